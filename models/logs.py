"""Three logs in a pyramid, the lower two touching: they stand if friction is enough at the top and at the bottom.

Moments about the axes of the lower logs: tan(15°) = 0.2679 between logs, a third of it, 0.0893, on the ground.
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 1.0, 5e-3


def scene(
    mu: float = 0.3, mu_ground: float = 0.1, radius: float = 0.1, length: float = 0.6, mass: float = 5.0
) -> Scene:
    """Equal logs of `radius`, `length` [m] and `mass` [kg]; `mu` between them, `mu_ground` under them."""
    out = Scene(name="logs")
    material = Material(mu=mu)
    out.add_halfspace("ground")
    lying = (math.sqrt(0.5), 0, 0, math.sqrt(0.5))  # the axis along y
    top = (1.0 + math.sqrt(3.0)) * radius
    for name, x, z in (("left", -radius, radius), ("right", radius, radius), ("top", 0.0, top)):
        out.add_cylinder(name, radius, length, mass, position=(x, 0, z), quaternion=lying, material=material)
        out.set_pair(name, "ground", mu=mu_ground)
    return out
