"""Tables of the joints and loops of a recording: how they move, what acts in them, and their reactions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording import link_names
from nsdyn.recording.columns import JOINTS, Columns
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice, counted
from nsdyn.tools.table import matching

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["JointMotion", "LoopReaction", "coordinates", "joint", "joint_columns", "loop"]

UNITS = {
    "position": "rad or m",
    "velocity": "rad/s or m/s",
    "torque": "N m or N",
    "limit": "N m or N",
    "friction": "N m or N",
    "external": "N m or N",
    "shift": "rad or m",
    **dict.fromkeys((f"reaction_force_{axis}" for axis in "xyz"), "N"),
    **dict.fromkeys((f"reaction_torque_{axis}" for axis in "xyz"), "N m"),
}
"""Of the columns of a table of joints, whatever coordinate they are of."""


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
        return f"<JointMotion of {self.name!r}: {counted(len(self.position), 'state')}>"


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
        return f"<LoopReaction of {self.name!r}: {counted(len(self.reaction_force), 'step')}>"


def joint(trajectory: Trajectory, name: str) -> JointMotion:
    """Motion of the joint "articulation/joint"; see `nsdyn.Trajectory.joint`."""
    found = coordinates(trajectory, choice(name, link_names.joints(trajectory.scene), "joint"))
    if found["velocity"].shape[1] == 1:
        found = {what: values[:, 0] for what, values in found.items()}
    return JointMotion(name, **found, _reaction=lambda: trajectory.reactions[name])


def coordinates(trajectory: Trajectory, name: str) -> dict[str, Array]:
    """Of a joint what `JointMotion` has of its coordinates, by columns."""
    scene = trajectory.scene
    if any("sizes" not in a for a in scene["articulations"]):
        raise ValueError("joints have no places in recordings before format 4")
    free, sizes = scene["free"], np.concatenate([np.array(a["sizes"]) for a in scene["articulations"]])
    which = link_names.joints(scene).index(name)
    q, v = np.sum(sizes[:which], axis=0)
    nq, nv = sizes[which]
    position, velocity = (
        x[:, at : at + size] for x, at, size in ((trajectory.q, 7 * free + q, nq), (trajectory.v, 6 * free + v, nv))
    )
    if (nq, nv) == (2, 1):  # cos and sin of an angle, which goes on over turns
        position = np.unwrap(np.arctan2(position[:, 1], position[:, 0]))[:, None]
    nothing, duration = np.full((trajectory.steps, nv), np.nan), trajectory.dt * trajectory.every
    told = [trajectory.columns.get(column) for column in JOINTS]
    actuation, limit, drag, external, shift, *_ = (nothing if x is None else x[:, v : v + nv] for x in told)
    return {
        "position": position,
        "velocity": velocity,
        "torque": actuation / duration,
        "limit_impulse": limit,
        "friction": drag / duration,
        "external": external / duration,
        "shift": shift,
    }


def loop(trajectory: Trajectory, name: str) -> LoopReaction:
    """Reaction in the loop "articulation/loop"; see `nsdyn.Trajectory.loop`."""
    found = trajectory.reactions[choice(name, link_names.loops(trajectory.scene), "loop")]
    return LoopReaction(name, found[:, :3], found[:, 3:])


def _named(trajectory: Trajectory, name: str, count: int) -> list[tuple[str, str]]:
    """Name and unit of each coordinate of a joint: along and about axes or a number, without one if it is the only one.

    The unit is empty for quaternions, cosines and what a recording does not tell.
    """
    told = [joint for a in trajectory.scene["articulations"] for joint in a.get("model", {}).get("joints", ())]
    names = link_names.joints(trajectory.scene)
    known = len(told) == len(names) and name in names
    kind = told[names.index(name)]["kind"].removeprefix("JointModel") if known else ""
    if kind in AXES:
        return list(AXES[kind].items())
    unit = "" if kind in ("", "Composite") else "m" if kind.startswith("P") else "rad"
    return [(str(k + 1) if count > 1 else "", unit) for k in range(count)]


def joint_columns(trajectory: Trajectory, pattern: str, step: int | None) -> tuple[Columns, dict[str, str]]:
    """Joints and loops in all states, or in one, by columns, and the units of these; see `nsdyn.Trajectory.table`."""
    from nsdyn.recording.reactions import reactions  # Pinocchio, which to read a recording does not need

    t, joints = trajectory, link_names.joints(trajectory.scene)
    names = matching([*joints, *link_names.loops(t.scene)], pattern, "joints")
    found = {name: coordinates(t, name) if name in joints else {} for name in names}
    states = np.arange(t.steps + 1) if step is None else np.array([step])
    ended = states > 0  # a step ends at every state but the first
    passed = t.reactions if step is None else reactions(t, states[ended] - 1)
    labels, parts = list[tuple[str, str, str]](), list[Array]()
    for name, moved in found.items():
        count = max((values.shape[1] for values in moved.values()), default=1)
        for k, own in enumerate(_named(t, name, count)):
            part = np.full((states.size, len(COORDINATE) + 6), np.nan)
            for column, what in enumerate(COORDINATE):
                values = moved.get(what, np.empty((0, 0)))
                if k < values.shape[1]:
                    rows = ended if len(values) == t.steps else states >= 0
                    part[rows, column] = values[states[rows] - (len(values) == t.steps), k]
            part[ended, len(COORDINATE) :] = passed[name]
            labels.append((name, *own))
            parts.append(part)
    at = np.repeat(states, len(parts))
    out: Columns = {"step": at, "t": t.t[at]}
    for label, words in zip(("joint", "coordinate", "unit"), zip(*labels, strict=True), strict=True):
        out[label] = np.tile(words, states.size)
    values = np.stack(parts, axis=1).reshape(len(at), -1)
    out |= dict(zip(UNITS, values.T, strict=True))
    out["limit"] = out["limit"] / (t.dt * t.every)
    return out, UNITS


COORDINATE = "position", "velocity", "torque", "limit_impulse", "friction", "external", "shift"
"""What every coordinate of a joint has."""

AXES = {
    "FreeFlyer": {**dict.fromkeys("xyz", "m"), **dict.fromkeys(("rx", "ry", "rz", "rw"), "")},
    "Spherical": dict.fromkeys(("rx", "ry", "rz", "rw"), ""),
    "Planar": {"x": "m", "y": "m", "rz": "", "rw": ""},
    "Translation": dict.fromkeys("xyz", "m"),
    "SphericalZYX": dict.fromkeys(("rz", "ry", "rx"), "rad"),
}
"""Coordinates of joints that have several, with their units: along and about axes.

The place of a rotation is a quaternion, of a planar one its cosine and sine. Velocities are in axes of the child."""
