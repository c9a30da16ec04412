"""Distances of many pairs in one call of Pinocchio and Coal, between cores slightly smaller than the shapes.

The poses of the geoms are written, and the results read, through views of the memory that Pinocchio owns.

Coal has constants that are lengths. It therefore gets each pair in a unit of its own: a power of two, which changes no
digit, of the size of its smaller geom. Grains and ships so have the distances of what is as large as a hand.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from nsdyn._kernels.collision import broadphase as _broadphase
from nsdyn.scene.shapes import HALFSPACE, Shape
from nsdyn.tools.arrays import Array, Index

SHRINK = 1e-3
"""Coal gets cores: shapes smaller by this fraction of their inscribed radius. At gap 0 Coal's normals may be wrong by
any angle (half of them are for ellipsoids); those of bodies slightly apart are right. Bodies in contact have cores
still apart."""

GJK_TOLERANCE = 1e-9
"""In units of the pair; cores closer than this count as overlapping and get an arbitrary normal, with Coal's 1e-6 too
many."""

SLOTS = 256
"""Solids per call of Pinocchio: time and memory of its GeometryModel grow with the square of their number."""

_EXPONENTS = 4096
"""More than there are exponents of floats."""


class Solids:
    """Coal's solids of shapes in any unit of length, made once.

    Parameters
    ----------
    shapes : sequence of Shape
        Of all geoms.
    made : dict, optional
        Solids made already, which the selections of `only` share.
    """

    def __init__(self, shapes: Sequence[Shape], made: dict[tuple[int, float, float], Any] | None = None) -> None:
        self.shapes, self._made = shapes, {} if made is None else made

    def __call__(self, geom: int, unit: float, fraction: float = SHRINK) -> Any:
        """Return the solid of a geom, smaller by `fraction` as of `Shape.core`, in a unit in m."""
        shape = self.shapes[geom]
        key = id(shape), unit, fraction
        if (solid := self._made.get(key)) is None:
            solid = self._made[key] = shape.core(fraction, unit)
            if shape.kind != HALFSPACE:  # a solid with an infinite box cannot be copied
                solid.computeLocalAABB()
        return solid

    def only(self, geoms: Index) -> Solids:
        """Return the solids of some geoms."""
        return Solids([self.shapes[g] for g in geoms.tolist()], self._made)


def exponents(radius: Array) -> Index:
    """Return k of the units 2ᵏ m in which lengths (m) are from 1 to 2."""
    return np.frexp(radius)[1].astype(np.int64) - 1


def numbered(geoms: Index, exponent: Index) -> Index:
    """Return one number for each geom in a unit 2ᵏ, k = `exponent`."""
    return _EXPONENTS * geoms + exponent + _EXPONENTS // 2


def split(first: Index, second: Index) -> list[tuple[int, int]]:
    """Ranges of consecutive pairs of solids that involve at most `SLOTS` of them each."""
    ranges, start = [], 0
    solids: set[int] = set()
    for k, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        if len(solids) + (i not in solids) + (j not in solids) > SLOTS:
            ranges.append((start, k))
            start, solids = k, set()
        solids |= {i, j}
    return [*ranges, (start, len(first))] if len(first) else []


def empty_model(solids: int) -> pin.GeometryModel:
    """Model of placeholders on the universe, which get their shapes later."""
    model, ball = pin.GeometryModel(), coal.Sphere(1.0)
    for k in range(solids):
        model.addGeometryObject(pin.GeometryObject(str(k), 0, pin.SE3.Identity(), ball))
    return model


@cache
def _pair(a: int, b: int) -> pin.CollisionPair:
    """Pair of slots, cached: making one takes ten times as long as looking it up."""
    return pin.CollisionPair(a, b)


def distance_request() -> Any:
    """Coal's request for a distance, always from the same start, so that results do not depend on earlier requests."""
    request = coal.DistanceRequest()
    request.gjk_tolerance = GJK_TOLERANCE
    request.gjk_initial_guess = coal.GJKInitialGuess.DefaultGuess
    return request


class Batch:
    """Pairs whose distances come from one call of `pin.computeDistances`, except those that their bounds show apart.

    The poses of the geoms are written, and the results read, through views of the memory of `pin.GeometryData`, whose
    elements are contiguous: rotations column by column, then translations; first distance and normal.

    Parameters
    ----------
    model : callable
        ``model(n)`` returns a model of at least n placeholders, made by `empty_model`.
    solids : Solids
        Of all geoms.
    pairs : ndarray of int, shape (2, m)
        Solids of the pairs, `numbered`; both of a pair are in one unit.
    margin : ndarray, shape (m,)
        m; pairs farther apart than this and the reach of both are of no interest.
    out : ndarray, shape (m, 4)
        Room for distance, m, and normal.
    """

    def __init__(self, model: Callable[[int], Any], solids: Solids, pairs: Index, margin: Array, out: Array) -> None:
        m = margin.size
        self._near, self._changed = np.ones(m, np.bool_), np.empty(m, np.int64)
        self._pairs = *(pairs // _EXPONENTS), margin
        numbers, slots = np.unique(pairs.ravel(), return_inverse=True)
        self._geoms, exponent = np.divmod(numbers, _EXPONENTS)
        unit = np.ldexp(1.0, exponent - _EXPONENTS // 2)
        self._of_solids, self._of_pairs = unit[:, None], np.ones((m, 4))
        self._of_pairs[:, 0] = unit[slots[:m]]
        self._model = model(numbers.size)
        for k, of in enumerate(zip(self._geoms.tolist(), unit.tolist(), strict=True)):
            self._model.geometryObjects[k].geometry = solids(*of)
        del self._model.collisionPairs[:]
        self._model.collisionPairs.extend([_pair(a, b) for a, b in zip(*slots.reshape(2, m).tolist(), strict=True)])
        self._data, self._out = pin.GeometryData(self._model), out
        request = distance_request()
        requests = self._data.distanceRequests
        for k in range(m):  # Pinocchio's own requests start from the last result: not reproducible
            requests[k] = request
        self._rotation, self._translation = pose_views(self._data.oMg, len(self._geoms))
        self._results = _memory(self._data.distanceResults[0].normal.ctypes.data - 8, (m, 4), (_strides()[1], 8))

    def run(self, fields: tuple[Any, ...], placed: tuple[Array, ...], boxes: tuple[Array, Array]) -> None:
        """Write the distances of all pairs into the rows of `out`, inf for pairs whose bounds are too far apart.

        `fields` are those of `Geometry`, `placed` is (R, t, reach) of the geoms, `boxes` their bounds (lower, upper),
        m.
        """
        R, t, _ = placed
        self._rotation[:] = R[self._geoms]
        np.divide(t[self._geoms], self._of_solids, out=self._translation)
        count = _broadphase.of_interest(fields, placed, boxes, self._pairs, self._near, self._changed)
        for k in self._changed[:count].tolist():
            if self._near[k]:
                self._data.activateCollisionPair(k)
            else:
                self._data.deactivateCollisionPair(k)
                self._results[k, 0] = np.inf
        pin.computeDistances(self._model, self._data)
        np.multiply(self._results, self._of_pairs, out=self._out)


def _memory(address: int, shape: tuple[int, ...], strides: tuple[int, ...]) -> Array:
    """Array over foreign memory, whose owner must outlive the array."""
    length = sum((n - 1) * s for n, s in zip(shape, strides, strict=True)) // 8 + 1
    flat = np.frombuffer(memoryview((ctypes.c_double * length).from_address(address)))
    return np.lib.stride_tricks.as_strided(flat, shape, strides)


def pose_views(poses: Any, count: int) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and translations (n, 3) of the first poses of a vector of Pinocchio, as live views."""
    pose, _, shift = _strides()
    origin = poses[0].rotation.ctypes.data
    return _memory(origin, (count, 3, 3), (pose, 8, 24)), _memory(origin + shift, (count, 3), (pose, 8))


@cache
def _strides() -> tuple[int, int, int]:
    """Bytes between poses, between results, and from a rotation to its translation; checked by value."""
    model = empty_model(2)
    model.collisionPairs.extend([pin.CollisionPair(0, 1), pin.CollisionPair(1, 0)])
    data = pin.GeometryData(model)
    pose, result = data.oMg, data.distanceResults
    address = [p.rotation.ctypes.data for p in pose]
    out = (
        address[1] - address[0],
        result[1].normal.ctypes.data - result[0].normal.ctypes.data,
        pose[0].translation.ctypes.data - address[0],
    )
    rotation = _memory(address[0], (2, 3, 3), (out[0], 8, 24))
    translation = _memory(address[0] + out[2], (2, 3), (out[0], 8))
    results = _memory(result[0].normal.ctypes.data - 8, (2, 4), (out[1], 8))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotation[:], translation[:] = turn, ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    pin.computeDistances(model, data)
    good = np.array_equal(pose[1].rotation, turn) and np.array_equal(pose[1].translation, translation[1])
    for row, r in zip(results, result, strict=True):
        seen = np.concatenate(([r.min_distance], r.normal))
        good = good and np.array_equal(row, seen)
    if not good:
        raise RuntimeError(
            f"pin {pin.__version__} with coal {coal.__version__} stores distance results in another way than nsdyn "
            "knows: install the versions that nsdyn was tested with"
        )
    return out
