"""What is compiled before it is needed: nothing tells what a simulation calls, and for which types, but simulating.

Each process runs small examples, the kernels as plain Python, which takes a second, and compiles what was called. All
go through the same list, and leave out what another has compiled or is compiling.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable
from functools import partial
from itertools import combinations_with_replacement, product
from typing import get_args, get_type_hints

import numpy as np

from nsdyn import solvers
from nsdyn._kernels.cache import reached
from nsdyn._kernels.compiled import Kernel, Notes
from nsdyn._kernels.problem import cones
from nsdyn.collision.contacts import ContactMemory, Poses
from nsdyn.collision.detector import Detector
from nsdyn.problem import gauss, paradox, polished
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import operator
from nsdyn.scene import checks, pairs
from nsdyn.scene import named as scenes
from nsdyn.scene.scene import Scene
from nsdyn.solvers.continuation import continuation
from nsdyn.solvers.nesterov import Sweeps
from nsdyn.solvers.newton import newton
from nsdyn.stepping.impacts import LAWS
from nsdyn.stepping.stepper import Stepper

__all__ = ["EXAMPLES", "noted", "work"]

SCENES = (
    *("arm_pushes_box", "bounce", "bricard", "bullet", "euler_disk", "gripper", "quadruped"),
    *("rattleback", "rocking", "rolling", "slider_crank", "woodpecker"),
)
"""Named scenes whose first steps call what others do."""


def _steps(name: str, count: int, impact: str = "dissipative") -> None:
    """Some steps of a named scene."""
    setup = scenes.setup(name)
    stepper = Stepper(setup.scene, **setup.options(on_fail="ignore", impact=impact))
    for _ in range(count):
        stepper.step()


def _step() -> None:
    """What most simulations of free bodies call."""
    _steps("slide", 3)
    _steps("stack", 1)


def _lift() -> None:
    """A turning ball that begins a little in the ground."""
    scene = Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.0995), angular_velocity=(1, 2, 3))
    Stepper(scene, on_fail="ignore").step()


def _shapes() -> None:
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
    none = ContactMemory.empty()
    _, memory = detector.find(near, R, np.full(len(x), 0.1), none)
    touches = detector.touches(Poses(x, R), Poses(near, R), memory)
    detector.gaps(touches.contacts, detector.find(near, R, np.zeros(len(x)), none)[0], Poses(near, R))
    detector.carry(touches.contacts, Poses(near, R), Poses(x, R))
    # One box tilted over the edge of another.
    near[1] += (0.08, 0.0, 0.1)
    R[1] = checks.rotation(np.array([0.0, 0.15, 0.0, 0.99]))
    detector.find(near, R, np.full(len(x), 0.1), none)


def _problems() -> None:
    """All solvers, and all means of `auto`, whatever it needs of them."""
    matrix = FC3D(np.eye(6) + 0.1, np.array([-1.0, 2.0, 0.0, -1.0, 0.1, 0.0]), np.full(2, 0.5))
    factors = Stepper(scenes.load("stack")(height=2), 5e-3).step().problem
    assert factors.blocks is not None
    for solver, problem in product(solvers.SOLVERS, (matrix, factors)):
        solvers.by_name(solver, 1e-4)(problem)
    solvers.by_name("auto")(FC3D(np.eye(3), np.array([-1.0, 2.0, 0.0]), np.full(1, 0.5)))
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
        opening = gauss.Opening(np.zeros(problem.blocks.n), problem.nc, 1.0)
        gauss.certify(problem, np.zeros_like(problem.q), -np.ones_like(problem.q), opening)
        polished.certify(problem, np.zeros_like(problem.q))
        paradox.ambiguous(problem, problem.q, np.zeros_like(problem.q))
    polished.certify(matrix, np.zeros_like(matrix.q))


def _all() -> None:
    """What anything calls."""
    _step()
    for name in SCENES:
        _steps(name, 3)
    for impact in LAWS:
        _steps("woodpecker", 1, impact)
    Stepper(scenes.load("bounce")(), 2.0, on_fail="ignore").step()  # more bounces than are located
    Stepper(scenes.load("quadruped")(), 1e-5).step()  # hardly moves
    belt = Scene()
    belt.add_box("belt", (1.0, 1.0, 0.1), position=(0, 0, -0.05), fixed=True)
    belt.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1))
    belt.set_motion("belt", surface_velocity=(1.0, 0.0, 0.0))
    Stepper(belt, 5e-3).step()
    _lift()
    _shapes()
    _problems()


def _contact() -> None:
    """One contact: little, for tests."""
    cones.solve_one(np.eye(3), np.array([-1.0, 2.0, 0.0]), 0.5, np.zeros(3))


EXAMPLES: dict[str, Callable[[], None]] = {"step": _step, "all": _all, "contact": _contact}


def noted(group: str) -> Notes:
    """Calls of kernels in a group of examples, which run as Python."""
    Kernel.notes = notes = Notes(patient=group != "step")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            EXAMPLES[group]()
    finally:
        Kernel.notes = None
    return notes


def work(group: str) -> None:
    """Compile what a group needs and nobody else does, and print the index of each and their number.

    First what reaches most: it takes longest.
    """
    logging.getLogger("nsdyn").setLevel(logging.ERROR)
    calls = sorted(noted(group).calls, key=lambda call: -len(reached(call[0].py_func.__module__)))
    for k, (kernel, types) in enumerate(calls):
        if kernel.compile(types, wait=False) is not None:
            os.write(1, f"{k} {len(calls)}\n".encode())
