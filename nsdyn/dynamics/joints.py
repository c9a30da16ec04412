"""Joint limits, dry friction and actuators at their limits as rows beside the contacts, and the solver's coordinates.

A joint limit is a frictionless contact whose normal row is ±e_j. A clutch |τ| ≤ τ_c is a contact with μ = 1 whose first
tangent row is e_j. Its normal row acts on an additional coordinate, pressed so that r_N = h τ_c exactly. Sticking is
therefore exact, and the solvers need nothing new. The clutches are:

- Dry joint friction: a clutch to a fixed part. In a planar joint the friction against sliding, ‖τ‖ ≤ τ_c, has the other
  coordinate as its second tangent row. A ball joint has one clutch of both kinds, pressed with h τ_c cos α and h τ_c
  sin α, see `nsdyn.stepping.ball_joints`.
- An actuator at its limit, τ = clip(τ₀ - b v_j, ±L): a clutch to a rotor. The rotor is an additional coordinate of mass
  h b, which turns at τ₀/b without the clutch. While the clutch sticks, the impulse is h (τ₀ - b v_j); while it slips,
  the impulse is ±h L.

Where loops or driven joints restrict a tree, v = v_p + Z y, and the solver works in y.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.dynamics import joints as _joints
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn.dynamics.trees import Tree
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.problem.fc3d import FC3D
from nsdyn.tools.arrays import NEVER, NONE, NOTHING, Array, Bools, Index

NO_CLUTCHES = NONE, np.empty((3, 0)), NEVER, NEVER
TINY = np.finfo(float).tiny

NEAR = 1e-2
"""A limit takes part in a step when the distance of the joint from it is below this fraction of the joint's range, plus
the way the joint may move in the step."""


class JointRows(NamedTuple):
    """The joint rows of a step, nj of them.

    Attributes
    ----------
    slot : ndarray of int, shape (nj,)
        Rows of the table of `JointLaws`, ascending.
    gap : ndarray, shape (nj,)
        Distance to the limit at the midpoint, rad or m; 0 for clutches.
    restitution, mu : ndarray, shape (nj,)
    clutch : ndarray, shape (3, nj)
        h τ_c [N m s or N s], 0 for limits; speed of the rotor [rad/s or m/s] and its mobility [1/(kg m²) or 1/kg], 0
        for rows without a rotor.
    """

    slot: Index
    gap: Array
    restitution: Array
    mu: Array
    clutch: Array

    def take(self, kept: Bools) -> JointRows | None:
        """Return the rows that `kept` selects; None if it selects none."""
        if kept.all():
            return self
        if not kept.any():
            return None
        return JointRows._make(x[..., kept] for x in self)

    @property
    def actuated(self) -> Bools:
        """True for the rows of actuators."""
        return self.clutch[2] > 0.0


class JointLaws:
    """Table of slots, each a possible row: limits and dry friction of the joints of all trees, then actuators.

    Parameters
    ----------
    trees : sequence of Tree
    first : int
        Block of the first tree; the other trees follow.

    Attributes
    ----------
    ball : ndarray of bool, shape (slots,)
        True for the first clutch of a ball joint, about two axes; the next slot is the clutch about the third axis.
    turning : ndarray of bool, shape (slots,)
        True for joints that slip along axes which turn with them.
    no_impulses : ndarray, shape (slots, 3)
        Zero.
    """

    def __init__(self, trees: Sequence[Tree], first: int) -> None:
        table: list[tuple[float, ...]] = []
        balls: list[int] = []
        for block, t in enumerate(trees, start=first):
            a, start = t.articulation, t.coordinates.start
            lower, upper = t.limits()
            paired = t.planes | t.balls
            for j in range(a.model.nv):
                near = NEAR * (upper[j] - lower[j]) if np.isfinite(upper[j] - lower[j]) else NEAR
                for sign, bound in ((1.0, lower[j]), (-1.0, upper[j])):
                    if np.isfinite(bound) and not t.held[j]:
                        table.append((start + j, block, sign, bound, near, a.restitution, -1))
                if a.friction[j] > 0.0 and j - 1 not in paired:
                    other = start + j + 1 if j in paired else -1
                    if j in t.balls:
                        balls.append(len(table))
                    table.append((start + j, block, 0.0, a.friction[j], 0.0, 0.0, other))
        self.passive = len(table)
        self._first = trees[0].coordinates.start if trees else 0
        self._actuators = self.passive - self._first
        for block, t in enumerate(trees, start=first):
            start = t.coordinates.start
            table += [(start + j, block, 0.0, 0.0, 0.0, 0.0, -1) for j in range(t.model.nv)]
        columns = np.array(table, dtype=float).reshape(-1, 7).T
        self.coordinate, self.block = columns[0].astype(np.int64), columns[1].astype(np.int64)
        self.sign, self.bound, self.near, self.restitution = (np.ascontiguousarray(c) for c in columns[2:6])
        self.other = columns[6].astype(np.int64)
        self.ball = np.zeros(self.coordinate.size, np.bool_)
        self.ball[balls] = True
        self.turning = (self.other >= 0) | np.roll(self.ball, 1)
        self.size = len(table)
        self.limits, self.no_impulses = np.flatnonzero(self.sign), np.zeros((self.size, 3))
        self._table = self.coordinate, self.sign, self.bound, self.near

    def rows(self, angle: Array, v: Array, v_free: Array, h: float) -> JointRows | None:
        """Rows of a step: all friction, and the limits that the joints may reach; None when there are no rows.

        Parameters
        ----------
        angle : ndarray, shape (n,)
            Joint coordinates at the midpoint.
        v, v_free : ndarray, shape (n,)
            Velocity at the beginning, and velocity at the end without contacts.
        h : float
        """
        slot = np.empty(self.passive, np.int64)
        if not (count := _joints.near(angle, (v, v_free), h, self._table, slot)):
            return None
        slot = slot[:count]
        friction = self.sign[slot] == 0.0
        clutch = np.zeros((3, slot.size))
        clutch[0] = np.where(friction, h * self.bound[slot], 0.0)
        disk = self.ball[slot]
        if disk.any():  # equal shares until the slip is known
            clutch[0, disk | np.roll(disk, 1)] *= np.sqrt(0.5)
        return JointRows(slot, self.gaps(slot, angle), self.restitution[slot], friction.astype(float), clutch)

    def actuators(self, coordinates: slice) -> slice:
        """Slots of the actuators of the tree with the given coordinates."""
        return slice(self._actuators + coordinates.start, self._actuators + coordinates.stop)

    def with_actuators(self, rows: JointRows | None, coordinates: slice, clutch: Array) -> JointRows | None:
        """Rows of a step followed by the rows of the actuators of a tree that have a clutch (3, nv) to a rotor."""
        on = np.flatnonzero(clutch[2])
        if not on.size:
            return rows
        slot, zero = on + self.actuators(coordinates).start, np.zeros(on.size)
        own = JointRows(slot, zero, zero, zero + 1.0, clutch[:, on])
        return (
            own if rows is None else JointRows(*(np.concatenate(two, axis=-1) for two in zip(rows, own, strict=True)))
        )

    def gaps(self, slot: Index | slice, angle: Array) -> Array:
        """Distances to the limits of the given slots at the joint coordinates, rad or m; 0 for friction."""
        return self.sign[slot] * (angle[self.coordinate[slot]] - self.bound[slot])

    def rates(self, slot: Index, v: Array) -> Array:
        """Rates of the gaps of the given slots at the velocity v (n,), rad/s or m/s; 0 for friction."""
        return self.sign[slot] * v[self.coordinate[slot]]

    def impulses(self, rows: JointRows | None, r: Array, nv: int) -> tuple[Array, Array]:
        """Impulses r (nj, 3) by slot, (slots, 3); and (8, nv): actuators, limits and friction in rows 0, 1 and 2."""
        on_coordinates = np.zeros((8, nv))
        if rows is None:
            return self.no_impulses, on_coordinates
        by_slot, j = np.zeros((self.size, 3)), self.coordinate[rows.slot] - self._first
        by_slot[rows.slot] = r
        np.add.at(on_coordinates[1], j, self.sign[rows.slot] * r[:, 0])
        np.add.at(on_coordinates, (np.where(rows.actuated, 0, 2), j), rows.mu * r[:, 1])
        plane = self.other[rows.slot] >= 0
        np.add.at(on_coordinates[2], self.other[rows.slot[plane]] - self._first, r[plane, 2])
        return by_slot, on_coordinates

    def append(self, rows: JointRows, full: DelassusFactors) -> DelassusFactors:
        """Factors `full` of the contacts, followed by the joint rows."""
        table = self.coordinate, self.other, self.block, self.sign
        return DelassusFactors(*_joints.append_rows(rows.slot, *table, full.arrays))


class ContactJacobian:
    """Factors of a step in the velocities v, and in the coordinates y that the constraints leave free, v = v_p + Z y.

    Parameters
    ----------
    full : DelassusFactors
        In the velocities v of the scene; M⁻¹ of a constrained block is Z Zᵀ.
    bases : mapping of int to ndarray, shape (n, ny)
        Z of the constrained blocks, with Zᵀ M Z = I.
    pressed : ndarray of int, shape (k,)
        Rows that are clutches. Each gets an additional coordinate on which it is pressed, with the mobility of the
        slipping coordinate, and one for its rotor.
    clutch : ndarray, shape (3, k)
        As in `JointRows`.
    plane : ndarray of bool, shape (k,)
        True for clutches with two tangents.
    ball : ndarray of bool, shape (k,)
        True for clutches that share the friction of a ball joint with the next clutch.

    Attributes
    ----------
    full, blocks : DelassusFactors
        `blocks` is `full` itself if no constraint and no clutch is present.
    joint_load : ndarray, shape (3 nc,)
        Velocities of the coordinates of clutches without impulses, m/s; empty without clutches.
    """

    def __init__(
        self,
        full: DelassusFactors,
        bases: Mapping[int, Array],
        pressed: Index,
        clutch: Array,
        plane: Bools,
        ball: Bools,
    ) -> None:
        self.full = self.blocks = full
        self._problem: FC3D | None = None
        self.joint_load, self._pressed, self._impulse, self._plane = NOTHING, pressed, clutch[0], plane
        self.balls = pressed
        if not bases and not pressed.size:
            return
        disks = self._disks = np.flatnonzero(ball)
        self.balls, self._shared = pressed[disks], np.hypot(clutch[0, disks], clutch[0, disks + 1])
        z_start = np.cumsum([0, *(Z.size for Z in bases.values())])
        self._z = np.concatenate([np.empty(0), *(Z.ravel() for Z in bases.values())])
        keys = np.fromiter(bases, np.int64, len(bases))
        reduced, self._where, self.joint_load = _joints.reduce_rows(
            full.arrays, keys, z_start, self._z, pressed, clutch
        )
        self.blocks = DelassusFactors(*reduced)
        self._mobility = -self.joint_load[3 * pressed] / clutch[0]

    def moved(self, least: float, gap: Array) -> Bools:
        """Mark the rows (nc,) that some motion opens or closes, by the rule of `_blocks.delassus_scales`, and clutches.

        `least` is the least opening that counts, m or rad; the gaps (some of nc,) have overlaps, m or rad.
        """
        scales = np.empty(self.full.nc)
        _blocks.delassus_scales(self.full.arrays, least, gap, scales)
        scales[self._pressed] = 1.0
        return scales > 0.0

    def ball_axes(self, x: Array) -> Array:
        """Entries of x (3 nc,) for the three axes of ball joints with dry friction, shape (balls, 3)."""
        first = 3 * self.balls[:, None] + np.array([1, 2, 4])
        return x[first]

    @property
    def shares(self) -> Array:
        """Pressing impulses of both clutches of each ball joint with friction, shape (balls, 2), N m s."""
        return np.column_stack((self._impulse[self._disks], self._impulse[self._disks + 1]))

    def sharing(self, angle: Array) -> ContactJacobian:
        """Return a copy in which the friction of ball joints is divided by the angles α (balls,), rad."""
        out, disks = copy(self), self._disks
        out._impulse, out.joint_load = self._impulse.copy(), self.joint_load.copy()
        out._impulse[disks], out._impulse[disks + 1] = self._shared * np.cos(angle), self._shared * np.sin(angle)
        both = np.concatenate((disks, disks + 1))
        out.joint_load[3 * self._pressed[both]] = -out._impulse[both] * self._mobility[both]
        return out

    def held(self, r: Array) -> Array:
        """Impulses r (3 nc,) with exact clutches: the prescribed pressing, and a tangential part of at most that."""
        if not self._pressed.size:
            return r
        rows, most, out = self._pressed, self._impulse, r.copy()
        first, second = r[3 * rows + 1], np.where(self._plane, r[3 * rows + 2], 0.0)
        less = np.minimum(1.0, most / np.maximum(np.hypot(first, second), TINY))
        out[3 * rows], out[3 * rows + 1], out[3 * rows + 2] = most, less * first, less * second
        return out

    def problem(self, b: Array, mu: Array) -> FC3D:
        """Contact problem of the rows with the free relative velocity b (3 nc,); μ (nc,) is the same at every call."""
        if self._problem is None:
            self._problem = FC3D.from_blocks(self.blocks, b, mu)
            return self._problem
        return self._problem.with_velocity(b)

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
