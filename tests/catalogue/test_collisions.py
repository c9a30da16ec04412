"""Catalogue of hard and analytic cases: bouncing, colliding, rocking, jamming."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import nsdyn as nd

g = 9.81


@pytest.mark.case(13)
@pytest.mark.parametrize("mu", [0.0, 0.05, 0.2, 0.5, 1.0])
@pytest.mark.parametrize("spin", [0.0, 40.0, -25.0, 29.0])
@pytest.mark.parametrize("restitution", [0.3, 1.0])
def test_spinning_ball_bounces(mu, spin, restitution):
    """Case 13: dv = -/+ mu (1 + e) |v_n| where it slips, v' = (5 v + 2 r w)/7 where it grips, in one step."""
    speed, fall, r = 3.0, 2.0, 0.1
    scene = nd.scenes.load("bounce")(
        height=0.0, restitution=restitution, mu=mu, speed=speed, fall=fall, spin=spin, gravity=0.0
    )
    step = nd.Stepper(scene, dt=1e-3).step()
    slip, impulse = speed - r * spin, (1 + restitution) * fall
    slips = mu * impulse < 2 / 7 * abs(slip)
    v = speed - math.copysign(mu * impulse, slip) if slips else (5 * speed + 2 * r * spin) / 7
    w = spin + (speed - v) * 5 / (2 * r)
    body = nd.simulate(scene, 1e-3, dt=1e-3).body("ball")
    assert step.contact_status[0] == (2 if slips else 1)
    assert np.abs(body.linear_velocity[-1] - [v, 0.0, restitution * fall]).max() <= 1e-13
    assert np.abs(body.angular_velocity[-1] - [0.0, w, 0.0]).max() <= 1e-11


@pytest.mark.case(13)
@pytest.mark.parametrize(("excess", "status"), [(1e-9, 1), (-1e-9, 2)])
def test_threshold_of_grip(excess, status):
    """Case 13: mu (1 + e) |v_n| = 2/7 |v - r w| (1 ± 1e-9) decides between grip and slip."""
    scene = nd.scenes.load("bounce")(
        height=0.0, restitution=0.5, mu=2 / 7 * (1 + excess), speed=3.0, fall=2.0, gravity=0.0
    )
    step = nd.Stepper(scene, dt=1e-3).step()
    slip = abs(step.u[0, 1])
    assert abs(slip - (0.0 if status == 1 else 3e-9)) <= 1e-14


def rest_error(dt, height, restitution=0.5):
    """Time at which a dropped ball lies still, against that of its infinitely many bounces, s."""
    end = math.sqrt(2 * height / g) * (1 + restitution) / (1 - restitution)
    trajectory = nd.simulate(nd.scenes.load("bounce")(height=height, restitution=restitution), 1.2 * end, dt=dt)
    moving = np.flatnonzero(np.abs(trajectory.v).max(axis=1) > 1e-12)
    # No bounce gives energy. An impact too slow to be located is caught within its step: the ball sinks in by the order
    # of g h², and what pushing it out costs is booked.
    energy = trajectory.energy
    assert (np.diff(energy.total) - energy.projection).max() <= 1e-12  # of 1 to 2 J
    assert energy.projection.max() <= 2 * (g * dt) ** 2
    # No chatter follows: the resting ball does not move at all.
    assert abs(trajectory.body("ball").position[-1, 2] - 0.1) <= 1e-9
    return trajectory.t[moving[-1] + 1] - end


@pytest.mark.case(14)
@pytest.mark.parametrize("h", [8e-3, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_zeno_ball_comes_to_rest_in_time(h):
    """Case 14: at t = sqrt(2 H/g) (1 + e)/(1 - e), less what is left of the series at 2 g h: at most 4 h.

    An impact slower than 2 g h gives nothing back, of which 2 e/(1 - e) times its speed over g would have come. All
    impacts before are exact, so the error is that and the part of a step in which the ball is already at rest.
    """
    errors = np.array([rest_error(h, height) for height in np.linspace(0.1, 0.2, 12)])
    assert (errors >= -4 * h).all() and (errors <= h).all()


@pytest.mark.case(14)
@pytest.mark.parametrize("restitution", [0.5, 0.8])
@pytest.mark.parametrize("h", [1e-2, 1e-3])
def test_apexes_of_a_bouncing_ball(restitution, h):
    """Case 14: apex n at e^(2 n) H, at any step, of every bounce faster than the 2 g h at which the ball rests."""
    trajectory = nd.simulate(nd.scenes.load("bounce")(height=1.0, restitution=restitution), 2.0, dt=h)
    z = trajectory.body("ball").position[:, 2] - 0.1
    v = trajectory.body("ball").linear_velocity[:, 2]
    tops = [k for k in range(1, len(z) - 1) if v[k] >= 0 > v[k + 1]]
    apexes = restitution ** (2 * np.arange(1, len(tops) + 1))
    fast = np.sqrt(2 * g * apexes) > restitution * 2 * g * h
    assert fast.sum() >= 3
    # The parabola from the last step before the top; what is left is the 1e-3 of a closed gap, 1e-13 m, at which an
    # impact is located.
    np.testing.assert_allclose((z + v**2 / (2 * g))[tops][fast], apexes[fast], rtol=0, atol=2e-13)


@pytest.mark.slow
@pytest.mark.case(15)
@pytest.mark.parametrize(
    ("height", "rows", "duration", "impacts"),
    [
        (5.0, 7, 6.0, 140),
        (0.0125, 8, 1.0, 500),
        (5.0, 7, 20.0, 400),
        (0.0125, 8, 20.0, 10_000),
    ],
)
def test_elastic_balls_keep_their_energy(height, rows, duration, impacts):
    """Case 15: e = 1, theta = 1/2: no drift of energy over 1e4 impacts in 20 s, nor in SimBenchmark's 7 x 7 balls.

    What one island can afford is located; what is caught obeys the same law of impact.
    """
    scene = nd.scenes.load("bouncing_balls")(rows=rows, height=height)
    trajectory = nd.simulate(scene, duration, dt=1e-2)
    total = trajectory.energy.total
    # SimBenchmark's measure is the squared error of the energy in J²; its best peer has 1.9e-6 at a step of 1e-4.
    assert ((total - total[0]) ** 2).mean() <= 1e-15
    assert np.abs(total / total[0] - 1).max() <= 1e-12
    assert np.abs(trajectory.energy.normal).max() <= 1e-12 * total[0]
    assert sum((trajectory.contacts(k).impulse[:, 0] > 0).sum() for k in range(1, len(trajectory.t))) >= impacts


@pytest.mark.case(16)
@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_cradle_of_touching_balls(count):
    """Case 16: Newton's law at e = 1: they strike one after the other and the last one flies off alone."""
    trajectory = nd.simulate(nd.scenes.load("cradle")(count=count, gap=0.0), 0.2, dt=1e-3)
    v = trajectory.v[-1].reshape(count, 6)[:, 0]
    assert np.abs(v - np.eye(count)[-1]).max() <= 1e-13
    assert np.ptp(trajectory.energy.kinetic) <= 1e-13 and abs(v.sum() - 1.0) <= 1e-13


@pytest.mark.case(16)
@pytest.mark.parametrize("count", [2, 3, 5, 10])
def test_cradle_of_separate_balls(count):
    """Case 16: with gaps larger than h v the impacts come one by one and the last ball flies off alone."""
    trajectory = nd.simulate(nd.scenes.load("cradle")(count=count, gap=0.005), 0.2 + 0.01 * count, dt=1e-3)
    v = trajectory.v[-1].reshape(count, 6)[:, 0]
    assert np.abs(v - np.eye(count)[-1]).max() <= 1e-13
    assert np.ptp(trajectory.energy.kinetic) <= 1e-13


def momenta(trajectory, masses=(1.0, 2.5), radii=(0.1, 0.15)):
    """Momentum and angular momentum about the origin, per step."""
    p, L = 0.0, 0.0
    for name, m, r in zip("ab", masses, radii, strict=True):
        s = trajectory.body(name)
        p = p + m * s.linear_velocity
        L = L + m * np.cross(s.position, s.linear_velocity) + 0.4 * m * r**2 * s.angular_velocity
    return p, L


@pytest.mark.case(17)
@pytest.mark.parametrize("mu", [0.05, 0.3, 2.0])
@pytest.mark.parametrize("parameters", [{"spin_y": 5.0}, {"spin_y": 0.0, "offset_y": 0.1}])
def test_oblique_collision(mu, parameters):
    """Case 17: both momenta to round-off, in a plane with spin and in space without."""
    trajectory = nd.simulate(nd.scenes.load("collision")(mu=mu, **parameters), 0.3, dt=1e-3)
    p, L = momenta(trajectory)
    assert np.abs(trajectory.body("b").linear_velocity[-1]).max() > 0.1, "they met"
    assert np.abs(p - p[0]).max() <= 3e-14 and np.abs(L - L[0]).max() <= 1e-13
    assert trajectory.energy.friction.sum() < 0 and np.abs(trajectory.energy.defect).max() <= 1e-13


@pytest.mark.case(17)
def test_oblique_collision_in_space_with_spin():
    """Case 17: both momenta to round-off with spins about all axes too: the impact is located, and free spin exact."""
    scene = nd.scenes.load("collision")(spin_x=2.0, spin_y=5.0, spin_z=-3.0, offset_y=0.1)
    for dt in (1e-2, 1e-3):
        p, L = momenta(nd.simulate(scene, 0.3, dt=dt))
        assert np.abs(p - p[0]).max() <= 1e-14 and np.abs(L - L[0]).max() <= 1e-13


@pytest.mark.case(18)
def test_kane_and_levinson():
    """Case 18: Newton's e with friction gives a rod energy in one impact; the ledger says so, and e = 0 never does.

    By default e is lowered so that the impact keeps the energy: by s, with r = (1 - s) r0 + s r1 and r (u + u⁻)/2 = 0.
    """
    parameters = {"angle": 60.0, "mu": 0.5, "slip": 1.0, "fall": 1.0, "gravity": 0.0}
    elastic = nd.scenes.load("rod")(restitution=1.0, **parameters)
    stepper = nd.Stepper(elastic, dt=1e-3, impact="newton")
    before_energy = stepper.start().energy["kinetic"]
    # The end sticks: dv = W r with dv = (2, -1), and the normal works do nothing at e = 1.
    d, now = stepper.dynamics, stepper.get_state().instant
    W = d.rows(now.contacts, now.placement, d.inertia(now.position, now.v), None)[0].blocks.delassus().toarray()
    with pytest.warns(UserWarning, match=r"Newton\(\) created 0.106 J at t = 0 s between 'ground' and 'rod'"):
        step = stepper.step()
    friction = np.linalg.solve(W, [2.0, -1.0, 0.0])[1] / 2
    assert friction > 0.1
    assert abs(step.energy["friction"] - friction) <= 1e-13 and abs(step.energy["normal"]) <= 1e-13
    assert abs(step.energy["kinetic"] - before_energy - friction) <= 1e-13
    plastic = nd.Stepper(nd.scenes.load("rod")(restitution=0.0, **parameters), dt=1e-3).step()
    assert plastic.energy["normal"] + plastic.energy["friction"] < 0
    kept = nd.Stepper(elastic, dt=1e-3).step()
    first, last = plastic.r[0], step.r[0]
    before = np.array([-1.0, *(step.u[0, 1:] - (W @ last)[1:])])

    def work(s):
        r = (1 - s) * first + s * last
        return r @ (before + 0.5 * W @ r)

    s = brentq(work, 0.0, 1.0, xtol=1e-15)
    np.testing.assert_allclose(kept.r[0], (1 - s) * first + s * last, rtol=0, atol=1e-12)
    assert kept.u[0, 0] == pytest.approx(s, abs=1e-12) and 0.5 < s < 0.99
    assert abs(kept.energy["kinetic"] - before_energy) <= 1e-13


@pytest.mark.case(18)
def test_energy_of_impacts_on_random_operators(rng):
    """Case 18: the works of the ledger are the change of energy whatever W; e = 0 and mu = 0 cannot gain any."""
    gains = 0
    for _ in range(200):
        A = rng.normal(size=(3, 3))
        W, u = A @ A.T + 1e-3 * np.eye(3), rng.normal(size=3)
        u[0] = -abs(u[0])
        for restitution, mu in ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (0.5, 0.0)):
            offset = np.array([restitution * u[0], 0.0, 0.0])
            solution = nd.solve(nd.FC3D(W, u + offset, [mu]), tol=1e-10)
            assert solution.converged
            # With M⁻¹ = W the velocity is u itself: T = u W⁻¹ u/2.
            after = solution.u - offset
            works = 0.5 * (u + after) @ solution.r
            change = 0.5 * (after @ np.linalg.solve(W, after) - u @ np.linalg.solve(W, u))
            assert works == pytest.approx(change, abs=1e-8 * (1 + abs(u @ np.linalg.solve(W, u))))
            if restitution == 0.0 or mu == 0.0:
                assert works <= 1e-10
            else:
                gains += works > 1e-6
    assert gains >= 10


def tilt(trajectory):
    q = trajectory.body("block").quaternion
    return 2 * np.arctan2(q[:, 1], q[:, 3])


def rocking_constants(width, height):
    """(alpha, p): half angle at the top, and the rate of the pendulum upside down, p² = 3 g/(4 R)."""
    return math.atan(width / height), math.sqrt(3 * g / (2 * math.hypot(width, height)))


@pytest.mark.case(19)
@pytest.mark.parametrize(("width", "ratio", "energy"), [(0.25, 0.9117647, 0.8313149), (0.5, 0.7, 0.49)])
def test_landing_of_a_rocking_block(width, ratio, energy):
    """Case 19: flat on both edges, e = 0: w+ = (1 - 3/2 sin² alpha) w-, the old edge lifts; exact but for gravity."""
    alpha, p = rocking_constants(width, 1.0)
    assert 1 - 1.5 * math.sin(alpha) ** 2 == pytest.approx(ratio, abs=1e-7)
    assert ratio**2 == pytest.approx(energy, abs=1e-6)
    h, spin = 1e-3, -0.5
    step = nd.Stepper(nd.scenes.load("rocking")(tilt=0.0, spin=spin, width=width), dt=h).step()
    # Gravity's moment about the new edge slows it down: J dw = h m g b/2 with J = 4/3 m R² = m g R/p².
    gravity = h * p**2 * math.sin(alpha)
    # Midpoint: contacts are where half a step of the first motion takes them, spin h/2 = 2.5e-4 rad.
    assert step.v[4] == pytest.approx((1 - 1.5 * math.sin(alpha) ** 2) * spin + gravity, rel=1e-3)


@pytest.mark.case(19)
def test_period_of_a_rocking_block():
    """Case 19: a quarter of a period, acosh(1/(1 - theta/alpha))/p, to 1 %, and to 1e-3 by the full sine."""
    for start in (3.0, 7.0, 10.0):
        alpha, p = rocking_constants(0.25, 1.0)
        theta = math.radians(start)
        linear = math.acosh(1 / (1 - theta / alpha)) / p
        # w² = 2 p² (cos(alpha - theta0) - cos(alpha - theta)); theta = theta0 (1 - s²) takes the root singularity away.
        top = math.cos(alpha - theta)
        exact = quad(
            lambda s, top=top, theta=theta, alpha=alpha, p=p: (
                2 * s * theta / (p * math.sqrt(2 * (top - math.cos(alpha - theta * (1 - s * s)))))
            ),
            1e-9,
            1.0,
        )[0]
        trajectory = nd.simulate(nd.scenes.load("rocking")(tilt=start), 1.2 * exact, dt=1e-3)
        angle = tilt(trajectory)
        k = int(np.flatnonzero(angle <= 0)[0])
        landing = trajectory.t[k - 1] + 1e-3 * angle[k - 1] / (angle[k - 1] - angle[k])
        assert abs(landing / linear - 1) <= 0.01
        assert abs(landing / exact - 1) <= 1e-3


@pytest.mark.case(19)
@pytest.mark.parametrize("start", [5.0, *(pytest.param(start, marks=pytest.mark.slow) for start in (7.0, 10.0))])
def test_energy_lost_in_rocking(start):
    """Case 19: a landing in the course of the motion keeps the ratio to 1e-3 of w at h = 1e-4: first order."""
    alpha, p = rocking_constants(0.25, 1.0)
    quarter = math.acosh(1 / (1 - math.radians(start) / alpha)) / p
    errors = []
    for h in (1e-3, 1e-4):
        trajectory = nd.simulate(nd.scenes.load("rocking")(tilt=start), 1.2 * quarter, dt=h)
        landing = int(np.flatnonzero(tilt(trajectory) <= 0)[0])
        # Turning about an edge keeps the energy; its level above the block at rest is J w²/2 at tilt 0.
        energy = trajectory.energy.total - 100.0 * g * 0.5
        after, before = energy[landing + round(5e-3 / h)], energy[landing - round(5e-3 / h)]
        errors.append(abs(math.sqrt(after / before) / (1 - 1.5 * math.sin(alpha) ** 2) - 1))
    assert errors[0] <= 1e-2 and errors[1] <= 1e-3


@pytest.mark.case(20)
@pytest.mark.parametrize("angle", [45.0, math.degrees(math.atan(2.0)), 75.0])
def test_threshold_of_the_painleve_rod(angle):
    """Case 20: at mu (1 ± 1e-6) about p = 0 the step gives a force times h, or an impulse that h does not shrink."""
    a = math.radians(angle)
    p0, slope = 1 + 3 * math.cos(a) ** 2, 3 * math.sin(a) * math.cos(a)
    assert angle != math.degrees(math.atan(2.0)) or p0 / slope == pytest.approx(4 / 3, rel=1e-12)
    # The impulse that stops the end dead: W r = (0, 1) for a unit of slip.
    jam = np.linalg.solve([[p0, -slope], [-slope, 1 + 3 * math.sin(a) ** 2]], [0.0, 1.0])[0]
    for h in (1e-9, 1e-10):
        # Gravity gives 1e-9 m/s in a step, which the default tolerance would not see.
        exact = {"dt": h, "solver": nd.solvers.Auto(tol=1e-12)}
        below = nd.Stepper(nd.scenes.load("rod")(angle=angle, mu=p0 / slope * (1 - 1e-6)), **exact).step()
        # N p = g: a million times the weight, and still a force.
        assert below.r[0, 0] == pytest.approx(h * g / (1e-6 * p0), rel=1e-3)
        above = nd.Stepper(nd.scenes.load("rod")(angle=angle, mu=p0 / slope * (1 + 1e-6)), **exact).step()
        assert above.r[0, 0] == pytest.approx(jam, rel=1e-6)


@pytest.mark.case(20)
def test_painleve_impulse_has_a_limit():
    """Case 20: tan(angle) = 2, mu = 2: P tends to 0.3 m v N·s as h goes to 0, an impact without a collision."""
    errors = []
    for h in (1e-2, 1e-3, 1e-4, 1e-5):
        stepper = nd.Stepper(nd.scenes.load("rod")(angle=math.degrees(math.atan(2.0)), mu=2.0), dt=h)
        step = stepper.step()
        assert step.solution.converged and (np.abs(step.u[:, 1:]) <= 1e-14).all()
        # At the end the gap is closed, but for half of what counts as that at most, which contacts that stay may leave
        # open; for that the normal velocity errs with h: by 0.20 h.
        assert abs(step.u[0, 0]) <= 0.25 * h and abs(step.gap[0]) <= 0.5 * stepper.gap_tol
        assert step.energy["normal"] + step.energy["friction"] < 0
        errors.append(abs(step.r[0, 0] - 0.3))
    assert errors[0] <= 7e-3
    # From 1 ms on the end of the slip is located, at a tenth of the step.
    np.testing.assert_allclose(errors[1:], 0.75 * 10.0 ** -np.arange(3, 6), rtol=5e-2)


@pytest.mark.case(20)
@pytest.mark.parametrize(
    ("start", "order"),
    [
        ({"angle": 30.0, "slip": -3.0, "spin": 3.0}, 0.8),
        pytest.param({"angle": 45.0, "slip": -5.0, "spin": 2.0}, 0.8, marks=pytest.mark.slow),
    ],
)
def test_motion_of_the_painleve_rod_converges(start, order):
    """Case 20: a rod that slides to a stop, and one that jams at once and is thrown up: first order to a fine run."""

    def end(h):
        trajectory = nd.simulate(nd.scenes.load("rod")(mu=2.0, **start), 0.2, dt=h)
        assert np.isin(trajectory.solver.status, (nd.Status.CONVERGED, nd.Status.JAM, nd.Status.SEVERAL)).all()
        # No energy comes from the contact but what second-order errors of the turning motion leave.
        assert np.diff(trajectory.energy.total).max() <= 3.0 * h**2 + 1e-13
        return np.concatenate((trajectory.q[-1, :3], [2 * math.atan2(trajectory.q[-1, 4], trajectory.q[-1, 6])]))

    fine = end(5e-5)
    # Far apart, for where in a step it comes to a stop makes them irregular.
    errors = [np.abs(end(h) - fine).max() for h in (4e-3, 2.5e-4)]
    assert errors[1] <= 1e-3 and math.log(errors[0] / errors[1]) / math.log(16) >= order
