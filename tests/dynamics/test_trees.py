"""The motion of one articulated tree between contacts: what it keeps, its orders, rest, and values that stay."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, bricard, four_bars, hang, limit, lump, pendulum, rod, serial

import nsdyn as nd
from nsdyn._kernels import reductions
from nsdyn._kernels.dynamics import links as kernels
from nsdyn.dynamics.actuators import Actuators
from nsdyn.dynamics.runge_kutta import runge_kutta
from nsdyn.dynamics.trees import Tree
from nsdyn.scene.control import Axes
from nsdyn.scene.shapes import box, capsule, sphere
from nsdyn.tools.displacements import displacement

JOINTS = [pin.JointModelRX(), pin.JointModelSpherical(), pin.JointModelRUBZ(), pin.JointModelPY()]


def robot():
    """A floating body with four joints in a row, and its scalar coordinates."""
    model = pin.Model()
    joint = hang(model, 0, "root", pin.JointModelFreeFlyer(), lump(5.0, (0.1, 0.2, 0.25), (0.02, 0, 0.01)))
    for k, kind in enumerate(JOINTS):
        turned = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.1 * k, 0.2), np.array((0.2, 0.1, -0.1 * k)))
        inertia = pin.Inertia(1.0, np.array((0.1, 0.05, -0.2)), np.diag((0.02, 0.03, 0.04)))
        joint = hang(model, joint, f"j{k}", kind, inertia, turned)
    scalar = np.zeros(model.nv)
    scalar[[j.idx_v for j in model.joints if j.nv == 1]] = 1.0
    return model, scalar


def tree(model, gravity=(0, 0, -9.81), **keywords):
    """The tree of a model whose joints all carry a small sphere."""
    scene = nd.Scene(gravity=gravity)
    add(scene, "a", model, **keywords)
    a = scene.articulations["a"]
    return Tree(a, np.array(scene.gravity), list(range(1, a.model.njoints)), {})


def controlled(t, given):
    """What a controller of one tree gives, as the tree takes it."""
    if given is None:
        return None
    nv = t.model.nv
    return Actuators(Axes.of("a", t.model, t.scalar), np.full(nv, np.inf), [slice(0, nv)]).controls(given)[0]


def momentum(model, q, v):
    """Linear momentum, and angular momentum about the centre of mass, shape (6,)."""
    return pin.computeCentroidalMomentum(model, model.createData(), q, v).vector


def follow(t, q, v, h, steps, control=None, impulse=None, theta=0.5):
    """(q, v, works) of steps in which rows give the impulse h f(q, t) at the middle, every joint force `control`."""
    works = []
    for k in range(steps):
        half = t.halfway(q, v, h, theta)
        free = t.free_motion(half, (k + 1) * h, controlled(t, control), None)
        p = np.zeros(v.size) if impulse is None else h * impulse(half)
        v1 = free.v + free.minv @ p
        end = t.end(half, free, v1, bool(p.any()))
        works.append(t.works(half, free, v1, end, (end.q, end.v), p, t.energies(q, v), np.zeros((6, v.size)))[0])
        q, v = end.q, end.v
    return q, v, works


@pytest.mark.parametrize(
    "what", ["free", "control", *(pytest.param(k, marks=pytest.mark.slow) for k in ("springs", "stiff"))]
)
def test_floating_robot_keeps_its_momentum(what, rng):
    model, scalar = robot()
    v = 3.0 * rng.normal(size=model.nv)
    joints = {"stiffness": 20.0 * scalar, "damping": 0.3 * scalar} if what == "springs" else {}
    t = tree(model, (0, 0, 0), **joints)
    gain = 1e5 if what == "stiff" else 30.0
    control = None if what == "free" else nd.PD(kp=gain * scalar, kd=0.03 * gain * scalar, target=0.1 * scalar)
    q, start = pin.neutral(model), momentum(model, pin.neutral(model), v)
    for _ in range(20):
        q, v, _ = follow(t, q, v, 1e-3, 50, control)
        change = np.abs(momentum(model, q, v) - start)
        # Round-off of 2000 motions.
        assert change[:3].max() <= 1e-11 * np.linalg.norm(start[:3])
        assert change[3:].max() <= 1e-11 * np.linalg.norm(start[3:])


def test_pushed_robot_keeps_the_angular_momentum_it_is_given(rng):
    """Impulses on the joints alone: momentum as on a free motion, though the motion is of second order."""
    model, scalar = robot()
    v, q = 3.0 * rng.normal(size=model.nv), pin.neutral(model)
    start = momentum(model, q, v)
    q, v, _ = follow(tree(model, (0, 0, 0)), q, v, 1e-3, 1000, impulse=lambda half: scalar)
    change = np.abs(momentum(model, q, v) - start)
    assert change.max() <= 1e-11 * np.linalg.norm(start)  # round-off of 2000 motions


def orders(error, steps):
    return np.diff(-np.log2([error(h) for h in steps]))


@pytest.mark.parametrize("joints", ["pendulum", pytest.param("robot", marks=pytest.mark.slow)])
def test_free_motion_is_of_fourth_order(joints):
    """Energy and place of a free motion under constant joint forces; what it gains is the ledger's integration."""
    if joints == "pendulum":
        model, q, v, tau = pendulum(2), np.array((1.5, 1.0)), np.zeros(2), np.array((1.0, -2.0))
    else:
        model, scalar = robot()
        q, v, tau = pin.neutral(model), np.linspace(-1, 1.5, model.nv), 0.1 * scalar
    t, time = tree(model), 0.32

    def errors(h):
        end, _, works = follow(t, q, v, h, round(time / h), tau)
        # Their parts cancel to some degree; the largest shows the order of a step.
        return np.abs(pin.difference(model, fine, end)).max(), max(abs(w.integration) for w in works)

    fine = follow(t, q, v, 2.5e-4, 1280, tau)[0]
    # Steps so short that they are one part each; longer ones go in parts, and err by no more.
    place, energy = np.diff(-np.log2([errors(h) for h in (8e-3, 4e-3, 2e-3)]), axis=0).T
    assert (place >= 3.7).all() and (energy >= 4.6).all()
    for h in (2e-2, 8e-2):
        place, energy = errors(h)
        # Some fifty parts err by 1e-10 rad / h, up to 5e-9 rad/s each, for a third of a second.
        assert place <= 1e-7 and energy <= 3e-7  # of 30 J


def test_pushed_motion_is_of_second_order():
    """A follower force on the tip by impulses of rows, against the same by joint forces in a fine free motion."""
    model = pendulum(2)
    q, v, t = np.array((2.5, 1.0)), np.array((3.0, -5.0)), tree(model)
    push = np.array((4.0, -3.0))
    exact = follow(t, q, v, 6.25e-4, 1024, push)[0]
    steps = (1e-2, 5e-3, 2.5e-3)

    def pushed(h):
        return follow(t, q, v, h, round(0.64 / h), impulse=lambda half: push)

    np.testing.assert_allclose(orders(lambda h: np.abs(pushed(h)[0] - exact).max(), steps), 2.0, rtol=0, atol=0.1)
    errors = [sum(abs(w.integration) for w in pushed(h)[2]) for h in steps]
    np.testing.assert_allclose(np.diff(-np.log2(errors)), 2.0, rtol=0, atol=0.2)


@pytest.mark.parametrize("mechanism", [pytest.param("bricard", marks=pytest.mark.slow), "four bars"])
def test_closed_loops_are_of_second_order(mechanism):
    model, loops, v = (*bricard(), np.zeros(6)) if mechanism == "bricard" else four_bars(1)
    gravity = (0, -9.81, 0) if mechanism == "bricard" else (0, 0, -9.81)
    scene = nd.Scene(gravity=gravity)
    add(scene, "a", model, v=v, loops=loops)
    t = Tree(scene.articulations["a"], np.array(gravity), [], {})
    q, v = t.start(scene.articulations["a"].q, scene.articulations["a"].v)
    ends = [follow(t, q, v, h, round(0.32 / h))[:2] for h in (8e-3, 4e-3, 2e-3)]
    drifts = [abs(sum(t.energies(*end)) - sum(t.energies(q, v))) for end in ends]
    assert (np.diff(-np.log2(drifts)) >= 1.8).all()


def test_a_tree_at_rest_does_not_move(rng):
    """Joint forces that carry it, impulses that do: to round-off of the velocity, and exactly where that is 0."""
    t = tree(pendulum(3))
    q, v = rng.normal(size=3), np.zeros(3)
    half = t.halfway(q, v, 1e-2, 0.5)
    assert half.q is q and half.v is v
    weight = pin.computeGeneralizedGravity(t.model, t.model.createData(), q)
    held = t.free_motion(half, 0.0, controlled(t, weight), None)
    assert not held.v.any()
    end = t.end(half, held, held.v, False)
    assert end.q is q and not end.v.any()
    # The same by rows, in one step and in many.
    q1, v1, works = follow(t, q, v, 1e-2, 1000, impulse=lambda half: half and weight)
    assert np.abs(q1 - q).max() <= 1e-12 and np.abs(v1).max() <= 1e-12
    assert max(abs(w.integration) for w in works) <= 1e-13  # of 30 J


@pytest.mark.parametrize("speed", [1e-10, 1e-8, 1e-6, 1e-4])
def test_what_hardly_moves_is_as_exact_as_what_moves(speed, rng):
    """With none, two or four stages: to the tolerance of its velocity, and at the end of many steps too."""
    model, _ = robot()
    t, q, h = tree(model), pin.neutral(model), 1e-2
    v = rng.normal(size=model.nv)
    v *= speed / (h * np.abs(v).max())
    weightless = model.copy()
    weightless.gravity = pin.Motion.Zero()
    data = weightless.createData()
    fine = q, v

    def rate(q, v):
        return pin.aba(weightless, data, q, v, 0 * v), 0.0

    for _ in range(64):
        step, _ = runge_kutta(weightless, rate, *fine, rate(*fine), h / 64, h)
        fine = step.q, step.v
    end = t.flow(q, v, h)
    assert np.abs(end.v - fine[1]).max() <= 2e-10 * np.abs(v).max()
    assert np.abs(pin.difference(model, end.q, fine[0])).max() <= 2e-10 * speed + 1e-15


def parts(monkeypatch):
    """The parts of all motions from now on: how long they are."""
    seen = []

    def part(*arguments):
        seen.append(arguments[-2])
        return runge_kutta(*arguments)

    monkeypatch.setattr("nsdyn.dynamics.runge_kutta.runge_kutta", part)
    return seen


def test_tame_trees_move_in_one_part(monkeypatch):
    """An arm of three that falls at 2 ms: a half motion and a whole one, as one that rests has none."""
    t, seen = tree(pendulum(3)), parts(monkeypatch)
    follow(t, np.array((0.8, 0.2, -0.4)), np.zeros(3), 2e-3, 500)
    assert len(seen) <= 2 * 500
    seen.clear()
    q, v = np.array((0.8, 0.2, -0.4)), np.zeros(3)
    follow(t, q, v, 2e-3, 10, pin.computeGeneralizedGravity(t.model, t.model.createData(), q))
    assert not seen


def payload(links, load, driven):
    """An arm of links of 1 kg and half a metre with a load at its end, perhaps beside a driven joint."""
    bodies = [lump(mass, mass / 48, (0, 0, -0.25)) for mass in [1.0] * (links - 1) + [load]]
    model = serial([pin.JointModelRY()] * links, bodies, (0, 0, -0.5))
    q = [0.5, 0.2, -0.3, 0.25, -0.1, 0.3][:links]
    scene = nd.Scene()
    if driven:
        hang(model, 0, "beside", pin.JointModelPX(), lump(1.0, 1.0))
    scene.add_model("a", model, q=q + driven * [0.0], limits=False)
    if driven:
        scene.set_motion("a/beside", 0.3)
    return scene


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize(
    "links, load, dt", [(2, 1e5, 1e-2), (3, 1e4, 1e-2), (3, 1e3, 5e-3), (4, 2e4, 2e-3), (6, 1e4, 1e-2)]
)
def test_light_links_carry_a_heavy_load(links, load, dt, driven):
    """They vibrate by up to eight rad in a step, and keep the energy to a millionth of that at play."""
    run = nd.simulate(payload(links, load, driven), 0.2, dt)
    energy = run.energy
    assert np.abs(np.cumsum(energy.integration)).max() <= 1e-6 * np.ptp(energy.potential)
    assert np.abs(energy.defect).max() <= 1e-12 * np.ptp(energy.potential)


def test_fast_trees_keep_their_momentum():
    """Links at 80 rad/s: to round-off at any step, whatever the flow errs by."""
    model, _ = robot()
    rng = np.random.default_rng(3)
    v, t = 20.0 * rng.normal(size=model.nv), tree(model, (0, 0, 0))
    q, start = pin.neutral(model), momentum(model, pin.neutral(model), v)

    def change(h):
        q1, v1, _ = follow(t, q, v, h, round(0.16 / h))
        return np.abs(momentum(model, q1, v1) - start).max() / np.linalg.norm(start)

    assert max(change(h) for h in (1.6e-2, 8e-3, 4e-3, 2e-3, 2e-4)) <= 1e-11


def test_a_robot_that_hardly_turns_keeps_its_momentum():
    """The axes of its base, in which its velocity is counted, turn by less in a step than its flow has to follow."""
    model, scalar = robot()
    t, v = tree(model, (0, 0, 0), damping=0.3 * scalar), np.zeros(model.nv)
    v[:6] = 10.0, 0, 0, 0, 0, 1e-7
    q, start = pin.neutral(model), momentum(model, pin.neutral(model), v)
    q, v, _ = follow(t, q, v, 5e-3, 200)
    assert np.abs(momentum(model, q, v) - start).max() <= 1e-13 * np.linalg.norm(start)  # it had turned by 1e-7


def test_what_floats_keeps_its_momentum_where_it_is_lifted():
    """A box with an arm tumbles at 100 m/s on ice, which pushes it upwards only; projections turn it."""
    model, arm = pin.Model(), pin.SE3(pin.utils.rotate("y", 0.5 * np.pi), np.array((0.12, 0, 0)))
    base = hang(model, 0, "base", pin.JointModelFreeFlyer(), lump(1.0, (0.01, 0.012, 0.014)))
    hang(model, base, "arm", pin.JointModelRY(), lump(0.4, 0.003, (0.1, 0, 0)), (0.1, 0.05, 0))
    scene, ice = nd.Scene(), nd.Material(mu=0.0)
    scene.add_halfspace("ice", material=ice)
    shapes = {"base": [box((0.2, 0.1, 0.1))], "arm": [(capsule(0.03, 0.15), arm)]}
    q, v = (0, 0, 0.3, 0, 0, 0, 1, 0.3), (0.1, 100, 0.6, 0.3, -1.6, 1.1, 3.9)
    scene.add_model("robot", limit(model), q=q, v=v, damping=(*np.zeros(6), 0.01), collisions=shapes, material=ice)
    run = nd.simulate(scene, 0.8, 5e-3)
    p = np.array([momentum(model, *state)[:2] for state in zip(run.q, run.v, strict=True)])
    assert np.count_nonzero(run.energy.projection) > 2
    assert np.abs(p - p[0]).max() <= 1e-12 * 140.0  # round-off of hundreds of motions
    assert nd.check(run).passed


def test_a_motion_that_cannot_be_followed_is_named():
    """Not as a mass matrix that lacks an armature."""
    t = tree(pendulum(3))
    with pytest.raises(ArithmeticError, match=r"in 'a' joint 'j1' moves at 1e\+200 rad/s or m/s, too wildly to follow"):
        t.flow(np.array((0.1, 0.2, 0.3)), np.array((0.0, 1e200, 0.0)), 1e-2)
    assert np.isnan(reductions.largest(np.array((0.0, np.nan, 1.0))))  # wherever it stands
    with pytest.raises(ArithmeticError, match="in 'a' joint 'j2' moves at nan"):
        t.flow(np.zeros(3), np.array((0.0, 1.0, np.nan)), 1e-2)


@pytest.mark.parametrize("theta", [0.5, 0.7, 1.0])
@pytest.mark.parametrize("gain", [1.0, 1e4, 1e8, 1e12])
def test_any_gain_is_stable(theta, gain):
    """PD without a rate from far away, springs under weight: a hundred steps never farther out than the beginning."""
    q = np.array((0.4, -0.3, 0.2))
    t, control = tree(pendulum(3), (0, 0, 0)), nd.PD(kp=gain, kd=0.0, target=0.0)
    end, rate = q, np.zeros(3)
    for _ in range(100):
        end, rate, _ = follow(t, end, rate, 1e-2, 1, control, theta=theta)
        assert np.abs(end).max() <= 0.41
    # At 1e4 and θ = ½ the first joint swings slower than 2.4/h: of that nothing is damped.
    assert gain == 1.0 or (gain, theta) == (1e4, 0.5) or np.abs(end).max() <= 0.03
    # Weight bends them by less than 30 N m / gain, and swings as far beyond.
    t, end = tree(pendulum(3), stiffness=1e3 * gain, rest=q), q
    for _ in range(100):
        end, rate, _ = follow(t, end, rate if end is not q else np.zeros(3), 1e-2, 1, theta=theta)
        assert np.abs(end - q).max() <= 1.0 / gain


@pytest.mark.slow
def test_a_tree_that_bounces_between_its_limits_switches_without_harm():
    """Impacts are located, with steps of fourth order between: so are their errors of energy."""
    scene = nd.Scene()
    add(scene, "a", pendulum(2, -0.5, 0.5), v=(2.0, 0.0), restitution=1.0)
    drifts = []
    for dt in (2e-3, 1e-3):
        trajectory = nd.simulate(scene, 1.5, dt)
        total = trajectory.energy.total
        hits = (np.diff(np.sign(trajectory.v[:, 0])) != 0).sum()
        drifts.append(np.abs(total - total[0]).max() / np.ptp(trajectory.energy.kinetic))
        assert hits > 5
    assert drifts[1] <= 1e-9 and drifts[1] <= 0.1 * drifts[0]


def test_what_is_returned_stays(rng):
    """Later calls change nothing of what earlier ones returned, nor share memory with it."""
    t = tree(robot()[0])
    q, v = pin.neutral(t.model), rng.normal(size=t.model.nv)

    def step(q, v):
        half = t.halfway(q, v, 1e-2, 0.5)
        free = t.free_motion(half, 0.0, None, None)
        return half, free, t.end(half, free, free.v, True), t.links(q)

    def arrays(values):
        return (
            [values]
            if isinstance(values, np.ndarray)
            else [a for value in values if isinstance(value, (tuple, np.ndarray)) for a in arrays(value)]
        )

    first = arrays(step(q, v))
    copies = [a.copy() for a in first]
    second = arrays(step(pin.integrate(t.model, q, v), -v))
    for a, b in zip(first, copies, strict=True):
        np.testing.assert_array_equal(a, b)
    own = {id(t._zero), id(q), id(v)}
    assert not any(np.shares_memory(a, b) for a in first for b in second if id(a) not in own)


def test_twists_are_the_rates_of_the_poses(rng):
    t = tree(robot()[0])
    q, v, s = pin.neutral(t.model), rng.normal(size=t.model.nv), 1e-6
    links = t.links(q)
    linear, angular = np.empty((2, *links.x.shape))
    table, support = np.array((0, len(t.joints), 0, t.model.nv)), t.support.astype(np.int64).ravel()
    kernels.twists((table, support, links.J.T.ravel()), links.x, v, linear, angular)
    ahead, behind = (t.links(pin.integrate(t.model, q, sign * s * v)) for sign in (1.0, -1.0))
    np.testing.assert_allclose(linear, (ahead.x - behind.x) / (2 * s), rtol=0, atol=1e-8)
    turned = [pin.log3(b @ a.T) / (2 * s) for a, b in zip(behind.R, ahead.R, strict=True)]
    np.testing.assert_allclose(angular, turned, rtol=0, atol=1e-8)


def test_a_driven_joint_does_the_work_of_its_speed():
    """A cart driven at constant speed under a swinging rod: its energy is the motor's, the rest is of second order."""

    def works(dt):
        model, cart = pin.Model(), None
        cart = hang(model, 0, "cart", pin.JointModelPX(), lump(2.0, 0.01))
        pole = hang(model, cart, "pole", pin.JointModelRY(), rod((0, 0, -1)))
        for joint in (cart, pole):
            model.addJointFrame(joint)
        scene = nd.Scene()
        scene.add_model("a", model, q=(0.0, 1.0), v=(1.5, 2.0), collisions={"pole": [sphere(0.1)]})
        scene.set_motion("a/cart", velocity=1.5)
        trajectory = nd.simulate(scene, 1.0, dt)
        np.testing.assert_allclose(trajectory.v[:, 0], 1.5, rtol=0, atol=1e-12)
        total = trajectory.energy.total
        return trajectory.energy.constraint.sum(), total[-1] - total[0]

    found = [works(dt) for dt in (4e-3, 2e-3)]
    assert abs(found[1][0]) > 1.0
    errors = [abs(work - change) for work, change in found]
    assert errors[1] <= 1e-5 and errors[1] <= 0.3 * errors[0]


@pytest.mark.parametrize("size", [1e-12, 1e-9, 3e-8, 1e-4, 0.3])
def test_displacements_are_exact_however_small(size):
    """Of joints given by cosine and sine too, and in composites: Pinocchio's own difference is off by 1e-8 rad."""
    both = pin.JointModelComposite(pin.JointModelRX(), at((0, 0, 0)))
    both.addJoint(pin.JointModelRUBY(), at((0, 0, 0.1)))
    kinds = [pin.JointModelFreeFlyer(), pin.JointModelPlanar(), pin.JointModelRUBX(), pin.JointModelSpherical(), both]
    model, parent = pin.Model(), 0
    for k, kind in enumerate(kinds):
        parent = model.addJoint(parent, kind, at((0, 0, 0)), f"j{k}")
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
        d = size * rng.uniform(-1.0, 1.0, model.nv)
        # Pinocchio's logarithms of larger displacements are exact to some thousand roundings.
        np.testing.assert_allclose(
            displacement(model, q, pin.integrate(model, q, d)), d, rtol=0, atol=1e-14 + 1e-11 * size
        )


@pytest.mark.parametrize("turning", [1e-13, 1e-11, 1e-9, 1e-5, 1.0])
def test_a_disk_on_a_plane_goes_straight_however_slowly_it_turns(turning):
    """Pinocchio's displacements of planar joints were off by 4 mm at 1e-11 rad/s."""
    model = pin.Model()
    hang(model, 0, "disk", pin.JointModelPlanar(), lump(1.0, 0.01))
    scene = nd.Scene()
    scene.add_model("disk", model, v=(1.0, 0.5, turning))
    end = nd.simulate(scene, 10.0, 1e-2).q[-1]
    angle = 10.0 * turning
    expected = (10.0, 5.0, np.cos(angle), np.sin(angle))
    np.testing.assert_allclose(end, expected, rtol=0, atol=1e-11 if turning < 1e-3 else 1e-6)
