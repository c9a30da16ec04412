"""Forces to draw: all impulses between keyframes, on the bodies, without corners that fight each other."""

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.view import arrows, viewer
from nsdyn.view.keyframes import nearest


def keyframes(trajectory, fps):
    return nearest(trajectory.t, np.arange(trajectory.t[0], trajectory.t[-1] + 1e-9, 1.0 / fps))


def test_every_bounce_shows():
    """Impacts fall between keyframes: their impulses, over the time between, are the change of momentum."""
    trajectory = nd.simulate(nd.scenes.load("bounce")(), 1.6, dt=1e-3)
    rows = keyframes(trajectory, 30)
    found = arrows.between(trajectory, rows, "pair")
    momentum = trajectory.body("ball").linear_velocity[rows, 2] + 9.81 * trajectory.t[rows]
    bounced = np.flatnonzero(np.abs(np.diff(momentum)) > 1e-6) + 1
    assert len(bounced) == 2 and found.keyframe.tolist() == bounced.tolist()
    length = np.diff(trajectory.t[rows])[bounced - 1]
    np.testing.assert_allclose(found.force[:, 2] * length, np.diff(momentum)[bounced - 1], rtol=1e-9)
    # Seen from where the ball is at the end of the step, which it leaves at up to 4.4 m/s.
    np.testing.assert_allclose(found.point, np.tile((0, 0, -0.1), (2, 1)), rtol=0, atol=4.5e-3)


@pytest.mark.parametrize(("by", "count"), [("pair", 1), ("point", 4)])
def test_a_cube_at_rest_is_carried_and_nothing_more(by, count):
    """Turned by 30°: its corners carry a quarter of the weight each, and do not pull at each other."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    turn = (0, 0, np.sin(np.pi / 12), np.cos(np.pi / 12))
    scene.add_box("cube", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), quaternion=turn)
    trajectory = nd.simulate(scene, 0.2, dt=1e-2)
    found = arrows.between(trajectory, np.array([10, 20]), by)
    # 10 N to the solver's 1e-8 m/s of 1 kg over dt.
    np.testing.assert_allclose(found.force, np.tile((0, 0, 9.81 / count), (count, 1)), rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.point.mean(axis=0), (0, 0, -0.1), rtol=0, atol=1e-5)


def test_points_keep_force_and_torque():
    """Of a box on an edge of its carrier: where equal shares would pull, the impulses stay as they are."""
    scene = nd.Scene()
    scene.add_box("table", (0.2, 0.2, 0.2), position=(0, 0, 0.1), fixed=True)
    scene.add_box("plank", (0.4, 0.2, 0.02), 1.0, position=(0.09, 0, 0.21))
    trajectory = nd.simulate(scene, 0.05, dt=1e-2)
    rows = np.array([0, 5])
    one, each = (arrows.between(trajectory, rows, by) for by in ("pair", "point"))
    np.testing.assert_allclose(each.force.sum(axis=0), one.force[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.force[0], trajectory.force("plank").mean(axis=0), rtol=0, atol=1e-12)
    assert (each.force[:, 2] >= 0.0).all()


def test_forces_of_another_kind_are_refused():
    trajectory = nd.simulate(nd.scenes.load("stack")(height=2), 0.02, dt=1e-2)
    with pytest.raises(ValueError, match=r"did you mean 'pair'\? forces must be one of pair, point; got 'pairs'"):
        viewer.html(trajectory, forces="pairs")
