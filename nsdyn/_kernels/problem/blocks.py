"""Products with H and M⁻¹ in block form, the diagonal of W = Hᵀ M⁻¹ H, islands.

``blocks`` is a plain tuple (offset, block, start, H, m_start, m, minv) in the order of
`nsdyn.problem.blocks.DelassusFactors`, since passing a named tuple takes twice as long. Coordinates come in blocks (a
free body: 6, an articulated tree: its nv). Contact c couples at most two blocks, ``block[c, s]`` (-1: none), and
``H[start[c, s]:]`` holds the 3 x n rows of Hᵀ for that block, row by row. ``m`` and ``minv`` hold the n x n diagonal
blocks of M and M⁻¹, block k from ``m_start[k]`` on.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.cones import largest_eigenvalue, measures
from nsdyn._kernels.vectors import adjugate, square

SMALLEST, LARGEST = 1e-150, 1e150
"""Range of numbers whose squares are in the range of floating-point numbers."""

SINGULAR = 1e-12
"""Determinant of W_cc over its trace³ that is round-off."""


@no_alloc
def relative_velocity_of(blocks, v, c):
    """Return Hᵀ v of contact c: three scalars."""
    offset, block, start, H = blocks[:4]
    u0, u1, u2 = 0.0, 0.0, 0.0
    for s in range(2):
        k = block[c, s]
        if k >= 0:
            # Unsigned indices spare the test for negative ones, a third of the time.
            o, n, a = np.uint64(offset[k]), np.uint64(offset[k + 1] - offset[k]), np.uint64(start[c, s])
            d, e = a + n, a + n + n
            for j in range(n):
                x = v[o + j]
                u0 += H[a + j] * x
                u1 += H[d + j] * x
                u2 += H[e + j] * x
    return u0, u1, u2


@no_alloc
def relative_velocity(blocks, v, u):
    """Write Hᵀ v into u (3 nc,)."""
    for c in range(blocks[1].shape[0]):
        u[3 * c], u[3 * c + 1], u[3 * c + 2] = relative_velocity_of(blocks, v, c)


@no_alloc
def add_momentum(blocks, c, r0, r1, r2, p):
    """Add H r of contact c to p (n,)."""
    if r0 == 0.0 and r1 == 0.0 and r2 == 0.0:
        return
    offset, block, start, H = blocks[:4]
    for s in range(2):
        k = block[c, s]
        if k >= 0:
            o, n, a = np.uint64(offset[k]), np.uint64(offset[k + 1] - offset[k]), np.uint64(start[c, s])
            d, e = a + n, a + n + n
            for j in range(n):
                p[o + j] += H[a + j] * r0 + H[d + j] * r1 + H[e + j] * r2


@no_alloc
def momentum(blocks, r, p):
    """Write H r into p (n,)."""
    p[:] = 0.0
    for c in range(blocks[1].shape[0]):
        add_momentum(blocks, c, r[3 * c], r[3 * c + 1], r[3 * c + 2], p)


@no_alloc
def block_product(offset, m_start, m, x, y):
    """Write diag(m) x into y (n,), for the block-diagonal matrix m (M or M⁻¹)."""
    for k in range(offset.size - 1):
        o, n, row = np.uint64(offset[k]), np.uint64(offset[k + 1] - offset[k]), np.uint64(m_start[k])
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += m[row + j] * x[o + j]
            y[o + i] = total
            row += n


@kernel
def weighted_rows(blocks):
    """Return the rows of (M⁻¹ H)ᵀ in the layout of H."""
    offset, block, start, H, m_start, _, minv = blocks
    y = np.empty_like(H)
    for c in range(block.shape[0]):
        for s in range(2):
            k = block[c, s]
            if k >= 0:
                n = offset[k + 1] - offset[k]
                for i in range(3):
                    row = start[c, s] + i * n
                    y[row : row + n] = 0.0  # contacts may share their rows
                    for l in range(n):
                        x = H[row + l]
                        if x != 0.0:
                            base = m_start[k] + l * n
                            for j in range(n):
                                y[row + j] += x * minv[base + j]
    return y


@no_alloc
def respond(blocks, r, p, v):
    """Write p = H r and v = M⁻¹ p into p and v (n,)."""
    offset, _, _, _, m_start, _, minv = blocks
    momentum(blocks, r, p)
    block_product(offset, m_start, minv, p, v)


@no_alloc
def velocity(blocks, q, r, y, u, work):
    """Write y = M⁻¹ H r and u = Hᵀ y + q into y (n,) and u (3 nc,); `work` (n,) holds H r."""
    respond(blocks, r, work, y)
    relative_velocity(blocks, y, u)
    for i in range(q.size):
        u[i] += q[i]


@kernel
def judged(blocks, q, mu, scales, r, u):
    """Write u = Hᵀ M⁻¹ H r + q into u, and return the two `measures` of r."""
    y, work = np.empty(blocks[0][-1]), np.empty(blocks[0][-1])
    velocity(blocks, q, r, y, u, work)
    return measures(scales, u, r, mu)


@no_alloc
def in_range(scales):
    """Whether the sizes of all diagonal blocks are in the valid range."""
    good = True
    for c in range(scales.size):
        good = good and SMALLEST <= scales[c] <= LARGEST
    return good


@no_alloc
def size_of(q, mu):
    """Return the norm of q, and whether q and mu are valid."""
    total, good = 0.0, True
    for c in range(mu.size):
        for i in range(3):
            total += square(q[3 * c + i])
        good = good and 0.0 <= mu[c] < np.inf
    return math.sqrt(total), good and total < np.inf


@no_alloc
def diagonal_block(blocks, c, rows, x, y, w):
    """Write W_cc of a contact into w (3, 3), without assembling W: its first `rows` rows, or all 3.

    Return the largest change of a coordinate by a unit impulse along the normal. x and y (3, n) are work arrays.
    """
    offset, block, start, H, m_start, _, minv = blocks
    w[:], most = 0.0, 0.0
    twice = block[c, 0] == block[c, 1]  # both sides on one block: add their rows
    for s in range(1 if twice else 2):
        k = block[c, s]
        if k < 0:
            continue
        n = offset[k + 1] - offset[k]
        for i in range(3):
            for j in range(n):
                x[i, j] = H[start[c, s] + i * n + j] + (H[start[c, 1] + i * n + j] if twice else 0.0)
        for i in range(rows):
            for j in range(n):
                y[i, j] = 0.0
            for l in range(n):
                f, base = x[i, l], m_start[k] + l * n
                if f != 0.0:
                    for j in range(n):
                        y[i, j] += f * minv[base + j]
        for i in range(rows):
            for j in range(i, 3):
                total = 0.0
                for l in range(n):
                    total += y[i, l] * x[j, l]
                w[i, j] += total
        for j in range(n):
            most = max(most, abs(y[0, j]))
    w[1, 0], w[2, 0], w[2, 1] = w[0, 1], w[0, 2], w[1, 2]
    return most


@no_alloc
def widest(offset):
    """Return the number of coordinates of the largest block."""
    most = 0
    for k in range(offset.size - 1):
        most = max(most, offset[k + 1] - offset[k])
    return most


@kernel
def dependent(blocks, c):
    """Whether the rows of contact c are linearly dependent, as those between two links that few joints part."""
    most = widest(blocks[0])
    x, y, W = np.empty((3, most)), np.empty((3, most)), np.empty((3, 3))
    diagonal_block(blocks, c, 3, x, y, W)
    _, determinant = adjugate(W)
    trace = W[0, 0] + W[1, 1] + W[2, 2]
    return determinant <= SINGULAR * trace * trace * trace


@kernel
def delassus_scales(blocks, least, gap, out):
    """Write lambda_max of every diagonal block W_cc into out (nc,); 0 if no motion opens or closes the contact.

    None does if an impulse along the normal changes a coordinate by 1 rad or m before it opens the contact by `least`
    m, or by the overlap that the gaps (some of nc,) give.
    """
    most = widest(blocks[0])
    x, y, w = np.empty((3, most)), np.empty((3, most)), np.empty((3, 3))
    for c in range(out.size):
        turn, arm = diagonal_block(blocks, c, 3, x, y, w), least
        if c < gap.size:
            arm = max(arm, -gap[c])
        out[c] = 0.0 if arm > 0.0 and w[0, 0] <= arm * turn else largest_eigenvalue(w)


@no_alloc
def unite(parent, a, b):
    """Join the components of a and b in a union-find forest; the smaller root stays."""
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    while parent[b] != b:
        parent[b] = parent[parent[b]]
        b = parent[b]
    if a < b:
        parent[b] = a
    else:
        parent[a] = b


@no_alloc
def number(parent, label):
    """Number the components of a union-find forest by their first members, into label; return how many.

    The forest is built by `unite`.
    """
    found = 0
    for k in range(label.size):
        root = k
        while parent[root] != root:
            root = parent[root]
        if root == k:
            label[k] = found
            found += 1
        else:
            label[k] = label[root]
    return found


@kernel
def islands(block, count, label):
    """Find the islands of contacts; write them into label (nc,) and return how many.

    Contacts that share one of the `count` blocks are connected. Labels ascend in the order of the first contacts.
    """
    parent, first = np.arange(label.size), np.full(count, -1, np.int64)
    for c in range(label.size):
        for s in range(2):
            k = block[c, s]
            if k >= 0 and first[k] < 0:
                first[k] = c
            elif k >= 0:
                unite(parent, first[k], c)
    return number(parent, label)
