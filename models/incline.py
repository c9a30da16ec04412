"""Block on an inclined plane: it holds if tan(angle) < mu, else slides at g (sin(angle) - mu cos(angle)).

Sent across the slope at mu = tan(angle) it keeps speed + downhill speed constant and ends at half its first speed. A
tall block tips over its lower edge if 1/slenderness < tan(angle) and mu > 1/slenderness.
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-2


def scene(
    angle: float = 20.0,
    mu: float = 0.37,
    speed: float = 0.0,
    across: float = 0.0,
    heading: float = 0.0,
    size: float = 0.2,
    slenderness: float = 1.0,
    mass: float = 1.0,
) -> Scene:
    """Block of `mass` [kg], base `size` [m] square and `slenderness` times as tall, on a plane tilted by `angle` [deg].

    The slope falls towards `heading` [deg from x]; its block does not turn with it, nor do the tangents of its
    contacts. It starts at `speed` down and `across` [m/s] the slope.
    """
    out = Scene(name="incline")
    material = Material(mu=mu)
    a, h = math.radians(angle), math.radians(heading)
    x, y = math.cos(h), math.sin(h)
    normal = (math.sin(a) * x, math.sin(a) * y, math.cos(a))
    downhill = (math.cos(a) * x, math.cos(a) * y, -math.sin(a))
    sideways = (-y, x, 0.0)
    height = slenderness * size
    out.add_halfspace("plane", normal=normal, material=material)
    out.add_box(
        "box",
        (size, size, height),
        mass,
        material=material,
        position=[height / 2 * n for n in normal],
        quaternion=(-y * math.sin(a / 2), x * math.sin(a / 2), 0, math.cos(a / 2)),
        linear_velocity=[speed * d + across * s for d, s in zip(downhill, sideways, strict=True)],
    )
    return out
