"""Box on four pillars with its centre of mass off the middle: forces in balance, their split not unique."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 1.0, 1e-2


def scene(
    offset_x: float = 0.1,
    offset_y: float = -0.05,
    size: float = 1.0,
    height: float = 0.2,
    mass: float = 10.0,
    mu: float = 0.5,
) -> Scene:
    """Box of `size` x `size` x `height` [m] and `mass` [kg] on four balls under its corners.

    Its centre of mass lies `offset_x`, `offset_y` [m] from the middle: the centre of pressure of the forces on the
    balls is below it, and they add up to the weight; these are three equations for four forces.
    """
    out = Scene(name="four_supports")
    material = Material(mu=mu)
    radius = 0.05 * size
    for k, (a, b) in enumerate(((-1, -1), (1, -1), (-1, 1), (1, 1))):
        out.add_sphere(
            f"support{k}", radius, fixed=True, material=material, position=(0.4 * a * size, 0.4 * b * size, radius)
        )
    inertia = mass / 12 * np.diag([size**2 + height**2, size**2 + height**2, 2 * size**2])
    out.add_box(
        "box",
        (size, size, height),
        mass,
        material=material,
        com=(offset_x, offset_y, 0),
        inertia=inertia,
        position=(offset_x, offset_y, 2 * radius + height / 2),
    )
    return out
