"""Projected Gauss–Seidel with momentum, for free bodies and for a given W."""

import math

import numpy as np

from nsdyn._kernels.compiled import kernel, no_alloc
from nsdyn._kernels.problem.cones import measure_at, project
from nsdyn._kernels.problem.given import velocity, velocity_of
from nsdyn._kernels.problem.unit_mass import CONTACT, PAIR, apply, diagonal, factors, independent, read, unit_rows
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.simd import dot

ALERT = 2.0  # opening speed, over its last change, above which a contact without impulse sleeps until the next check
CYCLE = 400  # sweeps without a better impulse after which momentum is taken to cycle from contact to contact


@no_alloc
def _local_step(w, mu, out):
    """Write 1/W_NN, W_TN and 1/lambda_max(W_TT) of a contact into out (4,); zeros for a missing row."""
    out[0] = 1.0 / w[0, 0] if w[0, 0] > 0.0 else 0.0
    mean, half, mixed = 0.5 * (w[1, 1] + w[2, 2]), 0.5 * (w[1, 1] - w[2, 2]), 0.5 * (w[1, 2] + w[2, 1])
    largest = mean + math.sqrt(half * half + mixed * mixed)
    if mu > 0.0 and largest > 0.0:
        out[1], out[2], out[3] = w[1, 0], w[2, 0], 1.0 / largest


@kernel
def local_steps(rows, mu):
    """Return `_local_step` of every contact, shape (nc, 4)."""
    out, w = np.zeros((mu.size, 4)), np.empty((3, 3))
    for c in range(mu.size):
        diagonal(rows, c, w)
        _local_step(w, mu[c], out[c])
    return out


@no_alloc
def sweep(awake, factors, given, state, keep):
    """Make one sweep over the awake contacts. It updates r = y and v = Ĥ y in place.

    Each contact gets its exact normal impulse, and its friction by one projected gradient step. The factors are (rows,
    body, steps) as in `begin`; given is (q (nc, 3), mu), the free velocity and friction. In state = (r, x, v, t), x
    (nc, 3) is the result of the last sweep and t (nc,) the parameter of the momentum. Where the momentum points against
    the step, t shrinks to `keep` of itself.
    """
    (rows, body, steps), (q, mu), (r, x, v, t) = factors, given, state
    for c in awake:
        # Unsigned indices spare the test for negative ones.
        o, a, b = CONTACT * np.uint64(c), body[c, 0], body[c, 1]
        r0, r1, r2 = r[c, 0], r[c, 1], r[c, 2]
        z0 = max(-r0, -(q[c, 0] + dot(rows, o, v, a, b)) * steps[c, 0])
        x0 = r0 + z0
        if r0 == 0.0 and x0 == 0.0:
            continue
        if mu[c] == 0.0:  # no friction: one row
            if z0 != 0.0:
                apply((z0,), rows, c, body, v)
                r[c, 0] = x0
                if z0 * (x0 - x[c, 0]) < 0.0:
                    t[c] = max(1.0, keep * t[c])
            continue
        u1, u2 = dot(rows, o + PAIR, v, a, b), dot(rows, o + PAIR + PAIR, v, a, b)
        x1 = r1 - (q[c, 1] + u1 + steps[c, 1] * z0) * steps[c, 3]
        x2 = r2 - (q[c, 2] + u2 + steps[c, 2] * z0) * steps[c, 3]
        slip, limit = x1 * x1 + x2 * x2, mu[c] * x0
        if slip > limit * limit:
            f = limit / math.sqrt(slip)
            x1 *= f
            x2 *= f
        z1, z2 = x1 - r1, x2 - r2
        if z0 != 0.0 or z1 != 0.0 or z2 != 0.0:
            apply((z0, z1, z2), rows, c, body, v)
            r[c, 0], r[c, 1], r[c, 2] = x0, x1, x2
            if z0 * (x0 - x[c, 0]) + z1 * (x1 - x[c, 1]) + z2 * (x2 - x[c, 2]) < 0.0:
                t[c] = max(1.0, keep * t[c])


@no_alloc
def extrapolate(awake, factors, mu, state):
    """Write y = P_K(r + b (r - x)), b = (t - 1)/(t + 1), into r, and r into x, and update v, for the awake contacts."""
    (rows, body, _), (r, x, v, t) = factors, state
    for c in awake:
        r0, r1, r2 = r[c, 0], r[c, 1], r[c, 2]
        b = (t[c] - 1.0) / (t[c] + 1.0)
        t[c] += 0.5
        if mu[c] == 0.0:
            z0 = b * (r0 - x[c, 0])
            x[c, 0] = r0
            if z0 != 0.0:
                r[c, 0] = max(0.0, r0 + z0)
                apply((r[c, 0] - r0,), rows, c, body, v)
            continue
        z0, z1, z2 = b * (r0 - x[c, 0]), b * (r1 - x[c, 1]), b * (r2 - x[c, 2])
        x[c, 0], x[c, 1], x[c, 2] = r0, r1, r2
        if z0 != 0.0 or z1 != 0.0 or z2 != 0.0:
            y0, y1, y2 = project(r0 + z0, r1 + z1, r2 + z2, mu[c])
            r[c, 0], r[c, 1], r[c, 2] = y0, y1, y2
            apply((y0 - r0, y1 - r1, y2 - r2), rows, c, body, v)


@no_alloc
def refresh(factors, r, v):
    """Write Ĥ r into v."""
    rows, body, _ = factors
    v[:] = 0.0
    for c in range(r.shape[0]):
        if r[c, 0] != 0.0:
            apply((r[c, 0], r[c, 1], r[c, 2]), rows, c, body, v)


@no_alloc
def measure(factors, given, r, v, u):
    """Return the larger of the literature's error and the residual in m/s of r, given v = Ĥ r; u becomes W r + q."""
    (rows, body, _), (q, mu, scales, q_norm) = factors, given
    for c in range(mu.size):
        u0, u1, u2 = read(rows, c, body, v)
        u[c, 0], u[c, 1], u[c, 2] = q[c, 0] + u0, q[c, 1] + u1, q[c, 2] + u2
    return measure_at(scales, u.reshape(-1), r.reshape(-1), mu, q_norm)


@no_alloc
def wake(u, last, r, x, awake):
    """Put the contacts that need a sweep first in `awake` and return their number.

    A contact without an impulse sleeps while it opens faster than `ALERT` times the change of its velocity u since the
    `last` check.
    """
    count = 0
    for c in range(r.shape[0]):
        change = abs(u[c, 0] - last[c, 0])
        if r[c, 0] > 0.0 or x[c, 0] > 0.0 or not u[c, 0] > ALERT * change:
            awake[count] = c
            count += 1
    return count


@kernel(rounds=1000)
def solve(given, state, so_far, limits):
    """Make sweeps with Nesterov's momentum, restarted contact by contact, from where the last call stopped.

    x' = sweep(y), y = P_K(x' + b (x' - x)) with b = (t - 1)/(t + 1), t growing by 1/2 a sweep. If the momentum of a
    contact points against its own step, (y - x')·(x' - x) > 0, the contact halves its t, or loses all of it once
    momentum cycles. Unlike a restart of all contacts, or combinations of past iterates, this survives contacts that
    change their state one after the other, as in a pile while impulses travel through it. Every `check` sweeps both
    measures are tested, and the contacts that need the next sweeps are chosen. best_r keeps the best impulse; all other
    arrays are in the `order` of the contacts. The kernel stops after `most` sweeps in all, or after `patience` sweeps
    without a better impulse. It returns (sweeps, the sweep of the best, its measure, keep).

    `given` are (order, factors, (q, mu, scales, q_norm)) as in `begin`. `state` is (best_r, y, x, v = Ĥ y, t (nc,) of
    each contact), which changes. `so_far` is the result of the last call, `limits` are (tol, most, check, patience).
    """
    order, factors, (q, mu, scales, q_norm) = given
    best_r, y, x, v, t = state
    count, last, best, keep = so_far
    tol, most, check, patience = limits
    moving = y, x, v, t
    u, before = np.full((mu.size, 3), -np.inf), np.empty((mu.size, 3))
    awake = index = np.arange(mu.size).astype(np.uint64)
    while best > tol and count < most and count - last < patience:
        count += 1
        sweep(awake, factors, (q, mu), moving, keep)
        if count % check == 0:
            refresh(factors, y, v)  # removes the round-off of the updates
            before, u = u, before
            now = measure(factors, (q, mu, scales, q_norm), y, v, u)
            if now < best:
                best, last = now, count
                for c in range(mu.size):
                    best_r[order[c]] = y[c]
            awake = index[: wake(u, before, y, x, index)]
        if count - last > CYCLE:
            keep = 0.0
        extrapolate(awake, factors, mu, moving)
    return count, last, best, keep


@kernel
def prepare(blocks, mu):
    """Prepare sweeps on W: (order of `independent`, (rows, bodies, steps) in that order, size of v̂)."""
    order = independent(blocks)
    rows, body, v = unit_rows(blocks, factors(blocks), mu, order)
    return order, (rows, body, local_steps(rows, mu[order])), v.size


@kernel
def begin(prepared, q, mu, scales, q_norm, r):
    """Begin sweeps from r (nc, 3) on a W as `prepare` gives it; tangents of r without friction become 0.

    Returns (order, (rows, bodies, steps), (q, mu, scales, q_norm)), then impulses, v̂ = Ĥ r, and the measure of r.
    """
    order, own, size = prepared
    for c in range(mu.size):
        if mu[c] == 0.0:
            r[c, 1] = r[c, 2] = 0.0
    given, y, v = (q[order], mu[order], scales[order], q_norm), r[order], np.zeros(size)
    refresh(own, y, v)
    best = measure(own, given, y, v, np.empty((mu.size, 3)))
    return (order, own, given), y, v, best


@kernel
def steps_of_matrix(W, mu):
    """Return `local_steps` of a block-sparse W."""
    (indptr, indices, data), out = W, np.zeros((mu.size, 4))
    for c in range(mu.size):
        for p in range(indptr[c], indptr[c + 1]):
            if indices[p] == c:
                _local_step(data[p], mu[c], out[c])
    return out


@no_alloc
def sweep_matrix(W, steps, q, mu, r, x, t, keep):
    """Make one `sweep` over all contacts of a block-sparse W, in place of r = y."""
    for c in range(mu.size):
        u0, u1, u2 = velocity_of(W, q, r, c)
        r0, r1, r2 = r[3 * c], r[3 * c + 1], r[3 * c + 2]
        z0 = max(-r0, -u0 * steps[c, 0])
        x0 = r0 + z0
        x1 = r1 - (u1 + steps[c, 1] * z0) * steps[c, 3]
        x2 = r2 - (u2 + steps[c, 2] * z0) * steps[c, 3]
        slip, limit = x1 * x1 + x2 * x2, mu[c] * x0
        if slip > limit * limit:
            f = limit / math.sqrt(slip)
            x1 *= f
            x2 *= f
        back = z0 * (x0 - x[3 * c]) + (x1 - r1) * (x1 - x[3 * c + 1]) + (x2 - r2) * (x2 - x[3 * c + 2])
        r[3 * c], r[3 * c + 1], r[3 * c + 2] = x0, x1, x2
        if back < 0.0:
            t[c] = max(1.0, keep * t[c])


@kernel(rounds=1000)
def solve_matrix(given, state, so_far, limits):
    """`solve` for a block-sparse W, which need not be symmetric; all contacts are awake.

    `given` are W, steps, q, mu, scales and q_norm, `state` best_r, y, x and t.
    """
    W, steps, q, mu, scales, q_norm = given
    best_r, y, x, t = state
    count, last, best, keep = so_far
    tol, most, check, patience = limits
    u = np.empty(y.size)
    while best > tol and count < most and count - last < patience:
        count += 1
        sweep_matrix(W, steps, q, mu, y, x, t, keep)
        if count % check == 0:
            velocity(W, q, y, u)
            now = measure_at(scales, u, y, mu, q_norm)
            if now < best:
                best, last = now, count
                copy(y, best_r)
        if count - last > CYCLE:
            keep = 0.0
        for c in range(mu.size):
            i = 3 * c
            b = (t[c] - 1.0) / (t[c] + 1.0)
            t[c] += 0.5
            r0, r1, r2 = y[i], y[i + 1], y[i + 2]
            y[i], y[i + 1], y[i + 2] = project(
                r0 + b * (r0 - x[i]), r1 + b * (r1 - x[i + 1]), r2 + b * (r2 - x[i + 2]), mu[c]
            )
            x[i], x[i + 1], x[i + 2] = r0, r1, r2
    return count, last, best, keep
