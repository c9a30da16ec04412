"""Pairs of links that are never tested for contact: joined by joints, disabled by a file, or overlapping."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from nsdyn.scene.shapes import HALFSPACE
from nsdyn.tools.arrays import Array
from nsdyn.tools.files import is_file

if TYPE_CHECKING:
    from nsdyn.scene.articulations import Link, Loop

FREE = "JointModelFreeFlyer"


def disabled_pairs(name: str, path: Path, model: Any, unused: list[str]) -> set[frozenset[str]]:
    """Return the pairs of bodies whose contact an SRDF file disables."""
    if not is_file(path):
        raise ValueError(f"srdf of {name!r} must be an SRDF file, got {str(path)!r}")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as failure:
        raise ValueError(f"srdf of {name!r}: {path} could not be read: {failure}") from None
    out = set()
    for pair in root.iter("disable_collisions"):
        bodies = frozenset((pair.get("link1", ""), pair.get("link2", "")))
        if all(model.existBodyName(body) for body in bodies):
            out.add(bodies)
        else:
            unused.append(f"SRDF: disable_collisions of {sorted(bodies)}, which are not both bodies of the model")
    unused += [f"SRDF: <{tag}>" for tag in sorted({child.tag for child in root} - {"disable_collisions"})]
    return out


def filtered(
    links: Sequence[Link], of_bodies: set[frozenset[str]], of_links: frozenset[frozenset[str]], moving: int
) -> frozenset[tuple[int, int]]:
    """Return the pairs of links, by index, excluded by a file, by link or by body; one of each pair is `moving`."""
    return frozenset(
        (i, j)
        for i in range(moving)
        for j in range(i + 1, len(links))
        if {links[i].body, links[j].body} in of_bodies or {links[i].name, links[j].name} in of_links
    )


def joined(links: Sequence[Link], joined: set[frozenset[int]]) -> frozenset[tuple[int, int]]:
    """Return the pairs of links, by index, that are carried by the same joint or by two joints that are `joined`."""
    return frozenset(
        (i, j)
        for (i, first), (j, second) in combinations(enumerate(links), 2)
        if first.joint == second.joint or frozenset((first.joint, second.joint)) in joined
    )


def carriers(model: Any) -> set[int]:
    """Return the joints that carry a named body or any mass; of several joints of one body only the last does."""
    named = {int(f.parentJoint) for f in model.frames if f.type == pin.FrameType.BODY}
    return named | {joint for joint, body in enumerate(model.inertias) if body.mass > 0.0}


def neighbours(model: Any, loops: Sequence[Loop], world_touches: bool) -> set[frozenset[int]]:
    """Return the pairs of joints whose links a joint or a loop joins; a free base is not joined to the world."""
    out = {frozenset((c.joint1, c.joint2)) for c in loops}
    carry = carriers(model)
    for joint in range(1, model.njoints):
        parent = int(model.parents[joint])
        while parent and parent not in carry:
            parent = int(model.parents[parent])
        if model.joints[joint].shortname() != FREE and not (world_touches and parent == 0):
            out.add(frozenset((joint, parent)))
    return out


def overlapping(
    model: Any, q: Array, links: Sequence[Link], pairs: Iterable[tuple[int, int]]
) -> tuple[set[tuple[int, int]], list[str]]:
    """Return those of some pairs of links, by index, that overlap at q, and a note of them if there are any."""
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    poses = [data.oMi[link.joint] * link.placement for link in links]
    places = [coal.Transform3s(pose.rotation, pose.translation) for pose in poses]
    out, deep = set(), []
    for i, j in sorted(pairs):
        a, b = links[i].shape, links[j].shape
        far = np.linalg.norm(poses[i].translation - poses[j].translation) > a.bounding_radius + b.bounding_radius
        if far or HALFSPACE == a.kind == b.kind:
            continue
        pair = a.geometry, places[i], b.geometry, places[j]
        found = coal.CollisionResult()
        if coal.collide(*pair, coal.CollisionRequest(), found):
            out.add((i, j))
            depth = -float(found.getContact(0).penetration_depth)
            deep.append(f"{links[i].name!r} and {links[j].name!r} ({depth:.3g} m deep)")
    return out, [f"contact of {', '.join(deep)}, which overlap at the start"] if deep else []
