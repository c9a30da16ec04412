"""Laws of joints with several coordinates: dry friction is a disk or a ball, what is not modelled is refused."""

import numpy as np
import pinocchio as pin
import pytest
from conftest import INERTIAL
from mechanisms import at, hang, limit, lump, serial
from robot_texts import robot_of
from scipy.integrate import solve_ivp

import nsdyn as nd
from nsdyn import cli
from nsdyn.scene import shapes

MASS, INERTIA, MOST = 2.0, 0.1, 1.0


def model_of(joint, **limits):
    model = pin.Model()
    hang(model, 0, "j", joint, lump(MASS, INERTIA))
    for name, value in limits.items():
        setattr(model, name, np.array(value, dtype=float))
    return model


def puck(v=(0.0, 0.0, 0.0), turning=0.0):
    """A joint that slides in the plane, with at most 1 N of dry friction."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("a", model_of(pin.JointModelPlanar()), v=v, friction=(MOST, MOST, turning))
    return scene


@pytest.mark.parametrize(
    "angle", [0.0, 0.3, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (np.pi / 4, 2.0))]
)
def test_planar_joint_slides_against_its_friction_whatever_the_direction(angle):
    way = np.array((np.cos(angle), np.sin(angle)))
    run = nd.simulate(puck((*3.0 * way, 0.0)), 1.0, 1e-2)
    assert nd.check(run).passed, nd.check(run)
    np.testing.assert_allclose(run.v[-1, :2], (3.0 - MOST / MASS) * way, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(run.q[-1, :2], (3.0 - 0.5 * MOST / MASS) * way, rtol=0.0, atol=1e-12)
    assert run.energy.friction.sum() == pytest.approx(-MOST * (3.0 - 0.5 * MOST / MASS), rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(run.joint("a/j").friction[:, :2], axis=1), MOST, rtol=1e-12)


@pytest.mark.slow
def test_planar_joint_that_turns_slides_straight_and_stops():
    """Its coordinates are along axes that turn with it: friction against the turn and the slip know nothing of another.

    It slides straight with |v| = v0 - (τ/m) t, exactly but for what the turn in a step does, O(h²) of its stop.
    """
    speed, errors = np.hypot(0.1, 0.2), []
    for dt in (2e-2, 1e-2, 5e-3):
        run = nd.simulate(puck((3.0, 0.0, 5.0), 0.02), 1.0, dt)
        assert nd.check(run).passed, nd.check(run)
        np.testing.assert_allclose(run.v[-1, 2], 5.0 - 0.02 / INERTIA, rtol=1e-12)
        np.testing.assert_allclose(
            run.q[-1, :2], (3.0 - 0.5 * MOST / MASS, 0.0), rtol=0.0, atol=4e-7 * (dt / 2e-2) ** 2
        )
        run = nd.simulate(puck((0.1, 0.2, 5.0), 0.02), 1.0, dt)
        assert nd.check(run).passed, nd.check(run)
        np.testing.assert_allclose(run.v[-1], (0.0, 0.0, 4.8), rtol=0.0, atol=1e-12)
        assert run.energy.friction.max() <= 1e-15
        errors.append(np.abs(run.q[-1, :2] - 0.5 * speed * MASS / MOST * np.array((0.1, 0.2))).max())
    assert errors[2] <= 3e-6 and errors[0] / errors[2] >= 10.0


@pytest.mark.parametrize("excess", [-1e-6, 1e-6])
@pytest.mark.parametrize(
    "angle", [0.0, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (0.4, np.pi / 4)), 1.9]
)
def test_planar_joint_breaks_away_at_its_friction(angle, excess):
    push = (1.0 + excess) * MOST * np.array((np.cos(angle), np.sin(angle), 0.0))
    run = nd.simulate(puck(), 1.0, 1e-2, controller=lambda t, q, v: {"a": push})
    if excess > 0.0:  # of what does not move at all, round-off is all that there is
        assert nd.check(run).passed, nd.check(run)
    expected = max(0.0, excess) * MOST / MASS
    np.testing.assert_allclose(np.linalg.norm(run.v[-1]), expected, rtol=1e-6, atol=1e-14)


AXES = [(1, 0, 0), (1, 1, 0), (1, 1, 1), (0, 0, 1), (-2, 1, 5)]
TORQUE = 0.1


@pytest.mark.parametrize("axis", [pytest.param(a, marks=[] if a in AXES[1::3] else pytest.mark.slow) for a in AXES])
def test_ball_joint_turns_against_its_friction_whatever_the_axis(axis):
    way = np.array(axis) / np.linalg.norm(axis)
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("a", model_of(pin.JointModelSpherical()), v=2.0 * way, friction=[TORQUE] * 3)
    run = nd.simulate(scene, 1.0, 1e-2)
    assert nd.check(run).passed, nd.check(run)
    np.testing.assert_allclose(run.v[-1], (2.0 - TORQUE / INERTIA) * way, rtol=0.0, atol=1e-12)
    assert run.energy.friction.sum() == pytest.approx(-TORQUE * (2.0 - 0.5 * TORQUE / INERTIA), rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(run.joint("a/j").friction, axis=1), TORQUE, rtol=1e-12)


@pytest.mark.parametrize("excess", [-1e-6, 1e-6])
@pytest.mark.parametrize("axis", AXES)
def test_ball_joint_breaks_away_at_its_friction(axis, excess):
    push = (1.0 + excess) * TORQUE * np.array(axis) / np.linalg.norm(axis)
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("a", model_of(pin.JointModelSpherical()), friction=[TORQUE] * 3)
    run = nd.simulate(scene, 1.0, 1e-2, controller=lambda t, q, v: {"a": push})
    expected = max(0.0, excess) * TORQUE / INERTIA
    np.testing.assert_allclose(np.linalg.norm(run.v[-1]), expected, rtol=1e-6, atol=1e-14)


def test_friction_of_a_ball_joint_turns_with_the_spin_of_a_body_of_three_inertias():
    """J ω̇ = J ω × ω - τ_c ω/‖ω‖, of second order: friction is against the mean spin of a step."""
    J, begin, most = np.array((0.1, 0.25, 0.3)), np.array((1.0, 2.0, -1.5)), 0.3
    found = solve_ivp(
        lambda t, w: (-np.cross(w, J * w) - most * w / np.linalg.norm(w)) / J,
        (0.0, 0.8),
        begin,
        method="DOP853",
        rtol=1e-12,
        atol=1e-13,
    )
    model, errors = pin.Model(), []
    hang(model, 0, "j", pin.JointModelSpherical(), lump(1.0, J))
    for dt in (1e-2, 5e-3):
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_model("a", model, v=begin, friction=[most] * 3)
        run = nd.simulate(scene, 0.8, dt)
        assert nd.check(run).passed, nd.check(run)
        errors.append(np.abs(run.v[-1] - found.y[:, -1]).max())
    assert errors[0] < 3e-5 and errors[0] / errors[1] == pytest.approx(4.0, abs=0.1)


def test_friction_of_a_planar_joint_turns_with_its_slip():
    """A body whose centre of mass is beside the joint turns the slip of the joint while it spins; of second order."""
    arm, turning, begin = 0.1, 0.05, np.array((0.5, -2.0, 3.0))

    def motion(t, state):
        (c, s), v = (np.cos(state[2]), np.sin(state[2])), state[3:]
        M = np.diag((MASS, MASS, INERTIA + MASS * arm**2))
        M[:2, 2] = M[2, :2] = MASS * arm * np.array((-s, c))
        force = MASS * arm * v[2] ** 2 * np.array((c, s, 0.0))
        force[:2] -= MOST * v[:2] / np.linalg.norm(v[:2])
        force[2] -= turning * np.sign(v[2])
        return np.r_[v, np.linalg.solve(M, force)]

    exact = solve_ivp(motion, (0.0, 0.5), np.r_[0, 0, 0, begin], method="DOP853", rtol=1e-12, atol=1e-13).y[:3, -1]
    model, errors = pin.Model(), []
    hang(model, 0, "j", pin.JointModelPlanar(), lump(MASS, INERTIA, (arm, 0.0, 0.0)))
    for dt in (1e-2, 5e-3):
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_model("a", model, v=begin, friction=(MOST, MOST, turning))
        run = nd.simulate(scene, 0.5, dt)
        assert nd.check(run).passed, nd.check(run)
        x, y, c, s = run.q[-1]
        errors.append(np.abs((x, y, np.arctan2(s, c)) - exact).max())
    assert errors[0] < 1e-4 and errors[0] / errors[1] == pytest.approx(4.0, abs=0.1)


@pytest.mark.slow
def test_chain_of_ball_joints_lands_and_comes_to_rest_under_their_friction():
    """Five shares at once, with contacts: friction is in every ball, and against the spin wherever there is any."""
    n, middle = 5, at((0, 0, -0.2))
    link = lump(1.0, (0.02, 0.02, 0.005), middle.translation)
    model = limit(serial([pin.JointModelSpherical()] * n, link, (0, 0, -0.4)))
    scene, material = nd.Scene(), nd.Material(mu=0.5)
    scene.add_halfspace("ground", offset=-1.7, material=material)
    q = pin.integrate(model, pin.neutral(model), 0.5 * np.random.default_rng(2).normal(size=model.nv))
    links = {f"j{k}": [(shapes.capsule(0.03, 0.3), middle)] for k in range(n)}
    scene.add_model(
        "a", model, q=q, friction=[1.0] * model.nv, material=material, collisions=links, self_collisions=False
    )
    run = nd.simulate(scene, 1.0, 1e-2)
    assert nd.check(run).passed
    friction = np.concatenate([run.joint(f"a/j{k}").friction for k in range(n)])
    assert np.linalg.norm(friction, axis=1).max() <= 1.0 + 1e-9  # what pieces of a step add up to


@pytest.mark.parametrize(
    ("joint", "keywords", "words"),
    [
        (
            pin.JointModelSpherical(),
            {"friction": (0.1, 0.1, 0.2)},
            r"the same about all axes of joint 'j', a .*Spherical",
        ),
        (pin.JointModelFreeFlyer(), {"friction": [0.1] * 6}, r"friction of 'a' must be 0 in joint 'j', a .*FreeFlyer"),
        (pin.JointModelPlanar(), {"friction": (0.1, 0.2, 0)}, r"the same along both axes of joint 'j', a .*Planar"),
        (
            pin.JointModelSpherical(),
            {"stiffness": [1.0] * 3},
            r"stiffness of 'a' must be 0 in joint 'j', a .*Spherical",
        ),
        (pin.JointModelPlanar(), {"stiffness": [1.0] * 3}, r"stiffness of 'a' must be 0 in joint 'j', a .*Planar"),
    ],
)
def test_laws_that_are_not_modelled_are_refused(joint, keywords, words):
    with pytest.raises(ValueError, match=words):
        nd.Scene().add_model("a", model_of(joint), **keywords)


def test_limits_and_gains_of_joints_without_an_angle_are_refused():
    for joint, n in ((pin.JointModelSpherical(), 4), (pin.JointModelPlanar(), 4), (pin.JointModelRUBZ(), 2)):
        limited = model_of(joint, lowerPositionLimit=[-0.5] * n, upperPositionLimit=[0.5] * n)
        with pytest.raises(ValueError, match="limits of 'a' must be infinite in joint 'j', a JointModel"):
            nd.Scene().add_model("a", limited)
    scene = nd.Scene()
    scene.add_model("a", model_of(pin.JointModelPlanar()))
    with pytest.raises(ValueError, match="kp of the PD control of 'a' must be 0 on free, ball and planar joints"):
        nd.Stepper(scene, controller=lambda t, q, v: {"a": nd.PD(np.ones(3), 0.0, np.zeros(3))}).step()


def test_efforts_of_joints_in_one_body_are_limits(tmp_path):
    """Two hinges of an MJCF body, which Pinocchio makes one joint."""
    a = robot_of(
        tmp_path,
        '<mujoco><worldbody><body><joint axis="0 1 0" actuatorfrcrange="-3 3"/><joint axis="0 0 1"/>'
        '<geom size=".1"/></body></worldbody></mujoco>',
    )
    assert a.effort.tolist() == [3.0, np.inf] and a.report == ()


def test_what_files_say_of_joints_without_an_angle_fails_the_check(tmp_path, capsys):
    text = (
        f'<robot name="r"><link name="w"/><link name="a">{INERTIAL}</link><joint name="j" type="planar">'
        '<axis xyz="0 0 1"/>'
        '<parent link="w"/><child link="a"/><limit lower="-1" upper="1" effort="1" velocity="0"/>'
        '<dynamics damping="1" friction="2"/><safety_controller k_velocity="1"/></joint>'
        '<gazebo reference="a"><mu1>0.2</mu1><turnGravityOff>true</turnGravityOff></gazebo></robot>'
    )
    with pytest.warns(UserWarning, match="'r' leaves out: joint 'j': <limit> of a planar joint"):
        a = robot_of(tmp_path, text)
    assert a.missing == ("joint 'j': <limit> of a planar joint", "joint 'j': <dynamics> of a planar joint")
    assert a.dropped == ("joint 'j': <safety_controller>", "gazebo 'a': <mu1>", "gazebo 'a': <turnGravityOff>")
    assert cli.main(["check", str(tmp_path / "r.urdf")]) == 1
    assert "<dynamics> of a planar joint" in capsys.readouterr().out
    text = (
        '<mujoco><worldbody><body><joint name="j" type="ball" frictionloss="1" stiffness="2"/><geom size=".1"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.warns(UserWarning, match="stiffness of a ball joint"):
        robot_of(tmp_path, text)
    assert cli.main(["check", str(tmp_path / "r.mjcf")]) == 1
    text = (
        '<sdf version="1.9"><world name="w"><gravity>0 0 -1</gravity>'
        "<wind><linear_velocity>1 0 0</linear_velocity></wind>"
        '<model name="m"><link name="a"/><joint name="j" type="ball"><parent>world</parent><child>a</child>'
        "<axis><dynamics><damping>1</damping></dynamics></axis></joint></model></world></sdf>"
    )
    with pytest.warns(UserWarning, match="'r' leaves out: joint 'j': <axis> of a ball joint; world: <gravity>"):
        a = robot_of(tmp_path, text)
    assert a.missing == ("joint 'j': <axis> of a ball joint",)
    assert a.dropped == ("world: <gravity>", "world 'w': <linear_velocity> of <wind>")


@pytest.mark.parametrize(
    ("joint", "armature", "must"),
    [
        (pin.JointModelFreeFlyer(), (0, 0, 0.1, 0, 0, 0), "0 in"),
        (pin.JointModelFreeFlyer(), (0, 0, 0, 0.1, 0.1, 0.1), "0 in"),
        (pin.JointModelPlanar(), (0.1, 0.1, 0), "0 along both axes of"),
        (pin.JointModelSpherical(), (0.1, 0.1, 0.2), "the same about all axes of"),
    ],
)
def test_armature_along_axes_that_turn_with_a_body_is_refused(joint, armature, must):
    """Given, or in the model: what is thrown with spin went round in circles."""
    told = f"armature of 'a' must be {must} joint 'j', a JointModel.*: it is inertia of rotors, .*; got"
    for model, given in ((model_of(joint), armature), (model_of(joint, armature=armature), None)):
        with pytest.raises(ValueError, match=told):
            nd.Scene().add_model("a", model, armature=given)


@pytest.mark.parametrize(
    ("joint", "armature", "v"),
    [
        (pin.JointModelFreeFlyer(), (), (1, 0, 0, 0, 0, 3)),
        (pin.JointModelPlanar(), (0, 0, 0.1), (1, 0, 3)),
    ],
)
def test_what_spins_goes_straight_on(joint, armature, v):
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("a", model_of(joint), v=v, armature=armature)
    run = nd.simulate(scene, 1.0, 1e-3)
    # Steps of fourth order leave 1e-12.
    np.testing.assert_allclose(run.q[-1, :2], (1, 0), rtol=0.0, atol=1e-11)
