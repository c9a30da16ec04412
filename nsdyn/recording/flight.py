"""Where free bodies go in each step with their velocities and the recorded impulses, by code that is no stepper's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording.poses import Poses
from nsdyn.recording.series import rotate
from nsdyn.tools.arrays import Array, Index

__all__ = ["Flight", "spins", "tumbled", "velocities"]

LEAP = 0.05
"""Largest turn of one step of the method of Runge and Kutta, rad: in a whole turn it errs by 1e-6 rad."""


@dataclass(frozen=True)
class Flight:
    """Where free bodies are in each step when its impulses act on them.

    With impulses r_j at the times t_j within a step, and w what forces change of the velocity,

        x(τ) = x + τ v⁻ + Σ (τ - t_j)₊ r_j / m + what w moves,

    which at the end is θ h w, and h w / 2 where the step was cut. All arrays are of shape (n, free, ...).

    Attributes
    ----------
    impulse, torque : ndarray, shape (n, free, 3)
        Σ r, N·s, and Σ (p - x(t_j)) × r about where the bodies are then, N·m·s.
    size, levers : ndarray, shape (n, free)
        Σ ‖r‖, and Σ ‖p - x‖ ‖r‖.
    lift : ndarray, shape (n, free, 3)
        Where bodies end - where this brings them, m: what the projection has lifted them.
    unknown : ndarray, shape (n, free)
        How far w may have moved them otherwise, where a step was cut at times that no impulse tells, m.
    quaternion : ndarray, shape (n, free, 4)
        How bodies are turned at the end: by their angular momenta, which the impulses change at their times.
    cut : ndarray of bool, shape (n, 1)
        Whether impulses act at several times, or not where those of a step in one piece would.
    timed : bool
        Whether times are recorded; without, all impulses of a step are taken to act where those of one piece would.
    """

    impulse: Array
    torque: Array
    size: Array
    levers: Array
    lift: Array
    unknown: Array
    quaternion: Array
    cut: NDArray[np.bool_]
    timed: bool

    @classmethod
    def of(cls, poses: Poses) -> Flight:
        """Follow the free bodies of a recording of all steps and contacts."""
        t, free, theta = poses.trajectory, poses.free, float(poses.trajectory.meta["theta"])
        c, h, shape = t.columns, t.dt, (t.steps, free)
        n, t1, r = c["contacts/normal"], c["contacts/tangent"], c["contacts/impulse"]
        world = r[:, :1] * n + r[:, 1:2] * t1 + r[:, 2:] * np.cross(n, t1)
        timed = not np.isnan(c["contacts/time"]).any()
        time = c["contacts/time"] if timed else np.full(len(r), (1.0 - theta) * h)
        step = np.repeat(np.arange(t.steps), np.diff(c["contacts/offset"]))
        cut = np.zeros((t.steps, 1), np.bool_)
        np.logical_or.at(cut[:, 0], step, np.abs(time - (1.0 - theta) * h) > 1e-9 * h)
        cut[:, 0] |= _cut_without_contacts(poses)
        sides = [(poses.frame[c["contacts/geom1"]], -1.0), (poses.frame[c["contacts/geom2"]], 1.0)]
        rows = [np.flatnonzero((body >= 0) & (body < free)) for body, _ in sides]
        body = np.concatenate([side[on] for (side, _), on in zip(sides, rows, strict=True)])
        push = np.concatenate([sign * world[on] for (_, sign), on in zip(sides, rows, strict=True)])
        row = np.concatenate(rows)
        order = np.lexsort((time[row], body, step[row]))
        row, body, push = row[order], body[order], push[order]
        step, time, point = step[row], time[row], c["contacts/point"][row]
        mass = np.array(poses.scene["masses"])

        def summed(values: Array) -> Array:
            out = np.zeros((*shape, *values.shape[1:]))
            np.add.at(out, (step, body), values)
            return out

        impulse, moments = summed(push), summed(time[:, None] * push)
        before = velocities(poses)[:-1]
        forced = np.diff(velocities(poses), axis=0) - impulse / mass[:, None]
        share = np.where(cut, 0.5, theta)[:, :, None]
        path = h * before + (h * impulse - moments) / mass[:, None] + share * h * forced
        # Of each impulse: those before it, and how far they and the forces have brought the body until then.
        first = np.searchsorted(step * free + body, step * free + body)
        so_far, so_long = (np.cumsum(a, axis=0) - a for a in (push, time[:, None] * push))
        way = time[:, None] * (so_far - so_far[first]) - (so_long - so_long[first])
        fall = np.where(cut[step], 0.5 * (time**2 / h)[:, None] * forced[step, body], 0.0)
        at = poses.x[step, body] + time[:, None] * before[step, body] + way / mass[body, None] + fall
        arm, size = point - at, np.linalg.norm(push, axis=1)
        unknown = ((theta - 0.5) + 0.5 * (1.0 - theta) ** 2) * h * np.linalg.norm(forced, axis=2)
        moment = np.cross(arm, push)
        turned = _turned(poses, step * free + body, time, moment)
        return cls(
            impulse, summed(moment), summed(size), summed(size * np.linalg.norm(arm, axis=1)),
            np.diff(poses.x[:, :free], axis=0) - path, np.where(cut, unknown, 0.0), turned, cut, timed,
        )  # fmt: skip


def _cut_without_contacts(poses: Poses) -> NDArray[np.bool_]:
    """Which steps without contacts were cut all the same, (n,): where what fell does not end as in one piece.

    Only with theta above ½ does it matter, and that some seemed to touch on their way and did not is all that cuts.
    """
    t, theta, v = poses.trajectory, float(poses.trajectory.meta["theta"]), velocities(poses)
    forced = t.dt * np.diff(v, axis=0)
    left = np.diff(poses.x[:, : poses.free], axis=0) - t.dt * v[:-1] - theta * forced
    off = (np.abs(left) > 1e-6 * np.abs(forced).max(initial=0.0)).any(axis=(1, 2))
    out: NDArray[np.bool_] = off & (np.diff(t.columns["contacts/offset"]) == 0) & (theta > 0.5)
    return out


def _turned(poses: Poses, row: Index, time: Array, moment: Array) -> Array:
    """How free bodies are turned after each step, (n, free, 4): moments act on body row % free in step row // free.

    The moments are sorted by row and time. What else changes angular momenta in a step, as external forces do, acts
    where those of a step in one piece do; rolling resistance acts at the end.
    """
    t, free = poses.trajectory, poses.free
    q, spin = poses.quaternion[:-1, :free].reshape(-1, 4).copy(), spins(poses)
    inertia = np.tile(np.array(poses.scene["inertias"]).reshape(-1, 3, 3), (t.steps, 1, 1))
    L, now = spin[:-1].reshape(-1, 3).copy(), np.zeros(t.steps * free)
    if t.meta.get("external_force", False):
        rest = np.diff(spin, axis=0).reshape(-1, 3)
        np.subtract.at(rest, row, moment)
        late = (1.0 - float(t.meta["theta"])) * t.dt
        row, time = np.append(row, np.arange(rest.size // 3)), np.append(time, np.full(rest.size // 3, late))
        order = np.lexsort((time, row))
        row, time, moment = row[order], time[order], np.concatenate([moment, rest])[order]
    # Moments of one body at one time together; then of each body the first, the second, ...
    new = np.ones(row.size, np.bool_)
    new[1:] = (row[1:] != row[:-1]) | (time[1:] != time[:-1])
    begin = np.flatnonzero(new)
    if begin.size:
        row, time, moment = row[begin], time[begin], np.add.reduceat(moment, begin)
    rank = np.arange(row.size) - np.searchsorted(row, row)
    for k in range(int(rank.max(initial=-1)) + 1):
        some = rank == k
        i = row[some]
        q[i] = tumbled(q[i], L[i], inertia[i], time[some] - now[i])
        L[i] += moment[some]
        now[i] = time[some]
    out: Array = tumbled(q, L, inertia, t.dt - now).reshape(t.steps, free, 4)
    return out


def velocities(poses: Poses) -> Array:
    """Velocities of free bodies in world axes, (n + 1, free, 3), m/s."""
    out: Array = rotate(poses.quaternion[:, : poses.free], poses.v[..., :3])
    return out


def spins(poses: Poses) -> Array:
    """Angular momenta of free bodies about their centres of mass in world axes, (n + 1, free, 3), N·m·s."""
    inertia = np.array(poses.scene["inertias"]).reshape(-1, 3, 3)
    out: Array = rotate(poses.quaternion[:, : poses.free], np.einsum("bij,nbj->nbi", inertia, poses.v[..., 3:]))
    return out


def tumbled(quaternion: Array, spin: Array, inertia: Array, time: Array) -> Array:
    """Orientations of bodies after they turned freely, shape (m, 4).

    With the angular momentum L of space, q' = ½ q ∘ ω and ω = J⁻¹ Rᵀ L. A body's own axes see ω turn no faster than
    the body does, for no moment of inertia exceeds the sum of the other two.

    Parameters
    ----------
    quaternion : ndarray, shape (m, 4)
    spin : ndarray, shape (m, 3)
        L, world axes, N·m·s.
    inertia : ndarray, shape (m, 3, 3)
        J in the axes of the bodies, kg m².
    time : ndarray, shape (m,)
        s.
    """
    out, left, inverse = quaternion.copy(), time.copy(), np.linalg.inv(inertia)

    def rate(q: Array, some: Index) -> tuple[Array, Array]:
        """q' and ‖ω‖."""
        w = np.einsum("mij,mj->mi", inverse[some], rotate(q * (-1.0, -1.0, -1.0, 1.0), spin[some]))
        turn = np.concatenate([q[:, 3:] * w + np.cross(q[:, :3], w), -(q[:, :3] * w).sum(1, keepdims=True)], axis=1)
        return 0.5 * turn, np.linalg.norm(w, axis=1)

    while (some := np.flatnonzero(left > 0.0)).size:
        q = out[some]
        first, fast = rate(q, some)
        h = np.minimum(left[some], LEAP / np.maximum(fast, 1e-300))
        left[some] -= h
        h = h[:, None]
        second = rate(q + 0.5 * h * first, some)[0]
        third = rate(q + 0.5 * h * second, some)[0]
        fourth = rate(q + h * third, some)[0]
        q = q + h / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        out[some] = q / np.linalg.norm(q, axis=1)[:, None]
    return out
