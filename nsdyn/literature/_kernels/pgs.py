"""Block Gauss–Seidel sweeps with the exact one-contact solver, Anderson-accelerated."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.cones import measure_at, project
from nsdyn._kernels.problem.given import velocity
from nsdyn._kernels.vectors import square
from nsdyn.literature._kernels.anderson import mix
from nsdyn.literature._kernels.one_contact import EXACT, sweep


@kernel(rounds=1000)
def accelerated(W, q, mu, scales, r, tol, q_norm, max_sweeps, check, memory, patience):
    """Repeat Anderson-accelerated sweeps (type II) in place of r; memory 0 is plain Gauss–Seidel.

    The fixed point is r = sweep(r). Differences f = sweep(r) - r are scaled by sqrt(lambda_max(W_cc)). The new iterate
    is the combination of the last `memory` sweeps whose combined f is smallest, projected on the cones. The memory is
    dropped when |f| exceeds twice its smallest value. Both measures are tested every `check` sweeps, and when a sweep
    changes velocities by less than the tolerance; r keeps the best iterate seen by a test. From `patience` sweeps on
    the method gives up if, at the rate of the later half of the sweeps so far, the tolerance lies beyond `max_sweeps`.
    Returns (sweeps, measure of r).

    Parameters
    ----------
    W : tuple
        Rows, columns and 3 x 3 blocks, as in `given`.
    q, r : ndarray, shape (3 nc,)
    mu, scales : ndarray, shape (nc,)
        Friction, and λ_max(W_cc).
    tol : float
        Tolerance of both measures.
    q_norm : float
        ‖q‖.
    max_sweeps, check, memory, patience : int
    """
    n, m = r.size, max(memory, 1)
    F, G = np.empty((2, m, n))
    x, u, weight = np.empty((3, n))
    for c in range(mu.size):
        weight[3 * c] = weight[3 * c + 1] = weight[3 * c + 2] = math.sqrt(scales[c])
    gram, order = np.zeros((m, m)), np.arange(mu.size)
    x[:] = r
    velocity(W, q, x, u)
    best = measure_at(scales, u, x, mu, q_norm)
    best_f = np.inf
    history = np.full(max_sweeps // check + 2, best)
    used, slot, k = 0, 0, 0
    for k in range(1, max_sweeps + 1):
        g, f = G[slot], F[slot]
        g[:] = x
        sweep(W, q, mu, scales, order, EXACT, 1.0, 0.0, 1, g)
        size, moved = 0.0, 0.0
        for i in range(n):
            f[i] = (g[i] - x[i]) * weight[i]
            size += f[i] * f[i]
            moved += square(f[i] * weight[i])
        due = k % check == 0 or k == max_sweeps or size == 0.0
        if due or math.sqrt(moved) * max(1.0, 1.0 / q_norm) <= tol:
            velocity(W, q, g, u)
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
