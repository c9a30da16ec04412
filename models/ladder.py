"""Ladder leaning on a wall: on a smooth wall it stands if 2 mu tan(angle) >= 1, friction on the wall lets it lean more.

With both ends about to slip, tan(angle) = (1 - mu mu_wall) / (2 mu). Two frictions and one unknown: below the limit
the forces of the ends are not determined by statics.
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(
    angle: float = 60.0,
    mu: float = 0.3,
    mu_wall: float = 0.0,
    length: float = 2.0,
    width: float = 0.4,
    mass: float = 10.0,
) -> Scene:
    """Ladder of `length` x `width` [m] and `mass` [kg], `angle` [deg] steep, edges as its ends.

    `mu` is the friction of the ground, `mu_wall` that of the wall.
    """
    out = Scene(name="ladder")
    a = math.radians(angle)
    half, run, rise = length / 2, length * math.cos(a), length * math.sin(a)
    out.add_halfspace("ground", normal=(0, 0, 1))
    out.add_halfspace("wall", normal=(-1, 0, 0), offset=-run)
    # A prism on a rhombus, thin in the middle: its ends are edges on the axis.
    thick = length / 100
    section = [(-half, 0), (0, thick / 2), (half, 0), (0, -thick / 2)]
    out.add_convex(
        "ladder",
        [(x, y, z) for x, z in section for y in (-width / 2, width / 2)],
        mass,
        position=(run / 2, 0, rise / 2),
        quaternion=(0, -math.sin(a / 2), 0, math.cos(a / 2)),
        material=Material(mu),
    )
    out.set_pair("ladder", "ground", mu=mu)
    out.set_pair("ladder", "wall", mu=mu_wall)
    return out
