"""The portfolio and the interior point method on what defeats other solvers: cold, redundant, unsymmetric, mixed."""

from pathlib import Path

import landing
import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from test_problem import one_block

import nsdyn as nd
from nsdyn._kernels.problem import linear
from nsdyn.literature._kernels import interior as kernels
from nsdyn.problem.operators import Local, Velocity
from nsdyn.problem.solution import Status
from nsdyn.solvers import auto

SHARED = Path(__file__).resolve().parents[3] / "shared"
SOLVERS = ("auto", "continuation", "interior")


def kicked_stack(height=6, ratio=1.0, mu=0.6, seed=0):
    """First step of a stack of boxes, the masses growing by `ratio` from bottom to top, all thrown about."""
    rng = np.random.default_rng(seed)
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=mu))
    for k in range(height):
        scene.add_box(
            f"box{k}", (0.4, 0.4, 0.2), float(ratio ** (k / (height - 1))), position=(0, 0, 0.1 + 0.2 * k),
            linear_velocity=rng.normal(size=3) * (0.3, 0.3, 0.1), angular_velocity=0.3 * rng.normal(size=3),
            material=nd.Material(mu=mu),
        )  # fmt: skip
    return nd.Stepper(scene, dt=1e-2, on_fail="ignore").step().problem


def given(problem):
    """The same problem by W alone."""
    return nd.FC3D(problem.W, problem.q, problem.mu)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("form", [lambda p: p, given], ids=["factors", "matrix"])
@pytest.mark.parametrize("mu", [0.0, 0.3, 1.0, 10.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kicked_stack_from_nothing(solver, form, mu, seed):
    solution = nd.solve(form(kicked_stack(mu=mu, seed=seed)), solver, tol=1e-9)
    if (solver, mu, seed) == ("continuation", 10.0, 0):  # the path alone may end before the solution, and says so
        assert solution.converged or solution.status is nd.Status.MAX_ITERATIONS
    else:
        assert solution.converged, (solution.error, solution.residual)


@pytest.mark.parametrize("ratio", [1e-3, 1.0, 1e3])
def test_iterations_do_not_grow_with_the_mass_ratio(ratio):
    solution = nd.solve(kicked_stack(height=20, ratio=ratio), tol=1e-8)
    assert solution.converged
    # Of which sweeps are ten rounds' at most; alone they would grow with the square of the ratio.
    assert solution.iterations <= 6400


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_unit_of_mass(solver, factor):
    problem = given(kicked_stack())
    assert nd.solve(nd.FC3D(problem.W / factor, problem.q, problem.mu), solver).residual <= 1e-8


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("seed", range(3))
def test_unsymmetric_matrix(solver, seed):
    """W with a gyroscopic part: W is taken as it is, not its symmetric part."""
    rng = np.random.default_rng(seed)
    nc = 8
    G = rng.normal(size=(3 * nc, 12))
    A = rng.normal(size=(12, 12))
    W = G @ (np.eye(12) + 0.05 * (A - A.T)) @ G.T
    problem = nd.FC3D(W, G @ rng.normal(size=12), rng.uniform(0.2, 0.8, nc))
    solution = nd.solve(problem, solver, tol=1e-10)
    assert solution.converged
    np.testing.assert_allclose(solution.u, W @ solution.r + problem.q, rtol=0, atol=1e-12)


def test_what_is_out_of_reach_is_loose_and_accepted():
    """No solver meets 1e-300: the answer is recorded as within the loose tolerance, and refused where there is none."""
    problem = kicked_stack(height=3)
    loose = nd.solvers.Auto(tol=1e-300)(problem)
    assert loose.status is nd.Status.LOOSE and loose.accepted and not loose.converged
    assert max(loose.error, loose.residual) <= 1e-4
    strict = nd.solve(problem, tol=1e-300)
    assert strict.status is nd.Status.STALLED and not strict.accepted
    assert nd.solvers.Auto(tol=1e-3)(problem).converged


def test_what_is_loose_is_in_its_cones(rng):
    """Also where the start is good enough and outside of them."""
    problem = kicked_stack(24)
    r0 = rng.normal(size=3 * problem.nc)
    found = nd.solvers.Auto(loose=1e6).loosely(problem, r0)
    r, most = found.r.reshape(-1, 3), problem.mu * found.r[0::3]
    assert found.status is Status.LOOSE and np.abs(r0).max() > 0.1 * np.abs(r).max() > 0.0
    assert (r[:, 0] >= 0.0).all() and (np.hypot(r[:, 1], r[:, 2]) <= most + 1e-15 * np.abs(r).max()).all()


@pytest.mark.parametrize("form", ["factors", "matrix"])
def test_what_is_loose_and_slips_has_all_its_friction(form):
    """A start that is good enough, though what slips lacks a thousandth of its friction."""
    problem = kicked_stack(height=24, mu=0.1)
    problem = problem if form == "factors" else given(problem)
    r = nd.solve(problem).r.reshape(-1, 3)
    slips = np.linalg.norm(problem.velocity(r.ravel()).reshape(-1, 3)[:, 1:], axis=1) > 1e-2
    assert (slips & (r[:, 0] > 0.0)).sum() > 4
    r[slips, 1:] *= 0.999
    found = nd.solvers.Auto(loose=1e-2).loosely(problem, r.ravel()).r.reshape(-1, 3)
    drag, most = np.linalg.norm(found[slips, 1:], axis=1), problem.mu[slips] * found[slips, 0]
    np.testing.assert_allclose(drag, most, rtol=1e-12, atol=0)
    assert np.abs(found - r).max() > 0.0


def test_what_does_not_fall_is_not_worked_on():
    """Contacts of one pair that stick, and are to slip against each other by round-off, which no motion does."""
    scene, stone = nd.Scene(), nd.Material(mu=0.6)
    scene.add_halfspace("ground", material=stone)
    for k in range(4):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(0.02 * k, 0, 0.1 + 0.2 * k), material=stone)
    stepper = nd.Stepper(scene, dt=5e-3)
    stepper.step()
    problem = stepper.step().problem
    q = problem.q.copy()
    q[[2, 5]] += 6e-14, -6e-14
    solution = nd.solve(problem.with_velocity(q))
    assert solution.converged and 3e-14 < solution.residual < 1e-13
    assert solution.iterations <= nd.solve(problem).iterations + 4  # 34 and 36; twice as many were tried in vain
    assert nd.solve(problem.with_velocity(q), r0=solution.r).iterations <= 4


def test_what_rounding_leaves_of_heavy_bodies_is_not_worked_on(rng):
    """Impulses of 1e12 N·s at 1 m/s are in their cones up to an error of 1e-4, which is told."""
    told, most = [], 0
    for _ in range(30):
        nc = int(rng.integers(2, 12))
        H, mu = rng.normal(size=(12, 3 * nc)), rng.uniform(0, 0.5, nc)
        H[0, ::3] += 3.0
        problem = nd.FC3D(H.T @ H * 1e-12, rng.normal(size=3 * nc), mu)
        solution = nd.solve(problem)
        told.append(solution.status)
        most = max(most, solution.iterations)
        assert solution.converged or 1e-8 < solution.error <= problem.round_off(solution.r)
    assert set(told) == {nd.Status.CONVERGED, nd.Status.STALLED}
    assert most < 5000  # 15 000 before it gave up


@pytest.mark.parametrize(("nc", "rank"), [(10, 12), (30, 90), (60, 60)])
def test_what_rounding_leaves_is_not_worked_on(nc, rank, rng):
    """Velocities of 1e5 m/s have no residual of 1e-12: what rounding allows is told, and soon."""
    H = rng.normal(size=(rank, 3 * nc))
    problem = nd.FC3D(H.T @ H / rank, 1e5 * rng.normal(size=3 * nc), np.full(nc, 0.5))
    solution = nd.solve(problem, tol=1e-12)
    assert solution.status is nd.Status.STALLED
    assert 1e-12 < solution.residual <= problem.round_off(solution.r) < 1e-8
    assert solution.iterations < 2 * nd.solve(problem, tol=1e-8).iterations + 2000  # 7000 before it gave up
    for r0 in (np.full(3 * nc, np.nan), [np.inf] * (3 * nc)):
        with pytest.raises(ValueError, match="r0 must be finite"):
            nd.solve(problem, r0=r0)


@pytest.mark.slow
def test_effort_beyond_the_loose_tolerance_is_bounded():
    """Where the tolerance is out of reach a solve ends after the work it may do, the same in every run."""
    problem = kicked_stack(height=40)
    solver = nd.solvers.Auto(tol=1e-300)
    counts = [solver(problem).iterations for _ in range(2)]
    assert counts[0] == counts[1]
    assert counts[0] < nd.solve(problem, tol=1e-300).iterations
    less = nd.solvers.Auto(tol=1e-300, effort=0.1)(problem)
    more = nd.solvers.Auto(tol=1e-300, effort=100.0)(problem)
    assert less.iterations < counts[0] == more.iterations  # at most `loose_limit` factorisations beyond


@pytest.mark.parametrize(("height", "rough", "loose"), [(3, 1e-8, 1e-8), (40, 1e-2, 1e-4)])
def test_what_is_posed_anew_is_asked_for_less(height, rough, loose):
    """In a collision large islands come to a hundred loose tolerances or to one; small ones are solved."""
    problem, auto = kicked_stack(height=height), nd.solvers.Auto()
    near = nd.solve(problem).r
    assert all(auto.roughly(problem, r, 0.0) is None for r in (near, np.zeros_like(near)))
    first, second = auto.roughly(problem, 3.0 * near, 0.0), auto.loosely(problem, 3.0 * near)
    assert first.iterations <= second.iterations
    assert first.iterations <= auto.roughly(problem, 3.0 * near, 1.0).iterations <= 2 * first.iterations
    full = auto.roughly(problem, 3.0 * near, 100.0)
    assert max(full.error, full.residual) <= loose
    for solution, reached in ((first, rough), (second, loose)):
        assert max(solution.error, solution.residual) <= reached
        assert solution.converged is (height == 3)
        np.testing.assert_allclose(solution.u, problem.W @ solution.r + problem.q, rtol=0, atol=1e-12)


def test_islands_of_a_matrix():
    W = scipy.linalg.block_diag(np.eye(3), np.ones((6, 6)) + np.eye(6), np.eye(3))
    order = np.array([1, 0, 3, 2])  # islands {1}, {0, 3}, {2}
    rows = (3 * order[:, None] + np.arange(3)).ravel()
    problem = nd.FC3D(W[np.ix_(rows, rows)], np.ones(12), np.ones(4))
    assert problem.islands().tolist() == [0, 1, 2, 0]


def test_large_island_of_a_matrix():
    """More contacts than are solved densely: the sparse form of the same methods."""
    n = 400
    W = sp.kron(sp.diags_array([-0.5, 1.0, -0.5], offsets=[-1, 0, 1], shape=(n, n)), np.eye(3))
    rng = np.random.default_rng(0)
    problem = nd.FC3D(W, rng.normal(size=3 * n), np.full(n, 0.5))
    for solver in SOLVERS:
        assert nd.solve(problem, solver).converged


@pytest.mark.parametrize("band", [2, 9])
def test_factorisation_against_dense_algebra(band, rng):
    i, j = np.indices((9, 9))
    S = np.where(np.abs(i - j) <= band, rng.normal(size=(9, 9)), 0.0)
    b, work = rng.normal(size=9), np.empty((3, 9), np.int64)
    expected = np.linalg.solve(S, b)
    assert linear.factorise(S, *work)
    linear.substitute(S, *work, b)
    np.testing.assert_allclose(b, expected, rtol=0, atol=1e-11)
    assert not linear.factorise(np.zeros((9, 9)), *work)


@pytest.mark.parametrize("operator", ["Velocity", "Local"])
def test_operators(operator, rng):
    """Both forms of W (I + A W)⁻¹ against dense algebra."""
    problem = kicked_stack(height=3)
    W, nc = problem.W.toarray(), problem.nc
    made = Velocity(problem.blocks) if operator == "Velocity" else Local(problem.W)
    A = np.array([R @ R.T for R in rng.normal(size=(nc, 3, 3))])
    g = rng.normal(size=3 * nc)
    expected = W @ np.linalg.solve(np.eye(3 * nc) + scipy.linalg.block_diag(*A) @ W, g)
    np.testing.assert_allclose(made.factor(A)(g), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(made.product(g), W @ g, rtol=0, atol=1e-10)


@pytest.mark.parametrize("as_sparse", [False, True])
def test_operator_that_couples_all_contacts(as_sparse, rng):
    """It is no sparse matrix, and need not be symmetric; I + A W of an indefinite W may be singular."""
    W, A, g = rng.normal(size=(12, 12)) + 8.0 * np.eye(12), rng.normal(size=(4, 3, 3)), rng.normal(size=12)
    made = Local(nd.FC3D(sp.csr_array(W[:, ::-1])[:, ::-1] if as_sparse else W, np.ones(12), np.ones(4)).W)
    expected = W @ np.linalg.solve(np.eye(12) + scipy.linalg.block_diag(*A) @ W, g)
    np.testing.assert_allclose(made.factor(A)(g), expected, rtol=1e-12)
    with pytest.raises(RuntimeError, match="singular"):
        Local(nd.FC3D([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]], np.ones(3), [1.0]).W).factor(-np.diag([1.0, 0, 0])[None])


def test_scaling_point(rng):
    """T z = T⁻¹ x = λ with T symmetric, and the mean of x·z."""
    nc = 5
    mu, u, z = rng.uniform(0.2, 1, nc), rng.normal(size=(nc, 3)), rng.normal(size=(nc, 3))
    u[:, 0], z[:, 0] = np.abs(u[:, 0]) + 0.1, np.hypot(z[:, 1], z[:, 2]) + rng.uniform(0.1, 1, nc)
    (T, V, C, A), lam = (np.empty((nc, 3, 3)) for _ in range(4)), np.empty((nc, 3))
    gap = kernels.scaling(u, z, mu, T, V, C, A, lam)
    x = np.column_stack((u[:, 0] / mu + np.hypot(u[:, 1], u[:, 2]), u[:, 1:]))
    assert gap == pytest.approx((x * z).sum() / nc, rel=1e-13)
    np.testing.assert_allclose(np.einsum("cij,cj->ci", V, x), lam, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("cij,cj->ci", T, z), lam, rtol=0, atol=1e-12)
    np.testing.assert_allclose(T @ V, np.broadcast_to(np.eye(3), T.shape), rtol=0, atol=1e-12)


@pytest.mark.case(49)
@pytest.mark.skipif(not SHARED.is_dir(), reason="the folders of FCLIB problems are not here")
@pytest.mark.parametrize(
    "name", [f"{d}/{path.name}" for d in ("fc3d", "hard") for path in sorted((SHARED / d).glob("*.hdf5"))]
)
def test_every_problem_of_the_literature(name):
    problem = nd.fclib.read(SHARED / name)
    solution = nd.solve(problem, tol=1e-8)
    assert solution.converged, (solution.error, solution.residual)
    assert (nd.solve(problem, tol=1e-8).r == solution.r).all(), "not reproducible to the last bit"


def test_one_contact_by_its_matrix(rng):
    """Take-off, stick and slip in closed form, from whatever start."""
    for q in ((1.0, 2.0, 0.0), (-1.0, 0.1, 0.0), (-1.0, 3.0, -2.0)):
        A = rng.normal(size=(3, 6))
        problem = nd.FC3D(A @ A.T, q, [0.3])
        solution = nd.solve(problem, r0=rng.normal(size=3))
        assert solution.converged and problem.error(solution.r) <= 1e-13  # round-off of W r, W of order 10
        np.testing.assert_allclose(solution.u, problem.velocity(solution.r), rtol=0, atol=1e-14)  # sums may be fused
        np.testing.assert_array_equal(solution.r, nd.solve(problem).r)
    with pytest.raises(ValueError, match="r0 must have shape"):
        nd.solve(problem, r0=np.zeros(6))


def test_contacts_that_take_off_cost_nothing():
    problem = nd.FC3D(np.eye(9) + 0.1, np.tile([1.0, 2.0, 0.0], 3), np.full(3, 0.5))
    solution = nd.solve(problem)
    assert solution.converged and solution.iterations == 0 and not solution.r.any()


def test_many_small_islands_and_a_large_one(rng):
    """By W alone, contacts of all islands mixed: each is solved, and the whole is judged."""
    blocks = [A @ A.T for A in (rng.normal(size=(3 * k, 3 * k + 2)) for k in (1, 4, 1, 2, 7, 1, 40))]
    W, nc = scipy.linalg.block_diag(*blocks), 56
    rows = (3 * rng.permutation(nc)[:, None] + np.arange(3)).ravel()
    q = rng.normal(size=3 * nc)
    q[::3] -= 0.5
    solution = nd.solve(nd.FC3D(W[np.ix_(rows, rows)], q, np.full(nc, 0.3)))
    assert solution.converged and solution.error <= 1e-8 and solution.residual <= 1e-8


def test_one_contact_that_two_coordinates_move(rng):
    """At the tip of an arm of two joints W_cc has rank two: impulses that stop it are a line, in the cone or not."""
    for _ in range(50):
        H = rng.normal(size=(2, 3))
        problem = nd.FC3D.from_blocks(one_block(H), rng.normal(size=2) @ H, rng.uniform(0.0, 1.5, 1))
        assert nd.solve(problem).converged


@pytest.mark.slow
def test_small_islands_of_redundant_contacts_need_nothing_else(tmp_path, monkeypatch):
    """A chain of twenty light links lands on twice as many rows as coordinates: impulses are far from unique."""
    searched, most, path = [], 0, tmp_path / "chain.xml"
    monkeypatch.setattr(auto.Search, "run", lambda search: searched.append(search.problem.nc))
    path.write_text(landing.mjcf(20))
    scene = nd.Scene()
    scene.add_mjcf("chain", path)
    stepper = nd.Stepper(scene, dt=2e-3, on_fail="raise")
    for _ in range(330):
        most = max(most, stepper.step().gap.size)
    assert 3 * most > 2 * 26 and not searched


@pytest.mark.parametrize("scale", [1e6, 1e9])
@pytest.mark.parametrize("tol", [1e-4, 1e-8])
def test_a_start_that_is_far_from_any_solution_costs_no_answer(scale, tol):
    problem, solver = kicked_stack(30), nd.solvers.Auto(tol=tol, loose=tol)
    start = scale * np.abs(np.random.default_rng(1).standard_normal(3 * problem.nc))
    solution, cold = solver(problem, start), solver(problem)
    assert solution.converged
    assert solution.iterations <= 6 * cold.iterations


@pytest.mark.parametrize("seed", [2, 18, 28, 49])
def test_few_contacts_by_w_alone_take_one_kernel_call(seed, monkeypatch):
    """Up to 6 contacts of one body that turns easily: sweeps alone creep, 1280 were not enough."""
    rng = np.random.default_rng(seed)
    nc = 2 + seed % 5
    H = rng.normal(size=(6, 3 * nc))
    W = H.T @ np.diag([1.0, 1.0, 1.0, 30.0, 30.0, 30.0]) @ H
    monkeypatch.setattr(auto, "Search", None)
    assert nd.solve(nd.FC3D(W, H.T @ rng.normal(size=6), np.full(nc, 0.5))).converged


@pytest.mark.parametrize("solver", ["auto", "pgs"])
def test_a_contact_of_a_mechanism_of_one_coordinate(solver):
    """W = h hᵀ: the impulse that stops the contact is not unique, and none of its components is round-off's."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        h, mu = rng.normal(size=3), float(rng.choice([0.1, 0.5, 1.0, 3.0, 10.0]))
        problem = nd.FC3D(np.outer(h, h), -np.sign(h[0]) * abs(rng.normal()) * h, [mu])
        solution = nd.solve(problem, solver=solver)
        assert solution.converged and np.abs(solution.r).max() <= 2.0 * np.abs(problem.q / h**2).max()
