"""The portfolio: what a user gets without choosing."""

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
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import NonNegative, Options, Positive


@dataclass(frozen=True)
class Tuning:
    """Constants of `Auto`. Efforts are counted in factorisations, so that results do not depend on the machine."""

    cost: int = 64
    """Sweeps that count as a factorisation, as they do in a wall."""

    length: int = 8
    """What Newton takes in the first round, and in the next so many times what it took in the last."""

    path: int = 256
    """What a path of smoothed laws takes in a round from the second on. A way that long is rather begun anew."""

    wide: tuple[float, float] = (1e6, 1e2)
    """How wide the first path begins, see `Following`, and how many times as wide each later one: from the best impulse
    most ways are short, and some only from farther off."""

    rounds: int = 4
    """So many at most."""

    sweeps: tuple[int, int] = (20, 80)
    """What sweeps with momentum take in a round, and what on their way to tolerances of `polish` and looser: these they
    mostly reach by themselves, and Newton hardly sooner."""

    patience: int = 128
    """Sweeps without gain that end those of a round after the first, where it begins with a measure of `polish`: from
    farther off they may gain late, and nothing else reaches a loose tolerance as soon."""

    newton: int = 4
    """What Newton takes from a warm start, as long as it gains."""

    gain: float = 0.1
    """Measure after a warm start's steps, over that before, at which they go on."""

    free: int = 200
    """What may be spent on what the start already solves to the loose tolerance."""

    small: tuple[float, int] = (1e2, 60)
    """Penalty and Newton steps of islands of few bodies. What redundant contacts exchange drifts by round-off times the
    penalty from step to step: from 1e4 on, to the cones of bodies at rest."""

    polish: float = 1e-5
    """Fraction of the tolerance to which Newton goes on where it gains, on larger islands only of tolerances that are
    no looser: what is left of a sticking contact's velocity is a creep that a long simulation adds up. (No simulation
    gives W alone.)"""

    hopeless: float = 100.0
    """Loose tolerances that are enough where a problem is only to show what it lacks, see `Auto.roughly`."""


TUNING = Tuning()

FLOOR = 1e-14
"""Round-off in m/s, below which `Tuning.polish` does not go."""

UNKNOWN = np.empty(0)

LIMITS = (DENSE, *TUNING.small)
"""What `_start.by_factors` takes."""

IN_TURN = TUNING.cost * TUNING.sweeps[0], TUNING.length, TUNING.small[0]
"""What `_start.by_matrix` takes."""

CONVERGED = Status.CONVERGED  # to look it up takes 70 ns


class Search:
    """The best impulse of one island so far, and what it has cost.

    Parameters
    ----------
    problem : FC3D
    r : ndarray, shape (3 nc,)
        Where it begins, N·s.
    tol, loose, effort : float
        As of `Auto`.

    Attributes
    ----------
    r, best : ndarray, float
        Impulse, in place, and its measure.
    count : int
        Sweeps and factorisations.
    spent, limit : float
        Factorisations, of which sweeps are a fraction; there is a limit from the loose tolerance on.
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
        """W of the island, where it is factorised."""
        return operator(self.problem)

    def _note(self, best: float, count: int, spent: float, x: Array | None = None) -> None:
        """Book what was done, and the impulse x it ended at where that is better than the best, after rounding too."""
        before, self.count, self.spent = self.best, self.count + count, self.spent + spent
        if x is not None and best < before:
            best = max(best, self.problem.round_off(x))
        if best < before:
            self.best = best
            if x is not None:
                self.r[:] = x
        if self.best <= self.loose < before:
            self.limit = (1.0 + self._effort) * self.spent or TUNING.free

    def _most(self, wanted: float) -> float:
        """So much of the effort, or what is left of it."""
        return min(wanted, self.limit - self.spent)

    @property
    def over(self) -> bool:
        """Whether the tolerance is met, or what rounding allows, or the effort spent."""
        return self.spent >= self.limit or self.best <= self.tol or self.best <= self.problem.round_off(self.r)

    def sweep(self, patience: int) -> None:
        """Sweeps with momentum from the best or on from the last, first to the loose tolerance: it bounds the rest."""
        if self._sweeps is None or self.best < self._sweeps.best:
            self._x = self.r.copy()
            self._sweeps = Sweeps(self.problem, self._x)
        for tol in sorted({max(self.loose, self.tol), self.tol}, reverse=True):
            if self.best > tol:
                wanted = TUNING.sweeps[tol >= MARGIN * TUNING.polish]
                before, most = self._sweeps.count, int(TUNING.cost * self._most(wanted))
                self._sweeps.run(tol, before + most, patience)
                used = self._sweeps.count - before
                self._note(self._sweeps.best, used, used / TUNING.cost, self._x)

    def settle(self) -> None:
        """One sweep from the best, unless it is of one: what it leaves may be worse, but misses no other tolerance."""
        if self._sweeps is not None and self._sweeps.best == self.best:
            return
        sweeps = Sweeps(self.problem, x := self.r.copy())
        sweeps.once()
        self.count += sweeps.count
        if sweeps.best <= max(self.best, self.tol if self.best <= self.tol else self.loose):
            self.best, self.r[:] = sweeps.best, x

    def newton(self, most: float, tol: float) -> None:
        """Newton from the best or on from the last."""
        run = self._newton
        if run is None or run.ended or self.best < run.best:
            run = self._newton = Multipliers(self.problem, self.W, self.r.copy(), PENALTY)
        before = run.count
        run.run(tol, int(np.ceil(self._most(most))))
        used = run.count - before
        self._note(run.best, used, used, run.r)

    def follow(self, wide: float) -> None:
        """A path of smoothed laws from the best, see `Following`."""
        path = Following(self.problem, self.W, self.tol, self.r, wide)
        path.run(int(np.ceil(self._most(TUNING.path))))
        self._note(path.best, path.count, path.count, path.r)

    def converge(self, tol: float) -> None:
        """Newton as long as it gains, at least to a tolerance."""
        before = np.inf
        while self.best > tol and self.best <= TUNING.gain * before:
            before = self.best
            self.newton(TUNING.newton, self.sharp)

    def run(self, warm: bool) -> None:
        """Newton from a warm start; then all in turn, Newton longer every time; Newton to the last digits.

        What is near is mostly Newton's, which stalls from farther off, where a path comes first.
        What has converged is mostly nearer in its cones. What is loose is left as one sweep leaves it: what slips has
        all the friction it can have then, and no impulse is outside its cone.
        """
        if warm and self.sharp < self.tol and self.best <= TUNING.hopeless * self.loose:
            self.converge(self.tol)
        first, wider = TUNING.wide
        for k in range(TUNING.rounds):
            if self.over:
                break
            if k > 0 or self.problem.blocks is not None:  # a W given alone has had the first
                late = k > 0 and self.best <= TUNING.polish
                self.sweep(TUNING.patience if late else TUNING.cost * sum(TUNING.sweeps))
            means = [partial(self.newton, TUNING.length ** (k + 1), self.tol)]
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
    """What a problem is solved to where Newton gets there."""
    return max(TUNING.polish * tol, FLOOR)


@dataclass(frozen=True)
class Auto(Options):
    """Portfolio, island by island, to a tolerance where it buys something and with a bound on effort everywhere.

    An island with one contact is solved in closed form, one of few bodies by Newton from any start: both in one kernel
    call. On larger ones a warm start first gets Newton steps as long as they gain, since the contact states of the last
    step mostly hold. Then come rounds: sweeps with momentum, then Newton, longer every time, and a path of smoothed
    laws from the best impulse, begun with more smoothing every time: before Newton from far off, from the second round
    on, after it where that is near, from the third on. Sweeps and Newton go on where they were, and begin anew where
    another has found better. A problem given by W alone, which need not be symmetric, has the sweeps of the first round
    in one kernel call, with Newton in turn where that costs no more, and the same means after.

    What meets `tol` is CONVERGED. Effort towards it is bounded by a multiple of what it took to meet `loose`, in
    operations and not in time, so that results do not depend on the machine; what then meets `loose` is LOOSE:
    accepted, with its error on record. What misses `loose` has failed: it is STALLED where no more than rounding is
    left; else it is checked for a Slater point, without which no solution is guaranteed, and its status says so.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    loose : float
        What is acceptable where `tol` costs too much; `tol` itself where that is looser, and then every problem gets
        all means.
    effort : float
        Bound on the effort beyond `loose`, as a multiple of that for `loose`; `Tuning.free` where the start meets it.
    """

    tol: Positive = 1e-8
    loose: Positive = 1e-4
    effort: NonNegative = 4.0

    @cached_property
    def aims(self) -> tuple[float, float]:
        """What islands of few coordinates are solved to where Newton gets there, and at least; measures in m/s or -."""
        return sharp(self.tol), MARGIN * self.tol

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        solution = self._solved(problem, r0, self.tol)
        return solution if solution.status is CONVERGED else self._explained(problem, solution)

    def balanced(self, problem: FC3D, r0: Array, before: Array) -> Solution:
        """Solve the problem from r0, which is no solution where it changes velocities of contacts that hold by much.

        As little as the tolerance allows, in every step, adds up; from `before` (3 nc,), the relative velocities before
        the impulses, m/s.
        """
        return self._explained(problem, self._solved(problem, r0, self.tol, before=before))

    def loosely(self, problem: FC3D, r0: Array) -> Solution:
        """Solve the problem from r0 (3 nc,), N·s, large islands to the loose tolerance only, as those of a collision.

        For what follows on such a solution and differs little.
        """
        return self._explained(problem, self._solved(problem, r0, max(self.tol, self.loose)))

    def roughly(self, problem: FC3D, r0: Array, effort: float) -> Solution | None:
        """Large islands to `Tuning.hopeless` loose tolerances from r0 where that misses these, None where it does not.

        For a problem that is posed anew with what its motion shows: a miss of more than that is of a collision. Towards
        the loose tolerance goes so much `effort`, as a multiple of that so far.
        """
        loose = max(self.tol, self.loose)
        enough = TUNING.hopeless * loose
        if not r0.any() or problem.solved(r0, self.tol)[2] <= enough:
            return None
        return self._solved(problem, r0, loose if effort else enough, (enough, effort))

    def _solved(
        self,
        problem: FC3D,
        r0: Array | None,
        large: float,
        bound: tuple[float, float] | None = None,
        before: Array = UNKNOWN,
    ) -> Solution:
        """Solve the problem from r0, islands that take more than a kernel call to the tolerance `large`.

        And with such a bound on effort, (loose, effort) as of `Auto`; with that of `Auto` itself if none is given.
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
                count, error, residual = _start.by_matrix(*W, q, mu, scales, q_norm, r, u, self.aims[1], *IN_TURN)
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
            # In half the time that Solution(...) takes
            return tuple.__new__(Solution, (r, u, CONVERGED, error, residual, count, clock() - start))
        otherwise = Status.LOOSE
        if (worst := max(error, residual)) > self.loose:
            otherwise = Status.STALLED if worst <= max(FLOOR, problem.round_off(r)) else Status.MAX_ITERATIONS
        return Solution.measured(r, u, error, residual, self.tol, count, clock() - start, otherwise)

    @staticmethod
    def _explained(problem: FC3D, solution: Solution) -> Solution:
        """The solution with `Status.NO_SLATER_POINT` where none is guaranteed to exist."""
        if solution.status is not Status.MAX_ITERATIONS:
            return solution
        from nsdyn.problem.slater import has_slater_point  # rarely needed, and its imports take long

        return solution._replace(status=Status.NO_SLATER_POINT) if has_slater_point(problem) is False else solution
