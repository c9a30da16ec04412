"""Impacts of a recording: contacts with a normal impulse whose gap was closing before."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nsdyn.recording.tables import contact_columns, contact_steps, impulses
from nsdyn.tools.arrays import Array, Index
from nsdyn.view.contact_points import identities

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

HELD = 1e-6
"""m/s, a hundred times the solver's default tolerance: a contact that separates no faster stays closed."""


class Impacts(NamedTuple):
    """The strongest impact of each step that has any.

    Attributes
    ----------
    step : ndarray, shape (n,)
        Number of the step, from 1 on, ascending; the step ends at t[step].
    speed : ndarray, shape (n,)
        Speed at which the contact closed, m/s.
    impulse : ndarray, shape (n,)
        Normal impulse, N·s; for redundant contacts the one of least norm.
    geoms : ndarray, shape (n, 2)
        The two shapes.
    """

    step: Index
    speed: Array
    impulse: Array
    geoms: Index


def find(trajectory: Trajectory) -> Impacts:
    """Find the impacts of a recording: pushing contacts that closed faster than |g| h and carried no load before.

    The speed at which a contact closed, at the point where its shapes were nearest at that time, follows from the work
    of its normal impulse. This work is r_N times the mean of the normal velocities before and after:
    -u_N⁻ = u_N - 2 w_N / r_N. A rolling contact therefore closes at zero speed, however fast it rolls, and an impact
    located within a step has the speed of its instant. h is the length of the step: a speed that gravity gives within
    one step cannot be distinguished from rest.

    A contact carries a load already if it had at least half the impulse when it last acted, in the same step or the
    step before, and did not separate. Such a contact is no impact. Its gap still closes by an amount of second order in
    h, which would exceed |g| h under loads of many times the weight and without gravity.

    Nothing is found if contacts are not recorded, or not in every step.
    """
    none = Impacts(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty((0, 2), np.int64))
    if not trajectory.has_contacts or trajectory.every > 1:
        return none
    c, step = contact_columns(trajectory), contact_steps(trajectory)
    impulse, u = c["impulse"][:, 0], c["u"][:, 0]
    push = impulse > 0.0
    speed = np.zeros(u.size)
    speed[push] = u[push] - 2.0 * c["work_normal"][push] / impulse[push]
    # Without gravity, round-off of velocities must not count as an impact.
    least = np.linalg.norm(trajectory.scene["gravity"]) * trajectory.dt + 1e-9 * speed.max(initial=0.0)
    held = _before(identities(c), step, np.where(push & (u <= HELD), impulse, 0.0)) >= 0.5 * impulse
    rolls = c["couple"].any(axis=1)
    hit = np.flatnonzero((speed > least) & ~held & ~rolls)
    there, shown = np.flatnonzero(np.isin(step, step[hit])), np.zeros(step.size)
    shown[there] = impulses(trajectory, there)[:, 0]
    hit = hit[np.lexsort((-shown[hit], step[hit]))]
    hit = hit[np.unique(step[hit], return_index=True)[1]]
    geoms = np.column_stack([c["geom1"][hit], c["geom2"][hit]]).astype(np.int64)
    return Impacts(step[hit], speed[hit], shown[hit], geoms)


def _before(identity: Index, step: Index, values: Array) -> Array:
    """Return the values of the same contacts when they last acted, in the same step or the one before, else 0."""
    order = np.argsort(identity, kind="stable")
    last, now = order[:-1], order[1:]
    out = np.zeros(step.size)
    out[now] = np.where((identity[last] == identity[now]) & (step[now] - step[last] <= 1), values[last], 0.0)
    return out
