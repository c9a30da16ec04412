"""Mass matrices, Jacobians and free motion against Pinocchio's own."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import hang, lump

import nsdyn as nd
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.values import MidpointState


def mixed_scene():
    """Three free bodies at random poses in contact with each other and the ground."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (0.2, 0.3, 0.2), 1.3, position=(0, 0, 0.1), linear_velocity=(0.3, 0, 0))
    scene.add_sphere("ball", 0.1, 0.7, position=(0.02, 0.03, 0.3), angular_velocity=(0, 3, 1))
    scene.add_cylinder(
        "roller",
        0.1,
        0.3,
        2.0,
        position=(0.5, 0, 0.1),
        quaternion=(0, np.sqrt(0.5), 0, np.sqrt(0.5)),
        angular_velocity=(1, 0, 2),
    )
    return scene


def middle(stepper: nd.Stepper) -> MidpointState:
    """Where the impulses of the next step act."""
    d, now = stepper.dynamics, stepper.get_state().instant
    return d.halfway(now.position, now.v, stepper.dt, stepper.theta, d.surfaces.twists(stepper.t))


def test_free_bodies_against_one_pinocchio_model():
    """M, H and W of a step, in Pinocchio's free-flyer coordinates, against its mass matrix and frame Jacobians."""
    scene = mixed_scene()
    stepper = nd.Stepper(scene, dt=1e-3)
    d, half = stepper.dynamics, middle(stepper)
    there = half.placement
    c = stepper.detector.find(there.x, there.R, np.full(3, 1e-2), ContactSet.empty())
    rows, frames = d.rows(c, there, d.inertia(half.position, half.v), None)
    problem = nd.FC3D.from_blocks(rows.blocks, np.zeros(3 * c.gap.size), c.mu)
    M, H = rows.full.dense()

    model = pin.Model()
    for body in scene.free_bodies:
        hang(model, 0, body.name, pin.JointModelFreeFlyer(), lump(body.mass, body.inertia))
    q = np.concatenate([np.r_[there.x[b], pin.Quaternion(there.R[b].copy()).coeffs()] for b in range(3)])
    data = model.createData()
    # Pinocchio's linear velocity is in body axes: v = T v_pin with T = diag(R, I) per body.
    T = np.zeros((18, 18))
    for b in range(3):
        T[6 * b : 6 * b + 3, 6 * b : 6 * b + 3], T[6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = (
            there.R[b],
            np.eye(3),
        )
    np.testing.assert_allclose(T.T @ M @ T, pin.crba(model, data, q), rtol=0, atol=1e-12)

    pin.computeJointJacobians(model, data, q)
    expected = np.zeros((18, H.shape[1]))
    assert c.gap.size > 6
    for k in range(c.gap.size):
        for frame, sign in ((c.frame1[k], -1.0), (c.frame2[k], 1.0)):
            if frame >= 0:
                J = pin.getJointJacobian(model, data, int(frame) + 1, pin.LOCAL_WORLD_ALIGNED)
                at_point = J[:3] - pin.skew(c.point[k] - there.x[frame]) @ J[3:]
                expected[:, 3 * k : 3 * k + 3] += sign * (frames[k] @ at_point).T
    np.testing.assert_allclose(T.T @ H, expected, rtol=0, atol=1e-12)
    W = expected.T @ np.linalg.solve(pin.crba(model, data, q), expected)
    np.testing.assert_allclose(problem.W.toarray(), W, rtol=0, atol=1e-12 * np.abs(W).max())
    np.testing.assert_array_equal(problem.W.toarray(), problem.W.toarray().T)


def test_tree_and_body_against_pinocchio():
    """The arm in contact with the cube: W couples the tree and the free body."""
    stepper = nd.Stepper(nd.scenes.load("arm_pushes_box")(), dt=2e-3)
    for _ in range(500):
        step = stepper.step()
        if ((step.contacts.frame1 >= 0) & (step.contacts.frame2 >= 0)).any():
            break
    else:
        pytest.fail("the arm never touches the box")
    # That step was cut at the impact.
    there = middle(stepper)
    step = stepper.step()
    M, H = step.problem.blocks.dense()
    d, tree = stepper.dynamics, stepper.dynamics.trees[0]
    model, data = tree.model, tree.model.createData()
    q = there.position.trees[0]
    np.testing.assert_allclose(M[6:, 6:], pin.crba(model, data, q), rtol=0, atol=1e-12)
    pin.computeJointJacobians(model, data, q)
    pin.framesForwardKinematics(model, data, q)
    c = step.contacts
    k = int(np.flatnonzero((c.frame1 >= 0) & (c.frame2 >= 0))[0])
    frame = c.frame1[k] if c.frame1[k] > 0 else c.frame2[k]
    sign = -1.0 if c.frame1[k] > 0 else 1.0
    joint = tree.joints[frame - tree.frames.start]
    J = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
    at_point = J[:3] - pin.skew(c.point[k] - data.oMi[joint].translation) @ J[3:]
    np.testing.assert_allclose(H[6:, 3 * k : 3 * k + 3], sign * (step.frame[k] @ at_point).T, rtol=0, atol=1e-12)
    W = H.T @ np.linalg.solve(M, H)
    np.testing.assert_allclose(step.problem.W.toarray(), W, rtol=0, atol=1e-12 * np.abs(W).max())
    assert np.abs(step.problem.W.toarray()[3 * k : 3 * k + 3]).sum() > 0 and d.n == 6 + model.nv


def test_rows_are_gap_rates(rng):
    """u_N is d(gap)/dt and u the relative velocity, by differences along the motion."""
    scene = mixed_scene()
    stepper = nd.Stepper(scene, dt=1e-3)
    d = stepper.dynamics
    position, _ = d.start()
    v = rng.normal(size=d.n)
    h, reach = 1e-6, np.full(3, 1e-3)
    here = d.place(position)
    contacts = stepper.detector.find(here.x, here.R, reach, ContactSet.empty())
    gaps = []
    for s in (-h, h):
        there = d.place(d.shift(position, s * v))
        gaps.append(stepper.detector.find(there.x, there.R, reach, contacts))
    rows, _ = d.rows(contacts, here, d.inertia(position, v), None)
    same = (gaps[0].key[:, None] == contacts.key).any(axis=0) & (gaps[1].key[:, None] == contacts.key).any(axis=0)
    assert same.sum() >= 5
    for k in np.flatnonzero(same):
        low, high = (float(g.gap[g.key == contacts.key[k]][0]) for g in gaps)
        # Curvature is of order 1/m: h² and round-off / h.
        assert rows.full.relative_velocity(v)[3 * k] == pytest.approx((high - low) / (2 * h), abs=1e-5)


def test_initial_velocity_is_in_world_axes():
    scene = nd.Scene(gravity=(0, 0, 0))
    turned = (0, 0, np.sqrt(0.5), np.sqrt(0.5))
    scene.add_box("b", (0.1, 0.2, 0.3), 1.0, quaternion=turned, linear_velocity=(1, 0, 0), angular_velocity=(0, 0, 2))
    trajectory = nd.simulate(scene, 0.01)
    body = trajectory.body("b")
    np.testing.assert_allclose(body.linear_velocity, [[1, 0, 0]] * 11, rtol=0, atol=1e-15)
    np.testing.assert_allclose(body.angular_velocity, [[0, 0, 2]] * 11, rtol=0, atol=1e-14)
    # Pinocchio's layout: the linear velocity in body axes, turned by -90 degrees about z.
    np.testing.assert_allclose(trajectory.v[0], [0, -1, 0, 0, 0, 2], rtol=0, atol=1e-15)
    assert Dynamics(scene).n == 6


def test_links_reach_as_far_as_their_shapes():
    """Speed of the link's origin, plus its spin times the size of what hangs on it, plus the fall."""
    scene = nd.scenes.load("spinning_disk")(speed=1.0, spin=10.0, radius=0.1, rings=2, sectors=3)
    dynamics = Dynamics(scene)
    position, v = dynamics.start()
    there = dynamics.place(position)
    x, y = there.x[:, 0], there.x[:, 1]
    speed = np.hypot(1.0 - 10.0 * y, 10.0 * x)
    still = dynamics.surfaces.twists(0.0)
    # Half a step, in which gravity has given the speed of a whole one.
    expected = 5e-4 * (speed + 10.0 * 0.005) + 5e-4 * 9.81e-3
    np.testing.assert_allclose(dynamics.reach(there, v, 5e-4, 1e-3, still), expected, rtol=1e-12)
