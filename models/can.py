"""Can that falls on its base and seems to rock: its contact sweeps around the rim, and nothing strikes.

The contact goes round the faster the flatter the can falls, and the can rises again as high as it was. Without friction
its tilt obeys one equation of Lagrange, as its momenta about its axis and about the vertical are kept.

M. Srinivasan, A. Ruina, Rocking and rolling: a can that appears to rock might actually roll, Phys. Rev. E 78, 2008.
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 1.0, 2e-3


def scene(
    tilt: float = 12.0,
    across: float = 0.1,
    radius: float = 0.03,
    height: float = 0.1,
    mass: float = 0.35,
    mu: float = 0.8,
    restitution: float = 0.0,
) -> Scene:
    """Can of `radius` and `height` [m] and `mass` [kg], let go at a `tilt` [deg].

    It turns at `across` [rad/s] about the horizontal axis towards which it leans. With 0 it would fall flat, which is a
    different motion: there the far side of the rim strikes.
    """
    out = Scene(name="can")
    material = Material(mu=mu, restitution=restitution)
    out.add_halfspace("ground", material=material)
    a = math.radians(tilt)
    out.add_cylinder(
        "can",
        radius,
        height,
        mass,
        material=material,
        position=(0, 0, height / 2 * math.cos(a) + radius * math.sin(a)),
        quaternion=(0, math.sin(a / 2), 0, math.cos(a / 2)),
        angular_velocity=(across, 0, 0),
    )
    return out
