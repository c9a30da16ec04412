"""Common parts of the reference solvers: equilibrated problem, best iterate, linear solves, Anderson's acceleration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh, splu

from nsdyn._kernels.compiled import clock
from nsdyn.literature._kernels import anderson as _anderson
from nsdyn.problem.fc3d import FC3D, _csr
from nsdyn.problem.operators import dense
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array

CHECK = 10
"""Iterations between two measurements of the error."""

SPARSE = 300, 0.1
"""A matrix with more rows than the first number and a lower density than the second is factorised as a sparse one."""


class Equilibrated:
    """The problem in the variables x = S^½ r, with S = λ_max(W_cc): W' = S^-½ W S^-½ and q' = S^-½ q.

    A scaling per contact leaves the cones unchanged, so the result is again a frictional contact problem. It has no
    units of mass, and its diagonal blocks have norm 1: one step length suits contacts of all masses.
    """

    def __init__(self, problem: FC3D) -> None:
        self.root = np.repeat(np.sqrt(problem.scales), 3)
        scaling = sp.diags_array(1.0 / self.root)
        self.W = sp.bsr_array(scaling @ problem.W @ scaling, blocksize=(3, 3))
        self.W.sort_indices()
        self.q = problem.q / self.root
        self.mu = problem.mu
        self.csr = _csr(self.W)

    def largest_eigenvalue(self) -> float:
        """Upper estimate of λ_max of the symmetric part of W': Lanczos to four digits, plus its tolerance."""
        A = 0.5 * (self.W + self.W.T)
        if A.shape[0] <= 100:
            return float(np.linalg.eigvalsh(A.toarray())[-1])
        start = 2.0 + np.cos(np.arange(A.shape[0]))  # the same start in every run
        return 1.001 * float(eigsh(A, k=1, which="LA", v0=start, tol=1e-4, return_eigenvectors=False)[0])


class Run:
    """State of one solve: clock, best iterate and status."""

    def __init__(self, problem: FC3D, r0: Array | None, tol: float) -> None:
        self.start = clock()
        self.problem, self.tol = problem, tol
        self.best = np.inf
        self.r: Array = np.zeros_like(problem.q) if r0 is None else np.array(r0, dtype=float)
        self.done(self.r)

    def done(self, r: Array) -> bool:
        """Measure r, keep it if it is the best so far, and return whether the best one meets the tolerance."""
        _, error, residual, _ = self.problem.solved(r, self.tol)
        if (now := max(error, residual)) < self.best:
            self.best, self.r = now, r.copy()
        return self.over

    @cached_property
    def scaled(self) -> Equilibrated:
        """The equilibrated problem."""
        return Equilibrated(self.problem)

    @property
    def over(self) -> bool:
        """Whether the best iterate meets the tolerance."""
        return self.best <= self.tol

    def finish(self, count: int, otherwise: Status = Status.MAX_ITERATIONS) -> Solution:
        """Return the solution of the best iterate."""
        return Solution.judge(self.problem, self.r, self.tol, count, clock() - self.start, otherwise)


@dataclass(frozen=True)
class Method:
    """Base of the reference solvers: each defines `_solve` for a run whose start does not meet the tolerance."""

    tol: float

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        run = Run(problem, r0, self.tol)
        return run.finish(0) if run.over else self._solve(run)

    def _solve(self, run: Run) -> Solution:
        raise NotImplementedError


def factor(A: Any) -> Callable[[Array], Array] | None:
    """Return a function that solves with A (dense or sparse) for a right-hand side; None if A is singular."""
    try:
        return splu(sp.csc_matrix(A)).solve if sp.issparse(A) else dense(A)
    except RuntimeError:
        return None


def matrix(W: Any) -> Any:
    """Return a sparse W in the form for `factor`: dense, or unchanged if a sparse factorisation is cheaper."""
    n = W.shape[0]
    return W if n > SPARSE[0] and W.nnz < SPARSE[1] * n * n else W.toarray()


class Anderson:
    """Anderson's acceleration (type II) of a fixed point x = G(x): combine past G(x) so that the defect is smallest.

    References
    ----------
    H. Walker, P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49, 2011.
    """

    def __init__(self, memory: int) -> None:
        self.memory, self.used, self.slot, self.least = memory, 0, 0, np.inf
        self.F = self.G = self.gram = np.empty((0, 0))

    def next(self, x: Array, g: Array) -> Array:
        """Return the next x from (x, g = G(x)); forget the past if the defect exceeds twice its smallest value."""
        kept, f = self.memory + 1, g - x
        size = float(np.linalg.norm(f))
        if not self.F.size:
            self.F, self.G, self.gram = np.empty((kept, f.size)), np.empty((kept, f.size)), np.zeros((kept, kept))
        if size > 2.0 * self.least:
            self.used, self.slot, self.least = 0, 0, np.inf
        self.least, self.used = min(self.least, size), min(self.used + 1, kept)
        self.F[self.slot], self.G[self.slot] = f, g
        out = np.empty_like(g)
        _anderson.mix(self.F, self.G, self.gram, self.slot, self.used, out)
        self.slot = (self.slot + 1) % kept
        return out
