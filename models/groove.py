"""Ball in a V-groove down a slope: it touches both sides and rolls on a smaller radius than its own."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-3


def scene(
    slope: float = 10.0,
    half_angle: float = 45.0,
    speed: float = 0.0,
    mu: float = 0.5,
    radius: float = 0.1,
    mass: float = 1.0,
) -> Scene:
    """Ball of `radius` [m] at `speed` [m/s] in a groove whose sides make `half_angle` [deg] with the plane of symmetry.

    Rolling from rest a = g sin(slope)/(1 + 2/(5 sin² half_angle)). Thrown without spin in a level groove it is slowed
    down by mu g/sin(half_angle) until it rolls at v0 / (1 + 2/(5 sin² half_angle)).
    """
    a, b = np.radians(slope), np.radians(half_angle)
    out = Scene(gravity=(9.81 * np.sin(a), 0, -9.81 * np.cos(a)), name="groove")
    material = Material(mu=mu)
    for side in (-1.0, 1.0):
        out.add_halfspace(f"side{side:+.0f}", (0, side * np.cos(b), np.sin(b)), material=material)
    out.add_sphere(
        "ball", radius, mass, position=(0, 0, radius / np.sin(b)), linear_velocity=(speed, 0, 0), material=material
    )
    return out
