"""Impacts of a recording: contacts that push and closed before they did."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["Impacts", "find"]


class Impacts(NamedTuple):
    """The strongest impact of each step that has any.

    Attributes
    ----------
    step : ndarray, shape (n,)
        From 1 on, ascending; it ends at t[step].
    speed : ndarray, shape (n,)
        At which the contact closed, m/s.
    impulse : ndarray, shape (n,)
        Normal impulse, N·s.
    geoms : ndarray, shape (n, 2)
        The shapes.
    """

    step: Index
    speed: Array
    impulse: Array
    geoms: Index


def find(trajectory: Trajectory) -> Impacts:
    """Impacts of a recording: r_N > 0, and u_N < -|g| h at the start of the step, h its length.

    What gravity gives within one step is not told from rest. Nothing is found where contacts are not recorded, or not
    of every step. Links, whose velocities are not recorded, move as in the step before.
    """
    none = Impacts(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty((0, 2), np.int64))
    if not trajectory.has_contacts or trajectory.every > 1:
        return none
    c = trajectory.columns
    step = np.repeat(np.arange(1, trajectory.steps + 1), np.diff(c["contacts/offset"]))
    push = np.flatnonzero(c["contacts/impulse"][:, 0] > 0.0)
    step, point, normal = step[push], c["contacts/point"][push], c["contacts/normal"][push]
    geoms = np.column_stack([c["contacts/geom1"][push], c["contacts/geom2"][push]]).astype(np.int64)
    frame = np.array([geom["frame"] for geom in trajectory.scene["geoms"]], dtype=np.int64)[geoms]
    speed = np.zeros(push.size)
    for f, name in enumerate(trajectory.scene["frames"]):
        x, v, w = _velocities(trajectory, name)
        for side, sign in ((0, 1.0), (1, -1.0)):
            on = np.flatnonzero(frame[:, side] == f)
            k = step[on] - 1
            velocity = v[k] + np.cross(w[k], point[on] - x[k])
            speed[on] += sign * (velocity * normal[on]).sum(axis=1)
    # Round-off of velocities is no impact where there is no gravity.
    least = np.linalg.norm(trajectory.scene["gravity"]) * trajectory.dt + 1e-9 * np.abs(speed).max(initial=0.0)
    hit = np.flatnonzero(speed > least)
    impulse = c["contacts/impulse"][push[hit], 0]
    order = np.lexsort((-impulse, step[hit]))
    hit, impulse = hit[order], impulse[order]
    first = np.unique(step[hit], return_index=True)[1]
    return Impacts(step[hit][first], speed[hit][first], impulse[first], geoms[hit][first])


def _velocities(trajectory: Trajectory, name: str) -> tuple[Array, Array, Array]:
    """Place, velocity there and angular velocity of a moving frame in all states, world axes."""
    motion = trajectory.body(name)
    if trajectory.scene["frames"].index(name) < trajectory.scene["free"]:
        return motion.position, motion.linear_velocity, motion.angular_velocity
    v, w = np.zeros_like(motion.position), np.zeros_like(motion.position)
    if trajectory.steps:
        h = np.diff(trajectory.t)[:, None]
        turn = Rotation.from_quat(motion.quaternion)
        v[1:], w[1:] = np.diff(motion.position, axis=0) / h, (turn[1:] * turn[:-1].inv()).as_rotvec() / h
    return motion.position, v, w
