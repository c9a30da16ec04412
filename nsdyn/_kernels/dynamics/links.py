"""Links of an articulated tree: where they are, how they move, rows of contacts on them."""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.vectors import along, cross, dot, put, row, times


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
            for i in range(3):
                d0, d1, d2 = d = times(-1.0 if s == 0 else 1.0, row(frame[c], i))
                m0, m1, m2 = cross(row(point, c), d)
                at = start[c, 0 if inside else s] + nv * i
                for j in range(nv):
                    if support[f - first, j]:
                        H[at + j] += (
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
        put(linear, f, along(row(linear, f), 1.0, cross(row(angular, f), row(x, f))))


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
        speed, spin = row(linear, f), row(angular, f)
        out[f] = h * (math.sqrt(dot(speed, speed)) + math.sqrt(dot(spin, spin)) * radius[f]) + fall


@kernel
def reach_of_all(trees, x, v, h, radius, fall, out):
    """`reach` of the last frames, those of all trees of a scene, from v (n,), where they are at x (k, 3)."""
    linear, angular = np.empty(x.shape), np.empty(x.shape)
    twists_of_all(trees, x, v, linear, angular)
    first = x.shape[0] - out.size
    reach(linear[first:], angular[first:], h, radius, fall, out)


@in_place
def closures(tree, loops, phi, G):
    """Add to phi (rows,) how far the points of two joints each are apart, and to G (rows, nv) the rows of closed loops.

    tree = (x, R, J, support): poses of all joints, velocity fields, and which coordinates move a joint, as of `rows`.
    loops = (joints, points, rows): two joints each, a point in the frame of each, and where their rows begin: three of
    the points, and three of the turn where there are six.
    """
    (x, R, J, support), (joints, points, rows) = tree, loops
    for k in range(joints.shape[0]):
        first, turns = rows[k], rows[k + 1] - rows[k] > 3
        for side in range(2):
            at, sign = joints[k, side], 1.0 - 2.0 * side
            a, b, c = points[k, side]
            p = (
                x[at, 0] + R[at, 0, 0] * a + R[at, 0, 1] * b + R[at, 0, 2] * c,
                x[at, 1] + R[at, 1, 0] * a + R[at, 1, 1] * b + R[at, 1, 2] * c,
                x[at, 2] + R[at, 2, 0] * a + R[at, 2, 1] * b + R[at, 2, 2] * c,
            )
            for i in range(3):
                phi[first + i] += sign * p[i]
                j, l = (i + 1) % 3, (i + 2) % 3
                for n in range(G.shape[1]):
                    if support[at, n]:
                        G[first + i, n] += sign * (J[i, n] + J[3 + j, n] * p[l] - J[3 + l, n] * p[j])
                        if turns:
                            G[first + 3 + i, n] += sign * J[3 + i, n]
