"""Semismooth Newton method for the velocity, within the proximal method of multipliers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import newton as _kernels
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Operator, operator
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.options import Count, Options, Positive

DENSE = 120
"""Largest number of coordinates of an island with dense factorisations: up to it LAPACK in the kernel is faster than a
sparse call."""

PENALTY = 1e5
"""First penalty times λ_max(W_cc) from the result of another method; the penalty adapts."""

MARGIN = 0.99
"""Fraction of the tolerance to which islands are solved, so that round-off keeps the whole problem below it."""


class Multipliers:
    """Proximal method of multipliers of `_kernels.newton`, with interruptions. The best impulse so far is in r.

    Its measure is `best`, after `count` factorisations; the method has `ended` if no penalty is left to try. For an
    island of few coordinates each run is one kernel call that starts from the best impulse.
    """

    def __init__(self, problem: FC3D, W: Operator, r: Array, penalty: float) -> None:
        self.problem, self.W, self.r, self._penalty = problem, W, r, penalty
        self.count, self.best, self.ended = 0, np.inf, False
        blocks = problem.blocks
        self._dense = blocks.arrays if blocks is not None and blocks.n <= DENSE else None
        if self._dense is None:
            self._steps = self._taken()
            next(self._steps)

    def run(self, tol: float, most: int) -> None:
        """Continue to the tolerance or for `most` factorisations."""
        if self._dense is None:
            for _ in range(most):
                if self.best <= tol or next(self._steps, None) is None:
                    break
            return
        p = self.problem
        given = self._dense, p.q, p.mu, p.scales, p.q_norm
        used, self.best = _kernels.dense(given, self.r, tol, tol, self._penalty, most)
        self.count, self.ended = self.count + used, used < most

    def _taken(self) -> Iterator[bool]:
        """Measure the initial impulse, then take one Newton step at a time: `_kernels.dense` for any W."""
        W, penalty, q, mu, scales = self.W, self._penalty, self.problem.q, self.problem.mu, self.problem.scales
        given = mu, scales, self.problem.q_norm
        (P, step), A, estimate = np.empty((2, self.r.size)), np.empty((mu.size, 3, 3)), self.r.copy()
        y = W.change(estimate)
        own, y = W.relative(y) + q, np.zeros_like(y)
        u, kept, inner, before = own.copy(), y, 0, np.inf
        self.best = float(_cones.measure_at(scales, u, estimate, mu, given[2]))
        yield True
        while penalty > _kernels.LEAST:
            if inner == 0:
                rho = penalty / scales
                _kernels.projected(u, estimate, rho, mu, P, step, A)
            try:
                y = y + W.towards(A, step, y)
            except RuntimeError:
                break
            self.count += 1
            u = W.relative(y) + own
            _kernels.projected(u, estimate, rho, mu, P, step, A)
            vectors = u, W.product(P) + q, own, P, estimate, self.r
            verdict, so_far = _kernels.judge(given, vectors, (penalty, inner + 1, before, self.best))
            penalty, inner, before, self.best = so_far
            if verdict == _kernels.SETTLED:
                y = kept = y - W.change(step)
            elif verdict == _kernels.FAILED:
                y, u = kept, W.relative(kept) + own
            yield True
        self.ended = True


def newton(problem: FC3D, W: Operator, r: Array, tol: float, penalty: float, most: int) -> tuple[int, float]:
    """Solve by Newton's method for any W from r (3 nc,), N·s, in place; return (factorisations, measure of r).

    At most `most` factorisations are made.
    """
    run = Multipliers(problem, W, r, penalty)
    run.run(tol, most)
    return run.count, run.best


def part(problem: FC3D, label: Index, k: int) -> tuple[Any, FC3D]:
    """Return the rows of island k in vectors of 3 nc entries, and the island as a problem of its own."""
    if (found := problem.kept.get((part, k))) is None:
        found = problem.kept[part, k] = _part(problem, label, k)
    i, own = found
    return (i, problem) if own is None else (i, own.with_velocity(problem.q[i]))


def _part(problem: FC3D, label: Index, k: int) -> tuple[Any, FC3D | None]:
    """Return the rows of island k, and the island as a problem of its own; None if it is the whole problem."""
    blocks = problem.blocks
    whole = not label.any() and (
        blocks is None or np.unique(blocks.block[blocks.block >= 0]).size == blocks.offset.size - 1
    )
    if whole:
        return slice(None), None
    contacts = np.flatnonzero(label == k)
    i = (3 * contacts[:, None] + np.arange(3)).ravel()
    q, mu = problem.q[i], problem.mu[contacts]
    if blocks is None:
        return i, FC3D(problem.W.tocsr()[i][:, i], q, mu)
    _, own = _kernels.extract(blocks.arrays, label, k)
    return i, FC3D.from_blocks(DelassusFactors(*own), q, mu, problem.scales[contacts])


def by_islands(
    problem: FC3D, r0: Array | None, tol: float, solve: Callable[[FC3D, Operator, Array, float], tuple[int, float]]
) -> Solution:
    """Solve a problem from r0, each island by itself, unless r0 already solves it.

    `solve` takes the problem of an island, its W, the impulse to improve in place, and a tolerance. It returns the
    number of iterations and the measure of the result. Each island has its own norm of q: a tolerance that each island
    meets is met by the whole problem.
    """
    start, count = clock(), 0
    r = np.zeros_like(problem.q) if r0 is None else problem.impulse(r0).copy()
    if problem.nc and not problem.solved(r, tol)[0]:
        label = problem.islands()
        for k in range(int(label.max()) + 1):
            i, own = part(problem, label, k)
            x = r[i]
            count += solve(own, operator(own), x, MARGIN * tol)[0]
            r[i] = x
    return Solution.judge(problem, r, tol, count, clock() - start, Status.MAX_ITERATIONS)


@dataclass(frozen=True)
class Newton(Options):
    """Semismooth Newton method on the augmented Lagrangian of the velocity problem, island by island.

    Good near the solution: it converges quadratically and is insensitive to mass ratios. A rank-deficient W is no
    obstacle, since the matrix M + Σ H_c A_c H_cᵀ has the size of the coordinates. It fails from a cold start when many
    contacts change their state at once: `auto` finds the contact states first.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    penalty : float
        First penalty times λ_max(W_cc); it adapts.
    max_iter : int
        Factorisations per island.

    References
    ----------
    P. Alart, A. Curnier, A mixed formulation for frictional contact problems prone to Newton like solution methods,
    CMAME 92, 1991. V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018.
    """

    tol: Positive = 1e-8
    penalty: Positive = 10.0
    max_iter: Count = 200

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        return by_islands(problem, r0, self.tol, partial(newton, penalty=self.penalty, most=self.max_iter))
