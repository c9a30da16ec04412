"""Reductions of short arrays, for which NumPy takes ten times as long, and copies.

Copies are loops: assigning an array to a slice makes numba compile the text of an error message, which takes 2 s.
"""

import math

from nsdyn._kernels.compiled import no_alloc


@no_alloc
def any_below(x, most):
    """True if any entry is at most `most`."""
    for i in range(x.size):
        if x[i] <= most:
            return True
    return False


@no_alloc
def least(x):
    """Smallest entry, or 0 if none is negative."""
    out = 0.0
    for i in range(x.size):
        out = min(out, x[i])
    return out


@no_alloc
def most(x):
    """Largest entry, or 0 if none is positive."""
    out = 0.0
    for i in range(x.size):
        out = max(out, x[i])
    return out


@no_alloc
def largest(x):
    """Largest magnitude, or nan if any entry is nan."""
    out = 0.0
    for i in range(x.size):
        if not abs(x[i]) <= out:
            out = abs(x[i])
            if math.isnan(out):
                return out
    return out


@no_alloc
def copy(x, out):
    """Copy the entries of x (n,) into the first entries of out."""
    for i in range(x.size):
        out[i] = x[i]
