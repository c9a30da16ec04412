"""Separate towers of cubes: many islands, hyperstatic contacts (400 for ten towers of ten)."""

from nsdyn import Material, Scene

DURATION, DT = 1.0, 5e-3


def scene(
    count: int = 10,
    height: int = 10,
    size: float = 0.2,
    mass: float = 1.0,
    mu: float = 0.5,
    spacing: float = 0.5,
) -> Scene:
    """`count` towers of `height` cubes of edge `size` [m] and `mass` [kg], `spacing` [m] apart."""
    out = Scene(name="stacks")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for i in range(count):
        for k in range(height):
            out.add_box(
                f"box{i}_{k}",
                (size, size, size),
                mass,
                position=(i * spacing, 0, (k + 0.5) * size),
                material=material,
            )
    return out
