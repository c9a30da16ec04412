"""Roller in the nip of two plates: what presses them together grips it or spits it out."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 0.5, 2e-3


def scene(
    half_angle: float = 15.0,
    mu: float = 0.27,
    radius: float = 0.05,
    weight: float = 10.0,
    roller: float = 0.1,
    length: float = 0.15,
) -> Scene:
    """Roller of `radius` [m] and `roller` [kg] between a fixed plate and the lower face of a block of `weight` [kg].

    Both make `half_angle` [deg] with the horizontal and open to the right; the block moves up and down between smooth
    walls, its centre of mass above the roller. A weightless roller stays if tan(half_angle) <= mu: the two forces on it
    are along the line of its contacts. With weights w on W it needs

        mu >= tan b (1 + w / (2 cos² b (W - w tan² b / 2))).
    """
    out = Scene(name="nip")
    rough = Material(mu=mu)
    b = np.radians(half_angle)
    out.add_halfspace("plate", (np.sin(b), 0, np.cos(b)), material=rough)
    x, t = radius / np.sin(b), np.tan(b)
    left, right, top = x - length / 2, x + length / 2, x * t + length
    out.add_halfspace("left", (1, 0, 0), left)
    out.add_halfspace("right", (-1, 0, 0), -right)
    out.add_cylinder(
        "roller",
        radius,
        length,
        roller,
        position=(x, 0, 0),
        material=rough,
        quaternion=(np.sqrt(0.5), 0, 0, np.sqrt(0.5)),
    )
    corners = [(u, y, z) for u in (left, right) for z in (u * t, top) for y in (-length / 2, length / 2)]
    low, high = top - right * t, top - left * t
    centroid = left + length / 3 * (high + 2 * low) / (high + low)
    out.add_convex(
        "block", corners, weight, com=(x - centroid, 0, 0), inertia=weight * length**2 / 6 * np.eye(3), material=rough
    )
    for wall in ("left", "right"):
        out.set_pair(wall, "block", mu=0.0)
    return out
