"""LU factorisation of a dense matrix that skips the zeros outside its profile: chains and stacks have narrow ones."""

import numpy as np

from nsdyn._kernels.compiled import no_alloc


@no_alloc
def factorise(S, pivot, low, end):
    """Factorise S (n, n) in place by LU with partial pivoting; False when S is singular or not finite.

    Zeros outside the profile are skipped: row k eliminates rows k + 1 to `low[k]`, and ends at `end[k]`.
    """
    n = pivot.size
    for i in range(n):
        low[i] = end[i] = i + 1
    for i in range(n):
        for j in range(n):
            if S[i, j] != 0.0:
                end[i] = max(end[i], j + 1)
                low[j] = max(low[j], i + 1)
    for k in range(n):
        if k > 0:
            low[k] = max(low[k], low[k - 1])
        p, largest = k, abs(S[k, k])
        for i in range(k + 1, low[k]):
            if abs(S[i, k]) > largest:
                p, largest = i, abs(S[i, k])
        if not (0.0 < largest < np.inf):
            return False
        pivot[k] = p
        if p != k:
            end[k], end[p] = max(end[k], end[p]), max(end[k], end[p])
            for j in range(k, end[k]):
                S[k, j], S[p, j] = S[p, j], S[k, j]
        last, inverse = end[k], 1.0 / S[k, k]
        for i in range(k + 1, low[k]):
            if S[i, k] != 0.0:
                f = S[i, k] * inverse
                S[i, k] = f
                end[i] = max(end[i], last)
                # Unsigned indices spare the test for negative ones, a third of the time.
                row, top = np.uint64(i), np.uint64(k)
                for j in range(np.uint64(k + 1), np.uint64(last)):
                    S[row, j] -= f * S[top, j]
    return True


@no_alloc
def substitute(S, pivot, low, end, b):
    """Solve the factorised system in place of b."""
    n = pivot.size
    for k in range(n):
        p = pivot[k]
        b[k], b[p] = b[p], b[k]
        for i in range(k + 1, low[k]):
            b[i] -= S[i, k] * b[k]
    for i in range(n - 1, -1, -1):
        total = b[i]
        for j in range(i + 1, end[i]):
            total -= S[i, j] * b[j]
        b[i] = total / S[i, i]
