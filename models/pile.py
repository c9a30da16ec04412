"""Boxes and spheres dropped into a container."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 2.0, 5e-3


def scene(
    boxes: int = 15,
    spheres: int = 15,
    size: float = 0.1,
    density: float = 1000.0,
    side: float = 0.5,
    mu: float = 0.4,
    seed: int = 0,
) -> Scene:
    """Cubes of edge `size` and spheres of diameter `size` [m] above a square container `side` [m] wide."""
    out = Scene(name="pile")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for name, normal in {
        "west": (1, 0, 0),
        "east": (-1, 0, 0),
        "south": (0, 1, 0),
        "north": (0, -1, 0),
    }.items():
        out.add_halfspace(name, normal=normal, offset=-side / 2, material=material)
    rng = np.random.default_rng(seed)
    # Cells as wide as a cube's diagonal, so that nothing overlaps at the start whatever its orientation.
    pitch = 1.8 * size
    per_row = max(1, int(side / pitch))
    kinds = rng.permutation(["box"] * boxes + ["sphere"] * spheres)
    for k, kind in enumerate(kinds):
        layer, cell = divmod(k, per_row**2)
        i, j = divmod(cell, per_row)
        centre = np.array([i - (per_row - 1) / 2, j - (per_row - 1) / 2, layer + 0.6]) * pitch
        centre[:2] += 0.02 * size * rng.uniform(-1, 1, 2)
        if kind == "box":
            quaternion = rng.normal(size=4)
            out.add_box(
                f"box{k}",
                (size, size, size),
                density * size**3,
                position=centre,
                quaternion=quaternion / np.linalg.norm(quaternion),
                material=material,
            )
        else:
            mass = density * np.pi / 6 * size**3
            out.add_sphere(f"sphere{k}", size / 2, mass, position=centre, material=material)
    return out
