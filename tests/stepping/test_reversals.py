"""Slip that turns round within a step: friction is against it until then, and the other way afterwards."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, hang, limit, lump, pendulum, serial
from scipy.integrate import solve_ivp

import nsdyn as nd
from nsdyn.scene import shapes
from nsdyn.stepping import substepping
from nsdyn.stepping.move import try_move

g = 9.81
SLOPE = math.radians(35.0)


def worst(run, exact, steps):
    """Largest errors of four runs with about so many steps, in which slip turns at other moments."""
    errors = []
    for n in range(steps, steps + 4):
        trajectory, found = run(n)
        e = trajectory.energy
        assert np.abs(e.defect).max() <= 1e-13 * (e.kinetic.max() + np.ptp(e.potential))
        assert e.friction.max() <= 1e-15
        errors.append(np.abs(np.array(found) - exact))
    return np.max(errors, axis=0)


def second_order(run, exact, steps):
    """Asserts that errors fall by three at least from each number of steps to the next, its double.

    Four in the mean: how much slip errs depends on when in a step it turns.
    """
    errors = [worst(run, exact, n) for n in steps]
    assert (np.array(errors[:-1]) >= 3.0 * np.array(errors[1:])).all(), errors


@pytest.mark.parametrize("steps", [25, 51, 200])
def test_a_block_that_comes_back_down_a_slope_is_exact(steps):
    """Shot up at 2 m/s it turns when v = 0; its forces are constant before and after."""
    mu, speed = 0.3, 2.0
    up, down = g * (math.sin(SLOPE) + mu * math.cos(SLOPE)), g * (math.sin(SLOPE) - mu * math.cos(SLOPE))
    top, time = speed**2 / 2 / up, 1.0 - speed / up
    fallen = down * time**2 / 2
    exact = np.array((top - fallen, -down * time, -mu * g * math.cos(SLOPE) * (top + fallen)))
    normal, along = np.array([math.sin(SLOPE), 0, math.cos(SLOPE)]), np.array([-math.cos(SLOPE), 0, math.sin(SLOPE)])

    def run(n):
        scene, material = nd.Scene(), nd.Material(mu)
        scene.add_halfspace("slope", normal=tuple(normal), material=material)
        scene.add_box(
            "b",
            (0.2, 0.2, 0.1),
            1.0,
            position=tuple(0.05 * normal),
            linear_velocity=tuple(speed * along),
            quaternion=(0, math.sin(SLOPE / 2), 0, math.cos(SLOPE / 2)),
            material=material,
        )
        trajectory = nd.simulate(scene, 1.0, 1.0 / n)
        b = trajectory.body("b")
        return trajectory, (b.position[-1] @ along, b.linear_velocity[-1] @ along, trajectory.energy.friction.sum())

    assert worst(run, exact, steps).max() <= 1e-12


def test_a_block_that_friction_holds_stops_and_stays():
    """μ > tan α: it stops within a step, and from then on nothing moves."""
    mu, speed = 0.8, 2.0
    scene, material = nd.Scene(gravity=(g * math.sin(SLOPE), 0, -g * math.cos(SLOPE))), nd.Material(mu)
    scene.add_halfspace("slope", material=material)
    scene.add_box("b", (0.2, 0.2, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(-speed, 0, 0), material=material)
    b = nd.simulate(scene, 1.0, 0.0123).body("b")
    after = math.ceil(speed / g / (math.sin(SLOPE) + mu * math.cos(SLOPE)) / 0.0123)
    assert np.linalg.norm(b.linear_velocity[after:], axis=1).max() <= 1e-12
    assert np.ptp(b.position[after:], axis=0).max() <= 1e-12


def test_a_block_that_its_belt_overtakes_is_exact():
    """The belt speeds up by more than friction gives: it first slows the block, then pulls it along."""
    mu, speed, belt = 0.2, 1.0, 3.0
    met = speed / (belt + mu * g)
    v = speed - mu * g * met
    exact = np.array(
        ((speed + v) / 2 * met + v * (0.6 - met) + mu * g * (0.6 - met) ** 2 / 2, v + mu * g * (0.6 - met))
    )

    def run(n):
        scene, material = nd.Scene(), nd.Material(mu)
        scene.add_halfspace("belt", material=material)
        scene.set_motion("belt", surface_velocity=lambda t: (belt * t, 0, 0))
        scene.add_box(
            "b", (0.4, 0.4, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(speed, 0, 0), material=material
        )
        b = nd.simulate(scene, 0.6, 0.6 / n).body("b")
        return b.position[-1, 0], b.linear_velocity[-1, 0]

    for n in (30, 31, 32, 100):
        np.testing.assert_allclose(run(n), exact, rtol=0, atol=1e-12)


def dry_hinge(v):
    """A body with J = 1 on a hinge with 2 N m of dry friction, at v rad/s."""
    model, scene = pin.Model(), nd.Scene()
    hang(model, 0, "hinge", pin.JointModelRZ(), lump(1.0, 1.0))
    scene.add_model("arm", model, v=[v], friction=[2.0])
    return scene


def test_a_dry_joint_that_turns_round_in_the_first_step():
    """J v' = -10 - 2 sign v from 0.05 rad/s on, with J = 1: it stops after 0.05/12 s, and goes back at -8 rad/s²."""
    run = nd.simulate(dry_hinge(0.05), 0.02, 2e-2, controller=lambda t, q, v: {"arm": np.array([-10.0])})
    stop, v = 0.05 / 12, -8 * (0.02 - 0.05 / 12)
    assert run.v[-1, 0] == pytest.approx(v, rel=1e-12)
    assert run.energy.friction[0] == pytest.approx(-2.0 * (0.5 * 0.05 * stop + v * v / 16), rel=1e-12)


def test_two_dry_joints_that_turn_round_in_one_step_are_exact():
    """A rail that carries another, askew: each turns where its slip is zero, however near the other turns."""
    mass, most, push = np.array([[2.5, 0.9], [0.9, 1.5]]), np.array([1.0, 0.6]), np.array([3.0, 2.5])
    model, joint = pin.Model(), 0
    for k, m, axis in ((0, 1.0, (1.0, 0.0, 0.0)), (1, 1.5, (0.6, 0.8, 0.0))):
        joint = hang(model, joint, f"rail{k}", pin.JointModelPrismaticUnaligned(np.array(axis)), lump(m, 0.01))
    both = np.linalg.solve(mass, push + most)
    for turns in ((0.1, 0.5), (0.1, 0.12), (0.2, 0.22), (0.9, 0.1), (0.5, 0.7), (0.7, 0.02)):
        begin = -0.01 * both * (1.0 + np.array(turns))
        v, left, way = begin, 0.04, -np.ones(2)
        for _ in range(3):  # to the first turn, to the second, to the end
            a = np.linalg.solve(mass, push - most * way)
            at = np.where(way < 0.0, -v / a, np.inf)
            first, span = at.argmin(), min(at.min(), left)
            v, left = v + span * a, left - span
            way[first] = 1.0
        assert left == 0.0
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_model("a", model, v=begin, friction=most)
        run = nd.simulate(scene, 0.04, 1e-2, controller=lambda t, q, v: {"a": push})
        np.testing.assert_allclose(run.v[-1], v, rtol=0.0, atol=1e-13)
        assert run.energy.friction.max() < 0.0


def test_a_dry_joint_that_a_stiff_damper_turns_round():
    """Its force changes so much within the step that what would be constant tells the reversal too late."""
    run = nd.simulate(dry_hinge(0.5), 0.02, 2e-2, controller=lambda t, q, v: {"arm": nd.PD([300.0], [30.0], [-0.1])})
    assert run.energy.friction[0] < 0.0
    assert run.v[-1, 0] == pytest.approx(-0.19101, rel=0.01)  # by steps of 1e-5 s


@pytest.mark.slow
def test_a_dry_joint_past_its_reversals_is_second_order():
    """A rod that swings against a dry hinge, turning twice, by an integration from reversal to reversal."""
    J, most = 1 / 3 + 1e-9, 0.5
    q, v, t, work, sign = 1.0, 0.0, 0.0, 0.0, -1.0
    while t < 2.0:

        def rate(_, y, sign=sign):
            return y[1], (-0.5 * g * math.sin(y[0]) - most * sign) / J, -most * abs(y[1])

        def turns(_, y):
            return y[1]

        turns.terminal, turns.direction = True, -sign
        piece = solve_ivp(rate, (t, 2.0), (q, v, work), events=turns, rtol=1e-12, atol=1e-13, first_step=1e-6)
        t, (q, _, work) = piece.t[-1], piece.y[:, -1]
        v, sign = 0.0, -sign
    exact = piece.y[:, -1]

    def run(n):
        scene = nd.Scene()
        add(scene, "a", pendulum(), q=[1.0], friction=[most])
        trajectory = nd.simulate(scene, 2.0, 2.0 / n)
        return trajectory, (trajectory.q[-1, 0], trajectory.v[-1, 0], trajectory.energy.friction.sum())

    second_order(run, exact, (100, 200, 400))


@pytest.mark.slow
def test_a_controlled_slide_that_turns_on_a_slope_is_second_order():
    """A ball on two rails, across and along a slope, with a control against its motion, in closed form."""
    mu, c, mass, speed = 0.3, 0.5, 2.0, 2.0
    rails, bodies = (pin.JointModelPX(), pin.JointModelPZ()), (pin.Inertia.Zero(), lump(mass, 0.01))
    model = limit(serial(rails, bodies, (0, 0, 0)))
    # v' = a - c v: x and v after t seconds.
    up, down = (g * (math.sin(SLOPE) + s * mu * math.cos(SLOPE)) / c for s in (1.0, -1.0))
    turn = math.log(1.0 + speed / up) / c
    top = up * turn - speed / c
    rest = 1.0 - turn
    fallen, v = down * rest - down * (1 - math.exp(-c * rest)) / c, down * (1 - math.exp(-c * rest))
    exact = np.array((top + fallen, v, -mu * mass * g * math.cos(SLOPE) * (fallen - top)))

    def run(n):
        scene, material = nd.Scene(gravity=(g * math.sin(SLOPE), 0, -g * math.cos(SLOPE))), nd.Material(mu)
        scene.add_halfspace("slope", material=material)
        ball = {"j1": [shapes.sphere(0.1)]}
        scene.add_model("a", model, collisions=ball, q=[0.0, 0.1], v=[-speed, 0.0], material=material)
        trajectory = nd.simulate(scene, 1.0, 1.0 / n, controller=lambda t, q, v: {"a": (-mass * c * v[0], 0.0)})
        return trajectory, (trajectory.q[-1, 0], trajectory.v[-1, 0], trajectory.energy.friction.sum())

    second_order(run, exact, (25, 50, 100))


def test_slips_that_do_not_depend_on_the_length_of_a_move_are_not_located(monkeypatch):
    """The slip with which dry joints of a standing robot creep ends each move reversed by 1e-9, however short it is."""
    scene, moves = nd.scenes.load("quadruped")(), []
    (name, robot), *_ = scene.articulations.items()
    scene.articulations[name] = replace(robot, friction=np.repeat((0.0, 0.5), (6, 12)))
    monkeypatch.setattr(substepping, "try_move", lambda *given: moves.append(0) or try_move(*given))
    stepper = nd.Stepper(scene, 1e-3, controller=lambda t, q, v: {name: nd.PD(100.0, 2.0, (0.0, 0.8, -1.6) * 4)})
    for _ in range(25):
        moves.clear()
        stepper.step()
        assert len(moves) <= 20  # 95 where each is cut by the same thousandth


def test_a_dry_joint_that_rests_at_its_limit_does_not_slip():
    """Two rods swing bent by 0.5 rad, as one body: its slip of O(dt²) was sought for reversals, in up to 17 moves."""
    bend, speed, model = 0.5, -4.0, pendulum(2)
    model.lowerPositionLimit, model.upperPositionLimit = np.array((-9.0, bend)), np.array((9.0, 9.0))
    inertia = 1 / 3 + 1 / 12 + 1.25 + math.cos(bend)

    def fall(t, y):
        return y[1], -g * (1.5 * math.sin(y[0]) + 0.5 * math.sin(y[0] + bend)) / inertia

    exact = solve_ivp(fall, (0.0, 0.3), (1.0, speed), rtol=1e-12, atol=1e-12).y[:, -1]
    scene, errors = nd.Scene(), []
    add(scene, "a", model, q=(1.0, bend), v=(speed, 0.0), friction=(0.0, 0.3))
    for n in (30, 60, 120):
        stepper = nd.Stepper(scene, 0.3 / n)
        steps = [stepper.step() for _ in range(n)]
        assert all(step.pieces is None for step in steps[1:])
        assert all(step.joints[1, 1] > 0.0 for step in steps[1:])
        assert max(abs(step.ledger.normal) for step in steps[1:]) == 0.0  # what it works is an error of the motion
        errors.append(np.abs((steps[-1].q[0] - exact[0], steps[-1].v[0] - exact[1])))
    assert (np.array(errors[:-1]) >= 3.5 * np.array(errors[1:])).all(), errors


def test_slips_of_round_off_are_not_located():
    """A woodpecker that hangs still by dry joints and contacts: of its slips of 1e-14 rad/s up to 22 were located."""
    scene = nd.scenes.load("woodpecker")()
    ((name, toy),) = scene.articulations.items()
    scene.articulations[name] = replace(toy, friction=np.full(toy.model.nv, 0.2 * toy.model.inertias[-1].mass))
    stepper = nd.Stepper(scene, 2e-3)
    steps = [stepper.step() for _ in range(80)]
    assert np.abs(steps[20].v).max() <= 1e-12
    assert all(step.pieces is None for step in steps[20:])


@pytest.mark.parametrize("tilt", [0.0, 0.8])
def test_a_link_that_a_wall_jams_does_not_slip(tilt):
    """The upper of two rods leans on a wall, which leaves its one joint no way; the lower one swings about its end.

    Normal and slip of the contact are one motion: its slip was that of its gaps, of O(dt²), with up to 12 reversals.
    """
    lean, speed, model = -0.3, 8.0, pendulum(2)
    tip, normal = np.array((-math.sin(lean), 0, -math.cos(lean))), np.array((math.cos(tilt), 0, math.sin(tilt)))
    scene, material = nd.Scene(), nd.Material(0.5)
    scene.add_halfspace("wall", normal=tuple(normal), offset=float(normal @ tip) - 0.1, material=material)
    ball = {"j0": [(shapes.sphere(0.1), pin.SE3(np.eye(3), np.array((0, 0, -1.0))))]}
    add(scene, "a", model, q=(lean, -lean), v=(0.0, speed), collisions=ball, material=material)
    swing = solve_ivp(lambda t, y: (y[1], -1.5 * g * math.sin(y[0])), (0, 0.4), (0, speed), rtol=1e-12, atol=1e-12)

    errors = []
    for n in (40, 80, 160):
        stepper = nd.Stepper(scene, 0.4 / n)
        steps = [stepper.step() for _ in range(n)]
        assert all(step.pieces is None and step.contact_status.tolist() == [1] for step in steps)
        errors.append(np.abs((steps[-1].q.sum() - swing.y[0, -1], steps[-1].v[1] - swing.y[1, -1])))
    assert (np.array(errors[:-1]) >= 3.5 * np.array(errors[1:])).all(), errors
