"""The matrix K = M + Σ H_c A_c H_cᵀ of `newton` in compressed columns: its pattern and its entries."""

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.sorting import order, place_of


@kernel
def pattern(offset, block):
    """Sparsity of K, compressed columns: (indptr, indices, slot).

    Entry (i, j) of the coupling of block[c, s] (rows) with block[c, t] (columns) is stored at
    indptr[offset[block[c, t]] + j] + slot[c, s, t] + i; of a diagonal block k at indptr[offset[k] + j] +
    diagonal[k] + i.
    """
    nb, nc = offset.size - 1, block.shape[0]
    pairs = np.empty(nb + 2 * nc, np.int64)
    count = 0
    for k in range(nb):
        pairs[count] = k * nb + k
        count += 1
    for c in range(nc):
        a, b = block[c, 0], block[c, 1]
        if a >= 0 and b >= 0 and a != b:
            pairs[count] = a * nb + b
            pairs[count + 1] = b * nb + a
            count += 2
    pairs = pairs[:count]
    pairs = pairs[order(pairs)]
    codes = np.empty(count, np.int64)  # ascending: column block first, then row block
    found = 0
    for code in pairs:
        if found == 0 or code > codes[found - 1]:
            codes[found] = code
            found += 1
    codes = codes[:found]
    indptr = np.zeros(offset[-1] + 1, np.int32)
    place = np.empty(codes.size, np.int64)
    diagonal = np.empty(nb, np.int64)
    height = np.zeros(nb, np.int64)
    for e in range(codes.size):
        l, k = codes[e] // nb, codes[e] % nb
        place[e] = height[l]
        height[l] += offset[k + 1] - offset[k]
        if k == l:
            diagonal[k] = place[e]
    for l in range(nb):
        for j in range(offset[l], offset[l + 1]):
            indptr[j + 1] = indptr[j] + height[l]
    indices = np.empty(indptr[-1], np.int32)
    for e in range(codes.size):
        l, k = codes[e] // nb, codes[e] % nb
        for j in range(offset[l], offset[l + 1]):
            for i in range(offset[k + 1] - offset[k]):
                indices[indptr[j] + place[e] + i] = offset[k] + i
    slot = np.full((nc, 2, 2), -1, np.int64)
    for c in range(nc):
        for s in range(2):
            for t in range(2):
                if block[c, s] >= 0 and block[c, t] >= 0:
                    slot[c, s, t] = place[place_of(codes, block[c, t] * nb + block[c, s])]
    return indptr, indices, slot, diagonal


@in_place
def assemble_sparse(blocks, A, indptr, begin, slot, diagonal, data):
    """K = M + Σ H_c A_c H_cᵀ in the layout of `pattern`, where block k begins at begin[k], into data."""
    offset, block, start, H, m_start, m, _ = blocks
    data[:] = 0.0
    for k in range(offset.size - 1):
        o, n = begin[k], offset[k + 1] - offset[k]
        for j in range(n):
            for i in range(n):
                data[indptr[o + j] + diagonal[k] + i] = m[m_start[k] + i * n + j]
    for c in range(block.shape[0]):
        a = A[c]
        rubs = a[1, 1] != 0.0 or a[2, 2] != 0.0  # else it has one row
        if a[0, 0] == 0.0 and not rubs:
            continue
        for t in range(2):
            l = block[c, t]
            if l < 0:
                continue
            ol, nl, hl = begin[l], offset[l + 1] - offset[l], start[c, t]
            for j in range(nl):
                if not rubs:
                    y0 = a[0, 0] * H[hl + j]
                    for s in range(2):
                        k = block[c, s]
                        if k >= 0:
                            # Unsigned: the compiler need not ask whether an index counts from the end.
                            base, hk = np.uint64(indptr[ol + j] + slot[c, s, t]), np.uint64(start[c, s])
                            for i in range(np.uint64(offset[k + 1] - offset[k])):
                                data[base + i] += H[hk + i] * y0
                    continue
                x0, x1, x2 = H[hl + j], H[hl + nl + j], H[hl + 2 * nl + j]
                y0 = a[0, 0] * x0 + a[0, 1] * x1 + a[0, 2] * x2
                y1 = a[1, 0] * x0 + a[1, 1] * x1 + a[1, 2] * x2
                y2 = a[2, 0] * x0 + a[2, 1] * x1 + a[2, 2] * x2
                for s in range(2):
                    k = block[c, s]
                    if k < 0:
                        continue
                    nk, h0 = np.uint64(offset[k + 1] - offset[k]), np.uint64(start[c, s])
                    base, h1, h2 = np.uint64(indptr[ol + j] + slot[c, s, t]), h0 + nk, h0 + nk + nk
                    for i in range(nk):
                        data[base + i] += H[h0 + i] * y0 + H[h1 + i] * y1 + H[h2 + i] * y2


@in_place
def symmetric(A):
    """Whether every A_c is symmetric, so that K is symmetric positive definite."""
    for c in range(A.shape[0]):
        if A[c, 0, 1] != A[c, 1, 0] or A[c, 0, 2] != A[c, 2, 0] or A[c, 1, 2] != A[c, 2, 1]:
            return False
    return True
