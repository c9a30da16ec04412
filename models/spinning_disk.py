"""Spinning disk that slides on the ground under uniform pressure: speed and spin end together.

Whatever the start, v/(R w) tends to 0.653 for a solid disk and to 1 for a ring. While it spins, friction does not hold
it: a small side force F moves it at v = R w F/(mu m g), as if in a viscous fluid.

A rigid disk on many points leaves their forces undetermined. Here the points are pads free to move up and down, each
carrying its own weight, so that the pressure is uniform by construction.

Z. Farkas, G. Bartels, T. Unger, D. E. Wolf, Frictional coupling between sliding and spinning motion, Phys. Rev. Lett.
90, 2003.
"""

import math

import coal
import numpy as np
import pinocchio as pin

from nsdyn import Material, Scene

DURATION, DT = 0.3, 1e-3


def scene(
    speed: float = 1.0,
    spin: float = 10.0,
    mu: float = 0.5,
    radius: float = 0.1,
    mass: float = 1.0,
    rings: int = 5,
    sectors: int = 3,
    solid: bool = True,
    flywheel: float = 0.0,
) -> Scene:
    """Disk of `radius` [m] and `mass` [kg] at `speed` along x [m/s] with `spin` [rad/s].

    A solid disk stands on `rings` rings of `sectors`, 3 `sectors`, 5 `sectors`, ... pads, all of the same weight and
    area; a ring has all pads on its rim. `flywheel` adds a moment of inertia [kg m²] but no weight.
    """
    out = Scene(name="spinning_disk")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    counts = sectors * (2 * np.arange(1, rings + 1) - 1)
    radii = radius * (np.arange(rings) + 0.5) / rings
    # Half a spacing's turn between rings: no two have a pad on the same ray.
    places = [
        (r * math.cos(a), r * math.sin(a))
        for r, n in zip(radii, counts, strict=True)
        for a in 2 * math.pi * (np.arange(n) + 0.5 * (n // sectors // 2 % 2)) / n
    ]
    if not solid:
        n = int(counts.sum())
        places = [(radius * math.cos(a), radius * math.sin(a)) for a in 2 * math.pi * np.arange(n) / n]
    pad_mass, pad_radius = mass / len(places), 0.05 * radius
    model = pin.Model()
    parent = 0
    for name, joint in (("x", pin.JointModelPX()), ("y", pin.JointModelPY()), ("yaw", pin.JointModelRZ())):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), name)
    # The pads are points; what a disk of the same weight has beyond them, and the flywheel, turns with the yaw joint.
    J = 0.5 * mass * radius**2 - pad_mass * sum(x * x + y * y for x, y in places) if solid else 0.0
    model.appendBodyToJoint(
        parent, pin.Inertia(0.0, np.zeros(3), np.diag((0.0, 0.0, J + flywheel))), pin.SE3.Identity()
    )
    geometry, ball = pin.GeometryModel(), coal.Sphere(pad_radius)
    for k, (x, y) in enumerate(places):
        at = pin.SE3(np.eye(3), np.array((x, y, pad_radius)))
        joint = model.addJoint(parent, pin.JointModelPZ(), at, f"pad{k}")
        model.appendBodyToJoint(joint, pin.Inertia(pad_mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        geometry.addGeometryObject(pin.GeometryObject(f"pad{k}", joint, pin.SE3.Identity(), ball))
    v = np.zeros(model.nv)
    v[0], v[2] = speed, spin
    out.add_model("disk", model, geometry, v=v, material=material, self_collisions=False)
    return out
