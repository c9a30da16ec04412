"""Woodpecker toy: a bird on a spring pecks its way down a pole, its sleeve jamming and slipping in turn.

Data of C. Glocker, Dynamik von Starrkörpersystemen mit Reibung und Stößen, VDI 1995. There rotations are small; here
they are not, so that the same toy has a slightly different periodic motion.
"""

import numpy as np
import pinocchio as pin

from nsdyn import Material, Scene
from nsdyn.scene import shapes

DURATION, DT = 1.0, 1e-4

POLE, SLEEVE, HALF_HEIGHT = 0.0025, 0.0031, 0.0058
"""Radius of the pole, inner radius and half height of the sleeve, m."""

SPRING, CENTRE, BEAK, BEAK_HEIGHT = 0.010, 0.015, 0.0201, 0.02
"""Pole to spring, spring to centre of the bird, back from there to the tip of the beak and up to it, m."""

TIP = 1e-4
"""Radius of the spheres that stand for the corners of the sleeve and the tip of the beak, m."""


def scene(
    mu: float = 0.3,
    peck: float = 0.5,
    stiffness: float = 0.0056,
    bird: float = -0.2788,
    speed: float = -0.3411,
    spin: float = -7.4583,
) -> Scene:
    """Start near the periodic motion: the sleeve just jams at `speed` [m/s], the bird at angle `bird` [rad].

    `spin` [rad/s] is that of the bird; `peck` is the restitution of the beak, the sleeve's is 0; `stiffness`
    [N m/rad] is that of the spring.
    """
    out = Scene(name="woodpecker")
    pole = Material(mu=mu)
    out.add_box("pole", (2 * POLE, 0.02, 2.0), fixed=True, material=pole)
    model = pin.Model()
    # Positive angles turn x towards z.
    hinge = pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0]))
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    turn = model.addJoint(slide, hinge, pin.SE3.Identity(), "sleeve")
    spring = model.addJoint(turn, hinge, pin.SE3(np.eye(3), np.array([SPRING, 0.0, 0.0])), "bird")
    for joint in (turn, spring):
        model.addJointFrame(joint)
    centre = pin.SE3(np.eye(3), np.array([CENTRE, 0.0, 0.0]))
    model.appendBodyToJoint(turn, pin.Inertia(3e-4, np.zeros(3), 5e-9 * np.eye(3)), pin.SE3.Identity())
    model.appendBodyToJoint(spring, pin.Inertia(4.5e-3, np.zeros(3), 7e-7 * np.eye(3)), centre)

    def tip(x: float, z: float) -> tuple[shapes.Shape, pin.SE3]:
        """Sphere that touches the pole at (x, z)."""
        return shapes.sphere(TIP), pin.SE3(np.eye(3), np.array([x + TIP, 0.0, z]))

    # The lower corner, at radius hypot(...) from the joint, is on the pole.
    arm = SLEEVE + TIP
    jam = np.arctan2(HALF_HEIGHT, arm) - np.arccos((POLE + TIP) / np.hypot(arm, HALF_HEIGHT))
    out.add_model(
        "toy",
        model,
        q=(0.0, jam, bird - jam),
        v=(speed, 0.0, spin),
        stiffness=(0.0, 0.0, stiffness),
        material={"sleeve": Material(mu=mu), "bird": Material(mu=mu, restitution=peck)},
        collisions={
            "sleeve": [tip(SLEEVE, -HALF_HEIGHT), tip(SLEEVE, HALF_HEIGHT)],
            "bird": [tip(CENTRE - BEAK, BEAK_HEIGHT)],
        },
        self_collisions=False,
    )
    return out
