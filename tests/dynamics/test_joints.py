"""Joint forces, dry friction, limits and prescribed motion, against formulas solved on paper."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, four_bars, hang, limit, lump, pendulum, slider

import nsdyn as nd
from nsdyn.dynamics.ledger import PHYSICS
from nsdyn.scene import shapes

G = 9.81
INERTIA = 1.0 / 3.0 + 1e-9  # of the pendulum's rod about its hinge, kg m²


def closes(trajectory):
    """Largest defect of the ledger over the largest energy or work."""
    e = trajectory.energy
    works = [np.abs(getattr(e, name)).max() for name in e.names[2:-1]]
    return np.abs(e.defect).max() / max(e.kinetic.max(), np.ptp(e.potential), *works)


def run(model, duration, dt=1e-3, gravity=(0, 0, -G), q=None, v=None, controller=None, **joints):
    scene = nd.Scene(gravity=gravity)
    add(scene, "a", model, q=q, v=v, **joints)
    trajectory = nd.simulate(scene, duration, dt, solver=nd.solvers.Auto(tol=1e-12), controller=controller)
    assert closes(trajectory) < 1e-12  # the bar of the ledger
    return trajectory


# -- smooth motion -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case(30)
@pytest.mark.parametrize("duration", [2.0, 10.0])
def test_double_pendulum_keeps_its_energy(duration):
    total = run(pendulum(2), duration, q=(2.5, 1.0)).energy.total
    assert np.abs(total - total[0]).max() <= 1e-6  # of 36 J that go back and forth


@pytest.mark.parametrize(
    ("joints", "ratio"),
    [
        # With the error of the fine run: (4⁴ - 1)/(2⁴ - 1) and (4² - 1)/(2² - 1).
        ({}, 17.0),
        pytest.param(
            {"stiffness": (30.0, 50.0), "rest": 0.2, "damping": 0.3, "armature": 0.1}, 5.0, marks=pytest.mark.slow
        ),
    ],
)
def test_smooth_motion_is_fourth_order_and_second_with_implicit_forces(joints, ratio):
    def end(dt):
        return run(pendulum(2), 0.5, dt, q=(1.5, 1.0), **joints).q[-1]

    fine = end(5e-4)
    errors = [np.abs(end(dt) - fine).max() for dt in (2e-3, 1e-3)]  # which are one part each
    assert errors[0] / errors[1] == pytest.approx(ratio, rel=0.05)  # 5 % for the next order


def test_springs_keep_energy_and_oscillate_as_they_should():
    """A mass on a spring: the midpoint rule turns the phase by 2 atan(ω h / 2) a step."""
    mass, stiffness, h = 2.0, 50.0, 1e-2
    trajectory = run(slider(mass), 2.0, h, q=[0.3], stiffness=stiffness, rest=0.1)
    phase = 2.0 * np.arctan(0.5 * h * np.sqrt(stiffness / mass)) * np.arange(201)
    np.testing.assert_allclose(trajectory.q[:, 0], 0.1 + 0.2 * np.cos(phase), rtol=0, atol=1e-13)
    # 1 J to round-off of 200 steps
    np.testing.assert_allclose(trajectory.energy.total, 0.5 * stiffness * 0.2**2, rtol=1e-13)


def test_damping_takes_what_it_should():
    """v falls by (1 - a)/(1 + a), a = h D / 2 m, in each step, and the ledger has the whole energy under `damping`."""
    trajectory = run(slider(2.0), 1.0, 1e-2, v=[3.0], damping=0.8)
    a = 0.5 * 1e-2 * 0.8 / 2.0
    np.testing.assert_allclose(trajectory.v[:, 0], 3.0 * ((1 - a) / (1 + a)) ** np.arange(101), rtol=1e-13)
    kinetic = trajectory.energy.kinetic
    np.testing.assert_allclose(np.cumsum(trajectory.energy.damping), kinetic[1:] - kinetic[0], rtol=1e-12)


@pytest.mark.slow
def test_armature_is_inertia():
    """A pendulum's small oscillation: ω² = m g l / 2 (I + armature)."""
    trajectory = run(pendulum(), 3.5, q=[1e-4], armature=0.5)
    q, t = trajectory.q[:, 0], trajectory.t
    down = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    crossing = t[down] + q[down] / (q[down] - q[down + 1]) * 1e-3
    omega = np.sqrt(0.5 * G / (INERTIA + 0.5))
    # The phase error of the midpoint rule is (ω h)²/12 = 5e-7, the linear crossing less.
    assert np.diff(crossing) == pytest.approx(2 * np.pi / omega, rel=2e-6)


# -- control -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kp", "kd"), [(1e6, 0.0), (1e6, 1e3), (0.0, 1e6)])
def test_pd_is_stable_at_any_gain(kp, kd):
    target = np.array([1.0, 0.5, -0.5])
    control = nd.PD(kp, kd, target)
    trajectory = run(pendulum(3), 1.0, 5e-3, q=(0.5, -0.3, 1.0), controller=lambda t, q, v: {"a": control})
    if kp:
        # At rest, off the target by what gravity bends: at most 1.5 + 2.5 + 3.5 m of 9.81 N.
        assert np.abs(trajectory.v[-1]).max() < 1e-9 and np.abs(trajectory.q[-1] - target).max() < 74.0 / kp
    else:
        assert np.abs(trajectory.v[-1]).max() < 74.0 / kd


@pytest.mark.slow
@pytest.mark.parametrize("in_file", [False, True])
def test_pd_gives_no_more_than_its_limit(in_file):
    """A mass on a rail far from its target: pushed with the limit to the round-off, then held at the target."""
    m, h, most = 2.0, 1e-2, 3.0
    model = slider(m)
    if in_file:
        model.upperEffortLimit = np.array([most])
    control = nd.PD(1e4, 1e4, target=1.0, limit=None if in_file else most)
    trajectory = run(model, 30.0, h, controller=lambda t, q, v: {"a": control})
    force = m * np.diff(trajectory.v[:, 0]) / h
    assert np.abs(force).max() == pytest.approx(most, rel=1e-12)
    # Round-off of 50 sums. Then it slides in, (1 - q) falls by e a second.
    np.testing.assert_allclose(trajectory.v[:50, 0], most / m * h * np.arange(50), rtol=1e-12)
    assert abs(trajectory.q[-1, 0] - 1.0) < 1e-9 and abs(trajectory.v[-1, 0]) < 1e-9
    free = nd.PD(1e4, 1e4, target=1.0, limit=np.inf)
    unlimited = run(model, h, h, controller=lambda t, q, v: {"a": free})
    assert m * unlimited.v[-1, 0] / h > 10.0 * most


def test_pd_at_its_limit_in_some_joints_is_the_formula_in_the_others():
    """Weight bends a weak shoulder down while the elbow holds; two joints at once make the active set work."""
    h, most = 1e-3, np.array([5.0, 200.0])
    scene = nd.Scene(gravity=(0, 0, -G))
    add(scene, "a", pendulum(2), q=(np.pi / 2, 0.0))
    control = nd.PD(5e3, 50.0, target=np.array([np.pi / 2, 0.0]), limit=most)
    stepper = nd.Stepper(scene, h, solver=nd.solvers.Auto(tol=1e-12), controller=lambda t, q, v: {"a": control})
    model = scene.articulations["a"].model
    data = model.createData()
    for _ in range(50):
        before = stepper.get_state().instant
        step = stepper.step()
        # The torque that the step gave, from the change of momentum at its middle, where all forces act.
        q, v = before.position.trees[0], before.v
        middle = pin.integrate(model, q, 0.5 * h * v)
        tau = pin.rnea(model, data, middle, 0.5 * (v + step.v), (step.v - v) / h)
        # Second order in h = 1e-3 of torques up to 20 N m.
        assert (np.abs(tau) <= most + 1e-2).all()
    assert tau[0] == pytest.approx(-most[0], abs=1e-2) or tau[0] == pytest.approx(most[0], abs=1e-2)
    assert abs(step.q[1]) < 0.1 and abs(step.q[0] - np.pi / 2) > 5e-3


def test_pd_is_the_formula():
    """One step of a mass on a rail: kp acts at the mean of both positions, kd at that of both velocities."""
    m, h, kp, kd, q, v = 2.0, 1e-2, 300.0, 7.0, 0.1, -0.4
    control = nd.PD(kp, kd, target=0.5, target_velocity=0.2, feedforward=3.0)
    trajectory = run(slider(m), h, h, q=[q], v=[v], controller=lambda t, q, v: {"a": control})
    force = kp * (0.5 - q - 0.25 * h * v) + kd * (0.2 - 0.5 * v) + 3.0
    expected = (m * v + h * force) / (m + 0.5 * h * kd + 0.25 * h * h * kp)
    assert trajectory.v[-1, 0] == pytest.approx(expected, rel=1e-14)
    # All of the change is work of the controller.
    assert np.diff(trajectory.energy.kinetic)[0] == pytest.approx(trajectory.energy.external[0], rel=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            np.zeros(2),
            r"joint forces of controller of 'a' must be \{joint: number\}, or 3 numbers, .*, got shape \(2,\)",
        ),
        ((1.0, np.nan, 0.0), "joint forces of controller of 'a' must be finite"),
        ("up", "joint forces of controller of 'a' must be finite"),
        (1j * np.ones(3), "joint forces of controller of 'a' must be finite"),
        (
            nd.PD(1.0, 1.0, np.zeros(2)),
            r"target of the PD control of 'a' must be \{joint: number\}, or 3 numbers, .* got shape \(2,\)",
        ),
        (
            nd.PD(1.0, 1.0, {"j00": 1.0}),
            r"did you mean 'j0'\? name in target of the PD control of 'a' must be one of j0, .*; got",
        ),
        ({"j00": 1.0}, r"did you mean 'j0'\? name in joint forces of controller of 'a' must be one of j0, "),
        ({"j0": "up"}, "joint forces of controller of 'a' must be finite"),
    ],
)
def test_wrong_control_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        run(pendulum(3), 1e-3, controller=lambda t, q, v: {"a": given})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 0.0, 0.0), "kp of a PD control must not be negative"),
        ((1.0, np.inf, 0.0), "kd of a PD control must be a finite number, one"),
        (([np.nan, 1.0], 0.0, 0.0), "kp of a PD control must be a finite number, one .*, got .nan, 1"),
        ((1.0, 1.0, "up"), "target of a PD control must be a finite number, one .*, got 'up'"),
        ((1.0, 1.0, np.zeros((2, 2))), "target of a PD control"),
        ((1.0, 1.0, 0.0, 0.0, 0.0, 0.0), "limit of a PD control must be positive, got 0.0"),
        ((1.0, 1.0, 0.0, 0.0, 0.0, np.nan), "limit of a PD control must be a finite number, one .*, got nan"),
    ],
)
def test_wrong_gains_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        nd.PD(*arguments)


def test_control_goes_by_joints():
    """By name, by revolute and prismatic joint, and by coordinate: the same, and what is not named is left alone."""
    module = nd.scenes.module("quadruped")
    scene = module.scene()
    names = list(scene.articulations["quadruped"].model.names)[2:]
    goal, push, base = np.linspace(0.1, -0.2, 12), np.linspace(-3.0, 3.0, 12), np.zeros(6)

    def ends(given):
        return nd.Stepper(scene, 2e-3, controller=lambda t, q, v: {"quadruped": given}).step().q

    expected = ends(
        nd.PD(np.r_[base, np.full(12, 50.0)], np.r_[base, np.ones(12)], np.r_[base, goal], 0.0, np.r_[base, push])
    )
    for one in (goal, dict(zip(names, goal, strict=True))):
        for other in (push, dict(zip(names, push, strict=True))):
            np.testing.assert_array_equal(ends(nd.PD(50.0, 1.0, one, feedforward=other)), expected)
    only = np.where(np.arange(12) == 2, 1.0, 0.0)
    knee = ends(nd.PD(np.r_[base, 50.0 * only], np.r_[base, only], np.r_[base, -2.0 * only]))
    np.testing.assert_array_equal(ends(nd.PD(50.0, 1.0, {names[2]: -2.0})), knee)
    np.testing.assert_array_equal(ends(nd.PD({names[2]: 50.0}, {names[2]: 1.0}, -2.0)), knee)
    torque = ends(np.r_[base, push])
    np.testing.assert_array_equal(ends(push), torque)
    np.testing.assert_array_equal(ends(dict(zip(names, push, strict=True))), torque)
    with pytest.raises(ValueError, match=r"or 12 numbers, .* or 18 numbers, one for each coordinate, got shape \(6,\)"):
        ends(np.zeros(6))


def test_gains_on_a_free_base_are_refused():
    scene, path = nd.Scene(), nd.scenes.folder() / "quadruped.urdf"
    scene.add_urdf("robot", path, base="free", position=(0, 0, 1), q=4 * (0.0, 0.6, -1.2))
    with pytest.raises(ValueError, match="kp of the PD control of 'robot' must be 0 on free, ball and planar joints"):
        nd.simulate(scene, 1e-3, controller=lambda t, q, v: {"robot": nd.PD(np.ones(18), 0.0, 0.0)})


@pytest.mark.slow
def test_a_force_on_a_link_turns_it_and_its_work_is_booked():
    """A force on the bob of a pendulum and the torque that does the same: equal motions, all work external."""
    model = pendulum(2)
    model.addFrame(pin.Frame("bob", 2, 0, at((0, 0, -1)), pin.FrameType.BODY))
    scene = nd.Scene(gravity=(0, 0, 0))
    add(scene, "a", model, q=(0.3, 0.5))
    force = np.array([2.0, 0.0, -1.0])

    def push(t, q, v):
        return {"a/bob": force}

    def torque(t, q, v):
        upper, whole = q[0], q[0] + q[1]
        # Of a force at the tip, about the hinges; a hinge about y turns -z towards -x.
        x, z = -np.sin(whole) - np.array((np.sin(upper), 0)), -np.cos(whole) - np.array((np.cos(upper), 0))
        return {"a": z * force[0] - x * force[2]}

    pushed, turned = nd.simulate(scene, 1.0, external_force=push), nd.simulate(scene, 1.0, controller=torque)
    np.testing.assert_allclose(pushed.q, turned.q, rtol=0, atol=1e-13)
    assert np.ptp(pushed.q) > 1.0
    assert closes(pushed) < 1e-12
    kinetic = pushed.energy.kinetic
    # The midpoint rule's own h² of the energy.
    assert pushed.energy.external.sum() == pytest.approx(kinetic[-1] - kinetic[0], rel=1e-5)


def test_a_wrench_on_a_robot_in_the_air_moves_its_centre_of_mass():
    """A force on a foot and a torque on the trunk: momentum and angular momentum are what they give."""
    scene, path = nd.Scene(gravity=(0, 0, 0)), nd.scenes.folder() / "quadruped.urdf"
    scene.add_urdf("r", path, base="free", position=(0, 0, 1), q=4 * (0.0, 0.6, -1.2))
    force, torque, duration = np.array([1.0, -2.0, 3.0]), np.array([0.1, 0.2, -0.1]), 0.01
    given = {"r/FL_foot": force, "r/trunk": ((0, 0, 0), torque)}
    trajectory = nd.simulate(scene, duration, 2.5e-4, external_force=lambda t, q, v: given)
    model = scene.articulations["r"].model
    data = model.createData()
    pin.computeCentroidalMomentum(model, data, trajectory.q[-1], trajectory.v[-1])
    # The scheme keeps the momentum of a tree to h²: 6e-6 here, 1e-4 at four times the step.
    np.testing.assert_allclose(data.hg.linear, force * duration, rtol=2e-5)
    pin.framesForwardKinematics(model, data, trajectory.q[0])
    arm = data.oMf[model.getFrameId("FL_foot")].translation - pin.centerOfMass(model, data, trajectory.q[0])
    # Foot and centre part by some h² 100 m/s² while they are pushed.
    np.testing.assert_allclose(data.hg.angular, (torque + np.cross(arm, force)) * duration, rtol=2e-2)


def test_unknown_articulation_is_refused():
    with pytest.raises(ValueError, match=r"articulation of controller must be one of .*; got 'b'"):
        run(pendulum(), 1e-3, controller=lambda t, q, v: {"b": np.zeros(1)})


# -- dry friction ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("links", [pytest.param(1, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize("duration", [2.0, pytest.param(10.0, marks=pytest.mark.slow)])
def test_joint_friction_holds_below_its_threshold(links, duration):
    """Rods that friction holds at an angle: gravity asks for 0.99 of the first joint's friction."""
    q = np.array([0.5, -0.3, 0.4])[:links]
    tip = np.cumsum(q)
    lever = [0.5 * np.sin(tip[k]) + sum(np.sin(tip[i]) for i in range(k)) for k in range(links)]
    tau = np.array([G * sum(lever[k:]) - G * (links - k) * sum(np.sin(tip[i]) for i in range(k)) for k in range(links)])
    trajectory = run(pendulum(links), duration, 1e-2, q=q, friction=np.abs(tau) / 0.99)
    assert np.abs(trajectory.q - q).max() <= 1e-12
    scene = nd.Scene()
    add(scene, "a", pendulum(links), q=q, friction=np.abs(tau) / 0.99)
    # What holds is the torque of statics, not the threshold; the bias is taken on the free motion, h² g²/4 off.
    np.testing.assert_allclose(nd.Stepper(scene, 1e-2).step().joint_impulse / 1e-2, tau, rtol=0, atol=2.4e-3)


@pytest.mark.slow
def test_joint_friction_slips_at_the_analytic_rate():
    """A flywheel under 0.5 N m of dry friction slows by τ/I each second and stops at I v²/2τ for good."""
    tau, v = 0.5, 2.0
    trajectory = run(pendulum(), 2.0, gravity=(0, 0, 0), v=[v], friction=tau)
    t = trajectory.t
    np.testing.assert_allclose(trajectory.v[:, 0], np.maximum(v - tau / INERTIA * t, 0.0), rtol=0, atol=1e-12)
    # The step in which it stops moves at the mean of its velocities: off by less than h² τ/I.
    assert trajectory.q[-1, 0] == pytest.approx(INERTIA * v * v / (2 * tau), abs=2e-6)
    assert trajectory.energy.friction.sum() == pytest.approx(-0.5 * INERTIA * v * v, rel=1e-9)
    assert np.ptp(trajectory.q[-500:]) <= 1e-12


def test_driven_above_its_threshold_a_joint_slips():
    trajectory = run(slider(2.0), 0.5, friction=3.0, controller=lambda t, q, v: {"a": np.array([5.0])})
    np.testing.assert_allclose(trajectory.v[:, 0], (5.0 - 3.0) / 2.0 * trajectory.t, rtol=0, atol=1e-12)


# -- limits ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.5, *(pytest.param(e, marks=pytest.mark.slow) for e in (0.0, 1.0))])
@pytest.mark.parametrize("duration", [1.0, pytest.param(5.0, marks=pytest.mark.slow)])
def test_pendulum_bounces_off_its_stop(restitution, duration):
    trajectory = run(pendulum(lower=-0.3, upper=2.0), duration, q=[1.0], restitution=restitution)
    assert trajectory.q.min() >= -0.3 - 1e-10 and trajectory.q.max() <= 2.0
    # Impacts act where the stop is: the first takes 1 - e² of what the fall gave, but for the O(h⁴) of the motion.
    energy = trajectory.energy
    k = int(np.argmax(np.abs(np.diff(trajectory.v[:, 0])) > 0.1))  # gravity changes v by 0.015 a step
    taken = (1.0 - restitution**2) * 0.5 * G * (np.cos(0.3) - np.cos(1.0))
    # What does not rebound is located to 1e-4 rad only, in which it falls by at most G sin(0.3) 1e-4 = 3e-4 J.
    off = 1e-11 if restitution else 3e-4
    assert -energy.normal[k] == pytest.approx(taken, abs=off)
    assert energy.total[k] - energy.total[k + 1] == pytest.approx(taken, abs=off)
    if restitution == 1.0:
        np.testing.assert_allclose(energy.total, energy.total[0], rtol=0, atol=1e-11)


@pytest.mark.slow
def test_resting_on_a_stop_is_exact():
    """Pressed on its upper limit a mass stays there, and the limit pushes back with the force."""
    scene = nd.Scene()
    add(scene, "a", slider(2.0, upper=0.2), q=[0.1], restitution=0.5)
    stepper = nd.Stepper(scene, 1e-3, controller=lambda t, q, v: {"a": np.array([10.0])})
    for _ in range(800):
        step = stepper.step()
    assert step.q[0] == pytest.approx(0.2, abs=1e-10) and abs(step.v[0]) <= 1e-12
    assert step.joint_impulse[0] == pytest.approx(-10.0 * 1e-3, rel=1e-9)
    assert step.contacts.gap.size == 0


def test_limits_can_be_switched_off():
    trajectory = run(slider(lower=-0.1, upper=0.1), 1.0, v=[1.0], limits=False)
    assert trajectory.q[-1, 0] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.slow
def test_limits_push_on_what_they_carry():
    """A box on a table that a rail carries up to its stop: the contact with the box takes part in the impact."""
    model = pin.Model()
    hang(model, 0, "lift", pin.JointModelPZ(), lump(3.0, 1.0))
    scene = nd.Scene()
    table = shapes.box((1, 1, 0.1)), at((0, 0, -0.05))
    add(scene, "lift", limit(model, 0.0, 0.5), q=[0.1], collisions={"lift": [table]})
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.2))
    trajectory = nd.simulate(scene, 0.5)
    assert closes(trajectory) < 1e-12
    body = trajectory.body("box")
    assert body.position[-1, 2] == pytest.approx(0.1, abs=1e-9) and trajectory.q[-1, 7] == pytest.approx(0.0, abs=1e-10)
    # The stop carries both, the box rests on the table.
    impulse = trajectory.contacts(-1).impulse[:, 0].sum()
    assert impulse == pytest.approx(1.0 * G * 1e-3, rel=1e-6)


# -- prescribed motion -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_conveyor_carries_a_box():
    """A box dropped on a belt of 1 m/s slips for v/(μ g), then moves with it; half of the belt's work is lost."""
    mu, speed, h = 0.5, 1.0, 1e-3
    scene = nd.Scene()
    scene.add_halfspace("belt")
    scene.set_motion("belt", surface_velocity=(speed, 0, 0))
    scene.add_box("box", (0.2, 0.2, 0.2), 2.0, position=(0, 0, 0.1))
    scene.set_pair("box", "belt", mu=mu)
    trajectory = nd.simulate(scene, 0.5, h)
    v = trajectory.body("box").linear_velocity[:, 0]
    np.testing.assert_allclose(v, np.minimum(mu * G * trajectory.t, speed), rtol=0, atol=1e-9)
    assert closes(trajectory) < 1e-12
    # Work of the belt: the force times its speed, all along; friction takes the sliding part.
    assert trajectory.energy.constraint.sum() == pytest.approx(2.0 * speed**2, rel=1e-9)
    assert trajectory.energy.friction.sum() == pytest.approx(-0.5 * 2.0 * speed**2, rel=1e-9)
    assert trajectory.scene["frames"] == ["box"]


@pytest.mark.slow
def test_moving_wall_pushes_a_ball():
    """A wall that moves as 1 - cos t catches a ball, and loses it where it slows down."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("wall", (0.1, 1, 1), position=(-0.05, 0, 0), fixed=True)
    scene.set_motion("wall", velocity=lambda t: (np.sin(t), 0, 0))
    scene.add_sphere("ball", 0.1, 1.0, position=(0.15, 0, 0))
    trajectory = nd.simulate(scene, 2.0)
    ball, wall = trajectory.body("ball"), trajectory.body("wall")
    # The trapezoidal rule of the wall's velocity: h² / 12.
    np.testing.assert_allclose(wall.position[:, 0], -0.05 + 1 - np.cos(trajectory.t), rtol=0, atol=2e-7)
    # Half of what counts as closed for a ball of 0.1 m is what a contact that stays may leave open, of either sign.
    assert min(trajectory.contacts(k).gap.min(initial=0.0) for k in range(1, 2001)) >= -0.5e-10
    assert ball.linear_velocity[-1, 0] == pytest.approx(1.0, abs=1e-6)  # the fastest the wall was
    assert closes(trajectory) < 1e-12
    # The wall did what the ball has and what the first, inelastic impact took.
    works = trajectory.energy
    numerics = works.integration.sum()
    assert works.constraint.sum() == pytest.approx(works.kinetic[-1] - works.normal.sum() - numerics, rel=1e-12)
    assert abs(numerics) <= 1e-10  # what is left open, 0.5e-10 m, at a newton


@pytest.mark.parametrize(("amplitude", "flies"), [pytest.param(0.9, False, marks=pytest.mark.slow), (1.5, True)])
def test_shaker_throws_a_box_above_one_g(amplitude, flies):
    omega = 20.0
    scene = nd.Scene()
    scene.add_box("table", (1, 1, 0.1), position=(0, 0, -0.05), fixed=True)
    scene.set_motion("table", velocity=lambda t: (0, 0, amplitude * G / omega * np.sin(omega * t)))
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1))
    trajectory = nd.simulate(scene, 0.4)
    apart = trajectory.body("box").position[:, 2] - trajectory.body("table").position[:, 2] - 0.15
    assert apart.min() >= -1e-9
    assert (apart.max() > 1e-3) == flies and (flies or apart.max() < 1e-9)
    assert closes(trajectory) < 1e-12


@pytest.mark.slow
def test_driven_joint_moves_as_told_and_its_work_is_booked():
    """The first joint of a double pendulum is a crank, also below a second, free joint that swings."""
    scene = nd.Scene()
    add(scene, "a", pendulum(2), q=(0.0, 0.3))
    scene.set_motion("a/j0", velocity=np.sin)
    trajectory = nd.simulate(scene, 1.2)
    np.testing.assert_allclose(trajectory.v[:, 0], np.sin(trajectory.t), rtol=0, atol=1e-14)
    # Trapezoidal rule, h²/12.
    np.testing.assert_allclose(trajectory.q[:, 0], 1 - np.cos(trajectory.t), rtol=0, atol=2e-7)
    assert np.ptp(trajectory.q[:, 1]) > 0.3
    assert closes(trajectory) < 1e-12
    total = trajectory.energy.total
    assert trajectory.energy.constraint.sum() == pytest.approx(total[-1] - total[0], abs=5e-6)  # O(h²), of 13 J


def swinging(rate, depth, **keywords):
    """A scene with a driven crank of 0.5 m whose tip, a ball, meets the ground `depth` [m] above its lowest place."""
    scene = nd.Scene()
    scene.add_halfspace("ground", offset=-0.52 + depth)
    tip = {"j0": [(shapes.sphere(0.02), at((0, 0, -0.5)))]}
    add(scene, "arm", pendulum(1), q=(1.2,), collisions=tip, **keywords)
    scene.set_motion("arm/j0", rate)
    return scene


@pytest.mark.parametrize(
    ("rate", "dt"),
    [
        *((-1.0, 1e-2), (-50.0, 5e-2)),
        *(pytest.param(*how, marks=pytest.mark.slow) for how in ((-1.0, 5e-3), (lambda t: -3.0 * t, 2e-3))),
    ],
)
def test_a_driven_link_does_not_go_through_the_ground(rate, dt):
    with pytest.raises(
        ValueError, match=r"prescribed motions contradict: 'ground' and 'arm/j0_0' overlap by [\d.e-]+ m at"
    ):
        nd.simulate(swinging(rate, 0.1), 1.5, dt)
    run = nd.simulate(swinging(rate, -1e-3), 0.5, dt)
    assert run.solver.status.max() == 0 and nd.check(run).passed


@pytest.mark.parametrize("turn", [2.0, 4.0, 6.0, 2.0 * np.pi, 40.0])
def test_a_driven_link_does_not_pass_a_post_in_whole_turns(turn):
    """Of two states that are a turn apart the post is in neither."""
    scene = nd.Scene()
    scene.add_box("post", (0.02, 1.0, 0.3), fixed=True, position=(0.2, 0, -0.5))
    tip = {"j0": [(shapes.sphere(0.02), at((0, 0, -0.5)))]}
    add(scene, "arm", pendulum(1), q=(1.2,), collisions=tip)
    scene.set_motion("arm/j0", -turn / 1e-2)
    with pytest.raises(ValueError, match=r"contradict: 'post' and 'arm/j0_0' overlap by .* m at t = 0\.01 s"):
        nd.simulate(scene, 0.05, 1e-2)


def test_links_of_several_driven_joints_do_not_pass_a_post():
    """They go on no screw: of both joints together the tip is at the post where one alone would miss it."""
    scene = nd.Scene()
    scene.add_sphere("post", 0.02, fixed=True, position=(-np.sin(1.3), 0, -np.cos(1.3) - 1.0))
    tip = {"j1": [(shapes.sphere(0.02), at((0, 0, -1)))]}
    add(scene, "arm", pendulum(2), q=(1.8, -1.8), collisions=tip)
    scene.set_motion("arm/j0", -100.0)
    scene.set_motion("arm/j1", 100.0)
    with pytest.raises(ValueError, match="contradict: 'post' and 'arm/j1_0' overlap"):
        nd.simulate(scene, 0.05, 1e-2)


def test_a_driven_body_turns_by_whole_turns():
    scene = nd.Scene()
    scene.add_box("post", (0.02, 0.02, 0.2), fixed=True, position=(0, 0.4, 0))
    scene.add_box("bar", (1.0, 0.02, 0.02), fixed=True, position=(0, 0, 0))
    scene.set_motion("bar", ((0, 0, 0), (0, 0, 2.0 * np.pi / 1e-2)))
    with pytest.raises(ValueError, match="contradict: 'post' and 'bar' overlap"):
        nd.simulate(scene, 0.05, 1e-2)


@pytest.mark.slow
def test_a_driven_link_that_touches_goes_on_and_is_audited():
    """It reaches a thousandth of its radius into the ground: no more than what a scene may start with, and told."""
    run = nd.simulate(swinging(-1.0, 2e-5), 1.5, 5e-3)
    into = 0.5 * np.cos(run.q[1:, 0]) > 0.5 - 2e-5 + 1e-9
    np.testing.assert_array_equal(run.solver.status == nd.Status.OVERLAP, into)
    audit = nd.check(run)
    assert not audit.passed and audit["overlap"].worst == pytest.approx(2e-5 / 0.04, rel=0.01)


def test_driven_bodies_do_not_go_through_each_other():
    scene = nd.Scene()
    for name, x, speed in (("left", -1.0, 80.0), ("right", 1.0, -80.0)):
        scene.add_box(name, (0.01, 1.0, 1.0), position=(x, 0, 0), fixed=True)
        scene.set_motion(name, (speed, 0, 0))
    # They have changed sides after a step.
    with pytest.raises(ValueError, match="prescribed motions contradict: 'left' and 'right' overlap"):
        nd.simulate(scene, 0.1, 5e-2)


def test_a_box_that_driven_fingers_squeeze_is_told():
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (0.1, 0.1, 0.1), 1.0, position=(0, 0, 0.05))
    for name, side in (("left", -1.0), ("right", 1.0)):
        model = pin.Model()
        hang(model, 0, "slide", pin.JointModelPX(), lump(1.0, 0.01), (0.07 * side, 0, 0.05))
        add(scene, name, limit(model), collisions={"slide": [shapes.box((0.02, 0.05, 0.05))]})
        scene.set_motion(f"{name}/slide", velocity=-0.1 * side)
    with pytest.raises(nd.NotConverged, match=r"prescribed motions that contradict each other.*'box'"):
        nd.simulate(scene, 0.2, 5e-3, on_fail="raise")


def test_a_driven_joint_ends_at_its_limit():
    def driven(upper):
        scene, model = nd.Scene(), pendulum(1)
        model.lowerPositionLimit, model.upperPositionLimit = np.array([-1.0]), np.array([upper])
        scene.add_model("a", model)
        scene.set_motion("a/j0", 1.0)
        return nd.simulate(scene, 0.25, 1e-2)

    assert driven(0.25).q[-1] == pytest.approx(0.25, abs=1e-12)
    with pytest.raises(ValueError, match=r"contradict: joint 'a/j0' is 0\.01 rad or m beyond its limits, -1 and 0\.1"):
        driven(0.1)


@pytest.mark.slow
def test_driven_bodies_and_links_move_beside_what_is_there():
    """A driven wall on the ground and a driven rod above it: nothing pushes them, and they push what gives way."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("wall", (0.1, 0.1, 1), position=(1, 0, 0.5), fixed=True)
    scene.set_motion("wall", velocity=(0.5, 0, 0))
    rod = {"j0": [(shapes.sphere(0.1), at((0, 0, -1.0)))]}
    add(scene, "a", pendulum(2), position=(0, 0, 1.1), collisions=rod, q=(0.0, 3.0))
    scene.set_motion("a/j0", velocity=2.0)
    scene.add_sphere("ball", 0.1, 1.0, position=(1.16, 0, 0.1))
    trajectory = nd.simulate(scene, 0.1)
    touched = {frozenset((c.body1[0], c.body2[0])) for c in map(trajectory.contacts, range(1, 101)) if len(c)}
    assert touched <= {frozenset(("ground", "ball")), frozenset(("wall", "ball"))} and touched
    assert nd.check(trajectory)["overlap"].passed


def test_wrong_motions_are_refused():
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("wall", (1, 1, 1), position=(0, 0, 3), fixed=True)
    scene.add_box("box", (1, 1, 1), 1.0, position=(0, 0, 1))
    add(scene, "a", pendulum(2))
    for arguments, message in [
        (("box", (1, 0, 0)), "fixed body or joint must be one of ground, wall, a/j0, a/j1; got 'box'"),
        (("wall",), "either velocity or surface_velocity"),
        (("wall", (1, 0)), r"finite with shape \(3,\) or \(2, 3\)"),
        (("wall", lambda t: (0, 0, np.inf)), r"must be finite"),
        (("ground", (0, 0, 1)), "halfspace 'ground' cannot move"),
        (("a/j7", 1.0), "joint must be one of a/j0, a/j1; got 'a/j7'"),
        (("a/j0", (1.0, 2.0)), "must be one finite number"),
        (("a/j0", None, 1.0), "no surface_velocity"),
    ]:
        with pytest.raises(ValueError, match=message):
            scene.set_motion(*arguments)
    scene.set_motion("wall", velocity=lambda t: (0, 0, 0) if t < 0.5e-3 else "stop")
    with pytest.raises(ValueError, match=r"velocity of 'wall' must be finite .*, got 'stop'"):
        nd.simulate(scene, 0.01)


# -- together ----------------------------------------------------------------------------------------------------------


def everything():
    """A box on a moving table, a four-bar with friction and damping, a bouncing arm under PD, a driven crank."""
    scene = nd.Scene()
    scene.add_box("table", (2, 2, 0.1), position=(0, 0, -2.3), fixed=True)
    scene.set_motion("table", velocity=lambda t: ((0.1 * np.cos(5 * t), 0, 0.3 * np.sin(7 * t)), (0, 0, 0.5)))
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0.3, 0, -2.149))
    model, loops, v = four_bars(2)
    add(scene, "bars", model, v=v, loops=loops, friction=(0.5, 0, 0, 0.2, 0), damping=0.1, position=(3, 0, 0))
    hand = {"j2": [(shapes.sphere(0.1), at((0, 0, -1)))]}
    add(
        scene,
        "arm",
        pendulum(3, lower=-1.5, upper=1.2),
        q=(1.0, 0.2, 0.1),
        friction=(0.3, 0.1, 0),
        restitution=0.4,
        stiffness=(0, 5.0, 0),
        rest=0.2,
        armature=0.01,
        collisions=hand,
    )
    add(scene, "crank", pendulum(2), q=(0.1, 0.3), position=(-3, 0, 0))
    scene.set_motion("crank/j0", velocity=lambda t: np.sin(3 * t))
    return scene, lambda t, q, v: {"arm": nd.PD((0, 0, 30.0), (0, 0, 1.0), 0.5)}


@pytest.mark.parametrize("theta", [0.5, *(pytest.param(theta, marks=pytest.mark.slow) for theta in (0.7, 1.0))])
def test_ledger_closes_with_everything_at_once(theta):
    scene, controller = everything()
    trajectory = nd.simulate(scene, 0.4, 2e-3, theta=theta, controller=controller)
    assert closes(trajectory) < 1e-12
    for name in PHYSICS:
        assert np.abs(getattr(trajectory.energy, name)).max() > 1e-6, f"{name} takes no part"


def test_driven_bodies_are_recorded_and_drawn(tmp_path):
    scene, controller = everything()
    trajectory = nd.simulate(scene, 0.02, 2e-3, controller=controller)
    trajectory.save(tmp_path / "run.h5")
    read = nd.Trajectory.load(tmp_path / "run.h5")
    table = read.body("table")
    np.testing.assert_array_equal(table.position, trajectory.body("table").position)
    turned = 2 * np.arctan2(table.quaternion[-1, 2], table.quaternion[-1, 3])
    assert turned == pytest.approx(0.5 * 0.02, rel=1e-12) and np.ptp(table.position[:, 0]) > 1e-3
    read.to_html(tmp_path / "run.html")
    assert "table" in (tmp_path / "run.html").read_text()


# -- state -------------------------------------------------------------------------------------------------------------


def test_resuming_is_exact_to_the_bit():
    """Driven wall and joint, friction, limits, PD: two halves make the same bytes as one run."""

    def stepper():
        scene = nd.Scene()
        scene.add_box("table", (1, 1, 0.1), position=(0, 0, -2.05), fixed=True)
        scene.set_motion("table", velocity=lambda t: (0.1 * np.cos(5 * t), 0, 0.3 * np.sin(7 * t)))
        scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, -1.8))
        add(scene, "a", pendulum(3, upper=1.2), q=(1.0, 0.2, 0.1), friction=(0.3, 0.1, 0.0), restitution=0.4)
        scene.set_motion("a/j1", velocity=lambda t: 0.5 * np.sin(3 * t))
        return nd.Stepper(scene, 2e-3, controller=lambda t, q, v: {"a": nd.PD((0, 0, 30.0), (0, 0, 1.0), 0.5)})

    whole, first, second = stepper(), stepper(), stepper()
    for _ in range(160):
        last = whole.step()
    for _ in range(80):
        first.step()
    second.set_state(first.get_state())
    for _ in range(80):
        end = second.step()
    assert end.q.tobytes() == last.q.tobytes() and end.v.tobytes() == last.v.tobytes()
    assert end.frames_x.tobytes() == last.frames_x.tobytes()
    assert end.joint_impulse.tobytes() == last.joint_impulse.tobytes() and np.abs(end.joint_impulse).max() > 0
