"""Links of articulated trees: their orientations, velocities and reach, rows of contacts on them, and closed loops."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.vectors import along, cross, dot, put, row, times


@no_alloc
def quaternions(R, out):
    """Write unit quaternions xyzw of rotation matrices into out (n, 4); w >= 0 unless the angle is near half a turn."""
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


@no_alloc
def rows(trees, contacts, frame, start, H):
    """Add the rows of Hᵀ on links of trees to H; a contact between two links of one tree adds both to side 0.

    trees = (table, support, J). The table has four numbers per tree: its first frame, its number of frames, its first
    coordinate, its number of coordinates. `support` tells, tree after tree, which coordinates move a link. J has the
    velocity fields of the coordinates, (nv, 6), world axes: linear at the world's origin, then angular. The contacts,
    `frame` and `start` are as in `motion.free_rows`.
    """
    (table, support, fields), (names, points, _) = trees, contacts
    at, field = 0, 0
    for t in range(table.size // 4):
        first, count, nv = table[4 * t], table[4 * t + 1], table[4 * t + 3]
        moves, J = support[at : at + count * nv].reshape((count, nv)), fields[field : field + 6 * nv].reshape((nv, 6))
        last = first + count
        for c in range(names.shape[1]):
            inside = first <= names[2, c] < last
            for s in range(2):
                f = names[2 + s, c]
                if f < first or f >= last:
                    continue
                for i in range(3):
                    d0, d1, d2 = d = times(-1.0 if s == 0 else 1.0, row(frame[c], i))
                    m0, m1, m2 = cross(row(points[0], c), d)
                    own = H[start[c, 0 if inside else s] + nv * i :]
                    for j in range(nv):
                        if moves[f - first, j]:
                            own[j] += (
                                d0 * J[j, 0] + d1 * J[j, 1] + d2 * J[j, 2] + m0 * J[j, 3] + m1 * J[j, 4] + m2 * J[j, 5]
                            )
        at, field = at + count * nv, field + 6 * nv


@no_alloc
def twists(trees, x, v, linear, angular):
    """Velocities of the frames of trees at their origins x (n, 3), and their angular velocities, world axes.

    `trees` is as in `rows`. The results are written into the rows (n, 3) of these frames.
    """
    table, support, fields = trees
    at, field = 0, 0
    for t in range(table.size // 4):
        first, count, begin, nv = table[4 * t], table[4 * t + 1], table[4 * t + 2], table[4 * t + 3]
        moves = support[at : at + count * nv].reshape((count, nv))
        J = fields[field : field + 6 * nv].reshape((2 * nv, 3))
        own = v[begin : begin + nv]
        for f in range(count):
            speed, spin = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for j in range(nv):
                if moves[f, j]:
                    speed, spin = along(speed, own[j], row(J, 2 * j)), along(spin, own[j], row(J, 2 * j + 1))
            put(angular, first + f, spin)
            put(linear, first + f, along(speed, 1.0, cross(spin, row(x, first + f))))
        at, field = at + count * nv, field + 6 * nv


@kernel
def reach(trees, x, v, h, radius, fall, out):
    """Bound on the way of any point of each link's shapes in h s at its `twists`, plus `fall`, m, into out (k,).

    The links are the last of the frames; x (n, 3) has the origins of all frames.
    """
    linear, angular = np.empty(x.shape), np.empty(x.shape)
    twists(trees, x, v, linear, angular)
    first = x.shape[0] - out.size
    for f in range(out.size):
        speed, spin = row(linear, first + f), row(angular, first + f)
        out[f] = h * (math.sqrt(dot(speed, speed)) + math.sqrt(dot(spin, spin)) * radius[f]) + fall


@no_alloc
def closures(tree, loops, phi, G):
    """Add the vectors between points of closed loops to phi (rows,), and the rows of the loops to G (rows, nv).

    tree = (x, R, J, support): poses of all joints, velocity fields (6, nv), and the coordinates that move each joint.
    loops = (joints, points, rows): two joints of each loop, a point in the frame of each, and the index of its first
    row. A loop has three rows for its points, and three more for the rotation if it has six rows.
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
