"""Catalogue of hard and analytic cases: sliding, rolling, spinning."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

import nsdyn as nd

g = 9.81

EXACT = nd.solvers.Auto(tol=2e-14)
"""For thresholds at 1e-9 and forces at 1e-11: the default, 1e-8 m/s a step, is more than what they are about."""


def downhill(angle, heading=0.0):
    a, h = math.radians(angle), math.radians(heading)
    return np.array([math.cos(a) * math.cos(h), math.cos(a) * math.sin(h), -math.sin(a)])


@pytest.mark.case(1)
def test_block_on_an_incline_does_not_creep():
    """Case 1: v = 0 and r_T/r_N = tan(alpha), for 20 s and at every step length."""
    for dt, duration in ((1e-3, 1.0), (1e-1, 20.0)):
        trajectory = nd.simulate(nd.scenes.load("incline")(angle=20.0, mu=0.37), duration, dt=dt)
        # Round-off of forces of 1 N over 1 kg, times the step.
        assert np.abs(trajectory.v).max() <= 1e-12
        impulse = trajectory.contacts(-1).impulse.sum(axis=0)
        assert abs(math.hypot(*impulse[1:]) / impulse[0] - math.tan(math.radians(20.0))) <= 1e-12
        # Below gravity's own work no joule goes anywhere.
        assert abs(trajectory.energy.friction.sum()) <= 1e-12


@pytest.mark.case(2)
def test_sliding_is_exact_at_every_step():
    """Case 2: with theta = 1/2 a constant acceleration g (sin - mu cos) gives x = a t²/2 exactly."""
    angle, mu = 30.0, 0.3
    a = math.radians(angle)
    acceleration = g * (math.sin(a) - mu * math.cos(a))
    for dt in (1e-1, 1e-2):
        trajectory = nd.simulate(nd.scenes.load("incline")(angle=angle, mu=mu), 2.0, dt=dt)
        position = trajectory.body("box").position
        x = (position - position[0]) @ downhill(angle)
        # Of a path of 4.7 m.
        assert np.abs(x - 0.5 * acceleration * trajectory.t**2).max() <= 1e-11


@pytest.mark.case(2)
@pytest.mark.parametrize("angle", [5.0, 20.0, 40.0])
@pytest.mark.parametrize(("excess", "slides"), [(1e-9, False), (-1e-9, True)])
def test_threshold_of_sliding_from_both_sides(angle, excess, slides):
    """Case 2: mu = tan(alpha) (1 ± 1e-9) decides."""
    mu = math.tan(math.radians(angle)) * (1 + excess)
    trajectory = nd.simulate(nd.scenes.load("incline")(angle=angle, mu=mu), 1.0, dt=1e-2, solver=EXACT)
    v = trajectory.body("box").linear_velocity[-1] @ downhill(angle)
    expected = 1e-9 * g * math.sin(math.radians(angle)) if slides else 0.0
    # A hundred steps at the solver's tolerance, on redundant contacts; what the deficit adds is 8.5e-10 and more.
    assert abs(v - expected) <= 2e-11


@pytest.mark.case(3)
def test_acceleration_is_the_same_in_every_direction():
    """Case 3: gravity turned through 360 degrees in the plane of contact, the block's and the contacts' axes fixed."""
    angle, mu = 25.0, 0.2
    a = math.radians(angle)
    expected = g * (math.sin(a) - mu * math.cos(a))
    worst = 0.0
    for heading in range(0, 360, 15):
        scene = nd.scenes.load("incline")(angle=angle, mu=mu, heading=float(heading))
        trajectory = nd.simulate(scene, 0.5, dt=1e-2)
        acceleration = trajectory.body("box").linear_velocity[-1] / trajectory.t[-1]
        worst = max(worst, np.abs(acceleration - expected * downhill(angle, heading)).max())
    # m/s², size and direction together; a four-sided pyramid errs by up to 0.7 here.
    assert worst <= 1e-11


@pytest.mark.case(3)
def test_threshold_is_the_same_in_every_direction():
    """Case 3: tan(alpha) (1 ± 1e-9) decides whatever the angle between gravity and the tangents."""
    for heading in (15.0, 45.0, 110.0, 225.0):
        for excess, expected in ((1e-9, 0.0), (-1e-9, 1e-9 * g * math.sin(math.radians(25.0)))):
            mu = math.tan(math.radians(25.0)) * (1 + excess)
            scene = nd.scenes.load("incline")(angle=25.0, mu=mu, heading=heading)
            trajectory = nd.simulate(scene, 0.5, dt=1e-2, solver=EXACT)
            v = trajectory.body("box").linear_velocity[-1]
            assert np.abs(v - 0.5 * expected * downhill(25.0, heading)).max() <= 2e-11  # as above


@pytest.mark.case(4)
@pytest.mark.parametrize("v0", [2.0, 2.05])
@pytest.mark.parametrize("dt", [1e-1, 1e-2, 3e-3, 1e-3])
def test_block_stops(dt, v0):
    """Case 4: friction is mu m g in every sliding step, the block stops at v0²/(2 mu g) whatever the dt, for good."""
    mu = 0.5
    trajectory = nd.simulate(nd.scenes.load("slide")(mu=mu, speed=v0), 0.6, dt=dt, solver=EXACT)
    v = trajectory.body("box").linear_velocity[:, 0]
    sliding = math.floor(v0 / (mu * g * dt))
    for k in range(1, sliding + 1):
        impulse = trajectory.contacts(k).impulse.sum(axis=0)
        assert abs(impulse[0] / dt - g) <= 1e-11 and abs(math.hypot(*impulse[1:]) / dt - mu * g) <= 1e-11
    assert abs(v[sliding] - (v0 - mu * g * sliding * dt)) <= 1e-12
    # At rest in the next step, never backwards.
    assert np.abs(v[sliding + 1 :]).max() <= 1e-14 and v.min() >= -1e-14
    x = trajectory.body("box").position[-1, 0]
    # The time of the stop is found from velocities solved to 1e-12, and the place is flat there.
    assert abs(x - v0**2 / (2 * mu * g)) <= 1e-11


def invariant_error(dt):
    v0, angle = 2.0, 20.0
    scene = nd.scenes.load("incline")(angle=angle, mu=math.tan(math.radians(angle)), across=v0)
    trajectory = nd.simulate(scene, 3.0, dt=dt)
    v = trajectory.body("box").linear_velocity
    invariant = np.linalg.norm(v, axis=1) + v @ downhill(angle)
    return np.abs(invariant / v0 - 1).max(), np.linalg.norm(v[-1] / v0 - 0.5 * downhill(angle))


@pytest.mark.case(5)
def test_sideways_on_the_critical_slope():
    """Case 5: at mu = tan(alpha) speed + downhill speed stays v0, so the block turns downhill and ends at v0/2."""
    coarse, fine = invariant_error(4e-3), invariant_error(1e-3)
    assert fine[0] <= 1e-3 and fine[1] <= 1e-3
    assert 14 <= coarse[0] / fine[0] <= 18  # second order: friction opposes the slip of the middle of the step


K = {"ball": 2 / 5, "cylinder": 1 / 2, "hoop": 1.0}


@pytest.mark.case(11)
@pytest.mark.parametrize("shape", K)
def test_rolling_down(shape):
    """Case 11: a = g sin(alpha)/(1 + k), exactly at every step, without slip and without work of friction."""
    angle, k = 30.0, K[shape]
    trajectory = nd.simulate(nd.scenes.load("roll_down")(shape=shape, angle=angle, mu=0.6), 1.0, dt=1e-2)
    body = trajectory.body("body")
    x = (body.position - body.position[0]) @ downhill(angle)
    a = g * math.sin(math.radians(angle)) / (1 + k)
    assert np.abs(x - 0.5 * a * trajectory.t**2).max() <= 1e-11
    assert np.abs(body.angular_velocity[:, 1] * 0.1 - a * trajectory.t).max() <= 1e-11
    assert np.abs(trajectory.energy.friction).max() <= 1e-13


@pytest.mark.case(11)
@pytest.mark.parametrize("shape", K)
@pytest.mark.parametrize(("excess", "slips"), [(1e-9, False), (-1e-9, True)])
def test_threshold_of_rolling(shape, excess, slips):
    """Case 11: rolls iff mu >= k/(1 + k) tan(alpha): 2/7, 1/3 and 1/2, ± 1e-9."""
    angle, k = math.radians(30.0), K[shape]
    mu = k / (1 + k) * math.tan(angle) * (1 + excess)
    # Where it turns by 0.2 rad a step, dt = 1e-2, points that come down beside its line of contact are foreseen; pushed
    # sideways against each other, the contacts then hold with a slip of 1e-10 m/s that the solver takes for none.
    trajectory = nd.simulate(nd.scenes.load("roll_down")(shape=shape, angle=30.0, mu=mu), 1.0, dt=5e-3, solver=EXACT)
    body = trajectory.body("body")
    slip = body.linear_velocity[-1] @ downhill(30.0) - 0.1 * body.angular_velocity[-1, 1]
    # Friction short by 1e-9 mu m g cos: v grows by that over m, r w falls short by it over k m.
    expected = 1e-9 * mu * g * math.cos(angle) * (1 + 1 / k) if slips else 0.0
    # As for sliding; the deficit adds 4.9e-9 and more.
    assert abs(slip - expected) <= 2e-11


@pytest.mark.case(12)
@pytest.mark.parametrize("mu", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("spin", [0.0, -30.0, 50.0])
def test_bowling(mu, spin):
    """Case 12: whatever mu, v = (5 v0 + 2 r w0)/7 in the end and (m/7) (v0 - r w0)² is lost."""
    v0, r = 2.0, 0.1
    trajectory = nd.simulate(nd.scenes.load("roll")(speed=v0, spin=spin, mu=mu), 3.0, dt=1e-2)
    ball = trajectory.body("ball")
    v = (5 * v0 + 2 * r * spin) / 7
    assert abs(ball.linear_velocity[-1, 0] - v) <= 1e-12
    assert abs(ball.angular_velocity[-1, 1] - v / r) <= 1e-11
    kinetic = trajectory.energy.kinetic
    assert abs(kinetic[0] - kinetic[-1] - (v0 - r * spin) ** 2 / 7) <= 1e-12
    # It grips in the step in which 2 |v0 - r w0|/(7 mu g) falls.
    onset = 2 * abs(v0 - r * spin) / (7 * mu * g)
    slip = np.abs(ball.linear_velocity[:, 0] - r * ball.angular_velocity[:, 1])
    assert np.flatnonzero(slip > 1e-12)[-1] == math.floor(onset / 1e-2)
    x = 0.5 * (v0 + v) * onset + v * (3.0 - onset)
    assert abs(ball.position[-1, 0] - x) <= 1e-10  # in 3 s at speeds solved to 1e-12 and better


def swing(t, x0, mu, stiffness):
    """x(t) of the block let go at x0 > 0: half waves about ± mu g m/k, each shorter by 2 mu m g/k."""
    omega, shift = math.sqrt(stiffness), mu * g / stiffness
    half = math.floor(t * omega / math.pi)
    amplitude = x0
    for k in range(half):
        if amplitude <= shift:
            return amplitude * (-1) ** k
        amplitude -= 2 * shift
    if amplitude <= shift:
        return (-1) ** half * amplitude
    phase = t * omega - half * math.pi
    return (-1) ** half * ((amplitude - shift) * math.cos(phase) + shift)


def oscillation(dt, x0=0.35, mu=0.3, stiffness=100.0):
    """Positions of the oscillator, exact positions, turning points, m."""
    model = nd.scenes.module("oscillator")
    spring = model.spring(stiffness)
    trajectory = nd.simulate(model.scene(start=x0, mu=mu), model.DURATION, dt=dt, external_force=spring)
    x = trajectory.body("block").position[:, 0]
    v = trajectory.body("block").linear_velocity[:, 0]
    v = np.where(np.abs(v) > 1e-9, v, 0.0)  # what the solver leaves of rest
    turns = np.flatnonzero((v[1:-1] != 0.0) & (v[1:-1] * v[2:] <= 0.0)) + 1
    exact = np.array([swing(t, x0, mu, stiffness) for t in trajectory.t])
    return x, exact, x[turns]


@pytest.mark.slow
@pytest.mark.case(21)
@pytest.mark.parametrize("h", [2e-3, 1e-3, 2.5e-4])
def test_coulomb_oscillator(h):
    """Case 21: the amplitude falls by 4 mu m g/k per cycle, and the block stays where |x| <= mu m g/k.

    The exact piecewise motion at every time, to second order: 6.7 m/s² h². The spring is a callback.
    """
    fall = 2 * 0.3 * g / 100.0  # per half cycle
    x, exact, turns = oscillation(h)
    # 0.35 m is six half cycles, the last of which ends where friction wins.
    amplitudes = [(-1) ** k * (0.35 - k * fall) for k in range(1, 7)]
    assert 0.35 - 5 * fall > fall / 2 >= abs(amplitudes[-1])
    assert np.abs(x - exact).max() <= 7.0 * h * h
    np.testing.assert_allclose(turns, amplitudes, rtol=0, atol=5e-6)
    assert np.ptp(x[-round(0.1 / h) :]) <= 1e-12


@pytest.mark.slow
@pytest.mark.case(22)
@pytest.mark.parametrize("duration", [2.4, 7.5])
def test_stick_and_slip_on_a_belt(duration):
    """Case 22: carried to x = mu m g/k, then round it with amplitude v_b/omega, grazing the belt's speed, undamped."""
    mu, stiffness, belt = 0.3, 100.0, 0.5
    model = nd.scenes.module("oscillator")
    omega, rest = math.sqrt(stiffness), mu * g / stiffness
    trajectory = nd.simulate(
        model.scene(start=0.0, mu=mu), duration, dt=1e-3, external_force=model.spring(stiffness, belt)
    )
    block = trajectory.body("block")
    x = block.position[:, 0] + belt * trajectory.t  # stretch of the spring
    v = block.linear_velocity[:, 0] + belt  # as seen from the ground
    sticking = trajectory.t <= rest / belt - 1e-3
    assert np.abs(block.linear_velocity[sticking]).max() <= 1e-12
    cycles = [
        (trajectory.t > t) & (trajectory.t <= t + 2 * math.pi / omega) for t in np.arange(1.0, duration - 0.7, 0.6)
    ]
    for cycle in cycles:
        assert abs(np.ptp(x[cycle]) / 2 - belt / omega) <= 1e-4
        assert abs(v[cycle].max() - belt) <= 1e-4
    centre = np.mean([x[c].max() + x[c].min() for c in cycles]) / 2
    assert abs(centre - rest) <= 1e-4


def disk_friction(ratio):
    """(force/(mu m g), torque/(mu m g R)) of a disk under uniform pressure at v/(R w) = ratio < 1."""
    m = ratio**2
    E, K = ellipe(m), ellipk(m)
    force = 4 / (3 * math.pi) * ((m + 1) * E + (m - 1) * K) / ratio
    return force, 4 / (9 * math.pi) * ((4 - 2 * m) * E + (m - 1) * K)


def fixed_point():
    """Ratio at which dv/v = dw/w: m R² F = J T/ratio with J = m R²/2."""
    return brentq(lambda ratio: disk_friction(ratio)[0] - 2 * ratio * disk_friction(ratio)[1], 0.5, 0.8, xtol=1e-14)


def ratios(trajectory, radius=0.1):
    """V/(R w) of every step until the disk stops; it stops altogether or not at all."""
    v, w = np.linalg.norm(trajectory.v[:, :2], axis=1), np.abs(trajectory.v[:, 2])
    stopped = v <= 1e-9
    assert stopped[-1] and (stopped == (radius * w <= 1e-9)).all()
    return v[~stopped] / (radius * w[~stopped])


@pytest.mark.case(23)
@pytest.mark.slow  # 192 pads, and Pinocchio needs 800 MB for as many joints
def test_spinning_disk_has_its_fixed_point():
    """Case 23: from 1 % above and below, v/(R w) of a solid disk closes in on 0.65300; v and w end together."""
    target = fixed_point()
    for side in (0.99, 1.01):
        scene = nd.scenes.load("spinning_disk")(speed=target * side, spin=10.0, rings=8)
        ratio = ratios(nd.simulate(scene, 0.3, dt=5e-3))
        # Without the step that ends at rest in the next one: the two stand for the whole stop, and leave no ratio.
        assert np.abs(ratio[:-1] / target - 1).max() <= 0.01 + 1e-9
        assert abs(ratio[-2] / target - 1) <= 0.007


@pytest.mark.case(23)
@pytest.mark.parametrize(("speed", "spin"), [pytest.param(1.0, 5.0, marks=pytest.mark.slow), (0.4, 10.0)])
def test_spinning_disk_and_ring_tend_to_their_ratios(speed, spin):
    """Case 23: from afar, v/(R w) comes closer all the time to 0.653 for a solid disk and to 1 for a ring."""
    target = fixed_point()
    assert target == pytest.approx(0.6530018, abs=1e-7)
    for solid, limit, close in ((True, target, 0.4), (False, 1.0, 0.05)):
        scene = nd.scenes.load("spinning_disk")(speed=speed, spin=spin, solid=solid, rings=5 if solid else 4)
        distance = np.abs(ratios(nd.simulate(scene, 0.5, dt=5e-3)) - limit)
        # In the last eight steps before the stop a step takes more than a tenth of the speed.
        assert (np.diff(distance[:-8]) <= 1e-9).all()
        assert distance[-2] <= close * distance[0]


@pytest.mark.case(24)
def test_spin_takes_friction_away():
    """Case 24: F = mu m g v/(R w): a side force of 1 % of friction moves a spinning disk, and not one at rest."""
    mu, radius, spin = 0.5, 0.1, 10.0
    force = 0.01 * mu * g
    for turning in (spin, 0.0):
        scene = nd.scenes.load("spinning_disk")(speed=0.0, spin=turning, mu=mu, radius=radius, flywheel=1e3)
        push = np.zeros(scene.articulations["disk"].model.nv)
        push[1] = force
        trajectory = nd.simulate(scene, 1.6, dt=2e-2, controller=lambda t, q, v, push=push: {"disk": push})
        # The drift settles within R w/(mu g) = 0.2 s.
        expected = radius * turning * force / (mu * g)
        assert np.abs(trajectory.v[-1, :2] - [0.0, expected]).max() <= (0.01 * expected or 1e-12)
        if turning:
            # The torque at zero drift, 2/3 mu m g R, by the ring rule of the pads 2/3 - 1/150.
            work = trajectory.energy.friction[-1] / 2e-2
            assert work == pytest.approx(-(2 / 3) * mu * g * radius * spin, rel=0.015)
