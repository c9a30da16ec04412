"""Couplings of the joints of an articulation besides its tree: closed loops and gears."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pinocchio as pin

from nsdyn.scene import checks, exclusions
from nsdyn.scene.articulations import Articulation, Loop
from nsdyn.scene.gears import GearGaps, gear
from nsdyn.tools.naming import choice


def close_loop(articulation: Articulation, name: str, frames: tuple[str, str], at: Any, kind: str) -> Articulation:
    """Return the articulation with one more loop, closed in its initial configuration; see `nsdyn.Scene.add_loop`."""
    model = articulation.model
    if kind not in ("point", "frame"):
        raise ValueError(f"kind of {name!r} must be 'point' or 'frame', got {kind!r}")
    checks.name(name, f"name of a loop of {articulation.name!r}")
    if any(loop.name == name for loop in articulation.loops):
        raise ValueError(f"name must be unique among the loops of {articulation.name!r}, {name!r} is taken")
    known = {f.name: f for f in model.frames}
    for what, frame in zip(("frame1", "frame2"), frames, strict=True):
        choice(frame, known, f"{what} of {name!r}, a frame of {articulation.name!r},")
    first, second = (known[frame] for frame in frames)
    placement1 = first.placement * at
    data = model.createData()
    pin.forwardKinematics(model, data, articulation.q)
    joint1, joint2 = int(first.parentJoint), int(second.parentJoint)
    if joint1 == joint2:
        raise ValueError(f"frame2 of {name!r} must be on another link than frame1, {frames[0]!r}, got {frames[1]!r}")
    loop = Loop(name, joint1, placement1, joint2, data.oMi[joint2].actInv(data.oMi[joint1] * placement1), kind)
    return replace(
        articulation,
        loops=(*articulation.loops, loop),
        excluded=articulation.excluded | exclusions.joined(articulation.links, {frozenset((joint1, joint2))}),
    )


def put_gear(articulation: Articulation, joints: tuple[str, str], ratio: float, offset: float | None) -> Articulation:
    """Return the articulation with one more gear; see `nsdyn.Scene.add_gear`."""
    name = f"gear '{articulation.name}/{joints[1]}'"
    model, q = articulation.model, articulation.q
    added = gear(model, name, joints, ratio, 0.0 if offset is None else offset)
    if offset is None:
        added = replace(added, offset=float(GearGaps(model, [added]).at(q)[0]))
    return replace(articulation, gears=(*articulation.gears, added))
