"""Position projection: remove the penetration that a step leaves, on the true shapes; velocities do not change."""

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

PASSES = 20
"""Most projections in a row. Each leaves an overlap of second order in the last one, so that two or three suffice."""

COARSE = 1e-4
"""Overlap that one projection may leave to the next, over the deepest one: about as much as the rotations leave anyway.
Coarser projections break symmetry: at 0.01 a row of dominoes left its plane."""


FAR = 10.0
"""Gaps wider than this multiple of the deepest overlap are left to the next projection, should the present one close
them. They occur where bodies move fast, and numbers so much larger cost the methods for hard problems digits."""


def found(s: System, at: SceneState, detected_at: DetectionPose) -> SceneState:
    """Return the state with the contacts found at the poses `detected_at`, overlaps included, and its joint limits."""
    contacts = s.detector.find(*detected_at, at.memory)
    return at._replace(
        contacts=contacts, limits=s.dynamics.limits(at.placement), memory=contacts, detected_at=detected_at
    )


def project(s: System, at: SceneState, forces: Forces) -> SceneState:
    """Return the closest position where no overlap exceeds the gap tolerance, as far as there is one: see `overlaps`.

    Closest in the kinetic metric: min ½‖δ‖²_M̃ under g + H_Nᵀ δ ≥ 0. Each pass solves a frictionless contact problem
    for the shift δ, with the gaps g of shapes and joint limits at the position of the last pass. The mass matrices of
    `forces` are the metric. Velocities stay those of `at`, the end of the motion. `at` itself is returned if no overlap
    exceeds the gap tolerance. Squeezed bodies cannot be separated: they and the bodies that touch them stay in place.
    """
    d, closed = s.dynamics, s.gap_tol
    for _ in range(PASSES):
        deepest = _least(at)
        if deepest >= -closed:
            break
        contacts = take(at.contacts, at.contacts.gap < -FAR * deepest)
        gap = contacts.gap
        joints = None
        if at.limits.size:
            joints = d.limit_rows(at.placement, np.zeros(d.n))
            gap = gap if joints is None else np.concatenate((gap, joints.gap))
        rows, _ = d.rows(contacts, at.placement, forces, joints)
        if d.trees and not (lifted := rows.moved(closed, gap)).all():
            nc, gap = contacts.gap.size, gap[lifted]
            contacts, joints = take(contacts, lifted[:nc]), joints and joints.take(lifted[nc:])
            rows, _ = d.rows(contacts, at.placement, forces, joints)
        # Gaps in units of the deepest overlap; the tolerance is a fraction of it.
        g = np.zeros(3 * gap.size)
        g[0::3] = gap / -deepest
        problem = FC3D.from_blocks(rows.blocks, g, np.zeros(gap.size))
        solution = Auto(tol=max(COARSE, -0.5 * closed / deepest))(problem)
        push = solution.r if solution.converged else _without_squeezed(rows.blocks, solution)
        if not push.any():
            break
        moved = d.shift(at.position, -deepest * rows.velocity_change(push))
        # Detection must cover the reach of the next shift, which is about as long as this one.
        there = d.place(moved)
        detected_at = DetectionPose(there.x, there.R, np.full(d.frames, -deepest))
        at = found(s, at._replace(position=moved, placement=there), detected_at)
    return at


def overlaps(s: System, at: SceneState) -> bool:
    """Return whether any overlap exceeds the gap tolerance."""
    return _least(at) < -s.gap_tol


def _without_squeezed(blocks: DelassusFactors, solution: Solution) -> Array:
    """Return the impulses of a projection, set to 0 in islands where they do not even halve an overlap."""
    label = blocks.islands()
    squeezed = np.isin(label, label[solution.u[0::3] < -0.5])
    return np.where(np.repeat(squeezed, 3), 0.0, solution.r)


def _least(at: SceneState) -> float:
    """Return the least gap of contacts and joint limits, 0 if none is negative."""
    least: float = _reductions.least(at.contacts.gap)
    return min(least, _reductions.least(at.limits)) if at.limits.size else least
