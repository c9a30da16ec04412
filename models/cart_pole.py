"""Cart on rails with stops, a pole hinged on it: the falling pole throws the cart from stop to stop."""

import numpy as np
import pinocchio as pin

from nsdyn import Scene
from nsdyn.scene import shapes

DURATION, DT = 5.0, 1e-3


def scene(
    rail: float = 0.6,
    restitution: float = 0.5,
    cart: float = 1.0,
    pole: float = 0.5,
    length: float = 1.0,
    angle: float = 10.0,
    speed: float = 1.0,
) -> Scene:
    """`cart` and `pole` [kg], uniform pole of `length` [m] leaning by `angle` [deg], cart at `speed` [m/s].

    Its centre moves freely over `rail` [m] and rebounds from the stops at both ends with `restitution`.
    """
    out = Scene(name="cart_pole")
    model = pin.Model()
    slider = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "cart")
    hinge = model.addJoint(slider, pin.JointModelRY(), pin.SE3.Identity(), "pole")
    for joint in (slider, hinge):
        model.addJointFrame(joint)
    up = pin.SE3(np.eye(3), np.array([0.0, 0.0, length / 2]))
    size = np.array([0.2, 0.1, 0.1])
    model.appendBodyToJoint(slider, pin.Inertia.FromBox(cart, *size), pin.SE3.Identity())
    model.appendBodyToJoint(hinge, pin.Inertia.FromCylinder(pole, 0.02, length), up)
    limit = np.array([rail / 2, np.inf])
    model.lowerPositionLimit, model.upperPositionLimit = -limit, limit
    out.add_model(
        "cart_pole",
        model,
        q=(0.0, np.radians(angle)),
        v=(speed, 0.0),
        restitution=restitution,
        collisions={"cart": [shapes.box(size)], "pole": [(shapes.capsule(0.02, length - 0.04), up)]},
    )
    return out
