"""Projected Gauss–Seidel with Nesterov's momentum, contact by contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import nesterov as _kernels
from nsdyn._kernels.solvers import pgs as _pgs
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array, Index

CHECK = 10
"""Sweeps between two measurements."""


class Sweeps:
    """Sweeps with momentum on a problem of free bodies, which may be interrupted; the best impulse so far is in r.

    Attributes
    ----------
    count : int
        Sweeps so far.
    best : float
        Measure of r.
    """

    def __init__(self, blocks: Blocks, q: Array, mu: Array, scales: Array, r: Array, q_norm: float) -> None:
        self._best_r = r.reshape(-1, 3)
        *given, self._y, self._v, self.best = _kernels.begin(
            blocks.arrays, q.reshape(-1, 3), mu, scales, q_norm, self._best_r
        )
        self._given = *given, q_norm
        self._x, self._t = self._y.copy(), np.ones(mu.size)
        self.count, self._last, self._keep = 0, 0, 0.5

    def run(self, tol: float, most: int, patience: int) -> bool:
        """Go on to the tolerance, to so many sweeps in all or so many without gain; whether it is worth going on."""
        self._last = self.count
        self.count, self._last, self.best, self._keep = _kernels.solve(
            *self._given, tol, self._best_r, self._y, self._x, self._v, self._t, self.count, self._last, self.best,
            self._keep, most, CHECK, patience,
        )  # fmt: skip
        return bool(self.best > tol and self.count - self._last < patience)


class MatrixSweeps:
    """`Sweeps` on a problem given by a block-sparse W, (indptr, indices, data)."""

    def __init__(
        self, W: tuple[Index, Index, Array], q: Array, mu: Array, scales: Array, r: Array, q_norm: float
    ) -> None:
        u = np.empty_like(q)
        _pgs.velocity(*W, q, r, u)
        self.best = float(_cones.measure_at(scales, u, r, mu, q_norm))
        self._best_r, self._given = r, (*W, _kernels.steps_of_matrix(*W, mu), q, mu, scales, q_norm)
        self._y, self._x, self._t = r.copy(), r.copy(), np.ones(mu.size)
        self.count, self._last, self._keep = 0, 0, 0.5

    def run(self, tol: float, most: int, patience: int) -> bool:
        """Go on as `Sweeps.run` does."""
        self._last = self.count
        self.count, self._last, self.best, self._keep = _kernels.solve_matrix(
            *self._given, tol, self._best_r, self._y, self._x, self._t, self.count, self._last, self.best,
            self._keep, most, CHECK, patience,
        )  # fmt: skip
        return bool(self.best > tol and self.count - self._last < patience)


def solve_free(
    blocks: Blocks,
    q: Array,
    mu: Array,
    scales: Array,
    r: Array,
    tol: float,
    q_norm: float,
    max_iter: int,
    patience: int,
) -> tuple[int, float]:
    """Sweeps with momentum on a problem of free bodies, in place of r; (sweeps, measure)."""
    sweeps = Sweeps(blocks, q, mu, scales, r, q_norm)
    sweeps.run(tol, max_iter, patience)
    return sweeps.count, sweeps.best


@dataclass(frozen=True)
class Nesterov:
    """Gauss–Seidel sweeps with Nesterov's momentum that each contact loses by itself, for free bodies.

    Good on random piles at loose tolerances: about 20 ns per contact and sweep, no factorisation, and momentum survives
    contacts that open, stick or slip one after the other, where combinations of past sweeps (`pgs`) stall. It fails
    where bodies are stacked high or tolerances are tight, at a linear rate. It is not among the solvers by name, since
    it takes only problems given by factors, without articulated bodies.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Sweeps.
    patience : int
        Sweeps without a better impulse after which the solve is called stalled.

    Raises
    ------
    ValueError
        For a problem given by W alone, or one with articulated bodies.

    References
    ----------
    Y. Nesterov, A method of solving a convex programming problem with convergence rate O(1/k²), Soviet Math. Dokl.
    27, 1983. B. O'Donoghue, E. Candès, Adaptive restart for accelerated gradient schemes, Found. Comput. Math. 15,
    2015. H. Mazhar, T. Heyn, D. Negrut, A. Tasora, Using Nesterov's method to accelerate multibody dynamics with
    friction and contact, ACM Trans. Graph. 34, 2015.
    """

    tol: float = 1e-8
    max_iter: int = 20_000
    patience: int = 5000

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        start = clock()
        blocks = problem.blocks
        if blocks is None or (np.diff(blocks.offset) != 6).any():
            raise ValueError("problem must be given by factors of free bodies (6 coordinates each), use solver='pgs'")
        r = np.zeros_like(problem.q) if r0 is None else np.array(r0, dtype=float)
        count = 0
        if problem.nc:
            given = problem.q, problem.mu, problem.scales
            count, _ = solve_free(blocks, *given, r, self.tol, problem.q_norm, self.max_iter, self.patience)
        otherwise = Status.STALLED if count < self.max_iter else Status.MAX_ITERATIONS
        return Solution.judge(problem, r, self.tol, count, clock() - start, otherwise)
