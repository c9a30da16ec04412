"""First stage of a solve in one kernel call: measure the start, solve small islands completely, measure again."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem import cones, given
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.solvers import nesterov, newton
from nsdyn._kernels.vectors import square

MORE = 7
"""Newton steps of the second attempt, as a multiple of those of the first."""

NEAR = 30.0
"""Multiple of `enough` below which a measure that no longer falls is round-off. Where the start is `good`, `good`
itself is that bound."""

CHECK = 5
"""Sweeps between two measurements for a given W."""

BALANCED = 0.1
"""Largest product of measure and `change` with which the start of a large island is kept, as a fraction of `good`.
Changes add up if every step makes them."""

NEARLY, CLOSE = 2.0, 0.9
"""Largest measure of a start that nearly is enough, and measure to which the start is then improved, both in units of
`enough`."""


@kernel
def small(problem, r, measure, aims, limits):
    """Solve one island of few coordinates by `newton.dense` in place of r; return (factorisations, measure).

    `measure` is that of the start. The aims are (`enough`, `good`): the measure to reach, and the one required. If the
    first attempt misses `good`, a second one takes `MORE` times as many steps and aims at `good` only; redundant
    contacts may need it. If its impulses are so large that round-off explains the measure, they are no better than the
    start, which is restored.

    If the start nearly was `enough`, the result goes only so far that it just meets `enough`. Reason: at rest the start
    misses by velocities that have added up over many steps, from a far smaller imbalance of the impulses. Impulses that
    remove these velocities in one step would give the next step as much of the other sign, and its start would miss,
    too.
    """
    (enough, good), (_, penalty, max_iter) = aims, limits
    blocks, q, mu, scales, q_norm = problem
    start, missed = r.copy(), measure
    near = good if measure <= good else NEAR * enough
    count, measure = newton.dense(problem, r, enough, near, penalty, max_iter)
    if measure > good:
        used, measure = newton.dense(problem, r, good, good, penalty, MORE * max_iter)
        count += used
        if good < measure <= cones.round_off(scales, q, r, q_norm):
            copy(start, r)
            measure = missed
    if measure <= enough < missed <= NEARLY * enough:
        closer = start + (1.0 - CLOSE * enough / missed) * (r - start)
        top, residual = _blocks.judged(blocks, q, mu, scales, closer, np.empty(r.size))
        now = max(residual, top / q_norm)
        if now <= enough:
            copy(closer, r)
            measure = now
    return count, measure


@no_alloc
def closed_form(W, q, mu, r, u):
    """Solve one contact in closed form; write r (3,) and u = W r + q."""
    r[0], r[1], r[2] = cones.coulomb(W, q[0], q[1], q[2], mu[0])
    for i in range(3):
        u[i] = W[i, 0] * r[0] + W[i, 1] * r[1] + W[i, 2] * r[2] + q[i]


@kernel
def only_contact(problem, c, r):
    """Solve an island of one contact in closed form, in place of r; return its measure."""
    blocks, q, mu, scales, q_norm = problem
    most, own, at = _blocks.widest(blocks[0]), slice(c, c + 1), slice(3 * c, 3 * c + 3)
    x, y, w, u = np.empty((3, most)), np.empty((3, most)), np.empty((3, 3)), np.empty(3)
    _blocks.diagonal_block(blocks, c, 3, x, y, w)
    closed_form(w, q[at], mu[own], r[at], u)
    return cones.measure_at(scales[own], u, r[at], mu[own], q_norm)


@kernel
def part(problem, label, k, r, measure, aims, limits):
    """Solve island k of several by `small`; return -1 factorisations if it is too large.

    The norm of q in `problem` is that of the island.
    """
    blocks, q, mu, scales, q_norm = problem
    contacts, own = newton.extract(blocks, label, k)
    if own[0][-1] > limits[0]:
        return -1, measure
    impulses = r.reshape((-1, 3))
    x, own_q = impulses[contacts], q.reshape((-1, 3))[contacts].reshape(-1)
    given = own, own_q, mu[contacts], scales[contacts], q_norm
    count, measure = small(given, x.reshape(-1), measure, aims, limits)
    for e in range(contacts.size):
        copy(x[e], impulses[contacts[e]])
    return count, measure


@no_alloc
def change(label, k, r, u, mu, before):
    """Return the largest velocity change from `before` to u (3 nc,) over the largest velocity, of contacts that hold.

    These are contacts of island k with r_N > 0: their normals, and if they stick their tangents.
    """
    most, size = 0.0, 0.0
    for c in range(mu.size):
        i = 3 * c
        if label[c] == k and r[i] > 0.0:
            holds = math.sqrt(square(r[i + 1]) + square(r[i + 2])) < mu[c] * r[i]
            for j in range(i, i + (3 if holds else 1)):
                most, size = max(most, abs(u[j] - before[j])), max(size, abs(u[j]))
    return most / size if size > 0.0 else 0.0


@no_alloc(rounds=10)
def by_factors(blocks, q, mu, scales, r, u, before, label, islands, enough, good, limits):
    """Solve every island of few coordinates in place of r, unless r is good `enough` there.

    Islands of one contact are solved in closed form, others by `small`. (`small` also solves a single contact where the
    closed form misses, as it may with a singular W_cc, for instance at the tip of an arm of two joints.) Every island
    is a problem of its own, with its own norm of q: its result does not depend on other islands, and the whole is as
    good as the worst island. A larger island keeps its r if r is good and balanced (`change`): changes of the
    velocities of contacts that hold add up from step to step.

    Returns the number of islands, whether one is left unsolved, the factorisations, and, where none is left, the defect
    of the literature and the residual of r; then its velocity is in u.

    Parameters
    ----------
    blocks : tuple
    q, r, u : ndarray, shape (3 nc,)
        Free velocity, m/s, impulse, N s, and room for W r + q.
    mu, scales : ndarray, shape (nc,)
    before : ndarray, shape (3 nc,)
        Relative velocities before the impulses, m/s; empty if they are not known.
    label : ndarray of int, shape (nc,)
        Room for the island of each contact.
    islands : ndarray, shape (3, nc)
        Room for the measures of the islands, 0 for those that end `good`, their norms of q and numbers of contacts.
    enough, good : float
        Measures of an island: the aim, and the one required.
    limits : tuple
        Most coordinates, penalty, most steps.
    """
    offset, block = blocks[:2]
    found = _blocks.islands(block, offset.size - 1, label)
    measures, norms, size = islands[0, :found], islands[1, :found], islands[2, :found]
    newton.norms_of_islands(label, q, r, norms)
    top, residual = _blocks.judged(blocks, q, mu, scales, r, u)
    newton.measures_of_islands(label, scales, norms, u, r, mu, measures)
    size[:] = 0.0
    for c in range(label.size):
        size[label[c]] += 1.0
    count, left, changed, c = 0, False, False, 0
    for k in range(found):
        wanted, problem = enough, (blocks, q, mu, scales, norms[k])
        while label[c] != k:  # first contacts of islands ascend with the islands
            c += 1
        if measures[k] > enough and size[k] == 1.0:
            measures[k] = only_contact(problem, c, r)
            wanted = good
            count += 1
            changed = True
        if not measures[k] <= wanted:
            used = -1
            if found > 1 or offset.size > 2:
                used, measures[k] = part(problem, label, k, r, measures[k], (enough, good), limits)
            elif offset[-1] <= limits[0]:  # one block, nothing to extract
                used, measures[k] = small(problem, r, measures[k], (enough, good), limits)
            count += max(used, 0)
            changed = changed or used >= 0
            if used < 0 and before.size > 0 and measures[k] * change(label, k, r, u, mu, before) > BALANCED * good:
                left = True
                continue
        if measures[k] <= good:
            measures[k] = 0.0
        left = left or not measures[k] <= enough
    if changed and not left:
        top, residual = _blocks.judged(blocks, q, mu, scales, r, u)
    return found, left, count, top, residual


@kernel
def widest(blocks, label):
    """Return the coordinates of the largest island and the number of islands.

    The island of each contact goes into label (nc,).
    """
    offset, block = blocks[:2]
    found, seen, out = _blocks.islands(block, offset.size - 1, label), np.zeros(offset.size, np.bool_), 0
    size = np.zeros(found, np.int64)
    for c in range(label.size):
        for k in block[c]:
            if k >= 0 and not seen[k]:
                seen[k] = True
                size[label[c]] += offset[k + 1] - offset[k]
                out = max(out, size[label[c]])
    return out, found


@no_alloc
def alone(W, q, mu, scales, q_norm, r, u):
    """Solve a problem of one contact; write r and u = W r + q. Returns 1 and the measures, as `by_matrix`."""
    closed_form(W[0], q, mu, r, u)
    top, residual = cones.measures(scales, u, r, mu)
    return 1, top / q_norm, residual


@kernel
def in_turn(problem, r, measure, tol, limits):
    """Run momentum sweeps on all islands at once and Newton's method in turn, in place of r; return the number of both.

    `measure` is that of r at first. Newton's method gets `length` steps at first and twice as many each time. Each run
    follows sweeps of as much work: a factorisation of a W that couples all contacts costs as much as nc sweeps. Sweeps
    continue from their last iterate, or begin anew where Newton's method gained.
    """
    (W, q, mu, scales, q_norm), (most, length, penalty) = problem, limits
    nc, count, sweeps = mu.size, 0, (0, 0, measure, 0.5)
    begun, y, x, t = (W, nesterov.steps_of_matrix(W, mu), q, mu, scales, q_norm), r.copy(), r.copy(), np.ones(nc)
    while sweeps[2] > tol and sweeps[0] < most:
        end = sweeps[0] + CHECK * math.ceil(length * nc * nc * nc / W[1].size / CHECK)
        sweeps = nesterov.solve_matrix(begun, (r, y, x, t), sweeps, (tol, min(end, most), CHECK, most))
        if sweeps[2] > tol and end <= most:
            used, measure = newton.impulses(problem, r, tol, penalty, length)
            count += used
            if measure < sweeps[2]:
                copy(r, y)
                copy(r, x)
                t[:] = 1.0
                sweeps = sweeps[0], sweeps[0], measure, 0.5
        length *= 2
    return sweeps[0] + count


@no_alloc(rounds=1000)
def by_matrix(indptr, indices, data, q, mu, scales, q_norm, r, u, tol, limits):
    """Solve a problem in place of r: lone contacts in closed form, others by `in_turn`.

    Returns the number of sweeps and factorisations, the error of the literature and the residual of r, m/s. Arrays are
    separate arguments, since numba takes twice as long for arrays in tuples.

    Parameters
    ----------
    indptr, indices, data : ndarray
        W in blocks, as in `FC3D.csr`.
    q : ndarray, shape (3 nc,)
        m/s.
    mu, scales : ndarray, shape (nc,)
    q_norm : float
        m/s.
    r, u : ndarray, shape (3 nc,)
        Initial impulse and result, N·s, and room for W r + q.
    tol : float
    limits : tuple
        Most sweeps, Newton steps of the first run, penalty.
    """
    W, count = (indptr, indices, data), 0
    given.velocity(W, q, r, u)
    top, residual = cones.measures(scales, u, r, mu)
    if not (residual <= tol and top <= tol * q_norm):
        for c in range(mu.size):
            if indptr[c + 1] == indptr[c] + 1:
                at = slice(3 * c, 3 * c + 3)
                closed_form(data[indptr[c]], q[at], mu[c : c + 1], r[at], u[at])
        given.velocity(W, q, r, u)
        best = cones.measure_at(scales, u, r, mu, q_norm)
        count = in_turn((W, q, mu, scales, q_norm), r, best, tol, limits)
        given.velocity(W, q, r, u)
        top, residual = cones.measures(scales, u, r, mu)
    return count, top / q_norm, residual
