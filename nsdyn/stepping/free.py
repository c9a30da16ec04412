"""The halves of a move of free bodies alone, each in one call of a kernel: `move` does them of any scene in pieces."""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.stepping import free as _free
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.dynamics import Forces, Middle, Placement, Position
from nsdyn.dynamics.joints import Rows
from nsdyn.problem.fc3d import FC3D
from nsdyn.stepping.encounter import NOTHING, Closing, Encounter
from nsdyn.stepping.instant import STILL, Instant, Looked, System
from nsdyn.tools.arrays import Array

__all__ = ["end", "half", "meet"]


def half(s: System, begin: Instant, h: float) -> tuple[Middle, Forces, Array, Array, float, bool]:
    """The first half of a move of h s under gravity: where its impulses act, and what acts there besides.

    Then the free acceleration, how far the frames may move in the second half, (frames,), the most of it, m, and
    whether the contacts that were found where the move begins are those of there.
    """
    d, n, position = s.dynamics, s.dynamics.free, begin.position
    x, quaternion, X, R = np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3, 3))
    v, v_free, rate, reach = np.empty(d.n), np.empty(d.n), np.empty(d.n), np.empty(n)
    far, same = _free.half(
        d.bodies, d.gravity, d.no_load, (position.x, position.quaternion), begin.v, h, s.theta, d.weight,
        tuple(begin.looked), s.arm, STILL * s.closed, (x, quaternion, v, X, R, v_free, rate, reach),
    )  # fmt: skip
    there = Position(x, quaternion, (), position.driven_x, position.driven_quaternion)
    return Middle(there, v, Placement(X, R, ()), ()), d.free_forces(v_free), rate, reach, far, same


def meet(
    s: System, contacts: ContactSet, middle: Middle, forces: Forces, begin: Instant, reach: Array, closing: Closing,
    h: float,
) -> Encounter:  # fmt: skip
    """What a move meets at its contacts, with the slip foreseen and the problem posed for it: see `Encounter.of`."""
    d, c, nc, warm, old = s.dynamics, contacts, contacts.gap.size, begin.warm, begin.contacts
    frame, H = np.empty((nc, 3, 3)), np.empty(36 * nc)
    block, start, place = np.empty((nc, 2), np.int64), np.empty((nc, 2), np.int64), np.empty(nc, np.int64)
    local, end_gap, slides = np.empty((5, 3 * nc)), np.empty(nc), np.empty(nc, np.bool_)
    b, scales, at = np.empty(3 * nc), np.empty(nc), middle.placement
    size, norm, good = _free.meet(
        (d.block_of_frame, d.offset, d.m_start, forces.m, forces.minv),
        (c.key, c.frame1, c.frame2, c.point, c.normal, c.gap, at.x, at.R),
        (old.key, old.point, old.normal, begin.placement.x, *begin.twists), (begin.v, middle.v, forces.v),
        (warm.key, warm.impulse, warm.status), reach, (c.mu, c.restitution), h / warm.h, tuple(closing),
        (frame, block, start, H), (local, end_gap, place, slides, b, scales),
    )  # fmt: skip
    rows = d.free_rows(block, start, H[:size])
    problem = FC3D.prepared(rows.full, b, c.mu, scales, norm) if good else FC3D.from_blocks(rows.full, b, c.mu)
    return Encounter(
        c, None, rows, frame, None, c.mu, c.restitution, place, warm.status, local, end_gap, NOTHING, NOTHING, slides,
        problem,
    )  # fmt: skip


def end(
    s: System, middle: Middle, rows: Rows, r: Array, v_free: Array, h: float, looked: Looked, near: Array
) -> tuple[Position, Array, Array, Placement, tuple[Array, Array], bool]:
    """The second half of a move, of h s: where it ends, v⁺, the velocity there, the frames and their twists.

    And whether the contacts that were `looked` for are those of there, up to the gaps that `near` (frames,) allows, m.
    """
    d, n, position = s.dynamics, s.dynamics.free, middle.position
    x, quaternion, X, R = np.empty((n, 3)), np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3, 3))
    v_plus, v, linear, angular = np.empty(d.n), np.empty(d.n), np.empty((n, 3)), np.empty((n, 3))
    same = _free.end(
        rows.full.arrays, r, v_free, d.bodies, (position.x, position.quaternion), h, tuple(looked), near, s.arm,
        STILL * s.closed, (v_plus, x, quaternion, v, X, R, linear, angular),
    )  # fmt: skip
    there = Position(x, quaternion, (), position.driven_x, position.driven_quaternion)
    return there, v_plus, v, Placement(X, R, ()), (linear, angular), same
