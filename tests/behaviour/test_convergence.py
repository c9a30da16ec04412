"""Orders of accuracy, and rotations that keep what is conserved."""

import math
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import hang, limit, lump, serial
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

import nsdyn as nd
from nsdyn.scene import shapes

g = 9.81
ROUGH = nd.Material(mu=2.0)


def orders(run, steps):
    """log₂ of the ratios of successive errors of `run(steps)`, which gives an error or an array of them."""
    errors = [np.abs(run(n)).max() for n in steps]
    return np.log2(np.array(errors[:-1]) / errors[1:])


def own_orders(simulate, steps):
    """Orders of the final q of `simulate(steps)`, by the changes from each number of steps to its double."""
    ends = {n: simulate(n).q[-1] for n in [*steps, 2 * steps[-1]]}
    return orders(lambda n: ends[n] - ends[2 * n], steps)


# -- rotation ------------------------------------------------------------------------------------------------


def spinning(inertia, w, quaternion=(0, 0, 0, 1)):
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("body", (1, 1, 1), 1.0, quaternion=quaternion, inertia=np.diag(inertia), angular_velocity=w)
    return scene


def angular_momentum(trajectory, inertia):
    """World axes, shape (steps + 1, 3)."""
    R = Rotation.from_quat(trajectory.q[:, 3:7])
    return R.apply(trajectory.v[:, 3:6] * inertia)


INERTIA = np.array([1.0, 2.0, 3.0])
UNSTABLE = np.array([0.01, 1.0, 0.01])


@pytest.mark.parametrize(
    "turn", [0.5, 50.0, *(pytest.param(turn, marks=pytest.mark.slow) for turn in (1.9, 5.0, 1000.0))]
)
def test_energy_does_not_grow_however_long_the_step(turn):
    """`turn` radians per step."""
    w = np.array([0.3, 1.0, 0.2])
    dt = turn / np.linalg.norm(w)
    trajectory = nd.simulate(spinning(INERTIA, w), 1000 * dt, dt=dt)
    kinetic, momentum = trajectory.energy.kinetic, angular_momentum(trajectory, INERTIA)
    np.testing.assert_allclose(kinetic, kinetic[0], rtol=1e-12)
    # 1000 steps of round-off of up to 1000 rad.
    assert np.abs(momentum - momentum[0]).max() <= 2e-12


def test_theta_does_not_touch_the_energy_of_rotation():
    trajectory = nd.simulate(spinning(INERTIA, UNSTABLE), 10.0, dt=1e-2, theta=0.8)
    assert np.abs(trajectory.energy.kinetic - 1.0002).max() <= 1e-13


TOP = np.array([15.234375, 0.46875, 15.234375])
"""kg m²; about the tip: 15 kg at 1 m along the body's y axis."""
WEIGHT = 15.0 * g


def top(steps, duration=0.2):
    """A heavy top whose weight is a torque about its tip. O. Brüls, A. Cardona, M. Arnold, MMT 48, 2012."""

    def weight(t, q, v):
        arm = Rotation.from_quat(q[3:7]).apply((0, 1, 0))
        return {"body": ((0, 0, 0), np.cross(arm, (0, 0, -WEIGHT)))}

    scene = spinning(TOP, (0, 150.0, -4.61538))
    return nd.simulate(scene, duration, dt=duration / steps, external_force=weight)


@pytest.mark.slow
def test_heavy_top_is_second_order():
    def rate(t, y):
        R, w = Rotation.from_quat(y[:4]), y[4:]
        torque = np.cross((0, 1, 0), R.apply((0, 0, -WEIGHT), inverse=True))
        half = 0.5 * np.append(w, 0.0)
        x, v = y[:3], half[:3]
        dq = np.append(y[3] * v + np.cross(x, v), -x @ v)
        return np.concatenate((dq, (torque - np.cross(w, TOP * w)) / TOP))

    start = np.array([0, 0, 0, 1, 0, 150.0, -4.61538])
    exact = solve_ivp(rate, (0, 0.2), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]

    @cache
    def error(steps):
        trajectory = top(steps)
        q = trajectory.q[-1, 3:7]
        return np.append(math.copysign(1.0, q @ exact[:4]) * q - exact[:4], (trajectory.v[-1, 3:] - exact[4:]) / 150)

    assert np.abs(error(800)).max() < 1e-4
    np.testing.assert_allclose(orders(error, (200, 400, 800)), 2.0, rtol=0, atol=0.1)


def test_heavy_top_keeps_its_vertical_angular_momentum():
    trajectory = top(400, 2.0)
    momentum = angular_momentum(trajectory, TOP)
    assert np.ptp(momentum[:, 0]) > 50.0, "it precesses"
    # The torque has no vertical part; 400 steps of round-off on 70 N m s.
    assert np.ptp(momentum[:, 2]) <= 1e-12 * 70


# -- smooth motion in contact --------------------------------------------------------------------------------

FINE = nd.solvers.Auto(tol=1e-11)


def ellipsoid(rotation, w, mu):
    """An ellipsoid on the ground that rolls without slip at the start."""
    radii = np.array([0.3, 0.2, 0.15])
    R = rotation.as_matrix()
    down = R.T @ (0, 0, -1)
    low = R @ (radii**2 * down) / np.linalg.norm(radii * down)
    scene = nd.Scene()
    material = nd.Material(mu)
    scene.add_halfspace("ground", material=material)
    scene.add_ellipsoid(
        "egg",
        radii,
        1.0,
        position=(0, 0, -low[2]),
        quaternion=rotation.as_quat(),
        angular_velocity=w,
        linear_velocity=-np.cross(w, low),
        material=material,
    )
    return scene


def rocking(angle=0.25):
    """A block on one edge, falling back without sliding."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=ROUGH)
    rotation = Rotation.from_euler("y", angle)
    position = -rotation.apply((0.05, 0, -0.15))
    scene.add_box("block", (0.1, 0.1, 0.3), 1.0, position=position, quaternion=rotation.as_quat(), material=ROUGH)
    return scene


def over_a_barrel():
    """An ellipsoid that slides across a lying cylinder, so that the normal turns too."""
    scene = nd.Scene()
    material = nd.Material(0.2)
    lying = Rotation.from_euler("x", 90, degrees=True).as_quat()
    scene.add_cylinder("barrel", 0.5, 2.0, fixed=True, quaternion=lying, material=material)
    rotation = Rotation.from_euler("y", 0.3)
    scene.add_ellipsoid(
        "egg",
        (0.2, 0.15, 0.1),
        1.0,
        position=rotation.apply((0, 0, 0.6)),
        quaternion=rotation.as_quat(),
        linear_velocity=rotation.apply((0.5, 0.3, 0)),
        angular_velocity=(0, 0, 1),
        material=material,
    )
    return scene


def arm(folder, mu):
    """Two links whose tip, a ball, slides on the ground."""
    inertial = (
        '<inertial><origin xyz="0 0 -0.25"/><mass value="1"/>'
        '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    joint = (
        '<joint name="j{0}" type="revolute"><parent link="l{0}"/><child link="l{1}"/><axis xyz="0 1 0"/>'
        '<origin xyz="0 0 {2}"/><limit lower="-9" upper="9" effort="9" velocity="0"/></joint>'
    )
    ball = '<collision><origin xyz="0 0 -0.5"/><geometry><sphere radius="0.1"/></geometry></collision>'
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="l0"/><link name="l1">{inertial}</link><link name="l2">{inertial}{ball}</link>'
        f"{joint.format(0, 1, 0)}{joint.format(1, 2, -0.5)}</robot>"
    )
    a, b = 1.0, -0.6
    spin = -math.sin(a) / math.sin(b)  # of the second link, for a tip that neither rises nor falls
    scene = nd.Scene()
    scene.add_halfspace("ground", offset=-0.5 * (math.cos(a) + math.cos(b)) - 0.1, material=nd.Material(mu))
    scene.add_urdf("arm", path, q=(a, b - a), v=(1.0, spin - 1.0), material=nd.Material(mu))
    return scene


SMOOTH = {
    "rolling in a plane": (lambda _: ellipsoid(Rotation.from_euler("y", 0.6), (0, 0, 0), 2.0), 0.6),
    "rolling": (lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2.0), 2.0), 0.5),
    "sliding without friction": (lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2), 0.0), 0.3),
    "sliding in a curve": (lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2), 0.15), 0.5),
    "sliding over a barrel": (lambda _: over_a_barrel(), 0.2),
    "rocking on an edge": (lambda _: rocking(), 0.12),
    "arm with a sliding tip": (lambda folder: arm(folder, 0.1), 0.1),
}


# Simpler than the next of them, or longer.
LATER = "rolling in a plane", "sliding without friction", "arm with a sliding tip", "sliding over a barrel"


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in LATER else []) for n in SMOOTH])
def test_smooth_contact_is_second_order(name, tmp_path):
    scene, duration = SMOOTH[name]

    def final(steps):
        trajectory = nd.simulate(scene(tmp_path), duration, dt=duration / steps, solver=FINE, on_fail="warn")
        assert (trajectory.solver.status == nd.Status.CONVERGED).all()
        assert all((trajectory.contacts(k).status > 0).any() for k in range(1, steps + 1)), "it stays in contact"
        return trajectory

    # 0.2 for the next order at these steps. At 100 steps, 6 ms, ellipsoids roll so far that what is left of their
    # normal velocity strikes.
    np.testing.assert_allclose(own_orders(final, (150, 300, 600)), 2.0, rtol=0, atol=0.2)


def test_ball_rolling_down_a_ball():
    """From the top of a fixed one, against the equation of motion θ'' = (5/7) g sin θ/(R + r)."""
    R, r, start, duration = 0.5, 0.1, 0.2, 0.6
    exact = solve_ivp(
        lambda t, y: (y[1], 5 / 7 * g * math.sin(y[0]) / (R + r)), (0, duration), (start, 0), rtol=1e-12, atol=1e-12
    ).y[:, -1]

    def error(steps):
        scene = nd.Scene()
        scene.add_sphere("hill", R, fixed=True, material=ROUGH)
        place = (R + r) * np.array([math.sin(start), 0, math.cos(start)])
        scene.add_sphere("ball", r, 1.0, position=place, material=ROUGH)
        body = nd.simulate(scene, duration, dt=duration / steps, solver=FINE).body("ball")
        x, v = body.position[-1], body.linear_velocity[-1]
        assert np.linalg.norm(x) == pytest.approx(R + r, abs=1e-5), "it has not left"
        return math.atan2(x[0], x[2]) - exact[0], np.linalg.norm(v) / (R + r) - exact[1]

    np.testing.assert_allclose(orders(error, (200, 400, 800)), 2.0, rtol=0, atol=0.15)


@pytest.mark.parametrize("share", [0.8, 1.6, pytest.param(6.0, marks=pytest.mark.slow)])
def test_light_links_with_a_load_keep_their_energy(share):
    """On a loop they would whip in moves longer than √(m d / T): such moves are halved."""
    rods, mass, length, load, lean = 3, 1e-3, 0.1, 1.0, 0.5
    tension = load * 9.81 / (2.0 * math.cos(lean))  # N, of either side

    def gained(looped):
        """Energy that numerics gave or took so far, over the largest kinetic energy."""
        model, parent, place = pin.Model(), 0, pin.SE3.Identity()
        for k in range(2 * rods if looped else rods):
            parent = model.addJoint(parent, pin.JointModelRY(), place, f"j{k}")
            place = pin.SE3(np.eye(3), np.array([0.0, 0.0, length]))
            body = pin.Inertia.FromSphere(load if k == rods - 1 else mass, 0.01)
            model.appendBodyToJoint(parent, body, place)
            model.addJointFrame(parent)
        scene, q, dt = nd.Scene(), np.zeros(model.nq), share * math.sqrt(mass * length / tension)
        q[0] = math.pi - lean
        if looped:
            q[rods] = 2.0 * lean - math.pi
        scene.add_model("chain", model, q=q)
        if looped:
            scene.add_loop("chain", "end", f"j{2 * rods - 1}", position=(0.0, 0.0, length))
        push = {f"chain/j{rods - 1}": (0.3, 0.0, 0.0)}
        energy = nd.simulate(scene, 80 * dt, dt, external_force=lambda t, q, v: push).energy
        return np.abs(energy.integration.cumsum()).max() / energy.kinetic.max()

    assert gained(True) < 0.1  # each move errs by 0.003 of it at most, of either sign; without halves by all, and more
    assert gained(False) < 1e-8  # flows are followed to 1e-9 of the velocity


@pytest.mark.parametrize("stiffness", [1e2, 1e4, 1e8])
def test_stiff_springs_do_not_shorten_moves(stiffness):
    """They are solved implicitly, so that no move is halved for their vibrations."""
    model, parent = pin.Model(), 0
    for name in ("inner", "outer"):
        parent = hang(model, parent, name, pin.JointModelRY(), lump(1.0, 1 / 12, (0.0, 0.0, -0.5)), (0.0, 0.0, -0.5))
    scene = nd.Scene()
    scene.add_model("arm", model, q=(0.3, -0.2), stiffness=(stiffness, stiffness), rest=(0.1, 0.0))
    stepper = nd.Stepper(scene, dt=1e-2)
    assert all(stepper.step().pieces is None for _ in range(20))


@pytest.mark.slow
def test_a_joint_at_rest_on_its_limit_is_second_order():
    """A double pendulum whose inner link rests on its limit swings as its outer one alone."""
    stop, start, T = 0.3, 0.1, 0.3

    def model(links):
        out, parent, place = pin.Model(), 0, pin.SE3.Identity()
        for name in ("inner", "outer"):
            if name in links:
                parent = out.addJoint(parent, pin.JointModelRY(), place, name)
                place = pin.SE3.Identity()
                out.appendBodyToJoint(parent, pin.Inertia(1.0, np.array((0, 0, -0.5)), np.eye(3) / 12), place)
            else:
                place = pin.SE3(pin.rpy.rpyToMatrix(0.0, stop, 0.0), np.zeros(3))
            place = place * pin.SE3(np.eye(3), np.array((0.0, 0.0, -1.0)))
        return out

    def run(links, q, n):
        m = model(links)
        if len(q) > 1:
            m.lowerPositionLimit, m.upperPositionLimit = np.array((stop, -9.0)), np.full(2, 9.0)
        scene = nd.Scene()
        scene.add_model("arm", m, q=q)
        return nd.simulate(scene, T, T / n)

    alone = run(("outer",), [start], 2000)
    exact = np.array((alone.q[-1, 0], alone.v[-1, 0]))

    def error(n):
        out = run(("inner", "outer"), [stop, start], n)
        assert not out.energy.projection.any()  # the limit is closed where each step ends
        np.testing.assert_allclose(out.q[:, 0], stop, rtol=0, atol=1e-8)  # what counts as closed
        return np.array((out.q[-1, 1], out.v[-1, 1])) - exact

    np.testing.assert_allclose(orders(error, (25, 50, 100)), 2.0, rtol=0, atol=0.1)


def test_pendulum_is_fourth_order(tmp_path):
    """A rod on a hinge, released at 1 rad, after one period 4 K(sin ½)/√(m g l/J)."""
    path = tmp_path / "pendulum.urdf"
    path.write_text(
        '<robot name="pendulum"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -0.5"/>'
        '<mass value="1.3"/><inertia ixx="0.1" iyy="0.1" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><origin xyz="0 0 -1"/><geometry><sphere radius="0.1"/></geometry></collision></link>'
        '<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" effort="9" velocity="0"/></joint></robot>'
    )
    period = 4 * ellipk(math.sin(0.5) ** 2) / math.sqrt(1.3 * g * 0.5 / (0.1 + 1.3 * 0.25))

    def error(steps):
        scene = nd.Scene()
        scene.add_urdf("pendulum", path, q=(1.0,))
        trajectory = nd.simulate(scene, period, dt=period / steps)
        return trajectory.q[-1, 0] - 1.0, trajectory.v[-1, 0]

    # 0.011 for the next order.
    np.testing.assert_allclose(orders(error, (200, 400, 800)), 4.0, rtol=0, atol=0.02)


# -- forces that depend on the velocity ----------------------------------------------------------------------


def closes(trajectory):
    """The trajectory, whose ledger closes."""
    e = trajectory.energy
    assert np.abs(e.defect).max() <= 1e-13 * (np.abs(e.kinetic).max() + np.ptp(e.potential))
    return trajectory


def test_drag_is_second_order():
    """v' = -c v: 1 - e^-c far after 1 s, and half of 1 - e^-2c of the energy lost, by the external force alone."""

    def error(steps):
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_sphere("ball", 0.1, 1.0, linear_velocity=(1, 0, 0))
        trajectory = closes(nd.simulate(scene, 1.0, 1 / steps, external_force=lambda t, q, v: {"ball": -2.0 * v[:3]}))
        ball, work = trajectory.body("ball"), trajectory.energy.external.sum()
        exact = 0.5 * (1 - math.exp(-2)), math.exp(-2), -0.5 * (1 - math.exp(-4))
        return np.array((ball.position[-1, 0], ball.linear_velocity[-1, 0], work)) - exact

    np.testing.assert_allclose(orders(error, (50, 100, 200)), 2.0, rtol=0, atol=0.05)


@pytest.mark.slow
def test_a_magnetic_force_does_no_work():
    """One turn: the place to second order, the energy, which only the prediction errs in, to third."""

    def run(steps):
        scene, w = nd.Scene(gravity=(0, 0, 0)), 2 * math.pi
        scene.add_sphere("ball", 0.1, 1.0, linear_velocity=(1, 0, 0))
        return closes(
            nd.simulate(scene, 1.0, 1 / steps, external_force=lambda t, q, v: {"ball": (w * v[1], -w * v[0], 0)})
        )

    energy = {n: run(n).energy.kinetic for n in (100, 200, 400)}
    assert energy[100][-1] / energy[100][0] - 1 < 5e-4  # ½ π (2 π/100)³ = 3.9e-4
    np.testing.assert_allclose(orders(lambda n: energy[n][-1] - energy[n][0], energy), 3.0, rtol=0, atol=0.02)
    place = orders(lambda n: run(n).body("ball").position[-1], (100, 200, 400))
    np.testing.assert_allclose(place, 2.0, rtol=0, atol=0.05)


@pytest.mark.slow
def test_a_torque_against_the_spin_is_second_order():
    """-c ω on a body that tumbles, in world axes, against a fine run."""

    def run(steps):
        scene = spinning(INERTIA, (1.0, 4.0, 2.0))

        def brake(t, q, v):
            return {"body": ((0, 0, 0), -Rotation.from_quat(q[3:7]).apply(v[3:6]))}

        return closes(nd.simulate(scene, 1.0, 1 / steps, external_force=brake))

    np.testing.assert_allclose(own_orders(run, (50, 100, 200)), 2.0, rtol=0, atol=0.05)


def test_sliding_with_drag_is_second_order():
    """v' = -μ g - c v on a plane."""
    mu, c, time, speed = 0.1, 1.0, 0.8, 3.0
    k = mu * g / c
    exact = np.array(((speed + k) * (1 - math.exp(-c * time)) / c - k * time, (speed + k) * math.exp(-c * time) - k))

    def error(steps):
        scene, material = nd.Scene(), nd.Material(mu)
        scene.add_halfspace("ground", material=material)
        scene.add_box(
            "box", (0.4, 0.4, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(speed, 0, 0), material=material
        )
        drag = closes(nd.simulate(scene, time, time / steps, external_force=lambda t, q, v: {"box": -c * v[:3]}))
        box = drag.body("box")
        return np.array((box.position[-1, 0], box.linear_velocity[-1, 0])) - exact

    np.testing.assert_allclose(orders(error, (20, 40, 80)), 2.0, rtol=0, atol=0.05)


@pytest.mark.slow
def test_joint_torques_against_the_motion_are_second_order():
    """A damping torque, and a force across the motion of the hand of an arm."""

    def run(steps):
        scene = nd.Scene(gravity=(0, g, 0))
        scene.add_urdf("arm", nd.scenes.folder() / "arm.urdf", q=(0.5, 0.3), v=(2.0, 1.0))
        return closes(
            nd.simulate(
                scene,
                0.5,
                0.5 / steps,
                controller=lambda t, q, v: {"arm": -0.3 * v},
                external_force=lambda t, q, v: {"arm/hand": (0.5 * v[1], -0.5 * v[0], 0)},
            )
        )

    # 0.09 and 0.06 for the next order.
    np.testing.assert_allclose(own_orders(run, (50, 100, 200)), 2.0, rtol=0, atol=0.1)


def test_a_controlled_slide_on_a_plane_is_second_order():
    """A ball on two rails, x and z, that the control slows by c v and presses on the ground by d v: c + μ d in all."""
    mu, c, d, mass, time, speed = 0.2, 0.7, 1.5, 2.0, 0.8, 3.0
    rails, bodies = (pin.JointModelPX(), pin.JointModelPZ()), (pin.Inertia.Zero(), lump(mass, 0.01))
    model = limit(serial(rails, bodies, (0, 0, 0)))
    decay, k = (c + mu * d) / mass, mu * g / ((c + mu * d) / mass)
    far = (speed + k) * (1 - math.exp(-decay * time)) / decay - k * time
    exact = np.array((far, (speed + k) * math.exp(-decay * time) - k))

    def error(steps):
        scene, material = nd.Scene(), nd.Material(mu)
        scene.add_halfspace("ground", material=material)
        ball = {"j1": [shapes.sphere(0.1)]}
        scene.add_model("a", model, collisions=ball, q=[0.0, 0.1], v=[speed, 0.0], material=material)
        control = closes(
            nd.simulate(scene, time, time / steps, controller=lambda t, q, v: {"a": (-c * v[0], -d * v[0])})
        )
        return np.array((control.q[-1, 0], control.v[-1, 0])) - exact

    np.testing.assert_allclose(orders(error, (20, 40, 80)), 2.0, rtol=0, atol=0.05)


# -- impacts -----------------------------------------------------------------------------------------------


def test_bounces_are_exact():
    """Height of a ball after three bounces, whatever the step and wherever in it they fall."""
    e, duration = 0.8, 1.5

    def error(steps, shift):
        height = 0.5 + 0.01 * shift
        first = math.sqrt(2 * height / g)
        speed, t = g * first, duration - first
        while t > 2 * e * speed / g:
            speed, t = e * speed, t - 2 * e * speed / g
        scene = nd.scenes.load("bounce")(height=height, restitution=e)
        ball = nd.simulate(scene, duration, dt=duration / steps).body("ball")
        return ball.position[-1, 2] - 0.1 - (e * speed * t - 0.5 * g * t * t)

    for steps in (75, 150, 300):
        # Impacts are located to 1e-3 of a closed gap, 1e-13 m.
        assert max(abs(error(steps, shift)) for shift in (0.0, 0.2, 0.5, 0.7)) <= 1e-12


@pytest.mark.parametrize(("across", "mu", "e"), [(0.05, 0.8, 0.0), (0.03, 0.5, 0.0), (0.3, 0.8, 0.5), (0.1, 0.5, 0.2)])
def test_a_can_that_seems_to_rock_rolls(across, mu, e):
    """M. Srinivasan, A. Ruina 2008: its contact sweeps around the rim, and it rises again. Nothing ever strikes."""
    can = nd.scenes.load("can")(across=across, mass=1.0, mu=mu, restitution=e)
    fine = nd.simulate(can, 0.6, dt=1e-4)
    for dt in (1e-2, 3e-3):
        run = nd.simulate(can, 0.6, dt=dt)
        energy = run.energy.total - g * 0.05  # above lying flat
        assert energy[-1] + abs(run.energy.friction.sum()) >= 0.995 * energy[0]  # an impact takes a fifth and more
        # m: where the second sweep ends depends on the first, which is far shorter than dt.
        np.testing.assert_allclose(run.body("can").position[-1], fine.body("can").position[-1], rtol=0, atol=3e-4)
        assert nd.check(run).passed


@pytest.mark.parametrize(("dt", "error"), [(1e-2, 3e-4), (3e-3, 3e-5), (1e-3, 3e-5)])
def test_a_can_without_friction_rolls_on_its_rim(dt, error):
    """Its height beside that of its Lagrange function, in which the momenta about its axis and the vertical are kept.

    The sweeps are resolved to a hundredth of a body a move, whatever the dt: from 3 ms on that decides the error, m.
    """
    m, r, h, across, tilt = 1.0, 0.04, 0.08, 0.3, math.radians(12.0)
    A, C = m * (3 * r * r + h * h) / 12, 0.5 * m * r * r
    spin = C * across * math.sin(tilt)
    upright = (C - A) * across * math.sin(tilt) * math.cos(tilt)

    def slope(t, y):
        a, rate = y
        s, c = math.sin(a), math.cos(a)
        left, z1, z2 = upright - spin * c, r * c - 0.5 * h * s, -r * s - 0.5 * h * c
        push = left * left * c / (A * s**3) - left * spin / (A * s) - m * g * z1 - m * z1 * z2 * rate**2
        return rate, push / (A + m * z1 * z1)

    end = solve_ivp(slope, (0, 0.6), (tilt, 0.0), method="DOP853", rtol=1e-12, atol=1e-14, max_step=1e-3).y[0, -1]
    can = nd.scenes.load("can")(across=across, radius=r, height=h, mass=m, mu=0.0)
    height = nd.simulate(can, 0.6, dt=dt).body("can").position[-1, 2]
    assert abs(height - r * math.sin(end) - 0.5 * h * math.cos(end)) <= error


@pytest.mark.parametrize(
    ("radii", "dt", "lost"),
    [((0.1, 0.1, 0.01), 1e-2, 0.062), ((0.1, 0.05, 0.01), 5e-3, 0.03), ((0.1, 0.1, 2e-3), 1e-2, 0.04)],
)
def test_a_lens_that_falls_flat_keeps_its_energy(radii, dt, lost):
    """Its contact crosses it in a few steps. Half a move extrapolates the lever of that, which took up to 0.9 of it."""
    scene, tilt, material = nd.Scene(), math.radians(20.0), nd.Material(mu=0.5)
    scene.add_halfspace("table", material=material)
    place = {"position": (0, 0, math.hypot(radii[0] * math.sin(tilt), radii[2] * math.cos(tilt)))}
    turned = {"quaternion": (0, math.sin(tilt / 2), 0, math.cos(tilt / 2))}
    scene.add_ellipsoid("lens", radii, 1.0, **place, **turned, material=material)
    run = nd.simulate(scene, 0.6, dt=dt)
    energy, works = run.energy.total - g * radii[2], run.energy
    assert energy[-1] + abs(works.friction.sum()) >= (1.0 - lost) * energy[0]
    assert np.abs(works.integration).sum() <= 0.04 * energy[0]
    assert nd.check(run).passed


@pytest.mark.parametrize("dt", [2.5e-2, 1.25e-2, 6.25e-3, 3.125e-3])
@pytest.mark.parametrize("shape", ["box", "cylinder"])
def test_a_body_that_spins_down_stops_where_it_does(shape, dt):
    """Its corners or its rim stop all at once, μ g d/ρ² slower each second, in a step in which it still turns."""
    scene, mu, spin = nd.Scene(), 0.3, 12.0
    scene.add_halfspace("table", material=nd.Material(mu=mu))
    how = {"position": (0, 0, 0.01), "angular_velocity": (0, 0, spin), "material": nd.Material(mu=mu)}
    if shape == "box":
        scene.add_box("body", (0.2, 0.1, 0.02), 1.0, **how)
        slowing = mu * g * math.hypot(0.1, 0.05) / ((0.2**2 + 0.1**2) / 12)
    else:
        scene.add_cylinder("body", 0.1, 0.02, 1.0, **how)
        slowing = mu * g * 0.1 / (0.1**2 / 2)
    run = nd.simulate(scene, 0.3, dt=dt)
    turned = run.body("body").angular_velocity[:, 2], run.body("body").quaternion[-1]
    assert abs(turned[0][-1]) <= 1e-10
    # Second order; a stop that is not located errs by up to 4 dt².
    assert abs(2 * math.atan2(turned[1][2], turned[1][3]) - spin**2 / (2 * slowing)) <= 0.06 * dt**2
