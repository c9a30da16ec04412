"""Links of an articulated tree: where they are, how they move, rows of contacts on them."""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.vectors import square


@in_place
def quaternions(R, out):
    """Unit quaternions xyzw of rotation matrices, w >= 0 unless the turn is near half, into out (n, 4)."""
    for b in range(R.shape[0]):
        trace = R[b, 0, 0] + R[b, 1, 1] + R[b, 2, 2]
        if trace > 0.0:
            s = 2.0 * math.sqrt(1.0 + trace)
            out[b, 3] = 0.25 * s
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                out[b, i] = (R[b, k, j] - R[b, j, k]) / s
        else:
            i = 0
            if R[b, 1, 1] > R[b, 0, 0]:
                i = 1
            if R[b, 2, 2] > R[b, i, i]:
                i = 2
            j, k = (i + 1) % 3, (i + 2) % 3
            s = 2.0 * math.sqrt(1.0 + R[b, i, i] - R[b, j, j] - R[b, k, k])
            out[b, i] = 0.25 * s
            out[b, j] = (R[b, i, j] + R[b, j, i]) / s
            out[b, k] = (R[b, i, k] + R[b, k, i]) / s
            out[b, 3] = (R[b, k, j] - R[b, j, k]) / s


@in_place
def rows(frame1, frame2, point, frame, first, support, J, start, H):
    """Add the rows of Hᵀ on the links of one tree to H. A contact between two links adds both to side 0.

    Parameters
    ----------
    frame1, frame2 : ndarray of int, shape (nc,)
        Of each contact.
    point, frame : ndarray, shapes (nc, 3), (nc, 3, 3)
        World; rows (n, t1, t2).
    first : int
        The links are the frames first, first + 1, ...
    support : ndarray of bool, shape (links, nv)
        Which coordinates move a link.
    J : ndarray, shape (6, nv)
        Column j is the velocity field of coordinate j, world axes: linear at the world's origin, then angular.
    start : ndarray of int, shape (nc, 2)
        Where the rows of each contact and side begin in H.
    H : ndarray
    """
    last, nv = first + support.shape[0], J.shape[1]
    for c in range(frame1.size):
        inside = first <= frame1[c] < last
        for s in range(2):
            f = frame1[c] if s == 0 else frame2[c]
            if f < first or f >= last:
                continue
            sign = -1.0 if s == 0 else 1.0
            side = 0 if inside else s
            p0, p1, p2 = point[c, 0], point[c, 1], point[c, 2]
            for i in range(3):
                d0, d1, d2 = sign * frame[c, i, 0], sign * frame[c, i, 1], sign * frame[c, i, 2]
                m0, m1, m2 = p1 * d2 - p2 * d1, p2 * d0 - p0 * d2, p0 * d1 - p1 * d0
                row = start[c, side] + nv * i
                for j in range(nv):
                    if support[f - first, j]:
                        H[row + j] += (
                            d0 * J[0, j] + d1 * J[1, j] + d2 * J[2, j] + m0 * J[3, j] + m1 * J[4, j] + m2 * J[5, j]
                        )


@in_place
def twists(x, support, J, v, linear, angular):
    """Velocities of the origins x (k, 3) of some frames, and of their rotations, world axes, into (k, 3) each."""
    for f in range(support.shape[0]):
        linear[f], angular[f] = 0.0, 0.0
        for j in range(v.size):
            if support[f, j]:
                for i in range(3):
                    linear[f, i] += J[i, j] * v[j]
                    angular[f, i] += J[3 + i, j] * v[j]
        w = angular[f]
        linear[f, 0] += w[1] * x[f, 2] - w[2] * x[f, 1]
        linear[f, 1] += w[2] * x[f, 0] - w[0] * x[f, 2]
        linear[f, 2] += w[0] * x[f, 1] - w[1] * x[f, 0]


@in_place
def rows_of_all(trees, frame1, frame2, point, frame, start, H):
    """`rows` of all trees of a scene.

    trees = (table, support, J): of each tree its first frame, how many, its first coordinate, and how many; one tree
    after the other, which coordinates move a link, and the velocity fields, (nv, 6).
    """
    table, support, J = trees
    at, field = 0, 0
    for t in range(table.size // 4):
        first, count, nv = table[4 * t], table[4 * t + 1], table[4 * t + 3]
        moves, own = support[at : at + count * nv].reshape((count, nv)), J[field : field + 6 * nv].reshape((nv, 6)).T
        rows(frame1, frame2, point, frame, first, moves, own, start, H)
        at, field = at + count * nv, field + 6 * nv


@in_place
def twists_of_all(trees, x, v, linear, angular):
    """`twists` of the frames of all trees of a scene, as of `rows_of_all`, where all frames are at x (n, 3)."""
    table, support, J = trees
    at, field = 0, 0
    for t in range(table.size // 4):
        first, count, begin, nv = table[4 * t], table[4 * t + 1], table[4 * t + 2], table[4 * t + 3]
        moves, own = support[at : at + count * nv].reshape((count, nv)), J[field : field + 6 * nv].reshape((nv, 6)).T
        last = first + count
        twists(x[first:last], moves, own, v[begin : begin + nv], linear[first:last], angular[first:last])
        at, field = at + count * nv, field + 6 * nv


@in_place
def reach(linear, angular, h, radius, fall, out):
    """How far any point of each link's shapes moves in a step of h at its `twists`, and by `fall`, m, into out (k,)."""
    for f in range(out.size):
        a, w = linear[f], angular[f]
        speed = math.sqrt(square(a[0]) + square(a[1]) + square(a[2]))
        spin = math.sqrt(square(w[0]) + square(w[1]) + square(w[2]))
        out[f] = h * (speed + spin * radius[f]) + fall


@kernel
def reach_of_all(trees, x, v, h, radius, fall, out):
    """`reach` of the last frames, those of all trees of a scene, from v (n,), where they are at x (k, 3)."""
    linear, angular = np.empty(x.shape), np.empty(x.shape)
    twists_of_all(trees, x, v, linear, angular)
    first = x.shape[0] - out.size
    reach(linear[first:], angular[first:], h, radius, fall, out)


@in_place
def closures(x, R, J, support, joints, points, rows, phi, G):
    """Add to phi how far the points of two joints each are apart, and to G the rows of closed loops.

    Parameters
    ----------
    x, R : ndarray, shapes (n, 3), (n, 3, 3)
        Of all joints, m.
    J, support : ndarray, shapes (6, nv), (n, nv)
        Velocity fields, and which coordinates move a joint, as of `rows`.
    joints : ndarray of int, shape (loops, 2)
    points : ndarray, shape (loops, 2, 3)
        In the frames of the joints, m.
    rows : ndarray of int, shape (loops + 1,)
        Loop k has the rows rows[k] to rows[k + 1]: three of the points, and three of the turn where there are six.
    phi, G : ndarray, shapes (rows,), (rows, nv)
    """
    for k in range(joints.shape[0]):
        row, turns = rows[k], rows[k + 1] - rows[k] > 3
        for side in range(2):
            at, sign = joints[k, side], 1.0 - 2.0 * side
            a, b, c = points[k, side]
            p = (
                x[at, 0] + R[at, 0, 0] * a + R[at, 0, 1] * b + R[at, 0, 2] * c,
                x[at, 1] + R[at, 1, 0] * a + R[at, 1, 1] * b + R[at, 1, 2] * c,
                x[at, 2] + R[at, 2, 0] * a + R[at, 2, 1] * b + R[at, 2, 2] * c,
            )
            for i in range(3):
                phi[row + i] += sign * p[i]
                j, l = (i + 1) % 3, (i + 2) % 3
                for n in range(G.shape[1]):
                    if support[at, n]:
                        G[row + i, n] += sign * (J[i, n] + J[3 + j, n] * p[l] - J[3 + l, n] * p[j])
                        if turns:
                            G[row + 3 + i, n] += sign * J[3 + i, n]
