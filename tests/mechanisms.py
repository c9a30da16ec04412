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


def lump(mass, moments, middle=(0, 0, 0)):
    """Inertia of a body with its moments, or its one moment, about its middle."""
    moments = np.array(moments, dtype=float)
    return pin.Inertia(mass, np.array(middle, dtype=float), moments if moments.ndim == 2 else moments * np.eye(3))


def rod(end, mass=1.0):
    """Inertia of a thin homogeneous rod from the origin to `end`."""
    d = np.array(end, dtype=float)
    return pin.Inertia(mass, d / 2, mass / 12 * (d @ d * np.eye(3) - np.outer(d, d)) + 1e-9 * np.eye(3))


def hang(model, parent, name, joint, inertia, place=(0, 0, 0)):
    """Hang a body on a parent by a joint, at a point of it or turned; its index."""
    index = model.addJoint(parent, joint, place if isinstance(place, pin.SE3) else at(place), name)
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    return index


def serial(joints, inertias, place):
    """A model of bodies that hang from each other at a place of the one before; one inertia may be that of all."""
    model, parent = pin.Model(), 0
    for k, joint in enumerate(joints):
        inertia = inertias if isinstance(inertias, pin.Inertia) else inertias[k]
        parent = hang(model, parent, f"j{k}", joint, inertia, place if k else (0, 0, 0))
    return model


def limit(model, lower=-np.inf, upper=np.inf):
    """The model, its coordinates limited so and its joints as frames that shapes can hang on."""
    model.lowerPositionLimit, model.upperPositionLimit = np.full(model.nq, lower), np.full(model.nq, upper)
    for joint in range(1, model.njoints):
        model.addJointFrame(joint)
    return model


def pendulum(links=1, lower=-np.inf, upper=np.inf):
    """Rods of 1 m and 1 kg that hang from each other and turn about y."""
    return limit(serial([pin.JointModelRY()] * links, rod((0, 0, -1)), (0, 0, -1)), lower, upper)


def slider(mass=2.0, lower=-np.inf, upper=np.inf):
    """A mass on a rail along x."""
    model = pin.Model()
    hang(model, 0, "rail", pin.JointModelPX(), lump(mass, 0.01))
    return limit(model, lower, upper)


def four_bars(windows):
    """(model, loops, velocity) of vertical rods on the ground joined by horizontal ones, tips moving at 1 m/s.

    IFToMM benchmark A02: 1 m and 1 kg each. Loops close at the feet, in space, so that their sideways rows are
    redundant; where all rods lie flat the mechanism is singular.
    """
    up, right = np.array((0, 0, 1.0)), np.array((1.0, 0, 0))
    model, loops = pin.Model(), []
    joint, tip = hang(model, 0, "v0", pin.JointModelRY(), rod(up)), up
    for k in range(windows):
        bar = hang(model, joint, f"h{k}", pin.JointModelRY(), rod(right), tip)
        joint, tip = hang(model, bar, f"v{k + 1}", pin.JointModelRY(), rod(-up), right), np.zeros(3)
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
            share = 0.5 if k == 2 else 1.0
            joint = hang(
                model, joint, names[k], hinge(), rod(share * (places[k + 1] - places[k]), share), places[k] - origin
            )
            origin = places[k]
        return joint, at((places[3] - places[2]) / 2)

    left, right = chain(p[:4], (y, z, x), "ABC"), chain(p[[5, 4, 3, 2]], (x, z, y), "FED")
    return limit(model), [Loop("cut", *left, *right, "frame")]
