"""Disk that rolls on its rim without sliding, its centre of mass at rest: Euler's disk, short of its losses."""

import numpy as np

from nsdyn import Material, Scene
from nsdyn.scene import shapes

DURATION, DT = 1.0, 1e-3


def scene(
    tilt: float = 10.0,
    radius: float = 0.0375,
    thickness: float = 0.0064,
    mass: float = 0.44,
    mu: float = 0.5,
    gravity: float = 9.81,
) -> Scene:
    """Disk of `radius` and `thickness` [m] leaning by `tilt` [deg] from the ground, in its steady motion.

    It turns about the line from its centre to the contact while that line goes round the vertical at the rate W,
    W² sin(tilt) (I1 cos(tilt) - I3 b/a sin(tilt)) = m g (a cos(tilt) - b sin(tilt)) with a the radius, b half the
    thickness; for a thin disk W² sin(tilt) = 4 g/a and E = 3/2 m g a sin(tilt). Rolling loses nothing: the tilt stays.

    H. K. Moffatt, Euler's disk and its finite-time singularity, Nature 404, 2000.
    """
    out = Scene(gravity=(0, 0, -gravity), name="euler_disk")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    disk = shapes.cylinder(radius, thickness)
    alpha, a, b = np.radians(tilt), radius, thickness / 2
    s, c = np.sin(alpha), np.cos(alpha)
    I3 = a**2 / 2  # both per mass
    I1 = (3 * a**2 + thickness**2) / 12
    steepest = np.degrees(np.arctan2(min(I1, I3) * a, I3 * b))
    if not 0.0 < tilt < steepest:
        raise ValueError(f"tilt must lie between 0 and {steepest:.4g} degrees, where such a disk rolls, got {tilt!r}")
    precession = np.sqrt(gravity * (a * c - b * s) / (s * (I1 * c - I3 * b / a * s)))
    # In the plane of the tilt: e1 up the face of the disk, e3 its axis; the disk leans about the y axis.
    e1, e3 = np.array([c, 0, s]), np.array([-s, 0, c])
    out.add_shape(
        "disk",
        disk,
        mass,
        position=(0, 0, a * s + b * c),
        material=material,
        quaternion=(0, -np.sin(alpha / 2), 0, np.cos(alpha / 2)),
        angular_velocity=precession * s * (e1 + b / a * e3),
    )
    return out
