"""Anderson's acceleration (type II) of a fixed point x = G(x)."""

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.linear import factorise, substitute


@kernel
def mix(F, G, gram, slot, used, x):
    """The combination of past G(x) whose defects f = G(x) - x, alike combined, are least, into x (n,).

    The first `used` rows of F and G (m, n) hold them, the newest in row `slot`; gram (m, m) keeps F Fᵀ, of which row
    and column `slot` are renewed. Where they all changed alike, to round-off, they are no basis: x = G of the newest.
    """
    f, g = F[slot], G[slot]
    for j in range(used):
        total = 0.0
        for i in range(f.size):
            total += F[j, i] * f[i]
        gram[j, slot] = gram[slot, j] = total
    x[:] = g
    if used < 2:
        return
    A, b = np.zeros((used - 1, used - 1)), np.empty(used - 1)
    trace = 0.0
    for i in range(used - 1):
        p = i if i < slot else i + 1
        b[i] = gram[slot, slot] - gram[p, slot]
        for j in range(used - 1):
            o = j if j < slot else j + 1
            A[i, j] = gram[p, o] - gram[p, slot] - gram[o, slot] + gram[slot, slot]
        trace += A[i, i]
    for i in range(used - 1):
        A[i, i] += 1e-10 * trace + 1e-300
    pivot, low, end = np.empty((3, used - 1), np.int64)
    if not factorise(A, pivot, low, end):
        return
    substitute(A, pivot, low, end, b)
    if np.abs(b).max() > 1e4:
        return
    for i in range(used - 1):
        p = i if i < slot else i + 1
        for l in range(f.size):
            x[l] += b[i] * (G[p, l] - g[l])
