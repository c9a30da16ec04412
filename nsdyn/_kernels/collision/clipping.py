"""Clipping of features of one shape to a face of another."""

import math
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.collision.faces import next_feature
from nsdyn._kernels.collision.kinds import (
    HALFSPACE,
    POLYTOPE,
    corners,
    face_level,
    face_normal,
    has_rim,
    incident,
    on_rim,
    other_feature,
    side,
)
from nsdyn._kernels.collision.segments import ANGLE
from nsdyn._kernels.collision.separation import INSIDE
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import along, axis, cross, dot, minus, put, row, square, times, to_local, to_world, unit


class Room(NamedTuple):
    """Most contacts of a pair, also the number of points for a circle; scratch arrays of polygons and heights."""

    limit: int
    poly: np.ndarray
    other: np.ndarray
    values: np.ndarray
    points: np.ndarray
    heights: np.ndarray


@no_alloc
def cut(poly, count, heights, tol, out):
    """Part of a polygon, segment or point where a linear function with these values at its corners is ≤ 0.

    A corner within tol of 0 stays unchanged and makes no new corner beside it. Returns the new number of points.
    """
    kept = 0
    for k in range(count):
        h = heights[k]
        if h <= tol:
            put(out, kept, row(poly, k))
            kept += 1
        if count == 1 or (count == 2 and k == 1):
            break
        q = k + 1 if k + 1 < count else 0
        g = heights[q]
        if (h < -tol and g > tol) or (h > tol and g < -tol):
            a = row(poly, k)
            put(out, kept, along(a, h / (h - g), minus(row(poly, q), a)))
            kept += 1
    return kept


@no_alloc(forceinline=True)
def clip_to_face(geometry, g, face, n, poly, count, other, heights):
    """Clip a polygon by the sides of a polytope face of world normal n; return its new number of points."""
    first, tol, c = geometry.vertex_ptr[g], INSIDE * geometry.radius[g], row(geometry.t, g)
    f = geometry.face_ptr[g] + face
    begin, end = geometry.loop_ptr[f], geometry.loop_ptr[f + 1]
    a = to_world(geometry.R, g, row(geometry.vertices, first + geometry.loop[end - 1]))
    for p in range(begin, end):
        b = to_world(geometry.R, g, row(geometry.vertices, first + geometry.loop[p]))
        outward, _ = unit(cross(minus(b, a), n))
        corner = along(c, 1.0, a)
        outside = False
        for q in range(count):
            heights[q] = dot(outward, minus(row(poly, q), corner))
            outside = outside or heights[q] > tol
        if outside:
            count = cut(poly, count, heights, tol, other)
            for q in range(count):
                put(poly, q, row(other, q))
        a = b
    return count


@no_alloc
def on_border(geometry, g, face, p, tol):
    """True if a point over a face or cap is within tol of the border of the face."""
    q = to_local(geometry.R, g, minus(p, row(geometry.t, g)))
    if has_rim(geometry, g):
        return np.hypot(q[0], q[1]) >= geometry.size[g, 0] - tol
    if geometry.kind[g] != POLYTOPE:
        return False
    f, n = geometry.face_ptr[g] + face, face_normal(geometry, g, face)
    for k in range(geometry.loop_ptr[f], geometry.loop_ptr[f + 1]):
        a, b = side(geometry, g, f, k)
        outward, _ = unit(cross(minus(b, a), n))
        if dot(outward, minus(q, a)) >= -tol:
            return True
    return False


@kernel
def clip_to_disk(geometry, g, poly, count, rim, other):
    """Points that span the part of a polygon, segment or point above or below a disk about the z axis of geom g.

    The points are the corners over the disk, the points of edges over its circle, and those of `rim` points of the
    circle that lie under the polygon, lifted to its plane. Returns their number; the points are in poly.
    """
    radius, c = geometry.size[g, 0], row(geometry.t, g)
    tol = INSIDE * radius
    flat = np.empty((count, 3))  # polygon in the frame of the disk
    for k in range(count):
        put(flat, k, to_local(geometry.R, g, minus(row(poly, k), c)))
    kept = 0
    for k in range(count):
        u = row(flat, k)
        if np.hypot(u[0], u[1]) <= radius + tol:
            put(other, kept, row(poly, k))
            kept += 1
        if count == 1 or (count == 2 and k == 1):
            break
        q = k + 1 if k + 1 < count else 0
        e = minus(row(flat, q), u)
        both, half = e[0] * e[0] + e[1] * e[1], e[0] * u[0] + e[1] * u[1]
        root = half * half - both * (u[0] * u[0] + u[1] * u[1] - radius * radius)
        if root > 0.0 and both > tol * tol:
            length = math.sqrt(both)
            for sign in (-1.0, 1.0):
                s = (-half + sign * math.sqrt(root)) / both
                # No point beside a corner: the corner itself is then on the circle.
                if s * length > tol and (1.0 - s) * length > tol:
                    put(other, kept, along(row(poly, k), s, minus(row(poly, q), row(poly, k))))
                    kept += 1
    if count > 2:
        # Newell's normal of the polygon gives its orientation and its plane.
        n = (0.0, 0.0, 0.0)
        for k in range(1, count - 1):
            n = along(n, 1.0, cross(minus(row(flat, k), row(flat, 0)), minus(row(flat, k + 1), row(flat, 0))))
        n, _ = unit(n)
        closest = times(math.copysign(1.0, n[2] * flat[0, 2]), n)  # the point of the circle outermost along it is
        for p in range(rim if n[2] != 0.0 else 0):
            x, y = on_rim(radius, closest, p, rim)
            inside = True
            for k in range(count):
                a, b = row(flat, k), row(flat, k + 1 if k + 1 < count else 0)
                area = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
                inside = inside and area * n[2] > 0.0
            if inside:
                z = flat[0, 2] - (n[0] * (x - flat[0, 0]) + n[1] * (y - flat[0, 1])) / n[2]
                put(other, kept, along(c, 1.0, to_world(geometry.R, g, (x, y, z))))
                kept += 1
    for k in range(kept):
        put(poly, k, row(other, k))
    return kept


@no_alloc
def under_disk(geometry, g, face, n, o, room):
    """Points of the disk of geom o that faces -n, over a polytope face of world normal n, into `room.poly`.

    They are those of `clip_to_disk`, moved along n to the disk, which is almost parallel. Returns their number.
    """
    count = corners(geometry, g, geometry.face_ptr[g] + face, room.poly)
    count = clip_to_disk(geometry, o, room.poly, count, room.limit, room.other)
    z = axis(geometry.R, o)
    up = dot(z, n)
    centre = along(row(geometry.t, o), -math.copysign(geometry.size[o, 1], up), z)
    for k in range(count):
        p = row(room.poly, k)
        put(room.poly, k, along(p, dot(z, minus(centre, p)) / up, n))
    return count


@no_alloc(forceinline=True)
def over_face(geometry, i, j, margin, face1, face2, room):
    """Contacts of a face of geom i (of geom j if face1 < 0) with the other geom, into points and heights of `room`.

    Returns their number and the normal from 1 to 2.
    """
    g, o, face, sign = (i, j, face1, 1.0) if face1 >= 0 else (j, i, face2, -1.0)
    kind, c = geometry.kind[g], row(geometry.t, g)
    poly, other, points, heights = room.poly, room.other, room.points, room.heights
    n = to_world(geometry.R, g, face_normal(geometry, g, face))
    level = face_level(geometry, g, face)
    count, radius, main = incident(geometry, o, n, kind == HALFSPACE, room.limit, poly)
    kept, following = 0, geometry.face_ptr[o]
    flat = kind == POLYTOPE and has_rim(geometry, o) and square(dot(n, axis(geometry.R, o))) > 1.0 - square(ANGLE)
    while count > 0:
        if has_rim(geometry, g):
            count = clip_to_disk(geometry, g, poly, count, room.limit, other)
        elif flat and count > 2:
            count = under_disk(geometry, g, face, n, o, room)
        elif kind == POLYTOPE:
            count = clip_to_face(geometry, g, face, n, poly, count, other, room.values)
        for k in range(count):
            p = row(poly, k)
            height = dot(n, minus(p, c)) - level - radius
            if height <= margin and kept < heights.size:
                put(points, kept, along(p, -radius, n))
                heights[kept] = height
                kept += 1
        # On a tilted geom other features may be within the margin too.
        count = 0
        if main >= 0 or has_rim(geometry, o):
            m, above = to_local(geometry.R, o, n), dot(n, minus(row(geometry.t, o), c)) - level
            if main < 0:
                if following == geometry.face_ptr[o]:
                    following += 1
                    count = other_feature(geometry, o, m, margin - above, room.limit, poly)
            else:
                following = next_feature(geometry, o, following, main, m, margin - above)
                if following < geometry.face_ptr[o + 1]:
                    count = corners(geometry, o, following, poly)
                following += 1
    return kept, times(sign, n)


@no_alloc
def merge(poly, gap, count, tol):
    """Keep the deepest of several points within tol of each other; return the number left, in order."""
    kept = 0
    for k in range(count):
        twin = -1
        for q in range(kept):
            d = minus(row(poly, k), row(poly, q))
            if dot(d, d) <= tol * tol:
                twin = q
                break
        if twin < 0 or gap[k] < gap[twin]:
            to = kept if twin < 0 else twin
            put(poly, to, row(poly, k))
            gap[to] = gap[k]
            kept = max(kept, to + 1)
    return kept
