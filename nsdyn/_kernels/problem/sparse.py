"""Matrix K = M + Σ H_c A_c H_cᵀ of Newton's methods: its entries, sparse or dense."""

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc


@kernel
def dense_pattern(offset, block):
    """Return the places of entries of a dense K, as `nsdyn.problem.operators.pattern` does for a sparse K.

    The result is (indptr, slot, diagonal).
    """
    n, nc = offset[-1], block.shape[0]
    slot = np.full((nc, 2, 2), -1, np.int64)
    for c in range(nc):
        for s in range(2):
            for t in range(2):
                if block[c, s] >= 0 and block[c, t] >= 0:
                    slot[c, s, t] = offset[block[c, s]]
    return n * np.arange(n), slot, offset


@no_alloc
def assemble(blocks, A, indptr, begin, slot, diagonal, data):
    """Write K = M + Σ H_c A_c H_cᵀ into data, in the layout given; block k begins at begin[k]."""
    offset, block, start, H, m_start, m, _ = blocks
    data[:] = 0.0
    for k in range(offset.size - 1):
        o, n = begin[k], offset[k + 1] - offset[k]
        for i in range(n):
            at, row = indptr[o + i] + diagonal[k], m_start[k] + i * n
            for j in range(n):
                data[at + j] = m[row + j]
    for c in range(block.shape[0]):
        a = A[c]
        rubs = a[1, 1] != 0.0 or a[2, 2] != 0.0  # else only its normal row counts
        if a[0, 0] == 0.0 and not rubs:
            continue
        for s in range(2):
            k = block[c, s]
            if k < 0:
                continue
            ok, nk, hk = begin[k], offset[k + 1] - offset[k], start[c, s]
            for t in range(2):
                l = block[c, t]
                if l < 0:
                    continue
                nl, hl, shift = offset[l + 1] - offset[l], start[c, t], slot[c, t, s]
                used, end = nl, hl + nl
                while nl > 6 and used > 0 and H[end - 1] == H[end + nl - 1] == H[end + 2 * nl - 1] == 0.0:
                    used, end = used - 1, end - 1  # in a tree, joints beyond a link do not move it
                # Views: their indices need no test for negative ones, and loops along them become vector instructions.
                h0, h1 = H[hl : hl + used], H[hl + nl : hl + nl + used]
                h2 = H[hl + 2 * nl : hl + 2 * nl + used]
                for i in range(nk):
                    at = indptr[ok + i] + shift
                    row = data[at : at + used]
                    if not rubs:
                        y0 = H[hk + i] * a[0, 0]
                        for j in range(used):
                            row[j] += y0 * h0[j]
                        continue
                    x0, x1, x2 = H[hk + i], H[hk + nk + i], H[hk + 2 * nk + i]
                    if x0 == 0.0 and x1 == 0.0 and x2 == 0.0:
                        continue
                    y0 = x0 * a[0, 0] + x1 * a[1, 0] + x2 * a[2, 0]
                    y1 = x0 * a[0, 1] + x1 * a[1, 1] + x2 * a[2, 1]
                    y2 = x0 * a[0, 2] + x1 * a[1, 2] + x2 * a[2, 2]
                    for j in range(used):
                        row[j] += y0 * h0[j] + y1 * h1[j] + y2 * h2[j]
