"""Sorting: numba's own sorts take seconds to compile, and again for every kernel that calls them."""

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc


@kernel
def order(keys):
    """Indices that sort an array; equal entries keep their order (merge sort, bottom up)."""
    n = keys.size
    now, merged = np.arange(n), np.empty(n, np.int64)
    width = 1
    while width < n:
        for low in range(0, n, 2 * width):
            i, middle, high = low, min(low + width, n), min(low + 2 * width, n)
            j = middle
            for k in range(low, high):
                if i < middle and (j >= high or keys[now[i]] <= keys[now[j]]):
                    merged[k] = now[i]
                    i += 1
                else:
                    merged[k] = now[j]
                    j += 1
        now, merged = merged, now
        width *= 2
    return now


@kernel
def among(x, some, out):
    """For each entry of x (n,), write into out (n,) whether it is in `some`."""
    codes = some[order(some)]
    for k in range(x.size):
        at = place_of(codes, x[k])
        out[k] = at < codes.size and codes[at] == x[k]


@no_alloc
def place_of(codes, code):
    """Count the entries of a sorted array that are less than `code`."""
    low, high = 0, codes.size
    while low < high:
        middle = (low + high) // 2
        if codes[middle] < code:
            low = middle + 1
        else:
            high = middle
    return low
