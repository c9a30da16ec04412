"""What a solve begins with, in one call: judge the start, solve whole what is small, judge again."""

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem import cones
from nsdyn._kernels.solvers import local, newton, pgs

POLISHED = 0.5
"""Measure after a step over that before, from which on it is round-off, as it is of a heap before it is `enough`."""

NEARLY, CLOSE = 2.0, 0.9
"""What nearly is enough, and what is left of it, both in `enough`."""


@kernel
def small(blocks, q, mu, scales, r, measure, enough, good, q_norm, limits):
    """Solve one island of few coordinates by `newton.dense` in place of r, of that measure; (factorisations, measure).

    A few steps from a warm start; if they are not `good`, or from nothing, many; then, as long as it gains, step by
    step with a new penalty: the one that has grown on the way would lose the last digits. What nearly was `enough` only
    comes close to that. At rest it missed what velocities an imbalance of the impulses, far smaller, has added up to in
    many steps; impulses that take these back in one give the next as much of the other sign, and so its start misses.
    """
    _, penalty, max_iter, few = limits
    start, missed, count = r.copy(), measure, 0
    if measure > good and r.any():
        count, measure = newton.dense(blocks, q, mu, scales, r, enough, q_norm, penalty, few)
    if measure > good:
        used, measure = newton.dense(blocks, q, mu, scales, r, enough, q_norm, penalty, max_iter)
        count += used
    before, steps = np.inf, 0
    while enough < measure <= good and measure <= POLISHED * before and steps < few:
        before = measure
        used, measure = newton.dense(blocks, q, mu, scales, r, enough, q_norm, penalty, 1)
        steps += used
    if measure <= enough < missed <= NEARLY * enough:
        y, work, u = np.empty(blocks[0][-1]), np.empty(blocks[0][-1]), np.empty(q.size)
        closer = start + (1.0 - CLOSE * enough / missed) * (r - start)
        now = newton.measure_of(blocks, q, mu, scales, q_norm, closer, y, u, work)
        if now <= enough:
            r[:], measure = closer, now
    return count + steps, measure


@in_place
def closed_form(W, q, mu, r, u):
    """One contact in closed form, into r (3,) and u = W r + q."""
    r[0], r[1], r[2] = cones.coulomb(W, q[0], q[1], q[2], mu[0])
    for i in range(3):
        u[i] = W[i, 0] * r[0] + W[i, 1] * r[1] + W[i, 2] * r[2] + q[i]


@kernel
def only_contact(blocks, c, q, mu, scales, r, q_norm):
    """An island of one contact in closed form, in place of r; its measure."""
    most, own, at = _blocks.widest(blocks[0]), slice(c, c + 1), slice(3 * c, 3 * c + 3)
    x, y, w, u = np.empty((3, most)), np.empty((3, most)), np.empty((3, 3)), np.empty(3)
    _blocks.diagonal_block(blocks, c, x, y, w)
    closed_form(w, q[at], mu[own], r[at], u)
    return cones.measure_at(scales[own], u, r[at], mu[own], q_norm)


@kernel
def part(blocks, label, k, q, mu, scales, r, measure, enough, good, q_norm, limits):
    """`small` for island k of several."""
    contacts, own = newton.extract(blocks, label, k)
    if own[0][-1] > limits[0]:
        return 0, measure
    own_q, own_mu, own_scales, x = newton.gather(contacts, q, mu, scales, r)
    count, measure = small(own, own_q, own_mu, own_scales, x, measure, enough, good, q_norm, limits)
    newton.scatter(contacts, x, r)
    return count, measure


@in_place
def by_factors(blocks, q, mu, scales, r, u, label, islands, enough, good, limits):
    """Solve every island of few coordinates in place of r, where r is not good `enough`.

    One contact in closed form, more by `small`, to be `enough` or at least `good`. (So is one whose W_cc is singular,
    as at the tip of an arm of two joints, where the closed form may miss.) Every island is a problem of its own, with
    its own norm of q: what one gets does not depend on the others, and all together are as good as the worst. The
    islands into label (nc,), into islands (3, nc) their measures, 0 for those that end `good`, norms and contacts.
    Returns their number, whether one is left, the factorisations, and, where none is left, the defect of the literature
    and the residual of r; then its u = W r + q is in u. limits = (most coordinates, penalty, most steps, a few steps).
    """
    top, residual = _blocks.judged(blocks, q, mu, scales, r, u)
    offset, block = blocks[:2]
    found = _blocks.islands(block, offset.size - 1, label)
    measures, norms, size = islands[0, :found], islands[1, :found], islands[2, :found]
    newton.norms_of_islands(label, q, norms)
    newton.measures_of_islands(label, scales, norms, u, r, mu, measures)
    size[:] = 0.0
    for c in range(label.size):
        size[label[c]] += 1.0
    count, left, changed, c = 0, False, False, 0
    for k in range(found):
        wanted = enough
        while label[c] != k:  # the first contact of an island comes after that of the one before
            c += 1
        if measures[k] > enough and size[k] == 1.0:
            measures[k] = only_contact(blocks, c, q, mu, scales, r, norms[k])
            wanted = good
            count += 1
            changed = True
        if not measures[k] <= wanted:
            if found == 1 and offset.size == 2:  # one body, nothing to extract
                if offset[-1] <= limits[0]:
                    used, measures[k] = small(blocks, q, mu, scales, r, measures[k], enough, good, norms[k], limits)
                    count += used
            else:
                used, measures[k] = part(
                    blocks, label, k, q, mu, scales, r, measures[k], enough, good, norms[k], limits
                )  # fmt: skip
                count += used
            changed = True
        if measures[k] <= good:
            measures[k] = 0.0
        left = left or not measures[k] <= enough
    if changed and not left:
        top, residual = _blocks.judged(blocks, q, mu, scales, r, u)
    return found, left, count, top, residual


@in_place
def alone(W, q, mu, scales, q_norm, r, u):
    """The only contact of a problem in closed form, W (1, 3, 3), into r and u (3,); its error and residual."""
    closed_form(W[0], q, mu, r, u)
    top, residual = cones.measures(scales, u, r, mu)
    return top / q_norm, residual


@in_place
def opening(q):
    """Whether all contacts open without impulses."""
    for i in range(0, q.size, 3):
        if not q[i] >= 0.0:
            return False
    return True


@in_place
def by_matrix(W, q, mu, scales, r, u, tol, margin, q_norm, limits):
    """Small islands of a block-sparse W by `local.solve_small` to `margin` in place of r, unless r meets `tol`.

    Returns the iterations, the literature's error and the residual; u = W r + q into u.
    """
    count, top, residual = 0, np.inf, np.inf
    if r.any() or opening(q):
        pgs.velocity(W[0], W[1], W[2], q, r, u)
        top, residual = cones.measures(scales, u, r, mu)
    if not (top / q_norm <= tol and residual <= tol):
        count = local.solve_small(W, (q, mu, scales), r, margin, q_norm, limits)
        pgs.velocity(W[0], W[1], W[2], q, r, u)
        top, residual = cones.measures(scales, u, r, mu)
    return count, top / q_norm, residual


@in_place
def left_by_matrix(W, q, mu, scales, r, u, label, islands):
    """Islands of W into label (nc,), their measures and norms of q into islands (2, nc); how many."""
    found = local.islands(W[0], W[1], label)
    newton.norms_of_islands(label, q, islands[1, :found])
    newton.measures_of_islands(label, scales, islands[1, :found], u, r, mu, islands[0, :found])
    return found
