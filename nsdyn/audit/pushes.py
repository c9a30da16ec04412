"""Impulses and lifts on free bodies, one by one, with their times within the step and the durations of their moves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.audit.poses import Poses
from nsdyn.recording.series import rotate
from nsdyn.tools.arrays import Array, Bools, Index

LIFT = -2
"""Value of `Pushes.row` for lifts."""


class Pushes(NamedTuple):
    """Impulses on free bodies, one by one, sorted by step, body and time; a contact of two free bodies has two.

    External wrenches are included, and so are lifts: displacements by the position projections that end moves. A lift
    stands after all impulses of its move.

    Attributes
    ----------
    row, side : ndarray of int, shape (m,)
        Of the contact, and 0 or 1 for its first or second body; row is -1 for wrenches and -2 for lifts.
    step, body : ndarray of int, shape (m,)
    time, length : ndarray, shape (m,)
        Time within the step, s, and duration of the move, 0 for an instantaneous impact.
    push, couple : ndarray, shape (m, 3)
        Impulse and couple on the body, world axes, N·s and N·m·s.
    shift : ndarray, shape (m, 6)
        Displacement of the centre of mass, m, and rotation vector, rad, world axes; nonzero for lifts only.
    """

    row: Index
    side: Index
    step: Index
    body: Index
    time: Array
    length: Array
    push: Array
    couple: Array
    shift: Array

    @classmethod
    def of(cls, poses: Poses, impulse: Array) -> Pushes:
        """Build from a recording and the impulses (contacts, 3) on the second bodies of its contacts."""
        frames = poses.frame[poses.pair].T
        row, side = np.nonzero(poses.is_free(frames))
        sign, met = np.where(side, 1.0, -1.0)[:, None], poses.contacts
        columns: list[Any] = [row, side, poses.step[row], frames[row, side], met["time"][row], met["duration"][row]]
        columns += [sign * impulse[row], sign * met["couple"][row], np.zeros((row.size, 6))]
        c = poses.trajectory.columns
        for mark, (group, name) in enumerate((("wrenches", "impulse"), ("lifts", "shift"))):
            if f"{group}/offset" in c:  # wrenches are recorded only where there may be any
                count, did = np.diff(c[f"{group}/offset"]), c[f"{group}/{name}"]
                none, step = np.full(count.sum(), -1 - mark), np.repeat(np.arange(count.size), count)
                of_moves = (c[f"{group}/{of}"] for of in ("body", "time", "duration"))
                push, shift = (did, np.zeros_like(did))[:: -1 if mark else 1]
                more = [none, none, step, *of_moves, push[:, :3], push[:, 3:], shift]
                columns = [np.concatenate(both) for both in zip(columns, more, strict=True)]
        order = np.lexsort((columns[0] == LIFT, columns[5], columns[4], columns[3], columns[2]))
        return cls(*(column[order] for column in columns))

    def cut(self, poses: Poses) -> Bools:
        """`Flight.cut`: whether a move shorter than the step acts on a body, or the body fell in several moves."""
        whole = np.ones((poses.trajectory.steps, poses.free), np.bool_)
        met, short = ~whole, self.length < poses.trajectory.dt
        met[self.step, self.body] = True
        whole[self.step[short], self.body[short]] = False
        return np.where(met, ~whole, _fell_in_pieces(poses))

    def summed(self, shape: tuple[int, int], values: Array) -> Array:
        """Sum values of the impulses by step and body."""
        out = np.zeros((*shape, *values.shape[1:]))
        np.add.at(out, (self.step, self.body), values)
        return out

    def earlier(self, values: Array) -> Array:
        """For each impulse, sum the values of the earlier impulses on its body in its step.

        No differences of a cumulative sum over all impulses are used: their round-off would hide those on light bodies.
        """
        begin, group = together(self.step, self.body)
        rank, out = np.arange(group.size) - begin[group], np.zeros(values.shape)
        order = np.argsort(rank, kind="stable")
        for some in np.split(order, np.flatnonzero(np.diff(rank[order])) + 1)[1:]:
            out[some] = out[some - 1] + values[some - 1]
        return out

    def around(self, values: Array) -> Array:
        """For each impulse, sums of values before and after all that act on its body at its time, (2, m, ...)."""
        begin, group = together(self.step, self.body, self.time, self.length)
        if not begin.size:
            return np.stack([values, values])
        so_far, sums = self.earlier(values), np.add.reduceat(values, begin)
        return np.stack([so_far[begin][group], so_far[begin][group] + sums[group]])


def _fell_in_pieces(poses: Poses) -> Bools:
    """Steps (n, free) in which a body that nothing touched ends elsewhere than after a fall in one move.

    This matters for theta above ½ only. The step is then cut because of contacts that seemed to close but did not.
    """
    t, theta, v = poses.trajectory, poses.theta, velocities(poses)
    forced = t.dt * np.diff(v, axis=0)
    left = np.diff(poses.x[:, : poses.free], axis=0) - t.dt * v[:-1] - theta * forced
    least = 8.0 * np.finfo(float).eps * np.linalg.norm(poses.x[1:, : poses.free], axis=2)
    return (np.linalg.norm(left, axis=2) > least) & (theta > 0.5)


def together(*keys: NDArray[Any]) -> tuple[Index, Index]:
    """Group sorted rows that are equal in all keys: return where each group begins, and the group of each row."""
    new = np.ones(keys[0].size, np.bool_)
    new[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return np.flatnonzero(new), np.cumsum(new) - 1


def velocities(poses: Poses) -> Array:
    """Velocities of free bodies in world axes, (n + 1, free, 3), m/s."""
    return rotate(poses.quaternion[:, : poses.free], poses.v[..., :3])
