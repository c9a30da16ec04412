"""Perfectly elastic smooth balls in a closed box: their energy stays, impact after impact."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 10.0, 2e-3


def scene(
    balls: int = 8,
    size: float = 1.0,
    radius: float = 0.1,
    speed: float = 3.0,
    gravity: float = 0.0,
    mass: float = 1.0,
    seed: int = 0,
) -> Scene:
    """`balls` balls of `radius` [m] with masses from `mass` to twice that [kg] in a cubic box of edge `size` [m].

    They start on a grid with velocities of length `speed` [m/s] in directions drawn from `seed`.
    """
    out = Scene(gravity=(0, 0, -gravity), name="billiard")
    material = Material(mu=0.0, restitution=1.0)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = -sign * np.eye(3)[axis]
            out.add_halfspace(f"wall{axis}{'+' if sign > 0 else '-'}", normal, -size / 2, material=material)
    rng = np.random.default_rng(seed)
    side = int(np.ceil(balls ** (1 / 3) - 1e-9))
    places = (np.stack(np.unravel_index(np.arange(balls), (side,) * 3), axis=1) + 0.5) / side - 0.5
    for k, place in enumerate(places):
        direction = rng.normal(size=3)
        out.add_sphere(
            f"ball{k}",
            radius,
            mass * (1.0 + k / balls),
            position=place * (size - radius),
            material=material,
            linear_velocity=speed * direction / np.linalg.norm(direction),
        )
    return out
