"""Fast symmetrical top on a spherical support: it precesses and nutates under its weight."""

from pathlib import Path

import numpy as np

from nsdyn import Scene

DURATION, DT = 2.0, 1e-3


def scene(spin: float = 150.0, precession: float = -4.61538) -> Scene:
    """Top of 15 kg whose centre of mass starts 1 m beside its support, at `spin` and `precession` [rad/s].

    The spherical support is three hinges in a row, the last one the axis of the top.

    O. Brüls, A. Cardona, M. Arnold, Lie group generalized-α time integration of constrained flexible multibody
    systems, Mech. Mach. Theory 48, 2012.
    """
    out = Scene(name="heavy_top")
    angle = np.radians(120.0)  # of the first hinge from the vertical, about y; the second is across
    rates = precession * np.cos(angle), -precession * np.sin(angle), spin
    # Continuous joints are (cos, sin) in Pinocchio's configuration.
    out.add_urdf("top", Path(__file__).with_suffix(".urdf"), q=(1, 0) * 3, v=rates)
    return out
