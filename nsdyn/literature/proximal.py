"""Proximal point algorithm with an inner Newton method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nsdyn.literature._common import Method, Run, matrix
from nsdyn.literature.formulations import ELEMENTS, with_blocks
from nsdyn.literature.impulse_newton import Function, Search, newton
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, NonNegative, Options, Positive

Rule = Literal["adaptive", "error"]


@dataclass(frozen=True)
class Proximal(Options, Method):
    """Proximal point algorithm, PPA-NSN: solve the problem with W + α I and q - α r_k by Newton for the next r_k.

    Strength: redundant contacts at tight tolerances, masonry and stacks; it is the robust method of the paper, as
    W + α I is definite. Weakness: it is slow if α must stay large, as on strongly sliding piles at high friction.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Total number of factorisations.
    alpha : float
        First α, times λ_max(W_cc); σ for the rule 'error'.
    rule : {'adaptive', 'error'}
        'adaptive' divides α by ten when the inner Newton succeeds. 'error' sets σ error^ν with the `FC3D.error` of r_k.
        Both multiply α by five when Newton fails.
    nu : float
        Exponent ν of the rule 'error'.
    inner : int
        Largest number of Newton steps for one proximal step.
    function, search
        Options of the inner Newton, see `ImpulseNewton`; full steps solve more problems than line searches, which stop
        at kinks.

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 4. W. Hager,
    H. Zhang, Self-adaptive inexact proximal point methods, Comput. Optim. Appl. 39, 2008.
    """

    tol: Positive = 1e-8
    max_iter: Count = 1000
    alpha: Positive = 1e-3
    inner: Count = 20
    function: Function = "alart-curnier"
    search: Search = "none"
    rule: Rule = "adaptive"
    nu: NonNegative = 1.0

    def _solve(self, run: Run) -> Solution:
        problem, scaled, count, alpha = run.problem, run.scaled, 0, self.alpha
        W = matrix(scaled.W)
        x = run.r * scaled.root
        if self.rule == "error":
            alpha = self._by_error(run.r, problem)
        while count < self.max_iter and alpha < 1e8:
            u = (W @ x + scaled.q).reshape(-1, 3)
            rho = np.full((problem.nc, 2), 1.0 / (1.0 + alpha))  # 1/λ_max of the diagonal blocks of W + α I
            target = 0.1 * float(np.linalg.norm(ELEMENTS[self.function](u, x.reshape(-1, 3), scaled.mu, rho)[0]))

            def done(y: Array, size: float, target: float = target) -> bool:
                return run.done(y / scaled.root) or size <= target

            given = with_blocks(W, alpha * np.eye(3)), scaled.q - alpha * x, scaled.mu
            method = self.function, self.search, rho
            new, used, ended = newton(given, x, method, done, min(self.inner, self.max_iter - count))
            count += max(used, 1)
            if run.over:
                break
            if ended:
                x = new
                alpha = self._by_error(x / scaled.root, problem) if self.rule == "error" else max(0.1 * alpha, 1e-12)
            else:
                alpha *= 5.0
        return run.finish(count, Status.MAX_ITERATIONS if count >= self.max_iter else Status.STALLED)

    def _by_error(self, r: Array, problem: FC3D) -> float:
        """Return α = σ error^ν, but at least the round-off that keeps W + α I definite."""
        return float(max(self.alpha * problem.error(r) ** self.nu, 1e-12))
