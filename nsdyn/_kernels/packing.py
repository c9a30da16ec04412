"""Many arrays as two, one of floats and one of integers: what a kernel gets in every call is handed over in no time.

Each array costs a twentieth of a microsecond, which is as much as a small kernel takes for everything. The integers
begin with where the arrays of floats begin in theirs, then where the arrays of integers do.
"""

import numpy as np

from nsdyn._kernels.compiled import kernel


def pack(floats, integers):
    """(float64 array, int64 array) of copies of all arrays, and views of them in their shapes, in two lists."""
    both = []
    head = len(floats) + len(integers) + 2
    begins = np.cumsum([0, *(a.size for a in floats)]), head + np.cumsum([0, *(a.size for a in integers)])
    for arrays, ends, dtype in ((floats, begins[0], np.float64), (integers, begins[1], np.int64)):
        out, at = np.empty(ends[-1], dtype), ends.tolist()
        np.concatenate([np.empty(0, dtype), *(a.ravel() for a in arrays)], out=out[at[0] :])
        both.append((out, [out[a:b].reshape(given.shape) for a, b, given in zip(at, at[1:], arrays, strict=False)]))
    both[1][0][:head] = np.concatenate(begins)
    return both[0][0], both[1][0], both[0][1], both[1][1]


@kernel(inline="always")
def numbers(floats, integers, k):
    """Array k of floats, of shape (n,)."""
    return floats[integers[k] : integers[k + 1]]


@kernel(inline="always")
def triples(floats, integers, k):
    """Array k of floats, of shape (n, 3)."""
    flat = floats[integers[k] : integers[k + 1]]
    return flat.reshape((flat.size // 3, 3))


@kernel(inline="always")
def matrices(floats, integers, k):
    """Array k of floats, of shape (n, 3, 3)."""
    flat = floats[integers[k] : integers[k + 1]]
    return flat.reshape((flat.size // 9, 3, 3))


@kernel(inline="always")
def indices(integers, k, floats):
    """Array k of integers, beside so many of floats."""
    at = floats + 1 + k
    return integers[integers[at] : integers[at + 1]]
