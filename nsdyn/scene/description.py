"""A scene as plain values, from which a recording is replayed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from nsdyn.scene import pairs
from nsdyn.scene.tree_description import describe_tree

if TYPE_CHECKING:
    from nsdyn.scene.scene import Scene

__all__ = ["describe"]


def describe(scene: Scene) -> dict[str, Any]:
    """Everything needed to replay a recording, as nested lists (see `nsdyn.recording.trajectory`)."""
    geoms = []
    for g in scene.geoms():
        placement = np.eye(4)
        placement[:3, :3], placement[:3, 3] = g.placement_R, g.placement_t
        geoms.append(
            {
                "name": g.name,
                "body": g.body,
                "link": g.link,
                "frame": g.frame,
                "placement": placement.tolist(),
                "mu": g.material.mu,
                "restitution": g.material.restitution,
                "colour": None if g.colour is None else list(g.colour),
                **g.shape.describe(),
            }
        )
    return {
        "name": scene.name,
        "gravity": scene.gravity.tolist(),
        "friction_rule": scene.friction_rule,
        "restitution_rule": scene.restitution_rule,
        "geoms": geoms,
        "excluded": sorted([min(pair), max(pair)] for pair in pairs.excluded(scene, scene.geoms())),
        "frames": [b.name for b in scene.free_bodies]
        + [f"{a}/{scene.articulations[a].model.names[j]}" for a, j in scene.link_frames()]
        + [b.name for b in scene.driven_bodies],
        "links": _describe_links(scene),
        "motions": {name: motion.kind for name, motion in scene.motions.items()},
        "free": len(scene.free_bodies),
        "masses": [b.mass for b in scene.free_bodies],
        "inertias": [b.inertia.tolist() for b in scene.free_bodies],
        "articulations": [
            {
                "name": a.name,
                "nq": a.model.nq,
                "nv": a.model.nv,
                "joints": list(a.model.names)[1:],
                "sizes": [[joint.nq, joint.nv] for joint in list(a.model.joints)[1:]],
                "model": describe_tree(a, scene.motions),
            }
            for a in scene.articulations.values()
        ],
    }


def _describe_links(scene: Scene) -> list[dict[str, Any]]:
    """Bodies of articulations that a recording shows: name, moving frame (-1 for the world), pose in it."""
    first, frames = len(scene.free_bodies), scene.link_frames()
    frame_of = {key: first + k for k, key in enumerate(frames)} | {(name, 0): -1 for name in scene.articulations}
    return [
        {"name": f"{a.name}/{f.name}", "frame": frame_of[key], "placement": f.placement.homogeneous.tolist()}
        for a in scene.articulations.values()
        for f in a.model.frames
        if f.type == pin.FrameType.BODY and (key := (a.name, int(f.parentJoint))) in frame_of
    ]
