"""Pinocchio's mimic joints, converted to joints with their own coordinates and gears, so that reactions are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn.scene.gears import Gear, following, gear

MIMIC = "JointModelMimic"
OF_V = (
    *("armature", "damping", "rotorInertia", "rotorGearRatio", "lowerVelocityLimit", "upperVelocityLimit"),
    *("lowerDryFrictionLimit", "upperDryFrictionLimit", "lowerEffortLimit", "upperEffortLimit"),
)
OF_Q = "lowerPositionLimit", "upperPositionLimit"

SAME = 1e-12
"""Round-off allowed in poses and velocities, compared with the mimic joint, m and m/s."""


def unfolded(name: str, model: Any) -> tuple[Any, tuple[Gear, ...]]:
    """Return a Pinocchio model with mimic joints q2 = ratio q1 + offset as independent joints, and their gears.

    Without mimic joints it is the model itself. ValueError, with the name of the articulation, for a mimic joint that
    is neither revolute nor prismatic, or whose ratio is 0.
    """
    kinds = [joint.shortname() for joint in model.joints]
    if MIMIC not in kinds:
        return model, ()
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model), np.ones(model.nv))
    out, gears = pin.Model(), []
    out.name, out.inertias[0] = model.name, model.inertias[0].copy()
    for k in range(1, model.njoints):
        joint = model.joints[k]
        if kinds[k] == MIMIC:
            mimic, axis = joint.extract(), np.array(data.joints[k].S).ravel()
            if not (mimic.scaling and axis.any()):
                raise ValueError(_refusal(name, model.names[k], mimic))
            turns = axis[3:].any()
            joint = (pin.JointModelRevoluteUnaligned if turns else pin.JointModelPrismaticUnaligned)(
                (axis[3:] if turns else axis[:3]) / mimic.scaling
            )
        out.addJoint(model.parents[k], joint, model.jointPlacements[k], model.names[k])
        out.inertias[k] = model.inertias[k].copy()
        if kinds[k] == MIMIC:
            of = model.names[model.mimicked_joints[list(model.mimicking_joints).index(k)]]
            gears.append(gear(out, f"mimic of {model.names[k]!r}", (of, model.names[k]), mimic.scaling, mimic.offset))
    for frame in list(model.frames)[1:]:
        out.addFrame(frame, False)
    _copy(model, out, [k for k in range(1, model.njoints) if kinds[k] != MIMIC])
    speed, there = np.ones(out.nv), out.createData()
    for g in gears:
        speed[g.coordinate2] = g.ratio
    pin.forwardKinematics(out, there, following(out, gears, pin.neutral(out)), speed)
    for k in (k for k in range(1, model.njoints) if kinds[k] == MIMIC):
        off = np.r_[(there.oMi[k].homogeneous - data.oMi[k].homogeneous).ravel(), (there.v[k] - data.v[k]).vector]
        if np.abs(off).max() > SAME:
            raise ValueError(_refusal(name, model.names[k], model.joints[k].extract()))
    return out, tuple(gears)


def _copy(model: Any, out: Any, joints: list[int]) -> None:
    """Copy the values per coordinate of some joints from `model` to `out`."""
    for fields, places, sizes in ((OF_V, "idx_vs", "nvs"), (OF_Q, "idx_qs", "nqs")):
        for field in fields:
            values, given = np.array(getattr(out, field)), np.array(getattr(model, field))
            for k in joints:
                there, here, size = getattr(out, places)[k], getattr(model, places)[k], getattr(model, sizes)[k]
                values[there : there + size] = given[here : here + size]
            setattr(out, field, values)


def _refusal(name: str, joint: str, mimic: Any) -> str:
    """Return the reason why a mimic joint cannot become an independent joint."""
    return (
        f"joint {joint!r} of model of {name!r} must be revolute or prismatic with a ratio that is not 0 to mimic "
        f"another, got the ratio {mimic.scaling!r}: build the model without mimic=True and use Scene.add_gear"
    )
