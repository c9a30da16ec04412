"""Motion of the bodies of a page: the animation of meshcat's viewer, keyframes as binary arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording.commands import Json, float_list, set_property
from nsdyn.recording.solids import body_path
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["motion_commands"]


def motion_commands(trajectory: Trajectory, rows: Index, radius: float) -> list[Json]:
    """Poses at the first of the rows, and the animation through all of them, of a scene of that radius."""
    commands, clips = [], []
    t = trajectory.t[rows] - trajectory.t[0]
    for name in trajectory.scene["frames"]:
        motion, path = trajectory.body(name), body_path(name)
        tracks = {"position": motion.position[rows], "quaternion": motion.quaternion[rows]}
        commands += [set_property(path, key, values[0].tolist()) for key, values in tracks.items()]
        moving = [_track(key, t, values, radius) for key, values in tracks.items()]
        moving = [track for track in moving if track]
        if moving:
            clip = {"fps": 1, "name": "default", "duration": float(t[-1]), "tracks": moving}
            clips.append({"path": path, "clip": clip})
    if clips:
        commands.append({"type": "set_animation", "path": "", "animations": clips, "options": {"play": False}})
    return commands


def _track(name: str, t: Array, values: Array, radius: float) -> Json | None:
    """Keyframes of one property, none if it is constant, without those that change nothing."""
    # Differences below a millionth of the scene, or of a unit quaternion, are invisible.
    grid = np.round(values / (1e-6 * (1.0 if name == "quaternion" else radius)))
    changes = (grid[1:] != grid[:-1]).any(axis=1)
    if not changes.any():
        return None
    keep = np.concatenate([[True], changes])
    keep[:-1] |= changes  # a line that ends needs the key where it begins too
    kind = "quaternion" if name == "quaternion" else "vector3"
    return {"name": f".{name}", "type": kind, "times": float_list(t[keep]), "values": float_list(values[keep])}
