"""Articulated trees in a scene: what is read from robot files and models, and their matrices against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

import nsdyn as nd
from nsdyn import shapes


def loaded(robot, **keywords):
    path, package_dirs = robot
    scene = nd.Scene()
    with pytest.warns(UserWarning, match=r"'r' leaves out: joint 'jc': <mimic> of 'ja'"):
        scene.add_urdf("r", path, package_dirs=package_dirs, **keywords)
    return scene, scene.articulations["r"]


def test_neighbours_are_not_tested(robot):
    scene, a = loaded(robot)
    names = [link.name for link in a.links]
    pairs = {frozenset((names[i], names[j])) for i, j in a.excluded}
    assert frozenset(("base_0", "a_0")) in pairs and frozenset(("c_0", "tip_0")) in pairs
    assert frozenset(("base_0", "b_0")) not in pairs and frozenset(("a_0", "c_0")) not in pairs
    scene.add_sphere("ball", 0.1, 1.0, position=(5, 0, 0))
    geoms = scene.geoms()
    assert {frozenset((geoms[i].name[2:], geoms[j].name[2:])) for i, j in scene.excluded(geoms)} == pairs


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
        ("base_0", 0), ("b_0", 2), ("c_0", 3), ("tip_0", 3), ("tip_1", 3),
    ]  # fmt: skip
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
        robot, base="free", friction=(1, 2, 3), damping=np.arange(9), stiffness=(3, 0, 4), rest=(0.1, 0, 0.2),
        v=(5, 6, 7), limits=False, restitution=0.5,
    )  # fmt: skip
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


def test_loop():
    model, _ = pendulum()
    scene = nd.Scene()
    scene.add_model("p", model, q=(0.5,))
    scene.add_loop("p", "pin", "bob", position=(0, 0, 0.2))
    (loop,) = scene.articulations["p"].loops
    assert (loop.joint1, loop.joint2, loop.kind) == (1, 0, "point")
    # Where the point 0.8 m down the rod is at 0.5 rad.
    np.testing.assert_allclose(loop.placement2.translation, (-0.8 * np.sin(0.5), 0, -0.8 * np.cos(0.5)), atol=1e-15)
    for change, words in (
        ({"articulation": "x"}, "articulation must be one of"),
        ({"frame1": "x"}, "frame1 of 'other' must be a frame"),
        ({"kind": "x"}, "kind of 'other' must be"),
        ({"name": "pin"}, "name must be unique among the loops"),
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
        ({"v": (0, 0, np.nan)}, "v of 'r' must be finite"),
        ({"base": "loose"}, "base of 'r' must be 'fixed' or 'free'"),
        ({"position": (0, 0)}, "position of 'r'"),
        ({"quaternion": (1, 0, 0, 1)}, "quaternion of 'r'"),
        ({"material": 0.4}, "material of 'r' must be a nsdyn.Material, got 0.4"),
        ({"material": {"z": nd.Material()}}, "material of 'r' names 'z'"),
        ({"material": {"a": 0.4}}, "material of 'r' must be a nsdyn.Material, got 0.4"),
        ({"friction": (-1, 0, 0)}, "friction of 'r' must not be negative"),
        ({"stiffness": (0, -1, 0)}, "stiffness of 'r' must not be negative"),
        ({"base": "free", "stiffness": np.ones(9)}, "stiffness of 'r' must be 0 in joint 'root_joint'"),
        ({"restitution": 2.0}, r"restitution must lie in \[0, 1\]"),
        ({"limits": 1}, "limits of 'r' must be True or False"),
        ({"self_collisions": 0}, "self_collisions of 'r' must be True or False"),
        ({"collisions": {"z": []}}, "collisions of 'r' names 'z'"),
        ({"collisions": {"a": [1.0]}}, r"collisions of 'r' must be shapes or \(Shape, SE3\)"),
        ({"collisions": "visual"}, "collisions of 'r' must be True, False or"),
        ({"srdf": "nowhere.srdf"}, "srdf of 'r' must be an SRDF file"),
        ({"package_dirs": ()}, r"mesh 'package://thing/box.stl' was not found"),
        ({"colour": (1, 0, 0)}, "unknown argument 'colour'"),
    ],
)
def test_refused(robot, change, words):
    path, package_dirs = robot
    scene = nd.Scene()
    with pytest.raises(ValueError, match=words):
        scene.add_urdf("r", path, **{"package_dirs": package_dirs} | change)
    assert not scene.articulations, "a refused robot leaves the scene as it was"


ARTICULATED = [name for name in nd.scenes.names() if nd.scenes.load(name)().articulations]


@pytest.mark.parametrize("name", ARTICULATED)
def test_step_against_dense_pinocchio(name):
    """M, H, W and the free acceleration of a step with contacts (if any in 0.5 s) against Pinocchio's dense ones.

    Inverse masses of trees with closed loops or driven joints B v = b are those of the motions with B v = 0.
    """
    stepper = nd.Stepper(nd.scenes.load(name)(), dt=nd.scenes.module(name).DT)
    d, h = stepper.dynamics, stepper.dt
    while True:
        before = stepper.get_state()
        step = stepper.step()
        links = (step.contacts.frame1 >= d.free) | (step.contacts.frame2 >= d.free)
        if links.any() or stepper.t > 0.5:
            break
    middle = d.advance(before.position, before.v, 0.5 * h, d.surfaces.twists(before.t))
    d.evaluate(middle)
    free_motion = before.v, before.next_t, h, stepper.theta, before.history.push, None, None
    d.free_velocity(before.position, middle, *free_motion)
    c, nc = step.contacts, step.contacts.gap.size
    M, H = d.blocks(c)[0].dense()
    M_pin, H_pin, inverse = M.copy(), np.zeros_like(H), np.linalg.inv(M)
    M_pin[6 * d.free :, 6 * d.free :] = 0.0
    sides = [(k, s, (c.frame1 if s < 0 else c.frame2)[k]) for k in range(nc) for s in (-1, 1)]
    for k, sign, frame in sides:
        if 0 <= frame < d.free:
            at_point = np.hstack((np.eye(3), -pin.skew(c.point[k] - d.x[frame]) @ d.R[frame]))
            H_pin[6 * frame : 6 * frame + 6, 3 * k : 3 * k + 3] += sign * (step.frame[k] @ at_point).T
    for t, q in zip(d.trees, middle.trees, strict=True):
        model, data, rows = t.model, t.model.createData(), t.coordinates
        mass = dense_mass(model, data, q)
        M_pin[rows, rows] = mass + 0.5 * h * np.diag(t.damping + 0.5 * h * t.stiffness)
        pin.computeJointJacobians(model, data, q)
        for k, sign, frame in sides:
            if t.frames.start <= frame < t.frames.stop:
                joint = t.joints[frame - t.frames.start]
                J = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
                at_point = J[:3] - pin.skew(c.point[k] - data.oMi[joint].translation) @ J[3:]
                H_pin[rows, 3 * k : 3 * k + 3] += sign * (step.frame[k] @ at_point).T
        inverse[rows, rows] = np.linalg.inv(M_pin[rows, rows])
        if t.constrained:
            N = inverse[rows, rows]
            inverse[rows, rows] = N - N @ t.B.T @ np.linalg.pinv(t.B @ N @ t.B.T, rcond=1e-12) @ t.B @ N
    W = H_pin.T @ inverse @ H_pin
    # The bar of all three, relative to the largest entry.
    np.testing.assert_allclose(M, M_pin, atol=1e-10 * np.abs(M_pin).max())
    np.testing.assert_allclose(H, H_pin, atol=1e-10 * np.abs(H_pin).max(initial=1.0))
    W_contacts = step.problem.W.toarray()[: 3 * nc, : 3 * nc]
    np.testing.assert_allclose(W_contacts, W, atol=1e-10 * np.abs(W).max(initial=1.0))


@pytest.mark.parametrize("name", ARTICULATED)
def test_free_acceleration_against_pinocchio(name):
    """M a + D v + K (q - rest) + bias(q, v) = 0 on admissible motions, at the mean velocity of a very short step."""
    scene = nd.scenes.load(name)()
    stepper = nd.Stepper(scene, dt=nd.scenes.module(name).DT)
    while stepper.t < 0.1:
        stepper.step()
    d, state, h = stepper.dynamics, stepper.get_state(), 1e-5
    middle = d.advance(state.position, state.v, 0.5 * h)
    d.evaluate(middle)
    v, _ = d.free_velocity(state.position, middle, state.v, state.t + h, h, 0.5, np.zeros(d.n), None, None)
    a, mean = (v - state.v) / h, 0.5 * (v + state.v)
    for t, begin, q in zip(d.trees, state.position.trees, middle.trees, strict=True):
        rows, data = t.coordinates, t.model.createData()
        inertial = dense_mass(t.model, data, q) @ a[rows]
        bias = pin.nonLinearEffects(t.model, data, q, mean[rows])
        springs = t.stiffness * (t.angle(begin) + 0.5 * h * mean[rows] - t.rest)
        Z = t.Z if t.constrained else np.eye(t.model.nv)
        force = Z.T @ (inertial + t.damping * mean[rows] + springs + bias)
        scale = max(1.0, np.abs(Z.T @ inertial).max(initial=0.0), np.abs(Z.T @ bias).max(initial=0.0))
        # The term of order h² that conserves the energy, and round-off / h.
        assert np.abs(force).max(initial=0.0) <= ((h * np.abs(mean[rows]).max()) ** 2 + 1e-8) * scale


def dense_mass(model, data, q):
    M = pin.crba(model, data, q)
    return np.triu(M) + np.triu(M, 1).T
