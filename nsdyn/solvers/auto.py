"""Default solver: a portfolio that chooses a method for each island of contacts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import start as _start
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Operator, operator
from nsdyn.problem.solution import Solution, Status
from nsdyn.solvers.continuation import Following
from nsdyn.solvers.nesterov import Sweeps
from nsdyn.solvers.newton import DENSE, MARGIN, PENALTY, Multipliers, part
from nsdyn.tools.arrays import NOTHING, Array
from nsdyn.tools.options import NonNegative, Options, Positive


@dataclass(frozen=True)
class Tuning:
    """Constants of `Auto`. Efforts are counted in factorisations, so that results do not depend on the machine.

    The measure of an impulse is the larger of `FC3D.error` and `FC3D.residual`.
    """

    sweeps_per_factorisation: int = 64
    """Sweeps that count as one factorisation, as measured in a wall."""

    round_length: int = 8
    """Factorisations of Newton's method in the first round, and their growth factor from each round to the next."""

    path_length: int = 1024
    """Most factorisations of one smoothing path in a round, from the second round on: as many as `Continuation` takes
    alone. Most paths that solve a problem end before 350, some as late as 900. With 256, one in ten hard problems
    remains unsolved."""

    smoothing: tuple[float, float] = (1e10, 1e2)
    """Initial smoothing of the first path, see `Following`, and its growth factor from each path to the next.
    From the best impulse most paths are short, and some are short only if they begin farther off, with more
    smoothing."""

    rounds: int = 4
    """Largest number of rounds."""

    sweeps: tuple[int, int] = (20, 80)
    """Factorisations' worth of momentum sweeps in a round: for tight tolerances, and for tolerances of `polish` and
    looser. Sweeps mostly reach the latter by themselves, and Newton's method hardly sooner."""

    patience: int = 128
    """Sweeps without gain that end the sweeps of a round after the first, if the round begins with a measure of at most
    `polish`. From farther off sweeps may gain late, and no other method reaches a loose tolerance as soon."""

    warm_steps: int = 4
    """Newton steps of one run from a warm start. Runs are repeated as long as they gain."""

    warm_gain: float = 0.1
    """Largest ratio of the measures after and before a run of `warm_steps` at which another run follows."""

    loose_limit: int = 50
    """Most factorisations beyond the loose tolerance. Problems that take more rarely reach the tight one."""

    small: tuple[float, int] = (1e2, 60)
    """Penalty, and Newton steps at most, for islands of few bodies. The impulses that redundant contacts exchange drift
    from step to step by round-off times the penalty. With penalties from 1e4 on, they drift as far as the cones of
    bodies at rest."""

    polish: float = 1e-5
    """Fraction of the tolerance to which Newton's method continues as long as it gains. On larger islands it does so
    only for tolerances of at most this value. Reason: the velocity that remains at a sticking contact is a slow drift,
    which accumulates in a long simulation. (A problem given by W alone is not polished, since no simulation gives W
    alone.)"""

    rough: float = 100.0
    """Multiple of the loose tolerance that suffices for a problem solved only to find out which contacts it lacks, see
    `Auto.roughly`."""


TUNING = Tuning()

FLOOR = 1e-14
"""Round-off in m/s. Sharper measures than this are not sought, whatever `Tuning.polish` gives."""


LIMITS = (DENSE, *TUNING.small)
"""Limits passed to `_start.by_factors`: most coordinates, penalty, most Newton steps."""

IN_TURN = TUNING.sweeps_per_factorisation * TUNING.sweeps[0], TUNING.round_length, TUNING.small[0]
"""Limits passed to `_start.by_matrix`: most sweeps, Newton steps of the first run, penalty."""

CONVERGED = Status.CONVERGED  # a global, since looking up the attribute takes 70 ns


class Search:
    """Search for the impulse of one island, from an impulse r (3 nc,), N·s; tol, loose and effort are as in `Auto`.

    The best impulse so far is in r, its measure in `best`. `count` are the sweeps and factorisations so far, `spent`
    the factorisations, where sweeps count as fractions; their `limit` is infinite until the loose tolerance is met.
    """

    def __init__(self, problem: FC3D, r: Array, tol: float, loose: float, effort: float) -> None:
        self.problem, self.r = problem, r
        self.tol, self.loose, self._effort = MARGIN * tol, MARGIN * max(tol, loose), effort
        self.sharp = sharp(tol) if tol <= TUNING.polish and problem.blocks is not None else self.tol
        self.best, self.count, self.spent, self.limit = np.inf, 0, 0.0, np.inf
        self._sweeps: Sweeps | None = None
        self._newton: Multipliers | None = None
        _, error, residual, _ = problem.solved(r, tol)
        self._note(max(error, residual), 0, 0)

    @cached_property
    def W(self) -> Operator:
        """W of the island, in a form that can be factorised."""
        return operator(self.problem)

    def _note(self, best: float, count: int, spent: float, x: Array | None = None) -> None:
        """Record the work done, and keep its result x if it is better than the best, even with round-off counted."""
        before, self.count, self.spent = self.best, self.count + count, self.spent + spent
        if x is not None and best < before:
            best = max(best, self.problem.round_off(x))
        if best < before:
            self.best = best
            if x is not None:
                self.r[:] = x
        if self.best <= self.loose < before:
            self.limit = self.spent + min(self._effort * self.spent or np.inf, TUNING.loose_limit)

    def _most(self, wanted: float) -> float:
        """Return the `wanted` factorisations, or as many as the limit still allows."""
        return min(wanted, self.limit - self.spent)

    @property
    def over(self) -> bool:
        """Whether the tolerance or the round-off is reached, or the effort spent."""
        return self.spent >= self.limit or self.best <= self.tol or self.best <= self.problem.round_off(self.r)

    def sweep(self, patience: int) -> None:
        """Run momentum sweeps, first to the loose tolerance, which sets the limit of effort, then to the tight one.

        Continue the last sweeps, or begin anew from the best impulse if another method found it.
        """
        if self._sweeps is None or self.best < self._sweeps.best:
            self._x = self.r.copy()
            self._sweeps = Sweeps(self.problem, self._x)
        for tol in sorted({max(self.loose, self.tol), self.tol}, reverse=True):
            if self.best > tol:
                wanted = TUNING.sweeps[tol >= MARGIN * TUNING.polish]
                before, most = self._sweeps.count, int(TUNING.sweeps_per_factorisation * self._most(wanted))
                self._sweeps.run(tol, before + most, patience)
                used = self._sweeps.count - before
                self._note(self._sweeps.best, used, used / TUNING.sweeps_per_factorisation, self._x)

    def settle(self) -> None:
        """Replace the best impulse by the result of one more sweep, unless a sweep produced it.

        The result may be worse, but it meets each tolerance that the best impulse meets.
        """
        if self._sweeps is not None and self._sweeps.best == self.best:
            return
        sweeps = Sweeps(self.problem, x := self.r.copy())
        sweeps.once()
        self.count += sweeps.count
        if sweeps.best <= max(self.best, self.tol if self.best <= self.tol else self.loose):
            self.best, self.r[:] = sweeps.best, x

    def newton(self, most: float, tol: float) -> None:
        """Run Newton's method from the best impulse, or continue its last run, for at most `most` factorisations."""
        run = self._newton
        if run is None or run.ended or self.best < run.best:
            run = self._newton = Multipliers(self.problem, self.W, self.r.copy(), PENALTY)
        before = run.count
        run.run(tol, int(np.ceil(self._most(most))))
        used = run.count - before
        self._note(run.best, used, used, run.r)

    def follow(self, wide: float) -> None:
        """Follow a smoothing path from the best impulse, with the initial smoothing `wide` of `Following`."""
        path = Following(self.problem, self.W, self.tol, self.r, wide)
        path.run(int(np.ceil(self._most(TUNING.path_length))))
        self._note(path.best, path.count, path.count, path.r)

    def converge(self, tol: float) -> None:
        """Run Newton's method to the sharp tolerance, a few steps at a time, until `tol` is met or gains cease."""
        before = np.inf
        while self.best > tol and self.best <= TUNING.warm_gain * before:
            before = self.best
            self.newton(TUNING.warm_steps, self.sharp)

    def run(self, warm: bool) -> None:
        """Run Newton's method from a warm start, then rounds of all methods, then Newton's method to the last digits.

        Newton's method takes more steps in each round. It usually solves a problem from nearby and stalls from farther
        off, where a path comes before it. A converged impulse usually improves when it is projected on its cones. A
        loose impulse is replaced by the result of one sweep: sliding contacts then have all the friction they can have,
        and no impulse is outside its cone.
        """
        if warm and self.sharp < self.tol and self.best <= TUNING.rough * self.loose:
            self.converge(self.tol)
        first, wider = TUNING.smoothing
        for k in range(TUNING.rounds):
            if self.over:
                break
            if k > 0 or self.problem.blocks is not None:  # a problem given by W alone has had its first sweeps
                late = k > 0 and self.best <= TUNING.polish
                self.sweep(TUNING.patience if late else TUNING.sweeps_per_factorisation * sum(TUNING.sweeps))
            means = [partial(self.newton, TUNING.round_length ** (k + 1), self.tol)]
            near = self.best <= max(self.loose, TUNING.polish)
            if k > near:
                means.insert(near, partial(self.follow, first * wider ** (k - 1)))
            for mean in means:
                if not self.over:
                    mean()
        if self.best <= self.tol:
            self.converge(self.sharp)
        if self.best > min(self.tol, TUNING.polish):
            self.settle()
        elif _cones.into_cones(self.r, self.problem.mu, inside := np.empty_like(self.r)):
            _, error, residual, _ = self.problem.solved(inside, self.tol)
            self._note(max(error, residual), 0, 0, inside)


def sharp(tol: float) -> float:
    """Return the sharp tolerance: the measure to which a problem is solved if Newton's method reaches it."""
    return max(TUNING.polish * tol, FLOOR)


@dataclass(frozen=True)
class Auto(Options):
    """Portfolio of methods, chosen island by island, with a bound on the effort beyond the loose tolerance.

    One kernel call solves all islands of one contact in closed form, and those of few bodies by Newton's method from
    any start. On a larger island with a warm start Newton's method comes first, as long as it gains, since most contact
    states of the last step still hold. Then come rounds of momentum sweeps, Newton's method (longer in each round) and
    a smoothing path from the best impulse (with more smoothing in each round). Far from the solution the path comes
    before Newton's method, from the second round on; near it, after Newton's method, from the third round on. Sweeps
    and Newton's method continue from their own last iterates, or begin anew from the best impulse if another method has
    found a better one. For a problem given by W alone, which need not be symmetric, one kernel call makes the sweeps of
    the first round, in turn with Newton's method where that costs no more. The same methods follow.

    A solution that meets `tol` is CONVERGED. The effort towards `tol` is bounded by a multiple of the effort that met
    `loose`, and by `Tuning.loose_limit`. Effort is counted in operations and not in time, so that results do not depend
    on the machine. A solution that then meets only `loose` is LOOSE: it is accepted and its error recorded. A solution
    that misses `loose` has failed. It is STALLED if its error is mere round-off. Otherwise the problem is checked for a
    Slater point, without which no solution is guaranteed, and the status says so.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    loose : float
        Tolerance that is acceptable where `tol` costs too much. If `tol` is looser it replaces `loose`, and every
        problem gets all methods.
    effort : float
        Bound on the effort beyond `loose`, as a multiple of the effort that met `loose`. It is at most
        `Tuning.loose_limit` anyway, and equal to it where the start meets `loose`.
    """

    tol: Positive = 1e-8
    loose: Positive = 1e-4
    effort: NonNegative = 4.0

    @cached_property
    def aims(self) -> tuple[float, float]:
        """Measures (m/s or -) for islands of few coordinates: the aim of Newton's method, and the one required."""
        return sharp(self.tol), 0.9 * self.tol  # a wide margin costs nothing there

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        return self._explained(problem, self._solved(problem, r0, self.tol))

    def balanced(self, problem: FC3D, r0: Array, before: Array) -> Solution:
        """Solve the problem from r0; large islands also if r0 meets the tolerance but its impulses are out of balance.

        The impulses of r0 are out of balance if they change the velocities of contacts that hold (`_start.change`).
        Even changes within the tolerance add up if every step makes them. `before` (3 nc,) are the relative velocities
        before the impulses, m/s.
        """
        return self._explained(problem, self._solved(problem, r0, self.tol, before=before))

    def loosely(self, problem: FC3D, r0: Array) -> Solution:
        """Solve the problem from r0 (3 nc,), N·s; large islands only to the loose tolerance, as in a collision.

        Meant for a problem that differs little from one whose solution was loose.
        """
        return self._explained(problem, self._solved(problem, r0, max(self.tol, self.loose)))

    def roughly(self, problem: FC3D, r0: Array, effort: float) -> Solution | None:
        """Solve large islands to `Tuning.rough` loose tolerances; None if r0 is 0 or its residual is as small.

        Meant for a problem that is posed again with the contacts its motion shows. A start that misses by more than
        this many tolerances belongs to a collision. `effort` bounds the further effort towards the loose tolerance, as
        a multiple of the effort so far.
        """
        loose = max(self.tol, self.loose)
        enough = TUNING.rough * loose
        if not r0.any() or problem.solved(r0, self.tol)[2] <= enough:
            return None
        return self._solved(problem, r0, loose if effort else enough, (enough, effort))

    def _solved(
        self,
        problem: FC3D,
        r0: Array | None,
        large: float,
        bound: tuple[float, float] | None = None,
        before: Array = NOTHING,
    ) -> Solution:
        """Solve the problem from r0; islands that need more than one kernel call to the tolerance `large`.

        For large islands `bound` is (loose, effort), with the meaning these have in `Auto`; by default it is taken from
        `Auto`. `before` is that of `balanced`.
        """
        start, nc, blocks = clock(), problem.mu.size, problem.blocks
        r, u = np.zeros(3 * nc) if r0 is None else problem.impulse(r0).copy(), np.empty(3 * nc)
        if not nc:
            return Solution.judge(problem, r, self.tol, 0, clock() - start)
        if blocks is None:
            W, q, mu, scales, q_norm = problem.csr, problem.q, problem.mu, problem.scales, problem.q_norm
            if nc == 1:
                count, error, residual = _start.alone(W[2], q, mu, scales, q_norm, r, u)
            else:
                count, error, residual = _start.by_matrix(*W, q, mu, scales, q_norm, r, u, self.aims[1], IN_TURN)
            left = not (error <= self.tol and residual <= self.tol)
        else:
            label, islands = np.empty(nc, np.int64), np.empty((3, nc))
            factors = blocks.arrays, problem.q, problem.mu, problem.scales
            found, left, count, error, residual = _start.by_factors(
                *factors, r, u, before, label, islands, *self.aims, LIMITS
            )
            error /= problem.q_norm
        if left:
            if blocks is None:
                label = problem.islands()
                found = int(label.max()) + 1
            for k in range(found):
                if blocks is None or not islands[0, k] == 0.0:
                    i, own = part(problem, label, k)
                    x = r[i]
                    small = own.blocks is not None and own.blocks.n <= DENSE
                    limits = (self.loose, self.effort) if small or bound is None else bound
                    search = Search(own, x, self.tol if small else large, *limits)
                    search.run(r0 is not None and bool(x.any()))
                    r[i], count = x, count + search.count
            _, error, residual, u = problem.solved(r, self.tol)
        if error <= self.tol and residual <= self.tol:
            # Takes half the time of Solution(...)
            return tuple.__new__(Solution, (r, u, CONVERGED, error, residual, count, clock() - start))
        otherwise = Status.LOOSE
        if (worst := max(error, residual)) > self.loose:
            otherwise = Status.STALLED if worst <= max(FLOOR, problem.round_off(r)) else Status.MAX_ITERATIONS
        return Solution.measured(r, u, error, residual, self.tol, count, clock() - start, otherwise)

    @staticmethod
    def _explained(problem: FC3D, solution: Solution) -> Solution:
        """Return the solution, with `Status.NO_SLATER_POINT` if it failed and no solution is guaranteed to exist."""
        if solution.status is not Status.MAX_ITERATIONS:
            return solution
        from nsdyn.problem.slater import has_slater_point  # rarely needed, and its imports take long

        return solution._replace(status=Status.NO_SLATER_POINT) if has_slater_point(problem) is False else solution
