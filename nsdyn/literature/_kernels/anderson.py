"""Anderson's acceleration (type II) of a fixed point x = G(x)."""

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc


@no_alloc
def products(F, f, used, out):
    """Compute F_j · f for the first `used` rows of F, into out."""
    ends = f.size // 4 * 4
    for j in range(used):
        a, b, c, d = 0.0, 0.0, 0.0, 0.0  # four partial sums: in a single sum each addition waits for the last one
        for i in range(0, ends, 4):
            a += F[j, i] * f[i]
            b += F[j, i + 1] * f[i + 1]
            c += F[j, i + 2] * f[i + 2]
            d += F[j, i + 3] * f[i + 3]
        for i in range(ends, f.size):
            a += F[j, i] * f[i]
        out[j] = a + b + c + d


@kernel
def mix(F, G, gram, slot, used, x):
    """Combine past G(x), with weights for which the combined defect f = G(x) - x is smallest, into x (n,).

    The first `used` rows of F and G (m, n) hold defects and G(x), the newest in row `slot`. gram (m, m) keeps F Fᵀ; its
    row and column `slot` are updated. If all defects changed alike, to round-off, they are no basis: x is the newest G.
    """
    g, own = G[slot], gram[slot]
    products(F, F[slot], used, own)
    for j in range(used):
        gram[j, slot] = own[j]
    x[:] = g
    if used < 2:
        return
    # Normal equations of the differences from the newest, the right side in the last column
    n = used - 1
    A = np.empty((n, used))
    trace = 0.0
    for i in range(n):
        p = i if i < slot else i + 1
        A[i, n] = own[slot] - own[p]
        for j in range(i, n):
            o = j if j < slot else j + 1
            A[i, j] = gram[p, o] - own[p] - own[o] + own[slot]
        trace += A[i, i]
    for i in range(n):
        A[i, i] += 1e-10 * trace + 1e-300
    # Cholesky's elimination in the upper half
    for k in range(n):
        if not A[k, k] > 0.0:
            return
        for i in range(k + 1, n):
            f = A[k, i] / A[k, k]
            for j in range(i, used):
                A[i, j] -= f * A[k, j]
    for k in range(n - 1, -1, -1):
        b = A[k, n]
        for j in range(k + 1, n):
            b -= A[k, j] * A[j, n]
        A[k, n] = b / A[k, k]
        if not abs(A[k, n]) <= 1e4:
            return
    for i in range(n):
        p = i if i < slot else i + 1
        for l in range(g.size):
            x[l] += A[i, n] * (G[p, l] - g[l])
