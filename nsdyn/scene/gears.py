"""Gears: a fixed ratio between the coordinates of two joints of an articulation, as `mimic` in URDF."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from nsdyn.scene import checks
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

TEETH = 1000
"""Most teeth of a wheel whose turns are not counted; the ratio of two such wheels is a fraction of whole numbers."""


@dataclass(frozen=True)
class Gear:
    """The constraint q2 = ratio q1 + offset, a rigid coupling whose reaction balances any force.

    Attributes
    ----------
    name : str
    coordinate1, coordinate2 : int
        Coordinates of revolute or prismatic joints in v; the same coordinate twice with ratio 0 holds q2 at the offset.
    ratio, offset : float
        In rad or m.
    """

    name: str
    coordinate1: int
    coordinate2: int
    ratio: float
    offset: float


class JointPlace(NamedTuple):
    """A joint of a Pinocchio model: its name, Pinocchio's name of its kind, its places in q and v.

    The q of a `plain` joint are angles and lengths; a `curved` one has several coordinates and is not plain.
    """

    name: str
    kind: str
    q: slice
    v: slice
    plain: bool
    curved: bool


def joints_of(model: Any) -> Iterator[JointPlace]:
    """Yield the joints of a model, without the world."""
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        q, v = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
        yield JointPlace(name, joint.shortname(), q, v, joint.nq == joint.nv, joint.nq != joint.nv > 1)


def joint_at(model: Any, coordinate: int) -> int:
    """Return the joint to which a coordinate of v belongs."""
    return int(np.searchsorted(np.array(model.idx_vs)[1:], coordinate, side="right"))


def _in_q(model: Any, coordinate: int) -> tuple[int, bool]:
    """Return the index in q of the value of a coordinate, and whether q has the value as a pair (cos, sin)."""
    joint = model.joints[joint_at(model, coordinate)]
    return joint.idx_q + coordinate - joint.idx_v, joint.nq != joint.nv


def gear(
    model: Any, name: str, joints: tuple[str, str], ratio: float, offset: float, axes: Sequence[int] = (0, 0)
) -> Gear:
    """Return the gear by which the second of two named joints follows the first; `axes` selects a coordinate each."""
    ratio = checks.number(ratio, f"ratio of {name}")
    known = {joint.name: joint for joint in joints_of(model)}
    coordinates: list[int] = []
    for what, joint, axis in zip(("joint1", "joint2"), joints, axes, strict=True):
        of = known[choice(joint, known, f"{what} of {name}")]
        if of.curved or axis >= of.v.stop - of.v.start:
            raise ValueError(f"{what} of {name} must be a revolute or prismatic joint, {joint!r} is none")
        coordinates.append(of.v.start + axis)
    first, second = coordinates
    if first == second:
        raise ValueError(f"joint2 of {name} must be another than joint1, got {joints[1]!r}")
    if _period(ratio, _in_q(model, first)[1], _in_q(model, second)[1]) == 0.0:
        raise ValueError(
            f"ratio of {name} must be a fraction of whole numbers up to {TEETH}, as turns of continuous joints are "
            f"not counted, got {ratio!r}: make one of {joints[0]!r} and {joints[1]!r} revolute"
        )
    return Gear(name, first, second, ratio, checks.number(offset, f"offset of {name}"))


def _period(ratio: float, round1: bool, round2: bool) -> float:
    """Return the period up to which q2 - ratio q1 is known: inf if it is known exactly, 0 if it is not known at all."""
    if not round1:
        return 2.0 * math.pi if round2 else math.inf
    if not round2:
        return 2.0 * math.pi * abs(ratio) or math.inf
    teeth = Fraction(ratio).limit_denominator(TEETH)
    return 2.0 * math.pi / teeth.denominator if abs(ratio - teeth) <= 1e-12 * abs(ratio) else 0.0  # text is rounded


def following(model: Any, gears: Sequence[Gear], q: Array) -> Array:
    """Return q with the second joint of every gear set to the value that follows from its first joint."""
    q = q.copy()
    for each in [*gears] * len(gears):  # a second joint may be the first of another gear
        k, turning = _in_q(model, each.coordinate2)
        value = _angle(model, each.coordinate1, q) * each.ratio + each.offset
        q[k : k + 1 + turning] = (math.cos(value), math.sin(value)) if turning else value
    return q


def _angle(model: Any, coordinate: int, q: Array) -> float:
    k, turning = _in_q(model, coordinate)
    return math.atan2(q[k + 1], q[k]) if turning else float(q[k])


class GearGaps:
    """Gaps q2 - ratio q1 - offset of k gears, and their derivative.

    Attributes
    ----------
    rows : ndarray, shape (k, nv)
        Derivative of the gaps.
    """

    def __init__(self, model: Any, gears: Sequence[Gear]) -> None:
        self.rows = np.zeros((len(gears), model.nv))
        for row, each in zip(self.rows, gears, strict=True):
            row[each.coordinate2] = 1.0
            row[each.coordinate1] -= each.ratio
        self._coordinates = np.flatnonzero(self.rows.any(axis=0))
        places = [_in_q(model, int(c)) for c in self._coordinates]
        self._at, self._round = np.array([k for k, _ in places], np.int64), np.array([r for _, r in places], np.bool_)
        turning = {int(c) for c in self._coordinates[self._round]}
        self._period = np.array([_period(g.ratio, g.coordinate1 in turning, g.coordinate2 in turning) for g in gears])
        self._offset = np.array([g.offset for g in gears])

    def at(self, q: Array) -> Array:
        """Return the gaps at q, shape (k,), rad or m; for continuous joints the smallest gap up to whole turns."""
        angle = np.where(self._round, np.arctan2(q[self._at + self._round], q[self._at]), q[self._at])
        gap: Array = self.rows[:, self._coordinates] @ angle - self._offset
        turns = np.isfinite(self._period)
        gap[turns] -= self._period[turns] * np.round(gap[turns] / self._period[turns])
        return gap
