"""Articulated trees in a scene: what is read from robot files and models, and their matrices against Pinocchio."""

import re

import coal
import numpy as np
import pinocchio as pin
import pytest
from conftest import INERTIAL
from mechanisms import hang, lump
from robot_texts import scene_of
from scipy.linalg import null_space

import nsdyn as nd
from nsdyn.scene import pairs, shapes


def loaded(robot, **keywords):
    path, package_dirs = robot
    scene = nd.Scene()
    with pytest.warns(UserWarning, match=r"'r' leaves out: joint 'ja': velocity of <limit> \(2\)"):
        scene.add_urdf("r", path, package_dirs=package_dirs, **keywords)
    return scene, scene.articulations["r"]


def test_neighbours_are_not_tested(robot):
    scene, a = loaded(robot)
    names = [link.name for link in a.links]
    expected = {frozenset((names[i], names[j])) for i, j in a.excluded}
    assert frozenset(("base_0", "a_0")) in expected and frozenset(("c_0", "tip_0")) in expected
    assert frozenset(("base_0", "b_0")) not in expected and frozenset(("a_0", "c_0")) not in expected
    scene.add_sphere("ball", 0.1, 1.0, position=(5, 0, 0))
    geoms = scene.geoms()
    assert {frozenset((geoms[i].name[2:], geoms[j].name[2:])) for i, j in pairs.excluded(scene, geoms)} == expected


def test_no_self_collisions(robot):
    _, a = loaded(robot, self_collisions=False)
    assert len(a.excluded) == 6 * 5 / 2


def test_srdf(robot, tmp_path):
    srdf = tmp_path / "r.srdf"
    srdf.write_text(
        '<robot name="r"><group name="g"/><disable_collisions link1="a" link2="c" reason="Never"/>'
        '<disable_collisions link1="a" link2="gone" reason="Never"/></robot>'
    )
    _, before = loaded(robot)
    _, a = loaded(robot, srdf=srdf)
    names = [link.name for link in a.links]
    added = {frozenset((names[i], names[j])) for i, j in a.excluded - before.excluded}
    assert added == {frozenset(("a_0", "c_0")), frozenset(("a_1", "c_0"))}
    assert any("gone" in line for line in a.report) and "SRDF: <group>" in a.report


def test_collision_shapes_are_the_users(robot):
    _, a = loaded(robot, collisions=False)
    assert a.links == ()
    up = pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    _, a = loaded(robot, collisions={"a": [], "tip": [shapes.sphere(0.2), (shapes.box((1, 1, 1)), up)]})
    assert [(link.name, link.joint) for link in a.links] == [
        ("base_0", 0),
        ("b_0", 2),
        ("c_0", 3),
        ("tip_0", 3),
        ("tip_1", 3),
    ]
    np.testing.assert_allclose(a.links[4].placement.translation, (0, 0, 1))


def test_material_of_a_body(robot):
    scene, _ = loaded(robot, material={"a": nd.Material(mu=0.9), "tip": nd.Material(restitution=0.3)})
    materials = {g.name: g.material for g in scene.geoms()}
    assert materials["r/a_0"].mu == materials["r/a_1"].mu == 0.9
    assert materials["r/tip_0"].restitution == 0.3 and materials["r/b_0"] == nd.Material()


POSE = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.9), np.array([1.0, -2.0, 0.5]))


@pytest.mark.parametrize("base", ["fixed", "free"])
def test_base_pose(robot, base):
    """Every frame of the placed robot is where that of the robot at the origin is, moved by the pose."""
    at = {"position": POSE.translation, "quaternion": pin.SE3ToXYZQUAT(POSE)[3:]}
    q = (0.4, np.cos(2), np.sin(2), 0.1)
    _, here = loaded(robot, base=base, q=q)
    _, there = loaded(robot, base=base, q=q, **at)
    poses = []
    for a in (here, there):
        data = a.model.createData()
        pin.framesForwardKinematics(a.model, data, a.q)
        poses.append([f.copy() for f in data.oMf] + [data.oMi[k.joint] * k.placement for k in a.links])
    for p, moved in zip(*(p[1:] for p in poses), strict=True):  # all but the world itself
        assert (POSE * p).isApprox(moved, 1e-14)
    assert there.v.size == (9 if base == "free" else 3)


def test_copies_are_independent():
    path = nd.scenes.folder() / "arm.urdf"
    scene = nd.Scene()
    for k in range(20):
        scene.add_urdf(f"arm{k}", path, position=(2 * k, 0, 0), armature=(0.1 * k, 0))
    first, last = scene.articulations["arm0"].model, scene.articulations["arm19"].model
    assert first.jointPlacements[1].translation[0] == 0 and last.jointPlacements[1].translation[0] == 38
    assert first.armature[0] == 0 and last.armature[0] == pytest.approx(1.9)
    assert len(scene.geoms()) == 60


def test_joint_values_of_the_user(robot):
    _, a = loaded(
        robot,
        base="free",
        friction=(1, 2, 3),
        damping=np.arange(9),
        stiffness=(3, 0, 4),
        rest=(0.1, 0, 0.2),
        v=(5, 6, 7),
        limits=False,
        restitution=0.5,
    )
    np.testing.assert_array_equal(a.friction, (0, 0, 0, 0, 0, 0, 1, 2, 3))
    np.testing.assert_array_equal(a.damping, np.arange(9))
    np.testing.assert_array_equal(a.stiffness[6:], (3, 0, 4))
    np.testing.assert_array_equal(a.rest[6:], (0.1, 0, 0.2))
    np.testing.assert_array_equal(a.v[6:], (5, 6, 7))
    assert not a.limits and a.restitution == 0.5


def pendulum():
    """Pinocchio model of a rod of 1 m on a hinge about y with a sphere at its end, and its geometry."""
    model, geometry = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    down = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), 0.01 * np.eye(3)), down)
    model.addFrame(pin.Frame("bob", joint, 0, down, pin.FrameType.BODY))
    geometry.addGeometryObject(pin.GeometryObject("ball", joint, down, shapes.sphere(0.1).geometry))
    return model, geometry


def test_model_made_by_hand():
    model, geometry = pendulum()
    scene = nd.Scene()
    scene.add_model("p", model, geometry, q=(0.3,))
    scene.add_model("bare", model)
    a = scene.articulations["p"]
    assert [(k.name, k.joint) for k in a.links] == [("ball", 1)]
    assert scene.articulations["bare"].links == () and a.report == ()
    a.model.armature = np.ones(1)
    assert model.armature[0] == 0, "the user's model is copied"
    np.testing.assert_array_equal(a.model.gravity.linear, (0, 0, -9.81))


@pytest.mark.parametrize(("parents", "taken"), [((0, 1, 2, 1, 4, 0), True), ((0, 1, 1, 2), False), ((0, 0, 1), False)])
def test_joints_are_depth_first(parents, taken):
    """Pinocchio's mass matrix lacks the elements of what a joint carries that does not come right after it."""
    model = pin.Model()
    for k, parent in enumerate(parents, start=1):
        hang(model, parent, f"j{k}", pin.JointModelRY(), lump(1.0, 0.1, (0.1, 0.0, 0.0)), (0.3, 0.0, 0.1))
    q, zero = np.linspace(0.1, 0.5, model.nv), np.zeros(model.nv)
    data = model.createData()
    upper = np.triu(pin.crba(model, data, q))
    gravity = pin.computeGeneralizedGravity(model, data, q)
    columns = [pin.rnea(model, data, q, zero, one) - gravity for one in np.eye(model.nv)]
    assert (np.abs(upper - np.triu(columns)).max() < 1e-12) == taken
    scene = nd.Scene()
    if taken:
        scene.add_model("r", model)
    else:
        last = len(parents)
        words = f"model of 'r' must have all joints .* right after it, got 'j{last}', which .* after 'j{last - 1}'"
        with pytest.raises(ValueError, match=words):
            scene.add_model("r", model)


def test_loop():
    model, _ = pendulum()
    scene = nd.Scene()
    scene.add_model("p", model, q=(0.5,))
    scene.add_loop("p", "pin", "bob", position=(0, 0, 0.2))
    (loop,) = scene.articulations["p"].loops
    assert (loop.joint1, loop.joint2, loop.kind) == (1, 0, "point")
    # Where the point 0.8 m down the rod is at 0.5 rad.
    np.testing.assert_allclose(
        loop.placement2.translation, (-0.8 * np.sin(0.5), 0, -0.8 * np.cos(0.5)), rtol=0, atol=1e-15
    )
    for change, words in (
        ({"articulation": "x"}, "articulation must be one of"),
        ({"frame1": "x"}, "frame1 of 'other', a frame of 'p', must be one of"),
        ({"kind": "x"}, "kind of 'other' must be"),
        ({"name": "pin"}, "name must be unique among the loops"),
        ({"name": 3}, "name of a loop of 'p' must be a text of Unicode without NUL, got 3"),
        ({"name": "a/b"}, "name of a loop of 'p' must be a non-empty string without '/', got 'a/b'"),
        ({"frame2": "bob"}, "frame2 of 'other' must be on another link than frame1, 'bob', got 'bob'"),
    ):
        with pytest.raises(ValueError, match=words):
            scene.add_loop(**{"articulation": "p", "name": "other", "frame1": "bob"} | change)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"q": (0.1, 1, 0)}, r"q of 'r' must be 4 numbers, got shape \(3,\)"),
        ({"q": (0.1, 1, 0.5, 0)}, "q of 'r' must have unit quaternions"),
        ({"q": (2.5, 1, 0, 0)}, "q of 'r' must respect the limits: joint 'ja' is at 2.5, its limits are -1 and 2"),
        ({"v": (0.1,)}, "v of 'r' must be 3 numbers"),
        ({"friction": -1}, "friction of 'r' must be a sequence of 3 numbers, got -1$"),
        ({"v": (0, 0, np.nan)}, "v of 'r' must be finite"),
        ({"base": "loose"}, "base of 'r' must be 'fixed' or 'free'"),
        ({"position": (0, 0)}, "position of 'r'"),
        ({"quaternion": (1, 0, 0, 1)}, "quaternion of 'r'"),
        ({"material": 0.4}, "material of 'r' must be a nsdyn.Material, got 0.4"),
        ({"material": {"z": nd.Material()}}, "body with shapes in material of 'r' must be one of .*; got 'z'"),
        ({"material": {"a": 0.4}}, "material of 'r' must be a nsdyn.Material, got 0.4"),
        ({"friction": (-1, 0, 0)}, "friction of 'r' must not be negative"),
        ({"stiffness": (0, -1, 0)}, "stiffness of 'r' must not be negative"),
        ({"base": "free", "stiffness": np.ones(9)}, "stiffness of 'r' must be 0 in joint 'root_joint'"),
        ({"restitution": 2.0}, r"restitution must lie in \[0, 1\]"),
        ({"limits": 1}, "limits of 'r' must be True or False"),
        ({"self_collisions": 0}, "self_collisions of 'r' must be True, False or 'apart', got 0"),
        ({"collisions": {"z": []}}, "body in collisions of 'r' must be one of .*; got 'z'"),
        ({"collisions": {"a": [1.0]}}, r"collisions of 'r' must be shapes or \(Shape, SE3\)"),
        ({"collisions": {"a": shapes.sphere(0.1)}}, "collisions of 'r' must be a sequence of shapes for 'a', got"),
        ({"collisions": "visual"}, "collisions of 'r' must be True, False or"),
        ({"srdf": "nowhere.srdf"}, "srdf of 'r' must be an SRDF file"),
        ({"package_dirs": ()}, r"mesh 'package://thing/box.stl' was not found"),
        ({"package_dirs": "folder"}, "package_dirs of 'r' must be a sequence of folders, got 'folder'"),
        ({"package_dirs": 3}, "package_dirs of 'r' must be a sequence of folders, got 3"),
        ({"package_dirs": ["nowhere"]}, "package_dirs of 'r' must be folders, got 'nowhere': there is none"),
        ({"srdf": 3}, "srdf of 'r' must be a path, got 3"),
        ({"path": None}, "path of 'r' must be a path, got None"),
        ({"colour": (1, 0, 0)}, "keyword must be one of .* others; got 'colour'"),
    ],
)
def test_refused(robot, change, words):
    path, package_dirs = robot
    scene = nd.Scene()
    with pytest.raises(ValueError, match=words):
        scene.add_urdf("r", **{"path": path, "package_dirs": package_dirs} | change)
    assert not scene.articulations, "a refused robot leaves the scene as it was"


ARTICULATED = [name for name in nd.scenes.names() if nd.scenes.load(name)().articulations]


def dense(dynamics, position, R):
    """(M, {frame: (its Jacobian in world axes, its origin)}) of a scene, of trees from Pinocchio alone."""
    d = dynamics
    M, jacobians = np.zeros((d.n, d.n)), {}
    for k in range(d.free):
        M[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = d.mass[k] * np.eye(3)
        M[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = d.J[k]
        J = np.zeros((6, d.n))
        J[:3, 6 * k : 6 * k + 3], J[3:, 6 * k + 3 : 6 * k + 6] = np.eye(3), R[k]
        jacobians[k] = J, position.x[k]
    for t, q in zip(d.trees, position.trees, strict=True):
        model, data, rows = t.model, t.model.createData(), t.coordinates
        upper = np.triu(pin.crba(model, data, q))
        M[rows, rows] = upper + np.triu(upper, 1).T
        pin.computeJointJacobians(model, data, q)
        for k, joint in enumerate(t.joints, start=t.frames.start):
            J = np.zeros((6, d.n))
            J[:, rows] = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
            jacobians[k] = J, data.oMi[joint].translation.copy()
    return M, jacobians


@pytest.mark.parametrize("name", ARTICULATED)
def test_step_against_dense_pinocchio(name):
    """M, H, W and the free acceleration of a step with contacts (if any in 0.3 s) against Pinocchio's dense ones."""
    setup = nd.scenes.setup(name)
    stepper = nd.Stepper(setup.scene, **setup.options())
    d, h = stepper.dynamics, 1e-5
    for _ in range(200):
        before = stepper.get_state().instant
        step = stepper.step()
        if (np.maximum(step.contacts.frame1, step.contacts.frame2) >= d.free).any():
            break
    # The forces of one short step from there (θ = 1: at its beginning), without control, whose gains are in the mass
    # matrix: M Δv = h (τ - g) with gravity terms g, damping and springs at its end; Coriolis terms are the flow's.
    q, v = before.position, before.v
    middle = d.halfway(q, v, h, 1.0, d.surfaces.twists(0.0))
    forces = d.forces(middle, h, h)
    M, jacobians = dense(d, q, middle.placement.R)
    N, v_free = np.eye(d.n), forces.v
    rows, frame = d.rows(step.contacts, middle.placement, forces, None)
    _, H = rows.full.dense()
    c = step.contacts
    expected = np.zeros_like(H)
    for k in range(c.gap.size):
        for body, sign in ((c.frame1[k], -1.0), (c.frame2[k], 1.0)):
            if body >= 0:
                J, origin = jacobians[body]
                at_point = J[:3] - pin.skew(c.point[k] - origin) @ J[3:]
                expected[:, 3 * k : 3 * k + 3] += sign * (frame[k] @ at_point).T
    ours, minv = np.zeros((2, d.n, d.n))
    for k, (at, size) in enumerate(zip(d.m_start, np.diff(d.offset), strict=True)):
        rows = slice(d.offset[k], d.offset[k + 1])
        ours[rows, rows] = forces.m[at : at + size**2].reshape(size, size)
        minv[rows, rows] = forces.minv[at : at + size**2].reshape(size, size)
    acceleration, bias = (v_free - v) / h, np.zeros(d.n)
    bias[: 6 * d.free] = -M[: 6 * d.free, : 6 * d.free] @ acceleration[: 6 * d.free]  # tested with the free bodies
    implicit = np.zeros(d.n)
    for t, a, x in zip(d.trees, setup.scene.articulations.values(), q.trees, strict=True):
        model, rows, after = t.model, t.coordinates, v_free[t.coordinates]
        tau = -a.damping * after - a.stiffness * (t.angle(x) + h * after - a.rest)
        bias[rows] = pin.computeGeneralizedGravity(model, model.createData(), x) - tau
        implicit[rows] = h * a.damping + h**2 * a.stiffness
        if a.loops:
            N = np.delete(N, np.s_[rows], axis=1)
            N = np.hstack((N, np.eye(d.n)[:, rows] @ null_space(loop_jacobian(a, x), rcond=1e-9)))
    M_implicit = M + np.diag(implicit)
    W = expected.T @ N @ np.linalg.solve(N.T @ M_implicit @ N, N.T @ expected)
    # The bar of all four, relative to the largest entry; accelerations lose the digits of v in a step of h.
    np.testing.assert_allclose(ours, M_implicit, rtol=0, atol=1e-10 * np.abs(M).max())
    np.testing.assert_allclose(H, expected, rtol=0, atol=1e-10 * max(1.0, np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(H.T @ minv @ H, W, rtol=0, atol=1e-10 * max(1.0, np.abs(W).max(initial=0.0)))
    rest = N.T @ (M @ acceleration + bias)
    np.testing.assert_allclose(rest, 0.0, rtol=0, atol=1e-10 * max(np.abs(bias).max(), np.abs(M @ v).max() / h))


def loop_jacobian(articulation, q):
    """Rows of all loops: the relative velocity of their frames, in the axes of the first."""
    model, rows = articulation.model, []
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    for loop in articulation.loops:
        J = []
        for joint, placement in ((loop.joint1, loop.placement1), (loop.joint2, loop.placement2)):
            pose = data.oMi[joint] * placement
            own = np.zeros((6, model.nv)) if joint == 0 else pin.getJointJacobian(model, data, joint, pin.WORLD)
            turn = pin.SE3(np.eye(3), pose.translation).toActionMatrixInverse()
            J.append(turn @ own)
        rows.append((J[1] - J[0])[: 3 if loop.kind == "point" else 6])
    return np.vstack(rows)


CROWDED = f"""<robot name="r"><link name="base">{INERTIAL}</link>
<link name="a">{INERTIAL}<collision><geometry><sphere radius="0.2"/></geometry></collision></link>
<link name="b">{INERTIAL}</link>
<link name="c">{INERTIAL}<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link>
<link name="d">{INERTIAL}<collision><origin xyz="2 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
{
    "".join(
        f'''<joint name="j{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/><limit lower="{low}" upper="2" effort="9" velocity="0"/></joint>'''
        for parent, child, low in (("base", "a", 0.5), ("a", "b", -1), ("b", "c", -1), ("c", "d", -1))
    )
}</robot>"""


@pytest.fixture
def crowded(tmp_path):
    """A robot whose zero configuration is outside a limit, and whose links a and c overlap."""
    return lambda **options: scene_of(tmp_path, CROWDED, **options)


def test_configuration_outside_limits_names_the_remedy(crowded):
    with pytest.raises(ValueError, match=r"'ja' is at 0, its limits are 0\.5 and 2; give another q, or clip=True"):
        crowded()
    scene = crowded(clip=True)
    np.testing.assert_array_equal(scene.articulations["r"].q, (0.5, 0, 0, 0))


def test_links_that_overlap_at_the_start_may_stay_apart(crowded):
    scene = crowded(clip=True)
    with pytest.raises(ValueError, match=r"'r/a_0' and 'r/c_0' overlap .*; self_collisions='apart' of 'r', or an SRDF"):
        nd.Stepper(scene)
    left = "contact of 'a_0' and 'c_0' (0.1 m deep), which overlap at the start"
    with pytest.warns(UserWarning, match=rf"^'r' leaves out: {re.escape(left)}$"):
        scene = crowded(clip=True, self_collisions="apart")
    a = scene.articulations["r"]
    names = [link.name for link in a.links]
    assert {frozenset((names[i], names[j])) for i, j in a.excluded} == {
        frozenset(("a_0", "c_0")),
        frozenset(("c_0", "d_0")),
    }, "the overlapping pair and the neighbours, but not a and d"
    assert a.report == (left,)
    nd.Stepper(scene).step()
    with pytest.raises(ValueError, match="self_collisions of 'r' must be True, False or 'apart', got 'together'"):
        crowded(clip=True, self_collisions="together")


def test_no_other_option_is_taken():
    with pytest.raises(ValueError, match=r"did you mean 'limits'\? keyword must be one of limits, .*; got 'limts'"):
        nd.Scene().add_model("r", pin.Model(), limts=True)


HAND = f"""<robot name="r"><link name="base">{INERTIAL}
<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision></link><link name="arm">{INERTIAL}</link>
<link name="foot"><collision><geometry><sphere radius="0.1"/></geometry></collision></link><link name="tip"/>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/>
<axis xyz="0 1 0"/></joint>
<joint name="weld" type="fixed"><parent link="arm"/><child link="foot"/><origin xyz="0.5 0 0"/></joint>
<joint name="tool" type="fixed"><parent link="foot"/><child link="tip"/>
<origin xyz="0 0.2 0" rpy="0 0 1.5707963267948966"/></joint></robot>"""


@pytest.fixture
def hand(tmp_path):
    """An arm over a plate; foot and tip hang on it by fixed joints."""
    scene = scene_of(tmp_path, HAND, q=(1.0, 0.0), position=(0, 0, 1.0))
    scene.add_box("plate", (0.4, 0.4, 0.1), position=(0.5, 0, 1.85), fixed=True)
    return scene


def test_links_go_by_their_names_in_a_recording(hand):
    trajectory = nd.simulate(hand, 0.05, dt=1e-3)
    model = hand.articulations["r"].model
    data = model.createData()
    for row in (0, 30):
        pin.framesForwardKinematics(model, data, trajectory.q[row])
        for link in ("base", "arm", "foot", "tip"):
            pose, motion = data.oMf[model.getFrameId(link, pin.FrameType.BODY)], trajectory.body(f"r/{link}")
            # Two ways to multiply a few rotations.
            np.testing.assert_allclose(motion.position[row], pose.translation, rtol=0, atol=1e-14)
            turn = pin.Quaternion(motion.quaternion[row]).toRotationMatrix()
            np.testing.assert_allclose(turn, pose.rotation, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(trajectory.body("r/shoulder").position, trajectory.body("r/arm").position)
    table = trajectory.contacts(-1)
    assert {*table.body1, *table.body2} == {"plate", "r/foot"} and {*table.shape1, *table.shape2} == {
        "plate",
        "r/foot_0",
    }
    with pytest.raises(ValueError, match=r"did you mean 'r/foot'\? moving body must be one of .*; got 'r/fot'"):
        trajectory.body("r/fot")


def test_links_without_shapes_are_in_a_recording(tmp_path):
    """As those that have some: where they are, how they move, and pushed by what the scene says."""
    text = (
        '<robot name="r"><link name="base"><collision><geometry><sphere radius="1"/></geometry></collision></link>'
        f'<link name="arm">{INERTIAL}</link><link name="tip"/><joint name="j" type="continuous"><axis xyz="0 1 0"/>'
        '<parent link="base"/><child link="arm"/></joint><joint name="f" type="fixed"><parent link="arm"/>'
        '<child link="tip"/><origin xyz="2 0 0"/></joint></robot>'
    )
    scene = scene_of(tmp_path, text, q=(np.cos(0.5), np.sin(0.5)), v=(3.0,))
    scene.gravity = (0, 0, 0)
    run, speed = nd.simulate(scene, 0.01, dt=1e-2), 6.0 * np.array((-np.sin(0.5), 0, -np.cos(0.5)))
    # Sines of an angle, by a quaternion and by a matrix.
    np.testing.assert_allclose(
        run.body("r/tip").position[0], (2 * np.cos(0.5), 0, -2 * np.sin(0.5)), rtol=0, atol=1e-14
    )
    np.testing.assert_allclose(run.body("r/tip").linear_velocity[0], speed, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(run.body("r/arm").position, np.zeros((2, 3)))
    step = nd.Stepper(scene, dt=1e-2).step()
    np.testing.assert_array_equal(step.velocity("r/arm")[1], run.body("r/arm").angular_velocity[1])
    assert nd.check(run).passed


def test_pairs_of_links_beat_pairs_of_robots(hand):
    hand.set_pair("r/foot", "plate", mu=0.9)
    hand.set_pair("r", "plate", mu=0.1, restitution=0.0)
    geoms = hand.geoms()
    names = [g.name for g in geoms]
    foot, base, plate = (np.array([names.index(n)]) for n in ("r/foot_0", "r/base_0", "plate"))
    assert (
        pairs.pair_material(hand, geoms)(foot, plate)[0] == 0.9
        and pairs.pair_material(hand, geoms)(plate, base)[0] == 0.1
    )
    assert set(nd.simulate(hand, 0.01).contacts(-1).mu) == {0.9}
    hand.set_pair("r", "r", restitution=0.0)
    with pytest.raises(ValueError, match="'r/foot' and itself never touches"):
        hand.set_pair("r/foot", "r/foot", restitution=0.0)
    with pytest.raises(ValueError, match=r"did you mean 'r/foot'\? body must be one of .*; got 'r/food'"):
        hand.set_pair("r/food", "plate", mu=0.1)


def test_forces_act_on_fixed_links(hand):
    """A force on the tip turns the arm as the same force, with its moment, on the arm does."""

    def turned(**force):
        trajectory = nd.simulate(hand, 1e-3, dt=1e-3, external_force=lambda t, q, v: force)
        return trajectory.v[-1, 0]

    up, arm = np.array([0, 0, 50.0]), np.array([0.5, 0.2, 0.0])
    assert turned(**{"r/tip": up}) == pytest.approx(turned(**{"r/arm": (up, np.cross(arm, up))}), rel=1e-9)
    assert abs(turned(**{"r/tip": up})) > 1e-3
    with pytest.raises(ValueError, match=r"did you mean 'r/tip'\? body of external_force must be .*; got 'r/tipp'"):
        turned(**{"r/tipp": up})


def rod(axis=(0.0, 1.0, 0.0), placement=None):
    """A rod on a hinge at the end of it, with its shape."""
    model, shape = pin.Model(), pin.GeometryModel()
    place = pin.SE3.Identity() if placement is None else placement
    inertia = pin.Inertia(1.0, np.array([0.3, 0.0, 0.0]), 0.1 * np.eye(3))
    joint = hang(model, 0, "hinge", pin.JointModelRevoluteUnaligned(np.array(axis)), inertia, place)
    model.addBodyFrame("rod", joint, pin.SE3.Identity(), 0)
    shape.addGeometryObject(pin.GeometryObject("end", joint, 0, pin.SE3.Identity(), coal.Sphere(0.1)))
    return model, shape


@pytest.mark.parametrize(
    ("turn", "place", "words"),
    [
        (1.1 * np.eye(3), (0, 0, 0), "placement of .* must have a rotation matrix, got"),
        (np.diag([1.0, 1.0, -1.0]), (0, 0, 0), "placement of .* must have a rotation matrix, got"),
        (np.full((3, 3), np.nan), (0, 0, 0), "placement of .* must have a rotation matrix, got"),
        (np.eye(3), (np.nan, 0, 0), "translation of placement of .* must be finite, got"),
    ],
)
def test_placements_that_are_none(turn, place, words):
    """Pinocchio takes them: a link went on without its shape, or stretched and out of its place, without a word."""
    wrong, scene = pin.SE3(turn, np.array(place, dtype=float)), nd.Scene()
    model, shape = rod()
    with pytest.raises(ValueError, match=words.replace(".*", "collisions of 'r' for 'rod'")):
        scene.add_model("r", model, collisions={"rod": [(shapes.sphere(0.1), wrong)]})
    shape.geometryObjects[0].placement = wrong
    with pytest.raises(ValueError, match=words.replace(".*", "shape 'end'")):
        scene.add_model("r", model, shape)
    with pytest.raises(ValueError, match=words.replace(".*", "joint 'hinge' of 'r'")):
        scene.add_model("r", rod(placement=wrong)[0])
    assert not scene.articulations


def test_rounded_placements():
    """Rotations typed with eight digits are those next to them."""
    a = np.round(pin.utils.rotate("z", 0.3), 8)
    scene = nd.Scene()
    model, _ = rod(placement=pin.SE3(a, np.zeros(3)))
    scene.add_model("r", model, collisions={"rod": [(shapes.sphere(0.1), pin.SE3(a, np.zeros(3)))]})
    assert nd.check(nd.simulate(scene, 0.02, dt=1e-2)).passed


@pytest.mark.parametrize(
    "joint",
    [
        pin.JointModelRevoluteUnaligned(np.array([1.0, 1.0, 0.0])),
        pin.JointModelPrismaticUnaligned(np.array([0.0, 2.0, 0.0])),
        pin.JointModelHelicalUnaligned(np.array([0.0, 0.5, 0.0]), 0.1),
        pin.JointModelUniversal(np.array([0.0, 1.0, 0.0]), np.array([2.0, 0.0, 0.0])),
    ],
)
def test_axes_that_are_no_unit_vectors(joint):
    """Pinocchio turns by other angles about them."""
    model = pin.Model()
    hang(model, 0, "j", joint, pin.Inertia.Random())
    with pytest.raises(ValueError, match="axis of joint 'j' of 'r' must be of length 1, got"):
        nd.Scene().add_model("r", model)


@pytest.mark.parametrize("names", [("a", "a"), ("universe", "b")])
def test_joints_have_names_of_their_own(names):
    """By which they are found: what was driven by its name stood still."""
    model, parent = pin.Model(), 0
    for name in names:
        parent = hang(model, parent, name, pin.JointModelRX(), lump(1.0, 1.0))
    with pytest.raises(ValueError, match=f"joint '{names[0]}' of 'r' must have a name of its own, which is not"):
        nd.Scene().add_model("r", model)
