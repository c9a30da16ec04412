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
   interior of a face has to stay above it: these contacts forbid nothing that is possible. But what is over the border
   of the face, or so near that it may move there, meets an edge, along the normal of 2., and that is the way out for
   what is below the face already. Bodies that overlap leave that way: what is above the face rises with them.

Vectors are tuples of three floats: they live in registers. The geoms are `Placed`, contacts go into `out`, a `Found`,
from index `at` on.
"""

import math
from typing import NamedTuple

from nsdyn._kernels.collision.clipping import Room, merge, on_border, over_face
from nsdyn._kernels.collision.curved import smooth
from nsdyn._kernels.collision.faces import best_normal, reference_face
from nsdyn._kernels.collision.geometry import Found, Placed, smaller
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
from nsdyn._kernels.collision.separation import SAME, SHARP, separation
from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import along, dot, minus, put, row, square, times, to_local, to_world, unit

SWEPT = 0.5
"""Of the radius of a round geom: to Coal it is its axis, from which the normal is, as long as that is outside."""


class Given(NamedTuple):
    """What is known of a pair: the normal of its cores, and lengths in m.

    The normal is to be relied on if it is `trusted`. The surfaces are no more than `slack` from those of the cores.
    Gaps up to `margin` are of interest, at rest up to `base`.
    """

    n: tuple
    trusted: bool
    slack: float
    base: float
    margin: float


@no_alloc(forceinline=True)
def apart(geometry, i, j, margin):
    """Whether the bounding spheres (or a sphere and a half-space) are farther apart than margin."""
    d = minus(row(geometry.t, j), row(geometry.t, i))
    for h, g, sign in ((i, j, 1.0), (j, i, -1.0)):
        if geometry.kind[h] == HALFSPACE:
            height = sign * dot(to_world(geometry.R, h, row(geometry.size, h)), d) - geometry.offset[h]
            return height - geometry.radius[g] > margin
    reach = geometry.radius[i] + geometry.radius[j] + margin
    return dot(d, d) > reach * reach


@no_alloc
def of_features(geometry, i, j, n, face, margin, out, at):
    """Contacts of the edges, corners and curved surfaces that are outermost along n; returns their number.

    The first one has the least gap. Ends of round segments that the margin holds follow. `face` as of `beside`: where n
    is its normal features are seen more sharply.
    """
    count = closest_features(geometry, i, j, n, face, out, at)
    if has_ends(geometry, i) or has_ends(geometry, j):
        count = ends(geometry, i, j, row(out.normal, at), margin, out, at, count)
    return count


@no_alloc
def closest_features(geometry, i, j, n, face, out, at):
    """Contacts of the features that are outermost along n, where they are closest; returns their number.

    It is 0 if no edges of two polytopes separate as well as n does.
    """
    angle = SHARP if face >= 0 else ANGLE
    lines = edge(geometry, i, n, angle), edge(geometry, j, times(-1.0, n), angle)
    if lines[0][3] and lines[1][3]:
        count = segments(geometry, i, j, lines, n, out, at)
        if count == 2 or (is_round(geometry, i) and is_round(geometry, j)):
            return count
        if count == 1:
            # The distance is the largest separation: the right features reach it.
            own, _, _ = separation(geometry, i, j, row(out.normal, at))
            given, _, _ = separation(geometry, i, j, n)
            same = SAME * smaller(geometry, i, j)
            if own > given - same and abs(own - out.gap[at]) < same:
                return 1
    if geometry.kind[i] == POLYTOPE and geometry.kind[j] == POLYTOPE:
        return 1 if crossing(geometry, i, j, n, lines, out, at) else 0
    if geometry.kind[i] == POLYTOPE and is_round(geometry, j):
        return beside(geometry, i, j, i, n, face, out, at)
    if geometry.kind[j] == POLYTOPE and is_round(geometry, i):
        return beside(geometry, i, j, j, n, face, out, at)
    smooth(geometry, i, j, n, lines, out, at)
    if lines[0][3] and lines[1][3] and has_rim(geometry, i) and has_rim(geometry, j):
        # The rim of either may touch the side of the other.
        (p1, q1, radius1, _), (p2, q2, radius2, _) = lines
        for rim in range(2):
            smooth(geometry, i, j, n, ((p1, q1, radius1, rim == 1), (p2, q2, radius2, rim == 0)), out, at + 1)
            if out.gap[at + 1] > out.gap[at]:
                put(out.point, at, row(out.point, at + 1))
                put(out.normal, at, row(out.normal, at + 1))
                out.gap[at] = out.gap[at + 1]
    return 1


@no_alloc
def beside(geometry, i, j, g, n, face, out, at):
    """Contacts of a round geom and the edge of polytope g that is closest to it; returns their number.

    Edges are those of a face, a row of its own, or if that is -1 of all faces around the corner outermost along n.
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
    return segments(geometry, i, j, lines, n, out, at)


@no_alloc
def begin(geometry, i, j, given, out, at):
    """Contacts of features where no face separates best: (their number, whether so, n, the reference of each geom)."""
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    n, face1, face2 = given.n, 0 if kind1 == HALFSPACE else -1, 0 if kind2 == HALFSPACE else -1
    if face1 == 0 or face2 == 0:
        return 0, False, n, face1, face2
    known = not (is_round(geometry, i) and is_round(geometry, j))
    if known:
        if not given.trusted:  # cores that overlap give no reliable normal
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
        # What is deepest is not over the face.
        if lowest > separation(geometry, i, j, m)[0] + SAME * smaller(geometry, i, j):
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
    count = merge(room.points, room.heights, count, SAME * smaller(geometry, i, j))
    if count > room.limit - first:
        count = reduce(room.points, room.heights, count, m, room.limit - first, margin, given.base)
    for k in range(count):
        p, height, n = row(room.points, k), room.heights[k], m
        if first > 0 and (height < 0.0 or on_border(geometry, g, face, p, near)):
            n = row(out.normal, at)
            height = min(height, height * dot(n, m))
        elif overlap < 0.0:
            height -= overlap * dot(row(out.normal, at), m)
        put(out.point, at + first + k, p)
        put(out.normal, at + first + k, n)
        out.gap[at + first + k] = height
    return first + count


@no_alloc
def new(room, count, first, near, out, at):
    """Of the points over a face those that the `first` contacts of features do not stand for; returns their number.

    No point is deeper than the bodies overlap: that is along the normal of the features.
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
    """How deep geom g may be in another for the normal of the cores to be relied on, m."""
    return SWEPT * geometry.size[g, 0] if is_round(geometry, g) else 0.0


@no_alloc(forceinline=True)
def ball_contact(geometry, i, j, out, at):
    """What `pair_contacts` gives of two balls, or of one and a half-space, without a look at features; else False."""
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    radius1, radius2, a, b = geometry.size[i, 0], geometry.size[j, 0], row(geometry.t, i), row(geometry.t, j)
    if kind1 == SPHERE and kind2 == SPHERE:
        d = minus(b, a)
        if dot(d, d) <= square(SAME * min(radius1, radius2)):
            return False
        touch(a, radius1, b, radius2, d, out, at)
        return True
    if kind1 == HALFSPACE and kind2 == SPHERE:
        c, radius, h, sign = b, radius2, i, 1.0
    elif kind1 == SPHERE and kind2 == HALFSPACE:
        c, radius, h, sign = a, radius1, j, -1.0
    else:
        return False
    n = to_world(geometry.R, h, row(geometry.size, h))
    out.gap[at] = dot(n, minus(c, row(geometry.t, h))) - geometry.offset[h] - radius
    put(out.point, at, along(c, -radius, n))
    put(out.normal, at, times(sign, n))
    return True


@no_alloc
def manifolds(geoms, pairs, room, found):
    """Contacts of all candidate pairs; returns their number. The arguments are plain tuples.

    Parameters
    ----------
    geoms : tuple
        Fields of `Geometry`, R, t, reach and slack: how far a point of a geom may still move, and its surface is from
        that of its core.
    pairs : tuple
        first, second, slot, coal and base: ``coal[slot[p]]`` is the distance and normal of the cores of pair p, where
        slot[p] ≥ 0; ``base[p]`` plus the reach of both geoms is the largest gap of interest.
    room : tuple
        Of `Room`.
    found : tuple
        point, normal, gap and pair, with room for `room.limit` contacts per pair.
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
        elif apart(geometry, i, j, margin):
            continue
        if not known and ball_contact(geometry, i, j, out, total):
            count = 1
        else:
            given = Given(n, trusted, both, base[p], margin)
            count = pair_contacts(geometry, i, j, given, scratch, out, total)
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
