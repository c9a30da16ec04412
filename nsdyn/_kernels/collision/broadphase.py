"""Broad phase: poses and axis-aligned bounding boxes of the geoms, and candidate pairs by sort and sweep."""

import math

import numpy as np

from nsdyn._kernels.collision.geometry import Geometry, Placed, place
from nsdyn._kernels.collision.kinds import HALFSPACE, support
from nsdyn._kernels.collision.separation import bounds_apart, gap_along
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.sorting import order as order_of
from nsdyn._kernels.sorting import place_of
from nsdyn._kernels.vectors import times

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@no_alloc
def bound(geometry, g, lower, upper):
    """Smallest axis-aligned bounding box of geom g, from its support points, into rows g; infinite for a half-space."""
    if geometry.kind[g] == HALFSPACE:
        lower[g], upper[g] = -math.inf, math.inf
        return
    for i in range(3):
        axis = AXES[i]
        lower[g, i] = support(geometry, g, times(-1.0, axis))[i]
        upper[g, i] = support(geometry, g, axis)[i]


@no_alloc
def follow(fields, frames, base, placed, boxes, fat):
    """Poses, reaches and bounding boxes of the geoms on moving frames, into `placed` and `boxes`.

    Returns True if the box of a geom, enlarged by its base and its reach, leaves its enlarged box in `fat`. `fields`
    are those of `Geometry`, as a plain tuple, which Python passes in half the time. `frames` is (x, R, reach), `placed`
    is (R, t, reach), `boxes` and `fat` are (lower, upper).
    """
    (x, R_frames, frame_reach), (R, t, reach), (lower, upper), (fat_lower, fat_upper) = frames, placed, boxes, fat
    geometry = Placed(*fields, R, t)
    place(fields, x, R_frames, R, t)
    out = False
    for g in range(geometry.kind.size):
        if geometry.frame[g] >= 0:
            reach[g] = frame_reach[geometry.frame[g]]
            need = base[g] + reach[g]
            bound(geometry, g, lower, upper)
            for i in range(3):
                inside = fat_lower[g, i] <= lower[g, i] - need and upper[g, i] + need <= fat_upper[g, i]
                out = out or not inside
    return out


@kernel
def bounds(fields, x, R_frames, lower, upper):
    """Bounding boxes of the geoms on moving frames at these poses, into their rows; `fields` as in `follow`."""
    geometry = Geometry(*fields)
    R, t = np.empty((geometry.kind.size, 3, 3)), np.empty((geometry.kind.size, 3))
    place(fields, x, R_frames, R, t)
    placed = Placed(*fields, R, t)
    for g in range(geometry.kind.size):
        if geometry.frame[g] >= 0:
            bound(placed, g, lower, upper)


@no_alloc
def contains(sorted_codes, code):
    """True if a sorted array contains the code."""
    at = place_of(sorted_codes, code)
    return at < sorted_codes.size and sorted_codes[at] == code


@no_alloc
def below(geometry, h, R, t, lower, upper):
    """True if a box reaches into the fixed half-space h."""
    depth = -geometry.offset[h]
    for i in range(3):
        n = R[i, 0] * geometry.size[h, 0] + R[i, 1] * geometry.size[h, 1] + R[i, 2] * geometry.size[h, 2]
        depth += n * ((lower[i] if n > 0.0 else upper[i]) - t[i])
    return depth <= 0.0


@kernel
def append(codes, count, code, excluded):
    """Append a code to the first `count` codes unless it is excluded: (array, enlarged if it was full, new count)."""
    if contains(excluded, code):
        return codes, count
    if count == codes.size:
        grown = np.empty(2 * codes.size, dtype=np.int64)
        copy(codes, grown)
        codes = grown
    codes[count] = code
    return codes, count + 1


@no_alloc
def fatten(fields, base, reach, skin, ahead, boxes, fat):
    """Enlarged boxes that stay valid for several steps, into fat_lower and fat_upper; `fields` as in `follow`.

    The boxes grow by the base, `skin` times the bounding radius and `ahead` times the reach; fixed geoms need no
    growth.
    """
    (lower, upper), (fat_lower, fat_upper) = boxes, fat
    geometry = Geometry(*fields)
    for g in range(geometry.kind.size):
        more = 0.0
        if geometry.frame[g] >= 0:
            more = base[g] + skin * geometry.radius[g] + ahead * reach[g]
        for i in range(3):
            fat_lower[g, i], fat_upper[g, i] = lower[g, i] - more, upper[g, i] + more


@no_alloc
def widest(geometry, t):
    """Axis along which the positions of the geoms that are no half-spaces vary most."""
    best, axis = -1.0, 0
    for i in range(3):
        count, mean, square = 0, 0.0, 0.0
        for g in range(geometry.kind.size):
            if geometry.kind[g] != HALFSPACE:
                count += 1
                away = t[g, i] - mean
                mean += away / count
                square += away * (t[g, i] - mean)
        if square > best:
            best, axis = square, i
    return axis


@kernel
def candidates(fields, R, t, lower, upper, excluded):
    """Codes n i + j (i < j) of all pairs of geoms whose boxes overlap, sorted; `fields` as in `follow`.

    Left out are pairs of fixed geoms, pairs on one frame, and excluded pairs (sorted codes). Geoms that are no
    half-spaces are swept along the axis of their greatest spread. Half-spaces are tested against every moving box.
    """
    geometry = Geometry(*fields)
    axis, n, m = widest(geometry, t), geometry.kind.size, 0
    solids, begin = np.empty(n, np.int64), np.empty(n)
    for g in range(n):
        if geometry.kind[g] != HALFSPACE:
            solids[m], begin[m] = g, lower[g, axis]
            m += 1
    order, codes, count = order_of(begin[:m]), np.empty(64, np.int64), 0
    for g in range(n if m < n else 0):
        if geometry.kind[g] != HALFSPACE:
            continue
        for k in range(n):
            if geometry.frame[k] >= 0 and below(geometry, g, R[g], t[g], lower[k], upper[k]):
                codes, count = append(codes, count, min(g, k) * n + max(g, k), excluded)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    for p in range(m):
        i = solids[order[p]]
        end = upper[i, axis]
        for q in range(p + 1, m):
            j = solids[order[q]]
            if lower[j, axis] > end:
                break
            if (
                geometry.frame[i] != geometry.frame[j]
                and lower[i, a] <= upper[j, a]
                and lower[j, a] <= upper[i, a]
                and lower[i, b] <= upper[j, b]
                and lower[j, b] <= upper[i, b]
            ):
                codes, count = append(codes, count, min(i, j) * n + max(i, j), excluded)
    return codes[order_of(codes[:count])]


@no_alloc
def at_least_apart(geometry, i, j, lower, upper):
    """Lower bound of the distance of two geoms, from their bounding spheres and boxes or the plane of a half-space."""
    if geometry.kind[i] == HALFSPACE or geometry.kind[j] == HALFSPACE:
        return gap_along(geometry, i, j, (0.0, 0.0, 1.0))
    square = 0.0
    for k in range(3):
        d = max(lower[j, k] - upper[i, k], lower[i, k] - upper[j, k], 0.0)
        square += d * d
    return max(math.sqrt(square), bounds_apart(geometry, i, j))


@no_alloc
def of_interest(fields, placed, boxes, pairs, near, changed):
    """Update in `near` which pairs may be within their margin and the reach of both; return the number of changes.

    The indices of changed pairs are the first in `changed`. `placed` and `boxes` are those of the geoms, as `follow`
    leaves them; `pairs` is (first, second, margin); lengths in m.
    """
    (R, t, reach), (lower, upper), (first, second, margin) = placed, boxes, pairs
    geometry = Placed(*fields, R, t)
    count = 0
    for p in range(first.size):
        i, j = first[p], second[p]
        now = at_least_apart(geometry, i, j, lower, upper) <= margin[p] + reach[i] + reach[j]
        if now != near[p]:
            near[p], changed[count] = now, p
            count += 1
    return count
