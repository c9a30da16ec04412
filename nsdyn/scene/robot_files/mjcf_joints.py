"""Joints of MJCF files: their poses, limits, springs and friction, and their positions in a keyframe.

This module reads the values of the joints, because Pinocchio takes the range of a slide for degrees, shifts the range
of a joint with `ref`, and has no springs. Pinocchio also makes one joint of several joints on one body, and the parts
have no names.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.exclusions import FREE
from nsdyn.scene.robot_files.xml import Report, numbers, range_of, scalar
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice, unused

SIZES = {"free": (7, 6), "ball": (4, 3), "hinge": (1, 1), "slide": (1, 1)}
"""(nq, nv) of every type of joint."""

COMPOSITE = "JointModelComposite"


def joints_of(root: Element) -> Iterator[tuple[Element, str, slice, slice]]:
    """Yield (element, type, its part of q, its part of v) for every joint, in Pinocchio's depth-first order."""
    q = v = 0
    for element in root.iter():
        if element.tag in ("joint", "freejoint") and "joint1" not in element.attrib:
            kind = "free" if element.tag == "freejoint" else element.get("type", "hinge")
            if kind not in SIZES:
                raise ValueError(f"joint {element.get('name')!r} must be of type {', '.join(SIZES)}, got {kind!r}")
            nq, nv = SIZES[kind]
            yield element, kind, slice(q, q + nq), slice(v, v + nv)
            q, v = q + nq, v + nv


def place_joints(model: Any) -> None:
    """Set the placements of the joints of a model that Pinocchio built to those of MuJoCo."""
    for joint, kind in enumerate(model.joints):
        if kind.shortname() == FREE:  # Pinocchio turns the body's position, and leaves the difference
            model.jointPlacements[joint] = pin.SE3.Identity()
        if kind.shortname() == COMPOSITE:  # Pinocchio omits `ref` of the first of several joints
            first = kind.extract().joints[0]
            moved = first.createData()
            first.calc(moved, np.array(model.referenceConfigurations["qpos0"]))
            model.jointPlacements[joint] *= moved.M.inverse()


def single(root: Element, model: Any, geometry: Any) -> Any:
    """Return Pinocchio's model with every joint of the file as a joint of its own.

    Shapes of `geometry` move to the last joint of their body. Links between the joints of one body have no mass.
    """
    given = {element.get("name", "") for element, *_ in joints_of(root)}
    names = [e.get("name") or unused(f"joint{k}", given) for k, (e, *_) in enumerate(joints_of(root))]
    if len(names) == model.njoints - 1:
        return model
    out, last = pin.Model(), [0]
    out.name, out.inertias[0] = model.name, model.inertias[0].copy()
    for k in range(1, model.njoints):
        joint, place, parent = model.joints[k].extract(), model.jointPlacements[k], last[model.parents[k]]
        parts = [(joint, pin.SE3.Identity(), model.names[k])]
        if joint.shortname() == COMPOSITE:
            own = names[out.njoints - 1 :]
            parts = list(zip(joint.joints, joint.jointPlacements, own, strict=False))
        for part, at, name in parts:
            parent = out.addJoint(parent, part, place * at, name)
            place = pin.SE3.Identity()
        out.inertias[parent] = model.inertias[k].copy()
        last.append(parent)
    for frame in list(model.frames)[1:]:
        on = last[frame.parentJoint]
        name = out.names[on] if frame.type == pin.FrameType.JOINT else frame.name
        out.addFrame(pin.Frame(name, on, frame.parentFrame, frame.placement, frame.type), False)
    for joint in sorted({*range(1, out.njoints)} - {*last}):  # last: shapes refer to the numbers of the frames before
        out.addJointFrame(joint, 0)
    for shape in geometry.geometryObjects:
        shape.parentJoint = last[shape.parentJoint]
    out.referenceConfigurations["qpos0"] = model.referenceConfigurations["qpos0"]
    return out


def set_joints(root: Element, model: Any, report: Report) -> tuple[Array, Array]:
    """Write limits, efforts, damping, friction and armature to the model; return (stiffness, rest) of the springs."""
    settings: dict[str, str] = getattr(root.find("compiler"), "attrib", {})
    unit = 1.0 if settings.get("angle", "degree") == "radian" else math.pi / 180.0
    autolimits = settings.get("autolimits", "true") == "true"
    lower, upper = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    damping, friction, armature, stiffness, rest = np.zeros((5, model.nv))
    effort = np.full(model.nv, np.inf)
    for element, kind, at, rows in joints_of(root):
        label = f"joint {element.get('name')!r}"
        if element.tag == "freejoint":
            continue

        def value(attribute: str, label: str = label, element: Element = element) -> float:
            return scalar(element.get(attribute), 0.0, f"{attribute} of {label}")

        damping[rows], friction[rows], armature[rows] = value("damping"), value("frictionloss"), value("armature")
        factor = unit if kind == "hinge" else 1.0
        bounds = range_of(element, "range", "limited", autolimits, label)
        if forces := range_of(element, "actuatorfrcrange", "actuatorfrclimited", autolimits, label):
            low, high = forces
            effort[rows] = most = max(-low, high)
            if kind == "ball":
                report.dropped.append(f"{label}: actuatorfrcrange of a ball joint")
                effort[rows] = np.inf
            elif low != -high:
                report.dropped.append(f"{label}: actuatorfrcrange, but for ±{most:g}")
        if kind in ("hinge", "slide"):
            stiffness[rows], rest[rows] = value("stiffness"), factor * value("springref")
            if bounds:
                lower[at], upper[at] = factor * bounds[0], factor * bounds[1]
        else:
            if bounds:
                report.missing.append(f"{label}: range of a {kind} joint")
            if value("stiffness"):
                report.missing.append(f"{label}: stiffness of a {kind} joint")
            # Armature is inertia of a rotor. Free joints have none: along turning axes it would bend a body's path.
            for attribute, values in (("frictionloss", friction), ("armature", armature)):
                if value(attribute) and kind == "free":
                    report.missing.append(f"{label}: {attribute} of a {kind} joint")
                    values[rows] = 0.0
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    model.damping, model.armature, model.upperEffortLimit = damping, armature, effort
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -friction, friction
    return stiffness, rest


def start_of(
    root: Element, model: Any, keyframe: str | None, drives: int, report: Report
) -> tuple[Array, list[float | None]]:
    """Return configuration and controls of a keyframe; without one, the file's configuration and no controls."""
    q: Array = np.array(model.referenceConfigurations["qpos0"])
    controls: list[float | None] = [None] * drives
    keys: dict[str, Element] = {}
    for k, e in enumerate(root.iterfind("keyframe/key")):
        if (name := e.get("name", f"key{k}")) in keys:
            raise ValueError(f"keyframe {name!r} must have a name of its own")
        keys[name] = e
    report.unused.extend(f"keyframe {key!r}" for key in keys if key != keyframe)
    if keyframe is None:
        return q, controls
    key = keys[choice(keyframe, keys, "keyframe")]
    if "qpos" in key.attrib:
        q = numbers(key.get("qpos"), model.nq, None, f"qpos of keyframe {keyframe!r}")
        for _, kind, at, _ in joints_of(root):
            if kind in ("free", "ball"):  # MuJoCo writes w x y z
                q[at.stop - 4 : at.stop] = np.roll(q[at.stop - 4 : at.stop], -1)
    if "ctrl" in key.attrib and drives:
        controls = numbers(key.get("ctrl"), drives, None, f"ctrl of keyframe {keyframe!r}").tolist()
    for what in sorted(key.attrib.keys() - {"name", "time", "qpos", "ctrl"}):
        count = model.nv if what == "qvel" else None
        if numbers(key.get(what), count, None, f"{what} of keyframe {keyframe!r}").any():
            report.dropped.append(f"keyframe {keyframe!r}: {what}")
    return q, controls
