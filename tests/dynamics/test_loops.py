"""Closed loops: hyperstatic ones, singular configurations, energy, contacts on them."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, bricard, four_bars, hang, limit, lump, pendulum, rod, serial

import nsdyn as nd
from nsdyn.dynamics import sliding
from nsdyn.dynamics.loops import Closures, admissible
from nsdyn.dynamics.trees import Tree
from nsdyn.scene import shapes
from nsdyn.scene.articulations import Loop


def follow(scene, duration, dt):
    """(step, largest gap of the loops, energies) of a scene with one articulation."""
    (a,) = scene.articulations.values()
    closures, stepper = Closures(a.model, a.loops), nd.Stepper(scene, dt)
    gap, energy, q = 0.0, [], []
    for _ in range(round(duration / dt)):
        step = stepper.step()
        gap = max(gap, np.abs(closures.at(step.q)[0]).max())
        energy.append((step.energy["kinetic"], step.energy["potential"], step.energy["defect"]))
        q.append(step.q)
    start = sum(nd.Stepper(scene, dt).start().energy.values())
    kinetic, potential, defect = np.array(energy).T
    assert np.abs(defect).max() <= 1e-12 * kinetic.max()  # the bar of the ledger
    return np.array(q), gap, np.abs(kinetic + potential - start).max()


@pytest.mark.slow
@pytest.mark.case(31)
@pytest.mark.parametrize("duration", [2.5, 10.0])
def test_bricard_moves_and_keeps_its_energy(duration):
    """Six rows of rank five leave the one degree of freedom; the energy drifts by 1e-5 of 29 J."""
    model, loops = bricard()
    scene = nd.Scene(gravity=(0, -9.81, 0))
    add(scene, "bricard", model, loops=loops)
    q, gap, drift = follow(scene, duration, 2e-3)
    assert gap <= 1e-9 and np.ptp(q[:, 0]) > 3.0
    assert drift <= 2e-5  # 9.4e-6 at this step, falling with h²


@pytest.mark.slow
@pytest.mark.case(31)
@pytest.mark.parametrize("windows", [1, 2])
@pytest.mark.parametrize(("duration", "turns"), [(4.0, 1), (10.0, 4)])
def test_four_bars_pass_their_singular_configurations(windows, duration, turns):
    """Rods turn all the way and lie flat twice a turn, where the loop loses rank; they stay parallel."""
    model, loops, v = four_bars(windows)
    scene = nd.Scene()
    add(scene, "bars", model, v=v, loops=loops)
    q, gap, drift = follow(scene, duration, 2e-3)
    assert gap <= 1e-9 and q[-1, 0] > 2 * np.pi * turns
    np.testing.assert_allclose(q[:, 1], -q[:, 0], rtol=0, atol=1e-5)
    assert drift <= 5e-4  # 1.6e-4 and 2.7e-4 of 39 J and more at this step, falling with h²


@pytest.mark.slow
def test_four_bar_is_second_order():
    """Against the pendulum it is: two rods of inertia 1/3 each and a bar that moves as their tips."""
    model, loops, v = four_bars(1)

    def end(dt):
        scene = nd.Scene()
        add(scene, "bars", model, v=v, loops=loops)
        return nd.simulate(scene, 1.0, dt).q[-1, 0]

    def pendulum_of_one_coordinate():
        from scipy.integrate import solve_ivp

        inertia, torque = 2.0 / 3.0 + 1.0, 9.81 * (2 * 0.5 + 1.0)
        rate = lambda t, y: (y[1], torque * np.sin(y[0]) / inertia)  # noqa: E731
        return solve_ivp(rate, (0, 1), (0.0, 1.0), rtol=1e-12, atol=1e-12).y[0, -1]

    exact = pendulum_of_one_coordinate()
    errors = [abs(end(dt) - exact) for dt in (4e-3, 2e-3)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_admissible_velocities_of_redundant_rows(rng):
    """B Z = 0, Zᵀ M Z = I and B P b = b on the range of B, whatever the rank and the units of the rows."""
    A = rng.normal(size=(6, 6))
    M = A @ A.T + np.eye(6)
    F = np.linalg.inv(np.linalg.cholesky(M))
    B = rng.normal(size=(3, 6))
    B = np.concatenate((B, B[:2] * 1e3, B[:1] + B[1:2]))  # rank 3
    Z, P = admissible(B, F)
    assert Z.shape == (6, 3)
    np.testing.assert_allclose(B @ Z, 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(Z.T @ M @ Z, np.eye(3), rtol=0, atol=1e-12)
    b = B @ rng.normal(size=6)
    np.testing.assert_allclose(B @ P @ b, b, rtol=1e-10)
    np.testing.assert_allclose(Z.T @ M @ P @ b, 0.0, rtol=0, atol=1e-11)


def floating_rods(count):
    """Rods of 1 m and 1 kg that hang from each other on hinges about y, of which the first floats."""
    joints = pin.JointModelFreeFlyer(), *[pin.JointModelRY()] * (count - 1)
    return limit(serial(joints, rod((0, 0, -1)), (0, 0, -1)))


@pytest.mark.parametrize("tilt", [0.0, 1e-15, 1e-13, 1e-11, 1e-9])
def test_a_planar_loop_that_floats_turns_out_of_its_plane(tilt):
    """A triangle of rods is one body; across its plane its rows are round-off, or all but a copy of the others."""
    model, scene = floating_rods(3), nd.Scene(gravity=(0, 0, 0))
    third = 2 * np.pi / 3
    q = (0, 0, 0, tilt, 3 * tilt, -2 * tilt, 1, third, third)
    add(scene, "truss", model, q=q, loops=[Loop("knee", 1, at((0, 0, 0)), 3, at((0, 0, -1)))])
    step = nd.Stepper(scene, 1e-3, external_force=lambda t, q, v: {"truss/j0": ((0, 0, 0), (1, 0, 2))}).step()
    data = model.createData()
    body = pin.ccrba(model, data, step.q, step.v) is not None and data.Ig.inertia
    # Neither the turn of the step nor the tilt changes more than 1e-6 of the velocity.
    np.testing.assert_allclose(step.v[3:6], 1e-3 * np.linalg.solve(body, (1.0, 0, 2.0)), rtol=0, atol=1e-7)


def test_a_loop_that_floats_knows_nothing_of_the_axes_of_the_world():
    """Four rods that fold and tumble, their plane 1e-3 rad from that of two axes, move as they do turned anyhow."""
    model = floating_rods(4)

    def velocity(turn):
        scene = nd.Scene(gravity=(0, 0, 0))
        q = (0, 0, 0, *(turn * pin.Quaternion(pin.exp3(np.array((1e-3, 0, 0))))).coeffs(), 1.0, 2.0, 1.2)
        scene.add_model("rods", model, q=q, v=(0, 0, 0, 2, 3, 1, 5, -5, 5))
        scene.add_loop("rods", "last", "j3", "j0", position=(0, 0, -1))
        return nd.Stepper(scene, 1e-2).step().v

    turned = velocity(pin.Quaternion(np.array((0.5, -0.5, 0.1, 0.7))).normalized())
    # Round-off of 7 rad/s.
    np.testing.assert_allclose(velocity(pin.Quaternion.Identity()), turned, rtol=0, atol=1e-9)


def test_a_loop_that_floats_keeps_its_momenta():
    """Four rods that fold and tumble, in steps so long that the midpoint rule alone errs by 1e-3 in a step."""
    model = floating_rods(4)
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("rods", model, q=(0, 0, 0, 0, 0, 0, 1, 1.0, 2.0, 1.2), v=(0, 0, 0, 2, 3, 1, 5, -5, 5))
    scene.add_loop("rods", "last", "j3", "j0", position=(0, 0, -1))
    run, data = nd.simulate(scene, 0.5, 1e-2), model.createData()
    momenta = np.array([pin.computeCentroidalMomentum(model, data, *x).vector for x in zip(run.q, run.v, strict=True)])
    # Round-off of 100 motions: 1e-16 of 20 N·s and N·m·s each.
    np.testing.assert_allclose(momenta, np.broadcast_to(momenta[0], momenta.shape), rtol=0, atol=1e-12)


@pytest.mark.slow
def test_a_chain_between_two_pins_hangs_as_statics_says():
    """Three damped rods over a span of two: the outer ones come to rest at 30° from the vertical."""
    scene = nd.Scene()
    pin_at = Loop("pin", 0, at((2.0, 0, 0)), 3, at((0, 0, -1)))
    add(scene, "chain", pendulum(3), q=(-0.2, -1.2, -1.2), damping=1.0, loops=[pin_at])
    q, gap, _ = follow(scene, 10.0, 1e-2)
    assert gap <= 1e-9 and np.abs(q[0] - q[-1]).max() > 0.05
    np.testing.assert_allclose(q[-1], (-np.pi / 6, -np.pi / 3, -np.pi / 3), rtol=0, atol=1e-4)


def test_a_triangle_is_a_structure():
    """Two rods between two pins a rod apart have no motion left, and carry a ball all the same."""
    scene = nd.Scene()
    knee = {"j1": [shapes.sphere(0.1)]}
    pin_at = Loop("pin", 0, at((1.0, 0, 0)), 2, at((0, 0, -1)))
    add(scene, "truss", pendulum(2), q=(-2.6, 2.1), collisions=knee, loops=[pin_at])
    scene.add_sphere("ball", 0.1, 1.0, position=(0.5, 0, np.sqrt(0.75) + 0.2))
    trajectory = nd.simulate(scene, 0.2)
    np.testing.assert_allclose(
        trajectory.q[:, 7:], np.tile((-5 * np.pi / 6, 2 * np.pi / 3), (201, 1)), rtol=0, atol=1e-9
    )
    assert trajectory.contacts(-1).impulse[0, 0] == pytest.approx(9.81e-3, rel=1e-6)


def test_contacts_act_on_closed_loops():
    """A four-bar table, held up by a spring, carries a box: the bar stays level and the box does not slip off."""
    model, loops, _ = four_bars(1)
    scene = nd.Scene()
    table = {"h0": [(shapes.box((1.0, 0.6, 0.1)), at((0.5, 0, 0)))]}
    add(scene, "bars", model, loops=loops, collisions=table, stiffness=(400.0, 0, 0), damping=(20.0, 0, 0))
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0.5, 0, 1.15))
    trajectory = nd.simulate(scene, 2.0, 2e-3)
    energy = trajectory.energy
    assert np.abs(energy.defect).max() <= 1e-12 * np.ptp(energy.potential) + 1e-13
    contacts = trajectory.contacts(-1)
    assert len(contacts) == 4 and contacts.impulse[:, 0].sum() == pytest.approx(9.81 * 2e-3, rel=1e-3)
    assert np.abs(trajectory.contacts(-1).gap).max() <= 1e-8


@pytest.mark.slow
def test_joint_friction_holds_a_closed_loop():
    """Dry friction in one joint of three of the four-bar holds it leaning, to the last bit."""
    model, loops, _ = four_bars(1)
    scene = nd.Scene()
    a = 0.3
    # m g sin(a) of the two rods at half, the bar at full height.
    torque = 2.0 * 9.81 * np.sin(a)
    add(scene, "bars", model, q=(a, -a, a), loops=loops, friction=(torque / 0.99, 0, 0))
    trajectory = nd.simulate(scene, 1.0, 2e-3)
    assert np.abs(trajectory.q - trajectory.q[0]).max() <= 1e-12


def test_a_crank_drives_a_loop():
    """A driven four-bar turns at the crank's speed, and its work is the change of energy."""
    model, loops, _ = four_bars(1)
    scene = nd.Scene()
    add(scene, "bars", model, loops=loops, v=(2.0, -2.0, 2.0))
    scene.set_motion("bars/v0", velocity=2.0)
    trajectory = nd.simulate(scene, 1.0, 2e-3)
    np.testing.assert_allclose(trajectory.v, np.tile((2.0, -2.0, 2.0), (501, 1)), rtol=0, atol=1e-6)
    total = trajectory.energy.total
    assert trajectory.energy.constraint.sum() == pytest.approx(total[-1] - total[0], rel=1e-4)
    assert np.abs(trajectory.energy.defect).max() <= 1e-12 * np.ptp(total)


def crank(speed):
    """(tree, q, v) of a slider-crank of 0.1 m and 0.3 m without weight."""
    model = pin.Model()
    turning = hang(model, 0, "crank", pin.JointModelRY(), rod((0.1, 0, 0), 0.2))
    arm = hang(model, turning, "rod", pin.JointModelRY(), rod((0.3, 0, 0), 0.3), (0.1, 0, 0))
    slider = hang(model, 0, "slider", pin.JointModelPX(), lump(0.5, 1e-3))
    a, b = 0.5, np.arcsin(np.sin(0.5) / 3)
    slope = np.cos(a) / (3 * np.cos(b))
    q = np.array((a, -a - b, 0.1 * np.cos(a) + 0.3 * np.cos(b)))
    v = speed * np.array((1.0, -1.0 - slope, -0.1 * np.sin(a) - 0.3 * np.sin(b) * slope))
    scene = nd.Scene(gravity=(0, 0, 0))
    add(scene, "sc", limit(model), q=q, v=v, loops=[Loop("pin", arm, at((0.3, 0, 0)), slider, at((0, 0, 0)))])
    t = Tree(scene.articulations["sc"], np.zeros(3), [], {})
    return t, *t.start(scene.articulations["sc"].q, v)


def energy(t, q, v):
    return 0.5 * v @ pin.crba(t.model, t.model.createData(), q) @ v


@pytest.mark.parametrize("turn, least, most", [(0.01, 1, 1), (0.2, 1, 1), (2.5, 2, 16)])
def test_a_motion_that_does_not_settle_goes_in_pieces(turn, least, most, monkeypatch):
    """Newton's method for a crank that turns so far in a step; what it returns has settled, whatever the pieces."""
    t, q, v = crank(turn / 1e-2)
    done, given = [], sliding._midpoint

    def piece(*arguments):
        flow = given(*arguments)
        done.append(arguments[-1])
        return flow

    monkeypatch.setattr(sliding, "_midpoint", piece)
    whole = t.flow(q, v, 1e-2)
    assert least <= len(done) <= most and sum(done) == pytest.approx(1e-2, rel=1e-12)
    closures = t.closures
    assert np.abs(closures.at(whole.q)[0]).max() <= 1e-12
    monkeypatch.setattr(sliding, "SETTLED", 1e-15)
    monkeypatch.setattr(sliding, "PASSES", 30)
    end = q, v
    for h in done:
        flow = given(t._weightless, t.data, closures, *end, h)
        end = flow.q, flow.v
    np.testing.assert_allclose(whole.v, end[1], rtol=0, atol=1e-10 * np.abs(v).max())
    np.testing.assert_allclose(whole.q, end[0], rtol=0, atol=1e-10)


def test_a_fast_crank_keeps_its_energy_to_second_order():
    t, q0, v0 = crank(100.0)

    def drift(h):
        q, v = q0, v0
        for _ in range(round(0.02 / h)):
            q, v, *_ = t.flow(q, v, h)
        return abs(energy(t, q, v) / energy(t, q0, v0) - 1.0)

    drifts = [drift(h) for h in (2e-3, 1e-3, 5e-4)]
    # A fifth of a rad in a step: z²/12 of the energy that the crank and the rod exchange.
    assert drifts[0] <= 4e-3 and (np.diff(-np.log2(drifts)) >= 1.7).all()


def test_a_motion_on_loops_that_cannot_be_followed_is_named():
    t, q, v = crank(1e9)
    with pytest.raises(ArithmeticError, match=r"in 'sc' joint 'rod' moves at 1.*, too wildly to follow its loops in"):
        t.flow(q, v, 1e-2)


def test_a_start_has_velocities_that_gears_admit():
    """The closest in the kinetic metric, beside a driven joint its own; sliders turn nothing."""
    model = limit(pin.Model())
    for name, mass in (("a", 1.0), ("b", 2.0)):
        hang(model, 0, name, pin.JointModelPX(), lump(mass, 1.0))
    for driven in (False, True):
        scene = nd.Scene()
        add(scene, "a", model, v=(1.0, 0.5))
        scene.add_gear("a", "a", "b", 2.0)
        if driven:
            scene.set_motion("a/a", velocity=0.3)
        run = nd.simulate(scene, 0.02, 5e-3)
        speed = 0.3 if driven else (1.0 * 1.0 + 2.0 * 2.0 * 0.5) / (1.0 + 2.0 * 2.0**2)
        np.testing.assert_allclose(run.v, np.tile((speed, 2.0 * speed), (5, 1)), rtol=0, atol=1e-14)
        assert nd.check(run).passed and abs(run.energy.constraint.sum()) <= 1e-15


def test_driven_joints_that_open_a_gear_are_told():
    model = limit(pin.Model())
    for name in ("a", "b"):
        hang(model, 0, name, pin.JointModelRY(), rod((0, 0, -1)))
    scene = nd.Scene()
    add(scene, "wheels", model)
    scene.add_gear("wheels", "a", "b", 2.0)
    for name in ("a", "b"):
        scene.set_motion(f"wheels/{name}", velocity=1.0)
    told = r"prescribed motions contradict: in 'wheels' they open loops or gears by .* rad/s .*gear 'wheels/b'"
    with pytest.raises(ValueError, match=told):
        nd.simulate(scene, 0.1, 5e-3)


def test_loops_that_cannot_close_are_refused():
    model = limit(pin.Model())
    hang(model, 0, "j", pin.JointModelRY(), rod((0, 0, -1)))
    scene = nd.Scene()
    add(scene, "a", model, loops=[Loop("pin", 0, at((3, 0, 0)), 1, at((0, 0, -1)))])
    with pytest.raises(ValueError, match=r"loops or gears \['pin'\] do not close: they are apart by 2"):
        nd.Stepper(scene)


def test_joints_that_closing_moves_beyond_their_limits_are_refused():
    """What a gear moves by less than a thousandth beyond a limit is rounding of the user's numbers."""
    model = pin.Model()
    for name in ("a", "b"):
        hang(model, 0, name, pin.JointModelRY(), rod((0, 0, -1)))
    limit(model, -1.0, 0.55)
    starts = []
    for q in ((0.278, 0.549), (0.5, 0.5)):
        scene = nd.Scene()
        add(scene, "w", model, q=q)
        scene.add_gear("w", "a", "b", 2.0, 0.0)
        starts.append(scene)
    assert nd.Stepper(starts[0]).start().q[1] == pytest.approx(0.5504, abs=1e-12)
    told = "joint 'w/b' is at 0.6 when loops and gears are closed, its limits are -1 and 0.55"
    with pytest.raises(ValueError, match=told):
        nd.Stepper(starts[1])


def test_a_linkage_far_from_the_origin_moves_as_at_it():
    """There its loop is closed but for the round-off of 1e5 m, 1e-11 m."""
    turns = []
    for base in (np.zeros(3), np.array((7e4, -8e4, 3e4))):
        model, joint, place = limit(pin.Model()), 0, base
        for name, end in (("crank", (0, 0, 0.5)), ("coupler", (1.1, 0, 0.2)), ("rocker", (0.1, 0, -0.7))):
            joint = hang(model, joint, name, pin.JointModelRY(), rod(end), place)
            place = end
        scene = nd.Scene()
        foot = Loop("foot", 0, at(base + np.array((1.2, 0, 0))), joint, at(end))
        add(scene, "bars", limit(model), v=(3.0, 0.0, 0.0), loops=[foot])
        turns.append(nd.simulate(scene, 0.2, 5e-3).q)
    np.testing.assert_allclose(turns[1], turns[0], rtol=0, atol=1e-9)


def test_wheels_that_have_turned_far_keep_their_gear():
    """After 1e4 rad the gear is known to 4e-12 rad."""
    model = limit(pin.Model())
    for name in ("motor", "wheel"):
        hang(model, 0, name, pin.JointModelRY(), rod((0, 0, -1)))
    scene = nd.Scene()
    add(scene, "wheels", model, q=(1e4, 2.7e4), v=(300.0, 810.0))
    scene.add_gear("wheels", "motor", "wheel", 2.7)
    run = nd.simulate(scene, 0.1, 5e-3)
    np.testing.assert_allclose(run.q @ (2.7, -1.0), 0.0, rtol=0, atol=1e-10)
