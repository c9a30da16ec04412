"""Edges, corners, spheres, capsules and sides of cylinders: segments with a radius, and where two touch."""

import math

from nsdyn._kernels.collision.geometry import CAPSULE, CYLINDER, POLYTOPE, SPHERE
from nsdyn._kernels.collision.support import INSIDE, SAME, deepest_vertex
from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.vectors import (
    along,
    axis,
    cross,
    dot,
    minus,
    perpendicular,
    put,
    row,
    times,
    to_local,
    to_world,
    unit,
)

PARALLEL = 1e-3  # sine of the angle below which two segments count as parallel
OBLIQUE = 0.8  # cosine of the angle below which round segments curve away from each other too fast to touch at ends


@in_place(forceinline=True)
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


@in_place
def edge(geometry, g, R, t, n, angle):
    """`segment` at `angle`, or of a polytope at a smaller one: a diagonal of a face tilts less than the face."""
    p, q, radius, valid = segment(geometry, g, R, t, n, angle)
    while not valid and geometry.kind[g] == POLYTOPE and angle > INSIDE:
        angle *= 0.5
        p, q, radius, valid = segment(geometry, g, R, t, n, angle)
    return p, q, radius, valid


@in_place(forceinline=True)
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


@in_place(forceinline=True)
def touch(a, radius1, b, radius2, n, point, normal, gap, at):
    """Write the contact of two balls (or of two points, with the known normal n) at index `at`."""
    if radius1 + radius2 > 0.0:
        n, _ = unit(minus(b, a))
    gap[at] = dot(n, minus(b, a)) - radius1 - radius2
    put(normal, at, n)
    put(point, at, times(0.5, along(along(along(a, radius1, n), 1.0, b), -radius2, n)))


@in_place(forceinline=True)
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


@in_place
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
