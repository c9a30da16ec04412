"""Block Gauss–Seidel sweeps with the exact one-contact solver, Anderson-accelerated.

W is given as a `Matrix` of 3 x 3 blocks, or by its `Factors`. A contact costs time in proportion to its neighbours with
the first; with the second it costs its two bodies, however many contacts they have.
"""

import math
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.blocks import (
    add_momentum,
    diagonal_block,
    momentum,
    relative_velocity,
    relative_velocity_of,
    weighted_rows,
    widest,
)
from nsdyn._kernels.problem.cones import coulomb, measure_at, project, slide
from nsdyn._kernels.problem.given import velocity
from nsdyn._kernels.vectors import adjugate, along, minus, square, three, times
from nsdyn._kernels.vectors import to_world as product
from nsdyn.literature._kernels.anderson import mix


class Matrix(NamedTuple):
    """Block-sparse W as in `nsdyn._kernels.problem.given`, and the inverses of its W_cc (nc, 3, 3)."""

    given: tuple
    inverse: np.ndarray


class Factors(NamedTuple):
    """W = Hᵀ M⁻¹ H as in `blocks`, with `y` the rows of (M⁻¹ H)ᵀ, and all W_cc (nc, 3, 3) with their inverses."""

    blocks: tuple
    y: np.ndarray
    diagonal: np.ndarray
    inverse: np.ndarray


@no_alloc
def invert(W, S):
    """Compute the inverse of a 3 x 3 block into S; 0 if the block is singular to round-off."""
    (x, y, z), det = adjugate(W)
    S[:] = 0.0
    if det > 1e-12 * W[0, 0] * W[1, 1] * W[2, 2]:
        for i in range(3):
            S[i, 0], S[i, 1], S[i, 2] = x[i] / det, y[i] / det, z[i] / det


@kernel
def matrix(indptr, indices, data):
    """Build the `Matrix` of a block-sparse W."""
    S = np.zeros((indptr.size - 1, 3, 3))
    for c in range(indptr.size - 1):
        for p in range(indptr[c], indptr[c + 1]):
            if indices[p] == c:
                invert(data[p], S[c])
    return Matrix((indptr, indices, data), S)


@kernel
def factors(blocks):
    """Build the `Factors` of W = Hᵀ M⁻¹ H."""
    nc, most = blocks[1].shape[0], widest(blocks[0])
    D, S, x, y = np.empty((nc, 3, 3)), np.empty((nc, 3, 3)), np.empty((3, most)), np.empty((3, most))
    for c in range(nc):
        diagonal_block(blocks, c, 3, x, y, D[c])
        invert(D[c], S[c])
    return Factors(blocks, weighted_rows(blocks), D, S)


@no_alloc
def solve_contact(W, own, S, c, b0, b1, b2, mu):
    """Return the impulse of contact c with free velocity b, 3 scalars; W[own] is its block, S[c] the inverse or 0."""
    if b0 >= 0.0:
        return 0.0, 0.0, 0.0
    x0, x1, x2 = times(-1.0, product(S, c, (b0, b1, b2)))
    if x0 > 0.0 and x1 * x1 + x2 * x2 <= square(mu * x0):
        return x0, x1, x2
    if S[c, 0, 0] == 0.0 or mu == 0.0:
        return coulomb(W[own], b0, b1, b2, mu)
    return slide(W[own], b0, b1, b2, mu)


@no_alloc
def sweep_matrix(W, q, mu, r):
    """One Gauss–Seidel sweep in place: solve each contact exactly with all other impulses frozen."""
    (indptr, indices, data), inverse = W
    for c in range(mu.size):
        # Unsigned, so that the compiler skips the test for negative indices.
        k = np.uint64(c)
        i, own = np.uint64(3) * k, k
        b = q[i], q[i + np.uint64(1)], q[i + np.uint64(2)]
        for p in range(indptr[c], indptr[c + 1]):
            e, d = np.uint64(p), np.uint64(3 * indices[p])
            if d == i:
                own = e
                continue
            b = along(b, 1.0, product(data, e, (r[d], r[d + np.uint64(1)], r[d + np.uint64(2)])))
        r[3 * c], r[3 * c + 1], r[3 * c + 2] = solve_contact(data, own, inverse, k, *b, mu[c])


@no_alloc
def sweep_factors(W, q, mu, v, r):
    """One Gauss–Seidel sweep in place of r and of v = M⁻¹ H r: solve each contact exactly, other impulses frozen."""
    blocks, y, diagonal, inverse = W
    for c in range(mu.size):
        i, before = 3 * c, three(r, 3 * c)
        b = along(three(q, i), 1.0, relative_velocity_of(blocks, v, c))
        b = minus(b, product(diagonal, c, before))
        r[i], r[i + 1], r[i + 2] = solve_contact(diagonal, c, inverse, c, *b, mu[c])
        add_momentum((*blocks[:3], y), c, *minus(three(r, i), before), v)


@kernel
def change_of(W, r):
    """Return v = M⁻¹ H r from the factors, shape (n,)."""
    offset, block, start, _, m_start, m, minv = W.blocks
    v = np.zeros(offset[-1])
    momentum((offset, block, start, W.y, m_start, m, minv), r, v)
    return v


@kernel
def _sweep(W, q, mu, r):
    """One sweep in place of r."""
    if len(W) == 2:  # a `Matrix`; the compiler drops the other branch
        sweep_matrix(W, q, mu, r)
    else:
        sweep_factors(W, q, mu, change_of(W, r), r)


@kernel
def _velocity(W, q, r, u):
    """Compute u = W r + q, into u."""
    if len(W) == 2:
        velocity(W.given, q, r, u)
    else:
        relative_velocity(W.blocks, change_of(W, r), u)
        u += q


@kernel(rounds=1000)
def accelerated(W, q, mu, scales, r, tol, q_norm, plan):
    """Repeat Anderson-accelerated sweeps (type II) in place of r; memory 0 is plain Gauss–Seidel.

    The fixed point is r = sweep(r). Differences f = sweep(r) - r are scaled by sqrt(lambda_max(W_cc)). The new iterate
    is the combination of the last `memory` sweeps whose combined f is smallest, projected on the cones. The memory is
    dropped when |f| exceeds twice its smallest value. Both measures are tested every `check` sweeps, and when a sweep
    changes velocities by less than the tolerance; r keeps the best iterate seen by a test. From `patience` sweeps on
    the method gives up if, at the rate of the later half of the sweeps so far, the tolerance lies beyond `max_sweeps`.
    Returns (sweeps, measure of r).

    Parameters
    ----------
    W : Matrix or Factors
    q, r : ndarray, shape (3 nc,)
    mu, scales : ndarray, shape (nc,)
        Friction, and λ_max(W_cc).
    tol : float
        Tolerance of both measures.
    q_norm : float
        ‖q‖.
    plan : (max_sweeps, check, memory, patience), int
    """
    max_sweeps, check, memory, patience = plan
    n, m = r.size, max(memory, 1)
    F, G = np.empty((2, m, n))
    x, u, weight = np.empty((3, n))
    for c in range(mu.size):
        weight[3 * c] = weight[3 * c + 1] = weight[3 * c + 2] = math.sqrt(scales[c])
    gram = np.zeros((m, m))
    x[:] = r
    _velocity(W, q, x, u)
    best = measure_at(scales, u, x, mu, q_norm)
    best_f = np.inf
    history = np.full(max_sweeps // check + 2, best)
    used, slot, k = 0, 0, 0
    for k in range(1, max_sweeps + 1):
        g, f = G[slot], F[slot]
        g[:] = x
        _sweep(W, q, mu, g)
        size, moved = 0.0, 0.0
        for i in range(n):
            f[i] = (g[i] - x[i]) * weight[i]
            size += f[i] * f[i]
            moved += square(f[i] * weight[i])
        due = k % check == 0 or k == max_sweeps or size == 0.0
        if due or math.sqrt(moved) * max(1.0, 1.0 / q_norm) <= tol:
            _velocity(W, q, g, u)
            now = measure_at(scales, u, g, mu, q_norm)
            if now < best:
                best = now
                r[:] = g
            if best <= tol or size == 0.0:
                break
        if due:
            done = (k + check - 1) // check
            history[done] = best
            if k >= patience:
                rate = math.log(history[done // 2] / best) / (k - done // 2 * check)
                if math.log(best / tol) > rate * (max_sweeps - k):
                    break
        if memory == 0:
            x[:] = g
            continue
        if used > 1 and math.sqrt(size) > 2.0 * best_f:
            if slot > 0:
                F[0], G[0] = f, g
            used, slot, best_f = 0, 0, np.inf
        best_f = min(best_f, math.sqrt(size))
        used = min(used + 1, m)
        mix(F, G, gram, slot, used, x)
        if used > 1:
            for c in range(mu.size):
                x[3 * c], x[3 * c + 1], x[3 * c + 2] = project(x[3 * c], x[3 * c + 1], x[3 * c + 2], mu[c])
        slot = (slot + 1) % m
    return k, best
