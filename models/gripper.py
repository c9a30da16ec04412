"""Gripper with two fingers that closes on a box, lifts it by friction and holds it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from nsdyn import PD, Material, Scene

DURATION, DT = 3.0, 5e-3

CLOSE, RAISE, HEIGHT = 0.5, 1.0, 0.2
"""Time to close the fingers and to raise the box [s], and how high [m]."""

GRIP, KP, KD = 20.0, 2e4, 400.0
"""Force of a finger [N]; gains of the lift [N/m, N s/m]."""


def scene(mass: float = 0.5, mu: float = 0.6, size: float = 0.06) -> Scene:
    """Cube of edge `size` [m] and `mass` [kg] on the ground, friction `mu` everywhere; two fingers hold 2 mu 20 N."""
    out = Scene(name="gripper")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    out.add_box("box", (size, size, size), mass, position=(0, 0, size / 2), material=material)
    out.add_urdf("gripper", Path(__file__).with_name("gripper.urdf"), position=(0, 0, 0.06), material=material)
    return out


def controller(scene: Scene) -> Callable[[float, np.ndarray, np.ndarray], dict[str, PD]]:
    """Constant grip; the lift waits, rises with zero speed and acceleration at both ends, then holds."""

    def control(t: float, q: np.ndarray, v: np.ndarray) -> dict[str, PD]:
        s = min(max((t - CLOSE) / RAISE, 0.0), 1.0)
        height = HEIGHT * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        speed = HEIGHT / RAISE * 30.0 * s**2 * (1.0 - s) ** 2
        gain = np.array([1.0, 0.0, 0.0])
        return {"gripper": PD(KP * gain, KD * gain, height * gain, speed * gain, np.array([0.0, GRIP, GRIP]))}

    return control
