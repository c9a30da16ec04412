"""Positions without overlap: what a step leaves is removed on the shapes themselves, and no velocity is touched."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn._kernels import reductions as _few
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.values import Forces, Placement, Position
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Auto
from nsdyn.tools.arrays import Array

__all__ = ["Placed", "place", "project"]

PASSES = 20
"""Most projections in a row; each leaves what is of second order in it, so that two or three do."""

COARSE = 1e-4
"""Fraction of the deepest overlap that one projection may leave to the next, which is about what turning leaves anyway.
Coarser ones are not even on both sides of what is symmetric: at 0.01 a row of dominoes left its plane."""


FAR = 10.0
"""Gaps of so many times the deepest overlap are left to the next projection, should this one close them. They are most
where bodies move fast, and numbers so much larger than those that matter cost the methods for hard problems digits."""


class Placed(NamedTuple):
    """A position, its frames, and the contacts found there.

    Attributes
    ----------
    position : Position
    placement : Placement
    contacts : ContactSet
        With the true gaps of the shapes.
    limits : ndarray
        Gaps of all joint limits, rad or m.
    memory : ContactMemory
    looked : Looked
    clear : bool
        Whether no shapes overlap, and no joint is beyond its limits, by more than what counts as closed.
    """

    position: Position
    placement: Placement
    contacts: ContactSet
    limits: Array
    memory: ContactMemory
    looked: Looked
    clear: bool


def place(
    dynamics: Dynamics,
    detector: Detector,
    position: Position,
    placement: Placement,
    memory: ContactMemory,
    looked: Looked,
) -> Placed:
    """The contacts and limits at a position, whatever overlaps, where they are `looked` for."""
    contacts, memory = detector.find(*looked, memory)
    return Placed(position, placement, contacts, dynamics.limits(placement), memory, looked, True)


def project(dynamics: Dynamics, detector: Detector, placed: Placed, forces: Forces, closed: float) -> Placed:
    """The closest position without overlap, in the kinetic metric: min ½‖δ‖²_M̃ under g + H_Nᵀ δ ≥ 0.

    Each pass is a frictionless contact problem for the shift δ, on the gaps g of the shapes and joint limits where the
    last one has brought them.

    Parameters
    ----------
    dynamics : Dynamics
    detector : Detector
    placed : Placed
        Where the motion ends.
    forces : Forces
        Whose mass matrices are the metric.
    closed : float
        Largest overlap [m] that is left.

    Returns
    -------
    Placed
        `placed` itself where nothing overlaps; not `clear` where bodies are squeezed so that nothing helps: these, and
        what touches them, stay.
    """
    for _ in range(PASSES):
        deepest = _least(placed)
        if deepest >= -closed:
            return placed
        contacts = ContactSet._make(column[placed.contacts.gap < -FAR * deepest] for column in placed.contacts)
        gap = contacts.gap
        joints = None
        if placed.limits.size:
            rest = np.zeros(dynamics.n)
            joints = dynamics.limit_rows(placed.placement, rest)
            gap = gap if joints is None else np.concatenate((gap, joints.gap))
        rows, _ = dynamics.rows(contacts, placed.placement, forces, joints)
        # In units of the deepest overlap, which the tolerance is a fraction of.
        g = np.zeros(3 * gap.size)
        g[0::3] = gap / -deepest
        problem = FC3D.from_blocks(rows.blocks, g, np.zeros(gap.size))
        solution = Auto(tol=max(COARSE, -0.5 * closed / deepest))(problem)
        push = solution.r if solution.converged else _without_squeezed(rows.blocks, solution)
        if not push.any():
            break
        moved = dynamics.shift(placed.position, -deepest * rows.velocity_change(push))
        # What the next shift may reach, which is about as far as this one, must be seen.
        there = dynamics.place(moved)
        looked = Looked(there.x, there.R, np.full(dynamics.frames, -deepest))
        placed = place(dynamics, detector, moved, there, placed.memory, looked)
    return placed._replace(clear=_least(placed) >= -closed)


def _without_squeezed(blocks: Blocks, solution: Solution) -> Array:
    """The impulses of a projection, none in islands where they do not even halve an overlap."""
    label = np.empty(blocks.block.shape[0], np.int64)
    _blocks.islands(blocks.block, blocks.offset.size - 1, label)
    squeezed = np.isin(label, label[solution.u[0::3] < -0.5])
    out: Array = np.where(np.repeat(squeezed, 3), 0.0, solution.r)
    return out


def _least(placed: Placed) -> float:
    """The least gap, 0 if none is negative."""
    least: float = _few.least(placed.contacts.gap)
    return min(least, _few.least(placed.limits)) if placed.limits.size else least
