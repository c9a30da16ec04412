"""Contacts at which Coulomb's law may have other solutions, or none that is a force."""

import math

import numpy as np

from nsdyn._kernels.compiled import in_place


@in_place
def stopped(q, u, r, nc):
    """(most |q_N|, most |u_T - q_T|) of the first nc contacts that are pressed, m/s."""
    load = change = 0.0
    for c in range(nc):
        i = 3 * c
        if r[i] > 0.0:
            load = max(load, abs(q[i]))
            change = max(change, math.sqrt((u[i + 1] - q[i + 1]) ** 2 + (u[i + 2] - q[i + 2]) ** 2))
    return load, change


@in_place
def _product(blocks, c, s, n, i, j):
    """Rows i and j of what block s, of n coordinates, adds to W_cc."""
    _, block, start, H, m_start, _, minv = blocks
    k = block[c, s]
    a, b, total = start[c, s] + i * n, start[c, s] + j * n, 0.0
    for p in range(n):
        x = H[a + p]
        if x != 0.0:
            base = m_start[k] + p * n
            for q in range(n):
                total += x * minv[base + q] * H[b + q]
    return total


@in_place
def coupled(blocks, mu, out):
    """W_NN - μ|W_NT| of every contact, into out (nc,), 1/kg; returns the least.

    Where it is negative friction presses the contact on faster than the normal impulse opens it.
    """
    offset, block = blocks[0], blocks[1]
    least = np.inf
    for c in range(mu.size):
        normal = first = second = 0.0
        for s in range(2):
            if block[c, s] >= 0:
                n = offset[block[c, s] + 1] - offset[block[c, s]]
                normal += _product(blocks, c, s, n, 0, 0)
                if mu[c] > 0.0:
                    first += _product(blocks, c, s, n, 0, 1)
                    second += _product(blocks, c, s, n, 0, 2)
        out[c] = normal - mu[c] * math.sqrt(first * first + second * second)
        least = min(least, out[c])
    return least
