"""Semismooth Newton on the augmented Lagrangian of the velocity problem.

For an impulse estimate r and penalties rho, the unknown is the velocity change y from that of the estimate:

    F(y) = M y - H (P(y) - r) = 0,  u = Hᵀ y + W r + q,
    P_N  = max(0, r_N - rho u_N),   P_T = projection of r_T - rho u_T on the disk of radius mu P_N,
    F'   = M + Σ_c H_c A_c H_cᵀ,    A_c = -dP_c/du_c.

Where a contact sticks, y and u become small, and so does their round-off. If the unknown were the whole velocity, rho
times its round-off would remain in P: 1e-7 m/s in a tall column, where penalties must be large since bending is much
softer than a contact. M is definite, so a rank-deficient W is no obstacle. A_c = rho I where a contact sticks and 0
where it is open, so that F' is symmetric unless a contact slips.
"""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem import given
from nsdyn._kernels.problem.blocks import block_product, momentum, relative_velocity, respond, velocity
from nsdyn._kernels.problem.cones import measure_at, measures
from nsdyn._kernels.problem.linear import factorise, substitute
from nsdyn._kernels.problem.sparse import assemble, dense_pattern
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.vectors import square

PATIENCE, DIVERGED = 5, 10.0  # a penalty is too large beyond these steps without settling, or this growth of defect²
SHRINKAGE, LEAST = 0.1, 1e-3  # factor on a penalty that is too large, and penalty below which the search ends
GROWTH, LARGEST = 2.0, 1e10  # factor on a penalty that settles in two steps, and its limit: large ones cost digits
IDLE = 4  # a measure that is near is round-off if it is not halved in this number of Newton steps
PART = 1e-2  # F has settled if its squared defect is at most this part of the squared multiplier step

GOES_ON, SETTLED, FAILED = range(3)
"""Verdicts on a Newton step."""


@no_alloc
def projected(u, r, rho, mu, P, step, A):
    """Write P(u) of every contact, P - r, and A_c = -dP_c/du_c.

    Parameters
    ----------
    u, r : ndarray, shape (3 nc,)
        Velocity, m/s, and impulse estimate, N·s.
    rho, mu : ndarray, shape (nc,)
        Penalties, kg, and coefficients of friction.
    P, step : ndarray, shape (3 nc,)
        Results P and P - r, N·s.
    A : ndarray, shape (nc, 3, 3)
        Result A_c, kg.
    """
    for c in range(mu.size):
        i, B = 3 * c, A[c]
        B[:] = 0.0
        a = r[i] - rho[c] * u[i]
        if a <= 0.0:
            P[i] = P[i + 1] = P[i + 2] = 0.0
        else:
            z1, z2 = r[i + 1] - rho[c] * u[i + 1], r[i + 2] - rho[c] * u[i + 2]
            t, s = math.sqrt(z1 * z1 + z2 * z2), 1.0
            B[0, 0] = B[1, 1] = B[2, 2] = rho[c]
            if t > mu[c] * a:
                s = mu[c] * a / t
                x, y, k = z1 / t, z2 / t, rho[c] * mu[c] * a / t
                B[1, 0], B[2, 0] = rho[c] * mu[c] * x, rho[c] * mu[c] * y
                B[1, 1], B[2, 2] = k * y * y, k * x * x
                B[1, 2] = B[2, 1] = -k * x * y
            P[i], P[i + 1], P[i + 2] = a, s * z1, s * z2
        for j in range(i, i + 3):
            step[j] = P[j] - r[j]


@no_alloc
def defect(blocks, y, P, F, work):
    """Write F = M y - H P into F (n,), where P is a change of impulses."""
    offset, _, _, _, m_start, m, _ = blocks
    momentum(blocks, P, F)
    block_product(offset, m_start, m, y, work)
    for i in range(y.size):
        F[i] = work[i] - F[i]


@no_alloc
def norms_of_islands(label, q, r, out):
    """Write the norm of q of every island into out (islands,). Where q is 0 write 1, and set r to 0, the solution."""
    out[:] = 0.0
    for i in range(q.size):
        out[label[i // 3]] += q[i] * q[i]
    for i in range(q.size):
        if out[label[i // 3]] == 0.0:
            r[i] = 0.0
    for k in range(out.size):
        out[k] = math.sqrt(out[k]) or 1.0


@kernel
def measures_of_islands(label, scales, norms, u, r, mu, out):
    """Write the measure of r and its u on every island, as a problem of its own with its norm of q, into out."""
    squares = np.zeros(out.size)
    out[:] = 0.0
    for c in range(mu.size):
        part, k = slice(3 * c, 3 * c + 3), label[c]
        error, residual = measures(scales[c : c + 1], u[part], r[part], mu[c : c + 1])
        squares[k] += square(error)
        if not residual <= out[k]:  # a NaN is the worst
            out[k] = residual
    for k in range(out.size):
        error = math.sqrt(squares[k]) / norms[k]
        if not error <= out[k]:
            out[k] = error


@no_alloc
def settled(scales, u, shown, own, P, estimate):
    """Return whether u is close to the velocity `shown` of P, and the square of their difference, the defect.

    Close is meant in comparison with the multiplier step P - estimate; `own` is the velocity of the estimate. Squares
    of velocities are weighed by 1/lambda_max(W_cc), J. The squared defect may be a PART of that of the step's velocity.
    It may also be (1e-5)² of the squared step, weighed as an impulse: redundant contacts exchange impulses without any
    velocity.
    """
    left, total, weighed = 0.0, 0.0, 0.0
    for i in range(u.size):
        scale = scales[i // 3]
        left += square(u[i] - shown[i]) / scale
        total += square(shown[i] - own[i]) / scale
        weighed += scale * square(P[i] - estimate[i])
    return left <= max(PART * total, 1e-10 * weighed), left


@no_alloc
def judge(given, vectors, so_far):
    """Return the verdict on a Newton step, `GOES_ON`, `SETTLED` or `FAILED`, and the next `so_far`.

    If F has settled, the estimate moves to P. If two steps were enough the penalty is doubled, or quadrupled where the
    measure gained less than a factor of two. If F does not settle, or diverges, the penalty is too large. The best P is
    kept in r. `given` are (mu, scales, q_norm) of the problem, `vectors` (u, shown, own, P, estimate, r), the first as
    in `settled`, `so_far` (penalty, Newton steps with it, square of the last defect, least measure).
    """
    (mu, scales, q_norm), (u, shown, own, P, estimate, r), (penalty, inner, before, best) = given, vectors, so_far
    measure = measure_at(scales, shown, P, mu, q_norm)
    growth = GROWTH if GROWTH * measure < best else GROWTH * GROWTH
    if measure < best:
        best = measure
        copy(P, r)
    done, left = settled(scales, u, shown, own, P, estimate)
    if done:
        copy(P, estimate)
        copy(shown, own)
        return SETTLED, (min(growth * penalty, LARGEST) if inner <= 2 else penalty, 0, np.inf, best)
    if inner >= PATIENCE or not left <= DIVERGED * before:
        return FAILED, (SHRINKAGE * penalty, 0, np.inf, best)
    return GOES_ON, (penalty, inner, left, best)


@kernel
def dense(problem, r, enough, near, penalty, most):
    """Solve (blocks, q, mu, scales, q_norm) by dense factorisations, in place of r; (factorisations, measure of r).

    The proximal method of multipliers takes full Newton steps on F (a line search would stop at the kinks), and judges
    each by `judge`. Where F settles, y becomes the velocity change from the new estimate. After a failure y returns to
    its last settled value. The first penalty is `penalty` / lambda_max(W_cc). The loop ends where the measure is
    `enough`, or where it is `near` and no longer falls. It is the loop of `nsdyn.solvers.newton`, compiled: a step
    takes 2 us for one body and 25 for ten bodies, instead of 35 and 60.
    """
    blocks, q, mu, scales, q_norm = problem
    n, nr = blocks[0][-1], q.size
    y, kept, F, work, dy = np.zeros(n), np.zeros(n), np.empty(n), np.empty(n), np.empty(n)
    u, own, shown, P, step = np.empty(nr), np.empty(nr), np.empty(nr), np.empty(nr), np.empty(nr)
    (indptr, slot, diagonal), A, K = dense_pattern(*blocks[:2]), np.empty((mu.size, 3, 3)), np.empty((n, n))
    pivot, low, end = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    velocity(blocks, q, r, dy, own, work)
    best = measure_at(scales, own, r, mu, q_norm)
    estimate = r.copy()
    copy(own, u)
    count, inner, before, reached, since = 0, 0, np.inf, best, 0
    while best > enough and count < most and penalty > LEAST and not (best <= near and count - since >= IDLE):
        if inner == 0:
            rho = penalty / scales
            projected(u, estimate, rho, mu, P, step, A)
        defect(blocks, y, step, F, work)
        assemble(blocks, A, indptr, blocks[0], slot, diagonal, K.reshape(-1))
        if not factorise(K, pivot, low, end):
            return count, best
        substitute(K, pivot, low, end, F)
        y -= F
        count += 1
        relative_velocity(blocks, y, u)
        u += own
        projected(u, estimate, rho, mu, P, step, A)
        velocity(blocks, q, P, dy, shown, work)
        so_far = penalty, inner + 1, before, best
        verdict, so_far = judge((mu, scales, q_norm), (u, shown, own, P, estimate, r), so_far)
        penalty, inner, before, best = so_far
        if 2.0 * best <= reached:
            reached, since = best, count
        if verdict == SETTLED:
            respond(blocks, step, work, dy)
            y -= dy
            copy(y, kept)
        elif verdict == FAILED:
            copy(kept, y)
            relative_velocity(blocks, y, u)
            u += own
    return count, best


@kernel
def impulses(problem, r, enough, penalty, most):
    """Solve (W, q, mu, scales, q_norm) as `dense`, with a given W: the unknown y is the change of the impulses.

    (I + A W) dy = P - r - y, u = W y + W r + q.
    """
    W, q, mu, scales, q_norm = problem
    n = q.size
    y, kept, own, shown, P, step = np.zeros(n), np.zeros(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    A, S = np.empty((mu.size, 3, 3)), np.empty((n, n))
    pivot, low, end = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    given.velocity(W, q, r, own)
    u, estimate, best = own.copy(), r.copy(), measure_at(scales, own, r, mu, q_norm)
    count, inner, before = 0, 0, np.inf
    while best > enough and count < most and penalty > LEAST:
        if inner == 0:
            rho = penalty / scales
            projected(u, estimate, rho, mu, P, step, A)
        given.stiffened(W, A, S)
        if not factorise(S, pivot, low, end):
            break
        step -= y
        substitute(S, pivot, low, end, step)
        y += step
        count += 1
        given.velocity(W, own, y, u)
        projected(u, estimate, rho, mu, P, step, A)
        given.velocity(W, q, P, shown)
        so_far = penalty, inner + 1, before, best
        verdict, so_far = judge((mu, scales, q_norm), (u, shown, own, P, estimate, r), so_far)
        penalty, inner, before, best = so_far
        if verdict == SETTLED:
            y -= step
            copy(y, kept)
        elif verdict == FAILED:
            copy(kept, y)
            given.velocity(W, own, y, u)
    return count, best


@kernel
def extract(blocks, label, island):
    """Return (contacts, blocks) of one island. The blocks share the arrays of rows and masses of the whole problem."""
    offset, block, start, H, m_start, m, minv = blocks
    contacts = np.flatnonzero(label == island)
    own, new = block[contacts], np.full(offset.size - 1, -1, np.int64)
    for c in range(contacts.size):
        for s in range(2):
            if own[c, s] >= 0:
                new[own[c, s]] = 0
    kept = np.flatnonzero(new == 0)
    begin = np.zeros(kept.size + 1, np.int64)
    for k in range(kept.size):
        new[kept[k]] = k
        begin[k + 1] = begin[k] + offset[kept[k] + 1] - offset[kept[k]]
    for c in range(contacts.size):
        for s in range(2):
            if own[c, s] >= 0:
                own[c, s] = new[own[c, s]]
    return contacts, (begin, own, start[contacts], H, m_start[kept], m, minv)
