"""Problems given by W alone: Newton on impulses, and whole islands solved in one call."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.blocks import unite
from nsdyn._kernels.problem.cones import coulomb
from nsdyn._kernels.problem.linear import factorise, substitute
from nsdyn._kernels.solvers import interior, pgs
from nsdyn._kernels.solvers.newton import PART, PATIENCE, gather, grown, projected, scatter, stiffness

NARROW = 30  # contacts from which on an island is worth an order


@kernel
def settled(Wf, f, Wd, d, part, scales):
    """The rule of `newton.settled` for the defect f = x - P and the multiplier step d, with Wf = W f and Wd = W d."""
    left, total, weighed = 0.0, 0.0, 0.0
    for i in range(f.size):
        left += f[i] * Wf[i]
        total += d[i] * Wd[i]
        weighed += scales[i // 3] * d[i] ** 2
    return left <= max(part * total, 1e-10 * weighed), left


@kernel
def newton(W, q, mu, scales, r, tol, q_norm, penalty, max_iter):
    """The method of `newton.dense` for a dense W, which need not be symmetric, in place of r.

    The unknown is an impulse x with u = W x + q instead of the velocity change M⁻¹ H x: (I + A W) dx = P(u) - x. The
    loop is that of `nsdyn.solvers.newton`, compiled: 1 us a step for 4 contacts and 65 for 40, where that takes 145 and
    300.
    """
    n = q.size
    x, estimate, u, own_u, P, f, d, Wf, Wd = np.empty((9, n))
    A, S = np.empty((mu.size, 3, 3)), np.empty((n, n))
    pivot, low, end = np.empty((3, n), np.int64)
    x[:] = estimate[:] = r
    best = interior.measure(W, q, mu, scales, q_norm, r, u)
    count, inner = 0, 0
    rho = penalty / scales
    projected(u, estimate, rho, mu, P)
    while best > tol and count < max_iter and penalty > 1e-3:
        stiffness(u, estimate, rho, mu, A)
        interior.system(W, A, 1.0, S)
        if not factorise(S, pivot, low, end):
            return count, best
        for i in range(n):
            f[i] = P[i] - x[i]
        substitute(S, pivot, low, end, f)
        count += 1
        inner += 1
        x += f
        interior.product(W, x, u)
        u += q
        projected(u, estimate, rho, mu, P)
        now = interior.measure(W, q, mu, scales, q_norm, P, own_u)
        if now < best:
            best = now
            r[:] = P
        for i in range(n):
            f[i], d[i] = x[i] - P[i], P[i] - estimate[i]
            Wf[i], Wd[i] = u[i] - own_u[i], 0.0
        interior.product(W, d, Wd)
        if settled(Wf, f, Wd, d, PART, scales)[0]:
            penalty = grown(penalty, inner)
            estimate[:] = P
        elif inner >= PATIENCE:
            penalty *= 0.1
            x[:] = estimate
            interior.product(W, x, u)
            u += q
        else:
            continue
        inner = 0
        rho = penalty / scales
        projected(u, estimate, rho, mu, P)
    return count, best


@kernel
def islands(indptr, indices, label):
    """Connected components of the pattern of W, by first contact, into label (nc,); returns their number."""
    nc = indptr.size - 1
    parent = np.arange(nc)
    for c in range(nc):
        for p in range(indptr[c], indptr[c + 1]):
            unite(parent, c, indices[p])
    found = 0
    for c in range(nc):
        a = c
        while parent[a] != a:
            a = parent[a]
        if a == c:
            label[c] = found
            found += 1
        else:
            label[c] = label[a]
    return found


@kernel
def narrow(indptr, indices, contacts):
    """Contacts of an island in the order of Cuthill and McKee, from one of fewest neighbours: a narrow profile."""
    seen = np.zeros(indptr.size - 1, np.bool_)
    first = contacts[0]
    for c in contacts:
        if indptr[c + 1] - indptr[c] < indptr[first + 1] - indptr[first]:
            first = c
    order = np.empty(contacts.size, np.int64)
    order[0] = first
    seen[first] = True
    found = 1
    for e in range(contacts.size):
        c, begin = order[e], found
        for p in range(indptr[c], indptr[c + 1]):
            d = indices[p]
            if not seen[d]:
                seen[d] = True
                # Neighbours ascending in their own number of neighbours
                i = found
                while i > begin and indptr[order[i - 1] + 1] - indptr[order[i - 1]] > indptr[d + 1] - indptr[d]:
                    order[i] = order[i - 1]
                    i -= 1
                order[i] = d
                found += 1
    return order


@kernel
def extract(W, contacts):
    """Block-sparse W = (indptr, indices, data) of some contacts that nothing connects with others."""
    indptr, indices, data = W
    new = np.empty(indptr.size - 1, np.int64)
    start = np.zeros(contacts.size + 1, np.int64)
    for e in range(contacts.size):
        c = contacts[e]
        new[c] = e
        start[e + 1] = start[e] + indptr[c + 1] - indptr[c]
    columns, values = np.empty(start[-1], np.int64), np.empty((start[-1], 3, 3))
    for e in range(contacts.size):
        c, o = contacts[e], start[e]
        for p in range(indptr[c], indptr[c + 1]):
            columns[o] = new[indices[p]]
            values[o] = data[p]
            o += 1
    return start, columns, values


@kernel
def filled(W):
    """Dense W of a block-sparse one."""
    indptr, indices, data = W
    n = 3 * (indptr.size - 1)
    out = np.zeros((n, n))
    for c in range(indptr.size - 1):
        for p in range(indptr[c], indptr[c + 1]):
            d = indices[p]
            for i in range(3):
                for j in range(3):
                    out[3 * c + i, 3 * d + j] += data[p, i, j]
    return out


@kernel
def solve_island(W, given, r, tol, q_norm, limits):
    """One island of a block-sparse W = (indptr, indices, data), given = (q, mu, scales), in place of r; iterations.

    From a warm start `warm` steps of Newton; accelerated Gauss–Seidel while its rate leaves hope; where a step costs
    little, `most` of Newton; then the interior point method and Newton from its states. limits = (largest, penalty,
    most, warm, quick, sweeps, patience).
    """
    q, mu, scales = given
    _, penalty, most, warm, quick, sweeps, patience = limits
    M, memory = pgs.matrix(W[0], W[1], W[2]), min(20, mu.size + 1)
    count, best = 0, np.inf
    if r.any():
        used, best = newton(filled(W), q, mu, scales, r, tol, q_norm, penalty, warm)
        count += used
    if best > tol:
        used, best = pgs.accelerated(M, q, mu, scales, r, tol, q_norm, sweeps, 5, memory, patience)
        count += used
    if best <= tol:
        return count
    full = filled(W)
    if mu.size <= quick:
        used, best = newton(full, q, mu, scales, r, tol, q_norm, penalty, most)
        count += used
        if best <= tol:
            return count
    x = np.empty(q.size)
    used, now = interior.dense(full, q, mu, scales, x, tol, q_norm, 40)
    count += used
    if now > tol:
        used, now = newton(full, q, mu, scales, x, tol, q_norm, 1e3, 400)
        count += used
    if now > tol:
        # Near the solution the sweeps reach the last digits that factorisations lose.
        used, now = pgs.accelerated(M, q, mu, scales, x, tol, q_norm, sweeps, 5, memory, sweeps)
        count += used
    if now < best:
        r[:] = x
    return count


@kernel
def solve_small(W, given, r, tol, q_norm, limits):
    """Every island of at most limits[0] contacts in place of r: one contact in closed form, more by `solve_island`.

    Each is a problem of its own, with its own norm of q. Returns the iterations.
    """
    indptr, indices, data = W
    q, mu, scales = given
    nc, largest = mu.size, limits[0]
    if indptr[1] == nc and nc <= min(largest, NARROW):  # one island, nothing to extract
        return solve_island(W, given, r, tol, q_norm, limits)
    label, order = np.empty(nc, np.int64), np.empty(nc, np.int64)
    found = islands(indptr, indices, label)
    end = np.zeros(found + 2, np.int64)
    for c in range(nc):
        end[label[c] + 2] += 1
    for e in range(found):
        end[e + 2] += end[e + 1]
    for c in range(nc):
        order[end[label[c] + 1]] = c
        end[label[c] + 1] += 1
    count = 0
    for e in range(found):
        contacts = order[end[e] : end[e + 1]]
        if contacts.size == 1:
            c = 3 * contacts[0]
            own = data[indptr[contacts[0]]]
            r[c], r[c + 1], r[c + 2] = coulomb(own, q[c], q[c + 1], q[c + 2], mu[contacts[0]])
            count += 1
        elif contacts.size <= largest:
            if contacts.size > NARROW:
                contacts = narrow(indptr, indices, contacts)
            own_q, own_mu, own_scales, x = gather(contacts, q, mu, scales, r)
            own_norm = math.sqrt(np.sum(own_q * own_q)) or 1.0
            count += solve_island(extract(W, contacts), (own_q, own_mu, own_scales), x, tol, own_norm, limits)
            scatter(contacts, x, r)
    return count
