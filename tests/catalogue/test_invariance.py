"""Symmetries that a simulation must have, and inputs at the edge of what it can take."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import drift, penetration

import nsdyn as nd
from nsdyn.scene import shapes

# -- case 47: invariance -----------------------------------------------------------------------------------------------


def scaled(shape, factor):
    """The shape with all lengths multiplied."""
    size = shape.size * factor
    match shape.kind:
        case shapes.SPHERE:
            return shapes.sphere(size[0])
        case shapes.CAPSULE:
            return shapes.capsule(size[0], 2 * size[1])
        case shapes.CYLINDER:
            return shapes.cylinder(size[0], 2 * size[1])
        case shapes.ELLIPSOID:
            return shapes.ellipsoid(size)
        case shapes.POLYTOPE if size.any():
            return shapes.box(size)
    return shapes.convex(shape.vertices * factor)[0]


def transformed(scene, turn=None, shift=(0, 0, 0), boost=(0, 0, 0), mass=1.0, length=1.0, order=None):
    """The same scene turned, moved, in a moving frame, heavier, larger (gravity and speeds as well), in other order."""
    Q = pin.Quaternion(1.0, 0.0, 0.0, 0.0) if turn is None else turn
    R, shift, boost = Q.toRotationMatrix(), np.array(shift, float), np.array(boost, float)
    out = nd.Scene(gravity=length * (R @ scene.gravity), name=scene.name)
    bodies = list(scene.bodies.values())
    for k in range(len(bodies)) if order is None else order:
        b = bodies[k]
        if b.shape.kind == shapes.HALFSPACE:
            normal = R @ b.shape.size
            out.add_halfspace(b.name, normal, length * b.shape.offset + normal @ shift, material=b.material)
            continue
        quaternion = (Q * pin.Quaternion(b.quaternion)).coeffs()
        out.bodies[b.name] = replace(
            b,
            shape=b.shape if length == 1.0 else scaled(b.shape, length),
            mass=mass * b.mass,
            inertia=mass * length**2 * b.inertia,
            com=length * b.com,
            position=length * (R @ b.position) + shift,
            quaternion=quaternion / np.linalg.norm(quaternion),
            linear_velocity=np.zeros(3) if b.fixed else length * (R @ b.linear_velocity) + boost,
            angular_velocity=R @ b.angular_velocity,
        )
    out.pairs.update(scene.pairs)
    return out


def motion(scene, duration, dt):
    """Positions, velocities and spins (steps, bodies, 3) of the free bodies, sorted by name."""
    trajectory = nd.simulate(scene, duration, dt=dt, solver=nd.solvers.Auto(tol=1e-10))
    bodies = [trajectory.body(name) for name in sorted(b.name for b in scene.free_bodies)]
    parts = [
        np.stack([getattr(b, part) for b in bodies], axis=1)
        for part in ("position", "linear_velocity", "angular_velocity")
    ]
    return trajectory.t[:, None, None], *parts


SCENES = {
    "collisions": ({}, 0.6, 3e-3),
    "slide": ({"heading": 30.0}, 0.5, 5e-3),
    "groove": ({"mu": 0.1}, 0.3, 5e-3),
    "rattleback": ({}, 0.2, 1e-3),
    "bounce": ({"height": 0.2}, 1.0, 5e-3),
    "arch": ({"thickness": 0.108}, 0.1, 5e-3),
    "pyramid": ({"base": 3}, 0.2, 1e-2),
    "domino": ({"count": 3}, 0.1, 1e-3),
}
"""Only motions that Coulomb's law determines, and that do not depend on round-off."""


@pytest.fixture(scope="module", params=SCENES)
def case(request):
    parameters, duration, dt = SCENES[request.param]
    scene = nd.scenes.load(request.param)(**parameters)
    return scene, duration, dt, motion(scene, duration, dt)


BAR = 1e-9


@pytest.mark.case(47)
def test_turned_scene(case):
    scene, duration, dt, (_, x, v, w) = case
    turn = np.random.default_rng(4).normal(size=4)
    Q = pin.Quaternion(turn / np.linalg.norm(turn))
    R = Q.toRotationMatrix()
    _, y, u, s = motion(transformed(scene, turn=Q), duration, dt)
    for before, after in ((x, y), (v, u), (w, s)):
        np.testing.assert_allclose(after, before @ R.T, rtol=0, atol=BAR * max(1.0, np.abs(before).max()))


@pytest.mark.case(47)
def test_moved_scene(case):
    scene, duration, dt, (_, x, v, w) = case
    shift = np.array([3.0, -7.0, 2.0])
    _, y, u, s = motion(transformed(scene, shift=shift), duration, dt)
    for before, after in ((x + shift, y), (v, u), (w, s)):
        np.testing.assert_allclose(after, before, rtol=0, atol=BAR * max(1.0, np.abs(before).max()))


@pytest.mark.case(47)
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_heavier_scene(case, factor):
    scene, duration, dt, (_, x, v, w) = case
    _, y, u, s = motion(transformed(scene, mass=factor), duration, dt)
    for before, after in ((x, y), (v, u), (w, s)):
        np.testing.assert_allclose(after, before, rtol=0, atol=BAR * max(1.0, np.abs(before).max()))


@pytest.mark.case(47)
@pytest.mark.parametrize("factor", [0.3, 30.0])
def test_larger_scene(case, factor):
    """Lengths, speeds and gravity by one factor, so that times stay."""
    scene, duration, dt, (_, x, v, w) = case
    _, y, u, s = motion(transformed(scene, length=factor), duration, dt)
    for before, after in ((x, y / factor), (v, u / factor), (w, s)):
        np.testing.assert_allclose(after, before, rtol=0, atol=BAR * max(1.0, np.abs(before).max()))


@pytest.mark.case(47)
def test_bodies_in_another_order(case):
    scene, duration, dt, (_, x, v, w) = case
    order = np.random.default_rng(5).permutation(len(scene.bodies))
    _, y, u, s = motion(transformed(scene, order=order), duration, dt)
    for before, after in ((x, y), (v, u), (w, s)):
        np.testing.assert_allclose(after, before, rtol=0, atol=BAR * max(1.0, np.abs(before).max()))


@pytest.mark.case(47)
@pytest.mark.parametrize("dt", [2e-3, 5e-3])
def test_galilean_shift(dt):
    """A uniformly moving observer sees the same collisions; there are no fixed bodies to tell who moves."""
    scene = nd.scenes.load("collisions")()
    t, x, v, w = motion(scene, 0.6, dt)
    boost = np.array([3.0, -2.0, 1.0])
    _, y, u, s = motion(transformed(scene, boost=boost), 0.6, dt)
    assert np.abs(v[-1] - v[0] - 0.6 * scene.gravity).max() > 0.1, "they met"
    np.testing.assert_allclose(y, x + t * boost, rtol=0, atol=BAR)
    np.testing.assert_allclose(u, v + boost, rtol=0, atol=BAR)
    np.testing.assert_allclose(s, w, rtol=0, atol=BAR)


# -- case 48: degenerate input -----------------------------------------------------------------------------------------


@pytest.mark.case(48)
@pytest.mark.parametrize("mu", [0.0, 10.0])
def test_extreme_friction(mu):
    """A plate on a slope of 80 degrees slides freely without friction and hangs on with mu = 10."""
    angle = np.radians(80.0)
    scene = nd.Scene(gravity=(9.81 * np.sin(angle), 0, -9.81 * np.cos(angle)))
    scene.add_halfspace("slope", material=nd.Material(mu))
    scene.add_box("plate", (0.5, 0.5, 0.02), 1.0, position=(0, 0, 0.01), material=nd.Material(mu))
    trajectory = nd.simulate(scene, 0.5, dt=1e-2)
    x = trajectory.body("plate").position[:, 0]
    expected = 0.0 if mu else 0.5 * 9.81 * np.sin(angle) * trajectory.t**2
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-12)


def two_walls(approach, slip=0.0, mu=0.5):
    """One free particle of 1 kg between two walls that come closer at `approach` [m/s] each, sliding by `slip`."""
    H = np.zeros((3, 6))
    H[:, :3], H[:, 3:] = np.eye(3), np.diag([-1.0, 1.0, 1.0])
    return nd.FC3D(H.T @ H, np.array([-approach, slip, 0.0, -approach, slip, 0.0]), np.array([mu, mu]))


SOLVERS = [
    "aclm",
    "auto",
    "continuation",
    "fixed_point",
    "impulse_newton",
    "interior",
    "newton",
    "panagiotopoulos",
    "pgs",
    "tresca",
]


PATIENT = "aclm", "panagiotopoulos", "tresca"  # a thousand convex problems of two thousand sweeps each


@pytest.mark.case(48)
@pytest.mark.parametrize("solver", [pytest.param(s, marks=pytest.mark.slow if s in PATIENT else []) for s in SOLVERS])
@pytest.mark.parametrize("slip", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_walls_that_leave_no_room_are_reported(solver, slip):
    """No velocity is admissible."""
    assert not nd.solve(two_walls(1.0, slip), solver=solver, tol=1e-8).converged


@pytest.mark.case(48)
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("slip", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_an_impulse_in_which_q_drowns_is_no_solution(solver, slip):
    """Between walls that leave no room, from 0 and from where the relative error is 0; walls that just do are solved.

    A few iterations tell: more do not lead away from there.
    """
    few = nd.solvers.by_name(solver, 1e-8)
    if hasattr(few, "max_iter"):
        few = replace(few, max_iter=3)
    for normal in (0.0, 1e16):
        assert not nd.solve(two_walls(1.0, slip), few, r0=np.tile([normal, 0.0, 0.0], 2)).converged
    assert nd.solve(two_walls(0.0, slip), solver=solver, tol=1e-8).converged


@pytest.mark.case(48)
@pytest.mark.parametrize("solver", SOLVERS)
def test_nothing_to_do(solver):
    """q = 0: no impulse and no motion."""
    solution = nd.solve(two_walls(0.0), solver=solver, tol=1e-12)
    assert solution.converged and np.abs(solution.u).max() <= 1e-12


@pytest.mark.case(48)
@pytest.mark.parametrize("solver", SOLVERS)
def test_every_contact_ten_times(solver):
    """The velocity and the sum of the copies' impulses on the body are those of the contacts once."""
    problem = nd.Stepper(nd.scenes.load("slide")(mu=0.5), dt=1e-2).step().problem
    M, H = problem.blocks.dense()
    once = np.linalg.solve(M, H @ nd.solve(problem, tol=1e-12).r)
    H = np.tile(H, 10)
    copies = nd.FC3D(H.T @ np.linalg.solve(M, H), np.tile(problem.q, 10), np.tile(problem.mu, 10))
    solution = nd.solve(copies, solver=solver, tol=1e-8)
    assert solution.converged
    # The tolerance, through impulses that are not unique.
    np.testing.assert_allclose(np.linalg.solve(M, H @ solution.r), once, rtol=0, atol=1e-6)


@pytest.mark.case(48)
def test_parallel_edges():
    """A cube balanced with an edge on the edge of another: no cross product tells the normal."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    eighth = (np.sin(np.pi / 8), 0, 0, np.cos(np.pi / 8))
    half = np.sqrt(0.5) * 0.2
    scene.add_box("below", (0.4, 0.2, 0.2), fixed=True, position=(0, 0, 0.3), quaternion=eighth)
    scene.add_box("above", (0.2, 0.2, 0.2), 1.0, position=(0, 1e-3, 0.3 + 2 * half), quaternion=eighth)
    trajectory = nd.simulate(scene, 1.5, dt=2e-3)
    assert (trajectory.solver.status == nd.Status.CONVERGED).all()
    assert np.abs(trajectory.energy.defect).max() <= 1e-12
    assert penetration(trajectory) <= 1e-8
    for k in range(1, len(trajectory.t), 25):
        contacts = trajectory.contacts(k)
        assert np.allclose(np.linalg.norm(contacts.normal, axis=1), 1.0, rtol=0, atol=1e-12)
    assert trajectory.body("above").position[-1, 2] < 0.2, "it fell off"


@pytest.mark.case(48)
def test_frozen_bodies():
    """Fixed bodies that overlap each other are no contacts; a scene of nothing else stands still, and says so."""
    scene = nd.Scene()
    scene.add_box("a", (1, 1, 1), fixed=True)
    scene.add_box("b", (1, 1, 1), fixed=True, position=(0.5, 0, 0))
    with pytest.warns(UserWarning, match="the scene has nothing that moves"):
        trajectory = nd.simulate(scene, 0.01, dt=1e-3)
    assert all(len(trajectory.contacts(k)) == 0 for k in range(1, 11))
    scene.add_sphere("mote", 0.1, 1e-12, position=(0, 0, 0.6))
    assert drift(nd.simulate(scene, 0.1, dt=1e-3)) <= 1e-12
