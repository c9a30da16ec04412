"""Continuation along smoothed laws: from nothing, where other methods stall, and the laws themselves."""

import numpy as np
import pytest
from test_auto import given, kicked_stack

import nsdyn as nd
from nsdyn._kernels.solvers import smoothing as smooth
from nsdyn.problem.operators import operator
from nsdyn.solvers.continuation import Following, Path, _corrected, continuation
from nsdyn.solvers.nesterov import Nesterov


def test_continuation_from_nothing():
    """A kicked stack by its factors and by W alone; friction is large, so that the path turns back in places."""
    problem = kicked_stack(height=8, ratio=30.0)
    for form in (problem, given(problem)):
        r = np.empty_like(problem.q)
        used, measure = continuation(form, operator(form), r, 1e-8, 400)
        assert problem.solved(r, 1e-8)[0] and measure <= 1e-8 and 5 < used < 200


@pytest.mark.parametrize("mu", [0.0, 10.0])
def test_continuation_where_sweeps_stall(mu, rng):
    """Thirty contacts that W couples all, of rank 20: with large friction sweeps with momentum leave 5e-2 of q."""
    nc, H = 30, rng.normal(size=(20, 90))
    q = H.T @ rng.normal(size=20)
    q[::3] += rng.uniform(0, 1, nc)
    problem = nd.FC3D(H.T @ H, q, np.full(nc, mu))
    assert (Nesterov(1e-8)(problem).error > 1e-2) == (mu > 0.0)
    r = np.empty_like(q)
    continuation(problem, operator(problem), r, 1e-8, 1000)
    assert problem.solved(r, 1e-8)[0]


def test_continuation_ends_by_the_effort_allowed():
    problem = given(kicked_stack(height=8))
    used, _ = continuation(problem, operator(problem), np.empty_like(problem.q), 0.0, 20)
    assert 20 <= used < 40


def test_no_path_where_floating_point_has_none():
    """The smoothing at which it would begin, 1e-240 J, divides by zero."""
    problem = nd.FC3D(np.eye(3), [-1e-120, 1e-120, 0.0], [0.5])
    assert nd.solve(problem, solver="continuation").status is nd.Status.MAX_ITERATIONS


@pytest.mark.parametrize("t", [-2000.0, 2000.0])
def test_a_point_beyond_floating_point_is_refused_in_silence(t):
    """Its smoothing is 0 or infinite: NumPy warned of a division by zero, or of a product with infinity."""
    problem = nd.FC3D(np.eye(6), [-1.0, 0.2, 0.0] * 2, [0.5, 0.0])
    path = Path(problem, operator(problem), np.zeros(6), 1.0)
    x = np.append(np.zeros_like(problem.q), t)
    assert _corrected(path, x, np.append(np.zeros_like(problem.q), 1.0))[0] is None


def test_a_path_goes_on_where_it_was():
    """Ten factorisations at a time end where one run ends, to the last bit, and so does Newton's method after it."""
    problem = kicked_stack(height=8, ratio=30.0)
    once, often = (Following(problem, operator(problem), 1e-8, np.zeros_like(problem.q), 1.0) for _ in range(2))
    once.run(400)
    while often.best > 1e-8 and often.count < 400:
        before = often.count
        often.run(10)
        assert 0 < often.count - before < 30
    assert 10 < once.count == often.count < 400
    np.testing.assert_array_equal(once.r, often.r)


@pytest.mark.parametrize("tau", [1e-12, 1e-3, 10.0])
def test_smoothed_law(tau, rng):
    """The three equations of the law and z = r - κ u, on random z and without friction; its tangent by differences."""
    nc = 40
    z, kappa, mu = rng.normal(size=3 * nc), rng.uniform(0.1, 10, nc), rng.uniform(0.05, 1.5, nc)
    mu[:3] = 0.0
    r, u, slip = np.empty(3 * nc), np.empty(3 * nc), np.empty((nc, 2))
    smooth.law(z, mu, kappa, tau, r, u, slip)
    R, U, Z = r.reshape(-1, 3), u.reshape(-1, 3), z.reshape(-1, 3).copy()
    Z[:3, 1:] = 0.0
    np.testing.assert_allclose(R - kappa[:, None] * U, Z, rtol=0, atol=1e-11 * np.abs(R).max())
    np.testing.assert_allclose(R[:, 0] * U[:, 0], tau, rtol=1e-12)
    rubs, (lam, D) = mu > 0, slip[mu > 0].T
    np.testing.assert_allclose(U[rubs, 1:], -lam[:, None] * R[rubs, 1:], rtol=1e-12)
    assert (D > 0).all() and (lam * D == pytest.approx(2 * tau, rel=1e-12))
    A, h = np.empty((nc, 3, 3)), 1e-7
    smooth.stiffness(r, u, slip, mu, A)
    rate, later, earlier = np.empty_like(r), r.copy(), r.copy()
    smooth.rate(r, u, slip, mu, kappa, tau, rate)
    for change, out in ((1e-4, later), (-1e-4, earlier)):
        smooth.law(Z.ravel(), mu, kappa, tau * np.exp(change), out, np.empty(3 * nc), slip.copy())
    differences = np.abs(r).max() / 1e-4 * np.finfo(float).eps  # of round-off, beside 1e-8 of their third order
    np.testing.assert_allclose(rate, (later - earlier) / 2e-4, rtol=1e-6, atol=10 * differences)
    for j in range(3) if tau >= 1e-3 else ():
        moved, r2, u2 = Z.copy(), np.empty(3 * nc), np.empty(3 * nc)
        moved[:, j] += h
        smooth.law(moved.ravel(), mu, kappa, tau, r2, u2, slip.copy())
        change = np.einsum("cij,cj->ci", A, (u2 - u).reshape(-1, 3))
        np.testing.assert_allclose((r2 - r).reshape(-1, 3)[rubs] / h, -change[rubs] / h, rtol=1e-3, atol=1e-4)
