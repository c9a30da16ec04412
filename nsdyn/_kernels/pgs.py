"""Block Gauss–Seidel sweeps with the exact one-contact solver, Anderson-accelerated."""

import math

import numpy as np
from numba import njit

from nsdyn._kernels.cones import natural_error, natural_residual, project_all, solve_one


@njit(cache=True)
def sweep(indptr, indices, data, q, mu, r):
    """One Gauss–Seidel sweep in place: each contact solved exactly with the others frozen."""
    W = np.empty((3, 3))
    b = np.empty(3)
    x = np.empty(3)
    for c in range(mu.size):
        b0, b1, b2 = q[3 * c], q[3 * c + 1], q[3 * c + 2]
        for p in range(indptr[c], indptr[c + 1]):
            d = indices[p]
            A = data[p]
            if d == c:
                W[:] = A
            else:
                x0, x1, x2 = r[3 * d], r[3 * d + 1], r[3 * d + 2]
                b0 += A[0, 0] * x0 + A[0, 1] * x1 + A[0, 2] * x2
                b1 += A[1, 0] * x0 + A[1, 1] * x1 + A[1, 2] * x2
                b2 += A[2, 0] * x0 + A[2, 1] * x1 + A[2, 2] * x2
        b[0], b[1], b[2] = b0, b1, b2
        solve_one(W, b, mu[c], x)
        r[3 * c], r[3 * c + 1], r[3 * c + 2] = x[0], x[1], x[2]


@njit(cache=True)
def velocity_of(indptr, indices, data, q, r, c):
    """u_c = (W r + q)_c of contact c: three scalars."""
    u0, u1, u2 = q[3 * c], q[3 * c + 1], q[3 * c + 2]
    for p in range(indptr[c], indptr[c + 1]):
        d = 3 * indices[p]
        A = data[p]
        u0 += A[0, 0] * r[d] + A[0, 1] * r[d + 1] + A[0, 2] * r[d + 2]
        u1 += A[1, 0] * r[d] + A[1, 1] * r[d + 1] + A[1, 2] * r[d + 2]
        u2 += A[2, 0] * r[d] + A[2, 1] * r[d + 1] + A[2, 2] * r[d + 2]
    return u0, u1, u2


@njit(cache=True)
def velocity(indptr, indices, data, q, r, u):
    """u = W r + q, into u (3 nc,)."""
    for c in range(indptr.size - 1):
        u[3 * c], u[3 * c + 1], u[3 * c + 2] = velocity_of(indptr, indices, data, q, r, c)


@njit(cache=True)
def accelerated(indptr, indices, data, q, mu, scales, r, tol, q_norm, max_sweeps, check, memory, patience):
    """Anderson-accelerated sweeps (type II) in place of r; memory 0 is plain Gauss–Seidel.

    The fixed point is r = sweep(r). Differences f = sweep(r) - r are scaled by sqrt(lambda_max(W_cc)); the new
    iterate is the combination of the last `memory` sweeps whose combined f is least, projected on the cones; the
    memory is dropped when |f| exceeds twice its best. Every `check` sweeps both measures are tested; r keeps the
    best iterate seen by a test. Returns (sweeps, stalled): stalled when the residual has not fallen by 10 within
    `patience` sweeps.
    """
    n, m = r.size, max(memory, 1)
    weight = np.empty(n)
    for c in range(mu.size):
        weight[3 * c] = weight[3 * c + 1] = weight[3 * c + 2] = math.sqrt(scales[c])
    F, G = np.empty((m, n)), np.empty((m, n))
    gram = np.zeros((m, m))
    x, u, best_r = r.copy(), np.empty(n), r.copy()
    velocity(indptr, indices, data, q, x, u)
    best = max(natural_residual(scales, u, x, mu), natural_error(u, x, mu) / q_norm)
    best_f = np.inf
    mark, mark_sweep = best, 0
    used, slot = 0, 0
    for k in range(1, max_sweeps + 1):
        g = G[slot]
        g[:] = x
        sweep(indptr, indices, data, q, mu, g)
        f = F[slot]
        size = 0.0
        for i in range(n):
            f[i] = (g[i] - x[i]) * weight[i]
            size += f[i] * f[i]
        if k % check == 0 or k == max_sweeps or size == 0.0:
            velocity(indptr, indices, data, q, g, u)
            residual = natural_residual(scales, u, g, mu)
            error = natural_error(u, g, mu) / q_norm
            if max(residual, error) < best:
                best = max(residual, error)
                best_r[:] = g
            if best <= tol or size == 0.0:
                r[:] = best_r
                return k, False
            if best < 0.1 * mark:
                mark, mark_sweep = best, k
            elif k - mark_sweep >= patience:
                r[:] = best_r
                return k, True
        if memory == 0:
            x[:] = g
            continue
        if used > 1 and math.sqrt(size) > 2.0 * best_f:
            F[0], G[0] = f.copy(), g.copy()
            f, g = F[0], G[0]
            used, slot, best_f = 0, 0, np.inf
        best_f = min(best_f, math.sqrt(size))
        used = min(used + 1, m)
        for j in range(used):
            total = 0.0
            for i in range(n):
                total += F[j, i] * f[i]
            gram[j, slot] = gram[slot, j] = total
        x[:] = g
        if used > 1:
            A, b = np.zeros((used - 1, used - 1)), np.empty(used - 1)
            trace = 0.0
            for i in range(used - 1):
                p = i if i < slot else i + 1
                b[i] = gram[slot, slot] - gram[p, slot]
                for j in range(used - 1):
                    o = j if j < slot else j + 1
                    A[i, j] = gram[p, o] - gram[p, slot] - gram[o, slot] + gram[slot, slot]
                trace += A[i, i]
            for i in range(used - 1):
                A[i, i] += 1e-10 * trace + 1e-300
            gamma = np.linalg.solve(A, b)
            for i in range(used - 1):
                p = i if i < slot else i + 1
                for l in range(n):
                    x[l] += gamma[i] * (G[p, l] - g[l])
            project_all(x, mu, x)
        slot = (slot + 1) % m
    r[:] = best_r
    return max_sweeps, False
