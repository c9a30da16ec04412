"""An elastic block pressed against a rigid plane and pushed sideways: zones that open, slip and stick.

Half of a block of 40 mm, plane strain, symmetric at its far side. The displacements of the contact nodes are
u = W r + q with the flexibility W of the block, so Coulomb's law in displacements is the contact problem of a time
step. Needs scikit-fem (extra `fem`).

    python demos/elastic_block.py

The block can move vertically as a whole, held by the contact alone. That rigid mode gets a spring alpha with its rest
position at the last iterate (a proximal step); the iteration ends when the spring carries nothing.

References: M. Raous, P. Chabrand, F. Lebon, Numerical methods for frictional contact problems and applications, J. Mec.
Theor. Appl. 7, 1988, whose displacements code_aster's test SSNV128 quotes.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

import nsdyn as nd

SIDE, YOUNG, POISSON = 0.04, 1.3e11, 0.2  # m, Pa
REFERENCE = {0.0: 2.86e-5, 1.25e-3: 2.72e-5, 5e-3: 2.28e-5, 7.5e-3: 1.98e-5, 11.25e-3: 1.50e-5}  # m, mu 1, F 15, f -5
CASES = {  # (mu, F, f) in daN/mm²: (end of the open zone, end of the slipping zone), mm, recomputed on 32 cells
    (1.0, 10.0, -5.0): (3.75, 22.5),
    (1.0, 15.0, -5.0): (3.75, 30.0),
    (0.2, 10.0, -5.0): (0.0, 40.0),
    (0.2, 10.0, -15.0): (0.0, 23.75),
    (0.2, 10.0, -25.0): (0.0, 3.75),
}


@dataclass(frozen=True)
class Block:
    """The block condensed to its contact nodes.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Positions of the contact nodes, m.
    W : ndarray, shape (3 n, 3 n)
        Flexibility in m/N per metre of depth; (N, T1, T2) per node, T2 out of the plane and idle.
    side, top : ndarray, shape (3 n,)
        Contact displacements per Pa of side and top pressure, m/Pa.
    rigid_W, rigid_side, rigid_top, rigid_lift : ndarray (3 n,), float, float, float
        The rigid mode's coordinate per contact force, per pressure and per rest position of its spring.
    lift : ndarray, shape (3 n,)
        Contact displacements per unit rest position of the spring.
    """

    x: np.ndarray
    W: np.ndarray
    side: np.ndarray
    top: np.ndarray
    rigid_W: np.ndarray
    rigid_side: float
    rigid_top: float
    lift: np.ndarray
    rigid_lift: float


def block(cells: int = 32, alpha: float = 0.3) -> Block:
    """Assemble the block on `cells` x `cells` squares; `alpha` times Young's modulus is the proximal spring."""
    from skfem import Basis, ElementQuad1, ElementVector, FacetBasis, LinearForm, MeshQuad, asm
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    grid = np.linspace(0.0, SIDE, cells + 1)
    mesh = MeshQuad.init_tensor(grid, grid)
    element = ElementVector(ElementQuad1())
    basis = Basis(mesh, element)
    K = asm(linear_elasticity(*lame_parameters(YOUNG, POISSON)), basis)
    fixed = basis.get_dofs(lambda x: np.isclose(x[0], SIDE)).all("u^1")
    free = np.setdiff1d(np.arange(K.shape[0]), fixed)

    def pressure(where, direction: int) -> np.ndarray:
        facets = FacetBasis(mesh, element, facets=mesh.facets_satisfying(where))
        return asm(LinearForm(lambda v, w: v[direction]), facets)

    loads = pressure(lambda x: np.isclose(x[0], 0.0), 0), pressure(lambda x: np.isclose(x[1], SIDE), 1)
    nodes = np.flatnonzero(np.isclose(mesh.p[1], 0.0))
    nodes = nodes[np.argsort(mesh.p[0, nodes])]
    n = len(nodes)
    # Contact displacements u = Bᵀ U: normal = vertical, tangent = horizontal.
    B = sp.lil_matrix((K.shape[0], 3 * n))
    for k, node in enumerate(nodes):
        B[basis.nodal_dofs[1, node], 3 * k] = 1.0
        B[basis.nodal_dofs[0, node], 3 * k + 1] = 1.0
    B = B.tocsr()[free]
    mode = np.zeros(K.shape[0])
    mode[basis.nodal_dofs[1]] = 1.0
    mode = mode[free] / np.linalg.norm(mode)
    spring = alpha * YOUNG / mesh.p.shape[1]  # moving the block by d costs alpha E d²/2 per metre of depth
    Ks = (K[free][:, free] + sp.csr_matrix(spring * np.outer(mode, mode))).tocsc()
    factor = splu(Ks)
    flexibility = B.T @ factor.solve(B.toarray())
    W = 0.5 * (flexibility + flexibility.T)
    W[2::3, 2::3] += np.eye(n) * np.diag(W)[1::3].mean()
    solved = [factor.solve(load[free]) for load in loads] + [factor.solve(spring * mode)]
    return Block(
        mesh.p[0, nodes],
        W,
        B.T @ solved[0],
        B.T @ solved[1],
        factor.solve(mode) @ B,
        mode @ solved[0],
        mode @ solved[1],
        B.T @ solved[2],
        mode @ solved[2],
    )


def solve(
    body: Block,
    mu: float,
    side: float,
    top: float,
    solver: str = "newton",
    tol: float = 1e-9,
    passes: int = 200,
    increments: int = 1,
) -> tuple[np.ndarray, np.ndarray, int]:
    """(u, r, passes of the last increment) under pressures in daN/mm²; u in m, r in N per metre of depth.

    The load grows in increments: the gap is that of the whole displacement, friction sees what an increment adds.
    """
    n = len(body.x)
    # Scaled to displacements of order 1: lengths by 1e-5 m, forces so that W has unit mean diagonal.
    length = 1e-5
    scale = np.trace(body.W) / (3 * n)
    rest, r, before = 0.0, np.zeros(3 * n), np.zeros(3 * n)
    for k in range(1, increments + 1):
        f, g = 1e7 * k / increments * side, 1e7 * k / increments * top
        base, fixed = f * body.side + g * body.top - before, f * body.rigid_side + g * body.rigid_top
        for used in range(1, passes + 1):  # noqa: B007 (what the last of them is)
            problem = nd.FC3D(body.W / scale, (base + rest * body.lift) / length, np.full(n, mu))
            solution = nd.solve(problem, solver, tol=tol, r0=r)
            if not solution.converged:
                raise nd.NotConverged(f"{solver}: {solution.status.message}", problem, solution)
            r = solution.r
            step = body.rigid_W @ (r * length / scale) + fixed + rest * body.rigid_lift - rest
            rest += step
            if abs(step) * body.lift.max() <= 10 * tol * length:  # the block's height, in tolerances of the solver
                break
        else:
            raise RuntimeError(f"the rigid mode still moves by {step:.1e} m after {passes} passes")
        u = solution.u * length + before
        before[1::3] = u[1::3]
    return u, r * length / scale, used


def zones(body: Block, u: np.ndarray, r: np.ndarray) -> tuple[float, float]:
    """Where the open and the slipping zone end, at the first node (or facet's end) past each, in mm from the side."""
    past = body.x[1] - 2 * body.x[0]  # from a node to the next, from a facet's middle to its end
    is_open = r[0::3] <= 1e-6 * r[0::3].max()  # what the tolerance leaves of an open node's impulse
    slips = ~is_open & (np.abs(u[1::3]) > 1e-4 * np.abs(u[1::3]).max())
    opened, slid = (1e3 * min(SIDE, body.x[where].max(initial=-past) + past) for where in (is_open, slips))
    return opened, max(opened, slid)


def plot(body: Block, results: dict[tuple[float, float, float], tuple[np.ndarray, np.ndarray]], path: str) -> None:
    """Draw normal and tangential contact pressures of all cases with their zones."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(len(results), 1, figsize=(7, 2.2 * len(results)), sharex=True, layout="constrained")
    for ax, ((mu, side, top), (u, r)) in zip(axes, results.items(), strict=True):
        opened, slid = zones(body, u, r)
        for begin, end, name, colour in (
            (0, opened, "open", "0.9"),
            (opened, slid, "slip", "#f4c7a1"),
            (slid, 40, "stick", "#a9cfe8"),
        ):
            if end > begin:
                ax.axvspan(begin, end, color=colour, label=name)
        width = body.x[1] * np.r_[0.5, np.ones(len(body.x) - 2), 0.5]
        ax.plot(1e3 * body.x, 1e-6 * r[0::3] / width, label="normal [MPa]")
        ax.plot(1e3 * body.x, 1e-6 * np.abs(r[1::3]) / width, label="tangential [MPa]")
        ax.set_title(f"mu {mu:g}, side {side:g}, top {top:g} daN/mm²", fontsize="small")
        ax.legend(fontsize="x-small", ncols=5)
    axes[-1].set_xlabel("distance from the loaded side [mm]")
    figure.savefig(path)
    plt.close(figure)


def main() -> None:
    """Print displacements and zones beside the references and draw the pressures."""
    body = block(32)
    results = {}
    for case, expected in CASES.items():
        u, r, passes = solve(body, *case)
        results[case] = u, r
        opened, slid = zones(body, u, r)
        print(
            f"mu {case[0]:g}, side {case[1]:g}, top {case[2]:g} daN/mm²: open to {opened:.2f}, slip to {slid:.2f} mm; "
            f"recomputed {expected[0]:.2f}, {expected[1]:.2f} ({passes} passes)"
        )
    u = results[1.0, 15.0, -5.0][0]
    for x, value in REFERENCE.items():
        print(f"x = {1e3 * x:5.2f} mm: u_x = {u[3 * round(x / body.x[1]) + 1]:.3e} m, reference {value:.2e} m")
    plot(body, results, "elastic_block.png")
    print("elastic_block.png")


if __name__ == "__main__":
    main()
