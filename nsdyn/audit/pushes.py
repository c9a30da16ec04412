"""Impulses on free bodies, one by one: when they act in their step, and in which piece of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.audit.poses import Poses
from nsdyn.recording.series import rotate
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Pieces", "Pushes", "times", "together", "velocities"]


class Pieces(NamedTuple):
    """What each contact acts in of steps that are cut.

    Attributes
    ----------
    number : ndarray of int
        0 where that is not known.
    length : ndarray
        s; 0 of an impact in no time, and where it is not known.
    known : ndarray of bool
        Whether they are recorded.
    """

    number: Index
    length: Array
    known: Bools

    @classmethod
    def of(cls, poses: Poses, step: Index) -> Pieces:
        """Of contacts, by the steps that they are in."""
        c, piece, length = poses.trajectory.columns, np.zeros(step.size, np.int64), np.zeros(step.size)
        known = np.zeros(step.size, np.bool_)
        if {f"pieces/{name}" for name in ("offset", "contacts", "duration")} <= c.keys():
            own = np.flatnonzero((np.diff(c["pieces/offset"]) > 0)[step])
            each = np.repeat(np.arange(len(c["pieces/contacts"])), np.maximum(c["pieces/contacts"], 0))
            if each.size == own.size:
                piece[own], length[own], known[own] = each, c["pieces/duration"][each], True
        return cls(piece, length, known)


class Pushes(NamedTuple):
    """Impulses on free bodies, one by one, sorted by step, body and time; two of a contact of two free bodies.

    Attributes
    ----------
    row, side : ndarray of int, shape (m,)
        Of the contact, and 0 or 1 for its first or second body.
    step, body : ndarray of int, shape (m,)
    time : ndarray, shape (m,)
        Within the step, s.
    pieces : Pieces
        What the step was cut into.
    push : ndarray, shape (m, 3)
        World axes, N·s.
    """

    row: Index
    side: Index
    step: Index
    body: Index
    time: Array
    pieces: Pieces
    push: Array

    @classmethod
    def of(cls, frames: Index, free: int, step: Index, time: Array, pieces: Pieces, impulse: Array) -> Pushes:
        """From the frames (contacts, 2) and the impulses (contacts, 3) on the second ones."""
        row, side = np.nonzero((frames >= 0) & (frames < free))
        body, push = frames[row, side], np.where(side, 1.0, -1.0)[:, None] * impulse[row]
        order = np.lexsort((time[row], body, step[row]))
        row, side = row[order], side[order]
        own = Pieces(pieces.number[row], pieces.length[row], pieces.known[row])
        return cls(row, side, step[row], body[order], time[row], own, push[order])

    def summed(self, shape: tuple[int, int], values: Array) -> Array:
        """Sums of values of each impulse by steps and bodies."""
        out = np.zeros((*shape, *values.shape[1:]))
        np.add.at(out, (self.step, self.body), values)
        return out

    def earlier(self, values: Array) -> Array:
        """Of each impulse the sum of values of those before it on its body in its step."""
        so_far, (begin, group) = np.cumsum(values, axis=0) - values, together(self.step, self.body)
        out: Array = so_far - so_far[begin][group]
        return out

    def around(self, values: Array) -> Array:
        """Of each impulse the sums before and after all that act on its body at its time, (2, m, ...)."""
        begin, group = together(self.step, self.body, self.time, self.pieces.number)
        if not begin.size:
            return np.stack([values, values])
        so_far, sums = self.earlier(values), np.add.reduceat(values, begin)
        return np.stack([so_far[begin][group], so_far[begin][group] + sums[group]])

    def alone(self, shape: tuple[int, int]) -> Bools:
        """Which are of the first of at most two instants of their body in its step."""
        (first, group), one, instants = (
            together(self.step, self.body, self.time),
            np.zeros(self.row.size),
            np.zeros(shape),
        )
        one[first] = 1.0
        np.add.at(instants, (self.step[first], self.body[first]), 1)
        out: Bools = (instants[self.step, self.body] <= 2) & (self.earlier(one)[first][group] == 0.0)
        return out


def times(poses: Poses, steps: Index, frames: Index) -> tuple[Array, bool, Bools]:
    """When each contact acts in its step, s; whether that is recorded; and `Flight.cut`."""
    t, free, late = poses.trajectory, poses.free, (1.0 - float(poses.trajectory.meta["theta"])) * poses.trajectory.dt
    when: Array = t.columns["contacts/time"]
    timed = not np.isnan(when).any()
    when = when if timed else np.full(len(when), late)
    cut, met = _fell_in_pieces(poses), np.zeros((2, t.steps, free), np.bool_)
    for side in frames.T:
        own = (side >= 0) & (side < free)
        np.logical_or.at(met[0], (steps[own], side[own]), True)
        np.logical_or.at(met[1], (steps[own], side[own]), np.abs(when[own] - late) > 1e-9 * t.dt)
    return when, timed, np.where(met[0], met[1], cut)


def _fell_in_pieces(poses: Poses) -> Bools:
    """Steps of bodies, (n, free), where what fell does not end as in one piece, if nothing touched it.

    Only with theta above ½ does it matter, and that some seemed to touch on their way and did not is all that cuts.
    """
    t, theta, v = poses.trajectory, float(poses.trajectory.meta["theta"]), velocities(poses)
    forced = t.dt * np.diff(v, axis=0)
    left = np.diff(poses.x[:, : poses.free], axis=0) - t.dt * v[:-1] - theta * forced
    least = 1e-6 * np.linalg.norm(forced, axis=2)
    out: Bools = (np.linalg.norm(left, axis=2) > least) & (theta > 0.5)
    return out


def together(*keys: NDArray[Any]) -> tuple[Index, Index]:
    """Of sorted rows those alike in all keys together: where each group begins, and the group of each row."""
    new = np.ones(keys[0].size, np.bool_)
    new[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return np.flatnonzero(new), np.cumsum(new) - 1


def velocities(poses: Poses) -> Array:
    """Velocities of free bodies in world axes, (n + 1, free, 3), m/s."""
    out: Array = rotate(poses.quaternion[:, : poses.free], poses.v[..., :3])
    return out
