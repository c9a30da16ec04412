"""Free bodies in coordinates with M = I: v = G v̂ with M⁻¹ = G Gᵀ.

In these coordinates Ĥ = Gᵀ H both gives the velocity of a contact, u = Ĥᵀ v̂, and applies its impulse, v̂ += Ĥ_c r.
Every body has eight numbers, two of which are zeros.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.simd import WIDTH, add, dot
from nsdyn._kernels.sorting import order as sorted_by

PAIR = np.uint64(2 * WIDTH)  # numbers in a row for both bodies
CONTACT = np.uint64(3) * PAIR

STILL = 16
"""Number of bodies that never move. They replace the missing bodies of contacts, in turn: contacts that share a single
one would have to wait for each other."""


@kernel
def independent(blocks):
    """Return an order of the contacts in which neighbours share no body if possible.

    The contacts of each body keep their order, so that a sweep gives the same result. The processor need not wait for
    one contact to begin the next.
    """
    offset, block = blocks[:2]
    last, turn = np.zeros(offset.size - 1, np.int64), np.zeros(block.shape[0], np.int64)
    for c in range(turn.size):
        for s in range(2):
            if block[c, s] >= 0:
                turn[c] = max(turn[c], last[block[c, s]])
        for s in range(2):
            if block[c, s] >= 0:
                last[block[c, s]] = turn[c] + 1
    return sorted_by(turn)


@kernel
def factors(blocks):
    """Return G, lower triangular, in the layout of M⁻¹."""
    offset, _, _, _, m_start, _, minv = blocks
    G = np.zeros_like(minv)
    for k in range(offset.size - 1):
        b = m_start[k]
        for j in range(6):
            for i in range(j, 6):
                total = minv[b + 6 * i + j]
                for l in range(j):
                    total -= G[b + 6 * i + l] * G[b + 6 * j + l]
                G[b + 6 * i + j] = math.sqrt(total) if i == j else total / G[b + 7 * j]
    return G


@kernel
def unit_rows(blocks, G, mu, order):
    """Return the rows of Ĥᵀ, (nc, 3, 2, 8) made flat, the places of the bodies in v̂ (nc, 2), and v̂ = 0.

    Rows are in the `order` of the contacts, and zero for a missing body. Contacts without friction have one row and
    zeros.
    """
    offset, block, start, H, m_start, _, _ = blocks
    out, body = np.zeros((block.shape[0], 3, 2, WIDTH)), np.empty((block.shape[0], 2), np.uint64)
    for e in range(order.size):
        c = order[e]
        for s in range(2):
            k = block[c, s]
            body[e, s] = WIDTH * (k if k >= 0 else offset.size - 1 + e % STILL)
            if k >= 0:
                for i in range(3 if mu[c] > 0.0 else 1):
                    for l in range(6):
                        x = H[start[c, s] + 6 * i + l]
                        for j in range(l + 1):
                            out[e, i, s, j] += x * G[m_start[k] + 6 * l + j]
    return out.reshape(-1), body, np.zeros(WIDTH * (offset.size - 1 + STILL))


@no_alloc(inline="always")
def read(rows, c, body, v):
    """Return Ĥ_cᵀ v̂: normal, first and second tangent."""
    # Unsigned indices spare the test for negative ones.
    o, a, b = CONTACT * np.uint64(c), body[c, 0], body[c, 1]
    return dot(rows, o, v, a, b), dot(rows, o + PAIR, v, a, b), dot(rows, o + PAIR + PAIR, v, a, b)


@no_alloc(inline="always")
def apply(z, rows, c, body, v):
    """Add Ĥ_c z to v̂, z = (z_N, z_T1, z_T2) or (z_N,)."""
    add(z, rows, CONTACT * np.uint64(c), v, body[c, 0], body[c, 1])


@no_alloc
def diagonal(rows, c, w):
    """Write W_cc = Ĥ_cᵀ Ĥ_c into w (3, 3)."""
    first = 6 * WIDTH * c
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for l in range(2 * WIDTH):
                total += rows[first + 2 * WIDTH * i + l] * rows[first + 2 * WIDTH * j + l]
            w[i, j] = w[j, i] = total
