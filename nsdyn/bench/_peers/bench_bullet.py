"""Worker of Bullet, run as a script; it runs in the Python that nsdyn runs in.

Variants: ``default``, the world with default settings, including damping; ``cone``, sequential impulses with cones,
1000 iterations (200 from five bodies on), no slop and no damping; ``dantzig``, its pivoting solver, maximal
coordinates, no damping.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pybullet
from stepping import serve


class Simulation:
    """A physics server of Bullet in this process, with one world at a time."""

    def __init__(self, scene: dict[str, Any], variant: str, dt: float) -> None:
        pybullet.resetSimulation()
        pybullet.setGravity(*scene["gravity"])
        pybullet.setPhysicsEngineParameter(fixedTimeStep=dt)
        if variant == "cone":
            iterations = 1000 if len(scene["bodies"]) < 5 else 200
            pybullet.setPhysicsEngineParameter(
                numSolverIterations=iterations, solverResidualThreshold=0.0, enableConeFriction=1, contactSlop=0.0
            )
        if variant == "dantzig":
            pybullet.setPhysicsEngineParameter(constraintSolverType=pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG)
        # Bullet multiplies the friction or restitution coefficients of two bodies.
        material = {
            "lateralFriction": math.sqrt(scene["mu"]),
            "restitution": math.sqrt(scene["restitution"]),
            "rollingFriction": 0.0,
            "spinningFriction": 0.0,
        }
        if variant != "default":
            material |= {"linearDamping": 0.0, "angularDamping": 0.0}
        maximal = variant == "dantzig"
        for ground in scene["grounds"]:
            normal = np.array(ground["normal"])
            plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal)
            fixed = pybullet.createMultiBody(
                0.0, plane, basePosition=ground["offset"] * normal, useMaximalCoordinates=maximal
            )
            pybullet.changeDynamics(fixed, -1, **material)
        self.bodies = [self.add(body, material, maximal) for body in scene["bodies"]]

    @staticmethod
    def add(body: dict[str, Any], material: dict[str, float], maximal: bool) -> int:
        """Add a body; Bullet computes the inertia from the shape."""
        if body["shape"] == "box":
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=np.array(body["size"]) / 2)
        else:
            shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=body["size"][0])
        out: int = pybullet.createMultiBody(
            body["mass"], shape, -1, body["position"], body["quaternion"], useMaximalCoordinates=maximal
        )
        pybullet.changeDynamics(out, -1, **material)
        pybullet.resetBaseVelocity(out, body["linear_velocity"], body["angular_velocity"])
        return out

    def advance(self, steps: int) -> None:
        """Take steps, one call each."""
        step = pybullet.stepSimulation
        for _ in range(steps):
            step()

    def poses(self) -> Any:
        """Return the poses of the free bodies."""
        return [[*position, *turn] for position, turn in map(pybullet.getBasePositionAndOrientation, self.bodies)]


pybullet.connect(pybullet.DIRECT)
serve(lambda scene: ["default", "cone", "dantzig"], Simulation)
