"""Spinning bodies: Euler's disk, tippe-top, rattleback, the intermediate axis, the heavy top on its support."""

import math
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import nsdyn as nd

g = 9.81
up = np.array([0.0, 0.0, 1.0])


def rotations(body):
    return np.array([pin.Quaternion(q).toRotationMatrix() for q in body.quaternion])


def total_energy(trajectory):
    return trajectory.energy.kinetic + trajectory.energy.potential


# -- case 25: Euler's disk ---------------------------------------------------------------------------------------------


def disk(dt, tilt=30.0, duration=0.25):
    """(tilt in degrees, energy in J) over the steady motion of Euler's disk."""
    trajectory = nd.simulate(nd.scenes.load("euler_disk")(tilt=tilt), duration, dt=dt)
    return np.degrees(np.arccos(rotations(trajectory.body("disk"))[:, 2, 2])), total_energy(trajectory)


@pytest.mark.case(25)
@pytest.mark.parametrize("tilt", [20.0, 45.0])
def test_disk_starts_in_its_steady_motion(tilt):
    """A thin one has W² sin(tilt) = 4 g/a and the energy 3/2 m g a sin(tilt)."""
    a, m, s = 0.3, 1.0, math.sin(math.radians(tilt))
    scene = nd.scenes.load("euler_disk")(tilt=tilt, radius=a, thickness=1e-7, mass=m)
    body = scene.bodies["disk"]
    spin = math.sqrt(4 * g / a * s)  # W sin(tilt), about the line to the contact
    assert np.linalg.norm(body.angular_velocity) == pytest.approx(spin, rel=1e-6)
    w = rotations(nd.simulate(scene, 1e-6, dt=1e-6).body("disk"))[0].T @ body.angular_velocity
    energy = 0.5 * w @ body.inertia @ w + m * g * body.position[2]
    assert energy == pytest.approx(1.5 * m * g * a * s, rel=1e-6)


@pytest.mark.case(25)
def test_disk_loses_only_what_the_step_takes():
    """No term of the model dissipates, nor does the scheme: its energy stays, and the fall of the tilt vanishes."""
    fall, loss = [], []
    for dt in (5e-4, 2.5e-4, 1.25e-4):
        tilt, energy = disk(dt)
        assert np.diff(energy).max() <= 1e-6 * energy[0], "energy does not grow"
        fall.append(30.0 - tilt[-1])
        loss.append(1.0 - energy[-1] / energy[0])
    assert np.abs(loss).max() <= 1e-12
    # At least first order.
    assert fall[2] <= 0.55 * fall[1]


@pytest.mark.case(25)
@pytest.mark.parametrize("tilt", [3.0, 0.3])
def test_disk_that_lies_almost_flat_loses_nothing(tilt):
    """Its contact runs round the rim 20 and 200 times as fast as any point of it moves, and rolls all the same."""
    tilts, energy = disk(2.5e-4, tilt, 0.1)
    flat = 0.44 * g * 0.0032
    assert np.abs(energy - energy[0]).max() <= 1e-9 * (energy[0] - flat)
    assert np.abs(tilts - tilt).max() <= 1e-3 * tilt


@pytest.mark.case(25)
@pytest.mark.parametrize("tilt", [-1.0, 0.0, 81.0, 95.0, math.nan])
def test_disk_without_a_steady_motion_is_refused(tilt):
    with pytest.raises(ValueError, match=r"tilt must lie between 0 and 80\.\d+ degrees, .* got "):
        nd.scenes.load("euler_disk")(tilt=tilt)


# -- case 26: tippe-top ------------------------------------------------------------------------------------------------

TOP = {"radius": 0.15, "mass": 15.0}
"""Ten times as large as the toy: h = 1e-3 is then a small part of a turn."""


class TippeTop:
    """A run of the tippe-top and its energy landscape at fixed Jellett's integral.

    With `glide` [N s/m] the contact is smooth and a viscous force -glide v acts at it instead of Coulomb's: it never
    sticks, so that every state but the least energy loses some. A ball that rolls under Coulomb's law loses nothing.
    """

    def __init__(self, spin, tilt, duration, dt=1e-3, glide=None):
        scene = nd.scenes.load("tippe_top")(spin=spin, tilt=tilt, mu=0.05 if glide is None else 0.0, **TOP)
        body = scene.bodies["top"]
        self.R, self.d, self.m = TOP["radius"], float(np.linalg.norm(body.com)), body.mass
        self.I1, self.I3 = body.inertia[0, 0], body.inertia[2, 2]

        def force(t, q, v):
            R = pin.Quaternion(q[3:7]).toRotationMatrix()
            arm = self.d * R[:, 2] - self.R * up
            slip = R @ v[:3] + np.cross(R @ v[3:], arm)
            f = -glide * (slip - slip[2] * up)
            return {"top": (f, np.cross(arm, f))}

        self.trajectory = nd.simulate(scene, duration, dt=dt, external_force=None if glide is None else force)
        b = self.trajectory.body("top")
        axis = rotations(b)[:, :, 2]
        w = b.angular_velocity
        L = self.I1 * w + (self.I3 - self.I1) * (w * axis).sum(axis=1)[:, None] * axis
        self.jellett = -(L * (self.d * axis - self.R * up)).sum(axis=1)
        self.drift = np.abs(self.jellett / self.jellett[0] - 1).max()
        self.cosine = axis[:, 2]
        self.energy = total_energy(self.trajectory) - self.m * g * self.R

    def least_energy(self, cosine):
        D = self.I1 * self.R**2 * (1 - cosine**2) + self.I3 * (self.d - self.R * cosine) ** 2
        return self.jellett[0] ** 2 / (2 * D) - self.m * g * self.d * cosine


def critical_spins():
    """Spins [rad/s] above which standing upright is no minimum of the energy, and standing on the head is one."""
    top = nd.scenes.load("tippe_top")(**TOP).bodies["top"]
    R, d, m, I1, I3 = TOP["radius"], -top.com[2], top.mass, top.inertia[0, 0], top.inertia[2, 2]
    upright = math.sqrt(m * g * d * (R - d) ** 2 / (R * (I1 * R - I3 * (R - d))))
    head = math.sqrt(m * g * d * (R + d) ** 4 / (R * (I3 * (R + d) - I1 * R))) / (R - d)
    return upright, head


@pytest.mark.case(26)
def test_critical_spins_of_the_tippe_top():
    """The formulas against the energy landscape, from both sides."""
    upright, head = critical_spins()
    for spin, cosine, minimum in (
        (upright * 0.999, 1.0, True),
        (upright * 1.001, 1.0, False),
        (head * 0.999, -1.0, False),
        (head * 1.001, -1.0, True),
    ):
        top = TippeTop(spin, 0.0, 1e-3)
        inside = top.least_energy(cosine * (1 - 1e-6))
        assert (inside > top.least_energy(cosine)) == minimum


@pytest.mark.slow
@pytest.mark.case(26)
@pytest.mark.parametrize("factor", [0.9, 1.15])
def test_tippe_top_leaves_the_upright_above_its_critical_spin(factor):
    top = TippeTop(factor * critical_spins()[0], 5.0, 8.0, dt=4e-3, glide=50.0)
    tilt = np.degrees(np.arccos(top.cosine))
    # Means over many nutations, the first once the sliding of the start is over.
    assert (tilt[-500:].mean() > 1.2 * tilt[500:1000].mean()) == (factor > 1.0)
    assert (tilt[-500:].mean() < 0.8 * tilt[500:1000].mean()) == (factor < 1.0)
    assert top.drift <= 1e-4
    assert np.diff(top.energy).max() <= 1e-7 * top.energy[0]


@pytest.mark.slow
@pytest.mark.case(26)
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_tippe_top_turns_over_above_its_critical_spin(factor):
    """It ends where its energy is least: on its head, or leaning if it was too slow for that."""
    top = TippeTop(factor * critical_spins()[1], 10.0, 8.0, dt=4e-3, glide=50.0)
    cosines = np.linspace(-1, 1, 20001)
    end = math.degrees(math.acos(cosines[top.least_energy(cosines).argmin()]))
    assert (end == 180.0) == (factor > 1.0)
    assert math.degrees(math.acos(top.cosine[-1])) == pytest.approx(end, abs=5.0)
    assert np.diff(top.energy).max() <= 1e-7 * top.energy[0]


@pytest.mark.case(26)
def test_jellett_integral_under_coulomb_friction():
    """Conserved while the ball slides on its rim, whatever the friction: -L·r has no torque. First order at least."""
    drifts = [TippeTop(2.5 * critical_spins()[1], 60.0, 0.5, dt=dt).drift for dt in (1e-3, 5e-4)]
    assert drifts[1] <= 0.52 * drifts[0]


# -- case 27: rattleback -----------------------------------------------------------------------------------------------


@cache
def rolling_ellipsoid():
    """R and ω of the rattleback as functions of time up to 1.2 s: rolling without sliding on z = 0.

    With n = Rᵀe_z, the contact r(n) = -A² n/√(nᵀA²n) - c from the centre of mass and v = r × ω (body axes),

        J ω' + ω × Jω = r × m (v' + ω × v + g n),   v' = r' × ω + r × ω'.
    """
    body = nd.scenes.load("rattleback")().bodies["rattleback"]
    A2, J, m = np.diag(np.square((0.2, 0.03, 0.02))), body.inertia, body.mass

    def rate(t, y):
        R, w = y[:9].reshape(3, 3), y[9:]
        n = R[2]
        dn = np.cross(n, w)
        d = math.sqrt(n @ A2 @ n)
        r = -A2 @ n / d - body.com
        dr = -A2 @ dn / d + A2 @ n * (n @ A2 @ dn) / d**3
        load = m * np.cross(r, np.cross(dr, w) + np.cross(w, np.cross(r, w)) + g * n) - np.cross(w, J @ w)
        return np.concatenate(((R @ pin.skew(w)).ravel(), np.linalg.solve(J - m * pin.skew(r) @ pin.skew(r), load)))

    R0 = pin.Quaternion(body.quaternion).toRotationMatrix()
    y0 = np.concatenate((R0.ravel(), R0.T @ body.angular_velocity))
    return solve_ivp(rate, (0, 1.2), y0, method="DOP853", rtol=1e-10, atol=1e-11, dense_output=True).sol


def rattle(dt, duration, **parameters):
    """Times and spin about the vertical of a rattleback, with its energy."""
    scene = nd.scenes.load("rattleback")(**parameters)
    trajectory = nd.simulate(scene, duration, dt=dt)
    statuses = {int(s) for k in range(1, len(trajectory.t), 10) for s in trajectory.contacts(k).status}
    assert statuses == {1}, "it rolls: always in contact, never sliding"
    return trajectory.t, trajectory.body("rattleback").angular_velocity[:, 2], total_energy(trajectory)


@pytest.mark.slow
@pytest.mark.case(27)
def test_rattleback_turns_back_from_the_wrong_sense_only():
    t, spin, energy = rattle(1e-3, 1.2)
    assert np.diff(energy).max() <= 1e-5 * energy[0]
    expected = np.array([up @ y[:9].reshape(3, 3) @ y[9:] for y in rolling_ellipsoid()(t).T])
    turns, should = (t[np.flatnonzero(s > 0)[0]] for s in (spin, expected))
    assert turns == pytest.approx(should, rel=0.1)
    # In the sense it likes it goes on.
    _, spin, _ = rattle(1e-3, 1.2, spin=5.0)
    assert spin.min() > 3.0


@pytest.mark.case(27)
def test_rattleback_mirrored():
    """The mirrored body spun the other way does the mirrored motion."""
    _, spin, _ = rattle(1e-3, 0.3)
    _, mirrored, _ = rattle(1e-3, 0.3, spin=5.0, skew=1e-4, tilt=-5.0)
    assert np.abs(spin + mirrored).max() <= 1e-9


@pytest.mark.slow
@pytest.mark.case(27)
def test_rattleback_converges_to_rolling():
    """Spin against the equations of rolling without sliding: second order; its energy stays."""
    errors, losses = [], []
    reference = rolling_ellipsoid()(0.4)
    for dt in (5e-4, 2.5e-4):
        _, spin, energy = rattle(dt, 0.4)
        errors.append(abs(spin[-1] - up @ reference[:9].reshape(3, 3) @ reference[9:]))
        losses.append(1 - energy[-1] / energy[0])
    assert errors[1] <= 0.26 * errors[0] and errors[1] <= 1.2e-3
    assert np.abs(losses).max() <= 1e-9


# -- cases 28 and 29: torque-free body, heavy top ----------------------------------------------------------------------


@pytest.mark.case(28)
@pytest.mark.parametrize("dt", [1e-1, *(pytest.param(dt, marks=pytest.mark.slow) for dt in (4e-2, 1e-2))])
def test_intermediate_axis_keeps_energy_and_momentum(dt):
    """J = (1, 2, 3), ω = (.01, 1, .01): ‖L‖² = 4.001, 2 E = 2.0004, whatever the step; it tumbles."""
    J = np.array([1.0, 2.0, 3.0])
    body = nd.simulate(nd.scenes.load("intermediate_axis")(), 80.0, dt=dt).body("body")
    R = rotations(body)
    w = np.einsum("kji,kj->ki", R, body.angular_velocity)
    L = np.einsum("kij,kj->ki", R, w * J)
    # Both are kept by the scheme; 8000 steps of round-off.
    np.testing.assert_allclose((w**2 * J).sum(axis=1), 2.0004, rtol=1e-12)
    np.testing.assert_allclose((L**2).sum(axis=1), 4.001, rtol=1e-12)
    assert np.abs(L - L[0]).max() <= 1e-12 and w[:, 1].min() < -0.99


@pytest.mark.case(28)
@pytest.mark.parametrize(("steps", "bar"), [(100, 2e-11), (400, 5e-13)])
def test_intermediate_axis_has_its_period(steps, bar):
    """4 K(k)/λ with k² = 0.99980006, to sixth order and down to round-off."""
    # Landau & Lifshitz, Mechanics, §37, for L² > 2E J2, with 2E = T2, L² = L2.
    J, T2, L2 = np.array([1.0, 2.0, 3.0]), 2.0004, 4.001
    m = (J[1] - J[0]) * (J[2] * T2 - L2) / ((J[2] - J[1]) * (L2 - J[0] * T2))
    rate = math.sqrt((J[2] - J[1]) * (L2 - J[0] * T2) / J.prod())
    period = 4 * ellipk(m) / rate
    assert m == pytest.approx(0.99980006, abs=1e-8) and period == pytest.approx(39.105734, abs=1e-6)
    end = nd.simulate(nd.scenes.load("intermediate_axis")(), period, dt=period / steps).v[-1, 3:]
    np.testing.assert_allclose(end, (0.01, 1.0, 0.01), rtol=0, atol=bar)


@pytest.mark.slow
@pytest.mark.case(29)
def test_heavy_top_is_fourth_order():
    """Brüls, Cardona and Arnold's top after 2 s against the equations of Euler."""
    m, X, J = 15.0, np.array([0.0, 1.0, 0.0]), np.diag([15.234375, 0.46875, 15.234375])

    def rate(t, y):
        R, w = y[:9].reshape(3, 3), y[9:]
        torque = np.cross(X, -m * g * R[2]) - np.cross(w, J @ w)
        return np.concatenate(((R @ pin.skew(w)).ravel(), np.linalg.solve(J, torque)))

    y0 = np.concatenate((np.eye(3).ravel(), (0.0, 150.0, -4.61538)))
    exact = solve_ivp(rate, (0, 2.0), y0, method="DOP853", rtol=1e-12, atol=1e-12).y[:9, -1].reshape(3, 3) @ X
    scene = nd.scenes.load("heavy_top")()
    model = scene.articulations["top"].model
    data, errors = model.createData(), []
    for dt in (8e-3, 4e-3):
        trajectory = nd.simulate(scene, 2.0, dt=dt)
        pin.forwardKinematics(model, data, trajectory.q[-1])
        errors.append(np.linalg.norm(data.oMi[3].rotation @ X - exact))
    # Each step is done in parts of 0.1 rad, a dozen and half of them here.
    assert errors[1] <= 1e-9
