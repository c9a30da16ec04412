"""An articulation as plain values, from which a reader of a recording can compute its motion again.

The values are JSON, because Pinocchio's own format changes with its versions. They give the kind of each joint, its
pose and the inertia that it carries. `nsdyn.recording.mechanism` builds the model again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn.scene.articulations import Articulation
from nsdyn.scene.prescribed import Motion
from nsdyn.tools.arrays import Array

GIVEN = ("axis", "axis1", "axis2", "pitch", "radius_x", "radius_y", "radius_z")
"""Attributes by which joints of one kind differ."""


def describe_tree(a: Articulation, motions: Mapping[str, Motion]) -> dict[str, Any]:
    """Return joints, inertias, loops and joint laws of an articulation as JSON values; SI units, null for no limit.

    They are joints, parents before children: kind, parent, pose in the parent's frame, mass, com, inertia about the
    com; armature, friction, damping, stiffness, rest, effort, lower, upper, each (nv,); restitution of the limits;
    loops; gears; and of all `motions` of the scene those driven, {joint: its velocity, null if it varies}.
    """
    m, laws = a.model, ("armature", "friction", "damping", "stiffness", "rest", "effort")
    prefix = f"{a.name}/"
    driven = {
        name.removeprefix(prefix): None if callable(motion.velocity) else motion.rate(0.0)
        for name, motion in motions.items()
        if motion.kind == "joint" and name.startswith(prefix) and m.existJointName(name.removeprefix(prefix))
    }
    lower, upper = a.bounds()
    return {
        "joints": [_joint(m, k) for k in range(1, m.njoints)],
        **{law: _finite(getattr(a, law)) for law in laws},
        "lower": _finite(lower),
        "upper": _finite(upper),
        "restitution": a.restitution,
        "loops": [
            {
                "name": loop.name,
                "kind": loop.kind,
                "joints": [loop.joint1, loop.joint2],
                "placements": [loop.placement1.homogeneous.tolist(), loop.placement2.homogeneous.tolist()],
            }
            for loop in a.loops
        ],
        "gears": [asdict(gear) for gear in a.gears],
        "driven": driven,
    }


def _joint(model: Any, k: int) -> dict[str, Any]:
    body = model.inertias[k]
    return {
        **_kind(model, k),
        "parent": int(model.parents[k]),
        "placement": model.jointPlacements[k].homogeneous.tolist(),
        "mass": float(body.mass),
        "com": np.array(body.lever).tolist(),
        "inertia": np.array(body.inertia).tolist(),
    }


def _kind(model: Any, k: int) -> dict[str, Any]:
    """Return Pinocchio's name of a joint's kind and the attributes in `GIVEN`; of a composite joint its parts."""
    joint = model.joints[k]
    out = _told(joint.extract())
    if out["kind"] == "JointModelRevoluteUnboundedUnaligned":  # Pinocchio does not expose its axis
        J = pin.computeJointJacobian(model, model.createData(), pin.neutral(model), k)
        out["axis"] = J.reshape(6, -1, order="A")[3:, joint.idx_v].tolist()
    return out


def _told(joint: Any) -> dict[str, Any]:
    out: dict[str, Any] = {"kind": joint.shortname()}
    if out["kind"] == "JointModelComposite":
        poses = [pose.homogeneous.tolist() for pose in joint.jointPlacements]
        return out | {"parts": [_told(part.extract()) for part in joint.joints], "placements": poses}
    return out | {name: np.array(getattr(joint, name)).tolist() for name in GIVEN if hasattr(joint, name)}


def _finite(values: Array) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in values]
