"""Worker of DART, run as a script; it runs in the Python that nsdyn runs in.

Variants: ``default``, a world with default settings, where bodies at rest are put to sleep. The other two have no sleep
and DART's own collision detector: ``dantzig``, the same pivoting solver with friction in boxes, and ``nsgs``, its
Gauss–Seidel solver with Coulomb's cones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from dartpy import collision, constraint, dynamics, math, simulation
from stepping import THICKNESS, WIDTH, serve


class Simulation:
    """A DART world made from a scene."""

    def __init__(self, scene: dict[str, Any], variant: str, dt: float) -> None:
        self.world = simulation.World()
        self.world.setTimeStep(dt)
        self.world.setGravity(scene["gravity"])
        if variant != "default":
            solver = self.world.getConstraintSolver()
            solver.setCollisionDetector(collision.DARTCollisionDetector())
            if variant == "nsgs":
                solver.setBoxedLcpSolver(constraint.NsgsFrictionSolver())
            options = self.world.getDeactivationOptions()
            options.mEnabled = False
            self.world.setDeactivationOptions(options)
        for k, ground in enumerate(scene["grounds"]):
            skeleton = dynamics.Skeleton(f"ground{k}")
            joint, node = skeleton.createWeldJointAndBodyNodePair()
            normal = np.array(ground["normal"])
            pose = math.Isometry3()
            pose.set_rotation(turned(normal))
            pose.set_translation((ground["offset"] - THICKNESS / 2) * normal)
            joint.setTransformFromParentBodyNode(pose)
            self.give(node, dynamics.BoxShape([WIDTH, WIDTH, THICKNESS]), scene)
            self.world.addSkeleton(skeleton)
        self.bodies = [self.add(f"body{k}", body, scene) for k, body in enumerate(scene["bodies"])]

    def add(self, name: str, body: dict[str, Any], scene: dict[str, Any]) -> Any:
        """Add a free body; its velocity is in body axes, angular first."""
        skeleton = dynamics.Skeleton(name)
        joint, node = skeleton.createFreeJointAndBodyNodePair()
        node.setInertia(dynamics.Inertia(body["mass"], np.zeros(3), np.diag(body["inertia"])))
        box = body["shape"] == "box"
        self.give(node, dynamics.BoxShape(body["size"]) if box else dynamics.SphereShape(body["size"][0]), scene)
        x, y, z, w = body["quaternion"]
        pose = math.Isometry3()
        pose.set_quaternion(math.Quaternion(w, x, y, z))
        pose.set_translation(body["position"])
        joint.setPositions(dynamics.FreeJoint.convertToPositions(pose))
        R = pose.rotation()
        joint.setVelocities(np.r_[R.T @ body["angular_velocity"], R.T @ body["linear_velocity"]])
        self.world.addSkeleton(skeleton)
        return node

    @staticmethod
    def give(node: Any, shape: Any, scene: dict[str, Any]) -> None:
        """Add a shape with its material to a body."""
        part = node.createShapeNode(shape)
        part.createCollisionAspect()
        part.createDynamicsAspect()
        part.getDynamicsAspect().setFrictionCoeff(scene["mu"])
        part.getDynamicsAspect().setRestitutionCoeff(scene["restitution"] ** 0.5)  # DART multiplies the two

    def advance(self, steps: int) -> None:
        """Take steps, one call each."""
        step = self.world.step
        for _ in range(steps):
            step()

    def poses(self) -> Any:
        """Return the poses of the free bodies."""
        out = []
        for body in self.bodies:
            pose = body.getWorldTransform()
            q = pose.quaternion()
            out.append([*pose.translation(), q.x(), q.y(), q.z(), q.w()])
        return out


def turned(normal: Any) -> Any:
    """Return a rotation that takes z to a unit normal."""
    other = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(other, normal)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(normal, x), normal])


serve(lambda scene: ["default", "dantzig", "nsgs"] if scene["grounds"] else ["default"], Simulation)
