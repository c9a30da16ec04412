"""Tippe-top: a ball with its centre of mass below its centre, spun fast, turns over and stands on its stem side."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 4.0, 1e-3


def scene(
    spin: float = 150.0,
    tilt: float = 6.0,
    mu: float = 0.3,
    radius: float = 0.015,
    mass: float = 0.015,
    eccentricity: float = 0.2,
    axial: float = 0.237,
    transverse: float = 0.237,
) -> Scene:
    """Ball of `radius` [m], its centre of mass `eccentricity` radii from its centre, leaning by `tilt` [deg].

    It spins at `spin` [rad/s] about its axis of symmetry, with moments of inertia `axial` and `transverse` in units of
    mass radius² about the centre of mass. Whatever the friction, Jellett's l = -L·(contact - centre of mass) stays.
    The least energy with l at a tilt t is

        F(t) = l²/(2 D) - m g d cos t,  D = I1 (R sin t)² + I3 (d - R cos t)²,  d the distance of the centres.

    Standing is its minimum below a critical spin, standing on the head above a larger one, if
    |I1/I3 - 1| < d/R.

    T. M. Cherry, J. H. Jellett; S. Ebenfeld and F. Scheck, A new analysis of the tippe top, Ann. Phys. 243, 1995.
    """
    out = Scene(name="tippe_top")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    t = np.radians(tilt)
    offset = eccentricity * radius
    axis = np.array([np.sin(t), 0, np.cos(t)])
    out.add_sphere(
        "top",
        radius,
        mass,
        com=(0, 0, -offset),
        material=material,
        inertia=mass * radius**2 * np.diag([transverse, transverse, axial]),
        position=np.array([0, 0, radius]) - offset * axis,
        quaternion=(0, np.sin(t / 2), 0, np.cos(t / 2)),
        angular_velocity=spin * axis,
    )
    return out
