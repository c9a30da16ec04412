"""Hanging chain with a heavy weight at its end: the mass ratio that breaks solvers with a constraint per joint."""

import numpy as np
import pinocchio as pin

from nsdyn import Scene
from nsdyn.scene import shapes

DURATION, DT = 2.0, 1e-3


def scene(links: int = 20, ratio: float = 1000.0, length: float = 0.1, mass: float = 0.1, angle: float = 20.0) -> Scene:
    """`links` rods of `length` [m] and `mass` [kg] on hinges, a ball of `ratio` times that mass on the last.

    It starts straight, at `angle` [deg] from the vertical, at rest.
    """
    out = Scene(name="chain")
    model, collisions = pin.Model(), {}
    middle, end = (pin.SE3(np.eye(3), np.array([0.0, 0.0, -z])) for z in (length / 2, length))
    rod = pin.Inertia(mass, np.zeros(3), np.diag([1.0, 1.0, 0.01]) * mass * length**2 / 12)
    joint, placement = 0, pin.SE3.Identity()
    for k in range(links):
        joint = model.addJoint(joint, pin.JointModelRY(), placement, f"link{k}")
        model.appendBodyToJoint(joint, rod, middle)
        model.addJointFrame(joint)
        collisions[f"link{k}"] = [(shapes.capsule(0.1 * length, 0.7 * length), middle)]
        placement = end
    radius = 0.5 * length
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(ratio * mass, radius), end)
    collisions[f"link{links - 1}"].append((shapes.sphere(radius), end))
    q = np.zeros(links)
    q[0] = np.radians(angle)
    out.add_model("chain", model, q=q, collisions=collisions, self_collisions=False)
    return out
