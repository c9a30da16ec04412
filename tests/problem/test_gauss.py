"""The certificate: tried to be refuted, against frozen problems that an independent conic solver has solved."""

from itertools import pairwise

import clarabel
import numpy as np
import pytest
import scipy.sparse as sp

import nsdyn as nd
from nsdyn.problem import cones, gauss


def conic(H, mu, b):
    """(y, status): least ‖y‖ with Hᵀ y + b in K*, in coordinates with M = I, by an interior point method."""
    n, D = H.shape[0], np.ones((mu.size, 3))
    D[:, 1:] = mu[:, None]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    cones = [clarabel.SecondOrderConeT(3)] * mu.size
    A = sp.csc_matrix(-(D.ravel()[:, None] * H.T))
    out = clarabel.DefaultSolver(sp.csc_matrix(np.eye(n)), np.zeros(n), A, D.ravel() * b, cones, settings).solve()
    return np.array(out.x), str(out.status)


def factor(problem):
    """H of W = Hᵀ H, from the blocks: coordinates Lᵀ v with M = L Lᵀ."""
    M, H = problem.blocks.dense()
    return np.linalg.solve(np.linalg.cholesky(M), H)


def distance(problem, r, H):
    """(‖v - v*‖_M, accuracy of the reference) of r in K."""
    b = problem.q.copy()
    u = problem.velocity(r)
    b[0::3] += problem.mu * np.hypot(u[1::3], u[2::3])
    size = np.linalg.norm(b)
    y, status = conic(H, problem.mu, b / size)
    # Objectives to 1e-12 are velocities to its root.
    error = 3e-6 * np.linalg.norm(y) + 1e-8 if status == "Solved" else np.inf
    return float(np.linalg.norm(size * y - H @ r)), size * error


def into_cones(r, mu):
    return cones.project(r.reshape(-1, 3), mu).ravel()


@pytest.fixture(scope="module")
def stack():
    """(problem, r, opening, H) of a step of five boxes, and r of a stack that was thrown aside."""
    stepper = nd.Stepper(nd.scenes.load("stack")(height=5), dt=1e-2)
    step = stepper.step()
    return step.problem, step.solution.r, stepper.get_state().slater, factor(step.problem)


def test_no_impulse_has_no_gap_but_an_honest_bound(stack):
    problem, r, opening, H = stack
    certificate, same = gauss.certify(problem, 0 * r, None, opening)
    assert same is opening
    assert certificate.gap == 0.0
    true, _ = distance(problem, 0 * r, H)
    assert true == pytest.approx(0.2194, abs=1e-4)
    assert certificate.bound == pytest.approx(0.722, abs=0.01)


def test_wrong_impulses_of_a_stack(stack, rng):
    """Perturbed, scaled, dropped, permuted: never below the true distance, and small only where that is small."""
    problem, r, opening, H = stack
    trials = [r * f for f in (0.0, 0.5, 0.9, 1.1, 2.0)]
    trials += [r + e * rng.normal(size=r.size) for e in 10.0 ** np.arange(-8.0, 0.0) for _ in range(3)]
    trials += [np.where(np.arange(r.size) // 3 == c, 0.0, r) for c in range(problem.nc)]
    trials += [r.reshape(-1, 3)[rng.permutation(problem.nc)].ravel() for _ in range(5)]
    for trial in trials:
        x = into_cones(trial, problem.mu)
        bound = gauss.certify(problem, x, None, opening)[0].bound
        true, error = distance(problem, x, H)
        assert bound >= true * (1 - 1e-6) - error
        # Loads of 0.3 N·s, in a direction whose norm is 7: of the order of the root of the error.
        assert bound <= 20.0 * true + 20.0 * np.sqrt(true)


def test_impulse_of_another_step(stack):
    problem, _, opening, H = stack
    scene = nd.scenes.load("stack")(height=5)
    other = nd.Stepper(scene, dt=2e-2).step().solution.r
    assert gauss.certify(problem, other, None, opening)[0].bound >= distance(problem, other, H)[0] > 0.1


def test_bound_goes_to_zero_with_the_error(stack):
    problem, r, opening, _ = stack
    bounds = [gauss.certify(problem, (1.0 - e) * r, None, opening)[0].bound for e in 10.0 ** -np.arange(1.0, 13.0, 2.0)]
    assert all(b <= 0.2 * a for a, b in pairwise(bounds))
    assert gauss.certify(problem, r, None, opening)[0].bound <= 1e-6


def test_impulse_outside_the_cones_stands_for_its_projection(stack, rng):
    problem, r, opening, _ = stack
    x = r + 0.1 * rng.normal(size=r.size)
    wrong = problem.velocity(x)
    expected = gauss.certify(problem, into_cones(x, problem.mu), None, opening)[0]
    np.testing.assert_allclose(gauss.certify(problem, x, wrong, opening)[0], expected, rtol=1e-12)


def random_problem(rng, k):
    """(problem, H, scale of H) with rank-deficient W, contacts without friction or tangents, masses of any size."""
    nc = int(rng.integers(1, 9))
    n = int(rng.integers(1, 3 * nc + 4))
    H = rng.normal(size=(n, 3 * nc))
    if k % 3 == 0:  # the same contact twice
        H[:, 3 * (nc // 2) :] = H[:, : 3 * (nc - nc // 2)]
    if k % 4 == 1:  # contacts that can be opened
        H[:, ::3] = np.abs(H[:, ::3]) * 10.0 ** rng.uniform(-1, 1)
    if k % 5 == 0:
        H[:, rng.random(3 * nc) < 0.2] = 0.0
        H[0, ::3] += 1.0
    mu = rng.uniform(0, 1.5, nc) * (rng.random(nc) < 0.8)
    q = rng.normal(size=3 * nc)
    mass = 10.0 ** rng.uniform(-6, 6)
    return nd.FC3D(H.T @ H / mass, q / np.linalg.norm(q), mu), H, mass


def test_random_problems(rng):
    """Random impulses of hundreds of random problems: below no true distance, finite where contacts can be opened."""
    compared = opened = unopened = 0
    for k in range(400):
        problem, H, mass = random_problem(rng, k)
        r = rng.normal(size=problem.q.size) * mass * 10.0 ** rng.uniform(-3, 1) * (rng.random() < 0.8)
        r = into_cones(r, problem.mu)
        certificate, opening = gauss.certify(problem, r)
        unit = nd.FC3D(problem.W * mass, problem.q, problem.mu)  # the same velocities, of unit masses
        true, error = distance(unit, r / mass, H)
        bound = certificate.bound / np.sqrt(mass)
        assert bound >= true * (1 - 1e-6) - error
        compared += np.isfinite(bound + error)
        e = np.zeros_like(problem.q)
        e[0::3] = -1.0
        least, status = conic(H, problem.mu, e)
        if status == "Solved":
            assert np.isfinite(bound)
            opened += 1
        if status == "Solved" and opening is not None and opening.d.size:
            # The least direction within the slack that the search may leave, and what it may be longer.
            norm = np.sqrt(opening.d @ (problem.W @ opening.d) / mass)
            assert norm <= 2.0 * np.linalg.norm(least)
        unopened += np.isinf(certificate.bound)
    assert compared > 200
    assert opened > 150
    assert unopened > 20


def walls(q1, q2):
    """A mass between two frictionless walls, with normal velocities q1 and q2 away from them."""
    H = np.array([[1.0, 0, 0, -1.0, 0, 0]])
    return nd.FC3D(H.T @ H + np.diag([0, 1, 1, 0, 1, 1]), [q1, 0, 0, q2, 0, 0], np.zeros(2))


def test_walls_that_close():
    """No velocity helps: the bound is infinite, and the search is not repeated for less to gain."""
    certificate, opening = gauss.certify(walls(-1.0, -0.5), np.zeros(6))
    assert certificate.bound == np.inf
    assert opening.d.size == 0
    again, same = gauss.certify(walls(-0.9, -0.5), np.zeros(6), None, opening)
    assert again.bound == np.inf
    assert same is opening


@pytest.mark.parametrize("play", [0.6, 1.02, 10.0, 1e6])
def test_walls_with_play(play):
    """No direction opens both, but one that closes on the far wall is right: v* = 1 away from the near one."""
    certificate, _ = gauss.certify(walls(-0.5, play), np.zeros(6))
    assert 0.5 <= certificate.bound <= 0.6


def wedged(count, rng):
    """Problem of balls in a row between two walls, each closing with some and play enough for all at the far wall."""
    scene = nd.Scene()
    scene.add_halfspace("floor", material=nd.Material(mu=0.4))
    for sign in (1, -1):
        scene.add_halfspace(f"wall {sign}", normal=(sign, 0, 0), offset=-0.1 * count, material=nd.Material(mu=0.4))
    for k in range(count):
        scene.add_sphere(f"ball {k}", 0.1, 1.0, position=(0.2 * k - 0.1 * (count - 1), 0, 0.1))
    problem = nd.Stepper(scene, dt=5e-3).step().problem
    q = problem.q + 0.02 * rng.normal(size=problem.q.size)
    q[0::3] += np.where(np.arange(problem.nc) == problem.nc - 1, 0.1 * count, 0.0)
    return nd.FC3D.from_blocks(problem.blocks, q, problem.mu)


@pytest.mark.parametrize("count", [1, 2, 6])
def test_wedged_bodies(count, rng):
    """No velocity opens all contacts of a row between walls: that is not asked twice, and every answer has a bound."""
    problem = wedged(count, rng)
    H, opening = factor(problem), None
    r = nd.solve(problem, solver="newton").r
    for share in (0.0, 0.9, 0.999):
        x = share * r
        certificate, opening = gauss.certify(problem, x, None, opening)
        assert opening.wedged == problem.nc
        true, error = distance(problem, x, H)
        assert true * (1 - 1e-6) - error <= certificate.bound <= 10.0 * true + 10.0 * np.sqrt(true)


def test_overlap_of_round_off_is_no_reason_to_search_in_vain():
    certificate, _ = gauss.certify(walls(-1e-320, 1.0), np.zeros(6))
    assert certificate.bound <= 1e-15


def test_roller_gripped_in_a_nip_has_no_bound():
    stepper = nd.Stepper(nd.scenes.load("nip")(), dt=2e-3)
    steps = [stepper.step() for _ in range(3)]
    assert steps[-1].gauss.bound == np.inf


def test_gap_is_that_of_the_problem(stack):
    problem, r, opening, _ = stack
    x = 0.9 * r
    assert gauss.certify(problem, x, None, opening)[0].gap == pytest.approx(problem.gap(x), rel=1e-12)


def test_answer_that_is_not_finite():
    assert gauss.certify(walls(-1.0, 2.0), np.full(6, np.nan))[0].bound == np.inf


def test_direction_is_verified_not_trusted(stack, rng):
    """Any direction from elsewhere: of other contacts, of other coordinates, nonsense; bounds stay above."""
    problem, r, opening, H = stack
    true, _ = distance(problem, 0 * r, H)
    for d in (
        -opening.d,
        rng.normal(size=opening.d.size),
        np.ones(3),
        1e-9 * opening.d,
        np.full(opening.d.size, np.nan),
    ):
        certificate, _ = gauss.certify(problem, 0 * r, None, gauss.SlaterDirection(d, problem.nc, 1.0))
        assert true <= certificate.bound < 1.0


def test_factors_and_matrix_agree(stack, rng):
    """The same bound from the blocks and from W alone, but for how far each search went."""
    problem, r, opening, _ = stack
    alone = nd.FC3D(problem.W, problem.q, problem.mu)
    x = into_cones(r + 0.01 * rng.normal(size=r.size), problem.mu)
    first, direction = gauss.certify(alone, x)
    assert direction.d.shape == problem.q.shape
    assert first.bound == pytest.approx(gauss.certify(problem, x, None, opening)[0].bound, rel=1e-6)


@pytest.mark.parametrize(
    "name", [pytest.param("gripper", marks=pytest.mark.slow), "arm_pushes_box", "four_bar", "tumble"]
)
def test_bounds_of_mechanisms(name):
    """Limits, joint friction and loops are rows like others."""
    stepper = nd.Stepper(nd.scenes.load(name)(), dt=2e-3)
    for k in range(60):
        step = stepper.step()
        problem, r = step.problem, step.solution.r
        if problem.nc and k % 15 == 0:
            opening = stepper.get_state().slater
            for x in (r, 0.9 * r, 0 * r):
                true, error = distance(problem, x, factor(problem))
                bound = gauss.certify(problem, x, None, opening)[0].bound
                assert bound >= true * (1 - 1e-6) - error
                assert np.isfinite(bound)


def test_direction_lasts_at_rest_and_is_resumed():
    """One search for a stack at rest; a run that is resumed has the same bounds to the last bit."""
    stepper = nd.Stepper(nd.scenes.load("stack")(height=5), dt=1e-2)
    stepper.step()
    state = stepper.get_state()
    bounds = [stepper.step().gauss.bound for _ in range(20)]
    assert stepper.get_state().slater is state.slater
    stepper.set_state(state)
    assert [stepper.step().gauss.bound for _ in range(20)] == bounds
