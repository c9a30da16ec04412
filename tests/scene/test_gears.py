"""Gears: q2 = ratio q1 + offset, with the reaction that it takes, from the API and from robot files."""

import numpy as np
import pinocchio as pin
import pytest
from conftest import INERTIAL
from mechanisms import hang, lump
from robot_texts import robot_of, scene_of
from scipy.integrate import solve_ivp

import nsdyn as nd
from nsdyn.scene import shapes
from nsdyn.stepping.checkpoint import checksums

MIMIC = (
    '<robot name="r"><link name="w"/><link name="a">{body}</link><link name="b">{body}</link>'
    '<joint name="j" type="{kind}"><parent link="w"/><child link="a"/><axis xyz="0 1 0"/>'
    '<limit lower="-2" upper="2" effort="9" velocity="0"/></joint>'
    '<joint name="k" type="{kind}"><parent link="{parent}"/><child link="b"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="0"/>{mimic}</joint></robot>'
)


def model_of(*kinds, inertias=(0.1, 0.4), chain=False):
    """Joints side by side, or one after the other, m = 1 kg each, a metre below its joint in a chain."""
    model = pin.Model()
    for k, (kind, inertia) in enumerate(zip(kinds, inertias, strict=True)):
        down = np.array([0.0, 0.0, -1.0 if chain else 0.0])
        place = down if chain and k else (0.0, 0.0 if chain else k, 0.0)
        joint = hang(model, k if chain else 0, f"j{k}", kind, lump(1.0, inertia, down), place)
        model.addJointFrame(joint)
    return model


def geared(model, ratio, offset=None, gravity=(0, 0, 0), **keywords):
    scene = nd.Scene(gravity=gravity)
    scene.add_model("a", model, **keywords)
    scene.add_gear("a", "j0", "j1", ratio, offset)
    return scene


@pytest.mark.parametrize(
    ("kinds", "second"),
    [
        ((pin.JointModelRZ(), pin.JointModelRZ()), 0.4),
        pytest.param((pin.JointModelRUBZ(), pin.JointModelRUBZ()), 0.4, marks=pytest.mark.slow),
        pytest.param((pin.JointModelRUBZ(), pin.JointModelPZ()), 1.0, marks=pytest.mark.slow),
    ],
)
def test_two_wheels(kinds, second):
    """Inertia I1 + a² I2, turned on by a torque on either; many turns leave the teeth where they are."""
    tau, ratio = np.array([0.3, 0.2]), -0.5
    scene, dt = geared(model_of(*kinds), ratio), 5e-2
    run = nd.simulate(scene, 10.0, dt, controller=lambda t, q, v: {"a": tau})
    assert nd.check(run).passed, nd.check(run)
    rate = (tau[0] + ratio * tau[1]) / (0.1 + ratio**2 * second)
    np.testing.assert_allclose(run.v, np.outer(run.t * rate, (1.0, ratio)), rtol=1e-11, atol=1e-12)
    # What the gear does to the joints is λ (-a, 1): it works nothing.
    reaction = np.diff(run.v, axis=0) * (0.1, second) / dt - tau
    expected = (second * ratio * rate - tau[1]) * np.array((-ratio, 1.0))
    np.testing.assert_allclose(reaction, np.broadcast_to(expected, reaction.shape), rtol=0.0, atol=1e-9)
    stepper = nd.Stepper(scene, dt)
    assert stepper.dynamics.trees[0].model.nv == 2  # one tree, not two
    energy = nd.Stepper(scene, dt, controller=lambda t, q, v: {"a": tau}).step().energy
    assert abs(energy["constraint"]) <= 1e-15 and abs(energy["defect"]) <= 1e-15
    angles = run.q
    if kinds[0].nq == 2:
        turn = np.arctan2(run.q[:, 1], run.q[:, 0])
        np.testing.assert_allclose(np.cos(turn - 0.5 * rate * run.t**2), 1.0, rtol=0.0, atol=1e-12)
    else:
        np.testing.assert_allclose(angles[:, 1], ratio * angles[:, 0], rtol=0.0, atol=1e-11)


@pytest.mark.slow
def test_geared_pendulum_is_of_second_order():
    """Two links in a chain, the second turns -2 times the first: against its equation of motion in q1."""
    ratio, model = -2.0, model_of(pin.JointModelRY(), pin.JointModelRY(), chain=True)
    model.gravity = pin.Motion(np.array([0.0, 0.0, -9.81]), np.zeros(3))
    data, G = model.createData(), np.array([1.0, ratio])

    def rate(t, y):
        M = pin.crba(model, data, G * y[0])
        return y[1], -G @ pin.nonLinearEffects(model, data, G * y[0], G * y[1]) / (G @ M @ G)

    exact = solve_ivp(rate, (0.0, 2.0), (1.0, 0.0), rtol=1e-11, atol=1e-12).y[:, -1]
    errors = []
    for dt in (8e-3, 4e-3, 2e-3):
        run = nd.simulate(geared(model, ratio, gravity=(0, 0, -9.81), q=(1.0, -2.0)), 2.0, dt)
        assert errors or nd.check(run).passed, nd.check(run)  # the coarsest
        np.testing.assert_allclose(run.q[:, 1], ratio * run.q[:, 0], rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(run.v[:, 1], ratio * run.v[:, 0], rtol=0.0, atol=1e-11)
        errors.append(abs(run.q[-1, 0] - exact[0]))
        energy = run.energy.kinetic + run.energy.potential
        assert np.abs(energy - energy[0]).max() <= 2e-3 * (dt / 8e-3) ** 2 * np.ptp(run.energy.kinetic)
    assert errors[-1] <= 1e-4
    assert 3.5 <= errors[0] / errors[1] <= 4.5 and 3.5 <= errors[1] / errors[2] <= 4.5


@pytest.mark.slow
@pytest.mark.parametrize("side", [0, 1])
def test_limits_of_either_joint_hold_both(side):
    """The wheels strike the limit of one of them, with e = 0.5, then rest on it under a torque."""
    model, ratio = model_of(pin.JointModelRZ(), pin.JointModelRZ()), -2.0
    model.upperPositionLimit = np.array([0.5, np.inf] if side == 0 else [np.inf, np.inf])
    model.lowerPositionLimit = np.array([-np.inf, -np.inf] if side == 0 else [-np.inf, -1.0])
    run = nd.simulate(geared(model, ratio, v=(1.0, -2.0), restitution=0.5), 1.0, 5e-3)
    assert nd.check(run).passed, nd.check(run)
    np.testing.assert_allclose(run.v[-1], (-0.5, 1.0), rtol=1e-12)
    assert run.q[:, 0].max() <= 0.5 + 1e-9
    pressed = geared(model, ratio, q=(0.5, -1.0))
    run = nd.simulate(pressed, 0.5, 1e-2, controller=lambda t, q, v: {"a": (0.3, 0.0)})
    assert nd.check(run).passed, nd.check(run)
    np.testing.assert_allclose(run.v, 0.0, rtol=0.0, atol=1e-12)
    # The limit takes all of the torque, or half of it on the wheel that turns twice as fast.
    held = run.joint("a/j0" if side == 0 else "a/j1").limit_impulse
    np.testing.assert_allclose(np.abs(held[1:]), 1e-2 * (0.3 if side == 0 else 0.15), rtol=1e-9)


def test_gripper_presses_with_half_the_force_on_each_side():
    """Two fingers, the second geared to the first by -1, which alone is pushed: F δx = N δx + N δx."""
    model = model_of(pin.JointModelPX(), pin.JointModelPX())
    model.jointPlacements[1], model.jointPlacements[2] = pin.SE3.Identity(), pin.SE3.Identity()
    geometry = pin.GeometryModel()
    for k, x in enumerate((-0.2, 0.2)):
        place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        geometry.addGeometryObject(pin.GeometryObject(f"finger{k}", k + 1, place, shapes.sphere(0.1).geometry))
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("a", model, geometry_model=geometry)
    scene.add_gear("a", "j0", "j1", -1.0)
    scene.add_box("box", (0.1, 0.4, 0.4), 1.0, position=(0.0, 0.0, 0.0))
    run = nd.simulate(scene, 0.5, 1e-2, controller=lambda t, q, v: {"a": (10.0, 0.0)})
    assert nd.check(run).passed, nd.check(run)
    assert run.joint("a/j0").position[-1] == pytest.approx(0.05, abs=1e-7)
    assert run.joint("a/j1").position[-1] == pytest.approx(-0.05, abs=1e-7)
    state = nd.Stepper(scene, 1e-2, controller=lambda t, q, v: {"a": (10.0, 0.0)})
    for _ in range(50):
        step = state.step()
    normal = step.solution.r.reshape(-1, 3)[:, 0]
    assert normal.size >= 2 and np.abs(step.v).max() <= 1e-9
    np.testing.assert_allclose(normal.sum() / 1e-2, 10.0, rtol=1e-8)


def test_urdf_mimic(tmp_path):
    """The reader makes the gear, in a chain, and starts where it says."""
    mimic = '<mimic joint="j" multiplier="-2" offset="0.1"/>'
    text = MIMIC.format(body=INERTIAL, kind="revolute", parent="a", mimic=mimic)
    scene = scene_of(tmp_path, text)
    assert scene.articulations["r"].report == () and scene.articulations["r"].q.tolist() == [0.0, 0.1]
    run = nd.simulate(scene, 0.5, 5e-3, controller=lambda t, q, v: {"r": (1.0, 0.0)})
    assert nd.check(run).passed, nd.check(run)
    assert np.ptp(run.q[:, 0]) > 0.1
    np.testing.assert_allclose(run.q[:, 1], 0.1 - 2 * run.q[:, 0], rtol=0.0, atol=1e-12)
    for before, after, words in (
        ('joint="j" m', 'joint="i" m', "joint1 of mimic of 'k' must be one of"),
        ('joint="j" m', 'joint="k" m', "joint2 of mimic of 'k' must be another than joint1"),
        ('multiplier="-2"', 'multiplier="x"', r"could not be read: .*value \(x\) is not a valid"),
    ):
        with pytest.raises(ValueError, match=words):
            scene_of(tmp_path, text.replace(before, after))
    # A fixed joint has nothing to gear, as in files that were made so: it is told.
    with pytest.warns(UserWarning, match="<mimic> of a fixed joint"):
        scene = scene_of(tmp_path, text.replace('name="k" type="revolute"', 'name="k" type="fixed"'))
    assert scene.articulations["r"].gears == ()


@pytest.mark.parametrize("kind", [pytest.param("revolute", marks=pytest.mark.slow), "prismatic"])
def test_mimic_joints_of_a_model(tmp_path, kind):
    """They move as the gears of the same URDF file do, and have the kinetic energy that Pinocchio's own have."""
    text = MIMIC.format(body=INERTIAL, kind=kind, parent="a", mimic='<mimic joint="j" multiplier="-2" offset="0.1"/>')
    path = tmp_path / "r.urdf"
    path.write_text(text)
    model, runs = pin.buildModelFromXML(text, mimic=True), []
    for add, given in (("add_urdf", path), ("add_model", model)):
        scene = nd.Scene(gravity=(1.0, 2.0, -9.81))
        getattr(scene, add)("r", given)
        runs.append(nd.simulate(scene, 0.5, 5e-3, controller=lambda t, q, v: {"r": (1.0, 0.0)}))
    assert model.nv == 1 and scene.articulations["r"].q.tolist() == [0.0, 0.1]
    np.testing.assert_allclose(runs[1].q, runs[0].q, rtol=0.0, atol=1e-12)
    assert nd.check(runs[1]).passed and np.ptp(runs[1].q[:, 0]) > 0.05
    M = pin.crba(model, model.createData(), runs[1].q[-1, :1])
    energy = 0.5 * runs[1].v[-1, 0] ** 2 * M[0, 0]
    np.testing.assert_allclose(runs[1].energy.kinetic[-1], energy, rtol=1e-12)


def test_mimic_joints_keep_what_the_others_have():
    """Coordinates after a mimic joint keep their limits, friction and inertia; what cannot mimic is named."""
    model = model_of(pin.JointModelRY(), pin.JointModelPrismaticUnaligned(np.array([0.6, 0.8, 0.0])), chain=True)
    hang(model, 2, "last", pin.JointModelRX(), lump(2.0, 1.0, (0.0, 0.1, 0.2)))
    model.upperPositionLimit, model.armature = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3])
    model.upperDryFrictionLimit = np.array([0.4, 0.5, 0.6])
    model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
    scene = nd.Scene()
    scene.add_model("a", pin.transformJointIntoMimic(model, 1, 2, -0.5, 0.2))
    a = scene.articulations["a"]
    np.testing.assert_allclose([a.model.upperPositionLimit[k] for k in (0, 2)], [1.0, 3.0])
    np.testing.assert_allclose((a.armature, a.friction), ((0.1, 0.0, 0.3), (0.4, 0.0, 0.6)))
    assert a.q.tolist() == [0.0, 0.2, 0.0] and a.gears[0].ratio == -0.5
    helix = model_of(pin.JointModelRY(), pin.JointModelHX(0.3), chain=True)
    for kind, ratio in ((helix, 2.0), (model, 0.0)):
        with pytest.raises(ValueError, match=rf"joint 'j1' of model of 'b' must be .* got the ratio {ratio}: build"):
            nd.Scene().add_model("b", pin.transformJointIntoMimic(kind, 1, 2, ratio, 0.0))


MJCF = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="a" axis="0 1 0" ref="0.2"/><geom size=".1" pos="0 0 -.5"/></body>
<body pos="0 1 0"><joint name="b" axis="0 1 0" ref="-0.1"/><geom size=".1" pos="0 0 -.5"/></body>
<body pos="0 2 0"><joint name="c" axis="0 1 0" limited="true" range="-1 1"/><geom size=".1" pos=".5 0 0"/></body>
</worldbody><equality><joint joint1="b" joint2="a" polycoef="{}"/><joint name="lock" joint1="c"/></equality></mujoco>"""


def test_mjcf_equalities_of_joints(tmp_path):
    """Linear polynomials between deviations from the file's zero, and one joint that is held; others are told."""
    scene = scene_of(tmp_path, MJCF.format("0.3 -2 0 0 0"), "m", v=(1.0, -2.0, 0.0))
    assert scene.articulations["m"].missing == ()
    stepper = nd.Stepper(scene, 5e-3)
    assert [tree.model.nv for tree in stepper.dynamics.trees] == [2, 1]
    for _ in range(100):
        step = stepper.step()
    mujoco = pytest.importorskip("mujoco", reason="the extra 'peers' is not installed")
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "m.mjcf"))
    data = mujoco.MjData(theirs)
    data.qpos[:] = step.q
    mujoco.mj_forward(theirs, data)
    np.testing.assert_allclose(data.efc_pos[:2], 0.0, rtol=0.0, atol=1e-12)  # what MuJoCo calls a violation
    assert abs(step.v[0]) > 0.1 and step.v[1] == pytest.approx(-2 * step.v[0], abs=1e-12)
    with pytest.warns(UserWarning, match="'m' leaves out: equality 'b': polycoef of degree 2, not linear"):
        a = robot_of(tmp_path, MJCF.format("0 1 0.5"), "m")
    assert a.missing == ("equality 'b': polycoef of degree 2, not linear",)


def test_a_short_polycoef_keeps_the_ratio_1(tmp_path):
    """As in MuJoCo, whose default is 0 1 0 0 0."""
    one, lock = robot_of(tmp_path, MJCF.format("0.3")).gears
    assert (one.ratio, lock.ratio) == (1.0, 0.0) and one.offset == pytest.approx(-0.1 + 0.3 - 0.2, abs=1e-15)


@pytest.mark.parametrize(
    ("equality", "words"),
    [
        ('<joint name="e" joint1="b" joint2="b"/>', "joint2 of equality 'e' must be another than joint1, got 'b'"),
        ('<joint name="e" joint1="b" polycoef="0 1 0 0 0 0"/>', "polycoef of equality 'e' must be at most 5 numbers"),
        ('<weld name="e" body1="k" body2="k"/>', "equality 'e' must join two bodies or sites, got 'k' twice"),
        ('<connect name="e" site1="s"/>', "equality 'e' joins .*, which are not both bodies or sites"),
    ],
)
def test_equalities_that_join_nothing_are_refused(tmp_path, equality, words):
    body = '<body name="k"><joint name="b"/><geom size=".1" pos="0 0 1"/><site name="s"/></body>'
    with pytest.raises(ValueError, match=words):
        scene_of(tmp_path, f"<mujoco><worldbody>{body}</worldbody><equality>{equality}</equality></mujoco>")


def test_sdf_mimic(tmp_path):
    """multiplier (q1 - reference) + offset."""
    joint = '<joint name="{0}" type="revolute"><parent>{1}</parent><child>{2}</child><axis>{3}</axis></joint>'
    mimic = '<mimic joint="j"><multiplier>3</multiplier><offset>0.1</offset><reference>0.2</reference></mimic>'
    a = robot_of(
        tmp_path,
        '<sdf version="1.11"><model name="m"><link name="a"/><link name="b"/>'
        + joint.format("j", "world", "a", "")
        + joint.format("k", "a", "b", mimic)
        + "</model></sdf>",
    )
    (gear,) = a.gears
    assert (gear.coordinate1, gear.coordinate2, gear.ratio) == (0, 1, 3.0) and gear.offset == pytest.approx(-0.5)
    assert a.report == ()


def test_bad_gears():
    continuous = model_of(pin.JointModelRUBZ(), pin.JointModelRUBZ())
    ball = model_of(pin.JointModelRZ(), pin.JointModelSpherical())
    for model, joints, ratio, words in (
        (continuous, ("j0", "j1"), np.pi, r"ratio of gear 'a/j1' must be a fraction of whole numbers up to 1000"),
        (continuous, ("j0", "j1"), np.nan, "ratio of gear 'a/j1' must be finite"),
        (continuous, ("j0", "j9"), 1.0, "joint2 of gear 'a/j9' must be one of"),
        (continuous, ("j1", "j1"), 1.0, "joint2 of gear 'a/j1' must be another than joint1"),
        (ball, ("j0", "j1"), 1.0, "joint2 of gear 'a/j1' must be a revolute or prismatic joint, 'j1' is none"),
    ):
        scene = nd.Scene()
        scene.add_model("a", model)
        with pytest.raises(ValueError, match=words):
            scene.add_gear("a", *joints, ratio)


def test_resumed_with_another_gear_is_refused():
    model = model_of(pin.JointModelRZ(), pin.JointModelRZ())
    assert checksums(geared(model, 1.0)) != checksums(geared(model, 2.0))


def test_acceleration_of_geared_wheels():
    scene = geared(model_of(pin.JointModelRZ(), pin.JointModelRZ()), 3.0)
    pytest.importorskip("clarabel", reason="the extra 'acceleration' is not installed")
    from nsdyn.literature.acceleration import accelerations, least_constraint

    found = accelerations(least_constraint(scene, wrenches={"a/j0": ((0, 0, 0), (0, 0, 1.0))}))
    np.testing.assert_allclose(found.a, np.array((1.0, 3.0)) / (0.1 + 9 * 0.4), rtol=1e-9)


@pytest.mark.slow
def test_a_driven_wheel_drives_the_other():
    """Its work is that of both; what contradicts the drive stops by name."""
    scene = geared(model_of(pin.JointModelRZ(), pin.JointModelRZ()), -0.5)
    scene.set_motion("a/j0", lambda t: 2.0 * t)
    run = nd.simulate(scene, 1.0, 1e-2)
    assert nd.check(run).passed, nd.check(run)
    np.testing.assert_allclose(run.v[-1], (2.0, -1.0), rtol=1e-12)
    assert run.energy.constraint.sum() == pytest.approx(0.5 * (0.1 * 4.0 + 0.4), rel=1e-9)
    scene.set_motion("a/j1", 1.0)
    with pytest.raises(ValueError, match=r"loops or gears .* do not close"):
        nd.simulate(scene, 1.0, 1e-2)
