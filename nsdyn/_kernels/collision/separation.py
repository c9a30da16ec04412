"""Separation of two shapes along a direction, and tolerances of lengths and angles. The geoms are `Placed`."""

import math

from nsdyn._kernels.collision.kinds import HALFSPACE, support
from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import dot, minus, row, times, to_world

SHARP = 1e-6  # rad; like `ANGLE` of `nsdyn._kernels.collision.segments`, for corners and edges beside such a face
SAME = 1e-6  # points closer than this fraction of the size are one
INSIDE = 1e-9  # a point this fraction of the size outside a side plane is on it


@no_alloc
def separation(geometry, i, j, n):
    """Gap of two geoms along n (width of the slab of normal n between them), and the support points p, q.

    The signed distance is the largest gap over all n. The gap along any n is therefore a lower bound of it.
    """
    p = support(geometry, i, n)
    q = support(geometry, j, times(-1.0, n))
    return dot(n, minus(q, p)), p, q


@no_alloc
def may_meet(geometry, i, j, n, gap, margin):
    """True if geoms i and j, now at the signed distance `gap`, may touch along n after a motion that closes the margin.

    In the motion n turns with one of them. The margin, m, bounds how far its points move; those of the other geom, seen
    from it, move farther if that is larger.
    """
    one, other = geometry.radius[i], geometry.radius[j]
    return separation(geometry, i, j, n)[0] >= min(gap, 0.0) - margin * max(one, other) / min(one, other)


@no_alloc
def gap_along(geometry, i, j, n):
    """`separation` of two geoms along n; if one geom is a half-space, along the normal of the half-space."""
    for h, g in ((i, j), (j, i)):
        if geometry.kind[h] == HALFSPACE:
            up = to_world(geometry.R, h, row(geometry.size, h))
            return dot(up, minus(support(geometry, g, times(-1.0, up)), row(geometry.t, h))) - geometry.offset[h]
    return separation(geometry, i, j, n)[0]


@no_alloc(forceinline=True)
def bounds_apart(geometry, i, j):
    """Distance of the bounding spheres of two geoms, or of one and a half-space; negative if they overlap."""
    d = minus(row(geometry.t, j), row(geometry.t, i))
    for h, g, sign in ((i, j, 1.0), (j, i, -1.0)):
        if geometry.kind[h] == HALFSPACE:
            up = to_world(geometry.R, h, row(geometry.size, h))
            return sign * dot(up, d) - geometry.offset[h] - geometry.radius[g]
    return math.sqrt(dot(d, d)) - geometry.radius[i] - geometry.radius[j]
