"""Dual mixed finite elements of Pop: the elastic block with its stresses as unknowns.

    python demos/papers/page.py dual

The stress has Raviart–Thomas rows, so that tractions are unknowns of the boundary, one a facet; displacements are
constant in the elements and a continuous multiplier makes the stress symmetric (PEERS: each row has the curl of a
bubble besides). Given contact forces r the saddle-point problem is linear, and the mean displacements of the contact
facets are u = W r + q: Coulomb's law is again the contact problem of `demos/elastic_block.py`. Needs scikit-fem.

References: N. Pop, A mixed finite element discretization of a quasistatic contact problem with friction. D. Arnold,
F. Brezzi, J. Douglas, PEERS: a new mixed finite element for plane elasticity, Japan J. Appl. Math. 1, 1984.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import elastic_block as primal
import numpy as np
import scipy.sparse as sp
from elastic_block import CASES, POISSON, REFERENCE, SIDE, YOUNG, Block, solve, zones
from scipy.sparse.linalg import eigsh, splu

TABLE = dict(zip(CASES, ((3.75, 23.75), (5.0, 25.75), (0.0, 40.0), (0.0, 22.5), (0.0, 5.0)), strict=True))
"""Zones that Pop prints for his primal elements (000, table 1): open to, slip to, mm."""


@dataclass(frozen=True)
class Mixed:
    """The saddle-point problem of the block, stresses in units of Young's modulus.

    Attributes
    ----------
    A : sparse array, shape (ns, ns)
        Compliance ∫ ε(σ) : τ.
    B : sparse array, shape (nu, ns)
        ∫ v · div σ.
    C : sparse array, shape (np, ns)
        ∫ q (σ12 - σ21).
    outward : ndarray, shape (ns,)
        ∫ τ·n over the boundary of every function of a row there, ±1; 0 inside.
    facets : dict of ndarray
        Degrees of freedom of a row on each side, in the order of their positions.
    x : ndarray
        Middles of the contact facets, m.
    areas : ndarray
        Of the elements, m².
    """

    A: sp.csr_array
    B: sp.csr_array
    C: sp.csr_array
    outward: np.ndarray
    facets: dict[str, np.ndarray]
    x: np.ndarray
    areas: np.ndarray


def mixed(cells: int) -> Mixed:
    """Assemble the block on `cells` x `cells` squares of two triangles."""
    from skfem import (
        Basis,
        BilinearForm,
        ElementTriP0,
        ElementTriP1,
        ElementTriRT1,
        FacetBasis,
        LinearForm,
        MeshTri,
        asm,
    )

    class Row(ElementTriRT1):
        """Lowest-order Raviart–Thomas and the curl of the bubble xy(1 - x - y)."""

        interior_dofs = 1
        maxdeg = 2
        dofnames = ("u^n", "u^b")
        doflocs = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5], [1 / 3, 1 / 3]])

        def lbasis(self, X, i):
            if i < 3:
                return super().lbasis(X, i)
            x, y = X
            return np.array([x - x**2 - 2 * x * y, y**2 + 2 * x * y - y]), 0.0 * x

    grid = np.linspace(0.0, SIDE, cells + 1)
    mesh = MeshTri.init_tensor(grid, grid)
    row = Basis(mesh, Row(), intorder=4)
    constant, linear = row.with_element(ElementTriP0()), row.with_element(ElementTriP1())

    def product(i: int, j: int) -> sp.csr_array:
        return sp.csr_array(asm(BilinearForm(lambda s, t, w: t[i] * s[j]), row))

    xx, xy, yy = product(0, 0), product(0, 1), product(1, 1)  # tested by the first index
    mass = xx + yy
    nu = POISSON
    A = (1 + nu) * sp.block_array([[mass - nu * xx, -nu * xy], [-nu * xy.T, mass - nu * yy]], format="csr")
    divergence = sp.csr_array(asm(BilinearForm(lambda s, v, w: s.div * v), row, constant))
    B = sp.block_array([[divergence, None], [None, divergence]], format="csr")
    second = sp.csr_array(asm(BilinearForm(lambda s, q, w: s[1] * q), row, linear))
    first = sp.csr_array(asm(BilinearForm(lambda s, q, w: s[0] * q), row, linear))
    C = sp.hstack([second, -first], format="csr")
    flux = asm(LinearForm(lambda t, w: t[0] * w.n[0] + t[1] * w.n[1]), FacetBasis(mesh, Row(), intorder=4))
    sides = {
        "bottom": lambda x: np.isclose(x[1], 0.0),
        "top": lambda x: np.isclose(x[1], SIDE),
        "left": lambda x: np.isclose(x[0], 0.0),
        "right": lambda x: np.isclose(x[0], SIDE),
    }
    facets, middle = {}, mesh.p[:, mesh.facets].mean(axis=1)
    for name, where in sides.items():
        found = mesh.facets_satisfying(where)
        found = found[np.argsort(middle[:, found].sum(axis=0))]
        facets[name] = row.facet_dofs[0, found]
        if name == "bottom":
            x = middle[0, found]
    areas = asm(LinearForm(lambda v, w: v), constant)
    return Mixed(A, B, C, np.where(np.abs(flux) > 1e-12, np.sign(flux), 0.0), facets, x, areas)


def block(cells: int = 32, alpha: float = 0.3) -> Block:
    """The dual elements condensed to their contact facets, in the form of `elastic_block.Block`.

    The rigid mode is the mean vertical displacement d, with a spring of `alpha` times Young's modulus.
    """
    m = mixed(cells)
    ns, nu = m.A.shape[0], m.B.shape[0]
    half = ns // 2
    mode = np.zeros(nu)
    mode[nu // 2 :] = m.areas / m.areas.sum()
    spring = sp.csr_array(([1.0 / alpha], ([0], [0])), shape=(1, 1))
    S = sp.block_array(
        [
            [m.A, m.B.T, m.C.T, None],
            [m.B, None, None, mode[:, None]],
            [m.C, None, None, None],
            [None, mode[None, :], None, spring],
        ],
        format="csc",
    )
    bottom = m.facets["bottom"]
    contact = np.column_stack((half + bottom, bottom)).ravel()  # (N, T1) = (y, x) of each facet
    sign = np.repeat(m.outward[bottom], 2)
    loaded = {name: m.facets[name] for name in ("top", "left")}
    pitch = SIDE / cells
    fixed = np.concatenate((contact, *loaded.values(), *(half + d for d in loaded.values()), half + m.facets["right"]))
    free = np.setdiff1d(np.arange(S.shape[0]), fixed)
    # Columns: contact forces, side pressure, top pressure (in units of E), rest position.
    n = bottom.size
    given = np.zeros((S.shape[0], 2 * n + 3))
    given[contact, np.arange(2 * n)] = sign
    given[m.facets["left"], 2 * n] = m.outward[m.facets["left"]] * pitch
    given[half + m.facets["top"], 2 * n + 1] = m.outward[m.facets["top"]] * pitch
    right = np.zeros_like(given)
    right[-1, 2 * n + 2] = 1.0
    factor = splu(sp.csc_matrix(S[free][:, free]))
    solution = given.copy()
    solution[free] = factor.solve((right - S @ given)[free])
    u = sign[:, None] * (S @ solution)[contact]  # ⟨u, τ n⟩, the mean displacement of the facet
    d = mode @ solution[ns : ns + nu]

    def spread(rows: np.ndarray) -> np.ndarray:
        """Rows of (N, T1) as (N, T1, T2)."""
        return np.insert(rows, np.arange(2, 2 * n + 1, 2), 0.0, axis=0)

    flexibility = 0.5 * (u[:, : 2 * n] + u[:, : 2 * n].T) / YOUNG
    W = spread(spread(flexibility).T)
    W[2::3, 2::3] = np.eye(n) * np.diag(flexibility)[1::2].mean()
    columns = spread(u[:, 2 * n :])
    return Block(
        m.x,
        W,
        columns[:, 0] / YOUNG,
        columns[:, 1] / YOUNG,
        spread(d[: 2 * n] / YOUNG),
        d[2 * n] / YOUNG,
        d[2 * n + 1] / YOUNG,
        columns[:, 2],
        d[2 * n + 2],
    )


def uzawa_limit(m: Mixed) -> float:
    """2/λ_max of B A⁻¹ Bᵀ M_u⁻¹: the largest step ρ of u ← u + ρ (div σ + f), A σ = -Bᵀ u, for which it converges.

    In units of Young's modulus and metres; the multiplier of the symmetry is left out, which only raises λ_max.
    """
    A = splu(sp.csc_matrix(m.A))
    root = 1.0 / np.sqrt(np.tile(m.areas, 2))
    operator = sp.linalg.LinearOperator(
        (m.B.shape[0], m.B.shape[0]), matvec=lambda x: root * (m.B @ A.solve(m.B.T @ (root * x.ravel()))), dtype=float
    )
    start = np.cos(np.arange(m.B.shape[0]))
    return 2.0 / float(eigsh(operator, k=1, which="LA", v0=start, return_eigenvectors=False)[0])


def uzawa_growth(m: Mixed, rho: float, iterations: int = 1000) -> float:
    """‖u_n‖ / ‖u_0‖ of the paper's iteration with f = 0, whose solution is 0."""
    A, u = splu(sp.csc_matrix(m.A)), np.cos(np.arange(m.B.shape[0]))
    area, size = np.tile(m.areas, 2), np.sqrt(np.tile(m.areas, 2))
    first = float(np.linalg.norm(size * u))
    for _ in range(iterations):
        u = u - rho * (m.B @ A.solve(m.B.T @ u)) / area
    return float(np.linalg.norm(size * u)) / first


def report(pictures: Path) -> str:
    """Compute, draw, and return the section of the page."""
    from matplotlib.figure import Figure

    lines = [
        "## Dual mixed finite elements (Pop)",
        "",
        "The block of `demos/elastic_block.py` (Raous, Chabrand, Lebon) with stresses as unknowns: PEERS, one traction "
        "a facet, 32 x 32 squares of two triangles; beside it bilinear displacements on the same squares.",
        "",
        "| μ, F, f | dual: open to, slip to [mm] | primal | Pop's table 1 |",
        "|---|---|---|---|",
    ]
    dual, displacements = block(32), primal.block(32)
    shown = {}
    for case, printed in TABLE.items():
        u, r, _ = solve(dual, *case)
        shown[case] = u, r
        v, s, _ = solve(displacements, *case)
        a, b = zones(dual, u, r), zones(displacements, v, s)
        name = ", ".join(f"{x:g}" for x in case)
        rows = " | ".join(f"{x[0]:.2f}, {x[1]:.2f}" for x in (a, b, printed))
        lines.append(f"| {name} | {rows} |")
    lines += [
        "",
        "u_x of the contact at μ = 1, F = 15, f = -5, in 1e-5 m (dual: linear between the middles of the facets):",
        "",
        "| x [mm] | dual 8 | 16 | 32 | primal 32 | reference |",
        "|---|---|---|---|---|---|",
    ]
    case = (1.0, 15.0, -5.0)
    runs, fine = {}, primal.block(64)
    for cells in (8, 16, 32):
        body = dual if cells == 32 else block(cells)
        runs[cells] = body, *solve(body, *case)[:2]
    v = solve(displacements, *case)[0]
    exact = solve(fine, *case)[0]
    for x, value in REFERENCE.items():
        along = [1e5 * np.interp(x, body.x, u[1::3]) for body, u, _ in runs.values()]
        here = 1e5 * v[3 * round(x / displacements.x[1]) + 1]
        lines.append(f"| {1e3 * x:g} | " + " | ".join(f"{y:.3f}" for y in [*along, here, 1e5 * value]) + " |")
    errors = [
        float(np.abs(u[1::3] - np.interp(body.x, fine.x, exact[1::3])).mean() / np.abs(exact[1::3]).max())
        for body, u, _ in runs.values()
    ]
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for cells, (body, u, _) in runs.items():
        left.plot(1e3 * body.x, 1e5 * u[1::3], ".-", label=f"dual, {cells} cells")
    left.plot(1e3 * fine.x, 1e5 * exact[1::3], "k-", lw=0.8, label="primal, 64 cells")
    left.plot([1e3 * x for x in REFERENCE], [1e5 * y for y in REFERENCE.values()], "ks", label="reference")
    left.set(xlabel="distance from the loaded side [mm]", ylabel="u_x [1e-5 m]")
    left.legend(fontsize="small")
    u, r = shown[case]
    right.plot(1e3 * dual.x, 1e-6 * r[0::3] * 32 / SIDE, label="normal")
    right.plot(1e3 * dual.x, 1e-6 * np.abs(r[1::3]) * 32 / SIDE, label="tangential")
    right.set(xlabel="distance from the loaded side [mm]", ylabel="contact traction [MPa], dual")
    right.legend(fontsize="small")
    figure.savefig(pictures / "dual.png", dpi=80)
    small = runs[8][0]
    one = solve(small, *case)[0]
    many = solve(small, *case, increments=20)[0]
    by = {name: solve(small, *case, solver=name, tol=1e-7)[0] for name in ("tresca", "uzawa")}
    apart = {name: float(np.abs(u - one).max()) for name, u in by.items()}
    limits = {cells: uzawa_limit(mixed(cells)) for cells in (4, 8, 16)}
    m = mixed(4)
    below, above = (uzawa_growth(m, f * limits[4]) for f in (0.99, 1.01))
    lines += [
        "",
        "![Displacements and tractions of the dual elements](../papers/dual.png)",
        "",
        "Mean difference of u_x from the primal elements on 64 x 64, relative to the largest: "
        + ", ".join(f"{e:.1e} on {c}" for c, e in zip(runs, errors, strict=True))
        + f" (order {np.log2(errors[0] / errors[2]) / 2:.2f}).",
        "",
        f"Twenty time increments in place of one change the displacements by at most {np.abs(many - one).max():.1e} m "
        "(8 cells; the load is proportional). Coulomb's law through Tresca's fixed point, by sweeps and by Uzawa with "
        f"0 < ρ < 2/λ_max(W), gives the displacements of Newton to {apart['tresca']:.0e} and {apart['uzawa']:.0e} m.",
        "",
        "The paper's Uzawa step on the displacements, u ← u + ρ (div σ + f), is claimed to converge for "
        "2ρ - 2ρ² ≥ β > 0, ρ in an interval inside (0, 1) whatever the mesh. Its bound is ρ < 2/λ_max(B A⁻¹ Bᵀ): "
        + ", ".join(f"{value:.2e} on {c} x {c}" for c, value in limits.items())
        + " (stress in units of E, metres), a quarter on half the mesh, for div is bounded by the norm of H(div) but "
        "the energy a*(σ, σ), which the proof takes for that norm, is not coercive in it. "
        f"1000 iterations from a rough u change its norm by {below:.1e} at 0.99 of the bound and {above:.1e} at 1.01.",
    ]
    return "\n".join(lines)
