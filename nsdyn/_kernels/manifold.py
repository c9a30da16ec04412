"""Contact points of a pair from its features: which of them touch is known (from Coal), where is computed here.

With n the unit normal from geom 1 to geom 2 that separates the pair best, and a margin that the motion may close:

1. A face of one geom whose normal is n within `ANGLE` (half-space, polytope face, cylinder cap) is the *reference*:
   its normal is the contact normal, and the *incident* features of the other geom, clipped to the face, give the
   points, each with its own gap over the plane, up to the margin.
2. Where no such face holds what is deepest, the features themselves touch. Two segments (polytope edge or corner,
   sphere, capsule, side of a cylinder: a segment with a radius) do so in their closest points, parallel ones at both
   ends of their overlap; ellipsoids and rims of cylinders in one point, where Newton's method makes the separation
   largest.
3. Bodies tilted towards each other can close elsewhere too: beside the contact of 2. come the ends of round segments
   and the points over the face whose normal is closest to n. While the bodies are apart, whatever is over the
   interior of a face has to stay above it: these contacts forbid nothing that is possible.

Vectors are tuples of three floats: they live in registers. R (n, 3, 3) and t (n, 3) are the poses of all geoms.
"""

import math

import numpy as np

from nsdyn._kernels.broadphase import CAPSULE, CYLINDER, ELLIPSOID, HALFSPACE, POLYTOPE, SPHERE, Geometry
from nsdyn._kernels.compiled import kernel

ANGLE = 2e-4  # rad; a face whose normal is this close to the one Coal found (good to 1e-5) is what it found
SHARP = 1e-6  # rad; the same for corners and edges beside such a face
WIDE = 1.0  # |difference| of the normals of tilted bodies and of a face that may still hold points of interest
BIAS = 1e-6  # a face of geom 2 is the reference only if it fits better than that of geom 1 by more than noise
PARALLEL = 1e-3  # sine of the angle below which two segments count as parallel
OBLIQUE = 0.8  # cosine of the angle below which round segments curve away from each other too fast to touch at ends
RESCUE = 1e-5  # a face is preferred to what Coal found if it separates better by this fraction of the size
NEAR = 1e-2  # a point within the margin, and this fraction of the size, of one found more exactly adds nothing
SAME = 1e-6  # points closer than this fraction of the size are one
INSIDE = 1e-9  # a point this fraction of the size outside a side plane is on it


# -- vectors -----------------------------------------------------------------------------------------------


@kernel
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a, b):
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def along(a, s, b):
    """Point a + s b."""
    return a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]


@kernel
def minus(a, b):
    """Difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def times(s, a):
    """Multiple s a."""
    return s * a[0], s * a[1], s * a[2]


@kernel
def unit(a):
    """Direction of a, and its length; a itself where the length is 0 or not finite."""
    length = math.sqrt(dot(a, a))
    if length > 0.0 and length < math.inf:
        return (a[0] / length, a[1] / length, a[2] / length), length
    return a, length


@kernel
def perpendicular(d):
    """A unit vector perpendicular to the unit vector d, the same for the same d; z when d is 0."""
    k = 0
    for i in range(1, 3):
        if abs(d[i]) < abs(d[k]):
            k = i
    e = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
    v, _ = unit(along(e, -d[k], d))
    return v if dot(d, d) > 0.0 else (0.0, 0.0, 1.0)


@kernel
def row(a, k):
    """Row k of an array as a vector."""
    return a[k, 0], a[k, 1], a[k, 2]


@kernel
def put(a, k, v):
    """Write the vector v into row k of an array."""
    a[k, 0], a[k, 1], a[k, 2] = v


@kernel
def to_world(R, g, v):
    """Vector v of the shape frame of geom g, in the world frame."""
    return (
        R[g, 0, 0] * v[0] + R[g, 0, 1] * v[1] + R[g, 0, 2] * v[2],
        R[g, 1, 0] * v[0] + R[g, 1, 1] * v[1] + R[g, 1, 2] * v[2],
        R[g, 2, 0] * v[0] + R[g, 2, 1] * v[1] + R[g, 2, 2] * v[2],
    )


@kernel
def to_local(R, g, v):
    """Vector v of the world frame, in the shape frame of geom g."""
    return (
        R[g, 0, 0] * v[0] + R[g, 1, 0] * v[1] + R[g, 2, 0] * v[2],
        R[g, 0, 1] * v[0] + R[g, 1, 1] * v[1] + R[g, 2, 1] * v[2],
        R[g, 0, 2] * v[0] + R[g, 1, 2] * v[1] + R[g, 2, 2] * v[2],
    )


@kernel
def axis(R, g):
    """The z axis of geom g in the world frame."""
    return R[g, 0, 2], R[g, 1, 2], R[g, 2, 2]


# -- shapes ------------------------------------------------------------------------------------------------


@kernel(forceinline=True)
def deepest_vertex(geometry, g, n):
    """Row of the vertex of polytope g farthest along n (shape frame)."""
    best, k = -math.inf, -1
    for i in range(geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]):
        h = dot(row(geometry.vertices, i), n)
        if h > best:
            best, k = h, i
    return k


@kernel
def on_ellipsoid(s, n):
    """Point of the ellipsoid of radii s with the outward normal n, and the height of its tangent plane."""
    height = math.sqrt((s[0] * n[0]) ** 2 + (s[1] * n[1]) ** 2 + (s[2] * n[2]) ** 2)
    return (s[0] ** 2 * n[0] / height, s[1] ** 2 * n[1] / height, s[2] ** 2 * n[2] / height), height


@kernel(forceinline=True)
def support(geometry, g, R, t, n):
    """A point of geom g outermost along n."""
    kind, s, c = geometry.kind[g], row(geometry.size, g), row(t, g)
    if kind == SPHERE:
        return along(c, s[0], n)
    m = to_local(R, g, n)
    if kind == CAPSULE:
        return along(along(c, s[0], n), math.copysign(s[1], m[2]), axis(R, g))
    if kind == ELLIPSOID:
        p, _ = on_ellipsoid(s, m)
    elif kind == CYLINDER:
        side = math.hypot(m[0], m[1])
        x, y = (m[0] / side, m[1] / side) if side > 0.0 else (1.0, 0.0)
        p = (s[0] * x, s[0] * y, math.copysign(s[1], m[2]))
    elif s[0] > 0.0:  # a box
        p = (math.copysign(0.5 * s[0], m[0]), math.copysign(0.5 * s[1], m[1]), math.copysign(0.5 * s[2], m[2]))
    else:
        p = row(geometry.vertices, deepest_vertex(geometry, g, m))
    return along(c, 1.0, to_world(R, g, p))


@kernel
def separation(geometry, i, j, R, t, n):
    """Gap of two geoms along n (width of the slab of normal n between them), and the support points p, q.

    The signed distance is the largest gap over all n, so that any n bounds it from below.
    """
    p = support(geometry, i, R, t, n)
    q = support(geometry, j, R, t, times(-1.0, n))
    return dot(n, minus(q, p)), p, q


@kernel
def gap_along(geometry, i, j, R, t, n):
    """`separation` of two geoms along n, or along the normal of a half-space if one of them is one."""
    for h, g in ((i, j), (j, i)):
        if geometry.kind[h] == HALFSPACE:
            up = to_world(R, h, row(geometry.size, h))
            return dot(up, minus(support(geometry, g, R, t, times(-1.0, up)), row(t, h))) - geometry.offset[h]
    return separation(geometry, i, j, R, t, n)[0]


@kernel
def bend(geometry, g, R, n, a, b):
    """Form a·(dp/dn) b of the support point p of an ellipsoid or of the rim of a cylinder; else 0."""
    kind, s = geometry.kind[g], row(geometry.size, g)
    if kind == CYLINDER:
        tangent, side = unit(cross(axis(R, g), n))
        return s[0] / side * dot(tangent, a) * dot(tangent, b) if side > 0.0 else 0.0
    if kind == ELLIPSOID:
        p, height = on_ellipsoid(s, to_local(R, g, n))
        u, v = to_local(R, g, a), to_local(R, g, b)
        stretched = s[0] ** 2 * u[0] * v[0] + s[1] ** 2 * u[1] * v[1] + s[2] ** 2 * u[2] * v[2]
        return (stretched - dot(p, u) * dot(p, v)) / height
    return 0.0


# -- faces -------------------------------------------------------------------------------------------------


@kernel
def face_count(geometry, g):
    """Number of faces: those of a polytope, the caps of a cylinder."""
    return 2 if geometry.kind[g] == CYLINDER else geometry.face_ptr[g + 1] - geometry.face_ptr[g]


@kernel(forceinline=True)
def face_normal(geometry, g, face):
    """Outward normal of a face in the shape frame: of a polytope, of a cylinder (0 above, 1 below), of a half-space."""
    kind = geometry.kind[g]
    if kind == CYLINDER:
        return 0.0, 0.0, 1.0 - 2.0 * face
    if kind == HALFSPACE:
        return row(geometry.size, g)
    return row(geometry.face_normals, geometry.face_ptr[g] + face)


@kernel(forceinline=True)
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


@kernel
def reference_face(geometry, i, j, R, n, angle):
    """The reference of the normal n: (face of geom i, -1), (-1, face of geom j), or (-1, -1) beyond `angle`."""
    face1, error1 = aligned_face(geometry, i, R, n, angle)
    face2, error2 = aligned_face(geometry, j, R, times(-1.0, n), angle)
    if face1 >= 0 and error1 <= error2 + BIAS:
        return face1, -1
    return -1, face2


@kernel
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


@kernel(forceinline=True)
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


@kernel
def corners(geometry, g, R, t, face, poly):
    """The polygon of a face (a row) of polytope g, into poly; returns its number of points."""
    first, begin, end = geometry.vertex_ptr[g], geometry.loop_ptr[face], geometry.loop_ptr[face + 1]
    for p in range(begin, end):
        v = row(geometry.vertices, first + geometry.loop[p])
        put(poly, p - begin, along(row(t, g), 1.0, to_world(R, g, v)))
    return end - begin


@kernel
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


@kernel
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


@kernel
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


@kernel(forceinline=True)
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


@kernel
def cut(poly, count, heights, tol, out):
    """Part of a polygon, segment or point where the linear function with these values at its corners is ≤ 0.

    A corner within tol of 0 stays as it is and makes no new corner beside it. Returns the new number of points.
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


@kernel(forceinline=True)
def clip_to_face(geometry, g, face, R, t, n, poly, count, other, heights):
    """Clip a polygon by the sides of a polytope face of world normal n; returns its new number of points."""
    first, tol, c = geometry.vertex_ptr[g], INSIDE * geometry.radius[g], row(t, g)
    f = geometry.face_ptr[g] + face
    begin, end = geometry.loop_ptr[f], geometry.loop_ptr[f + 1]
    a = to_world(R, g, row(geometry.vertices, first + geometry.loop[end - 1]))
    for p in range(begin, end):
        b = to_world(R, g, row(geometry.vertices, first + geometry.loop[p]))
        side, _ = unit(cross(minus(b, a), n))
        corner = along(c, 1.0, a)
        outside = False
        for q in range(count):
            heights[q] = dot(side, minus(row(poly, q), corner))
            outside = outside or heights[q] > tol
        if outside:
            count = cut(poly, count, heights, tol, other)
            for q in range(count):
                put(poly, q, row(other, q))
        a = b
    return count


@kernel
def clip_to_disk(radius, g, R, t, poly, count, rim, other):
    """Points that span the part of a polygon, segment or point above or below a disk about the z axis of geom g.

    They are the corners over the disk, the points of the edges over its circle, and those of `rim` points of the
    circle that lie under the polygon, lifted to its plane. Returns their number, in poly.
    """
    tol, c = INSIDE * radius, row(t, g)
    flat = np.empty((count, 3))  # the polygon in the frame of the disk
    for k in range(count):
        put(flat, k, to_local(R, g, minus(row(poly, k), c)))
    kept = 0
    for k in range(count):
        u = row(flat, k)
        if math.hypot(u[0], u[1]) <= radius + tol:
            put(other, kept, row(poly, k))
            kept += 1
        if count == 1 or (count == 2 and k == 1):
            break
        q = k + 1 if k + 1 < count else 0
        e = minus(row(flat, q), u)
        square, half = e[0] * e[0] + e[1] * e[1], e[0] * u[0] + e[1] * u[1]
        root = half * half - square * (u[0] * u[0] + u[1] * u[1] - radius * radius)
        if root > 0.0 and square > tol * tol:
            length = math.sqrt(square)
            for sign in (-1.0, 1.0):
                s = (-half + sign * math.sqrt(root)) / square
                # Not beside a corner: there the corner itself is on the circle.
                if s * length > tol and (1.0 - s) * length > tol:
                    put(other, kept, along(row(poly, k), s, minus(row(poly, q), row(poly, k))))
                    kept += 1
    if count > 2:
        # Newell's normal of the polygon, for its orientation and its plane.
        n = (0.0, 0.0, 0.0)
        for k in range(1, count - 1):
            n = along(n, 1.0, cross(minus(row(flat, k), row(flat, 0)), minus(row(flat, k + 1), row(flat, 0))))
        for p in range(rim if n[2] != 0.0 else 0):
            x, y = radius * math.cos(2.0 * math.pi * p / rim), radius * math.sin(2.0 * math.pi * p / rim)
            inside = True
            for k in range(count):
                u, v = row(flat, k), row(flat, k + 1 if k + 1 < count else 0)
                turn = (v[0] - u[0]) * (y - u[1]) - (v[1] - u[1]) * (x - u[0])
                inside = inside and turn * n[2] > 0.0
            if inside:
                z = flat[0, 2] - (n[0] * (x - flat[0, 0]) + n[1] * (y - flat[0, 1])) / n[2]
                put(other, kept, along(c, 1.0, to_world(R, g, (x, y, z))))
                kept += 1
    for k in range(kept):
        put(poly, k, row(other, k))
    return kept


@kernel(forceinline=True)
def over_face(geometry, i, j, R, t, whole, rim, margin, face1, face2, poly, other, values, points, heights):
    """Contacts of a face of geom i (or, if face1 < 0, of geom j) with the other geom, into points and heights.

    Returns their number and the normal from 1 to 2.
    """
    g, o, face, sign = (i, j, face1, 1.0) if face1 >= 0 else (j, i, face2, -1.0)
    kind, c = geometry.kind[g], row(t, g)
    n = to_world(R, g, face_normal(geometry, g, face))
    if kind == CYLINDER:
        level = geometry.size[g, 1]
    elif kind == POLYTOPE:
        level = geometry.face_offsets[geometry.face_ptr[g] + face]
    else:
        level = geometry.offset[g]
    count, radius, main = incident(geometry, o, R, t, n, whole, rim, poly)
    kept, following = 0, geometry.face_ptr[o]
    while count > 0:
        if kind == CYLINDER:
            count = clip_to_disk(geometry.size[g, 0], g, R, t, poly, count, rim, other)
        elif kind == POLYTOPE:
            count = clip_to_face(geometry, g, face, R, t, n, poly, count, other, values)
        for k in range(count):
            p = row(poly, k)
            height = dot(n, minus(p, c)) - level - radius
            if height <= margin and kept < heights.size:
                put(points, kept, along(p, -radius, n))
                heights[kept] = height
                kept += 1
        # Of a tilted geom other features reach below the margin too.
        count = 0
        if main >= 0 or geometry.kind[o] == CYLINDER:
            m, above = to_local(R, o, n), dot(n, minus(row(t, o), c)) - level
            if main < 0:
                if following == geometry.face_ptr[o]:
                    following += 1
                    count = other_feature(geometry, o, R, t, m, margin - above, rim, poly)
            elif following > geometry.face_ptr[o] or dipping(geometry, o, main, m, margin - above):
                following = next_feature(geometry, o, following, main, m, margin - above)
                if following < geometry.face_ptr[o + 1]:
                    count = corners(geometry, o, R, t, following, poly)
                following += 1
    return kept, times(sign, n)


@kernel
def merge(poly, gap, count, tol):
    """Keep one of several points within tol of each other, the deepest; returns the number left, in order."""
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


@kernel
def triangle(x, y, hull, p, q, r):
    """Twice the area of the triangle of three corners of a hull."""
    a, b, c = hull[p], hull[q], hull[r]
    return abs((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))


@kernel
def reduce(poly, gap, count, n, limit, margin, close):
    """Keep at most `limit` points: the deepest and the corners of the patch that hold most of its area.

    The patch is that of the points the motion closes first: from the margin on down to `close` above the deepest point
    the highest ones are left out, as long as `limit` points are left. The convex hull of the patch in the plane of n
    loses corner after corner, each time the one whose triangle with its neighbours is smallest; then corners move along
    the hull as long as the area grows. Returns the number left, in their former order.
    """
    lowest = math.inf
    for k in range(count):
        lowest = min(lowest, gap[k])
    height = margin - lowest
    while height > close:
        height = max(0.5 * height, close)
        low = 0
        for k in range(count):
            low += gap[k] <= lowest + height
        if low < limit:
            break
        if low < count:
            low = 0
            for k in range(count):
                if gap[k] <= lowest + height:
                    put(poly, low, row(poly, k))
                    gap[low] = gap[k]
                    low += 1
            count = low
    if count <= limit:
        return count
    e1 = perpendicular(n)
    e2 = cross(n, e1)
    x, y = np.empty(count), np.empty(count)
    order = np.empty(count, dtype=np.int64)  # by x, then y
    deepest = 0
    for k in range(count):
        x[k], y[k] = dot(row(poly, k), e1), dot(row(poly, k), e2)
        if gap[k] < gap[deepest]:
            deepest = k
        p = k
        while p > 0 and (x[order[p - 1]] > x[k] or (x[order[p - 1]] == x[k] and y[order[p - 1]] > y[k])):
            order[p] = order[p - 1]
            p -= 1
        order[p] = k
    hull = np.empty(2 * count, dtype=np.int64)
    m = 0
    for half in range(2):
        base = m
        for p in range(count):
            k = order[p] if half == 0 else order[count - 1 - p]
            while m - base >= 2:
                a, b = hull[m - 2], hull[m - 1]
                if (x[b] - x[a]) * (y[k] - y[a]) - (y[b] - y[a]) * (x[k] - x[a]) > 0.0:
                    break
                m -= 1
            hull[m] = k
            m += 1
        m -= 1  # the last of one half is the first of the other
    # The corners kept, as positions in the hull.
    kept = m
    corner = np.arange(m)
    free = limit - 1
    for p in range(m):
        if hull[p] == deepest:
            free = limit
    while kept > free:
        worst, smallest = -1, math.inf
        for p in range(kept):
            area = triangle(x, y, hull, corner[p - 1 if p > 0 else kept - 1], corner[p], corner[(p + 1) % kept])
            # Equal within round-off counts as equal, so that the order and not noise decides.
            if hull[corner[p]] != deepest and area < smallest * (1.0 - 1e-9):
                worst, smallest = p, area
        for p in range(worst, kept - 1):
            corner[p] = corner[p + 1]
        kept -= 1
    for _ in range(10):
        moved = False
        for p in range(kept):
            before, after = corner[p - 1 if p > 0 else kept - 1], corner[(p + 1) % kept]
            if hull[corner[p]] != deepest:
                best, largest = corner[p], triangle(x, y, hull, before, corner[p], after)
                for step in range(1, (after - before) % m):
                    q = (before + step) % m
                    area = triangle(x, y, hull, before, q, after)
                    # The last of equal ones: that spreads the corners of a regular polygon evenly.
                    if area > largest * (1.0 - 1e-9):
                        best, largest = q, max(area, largest)
                moved = moved or best != corner[p]
                corner[p] = best
        if not moved:
            break
    keep = np.zeros(count, dtype=np.bool_)
    keep[deepest] = True
    for p in range(kept):
        keep[hull[corner[p]]] = True
    kept = 0
    for k in range(count):
        if keep[k]:
            put(poly, kept, row(poly, k))
            gap[kept] = gap[k]
            kept += 1
    return kept


# -- segments ----------------------------------------------------------------------------------------------


@kernel(forceinline=True)
def segment(geometry, g, R, t, n, angle):
    """Segment (or point) of geom g that is outermost along n: (its ends p, q, its radius, valid)."""
    kind, s, c, z = geometry.kind[g], row(geometry.size, g), row(t, g), axis(R, g)
    if kind == SPHERE:
        return c, c, s[0], True
    if kind == CAPSULE or kind == CYLINDER:
        side = kind == CAPSULE or abs(dot(n, z)) < angle
        return along(c, -s[1], z), along(c, s[1], z), s[0], side
    if kind != POLYTOPE:
        return c, c, 0.0, False
    m = to_local(R, g, n)
    first, last = geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]
    top = row(geometry.vertices, deepest_vertex(geometry, g, m))
    # The edge: the two outermost corners among those seen from the topmost one under less than `angle`.
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
    return along(c, 1.0, to_world(R, g, p)), along(c, 1.0, to_world(R, g, q)), 0.0, valid


@kernel(forceinline=True)
def closest(p, d, length1, q, e, length2):
    """Arc lengths (s, r) of the closest points p + s d, q + r e of two segments with unit directions d, e."""
    b = dot(d, e)
    w = minus(p, q)
    c, f = dot(d, w), dot(e, w)
    det = 1.0 - b * b
    s = 0.0
    if length1 > 0.0:
        s = (b * f - c) / det if length2 > 0.0 and det > 1e-14 else -c
        s = min(max(s, 0.0), length1)
    r = 0.0
    if length2 > 0.0:
        r = b * s + f
        if r < 0.0 or r > length2:
            r = min(max(r, 0.0), length2)
            if length1 > 0.0:
                s = min(max(b * r - c, 0.0), length1)
    return s, r


@kernel(forceinline=True)
def touch(a, radius1, b, radius2, n, point, normal, gap, at):
    """Write the contact of two balls (or of two points, with the known normal n) at index `at`."""
    if radius1 + radius2 > 0.0:
        n, _ = unit(minus(b, a))
    gap[at] = dot(n, minus(b, a)) - radius1 - radius2
    put(normal, at, n)
    put(point, at, times(0.5, along(along(along(a, radius1, n), 1.0, b), -radius2, n)))


@kernel(forceinline=True)
def segments(p1, q1, radius1, flat1, p2, q2, radius2, flat2, n, known, size, point, normal, gap, at):
    """Contacts of two segments with radii, into the outputs from index `at` on; returns their number.

    n is the normal found by Coal, if `known`. A segment with flat ends (the side of a cylinder) touches with its
    side only. 0 means that the segments are not the features that touch.
    """
    d, length1 = unit(minus(q1, p1))
    e, length2 = unit(minus(q2, p2))
    common = cross(d, e)
    common, sine = unit(common)
    rounded, tiny = radius1 + radius2 > 0.0, SAME * size
    if length1 > 0.0 and length2 > 0.0 and sine < PARALLEL:
        # Both ends of the overlap, as arc lengths on segment 1.
        low, high = dot(d, minus(p2, p1)), dot(d, minus(q2, p1))
        low, high = max(min(low, high), 0.0), min(max(low, high), length1)
        if high - low > tiny:
            across, _ = unit(along(n, -dot(n, d), d))
            count = 0
            for s in (low, high):
                a = along(p1, s, d)
                b = along(p2, dot(e, minus(a, p2)), e)
                touch(a, radius1, b, radius2, across, point, normal, gap, at + count)
                apart = not rounded or gap[at + count] + radius1 + radius2 > tiny
                if apart and (not known or dot(row(normal, at + count), n) > 0.5):
                    count += 1
            if count == 2:
                return 2
    s, r = closest(p1, d, length1, p2, e, length2)
    a, b = along(p1, s, d), along(p2, r, e)
    direction, distance = unit(minus(b, a))
    if rounded and distance <= tiny:
        # The cores cross: any separating direction, the common perpendicular where there is one.
        if known:
            return 0
        m = common if sine >= PARALLEL else perpendicular(d if length1 > 0.0 else e)
        put(normal, at, m)
        put(point, at, a)
        gap[at] = -radius1 - radius2
        return 1
    m = n
    if s > 0.0 and s < length1 and r > 0.0 and r < length2:
        m = common if dot(common, n) >= 0.0 else times(-1.0, common)
    elif distance > tiny:
        m = direction
    touch(a, radius1, b, radius2, m, point, normal, gap, at)
    m = row(normal, at)
    return 0 if (flat1 and abs(dot(m, d)) > INSIDE) or (flat2 and abs(dot(m, e)) > INSIDE) else 1


@kernel
def ends(geometry, i, j, R, t, n, angle, margin, near, point, normal, gap, at, count):
    """Further contacts of two segments with radii: their ends opposite the other segment, up to the margin.

    They follow the `count` contacts from index `at` on; those within `near` of one of them add nothing. Returns the new
    number. Corners and edges of polytopes take part, but not with each other: these are found over faces.
    """
    p1, q1, radius1, valid1 = segment(geometry, i, R, t, n, angle)
    p2, q2, radius2, valid2 = segment(geometry, j, R, t, times(-1.0, n), angle)
    if not (valid1 and valid2) or radius1 + radius2 == 0.0:
        return count
    d, length1 = unit(minus(q1, p1))
    e, length2 = unit(minus(q2, p2))
    if abs(dot(d, e)) < OBLIQUE:
        return count
    for k in range(4):
        # An end a of one segment (radius, kind), and the other from c on along f.
        if k < 2:
            a, radius, flat, opposite, sign = p1 if k == 0 else q1, radius1, geometry.kind[i] == CYLINDER, length1, 1.0
            c, f, length, other = p2, e, length2, radius2
        else:
            a, radius, flat, opposite, sign = p2 if k == 2 else q2, radius2, geometry.kind[j] == CYLINDER, length2, -1.0
            c, f, length, other = p1, d, length1, radius1
        if flat:  # its end is a circle, not a ball
            m = minus(along(c, dot(f, minus(a, c)), f), a)
            m, _ = unit(along(m, -dot(m, d if k < 2 else e), d if k < 2 else e))
            a, radius = along(a, radius, m), 0.0
        s = dot(f, minus(a, c))
        foot = along(c, s, f)
        m, distance = unit(minus(foot, a))
        if not (s > 0.0 and s < length and opposite > 0.0) or sign * dot(m, n) < 0.5:
            continue
        height = distance - radius - other
        middle = times(0.5, along(along(a, radius, m), 1.0, along(foot, -other, m)))
        new = height <= margin
        for q in range(count):
            away = minus(middle, row(point, at + q))
            new = new and dot(away, away) > near * near
        if new:
            put(point, at + count, middle)
            put(normal, at + count, times(sign, m))
            gap[at + count] = height
            count += 1
    return count


# -- curved surfaces ---------------------------------------------------------------------------------------


@kernel
def smooth(geometry, i, j, R, t, n, p1, q1, radius1, valid1, p2, q2, radius2, valid2, point, normal, gap, at):
    """Write the contact of two geoms of which one at least is an ellipsoid or touches with the rim of a cylinder.

    The other may be a segment p, q with a radius (`valid`). From the given n on, Newton's method maximises the
    separation: where it is stationary, the support points a and b differ by a multiple of the normal.
    """
    size = min(geometry.radius[i], geometry.radius[j])
    if valid1 and valid2:  # not as segments, then: a cylinder touches with its rim
        valid1 = geometry.kind[i] != CYLINDER
        valid2 = geometry.kind[j] != CYLINDER and not valid1
    start, end, radius, side = (p1, q1, radius1, 1.0) if valid1 else (p2, q2, radius2, -1.0)
    d, length = unit(minus(end, start))
    if not (valid1 or valid2):
        length = 0.0
    m = n
    for _ in range(20):
        best, a, b = separation(geometry, i, j, R, t, m)
        if length > 0.0:
            s = dot(d, minus(b if valid1 else a, start))
            if not (s > 0.0 and s < length):  # opposite the other geom is an end
                if s > 0.0:
                    start = end
                length = 0.0
                # A cylinder does not end in a ball: its rim is meant.
                valid1 = valid1 and geometry.kind[i] != CYLINDER
                valid2 = valid2 and geometry.kind[j] != CYLINDER
        if length > 0.0:  # turn about the line only
            m, _ = unit(along(m, -dot(m, d), d))
            e1, e2 = cross(d, m), (0.0, 0.0, 0.0)
        else:
            e1 = perpendicular(m)
            e2 = cross(m, e1)
        best, a, b = separation(geometry, i, j, R, t, m)
        a11, a12, a22 = 0.0, 0.0, 0.0
        if valid1:
            a = start
        else:
            a11 += bend(geometry, i, R, m, e1, e1)
            a12 += bend(geometry, i, R, m, e1, e2)
            a22 += bend(geometry, i, R, m, e2, e2)
        if valid2:
            b = start
        else:
            back = times(-1.0, m)
            a11 += bend(geometry, j, R, back, e1, e1)
            a12 += bend(geometry, j, R, back, e1, e2)
            a22 += bend(geometry, j, R, back, e2, e2)
        delta = minus(b, a)
        f1, f2, width, trace = dot(e1, delta), dot(e2, delta), dot(m, delta), a11 + a22
        # Where the separation is not concave enough, step as if it were.
        if not (a11 + width > 0.0 and (a11 + width) * (a22 + width) - a12 * a12 > 1e-10 * trace * trace):
            width = abs(width) + 1e-5 * trace + INSIDE * size
        a11 += width
        a22 += width
        det = a11 * a22 - a12 * a12
        turn = along(times((a22 * f1 - a12 * f2) / det, e1), (a11 * f2 - a12 * f1) / det, e2)
        step = math.sqrt(dot(turn, turn))
        if step < 1e-15:
            break
        scale = min(1.0, 0.2 / step)
        better = False
        for _ in range(10):
            trial, _ = unit(along(m, scale, turn))
            value, _, _ = separation(geometry, i, j, R, t, trial)
            # Close to the maximum round-off decides which value is larger.
            if step < 1e-7 or value > best:
                better = True
                break
            scale *= 0.5
        if not better:
            break
        m = trial
    value, a, b = separation(geometry, i, j, R, t, m)
    given, _, _ = separation(geometry, i, j, R, t, n)
    if value < given - INSIDE * size:
        m = n
        value, a, b = separation(geometry, i, j, R, t, m)
    elif valid1 or valid2:
        # The support point of a segment is any of its points: take the one opposite the other geom.
        s = min(max(dot(d, minus(b if valid1 else a, start)), 0.0), length)
        foot = along(along(start, s, d), side * radius, m)
        a, b = (foot, b) if valid1 else (a, foot)
    put(normal, at, m)
    put(point, at, times(0.5, along(a, 1.0, b)))
    gap[at] = value


# -- pairs -------------------------------------------------------------------------------------------------


@kernel(forceinline=True)
def apart(geometry, i, j, R, t, margin):
    """Whether the bounding spheres (or a sphere and a half-space) are farther apart than margin."""
    d = minus(row(t, j), row(t, i))
    for h, g, sign in ((i, j, 1.0), (j, i, -1.0)):
        if geometry.kind[h] == HALFSPACE:
            height = sign * dot(to_world(R, h, row(geometry.size, h)), d) - geometry.offset[h]
            return height - geometry.radius[g] > margin
    reach = geometry.radius[i] + geometry.radius[j] + margin
    return dot(d, d) > reach * reach


@kernel
def of_features(geometry, i, j, R, t, known, n, angle, margin, near, point, normal, gap, at):
    """Contacts of the edges, corners and curved surfaces that are outermost along n; returns their number.

    The first one has the least gap. Ends of round segments that the margin holds follow.
    """
    count = closest_features(geometry, i, j, R, t, known, n, angle, point, normal, gap, at)
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    if kind1 == CAPSULE or kind1 == CYLINDER or kind2 == CAPSULE or kind2 == CYLINDER:
        wide = min(max(ANGLE, margin / min(geometry.radius[i], geometry.radius[j])), WIDE)
        count = ends(geometry, i, j, R, t, row(normal, at), wide, margin, near, point, normal, gap, at, count)
    return count


@kernel
def closest_features(geometry, i, j, R, t, known, n, angle, point, normal, gap, at):
    """Contacts of the features that are outermost along n, where they are closest; returns their number."""
    size = min(geometry.radius[i], geometry.radius[j])
    flat1, flat2 = geometry.kind[i] == CYLINDER, geometry.kind[j] == CYLINDER
    p1, q1, radius1, valid1 = segment(geometry, i, R, t, n, angle)
    p2, q2, radius2, valid2 = segment(geometry, j, R, t, times(-1.0, n), angle)
    if valid1 and valid2:
        count = segments(
            p1, q1, radius1, flat1, p2, q2, radius2, flat2, n, known, size, point, normal, gap, at
        )  # fmt: skip
        if not known or count == 2:
            return count
        if count == 1:
            # The distance is the largest separation: the right features reach it.
            own, _, _ = separation(geometry, i, j, R, t, row(normal, at))
            given, _, _ = separation(geometry, i, j, R, t, n)
            if own > given - SAME * size and abs(own - gap[at]) < SAME * size:
                return 1
    smooth(geometry, i, j, R, t, n, p1, q1, radius1, valid1, p2, q2, radius2, valid2, point, normal, gap, at)
    return 1


@kernel
def pair_contacts(
    geometry, i, j, R, t, slack, known, trusted, n, base, margin, limit, poly, other, values, points, heights, point,
    normal, gap, at,
):  # fmt: skip
    """Contacts of one pair, into point, normal, gap from index `at` on; returns their number.

    n is the normal of the cores, if `known`, and to be relied on if `trusted`. At rest the margin is `base`.
    """
    size = min(geometry.radius[i], geometry.radius[j])
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    whole = kind1 == HALFSPACE or kind2 == HALFSPACE
    face1, face2 = 0 if kind1 == HALFSPACE else -1, 0 if kind2 == HALFSPACE else -1
    found = n
    if known:
        face1, face2 = reference_face(geometry, i, j, R, n, ANGLE)
        # Cores that overlap give no reliable normal, and rounding off a sliver of contact beside an edge turns it.
        if not trusted or (face1 < 0 and face2 < 0 and separation(geometry, i, j, R, t, n)[0] <= slack):
            n = best_normal(geometry, i, j, R, t, n, RESCUE * size if trusted else 0.0)
            face1, face2 = reference_face(geometry, i, j, R, n, ANGLE)
    first, count, m, tilted = 0, 0, n, face1 < 0 and face2 < 0
    near, deepest = min(NEAR * size, margin), -math.inf
    if tilted:
        first = of_features(
            geometry, i, j, R, t, known, found if trusted else n, ANGLE, margin, near, point, normal, gap, at
        )  # fmt: skip
        deepest = gap[at]
        if kind1 != SPHERE and kind2 != SPHERE and deepest <= margin:
            face1, face2 = reference_face(geometry, i, j, R, row(normal, at), WIDE)
    if face1 >= 0 or face2 >= 0:
        count, m = over_face(
            geometry, i, j, R, t, whole, limit, margin, face1, face2, poly, other, values, points, heights
        )  # fmt: skip
    if not (tilted or whole):
        lowest = math.inf
        for k in range(count):
            lowest = min(lowest, heights[k])
        # What is deepest is not over the face: beside one the features are seen more sharply.
        if lowest > separation(geometry, i, j, R, t, m)[0] + SAME * size:
            first = of_features(
                geometry, i, j, R, t, known, found if trusted else n, SHARP, margin, near, point, normal, gap, at
            )  # fmt: skip
            deepest = gap[at]
    if first > 0:
        kept = 0
        for k in range(count):
            new = True
            for c in range(first):
                d = minus(row(points, k), row(point, at + c))
                new = new and dot(d, d) > near * near
            if new:
                put(points, kept, row(points, k))
                # No point is deeper than the bodies overlap: that is along the normal of the features.
                heights[kept] = max(heights[k], min(deepest, 0.0))
                kept += 1
        count = kept
    count = merge(points, heights, count, SAME * size)
    if count > limit - first:
        count = reduce(points, heights, count, m, limit - first, margin, base)
    for k in range(count):
        put(point, at + first + k, row(points, k))
        put(normal, at + first + k, m)
        gap[at + first + k] = heights[k]
    return first + count


@kernel
def manifolds(
    fields, R, t, slack, first, second, slot, coal, base, reach, limit, poly, other, values, points, heights, point,
    normal, gap, pair,
):  # fmt: skip
    """Contacts of all candidate pairs (first, second), into point, normal, gap and pair; returns their number.

    `fields` are those of `Geometry`, a plain tuple: from Python that is handed over in half the time.
    ``coal[slot[p]]`` is the distance and normal of the cores of pair p, where slot[p] ≥ 0; ``slack[g]`` bounds how
    far the surface of geom g is from that of its core. ``base[p]`` plus the reach of both geoms is the largest gap
    of interest. The outputs have room for `limit` contacts per pair; what comes before them is scratch.
    """
    geometry = Geometry(*fields)
    total = 0
    for p in range(first.size):
        i, j = first[p], second[p]
        margin, both = base[p] + reach[i] + reach[j], slack[i] + slack[j]
        known, trusted, n = slot[p] >= 0, True, (0.0, 0.0, 1.0)
        if known:
            k = slot[p]
            if coal[k, 0] - both > margin:
                continue
            direction, length = unit((coal[k, 1], coal[k, 2], coal[k, 3]))
            trusted = coal[k, 0] > 0.0
            n = direction if length > 0.5 and length < 2.0 else n
        elif apart(geometry, i, j, R, t, margin):
            continue
        count = pair_contacts(
            geometry, i, j, R, t, both, known, trusted, n, base[p], margin, limit, poly, other, values, points,
            heights, point, normal, gap, total,
        )  # fmt: skip
        kept = total
        for k in range(total, total + count):
            if gap[k] <= margin:
                put(point, kept, row(point, k))
                put(normal, kept, row(normal, k))
                gap[kept] = gap[k]
                pair[kept] = p
                kept += 1
        total = kept
    return total
