"""The portfolio: what a user gets without choosing."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from nsdyn._kernels import cones as _cones
from nsdyn._kernels import local as _local
from nsdyn._kernels import pgs as _pgs
from nsdyn._kernels import sparse as _matrix
from nsdyn._kernels import warm as _warm
from nsdyn.problem import FC3D, Array, Blocks, Solution, Status
from nsdyn.solvers.impulse_newton import ImpulseNewton
from nsdyn.solvers.interior import Local, solve_by_factors, solve_by_matrix
from nsdyn.solvers.mending import mend
from nsdyn.solvers.momentum import Sweeps, solve_free
from nsdyn.solvers.newton import DENSE, island, rows, solve_blocks

POLISH, FLOOR = 1e-5, 1e-14
"""Islands are solved to this fraction of the tolerance where Newton reaches it, but not below the round-off of FLOOR
m/s: what is left of a sticking contact's velocity is a creep that a long simulation adds up, and the impulses times
what is left of all velocities is the gap that certifies the step."""

LARGEST = 100
"""Contacts up to which an island given by W alone is solved densely, all such islands in one kernel call."""

WARM = 1e2, 6
"""Penalty and Newton steps of a warm start."""

SWEEPS, PATIENCE = 400, 20
"""Sweeps of Gauss–Seidel a cold start may take, which cost about as much as the interior point method, and the number
from which on it is foreseen whether they suffice."""

HEAVY, MOVING = (40.0, 1e-7), (10.0, 1e-5)
"""Where a factorisation costs more sweeps than the first number and the tolerance is no tighter than the second, sweeps
come first and the polish is left out: in any island, and in one that is in motion."""

MOTION = 5.0
"""An island is in motion where the largest velocity without impulses is so many times the median: at rest all are those
that the weight gives in a step, and an impulse is worth polishing, since it will last."""

TRAVEL, AGAIN = (8000, 2500), (300, 300)
"""Sweeps with momentum for impulses to travel through such an island, and those it may spend without gain: at first,
and after a region where they were stuck has been solved by itself."""

PAUSE, BRIEF = (500, 9.0), (10.0, 3)
"""Sweeps after which a few Newton steps may already do, at least so many and that many times what a factorisation is
worth; penalty and Newton steps."""

PATIENT = 10.0, 80
"""Penalty and Newton steps from where sweeps are stuck: near the solution, but on the wrong side of many kinks."""

MENDS = 10
"""Regions solved by themselves in turn."""

FINISH = 1e3, 3
"""Penalty and Newton steps of the polish."""

INTERIOR = 40, 2500
"""Limits of the interior point method and of the Newton steps that finish it."""

MATRIX = 1.5e-6
"""Seconds that a factorisation takes for a block of W given by itself, the median of 5e-7 to 3e-6 measured."""

LAST = 60
"""Newton steps in the impulses: where they converge they do so within these. They factorise W, whose size grows with
the contacts, so that few of them are affordable where contacts are many, and then there are none."""

EFFORT, LONGEST = 3.0, 10.0
"""Seconds, by counts of operations, that those Newton steps may take, and that the interior point method may take to be
tried after sweeps: the same result whatever the machine is busy with."""


def _sweep(W: Any, q: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float) -> tuple[int, float]:
    """Accelerated Gauss–Seidel in place of r, W a `Matrix` or `Factors`: (sweeps, measure)."""
    used, best = _pgs.accelerated(W, q, mu, scales, r, tol, q_norm, SWEEPS, 5, min(20, mu.size + 1), PATIENCE)
    return int(used), float(best)


def _cost(blocks: Blocks) -> float:
    """Seconds of a factorisation by counts of operations.

    Measured: 1.2 us for a coordinate and 0.09 ns for a multiplication of `elimination_work`.
    """
    return 1.2e-6 * blocks.n + 0.9e-10 * float(_matrix.elimination_work(blocks.offset, blocks.block))


def _worth(blocks: Blocks, cost: float) -> float:
    """How many sweeps, 85 ns per contact, a factorisation of that cost is worth."""
    return cost / (85e-9 * blocks.nc)


def _sweeps_first(blocks: Blocks, q: Array, worth: float, tol: float) -> bool:
    """Whether a factorisation worth so many sweeps outweighs too many of them, over free bodies."""
    if worth < MOVING[0] or tol < HEAVY[1] or blocks.n <= DENSE or (np.diff(blocks.offset) != 6).any():
        return False
    speed = np.abs(q).reshape(-1, 3).max(axis=1)
    return worth > HEAVY[0] or (tol >= MOVING[1] and bool(speed.max() > MOTION * np.median(speed)))


def _limits(cost: float, effort: float) -> tuple[int, int]:
    """INTERIOR where a factorisation takes so many seconds, and within that effort."""
    return INTERIOR[0], min(INTERIOR[1], max(INTERIOR[0], int(effort / cost)))


@dataclass(frozen=True)
class Auto:
    """Portfolio, island by island: closed form, warm Newton, accelerated Gauss–Seidel, Newton, interior point, Newton.

    Piles of free bodies whose factorisations fill in first try sweeps with momentum, unless the tolerance is tight, and
    regions where those are stuck are solved by themselves, the impulses elsewhere frozen.

    An island with one contact is solved in closed form. A warm start first gets a few Newton steps, since the contact
    states of the last step mostly hold. Otherwise accelerated Gauss–Seidel finds the states and Newton finishes from
    them; where it does not, the interior point method finds them and Newton finishes, or Newton in the impulses as the
    last resort. A problem given by W alone is solved on its impulses, so that W need not be symmetric. What is not
    solved is checked for a Slater point, without which no solution is guaranteed, and its status says so.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    accept : float
        Fraction of the tolerance within which a warm start is the solution of an island.
    heavy_tol : float
        Tolerance that is enough for islands whose factorisations cost too much, and by which the whole is judged, where
        it is looser.
    """

    tol: float = 1e-8
    accept: float = 1.0
    heavy_tol: float = 0.0

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        start = time.perf_counter()
        r = np.zeros(problem.q.size) if r0 is None else problem.impulse(r0).copy()
        tol = max(self.tol, self.heavy_tol)
        if problem.nc and problem.blocks is not None:
            solution = self._given_factors(problem, problem.blocks, r, tol, start)
        else:
            count = 0 if not problem.nc or problem.solved(r, self.tol)[0] else self._given_matrix(problem, r)
            solution = Solution.judge(problem, r, tol, count, time.perf_counter() - start, Status.MAX_ITERATIONS)
        return solution if solution.converged else self._explained(problem, solution)

    @staticmethod
    def _explained(problem: FC3D, solution: Solution) -> Solution:
        """The solution with `Status.NO_SLATER_POINT` where none is guaranteed to exist."""
        from nsdyn.formulations import has_slater_point  # rarely needed, and its imports take long

        if solution.status is Status.MAX_ITERATIONS and has_slater_point(problem) is False:
            return solution._replace(status=Status.NO_SLATER_POINT)
        return solution

    def _given_factors(self, problem: FC3D, blocks: Blocks, r: Array, tol: float, start: float) -> Solution:
        """Solve a problem with factors from r, in place of r, since the time `start`; judged by `tol`."""
        q_norm, enough, nc = problem.q_norm, max(POLISH * self.tol, FLOOR), problem.nc
        u, label, islands = np.empty(3 * nc), np.empty(nc, np.int64), np.empty((2, nc))
        found, left, count, error, residual = _warm.improve(
            *blocks, problem.q, problem.mu, problem.scales, r, u, label, islands, enough, 0.9 * self.accept * self.tol,
            q_norm, DENSE, *WARM,
        )  # fmt: skip
        if not left:
            spent = time.perf_counter() - start
            return Solution.measured(r, u, error, residual, tol, count, spent, Status.MAX_ITERATIONS)
        measures, share = islands[:, :found]
        for k in (~(measures <= enough)).nonzero()[0].tolist():
            contacts, part = island(blocks, label, k)
            i = rows(contacts, problem.nc)
            given = problem.q[i], problem.mu[contacts], problem.scales[contacts]
            r[i], used = self._island(part, *given, r[i].copy(), 0.9 * self.tol * float(share[k]), q_norm)
            count += used
        return Solution.judge(problem, r, tol, count, time.perf_counter() - start, Status.MAX_ITERATIONS)

    def _given_matrix(self, problem: FC3D, r: Array) -> int:
        """Solve a problem given by W alone in place of r; iterations used."""
        indptr, indices, data = problem.csr
        label, found = _local.islands(indptr, indices)
        q_norm = problem.q_norm
        tol = 0.9 * self.tol / np.sqrt(found)
        count = int(
            _local.solve_small(
                indptr, indices, data, problem.q, problem.mu, problem.scales, r, tol, q_norm, label, found,
                LARGEST, bool(r.any()), SWEEPS, PATIENCE,
            )
        )  # fmt: skip
        for k in np.flatnonzero(np.bincount(label) > LARGEST) if problem.nc > LARGEST else ():
            contacts = np.flatnonzero(label == k)
            i = rows(contacts, problem.nc)
            start, columns, values = _local.extract(indptr, indices, data, contacts)
            q, mu, scales = problem.q[i], problem.mu[contacts], problem.scales[contacts]
            x = r[i]
            W = Local(sp.bsr_array((values, columns, start), shape=(x.size, x.size)))
            used, best = _sweep(_pgs.matrix(start, columns, values), q, mu, scales, x, tol, q_norm)
            count += used
            if best > tol:
                y = np.empty_like(x)
                limits = _limits(MATRIX * columns.size, LONGEST)
                used, now = solve_by_matrix(W, q, mu, scales, y, tol, q_norm, limits)
                count += used
                x = y if now < best else x
            r[i] = x
        return count

    def _island(
        self, blocks: Blocks, q: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float
    ) -> tuple[Array, int]:
        """Impulse of one island and the iterations used."""
        if blocks.nc == 1:
            _cones.solve_one(blocks.delassus().data[0], q, mu[0], r)
            return r, 1
        cost, count = _cost(blocks), 0
        worth = _worth(blocks, cost)
        if _sweeps_first(blocks, q, worth, max(self.tol, self.heavy_tol)):
            enough = max(tol, self.heavy_tol)
            count, best = self._sweep_and_mend(blocks, q, mu, scales, r, enough, q_norm, worth)
            if best <= enough or INTERIOR[0] * cost > LONGEST:
                return r, count
            used, best = solve_blocks(blocks, q, mu, scales, r, enough, q_norm, *PATIENT)
            count += used
            if best <= enough:
                return r, count
        r, used = self._factorise(blocks, q, mu, scales, r, tol, q_norm)
        return r, count + used

    def _sweep_and_mend(
        self, blocks: Blocks, q: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float, worth: float
    ) -> tuple[int, float]:
        """Sweeps with momentum in place of r, Newton now and then, and direct solves of regions that are stuck."""

        def direct(part: Blocks, q: Array, mu: Array, scales: Array, r: Array) -> tuple[Array, int]:
            return self._factorise(part, q, mu, scales, r, 0.1 * tol, q_norm)

        sweeps, pause = Sweeps(blocks, q, mu, scales, r, q_norm), max(PAUSE[0], int(PAUSE[1] * worth))
        most, patience = TRAVEL
        count = 0
        while sweeps.run(tol, min(most, sweeps.count + pause), patience) and sweeps.count < most:
            x = r.copy()
            used, now = solve_blocks(blocks, q, mu, scales, x, tol, q_norm, *BRIEF)
            count += used
            if now <= tol:
                r[:] = x
                return count + sweeps.count, now
        count, best = count + sweeps.count, sweeps.best
        if best <= tol:
            return count, best
        problem, x = FC3D.from_blocks(blocks, q, mu), r.copy()
        for _ in range(MENDS):
            used = mend(problem, x, tol, direct)
            if not used:
                break
            more, now = solve_free(blocks, q, mu, scales, x, tol, q_norm, *AGAIN)
            count += used + more
            if now < best:
                best = now
                r[:] = x
            if best <= tol:
                break
        return count, best

    def _factorise(
        self, blocks: Blocks, q: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float
    ) -> tuple[Array, int]:
        """Impulse by warm Newton, sweeps, interior point, Newton, and the iterations used."""
        sharp, cost, count = max(POLISH * tol, FLOOR), _cost(blocks), 0
        if r.any() and blocks.n > DENSE:
            used, best = solve_blocks(blocks, q, mu, scales, r, sharp, q_norm, *WARM)
            count += used
            if best <= tol:
                return r, count
        W = _pgs.factors(blocks.offset, blocks.block, blocks.start, blocks.h, blocks.m_start, blocks.minv)
        used, best = _sweep(W, q, mu, scales, r, tol, q_norm)
        count += used
        if best > tol:
            x = np.empty_like(r)
            used, now = solve_by_factors(blocks, q, mu, scales, x, tol, q_norm, _limits(cost, EFFORT))
            count += used
            r, best = (x, now) if now < best else (r, best)
        if best > tol and LAST * cost * max(1.0, 3.0 * blocks.nc / blocks.n) ** 3 <= EFFORT:
            last = ImpulseNewton(tol, LAST)(FC3D.from_blocks(blocks, q, mu), r)
            count += last.iterations
            r = last.r if last.converged else r
        count += solve_blocks(blocks, q, mu, scales, r, sharp, q_norm, *FINISH)[0]
        return r, count
