"""Functions of each kind of shape for contact detection; elsewhere only half-spaces and balls have own branches.

A new kind that is smooth everywhere needs only its outermost point (`support`) and the `curvature` there. A kind with
two flat disks across z, of the radius and at the height of its sizes, needs `has_rim` and `incident` (its feature over
a face of another shape). A kind with straight lines needs `segment`, `has_ends` and `other_feature`. A kind whose
points all lie within a radius of a line needs `is_round`. The geoms are `Placed`.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import along, axis, cross, dot, minus, put, row, square, times, to_local, to_world, unit

HALFSPACE, POLYTOPE, SPHERE, CAPSULE, CYLINDER, ELLIPSOID = range(6)
"""As in `nsdyn.scene.shapes`."""


@no_alloc(forceinline=True)
def is_round(geometry, g):
    """True if geom g is the set of points within a radius of a point or segment: Coal is not used for two of them."""
    return geometry.kind[g] == SPHERE or geometry.kind[g] == CAPSULE


@no_alloc(forceinline=True)
def has_ends(geometry, g):
    """True if geom g has a straight line on its surface that ends, other than an edge of a polytope."""
    return geometry.kind[g] == CAPSULE or geometry.kind[g] == CYLINDER


@no_alloc(forceinline=True)
def has_rim(geometry, g):
    """True if geom g ends in two flat disks across its z axis, whose rims end its lines; else lines end in balls."""
    return geometry.kind[g] == CYLINDER


@no_alloc(forceinline=True)
def deepest_vertex(geometry, g, n):
    """Row of the vertex of polytope g farthest along n (shape frame)."""
    best, k = -math.inf, -1
    for i in range(geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]):
        h = dot(row(geometry.vertices, i), n)
        if h > best:
            best, k = h, i
    return k


@no_alloc
def on_ellipsoid(s, n):
    """Point of the ellipsoid of radii s with the outward normal n, and the height of its tangent plane."""
    height = math.sqrt(square(s[0] * n[0]) + square(s[1] * n[1]) + square(s[2] * n[2]))
    return (square(s[0]) * n[0] / height, square(s[1]) * n[1] / height, square(s[2]) * n[2] / height), height


@no_alloc(forceinline=True)
def support(geometry, g, n):
    """A point of geom g outermost along n."""
    kind, s, c = geometry.kind[g], row(geometry.size, g), row(geometry.t, g)
    if kind == SPHERE:
        return along(c, s[0], n)
    m = to_local(geometry.R, g, n)
    if kind == CAPSULE:
        return along(along(c, s[0], n), math.copysign(s[1], m[2]), axis(geometry.R, g))
    if kind == ELLIPSOID:
        p, _ = on_ellipsoid(s, m)
    elif kind == CYLINDER:
        side = np.hypot(m[0], m[1])
        x, y = (m[0] / side, m[1] / side) if side > 0.0 else (1.0, 0.0)
        p = (s[0] * x, s[0] * y, math.copysign(s[1], m[2]))
    elif s[0] > 0.0:  # a box
        p = (math.copysign(0.5 * s[0], m[0]), math.copysign(0.5 * s[1], m[1]), math.copysign(0.5 * s[2], m[2]))
    else:
        p = row(geometry.vertices, deepest_vertex(geometry, g, m))
    return along(c, 1.0, to_world(geometry.R, g, p))


@no_alloc
def curvature(geometry, g, n, a, b):
    """Form a·(dp/dn) b of the support point p of an ellipsoid or of the rim of a cylinder; else 0."""
    kind, s = geometry.kind[g], row(geometry.size, g)
    if kind == CYLINDER:
        tangent, side = unit(cross(axis(geometry.R, g), n))
        return s[0] / side * dot(tangent, a) * dot(tangent, b) if side > 0.0 else 0.0
    if kind == ELLIPSOID:
        p, height = on_ellipsoid(s, to_local(geometry.R, g, n))
        u, v = to_local(geometry.R, g, a), to_local(geometry.R, g, b)
        stretched = square(s[0]) * u[0] * v[0] + square(s[1]) * u[1] * v[1] + square(s[2]) * u[2] * v[2]
        return (stretched - dot(p, u) * dot(p, v)) / height
    return 0.0


@no_alloc
def opposite(geometry, g, n, q, p, angle):
    """The point of geom g nearest to p among those as far along n as q, its `support`; q if there is no other.

    These are a disk or a line of the geom, if it is across n to within `angle`.
    """
    m, x, s = to_local(geometry.R, g, n), to_local(geometry.R, g, minus(p, row(geometry.t, g))), row(geometry.size, g)
    side = np.hypot(m[0], m[1])
    if has_rim(geometry, g) and side < angle:
        inwards = min(1.0, s[0] / max(np.hypot(x[0], x[1]), 1e-300))
        x = inwards * x[0], inwards * x[1], math.copysign(s[1], m[2])
    elif has_ends(geometry, g) and abs(m[2]) < angle:
        x = s[0] / side * m[0], s[0] / side * m[1], min(max(x[2], -s[1]), s[1])
    else:
        return q
    return along(row(geometry.t, g), 1.0, to_world(geometry.R, g, x))


@no_alloc
def face_count(geometry, g):
    """Number of faces: those of a polytope, two disks."""
    return 2 if has_rim(geometry, g) else geometry.face_ptr[g + 1] - geometry.face_ptr[g]


@no_alloc(forceinline=True)
def face_normal(geometry, g, face):
    """Outward normal of a face in the shape frame: of a polytope, a disk (0 above, 1 below), a half-space."""
    if has_rim(geometry, g):
        return 0.0, 0.0, 1.0 - 2.0 * face
    if geometry.kind[g] == HALFSPACE:
        return row(geometry.size, g)
    return row(geometry.face_normals, geometry.face_ptr[g] + face)


@no_alloc(forceinline=True)
def face_level(geometry, g, face):
    """Height of a face over the origin of geom g, along its normal, m; for a disk it is the second size."""
    if has_rim(geometry, g):
        return geometry.size[g, 1]
    if geometry.kind[g] == POLYTOPE:
        return geometry.face_offsets[geometry.face_ptr[g] + face]
    return geometry.offset[g]


@no_alloc(forceinline=True)
def segment(geometry, g, n, angle):
    """Segment (or point) of geom g that is outermost along n: (its ends p, q, its radius, valid)."""
    kind, s, c, z = geometry.kind[g], row(geometry.size, g), row(geometry.t, g), axis(geometry.R, g)
    if kind == SPHERE:
        return c, c, s[0], True
    if kind == CAPSULE or kind == CYLINDER:
        side = kind == CAPSULE or abs(dot(n, z)) < angle
        return along(c, -s[1], z), along(c, s[1], z), s[0], side
    if kind != POLYTOPE:
        return c, c, 0.0, False
    m = to_local(geometry.R, g, n)
    first, last = geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]
    top = row(geometry.vertices, deepest_vertex(geometry, g, m))
    # The edge joins the two outermost corners among those seen from the topmost one at less than `angle`.
    p, q = top, top
    for _ in range(2):
        p, q = q, p
        farthest = 0.0
        for k in range(first, last):
            v = row(geometry.vertices, k)
            d, e = minus(v, top), minus(v, p)
            if -dot(d, m) <= angle * math.sqrt(dot(d, d)) and dot(e, e) > farthest:
                farthest, q = dot(e, e), v
    edge = minus(q, p)
    valid = True
    for k in range(first, last):
        v = row(geometry.vertices, k)
        d, e = minus(v, top), cross(edge, minus(v, p))
        if -dot(d, m) <= angle * math.sqrt(dot(d, d)) and math.sqrt(dot(e, e)) > 1e-3 * dot(edge, edge):
            valid = False  # a face
    return along(c, 1.0, to_world(geometry.R, g, p)), along(c, 1.0, to_world(geometry.R, g, q)), 0.0, valid


@no_alloc
def has_corner(geometry, face, corner):
    """True if a face (a row) has the corner, counted from the first vertex of its geom."""
    for k in range(geometry.loop_ptr[face], geometry.loop_ptr[face + 1]):
        if geometry.loop[k] == corner:
            return True
    return False


@no_alloc
def side(geometry, g, face, k):
    """Ends (shape frame) of the edge of geom g that begins at entry k of the loop of a face (a row)."""
    first, after = geometry.vertex_ptr[g], k + 1 if k + 1 < geometry.loop_ptr[face + 1] else geometry.loop_ptr[face]
    return row(geometry.vertices, first + geometry.loop[k]), row(geometry.vertices, first + geometry.loop[after])


@no_alloc(forceinline=True)
def incident(geometry, g, n, whole, rim, poly):
    """Feature of geom g that faces a plane of outward normal n, into poly; returns (number of points, radius, face).

    The feature is the set of points within `radius` of the point, segment or polygon in poly. If `whole` is true, all
    vertices of a polytope are used instead of a face. `rim` is the number of points that replace the circle of a
    cylinder's cap. The third result is the face of a polytope, as a row; -1 for others.
    """
    kind, s, c, z = geometry.kind[g], row(geometry.size, g), row(geometry.t, g), axis(geometry.R, g)
    if kind == SPHERE:
        put(poly, 0, c)
        return 1, s[0], -1
    if kind == CAPSULE:
        put(poly, 0, along(c, -s[1], z))
        put(poly, 1, along(c, s[1], z))
        return 2, s[0], -1
    if kind != CYLINDER and kind != POLYTOPE:
        put(poly, 0, support(geometry, g, times(-1.0, n)))
        return 1, 0.0, -1
    m = to_local(geometry.R, g, times(-1.0, n))
    if kind == CYLINDER:
        return of_cylinder(geometry, g, m, m[2] * m[2] > 0.5, rim, poly), 0.0, -1
    if whole:
        first = geometry.vertex_ptr[g]
        for k in range(geometry.vertex_ptr[g + 1] - first):
            put(poly, k, along(c, 1.0, to_world(geometry.R, g, row(geometry.vertices, first + k))))
        return geometry.vertex_ptr[g + 1] - first, 0.0, -1
    # Of the faces around the deepest vertex take the one that faces n most.
    deepest = deepest_vertex(geometry, g, m) - geometry.vertex_ptr[g]
    best, face = -math.inf, -1
    for f in range(geometry.face_ptr[g], geometry.face_ptr[g + 1]):
        e = dot(row(geometry.face_normals, f), m)
        if e > best and has_corner(geometry, f, deepest):
            best, face = e, f
    return corners(geometry, g, face, poly), 0.0, face


@no_alloc
def corners(geometry, g, face, poly):
    """The polygon of a face (a row) of polytope g, into poly; returns its number of points."""
    first, begin, end = geometry.vertex_ptr[g], geometry.loop_ptr[face], geometry.loop_ptr[face + 1]
    for p in range(begin, end):
        v = row(geometry.vertices, first + geometry.loop[p])
        put(poly, p - begin, along(row(geometry.t, g), 1.0, to_world(geometry.R, g, v)))
    return end - begin


@no_alloc
def on_rim(radius, m, k, rim):
    """Point k of `rim` points (x, y) of a circle about the z axis; the first is outermost along the unit vector m.

    In an upright cylinder its direction is noise, so that any fixed direction will do.
    """
    side, angle = np.hypot(m[0], m[1]), 2.0 * math.pi * k / rim
    x, y = (m[0] / side, m[1] / side) if side > 1e-9 else (1.0, 0.0)
    u, v = radius * math.cos(angle), radius * math.sin(angle)
    return x * u - y * v, y * u + x * v


@no_alloc
def of_cylinder(geometry, g, m, cap, rim, poly):
    """Cap of cylinder g outermost along m (shape frame) as `rim` points, or the line of its side; their number."""
    s, c = row(geometry.size, g), row(geometry.t, g)
    if cap:
        for k in range(rim):
            x, y = on_rim(s[0], m, k, rim)
            put(poly, k, along(c, 1.0, to_world(geometry.R, g, (x, y, math.copysign(s[1], m[2])))))
        return rim
    x, y = on_rim(s[0], m, 0, rim)
    foot = along(c, 1.0, to_world(geometry.R, g, (x, y, 0.0)))
    put(poly, 0, along(foot, -s[1], axis(geometry.R, g)))
    put(poly, 1, along(foot, s[1], axis(geometry.R, g)))
    return 2


@no_alloc
def other_feature(geometry, g, m, low, rim, poly):
    """The side line of a cylinder when its cap faces -m, else the cap; into poly if it reaches below m·x = low.

    Only the points that the other feature does not have count. Returns the number of points, 0 if it does not reach.
    """
    radius, half, side, up = geometry.size[g, 0], geometry.size[g, 1], np.hypot(m[0], m[1]), abs(m[2])
    cap = m[2] * m[2] > 0.5
    more = 2.0 * half * up if cap else radius * side * (1.0 - math.cos(2.0 * math.pi / rim))
    if more - radius * side - half * up > low:
        return 0
    return of_cylinder(geometry, g, times(-1.0, m), not cap, rim, poly)
