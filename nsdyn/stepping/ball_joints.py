"""Dry friction of ball joints, ‖τ‖ ≤ τ_c, built from the solvers' cones, which have two tangents.

The first two axes are a disk pressed with p cos α, the third axis is a clutch pressed with p sin α, where p = h τ_c.
For any α both parts resist their slip, and their sum lies in the ball ‖τ‖ ≤ p. The two parts satisfy the law of the
ball,

    τ = -p ω/‖ω‖  where ω ≠ 0,   ‖τ‖ ≤ p  where ω = 0,

if both stick, or if α is the angle of τ - s ω with the plane of the disk, for any s > 0. Secants find this fixed point.
Only velocities of the problem change with α. A step needs few additional solves, because the last impulses give a good
first α.
"""

from __future__ import annotations

import numpy as np

from nsdyn.dynamics.joints import ContactJacobian
from nsdyn.tools.arrays import Array, Bools

SHARES = 40
"""Most further solves for the directions of friction in a move: the secant method needs one to four for one joint,
eight for five joints in a chain."""

ALIKE = 1e-9
"""Tolerance of the direction of friction, rad; its size is exact."""

SLANT = 1e-3
"""Least change of the residual along a secant, over the length of the secant: flatter secants carry no information."""

AWAY = 2.0
"""Largest growth factor of the residual in a secant step."""

STICKS = 1.0 - 1e-9
"""Share of its largest friction below which a part of the joint sticks."""


def angles(axes: Array) -> Array:
    """Angles α of vectors (balls, 3) with the plane of the first two axes, rad."""
    return np.arctan2(np.abs(axes[:, 2]), np.hypot(axes[:, 0], axes[:, 1]))


def _wanted(rows: ContactJacobian, r: Array, u: Array, scales: Array) -> Array:
    """Angles α after one fixed-point step, from impulses r and velocities u of all rows; unchanged if both stick."""
    tau, shares = rows.ball_axes(r), rows.shares
    inside = (np.hypot(tau[:, 0], tau[:, 1]) < STICKS * shares[:, 0]) & (np.abs(tau[:, 2]) < STICKS * shares[:, 1])
    mobility = np.maximum(scales[rows.balls], scales[rows.balls + 1])
    return np.where(inside, _now(rows), angles(tau - rows.ball_axes(u) / mobility[:, None]))


def _now(rows: ContactJacobian) -> Array:
    return np.arctan2(rows.shares[:, 1], rows.shares[:, 0])


def unbalanced(rows: ContactJacobian, r: Array, u: Array, scales: Array) -> Bools:
    """Ball joints whose friction is not opposite to their slip, shape (balls,).

    At impulses r and velocities u (3 nc,) of all rows, with mobilities `scales` (nc,) as in `FC3D`.
    """
    return np.abs(_wanted(rows, r, u, scales) - _now(rows)) > ALIKE


class Search:
    """Broyden's secants for the angles α of all ball joints of a move.

    The first step is that of the fixed-point iteration. The secants restart with it if one leaves the quadrant or has
    led far away.
    """

    def __init__(self) -> None:
        self._last: tuple[Array, Array] | None = None
        self._inverse = np.empty((0, 0))

    def next(self, rows: ContactJacobian, r: Array, u: Array, scales: Array) -> Array | None:
        """Return the angles to try after a solve with those of `rows`, rad; None if the latter are the solution."""
        now = _now(rows)
        wanted = _wanted(rows, r, u, scales)
        off = wanted - now
        if (np.abs(off) <= ALIKE).all():
            return None
        if self._last is None:
            self._inverse = np.eye(now.size)
        else:
            moved, change = now - self._last[0], self._last[1] - off
            along = moved @ self._inverse
            if abs(scale := float(along @ change)) > SLANT * float(moved @ moved):
                self._inverse += np.outer(moved - self._inverse @ change, along) / scale
        out: Array = now + self._inverse @ off
        beyond = (out < 0.0) | (out > 0.5 * np.pi)
        if beyond.any() or (self._last is not None and np.linalg.norm(off) > AWAY * np.linalg.norm(self._last[1])):
            self._inverse = np.eye(now.size)
        self._last = now, off
        return np.where(beyond, wanted, out)
