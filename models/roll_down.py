"""Round body on an incline: it rolls if mu >= k/(1 + k) tan(angle), at a = g sin(angle)/(1 + k), k = J/(m r²).

k = 2/5 for a ball, 1/2 for a cylinder, 1 for a hoop; below the limit it slides and spins up at mu g cos(angle)/(k r).
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(shape: str = "ball", angle: float = 30.0, mu: float = 0.5, radius: float = 0.1, mass: float = 1.0) -> Scene:
    """A `shape`, "ball", "cylinder" or "hoop", of `radius` [m] and `mass` [kg] starts from rest at `angle` [deg]."""
    if shape not in ("ball", "cylinder", "hoop"):
        raise ValueError(f"shape must be 'ball', 'cylinder' or 'hoop', got {shape!r}")
    out = Scene(name="roll_down")
    material = Material(mu=mu)
    a = math.radians(angle)
    normal = (math.sin(a), 0.0, math.cos(a))
    out.add_halfspace("plane", normal=normal, material=material)
    position = [radius * n for n in normal]
    if shape == "ball":
        out.add_sphere("body", radius, mass, position=position, material=material)
    else:
        thin = mass * radius**2
        hoop = [[thin / 2, 0, 0], [0, thin / 2, 0], [0, 0, thin]]
        out.add_cylinder(
            "body",
            radius,
            2 * radius,
            mass,
            position=position,
            quaternion=(math.sqrt(0.5), 0, 0, math.sqrt(0.5)),
            material=material,
            inertia=hoop if shape == "hoop" else None,
        )
    return out
