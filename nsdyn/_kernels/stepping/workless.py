"""Impulses and couples in turns, until contacts that persist do no work."""

import numpy as np

from nsdyn._kernels.compiled import in_place, kernel
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.reductions import copy
from nsdyn._kernels.solvers.start import by_factors
from nsdyn._kernels.stepping.law import offsets, reconsider
from nsdyn._kernels.stepping.persistence import turn, turns

DONE, SOLVE = 0, 1
"""What is to be done: nothing, or a problem is to be solved."""

PASSES = 8
"""Most times that couples and impulses are looked for in turns; each makes what is left smaller by about h ω."""

SOLVES = 3
"""Most solves more for contacts that slide through, or stop, against what was foreseen; after the first only for those
that stop, whose slip would else be turned round."""


@in_place
def thaw(label, some, islands, before, after):
    """Leave (r, u) as they were `before` in the islands of no contact that is among `some`, in after.

    Islands by their labels (rows,); into `islands`, as large as the largest label and one, which have any of these.
    """
    islands[:] = False
    for c in range(some.size):
        if some[c]:
            islands[label[c]] = True
    for c in range(label.size):
        if not islands[label[c]]:
            for i in range(3 * c, 3 * c + 3):
                after[0][i], after[1][i] = before[0][i], before[1][i]


@in_place
def reconsider_some(solution, local, slides, back, label, islands, changed):
    """`reconsider` the contacts of some `islands` alone, by labels (nc,), of all if it is empty.

    Into changed (nc,) which slide otherwise.
    """
    for c in range(slides.size):
        changed[c] = slides[c]
    reconsider(solution, local, slides, back)
    some = False
    for c in range(slides.size):
        if islands.size > 0 and not islands[label[c]]:
            slides[c] = changed[c]
        changed[c] = slides[c] != changed[c]
        some = some or changed[c]
    return some


@kernel
def workless(blocks, contacts, velocities, bodies, given, flags, laws, off, solver, begin, state):
    """Couples as of `persistence.turn`, and impulses with them, in turns until no other couples do less work.

    Parameters
    ----------
    blocks, contacts, bodies, flags, laws : tuple
        As of `persistence.turn`.
    velocities : (v⁻, v_f)
        Shape (n,) each, m/s and rad/s: before the forces of the move, and after them but for its impulses.
    given : tuple
        mu and scales, shape (rows,), - and kg⁻¹; what moving surfaces add to u, as of `persistence.couples`; local,
        shape (5, 3 rows), without couples; r and u of the last solve, if any, shape (3 rows,), N·s and m/s.
    off : ndarray of bool, shape (rows,)
        Rows of whose islands the first solution changes that of the last solve; empty where it changes all.
    solver : tuple
        Whether problems of islands of few coordinates are solved here; `enough`, `good` and `limits` of `by_factors`;
        the tolerance; and how many more solves there are for contacts that slip otherwise.
    begin : tuple
        Whether to begin with a solve, and there only to look back, as of `reconsider`; most times that others are
        looked for; what of the first solve is known: whether (r, u) are its, factorisations, error and residual.
    state : tuple
        couple (nc, 3) and dv (n,), those that act; change (n,), that of v by r, made here if problems are solved here;
        mean (n,), the mean velocity, ½ (v⁻ + v_f + dv + change), made where nothing is left to do; left and other,
        (nc,), as of `couples`; local (5, 3 rows), b, r and u, (3 rows,): what is met, its problem and solution. All are
        changed in place.

    Returns
    -------
    tuple
        What is to be done, times that are left, how many problems were solved here, and error, residual and
        factorisations of the last one.
    """
    (before, free), (first, back, passes, (known, count, error, residual)) = velocities, begin
    (mu, scales, transport, alone, last_r, last_u), (stays, _, slides) = given, flags
    own, enough, good, limits, tol, most = solver
    _, dv, change, mean, _, other, local, b, r, u = state
    names, measures = np.empty(mu.size, np.int64), np.empty((3, mu.size))
    label, changed = np.empty(mu.size, np.int64), np.empty(slides.size, np.bool_)
    islands = np.empty(0, np.bool_)
    solved = 0
    while True:
        if not first:
            if own:
                _blocks.velocity_change(blocks, r, change)
            for i in range(mean.size):
                mean[i] = 0.5 * (before[i] + (free[i] + dv[i]) + change[i])
            if passes == 0 or not turns(mean, bodies[1].shape[0], bodies[3]):
                break
            if not turn(blocks, contacts, mean, bodies, (r, mu, transport, enough), flags, laws, alone, state):
                break
            passes, back = passes - 1, True
            last_r, last_u, off = r.copy(), u.copy(), other
        if not own:
            return SOLVE, passes, solved, error, residual, count
        if off.size > 0 and islands.size == 0:
            islands = np.empty(_blocks.islands(blocks[1], blocks[0].size - 1, label), np.bool_)
        islands[:] = True
        some, kept_r, kept_u = off, last_r, last_u
        for k in range(most + 1):
            if not known:
                norm, _ = _blocks.size_of(b, mu)
                _, missed, count, error, residual = by_factors(
                    blocks, b, mu, scales, r, u, local[0], names, measures, enough, good, limits
                )
                error /= norm or 1.0
                if missed or not (error <= tol and residual <= tol):
                    if not first:
                        copy(last_r, r)
                        copy(last_u, u)
                    return SOLVE, passes, solved, error, residual, count
            solved, known = solved + 1, False
            if some.size:
                thaw(label, some, islands, (kept_r, kept_u), (r, u))
            if not reconsider_some((r, u, b, mu), local, slides, back or k > 0, label, islands, changed):
                break
            if k < most:
                offsets(local, laws, stays, slides, b)
                some, kept_r, kept_u = changed, r.copy(), u.copy()
                if islands.size == 0:
                    islands = np.empty(_blocks.islands(blocks[1], blocks[0].size - 1, label), np.bool_)
        first = False
    return DONE, passes, solved, error, residual, count
