"""Rattleback: a half-ellipsoid whose inertia is askew to its shape; spun the wrong way it rattles and turns back."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 4.0, 1e-3


def scene(
    spin: float = -5.0,
    tilt: float = 5.0,
    skew: float = -1e-4,
    mu: float = 1.0,
    length: float = 0.2,
    width: float = 0.03,
    height: float = 0.02,
    offset: float = 0.01,
    mass: float = 1.0,
) -> Scene:
    """Ellipsoid with semi-axes `length`, `width`, `height` [m] turning at `spin` [rad/s] about the vertical.

    Its centre of mass lies `offset` [m] below its centre, its product of inertia about the long and the wide axis is
    `skew` [kg m²], whose sign is the sense of rotation it likes; it starts rolled by `tilt` [deg] about the long axis.
    With friction that prevents sliding nothing is lost.

    T. R. Kane, D. A. Levinson, Realistic mathematical modeling of the rattleback, Int. J. Non-Linear Mech. 17, 1982.
    """
    out = Scene(name="rattleback")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    t = np.radians(tilt)
    # Support of the tilted ellipsoid downwards; the centre of mass is below the centre along the body's z axis.
    up = np.array([0, np.sin(t), np.cos(t)])
    axes = np.array([length, width, height])
    centre = float(np.linalg.norm(axes * up))
    z = np.array([0, -np.sin(t), np.cos(t)])
    centre_of_mass = np.array([0, 0, centre]) - offset * z
    c, s = np.cos(t), np.sin(t)
    contact = np.array([0, (height**2 - width**2) * s * c / centre, 0])
    out.add_ellipsoid(
        "rattleback",
        axes,
        mass,
        com=(0, 0, -offset),
        material=material,
        inertia=[[2e-4, skew, 0], [skew, 1.6e-3, 0], [0, 0, 1.7e-3]],
        position=centre_of_mass,
        quaternion=(np.sin(t / 2), 0, 0, np.cos(t / 2)),
        angular_velocity=(0, 0, spin),
        linear_velocity=np.cross((0, 0, spin), centre_of_mass - contact),
    )
    return out
