"""N windows of four-bar linkages side by side: the mechanism is singular whenever all rods lie flat.

Benchmark A02 of the IFToMM library of computational multibody problems.
"""

import numpy as np
import pinocchio as pin

from nsdyn import Scene
from nsdyn.scene import shapes

DURATION, DT = 10.0, 1e-3


def scene(windows: int = 2, speed: float = 1.0, length: float = 1.0, mass: float = 1.0) -> Scene:
    """`windows` squares of uniform rods of `length` [m] and `mass` [kg] that start upright, tops at `speed` [m/s].

    Upright rods stand on hinges on the ground; each top rod hangs on the upright before it and a loop closes it at
    the next.
    """
    out = Scene(name="four_bar")
    model, collisions = pin.Model(), {}
    slender = np.array([1e-3, 1.0, 1.0]) * mass * length**2 / 12
    rod = shapes.capsule(0.02 * length, 0.8 * length)
    along_x = pin.SE3(pin.rpy.rpyToMatrix(0, np.pi / 2, 0), np.array([length / 2, 0.0, 0.0]))
    along_z = pin.SE3(np.eye(3), np.array([0.0, 0.0, length / 2]))
    top = pin.SE3(np.eye(3), np.array([0.0, 0.0, length]))

    def add(parent: int, placement: pin.SE3, name: str, shape: pin.SE3) -> int:
        joint = model.addJoint(parent, pin.JointModelRY(), placement, name)
        inertia = pin.Inertia(mass, np.zeros(3), np.diag(slender[::-1]))
        model.appendBodyToJoint(joint, inertia, shape)
        model.addJointFrame(joint)
        collisions[name] = [(rod, shape)]
        return joint

    v = []
    for k in range(windows + 1):
        ground = pin.SE3(np.eye(3), np.array([k * length, 0.0, 0.0]))
        upright = add(0, ground, f"upright{k}", along_z)
        v.append(speed / length)
        if k < windows:
            add(upright, top, f"top{k}", along_x)
            v.append(-speed / length)  # turning back against the upright, it stays level
    out.add_model("linkage", model, v=v, collisions=collisions, self_collisions=False)
    for k in range(windows):
        out.add_loop("linkage", f"window{k}", f"top{k}", f"upright{k + 1}", position=(length, 0.0, 0.0))
    return out
