"""Bricard's mechanism: five rods along the edges of a cube, six hinges, no degree of freedom by count and one in fact.

Benchmark A04 of the IFToMM library of computational multibody problems. The loop is cut in the middle of the last rod
and welded there, so that all six hinges are joints of the tree.
"""

import numpy as np
import pinocchio as pin

from nsdyn import Scene
from nsdyn.scene import shapes

DURATION, DT = 10.0, 1e-3

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], dtype=float)
AXES = (pin.JointModelRY, pin.JointModelRZ, pin.JointModelRX) * 2


def scene(length: float = 1.0, mass: float = 1.0, width: float = 0.1) -> Scene:
    """Rods of `length` [m], `mass` [kg] and square section of `width` [m], at rest; gravity acts along -y."""
    out = Scene(gravity=(0.0, -9.81, 0.0), name="bricard")
    model, collisions = pin.Model(), {}
    corners = length * CORNERS

    def add(parent: int, k: int, placement: np.ndarray, name: str, toward: np.ndarray, part: float) -> int:
        """Hinge at corner k with a rod, or part of it, from there towards another corner."""
        joint = model.addJoint(parent, AXES[k](), pin.SE3(np.eye(3), placement), name)
        along = np.array(toward) - corners[k]
        size = np.where(along == 0.0, width, part * length)
        centre = pin.SE3(np.eye(3), 0.5 * part * along)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(part * mass, *size), centre)
        model.addJointFrame(joint)
        collisions[name] = [(shapes.box(np.where(along == 0.0, 0.05 * length, part * length)), centre)]
        return joint

    joint = 0
    for k in range(5):
        start = corners[k] - corners[max(k - 1, 0)]
        joint = add(joint, k, start, f"rod{k}", corners[k + 1], 1.0 if k < 4 else 0.5)
    add(0, 5, corners[5], "half4", corners[4], 0.5)
    out.add_model("mechanism", model, collisions=collisions, self_collisions=False)
    out.add_loop("mechanism", "weld", "rod4", "half4", position=0.5 * (corners[5] - corners[4]), kind="frame")
    return out
