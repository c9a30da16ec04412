"""Problems given by W alone: Newton on impulses, and whole islands solved in one call."""

import numpy as np

from nsdyn._kernels.compiled import kernel
from nsdyn._kernels.problem.blocks import unite
from nsdyn._kernels.problem.cones import solve_one
from nsdyn._kernels.problem.linear import factorise, substitute
from nsdyn._kernels.solvers import interior, pgs
from nsdyn._kernels.solvers.newton import PATIENCE, gather, grown, projected, scatter, stiffness


@kernel
def settled(Wf, f, Wd, d, scales):
    """The rule of `newton.settled` for the defect f = x - P and the multiplier step d, with Wf = W f and Wd = W d."""
    left, total, weighed = 0.0, 0.0, 0.0
    for i in range(f.size):
        left += f[i] * Wf[i]
        total += d[i] * Wd[i]
        weighed += scales[i // 3] * d[i] ** 2
    return left <= max(1e-4 * total, 1e-10 * weighed)


@kernel
def newton(W, q, mu, scales, r, tol, q_norm, penalty, max_iter):
    """The method of `newton.dense` for a dense W, which need not be symmetric, in place of r.

    The unknown is an impulse x with u = W x + q instead of the velocity change M⁻¹ H x: (I + A W) dx = P(u) - x. The
    loop is that of `nsdyn.solvers.newton`, compiled: 1 us a step for 4 contacts and 65 for 40, where that takes 145 and
    300.
    """
    n = q.size
    x, estimate, u, own_u, P = r.copy(), r.copy(), np.empty(n), np.empty(n), np.empty(n)
    f, d, Wf, Wd = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    A, S = np.empty((mu.size, 3, 3)), np.empty((n, n))
    pivot, low, end = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
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
        if settled(Wf, f, Wd, d, scales):
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
def extract(indptr, indices, data, contacts):
    """Block-sparse W of some contacts that nothing connects with others: (indptr, indices, data)."""
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
def filled(indptr, indices, data):
    """Dense W of a block-sparse one."""
    n = 3 * (indptr.size - 1)
    W = np.zeros((n, n))
    for c in range(indptr.size - 1):
        for p in range(indptr[c], indptr[c + 1]):
            d = indices[p]
            for i in range(3):
                for j in range(3):
                    W[3 * c + i, 3 * d + j] += data[p, i, j]
    return W


@kernel
def solve_small(
    indptr, indices, data, q, mu, scales, r, tol, q_norm, label, found, largest, quick, penalty, warm, most, sweeps,
    patience,
):  # fmt: skip
    """Every island of at most `largest` contacts in place of r; returns the iterations.

    One contact: closed form. Else `warm` steps of Newton from a warm start; for at most `quick` contacts a few sweeps
    and `most` steps of Newton; then accelerated Gauss–Seidel while its rate leaves hope; then the interior point method
    and Newton from its states.
    """
    nc = mu.size
    end, order = np.zeros(found + 1, np.int64), np.empty(nc, np.int64)
    for c in range(nc):
        end[label[c] + 1] += 1
    for e in range(found):
        end[e + 1] += end[e]
    fill = end[:-1].copy()
    for c in range(nc):
        order[fill[label[c]]] = c
        fill[label[c]] += 1
    count = 0
    one, b = np.empty(3), np.empty(3)
    for e in range(found):
        contacts = order[end[e] : end[e + 1]]
        k = contacts.size
        if k > largest:
            continue
        if k > 30:
            contacts = narrow(indptr, indices, contacts)
        part = extract(indptr, indices, data, contacts)
        own_q, own_mu, own_scales, x = gather(contacts, q, mu, scales, r)
        if k == 1:
            b[:] = own_q
            solve_one(part[2][0], b, own_mu[0], one)
            x[:] = one
            count += 1
        else:
            W, best = filled(*part), np.inf
            M, memory = pgs.matrix(*part), min(20, k + 1)
            if x.any():
                used, best = newton(W, own_q, own_mu, own_scales, x, tol, q_norm, penalty, warm)
                count += used
            if best > tol and k <= quick:
                used, best = pgs.accelerated(M, own_q, own_mu, own_scales, x, tol, q_norm, 5, 5, memory, patience)
                count += used
                if best > tol:
                    used, best = newton(W, own_q, own_mu, own_scales, x, tol, q_norm, penalty, most)
                    count += used
            if best > tol:
                used, best = pgs.accelerated(
                    M, own_q, own_mu, own_scales, x, tol, q_norm, sweeps, 5, memory, patience
                )  # fmt: skip
                count += used
            if best > tol:
                y = np.empty(3 * k)
                used, now = interior.dense(W, own_q, own_mu, own_scales, y, tol, q_norm, 40)
                count += used
                if now > tol:
                    used, now = newton(W, own_q, own_mu, own_scales, y, tol, q_norm, 1e3, 400)
                    count += used
                if now > tol:
                    # Near the solution the sweeps reach the last digits that factorisations lose.
                    used, now = pgs.accelerated(
                        M, own_q, own_mu, own_scales, y, tol, q_norm, sweeps, 5, memory, sweeps
                    )  # fmt: skip
                    count += used
                if now < best:
                    x[:] = y
        scatter(contacts, x, r)
    return count
