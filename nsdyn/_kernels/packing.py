"""Many arrays as two, one of floats and one of integers: each array handed to a kernel costs a twentieth of a µs.

The integers begin with where the arrays of floats begin in theirs, then where the arrays of integers do.
"""

import numpy as np

from nsdyn._kernels.compiled import kernel


def pack(floats, integers):
    """(float64 array, int64 array) of copies of all arrays, and views of them in their shapes, in two lists."""
    head = len(floats) + len(integers) + 2
    begins = np.cumsum([0, *(a.size for a in floats)]), head + np.cumsum([0, *(a.size for a in integers)])
    both = np.concatenate([[], *map(np.ravel, floats)]), np.concatenate([*begins, *map(np.ravel, integers)])
    views = []
    for out, ends, arrays in zip(both, begins, (floats, integers), strict=True):
        at = ends.tolist()
        views.append([out[a:b].reshape(given.shape) for a, b, given in zip(at, at[1:], arrays, strict=False)])
    return *both, *views


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
