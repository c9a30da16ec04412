"""The halves of a move of free bodies alone, each in one call of a kernel: `move` does them of any scene in pieces.

They give arrays, since a call takes so little that values made of these would take as long.
"""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.stepping import free as _free
from nsdyn.collision.contacts import ContactSet, Looked
from nsdyn.dynamics.joints import Rows
from nsdyn.problem.fc3d import FC3D
from nsdyn.stepping.encounter import Closing
from nsdyn.stepping.instant import STILL, Instant, System
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["end", "half", "meet"]


def half(s: System, begin: Instant, h: float) -> tuple[Array, Array, Array, Array, Array, Array, Array, float, bool]:
    """The first half of a move of h s under gravity: (x, quaternion, v⁻, R) where its impulses act, and v_f.

    Then the free acceleration, how far the frames may move in the second half, (frames,), the most of it, m, and
    whether the contacts that were found where the move begins are those of there.
    """
    d, n, position = s.dynamics, s.dynamics.free, begin.position
    out = x, quaternion, v, R, v_free, rate, reach = (
        np.empty((n, 3)),
        np.empty((n, 4)),
        np.empty(d.n),
        np.empty((n, 3, 3)),
        np.empty(d.n),
        np.empty(d.n),
        np.empty(n),
    )
    far, same = _free.half(
        d.bodies,
        (d.gravity, d.no_load, d.weight),
        (position.x, position.quaternion, begin.v),
        h,
        s.theta,
        tuple(begin.looked),
        (s.arm, STILL * s.closed),
        out,
    )
    return x, quaternion, v, R, v_free, rate, reach, far, same


def meet(
    s: System,
    contacts: ContactSet,
    looked: Looked,
    v: Array,
    v_free: Array,
    begin: Instant,
    reach: Array,
    closing: Closing,
    h: float,
) -> tuple[Rows, Array, Array, Array, Index, Bools, FC3D]:
    """What a move meets at its contacts: (rows, frame, local, end_gap, place, slides, posed) of `Encounter`."""
    d, c, nc, warm, old = s.dynamics, contacts, contacts.gap.size, begin.warm, begin.contacts
    basis, again = warm.basis, False
    if basis is not None and basis.contacts is contacts:
        again, rows, frame, scales = True, basis.rows, basis.frame, basis.problem.scales
        _, block, start, H, *_ = rows.full
    else:
        frame, H, scales = np.empty((nc, 3, 3)), np.empty(36 * nc), np.empty(nc)
        block, start = np.empty((nc, 2), np.int64), np.empty((nc, 2), np.int64)
    local, end_gap, b = np.empty((5, 3 * nc)), np.empty(nc), np.empty(3 * nc)
    place, slides = np.empty(nc, np.int64), np.empty(nc, np.bool_)
    size, norm, good = _free.meet(
        d.masses,
        (c.key, c.frame1, c.frame2, c.point, c.normal, c.gap, looked.x, looked.R),
        (old.key, old.point, old.normal, begin.placement.x, *begin.twists, reach),
        (begin.v, v, v_free),
        (warm.key, warm.force, h, warm.status),
        (c.mu, c.restitution, tuple(closing)),
        (frame, block, start, H, scales, again),
        (local, end_gap, place, slides, b),
    )
    if not again:
        rows = d.free_rows(block, start, H[:size])
    problem = FC3D.prepared(rows.full, b, c.mu, scales, norm) if good else FC3D.from_blocks(rows.full, b, c.mu)
    return rows, frame, local, end_gap, place, slides, problem


def end(
    s: System, x: Array, quaternion: Array, rows: Rows, r: Array, v_free: Array, h: float, looked: Looked, near: Array
) -> tuple[Array, Array, Array, Array, Array, tuple[Array, Array], bool]:
    """The second half of a move, of h s: v⁺, then (x, quaternion, v, R) where it ends, and the twists of the frames.

    And whether the contacts that were `looked` for are those of there, up to the gaps that `near` (frames,) allows, m.
    """
    d, n = s.dynamics, s.dynamics.free
    out = v_plus, x_end, quaternion_end, v, R, linear, angular = (
        np.empty(d.n),
        np.empty((n, 3)),
        np.empty((n, 4)),
        np.empty(d.n),
        np.empty((n, 3, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
    )
    there = tuple(looked), near, s.arm, STILL * s.closed
    same = _free.end(rows.full.arrays, r, v_free, d.bodies, (x, quaternion), h, there, out)
    return v_plus, x_end, quaternion_end, v, R, (linear, angular), same
