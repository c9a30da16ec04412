"""Extragradient method on the variational inequality with a self-adaptive step."""

from __future__ import annotations

from dataclasses import dataclass

from nsdyn.literature._common import Method, Run
from nsdyn.literature.fixed_point import Rule, march
from nsdyn.problem.solution import Solution
from nsdyn.tools.options import Count, Options, Positive


@dataclass(frozen=True)
class Extragradient(Options, Method):
    """Extragradient method r̄ = P_K(r - ρ û(r)), r ← P_K(r - ρ û(r̄)), EG-VI, with a self-adaptive step.

    Strength: a last resort that rarely diverges. It converges for every monotone Lipschitz operator; the fixed point
    needs co-coercivity as well. Weakness: it takes two products with W per iteration, and is as slow as the fixed point
    on redundant contacts and tight tolerances.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Iterations.
    rule : {'khobotov', 'solodov-tseng'}
        Ratio that adapts the step, see `FixedPoint`.

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 4. G. Korpelevich,
    1976; E. Khobotov, 1987.
    """

    tol: Positive = 1e-8
    max_iter: Count = 100_000
    rule: Rule = "khobotov"

    def _solve(self, run: Run) -> Solution:
        return march(run, self.max_iter, self.rule, extra=True)
