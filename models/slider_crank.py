"""Slider-crank whose slider is a block with clearance in its guide: it knocks, slides and jams from wall to wall.

Data of P. Flores, R. Leine, C. Glocker, Modeling and analysis of planar rigid multibody systems with translational
clearance joints based on the non-smooth dynamics approach, Multibody System Dynamics 23, 2010.
"""

import numpy as np
import pinocchio as pin

from nsdyn import Material, Scene
from nsdyn.scene import shapes

DURATION, DT = 0.1, 5e-6

CRANK, ROD = 0.153, 0.306
"""Lengths, m."""

HALF_LENGTH, HALF_WIDTH = 0.05, 0.025
"""Of the block, m."""


def scene(clearance: float = 0.001, restitution: float = 0.4, mu: float = 0.01, speed: float = 150.0) -> Scene:
    """Stretched out along x, the crank turning at `speed` [rad/s] in the plane x z, the rod at half of it backwards.

    `clearance` [m] is left on both sides of the centred block.
    """
    out = Scene(name="slider_crank")
    material = Material(mu=mu, restitution=restitution)
    gap = HALF_WIDTH + clearance
    out.add_halfspace("lower", normal=(0, 0, 1), offset=-gap, material=material)
    out.add_halfspace("upper", normal=(0, 0, -1), offset=-gap, material=material)
    model = pin.Model()
    # Positive angles turn x towards z.
    hinge = pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))
    joint = 0
    bodies = (
        ("crank", 0.0, 0.5 * CRANK, 0.038, 7.4e-5),
        ("rod", CRANK, 0.5 * ROD, 0.038, 5.9e-4),
        ("block", ROD, 0.0, 0.076, 2.7e-6),
    )
    for name, start, centre, mass, moment in bodies:
        joint = model.addJoint(joint, hinge, pin.SE3(np.eye(3), np.array([start, 0.0, 0.0])), name)
        inertia = pin.Inertia(mass, np.zeros(3), moment * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3(np.eye(3), np.array([centre, 0.0, 0.0])))
        model.addJointFrame(joint)
    block = shapes.box((2 * HALF_LENGTH, 0.5 * HALF_WIDTH, 2 * HALF_WIDTH))
    v = np.array([speed, -0.5 * speed - speed, 0.5 * speed])
    out.add_model("mechanism", model, v=v, material=material, collisions={"block": [block]})
    return out
