"""Flat pyramid of cubes: each rests on two of the row below."""

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(base: int = 6, size: float = 0.2, mass: float = 1.0, mu: float = 0.5, joint: float = 0.02) -> Scene:
    """Rows of `base`, `base` - 1, ... 1 cubes of edge `size` [m] and `mass` [kg], `joint` [m] apart."""
    out = Scene(name="pyramid")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    pitch = size + joint
    for row in range(base):
        for k in range(base - row):
            out.add_box(
                f"box{row}_{k}",
                (size, size, size),
                mass,
                position=((k + 0.5 * row) * pitch, 0, (row + 0.5) * size),
                material=material,
            )
    return out
