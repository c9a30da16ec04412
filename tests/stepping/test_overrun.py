"""Contacts whose impulse the motion belies: a corner slips off the face on which it was to land; a body strikes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn._kernels.stepping import active_set, persistence
from nsdyn.collision.detector import Detector
from nsdyn.scene import shapes
from nsdyn.scene.bodies import Geom
from nsdyn.scene.materials import Material
from nsdyn.stepping.move import try_move

HALF = 0.05


def overrun(tilt=4.0, middle=4.0, presses=True, pressed=False, found=0.0):
    """Whether the lower left edge of a cube is left behind by a plate whose border it has reached.

    The cube is `tilt` degrees lower on its right, beyond the border, and `middle` degrees where the impulses act. The
    contact `pressed` in the last move. The bodies are `found` apart where they act and where the move ends.
    """
    both = shapes.box((1.0, 1.0, 0.2)), shapes.box((2.0 * HALF,) * 3)
    geoms = [Geom(str(k), str(k), shape, k, np.eye(3), np.zeros(3), Material()) for k, shape in enumerate(both)]
    detector = Detector(geoms, lambda i, j: (np.zeros(i.size), np.zeros(i.size)))
    names, points, out = np.array([[0], [1], [0], [1], [7]]), np.zeros((4, 1, 3)), np.empty(1, np.bool_)
    points[1, 0] = 0.0, 0.0, 1.0
    contacts, ends = (names, points, np.full((3, 1), found)), []
    for angle in (middle, tilt):
        R = np.array([np.eye(3), Rotation.from_euler("y", angle, degrees=True).as_matrix()])
        ends.append(((np.array([[-0.5, 0.0, -0.1], R[1] @ [HALF, 0.0, HALF]]), R), contacts))
    last, deep = (names[4], np.array([pressed], np.int8)), (np.array([0.1, HALF]), 1e-3)
    given = detector.searches[0], contacts, ends[0][0][1], tuple(ends), last, np.array([presses])
    some = active_set.overrun(*given, deep, out)
    assert some == out[0]
    return some


def test_an_edge_presses_no_longer_on_a_face_that_does_not_separate_the_bodies():
    """4° below the left edge, 0.1 m on, is 7 mm: more than a thousandth of the cube."""
    assert overrun()
    assert not overrun(found=-7e-3)  # they do overlap: the contact is to be found where it strikes
    assert not overrun(found=-6.5e-3) and overrun(found=-6e-3)  # by a tenth more: normals turn where bodies are deep
    assert not overrun(tilt=0.02)  # it lands
    assert not overrun(middle=0.02)  # it slips off after it has pressed


def test_what_pressed_before_or_does_not_press_is_not_left_behind():
    assert not overrun(pressed=True)
    assert not overrun(presses=False)


def test_what_lands_is_not_left_behind():
    assert not overrun(tilt=-4.0, middle=-4.0)


def test_rows_that_strike_foresee_nothing_of_the_motion_before():
    """After an impact bodies turn otherwise. What approaches no faster than its rows turn does not strike."""
    names, closed, h, ahead = np.array([[0], [1], [0], [1], [7]]), 1e-10, 5e-3, 2.5e-3
    drift, nothing = np.array([0.2, -0.1, 0.05]), np.empty(0, np.int64)
    for speed, kept in ((-1.0, False), (-0.1, True)):
        u = np.array([speed, 0.3, 0.0])
        local, end_gap = np.array([u, u + drift, u, drift, np.zeros(3)]), np.array([1e-3 - 0.5 * ahead * drift[0]])
        begin = (names, np.zeros((4, 1, 3)), np.full((3, 1), 1e-3)), np.empty(0), (closed, h, ahead)
        out = np.empty(1, np.bool_), np.empty(1, np.bool_), np.empty(1, np.int8)
        none = np.empty(0), np.empty(0, np.bool_)
        last = nothing, nothing, np.empty(0, np.int8)
        assert not persistence.persists(names, 2, last, begin, none, local, end_gap, False, out)
        np.testing.assert_array_equal(local[3], drift if kept else 0.0)
        assert end_gap[0] == pytest.approx(1e-3 - (0.5 * ahead * drift[0] if kept else 0.0), rel=1e-12)


def test_the_end_of_a_log_does_not_press_while_the_logs_cross_elsewhere(rng):
    """In a captured move: along the normal of that end they overlap where the impulse acts, by up to 9 mm."""
    pressed = 0
    for _ in range(200):
        scene, h = nd.Scene(), 5e-3
        scene.add_capsule("lower", 0.07, 0.8, fixed=True, quaternion=Rotation.from_euler("y", 90, True).as_quat())
        lie = Rotation.from_euler("yz", [0.5 * np.pi + rng.normal(0.0, 0.03), rng.uniform(0.2, 0.8)])
        over = rng.uniform(-0.35, 0.35) * lie.as_matrix()[:, 2] + (0.0, 0.0, rng.uniform(0.13, 0.14))
        thrown = {
            "linear_velocity": (0.5, 0.5, -2) * rng.normal(1.0, 0.5, 3),
            "angular_velocity": rng.normal(0.0, 8.0, 3),
        }
        scene.add_capsule("upper", 0.06, 0.6, 3.0, position=over, quaternion=lie.as_quat(), **thrown)
        stepper = nd.Stepper(scene, h, overlap=0.1)
        s, begin = stepper.system, stepper.get_state().instant
        move = try_move(s.capturing, lambda t: None, begin, 0.0, h, None)
        there = move.mid.state.placement
        _, apart = s.detector.carry(move.kin.contacts, there, there)
        pushes = move.normal_impulses > 0.0
        pressed += pushes.any()
        assert (apart[pushes] > min(apart.max(initial=-np.inf), 0.0) - 1e-3).all()
    assert pressed > 50


@pytest.mark.slow
@pytest.mark.parametrize("seed", [30, 52])
def test_no_corner_of_a_pile_presses_on_the_face_that_it_leaves(seed):
    """Impulses along normals in which boxes of 10 cm overlap by 2 to 7 mm."""
    t = nd.simulate(nd.scenes.load("pile")(seed=seed), 1.0, dt=5e-3, on_fail="ignore")
    (normal,) = (found for found in nd.check(t).findings if found.name == "normal")
    assert normal.passed and normal.looked_at > 1000
