"""Penetration depth of two described shapes, by code that shares nothing with the detection of contacts.

The separation of convex shapes A and B along a unit vector n is s(n) = min n·B - max n·A. It is at most their signed
distance. So -s(n) is an upper bound of their overlap, the smallest translation that separates them, and the largest s
is minus the overlap. The maximum is sought as follows:

- two polytopes, spheres or capsules: along the finitely many axes where a maximum can lie (normals of faces, cross
  products of edges; if one shape is round, also from corners to corners and from edges to corners);
- a half-space: along its normal;
- cylinders and ellipsoids: from the best of some hundred directions, by Newton's method and by searches along kinks.
  A maximum that is missed makes the reported overlap too large, never too small.

This module handles arrays of poses of one pair of shapes. For whole scenes and motions see `nsdyn.audit.audit`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.audit.true_shapes import Solid
from nsdyn.tools.arrays import Array, cross

RESOLUTION = 1e-9
"""Overlaps below this fraction of the smaller shape's size are not refined: their upper bound is reported."""

DIRECTIONS = 100
"""Number of directions tried before Newton's method, spread in proportion to each shape."""

NEWTON_STEPS = 30
"""Newton steps from each start."""

CIRCLES = 6
"""Least number of great circles of kinks that are searched; no fewer than the edges that meet in a corner."""

ANGLES = np.sort(
    np.concatenate([np.linspace(-np.pi, np.pi, 33), 0.1 * 0.4 ** np.arange(8), -0.1 * 0.4 ** np.arange(8)])
)
"""Initial angles of the search on a circle, measured from the best known direction, in radians."""

NUMBERS = 1_000_000
"""Largest number of elements of a temporary array: larger ones leave the caches of processors."""


def overlap(shape1: Mapping[str, Any], pose1: ArrayLike, shape2: Mapping[str, Any], pose2: ArrayLike) -> Any:
    """Return the penetration of two shapes: the smallest translation that separates them, 0 if they are apart.

    In m, a float or (m,); never below the true value, and above it by round-off or at most 1e-8 of the smaller shape's
    size. ValueError for an unknown shape or two half-spaces.

    Parameters
    ----------
    shape1, shape2 : mapping
        Outputs of `Shape.describe`, or geoms of `Scene.describe`; not both half-spaces.
    pose1, pose2 : array, shape (4, 4) or (m, 4, 4)
        Homogeneous transforms from the shapes' frames to the world. Several poses are paired one by one.
    """
    pose1, pose2 = np.asarray(pose1, dtype=float), np.asarray(pose2, dtype=float)
    (a, R1, x1), (b, R2, x2) = (
        (Solid.described(shape), pose[..., :3, :3].reshape(-1, 3, 3), pose[..., :3, 3].reshape(-1, 3))
        for shape, pose in ((shape1, pose1), (shape2, pose2))
    )
    out = np.maximum(0.0, -separation(a, R1, x1, b, R2, x2))
    return float(out[0]) if max(pose1.ndim, pose2.ndim) == 2 else out


def separation(a: Solid, R1: Array, x1: Array, b: Solid, R2: Array, x2: Array, exact: bool = False) -> Array:
    """Return the signed distance of two solids in m poses, shape (m,), m: minus the overlap if they overlap.

    ValueError for two half-spaces.

    Parameters
    ----------
    a, b : Solid
    R1, R2 : ndarray, shape (m, 3, 3)
        Rotations from the frames of the solids to the world; one (1, 3, 3) holds for all poses.
    x1, x2 : ndarray, shape (m, 3)
        Positions of the origins, m.
    exact : bool
        Matters if the solids are apart or overlap by less than `RESOLUTION`. False then accepts any lower bound that
        shows this. True gives the distance; for two polytopes apart it gives the largest separation, which their
        distance may exceed between corners.
    """
    if a.kind == "halfspace":
        if b.kind == "halfspace":
            raise ValueError("two halfspaces have no separation")
        return separation(b, R2, x2, a, R1, x1, exact)
    # Pose of b in the frame of a, from differences of positions: the world's origin may be far.
    R, x = np.swapaxes(R1, 1, 2) @ R2, np.einsum("mji,mj->mi", R1, x2 - x1)
    R, x = np.broadcast_to(R, (len(x), 3, 3)), np.broadcast_to(x, (len(R), 3))
    if b.kind == "halfspace":
        n = R @ b.size
        return -np.einsum("mi,mi->m", n, x) - a.support(-n) - b.offset
    separate = _smooth_separation if a.smooth or b.smooth else _polytope_separation
    # In blocks of poses that are small enough for its temporary arrays.
    axes = max(DIRECTIONS, len(a.edges) * len(b.edges), len(a.normals) + len(b.normals))
    if a.radius or b.radius:
        axes = max(axes, len(a.corners) * len(b.corners), len(a.feet) * len(b.corners) + len(b.feet) * len(a.corners))
    rows = max(1, NUMBERS // (axes * max(3, len(a.corners), len(b.corners))))
    parts = [separate(a, b, R[k : k + rows], x[k : k + rows], exact) for k in range(0, len(x), rows)]
    return np.concatenate([np.empty(0), *parts])


def _polytope_separation(a: Solid, b: Solid, R: Array, x: Array, exact: bool) -> Array:
    """Separation of two hulls of balls, from all axes along which a largest separation can lie."""
    turned = np.swapaxes(R, 1, 2)
    best = np.maximum(_over_faces(a, b, R, x), _over_faces(b, a, turned, -(turned @ x[:, :, None])[..., 0]))
    enough = np.inf if exact else -RESOLUTION * min(a.extent, b.extent)
    some = max(1, NUMBERS // (max(1, len(b.edges)) * len(x) * max(3, len(a.corners), len(b.corners))))
    edges = [partial(_edge_axes, a.edges[k : k + some]) for k in range(0, len(a.edges), some)]
    outer = _outermost(a), _outermost(b)
    for axes in [partial(_corner_axes, a), *edges] if a.radius or b.radius else edges:
        left = np.flatnonzero(best < enough)
        if not left.size:
            break
        n = axes(b, R[left], x[left])
        # Some of the corners bound a separation from above: few axes can beat the best and need all corners.
        n = n[:, (_along(*outer, R[left], x[left], n) > best[left, None]).any(axis=0)]
        if n.shape[1]:
            best[left] = np.maximum(best[left], _along(a, b, R[left], x[left], n).max(axis=1))
    return best


def _outermost(a: Solid) -> Solid:
    """The hull of those corners that reach farthest along few directions: about the root of their number."""
    reach = a.corners @ _sphere(math.isqrt(len(a.corners))).T
    return replace(a, corners=a.corners[np.union1d(reach.argmin(axis=0), reach.argmax(axis=0))])


def _over_faces(a: Solid, b: Solid, R: Array, x: Array) -> Array:
    """Largest separation along the normals of the faces of a, shape (m,); -inf if a has none."""
    (low, high), across = a.span, x @ a.normals.T
    other = (a.normals @ R) @ b.corners.T
    apart = np.maximum(across + other.min(axis=2) - high, low - across - other.max(axis=2))
    return apart.max(axis=1, initial=-np.inf) - a.radius - b.radius


SAME, AXIS = 1e-12, np.array([0.0, 0.0, 1.0])
"""Distance below which two points coincide, m; an axis for cases in which any axis will do."""


def _along(a: Solid, b: Solid, R: Array, x: Array, n: Array) -> Array:
    """Separations along axes n (m, k, 3), of either sign, shape (m, k); -inf along axes of length 0."""
    length = np.linalg.norm(n, axis=2)
    n = n / np.where(length > 0.0, length, 1.0)[..., None]
    first, second = a.corners @ np.swapaxes(n, 1, 2), b.corners @ np.swapaxes(n @ R, 1, 2)
    second += np.swapaxes(n @ x[:, :, None], 1, 2)
    up, down = second.min(axis=1) - first.max(axis=1), first.min(axis=1) - second.max(axis=1)
    return np.where(length > 0.0, np.maximum(up, down) - a.radius - b.radius, -np.inf)


def _edge_axes(edges: Array, b: Solid, R: Array, x: Array) -> Array:
    """Cross products of edges (ne, 3) of one solid with those of b, 0 for parallel ones, shape (m, k, 3)."""
    other = b.edges @ np.swapaxes(R, 1, 2)
    out = cross(edges[None, :, None], other[:, None]).reshape(len(x), -1, 3)
    out[np.linalg.norm(out, axis=2) < 1e-12] = 0.0
    return out


def _corner_axes(a: Solid, b: Solid, R: Array, x: Array) -> Array:
    """Axes from corners to corners, and from lines of edges to corners, shape (m, k, 3)."""
    turned = np.swapaxes(R, 1, 2)
    corners = b.corners @ turned + x[:, None]
    start, line = b.feet[:, :3] @ turned + x[:, None], b.feet[:, 3:] @ turned
    pairs = corners[:, None] - a.corners[:, None]
    # If two corners coincide, no axis is better than another.
    pairs[np.linalg.norm(pairs, axis=3) < SAME] = AXIS
    out = [pairs, _across(corners[:, None] - a.feet[:, None, :3], a.feet[None, :, None, 3:])]
    out.append(_across(a.corners[:, None] - start[:, None], line[:, None]))
    return np.concatenate([axes.reshape(len(x), -1, 3) for axes in out], axis=1)


def _across(d: Array, line: Array) -> Array:
    """Components of vectors d across a line of unit vectors; any unit vector across it if the component is 0."""
    out: Array = d - (d * line).sum(axis=-1, keepdims=True) * line
    on = np.linalg.norm(out, axis=-1) < SAME
    if on.any():
        out[on] = _tangents(np.broadcast_to(line, out.shape)[on])[:, :, 0]
    return out


def _smooth_separation(a: Solid, b: Solid, R: Array, x: Array, exact: bool) -> Array:
    """Separation of pairs with a cylinder or an ellipsoid.

    The largest separation lies where three of its kinks meet, on a kink, or off all kinks. All kinks lie on great
    circles, perpendicular to the edges of polytopes and the axes of cylinders.
    """
    enough = np.inf if exact else -RESOLUTION * min(a.extent, b.extent)
    # The line of centres, normals of faces and cross products of edges; kinks meet in the last two.
    centres = np.where(np.linalg.norm(x, axis=1)[:, None] < SAME, AXIS, x)
    faces = np.broadcast_to(a.normals, (len(x), *a.normals.shape)), b.normals @ np.swapaxes(R, 1, 2)
    known = np.concatenate([centres[:, None], *faces, _edge_axes(a.edges, b, R, x)], axis=1)
    best, n = _best_along(a, b, R, x, known)
    left = np.flatnonzero(best < enough)
    if not left.size:
        return best
    R, x, grid = R[left], x[left], _sphere(DIRECTIONS)
    # Directions of the normals of an ellipsoid with the proportions of each shape: flat and long shapes need these.
    own, other = grid / a.half, np.einsum("mij,kj->mki", R, grid / b.half)
    tried = np.concatenate([np.broadcast_to(own, (len(x), *own.shape)), other], axis=1)
    value, start = _best_along(a, b, R, x, tried)
    best[left] = np.maximum(best[left], value)
    deep = best[left] < enough
    left, R, x, start = left[deep], R[deep], x[deep], start[deep]
    if not left.size:
        return best
    value, n_left = _better(_climb(a, b, R, x, n[left]), _climb(a, b, R, x, start))
    for _ in range(2):
        value, n_left = _better((value, n_left), _around(a, b, R, x, n_left))
        value, n_left = _better((value, n_left), _climb(a, b, R, x, n_left))
    best[left] = np.maximum(best[left], value)
    return best


def _better(*found: tuple[Array, Array]) -> tuple[Array, Array]:
    """Largest of several separations (m,), and the vectors (m, 3) along which they occur."""
    values, vectors = (np.stack(items) for items in zip(*found, strict=True))
    k = values.argmax(axis=0)
    rows = np.arange(len(k))
    return values[k, rows], vectors[k, rows]


def _best_along(a: Solid, b: Solid, R: Array, x: Array, n: Array) -> tuple[Array, Array]:
    """Largest separation along given axes n (m, k, 3), shape (m,), and its unit vector from a to b, shape (m, 3)."""
    length = np.linalg.norm(n, axis=2)
    n = n / np.where(length > 0.0, length, 1.0)[..., None]
    both = np.concatenate([n, -n], axis=1)
    values = np.where(np.tile(length, 2) > 0.0, _each_along(a, b, R, x, both), -np.inf)
    k, rows = values.argmax(axis=1), np.arange(len(x))
    return values[rows, k], both[rows, k]


def _each_along(a: Solid, b: Solid, R: Array, x: Array, n: Array) -> Array:
    """Separations along unit vectors n (m, k, 3) from a to b, shape (m, k)."""
    return (n @ x[:, :, None])[..., 0] - a.support(n) - b.support(-(n @ R))


def _climb(a: Solid, b: Solid, R: Array, x: Array, n: Array) -> tuple[Array, Array]:
    """Maximise the separation by Newton's method from n (m, 3); return value and direction as `_best_along`.

    On the unit sphere with tangents T, for a separation s with gradient g and Hessian H, the step is
    T (|s| + λ - Tᵀ H T)⁻¹ Tᵀ g. The damping λ grows after steps that fail and shrinks after steps that help.
    """
    value = _best_along(a, b, R, x, n[:, None])[0]
    damping = np.full(len(x), 1e-3 * min(a.bounding_radius, b.bounding_radius))
    for _ in range(NEWTON_STEPS):
        (p, H), (other, other_H) = a.curvature(n), b.curvature(-(n[:, None] @ R)[:, 0])
        gradient, T = x - p + (R @ other[:, :, None])[..., 0], _tangents(n)
        B = np.swapaxes(T, 1, 2) @ (H + R @ other_H @ np.swapaxes(R, 1, 2)) @ T
        B[:, [0, 1], [0, 1]] += (np.abs(value) + damping)[:, None]
        d = (T @ np.linalg.solve(B, np.swapaxes(T, 1, 2) @ gradient[:, :, None]))[..., 0]
        tried = n + d / np.maximum(1.0, np.linalg.norm(d, axis=1))[:, None]
        new, tried = _best_along(a, b, R, x, tried[:, None])
        up = new > value
        damping *= np.where(up, 0.1, 10.0)
        value, n = np.where(up, new, value), np.where(up[:, None], tried, n)
    return value, n


def _around(a: Solid, b: Solid, R: Array, x: Array, n: Array) -> tuple[Array, Array]:
    """Maximise the separation on the great circles of kinks nearest to n; return value and place as `_best_along`."""
    m, rows = len(x), np.arange(len(x))
    kinks = np.concatenate([np.broadcast_to(a.edges, (m, *a.edges.shape)), b.edges @ np.swapaxes(R, 1, 2)], axis=1)
    if not kinks.shape[1]:
        return np.full(m, -np.inf), n
    lean = np.abs((kinks @ n[:, :, None])[..., 0])
    found = []
    for k in np.argsort(lean, axis=1)[:, : max(CIRCLES, a.meeting, b.meeting)].T:
        axis = kinks[rows, k]
        first = _across(n, axis)
        first = np.where(np.linalg.norm(first, axis=1)[:, None] > 1e-6, first, _tangents(axis)[:, :, 0])
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = cross(axis, first)

        def at(angle: Array, first: Array = first, second: Array = second) -> tuple[Array, Array]:
            directions = np.cos(angle)[..., None] * first[:, None] + np.sin(angle)[..., None] * second[:, None]
            return _each_along(a, b, R, x, directions), directions

        values = at(np.broadcast_to(ANGLES, (m, ANGLES.size)))[0]
        best = values.argmax(axis=1)
        low, high = ANGLES[np.maximum(best - 1, 0)], ANGLES[np.minimum(best + 1, ANGLES.size - 1)]
        while True:  # of nine angles, the neighbours of the best one enclose the maximum
            angle = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 9)
            values, directions = at(angle)
            best = values.argmax(axis=1)
            low, high = angle[rows, np.maximum(best - 1, 0)], angle[rows, np.minimum(best + 1, 8)]
            if (high - low).max() < 1e-7:
                break
        found.append((values[rows, best], directions[rows, best]))
    return _better(*found)


def _tangents(n: Array) -> Array:
    """Two unit vectors perpendicular to each n (m, 3), shape (m, 3, 2)."""
    helper = np.eye(3)[np.abs(n).argmin(axis=1)]
    first = cross(n, helper)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, cross(n, first)], axis=2)


def _sphere(count: int) -> Array:
    """Directions that cover a half sphere evenly, shape (count, 3)."""
    z = (np.arange(count) + 0.5) / count
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
    side = np.sqrt(1.0 - z**2)
    return np.column_stack([side * np.cos(turn), side * np.sin(turn), z])
