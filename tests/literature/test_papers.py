"""The studies of demos/papers: each formula against a second form of it."""

import math

import accelerations
import coulomb
import dual
import elastic_block
import increments
import numpy as np
import pytest

import nsdyn as nd


@pytest.fixture
def fem():
    pytest.importorskip("skfem", reason="scikit-fem is not installed (extra `fem`)")


def test_profiles_of_variants():
    """Both tolerances from one run: the loose one is met first; a limit that nothing meets leaves nothing solved."""
    problems = coulomb.load([])
    assert [p.singular for p in problems] == [
        np.linalg.matrix_rank(p.problem.W.toarray()) < 3 * p.problem.nc for p in problems
    ]
    solvers = {name: coulomb.groups()["solvers"][name] for name in ("NSN-AC", "NSN-FB")}
    loose, tight = coulomb.measure(problems, solvers, 20.0, {})  # s, which no load of the machine makes of a tenth
    assert (loose.times <= tight.times).all() and np.isfinite(loose.times).sum() >= 6
    for entry in problems:
        solution = solvers["NSN-AC"](nd.FC3D(entry.problem.W, entry.problem.q, entry.problem.mu))
        assert coulomb.solved(tight, "NSN-AC", [entry.name]) == solution.converged
    none = coulomb.measure(problems[:1], {"NSN-AC": solvers["NSN-AC"]}, 1e-9, {})
    assert not np.isfinite([p.times for p in none]).any()


def test_claims_are_decided_by_the_numbers():
    """A claim flips with the runs it is decided by."""
    from nsdyn.bench.profiles import Profile, Run

    def profile(a, b):
        rows = [
            Run(f"p{k}", 4, s, math.isfinite(t), t, 1, 0.0, 0.0, "")
            for s, times in (("NSGS-VI error/10", a), ("NSGS-VI 1e-14", b))
            for k, t in enumerate(times)
        ]
        return Profile(1e-8, 1.0, tuple(rows))

    (claim,) = coulomb.claims([])["local tolerance"]
    inf = math.inf
    cases = [
        ([1.0] * 3, [1.0, inf, inf], "Yes"),
        ([1.0, 1.0, inf], [2.0, inf, inf], "Yes"),
        ([2.0] * 3, [1.0] * 3, "No"),
        ([1.0] * 3, [1.1] * 3, "Undecided"),
    ]
    for a, b, verdict in cases:
        assert f"**{verdict}**" in claim.line({"local tolerance": [profile(b, a), profile(a, b)]})


def test_tangent_against_differences(fem, rng):
    cube = increments.Cube(1)
    U, d, h = 2e-3 * rng.normal(size=cube.basis.N), rng.normal(size=cube.basis.N), 1e-7
    K = cube.tangent(U)
    slope = (cube.internal(U + h * d) - cube.internal(U - h * d)) / (2 * h)
    np.testing.assert_allclose(K @ d, slope, rtol=0, atol=1e-6 * np.abs(slope).max())
    assert abs(K - K.T).max() <= 1e-12 * abs(K).max()


def test_increments_converge_quadratically(fem):
    """The residual falls as its square with the tangent updated, by a factor with it held; both end at one place."""
    cube, path = increments.Cube(2), increments.loading(6)[:2]
    solver = nd.solvers.Newton(tol=1e-11)
    newton, held = (increments.load(cube, path, solver, update=update) for update in (True, False))
    for a, b in zip(newton.residuals, held.residuals, strict=True):
        assert len(a) <= 5 < len(b)
        assert a[-1] <= 10.0 * a[-2] ** 2 + 1e-12
    # 1e-10 of the forces over a stiffness of order E times a length.
    np.testing.assert_allclose(newton.U[-1], held.U[-1], rtol=0, atol=1e-10)
    # Equilibrium and Coulomb's law at the end, recomputed: forces of the top against those of the ground.
    x, f = newton.r[-1].reshape(-1, 3), cube.internal(newton.U[-1])
    total = f[cube.top].sum(axis=1)
    np.testing.assert_allclose(total + x.sum(axis=0)[[1, 2, 0]], 0.0, rtol=0, atol=1e-8 * np.abs(x).sum())
    assert (np.hypot(x[:, 1], x[:, 2]) <= increments.MU * x[:, 0] * (1 + 1e-9)).all()


@pytest.mark.slow
def test_bundle_method_on_the_cube(fem):
    cube, path = increments.Cube(2), increments.loading(6)[:1]
    exact = increments.load(cube, path, nd.solvers.Auto(tol=1e-10, loose=1e-10))
    bundle = increments.load(cube, path, nd.solvers.Bundle(tol=1e-6, max_iter=20_000), tol=1e-5)
    np.testing.assert_allclose(bundle.U[-1], exact.U[-1], rtol=0, atol=1e-8)


def test_dual_elements_are_exact_for_a_constant_stress(fem):
    """Pressed from above without friction: σ_yy is constant, every facet carries its share, u_x is linear."""
    f = 5.0
    body = dual.block(4)
    u, r, _ = dual.solve(body, 0.0, 0.0, -f, tol=1e-11)
    np.testing.assert_allclose(r[0::3], f * 1e7 * dual.SIDE / 4, rtol=1e-9)
    nu, E = dual.POISSON, dual.YOUNG
    strain = nu * (1 + nu) / E * f * 1e7  # ε_xx of plane strain with σ_xx = 0
    np.testing.assert_allclose(u[1::3], -strain * (dual.SIDE - body.x), rtol=0, atol=1e-9 * strain * dual.SIDE)
    assert np.abs(u[0::3]).max() <= 1e-9 * strain * dual.SIDE


def test_flexibility_of_the_dual_elements(fem):
    """Symmetric, definite, and a third facet's displacement by forces on it is that of the saddle-point problem."""
    body = dual.block(6)
    values = np.linalg.eigvalsh(body.W)
    np.testing.assert_allclose(body.W, body.W.T, rtol=0, atol=1e-15 * values[-1])
    assert values[0] > 1e-3 * values[-1] and body.W.shape == (18, 18)
    assert not body.W[2::3, 0::3].any() and not body.W[2::3, 1::3].any()
    # A rigid motion costs the spring alone: vertical forces F in all move the mode by F / (alpha E), all facets too.
    np.testing.assert_allclose(body.rigid_W[0::3], 1.0 / (0.3 * dual.YOUNG), rtol=1e-9)
    np.testing.assert_allclose(body.lift[0::3], 1.0, rtol=1e-9)


def test_dual_beside_primal(fem):
    """The two discretisations enclose the truth: they come together as the mesh is refined."""
    case, apart = (1.0, 15.0, -5.0), []
    for cells in (4, 8, 16):
        body, other = dual.block(cells), elastic_block.block(cells)
        u, v = dual.solve(body, *case)[0], elastic_block.solve(other, *case)[0]
        apart.append(np.abs(u[1::3] - np.interp(body.x, other.x, v[1::3])).mean() / np.abs(v[1::3]).max())
    # Half on half the mesh or better: the solution has corners, where zones end and at the ends of the contact.
    assert apart[2] <= 0.6 * apart[1] <= 0.6 * 0.75 * apart[0] and apart[2] <= 0.02


def test_tresca_uzawa_and_increments(fem):
    case, body = (0.2, 10.0, -15.0), dual.block(8)
    u, r, _ = dual.solve(body, *case, tol=1e-10)
    for solver in ("tresca", "uzawa"):
        # 1e-7 of the unit of 1e-5 m, times the condition of the flexibility, about 100.
        np.testing.assert_allclose(dual.solve(body, *case, solver=solver, tol=1e-7)[0], u, rtol=0, atol=1e-10)
    # A proportional load: ten increments end where one does, up to where slip zones sweep across facets.
    ten = dual.solve(body, *case, increments=10)
    np.testing.assert_allclose(ten[1], r, rtol=0, atol=0.02 * r.max())


def test_uzawa_step_of_the_displacements_depends_on_the_mesh(fem):
    """Below 2/λ_max the iteration contracts, above it grows; a quarter on half the mesh, so no interval serves all."""
    coarse, fine = dual.mixed(3), dual.mixed(6)
    limit = dual.uzawa_limit(coarse)
    assert dual.uzawa_limit(fine) == pytest.approx(limit / 4, rel=0.02)
    assert dual.uzawa_growth(coarse, 0.99 * limit) < 1e-3 and dual.uzawa_growth(coarse, 1.01 * limit) > 1e3


@pytest.mark.slow
def test_zones_of_the_dual_elements(fem):
    body = dual.block(32)
    for case, expected in dual.CASES.items():
        # Two facets of 1.25 mm, as for the primal elements.
        np.testing.assert_allclose(dual.zones(body, *dual.solve(body, *case)[:2]), expected, rtol=0, atol=2.5 + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("section", [increments, accelerations, dual], ids=lambda m: m.__name__)
def test_sections_of_the_page(fem, section, tmp_path):
    pytest.importorskip("clarabel", reason="the extra 'acceleration' is not installed")
    text = section.report(tmp_path)
    assert text.startswith("## ") and (tmp_path / f"{section.__name__}.png").stat().st_size > 10_000


@pytest.mark.slow
def test_section_of_the_solvers(tmp_path):
    text = coulomb.report([], tmp_path, limit=0.05)
    verdicts = sum(text.count(f"**{word}**") for word in ("Agrees", "Does not agree", "Undecided", "Yes", "No"))
    assert verdicts == sum(map(len, coulomb.claims([]).values()))
    assert len(list(tmp_path.glob("profile_*.png"))) == len(coulomb.groups())
