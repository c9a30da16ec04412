"""Joint rows: joint limits, clutches, and the coordinates that closed loops leave free.

Joint rows follow the contacts of a step; like a contact, each has three rows. A limit is a frictionless contact with
one normal row ±e_j. A clutch |tau| <= tau_c is a contact with mu = 1. Its first tangent row is e_j, relative to a rotor
if it has one. Its second tangent row is that of another coordinate if both slip together. Its normal row acts on an
additional coordinate, pressed so that r_N = h tau_c exactly. All other rows are zero.
"""

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.reductions import copy


@kernel
def append_rows(slots, coordinate, other, tree, sign, blocks):
    """Factors of the contacts followed by the joint rows of the given slots, as blocks."""
    offset, block, start, H, m_start, m, minv = blocks
    nc, nj, size = block.shape[0], slots.size, H.size
    new_block, new_start = np.full((nc + nj, 2), -1, np.int64), np.empty((nc + nj, 2), np.int64)
    new_block[:nc], new_start[:nc] = block, start
    for i in range(nj):
        k = tree[slots[i]]
        new_block[nc + i, 0] = k
        new_start[nc + i, 0] = new_start[nc + i, 1] = size
        size += 3 * (offset[k + 1] - offset[k])
    new_H = np.zeros(size)
    copy(H, new_H)
    for i in range(nj):
        k = tree[slots[i]]
        at = new_start[nc + i, 0] + coordinate[slots[i]] - offset[k]
        if sign[slots[i]] == 0.0:
            new_H[at + offset[k + 1] - offset[k]] = 1.0
            if other[slots[i]] >= 0:
                new_H[at + 2 * (offset[k + 1] - offset[k]) + other[slots[i]] - coordinate[slots[i]]] = 1.0
        else:
            new_H[at] = sign[slots[i]]
    return offset, new_block, new_start, new_H, m_start, m, minv


@no_alloc
def near(angle, rates, h, table, out):
    """Write the slots that may act in a step of h s into out: friction, and limits in reach; return their number.

    `angle` (n,) has the joint coordinates, rates = (v, v_free), (n,) each, table = (coordinate, sign, bound, near).
    """
    (v, v_free), (coordinate, sign, bound, within), some = rates, table, 0
    for k in range(out.size):
        j = coordinate[k]
        gap, rate = sign[k] * (angle[j] - bound[k]), max(abs(v[j]), abs(v_free[j]))
        if gap <= within[k] + 2.0 * h * rate:
            out[some] = k
            some += 1
    return some


@no_alloc
def reduce_jacobian(blocks, where, z, sizes, block, start, out):
    """Write the rows of Hᵀ Z into `out`, zero before, and the entries ±1 of clutches.

    The blocks have the given sizes; Z of each begins at `where` in z (-1: Z is I).
    """
    offset, _, old, H = blocks[:4]
    for c in range(block.shape[0]):
        for s in range(2):
            k, b = block[c, s], start[c, s]
            if k >= where.size:
                out[b] = 1.0
                if sizes[k] == 2:
                    out[b + 3] = -1.0
            elif k >= 0:
                a, n, ny = old[c, s], offset[k + 1] - offset[k], sizes[k]
                for i in range(3):
                    for j in range(ny):
                        if where[k] < 0:
                            out[b + i * ny + j] = H[a + i * n + j]
                        else:
                            for l in range(n):
                                out[b + i * ny + j] += H[a + i * n + l] * z[where[k] + l * ny + j]


@kernel
def reduce_rows(blocks, bases, z_start, z, pressed, clutch):
    """Factors in the coordinates y that constraints leave free, v = Z y, followed by the coordinates of clutches.

    Block bases[i] has Z (n, ny) with Zᵀ M Z = I at z[z_start[i]:z_start[i + 1]]. Row pressed[i] has the clutch
    clutch[:, i]: its pressing impulse, and speed and mobility of its rotor. The row gets a block of its own as its side
    1. The block has a pressed coordinate, with the mobility of the slipping coordinate and with the normal velocity
    -press times that mobility; and the coordinate of the rotor, if the rotor is mobile. Returns the new blocks, the
    index where Z of each block begins in z (-1: Z is I), and the velocities.
    """
    offset, block, start, H, m_start, m, minv = blocks
    nb, nc, np_ = offset.size - 1, block.shape[0], pressed.size
    where, sizes = np.full(nb, -1, np.int64), np.ones(nb + np_, np.int64)
    for k in range(nb):
        sizes[k] = offset[k + 1] - offset[k]
    for i in range(bases.size):
        where[bases[i]] = z_start[i]
        sizes[bases[i]] = (z_start[i + 1] - z_start[i]) // sizes[bases[i]]
    for i in range(np_):
        sizes[nb + i] = 2 if clutch[2, i] > 0.0 else 1
    new_offset, new_m_start = np.zeros(nb + np_ + 1, np.int64), np.zeros(nb + np_ + 1, np.int64)
    for k in range(nb + np_):
        new_offset[k + 1], new_m_start[k + 1] = new_offset[k] + sizes[k], new_m_start[k] + sizes[k] * sizes[k]
    new_m, new_minv = np.zeros(new_m_start[-1]), np.zeros(new_m_start[-1])
    for k in range(nb):
        first, n = new_m_start[k], sizes[k]
        if where[k] < 0:
            copy(m[m_start[k] : m_start[k] + n * n], new_m[first:])
            copy(minv[m_start[k] : m_start[k] + n * n], new_minv[first:])
        else:
            for j in range(n):
                new_m[first + j * n + j] = new_minv[first + j * n + j] = 1.0
    new_block, new_start, velocity = block.copy(), np.empty_like(start), np.zeros(3 * nc)
    for i in range(np_):
        c, k = pressed[i], block[pressed[i], 0]
        n, row = offset[k + 1] - offset[k], start[pressed[i], 0] + offset[k + 1] - offset[k]
        mobility = clutch[2, i]
        for a in range(n):
            for b in range(n):
                mobility += H[row + a] * minv[m_start[k] + a * n + b] * H[row + b]
        if mobility <= 0.0:  # a joint that cannot move
            mobility = 1.0
        new_block[c, 1] = nb + i
        velocity[3 * c], velocity[3 * c + 1] = -clutch[0, i] * mobility, -clutch[1, i]
        first = new_m_start[nb + i]
        new_m[first], new_minv[first] = 1.0 / mobility, mobility
        if clutch[2, i] > 0.0:
            new_m[first + 3], new_minv[first + 3] = 1.0 / clutch[2, i], clutch[2, i]
    size = 0
    for c in range(nc):
        for s in range(2):
            new_start[c, s] = size
            if new_block[c, s] >= 0:
                size += 3 * sizes[new_block[c, s]]
    new_H = np.zeros(size)
    reduce_jacobian(blocks, where, z, sizes, new_block, new_start, new_H)
    return (new_offset, new_block, new_start, new_H, new_m_start[:-1], new_m, new_minv), where, velocity


@no_alloc
def expand(offset, z_start, z, new_offset, y, v):
    """Velocity v = Z y, block by block, written into v (n,)."""
    for k in range(offset.size - 1):
        o, n, p, ny = offset[k], offset[k + 1] - offset[k], new_offset[k], new_offset[k + 1] - new_offset[k]
        for i in range(n):
            if z_start[k] < 0:
                v[o + i] = y[p + i]
            else:
                total = 0.0
                for j in range(ny):
                    total += z[z_start[k] + i * ny + j] * y[p + j]
                v[o + i] = total
