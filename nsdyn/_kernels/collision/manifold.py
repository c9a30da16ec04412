"""Contact manifold of a pair: Coal tells which features touch, and their contact points are computed here.

With n the unit normal from geom 1 to geom 2 that separates the pair best, and a margin that the motion may close:

1. A face of one geom whose normal is n within `ANGLE` (half-space, polytope face, cylinder cap) is the *reference*. Its
   normal is the contact normal. The *incident* features of the other geom, clipped to the face, give the points, each
   with its own gap over the plane, up to the margin.
2. If no such face holds the deepest point, the features themselves touch. Two segments (polytope edge or corner,
   sphere, capsule, side of a cylinder: a segment with a radius) touch at their closest points, parallel ones at both
   ends of their overlap, and where they cross. Ellipsoids and rims of cylinders touch at one point, where Newton's
   method makes the separation largest.
3. Tilted bodies can come into contact elsewhere too. Beside the contact of 2. there are contacts at the ends of round
   segments, and at points over the face whose normal is closest to n. While the bodies are apart, points over the
   interior of a face must stay above it: their contacts forbid no possible motion. But a point over the border of the
   face, or so near that it may move there, meets an edge. Its contact has the normal of 2. A point below the face
   already separates along that normal too. Penetrating bodies separate along it; points above the face then rise with
   them, and their gaps include the rise.

Vectors are tuples of three floats, which the compiler keeps in registers. The geoms are `Placed`, contacts are written
into `out`, a `Found`, from index `at` on.
"""

import math
from typing import NamedTuple

from nsdyn._kernels.collision.clipping import Room, merge, on_border, over_face
from nsdyn._kernels.collision.curved import smooth
from nsdyn._kernels.collision.faces import best_normal, reference_face
from nsdyn._kernels.collision.geometry import Found, Placed, move, smaller, write
from nsdyn._kernels.collision.keys import CLOSED
from nsdyn._kernels.collision.kinds import (
    HALFSPACE,
    POLYTOPE,
    SPHERE,
    deepest_vertex,
    has_corner,
    has_ends,
    has_rim,
    is_round,
    segment,
    side,
)
from nsdyn._kernels.collision.reduction import reduce
from nsdyn._kernels.collision.segments import ANGLE, NEAR, WIDE, closest, crossing, edge, ends, segments, touch
from nsdyn._kernels.collision.separation import INSIDE, SAME, SHARP, bounds_apart, may_meet, separation
from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import along, dot, minus, put, row, square, times, to_local, to_world, unit

SWEPT = 0.5
"""Fraction of the radius of a round geom, see `swept`. To Coal such a geom is its axis, and the normal computed from
the axis is reliable as long as the axis is outside the other geom."""


class Given(NamedTuple):
    """Data of a pair: the normal of its cores, and lengths in m.

    The normal is reliable if it is `trusted`. The surfaces are no more than `slack` from those of the cores. Gaps up to
    `margin` are of interest, at rest up to `base`.
    """

    n: tuple
    trusted: bool
    slack: float
    base: float
    margin: float


@no_alloc
def of_features(geometry, i, j, n, face, margin, out, at):
    """Contacts of the edges, corners and curved surfaces that are outermost along n; returns their number.

    The first contact has the least gap, but for the two ends of almost parallel segments. Contacts at ends of round
    segments within the margin follow. `face` is as in `beside`: if n is its normal, features are selected with a
    smaller angle.
    """
    count = closest_features(geometry, i, j, n, face, out, at)
    if has_ends(geometry, i) or has_ends(geometry, j):
        count = ends(geometry, i, j, row(out.normal, at), margin, out, at, count)
    return count


@no_alloc
def closest_features(geometry, i, j, n, face, out, at):
    """Contacts at the closest points of the features that are outermost along n; returns their number.

    The number is 0 if no edges of two polytopes separate them as well as n does.
    """
    angle = SHARP if face >= 0 else ANGLE
    lines = edge(geometry, i, n, angle), edge(geometry, j, times(-1.0, n), angle)
    if lines[0][3] and lines[1][3]:
        count = segments(geometry, i, j, lines, n, out, at)
        if count >= 2 or (is_round(geometry, i) and is_round(geometry, j)):
            return count
        if count == 1:
            # The distance is the largest separation: the touching features attain it.
            own, _, _ = separation(geometry, i, j, row(out.normal, at))
            given, _, _ = separation(geometry, i, j, n)
            same = SAME * smaller(geometry, i, j)
            if own > given - same and abs(own - out.gap[at]) < same:
                return 1
    if geometry.kind[i] == POLYTOPE and geometry.kind[j] == POLYTOPE:
        return 1 if crossing(geometry, i, j, n, lines, out, at) else 0
    for g, h, line in ((i, j, lines[1][3]), (j, i, lines[0][3])):
        if geometry.kind[g] == POLYTOPE and line:
            count = beside(geometry, i, j, g, n, face, out, at)
            if count > 0 or is_round(geometry, h):
                return count
    smooth(geometry, i, j, n, lines, out, at)
    if lines[0][3] and lines[1][3] and has_rim(geometry, i) and has_rim(geometry, j):
        # The rim of either may touch the side of the other.
        (p1, q1, radius1, _), (p2, q2, radius2, _) = lines
        for rim in range(2):
            smooth(geometry, i, j, n, ((p1, q1, radius1, rim == 1), (p2, q2, radius2, rim == 0)), out, at + 1)
            if out.gap[at + 1] > out.gap[at]:
                move(out, at + 1, at)
    return 1


@no_alloc
def beside(geometry, i, j, g, n, face, out, at):
    """Contacts of the line of a geom and the edge of polytope g that is closest to it; returns their number.

    The line is that of a round geom or of the side of a cylinder. The edges are those of the given face, counted within
    g. If `face` is -1, they are those of all faces around the corner outermost along n.
    """
    out_of = n if g == i else times(-1.0, n)
    q, end, radius, _ = segment(geometry, i + j - g, times(-1.0, out_of), ANGLE)
    e, length2 = unit(minus(end, q))
    round_line, best, least = (q, end, radius, True), (q, end, 0.0, True), math.inf
    c, top = row(geometry.t, g), deepest_vertex(geometry, g, to_local(geometry.R, g, out_of)) - geometry.vertex_ptr[g]
    for f in range(geometry.face_ptr[g], geometry.face_ptr[g + 1]):
        if f != geometry.face_ptr[g] + face if face >= 0 else not has_corner(geometry, f, top):
            continue
        for k in range(geometry.loop_ptr[f], geometry.loop_ptr[f + 1]):
            u, v = side(geometry, g, f, k)
            p, tip = along(c, 1.0, to_world(geometry.R, g, u)), along(c, 1.0, to_world(geometry.R, g, v))
            d, length1 = unit(minus(tip, p))
            s, r = closest(p, d, length1, q, e, length2)
            away = minus(along(q, r, e), along(p, s, d))
            if dot(away, away) < least:
                least, best = dot(away, away), (p, tip, 0.0, True)
    lines = (best, round_line) if g == i else (round_line, best)
    count = segments(geometry, i, j, lines, n, out, at)
    m, inward = row(out.normal, at), times(-1.0, row(out.normal, at))
    if separation(geometry, i, j, m)[0] < out.gap[at] - SAME * smaller(geometry, i, j):
        # The axis is inside the polytope, past this edge: the distance of both is a penetration.
        own, given = separation(geometry, i, j, inward)[0], separation(geometry, i, j, n)[0]
        put(out.normal, at, inward if own > given else n)
        out.gap[at] = max(own, given)
    return count


@no_alloc
def begin(geometry, i, j, given, out, at):
    """Contacts of features, if no face separates best: (their number, True if so, n, reference face of each geom)."""
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    n, face1, face2 = given.n, 0 if kind1 == HALFSPACE else -1, 0 if kind2 == HALFSPACE else -1
    if face1 == 0 or face2 == 0:
        return 0, False, n, face1, face2
    known = not (is_round(geometry, i) and is_round(geometry, j))
    if known:
        if not given.trusted:  # overlapping cores give no reliable normal
            n = best_normal(geometry, i, j, n)
        face1, face2 = reference_face(geometry, i, j, n, ANGLE)
        if face1 >= 0 or face2 >= 0:
            return 0, False, n, face1, face2
    first = max(1, of_features(geometry, i, j, n, -1, given.margin, out, at))
    exact = row(out.normal, at)
    if known and given.trusted and out.gap[at] <= given.slack:
        # Rounding off a sliver of contact beside an edge turns the normal: a face may separate better.
        best = best_normal(geometry, i, j, exact)
        if best != exact:
            n = best
            face1, face2 = reference_face(geometry, i, j, n, ANGLE)
            if face1 >= 0 or face2 >= 0:
                return 0, False, n, face1, face2
    if kind1 != SPHERE and kind2 != SPHERE and out.gap[at] <= given.margin:
        face1, face2 = reference_face(geometry, i, j, exact, WIDE)
    return first, True, n, face1, face2


@no_alloc
def pair_contacts(geometry, i, j, given, room, out, at):
    """Contacts of one pair; returns their number."""
    first, tilted, n, face1, face2 = begin(geometry, i, j, given, out, at)
    count, m, margin = 0, n, given.margin
    if face1 >= 0 or face2 >= 0:
        count, m = over_face(geometry, i, j, margin, face1, face2, room)
    if not (tilted or geometry.kind[i] == HALFSPACE or geometry.kind[j] == HALFSPACE):
        lowest = math.inf
        for k in range(count):
            lowest = min(lowest, room.heights[k])
        # The deepest point is not over the face, or between the points that stand for a circle over a circle.
        close = INSIDE if has_rim(geometry, i) and has_rim(geometry, j) else SAME
        if lowest > separation(geometry, i, j, m)[0] + close * smaller(geometry, i, j):
            first = of_features(geometry, i, j, n, max(face1, face2), margin, out, at)
            if first == 0:  # another face separates better
                face1, face2 = reference_face(geometry, i, j, best_normal(geometry, i, j, m), WIDE)
                count, m = over_face(geometry, i, j, margin, face1, face2, room)
    g, face = (i, face1) if face1 >= 0 else (j, face2)
    near = min(NEAR * smaller(geometry, i, j), margin)
    deepest = out.gap[at] if first > 0 else math.inf
    overlap = min(deepest, 0.0)
    if first > 0:
        count = new(room, count, first, near, out, at)
    size = smaller(geometry, i, j)
    count = merge(room.points, room.heights, count, SAME * size)
    if count > room.limit - first:
        count = reduce(room.points, room.heights, count, m, room.limit - first, margin, given.base, CLOSED * size)
    reached, total = not tilted or count == 0 or may_meet(geometry, i, j, m, deepest, margin), first
    for k in range(count):
        p, height, n = row(room.points, k), room.heights[k], m
        if first > 0 and (height < 0.0 or on_border(geometry, g, face, p, near)):
            n = row(out.normal, at)
            height = min(height, height * dot(n, m))
        elif not reached:
            continue
        elif overlap < 0.0:
            height -= overlap * dot(row(out.normal, at), m)
        write(out, at + total, p, n, height)
        total += 1
    return total


@no_alloc
def new(room, count, first, near, out, at):
    """Keep the points over a face that are not near one of the `first` contacts of features; return their number.

    No point gets deeper than the penetration of the bodies, which is measured along the normal of the features.
    """
    kept, deepest = 0, out.gap[at]
    for k in range(count):
        more = room.heights[k] >= 0.0 or deepest < 0.0
        for c in range(first):
            d = minus(row(room.points, k), row(out.point, at + c))
            more = more and dot(d, d) > near * near
        if more:
            put(room.points, kept, row(room.points, k))
            room.heights[kept] = max(room.heights[k], min(deepest, 0.0))
            kept += 1
    return kept


@no_alloc
def swept(geometry, g):
    """Largest penetration of geom g into another at which the normal of the cores is reliable, m."""
    return SWEPT * geometry.size[g, 0] if is_round(geometry, g) else 0.0


@no_alloc(forceinline=True)
def ball_contact(geometry, i, j, out, at):
    """Write the contact of two balls, or of a ball and a half-space, as `pair_contacts` would; else return False."""
    if geometry.kind[i] == SPHERE and geometry.kind[j] == SPHERE:
        a, b = row(geometry.t, i), row(geometry.t, j)
        d = minus(b, a)
        if dot(d, d) <= square(SAME * smaller(geometry, i, j)):
            return False
        touch(a, geometry.size[i, 0], b, geometry.size[j, 0], d, out, at)
        return True
    for h, g, sign in ((i, j, 1.0), (j, i, -1.0)):
        if geometry.kind[h] == HALFSPACE and geometry.kind[g] == SPHERE:
            n, c, radius = to_world(geometry.R, h, row(geometry.size, h)), row(geometry.t, g), geometry.size[g, 0]
            gap = dot(n, minus(c, row(geometry.t, h))) - geometry.offset[h] - radius
            write(out, at, along(c, -radius, n), times(sign, n), gap)
            return True
    return False


@no_alloc
def manifolds(geoms, pairs, room, found):
    """Contacts of all candidate pairs; returns their number. The arguments are plain tuples.

    geoms = (fields of `Geometry`, R, t, reach, slack): the way that a point of a geom may still move, and the distance
    of its surface from that of its core. pairs = (first, second, slot, coal, base): ``coal[slot[p]]`` has the distance
    and normal of the cores of pair p, where slot[p] ≥ 0; ``base[p]`` plus the reach of both geoms is the largest gap of
    interest. found = (point, normal, gap, pair) has room for `room.limit` contacts per pair; `room` is that of `Room`.
    """
    fields, R, t, reach, slack = geoms
    first, second, slot, coal, base = pairs
    point, normal, gap, pair = found
    geometry, scratch, out = Placed(*fields, R, t), Room(*room), Found(point, normal, gap)
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
            trusted = coal[k, 0] > -swept(geometry, i) - swept(geometry, j)
            n = direction if length > 0.5 and length < 2.0 else n
        elif bounds_apart(geometry, i, j) > margin:
            continue
        if not known and ball_contact(geometry, i, j, out, total):
            count = 1
        else:
            given = Given(n, trusted, both, base[p], margin)
            count = pair_contacts(geometry, i, j, given, scratch, out, total)
        kept = total
        for k in range(total, total + count):
            if gap[k] <= margin:
                move(out, k, kept)
                pair[kept] = p
                kept += 1
        total = kept
    return total
