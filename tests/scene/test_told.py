"""Nothing in a file that changes the motion is left out without a warning that names it; what is usual is quiet."""

import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest
from mechanisms import hang
from robot_texts import robot_of

import nsdyn as nd
from nsdyn.scene.robot_files.elements import changes_nothing

MJCF = (
    "<mujoco {mujoco}><compiler {compiler}/><option {option}>{flag}</option>{top}<worldbody>{world}"
    '<body name="b" {body}>'
    '<joint name="j" {joint}/>{free}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1" {inertial}/>'
    '<geom name="g" size=".1" {geom}/>{more}</body><body name="c" pos="1 0 0"><joint name="k"/><geom size=".1"/></body>'
    "</worldbody>{end}</mujoco>"
)

SOFT = [("solref", "0.01 1", "0.02 1"), ("solimp", ".8 .9 .001", "0.9 0.95 0.001 0.5 2")]

# Place in the file, attribute, a value that changes the motion, one that does not.
MJCF_ATTRIBUTES = [
    ("compiler", "boundinertia", "1", "0"),
    ("compiler", "balanceinertia", "true", "false"),
    ("compiler", "settotalmass", "3", "-1"),
    ("compiler", "coordinate", "global", "local"),
    ("compiler", "strippath", "true", "false"),
    ("compiler", "alignfree", "true", "false"),
    ("compiler", "misspelt", "1", None),
    ("option", "gravity", "0 0 -1", "0 0 -9.81"),
    ("option", "wind", "1 0 0", "0 0 0"),
    ("option", "density", "1.2", "0"),
    ("option", "viscosity", "1e-5", "0.0"),
    ("option", "impratio", "10", "1"),
    ("option", "actuatorgroupdisable", "1", None),
    ("option", "misspelt", "1", None),
    ("body", "gravcomp", "0.5", "0.0"),
    ("body", "mocap", "true", "false"),
    ("body", "misspelt", "1", None),
    ("inertial", "misspelt", "1", None),
    ("joint", "margin", "0.1", "0"),
    ("joint", "springdamper", "1 1", "0 0"),
    ("joint", "actuatorgravcomp", "true", "false"),
    *((("joint", f"{law}{of}", *values)) for law, *values in SOFT for of in ("limit", "friction")),
    ("joint", "springyield", "1", None),
    ("joint", "misspelt", "1", None),
    ("geom", "margin", "0.01", "0"),
    ("geom", "gap", "0.01", "0.0"),
    ("geom", "priority", "1", "0"),
    ("geom", "solmix", "2", "1"),
    *(("geom", *values) for values in SOFT),
    ("geom", "fluidshape", "ellipsoid", "none"),
    ("geom", "adhesion", "1", "0"),
    ("geom", "surfacevel", "1 0 0", "0 0 0"),
    ("geom", "misspelt", "1", None),
]


def mjcf(**places):
    return MJCF.format(
        **dict.fromkeys("mujoco compiler option flag top world body joint free".split(), "")
        | dict.fromkeys("inertial geom more end".split(), "")
        | places
    )


def loaded(tmp_path, text):
    """(What the file's warning names, the articulation) of a file."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        a = robot_of(tmp_path, text)
    return "; ".join(str(w.message) for w in caught), a


@pytest.mark.parametrize(("place", "name", "value", "still"), MJCF_ATTRIBUTES)
def test_attributes_of_mjcf(tmp_path, place, name, value, still):
    told, _ = loaded(tmp_path, mjcf(**{place: f'{name}="{value}"'}))
    assert f": {name}" in told
    if still is not None:
        assert loaded(tmp_path, mjcf(**{place: f'{name}="{still}"'}))[0] == ""


@pytest.mark.parametrize(
    ("place", "text", "note"),
    [
        *(
            ("flag", f'<flag {flag}="disable"/>', f"flag: {flag}")
            for flag in "constraint contact equality limit frictionloss passive spring damper gravity filterparent "
            "clampctrl actuation".split()
        ),
        ("flag", '<flag override="enable"/>', "flag: override"),
        ("flag", '<flag ipc="enable"/>', "flag: ipc"),
        ("top", "<misspelt/>", "mujoco: <misspelt>"),
        ("top", '<default><jiont damping="1"/></default>', "default: <jiont>"),
        ("top", '<default><default class="c"><misspelt/></default></default>', "default: <misspelt>"),
        ("top", '<default><geom margin="1"/></default>', "geom 'g': margin (2)"),
        ("top", '<option density="1"/>', "option: density"),
        ("end", '<deformable><flex name="f"/></deformable>', "deformable: <flex>"),
        ("end", "<asset><misspelt/></asset>", "asset: <misspelt>"),
        (
            "world",
            "<body><joint/>" + 2 * '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>' + "</body>",
            "a second <i",
        ),
        ("end", "<contact><misspelt/></contact>", "contact: <misspelt>"),
        ("end", '<contact><pair geom1="g" geom2="h"/></contact>', "<pair> of 'g' and 'h'"),
        ("end", '<tendon><fixed name="t" stiffness="1"/></tendon>', "<tendon> 't'"),
        ("end", '<tendon><spatial name="t"/></tendon>', "<tendon> 't'"),
        ("end", '<equality><weld name="w" body1="b" torquescale="2"/></equality>', "weld 'w': torquescale"),
        ("end", '<equality><weld name="w" body1="b" solref="1 1"/></equality>', "weld 'w': solref"),
        ("end", '<equality><connect body1="b" anchor="0 0 0" solimp="0 0"/></equality>', "connect: solimp"),
        ("end", '<equality><joint name="e" joint1="j" solref="1 1"/></equality>', "joint 'e': solref"),
        ("end", '<equality><tendon name="e"/></equality>', "equality 'e' of type 'tendon'"),
        ("end", '<actuator><motor joint="j" armature="1"/></actuator>', "actuator 'j': armature"),
        ("more", "<misspelt/>", "body 'b': <misspelt>"),
        ("more", '<site name="s" misspelt="1"/>', "site 's': misspelt"),
        ("world", '<body><joint type="ball" stiffness="1"/><geom size=".1"/></body>', "stiffness of a ball joint"),
        ("world", '<body><freejoint align="true"/><geom size="1" pos="9 9 9"/></body>', "align of <freejoint>"),
        ("world", '<geom name="h" type="hfield" hfield="f"/>', "geom 'h' of type 'hfield'"),
    ],
)
def test_elements_of_mjcf(tmp_path, place, text, note):
    assert note in loaded(tmp_path, mjcf(**{place: text}))[0]


def test_usual_mjcf_is_quiet(tmp_path):
    text = mjcf(
        mujoco='model="m"',
        compiler='angle="radian" autolimits="true" meshdir="assets" discardvisual="false" fusestatic="false"',
        option='timestep="1e-3" integrator="implicitfast" cone="elliptic" iterations="5"',
        flag='<flag eulerdamp="disable" contact="enable" multiccd="enable"/>',
        top='<default><default class="c"><geom group="3" rgba="1 1 1 1"/></default></default>'
        '<visual><headlight active="1"/></visual><statistic/>'
        '<custom/><size njmax="5"/>',
        world='<light/><camera/><geom type="plane" size="1 1 1" pos="0 0 -9" material="grid"/>',
        geom='condim="3" friction="1 .005 .0001" user="1"',
        joint='damping="1" range="-1 1" group="2"',
        more='<camera/><light/><site name="s" size=".1"/>',
        end='<sensor/><asset><texture/><material name="grid"/></asset>',
    )
    told, a = loaded(tmp_path, text)
    assert told == "" and a.missing == a.dropped == ()
    assert {"mujoco: <visual>", "option: timestep", "mujoco: <sensor>", "body 'b': <camera>"} <= {*a.unused}


def test_sections_that_come_twice_are_one(tmp_path):
    """Also where an included file has its own; of an attribute the last counts."""
    (tmp_path / "more.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="d"><joint name="l" range="-1 1"/>'
        '<geom size=".1" pos="9 0 0"/></body></worldbody></mujoco>'
    )
    _, a = loaded(tmp_path, mjcf(compiler='angle="degree"', end='<include file="more.xml"/>', joint='range="-2 2"'))
    assert a.model.nv == 3
    np.testing.assert_array_equal(a.model.lowerPositionLimit, (-2, -np.inf, -1))


def test_equalities_take_the_defaults_of_their_class(tmp_path):
    weld = '<equality><weld name="w" body1="b"{}/></equality>'
    top = '<default><equality active="false"/><default class="on"><equality active="true"/></default></default>'
    assert not loaded(tmp_path, mjcf(top=top, end=weld.format("")))[1].loops
    assert loaded(tmp_path, mjcf(top=top, end=weld.format(' class="on"')))[1].loops


POSES = [
    ("", 'euler="10 20 30"'),
    ('angle="radian"', 'euler=".1 .2 .3"'),
    ('eulerseq="ZYX"', 'euler="10 20 30"'),
    ('eulerseq="XyZ"', 'euler="10 20 30"'),
    ('eulerseq="zxz"', 'euler="10 20 30"'),
    ("", 'axisangle="1 2 3 40"'),
    ("", 'quat="2 1 0 1"'),
    ("", 'xyaxes="0 1 0 1 0 .2"'),
    ("", 'zaxis="0 1 1"'),
    ("", 'zaxis="0 0 -3"'),
    ("", 'zaxis="1e-7 0 -1"'),
    ("", 'zaxis="2e-7 0 -1"'),
]


@pytest.mark.parametrize(("compiler", "pose"), POSES)
def test_orientations_are_those_of_mujoco(tmp_path, compiler, pose):
    """Of bodies, inertias and geoms, by the mass matrix."""
    mujoco = pytest.importorskip("mujoco", reason="the extra 'peers' is not installed")
    text = (
        f'<mujoco><compiler {compiler}/><worldbody><body {pose}><joint axis="1 2 3"/><joint axis="0 1 0"/>'
        f'<inertial pos=".1 .2 .3" mass="1" diaginertia=".1 .2 .25" {pose}/><body name="b"><joint axis="1 0 0"/>'
        f'<geom type="box" size=".1 .2 .3" {pose}/></body></body></worldbody></mujoco>'
    )
    _, a = loaded(tmp_path, text)
    theirs = mujoco.MjModel.from_xml_string(text)
    data, M = mujoco.MjData(theirs), np.zeros((3, 3))
    mujoco.mj_forward(theirs, data)
    mujoco.mj_fullM(theirs, data, M)
    np.testing.assert_allclose(
        np.array(pin.crba(a.model, a.model.createData(), a.q)), M, rtol=0, atol=1e-14 * np.abs(M).max()
    )


def test_turns_about_several_axes(tmp_path):
    """Small letters turn with the body, large ones stay; an axis need not be of length 1."""
    box = '<geom name="g" size="1 2 3" type="box" {}/>'

    def turn(compiler, pose):
        text = f"<mujoco><compiler {compiler}/><worldbody><body><joint/>{box.format(pose)}</body></worldbody></mujoco>"
        return loaded(tmp_path, text)[1].links[0].placement.rotation

    x, y, z = (pin.utils.rotate(axis, np.radians(angle)) for axis, angle in (("x", 10), ("y", 20), ("z", 30)))
    for compiler, expected in (
        ("", x @ y @ z),
        ('eulerseq="XYZ"', z @ y @ x),
        ('eulerseq="XyZ"', z @ x @ y),
    ):
        np.testing.assert_allclose(turn(compiler, 'euler="10 20 30"'), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(turn("", 'axisangle="0 0 2 30"'), z, rtol=0, atol=1e-15)
    for compiler, pose, words in (
        ('eulerseq="xyw"', "", "eulerseq must be three of x, y, z, X, Y, Z, got 'xyw'"),
        *(
            ("", f'{form}="{zero}"', f"{form} of <geom> 'g' must give an orientation, got '{zero}'")
            for form, zero in (
                ("axisangle", "0 0 0 1"),
                ("quat", "0 0 0 0"),
                ("zaxis", "0 0 0"),
                ("xyaxes", "0 0 0 0 1 0"),
                ("xyaxes", "1 1 1 .3 .3 .3"),
            )
        ),
        ("", 'euler="1 2 3" quat="1 0 0 0"', "orientation of <geom> 'g' must be given once, got euler and quat"),
    ):
        with pytest.raises(ValueError, match=words):
            turn(compiler, pose)
    inertial = '<inertial pos="0 0 0" mass="1" fullinertia="1 1 1 0 0 0" euler="1 2 3"/>'
    with pytest.raises(ValueError, match="of <inertial> '' must be given once, got euler and fullinertia"):
        loaded(tmp_path, f"<mujoco><worldbody><body><joint/>{inertial}</body></worldbody></mujoco>")


def test_what_a_keyframe_says_beyond_its_configuration(tmp_path):
    key = '<keyframe><key name="k" qpos="0 0" act="{}" mpos="1" time="3"/></keyframe>'
    with pytest.warns(UserWarning, match="keyframe 'k': act; keyframe 'k': mpos"):
        robot_of(tmp_path, mjcf(end=key.format("0 1")), keyframe="k")


def test_meshes_of_shapes_are_where_they_are(tmp_path):
    """refpos moves a mesh that touches; one that is only seen may do as it likes."""
    mesh = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1" refpos="1 0 0"/></asset>'
    for masks, told in (("", True), ('contype="0" conaffinity="0"', False)):
        text = mjcf(top=mesh, more=f'<geom type="mesh" mesh="m" {masks}/>')
        assert ("mesh 'm': refpos" in loaded(tmp_path, text)[0]) == told


def test_values_that_change_nothing():
    assert changes_nothing(" 0.020 ", "0.02 1") and changes_nothing("TRUE", "1") and changes_nothing("auto", "no|auto")
    assert not changes_nothing("", "0") and not changes_nothing("0.02 2", "0.02 1") and not changes_nothing("x", "0")
    assert not changes_nothing("0 0", "0")


def test_a_bound_of_masses_is_told_where_it_is_left_out(tmp_path):
    """It holds for the <inertial> of b, of 1 kg; c has the mass of its geoms."""
    told, a = loaded(tmp_path, mjcf(compiler='boundmass="5"'))
    assert told == "'r' leaves out: body 'c': boundmass where its geoms have less"
    assert a.model.inertias[1].mass == 5.0
    told, _ = loaded(tmp_path, mjcf(compiler='boundmass="5" inertiafromgeom="true"'))
    assert told.count("boundmass") == 2
    assert loaded(tmp_path, mjcf(compiler='boundmass="0"'))[0] == ""


def test_joints_written_after_the_bodies_they_carry(tmp_path):
    """What acts in a joint is that of its own element: Pinocchio numbers a body before those that it carries."""
    parts = '<joint name="j" damping="1" range="-1 1" axis="0 1 0"/>', '<geom name="g" size=".1"/>'
    inner = '<body name="d" pos="1 0 0"><geom size=".1"/><joint name="l" type="slide" damping="2" axis="0 0 1"/></body>'
    for order in ((*parts, inner), (inner, *parts)):
        text = (
            f'<mujoco><compiler angle="radian"/><worldbody><body name="b">{"".join(order)}</body></worldbody></mujoco>'
        )
        a = loaded(tmp_path, text)[1]
        assert list(a.model.names)[1:] == ["j", "l"]
        np.testing.assert_array_equal(a.damping, (1, 2))
        np.testing.assert_array_equal(a.model.upperPositionLimit, (1, np.inf))


URDF = (
    '<robot name="r" {robot}><link name="a"/><link name="b" {link}><inertial>{inertial}<mass value="1"/>'
    '<inertia ixx=".1" iyy=".2" izz=".15" ixy="0" ixz="0" iyz="0"/></inertial><collision>{collision}'
    '<geometry {geometry}><sphere radius=".1"/></geometry></collision>{more}</link>'
    '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1" {axis}/>'
    '<limit lower="-1" upper="1" effort="2" velocity="{velocity}" {limit}/>'
    '<dynamics damping="1" {dynamics}/>{joint}</joint>{end}</robot>'
)


def urdf(**places):
    places = {"velocity": "0"} | places
    named = "robot link inertial collision geometry more axis limit dynamics joint end".split()
    return URDF.format(**dict.fromkeys(named, "") | places)


@pytest.mark.parametrize(
    ("places", "note"),
    [
        ({"velocity": "3"}, "velocity of <limit>"),
        ({"limit": 'acceleration="3"'}, "joint 'j': acceleration of <limit>"),
        ({"dynamics": 'K="3"'}, "joint 'j': K of <dynamics>"),
        ({"dynamics": 'spring_stiffness="3"'}, "spring_stiffness of <dynamics>"),
        ({"joint": '<safety_controller k_velocity="1"/>'}, "joint 'j': <safety_controller>"),
        ({"joint": "<misspelt/>"}, "joint 'j': <misspelt>"),
        ({"joint": '<axis xyz="1 0 0"/>'}, "joint 'j': a second <axis>"),
        ({"more": "<inertial/>"}, "link 'b': a second <inertial>"),
        ({"axis": 'xzy="1"'}, "joint 'j': xzy of <axis>"),
        ({"link": 'kinematic="1"'}, "link 'b': kinematic"),
        ({"more": '<contact><lateral_friction value="1"/></contact>'}, "link 'b': <contact>"),
        ({"more": "<self_collision_checking/>"}, "link 'b': <self_collision_checking>"),
        ({"inertial": '<origin xyz="0 0 0" rot="1"/>'}, "link 'b': rot of <origin>"),
        ({"collision": '<contact_coefficients mu="1"/>'}, "link 'b': <contact_coefficients> of <collision>"),
        ({"collision": "<surface/>"}, "link 'b': <surface> of <collision>"),
        ({"geometry": 'scale="2"'}, "link 'b': scale of <geometry>"),
        ({"end": '<loop_joint name="l"/>'}, "robot 'r': <loop_joint>"),
        ({"end": "<misspelt/>"}, "robot 'r': <misspelt>"),
        ({"end": '<gazebo><link name="x"/></gazebo>'}, "<link> of <gazebo>"),
        ({"end": '<gazebo><joint name="x"/></gazebo>'}, "<joint> of <gazebo>"),
        ({"end": '<gazebo><plugin name="p"/></gazebo>'}, "<plugin> of <gazebo>"),
        *(
            ({"end": f'<gazebo reference="b"><{tag}>{value}</{tag}></gazebo>'}, f"gazebo 'b': <{tag}>")
            for tag, value in (
                *((tag, "0.5") for tag in "mu mu1 mu2 kp kd maxVel minDepth stopCfm stopErp fudgeFactor slip1".split()),
                *((tag, "1") for tag in "dampingFactor springStiffness springReference velocity_decay".split()),
                ("fdir1", "1 0 0"),
                ("selfCollide", "false"),
                ("turnGravityOff", "true"),
                ("gravity", "0"),
                ("kinematic", "true"),
                ("static", "true"),
                ("enable_wind", "true"),
                ("pose", "0 0 1 0 0 0"),
                ("misspelt", "1"),
            )
        ),
    ],
)
def test_elements_of_urdf(tmp_path, places, note):
    assert note in loaded(tmp_path, urdf(**places))[0]


def test_usual_urdf_is_quiet(tmp_path):
    gazebo = (
        "<material>Red</material><selfCollide>1</selfCollide><turnGravityOff>false</turnGravityOff><gravity>1</gravity>"
        "<kinematic>0</kinematic><sensor><plugin/></sensor><springStiffness>0.0</springStiffness><laserRetro>1</laserRetro>"
    )
    text = urdf(
        robot='version="1.0"',
        velocity="1e20",
        more='<visual><geometry><sphere radius="1"/></geometry><material name="m"/></visual>',
        joint='<calibration rising="0"/>',
        end=f'<material name="m"/><transmission name="t"/><gazebo reference="b">{gazebo}</gazebo>',
    )
    told, a = loaded(tmp_path, text)
    assert told == "" and a.missing == a.dropped == ()
    assert {"robot 'r': <transmission>", "joint 'j': <calibration>", "gazebo 'b': <sensor>"} <= {*a.unused}


@pytest.mark.parametrize("version", ["", 'version="1.1"'])
def test_quaternions_of_urdf(tmp_path, version):
    """Of inertias and shapes; urdfdom reads them where the file says a version."""
    places = {"inertial": '<origin xyz="1 2 3" {}/>', "collision": "<origin {}/>"}
    ways = 'rpy="0 0 1.2870022175866"', 'quat_xyzw="0 0 1.2 1.6"'
    written = [urdf(robot=version, **{k: text.format(way) for k, text in places.items()}) for way in ways]
    a, b = (loaded(tmp_path, text)[1] for text in written)
    np.testing.assert_allclose(a.model.inertias[1].inertia, b.model.inertias[1].inertia, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.links[0].placement.rotation, b.links[0].placement.rotation, rtol=0, atol=1e-12)
    assert np.abs(a.links[0].placement.rotation - np.eye(3)).max() > 0.5


SDF = (
    '<sdf version="1.11"><world name="w">{world}<model name="m" {model_attribute}>{model}'
    '<link name="a" {link_attribute}>{link}'
    "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia>{inertial}</inertial>"
    '<collision name="c">{collision}<geometry><sphere><radius>1</radius>{sphere}</sphere></geometry><surface>{surface}'
    '</surface></collision></link><joint name="j" type="revolute"><parent>world</parent><child>a</child><axis>'
    "<xyz>0 0 1</xyz><limit><lower>-1</lower><upper>1</upper>{limit}</limit><dynamics>{dynamics}</dynamics>{axis}"
    "</axis><physics><ode>{ode}</ode></physics>{joint}</joint></model></world></sdf>"
)


def sdf(**places):
    named = "world model_attribute model link_attribute link inertial collision sphere surface limit dynamics axis ode"
    return SDF.format(**dict.fromkeys([*named.split(), "joint"], "") | places)


def nested(path, value):
    """Elements in each other with a value in the last."""
    for tag in reversed(path.split("/")):
        value = f"<{tag}>{value}</{tag}>"
    return value


# Place in the file, elements, a value that changes the motion, one that does not.
SDF_ELEMENTS = [
    ("world", "gravity", "0 0 -1", "0 0 -9.8"),
    ("world", "wind/linear_velocity", "1 0 0", "0 0 0"),
    ("world", "include", "<uri>model://ground_plane</uri>", None),
    ("world", "joint", "", None),
    ("world", "plugin", "", None),
    ("world", "state", "", None),
    ("world", "population", "", None),
    ("world", "misspelt", "", None),
    ("model", "enable_wind", "true", "false"),
    ("model", "plugin", "", None),
    ("model", "gripper", "", None),
    ("model", "misspelt", "", None),
    ("link", "gravity", "0", "1"),
    ("link", "kinematic", "true", "false"),
    ("link", "enable_wind", "true", "0"),
    ("link", "self_collide", "true", "false"),
    ("link", "velocity_decay/linear", "0.1", "0.0"),
    ("link", "velocity_decay/angular", "0.1", "0"),
    ("link", "plugin", "", None),
    ("link", "misspelt", "", None),
    ("inertial", "fluid_added_mass/xx", "1", "0"),
    ("inertial", "misspelt", "1", None),
    ("collision", "misspelt", "1", None),
    ("sphere", "misspelt", "1", None),
    ("surface", "bounce/restitution_coefficient", "0.5", "0"),
    ("surface", "friction/ode/mu2", "0.5", "1"),
    ("surface", "friction/ode/fdir1", "1 0 0", "0 0 0"),
    ("surface", "friction/ode/slip1", "0.1", "0"),
    ("surface", "friction/ode/slip2", "0.1", "0"),
    ("surface", "friction/bullet/friction", "0.1", "1"),
    ("surface", "friction/bullet/rolling_friction", "0.1", "1"),
    ("surface", "friction/torsional/patch_radius", "0.1", "0"),
    ("surface", "friction/torsional/surface_radius", "0.1", "0"),
    ("surface", "friction/torsional/ode/slip", "0.1", "0"),
    ("surface", "friction/misspelt", "1", None),
    ("surface", "contact/ode/kp", "1e5", "1e12"),
    ("surface", "contact/ode/kd", "5", "1"),
    ("surface", "contact/ode/soft_cfm", "0.1", "0"),
    ("surface", "contact/ode/soft_erp", "0.1", "0.2"),
    ("surface", "contact/ode/max_vel", "1", "0.01"),
    ("surface", "contact/ode/min_depth", "0.1", "0.001"),
    ("surface", "contact/bullet/kp", "1e5", "1e12"),
    ("surface", "contact/collide_without_contact", "true", "false"),
    ("surface", "contact/collide_bitmask", "1", "0xffff"),
    ("surface", "contact/category_bitmask", "1", "65535"),
    ("surface", "contact/elastic_modulus", "1", "-1"),
    ("surface", "soft_contact/dart", "", None),
    ("surface", "misspelt", "1", None),
    ("limit", "velocity", "2", "1e16"),
    ("limit", "velocity", "2", "inf"),
    ("limit", "velocity", "2", "-1"),
    ("limit", "stiffness", "2", "1e8"),
    ("limit", "dissipation", "2", "1"),
    ("limit", "misspelt", "2", None),
    ("dynamics", "misspelt", "2", None),
    ("axis", "initial_position", "0.5", "0"),
    ("axis", "misspelt", "0.5", None),
    ("joint", "gearbox_ratio", "2", "1"),
    ("joint", "thread_pitch", "2", "1"),
    ("joint", "screw_thread_pitch", "2", "1"),
    ("joint", "misspelt", "2", None),
    *(("ode", tag, "0.5", "0") for tag in "fudge_factor cfm bounce max_force velocity".split()),
    ("ode", "erp", "0.5", "0.2"),
    ("ode", "limit/cfm", "0.5", "0"),
    ("ode", "limit/erp", "0.5", "0.2"),
    ("ode", "suspension/cfm", "0.5", "0"),
]


@pytest.mark.parametrize(("place", "path", "value", "still"), SDF_ELEMENTS)
def test_elements_of_sdf(tmp_path, place, path, value, still):
    told, _ = loaded(tmp_path, sdf(**{place: nested(path, value)}))
    # A friction across may be the same as that along, a velocity is told with the others; soft_contact as a whole.
    expected = {"mu2": "friction across", "velocity": "velocity", "dart": "<soft_contact>"}
    last = path.rpartition("/")[2]
    assert expected.get(last, f"<{last}>") in told
    if still is not None:
        assert loaded(tmp_path, sdf(**{place: nested(path, still)}))[0] == ""


@pytest.mark.parametrize(
    ("places", "note"),
    [
        ({"model_attribute": 'placement_frame="f"'}, "model 'm': placement_frame"),
        ({"model": '<pose relative_to="f">0 0 0 0 0 0</pose>'}, "model 'm': relative_to of <pose>"),
        ({"joint": "<axis/>"}, "joint 'j': a second <axis>"),
        ({"link_attribute": 'misspelt="1"'}, "link 'a': misspelt"),
        ({"link": '<pose frame="f">0 0 0 0 0 0</pose>'}, "link 'a': frame of <pose>"),
        ({"link": '<pose rotation="f">0 0 0 0 0 0</pose>'}, "link 'a': rotation of <pose>"),
    ],
)
def test_attributes_of_sdf(tmp_path, places, note):
    assert note in loaded(tmp_path, sdf(**places))[0]


def test_usual_sdf_is_quiet(tmp_path):
    text = sdf(
        world="<physics/><scene/><light/><gui/><gravity>0 0 -9.8</gravity><atmosphere/><magnetic_field/>",
        model_attribute='canonical_link="a" placement_frame=""',
        model="<static>false</static><self_collide>false</self_collide><allow_auto_disable>1</allow_auto_disable>",
        link='<pose frame="">0 0 0 0 0 0</pose><gravity>true</gravity><visual name="v"><geometry><box>'
        "<size>1 1 1</size></box></geometry><material/></visual><sensor><plugin/></sensor><must_be_base_link/>",
        collision='<max_contacts>10</max_contacts><laser_retro>1</laser_retro><pose degrees="true">0 0 0 0 0 0</pose>',
        surface="<friction><ode><mu>0.4</mu><mu2>0.4</mu2></ode></friction>",
        joint="<sensor/>",
    )
    told, a = loaded(tmp_path, text)
    assert told == "" and a.missing == a.dropped == ()
    assert {"world 'w': <physics>", "link 'a': <sensor>", "joint 'j': <sensor>"} <= {*a.unused}


def test_poses_in_a_link_may_be_relative_to_any_frame(tmp_path):
    frame = '<frame name="f" attached_to="a"><pose>1 2 3 0 0 1</pose></frame>'
    turned = '<pose relative_to="f">0 0 1 0 0 0</pose>'
    _, a = loaded(tmp_path, sdf(model=frame, collision=turned, inertial=turned))
    expected = pin.SE3(pin.rpy.rpyToMatrix(0, 0, 1), np.array([1.0, 2.0, 4.0]))
    assert a.links[0].placement.isApprox(expected, 1e-15)
    np.testing.assert_allclose(a.model.inertias[1].lever, (1, 2, 4), rtol=0, atol=1e-15)


def test_truth_is_written_in_two_ways(tmp_path):
    pose = '<pose degrees="{}">0 0 0 0 0 90</pose>'
    a, b = (loaded(tmp_path, sdf(collision=pose.format(yes)))[1] for yes in ("true", "1"))
    assert a.links[0].placement.isApprox(b.links[0].placement, 0.0)
    text = sdf().replace("<inertial>", '<inertial auto="1">')
    assert "link 'a': automatic inertia" in loaded(tmp_path, text)[0]


def test_an_empty_collision_is_no_missing_shape(tmp_path):
    text = sdf().replace("<sphere><radius>1</radius></sphere>", "<empty/>")
    told, a = loaded(tmp_path, text)
    assert told == "" and a.links == ()


@pytest.fixture
def chain():
    """Three balls on hinges, and what they are as collision shapes."""
    model, geometry, parent = pin.Model(), pin.GeometryModel(), 0
    for k in range(3):
        parent = hang(model, parent, f"j{k}", pin.JointModelRX(), pin.Inertia.Random(), (1.0, 0, 0))
        geometry.addGeometryObject(pin.GeometryObject(f"g{k}", parent, pin.SE3.Identity(), coal.Sphere(0.1)))
    return model, geometry


def of_model(model, geometry):
    scene = nd.Scene()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene.add_model("r", model, geometry)
    return "; ".join(str(w.message) for w in caught), scene.articulations["r"]


def test_values_of_a_model(chain):
    model, geometry = chain
    assert of_model(*chain)[0] == ""
    for name, value, note in (
        ("lowerDryFrictionLimit", np.array([0, -1.0, 0]), "joint 'j1': lowerDryFrictionLimit that is not -upper"),
        ("lowerEffortLimit", -np.ones(3), "joint 'j0': lowerEffortLimit that is not -upperEffortLimit (3)"),
        ("upperVelocityLimit", np.array([1e308, 1e308, 2.0]), "joint 'j2': velocity limit (1)"),
        ("gravity", pin.Motion.Zero(), "gravity of the model"),
    ):
        changed = model.copy()
        setattr(changed, name, value)
        assert note in of_model(changed, geometry)[0]


def test_pairs_of_a_geometry_model(chain):
    """Those that it lists, if any; shapes whose collision is disabled take no part."""
    _, geometry = chain
    assert of_model(*chain)[1].excluded == {(0, 1), (1, 2)}  # neighbours
    geometry.addCollisionPair(pin.CollisionPair(0, 1))
    assert of_model(*chain)[1].excluded == {(0, 1), (1, 2), (0, 2)}
    geometry.addAllCollisionPairs()
    assert of_model(*chain)[1].excluded == {(0, 1), (1, 2)}
    geometry.geometryObjects[1].disableCollision = True
    assert [link.name for link in of_model(*chain)[1].links] == ["g0", "g2"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (mjcf(compiler='angle="radians"'), r"did you mean 'radian'\? angle of <compiler> '' must be one of"),
        (mjcf(compiler='autolimits="no"'), "autolimits of <compiler> '' must be one of true, false; got 'no'"),
        (mjcf(joint='limited="True" range="0 1"'), "limited of <joint> 'j' must be one of true, false, auto"),
        (mjcf(geom='condim="2"'), "condim of <geom> 'g' must be one of 1, 3, 4, 6; got '2'"),
        (mjcf(end='<actuator><motor joint="j" ctrllimited="1"/></actuator>'), "ctrllimited of <motor> '' must"),
        (mjcf(end='<contact><exclude body1="b" body2="z"/></contact>'), "body2 of an <exclude> must be one of"),
        (mjcf(end='<contact><exclude body1="b" bodytwo="c"/></contact>'), "body2 of an <exclude> must be one"),
        (sdf(model='<link name="a"/>'), "link 'a' must have a name of its own"),
        (sdf(model="<static>yes</static>"), "must be true or false, got 'yes'"),
        (sdf(axis='<mimic joint="j" axis="x"/>'), "axis of mimic of 'j' must be one of axis, axis2; got 'x'"),
        (sdf(model='<pose rotation_format="x">0 0 0 0 0 0</pose>'), "rotation_format of <pose> must be"),
    ],
)
def test_words_that_are_none_are_refused(tmp_path, text, words):
    with pytest.raises(ValueError, match=words):
        loaded(tmp_path, text)


def test_a_range_from_0_to_0_is_none(tmp_path):
    """MuJoCo's default, which defaults of classes may give again; told to be limited, it is one."""
    text = mjcf(joint='range="0 0"', end='<actuator><motor joint="j" ctrlrange="0 0.0" forcerange="0 0"/></actuator>')
    a = loaded(tmp_path, text)[1]
    assert a.model.upperPositionLimit[0] == np.inf
    assert a.actuators[0].control_range == a.actuators[0].force_range == (-np.inf, np.inf)
    assert loaded(tmp_path, mjcf(joint='range="0 0" limited="true"'))[1].model.upperPositionLimit[0] == 0.0


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ({"top": '<default class="q"/>'}, "class of the <default> at the top must be one of main; got 'q'"),
        ({"top": '<default><default class="q"/><default class="q"/></default>'}, "class 'q' of a <default> must be a"),
        ({"top": "<default><default/></default>"}, "class '' of a <default> must be a name of its own"),
        ({"more": '<joint name="j" axis="1 0 0"/>'}, "joint 'j' of 'r' must have a name of its own"),
        ({"more": '<joint name="universe" axis="1 0 0"/>'}, "joint 'universe' of 'r' must have a name of its own"),
        ({"more": '<body name="world"/>'}, "body 'world' must have a name of its own"),
        ({"more": '<body name="b"/>'}, "body 'b' must have a name of its own"),
        ({"more": '<geom name="p" type="plane" size="1 1 1"/>'}, "geom 'p' must not be a plane: body 'b' moves"),
        ({"more": "<freejoint/>"}, "r.mjcf could not be read: [^/]*$"),
        ({"compiler": 'inertiafromgeom="false"'}, "r.mjcf could not be read: [^/]*$"),
    ],
)
def test_names_and_planes_that_mujoco_refuses_are_refused(tmp_path, places, words):
    """Two hinges had one name, a moving plane weighed 1 kg, a class named at the top was no default; in one line."""
    with pytest.raises(ValueError, match=words) as refused:
        loaded(tmp_path, mjcf(**places))
    assert "\n" not in str(refused.value)


def test_bodies_and_joints_without_a_name_get_another(tmp_path):
    """Than those that have one."""
    more = '<body name="body2"/><body><geom size=".1" pos="0 0 9"/></body>'
    a = loaded(tmp_path, mjcf(more=more))[1]
    assert "body2_" in {link.body for link in a.links} and a.model.existFrame("body2")
    more = '<joint axis="1 0 0"/><body name="d"><joint name="joint1"/><geom size=".1" pos="0 0 9"/></body>'
    assert loaded(tmp_path, mjcf(more=more))[1].model.existJointName("joint1_")


@pytest.mark.parametrize(
    ("joint", "motor", "words"),
    [
        ('range="-1 1"', "", "limited of joint 'j' must be given beside range: autolimits of <compiler> is false"),
        ('actuatorfrcrange="-1 1"', "", "actuatorfrclimited of joint 'j' must be given beside actuatorfrcrange"),
        ("", 'ctrlrange="-1 1"', "ctrllimited of actuator 'j' must be given beside ctrlrange"),
        ('actuatorfrclimited="true"', "", "actuatorfrcrange of joint 'j' is missing"),
        ('limited="true" range="1 -1"', "", "range of joint 'j' must not decrease, got '1 -1'"),
        ("", 'ctrllimited="true" ctrlrange="1 -1"', "ctrlrange of actuator 'j' must not decrease, got '1 -1'"),
        ("", 'inheritrange="1"', "inheritrange of actuator 'j' needs a range of joint 'j'"),
    ],
)
def test_ranges_that_limit_nothing_are_refused(tmp_path, joint, motor, words):
    """As by MuJoCo, which infers no limit where `autolimits` is false."""
    drive = f'<actuator><position joint="j" {motor}/></actuator>'
    with pytest.raises(ValueError, match=words):
        loaded(tmp_path, mjcf(joint=joint, end=drive, compiler='autolimits="false"'))


def test_all_of_a_static_model_is_fixed(tmp_path):
    """Whatever its joints; as in Gazebo."""
    assert loaded(tmp_path, sdf())[1].model.nv == 1
    a = loaded(tmp_path, sdf(model="<static>true</static>", axis='<mimic joint="j"/>'))[1]
    assert a.model.nv == 0 and [link.joint for link in a.links] == [0] and not a.gears


def test_masses_of_shapes_that_have_none_here(tmp_path):
    mesh = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/><mesh name="n" file="gone.stl"/></asset>'
    seen = 'contype="0" conaffinity="0"'
    gone = f'<geom name="s" type="mesh" mesh="n" {seen}/>'
    for places, note in (
        ({"more": f'<geom type="mesh" mesh="m" {seen}/>'}, ""),
        ({"more": f'<geom type="mesh" mesh="m" {seen}/>', "compiler": 'inertiafromgeom="true"'}, ""),
        ({"more": gone}, ""),
        ({"more": gone, "compiler": 'inertiafromgeom="true"'}, "inertia of geom 's': mesh 'gone.stl' was not found"),
        ({"more": f'<geom name="s" type="sdf" mesh="m" {seen}/>'}, "geom 's' of type 'sdf'"),
    ):
        told, _ = loaded(tmp_path, mjcf(top=mesh, **places))
        assert note in told and bool(note) == bool(told)


@pytest.mark.parametrize("mass", ['mass="0"', 'mass="0.0"', 'density="0"'])
def test_meshes_that_touch_get_no_mass_that_no_file_gives(tmp_path, mass):
    """Pinocchio gives each of them 1 kg and 1 kg m²."""
    mesh, compiler = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>', 'inertiafromgeom="true"'
    bare = loaded(tmp_path, mjcf(compiler=compiler))[1]
    told, a = loaded(tmp_path, mjcf(top=mesh, compiler=compiler, more=f'<geom type="mesh" mesh="m" {mass}/>'))
    assert told == ""
    assert len(a.links) == len(bare.links) + 1 and a.model.inertias[1] == bare.model.inertias[1]
