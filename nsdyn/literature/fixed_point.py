"""Projected fixed point on the variational inequality with a self-adaptive step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from nsdyn.literature._common import Method, Run
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.options import Count, Options, Positive

Rule = Literal["khobotov", "solodov-tseng"]

CHECK = 20
"""Iterations between two measurements of the error."""


def march(run: Run, max_iter: int, rule: Rule, extra: bool) -> Solution:
    """Iterate x ← P_K(x - ρ F(x)), or with `extra` gradient x ← P_K(x - ρ F(x̄)), with ρ adapted by the rule.

    x̄ = P_K(x - ρ F(x)) is computed with ρ ← ν ρ until the ratio of the rule is at most L. After a step whose ratio was
    below L_min, ρ ← ρ/ν.
    """
    limit, low, shrink = 0.9, 0.3, 2.0 / 3.0  # L, L_min, ν of the paper
    scaled, count = run.scaled, 0
    args = *scaled.csr, scaled.q, scaled.mu
    x, rho = run.r * scaled.root, 1.0
    F, trial, F_trial = np.empty_like(x), np.empty_like(x), np.empty_like(x)
    _kernels.operator(*args, x, F)
    while count < max_iter:
        count += 1
        while True:
            _kernels.step_on_cones(x, F, rho, scaled.mu, trial)
            _kernels.operator(*args, trial, F_trial)
            dx, dF = x - trial, F - F_trial
            length = dx @ dx
            if length == 0.0:
                break
            turn = np.sqrt(dF @ dF * length) if rule == "khobotov" else dx @ dF
            ratio = rho * turn / length
            if not ratio > limit:
                break
            rho *= shrink
        if length == 0.0:
            break
        if extra:
            _kernels.step_on_cones(x, F_trial, rho, scaled.mu, x)
            _kernels.operator(*args, x, F)
        else:
            x, trial, F, F_trial = trial, x, F_trial, F
        if ratio < low:
            rho /= shrink
        if count % CHECK == 0 and run.done(x / scaled.root):
            break
    run.done(x / scaled.root)
    return run.finish(count)


@dataclass(frozen=True)
class FixedPoint(Options, Method):
    """Projected fixed point r ← P_K(r - ρ û(r)), FP-VI, with a self-adaptive step.

    Strength: the simplest method, with one product with W per iteration, no factorisation and no parameter. Weakness:
    its convergence is linear at best. It needs a well-conditioned W and fails at tight tolerances on redundant
    contacts. The operator is not monotone, so no theorem covers large μ.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Iterations.
    rule : {'khobotov', 'solodov-tseng'}
        Ratio that adapts the step: ρ‖F(r) - F(r̄)‖/‖r - r̄‖ or ρ (r - r̄)ᵀ(F(r) - F(r̄))/‖r - r̄‖².

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 4. E. Khobotov,
    1987; D. Han, H. Lo, 2002; M. Solodov, P. Tseng, 1996 for the rules.
    """

    tol: Positive = 1e-8
    max_iter: Count = 100_000
    rule: Rule = "khobotov"

    def _solve(self, run: Run) -> Solution:
        return march(run, self.max_iter, self.rule, extra=False)
