"""Two equal rods on hinges, let go from rest: the smooth motion that shows the order of the scheme."""

import numpy as np
import pinocchio as pin

from nsdyn import Scene
from nsdyn.scene import shapes

DURATION, DT = 10.0, 1e-3


def scene(length: float = 1.0, mass: float = 1.0, angle1: float = 60.0, angle2: float = 30.0) -> Scene:
    """Uniform rods of `length` [m] and `mass` [kg], at `angle1` and `angle2` [deg] from hanging down."""
    out = Scene(name="double_pendulum")
    model, collisions = pin.Model(), {}
    middle = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length / 2]))
    end = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))
    rod = shapes.capsule(0.03 * length, 0.9 * length)
    joint, placement = 0, pin.SE3.Identity()
    for name in ("upper", "lower"):
        joint = model.addJoint(joint, pin.JointModelRY(), placement, name)
        inertia = pin.Inertia(mass, np.zeros(3), np.diag([1.0, 1.0, 1e-3]) * mass * length**2 / 12)
        model.appendBodyToJoint(joint, inertia, middle)
        model.addJointFrame(joint)
        collisions[name] = [(rod, middle)]
        placement = end
    q = np.radians([angle1, angle2 - angle1])
    out.add_model("pendulum", model, q=q, collisions=collisions)
    return out
