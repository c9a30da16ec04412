"""Calls of all kernels, which tests run as plain Python and look at for lost memory."""

from collections.abc import Callable
from functools import partial
from itertools import combinations_with_replacement, product
from typing import get_args, get_type_hints

import numpy as np
import pinocchio as pin

from nsdyn import compilation, solvers
from nsdyn.collision.contacts import ContactSet
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.values import Placement
from nsdyn.problem import cones, gauss, paradox, polished
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import operator
from nsdyn.scene import checks, pairs
from nsdyn.scene import named as scenes
from nsdyn.scene.scene import Scene
from nsdyn.scene.shapes import sphere
from nsdyn.solvers.continuation import continuation
from nsdyn.solvers.nesterov import Sweeps
from nsdyn.solvers.newton import newton
from nsdyn.stepping.stepper import Stepper


def lift() -> None:
    """A turning ball that begins a little in the ground."""
    scene = Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.0995), angular_velocity=(1, 2, 3))
    Stepper(scene, on_fail="ignore").step()


def jam() -> None:
    """A link that leans on a wall, which leaves its joint no way, with another that swings on it."""
    model, down = pin.Model(), np.array((0.0, 0.0, -1.0))
    for parent in (0, 1):
        joint = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), parent * down), f"j{parent}")
        model.appendBodyToJoint(joint, pin.Inertia(1.0, 0.5 * down, np.eye(3) / 12), pin.SE3.Identity())
        model.addJointFrame(joint)
    scene, tip = Scene(), {"j0": [(sphere(0.1), pin.SE3(np.eye(3), down))]}
    scene.add_halfspace("wall", normal=(1, 0, 0), offset=float(np.sin(0.3)) - 0.1)
    scene.add_model("arm", model, q=(-0.3, 0.3), v=(0.0, 8.0), collisions=tip)
    stepper = Stepper(scene, 0.01)
    for _ in range(3):
        stepper.step()


def shapes() -> None:
    """Contacts of every kind of shapes, upright and tilted, at rest and on their way."""
    scene, random = Scene(), np.random.default_rng(0)
    kinds: list[Callable[..., None]] = [
        partial(scene.add_box, size=(0.2, 0.24, 0.28)),
        partial(scene.add_sphere, radius=0.12),
        partial(scene.add_cylinder, radius=0.1, length=0.2),
        partial(scene.add_capsule, radius=0.08, length=0.2),
        partial(scene.add_ellipsoid, radii=(0.1, 0.12, 0.14)),
        partial(scene.add_convex, vertices=0.1 * random.normal(size=(24, 3))),
    ]
    for k, (tilted, pair) in enumerate(product((False, True), combinations_with_replacement(kinds, 2))):
        for above, add in enumerate(pair):
            quaternion = random.normal(size=4) if tilted else np.array([0.0, 0.0, 0.0, 1.0])
            pose = {"position": (k, 0.02 * above, 0.45 * above), "quaternion": quaternion / np.linalg.norm(quaternion)}
            add(name=f"{k}-{above}", mass=1.0, **pose)
    geoms = scene.geoms()
    detector = Detector(geoms, pairs.pair_material(scene, geoms), max_points=4)
    x = np.array([body.position for body in scene.free_bodies])
    R = np.array([checks.rotation(body.quaternion) for body in scene.free_bodies])
    near = x - np.outer(np.arange(len(x)) % 2, (0.0, 0.0, 0.25))
    none = ContactSet.empty()
    memory = detector.find(near, R, np.full(len(x), 0.1), none)
    there = Placement(near, R, ())
    touching = detector.carried(detector.touches(Placement(x, R, ()), there, memory), there, memory)[0]
    detector.gaps(touching, detector.find(near, R, np.zeros(len(x)), none), there)
    detector.carry(touching, there, Placement(x, R, ()))
    detector.ways(memory, Placement(near, R, ()), 1e-3)
    # A ball beside the border of a face of a box, deep in that.
    k = next(b for b, g in enumerate(geoms) if g.name == "1-0")
    near[k + 1], R[k] = near[k] + (0.1 + 1e-5, 0.0, 0.14 + 0.05), np.eye(3)
    detector.find(near, R, np.full(len(x), 0.1), none)
    # One box tilted over the edge of another.
    near[1] += (0.08, 0.0, 0.1)
    R[1] = checks.rotation(np.array([0.0, 0.15, 0.0, 0.99]))
    detector.find(near, R, np.full(len(x), 0.1), none)
    # A cap over a face, tilted by less than the normal of the face errs.
    scene = Scene()
    scene.add_box("box", (0.09429, 0.17267, 0.13143), 1.0)
    scene.add_cylinder("cap", 0.113, 0.11364, 1.0)
    geoms, turn = scene.geoms(), 4.75e-5 * np.array([-0.6943, 0.7197, 0.0])
    x = np.array([(0.0, 0.0, 0.0), (0.00222, -0.11274, 0.12253895524949175)])
    R = np.array([np.eye(3), checks.rotation(np.append(0.5 * turn, 1.0))])
    Detector(geoms, pairs.pair_material(scene, geoms), max_points=4).find(x, R, np.full(2, 1e-5), none)


def problems() -> None:
    """All solvers, and all means of `auto`, whatever it needs of them."""
    matrix = FC3D(np.eye(6) + 0.1, np.array([-1.0, 2.0, 0.0, -1.0, 0.1, 0.0]), np.full(2, 0.5))
    factors = Stepper(scenes.load("stack")(height=2), 5e-3).step().problem
    assert factors.blocks is not None
    for solver, problem in product(solvers.SOLVERS, (matrix, factors)):
        solvers.by_name(solver, 1e-4)(problem)
    for problem in (
        FC3D(np.eye(3), np.array([-1.0, 2.0, 0.0]), np.full(1, 0.5)),
        FC3D(factors.W, factors.q, factors.mu),
    ):
        solvers.by_name("auto")(problem)
    if "gauss_seidel" in solvers.SOLVERS:
        for local in get_args(get_type_hints(solvers.GaussSeidel)["local"]):
            solvers.GaussSeidel(1e-8, local=local)(matrix)
    smooth = FC3D.from_blocks(factors.blocks, factors.q, 0.0 * factors.mu)
    for problem in (factors, FC3D(factors.W, factors.q, factors.mu), smooth):
        W, r = operator(problem), np.zeros_like(problem.q)
        Sweeps(problem, r).run(1e-8, 4, 4)
        continuation(problem, W, r, 1e-8, 3)
        newton(problem, W, r, 0.0, 10.0, 3)
    large = Stepper(scenes.load("stack")(height=21), 5e-3).step().problem
    newton(large, operator(large), np.zeros_like(large.q), 0.0, 10.0, 3)
    for problem in (factors, Stepper(scenes.load("quadruped")(), 5e-3).step().problem):
        assert problem.blocks is not None
        slater = gauss.SlaterDirection(np.zeros(problem.blocks.n), problem.nc + 1, 1.0)
        gauss.certify(problem, np.zeros_like(problem.q), -np.ones_like(problem.q), slater)
        polished.certify(problem, np.zeros_like(problem.q))
        paradox.ambiguous(problem, problem.q, np.zeros_like(problem.q))
    polished.certify(matrix, np.zeros_like(matrix.q))


def everything() -> None:
    """What anything calls."""
    compilation.run(compilation.STEPS[0])
    Stepper(scenes.load("bounce")(), 2.0, on_fail="ignore").step()  # more bounces than are located
    Stepper(scenes.load("slide")(), 0.5).step()  # stops
    Stepper(scenes.load("quadruped")(), 1e-5).step()  # hardly moves
    Stepper(scenes.load("rod")(mu=2.0, slip=-1.0, spin=5.0), 1e-4).step()  # may move otherwise
    linkage = scenes.load("four_bar")()
    linkage.add_halfspace("ground", normal=(0, 0, 1), offset=0.08)  # on which its uprights stand
    Stepper(linkage, 1e-3, on_fail="ignore").step()
    belt = Scene()
    belt.add_box("belt", (1.0, 1.0, 0.1), position=(0, 0, -0.05), fixed=True)
    belt.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1))
    belt.set_motion("belt", surface_velocity=(1.0, 0.0, 0.0))
    Stepper(belt, 5e-3).step()
    cones.projection_jacobian(np.ones((2, 3)), np.full(2, 0.5))
    lift()
    jam()
    shapes()
    problems()
