"""Motion of a tree by an audit's own rule: to the tolerance, and no finer than numbers can tell."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, four_bars, hang, limit, lump, pendulum, rod

import nsdyn as nd
from nsdyn.recording import courses, retrace
from nsdyn.scene.articulations import Loop


@pytest.fixture
def mechanism():
    scene = nd.Scene()
    scene.add_model("a", pendulum(2), limits=False)
    return retrace.trees(nd.simulate(scene, 0.01, 5e-3)).mechanisms[0]


@pytest.mark.parametrize("v", [0.0, 1e-17, 1e-9])
def test_what_joint_forces_carry_at_rest_is_found_at_once(mechanism, monkeypatch, v):
    """Of a velocity that is round-off nothing could be found to eleven digits."""
    count, made = [], courses._in_parts
    monkeypatch.setattr(courses, "_in_parts", lambda *given: count.append(1) or made(*given))
    q = np.array([0.5, -0.3])
    course = courses.move(mechanism, q, np.array([v, -v]), 5e-3, mechanism.weight(q))
    assert len(count) <= 3
    np.testing.assert_allclose(course.q, q, rtol=0, atol=1e-10)  # 2 v h, and round-off
    assert np.abs(course.v).max() <= 2 * v + 1e-14


def test_a_fall_is_followed_to_its_tolerance(mechanism):
    """As of eight times as many moves: the energy says so too."""
    q, v, weightless = np.array([1.5, -0.8]), np.array([2.0, -30.0]), mechanism.zero
    whole = courses.move(mechanism, q, v, 0.08, weightless)
    there, speed = q, v
    for _ in range(8):
        part = courses.move(mechanism, there, speed, 0.01, weightless)
        there, speed = part.q, part.v
    np.testing.assert_allclose(whole.q, there, rtol=0, atol=1e-9)
    assert sum(mechanism.energies(whole.q, whole.v)) == pytest.approx(sum(mechanism.energies(q, v)), rel=1e-10)


def test_parts_are_no_more_than_a_smooth_motion_asks_for(mechanism, monkeypatch):
    """What halved parts tell is extrapolated: their fourth order alone took 378 parts."""
    count, made = [], courses._in_parts
    monkeypatch.setattr(courses, "_in_parts", lambda *given: count.append(given[-1]) or made(*given))
    q, v = np.array([1.5, -0.8]), np.array([2.0, -30.0])
    coarse = courses.move(mechanism, q, v, 0.02, mechanism.zero)
    assert sum(count) <= 100  # 90
    monkeypatch.undo()
    fine = made(mechanism, q, v, 0.02, mechanism.zero, 0.0, 1000)
    np.testing.assert_allclose(coarse.q, fine[0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(coarse.v, fine[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(coarse.mean, fine[2], rtol=0, atol=1e-12)


def test_what_needs_many_parts_is_halved(mechanism, monkeypatch):
    q, v = np.array([1.5, -0.8]), np.array([2.0, -30.0])
    whole = courses.move(mechanism, q, v, 0.02, mechanism.zero)
    monkeypatch.setattr(courses, "DOUBLINGS", 2)
    halved = courses.move(mechanism, q, v, 0.02, mechanism.zero)
    for name in ("q", "v", "mean"):
        np.testing.assert_allclose(getattr(halved, name), getattr(whole, name), rtol=0, atol=1e-9)
    assert not np.array_equal(halved.q, whole.q)


def test_what_floats_on_loops_keeps_its_momenta():
    """Two rods on a floating body, and a third between their ends: one step of second order alone errs by 2e-3."""
    model = pin.Model()
    body = hang(model, 0, "body", pin.JointModelFreeFlyer(), lump(3.0, 0.2))
    left = hang(model, body, "left", pin.JointModelRY(), rod((0, 0, -1)))
    between = hang(model, left, "between", pin.JointModelRY(), rod((1, 0, 0)), (0, 0, -1))
    right = hang(model, body, "right", pin.JointModelRY(), rod((0, 0, -1)), (1, 0, 0))
    scene = nd.Scene(gravity=(0, 0, 0))
    add(scene, "swing", limit(model), [Loop("end", between, at((1, 0, 0)), right, at((0, 0, -1)))])
    m = retrace.trees(nd.simulate(scene, 1e-3, 1e-3)).mechanisms[0]
    q, v = pin.neutral(m.model), np.array([0.1, 0.2, 0.3, 0.5, 2.0, 0.7, 3.0, -3.0, 3.0])
    course = courses.move(m, q, v, 0.02)
    states = (q, v), (course.q, course.v)
    momenta = [np.array(pin.computeCentroidalMomentum(m.model, m.data, *state)) for state in states]
    np.testing.assert_allclose(*momenta, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("before", "least", "most"), [(0.02, 1e-9, 1e-4), (1.0, 0.0, 1e-10)])
def test_the_doubt_of_a_motion_on_loops_covers_their_gaps(before, least, most):
    """Near a singular configuration the gaps that a step leaves change velocities by far more than themselves."""
    model, loops, along = four_bars(1)
    scene = nd.Scene()
    add(scene, "bars", model, loops)
    m = retrace.trees(nd.simulate(scene, 1e-3, 1e-3)).mechanisms[0]
    q, v = (np.pi / 2 - before) * along, 4.0 * along
    _, s, Vt = np.linalg.svd(m.constraints(q)[1])
    course, other = courses.move(m, q, v, 1e-3), courses.move(m, q + 1e-12 / s[1] * Vt[1], v, 1e-3)
    off = np.abs(other.v - course.v)
    assert least <= off.max() <= most
    assert (off <= course.doubted[1] + 1e-13).all()
