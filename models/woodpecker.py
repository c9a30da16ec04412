"""Woodpecker toy: a bird on a spring pecks its way down a pole, its sleeve jamming and slipping in turn.

Data of C. Glocker, Dynamik von Starrkörpersystemen mit Reibung und Stößen, VDI 1995. There rotations are small; here
they are not, so that the same toy has a slightly different periodic motion.
"""

from pathlib import Path

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-4

POLE, SLEEVE, HALF_HEIGHT = 0.0025, 0.0031, 0.0058
"""Radius of the pole, inner radius and half height of the sleeve, m."""

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
    # The lower corner, at radius hypot(...) from the joint, is on the pole.
    arm = SLEEVE + TIP
    jam = np.arctan2(HALF_HEIGHT, arm) - np.arccos((POLE + TIP) / np.hypot(arm, HALF_HEIGHT))
    out.add_urdf(
        "toy",
        Path(__file__).with_name("woodpecker.urdf"),
        q=(0.0, jam, bird - jam),
        v=(speed, 0.0, spin),
        limits=False,
        stiffness=(0.0, 0.0, stiffness),
        material={"sleeve": Material(mu=mu), "bird": Material(mu=mu, restitution=peck)},
        self_collisions=False,
    )
    return out
