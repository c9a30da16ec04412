"""Projected (block) Gauss–Seidel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn.literature._common import Method, Run
from nsdyn.literature._kernels import pgs as _kernels
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.options import Count, Options, Positive, Whole


@dataclass(frozen=True)
class PGS(Options, Method):
    """Block Gauss–Seidel: solve each contact exactly in turn, with Anderson's acceleration.

    Strength: loose tolerances and granular scenes, where a sweep costs 0.1 µs per contact block. Weakness: scenes in
    which information must travel far: tall stacks, heavy bodies on light ones, hyperstatic walls at tight tolerance.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Sweeps.
    memory : int
        Number of differences kept by Anderson's acceleration; 0 gives the plain method.
    patience : int
        Sweeps after which the solve may be declared stalled, if its rate cannot reach the tolerance within max_iter.

    References
    ----------
    F. Jourdan, P. Alart, M. Jean, A Gauss-Seidel like algorithm to solve frictional contact problems, CMAME 155,
    1998. H. Walker, P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49, 2011.
    """

    tol: Positive = 1e-8
    max_iter: Count = 10_000
    memory: Whole = 20
    patience: Count = 10_000

    def _solve(self, run: Run) -> Solution:
        problem, blocks = run.problem, run.problem.blocks
        W = _kernels.matrix(*problem.csr) if blocks is None else _kernels.factors(blocks.arrays)
        plan = self.max_iter, min(5, self.max_iter), min(self.memory, problem.nc + 1), self.patience
        size = float(np.linalg.norm(problem.q)) or 1.0
        sweeps, _ = _kernels.accelerated(W, problem.q, problem.mu, problem.scales, run.r, self.tol, size, plan)
        return run.finish(sweeps, Status.STALLED if sweeps < self.max_iter else Status.MAX_ITERATIONS)
