"""Reduction of a contact patch to the few points that represent it."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import cross, dot, perpendicular, put, row


@no_alloc
def triangle(x, y, hull, p, q, r):
    """Twice the area of the triangle of three corners of a hull."""
    a, b, c = hull[p], hull[q], hull[r]
    return abs((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))


@no_alloc
def lowest(poly, gap, count, limit, margin, close):
    """Remove the highest points, as long as `limit` points are left, as `reduce` describes; return the number left."""
    least = math.inf
    for k in range(count):
        least = min(least, gap[k])
    height = margin - least
    while height > close:
        height = max(0.5 * height, close)
        left = up_to(poly, gap, count, least + height, limit)
        if left < limit:
            break
        count = left
    return count


@no_alloc
def up_to(poly, gap, count, level, limit):
    """Remove the points above a level if at least `limit` are not; return the number of those that are not."""
    low, kept = 0, 0
    for k in range(count):
        low += gap[k] <= level
    for k in range(count if limit <= low < count else 0):
        if gap[k] <= level:
            put(poly, kept, row(poly, k))
            gap[kept] = gap[k]
            kept += 1
    return low


@kernel
def convex_hull(x, y):
    """Corners of the convex hull of points in a plane, counterclockwise: (their indices, number)."""
    count = x.size
    order = np.empty(count, dtype=np.int64)  # by x, then y
    for k in range(count):
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
        m -= 1  # the last corner of one half is the first of the other
    return hull, m


@kernel
def corners_of_most_area(x, y, hull, m, stays, limit):
    """At most `limit` of m corners, as positions in the hull, that preserve most of its area: (positions, number).

    The points that `stays` marks stay. Those that are no corners count towards the limit.
    """
    kept, corner, free = m, np.arange(m), limit - stays.sum() + stays[hull[:m]].sum()
    while kept > free:
        worst, smallest = -1, math.inf
        for p in range(kept):
            area = triangle(x, y, hull, corner[p - 1 if p > 0 else kept - 1], corner[p], corner[(p + 1) % kept])
            # Areas equal within round-off count as equal, so that the order decides, not noise.
            if not stays[hull[corner[p]]] and area < smallest * (1.0 - 1e-9):
                worst, smallest = p, area
        for p in range(worst, kept - 1):
            corner[p] = corner[p + 1]
        kept -= 1
    for _ in range(10):
        moved = False
        for p in range(kept):
            before, after = corner[p - 1 if p > 0 else kept - 1], corner[(p + 1) % kept]
            if not stays[hull[corner[p]]]:
                best, largest = corner[p], triangle(x, y, hull, before, corner[p], after)
                for step in range(1, (after - before) % m):
                    q = (before + step) % m
                    area = triangle(x, y, hull, before, q, after)
                    # Take the last of equal areas: this spreads the corners of a regular polygon evenly.
                    if area > largest * (1.0 - 1e-9):
                        best, largest = q, max(area, largest)
                moved = moved or best != corner[p]
                corner[p] = best
        if not moved:
            break
    return corner, kept


@kernel
def reduce(poly, gap, count, n, limit, margin, close, same):
    """Keep at most `limit` points: the lowest half, and the corners of the patch that preserve most of its area.

    The patch consists of the points that the motion closes first: from the margin down to `close` above the deepest
    point, the highest points are removed, as long as `limit` points are left. What is almost flat rests on few of them,
    so the lowest half of the limit stays, and what is as low within `same`. If that is more than the limit, it is the
    patch, and what is lower stays. The convex hull of the patch in the plane of n then loses corner after corner, each
    time the one whose triangle with its neighbours is smallest. Then the corners move along the hull as long as the
    area grows. Points on the line between others, as the two ends of an edge on which a prism rolls, add no area but
    may carry: what is left of the limit goes to the deepest. Returns the number left, in their former order.
    """
    count = lowest(poly, gap, count, limit, margin, close)
    if count <= limit:
        return count
    level = np.sort(gap[:count])[(limit - 1) // 2]
    low = up_to(poly, gap, count, level + same, limit)
    if low >= limit:
        count, level = low, level - 2.0 * same
    e1 = perpendicular(n)
    e2 = cross(n, e1)
    x, y = np.empty(count), np.empty(count)
    for k in range(count):
        x[k], y[k] = dot(row(poly, k), e1), dot(row(poly, k), e2)
    keep = gap[:count] <= level + same
    keep[gap[:count].argmin()] = True
    hull, m = convex_hull(x, y)
    corner, left = corners_of_most_area(x, y, hull, m, keep, limit)
    for p in range(left):
        keep[hull[corner[p]]] = True
    while keep.sum() < limit:
        low, least = 0, math.inf
        for k in range(count):
            if not keep[k] and gap[k] < least:
                low, least = k, gap[k]
        keep[low] = True
    kept = 0
    for k in range(count):
        if keep[k]:
            put(poly, kept, row(poly, k))
            gap[kept] = gap[k]
            kept += 1
    return kept
