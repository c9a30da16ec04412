"""Motion of frames between two poses: translation linear in time, rotation about one axis at one rate."""

import math

import numpy as np

from nsdyn._kernels.collision.broadphase import at_least_apart
from nsdyn._kernels.collision.geometry import Placed, place
from nsdyn._kernels.collision.separation import gap_along
from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.sorting import place_of
from nsdyn._kernels.vectors import along, cross, dot, minus, put, row, times, to_local, to_world, unit

HALF_TURN = 3.0
"""Rotation between two poses, rad, beyond which the poses do not determine its direction: slightly less than half a
turn."""


@no_alloc
def turn_between(A, B, f):
    """Rotation vector w, world axes, |w| ≤ π, with ``B[f] = exp([w]x) A[f]``."""
    # Rows of D = B Aᵀ.
    d11, d12, d13 = to_world(A, f, row(B[f], 0))
    d21, d22, d23 = to_world(A, f, row(B[f], 1))
    d31, d32, d33 = to_world(A, f, row(B[f], 2))
    a = (0.5 * (d32 - d23), 0.5 * (d13 - d31), 0.5 * (d21 - d12))
    sine, cosine = math.sqrt(dot(a, a)), 0.5 * (d11 + d22 + d33 - 1.0)
    angle = math.atan2(sine, cosine)
    if cosine > 0.0 or sine > 1e-3:
        return times(angle / sine, a) if sine > 0.0 else a
    # About half a turn: D = cos + (1 - cos) u uᵀ except for the sine term. The column of its largest diagonal element
    # gives u.
    u = (d11 - cosine, 0.5 * (d12 + d21), 0.5 * (d13 + d31))
    if d22 > d11 and d22 >= d33:
        u = (0.5 * (d12 + d21), d22 - cosine, 0.5 * (d23 + d32))
    elif d33 > d11:
        u = (0.5 * (d13 + d31), 0.5 * (d23 + d32), d33 - cosine)
    u, _ = unit(u)
    return times(angle if dot(u, a) >= 0.0 else -angle, u)


@no_alloc
def motions(frame, arm, begin, end, foreseen, turn, reach):
    """Rotation vectors of the frames, into turn (nframes, 3), and bounds on the way of their geoms, into reach.

    The rotations are the shortest ones from the poses `begin` (x, R) of the frames to the poses `end`, except for
    rotations `foreseen` to be longer than `HALF_TURN`; return whether any is. ``arm[g]`` bounds the distance of the
    points of geom g from the origin of its frame.
    """
    (x0, R0), (x1, R1), far = begin, end, False
    reach[:] = 0.0
    for g in range(frame.size):
        if frame[g] >= 0:
            reach[frame[g]] = max(reach[frame[g]], arm[g])
    for f in range(reach.size):
        w = row(foreseen, f)
        if dot(w, w) <= HALF_TURN * HALF_TURN:
            w = turn_between(R0, R1, f)
        else:
            far = True
        put(turn, f, w)
        d = minus(row(x1, f), row(x0, f))
        reach[f] = math.sqrt(dot(d, d)) + math.sqrt(dot(w, w)) * reach[f]
    return far


@no_alloc
def relative_motion(f1, f2, arm1, arm2, x0, x1, turn):
    """Bound on the way of any point of one geom as seen from the other; f1, f2 are their frames, -1 for the world.

    The velocity of a point p of body 2 relative to body 1 is (v - ω1 x d) + ω x (p - x2), with v, ω and d the
    differences of velocities, spins and origins. d is linear in time, so that the first term is largest at an end.
    """
    zero = (0.0, 0.0, 0.0)
    w1, w2 = row(turn, f1) if f1 >= 0 else zero, row(turn, f2) if f2 >= 0 else zero
    a1, b1 = (row(x0, f1), row(x1, f1)) if f1 >= 0 else (zero, zero)
    a2, b2 = (row(x0, f2), row(x1, f2)) if f2 >= 0 else (a1, a1)
    if f1 < 0:
        a1, b1 = a2, a2
    begin, end, w = minus(a2, a1), minus(b2, b1), minus(w2, w1)
    v, spin, least = minus(end, begin), math.sqrt(dot(w, w)), math.inf
    for moving, other, arm in ((f2, w1, arm2), (f1, w2, arm1)):
        if moving >= 0:
            p, q = minus(v, cross(other, begin)), minus(v, cross(other, end))
            least = min(least, math.sqrt(max(dot(p, p), dot(q, q))) + spin * arm)
    return least


@no_alloc
def carried(f, p, x0, R0, x1, R1):
    """Position of the point p fixed in frame f after the frame has moved from its pose 0 to pose 1."""
    if f < 0:
        return p
    return along(row(x1, f), 1.0, to_world(R1, f, to_local(R0, f, minus(p, row(x0, f)))))


@no_alloc
def carry(contacts, begin, end, there):
    """Move contacts whose points are fixed in both bodies from poses to others, where they have the normals `there`.

    Works in place on (names, points, scalars); `begin` and `end` are (x, R) of the frames.
    """
    (names, points, scalars), (x0, R0), (x1, R1) = contacts, begin, end
    for c in range(names.shape[1]):
        p, n, gap = row(points[0], c), row(points[1], c), scalars[0, c]
        a = carried(names[2, c], along(p, -0.5 * gap, n), x0, R0, x1, R1)
        b = carried(names[3, c], along(p, 0.5 * gap, n), x0, R0, x1, R1)
        scalars[0, c] = dot(row(there, c), minus(b, a))
        put(points[0], c, times(0.5, along(a, 1.0, b)))
        put(points[1], c, row(there, c))


@no_alloc
def widest(geometry, names, c, n, R0, R1):
    """Largest separation of the geoms of contact c, and the normal along which it is.

    Three normals are tried: n as it is, and as it turns with frame 1 and with frame 2 from rotations R0 to R1.
    """
    most, out = -math.inf, n
    for f in (-1, names[2, c], names[3, c]):
        there = to_world(R1, f, to_local(R0, f, n)) if f >= 0 else n
        gap = gap_along(geometry, names[0, c], names[1, c], there)
        if gap > most:
            most, out = gap, there
    return most, out


@no_alloc
def turn_normals(fields, contacts, R0, end, room, out, apart):
    """Normals of contacts of poses 0 at poses 1, into out, and the separations of their geoms along them, into apart.

    Both are those of `widest`. `contacts` is (names, points, scalars), `end` has the poses (x, R) of the frames, `room`
    is a work array for the poses (R, t) of the geoms.
    """
    (names, points, _), (x1, R1), (R, t) = contacts, end, room
    place(fields, x1, R1, R, t)
    for c in range(apart.size):
        apart[c], n = widest(Placed(*fields, R, t), names, c, row(points[1], c), R0, R1)
        put(out, c, n)


@no_alloc
def turned(w, s, p):
    """Vector p rotated by exp(s [w]x), Rodrigues' formula."""
    angle = math.sqrt(dot(w, w))
    if angle == 0.0:
        return p
    u = times(1.0 / angle, w)
    c = cross(u, p)
    return along(along(p, math.sin(s * angle), c), 1.0 - math.cos(s * angle), cross(u, c))


@no_alloc
def approach(frame, arm, motion, s, geoms, normal, points):
    """(bound on the approach speed, approach speed) of two geoms at their nearest points, m per way.

    The bound is that of their separation along n: of the rotations, only the part that turns n moves the support points
    along n. `motion` is (x0, x1, turn) of the frames.
    """
    x0, x1, turn = motion
    n = (normal[0], normal[1], normal[2])
    forward, turning, speed = 0.0, 0.0, 0.0
    for k in range(2):
        g, sign, p = geoms[k], 1.0 - 2.0 * k, points[k]
        f = frame[g]
        if f >= 0:
            v, e = minus(row(x1, f), row(x0, f)), cross(n, row(turn, f))
            lever = minus((p[0], p[1], p[2]), along(row(x0, f), s, v))
            forward += sign * dot(n, v)
            turning += math.sqrt(dot(e, e)) * arm[g]
            speed += sign * (dot(n, v) + dot(e, lever))
    i, j = geoms
    whole = relative_motion(frame[i], frame[j], arm[i], arm[j], x0, x1, turn)
    return min(max(forward, 0.0) + turning, whole), speed


@no_alloc
def place_at(fields, room, motion, s, geoms):
    """Place two geoms at the fraction s of the way, in room (R, t).

    `fields` are those of `Geometry`, `motion` is (x0, R0, x1, turn) of the frames.
    """
    geometry, (x0, R0, x1, turn) = Placed(*fields, *room), motion
    for g in geoms:
        f = geometry.frame[g]
        if f < 0:
            continue
        for column in range(3):
            a = (
                geometry.placement_R[g, 0, column],
                geometry.placement_R[g, 1, column],
                geometry.placement_R[g, 2, column],
            )
            a = turned(row(turn, f), s, to_world(R0, f, a))
            geometry.R[g, 0, column], geometry.R[g, 1, column], geometry.R[g, 2, column] = a
        a = turned(row(turn, f), s, to_world(R0, f, row(geometry.placement_t, g)))
        put(geometry.t, g, along(along(a, 1.0 - s, row(x0, f)), s, row(x1, f)))


@no_alloc
def bend(frame, arm, motion, geoms, n, turning):
    """Bound on the deviation of n·p from a linear function at the middle of the way, m: |d²(n·p)/ds²| / 8.

    p is a point of either geom. n and p are seen from the geom `turning` of the two, with which n turns, or from space,
    -1. The second derivative is 0 for points of the geom `turning`. For the other geom, which moves by v and is at most
    D away, while the two turn by w and ω, it is at most |n x w| (|w| (D + |p|) + 2 (|v| + |ω| |p|)) + ω² |p|.
    """
    (x0, x1, turn), zero, total = motion, (0.0, 0.0, 0.0), 0.0
    f = frame[geoms[turning]] if turning >= 0 else -1
    w, begin, end = (row(turn, f), row(x0, f), row(x1, f)) if f >= 0 else (zero, zero, zero)
    tilt, spin = cross(n, w), math.sqrt(dot(w, w))
    for k in range(2):
        g = geoms[k]
        h = frame[g]
        if k == turning or (turning < 0 and h < 0):
            continue
        own, a, b = (row(turn, h), row(x0, h), row(x1, h)) if h >= 0 else (zero, zero, zero)
        a, b = minus(a, begin), minus(b, end)
        v, away, fast = minus(b, a), math.sqrt(max(dot(a, a), dot(b, b))), math.sqrt(dot(own, own))
        seen = spin * (away + arm[g]) + 2.0 * (math.sqrt(dot(v, v)) + fast * arm[g])
        total += math.sqrt(dot(tilt, tilt)) * seen + fast * fast * arm[g]
    return total / 8.0


@no_alloc
def advance(fields, arm, motion, geoms, shown, room):
    """(fraction of the way before which two geoms cannot touch, their approach speed at the fraction s), m per way.

    There are two tests. First, the geoms cannot touch within their distance divided by a bound on their approach speed
    (`approach`). Second, their normal, fixed in space or turning with either geom, separates them in a whole part of
    the way if it does so at both ends of the part, by more than its `bend` times the square of its length. The second
    test covers geoms that separate while they turn.

    Parameters
    ----------
    fields : tuple
        Those of `Geometry`.
    arm : ndarray, shape (geoms,)
        m.
    motion : (x0, R0, x1, turn)
    geoms : (int, int)
    shown : (s, distance, least, n, points)
        At the fraction s, m: the first test uses `least` if it is larger than the distance.
    room : (R, t)
        Poses of all geoms; those of the two geoms at that fraction are overwritten.
    """
    (s, distance, least, n, points), (x0, _, x1, turn), (i, j) = shown, motion, geoms
    geometry, linear = Placed(*fields, *room), (x0, x1, turn)
    bound, speed = approach(geometry.frame, arm, linear, s, geoms, n, points)
    out = s + max(distance, least) / bound if bound * (1.0 - s) > max(distance, 0.0) else 1.0
    gap = gap_along(geometry, i, j, n)
    for turning in range(-1, 2):
        f = geometry.frame[geoms[turning]] if turning >= 0 else -1
        bent, way = bend(geometry.frame, arm, linear, geoms, n, turning), 1.0 - s
        while s + way > out and gap > 0.0:
            place_at(fields, room, motion, s + way, geoms)
            there = turned(row(turn, f), way, n) if f >= 0 else n
            if min(gap, gap_along(geometry, i, j, there)) > bent * way * way:
                out = s + way
                break
            way *= 0.5
    return out, speed


@no_alloc
def swept(frame, arm, g, ends, bounds, axis):
    """Bounds along an axis on the positions of a geom on its way between `ends` of the frames, for any rotation, m."""
    (x0, x1), (lower, upper), f = ends, bounds, frame[g]
    if f < 0:
        return lower[g, axis], upper[g, axis]
    return min(x0[f, axis], x1[f, axis]) - arm[g], max(x0[f, axis], x1[f, axis]) + arm[g]


@no_alloc
def flies_past(frame, arm, i, j, ends, bounds):
    """True if two geoms are apart along a world axis all the way, for any rotation."""
    for axis in range(3):
        low, high = swept(frame, arm, i, ends, bounds, axis)
        least, most = swept(frame, arm, j, ends, bounds, axis)
        if high < least or most < low:
            return True
    return False


@no_alloc
def stays_apart(geometry, arm, i, j, motion, codes, points):
    """True if two geoms cannot touch on their way, by their separation along the normal of a contact between them.

    motion = (x0, x1, turn) as in `motions`; the contacts have sorted codes, and points as in `ContactSet`.
    """
    code = i * geometry.kind.size + j
    c = place_of(codes, code)
    while c < codes.size and codes[c] == code:
        n = row(points[1], c)
        bound, _ = approach(geometry.frame, arm, motion, 0.0, (i, j), n, (n, n))
        if bound <= gap_along(geometry, i, j, n):
            return True
        c += 1
    return False


@kernel
def may_touch(fields, arm, least, pairs, motion, placed, memory, out):
    """Write the indices of candidate pairs that move farther than their distance into out; return their number.

    Left out are pairs whose relative motion is no longer than the smaller of their two `least`, and pairs that cannot
    touch by `flies_past` or, with the contacts in `memory`, by `stays_apart`.
    `fields` are those of `Geometry`, `pairs` is (first, second), `motion` is (x0, x1, turn) as in `motions`,
    `placed` is (R, t, lower, upper), poses and bounds of the geoms at the beginning.
    """
    (first, second), (x0, x1, turn), (R, t, lower, upper) = pairs, motion, placed
    geometry, (names, points), count = Placed(*fields, R, t), memory, 0
    codes = np.empty(names.shape[1], np.int64)
    for c in range(codes.size):
        codes[c] = names[0, c] * geometry.kind.size + names[1, c]
    for p in range(first.size):
        i, j = first[p], second[p]
        way = relative_motion(geometry.frame[i], geometry.frame[j], arm[i], arm[j], x0, x1, turn)
        if way > min(least[i], least[j]) and way > at_least_apart(geometry, i, j, lower, upper):
            if flies_past(geometry.frame, arm, i, j, (x0, x1), (lower, upper)):
                continue
            if not stays_apart(geometry, arm, i, j, motion, codes, points):
                out[count] = p
                count += 1
    return count
