"""Reductions of short arrays, for which NumPy takes ten times as long, and copies.

A slice that is set to an array makes numba compile the text of an error message, which takes two seconds.
"""

import math

from nsdyn._kernels.compiled import no_alloc


@no_alloc
def any_below(x, most):
    """Whether an entry is at most so large."""
    for i in range(x.size):
        if x[i] <= most:
            return True
    return False


@no_alloc
def least(x):
    """The smallest entry, or 0 if none is negative."""
    out = 0.0
    for i in range(x.size):
        out = min(out, x[i])
    return out


@no_alloc
def most(x):
    """The largest entry, or 0 if none is positive."""
    out = 0.0
    for i in range(x.size):
        out = max(out, x[i])
    return out


@no_alloc
def largest(x):
    """The largest magnitude, or nan if there is one."""
    out = 0.0
    for i in range(x.size):
        if not abs(x[i]) <= out:
            out = abs(x[i])
            if math.isnan(out):
                return out
    return out


@no_alloc
def copy(x, out):
    """The entries of x (n,), into the first of out."""
    for i in range(x.size):
        out[i] = x[i]
