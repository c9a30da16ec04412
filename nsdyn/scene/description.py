"""A scene as plain values, which a recording keeps in order to replay the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from nsdyn.scene import pairs
from nsdyn.scene.tree_description import describe_tree
from nsdyn.scene.visuals import describe_visuals

if TYPE_CHECKING:
    from nsdyn.scene.scene import Scene


def describe(scene: Scene) -> dict[str, Any]:
    """Return everything needed to replay a recording, as nested lists (see `nsdyn.recording.trajectory`)."""
    trees, frame_of = scene.articulations.values(), _frames(scene)
    placed = [(f"{a.name}/{v.body}", frame_of[a.name, v.joint], v) for a in trees for v in a.visuals]
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
        "pairs": [
            {"first": min(bodies), "second": max(bodies), "mu": mu, "restitution": restitution}
            for bodies, (mu, restitution) in scene.pairs.items()
        ],
        "geoms": geoms,
        "excluded": sorted([min(pair), max(pair)] for pair in pairs.excluded(scene, scene.geoms())),
        "frames": [b.name for b in scene.free_bodies]
        + [f"{a}/{scene.articulations[a].model.names[j]}" for a, j in scene.link_frames()]
        + [b.name for b in scene.driven_bodies],
        "links": describe_links(scene),
        **(describe_visuals(placed) if placed else {}),
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
            for a in trees
        ],
    }


def _frames(scene: Scene) -> dict[tuple[str, int], int]:
    """Return the moving frames by articulation and joint, -1 for the world."""
    first = len(scene.free_bodies)
    moving = {key: first + k for k, key in enumerate(scene.link_frames())}
    return moving | {(name, 0): -1 for name in scene.articulations}


def describe_links(scene: Scene) -> list[dict[str, Any]]:
    """Return the bodies of articulations that a recording shows: name, moving frame (-1 for the world), pose in it."""
    frame_of = _frames(scene)
    return [
        {"name": f"{a.name}/{f.name}", "frame": frame_of[key], "placement": f.placement.homogeneous.tolist()}
        for a in scene.articulations.values()
        for f in a.model.frames
        if f.type == pin.FrameType.BODY and (key := (a.name, int(f.parentJoint))) in frame_of
    ]
