"""Impulses of redundant contacts between two bodies: those of least norm, which tables and pictures show.

Contacts of two rigid bodies that push at one instant make one force and one torque. If the contacts are redundant, like
the four corners of a box, many impulses make the same force and torque, and a solver returns any of them. The impulses
shown are those of

    min ½ Σ ‖r_c‖²   with   Σ H_cᵀ r_c = Σ H_cᵀ r̂_c,   r_c ∈ K_c,

where r̂ are the solver's impulses and H_cᵀ r_c is force and torque of contact c. For a sticking contact, K_c is the
friction cone. For a slipping contact it is the ray through r̂_c, so that friction still opposes the slip with μ r_N. A
contact without an impulse keeps none. The law of contact therefore holds as it does for r̂. The motion, forces and
torques do not change. Nor does the sum of the works of the pair, which is the work of its force and torque on one
relative motion. Redundancy beyond a pair of bodies, as of three blocks in a ring, is left as the solver returned it.

The minimum is the projection of 0 on the feasible set. Its dual has six unknowns y, a twist:

    r_c = P_Kc(H_c y),   Σ H_cᵀ P_Kc(H_c y) = Σ H_cᵀ r̂_c.

Newton's method with the generalised Jacobian and a line search on the dual function solves it, many pairs at once. If
it does not converge, the solver's impulses are shown.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.problem import cones
from nsdyn.recording.columns import SLIP
from nsdyn.tools.arrays import Array, Bools, Index

COLUMNS = ("point", "normal", "tangent", "mu", "status", "time", "impulse")
"""Columns of contacts that `shared` reads."""

EXACT = 1e-12
"""Tolerance of force and torque, as a fraction of the sum of the sizes of the impulses: a hundred times the round-off
of a few dozen terms."""

STEPS, HALVINGS = 40, 20
"""Largest number of Newton steps, and of halvings of a step. None of 3000 random problems of 2 to 8 contacts needed
more. If the solution without cones lies inside all cones, no step is made."""

HAIR, DAMPING = 1e-14, 1e-4
"""Terms added to the diagonal of the Jacobian, which may be singular, as fractions of its size: HAIR always, and
DAMPING times the residual (K. Levenberg; D. W. Marquardt). Without DAMPING 22 of the 3000 problems did not converge."""

TOGETHER = 1 << 14
"""Number of contacts treated at once, about 10 MB."""


def shared(bodies: Index, step: Index, c: Mapping[str, NDArray[Any]]) -> Array:
    """Return impulses of least norm of contacts, shape (n, 3), (N, T1, T2), N·s, from their `COLUMNS` in a recording.

    Contacts of the same two `bodies` (n, 2), the same `step` (n,) and the same time within the step form a group.
    """
    out: Array = c["impulse"].copy()
    push = np.flatnonzero(out[:, 0] > 0.0)
    time = np.unique(c["time"][push], return_inverse=True)[1].ravel()
    pair = np.sort(bodies[push], axis=1)
    _, group = distinct(np.column_stack([step[push], pair, time]))
    several = np.bincount(group)[group] > 1
    push, group = push[several], group[several]
    order = np.argsort(group, kind="stable")
    push, group = push[order], group[order]
    ends = np.flatnonzero(np.diff(group, append=-1)) + 1  # ends of the groups
    begin = 0
    while begin < push.size:
        last = min(int(np.searchsorted(ends, begin + TOGETHER)), ends.size - 1)
        end = int(ends[last])
        rows = push[begin:end]
        member = np.unique(group[begin:end], return_inverse=True)[1].ravel()
        sign = np.where(bodies[rows, 0] <= bodies[rows, 1], 1.0, -1.0)
        out[rows] = _least(_Pairs.of({name: c[name][rows] for name in COLUMNS}, sign, member), out[rows])
        begin = end
    return out


def contact_axes(c: Mapping[str, NDArray[Any]]) -> Array:
    """Return the axes (n, t1, t2) of contacts in world axes, shape (., 3, 3), from their columns."""
    return np.stack([c["normal"], c["tangent"], np.cross(c["normal"], c["tangent"])], axis=1)


def distinct(rows: Index) -> tuple[Index, Index]:
    """Return the distinct rows, ascending, and the number of each row among them; much faster than `np.unique`."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.concatenate([np.ones(min(1, len(rows)), bool), (np.diff(ordered, axis=0) != 0).any(axis=1)])
    member = np.empty(len(rows), np.int64)
    member[order] = np.cumsum(new) - 1
    return ordered[new], member


class _Pairs(NamedTuple):
    """Contacts of some pairs of bodies, sorted by pair.

    Attributes
    ----------
    H : ndarray, shape (n, 3, 6)
        Maps the twist of a pair to the relative velocity (N, T1, T2). The twist is about the mean of the pair's contact
        points; lengths of its lever arms are in units of the extent of these points.
    mu : ndarray, shape (n,)
    ray : ndarray, shape (n, 3)
        Direction of the solver's impulse.
    slips : ndarray of bool, shape (n,)
    member, start : ndarray of int, shapes (n,), (pairs,)
        Pair of each contact, and the first contact of each pair.
    """

    H: Array
    mu: Array
    ray: Array
    slips: Bools
    member: Index
    start: Index

    @classmethod
    def of(cls, c: Mapping[str, NDArray[Any]], sign: Array, member: Index) -> _Pairs:
        """Make pairs from columns, the sign of each contact (1 or -1, by the order of its bodies), and sorted pairs."""
        start = np.flatnonzero(np.diff(member, prepend=-1))
        count = np.bincount(member)[:, None]
        arm = c["point"] - (np.add.reduceat(c["point"], start) / count)[member]
        extent = np.sqrt(np.add.reduceat((arm**2).sum(axis=1), start) / count[:, 0])
        arm /= np.where(extent > 0.0, extent, 1.0)[member, None]
        lines = sign[:, None, None] * contact_axes(c)
        H = np.concatenate([lines, np.cross(arm[:, None], lines)], axis=2)
        ray = c["impulse"] / np.linalg.norm(c["impulse"], axis=1, keepdims=True)
        return cls(H, c["mu"], ray, c["status"] == SLIP, member, start)

    def some(self, pairs: Bools) -> _Pairs:
        """Return the contacts of some pairs."""
        rows = pairs[self.member]
        member = (np.cumsum(pairs) - 1)[self.member[rows]]
        start = np.flatnonzero(np.diff(member, prepend=-1))
        return _Pairs(self.H[rows], self.mu[rows], self.ray[rows], self.slips[rows], member, start)

    def total(self, values: Array) -> Array:
        """Return the sums over the contacts of each pair."""
        return np.add.reduceat(values, self.start)

    def wrench(self, r: Array) -> Array:
        """Return Σ Hᵀ r of each pair, shape (pairs, 6)."""
        return self.total(np.einsum("cij,ci->cj", self.H, r))

    def impulses(self, y: Array) -> tuple[Array, Array]:
        """Return H y and its projections on the cones and rays, shape (n, 3)."""
        z = np.einsum("cij,cj->ci", self.H, y[self.member])
        along = np.maximum((z * self.ray).sum(axis=1, keepdims=True), 0.0) * self.ray
        return z, np.where(self.slips[:, None], along, cones.project(z, self.mu))

    def newton(self, z: Array, off: Array, damping: Array | float) -> Array:
        """Return the change of y (pairs, 6) that cancels the residual `off` of Σ Hᵀ P(z), z = H y, to first order.

        The Jacobian may be singular: `damping` (pairs,) times its size is added to its diagonal.
        """
        cone = cones.projection_jacobian(z, self.mu)
        along = ((z * self.ray).sum(axis=1) >= 0.0)[:, None, None] * self.ray[:, :, None] * self.ray[:, None, :]
        D = np.where(self.slips[:, None, None], along, cone)
        added = damping * self.total((self.H**2).sum(axis=(1, 2)))
        slope = self.total(self.H.transpose(0, 2, 1) @ D @ self.H) + added[:, None, None] * np.eye(6)
        return np.linalg.solve(slope, -off[..., None])[..., 0].astype(float)


def _least(pairs: _Pairs, r: Array) -> Array:
    """Return impulses of least norm with the wrench of r (n, 3) for each pair; r itself if Newton's method fails."""
    out, row = r.copy(), np.arange(len(r))
    total = pairs.total(np.linalg.norm(r, axis=1))
    wanted, scale = pairs.wrench(r) / total[:, None], total[pairs.member]
    y = pairs.newton(np.zeros_like(r), -wanted, HAIR)  # as if there were no cones
    for _ in range(STEPS):
        z, p = pairs.impulses(y)
        off = pairs.wrench(p) - wanted
        size = np.linalg.norm(off, axis=1)
        left = ~(size <= EXACT)
        stay = left[pairs.member]
        out[row[~stay]] = scale[~stay, None] * p[~stay]
        if not left.any():
            break
        row, scale, pairs, z = row[stay], scale[stay], pairs.some(left), z[stay]
        wanted, y, off = wanted[left], y[left], off[left]
        y = _descended(pairs, wanted, y, off, pairs.newton(z, off, HAIR + DAMPING * size[left]))
    return out


def _descended(pairs: _Pairs, wanted: Array, y: Array, off: Array, step: Array) -> Array:
    """Return y after a step, which is halved until it lowers ½ Σ ‖P(H y)‖² - wanted·y, whose gradient is `off`."""

    def value(some: Bools, y: Array) -> Array:
        own = pairs.some(some)
        return 0.5 * own.total((own.impulses(y)[1] ** 2).sum(axis=1)) - (wanted[some] * y).sum(axis=1)

    part, short = np.ones((len(y), 1)), np.ones(len(y), np.bool_)
    begin, slope = value(short, y), (off * step).sum(axis=1)
    for _ in range(HALVINGS):
        # The values are below 1: an increase within their round-off counts as a decrease.
        least = begin[short] + 1e-4 * part[short, 0] * slope[short] + 1e-15
        short[short] = value(short, (y + part * step)[short]) > least
        if not short.any():
            break
        part[short] *= 0.5
    return y + part * step
