"""Motion of the bodies of a page: initial poses, and keyframes of the bodies that move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording.body_motion import of_frame
from nsdyn.tools.arrays import Array, Index
from nsdyn.view.commands import Json, set_property
from nsdyn.view.solids import body_path

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

INVISIBLE = 1e-6
"""Differences below this fraction of the scene's radius, or of a unit quaternion, are invisible."""


def start_commands(trajectory: Trajectory, row: int) -> list[Json]:
    """Return commands that set the poses of all moving frames to those of a row of the recording."""
    commands = []
    for k, name in enumerate(trajectory.scene["frames"]):
        motion, path = of_frame(trajectory, k), body_path(name)
        commands.append(set_property(path, "position", motion.position[row].tolist()))
        commands.append(set_property(path, "quaternion", motion.quaternion[row].tolist()))
    return commands


def keys(trajectory: Trajectory, rows: Index, radius: float) -> dict[str, Array]:
    """Return the keyframes of a scene of the given radius at the states `rows`.

    Returns
    -------
    dict of str to ndarray
        position (k, len(rows), 3), m, and quaternion (m, len(rows), 4) xyzw of the frames whose position or quaternion
        changes, rounded to visible digits; moving (k,) and turning (m,), the indices of the frames.
    """
    out: dict[str, Array] = {}
    motions = [of_frame(trajectory, k) for k in range(len(trajectory.scene["frames"]))]
    for name, which, scale in (("position", "moving", radius), ("quaternion", "turning", 1.0)):
        grid = 2.0 ** np.floor(np.log2(INVISIBLE * scale))  # a power of 2: its multiples compress well
        values = [grid * np.round(getattr(motion, name)[rows] / grid) for motion in motions]
        changing = [k for k, x in enumerate(values) if (x != x[0]).any()]
        width = 3 if name == "position" else 4
        out[name] = np.array([values[k] for k in changing]).reshape(-1, rows.size, width)
        out[which] = np.array(changing, dtype=np.int64)
    return out
