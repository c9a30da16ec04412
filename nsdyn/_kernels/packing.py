"""Many arrays packed into two, one of floats and one of integers.

Each array passed to a kernel costs a twentieth of a µs. The array of integers begins with the start of each array of
floats, then the start of each array of integers.
"""

import numpy as np

from nsdyn._kernels.compiled import kernel


def pack(floats, integers):
    """Copies of all arrays as a float64 and an int64 array, and two lists of views of them in the original shapes."""
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
    """View of array k of floats, with shape (n,)."""
    return floats[integers[k] : integers[k + 1]]


@kernel(inline="always")
def triples(floats, integers, k):
    """View of array k of floats, with shape (n, 3)."""
    flat = floats[integers[k] : integers[k + 1]]
    return flat.reshape((flat.size // 3, 3))


@kernel(inline="always")
def matrices(floats, integers, k):
    """View of array k of floats, with shape (n, 3, 3)."""
    flat = floats[integers[k] : integers[k + 1]]
    return flat.reshape((flat.size // 9, 3, 3))


@kernel(inline="always")
def indices(integers, k, floats):
    """View of array k of integers; `floats` is the number of arrays of floats in the same pack."""
    at = floats + 1 + k
    return integers[integers[at] : integers[at + 1]]
