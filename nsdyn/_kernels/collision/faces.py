"""Faces of polytopes, half-spaces and caps of cylinders, and what of the other shape lies over them."""

import math

from nsdyn._kernels.collision.geometry import CAPSULE, CYLINDER, ELLIPSOID, HALFSPACE, SPHERE
from nsdyn._kernels.collision.support import SHARP, deepest_vertex, separation, support
from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.vectors import along, axis, dot, minus, put, row, times, to_local, to_world, unit

BIAS = 1e-6  # a face of geom 2 is the reference only if it fits better than that of geom 1 by more than noise


@in_place
def face_count(geometry, g):
    """Number of faces: those of a polytope, the caps of a cylinder."""
    return 2 if geometry.kind[g] == CYLINDER else geometry.face_ptr[g + 1] - geometry.face_ptr[g]


@in_place(forceinline=True)
def face_normal(geometry, g, face):
    """Outward normal of a face in the shape frame: of a polytope, of a cylinder (0 above, 1 below), of a half-space."""
    kind = geometry.kind[g]
    if kind == CYLINDER:
        return 0.0, 0.0, 1.0 - 2.0 * face
    if kind == HALFSPACE:
        return row(geometry.size, g)
    return row(geometry.face_normals, geometry.face_ptr[g] + face)


@in_place(forceinline=True)
def aligned_face(geometry, g, R, n, angle):
    """The face of geom g whose normal is closest to n, and |difference|; (-1, inf) if that is not below `angle`."""
    m = to_local(R, g, n)
    best, face = angle * angle, -1
    for f in range(face_count(geometry, g)):
        e = minus(face_normal(geometry, g, f), m)
        square = dot(e, e)
        if square < best:
            best, face = square, f
    return face, math.sqrt(best) if face >= 0 else math.inf


@in_place
def reference_face(geometry, i, j, R, n, angle):
    """The reference of the normal n: (face of geom i, -1), (-1, face of geom j), or (-1, -1) beyond `angle`."""
    face1, error1 = aligned_face(geometry, i, R, n, angle)
    face2, error2 = aligned_face(geometry, j, R, times(-1.0, n), angle)
    if face1 >= 0 and error1 <= error2 + BIAS:
        return face1, -1
    return -1, face2


@in_place
def best_normal(geometry, i, j, R, t, n, gain):
    """The face normal or line of centres that separates best; n itself unless that is better by `gain`."""
    best, p, q = separation(geometry, i, j, R, t, n)
    best += gain
    between = minus(q, p)
    m, distance = unit(minus(row(t, j), row(t, i)))
    if distance > 0.0:
        gap, _, _ = separation(geometry, i, j, R, t, m)
        if gap > best:
            best, n = gap, m
    for g, sign in ((i, 1.0), (j, -1.0)):
        for f in range(face_count(geometry, g)):
            m = times(sign, to_world(R, g, face_normal(geometry, g, f)))
            if dot(m, between) > best:  # any two points bound the gap from above
                gap, _, _ = separation(geometry, i, j, R, t, m)
                if gap > best:
                    best, n = gap, m
    return n


@in_place(forceinline=True)
def incident(geometry, g, R, t, n, whole, rim, poly):
    """Feature of geom g that faces a plane of outward normal n, into poly; returns (number of points, radius).

    The feature is what lies within `radius` of the point, segment or polygon; `whole` asks for all vertices of a
    polytope instead of a face, `rim` is the number of points that stand for the circle of a cylinder's cap. The third
    result is the face of a polytope, as a row.
    """
    kind, s, c, z = geometry.kind[g], row(geometry.size, g), row(t, g), axis(R, g)
    if kind == SPHERE:
        put(poly, 0, c)
        return 1, s[0], -1
    if kind == CAPSULE:
        put(poly, 0, along(c, -s[1], z))
        put(poly, 1, along(c, s[1], z))
        return 2, s[0], -1
    if kind == ELLIPSOID:
        put(poly, 0, support(geometry, g, R, t, times(-1.0, n)))
        return 1, 0.0, -1
    m = to_local(R, g, times(-1.0, n))
    if kind == CYLINDER:
        return of_cylinder(geometry, g, R, t, m, m[2] * m[2] > 0.5, rim, poly), 0.0, -1
    if whole:
        first = geometry.vertex_ptr[g]
        for k in range(geometry.vertex_ptr[g + 1] - first):
            put(poly, k, along(c, 1.0, to_world(R, g, row(geometry.vertices, first + k))))
        return geometry.vertex_ptr[g + 1] - first, 0.0, -1
    # The face most against n among those around the deepest vertex.
    deepest = deepest_vertex(geometry, g, m) - geometry.vertex_ptr[g]
    best, face = -math.inf, -1
    for f in range(geometry.face_ptr[g], geometry.face_ptr[g + 1]):
        e = dot(row(geometry.face_normals, f), m)
        if e > best:
            for p in range(geometry.loop_ptr[f], geometry.loop_ptr[f + 1]):
                if geometry.loop[p] == deepest:
                    best, face = e, f
    return corners(geometry, g, R, t, face, poly), 0.0, face


@in_place
def corners(geometry, g, R, t, face, poly):
    """The polygon of a face (a row) of polytope g, into poly; returns its number of points."""
    first, begin, end = geometry.vertex_ptr[g], geometry.loop_ptr[face], geometry.loop_ptr[face + 1]
    for p in range(begin, end):
        v = row(geometry.vertices, first + geometry.loop[p])
        put(poly, p - begin, along(row(t, g), 1.0, to_world(R, g, v)))
    return end - begin


@in_place
def of_cylinder(geometry, g, R, t, m, cap, rim, poly):
    """The cap of cylinder g outermost along m (shape frame) as `rim` points, or that line of its side; their number."""
    s, c, side = row(geometry.size, g), row(t, g), math.hypot(m[0], m[1])
    # Where the circle dips deepest; in an upright cylinder that is noise, so any fixed direction does.
    x, y = (m[0] / side, m[1] / side) if side > 1e-6 else (1.0, 0.0)
    if cap:
        for k in range(rim):
            u, v = s[0] * math.cos(2.0 * math.pi * k / rim), s[0] * math.sin(2.0 * math.pi * k / rim)
            p = (x * u - y * v, y * u + x * v, math.copysign(s[1], m[2]))
            put(poly, k, along(c, 1.0, to_world(R, g, p)))
        return rim
    foot = along(c, 1.0, to_world(R, g, (s[0] * x, s[0] * y, 0.0)))
    put(poly, 0, along(foot, -s[1], axis(R, g)))
    put(poly, 1, along(foot, s[1], axis(R, g)))
    return 2


@in_place
def other_feature(geometry, g, R, t, m, low, rim, poly):
    """The line of a cylinder's side when its cap faces -m, else the cap; into poly if that reaches below m·x = low.

    Only what the feature has more than the other one counts. Returns the number of points, 0 if it is of no interest.
    """
    radius, half, side, up = geometry.size[g, 0], geometry.size[g, 1], math.hypot(m[0], m[1]), abs(m[2])
    cap = m[2] * m[2] > 0.5
    more = 2.0 * half * up if cap else radius * side * (1.0 - math.cos(2.0 * math.pi / rim))
    if more - radius * side - half * up > low:
        return 0
    return of_cylinder(geometry, g, R, t, times(-1.0, m), not cap, rim, poly)


@in_place
def next_feature(geometry, g, face, main, m, low):
    """The first face of polytope g from `face` on (rows) that faces -m and has a corner with m·corner ≤ low.

    Corners of the face `main` do not count.
    """
    last = geometry.face_ptr[g + 1]
    while face < last:
        if face != main and dot(row(geometry.face_normals, face), m) < -SHARP:
            for p in range(geometry.loop_ptr[face], geometry.loop_ptr[face + 1]):
                corner = geometry.loop[p]
                if dot(row(geometry.vertices, geometry.vertex_ptr[g] + corner), m) <= low:
                    shared = False
                    for q in range(geometry.loop_ptr[main], geometry.loop_ptr[main + 1]):
                        shared = shared or corner == geometry.loop[q]
                    if not shared:
                        return face
        face += 1
    return last


@in_place(forceinline=True)
def dipping(geometry, g, main, m, low):
    """Whether any corner of polytope g with m·corner ≤ low is not one of the face `main` (a row)."""
    if geometry.size[g, 0] > 0.0:  # a box, faces two by two: the lowest of these corners is opposite the lowest of main
        s, k = row(geometry.size, g), (main - geometry.face_ptr[g]) // 2
        return s[k] * abs(m[k]) - 0.5 * (s[0] * abs(m[0]) + s[1] * abs(m[1]) + s[2] * abs(m[2])) <= low
    count = 0
    for k in range(geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]):
        count += dot(row(geometry.vertices, k), m) <= low
    for p in range(geometry.loop_ptr[main], geometry.loop_ptr[main + 1]):
        count -= dot(row(geometry.vertices, geometry.vertex_ptr[g] + geometry.loop[p]), m) <= low
    return count > 0
