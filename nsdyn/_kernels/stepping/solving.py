"""Which impulses of a move are sought once more: of islands that slip otherwise, turn otherwise or end elsewhere."""

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.stepping.law import reconsider

PASSES = 8
"""Most times that the impulses of a move are sought once more, with other slip, couples and gaps. Each makes what is
left of the latter smaller by about h ω; slip is, after the first, only changed where it would be turned round."""


@kernel
def concerned(blocks, some):
    """Rows in islands of which a row is among `some` (rows,), shape (rows,)."""
    label, out = np.empty(some.size, np.int64), np.empty(some.size, np.bool_)
    islands = np.zeros(_blocks.islands(blocks[1], blocks[0].size - 1, label), np.bool_)
    for c in range(some.size):
        if some[c]:
            islands[label[c]] = True
    for c in range(some.size):
        out[c] = islands[label[c]]
    return out


@kernel
def thaw(blocks, some, before, after):
    """Leave (r, u) as they were `before`, in after, in the islands of which no row is among `some` (rows,)."""
    anew = concerned(blocks, some)
    for c in range(some.size):
        if not anew[c]:
            for i in range(3 * c, 3 * c + 3):
                after[0][i], after[1][i] = before[0][i], before[1][i]


@kernel
def update_sliding(blocks, solution, local, sliding, back, some, out):
    """`law.reconsider` contacts of the islands of which a row is among `some` (rows,), of all if that is empty.

    Into out (nc,) which slide otherwise than before; whether any does.
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
