"""Contact points of a pair from its features: which of them touch is known (from Coal), where is computed here.

With n the unit normal from geom 1 to geom 2 that separates the pair best, in this order:

1. A face of one geom whose normal is about n (half-space, polytope face, cylinder cap) is the *reference*: its normal
   is the contact normal, and the *incident* feature of the other geom, clipped to the face, gives the points, each
   with its own gap over the plane. It is what touches if the smallest gap is the distance that Coal found; the
   direction alone would not tell, since Coal's normal is noise where the distance is 0.
2. Two segments (polytope edge or corner, sphere, capsule, side of a cylinder: a segment with a radius) touch in their
   closest points, parallel ones at both ends of their overlap.
3. Anything else touches in the one point that Coal found.
"""

import math

import numpy as np
from numba import njit

from nsdyn._kernels.broadphase import CAPSULE, CYLINDER, ELLIPSOID, HALFSPACE, POLYTOPE, SPHERE

ANGLE = 2e-3  # rad; Coal's normal is off by up to 5e-4 near gap 0, and a face within this of it is what it found
FACE = 0.05  # rad; how far Coal's normal may be off where it is noise; the distance decides
AGREE = 1e-5  # features whose gap is the distance found, within this fraction of the size, are those that touch
BIAS = 1e-3  # a face of geom 2 is the reference only if it fits better than that of geom 1 by this much
PARALLEL = 1e-3  # sine of the angle below which two segments count as parallel
RESCUE = 1e-5  # a face is preferred to what Coal found if it separates better by this fraction of the size
SAME = 1e-6  # points closer than this fraction of the size are one
INSIDE = 1e-9  # a point this fraction of the size outside a side plane is on it


@njit(cache=True)
def dot(a, b):
    """Scalar product of two vectors of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def to_world(R, v, out):
    """out = R v."""
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


@njit(cache=True)
def to_local(R, v, out):
    """out = Rᵀ v."""
    for i in range(3):
        out[i] = R[0, i] * v[0] + R[1, i] * v[1] + R[2, i] * v[2]


@njit(cache=True)
def normalise(v):
    """Scale v to length 1 in place; returns its former length, and leaves v alone when that is 0 or not finite."""
    length = math.sqrt(dot(v, v))
    if length > 0.0 and length < math.inf:
        for i in range(3):
            v[i] /= length
    return length


@njit(cache=True)
def any_perpendicular(d, out):
    """A unit vector perpendicular to the unit vector d, the same for the same d; z when d is 0."""
    k = 0
    for i in range(1, 3):
        if abs(d[i]) < abs(d[k]):
            k = i
    if dot(d, d) == 0.0:
        out[0], out[1], out[2] = 0.0, 0.0, 1.0
        return
    for i in range(3):
        out[i] = (1.0 if i == k else 0.0) - d[k] * d[i]
    normalise(out)


@njit(cache=True)
def aligned_face(geometry, g, R, n, local):
    """The face of geom g whose outward normal is closest to n, and |difference|; (-1, inf) beyond `FACE`.

    Faces of a polytope count from face_ptr[g]; those of a cylinder are 0 (+z) and 1 (-z).
    """
    to_local(R, n, local)
    best, face = FACE * FACE, -1
    if geometry.kind[g] == POLYTOPE:
        for f in range(geometry.face_ptr[g], geometry.face_ptr[g + 1]):
            m = geometry.face_normals[f]
            e = (m[0] - local[0]) ** 2 + (m[1] - local[1]) ** 2 + (m[2] - local[2]) ** 2
            if e < best:
                best, face = e, f
    elif geometry.kind[g] == CYLINDER:
        e = local[0] ** 2 + local[1] ** 2 + (abs(local[2]) - 1.0) ** 2
        if e < best:
            best, face = e, 0 if local[2] > 0.0 else 1
    return face, math.sqrt(best) if face >= 0 else math.inf


@njit(cache=True)
def deepest_vertex(geometry, g, local):
    """Vertex of polytope g farthest along `local` (shape frame), counted from its first."""
    best, k = -math.inf, 0
    for i in range(geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]):
        h = dot(geometry.vertices[i], local)
        if h > best:
            best, k = h, i
    return k - geometry.vertex_ptr[g]


@njit(cache=True)
def support(geometry, g, R, t, n, local, out):
    """A point of geom g outermost along n, into out."""
    kind, a, h = geometry.kind[g], geometry.size[g, 0], geometry.size[g, 1]
    to_local(R, n, local)
    if kind == POLYTOPE:
        k = geometry.vertex_ptr[g] + deepest_vertex(geometry, g, local)
        to_world(R, geometry.vertices[k], out)
    elif kind == ELLIPSOID:
        s = geometry.size[g]
        length = math.sqrt((s[0] * local[0]) ** 2 + (s[1] * local[1]) ** 2 + (s[2] * local[2]) ** 2)
        for i in range(3):
            local[i] *= s[i] * s[i] / length
        to_world(R, local, out)
    elif kind == CYLINDER:
        side = math.sqrt(local[0] ** 2 + local[1] ** 2)
        c, s_ = (local[0] / side, local[1] / side) if side > 0.0 else (1.0, 0.0)
        local[0], local[1], local[2] = a * c, a * s_, math.copysign(h, local[2])
        to_world(R, local, out)
    else:
        z = math.copysign(h, local[2]) if kind == CAPSULE else 0.0
        for i in range(3):
            out[i] = a * n[i] + z * R[i, 2]
    for i in range(3):
        out[i] += t[i]


@njit(cache=True)
def separation(geometry, i, j, R, t, n, work):
    """Gap of geoms i and j along n, the width of the slab of normal n between them (negative: its overlap).

    The signed distance is the largest value over all n, so that any n bounds it from below.
    """
    local, back, p, q = work[0], work[1], work[2], work[3]
    for k in range(3):
        back[k] = -n[k]
    support(geometry, i, R[i], t[i], n, local, p)
    support(geometry, j, R[j], t[j], back, local, q)
    return n[0] * (q[0] - p[0]) + n[1] * (q[1] - p[1]) + n[2] * (q[2] - p[2])


@njit(cache=True)
def best_normal(geometry, i, j, R, t, n, gain, trial, work):
    """Turn n to the face normal or line of centres that separates best, if by more than `gain`."""
    best = separation(geometry, i, j, R, t, n, work) + gain
    for k in range(3):
        trial[k] = t[j, k] - t[i, k]
    if normalise(trial) > 0.0:
        gap = separation(geometry, i, j, R, t, trial, work)
        if gap > best:
            best = gap
            n[:] = trial
    for g, sign in ((i, 1.0), (j, -1.0)):
        caps = 2 if geometry.kind[g] == CYLINDER else 0
        for f in range(geometry.face_ptr[g + 1] - geometry.face_ptr[g] + caps):
            if caps:
                for k in range(3):
                    trial[k] = R[g, k, 2] if f == 0 else -R[g, k, 2]
            else:
                to_world(R[g], geometry.face_normals[geometry.face_ptr[g] + f], trial)
            for k in range(3):
                trial[k] *= sign
            gap = separation(geometry, i, j, R, t, trial, work)
            if gap > best:
                best = gap
                n[:] = trial


@njit(cache=True)
def curvature(geometry, g, R, n, local, C):
    """Derivative of the support point of an ellipsoid or of a cylinder's rim with respect to n, into C; else 0."""
    kind, a = geometry.kind[g], geometry.size[g, 0]
    C[:] = 0.0
    to_local(R, n, local)
    if kind == CYLINDER:
        side = math.sqrt(local[0] ** 2 + local[1] ** 2)
        if side == 0.0:
            return
        for i in range(3):
            for k in range(3):
                u = (R[i, 1] * local[0] - R[i, 0] * local[1]) / side
                v = (R[k, 1] * local[0] - R[k, 0] * local[1]) / side
                C[i, k] = a / side * u * v
    elif kind == ELLIPSOID:
        s = geometry.size[g]
        length = math.sqrt((s[0] * local[0]) ** 2 + (s[1] * local[1]) ** 2 + (s[2] * local[2]) ** 2)
        for i in range(3):
            for k in range(3):
                for l in range(3):
                    C[i, k] += R[i, l] * R[k, l] * s[l] ** 2 / length
        for l in range(3):
            local[l] *= s[l] * s[l] / length
        p = local.copy()
        to_world(R, p, local)
        for i in range(3):
            for k in range(3):
                C[i, k] -= local[i] * local[k] / length


@njit(cache=True)
def smooth(geometry, i, j, R, t, n, ends1, radius1, valid1, ends2, radius2, valid2, point, normal, gap, work):
    """The contact of two geoms of which one at least is an ellipsoid or touches with the rim of a cylinder.

    The other may be a segment with a radius (`valid`, with its ends). From the given n on, Newton's method maximises
    the separation: where it is stationary, the support points p and q differ by a multiple of the normal.
    """
    size = min(geometry.radius[i], geometry.radius[j])
    local, back, p, q, d, e1, e2, m, old = (
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8],
    )  # fmt: skip
    C1, C2 = work[9:12], work[12:15]
    m[:] = n
    if valid1 and valid2:  # not as segments, then: a cylinder touches with its rim
        valid1 = geometry.kind[i] != CYLINDER
        valid2 = geometry.kind[j] != CYLINDER and not valid1
    ends, radius, side = (ends1, radius1, 1.0) if valid1 else (ends2, radius2, -1.0)
    own, far = (p, q) if valid1 else (q, p)
    length = 0.0
    if valid1 or valid2:
        for k in range(3):
            d[k] = ends[1, k] - ends[0, k]
        length = normalise(d)
    best = separation(geometry, i, j, R, t, m, work)  # leaves the support points in p and q
    for _ in range(20):
        if length > 0.0:
            s = dot(far, d) - dot(ends[0], d)
            if not (s > 0.0 and s < length):  # opposite the other geom is an end
                ends[0] = ends[0 if s <= 0.0 else 1]
                length = 0.0
                # A cylinder does not end in a ball: its rim is meant.
                valid1 = valid1 and geometry.kind[i] != CYLINDER
                valid2 = valid2 and geometry.kind[j] != CYLINDER
        if length > 0.0:  # turn about the line only
            along = dot(m, d)
            for k in range(3):
                m[k] -= along * d[k]
            normalise(m)
            for k in range(3):
                e1[k] = d[(k + 1) % 3] * m[(k + 2) % 3] - d[(k + 2) % 3] * m[(k + 1) % 3]
            e2[:] = 0.0
        else:
            any_perpendicular(m, e1)
            for k in range(3):
                e2[k] = m[(k + 1) % 3] * e1[(k + 2) % 3] - m[(k + 2) % 3] * e1[(k + 1) % 3]
        best = separation(geometry, i, j, R, t, m, work)
        if valid1:
            C1[:] = 0.0
            p[:] = ends1[0]
        else:
            curvature(geometry, i, R[i], m, local, C1)
        if valid2:
            C2[:] = 0.0
            q[:] = ends2[0]
        else:
            curvature(geometry, j, R[j], back, local, C2)
        f1, f2, a11, a12, a22, width = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            delta = q[k] - p[k]
            f1 += e1[k] * delta
            f2 += e2[k] * delta
            width += m[k] * delta
            for l in range(3):
                c = C1[k, l] + C2[k, l]
                a11 += e1[k] * c * e1[l]
                a12 += e1[k] * c * e2[l]
                a22 += e2[k] * c * e2[l]
        # Where the separation is not concave enough, step as if it were.
        trace = a11 + a22
        if not (a11 + width > 0.0 and (a11 + width) * (a22 + width) - a12 * a12 > 1e-10 * trace * trace):
            width = abs(width) + 1e-5 * trace + INSIDE * size
        a11 += width
        a22 += width
        det = a11 * a22 - a12 * a12
        s1, s2 = (a22 * f1 - a12 * f2) / det, (a11 * f2 - a12 * f1) / det
        step = math.sqrt(s1 * s1 + s2 * s2)
        if step < 1e-15:
            break
        old[:] = m
        scale = min(1.0, 0.2 / step)
        for _ in range(10):
            for k in range(3):
                m[k] = old[k] + scale * (s1 * e1[k] + s2 * e2[k])
            normalise(m)
            # Close to the maximum round-off decides which value is larger.
            if step < 1e-7 or separation(geometry, i, j, R, t, m, work) > best:
                break
            scale *= 0.5
        else:
            m[:] = old
            break
        separation(geometry, i, j, R, t, m, work)
    turned = separation(geometry, i, j, R, t, m, work) >= separation(geometry, i, j, R, t, n, work) - INSIDE * size
    if not turned:
        m[:] = n
    normal[:] = m
    gap[0] = separation(geometry, i, j, R, t, m, work)
    if turned and (valid1 or valid2):
        # The support point of a segment is any of its points: take the one opposite the other geom.
        s = min(max(dot(far, d) - dot(ends[0], d), 0.0), length)
        for k in range(3):
            own[k] = ends[0, k] + s * d[k] + side * radius * m[k]
    for k in range(3):
        point[k] = 0.5 * (p[k] + q[k])


@njit(cache=True)
def incident(geometry, g, R, t, n, whole, rim, local, poly):
    """Feature of geom g that faces a plane of outward normal n, into poly; returns (number of points, radius).

    The feature is what lies within `radius` of the point, segment or polygon; `whole` asks for all vertices of a
    polytope instead of a face, `rim` is the number of points that stand for the circle of a cylinder's cap.
    """
    kind, a, h = geometry.kind[g], geometry.size[g, 0], geometry.size[g, 1]
    to_local(R, n, local)
    for i in range(3):
        local[i] = -local[i]
    if kind == SPHERE:
        poly[0] = t
        return 1, a
    if kind == CAPSULE:
        for i in range(3):
            poly[0, i] = t[i] - h * R[i, 2]
            poly[1, i] = t[i] + h * R[i, 2]
        return 2, a
    if kind == ELLIPSOID:
        s = geometry.size[g]
        length = math.sqrt((s[0] * local[0]) ** 2 + (s[1] * local[1]) ** 2 + (s[2] * local[2]) ** 2)
        for i in range(3):
            local[i] *= s[i] * s[i] / length
        to_world(R, local, poly[0])
        for i in range(3):
            poly[0, i] += t[i]
        return 1, 0.0
    if kind == CYLINDER:
        side = math.sqrt(local[0] ** 2 + local[1] ** 2)
        # Where the circle dips deepest; in an upright cylinder that is noise, so any fixed direction does.
        c, s = (local[0] / side, local[1] / side) if side > 1e-6 else (1.0, 0.0)
        if local[2] ** 2 > 0.5:
            z = h if local[2] > 0.0 else -h
            for k in range(rim):
                angle = 2.0 * math.pi * k / rim
                ck, sk = math.cos(angle), math.sin(angle)
                x, y = a * (c * ck - s * sk), a * (s * ck + c * sk)
                for i in range(3):
                    poly[k, i] = t[i] + R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
            return rim, 0.0
        for i in range(3):
            foot = t[i] + a * (R[i, 0] * c + R[i, 1] * s)
            poly[0, i] = foot - h * R[i, 2]
            poly[1, i] = foot + h * R[i, 2]
        return 2, 0.0
    first = geometry.vertex_ptr[g]
    count = 0
    if whole:
        for k in range(first, geometry.vertex_ptr[g + 1]):
            to_world(R, geometry.vertices[k], poly[count])
            count += 1
    else:
        deepest = deepest_vertex(geometry, g, local)
        best, face = -math.inf, -1
        for f in range(geometry.face_ptr[g], geometry.face_ptr[g + 1]):
            e = dot(geometry.face_normals[f], local)
            if e > best:
                for p in range(geometry.loop_ptr[f], geometry.loop_ptr[f + 1]):
                    if geometry.loop[p] == deepest:
                        best, face = e, f
        for p in range(geometry.loop_ptr[face], geometry.loop_ptr[face + 1]):
            to_world(R, geometry.vertices[first + geometry.loop[p]], poly[count])
            count += 1
    for k in range(count):
        for i in range(3):
            poly[k, i] += t[i]
    return count, 0.0


@njit(cache=True)
def cut(poly, count, heights, tol, out):
    """Part of a polygon, segment or point where the linear function with these values at its corners is ≤ 0.

    A corner within tol of 0 stays as it is and makes no new corner beside it. Returns the new number of points.
    """
    kept = 0
    for k in range(count):
        h = heights[k]
        if h <= tol:
            out[kept] = poly[k]
            kept += 1
        if count == 1 or (count == 2 and k == 1):
            break
        q = (k + 1) % count
        g = heights[q]
        if (h < -tol and g > tol) or (h > tol and g < -tol):
            s = h / (h - g)
            for i in range(3):
                out[kept, i] = poly[k, i] + s * (poly[q, i] - poly[k, i])
            kept += 1
    return kept


@njit(cache=True)
def clip_to_face(geometry, g, face, R, t, n, poly, count, other, heights, work):
    """Clip a polygon by the sides of a polytope face; returns its new number of points, in poly."""
    first, tol = geometry.vertex_ptr[g], INSIDE * geometry.radius[g]
    a, b, side = work[4], work[5], work[6]
    begin, end = geometry.loop_ptr[face], geometry.loop_ptr[face + 1]
    to_world(R, geometry.vertices[first + geometry.loop[end - 1]], a)
    for p in range(begin, end):
        to_world(R, geometry.vertices[first + geometry.loop[p]], b)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            side[i] = (b[j] - a[j]) * n[k] - (b[k] - a[k]) * n[j]
        normalise(side)
        outside = False
        for q in range(count):
            heights[q] = side[0] * (poly[q, 0] - t[0] - a[0])
            heights[q] += side[1] * (poly[q, 1] - t[1] - a[1]) + side[2] * (poly[q, 2] - t[2] - a[2])
            outside = outside or heights[q] > tol
        if outside:
            count = cut(poly, count, heights, tol, other)
            for q in range(count):
                poly[q] = other[q]
        a[:] = b
    return count


@njit(cache=True)
def clip_to_disk(radius, R, t, poly, count, rim, other):
    """Points that span the part of a polygon, segment or point above a disk about the z axis of the pose (R, t).

    They are the corners above the disk, the points of the edges above its circle, and those of `rim` points of the
    circle that lie under the polygon, lifted to its plane. Returns their number, in poly.
    """
    tol = INSIDE * radius
    u = np.empty((count, 3))  # the polygon in the disk's frame
    d = np.empty(3)
    kept = 0
    for k in range(count):
        for i in range(3):
            d[i] = poly[k, i] - t[i]
        to_local(R, d, u[k])
    for k in range(count):
        inside = math.sqrt(u[k, 0] ** 2 + u[k, 1] ** 2) <= radius + tol
        if inside:
            other[kept] = poly[k]
            kept += 1
        if count == 1 or (count == 2 and k == 1):
            break
        q = (k + 1) % count
        ex, ey = u[q, 0] - u[k, 0], u[q, 1] - u[k, 1]
        a, b = ex * ex + ey * ey, ex * u[k, 0] + ey * u[k, 1]
        c = u[k, 0] ** 2 + u[k, 1] ** 2 - radius * radius
        root = b * b - a * c
        if root <= 0.0 or a <= tol * tol:
            continue
        for sign in (-1.0, 1.0):
            s = (-b + sign * math.sqrt(root)) / a
            # Not beside a corner: the corner itself is on the circle.
            if s * math.sqrt(a) > tol and (1.0 - s) * math.sqrt(a) > tol:
                for i in range(3):
                    other[kept, i] = poly[k, i] + s * (poly[q, i] - poly[k, i])
                kept += 1
    if count > 2:
        # Newell's normal of the polygon in the disk's frame, for its orientation and its plane.
        nx, ny, nz = 0.0, 0.0, 0.0
        for k in range(count):
            q = (k + 1) % count
            nx += (u[k, 1] - u[q, 1]) * (u[k, 2] + u[q, 2])
            ny += (u[k, 2] - u[q, 2]) * (u[k, 0] + u[q, 0])
            nz += (u[k, 0] - u[q, 0]) * (u[k, 1] + u[q, 1])
        for p in range(rim if nz != 0.0 else 0):
            x, y = radius * math.cos(2.0 * math.pi * p / rim), radius * math.sin(2.0 * math.pi * p / rim)
            inside = True
            for k in range(count):
                q = (k + 1) % count
                turn = (u[q, 0] - u[k, 0]) * (y - u[k, 1]) - (u[q, 1] - u[k, 1]) * (x - u[k, 0])
                inside = inside and turn * nz > 0.0
            if inside:
                z = u[0, 2] - (nx * (x - u[0, 0]) + ny * (y - u[0, 1])) / nz
                for i in range(3):
                    other[kept, i] = t[i] + R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
                kept += 1
    for k in range(kept):
        poly[k] = other[k]
    return kept


@njit(cache=True)
def merge(poly, gap, count, tol):
    """Keep one of several points within tol of each other, the deepest; returns the number left, in order."""
    kept = 0
    for k in range(count):
        twin = -1
        for q in range(kept):
            d = (poly[k, 0] - poly[q, 0]) ** 2 + (poly[k, 1] - poly[q, 1]) ** 2 + (poly[k, 2] - poly[q, 2]) ** 2
            if d <= tol * tol:
                twin = q
                break
        if twin < 0:
            poly[kept] = poly[k]
            gap[kept] = gap[k]
            kept += 1
        elif gap[k] < gap[twin]:
            poly[twin] = poly[k]
            gap[twin] = gap[k]
    return kept


@njit(cache=True)
def reduce(poly, gap, count, n, limit):
    """Keep at most `limit` points: the deepest and the corners of the patch that hold most of its area.

    The convex hull of the points in the plane of n loses corner after corner, each time the one whose triangle with
    its neighbours is smallest. Returns the number left, in their former order.
    """
    e1, e2 = np.empty(3), np.empty(3)
    any_perpendicular(n, e1)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        e2[i] = n[j] * e1[k] - n[k] * e1[j]
    x, y = np.empty(count), np.empty(count)
    deepest = 0
    for k in range(count):
        x[k], y[k] = dot(poly[k], e1), dot(poly[k], e2)
        if gap[k] < gap[deepest]:
            deepest = k
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
        m -= 1  # the last of one half is the first of the other
    keep = np.zeros(count, dtype=np.bool_)
    keep[deepest] = True
    room = limit - 1
    for p in range(m):
        if hull[p] == deepest:
            room = limit
    while m > room:
        worst, smallest = -1, math.inf
        for p in range(m):
            a, b, c = hull[p - 1 if p > 0 else m - 1], hull[p], hull[p + 1 if p + 1 < m else 0]
            area = abs((x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a]))
            # Equal within round-off counts as equal, so that the order and not noise decides.
            if b != deepest and area < smallest * (1.0 - 1e-9):
                worst, smallest = p, area
        for p in range(worst, m - 1):
            hull[p] = hull[p + 1]
        m -= 1
    for p in range(m):
        keep[hull[p]] = True
    kept = 0
    for k in range(count):
        if keep[k]:
            poly[kept] = poly[k]
            gap[kept] = gap[k]
            kept += 1
    return kept


@njit(cache=True)
def segment(geometry, g, R, t, n, local, ends):
    """Segment (or point) of geom g that is outermost along n, into ends (2, 3); returns (its radius, valid)."""
    kind, a, h = geometry.kind[g], geometry.size[g, 0], geometry.size[g, 1]
    if kind == SPHERE:
        ends[0] = t
        ends[1] = t
        return a, True
    if kind == CAPSULE or kind == CYLINDER:
        for i in range(3):
            ends[0, i] = t[i] - h * R[i, 2]
            ends[1, i] = t[i] + h * R[i, 2]
        return a, kind == CAPSULE or abs(n[0] * R[0, 2] + n[1] * R[1, 2] + n[2] * R[2, 2]) < ANGLE
    if kind != POLYTOPE:
        return 0.0, False
    to_local(R, n, local)
    first, last = geometry.vertex_ptr[g], geometry.vertex_ptr[g + 1]
    top = geometry.vertices[first + deepest_vertex(geometry, g, local)]
    # The edge: the two outermost corners among those seen from the topmost one under less than ANGLE.
    p, q = top, top
    for turn in range(2):
        farthest = 0.0
        for k in range(first, last):
            v = geometry.vertices[k]
            d = math.sqrt((v[0] - top[0]) ** 2 + (v[1] - top[1]) ** 2 + (v[2] - top[2]) ** 2)
            if dot(top, local) - dot(v, local) <= ANGLE * d:
                far = (v[0] - p[0]) ** 2 + (v[1] - p[1]) ** 2 + (v[2] - p[2]) ** 2
                if far > farthest:
                    farthest, q = far, v
        if turn == 0:
            p, q = q, p
    length = math.sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
    for k in range(first, last):
        v = geometry.vertices[k]
        d = math.sqrt((v[0] - top[0]) ** 2 + (v[1] - top[1]) ** 2 + (v[2] - top[2]) ** 2)
        if dot(top, local) - dot(v, local) <= ANGLE * d:
            cx = (q[1] - p[1]) * (v[2] - p[2]) - (q[2] - p[2]) * (v[1] - p[1])
            cy = (q[2] - p[2]) * (v[0] - p[0]) - (q[0] - p[0]) * (v[2] - p[2])
            cz = (q[0] - p[0]) * (v[1] - p[1]) - (q[1] - p[1]) * (v[0] - p[0])
            if math.sqrt(cx * cx + cy * cy + cz * cz) > 1e-3 * length * length:
                return 0.0, False  # a face
    to_world(R, p, ends[0])
    to_world(R, q, ends[1])
    for i in range(3):
        ends[0, i] += t[i]
        ends[1, i] += t[i]
    return 0.0, True


@njit(cache=True)
def closest(p, d, length1, q, e, length2):
    """Arc lengths (s, r) of the closest points p + s d and q + r e of two segments with unit directions d, e."""
    b = dot(d, e)
    c = dot(d, p) - dot(d, q)
    f = dot(e, p) - dot(e, q)
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


@njit(cache=True)
def between(p, radius1, q, radius2, n, point, normal):
    """Contact of two balls (radius 0: points with the known normal n); returns the gap."""
    if radius1 + radius2 > 0.0:
        for i in range(3):
            normal[i] = q[i] - p[i]
        gap = normalise(normal) - radius1 - radius2
    else:
        normal[:] = n
        gap = n[0] * (q[0] - p[0]) + n[1] * (q[1] - p[1]) + n[2] * (q[2] - p[2])
    for i in range(3):
        point[i] = 0.5 * (p[i] + radius1 * normal[i] + q[i] - radius2 * normal[i])
    return gap


@njit(cache=True)
def segments(ends1, radius1, flat1, ends2, radius2, flat2, n, known, size, point, normal, gap, work):
    """Contacts of two segments with radii, into the first rows of point, normal, gap; returns their number.

    n is the normal found by Coal, if `known`. A segment with flat ends (the side of a cylinder) touches with its
    side only. 0 means that the segments are not the features that touch.
    """
    d, e, m, a, b = work[4], work[5], work[6], work[7], work[8]
    for i in range(3):
        d[i] = ends1[1, i] - ends1[0, i]
        e[i] = ends2[1, i] - ends2[0, i]
    length1, length2 = normalise(d), normalise(e)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        m[i] = d[j] * e[k] - d[k] * e[j]
    sine = math.sqrt(dot(m, m))
    round_ = radius1 + radius2 > 0.0
    tiny = SAME * size
    if length1 > 0.0 and length2 > 0.0 and sine < PARALLEL:
        # Both ends of the overlap, as arc lengths on segment 1.
        low = dot(d, ends2[0]) - dot(d, ends1[0])
        high = dot(d, ends2[1]) - dot(d, ends1[0])
        low, high = max(min(low, high), 0.0), min(max(low, high), length1)
        if high - low > tiny:
            if known:
                for i in range(3):
                    m[i] = n[i] - dot(n, d) * d[i]
                normalise(m)
            count = 0
            for s in (low, high):
                for i in range(3):
                    a[i] = ends1[0, i] + s * d[i]
                r = dot(e, a) - dot(e, ends2[0])
                for i in range(3):
                    b[i] = ends2[0, i] + r * e[i]
                gap[count] = between(a, radius1, b, radius2, m, point[count], normal[count])
                apart = not round_ or gap[count] + radius1 + radius2 > tiny
                if apart and (not known or dot(normal[count], n) > 0.5):
                    count += 1
            if count == 2:
                return 2
    s, r = closest(ends1[0], d, length1, ends2[0], e, length2)
    for i in range(3):
        a[i] = ends1[0, i] + s * d[i]
        b[i] = ends2[0, i] + r * e[i]
    inner = s > 0.0 and s < length1 and r > 0.0 and r < length2
    distance = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    if round_ and distance <= tiny:
        # The cores cross: any separating direction, the common perpendicular where there is one.
        if known:
            return 0
        if sine < PARALLEL:
            any_perpendicular(d if length1 > 0.0 else e, m)
        normalise(m)
        normal[0] = m
        point[0] = a
        gap[0] = -radius1 - radius2
        return 1
    if not round_:
        if inner:
            normalise(m)
            if dot(m, n) < 0.0:
                for i in range(3):
                    m[i] = -m[i]
        elif distance > tiny:
            for i in range(3):
                m[i] = (b[i] - a[i]) / distance
        else:
            m[:] = n
    gap[0] = between(a, radius1, b, radius2, m, point[0], normal[0])
    side1, side2 = dot(normal[0], d), dot(normal[0], e)
    return 0 if (flat1 and abs(side1) > INSIDE) or (flat2 and abs(side2) > INSIDE) else 1


@njit(cache=True)
def reference(geometry, i, j, R, t, whole, rim, margin, face1, face2, poly, other, gap, work, m):
    """Contacts of a face of geom i (or j) with the other geom; returns (number, normal 1 to 2 in m).

    face1, face2: the faces as of `aligned_face`, -1 where there is none, of which one is used.
    """
    g, o, sign = (i, j, 1.0) if face1 >= 0 else (j, i, -1.0)
    face = face1 if face1 >= 0 else face2
    kind = geometry.kind[g]
    if kind == CYLINDER:
        for k in range(3):
            m[k] = R[g, k, 2] if face == 0 else -R[g, k, 2]
        level = geometry.size[g, 1]
    elif kind == HALFSPACE:
        to_world(R[g], geometry.size[g], m)
        level = geometry.offset[g]
    else:
        to_world(R[g], geometry.face_normals[face], m)
        level = geometry.face_offsets[face]
    count, radius = incident(geometry, o, R[o], t[o], m, whole, rim, work[0], poly)
    if kind == CYLINDER:
        count = clip_to_disk(geometry.size[g, 0], R[g], t[g], poly, count, rim, other)
    elif kind == POLYTOPE:
        count = clip_to_face(geometry, g, face, R[g], t[g], m, poly, count, other, gap, work)
    kept = 0
    for k in range(count):
        height = m[0] * (poly[k, 0] - t[g, 0]) + m[1] * (poly[k, 1] - t[g, 1]) + m[2] * (poly[k, 2] - t[g, 2])
        height -= level + radius
        if height <= margin:
            for c in range(3):
                poly[kept, c] = poly[k, c] - radius * m[c]
            gap[kept] = height
            kept += 1
    for c in range(3):
        m[c] *= sign
    return kept


@njit(cache=True)
def faces(geometry, i, j, R, n, work):
    """The reference face of the normal n: (face of geom i, -1), (-1, face of geom j) or (-1, -1)."""
    local, back = work[0], work[1]
    for k in range(3):
        back[k] = -n[k]
    face1, error1 = aligned_face(geometry, i, R[i], n, local)
    face2, error2 = aligned_face(geometry, j, R[j], back, local)
    if face1 >= 0 and error1 <= error2 + BIAS:
        return face1, -1
    return -1, face2


@njit(cache=True)
def pair_contacts(
    geometry, i, j, R, t, slack, known, trusted, n, margin, limit, poly, other, point, normal, gap, work
):
    """Contacts of one pair, into the first rows of point, normal, gap; returns their number.

    n is the normal of the cores, if `known`, and to be relied on if `trusted`.
    """
    size = min(geometry.radius[i], geometry.radius[j])
    kind1, kind2 = geometry.kind[i], geometry.kind[j]
    whole = kind1 == HALFSPACE or kind2 == HALFSPACE
    m, found = work[15], work[16]
    face1, face2 = 0 if kind1 == HALFSPACE else -1, 0 if kind2 == HALFSPACE else -1
    if known:
        found[:] = n
        face1, face2 = faces(geometry, i, j, R, n, work)
        face = face1 >= 0 or face2 >= 0
        # Cores that overlap give no reliable normal, and rounding off a sliver of contact beside an edge turns it.
        if not trusted or not face and separation(geometry, i, j, R, t, n, work) <= slack:
            best_normal(geometry, i, j, R, t, n, RESCUE * size if trusted else 0.0, m, work)
            face1, face2 = faces(geometry, i, j, R, n, work)
    if face1 >= 0 or face2 >= 0:
        count = reference(geometry, i, j, R, t, whole, limit, margin, face1, face2, poly, other, gap, work, m)
        deepest = math.inf
        for k in range(count):
            deepest = min(deepest, gap[k])
        if known and deepest > separation(geometry, i, j, R, t, m, work) + SAME * size:
            count = 0  # what is deepest is not over this face
            if trusted:
                n[:] = found
        count = merge(poly, gap, count, SAME * size)
        if count > limit:
            count = reduce(poly, gap, count, m, limit)
        for k in range(count):
            point[k] = poly[k]
            normal[k] = m
        if count > 0 or whole:
            return count
    ends1, ends2 = work[17:19], work[19:21]
    for k in range(3):
        m[k] = -n[k]
    radius1, valid1 = segment(geometry, i, R[i], t[i], n, work[0], ends1)
    radius2, valid2 = segment(geometry, j, R[j], t[j], m, work[0], ends2)
    if valid1 and valid2:
        flat1, flat2 = kind1 == CYLINDER, kind2 == CYLINDER
        count = segments(ends1, radius1, flat1, ends2, radius2, flat2, n, known, size, point, normal, gap, work)
        if not known or count == 2:
            return count
        if count == 1:
            # The distance is the largest separation: the right features reach it.
            own = separation(geometry, i, j, R, t, normal[0], work)
            if own > separation(geometry, i, j, R, t, n, work) - SAME * size and abs(own - gap[0]) < SAME * size:
                return 1
    smooth(
        geometry, i, j, R, t, n, ends1, radius1, valid1, ends2, radius2, valid2, point[0], normal[0], gap, work
    )
    return 1


@njit(cache=True)
def apart(geometry, i, j, R, t, margin):
    """Whether the bounding spheres (or a sphere and a half-space) are farther apart than margin."""
    x, y, z = t[j, 0] - t[i, 0], t[j, 1] - t[i, 1], t[j, 2] - t[i, 2]
    for h, g, sign in ((i, j, 1.0), (j, i, -1.0)):
        if geometry.kind[h] == HALFSPACE:
            height = -geometry.offset[h] - geometry.radius[g]
            for k in range(3):
                n = geometry.size[h, k]
                height += sign * n * (R[h, 0, k] * x + R[h, 1, k] * y + R[h, 2, k] * z)
            return height > margin
    reach = geometry.radius[i] + geometry.radius[j] + margin
    return x * x + y * y + z * z > reach * reach


@njit(cache=True)
def manifolds(
    geometry, R, t, slack, first, second, slot, coal, base, reach, limit, poly, other, heights, point, normal, gap, pair
):
    """Contacts of all candidate pairs (first, second), into point, normal, gap and pair; returns their number.

    ``coal[slot[p]]`` is the distance and normal of the cores of pair p, where slot[p] ≥ 0; ``slack[g]`` bounds how far
    the surface of geom g is from that of its core. ``base[p]`` plus the reach of both geoms is the largest gap of
    interest. The outputs have room for `limit` contacts per pair.
    """
    n, work = np.empty(3), np.empty((21, 3))
    points, normals = np.empty((limit, 3)), np.empty((limit, 3))
    total = 0
    for p in range(first.size):
        i, j = first[p], second[p]
        margin, both = base[p] + reach[i] + reach[j], slack[i] + slack[j]
        known, trusted = slot[p] >= 0, True
        if not known and apart(geometry, i, j, R, t, margin):
            continue
        if known:
            result = coal[slot[p]]
            if result[0] - both > margin:
                continue
            n[:] = result[1:4]
            length = normalise(n)
            if not (length > 0.5 and length < 2.0):
                n[0], n[1], n[2] = 0.0, 0.0, 1.0
            trusted = result[0] > 0.0
        count = pair_contacts(
            geometry, i, j, R, t, both, known, trusted, n, margin, limit, poly, other, points, normals, heights, work
        )
        for k in range(count):
            if heights[k] <= margin:
                point[total] = points[k]
                normal[total] = normals[k]
                gap[total] = heights[k]
                pair[total] = p
                total += 1
    return total


@njit(cache=True)
def match(geometry, R, t, first, second, point, tolerance, old1, old2, old_key, old_local1, old_local2, next_key, key,
          local1, local2):  # fmt: skip
    """Give contacts the keys of those they continue; new ones count up from next_key, which is returned.

    Both lists are sorted by pair. Within a pair the closest old and new points are matched first, by the smaller of
    the distances seen from geom 1 and from geom 2, up to `tolerance` times the radius of the smaller geom.
    """
    d = np.empty(3)
    count = first.size
    for c in range(count):
        for k in range(3):
            d[k] = point[c, k] - t[first[c], k]
        to_local(R[first[c]], d, local1[c])
        for k in range(3):
            d[k] = point[c, k] - t[second[c], k]
        to_local(R[second[c]], d, local2[c])
        key[c] = -1
    used = np.zeros(old1.size, dtype=np.bool_)
    a, o = 0, 0
    while a < count:
        i, j = first[a], second[a]
        b = a
        while b < count and first[b] == i and second[b] == j:
            b += 1
        while o < old1.size and (old1[o] < i or (old1[o] == i and old2[o] < j)):
            o += 1
        q = o
        while q < old1.size and old1[q] == i and old2[q] == j:
            q += 1
        reach = tolerance * min(geometry.radius[i], geometry.radius[j])
        for _ in range(min(b - a, q - o)):
            best, new, old = reach * reach, -1, -1
            for c in range(a, b):
                for e in range(o, q):
                    if key[c] < 0 and not used[e]:
                        s1, s2 = 0.0, 0.0
                        for k in range(3):
                            s1 += (local1[c, k] - old_local1[e, k]) ** 2
                            s2 += (local2[c, k] - old_local2[e, k]) ** 2
                        if min(s1, s2) < best:
                            best, new, old = min(s1, s2), c, e
            if new < 0:
                break
            key[new] = old_key[old]
            used[old] = True
        for c in range(a, b):
            if key[c] < 0:
                key[c] = next_key
                next_key += 1
        a, o = b, q
    return next_key
