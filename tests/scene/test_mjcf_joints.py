"""Joints of MJCF files are where MuJoCo has them, and act as they can."""

import numpy as np
import pinocchio as pin
import pytest
from robot_texts import scene_of

import nsdyn as nd


def loaded(tmp_path, body, more="", **options):
    return scene_of(tmp_path, f"<mujoco><worldbody>{body}</worldbody>{more}</mujoco>", **options)


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


HINGE = '<joint name="a" axis="0 1 0" pos=".1 .2 .1" ref="30"/>'
SLIDE = '<joint name="s" type="slide" axis="1 0 1" ref=".4"/>'
LAST = '<joint name="c" axis="0 0 1" pos="0 .2 0" ref="-20"/>'


@pytest.mark.parametrize(
    ("joints", "q", "place", "wxyz", "masses"),
    [
        (
            HINGE + SLIDE + LAST,
            (0.3, -0.2, 0.5),
            (0.4321369332222761, -0.1485672070198934, 0.505827104081807),
            (0.35087955654801944, 0.03939237967423717, -0.10438081426086109, 0.9297507315590053),
            (0.20711261871378336, -0.05181095502613833, 0.051600335722107725, 1, -0.1125223261570164, 7 / 60),
        ),
        (
            SLIDE + HINGE,
            (0.3, -0.2),
            (0.5, 0.02055513067423867, 0.8881379354058391),
            (0.6613297000008891, 0.2502858923246256, -0.2502858923246256, 0.661329700000889),
            (1, 0.08745709088926351, 1 / 12),
        ),
    ],
)
def test_every_joint_of_a_body_has_its_ref(tmp_path, joints, q, place, wxyz, masses):
    """At its `ref` a joint has its body where it is written; elsewhere places and mass matrix are MuJoCo 4.0's."""
    body = (
        f'<body name="b" pos=".5 0 1" euler="0 0 90">{joints}'
        '<geom type="box" size=".1 .2 .3" pos=".3 .1 .2" mass="1"/></body>'
    )
    refs = {"a": np.radians(30), "s": 0.4, "c": np.radians(-20)}
    a = loaded(tmp_path, body).articulations["r"]
    # The round-off of some products of numbers of size 1, on both sides.
    np.testing.assert_allclose(a.q, [refs[name] for name in a.model.names.tolist()[1:]], rtol=0, atol=1e-14)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(pin.SE3ToXYZQUAT(pose(a, "b")), (0.5, 0, 1, 0, 0, half, half), rtol=0, atol=1e-14)
    a = loaded(tmp_path, body, q=q).articulations["r"]
    np.testing.assert_allclose(pose(a, "b").translation, place, rtol=0, atol=1e-14)
    expected = pin.Quaternion(*wxyz).toRotationMatrix()
    np.testing.assert_allclose(pose(a, "b").rotation, expected, rtol=0, atol=1e-14)
    M = np.array(pin.crba(a.model, a.model.createData(), a.q))
    np.testing.assert_allclose(M[np.triu_indices(len(q))], masses, rtol=0, atol=1e-14)


@pytest.mark.parametrize("joint", ['<joint name="j" type="free" armature="1"/>', '<joint name="j" type="free"/>'])
def test_armature_of_free_joints_is_told(tmp_path, joint):
    """A rotor has it, and a free body none: one that spins goes straight on."""
    default = "" if "armature" in joint else '<default><joint armature="1"/></default>'
    body = f'<body name="b">{joint}<geom type="box" size=".1 .1 .1" mass="1"/></body>'
    with pytest.warns(UserWarning, match="'r' leaves out: joint 'j': armature of a free joint"):
        scene = loaded(tmp_path, body, default, v=(1, 0, 0, 0, 0, 3))
    scene.gravity = np.zeros(3)
    assert not scene.articulations["r"].armature.any()
    run = nd.simulate(scene, 1.0, dt=1e-3)
    # Steps of fourth order leave 1.5e-12.
    np.testing.assert_allclose(run.body("r/b").position[-1], (1, 0, 0), rtol=0, atol=1e-11)


def test_armature_of_a_ball_joint_is_inertia(tmp_path):
    """The same about all axes, so that of axes fixed to the body, too: R (I + a) ω stays as it is."""
    body = (
        '<body name="b"><joint name="j" type="ball" armature=".5"/>'
        '<inertial pos="0 0 0" mass="1" diaginertia=".1 .2 .25"/></body>'
    )
    a = (scene := loaded(tmp_path, body, v=(1, 2, 3))).articulations["r"]
    np.testing.assert_array_equal(a.armature, (0.5, 0.5, 0.5))
    run = nd.simulate(scene, 1.0, dt=1e-3)
    inertia = np.array((0.6, 0.7, 0.75))
    turn = pin.Quaternion(run.q[-1]).toRotationMatrix()
    # Steps of fourth order leave 5e-14.
    np.testing.assert_allclose(turn @ (inertia * run.v[-1]), inertia * (1, 2, 3), rtol=0, atol=1e-11)
