"""Curves a page draws over time: the energy ledger, and what vouches for the steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.recording.file import WORKS
from nsdyn.recording.keyframes import thinned
from nsdyn.tools.arrays import Array

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["MAX_POINTS", "bodies", "ledger"]

MAX_POINTS = 2000
"""Of a curve."""


def ledger(trajectory: Trajectory) -> dict[str, Array]:
    """Energies and works so far at no more than MAX_POINTS states, and the worst figures since the point before.

    Returns
    -------
    dict of str to ndarray
        t, s; kinetic and potential, the latter from its smallest value, and each work so far, J; residual, m/s,
        bound, √J, and overlap by the recorded gaps, m: the largest since the point before, NaN at the first and where
        they are not recorded.
    """
    rows = thinned(trajectory.t.size, MAX_POINTS)
    e = trajectory.energy
    out = {
        "t": trajectory.t[rows],
        "kinetic": e.kinetic[rows],
        "potential": (e.potential - e.potential.min())[rows],
    }
    for name in WORKS:
        out[name] = np.concatenate([[0.0], np.cumsum(getattr(e, name))])[rows]
    overlap = np.full(trajectory.steps, np.nan)
    if trajectory.has_contacts:
        step = np.repeat(np.arange(trajectory.steps), np.diff(trajectory.columns["contacts/offset"]))
        overlap[:] = 0.0
        np.maximum.at(overlap, step, -trajectory.columns["contacts/gap"])
    figures = {"residual": trajectory.solver.residual, "bound": trajectory.gauss.bound, "overlap": overlap}
    for name, values in figures.items():
        out[name] = np.full(rows.size, np.nan)
        if rows.size > 1:
            out[name][1:] = np.maximum.reduceat(values, rows[:-1])
    return out


def bodies(trajectory: Trajectory, rows: np.ndarray) -> dict[str, Array]:
    """Speed of the centre of mass, m/s, and kinetic energy, J, of the free bodies at states; shape (states, bodies)."""
    free = trajectory.scene["free"]
    twist = trajectory.v[rows, : 6 * free].reshape(rows.size, free, 6)
    inertia = np.array(trajectory.scene["inertias"]).reshape(-1, 3, 3)
    speed = np.linalg.norm(twist[..., :3], axis=2)
    turning = np.einsum("nbi,bij,nbj->nb", twist[..., 3:], inertia, twist[..., 3:])
    return {"speed": speed, "kinetic": 0.5 * (speed**2 * np.array(trajectory.scene["masses"]) + turning)}
