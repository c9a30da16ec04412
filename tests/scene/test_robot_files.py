"""Readers of robot files: what they find, what they leave out, and what they refuse."""

import re
import shutil
from pathlib import Path

import fuzz
import numpy as np
import pinocchio as pin
import pytest
from conftest import DATA, INERTIAL
from robot_texts import robot_of, scene_of

import nsdyn as nd
from nsdyn.scene import shapes
from nsdyn.scene.gears import Gear

ROBOT, MJCF, SDF = ((DATA / f"robot.{suffix}").read_text() for suffix in ("urdf", "xml", "sdf"))


def test_urdf(robot):
    path, package_dirs = robot
    scene = nd.Scene()
    with pytest.warns(UserWarning, match=r"'r' leaves out: joint 'ja': velocity of <limit> \(2\)"):
        scene.add_urdf("r", path, package_dirs=package_dirs)
    a = scene.articulations["r"]
    assert a.model.nv == 3 and a.model.nq == 4
    np.testing.assert_array_equal(a.damping, (0.5, 0, 0))
    np.testing.assert_array_equal(a.friction, (0.7, 0, 0))
    np.testing.assert_array_equal(a.armature, np.zeros(3))
    # The continuous joint's (cos, sin) has none.
    np.testing.assert_array_equal(a.model.lowerPositionLimit, (-1, -np.inf, -np.inf, 0))
    np.testing.assert_array_equal(a.model.upperPositionLimit, (2, np.inf, np.inf, 0.4))
    assert [link.name for link in a.links] == ["base_0", "a_0", "a_1", "b_0", "c_0", "tip_0"]
    assert [link.joint for link in a.links] == [0, 1, 1, 2, 3, 3]
    kinds = [shapes.POLYTOPE, shapes.CAPSULE, shapes.SPHERE, shapes.CYLINDER, shapes.POLYTOPE, shapes.SPHERE]
    assert [link.shape.kind for link in a.links] == kinds
    capsule, mesh, tip = a.links[1], a.links[4], a.links[5]
    np.testing.assert_allclose(capsule.shape.size, (0.1, 0.15, 0))
    np.testing.assert_allclose(capsule.placement.translation, (0, 0, 0.5))
    np.testing.assert_allclose(capsule.placement.rotation, pin.rpy.rpyToMatrix(0, 0.3, 0), rtol=0, atol=1e-15)
    # Scaled and mirrored in y; the origin of a shape is its centroid. The file holds float32.
    np.testing.assert_allclose(np.ptp(mesh.shape.vertices, axis=0), (0.1, 0.4, 0.3), rtol=1e-6)
    np.testing.assert_allclose(mesh.placement.translation, (0.05, -0.2, 0.15), rtol=1e-6)
    np.testing.assert_allclose(tip.placement.translation, (0, 0, 2))
    assert a.report == ("joint 'ja': velocity of <limit> (2)", "robot 'r': <transmission>")
    assert a.gears == (Gear("mimic of 'jc'", 0, 2, 1.0, 0.0),)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot name='r'><link", r"r\.urdf could not be read"),
        ("<sdf/>", "its root is <sdf>, not <robot>"),
        ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/></robot>', "xacro"),
        ('<robot name="r"><link name="a"><collision><geometry><cone/></geometry></collision></link></robot>', "<cone>"),
        ('<robot name="r"><link name="a"><collision/></link></robot>', "<geometry> must hold one shape"),
        (
            ROBOT.replace('sphere radius="0.1"', 'sphere radius="x"'),
            "radius of <sphere> must be a number, got 'x'",
        ),
        (ROBOT.replace("sphere radius", "sphere diameter"), "radius of <sphere> is missing"),
        (
            '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
            '<child link="b"/><axis xyz="0 0 1"/></joint></robot>',
            "'r' has a singular mass matrix: give the bodies moved by joint 'j'",
        ),
    ],
)
def test_bad_files(tmp_path, text, words):
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_urdf("r", path)


ARM = f"""<robot name="r"><link name="base"/><link name="arm">{INERTIAL}
<collision><geometry><box size="1 1 1"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="0.5" upper="1" effort="2" velocity="0"/></joint></robot>"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass value="1"', 'mass value="nan"', "mass of link 'arm' must be a number, got 'nan'"),
        ('mass value="1"', 'mass value="-1"', "mass of link 'arm' must not be negative, got -1"),
        ('<mass value="1"/>', "", "mass of link 'arm' is missing"),
        ('izz=".1"', 'izz="inf"', "izz of link 'arm' must be a number, got 'inf'"),
        ('izz=".1"', "", "izz of link 'arm' is missing"),
        ('izz=".1"', 'izz="5"', "inertia of link 'arm' is not that of a body: .* break the triangle inequality"),
        ('izz=".1"', 'izz="-.1"', "inertia of link 'arm' is not that of a body: .* are not all positive"),
        ('parent link="base"', 'parent link="bse"', r"did you mean 'base'\? parent of joint 'j' must be one of .*"),
        ('parent link="base"', 'parent link="arm"', r"\['arm'\] hang on each other in a circle"),
        ('<link name="base"/>', '<link name="base"/><link name="x"/>', "hang on one root by joints, got .*'x'"),
        ('name="r"', "", "No name given for the robot"),
        ('type="revolute"', 'type="hinge"', r"Joint \[j\] has no known type \[hinge\]"),
        ('value="1"', 'value="${m}"', "has xacro macros: expand them first"),
        ("<link", "<xacro:link", "has xacro macros: expand them first"),
        ('<box size="1 1 1"/>', '<mesh filename=""/>', "collision of 'arm': <mesh> names no file"),
        ('<box size="1 1 1"/>', '<mesh filename="empty.stl"/>', r"collision of 'arm': .*empty\.stl .* it is empty"),
        (
            '<box size="1 1 1"/>',
            '<mesh filename="none.stl"/>',
            r"collision of 'arm': .*none\.stl .* it has no triangles",
        ),
    ],
)
def test_bad_urdf_is_told_in_one_line_with_its_culprit(tmp_path, capfd, old, new, words):
    assert old in ARM
    (tmp_path / "empty.stl").touch()
    (tmp_path / "none.stl").write_bytes(bytes(84))
    with pytest.raises(ValueError, match=words) as failure:
        scene_of(tmp_path, ARM.replace(old, new), clip=True)
    assert "\n" not in str(failure.value)
    assert capfd.readouterr() == ("", ""), "the libraries print nothing"


def test_inertias_can_be_trusted(tmp_path):
    text = ARM.replace('izz=".1"', 'izz="5"')
    with pytest.warns(UserWarning, match="'r' leaves out: inertia of link 'arm' is not that of a body"):
        a = robot_of(tmp_path, text, clip=True, inertias="trust")
    assert a.model.inertias[1].inertia[2, 2] == 5.0
    with pytest.raises(ValueError, match=r"inertias of 'r' must be one of check, trust; got 'trsut'"):
        scene_of(tmp_path, text, inertias="trsut")
    with pytest.raises(ValueError, match=r"inertias of 'm' must be one of check, trust; got 'chekc'"):
        nd.Scene().add_model("m", pin.buildSampleModelManipulator(), inertias="chekc")


def test_thin_and_rounded_inertias_are_sound(tmp_path):
    """A rod without a moment about its axis, a plate whose sum is rounded to two digits."""
    for x, y, z in ((0.0, 0.1, 0.1), (0.33, 0.33, 0.665)):
        text = ARM.replace('ixx=".1" iyy=".1" izz=".1"', f'ixx="{x}" iyy="{y}" izz="{z}"')
        scene_of(tmp_path, text, clip=True)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ('<inertial pos="0 0 0" mass="-1" diaginertia="1 1 1"/>', "mass of body 'b' must not be negative"),
        ('<inertial pos="0 0 0" mass="1" diaginertia="1 1 3"/>', "inertia of body 'b' is not that of a body"),
        ('<inertial pos="0 0 0" mass="1" fullinertia="1 1 1 2 0 0"/>', "inertia of body 'b' is not that of a body"),
        ('<geom size=".1" density="nan"/>', "density of body 'b' must be a number, got 'nan'"),
    ],
)
def test_bad_inertias_of_mjcf(tmp_path, body, words):
    with pytest.raises(ValueError, match=words):
        scene_of(tmp_path, f'<mujoco><worldbody><body name="b"><joint/>{body}</body></worldbody></mujoco>')


def test_bad_inertia_of_sdf(tmp_path):
    for old, new, words in (
        ("<mass>2<", "<mass>-2<", "mass of link 'base' must not be negative"),
        ("<izz>0.15<", "<izz>1.5<", "inertia of link 'base' is not that of a body"),
    ):
        text = f"<sdf version='1.9'><model name='m'><link name='base'>{sdf_inertial(2)}</link></model></sdf>"
        assert old in text
        with pytest.raises(ValueError, match=words):
            scene_of(tmp_path, text.replace(old, new))


def test_friction_of_mjcf_geoms_is_applied(tmp_path):
    """Sliding friction of geoms and of their class; the user's material wins."""
    text = (
        '<mujoco><default><default class="c"><geom friction="0.7"/></default></default><worldbody>'
        '<body name="b"><joint/><geom name="g" size=".1" friction="0.3 0.01 0.001"/><geom class="c" size=".1"/>'
        '<geom size=".1"/><geom size=".1" condim="1"/><geom size=".1" condim="4"/></body></worldbody></mujoco>'
    )
    with pytest.warns(UserWarning, match="geom 'b_4': friction of spinning and rolling"):
        own, user = robot_of(tmp_path, text), robot_of(tmp_path, text, material=nd.Material(0.1))
    assert [link.material.mu for link in own.links] == [0.3, 0.7, nd.Material().mu, 0.0, nd.Material().mu]
    assert {link.material.mu for link in user.links} == {0.1}
    with pytest.raises(ValueError, match="friction of geom 'b_1' must be a number, got 'much'"):
        scene_of(tmp_path, text.replace('friction="0.7"', 'friction="much"'))


def test_friction_of_sdf_collisions_is_applied(tmp_path):
    surface = "<surface><friction><ode><mu>0.2</mu><mu2>0.1</mu2></ode></friction></surface>"
    box = "<geometry><box><size>1 1 1</size></box></geometry>"
    text = (
        f"<sdf version='1.9'><model name='m'><link name='b'>{sdf_inertial(2)}<collision name='c'>{box}{surface}"
        f"</collision><collision name='d'>{box}</collision></link></model></sdf>"
    )
    with pytest.warns(UserWarning, match="collision 'c': friction across that is not that along"):
        a = robot_of(tmp_path, text)
    assert [link.material.mu for link in a.links] == [0.2, nd.Material().mu]


@pytest.mark.parametrize(("effort", "expected"), [("2", 2.0), ("0", np.inf)])
def test_limits_of_joints(tmp_path, effort, expected):
    """Efforts are read, 0 for none; velocities are warned of."""
    a = robot_of(tmp_path, ARM.replace('effort="2"', f'effort="{effort}"'), clip=True)
    np.testing.assert_array_equal(a.effort, [expected])
    with pytest.warns(UserWarning, match=r"'r' leaves out: joint 'j': velocity of <limit> \(1\)"):
        scene_of(tmp_path, ARM.replace('velocity="0"', 'velocity="3"'), clip=True)


def test_a_limit_without_bounds_locks_its_joint(tmp_path):
    """As the format says, but seldom as meant."""
    with pytest.warns(UserWarning, match="joint 'j': its motion, since a <limit> without lower and upper is from 0 to"):
        scene_of(tmp_path, re.sub(r' (lower|upper)="[^"]*"', "", ARM))


def test_bad_mass_of_a_model():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "j")
    model.inertias[joint] = pin.Inertia(np.nan, np.zeros(3), np.eye(3))
    with pytest.raises(ValueError, match="mass and inertia of joint 'j' of 'r' must be finite"):
        nd.Scene().add_model("r", model)


@pytest.fixture
def mjcf(tmp_path):
    """A file with three trees, classes, an included file, a mesh, loops, masks and a keyframe."""
    (tmp_path / "box.stl").write_bytes(fuzz.binary_stl())
    shutil.copy(DATA / "assets.xml", tmp_path)
    return Path(shutil.copy(DATA / "robot.xml", tmp_path))


def loaded_mjcf(path, **keywords):
    scene = nd.Scene()
    with pytest.warns(UserWarning, match="'m' leaves out: joint 'jc': range of a ball joint; option"):
        scene.add_mjcf("m", path, **keywords)
    return scene.articulations["m"]


def test_mjcf(mjcf):
    a = loaded_mjcf(mjcf)
    inf = np.inf
    # Free base, hinge ja, slide jb, ball jc, hinges jd1 and jd2, free body, hinge je.
    lower = [-inf] * 7 + [np.radians(-30), -0.1] + [-inf] * 14
    upper = [inf] * 7 + [np.radians(60), 0.2] + [inf] * 14
    np.testing.assert_allclose(a.model.lowerPositionLimit, lower, rtol=1e-15)
    np.testing.assert_allclose(a.model.upperPositionLimit, upper, rtol=1e-15)
    np.testing.assert_array_equal(a.damping, [0] * 6 + [0.3, 0.3, 0.4, 0.4, 0.4, 0.3, 0.3] + [0] * 6 + [0.3])
    np.testing.assert_array_equal(a.friction, [0] * 7 + [0.2] + [0] * 12)
    np.testing.assert_array_equal(a.armature, [0] * 6 + [0.01] * 7 + [0] * 6 + [0.01])
    np.testing.assert_array_equal(a.stiffness, [0] * 7 + [5] + [0] * 4 + [2] + [0] * 7)
    np.testing.assert_allclose(a.rest, [0] * 7 + [0.1] + [0] * 4 + [np.pi / 2] + [0] * 7, rtol=1e-15)
    names = [(link.name, link.joint) for link in a.links]
    assert names == [("t", 1), ("ga", 2), ("gb", 3), ("gc", 4), ("d_0", 6), ("g2", 7), ("ge", 8)]
    assert [(body.name, body.shape.kind) for body in a.fixed] == [("m/floor", shapes.HALFSPACE)]
    assert a.missing == ("joint 'jc': range of a ball joint",)
    (linked,) = a.gears  # of "joint2": the angle of ja is the length of jb
    assert linked == Gear("ja", 7, 6, 1.0, np.radians(10.0))
    assert a.dropped == ("option: gravity", "contact: <pair> of 'ga' and 'gb'")
    assert a.unused == (
        "mujoco: <sensor>",
        "worldbody 'world': <light>",
        "keyframe 'home'",
    )
    assert a.report == (*a.missing, *a.dropped, *a.unused)


SEVERAL = """<mujoco><compiler angle="radian"/><worldbody><body name="b" pos="0 0 1" euler="0.2 0 0.3">
<joint name="x" type="slide" axis="1 0 0" pos=".1 0 0"/><joint axis="0 1 1" pos="0 .2 0"/>
<joint name="y" type="slide" axis="0 1 0" range="-1 2" armature=".1"/><geom name="g" size=".1"/>
<body name="c" pos=".1 .2 .15"><joint name="u" type="slide"/><joint name="w" type="ball"/><geom name="h" size=".1"/>
</body></body></worldbody></mujoco>"""


def test_several_joints_of_one_mjcf_body_are_joints_by_their_names(tmp_path):
    """They move as the one that Pinocchio makes of them, can be driven, geared and asked for, and join both bodies."""
    scene = scene_of(tmp_path, SEVERAL, "m")
    a = scene.articulations["m"]
    assert list(a.model.names)[1:] == ["x", "joint1", "y", "u", "w"]
    assert [(link.name, link.joint) for link in a.links] == [("g", 3), ("h", 5)]
    assert a.excluded == {(0, 1)}  # they overlap
    np.testing.assert_array_equal(a.model.upperPositionLimit[:4], (np.inf, np.inf, 2, np.inf))
    theirs = pin.buildModelFromMJCF(str(tmp_path / "m.mjcf"))
    theirs.armature = a.model.armature
    rng, own, other = np.random.default_rng(0), a.model.createData(), theirs.createData()
    q, v = pin.integrate(a.model, a.q, rng.normal(size=7)), rng.normal(size=7)
    np.testing.assert_allclose(  # of 1 kg and 1 m
        pin.rnea(a.model, own, q, v, v), pin.rnea(theirs, other, q, v, v), rtol=0.0, atol=1e-12
    )
    np.testing.assert_allclose(own.oMi[5].homogeneous, other.oMi[2].homogeneous, rtol=0.0, atol=1e-14)
    scene.set_motion("m/y", velocity=0.5)
    scene.add_gear("m", "x", "u", 2.0)
    run = nd.simulate(scene, 0.1, dt=1e-2)
    assert run.joint("m/y").position[-1] == pytest.approx(0.05, abs=1e-14)
    # What closes gears leaves of lengths of 0.1 m.
    np.testing.assert_allclose(run.joint("m/u").position, 2.0 * run.joint("m/x").position, rtol=0.0, atol=1e-12)
    assert nd.check(run).passed, nd.check(run)


def test_mjcf_names_every_attribute_it_leaves_out(tmp_path):
    text = (
        '<mujoco><option density="1.2" wind="0 0 0" timestep="0.01"><flag contact="disable"/></option>'
        '<worldbody><body><joint springdamper="1 1" margin=".1" actuatorfrcrange="-1 2"/>'
        '<geom size=".1" friction="2 0 0" solref=".01 1"/>'
        '<geom size=".1" friction="1 0 0"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.warns(UserWarning, match="'m' leaves out: option: density; flag: contact"):
        a = robot_of(tmp_path, text, "m")
    assert a.report == (
        "option: density",
        "flag: contact",
        "body 'body0': springdamper of <joint>",
        "body 'body0': margin of <joint>",
        "body 'body0': solref of <geom>",
        "joint None: actuatorfrcrange, but for ±2",
        "option: timestep",
    )


def test_mjcf_masks_and_exclusions(mjcf):
    a = loaded_mjcf(mjcf)
    names = [*(link.name for link in a.links), "floor"]
    pairs = {frozenset((names[i], names[j])) for i, j in a.excluded}
    assert frozenset(("t", "gb")) in pairs, "<exclude>"
    assert {frozenset(("gc", n)) for n in names if n != "gc"} <= pairs, "masks 2 and 4 meet no 1"
    assert frozenset(("floor", "t")) not in pairs and frozenset(("g2", "floor")) not in pairs
    assert frozenset(("floor", "ge")) not in pairs, "a hinge to the world does not keep a body off its geoms"
    assert frozenset(("t", "ga")) in pairs and frozenset(("ga", "gb")) in pairs, "joined by joints"


def test_mjcf_loops(mjcf):
    """Both are closed where the file puts the bodies; the connect at its anchor."""
    a = loaded_mjcf(mjcf)
    data = a.model.createData()
    pin.framesForwardKinematics(a.model, data, a.q)
    assert [(c.name, c.joint1, c.joint2, c.kind) for c in a.loops] == [
        ("loop", 3, 4, "point"),
        ("weld1", 2, 6, "frame"),
    ]
    point, weld = a.loops
    body = data.oMf[a.model.getFrameId("b", pin.FrameType.BODY)]
    np.testing.assert_allclose(
        (data.oMi[3] * point.placement1).translation, body.act(np.array([0, 0, 0.1])), rtol=0, atol=1e-15
    )
    np.testing.assert_allclose(
        (data.oMi[3] * point.placement1).translation, (data.oMi[4] * point.placement2).translation, rtol=0, atol=1e-15
    )
    assert (data.oMi[2] * weld.placement1).isApprox(data.oMi[5] * weld.placement2, 1e-14)


def test_weld_with_relpose_and_anchor(tmp_path):
    """`relpose` says where the anchor, a point of the second body, and its axes are in the first, as for MuJoCo."""
    bodies = (
        '<body name="a" pos="0 0 1"><joint axis="0 1 0"/><geom size=".1"/></body>'
        '<body name="c" pos=".5 -.2 1" euler="0 0 90"><freejoint/><geom size=".1"/></body>'
    )
    weld = '<weld body1="a" body2="c" anchor=".2 0 0" relpose=".5 0 0 1 0 0 1"/>'
    a = robot_of(tmp_path, f"<mujoco><worldbody>{bodies}</worldbody><equality>{weld}</equality></mujoco>")
    (loop,) = a.loops
    np.testing.assert_array_equal(loop.placement1.translation, (0.5, 0, 0))
    np.testing.assert_array_equal(loop.placement2.translation, (0.2, 0, 0))
    data = a.model.createData()
    pin.forwardKinematics(a.model, data, a.q)
    assert (data.oMi[loop.joint1] * loop.placement1).isApprox(data.oMi[loop.joint2] * loop.placement2, 1e-14)


def test_mjcf_keyframe(mjcf):
    a = loaded_mjcf(mjcf, keyframe="home")
    # Quaternions of the file are w x y z.
    expected = [0, 0, 2, 0, 0, 0.8, 0.6, 0.3, 0.05, 0, 0.8, 0, 0.6, 0.1, 0.2, 2, 0, 3, 0, 0, 0, 1, 0.5]
    np.testing.assert_allclose(a.q, expected, rtol=0, atol=1e-15)
    with pytest.raises(ValueError, match="keyframe must be one of home; got 'away'"):
        nd.Scene().add_mjcf("m", mjcf, keyframe="away")


def test_mjcf_against_mujoco(mjcf, rng):
    """Mass matrix and bias at a random state, and what acts in the joints, against MuJoCo's own reading."""
    mujoco = pytest.importorskip("mujoco", reason="the extra 'peers' is not installed")
    a = loaded_mjcf(mjcf)
    theirs = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(theirs)
    v = rng.normal(size=a.model.nv)
    q = pin.integrate(a.model, a.q, 0.2 * v)
    # Free joints: MuJoCo has w first and the linear velocity in world axes.
    turn = np.eye(a.model.nv)
    data.qpos[:], placed = q, a.model.createData()
    pin.forwardKinematics(a.model, placed, q)
    for start in (3, 9, 18):
        data.qpos[start : start + 4] = np.roll(q[start : start + 4], 1)
    for joint, start in ((1, 0), (7, 13)):
        turn[start : start + 3, start : start + 3] = placed.oMi[joint].rotation.T
    data.qvel[:] = np.linalg.solve(turn, v)
    data.qvel[[0, 1, 2, 13, 14, 15]] = 0.0
    v = turn @ data.qvel
    mujoco.mj_forward(theirs, data)
    M = np.zeros((theirs.nv, theirs.nv))
    mujoco.mj_fullM(theirs, data, M)
    np.testing.assert_allclose(turn.T @ pin.crba(a.model, placed, q) @ turn, M, rtol=0, atol=1e-13)
    a.model.gravity = pin.Motion(np.array([0, 0, -9.0]), np.zeros(3))
    bias = pin.nonLinearEffects(a.model, placed, q, v)
    np.testing.assert_allclose(turn.T @ bias, data.qfrc_bias, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.damping, theirs.dof_damping.ravel()[: a.model.nv])
    np.testing.assert_allclose(a.friction, theirs.dof_frictionloss)
    np.testing.assert_allclose(a.armature, theirs.dof_armature)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<mujoco", "could not be read"),
        ("<robot/>", "its root is <robot>, not <mujoco>"),
        ("<mujoco/>", "it has no <worldbody>"),
        ('<mujoco><worldbody><replicate count="2"/></worldbody></mujoco>', "body 'world' has a <replicate>"),
        ('<mujoco><include file="gone.xml"/></mujoco>', "path of 'm' must be a file in MJCF"),
        (f'<mujoco><include file="{"a" * 5000}"/></mujoco>', "path of 'm' must be a file in MJCF"),
        ('<mujoco><worldbody><body><joint class="x"/></body></worldbody></mujoco>', "class 'x' of a <joint>"),
        (
            '<mujoco><worldbody><body><joint range="1"/><geom size="1"/></body></worldbody></mujoco>',
            "could not be read",
        ),
        (MJCF.replace("0 0 2 .6", "2 .6"), "qpos of keyframe 'home' must be 23 numbers"),
        (MJCF.replace('body2="c"', 'body2="z"'), "equality 'loop' joins .* which are not both bodies or sites"),
    ],
)
def test_bad_mjcf(mjcf, text, words):
    mjcf.write_text(text)
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_mjcf("m", mjcf, keyframe="home")


def sdf_inertial(mass, xyz="0 0 0"):
    return (
        f"<inertial><pose>{xyz} 0 0 0.3</pose><mass>{mass}</mass>"
        "<inertia><ixx>0.1</ixx><iyy>0.2</iyy><izz>0.15</izz><ixy>0.01</ixy></inertia></inertial>"
    )


@pytest.fixture
def sdf(robot, tmp_path):
    return Path(shutil.copy(DATA / "robot.sdf", tmp_path)), robot[1]


def test_sdf_warns_of_what_changes_the_motion(tmp_path):
    link = "<gravity>{}</gravity><kinematic>false</kinematic><velocity_decay><linear>1</linear></velocity_decay>"
    text = (
        '<sdf version="1.9"><world name="w"><physics type="ode"/><model name="m"><enable_wind>true</enable_wind>'
        f'<link name="a">{link.format("false")}</link><link name="b">{link.format("true")}</link>'
        '<joint name="j" type="revolute"><parent>a</parent><child>b</child><axis><xyz>0 0 1</xyz><limit>'
        "<stiffness>1</stiffness></limit></axis></joint></model></world></sdf>"
    )
    with pytest.warns(UserWarning, match="'m' leaves out: model 'm': <enable_wind>; link 'a': <gravity>"):
        a = robot_of(tmp_path, text, "m")
    assert a.report == (
        "model 'm': <enable_wind>",
        "link 'a': <gravity>",
        "link 'a': <linear> of <velocity_decay> (2)",
        "joint 'j': <stiffness> of <limit>",
        "world 'w': <physics>",
    )


def test_sdf(sdf):
    path, package_dirs = sdf
    scene = nd.Scene()
    with pytest.warns(UserWarning, match="'m' leaves out: collision 'h' of link 'a': its shape"):
        scene.add_sdf("m", path, package_dirs)
    a = scene.articulations["m"]
    assert list(a.model.names) == ["universe", "base_free", "ja", "jb", "jc"]
    inf = np.inf
    np.testing.assert_array_equal(a.model.lowerPositionLimit, [-inf] * 7 + [-1, -inf] + [-inf] * 4)
    np.testing.assert_array_equal(a.model.upperPositionLimit, [inf] * 7 + [2, 0.4] + [inf] * 4)
    for values, first in ((a.damping, 0.5), (a.friction, 0.7), (a.stiffness, 3), (a.rest, 0.2)):
        np.testing.assert_array_equal(values, [0] * 6 + [first] + [0] * 4)
    assert [(k.name, k.joint) for k in a.links] == [("base_0", 1), ("a_0", 2), ("b_0", 3), ("tip_0", 3)]
    kinds = [shapes.POLYTOPE, shapes.CAPSULE, shapes.POLYTOPE, shapes.ELLIPSOID]
    assert [k.shape.kind for k in a.links] == kinds
    assert a.report == (
        "collision 'h' of link 'a': its shape",
        "model 'm': <plugin>",
        "visual of link 'a': <geometry> must hold one shape",
    )
    # Where the file puts the links, by its own chain of frames.
    data = a.model.createData()
    pin.framesForwardKinematics(a.model, data, a.q)
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 2.0, 3.0]))
    mount = base * pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.array([0, 0, 1.0]))
    link_a = mount * pin.SE3(np.eye(3), np.array([0, 0, 0.5]))
    link_b = link_a * pin.SE3(np.eye(3), np.array([0, 0.1, 0.7]))
    tip = link_b * pin.SE3(pin.Quaternion(0.8, 0, 0.6, 0).toRotationMatrix(), np.array([0, 0, 0.2]))
    for name, pose in (("base", base), ("a", link_a), ("b", link_b), ("tip", tip)):
        assert data.oMf[a.model.getFrameId(name, pin.FrameType.BODY)].isApprox(pose, 1e-14), name
    # The axis of ja is the model's z; its point lies 0.1 below the origin of a.
    J = pin.computeFrameJacobian(
        a.model, data, a.q, a.model.getFrameId("a", pin.FrameType.BODY), pin.LOCAL_WORLD_ALIGNED
    )[:, 6]
    np.testing.assert_allclose(J[3:], base.rotation[:, 2], rtol=0, atol=1e-14)
    np.testing.assert_allclose(J[:3], np.cross(base.rotation[:, 2], 0.1 * link_a.rotation[:, 2]), rtol=0, atol=1e-14)
    assert pin.computeTotalMass(a.model) == pytest.approx(5.1, rel=1e-15)


def four_bar_sdf(closing):
    """A planar four-bar of rods of 1 m; `closing` is the type of the joint that makes it a loop."""
    rods = ((0, 0.5, 0), (0.5, 1, np.pi / 2), (1, 0.5, 0))
    links = "".join(
        f'<link name="rod{k}"><pose>{x} 0 {z} 0 {turn} 0</pose>{sdf_inertial(1)}</link>'
        for k, (x, z, turn) in enumerate(rods)
    )
    ends = (
        ("world", "rod0", "0 0 -0.5", "revolute"),
        ("rod0", "rod1", "0 0 -0.5", "revolute"),
        ("rod1", "rod2", "0 0 0.5", "revolute"),
        ("world", "rod2", "0 0 -0.5", closing),
    )
    joints = "".join(
        f'<joint name="j{k}" type="{kind}"><parent>{parent}</parent><child>{child}</child><pose>{pose} 0 0 0</pose>'
        "<axis><xyz>0 1 0</xyz></axis></joint>"
        for k, (parent, child, pose, kind) in enumerate(ends)
    )
    return f'<sdf version="1.9"><model name="m">{links}{joints}</model></sdf>'


@pytest.mark.parametrize(("closing", "nv"), [("revolute", 4), ("fixed", 3)])
def test_sdf_loop(tmp_path, closing, nv):
    """The rod with two parents is cut in halves that a loop welds; the mass is that of the file."""
    a = robot_of(tmp_path, four_bar_sdf(closing))
    (loop,) = a.loops
    assert a.model.nv == nv and loop.kind == "frame"
    assert pin.computeTotalMass(a.model) == pytest.approx(3 - 0.5 * (closing == "fixed"), rel=1e-15)
    data = a.model.createData()
    pin.forwardKinematics(a.model, data, a.q)
    assert (data.oMi[loop.joint1] * loop.placement1).isApprox(data.oMi[loop.joint2] * loop.placement2, 1e-14)


def test_sdf_against_urdf(robot, tmp_path, rng):
    """The same two-link arm in both formats: mass matrix and bias at a random state."""
    arm = (nd.scenes.folder() / "arm.urdf").read_text()
    assert 'name="shoulder"' in arm
    path = tmp_path / "arm.sdf"
    path.write_text(
        """<sdf version="1.9"><model name="arm"><link name="base"/>
        <link name="upper"><pose>0 0 .1 0 0 0</pose><inertial><pose>.2 0 0 0 0 0</pose><mass>2</mass>
          <inertia><ixx>.002</ixx><iyy>.03</iyy><izz>.03</izz></inertia></inertial></link>
        <link name="fore"><pose relative_to="upper">.4 0 0 0 0 0</pose><inertial><pose>.2 0 0 0 0 0</pose><mass>1</mass>
          <inertia><ixx>.001</ixx><iyy>.015</iyy><izz>.015</izz></inertia></inertial></link>
        <link name="hand"><pose relative_to="fore">.4 0 0 0 0 0</pose><inertial><mass>.5</mass>
          <inertia><ixx>.0005</ixx><iyy>.0005</iyy><izz>.0005</izz></inertia></inertial></link>
        <joint name="hold" type="fixed"><parent>world</parent><child>base</child></joint>
        <joint name="shoulder" type="revolute"><parent>base</parent><child>upper</child>
          <axis><xyz>0 0 1</xyz></axis></joint>
        <joint name="elbow" type="revolute"><parent>upper</parent><child>fore</child>
          <axis><xyz>0 0 1</xyz></axis></joint>
        <joint name="wrist" type="fixed"><parent>fore</parent><child>hand</child></joint></model></sdf>"""
    )
    scene = nd.Scene(gravity=(1, 2, 3))
    scene.add_sdf("sdf", path)
    scene.add_urdf("urdf", nd.scenes.folder() / "arm.urdf")
    q, v = rng.normal(size=(2, 2))
    M, bias = [], []
    for a in scene.articulations.values():
        M.append(pin.crba(a.model, a.model.createData(), q))
        bias.append(pin.nonLinearEffects(a.model, a.model.createData(), q, v))
    np.testing.assert_allclose(M[0], M[1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(bias[0], bias[1], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<sdf", "could not be read"),
        ("<robot/>", "its root is <robot>, not <sdf>"),
        ("<sdf/>", r"it must hold one model, got \[\]"),
        ("<sdf><model/><model/></sdf>", "it must hold one model"),
        ("<sdf><model/></sdf>", "it has no <link>"),
        ("<sdf><model><link name='a'/><include/></model></sdf>", "a <include> inside the model"),
        (SDF.replace('"prismatic"', '"screw"'), "joint 'jb' is of type 'screw'"),
        (SDF.replace("<child>b</child>", "<child>z</child>"), "joint 'jb' names 'z', which is no link"),
        (SDF.replace('relative_to="b"', 'relative_to="z"'), "frame 'z' is not defined"),
        (
            SDF.replace('attached_to="base"', 'attached_to="a"'),
            "frame 'a' hangs on itself|frame 'mount' hangs on itself",
        ),
        (SDF.replace("<xyz>0 1 0</xyz>", "<xyz>0 0 0</xyz>"), "axis of joint 'jb' must not be zero"),
        (SDF.replace("<mass>1.5</mass>", "<mass>heavy</mass>"), "mass of link 'b' must be a number, got 'heavy'"),
        (SDF.replace("<lower>-1</", "<lower>3</"), "limits of 'm': joint 'ja' has lower 3 above upper 2"),
        (
            "<sdf><model><link name='a'/><link name='b'/>"
            "<joint name='j' type='fixed'><parent>a</parent><child>b</child></joint>"
            "<joint name='k' type='fixed'><parent>b</parent><child>a</child></joint></model></sdf>",
            "hang on each other in a circle",
        ),
    ],
)
def test_bad_sdf(sdf, text, words):
    path, package_dirs = sdf
    path.write_text(text)
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_sdf("m", path, package_dirs)


# One line each: those whose zero configuration is sound, outside limits, with links in each other, all of it.
ROBOTS = {
    "quadruped_description/urdf/quadruped.urdf": {},
    "human_description/robots/human.urdf": {},
    "double_pendulum_description/urdf/double_pendulum_simple.urdf": {},
    "iris_description/robots/iris_simple.urdf": {},
    "a1_description/urdf/a1.urdf": {"clip": True},
    "simple_humanoid_description/urdf/simple_humanoid.urdf": {"clip": True},
    "laikago_description/urdf/laikago.urdf": {"clip": True},
    "solo_description/robots/solo12.urdf": {"self_collisions": "apart"},
    "hextilt_description/urdf/hextilt_flying_arm_5.urdf": {"self_collisions": "apart"},
    "anymal_b_simple_description/robots/anymal.urdf": {"self_collisions": "apart", "inertias": "trust"},
    "hyq_description/robots/hyq_no_sensors.urdf": {"clip": True, "self_collisions": "apart", "inertias": "trust"},
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:'r")
@pytest.mark.parametrize("name", ROBOTS)
def test_robots_of_example_robot_data_load_and_move(share, name):
    path, needed = share / "example-robot-data/robots" / name, ROBOTS[name]
    scene = nd.Scene()
    scene.add_urdf("r", path, base="free", package_dirs=[share], **needed)
    step = nd.Stepper(scene).step()
    assert step.solution.accepted and np.isfinite(step.v).all()
    for option in needed:  # each is needed
        with pytest.raises(ValueError, match=option):
            bare = nd.Scene()
            bare.add_urdf("r", path, base="free", package_dirs=[share], **{k: needed[k] for k in needed if k != option})
            nd.Stepper(bare)


@pytest.mark.parametrize(
    ("axis", "place"),
    [
        ("", (0, 0.2, -0.3)),
        ('<axis xyz="0 0 2"/>', (0.3, 0.2, 0)),
        ('<axis xyz="0 0 -1"/>', (0.3, -0.2, 0)),
        ('<axis xyz="0 1 0"/>', (0.3, 0, -0.2)),
    ],
)
def test_planar_joints_of_urdf_move_across_their_axis(tmp_path, axis, place):
    """It is x by default, as URDF has it; along the plane as in MuJoCo, which turns z onto it the shortest way."""
    inertial = INERTIAL.format(2).replace("<mass", '<origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/><mass')
    text = (
        f'<robot name="r"><link name="w"/><link name="a">{inertial}</link><joint name="j" type="planar">'
        f'<origin xyz="1 2 3"/><parent link="w"/><child link="a"/>{axis}</joint></robot>'
    )
    model = robot_of(tmp_path, text).model
    data, frame = model.createData(), model.getFrameId("a")
    pin.framesForwardKinematics(model, data, np.array([0.3, 0.2, 1.0, 0.0]))
    # The round-off of turns and of sums of numbers up to 3.
    np.testing.assert_allclose(data.oMf[frame].translation - (1, 2, 3), place, rtol=0, atol=1e-15)
    np.testing.assert_allclose(data.oMf[frame].rotation, np.eye(3), rtol=0, atol=1e-15)
    normal = np.array([float(x) for x in axis.split('"')[1].split()]) if axis else np.array([1.0, 0.0, 0.0])
    pin.framesForwardKinematics(model, data, np.array([0.0, 0.0, np.cos(0.5), np.sin(0.5)]))
    expected = pin.AngleAxis(0.5, normal / np.linalg.norm(normal)).toRotationMatrix()
    np.testing.assert_allclose(data.oMf[frame].rotation, expected, rtol=0, atol=1e-15)
    assert data.oMf[frame].actInv(data.oMi[1] * model.inertias[1].lever) == pytest.approx((0.1, 0.2, 0.3), abs=1e-15)


@pytest.mark.parametrize(
    ("origin", "words"),
    [
        ('xyz="1 2"', "xyz of <inertial> of link 'a' must be 3 numbers"),
        ('rpy="0 x 0"', "rpy of <inertial> of link 'a' must be 3 numbers"),
        ('quat_xyzw="0 0 0 0"', "quat_xyzw must not be zero"),
    ],
)
def test_a_wrong_origin_of_an_inertia_is_refused(tmp_path, origin, words):
    """The XML parser of Pinocchio drops all of such an inertia, without a word."""
    inertial = INERTIAL.format(1).replace("<mass", f"<origin {origin}/><mass")
    with pytest.raises(ValueError, match=words):
        scene_of(tmp_path, f'<robot name="r"><link name="a">{inertial}</link></robot>', base="free")


@pytest.mark.parametrize(("version", "turned"), [("1.3", True), ("1.4", True), ("1.5", False), ("1.12", False)])
def test_axes_of_old_sdf_are_in_the_frame_of_the_model(tmp_path, version, turned):
    """As sdformat converts them."""
    text = (
        f'<sdf version="{version}"><model name="m"><link name="a"><pose>0 0 0 0 0 1.5707963267948966</pose></link>'
        '<joint name="j" type="revolute"><parent>world</parent><child>a</child><axis><xyz>1 0 0</xyz></axis></joint>'
        "</model></sdf>"
    )
    model = robot_of(tmp_path, text).model
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(1), np.ones(1))
    spin = data.oMi[1].rotation @ data.v[1].angular
    np.testing.assert_allclose(spin, (1, 0, 0) if turned else (0, 1, 0), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "text",
    [
        '<robot name="r"><link name="w"/><link name="a">{}</link><joint name="j" type="continuous">'
        '<parent link="w"/><child link="a"/><axis xyz="0 0 0"/></joint></robot>',
        '<mujoco><worldbody><body><joint name="j" axis="0 0 0"/><geom size=".1"/></body></worldbody></mujoco>',
        '<mujoco><worldbody><body><joint name="j" axis="0 0"/><geom size=".1"/></body></worldbody></mujoco>',
    ],
)
def test_axes_of_files_are_directions(tmp_path, text):
    """A rotor that nothing hangs on, else."""
    with pytest.raises(ValueError, match="axis of joint 'j' of 'r' must be of length 1, got 0"):
        scene_of(tmp_path, text.format(INERTIAL.format(1)), armature=[1.0])
