"""Worker of Siconos, for the system's Python and Debian's python3-siconos; imports nothing of nsdyn.

It builds the objects of ``siconos.io.mechanics_run`` without its files: Moreau–Jean's scheme with θ = 0.50001, contacts
from Bullet, block Gauss–Seidel. Variants: ``default``, its default settings; ``accurate``, a solver tolerance of 1e-10
with up to 10 000 sweeps, no perturbed contacts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import siconos.kernel as sk
import siconos.numerics as sn
from scipy.spatial.transform import Rotation
from siconos.mechanics import collision
from siconos.mechanics.collision import bullet
from stepping import THICKNESS, WIDTH, serve

THETA = 0.50001
MARGIN = 0.02  # fraction of a shape's smallest dimension by which Bullet shrinks it to find contacts


class Simulation:
    """A nonsmooth dynamical system of Siconos and its time-stepping."""

    def __init__(self, scene: dict[str, Any], variant: str, dt: float) -> None:
        accurate = variant == "accurate"
        self.system = sk.NonSmoothDynamicalSystem(0.0, 1e6)
        options = bullet.SiconosBulletOptions()
        if accurate:
            options.perturbationIterations = options.minimumPointsPerturbationThreshold = 0
        manager = bullet.SiconosBulletCollisionManager(options)
        manager.useEqualityConstraints(False)
        manager.insertNonSmoothLaw(sk.NewtonImpactFrictionNSL(scene["restitution"], 0.0, scene["mu"], 3), 0, 0)
        # Siconos refers to some of the objects without owning them.
        self.kept: list[Any] = [options, manager]
        for ground in scene["grounds"]:
            self.insert(manager, ground)
        self.bodies = [self.add(body, scene["gravity"]) for body in scene["bodies"]]
        osi = sk.MoreauJeanOSI(THETA)
        problem = sk.FrictionContact(3)
        problem.setMStorageType(sn.NM_SPARSE_BLOCK)
        problem.setKeepLambdaAndYState(True)
        if accurate:
            chosen = problem.numericsSolverOptions()
            chosen.dparam[sn.SICONOS_DPARAM_TOL], chosen.iparam[sn.SICONOS_IPARAM_MAX_ITER] = 1e-10, 10_000
        steps = sk.TimeDiscretisation(0.0, dt)
        self.stepping = sk.TimeStepping(self.system, steps)
        self.stepping.insertIntegrator(osi)
        self.stepping.insertNonSmoothProblem(problem)
        self.stepping.insertInteractionManager(manager)
        self.stepping.setNewtonOptions(sk.SICONOS_TS_NONLINEAR)
        self.stepping.setNewtonMaxIteration(20)
        self.stepping.setNewtonTolerance(1e-10)
        self.kept += [osi, problem, steps]

    def insert(self, manager: Any, ground: dict[str, Any]) -> None:
        """Add a fixed half-space as a box whose z axis is its normal: a plane would keep contacts that have ended."""
        normal = np.array(ground["normal"])
        x, y, z = normal
        q = np.array([1.0 + z, -y, x, 0.0]) if z > -1.0 else np.array([0.0, 1.0, 0.0, 0.0])
        pose = [*((ground["offset"] - THICKNESS / 2) * normal), *(q / np.linalg.norm(q))]
        box, contactors = collision.SiconosBox(WIDTH, WIDTH, THICKNESS), collision.SiconosContactorSet()
        contactors.append(collision.SiconosContactor(box))
        manager.insertStaticContactorSet(contactors, pose)
        self.kept += [box, contactors]

    def add(self, body: dict[str, Any], gravity: list[float]) -> Any:
        """Add a body; its angular velocity is in body axes, its quaternion begins with w."""
        x, y, z, w = body["quaternion"]
        pose = [*body["position"], w, x, y, z]
        v = [*body["linear_velocity"], *Rotation.from_quat(body["quaternion"]).inv().apply(body["angular_velocity"])]
        out = collision.RigidBodyDS(pose, v, body["mass"], np.diag(body["inertia"]))
        out.setUseContactorInertia(False)
        if body["shape"] == "box":
            shape = collision.SiconosBox(*body["size"])
            shape.setInsideMargin(min(body["size"]) * MARGIN)
        else:
            shape = collision.SiconosSphere(body["size"][0])
            shape.setInsideMargin(body["size"][0] * MARGIN)
        shape.setOutsideMargin(0.0)
        contactors = collision.SiconosContactorSet()
        contactors.append(collision.SiconosContactor(shape))
        out.setContactors(contactors)
        weight = body["mass"] * np.array(gravity)
        out.setFExtPtr(weight)
        self.kept += [shape, contactors, weight]
        self.system.insertDynamicalSystem(out)
        return out

    def advance(self, steps: int) -> None:
        """Take steps with the loop of mechanics_run."""
        for _ in range(steps):
            self.stepping.computeOneStep()
            self.stepping.nextStep()

    def poses(self) -> Any:
        """Return the poses of the bodies."""
        return np.array([np.array(body.q())[[0, 1, 2, 4, 5, 6, 3]] for body in self.bodies])


serve(lambda scene: ["default", "accurate"], Simulation)
