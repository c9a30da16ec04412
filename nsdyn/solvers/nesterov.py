"""Projected Gauss–Seidel sweeps with Nesterov's momentum, which is restarted contact by contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import nesterov as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive

CHECK = 10
"""Sweeps between two measurements."""


class Sweeps:
    """Sweeps with momentum that can be interrupted and continued: `count` so far; the measure of r is `best`.

    The best impulse so far is in r. For free bodies sweeps use the factors of W, else W itself, which need not be
    symmetric.
    """

    def __init__(self, problem: FC3D, r: Array) -> None:
        q, mu, scales, q_norm, blocks = problem.q, problem.mu, problem.scales, problem.q_norm, problem.blocks
        self._free = blocks is not None and bool((np.diff(blocks.offset) == 6).all())
        if blocks is not None and self._free:
            best_r = r.reshape(-1, 3)
            if (prepared := problem.kept.get(Sweeps)) is None:
                prepared = problem.kept[Sweeps] = _kernels.prepare(blocks.arrays, mu)
            self._given, y, v, self.best = _kernels.begin(prepared, q.reshape(-1, 3), mu, scales, q_norm, best_r)
            self._state: tuple[Any, ...] = (best_r, y, y.copy(), v, np.ones(mu.size))
        else:
            W = problem.csr
            self.best = float(_cones.measure_at(scales, problem.velocity(r), r, mu, q_norm))
            self._given = W, _kernels.steps_of_matrix(W, mu), q, mu, scales, q_norm
            self._state = r, r.copy(), r.copy(), np.ones(mu.size)
        self.count, self._keep = 0, 0.5

    def run(self, tol: float, most: int, patience: int) -> None:
        """Continue to the tolerance, to `most` sweeps in all, or to `patience` sweeps without gain."""
        self._run((self.count, self.count, self.best, self._keep), (tol, most, CHECK, patience))

    def once(self) -> None:
        """Make one more sweep and take its impulse as the best, whatever its measure."""
        self._run((self.count, self.count, np.inf, self._keep), (0.0, self.count + 1, 1, 1))

    def _run(self, so_far: tuple[int, int, float, float], limits: tuple[float, int, int, int]) -> None:
        """Run the kernel of sweeps from the state `so_far` to the `limits`."""
        solve = _kernels.solve if self._free else _kernels.solve_matrix
        self.count, _, self.best, self._keep = solve(self._given, self._state, so_far, limits)


@dataclass(frozen=True)
class Nesterov(Options):
    """Gauss–Seidel sweeps with Nesterov's momentum, which is restarted contact by contact.

    Good on random piles at loose tolerances: a sweep takes about 20 ns per contact and needs no factorisation. The
    momentum survives contacts that open, stick or slip one after the other, where combinations of past sweeps (`pgs`)
    stall. The method fails where bodies are stacked high or tolerances are tight, since it converges linearly.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Sweeps.
    patience : int
        Sweeps without a better impulse after which the solve has stalled.

    References
    ----------
    Y. Nesterov, A method of solving a convex programming problem with convergence rate O(1/k²), Soviet Math. Dokl. 27,
    1983. B. O'Donoghue, E. Candès, Adaptive restart for accelerated gradient schemes, Found. Comput. Math. 15, 2015. H.
    Mazhar, T. Heyn, D. Negrut, A. Tasora, Using Nesterov's method to accelerate multibody dynamics with friction and
    contact, ACM Trans. Graph. 34, 2015.
    """

    tol: Positive = 1e-8
    max_iter: Count = 20_000
    patience: Count = 5000

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        start = clock()
        r = np.zeros_like(problem.q) if r0 is None else problem.impulse(r0).copy()
        count = 0
        if problem.nc:
            sweeps = Sweeps(problem, r)
            sweeps.run(self.tol, self.max_iter, self.patience)
            count = sweeps.count
        otherwise = Status.STALLED if count < self.max_iter else Status.MAX_ITERATIONS
        return Solution.judge(problem, r, self.tol, count, clock() - start, otherwise)
