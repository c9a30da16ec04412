"""Tables of the joints and loops of a recording: their motion, the forces in them, and their reactions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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
"""Units of the columns of a table of joints, for all kinds of coordinates."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Motion and forces of a joint; arrays have no second axis if the joint has one coordinate.

    Attributes
    ----------
    name : str
    position, velocity : ndarray, shapes (n + 1, nq), (n + 1, nv)
        At the times t; rad or m, and per s.
    torque : ndarray, shape (n, nv)
        Mean actuation in each step, from the return value of the controller or from `nsdyn.PD`, N m or N.
    limit_impulse, friction : ndarray, shape (n, nv)
        Impulse of the limits in each step [N m s or N s], and mean dry friction [N m or N].
    external : ndarray, shape (n, nv)
        Mean generalised force of the external wrenches on the links in each step, N m or N.
    shift : ndarray, shape (n, nv)
        Displacement by the position projections of each step, rad or m.
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

        It is the total force that a sensor in the joint would measure: constraint forces, actuation, limits, friction,
        damping and springs, and the impulses of impacts divided by dt. It follows from the balance of momentum of all
        links beyond the joint (`nsdyn.recording.reactions`). If one of N steps is recorded, it is the mean over all N.
        """
        return self._reaction()[:, :3]

    @property
    def reaction_torque(self) -> Array:
        """Mean torque in each step that the joint passes on to its child, shape (n, 3), N m, world axes.

        The torque is about the origin of the joint's frame on the child, at its position halfway through the step. It
        is of second order in the time between recorded states, of first order in a step with an impact.
        """
        return self._reaction()[:, 3:]

    def __repr__(self) -> str:
        return f"<JointMotion of {self.name!r}: {counted(len(self.position), 'state')}>"


@dataclass(frozen=True, eq=False)
class LoopReaction:
    """Reaction in a closed loop.

    Attributes
    ----------
    name : str
    reaction_force, reaction_torque : ndarray, shape (n, 3)
        Mean in each step on the link of the loop's first frame, at that frame; the link of the second frame receives
        the opposite. World axes, N and N m; as in `JointMotion`. For redundant loops, the reactions of least norm of
        forces and torques.
    """

    name: str
    reaction_force: Array
    reaction_torque: Array

    def __repr__(self) -> str:
        return f"<LoopReaction of {self.name!r}: {counted(len(self.reaction_force), 'step')}>"


def joint(trajectory: Trajectory, name: str) -> JointMotion:
    """Return the motion of the joint "articulation/joint"; see `nsdyn.Trajectory.joint`."""
    found = coordinates(trajectory, choice(name, link_names.joints(trajectory.scene), "joint"))
    if found["velocity"].shape[1] == 1:
        found = {what: values[:, 0] for what, values in found.items()}
    return JointMotion(name, **found, _reaction=partial(_reaction, trajectory, name))


def _reaction(trajectory: Trajectory, name: str) -> Array:
    return trajectory.reactions[name]


def coordinates(trajectory: Trajectory, name: str) -> dict[str, Array]:
    """Return the arrays of `JointMotion` for a joint by name, each with a column per coordinate."""
    scene = trajectory.scene
    free, sizes = scene["free"], np.concatenate([np.array(a["sizes"]) for a in scene["articulations"]])
    which = link_names.joints(scene).index(name)
    q, v = np.sum(sizes[:which], axis=0)
    nq, nv = sizes[which]
    position, velocity = (
        x[:, at : at + size] for x, at, size in ((trajectory.q, 7 * free + q, nq), (trajectory.v, 6 * free + v, nv))
    )
    if (nq, nv) == (2, 1):  # cosine and sine of an angle; the angle counts whole turns
        position = np.unwrap(np.arctan2(position[:, 1], position[:, 0]))[:, None]
    duration = trajectory.dt * trajectory.every
    actuation, limit, drag, external, shift, *_ = (trajectory.columns[name][:, v : v + nv] for name in JOINTS)
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
    """Return the reaction in the loop "articulation/loop"; see `nsdyn.Trajectory.loop`."""
    found = trajectory.reactions[choice(name, link_names.loops(trajectory.scene), "loop")]
    return LoopReaction(name, found[:, :3], found[:, 3:])


def _named(trajectory: Trajectory, name: str, count: int) -> list[tuple[str, str]]:
    """Return name and unit of each coordinate of a joint.

    The name is that of an axis (x along it, rx about it) or else a number, and empty for an only coordinate. The unit
    is empty for quaternions and cosines, and for loops.
    """
    told = [joint for a in trajectory.scene["articulations"] for joint in a["model"]["joints"]]
    kinds = dict(zip(link_names.joints(trajectory.scene), (joint["kind"] for joint in told), strict=True))
    kind = kinds.get(name, "").removeprefix("JointModel")
    if kind in AXES:
        return list(AXES[kind].items())
    unit = "" if kind in ("", "Composite") else "m" if kind.startswith("P") else "rad"
    return [(str(k + 1) if count > 1 else "", unit) for k in range(count)]


def joint_columns(trajectory: Trajectory, pattern: str, step: int | None) -> tuple[Columns, dict[str, str]]:
    """Return columns, and their units, of joints and loops in all states or in one; see `nsdyn.Trajectory.table`."""
    from nsdyn.recording.reactions import reactions  # loads Pinocchio, not needed to read a recording

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
"""Columns of every coordinate of a joint."""

AXES = {
    "FreeFlyer": {**dict.fromkeys("xyz", "m"), **dict.fromkeys(("rx", "ry", "rz", "rw"), "")},
    "Spherical": dict.fromkeys(("rx", "ry", "rz", "rw"), ""),
    "Planar": {"x": "m", "y": "m", "rz": "", "rw": ""},
    "Translation": dict.fromkeys("xyz", "m"),
    "SphericalZYX": dict.fromkeys(("rz", "ry", "rx"), "rad"),
}
"""Coordinates of joints that have several, along and about axes, with their units.

Spherical rotations are given by a quaternion, planar ones by cosine and sine. Velocities are in axes of the child."""
