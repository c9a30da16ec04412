"""Block on a spring and dry friction: give `nsdyn.simulate` this file's `external_force`, or another `spring`.

On ground at rest its amplitude falls by 2 mu m g/k every half period, until it stays where the spring is weaker than
friction, |x| <= mu m g/k. On a belt that runs at `belt` it is carried along to x = mu m g/k, where the spring wins,
and slips around that point with the amplitude belt/omega, grazing the belt's speed once a period for ever.
"""

from collections.abc import Callable
from typing import Any

from nsdyn import Material, Scene

DURATION, DT = 2.0, 1e-3


def spring(
    stiffness: float = 100.0, belt: float = 0.0, rest: float = 0.0
) -> Callable[[float, Any, Any], dict[str, tuple[float, float, float]]]:
    """Spring of `stiffness` [N/m] along x, seen from a belt at speed `belt` [m/s]: its anchor runs from `rest` to -x.

    Belt and ground are one thing in two frames: in the belt's own frame, where it rests, the anchor moves backwards.
    """
    return lambda t, q, v: {"block": (-stiffness * (q[0] - rest + belt * t), 0.0, 0.0)}


def scene(start: float = 0.35, speed: float = 0.0, mu: float = 0.3, size: float = 0.2, mass: float = 1.0) -> Scene:
    """Cube of edge `size` [m] and `mass` [kg] at x = `start` [m] with `speed` along x [m/s], ground of friction `mu`.

    The cube's height above the contact makes friction tilt it; `mu` < 1 keeps it on the ground.
    """
    out = Scene(name="oscillator")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    out.add_box(
        "block",
        (size, size, size),
        mass,
        position=(start, 0, size / 2),
        linear_velocity=(speed, 0, 0),
        material=material,
    )
    return out


def external_force(scene: Scene) -> Callable[[float, Any, Any], dict[str, tuple[float, float, float]]]:
    """The spring on ground at rest."""
    return spring()
