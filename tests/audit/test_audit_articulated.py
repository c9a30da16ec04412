"""The audit follows articulations by equations of its own: true recordings pass, and no falsified one does."""

import json
import shutil
import sys
import warnings
from dataclasses import replace

import audits
import falsified
import fuzz
import numpy as np
import pinocchio as pin
import pytest
from conftest import DATA
from mechanisms import add, at, four_bars, hang, limit, lump, pendulum, serial

import nsdyn as nd
from nsdyn.audit.findings import TOLERANCES
from nsdyn.recording.retrace import trees
from nsdyn.scene import shapes

SHORT = "boxes", "ball", "machine"


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in SHORT else pytest.mark.slow) for n in falsified.RUNS]
)
def test_true_recordings_pass(name):
    audit = nd.check(falsified.true(name))
    assert audit.passed, audit


@pytest.mark.parametrize(
    ("v", "dt", "how"),
    [
        ((2, 0, 0, 0, 19, 0), 5e-3, {"controller": lambda t, q, v: {"robot": np.zeros(6)}}),
        ((2, 2, -0.5, -13, 17, 0), 1e-2, {"external_force": lambda t, q, v: {"robot/link": (1, 2, 0)}}),
    ],
    ids=["forces all along or in the middle", "a push in the middle"],
)
def test_a_link_that_spins_fast_passes(v, dt, how):
    """It turns by a tenth of a rad in half a step: what acts there is as much in doubt as where it is."""
    model = pin.Model()
    inertia = pin.Inertia(1.0, np.array([0, 0, -0.1]), np.diag([4e-3, 3e-3, 3e-3]))
    joint = hang(model, 0, "body", pin.JointModelFreeFlyer(), inertia)
    model.addBodyFrame("link", joint, pin.SE3.Identity(), model.addJointFrame(joint))
    scene = nd.Scene()
    scene.add_model("robot", model, v=v)
    audit = nd.check(nd.simulate(scene, 0.1, dt, **how))
    assert audit.passed, audit


@pytest.mark.parametrize(("speed", "dt"), [(10.0, 0.02), (2.0, 0.1)])
def test_what_is_driven_by_a_round_number_passes(speed, dt):
    """It turns by a tenth of a rad in half a step, which the step takes in one part: in two its doubt was too small."""
    model = pin.Model()
    spin = hang(model, 0, "spin", pin.JointModelRZ(), lump(5.0, (1.0, 1.0, 2.0)))
    hang(model, spin, "arm", pin.JointModelRY(), lump(1.0, 0.01, (0.2, 0.0, -0.3)), (0.3, 0.0, 0.0))
    scene = nd.Scene()
    scene.add_model("robot", model, v=(speed, 0.0), friction=(0.0, 100.0))
    scene.set_motion("robot/spin", velocity=speed)
    audit = nd.check(nd.simulate(scene, 1.0, dt))
    assert audit.passed, audit


UNSEEN = "certificates", "provenance"
"""What no motion shows."""

EACH = {
    ("a state between its neighbours, with a controller", "quadruped"): "joint_motion",
    ("another bound about one axis of a ball joint", "ball"): "joint_slip",
    ("less of it", "ball"): "joint_cone",
    ("friction of other materials", "quadruped"): "cone",
    ("works of drives as numerics", "cart"): "drives",
    ("actuation scaled by a millionth everywhere", "machine"): "strength",
    ("a limit in mid-range that an actuator works against", "machine"): "stops",
    ("an offset of gears", "machine"): "pushes",
    ("another restitution of limits", "machine"): "rebounds",
    ("masses off by a millionth", "machine"): "joint_momentum",
    ("lengths of pieces", "machine"): "pieces",
    ("quaternions of links not unit", "quadruped"): "turns",
    ("actuation as of external wrenches", "quadruped"): "wrenches",
    ("a defect of the ledger", "cart"): "balance",
    ("forces in a loop, which takes them up", "bars"): "loads",
    ("a loop elsewhere", "bars"): "loops",
    ("links turned", "quadruped"): "links",
    ("limits of the model closer", "arm"): "limits",
    ("everything backwards", "boxes"): "distance",
    ("points exchanged", "boxes"): "points",
    ("a state twice", "boxes"): "lifts",
    ("a body faster in one state", "boxes"): "momentum",
    ("a body lifted aside at the end", "boxes"): "sideways",
    ("a coefficient of one contact", "boxes"): "materials",
    ("places of shapes that are no poses", "boxes"): "scene",
    ("energy said to be created", "boxes"): "created",
    ("relative velocities turned round", "boxes"): "friction",
    ("half of an impulse of friction left out", "boxes"): "slip",
    ("a time that is no number", "boxes"): "numbers",
    ("times shifted by a step", "boxes"): "times",
    ("a contact of a body with itself", "boxes"): "pairs",
    ("shapes of a contact exchanged", "boxes"): "normal",
    ("work of one contact in another of its step", "boxes"): "contact_works",
    ("kinetic energy in another state", "boxes"): "energy",
    ("sizes of round shapes", "boxes"): "overlap",
    ("materials that are said not to rebound", "bounces"): "partings",
    ("materials that are said to rebound more", "bounces"): "bounces",
    ("gaps a thousandth larger", "bounces"): "gaps",
    ("relative velocities in another step", "bounces"): "velocities",
    ("velocities as differences of places", "bounces"): "motion",
    ("impacts booked as friction", "bounces"): "works",
    ("impacts that last", "bounces"): "spin",
    ("states in another step", "bounces"): "states",
    ("a frame of a body that is not its own", "pushes"): "frames",
}
"""What finds it: each finding that is of no other test, by one recording; all others are slow."""

BY_OTHERS = {*UNSEEN, "axes", "dissipation", "lift", "numerics", "prescribed", "shared_rebounds"}
"""Findings of other tests."""


def test_each_finding_has_a_falsified_recording():
    assert {*EACH.values(), *BY_OTHERS} == TOLERANCES.keys() and EACH.keys() < {*falsified.CASES}


@pytest.mark.parametrize(
    ("kind", "name"), [pytest.param(*c, marks=[] if c in EACH else pytest.mark.slow) for c in falsified.CASES]
)
def test_falsified_recordings_do_not_pass(kind, name):
    audit = nd.check(falsified.false(kind, name))
    assert not audit.passed and audit.verdict.startswith("FAILED"), audit
    assert (kind, name) not in EACH or not audit[EACH[kind, name]].passed, audit


def test_verdict_names_what_was_not_looked_at():
    audit = nd.check(falsified.true("quadruped"))
    assert audit.passed and audit.not_audited == ("loads", *UNSEEN)
    assert audit.verdict == "passed, not audited: loads, certificates, provenance"
    assert repr(audit).splitlines()[-1] == f"quadruped: {audit.verdict}"
    assert "controller" in audit["loads"].reason
    told = json.loads(json.dumps(audit.as_dict()))
    assert told["verdict"] == audit.verdict and told["not_audited"] == [*audit.not_audited]


@pytest.mark.parametrize("what", ["an unknown joint", "every second step", "no contacts"])
def test_what_cannot_be_audited_is_said(what):
    scene = nd.scenes.load("cart_pole")()
    options = {"every second step": {"every": 2}, "no contacts": {"contacts": False}}.get(what, {})
    t = nd.simulate(scene, 0.02, 5e-3, **options)
    if what == "an unknown joint":
        t.scene["articulations"][0]["model"]["joints"][1]["kind"] = "JointModelScrew"
    audit = nd.check(t)
    assert audit.passed and {"joint_momentum", "joint_motion", "works"} <= {*audit.not_audited}, audit
    assert ("links" in audit.not_audited) == (what == "an unknown joint")
    assert audit["joint_momentum"].reason
    if what == "an unknown joint":
        assert "JointModelScrew is no kind of joint" in audit["links"].reason


def test_a_recording_holds_its_articulations(tmp_path):
    """All kinds of joints, saved and read: the audit builds the same mass matrix, weights and frames from it."""
    rng, model, parent = np.random.default_rng(0), pin.Model(), 0
    axis = np.array([0.0, 0.6, 0.8])
    unbounded = pin.JointModelRevoluteUnboundedUnaligned()
    unbounded.axis = axis
    both = pin.JointModelComposite()
    both.addJoint(pin.JointModelRX(), pin.SE3.Random())
    both.addJoint(pin.JointModelPY())
    for k, joint in enumerate(
        (
            pin.JointModelFreeFlyer(),
            pin.JointModelRUBX(),
            unbounded,
            pin.JointModelRevoluteUnaligned(axis),
            pin.JointModelPrismaticUnaligned(axis),
            pin.JointModelHX(0.2),
            pin.JointModelHelicalUnaligned(axis, 0.1),
            pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[1]),
            pin.JointModelPlanar(),
            pin.JointModelTranslation(),
            pin.JointModelSpherical(),
            pin.JointModelSphericalZYX(),
            both,
        )
    ):
        parent = model.addJoint(parent, joint, pin.SE3.Random(), f"j{k}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Random())
        model.addJointFrame(parent)
    scene = nd.Scene()
    armature, of = rng.uniform(size=model.nv), model.idx_vs
    # That of axes that turn with a body is none, but for one about all axes.
    armature[of[1] : of[1] + 6], armature[of[9] : of[9] + 2], armature[of[11] : of[11] + 3] = 0.0, 0.0, 0.5
    scene.add_model("a", model, collisions={"j12": [shapes.sphere(0.1)]}, armature=armature)
    nd.simulate(scene, 1e-3, 1e-3).save(tmp_path / "run.h5")
    t = nd.Trajectory.load(tmp_path / "run.h5")
    assert nd.check(t).passed
    m = trees(t).mechanisms[0]
    model.armature = armature
    data, q = model.createData(), pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    M = np.triu(np.array(pin.crba(model, data, q)))
    np.testing.assert_allclose(m.mass(q), M + np.triu(M, 1).T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(m.weight(q), pin.computeGeneralizedGravity(model, data, q), rtol=0, atol=1e-11)
    pin.forwardKinematics(model, data, q)
    m.place(q)
    for k in range(1, model.njoints):
        np.testing.assert_allclose(m.pose(k).homogeneous, data.oMi[k].homogeneous, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_robot_files_pass(robot, tmp_path):
    """Loops, springs, frames of MJCF, URDF and SDF."""
    (tmp_path / "box.stl").write_bytes(fuzz.binary_stl())
    shutil.copy(DATA / "assets.xml", tmp_path)
    shutil.copy(DATA / "robot.xml", tmp_path)
    scene = nd.Scene()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene.add_urdf("urdf", robot[0], position=(9, 0, 4), package_dirs=robot[1], self_collisions=False)
        scene.add_mjcf("mjcf", tmp_path / "robot.xml", self_collisions=False)
        trajectory = nd.simulate(scene, 0.05, 1e-3)
    audit = nd.check(trajectory)
    assert audit.passed and audit.not_audited == UNSEEN, audit


@pytest.mark.parametrize(
    "seed",
    [
        *(3094, 20160),
        *(
            pytest.param(seed, marks=pytest.mark.slow)
            for seed in (1, 4, 6, 2050, 2071, 2173, 5079, 40004, 70087, 90053, 95096, 99, 65, 127, 175, 3108, 2113)
        ),
    ],
)
def test_random_robots_pass(seed):
    """Among them one whose driven joint takes up impacts, and one whose loops turn fast.

    And contacts that do nothing at θ = 0.7 (3094), steps cut where a driven joint varies (2050), forces that work while
    joints turn fast (2071), small angles by cosine and sine (2173, 3108), a limit met on the way there and back (5079),
    an end of loops that one pass finds (20160), impacts where θ = 1 has other impulses at the same time (40004), a dry
    joint that has stopped where a move begins (99), pieces of 1e-15 s (2113), a limit struck at 27 rad/s (70087),
    a start at a velocity that a gear beside a driven joint does not admit (90053), and a link that is carried round at
    50 rad/s, for which rules of fourth order differ by tens of times what two of them do (95096).
    """
    audit = nd.check(audits.random_run(seed))
    assert audit.passed, audit


@pytest.mark.slow
@pytest.mark.parametrize("kind", [pin.JointModelRY, pin.JointModelSpherical])
def test_a_heavy_payload_passes(kind):
    """Links whipped by 10 000 times their mass, which are fast for a short time: thousands of parts of one length."""
    bodies = [lump(mass, mass / 48, (0, 0, -0.25)) for mass in (1.0, 1.0, 1e4)]
    model = serial([kind()] * 3, bodies, (0, 0, -0.5))
    scene, start = nd.Scene(), np.resize([0.5, 0.2, -0.3, 0.4], model.nv)
    scene.add_model("arm", model, q=pin.integrate(model, pin.neutral(model), start), limits=False)
    audit = nd.check(nd.simulate(scene, 0.15, 1e-2))
    assert audit.passed and audit.not_audited == UNSEEN, audit


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_a_driven_arm_that_hits_a_box_passes(restitution):
    """With θ = 1 the moves after impacts act when these do; drives work in flows of a whole step, to fourth order."""
    model = limit(serial([pin.JointModelRY()] * 3, lump(1.0, 0.02, (0, 0, -0.2)), (0, 0, -0.4)))
    scene, material = nd.Scene(), nd.Material(mu=0.4, restitution=restitution)
    scene.add_halfspace("ground", offset=-1.1, material=material)
    scene.add_box("box", (0.2, 0.2, 0.2), 0.7, position=(-0.85, 0, -1.0), material=material)
    limb = [(shapes.capsule(0.03, 0.3), at((0, 0, -0.2)))]
    laws = {"friction": [0.3] * 3, "damping": [0, 0.3, 0.1], "material": material, "self_collisions": False}
    shape = {f"j{k}": limb for k in range(3)}
    scene.add_model("arm", model, q=[0.2, 0.5, -0.4], v=[4.2, 0, 0], collisions=shape, **laws)
    scene.set_motion("arm/j0", velocity=lambda t: 4.2 * np.cos(7.0 * t))
    audit = nd.check(nd.simulate(scene, 1.0, 1e-2, theta=1.0))
    assert audit.passed, audit


def test_what_hangs_still_passes():
    """Its weight has no part along the joint but round-off, which nothing else is of the size of."""
    model = pin.Model()
    hang(model, 0, "hinge", pin.JointModelRY(), lump(1.0, 0.02, (0.1, 0.0, -0.3)))
    scene = nd.Scene()
    scene.add_model("a", model, q=[np.arctan2(0.1, 0.3)])
    t = nd.simulate(scene, 0.5, dt=5e-3)
    assert 0.0 < np.abs(t.v).max() < 1e-14
    assert nd.check(t).passed


@pytest.mark.slow
def test_rolling_of_a_boat_creates_nothing():
    """The work of contacts that stay closed is O(h²) of a motion, and in the ledger as numerics."""
    model = pin.Model()
    hull = hang(model, 0, "hull", pin.JointModelFreeFlyer(), lump(1.0, (0.003, 0.004, 0.003), (0, 0, -0.05)))
    model.addJointFrame(hull)
    hang(model, hull, "inside", pin.JointModelRX(), lump(0.2, 1e-4, (0, 0, -0.03)))
    lying = pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.zeros(3))
    scene, material = nd.Scene(), nd.Material(mu=0.8)
    scene.add_halfspace("ground", material=material)
    q = np.r_[0, 0, 0.1, pin.Quaternion(pin.rpy.rpyToMatrix(0.9, 0, 0)).coeffs(), 0]
    shape = {"hull": [(shapes.capsule(0.1, 0.3), lying)]}
    scene.add_model("boat", model, q=q, collisions=shape, material=material, limits=False, self_collisions=False)
    audit = nd.check(nd.simulate(scene, 2.0, 2e-2))
    assert audit.passed, audit


def test_what_touches_at_the_start_stays():
    """Its first work is the scheme's, as all that follows."""
    audit = nd.check(audits.named("woodpecker", 0.01, 1e-3))
    assert audit.passed, audit


def test_limits_and_contacts_that_rebound_in_turn():
    """Their works are what changes the kinetic energy in all: parts are bounded, the sum is known to round-off."""
    model = pin.Model()
    base = hang(model, 0, "base", pin.JointModelFreeFlyer(), lump(3.0, (0.05, 0.06, 0.08)))
    leg = hang(model, base, "leg", pin.JointModelRY(), lump(0.3, (2e-3, 2e-3, 2e-4), (0, 0, -0.1)), (0.2, 0.12, -0.03))
    for joint in (base, leg):
        model.addJointFrame(joint)
    for bound, sign in ((model.lowerPositionLimit, -1.0), (model.upperPositionLimit, 1.0)):
        bound[-1] = sign
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=0.0))
    scene.add_model(
        "r",
        model,
        q=[0, 0, 0.5, -0.1, 0.18, 0, (1 - 0.1**2 - 0.18**2) ** 0.5, 0.74],
        collisions={
            "base": [shapes.box((0.4, 0.2, 0.1))],
            "leg": [(shapes.capsule(0.02, 0.2), at((0, 0, -0.1)))],
        },
        restitution=0.5,
        material=nd.Material(mu=0.0, restitution=0.4),
        self_collisions=False,
    )
    run = nd.simulate(scene, 0.28, 4e-3)
    assert nd.check(run).passed, nd.check(run)
    c, m, kicks = run.columns, trees(run).mechanisms[0], trees(run).way(0, 63).kicks
    (kick,) = [kick for kick in kicks if kick.h == 0.0 and kick.touches and kick.given[1].any()]
    ((row, *_),) = kick.touches
    impulse, speed = kick.pushed + kick.given[1], 0.5 * (kick.before + kick.after)
    before, after = (0.5 * v @ m.mass(kick.q) @ v for v in (kick.before, kick.after))
    assert after - before == pytest.approx(impulse @ speed, abs=1e-13)  # J, of 11 J
    assert kick.pushed @ speed > 0.05 and c["contacts/work_normal"][row] < -0.03  # it has struck more than once
    for names, more, where in (
        (["energy/normal", "energy/integration"], 1e-6, "works"),  # with 2e-9 J that the step's move leaves open
        (["contacts/work_normal"], 10.0, "contact_works"),  # no speed there gives as much
    ):
        off = dict(c)
        for name, sign in zip(names, (1.0, -1.0), strict=False):
            off[name] = c[name].copy()
            off[name][63 if name.startswith("energy") else row] += sign * more
        audit = nd.check(replace(run, columns=off))
        assert not audit[where].passed and audit["balance"].passed


@pytest.mark.parametrize(("speed", "dt", "theta"), [(3.0, 1e-2, 0.5), (20.0, 5e-3, 0.5), (5.0, 5e-3, 1.0)])
def test_a_linkage_that_strikes_a_limit_passes(speed, dt, theta):
    """Its motion leaves a little of the speed at which its loop opens, which no impact takes, only forces do."""
    model = pendulum(3)
    model.lowerPositionLimit, model.upperPositionLimit = np.array([0.0, -9.0, -9.0]), np.array([1.3, 9.0, 9.0])
    scene = nd.Scene()
    scene.add_model("linkage", model, q=(0.6, -1.2, -1.1), v=(speed, 0.0, 0.0), restitution=1.0)
    scene.add_loop("linkage", "closure", "j2", position=(0.0, 0.0, -1.0))
    run = nd.simulate(scene, 0.8, dt, theta=theta)
    assert (run.columns["joints/limit"] != 0.0).any(), "it strikes"
    audit = nd.check(run)
    assert audit.passed, audit


@pytest.mark.parametrize(("force", "duration", "dt"), [(0.01, 0.1, 1e-3), (10.0, 0.5, 1e-2)], ids=["slow", "wild"])
def test_light_links_that_carry_a_load_on_a_loop_pass(force, duration, dt):
    """Slow, what leaves a loop open by 1e-13 m counts; wild, the equations of a step are beyond a fixed point."""
    model, parent, place = pin.Model(), 0, at((0, 0, 0))
    for k, mass in enumerate((0.01, 1.0, 0.01, 0.01)):
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"j{k}")
        place = at((0, 0, 0.1))
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(mass, 0.01), place)
        model.addJointFrame(parent)
    scene = nd.Scene()
    scene.add_model("swing", model, q=(np.pi - 0.5, 0.0, 1.0 - np.pi, 0.0))
    scene.add_loop("swing", "closure", "j3", position=(0, 0, 0.1))
    audit = nd.check(nd.simulate(scene, duration, dt, external_force=lambda t, q, v: {"swing/j1": (force, 0, 0)}))
    assert audit.passed, audit


@pytest.mark.parametrize("quickens", [0.0, 20.0])
def test_a_rod_that_falls_on_the_edge_of_a_driven_plate_passes(quickens):
    """It strikes anywhere in a step, on an edge that moves: where the plate is then counts, not where it is halfway."""
    model = pin.Model()
    cart = hang(model, 0, "cart", pin.JointModelPX(), pin.Inertia.FromSphere(10.0, 0.1))
    hinge = model.addJoint(cart, pin.JointModelRY(), at((0, 0, 0.2)), "rod")
    model.appendBodyToJoint(hinge, pin.Inertia.FromCapsule(0.3, 0.02, 0.3), at((0, 0, 0.2)))
    model.addBodyFrame("limb", hinge, at((0, 0, 0.2)), 0)
    scene = nd.Scene()
    scene.add_box("plate", (0.1, 0.5, 0.1), fixed=True, position=(-0.2, 0, 0.1))
    scene.add_model("robot", model, q=(0.0, -1.2), v=(2.0, 0.0), collisions={"limb": [shapes.capsule(0.02, 0.3)]})
    scene.set_motion("plate", velocity=lambda t: (2.0 + quickens * t, 0, 0))
    scene.set_motion("robot/cart", velocity=lambda t: 2.0 + quickens * t)
    run = nd.simulate(scene, 0.3, 1e-2)
    assert run.columns["contacts/impulse"].any(), "it strikes"
    audit = nd.check(run)
    assert audit.passed, audit


def test_a_linkage_at_rest_passes():
    """It keeps its loop as open as the last step of its motion left it, which may be all that the step allows."""
    model, loops, v = four_bars(1)
    scene = nd.Scene(gravity=(0, 0, 0))
    add(scene, "bars", model, loops, q=(5e-13, 0, 0), v=0 * v)
    audit = nd.check(nd.simulate(scene, 2e-3, 1e-3))
    assert audit.passed, audit


def test_limits_and_bodies_that_strike_in_turn_with_theta_above_half():
    """A capsule falls on an arm that rests on its limit: where it strikes is in doubt in a step that is cut."""
    model, material = pin.Model(), nd.Material(mu=0.5, restitution=0.6)
    arm = hang(model, 0, "arm", pin.JointModelRY(), lump(0.2, (1e-3, 3e-3, 3e-3), (0.2, 0, 0)))
    model.addJointFrame(arm)
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, 0.0
    scene, lying = nd.Scene(), pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.array([0.2, 0, 0]))
    scene.add_model("r", model, collisions={"arm": [(shapes.capsule(0.02, 0.4), lying)]}, material=material)
    thrown = {"quaternion": (0.64, 0.48, 0.36, 0.48), "angular_velocity": (6, -8, 4), "material": material}
    scene.add_capsule("body", 0.03, 0.1, 1.0, position=(0.3, 0, 0.13), **thrown)
    audit = nd.check(nd.simulate(scene, 0.15, 1e-2, theta=0.75, impact="fremond"))
    assert audit.passed, audit


@pytest.mark.parametrize(("dt", "depth", "kp"), [(5e-3, 1.2, 60.0), (1e-2, 1.2, 300.0), (1e-2, 2.0, 60.0)])
def test_a_quadruped_that_squats_onto_the_limits_of_its_knees_passes(dt, depth, kp):
    """Some knees rest, others strike, and projections lift what rests: only knees that rest may work as numerics."""
    stance = np.array((0.0, 0.8, -1.6) * 4)

    def squat(t, q, v):
        down = depth * (1.0 - np.cos(8.0 * np.pi * t)) * np.tile([0.0, 0.5, -1.0], 4)
        return {"quadruped": nd.PD(kp=kp, kd=2.0, target=stance + down)}

    run = nd.simulate(nd.scenes.load("quadruped")(), 0.2, dt, controller=squat)
    assert (run.columns["joints/limit"] != 0.0).any(), "it gets there"
    audit = nd.check(run)
    assert audit.passed, audit


@pytest.mark.slow
def test_many_true_recordings_pass(monkeypatch, capsys):
    """Sixty random robots and the named scenes; `demos/bench/audits.py` has any number."""
    monkeypatch.setattr(sys, "argv", ["audits.py", "--count", "60"])
    audits.main()
    lines = capsys.readouterr().out.splitlines()
    assert not [line for line in lines if line.endswith(":")]
    assert sum(int(line.split()[0]) for line in lines if "passed" in line) >= 70


@pytest.mark.parametrize("friction", [1e-3, 5.0])
def test_a_joint_that_friction_holds_at_the_origin_passes(friction):
    """Its placement and its centre of mass are 0: the size of its energy is that of its inertia."""
    model = pin.Model()
    hang(model, 0, "j", pin.JointModelPZ(), lump(3.7, 1.0))
    scene = nd.Scene()
    scene.add_model("r", model, q=[0.0], friction=np.array([3.7 * 9.81 + friction]))
    assert nd.check(nd.simulate(scene, 0.2, dt=5e-3)).passed


def test_velocities_of_links_are_as_uncertain_as_the_motion_of_their_tree():
    """Light links that spin on a peg: their flow to an impact errs, by up to 1e-9 of the fastest velocity."""
    rng, turned = np.random.default_rng(2), pin.utils.rotate("y", np.pi / 2)
    scene, model, joint, shapes_of = nd.Scene(), pin.Model(), 0, {}
    material = nd.Material(0.4, 0.3)
    scene.add_cylinder(
        "peg", 0.1, 1.0, fixed=True, position=(0, 0, 1), quaternion=(0.5**0.5, 0, 0, 0.5**0.5), material=material
    )
    for k in range(3):
        kind, x = (pin.JointModelSpherical(), 0.1) if k else (pin.JointModelFreeFlyer(), 0.0)
        joint = model.addJoint(joint, kind, pin.SE3(np.eye(3), np.array([x, 0, 0])), f"l{k}")
        middle = np.array([0.05, 0, 0])
        model.appendBodyToJoint(
            joint, pin.Inertia(0.1, np.zeros(3), 1e-3 / 6 * np.diag([0.1, 1, 1])), pin.SE3(np.eye(3), middle)
        )
        model.addJointFrame(joint)
        shapes_of[f"l{k}"] = [(shapes.capsule(0.02, 0.06), pin.SE3(turned, middle))]
    q = np.r_[-0.15, 0, 1.15, 0, 0, 0, 1, pin.neutral(model)[7:]]
    v = 5.0 * rng.normal(size=model.nv)
    scene.add_model("chain", model, collisions=shapes_of, self_collisions="apart", material=material, q=q, v=v)
    assert nd.check(nd.simulate(scene, 0.03, 1e-2), velocities=1e-9).passed


def test_an_inertia_that_no_body_has_is_named(tmp_path):
    """Files have such: a link that turns about y with a negative moment about x. Pinocchio's constructor refuses it."""
    path = tmp_path / "r.sdf"
    path.write_text(
        '<sdf version="1.7"><model name="m"><link name="a"><inertial><pose>0 0 -0.5 0 0 0</pose>'
        "<mass>1</mass><inertia><ixx>-0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link>"
        '<joint name="j" type="revolute"><parent>world</parent><child>a</child><axis><xyz>0 1 0</xyz></axis></joint>'
        "</model></sdf>"
    )
    with pytest.raises(ValueError, match=r"inertia of link 'a' is not that of a body: .* are not all positive"):
        nd.Scene().add_sdf("r", path)
    scene = nd.Scene()
    with pytest.warns(UserWarning, match="inertia of link 'a'"):
        scene.add_sdf("r", path, inertias="trust", q=[0.5])
    found = nd.check(nd.simulate(scene, 0.1, 0.01))
    assert [finding.name for finding in found.findings if not finding.passed] == ["scene"]


def test_moments_that_are_round_off_are_those_of_a_point(tmp_path):
    """As of iCub's hips: links of -5e-20 kg m², beside others that have moments."""
    link = '<link name="{}"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/><inertia {}/></inertial></link>'
    joint = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 1 0"/>'
    joint += '<origin xyz="0 0 -0.3"/><limit lower="-3" upper="3" effort="9" velocity="0"/></joint>'
    own = [f'ixx="{x}" iyy="{x}" izz="0" ixy="0" ixz="0" iyz="0"' for x in ("0.1", "-5e-20")]
    path = tmp_path / "r.urdf"
    joints = joint.format("i", "base", "a") + joint.format("j", "a", "b")
    path.write_text(
        f'<robot name="r"><link name="base"/>{link.format("a", own[0])}{link.format("b", own[1])}{joints}</robot>'
    )
    scene = nd.Scene()
    scene.add_urdf("r", path, q=[0.5, 0.2])
    assert nd.check(nd.simulate(scene, 0.1, 0.01)).passed


def test_an_arm_that_falls_on_a_plate_under_its_shoulder_passes():
    """The shoulder, which alone moves the contact, closes its gap: friction is on its cone though it holds."""
    model, scene, along = pin.Model(), nd.Scene(), pin.SE3(pin.utils.rotate("y", np.pi / 2), np.array([0.2, 0, 0]))
    joint, collisions = 0, {}
    for name, place in (("shoulder", (0, 0, 0.05)), ("elbow", (0.4, 0, 0))):
        joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3(np.eye(3), np.array(place)), name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, along.translation, 0.013 * np.eye(3)), pin.SE3.Identity())
        collisions[name] = [(shapes.capsule(0.05, 0.4), along)]
    scene.add_box("plate", (0.1, 0.2, 0.02), fixed=True, position=(0, 0, -0.01))
    scene.add_model("arm", model, q=(-1.0, 0.5), collisions=collisions)
    run = nd.simulate(scene, 0.4, dt=5e-3)
    assert nd.check(run).passed
