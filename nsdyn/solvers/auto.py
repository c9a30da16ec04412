"""The portfolio: what a user gets without choosing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.solvers import local as _local
from nsdyn._kernels.solvers import start as _start
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import ACCEPTED, Solution, Status
from nsdyn.solvers.continuation import continuation, continued
from nsdyn.solvers.impulse_newton import ImpulseNewton
from nsdyn.solvers.interior import interior
from nsdyn.solvers.means import ByFactors, ByMatrix, Interruptible, Means
from nsdyn.solvers.newton import DENSE, island, rows
from nsdyn.solvers.tuning import TUNING
from nsdyn.tools.arrays import Array

CONVERGED = Status.CONVERGED  # to look it up takes 70 ns

LIMITS = (DENSE, *TUNING.small, TUNING.warm[1])
"""What `_start.by_factors` takes."""

MATRIX_LIMITS = (TUNING.dense, *TUNING.small, TUNING.warm[1], TUNING.quick, TUNING.sweeps, TUNING.patience)
"""What `_local.solve_small` takes."""


class Search:
    """The best impulse of one island so far, and what it has cost.

    Attributes
    ----------
    r, best : ndarray, float
        Impulse, in place, and its measure.
    count : int
        Sweeps and factorisations.
    tol, loose, coarse : float
        The tolerances and `Tuning.coarse`, with a margin.
    large : bool
        Whether a factorisation is worth many sweeps.
    abrupt : bool
        Whether it is of a collision, by the misfit of r or since it is known.
    spent, limit : float
        Seconds by counts of operations; from the loose tolerance on the limit is a multiple of what that has cost.
    """

    def __init__(self, means: Means, r: Array, auto: Auto, large: bool) -> None:
        self.means, self.r, self.large = means, r, large
        tols = np.array([auto.tol, max(auto.tol, auto.loose), TUNING.coarse])
        self.tol, self.loose, self.coarse = (TUNING.margin * tols).tolist()
        self.best, self.count, self.spent = np.inf, 0, 0.0
        self.limit = self._longest = TUNING.longest[self.loose < self.coarse] * means.factorisation
        self._sweeps: Interruptible | None = None
        self._followed = np.inf
        p = means.problem
        _, error, residual, _ = p.solved(r, self.tol)
        self.abrupt = auto.collided or (bool(r.any()) and residual > TUNING.abrupt * self.loose)
        self._hopeless = large and (auto.collided or (self.abrupt and residual > TUNING.hopeless * self.loose))
        self._effort, self._convex = auto.effort, not p.mu.any()
        self._calm = TUNING.warm[1] if large else TUNING.calm
        if residual <= TUNING.rest * self.loose:
            self._calm = TUNING.calm_at_rest
        self._note(max(error, residual), 0, 0.0)

    def _note(self, best: float, count: int, seconds: float) -> None:
        """Book what was done."""
        self.count, self.spent = self.count + count, self.spent + seconds
        before, self.best = self.best, min(self.best, best)
        if best <= self.loose < before:
            self._bound()

    def _bound(self) -> None:
        """Bound the effort by what has been spent, where that has reached `loose`."""
        calm = 0.0 if self.abrupt else max(self._calm * self.means.factorisation, self._effort * self.spent)
        if self.best <= self.loose:
            free = 0.0 if self.large else TUNING.free * self.means.factorisation
            self.limit = min(self._longest, max(free, calm))

    def _over(self, tol: float) -> bool:
        """Whether a tolerance is met or the effort spent."""
        return self.best <= tol or self.spent >= self.limit

    def _most(self, cost: float, most: float) -> int:
        """So many iterations of that cost, or what is left of the effort if that is less, but one."""
        return max(1, int(min(most, (self.limit - self.spent) / cost)))

    def accelerated(self) -> None:
        """Accelerated Gauss–Seidel, as long as it is foreseen to suffice."""
        if not self._over(self.tol):
            used, best = self.means.accelerated(self.r, self.tol, TUNING.sweeps, TUNING.patience)
            self._note(best, used, used * self.means.accelerated_sweep)

    def newton(self, penalty: float, most: int, tol: float) -> None:
        """Newton from the best impulse."""
        if not self._over(tol):
            cost = self.means.factorisation
            used, best = self.means.newton(self.r, tol, penalty, self._most(cost, most))
            self._note(best, used, used * cost)

    def warm(self) -> None:
        """Newton from a warm start; one that misses by far and gains nothing in a few steps is of a collision."""
        start, sharp = self.best, TUNING.sharp(self.tol)
        if self.abrupt:
            self.newton(TUNING.warm[0], TUNING.peek, sharp)
            self.abrupt = self.best > TUNING.gain * start
            if self.abrupt:
                return
            self._bound()
        self.newton(*TUNING.warm, sharp)

    def _cold(self, x: Array, used: int, best: float) -> None:
        """Book what a method from nothing has found; kept where better than the best."""
        if best < self.best:
            self.r[:] = x
        self._note(best, used, used * self.means.factorisation)

    def interior_point(self) -> None:
        """The interior point method from nothing and Newton from where it ends, if that is near."""
        m, x, (most, finish) = self.means, np.zeros_like(self.r), TUNING.interior
        if self._over(self.tol) or self.spent + most * m.factorisation > self.limit:
            return
        p = m.problem
        used, best = interior(m.operator, p.q, p.mu, p.scales, x, self.tol, p.q_norm, most, self.coarse)
        if self.tol < best <= self.coarse:
            more, best = m.newton(x, self.tol, TUNING.near, finish)
            used += more
        self._cold(x, used, best)

    def follow(self, tol: float) -> None:
        """The path of smoothed laws from nothing."""
        cost, (least, most) = self.means.factorisation, TUNING.path
        if self._over(tol) or self._followed <= tol or self.spent + least * cost > self.limit:
            return
        self._followed, x = tol, np.zeros_like(self.r)
        self._cold(x, *continuation(self.means, x, tol, self._most(cost, most)))

    def follow_on(self, tol: float) -> None:
        """The same from the best."""
        cost, (misses, most) = self.means.factorisation, TUNING.onward
        if not self._over(tol):
            x = self.r.copy()
            self._cold(x, *continued(self.means, x, misses * self.best, tol, self._most(cost, most)))

    def sweep(self, factorisations: float, tol: float) -> None:
        """Sweeps with momentum that take as long as so many factorisations, from the best or on from the last."""
        if self._over(tol):
            return
        if self._sweeps is None or self.best < TUNING.restart * self._sweeps.best:
            self._x = self.r.copy()
            self._sweeps = self.means.nesterov(self._x)
        cost, before = self.means.sweep, self._sweeps.count
        most = before + self._most(cost, factorisations * self.means.factorisation / cost)
        self._sweeps.run(tol, most, TUNING.idle)
        if self._sweeps.best < self.best:
            self.r[:] = self._x
        used = self._sweeps.count - before
        self._note(self._sweeps.best, used, used * cost)

    def rounds(self, tol: float) -> None:
        """Sweeps and Newton in turn, the next time twice as long; paths where that gains little.

        The first time both do, a path begins at the best, and where sweeps are stuck again and again one from nothing.
        Without friction the interior point method takes the place of the first: of a convex problem it needs less.
        """
        lengths, (little, patience), on = [TUNING.first_sweep, TUNING.first_newton], TUNING.stuck, True
        for _ in range(TUNING.rounds):
            start = self.best
            self.sweep(lengths[0], tol)
            stuck = self.best > little * start
            self.newton(TUNING.far, lengths[1], tol)
            lengths = [lengths[0] if stuck else 2 * lengths[0], 2 * lengths[1]]
            patience -= stuck
            if on and self.best > little * start:
                if self._convex:
                    self.interior_point()
                else:
                    self.follow_on(tol)
                on = False
            if stuck and patience <= 0:
                self.follow(tol)

    def creep(self) -> None:
        """Sweeps to what they may be asked for and one long run of Newton from there, which more sweeps would undo."""
        self.sweep(TUNING.first_sweep, self.coarse)
        self.newton(TUNING.warm[0], TUNING.creep[1], self.tol)

    def impulses(self) -> None:
        """Newton in the impulses, where it is affordable: it factorises W, whose size grows with the contacts."""
        cost = TUNING.impulse_cost * float(self.r.size) ** 3
        if self._over(self.tol) or self.spent + TUNING.impulse_steps * cost > self.limit:
            return
        p = self.means.problem
        solution = ImpulseNewton(self.tol, TUNING.impulse_steps)(p, self.r)
        best = max(solution.error, solution.residual)
        if best < self.best:
            self.r[:] = solution.r
        self._note(best, solution.iterations, solution.iterations * cost)

    def run(self) -> None:
        """All means in turn: for a large problem first what reaches `loose`, then what is quick, then all the rest."""
        if self.r.any() and not (self._hopeless or (self.large and self.tol > self.coarse)):
            self.warm()
        if self.large and self.loose >= self.coarse:
            self.rounds(self.loose)
        elif self.large and self.coarse <= TUNING.creep[0] * self.loose:
            self.creep()
        if not (self.large and self.abrupt):
            self.accelerated()
            self.interior_point()
        if self.large and self.loose >= self.coarse:
            self.newton(TUNING.far, TUNING.from_loose, self.tol)
        self.follow(self.tol)
        for k in range(TUNING.last_rounds):
            self.sweep(TUNING.last_sweep, self.tol)
            self.newton(TUNING.far, TUNING.last_newton << k, self.tol)
        self.impulses()
        if self.best <= self.tol and not (self.large and (self.abrupt or self.tol > self.coarse)):
            # To the last digits, see `Tuning.polish`.
            self.count += self.means.newton(self.r, TUNING.sharp(self.tol), TUNING.near, TUNING.finish)[0]


@dataclass(frozen=True)
class Auto:
    """Portfolio, island by island, to a tolerance where it buys something and with a bound on effort everywhere.

    An island with one contact is solved in closed form, one of few bodies by Newton from any start: both in one kernel
    call. On larger ones a warm start first gets a few Newton steps, since the contact states of the last step mostly
    hold. Large islands, where a factorisation is worth many sweeps, then come to `loose`
    in rounds of sweeps with momentum and of Newton, each twice as long as the one before, after some by continuation;
    where `loose` is finer than sweeps reach, by one long run of Newton from where they end.
    Towards `tol` there are accelerated Gauss–Seidel, as long as it is foreseen to suffice, the interior point method
    followed by Newton, and continuation along smoothed laws, both from nothing; then sweeps and Newton from the best so
    far. A problem given by W alone is solved on its impulses by the same means, so that W need not be symmetric.

    What meets `tol` is CONVERGED. Effort towards it is bounded by a multiple of what it took to meet `loose`, in
    operations and not in time, so that results do not depend on the machine; what then meets `loose` is LOOSE:
    accepted, with its error on record. Where the warm start misses by far, in a collision, a problem has many solutions
    further apart than answers of either tolerance, and nothing is done beyond `loose`. What misses `loose` has failed;
    it is checked for a Slater point, without which no solution is guaranteed, and its status says so.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    loose : float
        What is acceptable where `tol` costs too much; `tol` itself where that is looser, and then every problem gets
        all means.
    effort : float
        Bound on all effort, as a multiple of that for `loose`; small problems may take `Tuning.free` in any case.
    accept : float
        Fraction of the tolerance within which a warm start is the solution of an island.
    """

    tol: float = 1e-8
    loose: float = 1e-4
    effort: float = 10.0
    accept: float = 1.0

    collided: ClassVar[bool] = False
    """Whether problems are known to be of a collision."""

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        start = clock()
        if problem.blocks is None:
            solution = self._given_matrix(problem, r0, start)
        else:
            r = np.zeros(problem.q.size) if r0 is None else problem.impulse(r0).copy()
            solution = self._given_factors(problem, r, start) if problem.nc else self._judged(problem, r, 0, start)
        return solution if solution.status in ACCEPTED else self._explained(problem, solution)

    def loosely(self, problem: FC3D, r0: Array) -> Solution:
        """Solve the problem from r0 (3 nc,), N·s, large islands to the loose tolerance only, as those of a collision.

        For what follows on such a solution and differs little.
        """
        return _Loosely(self.tol, self.loose, self.effort, self.accept)(problem, r0)

    def roughly(self, problem: FC3D, r0: Array) -> Solution | None:
        """Few sweeps of large islands from r0 where that misses by far, None where it does not.

        For a problem that is posed anew with what its motion shows: a miss of more than `Tuning.hopeless` loose
        tolerances is of a collision, and the sweeps end within it.

        Parameters
        ----------
        problem : FC3D
        r0 : ndarray, shape (3 nc,)
            N·s.
        """
        if not r0.any() or problem.solved(r0, self.tol)[2] <= TUNING.hopeless * max(self.tol, self.loose):
            return None
        return _Roughly(self.tol, self.loose, self.effort, self.accept)(problem, r0)

    def _judged(self, problem: FC3D, r: Array, count: int, start: float) -> Solution:
        """Solution of an impulse, since the time `start`."""
        _, error, residual, u = problem.solved(r, self.tol)
        return self._measured(r, u, error, residual, count, start)

    def _measured(self, r: Array, u: Array, error: float, residual: float, count: int, start: float) -> Solution:
        """Solution of an impulse of those measures."""
        otherwise = Status.LOOSE if max(error, residual) <= self.loose else Status.MAX_ITERATIONS
        spent = clock() - start
        return Solution.measured(r, u, error, residual, self.tol, count, spent, otherwise)

    @staticmethod
    def _explained(problem: FC3D, solution: Solution) -> Solution:
        """The solution with `Status.NO_SLATER_POINT` where none is guaranteed to exist."""
        from nsdyn.problem.slater import has_slater_point  # rarely needed, and its imports take long

        if solution.status is Status.MAX_ITERATIONS and has_slater_point(problem) is False:
            return solution._replace(status=Status.NO_SLATER_POINT)
        return solution

    def _given_factors(self, problem: FC3D, r: Array, start: float) -> Solution:
        """Solve a problem with factors from r, in place of r, since the time `start`."""
        enough, nc, blocks = TUNING.sharp(self.tol), problem.nc, cast(Blocks, problem.blocks)
        u, label, islands = np.empty(3 * nc), np.empty(nc, np.int64), np.empty((3, nc))
        given = problem.q, problem.mu, problem.scales
        found, left, count, error, residual = _start.by_factors(
            blocks.arrays, *given, r, u, label, islands, enough, TUNING.margin * self.accept * self.tol, LIMITS
        )
        if not left:
            error /= problem.q_norm
            if error <= self.tol and residual <= self.tol:
                # As `Solution.measured`, in a third of the time
                return tuple.__new__(Solution, (r, u, CONVERGED, error, residual, count, clock() - start))
            return self._measured(r, u, error, residual, count, start)
        measures = islands[0, :found]
        for k in (~(measures <= enough)).nonzero()[0].tolist():
            contacts, part = island(blocks, label, k)
            i = rows(contacts, nc)
            x = r[i].copy()
            means = ByFactors(part, problem.q[i], problem.mu[contacts], problem.scales[contacts])
            count += self._island(means, x, part.n > DENSE)
            r[i] = x
        return self._judged(problem, r, count, start)

    def _given_matrix(self, problem: FC3D, r0: Array | None, start: float) -> Solution:
        """Solve a problem given by W alone from r0, since the time `start`."""
        W, q, mu, q_norm = problem.csr, problem.q, problem.mu, problem.q_norm
        scales, nc = problem.scales, mu.size
        r = np.zeros(q.size) if r0 is None else problem.impulse(r0).copy()
        u = np.empty(q.size)
        if nc == 1:
            count, (error, residual) = 1, _start.alone(W[2], q, mu, scales, q_norm, r, u)
        else:
            given, margin = (W, q, mu, scales, r, u), TUNING.margin * self.tol
            count, error, residual = _start.by_matrix(*given, self.tol, margin, q_norm, MATRIX_LIMITS)
        if error <= self.tol and residual <= self.tol:
            # As `Solution.measured`, in a third of the time
            found = r, u, CONVERGED, error, residual, count, clock() - start
            return tuple.__new__(Solution, found)
        label, islands = np.empty(nc, np.int64), np.empty((2, nc))
        measures = islands[0, : _start.left_by_matrix(W, q, mu, scales, r, u, label, islands)]
        for k in (~(measures <= TUNING.margin * self.tol)).nonzero()[0]:
            contacts = np.flatnonzero(label == k)
            i = rows(contacts, nc)
            x, part = r[i], _local.extract(W, contacts)
            means = ByMatrix(part, q[i], mu[contacts], scales[contacts])
            count += self._island(means, x, contacts.size > TUNING.dense)
            r[i] = x
        return self._judged(problem, r, count, start)

    def _island(self, means: Means, r: Array, large: bool) -> int:
        """Solve one island in place of r; iterations used."""
        search = Search(means, r, self, large and means.factorisation > TUNING.heavy * means.sweep)
        self._run(search)
        return search.count

    def _run(self, search: Search) -> None:
        """All that an island is worth."""
        search.run()


class _Loosely(Auto):
    """`Auto` for what is known to be of a collision."""

    collided: ClassVar[bool] = True


class _Roughly(Auto):
    """`Auto` with one round of sweeps for a large island, of which nobody asks why it is not solved."""

    def _run(self, search: Search) -> None:
        if search.large:
            search.sweep(TUNING.first_sweep, TUNING.hopeless * search.loose)
        else:
            search.run()

    @staticmethod
    def _explained(problem: FC3D, solution: Solution) -> Solution:
        return solution
