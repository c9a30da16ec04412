"""Positions without overlap: what a step leaves is removed on the shapes themselves, and no velocity is touched."""

from __future__ import annotations

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn.collision.contacts import DetectionPose, take
from nsdyn.dynamics.values import Forces
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Auto
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.tools.arrays import Array

__all__ = ["found", "project"]

PASSES = 20
"""Most projections in a row; each leaves what is of second order in it, so that two or three do."""

COARSE = 1e-4
"""Fraction of the deepest overlap that one projection may leave to the next, which is about what turning leaves anyway.
Coarser ones are not even on both sides of what is symmetric: at 0.01 a row of dominoes left its plane."""


FAR = 10.0
"""Gaps of so many times the deepest overlap are left to the next projection, should this one close them. They are most
where bodies move fast, and numbers so much larger than those that matter cost the methods for hard problems digits."""


def found(s: System, at: SceneState, detected_at: DetectionPose) -> SceneState:
    """The contacts and limits where an instant is, whatever overlaps, where they are `detected_at` for."""
    contacts = s.detector.find(*detected_at, at.memory)
    return at._replace(
        contacts=contacts, limits=s.dynamics.limits(at.placement), memory=contacts, detected_at=detected_at
    )


def project(s: System, at: SceneState, forces: Forces) -> tuple[SceneState, bool]:
    """The closest position without overlap, in the kinetic metric: min ½‖δ‖²_M̃ under g + H_Nᵀ δ ≥ 0.

    Each pass is a frictionless contact problem for the shift δ, on the gaps g of the shapes and joint limits where the
    last one has brought them; the mass matrices of the forces are the metric. Velocities stay what they are `at` the
    end of the motion. That itself is returned where nothing overlaps by more than what counts as closed, and whether
    that is so at last: where bodies are squeezed nothing helps. These, and what touches them, stay.
    """
    d, closed = s.dynamics, s.gap_tol
    for _ in range(PASSES):
        deepest = _least(at)
        if deepest >= -closed:
            return at, True
        contacts = take(at.contacts, at.contacts.gap < -FAR * deepest)
        gap = contacts.gap
        joints = None
        if at.limits.size:
            joints = d.limit_rows(at.placement, np.zeros(d.n))
            gap = gap if joints is None else np.concatenate((gap, joints.gap))
        rows, _ = d.rows(contacts, at.placement, forces, joints)
        # In units of the deepest overlap, which the tolerance is a fraction of.
        g = np.zeros(3 * gap.size)
        g[0::3] = gap / -deepest
        problem = FC3D.from_blocks(rows.blocks, g, np.zeros(gap.size))
        solution = Auto(tol=max(COARSE, -0.5 * closed / deepest))(problem)
        push = solution.r if solution.converged else _without_squeezed(rows.blocks, solution)
        if not push.any():
            break
        moved = d.shift(at.position, -deepest * rows.velocity_change(push))
        # What the next shift may reach, which is about as far as this one, must be seen.
        there = d.place(moved)
        detected_at = DetectionPose(there.x, there.R, np.full(d.frames, -deepest))
        at = found(s, at._replace(position=moved, placement=there), detected_at)
    return at, _least(at) >= -closed


def _without_squeezed(blocks: DelassusFactors, solution: Solution) -> Array:
    """The impulses of a projection, none in islands where they do not even halve an overlap."""
    label = blocks.islands()
    squeezed = np.isin(label, label[solution.u[0::3] < -0.5])
    out: Array = np.where(np.repeat(squeezed, 3), 0.0, solution.r)
    return out


def _least(at: SceneState) -> float:
    """The least gap, 0 if none is negative."""
    least: float = _reductions.least(at.contacts.gap)
    return min(least, _reductions.least(at.limits)) if at.limits.size else least
