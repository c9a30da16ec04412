"""Tables of the joints and loops of a recording: how they move, what acts in them, and their reactions."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording import links
from nsdyn.recording.file import JOINTS
from nsdyn.recording.tables import framed
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import choice, meant

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["JointMotion", "LoopReaction", "coordinates", "heading", "joint", "joint_table", "loop"]

UNITS = {
    "t": "s", "position": "rad or m", "velocity": "rad/s or m/s", "torque": "N m or N", "limit_impulse": "N m s or N s",
    "friction": "N m or N", "external": "N m or N", "shift": "rad or m", "reaction_force": "N",
    "reaction_torque": "N m about its origin",
}  # fmt: skip
"""Of the columns of `joint_table`, whatever coordinate or axis they are of."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Motion of a joint and what acts in it; without the second axis where it has one coordinate.

    Attributes
    ----------
    name : str
    position, velocity : ndarray, shapes (n + 1, nq), (n + 1, nv)
        At the times t; rad or m, and per s.
    torque : ndarray, shape (n, nv)
        Mean actuation in each step, what the controller gave and `nsdyn.PD` made of it, N m or N.
    limit_impulse, friction : ndarray, shape (n, nv)
        Impulse of the limits in each step [N m s or N s], and mean dry friction [N m or N].
    external : ndarray, shape (n, nv)
        What external wrenches on the links do to the coordinates, the mean in each step, N m or N.
    shift : ndarray, shape (n, nv)
        Displacement by the position projections of each step, rad or m. NaN, as all that acts, in recordings that do
        not tell.
    """

    name: str
    position: Array
    velocity: Array
    torque: Array
    limit_impulse: Array
    friction: Array
    external: Array
    shift: Array
    _reaction: Callable[[], Array]

    @property
    def reaction_force(self) -> Array:
        """Mean force in each step that the joint passes on to its child, shape (n, 3), N, world axes.

        All of it: what the joint constrains, its actuation, limits, friction, damping and springs, as a sensor in it
        would measure; the impulses of impacts over dt. It is found by the balance of momentum of all links beyond
        (`nsdyn.recording.reactions`). Where of N steps one is recorded it is the mean over all N. NaN in recordings
        before format 7, which do not tell masses, or on which links external forces act.
        """
        return self._reaction()[:, :3]

    @property
    def reaction_torque(self) -> Array:
        """Mean torque of the same about the origin of the joint's frame on the child, shape (n, 3), N m, world axes.

        About where that origin is halfway through the step: to second order in the time between recorded states, to
        first order in a step with an impact.
        """
        return self._reaction()[:, 3:]

    def __repr__(self) -> str:
        return f"<JointMotion of {self.name!r}: {len(self.position)} states>"


@dataclass(frozen=True, eq=False)
class LoopReaction:
    """What a closed loop does.

    Attributes
    ----------
    name : str
    reaction_force, reaction_torque : ndarray, shape (n, 3)
        Mean in each step on the link of its first frame, at that frame; its opposite is on the second's. World axes, N
        and N m; as of `JointMotion`. Where loops are redundant, the least in the norm of forces and torques.
    """

    name: str
    reaction_force: Array
    reaction_torque: Array

    def __repr__(self) -> str:
        return f"<LoopReaction of {self.name!r}: {len(self.reaction_force)} steps>"


def joint(trajectory: Trajectory, name: str) -> JointMotion:
    """Motion of the joint "articulation/joint"; see `nsdyn.Trajectory.joint`."""
    found = coordinates(trajectory, choice(name, links.joints(trajectory.scene), "joint"))
    if found["velocity"].shape[1] == 1:
        found = {what: values[:, 0] for what, values in found.items()}
    return JointMotion(name, **found, _reaction=lambda: trajectory.reactions[name])


def coordinates(trajectory: Trajectory, name: str) -> dict[str, Array]:
    """Of a joint what `JointMotion` has of its coordinates, by columns."""
    scene = trajectory.scene
    if any("sizes" not in a for a in scene["articulations"]):
        raise ValueError("joints have no places in recordings before format 4")
    free, sizes = scene["free"], np.concatenate([np.array(a["sizes"]) for a in scene["articulations"]])
    which = links.joints(scene).index(name)
    q, v = np.sum(sizes[:which], axis=0)
    nq, nv = sizes[which]
    position, velocity = (x[:, at : at + size] for x, at, size in (
        (trajectory.q, 7 * free + q, nq), (trajectory.v, 6 * free + v, nv)
    ))  # fmt: skip
    if (nq, nv) == (2, 1):  # cos and sin of an angle, which goes on over turns
        position = np.unwrap(np.arctan2(position[:, 1], position[:, 0]))[:, None]
    nothing, duration = np.full((trajectory.steps, nv), np.nan), trajectory.dt * trajectory.every
    told = [trajectory.columns.get(column) for column in JOINTS]
    actuation, limit, drag, external, shift, *_ = (nothing if x is None else x[:, v : v + nv] for x in told)
    return {
        "position": position, "velocity": velocity, "torque": actuation / duration, "limit_impulse": limit,
        "friction": drag / duration, "external": external / duration, "shift": shift,
    }  # fmt: skip


def loop(trajectory: Trajectory, name: str) -> LoopReaction:
    """Reaction in the loop "articulation/loop"; see `nsdyn.Trajectory.loop`."""
    found = trajectory.reactions[choice(name, links.loops(trajectory.scene), "loop")]
    return LoopReaction(name, found[:, :3], found[:, 3:])


def heading(column: str) -> str:
    """A column of `joint_table` with its unit."""
    unit = next((unit for name, unit in UNITS.items() if re.fullmatch(rf"{name}(_[\dxyz])?", column)), "")
    return f"{column} [{unit}]" if unit else column


def joint_table(trajectory: Trajectory, pattern: str, steps: Index) -> Any:
    """Joints and loops of some steps, from 1 on, by columns; see `nsdyn.Trajectory.joint_table`."""
    from nsdyn.recording.reactions import reactions  # Pinocchio, which to read a recording does not need

    joints, n = links.joints(trajectory.scene), steps.size
    known = [*joints, *links.loops(trajectory.scene)]
    names = [name for name in known if fnmatchcase(name, pattern)]
    if not names:
        raise ValueError(
            f"{meant(pattern, known)}joints must match one of {', '.join(known) or 'none'}; got {pattern!r}"
        )
    step = np.repeat(steps, len(names))
    out: dict[str, NDArray[Any]] = {"step": step, "t": trajectory.t[step], "joint": np.tile(names, n)}
    moving = {k: coordinates(trajectory, name) for k, name in enumerate(names) if name in joints}
    for what in ("position", "velocity", "torque", "limit_impulse", "friction", "external", "shift"):
        columns = np.full((n, len(names), max((m[what].shape[1] for m in moving.values()), default=1)), np.nan)
        for k, m in moving.items():
            columns[:, k, : m[what].shape[1]] = m[what][len(m[what]) - trajectory.steps :][
                steps - 1
            ]  # states end steps
        out |= {f"{what}_{c + 1}" if c else what: columns[:, :, c].ravel() for c in range(columns.shape[2])}
    found = trajectory.reactions if n == trajectory.steps else reactions(trajectory, steps - 1)
    reaction = np.stack([found[name] for name in names], axis=1)
    for what, part in (("reaction_force", reaction[:, :, :3]), ("reaction_torque", reaction[:, :, 3:])):
        out |= {f"{what}_{axis}": part[:, :, k].ravel() for k, axis in enumerate("xyz")}
    return framed(out)
