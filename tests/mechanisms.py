"""Mechanisms built by hand, for the tests of joints and loops."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from nsdyn.scene.articulations import Loop


def add(scene, name, model, loops=(), **keywords):
    """`Scene.add_model`; joint values may be one number, loops are given by joints."""
    for k in ("friction", "damping", "armature", "stiffness", "rest"):
        if k in keywords:
            keywords[k] = np.broadcast_to(np.asarray(keywords[k], float), (model.nv,))
    scene.add_model(name, model, **keywords)
    scene.articulations[name] = replace(scene.articulations[name], loops=tuple(loops))


def at(point):
    """Pose of a point without a turn."""
    return pin.SE3(np.eye(3), np.array(point, dtype=float))


def rod(end, mass=1.0):
    """Inertia of a thin homogeneous rod from the origin to `end`."""
    d = np.array(end, dtype=float)
    return pin.Inertia(mass, d / 2, mass / 12 * (d @ d * np.eye(3) - np.outer(d, d)) + 1e-9 * np.eye(3))


def limit(model, lower=-np.inf, upper=np.inf):
    """The model, its coordinates limited so and its joints as frames that shapes can hang on."""
    model.lowerPositionLimit, model.upperPositionLimit = np.full(model.nq, lower), np.full(model.nq, upper)
    for joint in range(1, model.njoints):
        model.addJointFrame(joint)
    return model


def pendulum(links=1, lower=-np.inf, upper=np.inf):
    """Rods of 1 m and 1 kg that hang from each other and turn about y."""
    model, joint = pin.Model(), 0
    for k in range(links):
        joint = model.addJoint(joint, pin.JointModelRY(), at((0, 0, -1 if k else 0)), f"j{k}")
        model.appendBodyToJoint(joint, rod((0, 0, -1)), pin.SE3.Identity())
    return limit(model, lower, upper)


def slider(mass=2.0, lower=-np.inf, upper=np.inf):
    """A mass on a rail along x."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    return limit(model, lower, upper)


def four_bars(windows):
    """(model, loops, velocity) of vertical rods on the ground joined by horizontal ones, tips moving at 1 m/s.

    IFToMM benchmark A02: 1 m and 1 kg each. Loops close at the feet, in space, so that their sideways rows are
    redundant; where all rods lie flat the mechanism is singular.
    """
    up, right = np.array((0, 0, 1.0)), np.array((1.0, 0, 0))
    model, loops = pin.Model(), []
    joint, tip = model.addJoint(0, pin.JointModelRY(), at((0, 0, 0)), "v0"), up
    model.appendBodyToJoint(joint, rod(up), pin.SE3.Identity())
    for k in range(windows):
        bar = model.addJoint(joint, pin.JointModelRY(), at(tip), f"h{k}")
        model.appendBodyToJoint(bar, rod(right), pin.SE3.Identity())
        joint, tip = model.addJoint(bar, pin.JointModelRY(), at(right), f"v{k + 1}"), np.zeros(3)
        model.appendBodyToJoint(joint, rod(-up), pin.SE3.Identity())
        loops.append(Loop(f"foot{k + 1}", 0, at((k + 1, 0, 0)), joint, at(-up)))
    return limit(model), loops, np.array([1.0, *([-1.0, 1.0] * windows)])


def bricard():
    """(model, loops) of Bricard's mechanism, IFToMM benchmark A04: five rods of 1 m and 1 kg along the edges of a cube.

    Six hinges, each across its two edges; one degree of freedom although Grübler's count gives none. The loop is
    closed by a cut through the third rod, six rows of rank five.
    """
    p = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], dtype=float)
    x, y, z = pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ
    model = pin.Model()

    def chain(places, hinges, names):
        """Rods along the edges from places[0] on; half of the last one."""
        joint, origin = 0, np.zeros(3)
        for k, hinge in enumerate(hinges):
            joint = model.addJoint(joint, hinge(), at(places[k] - origin), names[k])
            share = 0.5 if k == 2 else 1.0
            model.appendBodyToJoint(joint, rod(share * (places[k + 1] - places[k]), share), pin.SE3.Identity())
            origin = places[k]
        return joint, at((places[3] - places[2]) / 2)

    left, right = chain(p[:4], (y, z, x), "ABC"), chain(p[[5, 4, 3, 2]], (x, z, y), "FED")
    return limit(model), [Loop("cut", *left, *right, "frame")]
