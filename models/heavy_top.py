"""Fast symmetrical top on a spherical support: it precesses and nutates under its weight."""

import numpy as np
import pinocchio as pin

from nsdyn import Scene
from nsdyn.scene import shapes

DURATION, DT = 2.0, 1e-3


def scene(spin: float = 150.0, precession: float = -4.61538) -> Scene:
    """Top of 15 kg whose centre of mass starts 1 m beside its support, at `spin` and `precession` [rad/s].

    The support is three hinges in a row, the last one the axis of the top: the fast spin is then a coordinate of its
    own, which one spherical joint would mix with the others. The first two are turned away from the vertical, which
    the axis goes through: where it meets the first hinge their directions do not span.

    O. Brüls, A. Cardona, M. Arnold, Lie group generalized-α time integration of constrained flexible multibody
    systems, Mech. Mach. Theory 48, 2012.
    """
    out = Scene(name="heavy_top")
    s, c = np.sin(np.radians(120.0)), np.cos(np.radians(120.0))
    model, joint = pin.Model(), 0
    for name, axis in (("first", (s, 0.0, c)), ("second", (c, 0.0, -s)), ("top", (0.0, 1.0, 0.0))):
        hinge = pin.JointModelRevoluteUnaligned(np.array(axis))
        joint = model.addJoint(joint, hinge, pin.SE3.Identity(), name)
        model.addJointFrame(joint)
    middle = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([0.0, 1.0, 0.0]))  # the disk's axis z along y
    inertia = pin.Inertia(15.0, np.zeros(3), np.diag([0.234375, 0.234375, 0.46875]))
    model.appendBodyToJoint(joint, inertia, middle)
    disk = {"top": [(shapes.cylinder(0.25, 0.05), middle)]}
    out.add_model("top", model, v=(precession * c, -precession * s, spin), collisions=disk)
    return out
