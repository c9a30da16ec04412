"""Impulses on free bodies, one by one: when they act in their step, and how long the move takes that they act in."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.audit.poses import Poses
from nsdyn.recording.series import rotate
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["UNTIMED", "Pushes", "Times", "together", "velocities"]


UNTIMED = "in what moves impulses acted is not recorded"
"""Why what hangs on it is not audited of older recordings."""


class Pushes(NamedTuple):
    """Impulses on free bodies, one by one, sorted by step, body and time; two of a contact of two free bodies.

    Attributes
    ----------
    row, side : ndarray of int, shape (m,)
        Of the contact, and 0 or 1 for its first or second body.
    step, body : ndarray of int, shape (m,)
    time, length : ndarray, shape (m,)
        Within the step, s, and of the move that it acts in, 0 of an impact in no time.
    push : ndarray, shape (m, 3)
        World axes, N·s.
    """

    row: Index
    side: Index
    step: Index
    body: Index
    time: Array
    length: Array
    push: Array

    @classmethod
    def of(cls, frames: Index, free: int, step: Index, times: Times, impulse: Array) -> Pushes:
        """From the frames (contacts, 2) and the impulses (contacts, 3) on the second ones."""
        row, side = np.nonzero((frames >= 0) & (frames < free))
        body, push = frames[row, side], np.where(side, 1.0, -1.0)[:, None] * impulse[row]
        order = np.lexsort((times.length[row], times.time[row], body, step[row]))
        row, side = row[order], side[order]
        return cls(row, side, step[row], body[order], times.time[row], times.length[row], push[order])

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
        begin, group = together(self.step, self.body, self.time, self.length)
        if not begin.size:
            return np.stack([values, values])
        so_far, sums = self.earlier(values), np.add.reduceat(values, begin)
        return np.stack([so_far[begin][group], so_far[begin][group] + sums[group]])


class Times(NamedTuple):
    """When each contact acts.

    Attributes
    ----------
    time, length : ndarray, shape (contacts,)
        Within its step, s, and of the move that it acts in, 0 of an impact in no time.
    known : bool
        Whether both are recorded; without, all are taken to act in steps of one piece.
    """

    time: Array
    length: Array
    known: bool

    @classmethod
    def of(cls, poses: Poses) -> Times:
        """Of all contacts of a recording."""
        c, h, late = poses.contacts, poses.trajectory.dt, 1.0 - float(poses.trajectory.meta["theta"])
        known = not (np.isnan(c["time"]).any() or np.isnan(c["duration"]).any())
        if known:
            return cls(c["time"], c["duration"], True)
        return cls(np.full(poses.step.size, late * h), np.full(poses.step.size, h), False)

    def cut(self, poses: Poses) -> Bools:
        """`Flight.cut`: whether any contact of a body acts in less than the step, or it fell in pieces."""
        out, whole = _fell_in_pieces(poses), np.ones((poses.trajectory.steps, poses.free), np.bool_)
        met = ~whole
        for side in poses.frame[poses.pair]:
            own = (side >= 0) & (side < poses.free)
            met[poses.step[own], side[own]] = True
            short = own & (self.length < poses.trajectory.dt)
            whole[poses.step[short], side[short]] = False
        return np.where(met, ~whole, out)


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
