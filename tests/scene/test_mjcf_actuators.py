"""Actuators of MJCF files by name: the forces of MuJoCo, and what is left out told."""

import numpy as np
import pytest
from robot_texts import robot_of, scene_of

import nsdyn as nd

LEG = """<mujoco><compiler angle="radian"/><option timestep="1e-4" integrator="RK4"/>
<default>
  <geom contype="0" conaffinity="0"/><position kp="30" kv="1"/><general gear="2" ctrlrange="-1 1"/>
  <default class="weak"><motor forcerange="-1 1"/></default>
</default>
<worldbody><body>
  <joint name="hip" axis="0 1 0"/><joint name="roll" axis="1 0 0" range="-1 1" damping=".1"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.5" size=".02" mass="1"/>
  <body pos="0 0 -.5"><joint name="knee" axis="0 1 0" actuatorfrcrange="-2 2"/>
    <geom type="capsule" fromto="0 0 0 .1 0 -.5" size=".02" mass="1"/>
    <body pos="0 0 -.5"><joint name="toe" type="slide" axis="0 0 1" damping="1"/>
      <geom type="sphere" size=".05" mass=".3"/></body></body>
</body></worldbody>
<actuator>%s</actuator></mujoco>
"""
DRIVES = """
<position name="hip" joint="hip" forcerange="-4 4"/>
<motor name="roll_motor" joint="roll" gear="3" ctrlrange="-.5 .2"/>
<motor joint="knee" gear="20"/>
<velocity name="slide" joint="toe" kv="5"/>
<general name="spring" joint="toe" gear="1" gainprm="3" biastype="affine" biasprm="1 -40 -2"/>
"""
CONTROLS = {"hip": 0.8, "roll_motor": 0.9, "knee": 0.3, "slide": 0.2, "spring": 0.5}
"""Of which that of roll_motor is beyond its range, and the force of the knee beyond that of its joint."""


@pytest.fixture
def leg(tmp_path):
    return lambda drives: scene_of(tmp_path, LEG % drives, "leg")


def run(scene, control, dt=2e-3, time=0.2):
    return nd.simulate(scene, time, dt=dt, controller=lambda t, q, v: {"leg": control})


def test_actuators_move_joints_as_in_mujoco(leg):
    """Servos, motors, gears, ranges, against MuJoCo's fourth order at 1e-4 s."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(LEG % DRIVES)
    data = mujoco.MjData(model)
    data.ctrl[:] = [CONTROLS[model.actuator(k).name or "knee"] for k in range(model.nu)]
    while data.time < 0.2 - 1e-9:
        mujoco.mj_step(model, data)
    scene, control = leg(DRIVES), nd.Actuation(CONTROLS)
    assert scene.articulations["leg"].dropped == ()
    errors = [np.abs(run(scene, control, dt).q[-1] - data.qpos).max() for dt in (2e-3, 5e-4)]
    # Joints turn by 0.3 rad. Of second order; when a servo leaves its range falls anywhere in a step.
    assert errors[0] <= 1e-5 and errors[1] <= 1e-6


def test_a_check_lists_them(leg):
    found = nd.check(leg(DRIVES))
    assert found.actuators == ("leg/hip", "leg/roll_motor", "leg/knee", "leg/slide", "leg/spring")
    assert "\nactuators: leg/hip, leg/roll_motor, leg/knee, " in str(found)


def test_an_actuator_is_a_law_of_its_joint(leg):
    """A position servo is a PD control in terms of its joint, g² kp and g² kv about u/g; a motor is a torque."""
    scene = leg('<position name="p" joint="hip" kp="30" kv="1"/><motor name="m" joint="knee" class="weak"/>')
    hip, knee = scene.articulations["leg"].actuators
    assert hip.servo and hip.gear == 2.0 and not knee.servo and knee.force_range == (-1.0, 1.0)
    servo = run(scene, nd.Actuation({"p": 0.8, "m": 3.0}))
    law = nd.PD({"hip": 120.0}, {"hip": 4.0}, {"hip": 0.4}, feedforward={"knee": 2.0})
    # The same numbers in another order of sums.
    np.testing.assert_allclose(servo.q, run(scene, law).q, rtol=0, atol=1e-12)
    assert nd.check(servo).passed


def test_ranges_are_kept(leg):
    """A servo far from its target gives its forcerange through the gear; ctrllimited="false" frees a control."""
    scene = leg(
        '<position name="p" joint="toe" kp="1e4" forcerange="-3 3"/>'
        '<motor name="free" joint="hip" ctrllimited="false" gear="1"/>'
        '<position name="half" joint="roll" ctrllimited="auto" ctrlrange="" inheritrange=".5"/>'.replace(
            'ctrlrange=""', ""
        )
    )
    assert scene.articulations["leg"].actuators[1].control_range == (-np.inf, np.inf)
    assert scene.articulations["leg"].actuators[2].control_range == (-0.5, 0.5)
    moved = run(scene, nd.Actuation({"p": 1.0, "free": 7.0, "half": 0.0}), time=0.01)
    assert np.abs(moved.joint("leg/toe").torque - 6.0).max() <= 1e-9
    with pytest.raises(ValueError, match=r"inheritrange of actuator 'p' must be a number, got 'x'"):
        leg('<position name="p" joint="roll" inheritrange="x"/>')


def test_a_range_that_is_not_symmetric_keeps_its_larger_bound(leg):
    """No limit at all would be worse: 1e4 N m here."""
    with pytest.warns(UserWarning, match="'p': forcerange of a servo, but for ±3"):
        scene = leg('<position name="p" joint="toe" kp="1e4" forcerange="-3 1"/>')
    moved = run(scene, nd.Actuation({"p": 1.0}), time=0.01)
    assert np.abs(moved.joint("leg/toe").torque - 6.0).max() <= 1e-9


def test_what_is_not_named_is_off_and_told(leg):
    scene = leg(DRIVES)
    with pytest.warns(
        UserWarning, match=r"actuators of 'leg' that controller does not name are off: \['hip', 'roll_mo"
    ):
        one = run(scene, nd.Actuation({"knee": 0.05}), time=0.02)
    np.testing.assert_array_equal(one.q, run(scene, {"knee": 1.0}, time=0.02).q)  # a torque
    with pytest.warns(
        UserWarning, match="without a controller these actuators are off: leg/hip, leg/slide, leg/spring"
    ):
        nd.Stepper(scene)


def test_controls_in_the_order_of_the_file(leg):
    """As MuJoCo's ctrl."""
    scene = leg(DRIVES)
    names = [a.name for a in scene.articulations["leg"].actuators]
    controls = {name: 0.01 * k for k, name in enumerate(names)}
    named, listed = (run(scene, nd.Actuation(c), time=0.02) for c in (controls, list(controls.values())))
    np.testing.assert_array_equal(named.q, listed.q)
    assert np.abs(listed.v).max() > 0.0


def keyed(tmp_path, keyframe="up", key='ctrl=".1 .2 .3 .4 .5"'):
    """The leg at one of two keyframes."""
    keys = f'<keyframe><key name="up" qpos="0 0 0 0" {key}/><key name="plain"/></keyframe></mujoco>'
    text = (LEG % DRIVES).replace("</mujoco>", keys)
    return scene_of(tmp_path, text, "leg", keyframe=keyframe), text


def test_controls_of_a_keyframe(tmp_path):
    """They are told without a name, and are those that MuJoCo sets; where there are none, that is refused."""
    scene, text = keyed(tmp_path)
    held = [a.control for a in scene.articulations["leg"].actuators]
    assert held == [0.1, 0.2, 0.3, 0.4, 0.5] and scene.articulations["leg"].dropped == ()
    one, other = (run(scene, nd.Actuation(*given), time=0.02) for given in ((), (held,)))
    np.testing.assert_array_equal(one.q, other.q)
    with pytest.warns(UserWarning, match="these actuators are off: leg/hip, leg/roll_motor, leg/knee, leg/slide"):
        nd.Stepper(scene)
    with pytest.raises(ValueError, match="must be given: 'leg' was read without a keyframe's ctrl"):
        run(keyed(tmp_path, "plain")[0], nd.Actuation())
    assert not keyed(tmp_path, "plain")[0].articulations["leg"].q.any(), "qpos0, as in MuJoCo"
    with pytest.raises(ValueError, match="ctrl of keyframe 'up' must be 5 numbers of at most"):
        keyed(tmp_path, key='ctrl="1 2"')
    with pytest.raises(ValueError, match="keyframe 'plain' must have a name of its own"):
        keyed(tmp_path, key='/><key name="plain"')
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert data.ctrl.tolist() == held


@pytest.mark.parametrize(
    ("control", "words"),
    [
        (
            lambda: nd.Actuation({"hips": 1.0}),
            r"did you mean 'hip'\? actuator of 'leg' must be one of hip, .*; got 'hips'",
        ),
        (lambda: nd.Actuation({"hip": np.inf}), r"controls of an Actuation must be \{actuator: finite number\}, or"),
        (lambda: nd.Actuation([[1.0]]), r"controls of an Actuation must be .*, got \[\[1"),
        (lambda: nd.Actuation([1.0]), r"must be one for each of the \d actuators of 'leg': hip, .*; got 1"),
        (lambda: nd.Actuation({"hip": "up"}), "controls of an Actuation must be"),
    ],
)
def test_wrong_controls_are_refused(leg, control, words):
    with pytest.raises(ValueError, match=words):
        run(leg(DRIVES), control())


@pytest.mark.parametrize(
    ("drive", "note"),
    [
        ('<muscle name="m" joint="hip"/>', "<actuator> 'm': of kind 'muscle'"),
        ('<motor name="m" site="s"/>', "<actuator> 'm': on no hinge or slide"),
        ('<position joint="hip" dampratio="1"/>', "<actuator> 'hip': dampratio"),
        ('<general joint="hip" dyntype="integrator"/>', "<actuator> 'hip': dyntype='integrator'"),
        ('<general joint="hip" biastype="affine" biasprm="0 1 0"/>', "<actuator> 'hip': biasprm that drives it away"),
        ('<motor joint="hip" cranklength="1"/>', "actuator 'hip': cranklength"),
        ('<position joint="hip" forcerange="-1 2"/>', "actuator 'hip': forcerange of a servo, but for ±2"),
    ],
)
def test_what_is_not_used_is_told(leg, drive, note):
    with pytest.warns(UserWarning, match="'leg' leaves out: "):
        scene = leg(drive)
    assert scene.articulations["leg"].dropped == (note,)
    (left,) = scene.articulations["leg"].actuators or (None,)
    assert (left is None) == note.startswith("<actuator>")


def test_two_of_one_name_are_refused(leg):
    with pytest.raises(ValueError, match="actuator 'hip' comes twice: name both"):
        leg('<motor joint="hip"/><motor joint="hip"/>')


def test_control_takes_the_names_of_the_file(leg):
    """Also of the joints of one body."""
    scene = leg("")
    with pytest.raises(
        ValueError, match=r"name in joint forces of controller of 'leg' must be one of hip, roll, knee, toe"
    ):
        run(scene, {"ankle": 1.0})
    np.testing.assert_array_equal(run(scene, {"roll": 1.0}).q, run(scene, [0.0, 1.0, 0.0, 0.0]).q)


@pytest.mark.parametrize(
    ("default", "drive", "gain", "bias"),
    [
        ('<position kp="7" kv="2"/><motor gear="9"/>', "<position", 1, (0, -1, 0)),
        ('<motor gear="9"/><position kp="7" kv="2"/>', "<position", 7, (0, -7, -2)),
        ('<motor gear="9"/><position kp="7" kv="2"/>', "<general", 7, (0, -7, -2)),
        ('<position kp="7" kv="2"/>', "<velocity", 1, (0, 0, -1)),
        ('<position kp="7" kv="2"/><velocity kv="5"/>', '<position kp="3" kv="1"', 3, (0, -3, -1)),
        ('<position kp="7"/><general gainprm="5"/>', "<general", 5, (0, -7, 0)),
        ('<general gainprm="7" biastype="affine" biasprm="1 -8 -3"/>', '<position kp="5"', 5, (0, -5, -3)),
        ('<general gainprm="7" biastype="affine" biasprm="1 -8 -3"/>', "<velocity", 7, (0, 0, -7)),
        ('<general gainprm="7" biastype="affine" biasprm="1 -8 -3"/>', "<motor", 1, (0, 0, 0)),
        ('<general biastype="affine" biasprm="1 -8 -3"/>', '<general biasprm="2 -4"', 1, (2, -4, -3)),
        ('<muscle/><position kp="4"/>', '<position kv="1"', 4, (0, -4, -1)),
    ],
)
@pytest.mark.filterwarnings("ignore:'r' leaves out")
def test_kinds_of_a_class_share_their_gains(tmp_path, default, drive, gain, bias):
    """The numbers are MuJoCo 4.0's: a kind begins from the gains of its own kind or of `general`."""
    body = '<body><joint name="j"/><geom size=".1"/></body>'
    text = f"<default>{default}</default><worldbody>{body}</worldbody>" + f'<actuator>{drive} joint="j"/></actuator>'
    (a,) = robot_of(tmp_path, f"<mujoco>{text}</mujoco>").actuators
    assert (a.gain, a.bias) == (gain, bias)


@pytest.mark.parametrize(
    ("parent", "child", "drive", "note"),
    [
        ('<position kp="7"/>', '<velocity kv="5"/>', "<position", "gains of several kinds in its class"),
        ('<position kp="7"/>', '<motor gear="2"/>', "<position", "gains of several kinds in its class"),
        ('<position kp="7"/>', '<motor gear="2"/>', "<motor", ""),
        ('<position kp="7"/>', '<velocity kv="5"/>', '<position kp="3" kv="1"', ""),
        ('<motor gear="2"/>', '<position kp="7"/>', "<position", ""),
        ("", '<motor kp="7"/>', "<motor", "kp"),
        ("", '<motor gainprm="7"/>', "<motor", "gainprm of a motor"),
    ],
)
@pytest.mark.filterwarnings("ignore:'r' leaves out")
def test_gains_of_several_kinds_are_told(tmp_path, parent, child, drive, note):
    """Of a class, where MuJoCo may go back to those of a class before."""
    body = '<body><joint name="j"/><geom size=".1"/></body>'
    default = f'<default>{parent}<default class="c">{child}</default></default>'
    drives = f'<actuator>{drive} class="c" joint="j"/></actuator>'
    a = robot_of(tmp_path, f"<mujoco>{default}<worldbody>{body}</worldbody>{drives}</mujoco>")
    assert a.dropped == ((f"actuator 'j': {note}",) if note else ())
