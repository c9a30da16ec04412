"""`nd.PD` and its limits: the law and order of joint springs, any gain, and torques that stay below their limits."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, four_bars, limit, lump, pendulum, serial, slider

import nsdyn as nd
from nsdyn.scene import shapes

BALL = {"rail": [(shapes.sphere(0.02), at((0, 0, 0)))]}


def run(scene, control, duration, dt, **options):
    """Trajectory under one PD control of the articulation "a", or under what a function of t gives."""
    given = control if callable(control) else lambda t: control
    controller = None if control is None else lambda t, q, v: {"a": given(t)}
    trajectory = nd.simulate(scene, duration, dt, controller=controller, **options)
    e = trajectory.energy
    works = max(np.abs(getattr(e, name)).max() for name in e.names[2:-1])
    assert np.abs(e.defect).max() <= 1e-12 * max(e.kinetic.max(), np.ptp(e.potential), works, 1e-12)
    return trajectory


def worst(trajectory, joints, limits):
    """Largest |torque| over its limit."""
    pairs = zip(joints, limits, strict=True)
    return max(np.abs(trajectory.joint(f"a/{joint}").torque).max() / most for joint, most in pairs)


# -- the law -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("theta", [0.5, 0.7])
@pytest.mark.parametrize(("links", "kp", "kd"), [(1, 50.0, 1.0), (2, 300.0, 0.0), (3, 150.0, 1.5), (2, 0.0, 4.0)])
def test_a_soft_control_is_joint_springs_and_dampers(links, kp, kd, theta):
    goal, ends = np.linspace(0.4, -0.2, links), []
    for springs in (True, False):
        scene = nd.Scene()
        law = {"stiffness": kp, "damping": kd, "rest": goal} if springs else {}
        add(scene, "a", pendulum(links), q=np.linspace(1.0, 0.3, links), **law)
        ends.append(run(scene, None if springs else nd.PD(kp, kd, goal), 0.2, 5e-3, theta=theta).q[-1])
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-12)  # round-off of 40 steps


def test_a_mass_under_control_is_of_second_order():
    """q'' = -ω² q - 2 ζ ω q' of a mass on a rail, with its closed form."""
    m, kp, kd, time = 2.0, 200.0, 4.0, 0.64
    decay, swing = kd / (2 * m), np.sqrt(kp / m - (kd / (2 * m)) ** 2)
    exact = 0.3 * np.exp(-decay * time) * (np.cos(swing * time) + decay / swing * np.sin(swing * time))

    def error(h):
        scene = nd.Scene()
        add(scene, "a", slider(m), q=[0.3])
        return abs(run(scene, nd.PD(kp, kd, 0.0), time, h).q[-1, 0] - exact)

    errors = [error(h) for h in (2e-2, 1e-2, 5e-3)]
    np.testing.assert_allclose(-np.diff(np.log2(errors)), 2.0, rtol=0, atol=0.05)


@pytest.mark.parametrize("damping", [2.0, 5.9, 6.1, 10.0, 1e3, 1e8])
def test_what_damping_stops_overshoots_by_a_half_at_most(damping):
    """δ = h kd/m: v falls by (1 - δ/2)/(1 + δ/2) a step up to δ = 6, beyond by -2/(δ - 2)."""
    m, h = 2.0, 1e-2
    scene = nd.Scene()
    add(scene, "a", slider(m), v=[1.0])
    v = run(scene, nd.PD(0.0, damping * m / h, 0.0), 4 * h, h).v[:, 0]
    factor = (1.0 - damping / 2) / (1.0 + damping / 2) if damping <= 6.0 else -2.0 / (damping - 2.0)
    np.testing.assert_allclose(v, factor ** np.arange(5), rtol=1e-12, atol=1e-15)
    assert abs(factor) <= 0.5


@pytest.mark.parametrize("stiffness", [7.0, 30.0, 1e3, 1e8])
def test_what_swings_too_fast_for_the_step_dies_down(stiffness):
    """σ = h² kp/m > 6: q and h v are those of the θ-method with α = 1 - 3/σ, whose determinant is below 1."""
    m, h, steps = 2.0, 1e-2, 20
    scene = nd.Scene()
    add(scene, "a", slider(m), q=[1.0])
    trajectory = run(scene, nd.PD(stiffness * m / h**2, 0.0, 0.0), steps * h, h)
    alpha, path = 1.0 - 3.0 / stiffness, [np.array((1.0, 0.0))]
    for _ in range(steps):
        q, w = path[-1]
        force = -stiffness * (q + 0.5 * w - (1.0 - alpha) ** 2 * w)
        new = (w + force) / (1.0 + stiffness * alpha**2)
        path.append(np.array((q + 0.5 * (w + new), new)))
    np.testing.assert_allclose(np.c_[trajectory.q, h * trajectory.v], path, rtol=0, atol=1e-12)
    assert np.abs(path[-1]).max() <= 0.25


@pytest.mark.slow
def test_a_trot_is_of_second_order():
    """The quadruped's joints against a fine step; below 5 ms the times at which feet land show."""
    module = nd.scenes.module("quadruped")

    def joints(dt):
        scene = module.scene()
        return nd.simulate(scene, 1.5, dt, controller=module.controller(scene)).q[:: round(1e-2 / dt), 7:]

    fine = joints(6.25e-4)  # whose own error is a sixteenth of that of the last
    errors = [np.abs(joints(dt) - fine).max() for dt in (1e-2, 5e-3, 2.5e-3)]
    assert errors[1] <= 1.5e-3 and errors[0] >= 3.5 * errors[1] and errors[2] <= 6e-4


# -- limits ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mass", "dt"),
    [
        (0.01, 1e-2),
        *(
            pytest.param(mass, dt, marks=pytest.mark.slow)
            for mass, dt in ((10.0, 1e-4), (0.01, 1e-3), (0.01, 1e-4), (10.0, 1e-2), (10.0, 1e-3))
        ),
    ],
)
@pytest.mark.parametrize(
    ("kp", "kd"),
    [
        *((0.0, 1.0), (1e6, 1e6)),  # a soft one and the stiffest
        *(
            pytest.param(*gains, marks=pytest.mark.slow)
            for gains in ((1.0, 0.0), (0.0, 1e6), (1e6, 0.0), (1.0, 1.0), (1e3, 1e2))
        ),
    ],
)
def test_a_finger_presses_with_its_limit(kp, kd, dt, mass):
    """A servo that wants 2 N and more, and gives 0.7: flying to a wall, striking and pressing it."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("wall", (0.1, 0.1, 0.1), fixed=True, position=(0.0702, 0, 0))
    add(scene, "a", slider(mass), v=[0.1], collisions=BALL)
    servo = nd.PD(kp, kd, 2.0 if kp else 0.0, 2.0 + 0.1, limit=0.7)
    trajectory = run(scene, servo, max(150 * dt, 0.02), dt)
    assert worst(trajectory, ["rail"], [0.7]) <= 1.0 + 1e-9
    assert (trajectory.solver.status == 0).all()
    assert trajectory.force("a/rail")[-1][0] == pytest.approx(-0.7, rel=1e-6)
    assert nd.check(trajectory).passed


@pytest.mark.parametrize(("kp", "kd"), [(400.0, 30.0), (0.0, 80.0), (1e4, 3e3)])
def test_a_limited_servo_follows_its_clipped_law(kp, kd):
    """Every step of a mass on a rail is m (v⁺ - v⁻) = h clip(τ₀ - b v⁺, ±L), far from its target and at it."""
    m, h, most, goal = 2.0, 5e-3, 3.0, 0.05
    scene = nd.Scene()
    add(scene, "a", slider(m), v=[-0.2])
    rate = 0.0 if kp else 0.4
    trajectory = run(scene, nd.PD(kp, kd, goal, rate, limit=most), 1.0, h)
    beta = max(0.5, 1.0 - 3.0 * m / (h * kd))
    swings = h * h * kp / (m + 0.5 * h * kd)
    alpha = max(0.5, 1.0 - 3.0 / swings) if kp else 0.5
    q, v, path, forces = 0.0, -0.2, [], []
    for _ in range(200):
        start = kp * (goal - q - 0.5 * h * v + h * (1 - alpha) ** 2 * v) + kd * (rate - (1 - beta) * v)
        slope = beta * kd + h * alpha**2 * kp
        new = (m * v + h * start) / (m + h * slope)
        force = np.clip(start - slope * new, -most, most)
        new = v + h * force / m
        q, v = q + 0.5 * h * (v + new), new
        path.append((q, v))
        forces.append(force)
    np.testing.assert_allclose(np.c_[trajectory.q, trajectory.v][1:], path, rtol=0, atol=1e-10)
    np.testing.assert_allclose(trajectory.joint("a/rail").torque, forces, rtol=0, atol=1e-7 * most)
    saturated = np.abs(forces) == most
    assert saturated.any() and not saturated.all()
    # All of its work is that of the torque on the mean velocity.
    mean = 0.5 * (trajectory.v[1:, 0] + trajectory.v[:-1, 0])
    np.testing.assert_allclose(trajectory.energy.external, h * mean * forces, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("kp", "kd"), [(1e4, 0.0), (0.0, 50.0), (1e6, 1e6)])
def test_limit_friction_and_actuator_in_one_joint(kp, kd):
    """8 N against 3 N of friction up to a stop: (8 - 3)/2 m/s², and works that add up to nothing."""
    scene = nd.Scene(gravity=(0, 0, 0))
    add(scene, "a", slider(2.0, upper=0.05), friction=3.0)
    trajectory = run(scene, nd.PD(kp, kd, 1.0, 1.0, limit=8.0), 0.4, 1e-3)
    np.testing.assert_allclose(trajectory.v[:100, 0], 2.5e-3 * np.arange(100), rtol=0, atol=1e-10)
    assert trajectory.q[-1, 0] == pytest.approx(0.05, abs=1e-10) and abs(trajectory.v[-1, 0]) <= 1e-10
    joint, e = trajectory.joint("a/rail"), trajectory.energy
    assert np.abs(joint.torque).max() <= 8.0 * (1 + 1e-9) and np.abs(joint.friction).max() <= 3.0 * (1 + 1e-9)
    assert joint.torque[-1] + joint.friction[-1] + joint.limit_impulse[-1] / 1e-3 == pytest.approx(0, abs=1e-7)
    found = e.external.sum(), e.friction.sum(), e.normal.sum()
    np.testing.assert_allclose(found, (8.0 * 0.05, -3.0 * 0.05, -5.0 * 0.05), rtol=0, atol=1e-9)
    assert nd.check(trajectory).passed


def chain():
    """Two masses on each other along x, the second within 5 cm of the first."""
    model = limit(serial([pin.JointModelPX()] * 2, [lump(1.0, 0.01), lump(2.0, 0.01)], (0, 0, 0)))
    model.lowerPositionLimit, model.upperPositionLimit = np.array((-1.0, -0.05)), np.array((1.0, 0.05))
    return model


@pytest.mark.parametrize(("limits", "pressed"), [((6.0, 10.0), (6.0, 6.0)), ((10.0, 4.0), (10.0, 4.0))])
@pytest.mark.parametrize(
    ("kp", "kd", "dt"),
    [*(pytest.param(*k, marks=pytest.mark.slow) for k in ((1e3, 30.0, 2e-3), (1e6, 1e3, 1e-2))), (200.0, 20.0, 1e-2)],
)
def test_two_limited_actuators_press_in_a_row(limits, pressed, kp, kd, dt):
    """The weaker first presses; a weaker second gives way to its stop, which carries the rest."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("wall", (0.1, 0.1, 0.1), fixed=True, position=(0.08, 0, 0))
    add(scene, "a", chain(), collisions={"j1": [(shapes.sphere(0.02), at((0, 0, 0)))]})
    trajectory = run(scene, nd.PD(kp, kd, (0.5, 0.02), limit=limits), 1.5, dt)
    assert worst(trajectory, ["j0", "j1"], limits) <= 1.0 + 1e-9
    assert trajectory.force("a/j1")[-1][0] == pytest.approx(-limits[0], rel=1e-4)  # the last of a slow decay
    torques = [trajectory.joint(f"a/j{k}").torque[-1] for k in (0, 1)]
    np.testing.assert_allclose(torques, pressed, rtol=1e-4)
    assert nd.check(trajectory).passed


@pytest.mark.slow
def test_a_limited_control_of_a_loop_is_the_limit():
    """Far beyond its limit a control is a constant force, on closed loops too."""
    ends = []
    for servo in (True, False):
        scene = nd.Scene()
        model, loops, v = four_bars(2)
        add(scene, "a", model, v=v, loops=loops)
        on = np.eye(model.nv)[0]
        control = nd.PD(1e3 * on, 10.0 * on, 50.0 * on, limit=2.0) if servo else 2.0 * on
        trajectory = run(scene, control, 0.3, 2e-3, solver=nd.solvers.Auto(tol=1e-12))
        ends.append((trajectory.q[-1], trajectory.energy.external.sum()))
        assert abs(ends[-1][1]) > 0.5
    np.testing.assert_allclose(ends[0][0], ends[1][0], rtol=0, atol=1e-10)
    assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-10)


@pytest.mark.parametrize(
    ("speed", "torque"), [(1.51, 1.0), pytest.param(1.55, 4.0, marks=pytest.mark.slow), (1.0, -4.0)]
)
def test_a_control_on_a_driven_joint_is_no_more_than_its_limit(speed, torque):
    """The joint moves as told, at 1.5 rad/s; its control gives 100 (speed - 1.5), or its limit."""
    scene = nd.Scene()
    add(scene, "a", pendulum(2), q=(0.0, 0.3), v=(1.5, 0.0))
    scene.set_motion("a/j0", velocity=1.5)
    servo = nd.PD(0.0, (100.0, 3.0), 0.0, (speed, 2.0), limit=(4.0, 3.0))
    trajectory = run(scene, servo, 0.1, 1e-3)
    np.testing.assert_allclose(trajectory.v[:, 0], 1.5, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trajectory.joint("a/j0").torque, torque, rtol=0, atol=1e-11)
    assert worst(trajectory, ["j1"], [3.0]) <= 1.0 + 1e-9


def test_efforts_of_a_file_bound_a_servo_that_presses(tmp_path):
    body = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    shape = '</inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
    joint = '<joint name="j" type="prismatic"><parent link="base"/><child link="tip"/><axis xyz="1 0 0"/>'
    text = f'<robot name="r"><link name="base"/>{body.format("tip")}{shape}{joint}'
    (tmp_path / "r.urdf").write_text(text + '<limit lower="-1" upper="1" effort="9" velocity="0"/></joint></robot>')
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_urdf("a", tmp_path / "r.urdf")
    scene.add_box("wall", (0.1, 1, 1), fixed=True, position=(0.16, 0, 0))
    trajectory = run(scene, nd.PD(1e4, 1e3, 0.5), 0.5, 5e-3)
    assert worst(trajectory, ["j"], [9.0]) <= 1.0 + 1e-9
    assert trajectory.force("a/tip")[-1][0] == pytest.approx(-9.0, rel=1e-9)


@pytest.mark.slow
def test_a_limit_far_away_changes_no_bit():
    """A robot and a sliding box, and 50 m away a servo that begins to press beyond its limit, or has none."""

    def motion(most):
        scene = nd.Scene()
        scene.add_halfspace("ground", offset=-3.0)
        add(scene, "b", pendulum(2), q=(0.6, -0.3), collisions={"j1": [(shapes.sphere(0.1), at((0, 0, -1)))]})
        scene.add_box("box", (0.3, 0.3, 0.3), 2.0, position=(2, 0, -2.85), linear_velocity=(1, 0, 0))
        scene.add_box("wall", (0.1, 1, 1), fixed=True, position=(50.07, 0, 0))
        add(scene, "a", slider(2.0), position=(50, 0, 0), collisions=BALL)
        arm = nd.PD(800.0, 10.0, (-0.5, 0.0), limit=30.0)
        control = {"b": arm}
        return nd.simulate(
            scene,
            0.2,
            2e-3,
            controller=lambda t, q, v: control | {"a": nd.PD(800.0, 10.0, 0.05 * (1.0 + t), limit=most)},
        )

    free, held = motion(np.inf), motion(42.0)
    assert held.joint("a/rail").torque.max() == pytest.approx(42.0) and free.joint("a/rail").torque.max() > 45.0
    for name in ("position", "torque"):
        assert getattr(free.joint("b/j0"), name).tobytes() == getattr(held.joint("b/j0"), name).tobytes()
    assert free.body("box").position.tobytes() == held.body("box").position.tobytes()


def test_a_run_goes_on_bit_for_bit_at_a_limit():
    """From a state in which a servo presses at its limit, in the row that it had."""

    def stepper():
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_box("wall", (0.1, 0.1, 0.1), fixed=True, position=(0.0702, 0, 0))
        add(scene, "a", slider(0.3), v=[0.1], collisions=BALL)
        return nd.Stepper(scene, 1e-3, controller=lambda t, q, v: {"a": nd.PD(1e3, 1e2, 2.0, limit=0.7 + 0.1 * t)})

    whole, first, second = stepper(), stepper(), stepper()
    for _ in range(40):
        last = whole.step()
    for _ in range(20):
        first.step()
    second.set_state(first.get_state())
    for _ in range(20):
        end = second.step()
    assert end.q.tobytes() == last.q.tobytes() and end.v.tobytes() == last.v.tobytes()
    assert end.joints.tobytes() == last.joints.tobytes() and end.joints[0, 0] > 0.7e-3


def test_work_at_the_limit_is_the_force_along_the_way():
    """A cart between walls 4 mm apart strikes them with 70 points, and so often that a move catches the impacts."""
    scene, points = nd.Scene(gravity=(0, 0, 0)), [at((0, 0.03 * (k % 10), 0.03 * (k // 10))) for k in range(70)]
    bumpers, bouncy = [(shapes.sphere(0.01), place) for place in points], nd.Material(mu=0.0, restitution=0.9)
    scene.add_model("a", slider(), v=(1.0,), collisions={"rail": bumpers}, material=bouncy)
    for k, x in enumerate((0.112, -0.112)):
        scene.add_box(f"wall{k}", (0.2, 2, 2), fixed=True, position=(x, 0, 0), material=bouncy)
    held = run(scene, nd.PD(kp=1e4, kd=10.0, target=1.0, limit=7.0), 0.1, 1e-2)
    np.testing.assert_allclose(held.energy.external, 7.0 * np.diff(held.q[:, 0]), rtol=0, atol=1e-12)
    given = run(scene, [7.0], 0.1, 1e-2)
    np.testing.assert_allclose(held.q, given.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(held.energy.external, given.energy.external, rtol=0, atol=1e-12)
