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

Vectors are tuples of three floats: they live in registers. R (n, 3, 3) and t (n, 3) are the poses of all geoms.
"""

import math

from nsdyn._kernels.collision.clipping import merge, on_border, over_face
from nsdyn._kernels.collision.curved import smooth
from nsdyn._kernels.collision.faces import best_normal, reference_face
from nsdyn._kernels.collision.geometry import CAPSULE, CYLINDER, HALFSPACE, SPHERE, Geometry
from nsdyn._kernels.collision.reduction import reduce
from nsdyn._kernels.collision.segments import edge, ends, segments, touch
from nsdyn._kernels.collision.support import SAME, SHARP, separation
from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.vectors import along, dot, minus, put, row, times, to_world, unit

ANGLE = 2e-4  # rad; a face whose normal is this close to the one Coal found (good to 1e-5) is what it found
WIDE = 1.0  # |difference| of the normals of tilted bodies and of a face that may still hold points of interest
RESCUE = 1e-5  # a face is preferred to what Coal found if it separates better by this fraction of the size
NEAR = 1e-2  # a point within the margin, and this fraction of the size, of one found more exactly adds nothing


@in_place(forceinline=True)
def apart(geometry, i, j, R, t, margin):
    """Whether the bounding spheres (or a sphere and a half-space) are farther apart than margin."""
    d = minus(row(t, j), row(t, i))
    for h, g, sign in ((i, j, 1.0), (j, i, -1.0)):
        if geometry.kind[h] == HALFSPACE:
            height = sign * dot(to_world(R, h, row(geometry.size, h)), d) - geometry.offset[h]
            return height - geometry.radius[g] > margin
    reach = geometry.radius[i] + geometry.radius[j] + margin
    return dot(d, d) > reach * reach


@in_place
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


@in_place
def closest_features(geometry, i, j, R, t, known, n, angle, point, normal, gap, at):
    """Contacts of the features that are outermost along n, where they are closest; returns their number."""
    size = min(geometry.radius[i], geometry.radius[j])
    flat1, flat2 = geometry.kind[i] == CYLINDER, geometry.kind[j] == CYLINDER
    p1, q1, radius1, valid1 = edge(geometry, i, R, t, n, angle)
    p2, q2, radius2, valid2 = edge(geometry, j, R, t, times(-1.0, n), angle)
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


@in_place
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
    overlap = min(deepest, 0.0) if first > 0 else 0.0
    if first > 0:
        kept = 0
        for k in range(count):
            new = heights[k] >= 0.0 or deepest < 0.0
            for c in range(first):
                d = minus(row(points, k), row(point, at + c))
                new = new and dot(d, d) > near * near
            if new:
                put(points, kept, row(points, k))
                # No point is deeper than the bodies overlap: that is along the normal of the features.
                heights[kept] = max(heights[k], overlap)
                kept += 1
        count = kept
    count = merge(points, heights, count, SAME * size)
    if count > limit - first:
        count = reduce(points, heights, count, m, limit - first, margin, base)
    g, face = (i, face1) if face1 >= 0 else (j, face2)
    for k in range(count):
        p, height, n = row(points, k), heights[k], m
        if first > 0 and (height < 0.0 or on_border(geometry, g, face, R, t, p, near)):
            n = row(normal, at)
            height = min(height, height * dot(n, m))
        elif overlap < 0.0:
            height -= overlap * dot(row(normal, at), m)
        put(point, at + first + k, p)
        put(normal, at + first + k, n)
        gap[at + first + k] = height
    return first + count


@in_place(forceinline=True)
def ball_contact(geometry, i, j, R, t, point, normal, gap, at):
    """What `pair_contacts` gives of two balls, or of one and a half-space, without a look at features; else False."""
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    radius1, radius2, a, b = geometry.size[i, 0], geometry.size[j, 0], row(t, i), row(t, j)
    if kind1 == SPHERE and kind2 == SPHERE:
        d = minus(b, a)
        if dot(d, d) <= (SAME * min(radius1, radius2)) ** 2:
            return False
        touch(a, radius1, b, radius2, d, point, normal, gap, at)
        return True
    if kind1 == HALFSPACE and kind2 == SPHERE:
        c, radius, h, sign = b, radius2, i, 1.0
    elif kind1 == SPHERE and kind2 == HALFSPACE:
        c, radius, h, sign = a, radius1, j, -1.0
    else:
        return False
    n = to_world(R, h, row(geometry.size, h))
    gap[at] = dot(n, minus(c, row(t, h))) - geometry.offset[h] - radius
    put(point, at, along(c, -radius, n))
    put(normal, at, times(sign, n))
    return True


@in_place
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
        if not known and ball_contact(geometry, i, j, R, t, point, normal, gap, total):
            count = 1
        else:
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
