"""Mechanisms and robots of `models`: what the literature and mechanics say of them."""

import importlib.metadata
import sys
import tracemalloc

import numpy as np
import pinocchio as pin
import pytest

import nsdyn as nd
from nsdyn.scene.shapes import SPHERE


def run(name, duration, dt, parameters=None, **control):
    """(scene, list of steps) of a named scene under its own controller."""
    module = nd.scenes.module(name)
    scene = module.scene(**(parameters or {}))
    make = getattr(module, "controller", None)
    stepper = nd.Stepper(scene, dt=dt, controller=make(scene, **control) if make else None)
    return scene, [stepper.step() for _ in range(round(duration / dt))]


# -- cart and pole ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_cart_rebounds_from_its_stops():
    """Against both ends in 2 s, without passing them; the impulse acts on the cart, the pole swings on through it."""
    e, h = 0.5, 1e-3
    _, steps = run("cart_pole", 2.0, h, {"restitution": e})
    x, speed = np.array([[s.q[0], s.v[0]] for s in steps]).T
    stop = 0.3
    # The bar of positions; joint limits are projected.
    assert np.abs(x).max() <= stop + 1e-9
    hits = [k for k, s in enumerate(steps) if abs(s.joint_impulse[0]) > 1e-6 and abs(speed[k - 1]) > 0.05]
    assert {np.sign(x[k]) for k in hits} == {-1.0, 1.0}
    for k in hits:
        # Newton's law where the stop is; before and after it the pole moves the cart as in the steps beside.
        before, after = (speed[k - 1] - speed[k - 2]) / h, (speed[k + 1] - speed[k]) / h
        until = (np.copysign(stop, x[k]) - x[k - 1]) / speed[k - 1]
        struck = speed[k - 1] + until * before
        assert speed[k] == pytest.approx(-e * struck + (h - until) * after, abs=2e-5)  # h² of some 10 m/s³
        assert steps[k].joint_impulse[1] == 0.0
    total = np.array([s.energy["kinetic"] + s.energy["potential"] for s in steps])
    free = np.array([abs(s.joint_impulse[0]) == 0.0 for s in steps])[1:]
    # Between the stops nothing takes energy, of 3 J.
    assert np.abs(np.diff(total)[free]).max() <= 1e-11
    assert (np.diff(total)[~free] <= 1e-12).all()


# -- slider-crank ----------------------------------------------------------------------------------------------


def block_in_its_guide(scene, q):
    """How deep a corner of the block is in a wall, m."""
    a = scene.articulations["mechanism"]
    (block,), data = a.links, a.model.createData()
    pin.forwardKinematics(a.model, data, q)
    pose = data.oMi[block.joint] * block.placement
    return np.abs(block.shape.vertices @ pose.rotation[2] + pose.translation[2]).max() - 0.026


@pytest.mark.slow
@pytest.mark.case(32)
@pytest.mark.parametrize("finest", [None, 5e-6, 1.25e-6])
def test_slider_crank_converges_and_stays_in_its_guide(finest):
    """First order in the step through knocks and slides at both walls, three quarters of a turn; no penetration."""
    path, walls, depth = {}, set(), {}
    steps_taken = (4e-5, 1e-5, finest) if finest else (4e-5, 1e-5)
    for dt in steps_taken:
        scene, steps = run("slider_crank", 0.03, dt)
        depth[dt] = max(block_in_its_guide(scene, s.q) for s in steps)
        assert -min(s.gap.min(initial=0.0) for s in steps) <= 1e-8
        assert (np.array([s.solution.error for s in steps]) <= 1e-8).all()
        path[dt] = np.array([s.q for s in steps])[round(4e-5 / dt) - 1 :: round(4e-5 / dt)]
        names = [g.name for g in scene.geoms()]
        walls |= {names[g] for s in steps for g, r in zip(s.contacts.geom1, s.r[:, 0], strict=True) if r > 0}
    assert walls == {"upper", "lower"}
    # The bar is met from a step of 2e-5 on; one projection of a block turning at 150 rad/s leaves more at 4e-5.
    assert depth[4e-5] <= 2e-8 and depth[1e-5] <= 1e-8 and depth[dt] <= (1e-8 if dt > 2e-6 else 1e-9)
    # Impacts are up to a step late: 225 rad/s while one is missing, some 10 rad/s of change on the mean.
    errors = [np.abs(path[coarse] - path[dt]).max(axis=1) for coarse in steps_taken[:-1]]
    for coarse, error in zip(steps_taken, errors, strict=False):
        assert error.max() <= 225 * coarse and error.mean() <= 12 * coarse
    assert errors[-1].mean() <= 0.4 * errors[0].mean() or not finest


# -- woodpecker ------------------------------------------------------------------------------------------------


def pecks(dt, duration):
    """States (time, height, angles, speed, spins) at which the bird swings up through the horizontal."""
    out, before = [], None
    for s in run("woodpecker", duration, dt)[1]:
        state, angle = np.r_[s.t, s.q, s.v], s.q[1] + s.q[2]
        if before is not None and before[1] < 0.0 <= angle:
            share = before[1] / (before[1] - angle)
            out.append(before[0] + share * (state - before[0]))
        before = state, angle
    return np.array(out)


@pytest.mark.slow
@pytest.mark.case(33)
def test_woodpecker_pecks_periodically():
    """Each period it jams below, flies up, pecks the pole and falls a little: always the same."""
    found = pecks(2e-4, 0.85)[1:]  # it does not start on the cycle
    period, fall, spin = np.diff(found[:, 0]), -np.diff(found[:, 1]), found[:, 5] + found[:, 6]
    assert len(period) >= 4
    # Impacts fall anywhere in a step of 0.2 ms; means of 131.4 ms and 14.9 mm are those of a step of 0.05 ms.
    assert np.ptp(period) <= 3e-3 and period.mean() == pytest.approx(0.1314, abs=5e-4)
    assert np.ptp(fall) <= 2e-3 and fall.mean() == pytest.approx(0.0149, abs=2.5e-4)
    assert np.ptp(spin) <= 0.1


@pytest.mark.case(33)
@pytest.mark.slow
def test_woodpecker_return_map_converges():
    """One and two returns from one state converge at first order, and periods scatter less with the step."""
    found = {dt: pecks(dt, 0.45) for dt in (4e-4, 1e-4, 2.5e-5, 6.25e-6)}
    # Time and height of the second and third peck; a quarter of the step, half of the error at the very most.
    errors = [np.abs(found[dt][1:3, :2] - found[6.25e-6][1:3, :2]) for dt in (4e-4, 1e-4, 2.5e-5)]
    assert (errors[1] <= 0.5 * errors[0]).all() and (errors[2] <= 0.5 * errors[1]).all()
    scatter = [np.ptp(np.diff(pecks(dt, 1.2)[2:, 0])) for dt in (4e-4, 2.5e-5)]
    assert scatter[1] <= 0.5 * scatter[0]


# -- gripper ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gripping():
    """Steps of 6 s, of which the box is lifted in the first two."""
    return run("gripper", 6.0, 5e-3)[1]


def test_gripper_lifts_and_holds(gripping):
    """The box is 0.2 m up but for the lift's own sag, between fingers that press with 20 N each."""
    steps = gripping[:600]
    box, lift = steps[-1].q[:3], steps[-1].q[7]
    assert box[2] - 0.03 == pytest.approx(lift, abs=1e-9), "no slip while it is lifted"
    # (1.4 + 0.5) kg on 2e4 N/m.
    assert lift == pytest.approx(0.2 - 1.9 * 9.81 / 2e4, abs=1e-6)
    c = steps[-1].contacts
    grip = steps[-1].r[np.abs(c.normal[:, 0]) > 0.9, 0] / 5e-3
    assert grip.sum() == pytest.approx(40.0, rel=1e-6)


@pytest.mark.parametrize("seconds", [pytest.param(4, id="4 s"), pytest.param(60, id="60 s", marks=pytest.mark.slow)])
def test_gripper_does_not_slip(seconds, gripping):
    steps = gripping if seconds == 4 else run("gripper", 2.0 + seconds, 5e-3)[1]
    held = np.array([np.r_[s.q[:3], s.q[3:7], s.q[7:]] for s in steps[400:]])
    slip = held[:, 2] - held[:, 7]
    # The bar: exact stiction creeps by the solver's residual only.
    assert np.ptp(slip) <= 1e-9
    assert np.ptp(held[:, 3:7], axis=0).max() <= 1e-9, "nor does it turn"


@pytest.mark.slow
def test_gripper_drops_what_is_too_heavy():
    """Two fingers of 20 N carry 2 mu 20 N = 24 N: 2 kg, not 3 kg."""
    end = {mass: run("gripper", 2.0, 5e-3, {"mass": mass})[1][-1].q[2] - 0.03 for mass in (2.0, 3.0)}
    assert end[2.0] > 0.19 and abs(end[3.0]) < 1e-6


# -- quadruped -------------------------------------------------------------------------------------------------


def feet(scene, step):
    """Centres of the feet, shape (robots, 4, 3), m."""
    out, start = [], 0
    for a in scene.articulations.values():
        data = a.model.createData()
        pin.forwardKinematics(a.model, data, step.q[start : start + a.model.nq])
        spheres = [link for link in a.links if link.shape.kind == SPHERE]
        out.append([(data.oMi[f.joint] * f.placement).translation for f in spheres])
        start += a.model.nq
    return np.array(out)


@pytest.mark.slow
def test_quadruped_stands_without_slip():
    scene, steps = run("quadruped", 10.0, 5e-3, walk=False)
    # The bar: the path of the points of contact on the ground over all 10 s, settling included.
    slip = sum(5e-3 * np.hypot(s.u[:, 1], s.u[:, 2]).max(initial=0.0) for s in steps)
    assert slip <= 1e-9
    # The feet roll by what the joints give way; once at rest nothing moves.
    assert np.abs(feet(scene, steps[-1]) - feet(scene, steps[999])).max() <= 1e-9
    assert np.abs(steps[-1].v).max() <= 1e-12
    weight = sum(s.r[:, 0].sum() for s in steps[-10:]) / (10 * 5e-3)
    # Coriolis terms are those of the motion without contacts, the fall of half a step: O(h²) of the weight at rest.
    assert weight == pytest.approx(10.4 * 9.81, rel=2e-4)
    assert steps[-1].contacts.gap.size == 4


@pytest.mark.slow
def test_quadruped_walks_in_place():
    """Every foot leaves the ground and lands in every period, and the trunk stays up and level."""
    scene, steps = run("quadruped", 3.0, 5e-3)
    height = np.array([feet(scene, s)[0, :, 2] for s in steps[200:]]) - 0.02
    assert (height.max(axis=0) > 0.02).all()
    # Feet that land are where they should be at the end of that step.
    assert height.min() >= -1e-8
    lifted = height > 0.005
    assert (np.diff(lifted.astype(int), axis=0) == 1).sum(axis=0).min() >= 3
    trunk = np.array([s.q[:7] for s in steps])
    assert np.abs(trunk[:, 2] - trunk[0, 2]).max() < 0.02 and np.abs(trunk[:, 3:6]).max() < 0.05
    assert np.abs(trunk[:, :2]).max() < 0.06


def test_robots_side_by_side_move_alike():
    """Four robots do what one does: trees do not disturb each other."""
    _, one = run("quadruped", 0.3, 5e-3, walk=False)
    _, four = run("quadruped", 0.3, 5e-3, {"count": 4}, walk=False)
    assert four[-1].q.size == 4 * one[-1].q.size
    for k in range(4):
        apart = four[-1].q[19 * k : 19 * k + 19] - one[-1].q
        apart[1] -= k
        assert np.abs(apart).max() <= 1e-9, "to the tolerance of the solver"


def test_robot_of_the_extra():
    try:
        importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("the extra 'robots' is not installed")
    with pytest.warns(UserWarning, match="'solo12' leaves out"):
        scene, steps = run("quadruped", 1.0, 5e-3, {"robot": "solo12"}, walk=False)
    assert scene.articulations["solo12"].model.nv == 18
    assert steps[-1].q[2] == pytest.approx(steps[0].q[2], abs=0.01), "it stands"


def test_unknown_robot_is_named():
    with pytest.raises(ValueError, match=r"robot must be one of quadruped, solo12; got 'cat'"):
        nd.scenes.load("quadruped")(robot="cat")


def cost(count):
    """Calls in a step of so many robots that stand, and the bytes that it takes at most."""
    module, calls = nd.scenes.module("quadruped"), 0
    scene = module.scene(count=count)
    stepper = nd.Stepper(scene, dt=5e-3, controller=module.controller(scene, walk=False))
    for _ in range(40):  # they have landed
        stepper.step()

    def count_call(frame, event, argument):
        nonlocal calls
        calls += event in ("call", "c_call")

    tracemalloc.start()
    sys.setprofile(count_call)
    stepper.step()
    sys.setprofile(None)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return calls, most


@pytest.mark.slow
def test_cost_is_linear_in_the_robots():
    """Twice the robots take twice the calls and the memory of a step, but for the sizes of buffers that grow."""
    assert (np.array(cost(16)) <= 2.3 * np.array(cost(8))).all()
