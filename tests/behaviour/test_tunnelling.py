"""What flies and turns fast hits what is in its way, as closed forms and fine steps have it."""

import math

import numpy as np
import pytest

import nsdyn as nd


@pytest.mark.case(46)
@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("shift", [0.0, 0.13, 0.37, 0.71])
def test_no_tunnelling(restitution, shift):
    """100 m/s at a wall of 10 mm with steps in which the ball flies a metre."""
    trajectory = nd.simulate(nd.scenes.load("bullet")(shift=shift, restitution=restitution), 0.2, dt=1e-2)
    ball = trajectory.body("ball")
    assert ball.position[:, 0].max() <= 5 + shift - 0.005 - 0.02 + 1e-9
    assert ball.linear_velocity[-1, 0] == pytest.approx(-100 * restitution, abs=1e-9)
    # The whole momentum went through the contact: P = m v (1 + e).
    impulse = sum(trajectory.contacts(k).impulse[:, 0].sum() for k in range(1, len(trajectory.t)))
    assert impulse == pytest.approx(100 * (1 + restitution), rel=1e-12)


def unit(quaternion):
    return np.array(quaternion) / np.linalg.norm(quaternion)


@pytest.mark.parametrize("count", [1, 2, 10])
def test_rods_that_strike_twice_in_a_step(count):
    """They turn by half a radian: after the first impact they part, and cross once more where they had not touched."""
    scene, smooth = nd.Scene(gravity=(0, 0, 0)), nd.Material(mu=0.0, restitution=0.5)
    where = ((0, 0, 0), (0.811, -0.193, -0.318, -0.451)), ((-0.151, 0.091, -0.139), (0.906, -0.335, 0.031, 0.255))
    how = ((-19.2, 2.6, 1.2), (-20.0, -53.6, -25.4)), ((33.6, -37.0, 11.6), (47.6, -12.0, 27.3))
    for k, (size, (x, q), (v, w)) in enumerate(zip(((0.008, 0.92), (0.001, 0.6)), where, how, strict=True)):
        motion = {"linear_velocity": v, "angular_velocity": w}
        body = {"inertia": 0.1 * np.eye(3), "material": smooth}
        scene.add_capsule(f"rod {k}", *size, 1.0, position=x, quaternion=unit(q), **motion, **body)
    trajectory = nd.simulate(scene, 1e-2, dt=1e-2 / count)
    # Steps of 1e-5 s say 13.86701348, 7.40584295, -0.97304425 m/s; one impact alone 6.02, 7.52, -2.55.
    expected = 13.86701348, 7.40584295, -0.97304425
    np.testing.assert_allclose(trajectory.body("rod 0").linear_velocity[-1], expected, rtol=0, atol=1e-7)


def test_what_touches_a_plate_and_parts_does_not_pass_through_it():
    """A capsule of 1 m turns by half a turn in a step: one end leaves a plate of 1 cm, and the other arrives."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("plate", (0.01, 20, 20), fixed=True)
    x, y, z, w = q = unit((0.15637197, -0.12290952, 0.75268583, 0.62761859))
    touching = -0.005 - 0.05 - abs(x * z + y * w)
    motion = {"linear_velocity": (129.418, 0, 0), "angular_velocity": (88.37545189, -307.46881661, 7.25991169)}
    scene.add_capsule("rod", 0.05, 1.0, 1.0, position=(touching, 0, 0), quaternion=q, **motion)
    trajectory = nd.simulate(scene, 1e-2, dt=1e-2)
    # It is pushed flat onto the plate by its flight, which friction does not turn: it lies there at the end.
    assert trajectory.body("rod").position[-1, 0] == pytest.approx(-0.055, abs=1e-9)
    assert nd.check(trajectory)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("turns", [0.4, 1.0, 2.0, 4.0, 16.5])
def test_what_turns_more_than_once_a_step_hits_what_is_in_its_way(turns, free):
    """A blade, free or driven, hits a ball when its leading face is a radius from it, however far it turns a step."""
    scene, dt = nd.Scene(gravity=(0, 0, 0)), 1.0 / 60.0
    spin = 2.0 * math.pi * turns / dt
    if free:
        scene.add_box("blade", (1.0, 0.05, 0.05), 1.0, angular_velocity=(0, 0, spin))
    else:
        scene.add_box("blade", (1.0, 0.05, 0.05), fixed=True)
        scene.set_motion("blade", lambda t: ((0, 0, 0), (0, 0, spin)))
    scene.add_sphere("ball", 0.05, 0.1, position=(0, 0.4, 0))
    contacts = nd.simulate(scene, dt, dt=dt).contacts(1)
    # The impact of free bodies is located; a driven one first pushes in a short move about it.
    expected = math.acos((0.05 + 0.025) / 0.4) / spin
    bar = 1e-8 if free else 0.1
    assert contacts.time[contacts.impulse[:, 0] > 0.0].min() == pytest.approx(expected, rel=bar)
