"""The contact law of a move: what it foresees of a contact from where that was before."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn._kernels.stepping import law
from nsdyn.scene import shapes
from nsdyn.stepping import move, substepping
from nsdyn.stepping.move_kernel import MoveKernel


def contacts(frame1, point, normal):
    """Contacts of some frames with body 0, as kernels take them."""
    names, points = np.zeros((5, len(point)), np.int64), np.zeros((4, *point.shape))
    names[2], names[4], points[0], points[1] = frame1, np.arange(len(point)), point, normal
    return names, points, np.zeros((3, len(point)))


@pytest.mark.parametrize(
    ("angle", "way", "follows"),
    [
        (0.05, 1.0, True),
        (0.19, 1.0, True),
        (0.21, 1.0, False),
        (0.27, 1.0, False),
        (0.05, 0.02, True),
        (0.05, 0.015, False),
        (0.0, 0.0, True),
    ],
)
def test_a_normal_that_jumps_is_of_another_contact(angle, way, follows):
    """How fast bodies parted along the old normal counts where it turned into this one; else what does along this.

    It turns no faster than by 3 rad while bodies move by their inscribed radius, which is 1 m.
    """
    old, frame = np.array([[np.sin(angle), 0.0, np.cos(angle)]]), np.eye(3)[None, [2, 0, 1]].copy()
    still, none, u = np.zeros((1, 3)), np.empty(0), np.empty(3)
    twists = np.array([[1.0, 0.0, 0.0]]), still
    begin = contacts([-1], still, old), still, twists, (np.full(1, way), 0.0, np.ones(1), 1)
    here = contacts([-1], still, old), frame, still
    law.begin_velocities(np.array([0]), begin, here, np.empty((0, 3)), none, 0.5, u, np.empty(1, np.bool_))
    expected = (np.sin(angle), np.cos(angle), 0.0) if follows else (0.0, 1.0, 0.0)
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize(("spin", "driven", "follows"), [(0.0, False, False), (0.1, False, True), (0.0, True, True)])
def test_normals_of_flat_shapes_turn_with_bodies_alone(spin, driven, follows):
    """However far these go; by 3 times as much at most, as where edges cross. What a driven body turns is not known."""
    old, frame = np.array([[np.sin(0.1), 0.0, np.cos(0.1)]]), np.eye(3)[None, [2, 0, 1]].copy()
    still, none, u = np.zeros((1, 3)), np.empty(0), np.empty(3)
    twists = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, spin, 0.0]])
    begin = contacts([-1], still, old), still, twists, (np.ones(1), 0.0, np.full(1, np.inf), 1)
    here = contacts([-1], still, old), frame, still
    law.begin_velocities(np.array([0]), begin, here, np.zeros((int(driven), 3)), none, 0.5, u, np.empty(1, np.bool_))
    assert abs(u[0]) == pytest.approx(np.sin(0.1) if follows else 0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("gone", "others", "fallen", "follows"),
    [
        (0.9, [0.0], False, True),
        (5.0, [], False, True),
        (5.0, [0.0], False, False),
        (5.0, [1.0], False, True),
        (5.0, [1.0], True, False),
        (500.0, [], False, True),
    ],
)
def test_only_a_contact_that_is_alone_rolls_far(gone, others, fallen, follows):
    """Points of the bodies go 1 m; where an edge crosses another one of several may go farther, as nothing does there.

    Body 0 turns at 1 rad/s about y, and moves at 1 m/s along x: where the contact was it goes otherwise than here. The
    others are of the same bodies, 2 m away, and open by so much where the move begins; here they are closed if a body
    has fallen flat.
    """
    still, none, u = np.zeros((1, 3)), np.empty(0), np.empty(3)
    old, frame = np.array([[gone, 0.0, 0.0]]), np.eye(3)[None, [2, 0, 1]].copy()
    along, about = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    nc, up = 1 + len(others), np.array([[0.0, 0.0, 1.0]])
    away = np.array([[0.0, 2.0, 0.0]]) * (np.arange(nc) > 0)[:, None]
    before = contacts(np.full(nc, -1), old + away, np.tile(up, (nc, 1)))
    before[2][0, 1:] = others
    begin = before, still, (along, about), (np.ones(1), 1e-9, np.ones(1), 1)
    count = nc if fallen else 1
    here = contacts(np.full(count, -1), still + away[:count], np.tile(up, (count, 1))), frame, still
    law.begin_velocities(np.array([0]), begin, here, np.empty((0, 3)), none, 0.5, u, np.empty(1, np.bool_))
    np.testing.assert_allclose(u[:3], (-gone if follows else 0.0, 1.0, 0.0), rtol=0, atol=1e-15 * gone)


@pytest.mark.parametrize(
    ("new", "free", "spin", "slid", "far"),
    [
        (False, 1, 0.0, 0.49, False),
        (False, 1, 0.0, 0.51, True),
        (False, 1, 9.0, 0.0, False),  # a ball that spins or rolls: the lever stays
        (False, 0, 9.0, 0.0, True),  # a link, whose joint may be anywhere
        (True, 1, 0.9, 0.0, False),
        (True, 1, 1.1, 0.0, True),
    ],
)
def test_a_contact_turns_far_if_its_lever_does(new, free, spin, slid, far):
    """By half a radian in half a move of 1 s, about a body at the origin, 1 m above; a new one as its body turns."""
    still, none, frame = np.zeros((1, 3)), np.empty(0), np.eye(3)[None, [2, 0, 1]].copy()
    up, below = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    twists = still, np.array([[0.0, spin, 0.0]])
    begin = contacts([-1], below - [slid, 0.0, 0.0], up), still, twists, (np.full(1, 9.0), 0.0, np.ones(1), free)
    marked, here = np.empty(1, np.bool_), (contacts([-1], below, up), frame, still)
    place = np.array([-1 if new else 0])
    law.begin_velocities(place, begin, here, np.empty((0, 3)), none, 0.5, np.empty(3), marked)
    assert marked.tolist() == [far]


@pytest.mark.parametrize("after", [-0.04 * (1.0 + 1e-15), -0.04 * (1.0 - 1e-15), -0.02, 0.02])
def test_what_friction_would_turn_back_has_stopped(after):
    """A slip of 4 cm/s that a force on the edge of the cone reverses, up to round-off of either sign, or in part."""
    u, none = np.array([0.0, 0.04, 0.0]), np.zeros(3)
    local, b, sliding = np.array([u, u, u, none, none]), np.zeros(3), np.array([True])
    y = np.array([0.0, after, 0.0]) - u
    changed = law.reconsider((np.array([1.0, -0.5, 0.0]), y, b, np.array([0.5])), local, sliding, False)
    assert changed == (after < 0.0) and sliding[0] == (not changed)


def test_the_problem_of_a_move_is_that_of_the_slip_it_ends_with(monkeypatch):
    """Whatever the solver reaches: velocities that are recorded are those of the slip in the problem solved."""
    made = substepping.try_move

    def checked(s, loads, begin, t, h, located, *known):
        m = made(s, loads, begin, t, h, located, *known)
        b = m.kin.offsets(m.sliding, s.gap_rule(m.mid.h, located is None))
        loose.append(not m.solution.converged)
        np.testing.assert_array_equal(m.problem.q, b)
        return m

    loose = []
    monkeypatch.setattr(substepping, "try_move", checked)
    stepper = nd.Stepper(nd.scenes.load("pile")(seed=3), dt=5e-3, on_fail="ignore")
    for _ in range(75):
        stepper.step()
    assert any(loose)


def test_contacts_that_grip_a_body_do_not_ask_what_no_motion_obeys(monkeypatch):
    """A ball between two walls of which both foresee to be 0.1 mm too near: the motion is as without that.

    Friction holds the ball against any impulse of the walls, so that none solves the problem of what is foreseen.
    """
    scene, material = nd.Scene(), nd.Material(mu=1.0)
    for side in (-1.0, 1.0):
        scene.add_box(f"wall{side:+.0f}", (0.2, 1, 1), fixed=True, position=(0.2 * side, 0, 0), material=material)
    scene.add_sphere("ball", 0.1, 1.0, linear_velocity=(0, 0, 0.5), material=material)
    made, found = move.solve, []

    def foreseen(kin, *given):
        squeezed = kin._replace(end_gap=np.full(2, -1e-4), stays=np.ones(2, np.bool_))
        found.append((made(kin, *given), made(squeezed, *given)))
        return found[-1][1]

    monkeypatch.setattr(move, "solve", foreseen)
    monkeypatch.setattr(MoveKernel, "ready", False)
    stepper = nd.Stepper(scene, dt=5e-3)
    monkeypatch.setattr(stepper, "_eventless", None)
    stepper.step()
    (_, _, without), (kin, problem, solution) = found[0]
    assert problem.nc == 2 and not kin.end_gap.any() and solution.converged
    np.testing.assert_allclose(solution.u, without.u, rtol=0, atol=1e-8)


@pytest.mark.parametrize("mu", [0.8, 1.5])
def test_a_ball_that_friction_grips_between_rails_rolls_on(mu):
    """Each contact is inside the friction cone of the other, so impulses of any size cancel.

    What their extrapolated drifts ask of each other, 1e-7 m/s, no velocity obeys: impulses had grown to 1e5 N·s.
    """
    scene, material, rails = nd.Scene(), nd.Material(mu), []
    for side, angle, height in ((1.0, 0.06, 0.005), (-1.0, 0.04, -0.008)):
        along = np.array((np.cos(angle), -side * np.sin(angle), 0.0))
        turn = Rotation.align_vectors([along], [(0, 0, 1)])[0].as_quat()
        place = np.array((0.0, side * 0.09, height))
        scene.add_capsule(f"rail{side:+.0f}", 0.01, 1.2, fixed=True, position=place, quaternion=turn, material=material)
        rails.append((place, along))

    def gaps(yz):
        return [np.linalg.norm(np.cross((0.0, *yz) - place, along)) - 0.11 for place, along in rails]

    centre = np.array((0.0, *fsolve(gaps, (0.0, 0.06), xtol=1e-14)))
    arms = [0.1 / 0.11 * (place + along * ((centre - place) @ along) - centre) for place, along in rails]
    spin = 4.0 * (arms[0] - arms[1]) / np.linalg.norm(arms[0] - arms[1])
    moves = {"linear_velocity": -np.cross(spin, arms[0]), "angular_velocity": spin}
    scene.add_sphere("ball", 0.1, 1.0, position=centre, material=material, **moves)
    stepper = nd.Stepper(scene, dt=5e-3)
    steps = [stepper.step() for _ in range(10)]
    assert max(np.abs(step.r).max() for step in steps) < 100.0  # its weight gives 0.05 N·s


def hinged(shape, place, seed, deep=0.0):
    """A pendulum of 0.15 m on a hinge anywhere, with a shape that touches a plate there, `deep` m into it.

    With the seed 0 the hinge is along an axis through the origin, where no round-off hides that nothing moves.
    """
    rng, model = np.random.default_rng(seed), pin.Model()
    turn, at = (Rotation.random(random_state=seed), rng.normal(size=3)) if seed else (Rotation.identity(), np.zeros(3))
    up, where = turn.as_matrix()[:, 2], pin.SE3(np.eye(3), np.array(place))
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3(turn.as_matrix(), at), "lid")
    model.addJointFrame(joint)
    model.appendBodyToJoint(joint, pin.Inertia(0.5, np.array([0.15, 0, 0]), np.eye(3) / 100), pin.SE3.Identity())
    scene = nd.Scene(gravity=-9.81 * up)
    below = at + (deep - 0.5 - (place[2] == 0.0) * 0.05) * up
    scene.add_box("plate", (4, 4, 1), fixed=True, position=below, quaternion=turn.as_quat())
    scene.add_model("m", model, q=[-0.3], collisions={"lid": [(shape, where)]})
    return scene


@pytest.mark.parametrize("seed", range(4))
def test_a_lid_that_touches_on_the_axis_of_its_hinge_falls_shut(seed):
    """No motion opens or closes the contact there, and what round-off says of it is no lever arm."""
    run = nd.simulate(hinged(shapes.box((0.6, 0.2, 0.02)), (0.3, 0.0, 0.01), seed), 0.3, dt=1e-2)
    np.testing.assert_allclose((run.q[-1], run.v[-1]), 0.0, rtol=0, atol=1e-10)
    assert run.contacts(-1).impulse[:, 0].sum() == pytest.approx(0.5 * 9.81 * 0.15 / 0.6 * 1e-2, rel=1e-9)
    assert nd.check(run).passed


@pytest.mark.parametrize("deep", [0.0, 1e-9, 1e-8])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_wheel_on_a_fixed_axle_is_not_lifted_by_turning(deep, seed):
    """An overlap that no turn of the joint removes stays; the pendulum swings as if nothing touched."""
    wheel, free = (hinged(shapes.sphere(0.05), (0.0, 0.0, 0.0), seed, into) for into in (deep, -1.0))
    stepper, other = (nd.Stepper(scene, dt=1e-2, on_fail="ignore") for scene in (wheel, free))
    for _ in range(20):
        step, alone = stepper.step(), other.step()
        np.testing.assert_allclose((step.q, step.v), (alone.q, alone.v), rtol=0, atol=1e-7)
        assert (step.solution.status == nd.Status.OVERLAP) == (deep > 0.0)


@pytest.mark.filterwarnings("ignore:.* overlap at the start")
@pytest.mark.parametrize("ahead", [1e-7, -1e-7])
def test_an_overlap_deeper_than_its_lever_arm_is_left(ahead):
    """To remove it, the lid would turn by more than a radian; it falls as if nothing touched at its hinge."""
    lid, free = (hinged(shapes.box((0.6, 0.2, 0.02)), (0.3 + ahead, 0.0, 0.01), 1, into) for into in (1e-6, -1.0))
    stepper, other = (nd.Stepper(scene, dt=1e-2, on_fail="ignore") for scene in (lid, free))
    for _ in range(5):
        step, alone = stepper.step(), other.step()
        np.testing.assert_allclose((step.q, step.v), (alone.q, alone.v), rtol=0, atol=1e-9)
        assert step.solution.status == nd.Status.OVERLAP


@pytest.mark.filterwarnings("ignore:.* overlap at the start")
def test_an_overlap_is_removed_whatever_turns_lightly_elsewhere():
    """A rotor of 1e-6 kg m² on a body that overlaps the ground has no part in its contacts."""
    model, scene = pin.Model(), nd.Scene()
    for name, kind, inertia in (
        ("body", pin.JointModelFreeFlyer(), pin.Inertia.FromBox(10.0, 0.2, 0.2, 0.2)),
        ("rotor", pin.JointModelRZ(), pin.Inertia(0.01, np.zeros(3), 1e-6 * np.eye(3))),
    ):
        joint = model.addJoint(model.njoints - 1, kind, pin.SE3.Identity(), name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    scene.add_halfspace("ground")
    box = [(shapes.box((0.2, 0.2, 0.2)), pin.SE3.Identity())]
    scene.add_model("m", model, q=[0, 0, 0.0991, 0, 0, 0, 1, 0], collisions={"body": box})
    step = nd.Stepper(scene, dt=1e-3).step()
    assert step.q[2] == pytest.approx(0.1, abs=1e-9)
    assert step.solution.status == nd.Status.CONVERGED


def test_links_of_one_tree_that_touch_on_their_hinge_turn_on_it():
    """A lid on a chest in flight, with a ring between them on the same hinge: its edge touches and carries nothing."""
    model, joint, scene = pin.Model(), 0, nd.Scene(gravity=(0, 0, 0))
    turn, sole = Rotation.random(random_state=1).as_quat(), pin.SE3(np.eye(3), np.array([0.2, 0, 0.01]))
    hinge, ring = (pin.SE3(np.eye(3), np.array(x)) for x in ((-0.2, 0.0, 0.1), (0.0, 0.0, 0.0)))
    for name, kind, place, inertia in (
        ("chest", pin.JointModelFreeFlyer(), ring, pin.Inertia.FromBox(3.0, 0.4, 0.3, 0.2)),
        ("ring", pin.JointModelRY(), hinge, pin.Inertia.FromSphere(0.1, 0.03)),
        ("lid", pin.JointModelRY(), ring, pin.Inertia(0.6, sole.translation, 0.01 * np.eye(3))),
    ):
        joint = model.addJoint(joint, kind, place, name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    boxes = {"chest": [(shapes.box((0.4, 0.3, 0.2)), ring)], "lid": [(shapes.box((0.4, 0.3, 0.02)), sole)]}
    scene.add_model("m", model, q=[0, 0, 0, *turn, 0.1, -0.8], v=[0, 0, 0, 0, 0, 0, 0, -1], collisions=boxes)
    run = nd.simulate(scene, 0.1, dt=1e-2)
    assert run.energy.kinetic[-1] == pytest.approx(run.energy.kinetic[0], rel=1e-9)
    assert nd.check(run).passed


def test_a_wheel_that_a_driven_slide_presses_into_the_ground_overlaps():
    """Only the slide moves the contact, and no impulse moves the slide."""
    model, joint, scene = pin.Model(), 0, nd.Scene()
    for name, kind in (("slide", pin.JointModelPZ()), ("wheel", pin.JointModelRY())):
        joint = model.addJoint(joint, kind, pin.SE3.Identity(), name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene.add_halfspace("ground")
    scene.add_model("m", model, q=[0.102, 0.0], collisions={"wheel": [(shapes.sphere(0.1), pin.SE3.Identity())]})
    scene.set_motion("m/slide", velocity=-0.5)
    stepper = nd.Stepper(scene, dt=1e-3, on_fail="ignore")
    steps = [stepper.step() for _ in range(8)]
    assert [step.solution.status == nd.Status.OVERLAP for step in steps] == [step.q[0] < 0.1 - 1e-9 for step in steps]


def test_a_truss_that_touches_a_fixed_body_carries_what_falls_on_it():
    """A loop leaves its two bars no freedom: no impulse there moves anything, nor one at a limit that is reached."""
    model, scene, bar = pin.Model(), nd.Scene(), pin.SE3(np.eye(3), np.array([0, 0, 0.35]))
    for name, x in (("left", -0.5), ("right", 0.5)):
        joint = model.addJoint(0, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([x, 0, 0])), name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, bar.translation, 0.04 * np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, np.pi / 4
    collisions = {name: [(shapes.capsule(0.03, 0.7), bar)] for name in ("left", "right")}
    scene.add_model("truss", model, q=np.array([1, -1]) * np.pi / 4, collisions=collisions, self_collisions=False)
    scene.add_loop("truss", "apex", "left", frame2="right", position=(0, 0, 0.5**0.5))
    scene.add_sphere("stop", 0.05, fixed=True, position=(0.08 * 0.5**0.5 - 0.25, 0, 0.25 - 0.08 * 0.5**0.5))
    scene.add_sphere("ball", 0.05, 1.0, position=(-0.25 - 0.08 * 0.5**0.5, 0, 0.26 + 0.08 * 0.5**0.5))
    run = nd.simulate(scene, 0.1, dt=1e-2)
    np.testing.assert_allclose(run.q[-1, 7:], np.array([1, -1]) * np.pi / 4, rtol=0, atol=1e-12)
    assert run.contacts(-1).impulse[0, 0] > 0.0
    assert nd.check(run).passed
