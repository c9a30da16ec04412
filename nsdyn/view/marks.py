"""Impacts of a recording: contacts that push and closed before they did."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nsdyn.recording.tables import impulses
from nsdyn.tools.arrays import Array, Index
from nsdyn.view.contact_points import identities

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["Impacts", "find"]

HELD = 1e-6
"""m/s, a hundred times the solver's default tolerance: what parts no faster is held."""


class Impacts(NamedTuple):
    """The strongest impact of each step that has any.

    Attributes
    ----------
    step : ndarray, shape (n,)
        From 1 on, ascending; it ends at t[step].
    speed : ndarray, shape (n,)
        At which the contact closed, m/s.
    impulse : ndarray, shape (n,)
        Normal impulse, N·s, of redundant contacts that of least norm.
    geoms : ndarray, shape (n, 2)
        The shapes.
    """

    step: Index
    speed: Array
    impulse: Array
    geoms: Index


def find(trajectory: Trajectory) -> Impacts:
    """Impacts of a recording: contacts that push, closed faster than |g| h before, and carried no such load before.

    How fast a contact closed, where its shapes were nearest then, follows from the work of its normal impulse, which is
    r_N times the mean of the velocities before and after: -u_N⁻ = u_N - 2 w_N / r_N. So what rolls closes at no speed,
    however fast, and an impact located within a step has the speed of its instant. h is the length of the step: what
    gravity gives within it is not told from rest.

    A contact that pushed at least half as much when it last acted, in this step or the one before, and did not part,
    goes on to carry a load: by what its gap still closes, of second order in h, it does not strike. Under loads of many
    times the weight, and without gravity, that would be more than |g| h.

    Nothing is found where contacts are not recorded, or not of every step.
    """
    none = Impacts(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty((0, 2), np.int64))
    if not trajectory.has_contacts or trajectory.every > 1:
        return none
    c = {name.removeprefix("contacts/"): x for name, x in trajectory.columns.items() if name.startswith("contacts/")}
    step = np.repeat(np.arange(1, trajectory.steps + 1), np.diff(c["offset"]))
    impulse, u = c["impulse"][:, 0], c["u"][:, 0]
    push = impulse > 0.0
    speed = np.zeros(u.size)
    speed[push] = u[push] - 2.0 * c["work_normal"][push] / impulse[push]
    # Round-off of velocities is no impact where there is no gravity.
    least = np.linalg.norm(trajectory.scene["gravity"]) * trajectory.dt + 1e-9 * speed.max(initial=0.0)
    held = _before(identities(c), step, np.where(push & (u <= HELD), impulse, 0.0)) >= 0.5 * impulse
    rolls = np.nan_to_num(c["couple"]).any(axis=1)
    hit = np.flatnonzero((speed > least) & ~held & ~rolls)
    there, shown = np.flatnonzero(np.isin(step, step[hit])), np.zeros(step.size)
    shown[there] = impulses(trajectory, there)[:, 0]
    hit = hit[np.lexsort((-shown[hit], step[hit]))]
    hit = hit[np.unique(step[hit], return_index=True)[1]]
    geoms = np.column_stack([c["geom1"][hit], c["geom2"][hit]]).astype(np.int64)
    return Impacts(step[hit], speed[hit], shown[hit], geoms)


def _before(identity: Index, step: Index, values: Array) -> Array:
    """Values of the same contacts when they last acted, in the same step or the one before, else 0."""
    order = np.argsort(identity, kind="stable")
    last, now = order[:-1], order[1:]
    out = np.zeros(step.size)
    out[now] = np.where((identity[last] == identity[now]) & (step[now] - step[last] <= 1), values[last], 0.0)
    return out
