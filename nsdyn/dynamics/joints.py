"""Joint limits and dry joint friction as rows beside the contacts, and the coordinates the solver works in.

A limit is a frictionless contact whose normal row is ±e_j. Dry friction |τ| ≤ τ_c is a contact with μ = 1 whose first
tangent row is e_j, pressed on a coordinate of its own so that r_N = h τ_c exactly: sticking is exact, and the solvers
need nothing new. Where loops or driven joints restrict a tree, v = v_p + Z y, and the solver sees y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.dynamics import joints as _joints
from nsdyn.dynamics.trees import Tree
from nsdyn.problem.blocks import Blocks
from nsdyn.scene.articulations import Articulation
from nsdyn.tools.arrays import Array, Index

__all__ = ["JointLaws", "JointRows", "Rows"]

NOTHING = np.empty(0)
NO_IMPULSES = np.empty((0, 3))

NEAR = 1e-2
"""A limit takes part in a step when the joint is this fraction of its range away from it, plus what it moves."""


@dataclass(frozen=True, eq=False)
class JointRows:
    """The joint rows of a step, nj of them.

    Attributes
    ----------
    slot : ndarray of int, shape (nj,)
        Rows of the table of `JointLaws`, ascending.
    gap : ndarray, shape (nj,)
        Distance to the limit at the midpoint, rad or m; 0 for friction.
    restitution, mu : ndarray, shape (nj,)
    press : ndarray, shape (nj,)
        h τ_c of friction, 0 for limits, N m s or N s.
    """

    slot: Index
    gap: Array
    restitution: Array
    mu: Array
    press: Array

    def take(self, kept: NDArray[np.bool_]) -> JointRows | None:
        """Some of the rows, None for none."""
        if kept.all():
            return self
        if not kept.any():
            return None
        return JointRows(self.slot[kept], self.gap[kept], self.restitution[kept], self.mu[kept], self.press[kept])


class JointLaws:
    """Limits and dry friction of the joints of all trees: a table of slots, each of which may become a row.

    Parameters
    ----------
    articulations : sequence of Articulation
    trees : sequence of Tree
    first : int
        Block of the first tree; the others follow.
    """

    def __init__(self, articulations: Sequence[Articulation], trees: Sequence[Tree], first: int) -> None:
        table = []
        for block, (a, t) in enumerate(zip(articulations, trees, strict=True), start=first):
            start = t.coordinates.start
            lower, upper = t.limits() if a.limits else (np.full(a.model.nv, -np.inf), np.full(a.model.nv, np.inf))
            for j in range(a.model.nv):
                near = NEAR * (upper[j] - lower[j]) if np.isfinite(upper[j] - lower[j]) else NEAR
                for sign, bound in ((1.0, lower[j]), (-1.0, upper[j])):
                    if np.isfinite(bound):
                        table.append((start + j, block, sign, bound, near, a.restitution))
                if a.friction[j] > 0.0:
                    table.append((start + j, block, 0.0, a.friction[j], 0.0, 0.0))
        columns = np.array(table, dtype=float).reshape(-1, 6).T
        self.coordinate, self.block = columns[0].astype(np.int64), columns[1].astype(np.int64)
        self.sign, self.bound, self.near, self.restitution = (np.ascontiguousarray(c) for c in columns[2:])
        self.size = len(table)
        self.limits = np.flatnonzero(self.sign)

    def rows(self, angle: Array, v: Array, v_free: Array, h: float) -> JointRows | None:
        """Rows of a step: all friction, and the limits the joints may reach; None when there are none.

        Parameters
        ----------
        angle : ndarray, shape (n,)
            Joint coordinates at the midpoint.
        v, v_free : ndarray, shape (n,)
            Velocity at the beginning, and at the end without contacts.
        h : float
        """
        slot = np.empty(self.size, np.int64)
        count = _joints.active_rows(self.coordinate, self.sign, self.bound, self.near, angle, v, v_free, h, slot)
        if not count:
            return None
        slot = slot[:count]
        friction = self.sign[slot] == 0.0
        gap, bound = self.gaps(slot, angle), self.bound[slot]
        return JointRows(slot, gap, self.restitution[slot], friction.astype(float), np.where(friction, h * bound, 0.0))

    def gaps(self, slot: Index, angle: Array) -> Array:
        """Distances to the limits of some slots at the joint coordinates, rad or m; 0 for friction."""
        out = np.empty(slot.size)
        _joints.gaps(slot, self.coordinate, self.sign, self.bound, angle, out)
        return out

    def rates(self, slot: Index, v: Array) -> Array:
        """Rates of the gaps of some slots at the velocity v (n,), rad/s or m/s; 0 for friction."""
        out: Array = self.sign[slot] * v[self.coordinate[slot]]
        return out

    def impulses(self, rows: JointRows | None, r: Array, n: int) -> tuple[Array, Array]:
        """Impulses r (nj, 3) by slot, (slots, 3), and those of limits and friction in rows 1 and 2 of (5, n)."""
        on_coordinates = np.zeros((5, n))
        if not self.size:
            return NO_IMPULSES, on_coordinates
        by_slot = np.zeros((self.size, 3))
        if rows is not None:
            by_slot[rows.slot] = r
            j = self.coordinate[rows.slot]
            np.add.at(on_coordinates[1], j, self.sign[rows.slot] * r[:, 0])
            np.add.at(on_coordinates[2], j, rows.mu * r[:, 1])
        return by_slot, on_coordinates

    def append(self, rows: JointRows, full: Blocks) -> Blocks:
        """Contacts of `full` followed by the joint rows."""
        table = self.coordinate, self.block, self.sign
        return Blocks(*_joints.append_rows(rows.slot, *table, full.arrays))


class Rows:
    """The factors of a step in the velocities v, and in the coordinates y that constraints leave free, v = v_p + Z y.

    Parameters
    ----------
    full : Blocks
        In the velocities v of the scene, M⁻¹ of a constrained block being Z Zᵀ.
    bases : mapping of int to ndarray, shape (n, ny)
        Z of the constrained blocks, with Zᵀ M Z = I.
    pressed : ndarray of int, shape (k,)
        Rows of joint friction. Each gets a coordinate of its own, as mobile as its joint.
    press : ndarray, shape (k,)
        Their impulses h τ_c.

    Attributes
    ----------
    full, blocks : Blocks
        `blocks` is `full` itself where nothing restricts or presses.
    press : ndarray, shape (3 nc,)
        Normal velocities without impulses on the coordinates of joint friction, m/s; empty where nothing presses.
    """

    def __init__(self, full: Blocks, bases: Mapping[int, Array], pressed: Index, press: Array) -> None:
        self.full = self.blocks = full
        self.press = NOTHING
        if not bases and not pressed.size:
            return
        z_start = np.cumsum([0, *(Z.size for Z in bases.values())])
        self._z = np.concatenate([np.empty(0), *(Z.ravel() for Z in bases.values())])
        keys = np.fromiter(bases, np.int64, len(bases))
        reduced, self._where, self.press = _joints.reduce_rows(full.arrays, keys, z_start, self._z, pressed, press)
        self.blocks = Blocks(*reduced)

    def velocity_change(self, r: Array) -> Array:
        """Change of v by the impulses r, shape (n,)."""
        y = self.blocks.velocity_change(r)
        if self.blocks is self.full:
            return y
        v = np.empty(self.full.n)
        _joints.expand(self.full.offset, self._where, self._z, self.blocks.offset, y, v)
        return v

    def response(self, r: Array, v: Array) -> tuple[Array, Array]:
        """Impulses H r on the coordinates, and v after them, shape (n,) each."""
        if self.blocks is self.full:
            return self.full.response(r, v)
        return self.full.momentum(r), v + self.velocity_change(r)
