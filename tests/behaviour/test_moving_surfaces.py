"""What moves on surfaces that move: belts, turntables, plates that wobble, against exact motions."""

import math

import numpy as np
import pytest

import nsdyn as nd


@pytest.mark.parametrize("dt", [2e-2, 5e-3])
def test_ball_on_a_belt_that_speeds_up(dt):
    """Friction that holds gives a solid ball 2/7 of the belt's velocity, and spin for the rest."""
    radius, end = 0.05, 0.4
    scene, material = nd.Scene(), nd.Material(0.5)
    scene.add_halfspace("belt", material=material)
    scene.set_motion("belt", surface_velocity=lambda t: (0, math.sin(3 * t), 0))
    scene.add_sphere("ball", radius, 0.5, position=(0, 0, radius), material=material)
    run = nd.simulate(scene, end, dt)
    ball, belt = run.body("ball"), math.sin(3 * end)
    np.testing.assert_allclose(ball.linear_velocity[-1], (0, 2 / 7 * belt, 0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(ball.angular_velocity[-1], (5 / 7 * belt / radius, 0, 0), rtol=0, atol=1e-7)
    assert np.abs(run.energy.integration).max() < 1e-12
    assert run.energy.constraint.sum() == pytest.approx(run.energy.kinetic[-1], rel=0.1)  # all is from the belt


@pytest.mark.parametrize("kind", ["surface_velocity", "velocity"])
def test_ball_rolls_in_circles_on_a_turntable(kind):
    """With 2/7 of the table's rate, whatever its radius, to second order.

    K. Weltner, Stable circular orbits of freely moving balls on rotating discs, American Journal of Physics 47, 1979.
    """
    rate, radius, end = 2.0, 0.05, 2.0
    x, v = np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.3, 0.0])
    slower = 2 / 7 * rate
    turned = slower * end
    there = x[:2] + np.array([math.cos(turned) - 1, math.sin(turned)]) * 0.3 / slower
    errors = []
    for dt in (2e-2, 1e-2):
        scene, material = nd.Scene(), nd.Material(1.0)
        scene.add_cylinder("table", 2.0, 0.2, fixed=True, position=(0, 0, -0.1), material=material)
        scene.set_motion("table", **{kind: ((0, 0, 0), (0, 0, rate))})
        spin = np.cross((0, 0, 1), v - np.cross((0, 0, rate), x)) / radius
        scene.add_sphere(
            "ball",
            radius,
            0.5,
            position=(*x[:2], radius),
            linear_velocity=tuple(v),
            angular_velocity=tuple(spin),
            material=material,
        )
        errors.append(np.linalg.norm(nd.simulate(scene, end, dt).body("ball").position[-1, :2] - there))
    assert errors[0] < 1e-4 and errors[0] / errors[1] > 3.8


def test_a_box_stands_on_a_turntable():
    """What sticks gets ahead by (5/12)(ω dt)² of the table's way, and goes out by (ω dt)³ / 4 of it."""
    rate, dt, half = 1.2, 4e-3, 0.4
    scene, material = nd.Scene(), nd.Material(0.5)
    scene.add_cylinder("table", 2.0, 0.1, fixed=True, material=material)
    scene.set_motion("table", velocity=((0, 0, 0), (0, 0, rate)))
    moves = {"linear_velocity": (0, 0.5 * rate, 0), "angular_velocity": (0, 0, rate)}
    scene.add_box("box", (0.1, 0.1, 0.02), 1.0, position=(0.5, 0, 0.06), material=material, **moves)
    run = nd.simulate(scene, 2 * half, dt)
    x, y = run.body("box").position[:, :2].T
    ahead = np.unwrap(np.arctan2(y, x)) - rate * run.t
    middle = run.t.size // 2
    gained = (ahead[-1] - ahead[middle]) / (rate * half)
    assert gained == pytest.approx(5 / 12 * (rate * dt) ** 2, rel=1e-3)
    out = (math.hypot(x[-1], y[-1]) - math.hypot(x[middle], y[middle])) / (0.5 * rate * half)
    assert out == pytest.approx((rate * dt) ** 3 / 4, rel=1e-3)
    assert nd.check(run).passed


@pytest.mark.parametrize(
    ("theta", "velocity"),
    [
        (0.5, lambda t: ((0, 0, 0), (np.cos(9 * t), np.sin(9 * t), 1.0))),
        pytest.param(1.0, lambda t: ((0, 0, 0.45 * np.cos(9 * t)), (0, 0, 0)), marks=pytest.mark.slow),
    ],
)
def test_a_driven_floor_is_where_it_is_for_what_meets_it_in_pieces(theta, velocity):
    """It wobbles about an axis that turns, or is first order: pieces by themselves would bring it elsewhere."""
    scene, material = nd.Scene(), nd.Material(0.5, 0.5)
    scene.add_box("plate", (2, 2, 0.2), fixed=True, position=(0, 0, -0.1), material=material)
    scene.set_motion("plate", velocity=velocity)
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0.5, 0, 0.2), material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(-0.5, 0.3, 0.3), material=material)
    overlap = nd.check(nd.simulate(scene, 0.6, 0.05, theta=theta))["overlap"]
    assert overlap.worst < 1e-7  # 1e-4 and 6e-3 where each piece brought it on


def test_a_robot_stands_on_a_lift_that_speeds_up_as_under_more_gravity():
    """What rests does not approach where a move begins: no step is cut, and nothing is projected."""
    robot = nd.scenes.load("quadruped")()
    controller = nd.scenes.module("quadruped").controller(robot, walk=False)
    joints = []
    for lifted in (True, False):
        scene, material = nd.Scene(gravity=(0, 0, -9.81 if lifted else -12.81)), nd.Material(0.8)
        if lifted:
            scene.add_box("lift", (20, 20, 0.5), fixed=True, position=(0, 0, -0.25), material=material)
            scene.set_motion("lift", velocity=lambda t: (0, 0, 3.0 * t))
        else:
            scene.add_halfspace("ground", material=material)
        scene.articulations["quadruped"] = robot.articulations["quadruped"]
        run = nd.simulate(scene, 0.1, 4e-3, controller=controller)
        assert not np.diff(run.columns["pieces/offset"]).any()  # 12 of 25 steps were
        assert not run.energy.projection.any()
        joints.append(run.q[-1, 7:])
    # Both are of second order, and 2.5e-7 rad at 1 ms from a fine run.
    np.testing.assert_allclose(*joints, rtol=0, atol=1e-5)


@pytest.mark.parametrize("restitution", [0.0, 0.8])
@pytest.mark.parametrize("speeds", [(0.0, 0.0), (1.0, 1.0), (1.0, 2.0), (2.0, 1.0)])
@pytest.mark.parametrize("shape", ["box", "cylinder"])
def test_what_slides_onto_the_next_plate_does_not_meet_its_edge(shape, speeds, restitution):
    """Where its front was right above the seam where a step began it was struck there, at 45°, and thrown up."""
    mu = 0.0 if speeds == (0.0, 0.0) else 0.5
    material, scene = nd.Material(mu, restitution), nd.Scene()
    for k, speed in enumerate(speeds):
        plate = f"plate{k}"
        scene.add_box(plate, (2, 1, 0.2), fixed=True, position=(2 * k - 1, 0, -0.1), material=material)
        scene.set_motion(plate, surface_velocity=(speed, 0, 0))
    speed = speeds[0] or 1.0
    given = {"position": (-0.1 - 5e-3 * speed, 0, 0.05), "linear_velocity": (speed, 0, 0), "material": material}
    if shape == "box":
        scene.add_box("thing", (0.2, 0.2, 0.1), 1.0, **given)
    else:
        scene.add_cylinder("thing", 0.1, 0.1, 1.0, **given)
    run = nd.simulate(scene, 0.3, dt=5e-3)
    thing = run.body("thing")
    assert np.abs(thing.position[:, 2] - 0.05).max() < 1e-9
    assert np.abs(thing.angular_velocity[:, :2]).max() < 1e-9
    if speeds[0] == speeds[1]:
        np.testing.assert_allclose(thing.linear_velocity[:, 0], speed, rtol=1e-12)
    assert nd.check(run)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("e", [0.5, 0.9])
def test_what_lies_on_a_plate_that_quickens_moves_with_it_whatever_its_restitution(axis, e):
    """Over the ground, and pushed without gravity: the plate catches up within a move, which is no approach."""
    n, a = np.eye(3)[axis], 12.0
    scene, material = nd.Scene(gravity=(0, 0, -9.81 if axis == 2 else 0)), nd.Material(0.5, restitution=e)
    scene.add_box("plate", (1, 1, 1), fixed=True, position=-0.5 * n, material=material)
    scene.set_motion("plate", velocity=lambda t: a * t * n)
    scene.add_sphere("ball", 0.1, 1.0, position=0.1 * n, material=material)
    run = nd.simulate(scene, 0.1, dt=1e-2)
    late = run.body("ball").linear_velocity[:, axis] - a * run.t
    assert np.abs(late).max() <= 1e-5  # m/s: its bounces end in a step; 2e-2 where it struck in every step
    assert abs(run.energy.projection.sum()) <= 1e-9  # J


@pytest.mark.parametrize("speed", [None, 1e-9])
def test_a_move_that_gains_energy_on_a_driven_body_is_made_in_halves_as_on_a_fixed_one(speed):
    """A box settles on its corners: where the floor moved one sank by 2e-6 m, and was lifted at the cost of 7e-6 J."""
    rng, scene, material = np.random.default_rng(1), nd.Scene(), nd.Material(0.3, 0.5)
    walls = {"floor": ((0, 0, -0.05), (1, 1, 0.1))}
    for sign in (1, -1):
        walls[f"x {sign}"] = (0.55 * sign, 0, 0.5), (0.1, 1, 1)
        walls[f"y {sign}"] = (0, 0.55 * sign, 0.5), (1, 0.1, 1)
    for name, (place, size) in walls.items():
        scene.add_box(name, size, fixed=True, position=place, material=material)
        if speed is not None:
            scene.set_motion(name, velocity=(speed, 0, 0))
    for k in range(2):
        x, v, q = (*rng.uniform(-0.3, 0.3, 2), 0.15 + 0.3 * k), 2 * rng.normal(size=3), rng.normal(size=4)
        common = {"position": x, "linear_velocity": v, "material": material}
        if k:
            scene.add_box("box", (0.15, 0.1, 0.2), 1.0, quaternion=q / np.linalg.norm(q), **common)
        else:
            scene.add_sphere("ball", 0.08, 0.7, **common)
    assert nd.simulate(scene, 0.59, 2e-3).energy.projection.sum() < 1e-9
