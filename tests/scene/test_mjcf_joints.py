"""Joints of MJCF files are where MuJoCo has them, and act as they can."""

import numpy as np
import pinocchio as pin
import pytest

import nsdyn as nd


def loaded(tmp_path, body, more="", **options):
    path, scene = tmp_path / "r.xml", nd.Scene()
    path.write_text(f"<mujoco><worldbody>{body}</worldbody>{more}</mujoco>")
    scene.add_mjcf("r", path, **options)
    return scene


def pose(a, name):
    """Pose of a body of an articulation at its start."""
    data = a.model.createData()
    pin.framesForwardKinematics(a.model, data, a.q)
    return data.oMf[a.model.getFrameId(name, pin.FrameType.BODY)]


TURNED = '<body name="b" pos="1 2 3" euler="0 0 90">{}<geom size=".1"/></body>'
KEY = '<keyframe><key name="home" qpos="2 0 1 1 0 0 0"/></keyframe>'


@pytest.mark.parametrize(
    "joint", ['<freejoint name="j"/>', '<joint name="j" type="free"/>', '<joint name="j" type="free" pos="4 5 6"/>']
)
def test_turned_free_bodies_are_where_the_file_has_them(tmp_path, joint):
    """As it is written, moved, by a keyframe, by the user; the `pos` of a free joint is nothing."""
    half = np.sqrt(0.5)
    for options, place, quaternion in (
        ({}, (1, 2, 3), (0, 0, half, half)),
        ({"position": (0, 0, 1)}, (1, 2, 4), (0, 0, half, half)),
        ({"quaternion": (0, 0, half, half)}, (-2, 1, 3), (0, 0, 1, 0)),
        ({"keyframe": "home"}, (2, 0, 1), (0, 0, 0, 1)),
        ({"q": (5, 6, 7, 0, 0, 0, 1)}, (5, 6, 7), (0, 0, 0, 1)),
    ):
        scene = loaded(tmp_path, TURNED.format(joint), KEY, **options)
        a = scene.articulations["r"]
        # The round-off of some products of numbers below 10.
        np.testing.assert_allclose(a.q, (*place, *quaternion), rtol=0, atol=1e-14)
        np.testing.assert_allclose(pin.SE3ToXYZQUAT(pose(a, "b")), (*place, *quaternion), rtol=0, atol=1e-14)
        np.testing.assert_allclose(nd.simulate(scene, 1e-2, dt=1e-2).body("r/b").position[0], place, rtol=0, atol=1e-14)


def test_free_joints_are_at_the_top_of_the_world(tmp_path):
    with pytest.raises(ValueError, match="body 'b' must be at the top of the world to have a free joint"):
        loaded(tmp_path, f'<body pos="1 0 0">{TURNED.format("<freejoint/>")}</body>')
