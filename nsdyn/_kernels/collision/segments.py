"""Segments with a radius (edges, corners, spheres, capsules, sides of cylinders), and contacts of two of them."""

from nsdyn._kernels.collision.geometry import move, smaller, write
from nsdyn._kernels.collision.kinds import POLYTOPE, deepest_vertex, has_corner, has_rim, is_round, segment, side
from nsdyn._kernels.collision.separation import INSIDE, SAME, SHARP, may_meet, separation
from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import along, cross, dot, minus, perpendicular, row, square, times, to_local, to_world, unit

PARALLEL = 1e-3  # sine of the angle below which two segments count as parallel
ANGLE = 2e-4  # rad; a face whose normal is this close to Coal's (accurate to 1e-5) is the feature that Coal found
WIDE = 1.0  # |difference| of the normals of tilted bodies and of a face up to which points over it are of interest
NEAR = 1e-2  # a point within the margin, and this fraction of the size, of one found more exactly is redundant
OBLIQUE = 0.8  # cosine of the angle; below it round segments curve away from each other too fast to touch at ends


@no_alloc
def edge(geometry, g, n, angle):
    """`segment` at `angle`; of a polytope at smaller angles until it is valid.

    A smaller angle excludes the diagonals of a face, which tilt less than the face.
    """
    p, q, radius, valid = segment(geometry, g, n, angle)
    while not valid and geometry.kind[g] == POLYTOPE and angle > INSIDE:
        angle *= 0.5
        p, q, radius, valid = segment(geometry, g, n, angle)
    return p, q, radius, valid


@no_alloc(forceinline=True)
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


@no_alloc(forceinline=True)
def touch(a, radius1, b, radius2, n, out, at):
    """Write the contact of two balls (or of two points, with the known normal n) at index `at`."""
    if radius1 + radius2 > 0.0:
        n, _ = unit(minus(b, a))
    point = times(0.5, along(along(along(a, radius1, n), 1.0, b), -radius2, n))
    write(out, at, point, n, dot(n, minus(b, a)) - radius1 - radius2)


@no_alloc(forceinline=True)
def end_opposite(end, line):
    """Contact of the end of one segment with another: (unit vector to it, point, gap, distance of cores, arc length).

    `end` is (a, g, radius, flat): the end, the direction and the radius of its segment, and whether its end is flat.
    `line` is (c, f, length, radius, flat) of the other, which starts at c with direction f. Where that has ends that
    are balls, the foot of a on it stays between them.
    """
    (a, g, radius, flat), (c, f, length, other, bounded) = end, line
    if flat:  # its end is a circle, not a ball
        m = minus(along(c, dot(f, minus(a, c)), f), a)
        m, _ = unit(along(m, -dot(m, g), g))
        a, radius = along(a, radius, m), 0.0
    s = dot(f, minus(a, c))
    foot = along(c, s if bounded else min(max(s, 0.0), length), f)
    m, distance = unit(minus(foot, a))
    middle = times(0.5, along(along(a, radius, m), 1.0, along(foot, -other, m)))
    return m, middle, distance - radius - other, distance, s


@no_alloc
def at_ends(one, two, n, known, tiny, out, at):
    """Contacts of almost parallel segments at both ends of their overlap, into `out` from index `at` on; their number.

    Each end is an end of one of the segments. one and two are (p, q, direction, length, radius, flat) of the segments,
    `flat` as in `end_opposite`; n is as in `segments`, and `known` whether it is used.
    """
    (p1, _, d, length1, radius1, flat1), (p2, q2, e, length2, radius2, flat2) = one, two
    begin, end = dot(d, minus(p2, p1)), dot(d, minus(q2, p1))
    low, high = max(min(begin, end), 0.0), min(max(begin, end), length1)
    if high - low <= tiny:
        return 0
    across, _ = unit(along(n, -dot(n, d), d))
    count = 0
    for s in (low, high):
        if radius1 + radius2 > 0.0:
            sign, b = -1.0, p2 if s == begin else q2
            own, line = (b, e, radius2, flat2), (p1, d, length1, radius1, flat1)
            if s == 0.0 or s == length1:
                sign, own, line = 1.0, (along(p1, s, d), d, radius1, flat1), (p2, e, length2, radius2, flat2)
            m, middle, gap, distance, _ = end_opposite(own, line)
            write(out, at + count, middle, times(sign, m), gap)
            apart = distance > tiny
        else:  # edges that touch lie one above the other, not side by side in almost parallel faces
            a = along(p1, s, d)
            b = along(p2, dot(e, minus(a, p2)), e)
            touch(a, radius1, b, radius2, across, out, at + count)
            gap, away = out.gap[at + count], minus(b, a)
            apart = dot(away, away) <= square(gap) + square(ANGLE * abs(gap) + tiny)
        if apart and (not known or dot(row(out.normal, at + count), n) > 0.5):
            count += 1
    return count


@no_alloc(forceinline=True)
def segments(geometry, i, j, lines, n, out, at):
    """Contacts of two segments with radii, one of each geom, into `out` from index `at` on; returns their number.

    n is the normal found by Coal, which is not used for two round geoms. A segment with flat ends (the side of a
    cylinder) touches with its side only. 0 means that the segments are not the touching features.
    """
    (p1, q1, radius1, _), (p2, q2, radius2, _) = lines
    flat1, flat2 = has_rim(geometry, i), has_rim(geometry, j)
    known = not (is_round(geometry, i) and is_round(geometry, j))
    d, length1 = unit(minus(q1, p1))
    e, length2 = unit(minus(q2, p2))
    common, sine = unit(cross(d, e))
    size = smaller(geometry, i, j)
    rounded, tiny = radius1 + radius2 > 0.0, SAME * size
    s, r = closest(p1, d, length1, p2, e, length2)
    a, b = along(p1, s, d), along(p2, r, e)
    direction, distance = unit(minus(b, a))
    crosses = s > 0.0 and s < length1 and r > 0.0 and r < length2
    if length1 > 0.0 and length2 > 0.0 and sine < PARALLEL:
        one, two = (p1, q1, d, length1, radius1, flat1), (p2, q2, e, length2, radius2, flat2)
        count = at_ends(one, two, n, known, tiny, out, at)
        if count == 2 and rounded and crosses and distance > tiny:
            # Round segments that cross are closer there than at the ends, by half of (tilt · way)² over the radii.
            if distance - radius1 - radius2 < min(out.gap[at], out.gap[at + 1]) - INSIDE * size:
                move(out, at, at + 2)
                touch(a, radius1, b, radius2, n, out, at)
                count = 3
        if count >= 2:
            return count
    if rounded and distance <= tiny:
        # The cores cross: take any separating direction, the common perpendicular if there is one.
        if known:
            return 0
        m = common if sine >= PARALLEL else perpendicular(d if length1 > 0.0 else e)
        write(out, at, a, m, -radius1 - radius2)
        return 1
    m = n
    if crosses:
        m = common if dot(common, n) >= 0.0 else times(-1.0, common)
    elif distance > tiny:
        m = direction
    touch(a, radius1, b, radius2, m, out, at)
    m = row(out.normal, at)
    return 0 if (flat1 and abs(dot(m, d)) > INSIDE) or (flat2 and abs(dot(m, e)) > INSIDE) else 1


@no_alloc
def crossing(geometry, i, j, n, lines, out, at):
    """Contact of the crossing edges of two polytopes that separate them best; False if n separates better.

    The edges are those of the faces around the corners outermost along n. If no edges are found, the contact is written
    at the closest points of the outermost `lines`, or of these corners if the lines are not valid.
    """
    tiny = INSIDE * smaller(geometry, i, j)
    least, a, b = separation(geometry, i, j, n)
    if lines[0][3] and lines[1][3]:
        (p, u, _, _), (q, v, _, _) = lines
        (d, length1), (e, length2) = unit(minus(u, p)), unit(minus(v, q))
        s, r = closest(p, d, length1, q, e, length2)
        a, b = along(p, s, d), along(q, r, e)
    touch(a, 0.0, b, 0.0, n, out, at)
    out.gap[at] = least
    least -= tiny
    found, c1, c2 = False, row(geometry.t, i), row(geometry.t, j)
    own, other = to_local(geometry.R, i, n), to_local(geometry.R, j, times(-1.0, n))
    top1 = deepest_vertex(geometry, i, own) - geometry.vertex_ptr[i]
    top2 = deepest_vertex(geometry, j, other) - geometry.vertex_ptr[j]
    for f in range(geometry.face_ptr[i], geometry.face_ptr[i + 1]):
        if not has_corner(geometry, f, top1):
            continue
        for k in range(geometry.loop_ptr[f], geometry.loop_ptr[f + 1]):
            u, v = side(geometry, i, f, k)
            p = along(c1, 1.0, to_world(geometry.R, i, u))
            d, length1 = unit(to_world(geometry.R, i, minus(v, u)))
            for g in range(geometry.face_ptr[j], geometry.face_ptr[j + 1]):
                if not has_corner(geometry, g, top2):
                    continue
                for l in range(geometry.loop_ptr[g], geometry.loop_ptr[g + 1]):
                    u, v = side(geometry, j, g, l)
                    q = along(c2, 1.0, to_world(geometry.R, j, u))
                    e, length2 = unit(to_world(geometry.R, j, minus(v, u)))
                    m, sine = unit(cross(d, e))
                    if sine < SHARP:
                        continue
                    m = m if dot(m, n) > 0.0 else times(-1.0, m)
                    s, r = closest(p, d, length1, q, e, length2)
                    if s > 0.0 and s < length1 and r > 0.0 and r < length2:
                        value, a, b = separation(geometry, i, j, m)[0], along(p, s, d), along(q, r, e)
                        # Between outermost edges the gap is the separation. This excludes other edges with the same
                        # directions.
                        if value > least and dot(m, minus(b, a)) < value + tiny:
                            least, found = value, True
                            touch(a, 0.0, b, 0.0, m, out, at)
    return found


@no_alloc
def ends(geometry, i, j, n, margin, out, at, count):
    """Further contacts of two segments with radii: their ends opposite the other segment, up to the margin.

    They follow the `count` contacts from index `at` on; ends near one of those are redundant. Returns the new number.
    Corners and edges of polytopes take part, but not with each other: `over_face` finds their contacts.
    """
    size = smaller(geometry, i, j)
    near, angle = min(NEAR * size, margin), min(max(ANGLE, margin / size), WIDE)
    p1, q1, radius1, valid1 = segment(geometry, i, n, angle)
    p2, q2, radius2, valid2 = segment(geometry, j, times(-1.0, n), angle)
    if not (valid1 and valid2) or radius1 + radius2 == 0.0:
        return count
    d, length1 = unit(minus(q1, p1))
    e, length2 = unit(minus(q2, p2))
    if abs(dot(d, e)) < OBLIQUE:
        return count
    flat1, flat2 = has_rim(geometry, i), has_rim(geometry, j)
    one = (d, radius1, flat1), (p2, e, length2, radius2, flat2), length1, 1.0
    two = (e, radius2, flat2), (p1, d, length1, radius1, flat1), length2, -1.0
    for a, lines in ((p1, one), (q1, one), (p2, two), (q2, two)):
        (g, radius, flat), line, opposite, sign = lines
        m, middle, height, _, s = end_opposite((a, g, radius, flat), line)
        if not (s > 0.0 and s < line[2] and opposite > 0.0) or sign * dot(m, n) < 0.5:
            continue
        if not may_meet(geometry, i, j, times(sign, m), out.gap[at], margin):
            continue
        new = height <= margin
        for q in range(count):
            away = minus(middle, row(out.point, at + q))
            new = new and dot(away, away) > near * near
        if new:
            write(out, at + count, middle, times(sign, m), height)
            count += 1
    return count
