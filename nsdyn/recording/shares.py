"""How redundant contacts share what two bodies do to each other: by the least norm, the one answer shown everywhere.

Contacts of two rigid bodies that push at one instant make one force and one torque; where they are redundant, as the
four corners of a box, many impulses make the same, and a solver returns any of them. Shown are those of

    min ½ Σ ‖r_c‖²   with   Σ H_cᵀ r_c = Σ H_cᵀ r̂_c,   r_c ∈ K_c,

where r̂ are the solver's and H_cᵀ r_c is force and torque of contact c. K_c is the friction cone of a contact that
sticks. Of one that slips it is the ray through r̂_c, so that friction goes on to oppose the slip with μ r_N. A contact
that carried nothing carries nothing. So the law of contact holds as it does for r̂, and all that the bodies feel stays:
motion, forces, torques, and the sum of the works of the pair, which are those of its force and torque on one relative
motion. Redundancy beyond a pair of bodies, as of three blocks in a ring, is left as the solver has it.

The minimum is the projection of 0 on the feasible set. Its dual has six unknowns y, a twist:

    r_c = P_Kc(H_c y),   Σ H_cᵀ P_Kc(H_c y) = Σ H_cᵀ r̂_c,

solved by Newton's method with its generalised Jacobian and a line search on the dual function, many pairs at once.
Where that does not converge the solver's impulses are shown.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.problem import cones
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["COLUMNS", "distinct", "shared"]

COLUMNS = ("point", "normal", "tangent", "mu", "status", "time", "impulse")
"""Of contacts, that `shared` reads."""

EXACT = 1e-12
"""Force and torque are kept to this, over the sum of the sizes of the impulses: a hundred times round-off of a few
dozen terms."""

STEPS, HALVINGS = 40, 20
"""Most steps of Newton's method, and most times that one is halved. Of 3000 random problems of 2 to 8 contacts none
needed more; where the answer without cones lies in them all, there is no step."""

HAIR, DAMPING = 1e-14, 1e-4
"""What is added to the diagonal of a Jacobian that may be singular, over its size: next to nothing, and more the
farther from the solution, as K. Levenberg and D. W. Marquardt have it. Without the latter 22 of the 3000 did not
converge."""

TOGETHER = 1 << 14
"""Contacts that are looked at at once, about 10 MB."""

SLIP = 2
"""State of a contact that slips."""


def shared(bodies: Index, step: Index, c: Mapping[str, NDArray[Any]]) -> Array:
    """Impulses of least norm of contacts, shape (n, 3), (N, T1, T2), N·s.

    Parameters
    ----------
    bodies : ndarray of int, shape (n, 2)
        The two that touch; a body has one number.
    step : ndarray of int, shape (n,)
        Contacts of one step, of two bodies and at one time within it share.
    c : mapping of str to ndarray
        `COLUMNS` of the contacts, as `nsdyn.recording.file` has them.
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
    ends = np.flatnonzero(np.diff(group, append=-1)) + 1  # of the groups
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


def distinct(rows: Index) -> tuple[Index, Index]:
    """Distinct rows, ascending, and which of them each row is; much faster than `np.unique` of rows."""
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
        Relative velocities (N, T1, T2) by the twists of the pairs about the means of their points, whose turning is in
        units of the extent of these.
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
        """From the columns, 1 or -1 for which of its bodies each contact has second, and the pairs, ascending."""
        start = np.flatnonzero(np.diff(member, prepend=-1))
        count = np.bincount(member)[:, None]
        arm = c["point"] - (np.add.reduceat(c["point"], start) / count)[member]
        extent = np.sqrt(np.add.reduceat((arm**2).sum(axis=1), start) / count[:, 0])
        arm /= np.where(extent > 0.0, extent, 1.0)[member, None]
        n, t = c["normal"], c["tangent"]
        axes = sign[:, None, None] * np.stack([n, t, np.cross(n, t)], axis=1)
        H = np.concatenate([axes, np.cross(arm[:, None], axes)], axis=2)
        ray = c["impulse"] / np.linalg.norm(c["impulse"], axis=1, keepdims=True)
        return cls(H, c["mu"], ray, c["status"] == SLIP, member, start)

    def some(self, pairs: Bools) -> _Pairs:
        """Those of some pairs."""
        rows = pairs[self.member]
        member = (np.cumsum(pairs) - 1)[self.member[rows]]
        start = np.flatnonzero(np.diff(member, prepend=-1))
        return _Pairs(self.H[rows], self.mu[rows], self.ray[rows], self.slips[rows], member, start)

    def total(self, values: Array) -> Array:
        """Sums over each pair."""
        return np.add.reduceat(values, self.start)

    def wrench(self, r: Array) -> Array:
        """Σ Hᵀ r of each pair, shape (pairs, 6)."""
        return self.total(np.einsum("cij,ci->cj", self.H, r))

    def impulses(self, y: Array) -> tuple[Array, Array]:
        """H y and its projections on the cones and rays, shape (n, 3)."""
        z = np.einsum("cij,cj->ci", self.H, y[self.member])
        along = np.maximum((z * self.ray).sum(axis=1, keepdims=True), 0.0) * self.ray
        return z, np.where(self.slips[:, None], along, cones.project(z, self.mu))

    def newton(self, z: Array, off: Array, damping: Array | float) -> Array:
        """Change of y (pairs, 6) that makes up for what Σ Hᵀ P(z), z = H y, is off, to first order.

        The Jacobian may be singular: that much of its size, (pairs,), is added to its diagonal.
        """
        cone = cones.projection_jacobian(z, self.mu)
        along = ((z * self.ray).sum(axis=1) >= 0.0)[:, None, None] * self.ray[:, :, None] * self.ray[:, None, :]
        D = np.where(self.slips[:, None, None], along, cone)
        added = damping * self.total((self.H**2).sum(axis=(1, 2)))
        slope = self.total(self.H.transpose(0, 2, 1) @ D @ self.H) + added[:, None, None] * np.eye(6)
        change: Array = np.linalg.solve(slope, -off[..., None])[..., 0].astype(float)
        return change


def _least(pairs: _Pairs, r: Array) -> Array:
    """Impulses of least norm with the wrenches of r (n, 3) of each pair, r itself where Newton's method fails."""
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
    """Where a step leads, halved until it lowers ½ Σ ‖P(H y)‖² - wanted·y, whose gradient is `off`."""

    def value(some: Bools, y: Array) -> Array:
        own = pairs.some(some)
        out: Array = 0.5 * own.total((own.impulses(y)[1] ** 2).sum(axis=1)) - (wanted[some] * y).sum(axis=1)
        return out

    part, short = np.ones((len(y), 1)), np.ones(len(y), np.bool_)
    begin, slope = value(short, y), (off * step).sum(axis=1)
    for _ in range(HALVINGS):
        # The values are below 1: what is smaller than their round-off counts as lower.
        least = begin[short] + 1e-4 * part[short, 0] * slope[short] + 1e-15
        short[short] = value(short, (y + part * step)[short]) > least
        if not short.any():
            break
        part[short] *= 0.5
    return y + part * step
