"""Curves that a page draws over time: the energy ledger, residuals and bounds of the steps, motion of the bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nsdyn.dynamics.ledger import WORKS
from nsdyn.recording import link_names
from nsdyn.recording.body_motion import energies, twists
from nsdyn.recording.joint_tables import coordinates
from nsdyn.recording.tables import contact_steps
from nsdyn.tools.arrays import Array, Index
from nsdyn.view.keyframes import thinned

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

MAX_POINTS = 2000
"""Most points of a curve."""


def ledger(trajectory: Trajectory, rows: Index | None = None) -> dict[str, Array]:
    """Return energies and cumulative works at states, and the largest errors since the previous point.

    Without `rows`, at most MAX_POINTS states are used.

    Returns
    -------
    dict of str to ndarray
        t, s; kinetic and potential energy, the latter above its smallest value, and each cumulative work, J. The works
        of drives and loads are in `put_in` while their sum is positive, in `drives` while it is negative. residual,
        m/s, bound, √J, and penetration by the recorded gaps, m: the largest since the previous point, NaN at the first
        point and where they are not recorded.
    """
    rows = thinned(trajectory.t.size, MAX_POINTS) if rows is None else rows
    e = trajectory.energy
    out = {
        "t": trajectory.t[rows],
        "kinetic": e.kinetic[rows],
        "potential": (e.potential - e.potential.min())[rows],
    }
    for name in WORKS:
        out[name] = np.concatenate([[0.0], np.cumsum(getattr(e, name))])[rows]
    given = out.pop("external") + out.pop("constraint")
    out["put_in"], out["drives"] = np.maximum(given, 0.0), np.minimum(given, 0.0)
    penetration = np.full(trajectory.steps, np.nan)
    if trajectory.has_contacts:
        penetration[:] = 0.0
        np.maximum.at(penetration, contact_steps(trajectory) - 1, -trajectory.columns["contacts/gap"])
    figures = {"residual": trajectory.solver.residual, "bound": trajectory.gauss.bound, "penetration": penetration}
    for name, values in figures.items():
        out[name] = np.full(rows.size, np.nan)
        if rows.size > 1:
            out[name][1:] = np.maximum.reduceat(values, rows[:-1])
    return out


def bodies(trajectory: Trajectory, rows: Index) -> dict[str, Array]:
    """Return speed of the centre of mass, m/s, and kinetic energy, J, of each frame; shape (states, frames).

    NaN where masses are not known: for driven bodies, and for links of joints that are not known.
    """
    out = np.full((2, rows.size, len(trajectory.scene["frames"])), np.nan)
    for frame, of_body in energies(trajectory, rows, twists(trajectory, rows)).items():
        out[:, :, frame] = of_body
    return {"speed": out[0], "kinetic": out[1]}


def joints(trajectory: Trajectory, rows: Index) -> dict[str, Array]:
    """Return position, velocity and torque of joints of one coordinate, and reactions; shape (states, joints).

    In rad or m, per s, N m or N. Magnitudes of the reactions of all joints: force, N, and moment, N m, as in
    `nsdyn.recording.joint_tables.JointMotion`. Values of steps belong to the step that ends at the state. NaN for other
    joints, at the initial state and where a value is not recorded.
    """
    from nsdyn.recording.reactions import reactions  # imports Pinocchio, which only joints need

    names, begun = link_names.joints(trajectory.scene), rows > 0
    found = {what: np.full((rows.size, len(names)), np.nan) for what in ("position", "velocity", "torque")}
    for k, name in enumerate(names):
        own = coordinates(trajectory, name)
        if own["velocity"].shape[1] == 1:
            found["position"][:, k], found["velocity"][:, k] = own["position"][rows, 0], own["velocity"][rows, 0]
            found["torque"][begun, k] = own["torque"][rows[begun] - 1, 0]
    passed, known = np.full((rows.size, len(names), 6), np.nan), reactions(trajectory, rows[begun] - 1)
    passed[begun] = np.stack([known[name] for name in names], axis=1)
    sizes = {"force": passed[..., :3], "moment": passed[..., 3:]}
    return found | {what: np.linalg.norm(vectors, axis=2) for what, vectors in sizes.items()}
