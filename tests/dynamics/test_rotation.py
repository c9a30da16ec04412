"""Free rotation: accuracy, invariants, exact cases, against integrators and formulas that share nothing with it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipj

from nsdyn._kernels.dynamics.rotation import flow, principal
from nsdyn.scene.named import load

TURN = np.array([1.0, 3.0, 2.0]) * 4.0 / np.sqrt(14.0)  # rad/s, |TURN| = 4
BODY = np.diag([1.0, 2.0, 2.7])


def move(J, w, h, steps=1, quaternion=(0.0, 0.0, 0.0, 1.0)):
    """Attitude and spin of one body after steps of h."""
    x, q, v = np.zeros((1, 3)), np.array([quaternion]), np.r_[0.0, 0.0, 0.0, w]
    moments, axes = principal(np.asarray(J)[None])
    for _ in range(steps):
        flow(moments, axes, x, q, v, h, x, q, v)
    return Rotation.from_quat(q[0]).as_matrix(), v[3:]


def reference(J, w, t):
    """Attitude and spin by DOP853 on R alone: R' = R [J⁻¹ Rᵀ L]x with L fixed in space."""
    L, inverse = J @ w, np.linalg.inv(J)

    def slope(_, y):
        R = y.reshape(3, 3)
        return np.cross(R, inverse @ R.T @ L).ravel()

    R = solve_ivp(slope, (0.0, t), np.eye(3).ravel(), method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1].reshape(3, 3)
    return R, inverse @ R.T @ L


def bodies(rng, n):
    """Inertias of n bodies, from nearly flat to nearly slender, in any axes."""
    spread = rng.uniform(0.0, 1.0, (n, 3)) ** 3 + 1e-3
    moments = spread.sum(axis=1, keepdims=True) - spread
    Q = Rotation.random(n, rng=rng).as_matrix()
    J = Q @ (moments[:, :, None] * Q.swapaxes(1, 2))
    return 0.5 * (J + J.swapaxes(1, 2))


def drifts(J, w, h, steps):
    """Relative change of energy, and of angular momentum in space."""
    R, end = move(J, w, h, steps)
    L = J @ w
    return abs(end @ J @ end / (w @ L) - 1.0), np.linalg.norm(R @ J @ end - L) / np.linalg.norm(L)


def test_principal_moments_and_axes(rng):
    J = np.concatenate([bodies(rng, 20), BODY[None], np.eye(3)[None]])
    moments, axes = principal(J)
    # Orthogonal to the rounding of the entries; eigenvalues to a few ulps of the largest, which is below 3.
    assert np.abs(axes.swapaxes(1, 2) @ axes - np.eye(3)).max() < 4e-16
    assert np.abs(axes @ (moments[:, :, None] * axes.swapaxes(1, 2)) - J).max() < 1e-14
    assert np.linalg.det(axes) == pytest.approx(np.ones(len(J)), abs=1e-15)
    assert np.array_equal(moments[-2], BODY.diagonal())
    assert np.array_equal(axes[-2:], [np.eye(3)] * 2)


def test_sixth_order():
    fine, exact = move(BODY, TURN, 2.0 / 4000, 4000)[0], reference(BODY, TURN, 2.0)[0]
    # Round-off of 4000 steps, and the tolerance of DOP853 times the growth in 8 rad.
    assert np.abs(fine - exact).max() < 5e-13
    error = np.array([np.abs(move(BODY, TURN, 2.0 / n, n)[0] - fine).max() for n in (20, 40, 80)])
    # Measured 2.2e-8, 3.5e-10 and 5.5e-12: orders 6.00 and 6.00.
    assert error[0] < 4e-8
    assert np.log2(error[:-1] / error[1:]) == pytest.approx([6.0, 6.0], abs=0.1)


@pytest.mark.parametrize(("dt", "error"), [(0.05, 3e-11), (0.1, 2e-9), (0.2, 1e-7)])
def test_tumbling_box_in_half_steps(dt, error):
    """The box of the model `tumble` over its 10 s, two motions a step: 1.6e-11, 1e-9 and 6.4e-8 measured."""
    box = load("tumble")().free_bodies[0]
    w = np.array(box.angular_velocity)
    R, end = move(box.inertia, w, 0.5 * dt, round(20.0 / dt))
    exact, w_exact = reference(box.inertia, w, 10.0)
    assert max(np.abs(R - exact).max(), np.abs(end - w_exact).max()) < error


def test_random_bodies_against_dop853(rng):
    for J in bodies(rng, 12):
        w = rng.standard_normal(3)
        R, end = move(J, w, 0.02, 50)
        exact, w_exact = reference(J, w, 1.0)
        # 50 steps of less than 0.1 rad, 0.1^7 times a constant of 1e-5 each; measured 2e-12.
        assert np.abs(R - exact).max() < 5e-11
        assert np.abs(end - w_exact).max() < 5e-11


def test_flips_about_the_middle_axis_follow_jacobi():
    """Landau and Lifshitz, Mechanics, section 37, for L² > 2 E I₂."""
    I, w = BODY.diagonal(), np.array([0.01, 3.0, 0.02])
    twice, square = w @ (I * w), (I * w) @ (I * w)
    low, high = square - twice * I[0], twice * I[2] - square
    spin = np.sqrt([high / (I[0] * (I[2] - I[0])), high / (I[1] * (I[2] - I[1])), low / (I[2] * (I[2] - I[0]))])
    rate, m = np.sqrt((I[2] - I[1]) * low / I.prod()), (I[1] - I[0]) * high / ((I[2] - I[1]) * low)
    for t in (0.5, 2.0, 10.0):
        sn, cn, dn, _ = ellipj(rate * t, m)
        # 30 rad in parts of 0.03 rad; each flip enlarges round-off by 3.0 / 0.02.
        assert np.abs(move(BODY, spin * [1, 0, 1], 0.01, round(t / 0.01))[1] - spin * [cn, sn, dn]).max() < 1e-11


@pytest.mark.parametrize("h", [0.005, 0.05, 0.3])
def test_energy_and_angular_momentum_stay(rng, h):
    for J in bodies(rng, 8):
        # An ulp per step that never averages out would be 7e-13 in 3000 steps; L of a slender body loses another digit.
        assert max(drifts(J, 4.0 * rng.standard_normal(3), h, 3000)) < 1e-12
    # In principal axes round-off is all but random: 3000 steps keep the thirteenth digit.
    assert max(drifts(BODY, TURN, h, 3000)) < 1e-13


@pytest.mark.parametrize(
    ("moments", "w"),
    [
        ((1.0, 1.0 + 1e-12, 1.5), (1.0, 2.0, 3.0)),
        ((1.0, 1.0 + 1e-12, 1.0 - 1e-12), (1.0, 2.0, 3.0)),
        ((1.0, 1.0, 1e-8), (0.1, 0.2, 10.0)),
        ((1.0, 1.0 - 5e-9, 1e-8), (1.0, 1.0, 0.0)),
        ((1.0, 1.5, 2.5), (1.0, 2.0, 3.0)),
        ((1.0, 2.0, 2.7), (1e-12, 3.0, 0.0)),
    ],
    ids=["two alike", "almost a sphere", "needle", "flat needle", "flat", "middle axis"],
)
def test_invariants_of_extreme_bodies(moments, w):
    # Changes of a few ulps are rounded the same way at every step: up to an ulp, 2e-16, each.
    assert max(drifts(1e-3 * np.diag(moments), np.array(w), 0.01, 1000)) < 2e-13


@pytest.mark.parametrize("size", [1e4, 1e6, 1e15, 1e100])
def test_extreme_spin_is_finite_and_keeps_its_invariants(size):
    # At most 4096 parts, each rounded to an ulp at random.
    assert max(drifts(BODY, size * TURN, 0.01, 1)) < 64 * 1e-15


def test_needle_spins_about_itself_off_its_body_axes(rng):
    Q = Rotation.random(rng=rng).as_matrix()
    J = Q @ np.diag([1.0, 1.0 - 5e-7, 1e-6]) @ Q.T
    J = 0.5 * (J + J.T)
    # The spin along the needle is known to 1e-16 / J_min of its momentum: that error must not grow.
    assert max(drifts(J, Q @ [1e-3, 1e-3, 10.0], 0.01, 100)) < 1e-10
    assert max(drifts(J, Q @ [1e-3, 1e-3, 10.0], 0.01, 3000)) < 1e-10


def test_rest_changes_no_bit(rng):
    x, q = rng.standard_normal((3, 3)), Rotation.random(3, rng=rng).as_quat()
    moments, axes = principal(bodies(rng, 3))
    out = np.empty_like(x), np.empty_like(q), np.empty(18)
    flow(moments, axes, x, q, np.zeros(18), 0.01, *out)
    assert np.array_equal(out[0], x)
    assert np.array_equal(out[1], q)
    assert not out[2].any()


@pytest.mark.parametrize(("h", "size"), [(0.0, 1.0), (0.01, 1e-200)], ids=["no time", "no turn to speak of"])
def test_identity(rng, h, size):
    x, q, v = np.zeros((3, 3)), Rotation.random(3, rng=rng).as_quat(), size * rng.standard_normal(18)
    out = np.empty_like(x), np.empty_like(q), np.empty(18)
    flow(*principal(bodies(rng, 3)), x, q, v, h, *out)
    assert np.array_equal(out[2], v)
    # The quaternion is normalised anew.
    assert np.abs(out[1] - q).max() < 4e-16


@pytest.mark.parametrize("J", [np.diag([1.0, 1.0, 1.0]), BODY], ids=["sphere", "principal axis"])
def test_steady_spin_is_the_exponential(rng, J):
    w = np.array([0.0, -3.0, 0.0]) if J is BODY else rng.standard_normal(3)
    q = Rotation.random(rng=rng)
    for h in (1e-9, 0.01, 100.0):
        R, end = move(J, w, h, 1, q.as_quat())
        assert np.array_equal(end, w)
        # Rounding of the angle, 300 rad at most.
        assert np.abs(R - (q * Rotation.from_rotvec(h * w)).as_matrix()).max() < 1e-13


def test_steady_spin_agrees_with_collocation():
    # Moments that differ by 1e-11, a spin that is off its axis by 1e-12: not taken for steady, and 1e-10 from it.
    near = np.diag([1.0, 1.0 + 1e-11, 1.0 - 1e-11])
    assert np.abs(move(near, TURN, 0.005, 400)[0] - move(np.eye(3), TURN, 0.005, 400)[0]).max() < 1e-10
    R, end = move(BODY, [1e-12, 1e-12, 4.0], 0.005, 400)
    assert not np.array_equal(end, [1e-12, 1e-12, 4.0])
    assert np.abs(R - move(BODY, [0.0, 0.0, 4.0], 0.005, 400)[0]).max() < 1e-11


def test_symmetric_top_precesses_in_closed_form(rng):
    I, I3, t = 1.0, 1.6, 1.0
    w = rng.standard_normal(3)
    R, end = move(np.diag([I, I, I3]), w, 0.01, 100)
    # R = exp([t L/I]x) exp([t (1 - I₃/I) ω₃ e₃]x); 100 steps of about 0.02 rad leave round-off.
    spin = Rotation.from_rotvec([0.0, 0.0, t * (1.0 - I3 / I) * w[2]])
    exact = Rotation.from_rotvec(t * w * [1.0, 1.0, I3 / I]) * spin
    assert np.abs(R - exact.as_matrix()).max() < 1e-13
    assert np.abs(end - spin.inv().apply(w)).max() < 1e-13


def test_reversed_motion_returns(rng):
    for J in bodies(rng, 8):
        w, q = rng.standard_normal(3), Rotation.random(rng=rng).as_quat()
        x, q1, v = np.zeros((1, 3)), q[None].copy(), np.r_[1.0, 2.0, 3.0, w]
        moments, axes = principal(J[None])
        flow(moments, axes, x, q1, v, 0.02, x, q1, v)
        v *= -1.0
        flow(moments, axes, x, q1, v, 0.02, x, q1, v)
        assert np.abs(x).max() < 1e-17
        # The collocation is symmetric: round-off is left, as long as the angle is counted about the same axis.
        assert np.abs(q1[0] - q).max() < 2e-15
        assert np.abs(v[3:] + w).max() < 2e-15


def test_two_halves_make_a_whole_to_seventh_order():
    gap = [np.abs(move(BODY, TURN, h, 1)[0] - move(BODY, TURN, 0.5 * h, 2)[0]).max() for h in (0.06, 0.03)]
    # The error of one step of sixth order: 2^7 from 0.24 rad to half of it.
    assert gap[0] < 1e-10
    assert np.log2(gap[0] / gap[1]) == pytest.approx(7.0, abs=0.3)


def test_long_steps_are_cut():
    # 40 rad at once against 400 steps of 0.1 rad: 80 parts with an error of 1e-9 each, which grows with time.
    assert np.abs(move(BODY, TURN, 10.0)[0] - move(BODY, TURN, 0.025, 400)[0]).max() < 2e-6


def test_bodies_move_on_their_own_and_in_place(rng):
    n, h = 5, 0.03
    J = bodies(rng, n)
    J[1], J[2] = np.eye(3), BODY
    x, q, v = rng.standard_normal((n, 3)), Rotation.random(n, rng=rng).as_quat(), rng.standard_normal(6 * n + 2)
    v[3:6] = 0.0
    moments, axes = principal(J)
    out = np.empty_like(x), np.empty_like(q), np.full(6 * n + 2, 7.0)
    flow(moments, axes, x, q, v, h, *out)
    assert np.array_equal(out[2][6 * n :], [7.0, 7.0])
    assert np.array_equal(out[2][: 6 * n].reshape(n, 6)[:, :3], v[: 6 * n].reshape(n, 6)[:, :3])
    assert out[0] == pytest.approx(x + h * v[: 6 * n].reshape(n, 6)[:, :3], abs=1e-15)
    assert np.linalg.norm(out[1], axis=1) == pytest.approx(np.ones(n), abs=4e-16)
    for b in range(n):
        R, w = move(J[b], v[6 * b + 3 : 6 * b + 6], h, 1, q[b])
        assert np.array_equal(R, Rotation.from_quat(out[1][b]).as_matrix())
        assert np.array_equal(w, out[2][6 * b + 3 : 6 * b + 6])
    flow(moments, axes, x, q, v, h, x, q, v)
    assert np.array_equal(x, out[0])
    assert np.array_equal(q, out[1])
    assert np.array_equal(v[: 6 * n], out[2][: 6 * n])
