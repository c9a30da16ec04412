"""Test, by rank, of which contacts of a step have a unique impulse.

The impulses r of a step may be changed without any change of the motion if H r, their effect on the coordinates of the
bodies, and the law of contact stay the same. A sticking contact may change all three components, a slipping contact
only along its ray, a contact without friction only the normal component, an open contact none. The impulse of a contact
is unique if every vector in the null space of the corresponding columns of H leaves the impulse unchanged. The test
uses the rank alone: an impulse that it calls not unique may still be unique because of the edges of the cones.

Coordinates are those of free bodies and of articulations, at the end of the step, without the directions that loops,
gears and drives constrain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from nsdyn.recording.columns import OPEN, SLIP
from nsdyn.recording.retrace import trees as articulations
from nsdyn.recording.shares import contact_axes
from nsdyn.recording.tables import contact_columns
from nsdyn.tools.arrays import Array, Bools, Index

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

CLOSED = 1e-6
"""Largest separating velocity plus gap / dt, m/s, at which a contact without an impulse counts as closed; the solver's
tolerance is smaller."""

NULL = 1e-8
"""Fraction of the largest singular value below which a singular value is 0; components of null vectors below it are 0
too. Columns have norm one, and round-off of points and normals is 1e-16 of their size."""


def unique(trajectory: Trajectory, step: int) -> Bools:
    """Return whether the impulse of each contact of a step, from 1 on, is unique, shape (nc,).

    ValueError if the recording describes its articulations too incompletely for the test.
    """
    first, last = trajectory.columns["contacts/offset"][step - 1 : step + 1]
    c = {name: x[first:last] for name, x in contact_columns(trajectory).items()}
    own, direction = _freedoms(c, trajectory.dt)
    H = _columns(trajectory, step, c, own, direction)
    out = np.ones(last - first, np.bool_)
    for some in _islands(H, own) if own.size else ():
        A = H[:, some].toarray()
        A = A[np.abs(A).any(axis=1)]
        _, singular, V = np.linalg.svd(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300))
        rank = int((singular > NULL * singular.max(initial=0.0)).sum())
        out[own[some[np.linalg.norm(V[rank:], axis=0) > NULL]]] = False
    return out


def _freedoms(c: Mapping[str, NDArray[Any]], dt: float) -> tuple[Index, Array]:
    """Return contact and direction in world axes of all possible changes of impulses, shapes (m,), (m, 3)."""
    r, u, mu, status = c["impulse"], c["u"], c["mu"], c["status"]
    frames = contact_axes(c)
    rests = (status == OPEN) & (u[:, 0] + c["gap"] / dt <= CLOSED)
    drag, slip = np.linalg.norm(r[:, 1:], axis=1), np.linalg.norm(u[:, 1:], axis=1)
    slides = ((status == SLIP) & (drag > 0.0)) | (rests & (slip > CLOSED)) | (mu == 0.0)
    opposed = np.where(rests[:, None], -u[:, 1:], r[:, 1:])
    along = opposed * (mu / np.maximum(np.linalg.norm(opposed, axis=1), 1e-300))[:, None]
    ray = np.einsum("ci,cij->cj", np.column_stack([np.ones(len(mu)), along]), frames)
    touches = (status != OPEN) | rests
    rays, sticks = np.flatnonzero(touches & slides), np.flatnonzero(touches & ~slides)
    return np.concatenate([rays, np.repeat(sticks, 3)]), np.concatenate([ray[rays], frames[sticks].reshape(-1, 3)])


def _columns(trajectory: Trajectory, step: int, c: Mapping[str, NDArray[Any]], own: Index, direction: Array) -> Any:
    """Return the generalised impulses of impulses along directions at contacts, end of the step, sparse (n, m)."""
    scene, free = trajectory.scene, trajectory.scene["free"]
    frame, place = np.array([geom["frame"] for geom in scene["geoms"]], dtype=np.int64), trajectory.q[step]
    built = articulations(trajectory)
    if isinstance(built, str):
        raise ValueError(f"whether impulses are unique is not known: {built}")
    # Projections on the directions that loops, gears and drives leave free; `constraints` places a mechanism.
    rows_of = [m.constraints(place[q])[1] for m, (q, _) in zip(built.mechanisms, built.at, strict=True)]
    bases = [np.eye(B.shape[1]) - np.linalg.pinv(B, rcond=NULL) @ B for B in rows_of]
    rows, columns, values = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty(0)]
    for k, (contact, push) in enumerate(zip(own.tolist(), direction, strict=True)):
        point = c["point"][contact]
        for side, sign in (("geom1", -1.0), ("geom2", 1.0)):
            body = int(frame[c[side][contact]])
            if 0 <= body < free:
                lever = point - place[7 * body : 7 * body + 3]
                rows.append(6 * body + np.arange(6))
                values.append(sign * np.concatenate((push, np.cross(lever, push))))
            elif body in built.links:
                tree, joint = built.links[body]
                own_rows = built.at[tree][1]
                rows.append(np.arange(own_rows.start, own_rows.stop))
                values.append(sign * bases[tree] @ built.mechanisms[tree].push(joint, point, push))
            else:
                continue
            columns.append(np.full(rows[-1].size, k))
    places = np.concatenate(rows), np.concatenate(columns)
    return coo_array((np.concatenate(values), places), shape=(trajectory.v.shape[1], own.size)).tocsc()


def _islands(H: Any, own: Index) -> Iterator[Index]:
    """Yield groups of columns that share coordinates or a contact."""
    pattern = abs(H)
    same = coo_array((np.ones(own.size), (own, np.arange(own.size)))).tocsc()
    count, label = connected_components(pattern.T @ pattern + same.T @ same, directed=False)
    for k in range(count):
        yield np.flatnonzero(label == k)
