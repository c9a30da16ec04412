"""Contacts of a recording: forces between two bodies, forces on a body, impulses of contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording import shares
from nsdyn.recording.columns import CONTACT_STATES
from nsdyn.tools.arrays import Array, Bools, Index
from nsdyn.tools.naming import choice, counted

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Pair:
    """Contact of body a on body b in each of n recorded steps; SI units, world frame.

    Attributes
    ----------
    a, b : str
    t : ndarray, shape (n,)
        Ends of the steps, s.
    force, torque : ndarray, shape (n, 3)
        Force and torque on b: impulses of the step divided by dt; the torque is about the world's origin.
    work : ndarray, shape (n,)
        Work of normal and tangential impulses on both bodies, J.
    gap : ndarray, shape (n,)
        Smallest gap at the end of the step, m; infinite without contact points.
    state : tuple of str
        "apart" without contact points, "open" if no point carries an impulse; else "stick", "slip" if any point slips,
        or "jam" if any jams.
    """

    a: str
    b: str
    t: Array
    force: Array
    torque: Array
    work: Array
    gap: Array
    state: tuple[str, ...]

    def __repr__(self) -> str:
        touching = sum(state not in ("apart", "open") for state in self.state)
        return f"<Pair {self.a!r}, {self.b!r}: {counted(len(self.state), 'step')}, {touching} of them pushing>"


def pair(trajectory: Trajectory, a: str, b: str) -> Pair:
    """Return forces, work, gap and state between bodies a and b; see `nsdyn.Trajectory.pair`."""
    on_a, on_b = (_members(trajectory, name) for name in (a, b))
    step, n = contact_steps(trajectory) - 1, trajectory.steps
    first, second = (trajectory.columns[f"contacts/geom{side}"] for side in "12")
    sign = 1.0 * (on_a[first] & on_b[second]) - 1.0 * (on_b[first] & on_a[second])
    row = np.flatnonzero(sign)
    step, sign = step[row], sign[row]
    c = {name: trajectory.columns[f"contacts/{name}"][row] for name in ("point", "gap", "status")}
    push = sign[:, None] * impulses_world(trajectory.columns)[row]
    force, torque, work, gap = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.full(n, np.inf)
    np.add.at(force, step, push / trajectory.dt)
    np.add.at(torque, step, np.cross(c["point"], push) / trajectory.dt)
    for name in ("work_normal", "work_friction"):
        np.add.at(work, step, trajectory.columns[f"contacts/{name}"][row])
    np.minimum.at(gap, step, c["gap"])
    state = np.full(n, -1)
    np.maximum.at(state, step, c["status"])
    words = ("apart", *CONTACT_STATES)
    return Pair(a, b, trajectory.t[1:], force, torque, work, gap, tuple(words[s + 1] for s in state))


def force(trajectory: Trajectory, name: str) -> Array:
    """Return the contact force on a body in each step; see `nsdyn.Trajectory.force`."""
    members = _members(trajectory, name)
    step = contact_steps(trajectory)
    first, second = (members[trajectory.columns[f"contacts/geom{side}"]] for side in "12")
    sign = 1.0 * second - 1.0 * first
    out = np.zeros((trajectory.steps, 3))
    np.add.at(out, step - 1, sign[:, None] * impulses_world(trajectory.columns) / trajectory.dt)
    return out


def left_out(t: Trajectory) -> str:
    """Say which contacts are not recorded; empty if all are."""
    if not t.has_contacts:
        return "contacts are not recorded"
    return "" if t.every == 1 else f"of every {t.every} steps one is recorded"


def need_contacts(trajectory: Trajectory) -> None:
    """Refuse a recording without contacts."""
    if not trajectory.has_contacts:
        raise ValueError("the recording has no contacts: it was made without them")


def contact_steps(trajectory: Trajectory) -> Index:
    """Return the step of each contact, from 1 on; ValueError for a recording without contacts."""
    need_contacts(trajectory)
    return np.repeat(np.arange(1, trajectory.steps + 1), np.diff(trajectory.columns["contacts/offset"]))


def contact_columns(trajectory: Trajectory) -> dict[str, NDArray[Any]]:
    """Return the columns of contacts by their names without the group's."""
    columns = trajectory.columns.items()
    return {name.removeprefix("contacts/"): x for name, x in columns if name.startswith("contacts/")}


def impulses(trajectory: Trajectory, row: Index) -> Array:
    """Return the impulses of the contacts in some rows as tables and pictures show them, (., 3), (N, T1, T2), N·s.

    `row` must have all contacts of two bodies in a step. Redundant contacts get the impulses of least norm, see
    `nsdyn.recording.shares`; `/contacts/impulse` has those of the solver.
    """
    step = contact_steps(trajectory)
    c = {name: trajectory.columns[f"contacts/{name}"][row] for name in shares.COLUMNS}
    body = np.unique(body_names(trajectory), return_inverse=True)[1]
    bodies = np.column_stack([body[trajectory.columns[f"contacts/geom{side}"][row]] for side in "12"])
    return shares.shared(bodies, step[row], c)


def impulses_world(columns: Mapping[str, NDArray[Any]]) -> Array:
    """Return the solver's impulses on body 2 of all contacts in world axes, shape (., 3), N·s."""
    c = {name: columns[f"contacts/{name}"] for name in ("impulse", "normal", "tangent")}
    return np.einsum("ci,cij->cj", c["impulse"], shares.contact_axes(c))


def body_names(trajectory: Trajectory) -> NDArray[Any]:
    """Return the name of the body or link of every shape."""
    return np.array([geom["link"] for geom in trajectory.scene["geoms"]])


def _members(trajectory: Trajectory, name: str) -> Bools:
    """Return for every shape whether it belongs to the named body, link or whole articulation."""
    geoms = trajectory.scene["geoms"]
    labels = [(geom["body"], geom["link"]) for geom in geoms]
    choice(name, dict.fromkeys(label for both in labels for label in both), "body")
    return np.array([name in both for both in labels])
