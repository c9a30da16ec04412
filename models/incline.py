"""Cube on an inclined plane: it holds if tan(angle) < mu, else slides at g (sin(angle) - mu cos(angle))."""

import math

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-2


def scene(angle: float = 20.0, mu: float = 0.37, speed: float = 0.0, size: float = 0.2, mass: float = 1.0) -> Scene:
    """Cube of edge `size` [m] and `mass` [kg] on a plane tilted by `angle` [deg], sent down it at `speed` [m/s]."""
    out = Scene(name="incline")
    material = Material(mu=mu)
    a = math.radians(angle)
    normal, downhill = (math.sin(a), 0.0, math.cos(a)), (math.cos(a), 0.0, -math.sin(a))
    out.add_halfspace("plane", normal=normal, material=material)
    out.add_box(
        "box", (size, size, size), mass, material=material,
        position=[size / 2 * n for n in normal], quaternion=(0, math.sin(a / 2), 0, math.cos(a / 2)),
        linear_velocity=[speed * d for d in downhill],
    )  # fmt: skip
    return out
