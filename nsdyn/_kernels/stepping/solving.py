"""Islands of a move whose impulses are solved once more: their slip, couples or end gaps differ from the foreseen."""

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem.cones import measures
from nsdyn._kernels.stepping.law import reconsider

PASSES = 8
"""Most times that the impulses of a move are solved once more, with corrected slip, couples and gaps. Each pass reduces
the remaining error of couples and gaps by a factor of about h ω. After the first pass slip is only corrected where it
would be reversed."""


@kernel
def concerned(blocks, some):
    """Rows of islands with at least one row in `some` (rows,), shape (rows,)."""
    label, out = np.empty(some.size, np.int64), np.empty(some.size, np.bool_)
    islands = np.zeros(_blocks.islands(blocks[1], blocks[0].size - 1, label), np.bool_)
    for c in range(some.size):
        if some[c]:
            islands[label[c]] = True
    for c in range(some.size):
        out[c] = islands[label[c]]
    return out


@kernel
def residuals(blocks, sizes, answer, worst, enough, out):
    """Residual of the island of each row, m/s, into out (rows,): what one leaves does not count in others.

    sizes = (scales, mu) of the rows, answer = (r, u). Where the `worst` residual is `enough` for all it stands for all.
    """
    out[:] = worst
    if worst <= enough:
        return
    (scales, mu), (r, u), label = sizes, answer, np.empty(out.size, np.int64)
    most = np.zeros(_blocks.islands(blocks[1], blocks[0].size - 1, label))
    for c in range(out.size):
        one, three = slice(c, c + 1), slice(3 * c, 3 * c + 3)
        most[label[c]] = max(most[label[c]], measures(scales[one], u[three], r[three], mu[one])[1])
    for c in range(out.size):
        out[c] = most[label[c]]


@kernel
def thaw(blocks, some, before, after):
    """Restore (r, u) from `before` into `after` in the islands without a row in `some` (rows,)."""
    anew = concerned(blocks, some)
    for c in range(some.size):
        if not anew[c]:
            for i in range(3 * c, 3 * c + 3):
                after[0][i], after[1][i] = before[0][i], before[1][i]


@kernel
def update_sliding(blocks, solution, local, sliding, back, some, out):
    """Apply `law.reconsider` to islands with a row in `some` (rows,), to all islands if `some` is empty.

    Into out (nc,) the contacts whose `sliding` changed; whether any did.
    """
    nc, found = sliding.size, False
    for c in range(nc):
        out[c] = sliding[c]
    if reconsider(solution, local, sliding, back) and some.size > 0:
        anew = concerned(blocks, some)
        for c in range(nc):
            if not anew[c]:
                sliding[c] = out[c]
    for c in range(nc):
        out[c] = sliding[c] != out[c]
        found = found or out[c]
    return found
