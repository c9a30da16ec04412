"""Four bodies of different shapes that meet in the air: with nothing fixed, every frame of reference is as good."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 0.6, 1e-3


def scene(mu: float = 0.4, restitution: float = 0.3, gravity: float = 9.81) -> Scene:
    """Box, ball, egg and rod on collision courses, with friction `mu` and `restitution`, falling freely."""
    out = Scene(gravity=(0, 0, -gravity), name="collisions")
    material = Material(mu, restitution)
    out.add_box(
        "box",
        (0.4, 0.3, 0.2),
        1.3,
        quaternion=(0, 0, 0.1, np.sqrt(0.99)),
        angular_velocity=(0, 0, 0.5),
        material=material,
    )
    out.add_sphere(
        "ball",
        0.1,
        0.7,
        position=(0.06, 0.03, 0.35),
        linear_velocity=(0, 0.1, -1.5),
        angular_velocity=(2, 0, 1),
        material=material,
    )
    out.add_ellipsoid(
        "egg",
        (0.1, 0.08, 0.12),
        0.5,
        position=(-0.5, 0.02, 0.03),
        quaternion=(0.2, 0.1, 0, np.sqrt(0.95)),
        linear_velocity=(1.5, 0, 0.2),
        angular_velocity=(0, 3, 0),
        material=material,
    )
    out.add_capsule(
        "rod",
        0.05,
        0.2,
        0.4,
        position=(0.03, 0.42, 0),
        quaternion=(0.5, 0.1, 0, np.sqrt(0.74)),
        linear_velocity=(0, -1.2, 0.3),
        angular_velocity=(1, 1, 0),
        material=material,
    )
    return out
