"""Cube thrown along the ground: it slides, slows down at mu g and stops after v0²/(2 mu g)."""

import math

from nsdyn import Material, Scene

DURATION, DT = 0.6, 1e-3


def scene(mu: float = 0.5, speed: float = 2.0, heading: float = 0.0, size: float = 0.2, mass: float = 1.0) -> Scene:
    """Cube of edge `size` [m] and `mass` [kg] sliding at `speed` [m/s] towards `heading` [deg]."""
    out = Scene(name="slide")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    angle = math.radians(heading)
    out.add_box(
        "box",
        (size, size, size),
        mass,
        position=(0, 0, size / 2),
        material=material,
        linear_velocity=(speed * math.cos(angle), speed * math.sin(angle), 0),
    )
    return out
