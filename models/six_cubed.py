"""216 balls dropped on the ground in a slightly disturbed 6 x 6 x 6 grid: SimBenchmark's 666."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 4.0, 2e-3


def scene(
    side: int = 6,
    restitution: float = 0.0,
    mu: float = 0.8,
    radius: float = 0.1,
    mass: float = 10.0,
    pitch: float = 0.21,
    height: float = 1.101,
    disturbance: float = 1e-3,
    seed: int = 42,
) -> Scene:
    """`side`³ balls of `radius` [m] and `mass` [kg] at a `pitch` [m], the lowest `height` [m] up, in a cubic grid.

    Each is displaced by up to `disturbance` [m] along every axis. With `restitution` 0 the measure is penetration,
    with `restitution` 1 and `mu` 0 the total energy, which stays.

    J. Hwangbo, D. Kang et al., SimBenchmark, 666 and elastic 666.
    """
    out = Scene(gravity=(0, 0, -9.8), name="six_cubed")
    material = Material(mu, restitution)
    out.add_halfspace("ground", material=material)
    rng = np.random.default_rng(seed)
    for k, place in enumerate(np.ndindex(side, side, side)):
        position = pitch * np.array(place) + (0, 0, height) + disturbance * rng.uniform(-1, 1, 3)
        out.add_sphere(f"ball{k}", radius, mass, position=position, material=material)
    return out
