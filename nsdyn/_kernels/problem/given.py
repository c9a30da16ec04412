"""Products with a W given in 3 x 3 blocks: (rows `indptr`, columns `indices`, blocks `data` (nnz, 3, 3))."""

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.vectors import along, three
from nsdyn._kernels.vectors import to_world as product


@no_alloc
def velocity_of(W, q, r, c):
    """Return u_c = (W r + q)_c of contact c: three scalars."""
    indptr, indices, data = W
    u = three(q, 3 * c)
    for p in range(indptr[c], indptr[c + 1]):
        u = along(u, 1.0, product(data, p, three(r, 3 * indices[p])))
    return u


@no_alloc
def velocity(W, q, r, u):
    """Write W r + q into u (3 nc,)."""
    for c in range(W[0].size - 1):
        u[3 * c], u[3 * c + 1], u[3 * c + 2] = velocity_of(W, q, r, c)


@no_alloc
def stiffened(W, A, S):
    """Write I + A W into S (3 nc, 3 nc), for blocks A (nc, 3, 3)."""
    indptr, indices, data = W
    S[:] = 0.0
    for c in range(A.shape[0]):
        for p in range(indptr[c], indptr[c + 1]):
            d, B, w = 3 * indices[p], A[c], data[p]
            for i in range(3):
                for j in range(3):
                    S[3 * c + i, d + j] = B[i, 0] * w[0, j] + B[i, 1] * w[1, j] + B[i, 2] * w[2, j]
    for i in range(S.shape[0]):
        S[i, i] += 1.0
