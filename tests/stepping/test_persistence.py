"""Contacts that persist do no work and end without gaps; shallow impacts are located; what hardly bounces rests."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from test_convergence import arm

import nsdyn as nd
from nsdyn._kernels.stepping import columns
from nsdyn._kernels.stepping import eventless as eventless_kernels
from nsdyn._kernels.stepping import persistence as kernels
from nsdyn._kernels.stepping.eventless_contacts import DONE
from nsdyn.solvers import Auto

G = 9.81


# -- the couple --------------------------------------------------------------------------------------------------------


class Pair:
    """Two free bodies that touch in one point, with given inertias, turns and mean velocities."""

    def __init__(self, rng):
        self.J = np.array([np.diag(rng.uniform(1.0, 1.5, 3)) for _ in range(2)])
        self.R = Rotation.random(2, random_state=3).as_matrix()
        self.mean, self.r = rng.normal(size=12), np.array([1.0, 0.1, -0.2])
        self.contacts = np.array([[0], [1], [0], [1], [0]]), np.zeros((4, 1, 3)), np.zeros((3, 1))
        self.contacts[1][1] = self.normal = np.array([[0.6, 0.0, 0.8]])
        H = rng.normal(size=36)
        offset, m_start = np.array([0, 6, 12]), np.array([0, 36])
        empty = np.empty(0)
        self.blocks = offset, np.array([[0, 1]]), np.array([[0, 18]]), H, m_start, empty, empty
        self.rows = np.concatenate(H.reshape(2, 3, 6), axis=1)

    @property
    def work(self):
        """r·ū, J."""
        return float(self.r @ self.rows @ self.mean)

    def couple(self, h, sticks=True, surface_velocity=(), exact=1e-13, slip=1.0):
        """(couple, change of v, whether there is any other than none) in a move of h s, of bodies of 1 m.

        Surfaces that move add `surface_velocity` to the relative velocity, of which a solver leaves `exact` m/s. The
        contact slips with `slip` m/s, should it be on its cone.
        """
        yes = np.array([True])
        couple, dv = np.zeros((1, 3)), np.empty(12)
        other = kernels.couples(
            self.blocks,
            self.contacts,
            self.mean,
            (self.R, np.linalg.inv(self.J), np.ones(2), h),
            (
                self.r,
                np.array([0.0, 0.6 * slip, 0.8 * slip]),
                np.array([0.5]),
                np.array(surface_velocity, dtype=float),
                np.array([exact]),
            ),
            (yes, yes & sticks, ~yes),
            (couple, dv, np.full(1, np.inf), np.empty(1, np.bool_)),
        )
        return couple[0], dv.reshape(2, 6), other

    def turning(self):
        """Mean spin of body 2 on body 1, world axes."""
        spin = np.einsum("bij,bj->bi", self.R, self.mean.reshape(2, 6)[:, 3:])
        return spin[1] - spin[0]


def test_a_couple_takes_the_work_of_its_contact_and_keeps_the_momenta(rng):
    pair = Pair(rng)
    couple, dv, other = pair.couple(h=10.0)
    assert other and couple @ pair.turning() == pytest.approx(-pair.work, rel=1e-12)
    np.testing.assert_allclose(np.cross(couple, pair.turning()), 0.0, rtol=0, atol=1e-14)
    momentum = np.einsum("bij,bjk,bk->bi", pair.R, pair.J, dv[:, 3:])
    np.testing.assert_allclose(momentum[1], couple, rtol=0, atol=1e-14)
    np.testing.assert_allclose(momentum.sum(axis=0), 0.0, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(dv[:, :3], 0.0)


def test_a_couple_leaves_the_work_of_a_moving_surface_alone(rng):
    pair, belt = Pair(rng), np.array([0.0, 0.3, -0.1])
    couple, _, _ = pair.couple(10.0, surface_velocity=belt)
    assert couple @ pair.turning() == pytest.approx(-(pair.work + pair.r @ belt), rel=1e-12)


def test_a_work_that_the_solver_leaves_is_none(rng):
    """The pair presses with 1 N·s: a velocity of `exact` does as much work."""
    pair = Pair(rng)
    assert pair.couple(10.0, exact=0.99 * abs(pair.work))[2]
    couple, dv, other = pair.couple(10.0, exact=1.01 * abs(pair.work))
    assert not other and not couple.any() and not dv.any()


def test_what_slips_does_the_work_of_its_friction(rng):
    """Only that of its normal force is taken, which has no moment about the normal."""
    pair, smooth = Pair(rng), Pair(np.random.default_rng(0))
    smooth.__dict__ |= pair.__dict__
    smooth.r = pair.r * [1.0, 0.0, 0.0]
    couple = pair.couple(10.0, sticks=False)[0]
    np.testing.assert_array_equal(couple, smooth.couple(10.0, sticks=False)[0])
    assert abs(couple @ pair.normal[0]) <= 1e-14 and np.linalg.norm(couple) > 0.01


def test_what_is_on_its_cone_but_does_not_slip_does_no_work(rng):
    """As redundant contacts that share a friction less than their limits: 1e-8 m/s is what a tolerance leaves."""
    pair = Pair(rng)
    pair.r = np.array([1.0, 0.3, -0.4])
    normal = float(pair.rows[0] @ pair.mean)
    held, _, _ = pair.couple(10.0, slip=1e-9)
    rubs, _, _ = pair.couple(10.0, slip=1e-7)
    assert held @ pair.turning() == pytest.approx(-pair.work, rel=1e-12)
    assert rubs @ pair.turning() == pytest.approx(-normal, rel=1e-12)


def test_a_couple_is_no_longer_an_arm_than_the_way_of_the_bodies(rng):
    """h ‖ω‖ times the size, here 1 m, times the pressing impulse."""
    pair, h = Pair(rng), 1e-3
    couple, _, _ = pair.couple(h)
    assert np.linalg.norm(couple) == pytest.approx(h * np.linalg.norm(pair.turning()) * pair.r[0], rel=1e-12)


def test_what_does_not_turn_has_no_couple(rng):
    pair = Pair(rng)
    pair.mean.reshape(2, 6)[:, 3:] = 0.0
    couple, dv, other = pair.couple(10.0)
    assert not other and not couple.any() and not dv.any()


# -- rolling -----------------------------------------------------------------------------------------------------------


def boat():
    """A capsule with its centre of mass below its axis: rolls to and fro for ever."""
    scene, material = nd.Scene(), nd.Material(mu=2.0)
    scene.add_halfspace("ground", material=material)
    flat = Rotation.from_euler("y", 90, degrees=True)
    turn, com = Rotation.from_euler("x", 1.0) * flat, 0.05 * flat.inv().apply([0, 0, -1.0])
    scene.add_capsule(
        "boat",
        0.1,
        0.3,
        2.0,
        com=tuple(com),
        inertia=np.diag([0.03, 0.03, 0.012]).tolist(),
        material=material,
        position=tuple(np.array([0, 0, 0.1]) + turn.apply(com)),
        quaternion=tuple(turn.as_quat()),
    )
    return scene


def roller(spin=20.0, radius=0.1, off=0.02):
    """An unbalanced roller that never leaves the ground: the least normal force is 0.58 of its weight."""
    scene, material = nd.Scene(), nd.Material(mu=5.0)
    scene.add_halfspace("ground", material=material)
    turn = Rotation.from_euler("y", 90, degrees=True)
    com = off * turn.inv().apply([0, 0, -1.0])
    at = np.array([0, 0, radius]) + turn.apply(com)
    scene.add_capsule(
        "roller",
        radius,
        0.3,
        2.0,
        com=tuple(com),
        inertia=np.diag([0.03, 0.03, 0.012]).tolist(),
        position=tuple(at),
        quaternion=tuple(turn.as_quat()),
        material=material,
        angular_velocity=(spin, 0, 0),
        linear_velocity=tuple(np.cross((spin, 0, 0), at)),
    )
    return scene


def egg(mu):
    """An ellipsoid that tumbles on a plane; without slip if mu is large."""
    scene, material = nd.Scene(), nd.Material(mu=mu)
    scene.add_halfspace("ground", material=material)
    turn, semi, spin = Rotation.from_euler("xyz", [0.3, 0.2, 0.1]), np.array([0.12, 0.08, 0.1]), (3.0, 9.0, 1.0)
    n = turn.inv().apply([0, 0, 1.0])
    point = turn.apply(-(semi**2) * n / np.linalg.norm(semi * n))
    scene.add_ellipsoid(
        "egg",
        tuple(semi),
        2.0,
        position=(0, 0, -point[2]),
        quaternion=tuple(turn.as_quat()),
        material=material,
        linear_velocity=tuple(-np.cross(spin, point)),
        angular_velocity=spin,
    )
    return scene


@pytest.mark.parametrize(
    "make, duration, dt, bar",
    [
        (lambda: egg(20.0), 0.4, 1e-2, 1e-12),
        (nd.scenes.load("euler_disk"), 0.2, 1e-3, 1e-12),
        (boat, 5.0, 1e-2, 1e-4),  # where its spin turns round, the couple has less of it than it would need
        (nd.scenes.load("rattleback"), 1.0, 1e-3, 1e-4),  # while it rattles, contact is lost for some steps
    ],
)
def test_rolling_keeps_its_energy(make, duration, dt, bar):
    trajectory = nd.simulate(make(), duration, dt)
    e = trajectory.energy
    assert np.abs(e.total - e.total[0]).max() <= bar * e.kinetic.max()
    assert np.abs(e.defect).max() <= 1e-13 * trajectory.at_play
    assert nd.check(trajectory).passed


def test_forces_of_a_contact_that_stays_do_not_alternate(tmp_path):
    """The tip of an arm slides: with gaps of exactly 0 at all ends second differences of its 8 N were 3 mN."""
    dt = 2.5e-4
    stepper = nd.Stepper(arm(tmp_path, 0.1), dt=dt, solver=Auto(tol=1e-12))
    force = np.array([stepper.step().r[:, 0].sum() for _ in range(60)]) / dt
    # Of a smooth force they are dt² times some 150 N/s².
    assert np.abs(np.diff(force[20:], 2)).max() <= 3e-5


@pytest.mark.parametrize("dt", [0.024, 0.016, 0.008])
def test_an_unbalanced_roller_loses_nothing_and_never_strikes(dt):
    """13, 20 and 39 steps a turn, against its equation of motion: second order."""
    off, radius, m, inertia, spin, duration = 0.02, 0.1, 2.0, 0.012, 20.0, 0.48

    def rate(_, y):
        about = inertia + m * (radius**2 + off**2 - 2 * radius * off * math.cos(y[0]))
        return y[1], -m * off * math.sin(y[0]) * (radius * y[1] ** 2 + G) / about

    exact = solve_ivp(rate, (0, duration), (0, spin), rtol=1e-11, atol=1e-11).y[1, -1]
    trajectory = nd.simulate(roller(), duration, dt)
    e = trajectory.energy
    assert np.abs(e.normal).max() == np.abs(e.projection).max() == 0.0
    assert np.abs(e.total - e.total[0]).max() <= 1e-12 * e.kinetic[0]
    # At 0.016 s 1.3e-2 rad/s.
    assert abs(trajectory.body("roller").angular_velocity[-1, 0] - exact) <= 3e-2 * (dt / 0.016) ** 2


@pytest.mark.parametrize("sides", [40, 100])
def test_a_prism_rolls_straight_on(sides):
    """More corners come near in a step than stand for the patch, but both ends of the edge that carries do."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = 0.1 * np.column_stack((np.sin(angle), -np.cos(angle)))
    ends = [np.column_stack((ring[:, 0], np.full(sides, y), ring[:, 1])) for y in (-0.1, 0.1)]
    scene, rough = nd.Scene(), nd.Material(mu=2.0)
    scene.add_halfspace("ground", material=rough)
    height = 0.1 * math.cos(np.pi / sides)
    roller = {"position": (0, 0, height), "angular_velocity": (0, 4, 0), "linear_velocity": (4 * height, 0, 0)}
    scene.add_convex("prism", np.vstack(ends), 1.0, material=rough, **roller)
    trajectory = nd.simulate(scene, 0.3, dt=1e-2)
    assert trajectory.body("prism").position[-1, 0] > 0.1
    # Round-off, of 4 rad/s. With one end of the edge alone 3e-3 and 2e-2 rad/s.
    assert np.abs(trajectory.body("prism").angular_velocity[:, ::2]).max() <= 1e-10


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_what_an_ellipsoid_that_slides_gains_is_in_the_ledger(mu):
    trajectory = nd.simulate(egg(mu), 1.0, 1e-2)
    e = trajectory.energy
    numerics = np.abs(e.integration + e.projection)
    assert (np.diff(e.total) - numerics).max() <= 1e-13 * trajectory.at_play
    assert numerics.sum() <= 1e-4 * trajectory.at_play
    assert np.abs(e.defect).max() <= 1e-13 * trajectory.at_play
    if mu == 0.0:  # nothing pushes it sideways
        velocity = trajectory.body("egg").linear_velocity
        np.testing.assert_allclose(velocity[:, :2], velocity[:1, :2].repeat(len(velocity), 0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("slip", [1.0, 0.2])
def test_what_sticks_gets_no_energy_from_friction_where_nothing_is_foreseen_of_how_it_turns(slip):
    # With theta = 1 the point of a rod that topples slips on a little where each move begins, by how it turned in the
    # last, and more where it touches again after one in flight. Impacts leave 4e-7 J.
    run = nd.simulate(nd.scenes.load("rod")(angle=50.0, mu=1.8, slip=slip), 0.15, 8e-3, theta=1.0)
    assert run.energy.friction.max() < 1e-6 * run.at_play


def test_what_works_on_a_body_may_give_it_energy():
    """A ball rolls under a force F at its centre: (7/5) m v' = F."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=1.0))
    scene.add_sphere("ball", 0.1, 2.0, position=(0, 0, 0.1), material=nd.Material(mu=1.0))
    push = np.array([3.0, 0.0, 0.0])
    trajectory = nd.simulate(scene, 0.5, 1e-2, external_force=lambda t, q, v: {"ball": push})
    speed = trajectory.body("ball").linear_velocity[-1, 0]
    assert speed == pytest.approx(3.0 * 0.5 / (1.4 * 2.0), rel=1e-9)
    assert trajectory.energy.external.sum() == pytest.approx(trajectory.energy.kinetic[-1], rel=1e-9)


# -- landing -----------------------------------------------------------------------------------------------------------


def block(tilt, width, height, mass=100.0):
    """A block on its edge, let go at an angle in degrees."""
    scene, material, turn = nd.Scene(), nd.Material(mu=10.0), Rotation.from_euler("y", math.radians(tilt))
    scene.add_halfspace("ground", material=material)
    lowest = min(turn.apply([x, 0, -height / 2])[2] for x in (-width / 2, width / 2))
    scene.add_box(
        "block", (width, 0.5, height), mass, position=(0, 0, -lowest), quaternion=turn.as_quat(), material=material
    )
    return scene


@pytest.mark.parametrize("tilt, width, height", [(3.0, 0.25, 1.0), (1.0, 0.25, 1.0), (4.0, 0.5, 1.0), (2.0, 0.15, 1.5)])
def test_a_landing_takes_what_housner_says_at_every_step_length(tilt, width, height):
    """ω⁺/ω⁻ = 1 - 3/2 sin² α with tan α = width/height: G. W. Housner, 1963. Whether the landing is deep or shallow."""
    alpha, angle, mass = math.atan(width / height), math.radians(tilt), 100.0
    potential = mass * G * 0.5 * (width * math.sin(angle) + height * (math.cos(angle) - 1.0))
    loss = potential * (1.0 - (1.0 - 1.5 * math.sin(alpha) ** 2) ** 2)

    def fall(_, y):
        return y[1], 1.5 * G / math.hypot(width, height) * math.sin(y[0] - alpha)

    def lands(_, y):
        return y[0]

    lands.terminal = True
    time = solve_ivp(fall, (0, 10), (angle, 0), events=lands, rtol=1e-10, atol=1e-12).t[-1]
    for dt in (1e-2, 5e-3, 2e-3, 1e-3):
        e = nd.simulate(block(tilt, width, height), math.ceil(1.3 * time / dt) * dt, dt).energy
        assert e.total[0] - e.total[-1] == pytest.approx(loss, rel=1e-3)  # 3e-4 at 1e-2 s, where it was up to 0.6
        assert np.abs(e.projection).sum() <= 1e-5 * loss


def test_a_box_that_falls_on_its_face_comes_to_rest():
    """From an edge and two corners, with a spin: what parts and closes by a hair is stopped, not thrown back."""
    scene, turn = nd.Scene(), Rotation.from_euler("xyz", [0.3, 0.5, 0.2])
    scene.add_halfspace("ground", material=nd.Material(mu=0.5))
    lowest = np.abs(turn.as_matrix()[2]) @ [0.1, 0.1, 0.1]
    scene.add_box(
        "box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, lowest), quaternion=turn.as_quat(), material=nd.Material(mu=0.5)
    )
    e = nd.simulate(scene, 1.2, 5e-3).energy
    assert e.kinetic[-1] <= 1e-20
    assert np.diff(e.total).max() <= 1e-12 and np.abs(e.integration + e.projection).sum() <= 1e-5


# -- rest --------------------------------------------------------------------------------------------------------------


def ball_on_a_box(e):
    scene, material = nd.Scene(), nd.Material(mu=0.5, restitution=e)
    scene.add_halfspace("ground", material=material)
    scene.add_box("box", (1, 1, 0.2), 10.0, position=(0, 0, 0.1), material=material)
    scene.set_pair("box", "ground", mu=0.5, restitution=0.0)
    scene.add_sphere("ball", 0.1, 1.0, position=(0.01, 0, 0.5), material=material)
    return scene


def boxes(e, n=3):
    scene, material = nd.Scene(), nd.Material(mu=0.5, restitution=e)
    scene.add_halfspace("ground", material=material)
    for k in range(n):
        at = (0, 0, 0.1 + 0.2 * k + 0.02 * (k + 1))
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=at, material=material)
    return scene


def heap(e, n=8):
    """Boxes that fall on each other as they come."""
    rng, scene, material = np.random.default_rng(3), nd.Scene(), nd.Material(mu=0.5, restitution=e)
    scene.add_halfspace("ground", material=material)
    for k in range(n):
        turn, at = Rotation.random(random_state=k).as_quat(), (*rng.uniform(-0.1, 0.1, 2), 0.2 + 0.3 * k)
        scene.add_box(f"box{k}", (0.2, 0.15, 0.1), 1.0, position=at, quaternion=tuple(turn), material=material)
    return scene


@pytest.mark.parametrize(
    "make, dt, steps",
    [(ball_on_a_box, 1e-2, 200), (boxes, 5e-3, 300), pytest.param(heap, 5e-3, 700, marks=pytest.mark.slow)],
)
def test_what_bounces_on_free_bodies_comes_to_rest(make, dt, steps, monkeypatch):
    """At no more than three times the solves of what does not bounce."""
    calls, solve, made = [0], Auto.__call__, eventless_kernels.eventless_step

    def counted(self, *args):
        calls[-1] += 1
        return solve(self, *args)

    def counted_eventless(*args):
        """What the kernel of a step solves itself, whether or not the step is then one of these."""
        results, stage = args[4][0], args[10][0]
        if stage == DONE:
            results[columns.TIME] = 0.0
        before, out = results[columns.TIME], made(*args)
        calls[-1] += results[columns.TIME] > before
        return out

    monkeypatch.setattr(Auto, "__call__", counted)
    monkeypatch.setattr(eventless_kernels, "eventless_step", counted_eventless)
    late = {}
    for e in (0.0, 0.3, 0.5):
        stepper = nd.Stepper(make(e), dt=dt)
        for k in range(steps):
            if k == steps - 20:
                calls[-1] = 0
            step = stepper.step()
        late[e] = calls[-1]
        mass, slow = sum(body.mass for body in stepper.scene.free_bodies), stepper.gap_tol / dt
        assert step.ledger.kinetic <= 0.5 * mass * slow**2  # in a step they go no farther than what counts as closed
        assert step.gap.min() >= -stepper.gap_tol
    assert max(late.values()) <= 3 * late[0.0]


@pytest.mark.parametrize("drop", [1e-3, 1e-4])
def test_a_slow_elastic_ball_keeps_bouncing(drop):
    """Flights of 28 and of 9 ms in steps of 10 ms."""
    scene, material = nd.Scene(), nd.Material(mu=0.0, restitution=1.0)
    scene.add_halfspace("ground", material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1 + drop), material=material)
    e = nd.simulate(scene, 1.0, 1e-2).energy
    np.testing.assert_allclose(e.total - G * 0.1, G * drop, rtol=1e-7)  # of 9.81 J to round-off


@pytest.mark.parametrize("bounces", [20, *(pytest.param(count, marks=pytest.mark.slow) for count in (100, 300))])
def test_a_ball_between_two_plates_may_bounce_any_number_of_times_in_a_step(bounces):
    """40 bounces of a step are located. What sixty more in no time leave of the speed is round-off, and no approach."""
    scene, material = nd.Scene(gravity=(0, 0, 0)), nd.Material(mu=0.0, restitution=1.0)
    scene.add_halfspace("floor", material=material)
    scene.add_halfspace("roof", normal=(0, 0, -1), offset=-1.0, material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.5), linear_velocity=(0, 0, 1), material=material)
    stepper = nd.Stepper(scene, dt=0.8 * bounces)
    kinetic = [stepper.step().ledger.kinetic for _ in range(3)]
    assert max(kinetic) <= 0.5 * (1.0 + 1e-12)
    assert bounces > 40 or min(kinetic) == pytest.approx(0.5, rel=1e-12)


@pytest.mark.slow
def test_elastic_balls_keep_their_energy():
    """64 under gravity between walls: some 400 impacts, of which the slow ones were lost."""
    rng, scene, material = np.random.default_rng(1), nd.Scene(), nd.Material(mu=0.0, restitution=1.0)
    scene.add_halfspace("ground", material=material)
    for k, normal in enumerate(((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))):
        scene.add_halfspace(f"wall{k}", normal=normal, offset=-0.8, material=material)
    for k, (x, y, z) in enumerate(np.ndindex(4, 4, 4)):
        at, v = (-0.6 + 0.4 * x, -0.6 + 0.4 * y, 0.15 + 0.3 * z), tuple(0.5 * rng.normal(size=3))
        scene.add_sphere(f"ball{k}", 0.1, 1.0, position=at, linear_velocity=v, material=material)
    e = nd.simulate(scene, 0.3, 5e-3).energy
    np.testing.assert_allclose(e.total, e.total[0], rtol=1e-12)
