"""Certificates through polished answers: never below the truth, found in extended precision, and close to it."""

import numpy as np
import pytest
from extended import Real, distance, frozen

import nsdyn as nd
from nsdyn.problem import cones, gauss, polished
from nsdyn.problem.blocks import DelassusFactors

extended = pytest.mark.skipif(np.finfo(Real).eps > 1e-18, reason="long doubles are doubles here")
PROVED = 1e-17
"""Most gap of a reference, J, which is proved to its root then: 3e-9, a hundredth of the errors that noise of 1e-7
makes. Round-off in extended precision is 1e-19."""

NOISES = 1e-3, 1e-4, 1e-5, 1e-6, 1e-7


def of_factors(H, q, mu):
    """The problem with M = I and H (n, 3 nc) in one block of coordinates."""
    n, nc = len(H), mu.size
    one, none = np.zeros(nc, np.int64), np.full(nc, -1, np.int64)
    start, eye = np.column_stack((3 * n * np.arange(nc), one)), np.eye(n).ravel()
    blocks = DelassusFactors(
        np.array([0, n]), np.column_stack((one, none)), start, H.T.ravel(), np.array([0]), eye, eye
    )
    return nd.FC3D.from_blocks(blocks, q, mu)


def drawn(rng, k):
    """(H, q, mu) of 2 to 12 contacts of one or several bodies: masses of any size, contacts twice, some that open.

    H is of few bits, so that W = Hᵀ H has no round-off.
    """
    nc = int(rng.integers(2, 13))
    n = 6 if k % 2 else 6 * max(1, nc // 2)
    H = rng.normal(size=(n, 3 * nc))
    if k % 4 == 1:
        H *= 10.0 ** rng.uniform(-2, 2, n)[:, None]
    if k % 5 == 2:
        H[:, 3 * (nc // 2) :] = H[:, : 3 * (nc - nc // 2)]
    if k % 3 == 1:
        H[0, ::3] += 3.0
    mu = rng.uniform(0, 1.5, nc) * (rng.random(nc) < 0.9)
    return np.round(H * 4096) / 4096, rng.normal(size=3 * nc), np.round(mu * 1024) / 1024


def truth(H, q, mu, r):
    """(‖v(r) - v*‖ with the shift of r frozen, gap that proves it) in extended precision, from a polished guess."""
    problem = of_factors(H, q, mu)
    guess = polished.polished(problem, r)
    u = H.T.astype(Real) @ (H.astype(Real) @ r) + q
    b = q.astype(Real)
    b[0::3] += mu * np.sqrt(u[1::3] ** 2 + u[2::3] ** 2)
    x, gap = frozen(H, b, mu, guess)
    return distance(H, r, x), gap


def trials(rng, count):
    """(noise, truth, bounds without and with polishing) of answers with noise, and of wrong ones, noise 1."""
    out = []
    for k in range(count):
        H, q, mu = drawn(rng, k)
        r = nd.solve(nd.FC3D(H.T @ H, q, mu), tol=1e-12).r
        for noise in (*NOISES, 1e-9, 0.0, 1.0):
            change = noise * np.abs(r).max() * rng.normal(size=r.size) if noise < 1.0 else -rng.choice([0.1, 1.0]) * r
            x = cones.project((r + change).reshape(-1, 3), mu).ravel()
            problem = of_factors(H, q, mu) if rng.random() < 0.5 else nd.FC3D(H.T @ H, q, mu)
            bounds = [certify(problem, x)[0].bound for certify in (gauss.certify, polished.certify)]
            if np.isfinite(bounds[1]):
                true, gap = truth(H, q, mu, x)
                if gap <= PROVED:
                    out.append((noise, float(true), *bounds))
    return np.array(out)


def judge(found, least):
    """Bounds above the truth, polished ones close to it."""
    noise, true, plain, sharp = found.T
    assert len(found) >= least
    assert (sharp >= true).all() and (plain >= true).all()
    assert (sharp <= plain)[noise >= 1e-7].all()  # below that round-off decides, not counted in plain
    for k in NOISES:
        some = (noise == k) & (true > 0.0)
        ratio = sharp[some] / true[some]
        # By noise of 1e-7 the root of round-off is as large as the error.
        assert np.median(ratio) <= (1.2 if k >= 1e-6 else 3.0)


@pytest.mark.slow
@extended
def test_bounds_of_random_answers(rng):
    judge(trials(rng, 7), 35)


@extended
@pytest.mark.slow
def test_bounds_of_many_random_answers(rng):
    judge(trials(rng, 80), 480)


def noisy(problem, rng, noise):
    r = nd.solve(problem, tol=1e-12).r
    return cones.project((r + noise * np.abs(r).max() * rng.normal(size=r.size)).reshape(-1, 3), problem.mu).ravel()


@pytest.mark.parametrize(("name", "parameters"), [("stack", {"height": 5}), ("gripper", {})])
def test_steps_of_scenes(name, parameters, rng):
    """Redundant contacts, limits and joints: the bound is the distance from a second solution, not its root."""
    stepper = nd.Stepper(nd.scenes.load(name)(**parameters), dt=5e-3)
    for _ in range(3):
        problem = stepper.step().problem
    x = noisy(problem, rng, 1e-5)
    plain, sharp = (certify(problem, x)[0].bound for certify in (gauss.certify, polished.certify))
    assert sharp <= 0.1 * plain


@extended
@pytest.mark.parametrize("factors", [False, True])
def test_impulses_that_hardly_change_a_large_velocity(rng, factors):
    """Points that part, v* = 0: all of the answer is error, of which q in u = W r + q would round digits off."""
    for _ in range(50):
        H, mu = np.round(rng.normal(size=(3, 3)) * 4096) / 4096, np.array([0.5])
        q = np.array([rng.uniform(10, 20), *rng.normal(size=2)])
        r = 1e-6 * np.array([1.0, *rng.uniform(-0.3, 0.3, 2)])
        problem = of_factors(H, q, mu) if factors else nd.FC3D(H.T @ H, q, mu)
        assert polished.certify(problem, r)[0].bound >= distance(H, r, np.zeros(3))


def test_defect_in_coulombs_law():
    """One contact that slides: with the shift s frozen u_N = 0, and s = μ u_T once it is updated; known by hand."""
    W, mu = np.diag([2.0, 1.0, 1.0]), 0.5
    problem = nd.FC3D(W, [-1.0, 3.0, 0.0], [mu])
    exact = np.array([0.5, -0.25, 0.0])
    assert polished.certify(problem, exact)[0].coulomb <= 1e-14
    r = np.array([0.4, -0.2, 0.0])
    u = W @ r + problem.q

    def least(s):
        """Least ½ x·W x + (q + s e_N)·x over the ray where it slides, x = t (1, -μ, 0)."""
        ray = np.array([1.0, -mu, 0.0])
        t = -ray @ (problem.q + np.array([s, 0.0, 0.0])) / (ray @ W @ ray)
        return max(t, 0.0) * ray

    first = least(mu * abs(u[1]))
    second = least(mu * abs((W @ first + problem.q)[1]))
    norm = np.sqrt((second - first) @ W @ (second - first))
    assert norm > 1e-3
    assert polished.certify(problem, r)[0].coulomb == pytest.approx(norm, rel=1e-2)


def test_wedge_without_a_direction_keeps_its_plain_certificate():
    H = np.array([[1.0, 0, 0, -1.0, 0, 0]])
    problem = nd.FC3D(H.T @ H + np.diag([0, 1, 1, 0, 1, 1]), [-1.0, 0, 0, -0.5, 0, 0], np.zeros(2))
    assert polished.certify(problem, np.zeros(6))[0].bound == np.inf
    assert polished.certify(problem, np.full(6, np.nan))[0].bound == np.inf


@pytest.mark.parametrize("mu", [0.1, 1.0])
def test_ball_in_a_steep_cup_has_a_bound(mu):
    """With much friction nothing opens all three contacts, so that round-off, if it counts, leaves no bound."""
    scene, steep = nd.Scene(), 0.3
    for angle in 2.0 * np.pi * np.arange(3) / 3:
        normal = np.array([np.cos(angle), np.sin(angle), steep]) / np.hypot(1.0, steep)
        scene.add_halfspace(f"wall {angle:.0f}", normal=normal, material=nd.Material(mu=mu))
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1 * np.hypot(1.0, steep) / steep), material=nd.Material(mu=mu))
    run = nd.simulate(scene, 0.02, dt=5e-3, polish=True)
    assert (run.gauss.bound < 1e-6).all()


def test_recorded_where_it_is_asked_for(tmp_path):
    """The motion is the same to the last bit; bounds are tighter, defects recorded; elsewhere they are NaN."""
    scene = nd.scenes.load("stack")(height=3)
    plain = nd.simulate(scene, 0.05, dt=5e-3, solver=nd.solvers.Auto(tol=1e-4))
    sharp = nd.simulate(scene, 0.05, dt=5e-3, solver=nd.solvers.Auto(tol=1e-4), polish=True, record=tmp_path / "a.h5")
    assert np.isnan(plain.gauss.coulomb).all()
    assert (nd.Trajectory.load(tmp_path / "a.h5").gauss.coulomb == sharp.gauss.coulomb).all()
    assert np.isfinite(sharp.gauss.coulomb).all()
    np.testing.assert_array_equal(sharp.q, plain.q)
    assert (sharp.gauss.bound <= plain.gauss.bound).all()
    assert (sharp.gauss.bound < 0.5 * plain.gauss.bound).any()
    with pytest.raises(ValueError, match="its option polish is True, not False"):
        nd.simulate(scene, 0.1, dt=5e-3, solver=nd.solvers.Auto(tol=1e-4), resume=tmp_path / "a.h5")


def test_polish_is_true_or_false():
    with pytest.raises(ValueError, match="polish must be True or False, got 1"):
        nd.Stepper(nd.scenes.load("slide")(), polish=1)
