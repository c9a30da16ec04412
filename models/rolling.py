"""Box pushed over the ground, 60 degrees from the axes, with 25 balls rolling on it: SimBenchmark's rolling."""

from collections.abc import Callable

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 4.0, 1e-3

FORCE, HEADING = 150.0, 60.0


def scene(balls: int = 5, box_mass: float = 10.0, ball_mass: float = 1.0) -> Scene:
    """Box of `box_mass` [kg] under `balls` x `balls` balls of `ball_mass` [kg]; `external_force` pushes its centre.

    mu is 0.4 under the box, which slides, and 0.8 under the balls, which roll. A ball of mass m follows the box of mass
    M with 2/7 of its acceleration, so that for n balls

        M a + (2/7) n m a = F - 0.4 (M + n m) g,   a = 0.7385 m/s² and 0.2110 m/s² for 25 balls and F = 150 N.

    J. Hwangbo, D. Kang et al., SimBenchmark, rolling test.
    """
    out = Scene(name="rolling")
    out.add_halfspace("ground")
    out.add_box("box", (20, 20, 1), box_mass, position=(0, 0, 0.5))
    out.set_pair("ground", "box", mu=0.4)
    for k in range(balls**2):
        i, j = divmod(k, balls)
        name = f"ball{k}"
        out.add_sphere(
            name, 0.5, ball_mass, position=(2.0 * i - balls + 1, 2.0 * j - balls + 1, 1.5), material=Material()
        )
        out.set_pair("box", name, mu=0.8)
    return out


def external_force(scene: Scene) -> Callable[[float, np.ndarray, np.ndarray], dict[str, tuple[float, float, float]]]:
    """The push on the box, N."""
    heading = np.radians(HEADING)
    push = (FORCE * np.cos(heading), FORCE * np.sin(heading), 0.0)
    return lambda t, q, v: {"box": push}
