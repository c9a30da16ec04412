"""Gauss's principle at the level of accelerations, against closed forms, against steps, and literally."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mechanisms import add, bricard, four_bars, pendulum, slider
from scipy.spatial.transform import Rotation
from test_convergence import FINE, ROUGH, arm, ellipsoid
from test_properties import scenes

import nsdyn as nd
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.loops import Closures
from nsdyn.literature.acceleration import Existence, accelerations, constraint_acceleration, least_constraint
from nsdyn.scene import shapes

pytest.importorskip("clarabel", reason="the extra 'acceleration' is not installed")

g = 9.81


@pytest.mark.parametrize("mu", [0.35, 0.37])
def test_block_on_an_incline(mu):
    """On either side of tan 20° = 0.364, from rest: the jump from stick to slip is predicted."""
    angle = math.radians(20.0)
    a = max(0.0, g * (math.sin(angle) - mu * math.cos(angle)))
    found = accelerations(least_constraint(nd.scenes.load("incline")(angle=20.0, mu=mu)))
    assert found.existence is Existence.SOLVED and not found.problem.sliding.any()
    # Twice the tolerance of the quadratic program.
    assert np.linalg.norm(found.a[:3]) == pytest.approx(a, abs=1e-8)
    assert found.force[:, 0].sum() == pytest.approx(g * math.cos(angle), rel=1e-8)
    assert np.linalg.norm(found.relative[:, 1:], axis=1).max() == pytest.approx(a, abs=1e-8)


@pytest.mark.parametrize("excess", [-1e-4, 1e-4])
def test_stick_to_slip_where_the_step_says_so(excess):
    """A block at rest, pulled by a hair less and more than friction holds."""
    pull = 0.5 * g * (1 + excess)
    scene = nd.scenes.load("slide")(speed=0.0)
    found = accelerations(least_constraint(scene, wrenches={"box": (pull, 0, 0)}))
    # The interior point stays 1e-7 away where the friction is so near its bound.
    assert found.a[0] == pytest.approx(max(0.0, 0.5 * g * excess), abs=1e-7)
    stepper = nd.Stepper(scene, dt=1e-3, external_force=lambda t, q, v: {"box": (pull, 0, 0)}, solver=FINE)
    step = stepper.step()
    assert stepper.get_state().instant.v[0] / 1e-3 == pytest.approx(found.a[0], abs=1e-7)
    assert (step.contact_status == 2).any() == (found.relative[:, 1:].any() and excess > 0)


SMOOTH = {
    "rolling": lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2.0), 2.0),
    "sliding in a curve": lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2.0), 0.15),
    "arm with a sliding tip": lambda folder: arm(folder, 0.1),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_differences_of_velocity_converge_to_it(name, tmp_path):
    """First order ahead, second order across."""
    ahead, across = [], []
    for steps in (50, 200):
        dt = 0.05 / steps
        stepper = nd.Stepper(SMOOTH[name](tmp_path), dt=dt, solver=nd.solvers.Auto(tol=1e-12), on_fail="ignore")
        states = []
        for _ in range(steps + 1):
            stepper.step()
            states.append(stepper.get_state())
        before, now, after = (state.instant for state in states[-3:])
        # Gaps and normal velocities of the run are of second order in dt.
        problem = least_constraint(stepper.scene, states[-2], closed=1e-4, still=1e-2)
        found = accelerations(problem)
        assert found.existence is Existence.SOLVED
        ahead.append(np.abs((after.v - now.v) / dt - found.a).max())
        across.append(np.abs((after.v - before.v) / (2 * dt) - found.a).max())
    assert math.log(ahead[0] / ahead[1], 4) == pytest.approx(1.0, abs=0.1)
    assert math.log(across[0] / across[1], 4) == pytest.approx(2.0, abs=0.3)


def rod(mu, speed):
    """A thin rod whose lower end slides on the ground."""
    half, radius, angle = 0.5, 1e-4, math.atan(2.0)
    scene = nd.Scene()
    material = nd.Material(mu)
    scene.add_halfspace("ground", material=material)
    scene.add_capsule(
        "rod",
        radius,
        2 * half,
        1.0,
        position=(half * math.cos(angle), 0, half * math.sin(angle) + radius),
        quaternion=Rotation.from_euler("y", math.pi / 2 - angle).as_quat(),
        inertia=np.diag([half**2 / 3, half**2 / 3, 1e-6]),
        linear_velocity=(speed, 0, 0),
        material=material,
    )
    return scene


@pytest.mark.parametrize(("excess", "exists"), [(-1e-3, True), (1e-3, False)])
def test_painleve(excess, exists):
    """μ = 4/3 at tan θ = 2: beyond, friction presses the end of the rod into the ground faster than it lifts it."""
    mu = 4 / 3 * (1 + excess)
    scene = rod(mu, -1.0)
    found = accelerations(least_constraint(scene))
    assert found.existence is (Existence.SOLVED if exists else Existence.NO_SOLUTION)
    steps = [nd.Stepper(scene, dt=dt).step() for dt in (1e-4, 1e-5)]
    impulses = [step.r[0, 0] for step in steps]
    assert all(step.solution.converged for step in steps)
    if exists:
        # A force: the impulse falls with dt, as far as the thickness of the rod allows.
        assert found.force[0, 0] == pytest.approx(impulses[1] / 1e-5, rel=0.05)
    else:
        # An impact without collision: an impulse whatever the dt.
        assert impulses[1] == pytest.approx(impulses[0], rel=0.01) and impulses[1] > 0.1
    # In the other direction nothing is odd.
    assert accelerations(least_constraint(rod(mu, 1.0))).existence is Existence.SOLVED


def test_impacts_have_no_acceleration():
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1), linear_velocity=(0, 0, -1), material=ROUGH)
    with pytest.raises(ValueError, match="'ground' and 'ball' approach at 1 m/s"):
        least_constraint(scene)


@pytest.mark.slow
@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(scenes(), st.integers(20, 120), st.integers(0, 2**32 - 1))
def test_principles_on_random_scenes(scene, count, seed):
    """No admissible virtual acceleration lowers the functional; friction dissipates the most it can."""
    stepper = nd.Stepper(scene, dt=5e-3, on_fail="ignore")
    for _ in range(count):
        stepper.step()
    state = stepper.get_state()
    try:
        # After contact, bodies approach by what the turning of the rows makes of a step.
        problem = least_constraint(scene, state, closed=1e-5, still=1e-2)
    except ValueError:
        return
    found = accelerations(problem)
    if found.existence is not Existence.SOLVED:
        return
    mu, force, a = problem.contacts.mu, found.force, found.relative
    weight = 1.0 + np.abs(force).max(initial=0.0)
    # Signorini and Coulomb to the tolerance of the quadratic program.
    assert (force[:, 0] >= -1e-8 * weight).all() and (a[:, 0] >= -1e-6 * weight).all()
    assert np.abs(force[:, 0] * a[:, 0]).max(initial=0.0) <= 1e-6 * weight**2
    sliding = problem.sliding
    rate = np.where(sliding, (a[:, 1:] * problem.slip).sum(axis=1), np.linalg.norm(a[:, 1:], axis=1))
    np.testing.assert_allclose(
        -(force[:, 1:] * a[:, 1:]).sum(axis=1), mu * force[:, 0] * rate, rtol=0, atol=1e-6 * weight**2
    )
    # Literally: M's metric makes light coordinates move more.
    rng = np.random.default_rng(seed)
    least = problem.functional(found.a, force[:, 0])
    root = np.linalg.cholesky(np.linalg.inv(problem.M))
    for _ in range(100):
        other = found.a + 10.0 ** rng.uniform(-4, 2) * root @ rng.normal(size=found.a.size)
        if (problem.relative(other)[:, 0] >= np.minimum(a[:, 0], 0.0)).all():
            assert problem.functional(other, force[:, 0]) >= least - 1e-6 * weight**2


def mechanism(name):
    """Scenes with what accelerations meet besides contacts."""
    scene = nd.Scene()
    if name == "loop":  # redundant rows, viscous and dry friction, all turning
        model, loops, v = four_bars(2)
        q = pin.integrate(model, pin.neutral(model), 0.3 * v)
        add(scene, "m", model, loops, q=q, v=v, friction=0.2, damping=0.3)
    elif name == "spatial loop":  # one degree of freedom that no count of rows and coordinates finds
        model, loops = bricard()
        along = np.linalg.svd(Closures(model, loops).at(pin.neutral(model))[1])[2][-1]
        add(scene, "m", model, loops, v=2.0 * along, friction=0.1)
    elif name == "driven":  # a double pendulum whose first joint follows a sine, the second slides on dry friction
        add(scene, "m", pendulum(2), q=[0.3, 0.4], v=[0.0, 1.0], friction=[0.0, 0.3], damping=0.1)
        scene.set_motion("m/j0", velocity=lambda t: math.sin(1.0 + 3.0 * t))
    elif name == "held":  # dry friction that holds a link against gravity, the other link falls
        add(scene, "m", pendulum(2), q=[0.02, 1.2], friction=[30.0, 0.5])
    else:  # the first link is pressed on its limit by what hangs from it
        add(scene, "m", pendulum(2, lower=-0.4), q=[-0.4, 0.8])
    return scene


MECHANISMS = ["loop", "spatial loop", "driven", "held", "limit"]


@pytest.mark.parametrize("name", MECHANISMS)
def test_primal_against_dual(name):
    """The same acceleration, the same least value, and none lower among admissible ones."""
    found = accelerations(least_constraint(mechanism(name)))
    problem, k = found.problem, found.force[:, 0]
    a = problem.primal(k)
    assert found.existence is Existence.SOLVED and np.abs(a).max() > 0.1
    np.testing.assert_allclose(a, found.a, rtol=0, atol=1e-8 * (1.0 + np.abs(a).max()))
    least = problem.functional(found.a, k)
    assert problem.functional(a, k) == pytest.approx(least, rel=1e-8, abs=1e-8)
    rng = np.random.default_rng(0)
    for _ in range(200):
        other = found.a + 10.0 ** rng.uniform(-4, 1) * problem.Z @ rng.normal(size=problem.Z.shape[1])
        if (problem.joints.limits.T @ other >= 0.0).all():
            assert problem.functional(other, k) >= least - 1e-9 * (1.0 + abs(least))


@pytest.mark.parametrize("case", ["incline", "arm"])
def test_primal_against_dual_with_contacts(case, tmp_path):
    scene = nd.scenes.load("incline")(angle=20.0, mu=0.3) if case == "incline" else arm(tmp_path, 0.1)
    found = accelerations(least_constraint(scene, closed=1e-4, still=1e-2))
    assert found.existence is Existence.SOLVED and len(found.force)
    a = found.problem.primal(found.force[:, 0])
    # Both programs end at 1e-12 of their value, which is of second order in a.
    np.testing.assert_allclose(a, found.a, rtol=0, atol=1e-6 * (1.0 + np.abs(a).max()))


def mean_acceleration(scene, dt):
    """(v_1 - v_0)/dt of the first step."""
    stepper = nd.Stepper(scene, dt=dt, solver=nd.solvers.Auto(tol=1e-12), on_fail="ignore")
    before = stepper.get_state().instant.v.copy()
    stepper.step()
    return (stepper.get_state().instant.v - before) / dt


@pytest.mark.parametrize("name", ["loop", "spatial loop", "driven"])
def test_steps_of_mechanisms_converge_to_the_acceleration(name):
    """Of first order in dt."""
    scene = mechanism(name)
    found = accelerations(least_constraint(scene))
    ahead = [np.abs(mean_acceleration(scene, dt) - found.a).max() for dt in (4e-4, 1e-4)]
    assert ahead[1] <= 0.05 * np.abs(found.a).max()
    assert math.log(ahead[0] / ahead[1], 4) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", ["held", "limit"])
def test_steps_from_rest_agree_with_the_acceleration(name):
    """Nothing moves yet: gravity, dry friction and limits act as they do in a step, to what it moves in one."""
    scene = mechanism(name)
    found = accelerations(least_constraint(scene))
    errors = [np.abs(mean_acceleration(scene, dt) - found.a).max() for dt in (4e-4, 2e-4)]
    assert errors[1] <= 1e-3 * np.abs(found.a).max() and errors[1] <= errors[0]


def test_a_joint_that_friction_holds():
    """Double pendulum, the first joint held: the torque on it is what statics and the falling link ask for."""
    found = accelerations(least_constraint(mechanism("held")))
    assert abs(found.a[0]) <= 1e-8 and abs(found.friction[0]) < 30.0
    # Link of 1 m and 1 kg about its end: I = 1/3; gravity at 1.22 rad, friction 0.5 N m at its bound.
    angle = 1.22
    assert found.a[1] == pytest.approx(-3.0 * (g / 2 * math.sin(angle) - 0.5), rel=1e-8)
    assert found.friction[1] == pytest.approx(0.5, rel=1e-8)


def test_a_joint_at_its_limit():
    """One link horizontally on its lower limit: the limit carries m g l/2, and lets go when it is pulled away."""
    scene = nd.Scene()
    add(scene, "m", pendulum(1, upper=math.pi / 2), q=[math.pi / 2])
    torque = g / 2
    # Gravity turns it back to 0: pulled on with twice that, it stays on the limit.
    pressed = accelerations(least_constraint(scene, tau={"m": np.array([2 * torque])}))
    assert abs(pressed.a[0]) <= 1e-9 and pressed.limit[0] == pytest.approx(torque, rel=1e-8)
    free = accelerations(least_constraint(scene))
    assert free.limit[0] == pytest.approx(0.0, abs=1e-9) and free.a[0] == pytest.approx(-1.5 * g, rel=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_a_link_that_touches_on_its_own_hinge(seed):
    """No acceleration opens or closes the contact there; round-off had forces of 1e13 N, and an error of 1e-3."""
    turn, at = Rotation.random(random_state=seed), np.random.default_rng(seed).normal(size=3)
    model, scene = pin.Model(), nd.Scene(gravity=turn.apply((0, 0, -9.81)))
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3(turn.as_matrix(), at), "lid")
    model.addJointFrame(joint)
    model.appendBodyToJoint(joint, pin.Inertia(0.5, np.array([0.3, 0, 0]), 0.01 * np.eye(3)), pin.SE3.Identity())
    below = at - 0.5 * turn.as_matrix()[:, 2]
    scene.add_box("floor", (4, 4, 1), fixed=True, position=below, quaternion=turn.as_quat())
    box = [(shapes.box((0.6, 0.2, 0.02)), pin.SE3(np.eye(3), np.array([0.3, 0, 0.01])))]
    scene.add_model("m", model, q=[-0.3], collisions={"lid": box})
    found = accelerations(least_constraint(scene))
    assert found.existence == Existence.SOLVED
    assert found.a[0] == pytest.approx(0.5 * 9.81 * 0.3 * math.cos(0.3) / (0.01 + 0.5 * 0.3**2), rel=1e-12)


def test_sliders_on_paper():
    """m v̇ = F - d v - τ_c sign v where it moves; at rest |F| ≤ τ_c holds it."""
    for v, force, expected in ((0.5, 3.0, (3.0 - 0.4 * 0.5 - 1.0) / 2.0), (0.0, 0.9, 0.0), (0.0, -3.0, -1.0)):
        scene = nd.Scene()
        add(scene, "m", slider(2.0), v=[v], friction=1.0, damping=0.4)
        found = accelerations(least_constraint(scene, tau={"m": np.array([force])}))
        assert found.a[0] == pytest.approx(expected, abs=1e-9)


def test_a_driven_joint_has_its_acceleration():
    found = accelerations(least_constraint(mechanism("driven")))
    assert found.a[0] == pytest.approx(3.0 * math.cos(1.0), abs=1e-8)


def test_drift_of_loops_against_classical_accelerations():
    """-Ġ v by differences against Pinocchio's accelerations of the ends of the cut at v̇ = 0; Bricard's mechanism."""
    scene = mechanism("spatial loop")
    d = Dynamics(scene)
    tree, (position, v) = d.trees[0], d.start()
    q, model, (loop,) = position.trees[0], tree.model, scene.articulations["m"].loops
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    linear, angular = [], []
    for joint, place in ((loop.joint1, loop.placement1), (loop.joint2, loop.placement2)):
        motion, acceleration = place.actInv(data.v[joint]), place.actInv(data.a[joint])
        R = data.oMi[joint].rotation @ place.rotation
        linear.append(R @ (acceleration.linear + np.cross(motion.angular, motion.linear)))
        angular.append(R @ acceleration.angular)
    expected = np.concatenate((linear[1] - linear[0], angular[1] - angular[0]))
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(constraint_acceleration(tree, q, v, 0.0), expected, rtol=0, atol=1e-6)


def test_what_has_no_acceleration():
    scene = nd.Scene()
    add(scene, "m", pendulum(1, upper=0.5), q=[0.5], v=[1.0])
    with pytest.raises(ValueError, match="a joint runs into its limit at 1 rad/s"):
        least_constraint(scene)
    scene = nd.Scene()
    scene.add_halfspace("belt")
    scene.set_motion("belt", surface_velocity=(1, 0, 0))
    with pytest.raises(ValueError, match="no driven bodies and no sliding surfaces"):
        least_constraint(scene)
