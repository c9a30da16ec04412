"""Contacts at selected states of a recording, as a page shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording.tables import contact_columns, impulses, need_contacts
from nsdyn.tools.arrays import Array, Index
from nsdyn.view import payload

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

EDGE = 4
"""Added to the state of a contact whose impulse is at the edge of its friction cone."""


def counts(trajectory: Trajectory, rows: Index) -> Index:
    """Return the number of contacts of the steps that end at the states `rows`; no step ends at the first state."""
    need_contacts(trajectory)
    sizes = np.concatenate([[0], np.diff(trajectory.columns["contacts/offset"])])
    return sizes[rows]


def at(trajectory: Trajectory, rows: Index) -> dict[str, NDArray[Any]]:
    """Return the contacts of the steps that end at the states `rows`, ascending; ValueError without contacts.

    Returns
    -------
    dict of str to ndarray
        offset (len(rows) + 1), and for each contact, sorted by state and identity: id; state, 0 open, 1 stick, 2 slip,
        plus EDGE where |r_T| = μ r_N to 1e-4; point, normal (., 3), world; r (., 3), N·s, along the normal and its
        `axes`, as in `nsdyn.recording.tables.impulses`; u_N, u_T, m/s, u_T as a magnitude; gap, m; taken, its
        dissipation since the recording began, J. For each identity (the same features of the same pair of shapes):
        geoms (., 2) and mu.
    """
    size = counts(trajectory, rows)
    c = contact_columns(trajectory)
    identity = identities(c)
    taken = _so_far(identity, -(c["work_normal"] + c["work_friction"]))
    start = c["offset"][np.maximum(rows - 1, 0)]
    k = np.repeat(start - np.concatenate([[0], np.cumsum(size)[:-1]]), size) + np.arange(size.sum())
    frame = np.repeat(np.arange(rows.size), size)
    k = k[np.lexsort((identity[k], frame))]
    known, first, number = np.unique(identity[k], return_index=True, return_inverse=True)
    t1, r = c["tangent"][k], impulses(trajectory, k)
    normal = payload.rounded(c["normal"][k]).astype(float)  # as in the page, which computes the axes from it
    drag = r[:, 1:2] * t1 + r[:, 2:] * np.cross(c["normal"][k], t1)
    own1, own2 = axes(normal)
    edge = (r[:, 0] > 0.0) & (np.hypot(r[:, 1], r[:, 2]) >= (1.0 - 1e-4) * c["mu"][k] * r[:, 0])
    one = k[first] if known.size else k
    return {
        "offset": np.concatenate([[0], np.cumsum(size)]),
        "id": number.ravel(),
        "state": c["status"][k] + EDGE * edge,
        "point": c["point"][k],
        "normal": normal,
        "r": np.column_stack([r[:, 0], (drag * own1).sum(axis=1), (drag * own2).sum(axis=1)]),
        "u_N": c["u"][k, 0],
        "u_T": np.hypot(c["u"][k, 1], c["u"][k, 2]),
        "gap": c["gap"][k],
        "taken": taken[k],
        "geoms": np.column_stack([c["geom1"][one], c["geom2"][one]]),
        "mu": c["mu"][one],
    }


def axes(normal: Array) -> tuple[Array, Array]:
    """Return two unit vectors (n, 3) that make right-handed frames with unit normals, from the normals alone."""
    flat = np.abs(normal[:, 2:]) < 0.9
    t1 = np.cross(np.where(flat, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), normal)
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    return t1, np.cross(normal, t1)


def identities(c: dict[str, NDArray[Any]]) -> Index:
    """Return one number for each pair of shapes and key of the warm start."""
    g1, g2 = c["geom1"].astype(np.int64), c["geom2"].astype(np.int64)
    keys, key = np.unique(c["key"], return_inverse=True)
    shapes = int(max(g1.max(initial=0), g2.max(initial=0))) + 1
    code = (g1 * shapes + g2) * max(1, keys.size) + key.ravel()
    return np.unique(code, return_inverse=True)[1].ravel()


def _so_far(group: Index, values: Array) -> Array:
    """Return cumulative sums of the values within each group."""
    order = np.argsort(group, kind="stable")
    total = np.cumsum(values[order])
    first = np.searchsorted(group[order], group[order])
    out = np.empty(values.size)
    out[order] = total - (total - values[order])[first] if values.size else total
    return out
