"""Articulations cut at the world: parts that no joint, loop or gear connects become separate trees."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pinocchio as pin

from nsdyn.scene.articulations import Articulation
from nsdyn.scene.gears import joint_at


def parts(a: Articulation) -> list[tuple[Articulation, range]]:
    """Trees of an articulation, in the order of their coordinates, some joined by loops or gears.

    Each is an articulation of its own with the name of the whole, beside its joints within the whole: the first of them
    is joint 1 of the part.
    """
    model = a.model
    roots = [joint for joint in range(1, model.njoints) if model.parents[joint] == 0]
    ends = [*roots[1:], model.njoints]
    joined = [(loop.joint1, loop.joint2) for loop in a.loops]
    joined += [(joint_at(model, g.coordinate1), joint_at(model, g.coordinate2)) for g in a.gears]
    for low, high in map(sorted, joined):  # join all trees from the first to the last
        kept = [k for k, end in enumerate(ends) if not (low and low < end <= high)]
        roots, ends = [roots[0], *(ends[k] for k in kept[:-1])], [ends[k] for k in kept]
    if len(roots) <= 1:
        return [(a, range(1, model.njoints))]
    own = (range(first, end) for first, end in zip(roots, ends, strict=True))
    return [(_part(a, joints), joints) for joints in own]


def _part(a: Articulation, joints: range) -> Articulation:
    shift, own = joints.start - 1, _alone(a.model, joints)
    q_start, v_start = a.model.idx_qs[joints.start], a.model.idx_vs[joints.start]
    q, v = slice(q_start, q_start + own.nq), slice(v_start, v_start + own.nv)
    own.lowerPositionLimit, own.upperPositionLimit = a.model.lowerPositionLimit[q], a.model.upperPositionLimit[q]
    return replace(
        a,
        model=own,
        q=a.q[q],
        v=a.v[v],
        **{name: getattr(a, name)[v] for name in ("friction", "damping", "armature", "stiffness", "rest", "effort")},
        links=tuple(link._replace(joint=link.joint - shift) for link in a.links if link.joint in joints),
        loops=tuple(
            replace(loop, joint1=max(0, loop.joint1 - shift), joint2=max(0, loop.joint2 - shift))
            for loop in a.loops
            if {loop.joint1, loop.joint2} & set(joints)
        ),
        gears=tuple(
            replace(g, coordinate1=g.coordinate1 - v.start, coordinate2=g.coordinate2 - v.start)
            for g in a.gears
            if v.start <= g.coordinate2 < v.stop
        ),
        actuators=(),
        fixed=(),
        excluded=frozenset(),
    )


def _alone(model: Any, joints: range) -> Any:
    """Pinocchio model of some joints, with the frames on them and the inertias that they carry."""
    # `buildReducedModel` is of no use: it refuses joints that have the names of bodies.
    own, shift = pin.Model(), joints.start - 1
    own.gravity = model.gravity
    for joint in joints:
        parent = max(0, int(model.parents[joint]) - shift)
        own.addJoint(parent, model.joints[joint], model.jointPlacements[joint], model.names[joint])
        own.appendBodyToJoint(joint - shift, model.inertias[joint], pin.SE3.Identity())
    for frame in model.frames:
        if frame.parentJoint in joints:
            own.addFrame(pin.Frame(frame.name, frame.parentJoint - shift, 0, frame.placement, frame.type), False)
    return own
