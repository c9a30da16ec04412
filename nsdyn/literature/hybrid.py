"""Newton's method with safe restarts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn.literature._common import Method, Run, matrix
from nsdyn.literature.fixed_point import march
from nsdyn.literature.impulse_newton import Equation, Function, newton, steps
from nsdyn.problem.solution import Solution
from nsdyn.tools.options import Count, Options, Positive

SAFE = 100
"""Extragradient iterations before the first Newton method, the number in the paper."""

FACTORISATIONS = 30
"""Factorisations of one Newton method: it converges within about ten, or it cycles."""


@dataclass(frozen=True)
class Hybrid(Options, Method):
    """NSN-HYBRID: extragradient iterations, Newton from their best iterate, then again from the best of both.

    The first round is that of the paper: 100 safe iterations, then Newton. If Newton fails, the next round has twice as
    many safe iterations, so that both methods get their share.

    Strength: problems on which Newton converges once the contact states are nearly right: elastic bodies, few contacts
    per coordinate. Weakness: on redundant contacts Newton's matrix stays singular, and only the extragradient method
    remains.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Extragradient iterations and factorisations together.
    function : {'alart-curnier', 'fischer-burmeister', 'jean-moreau', 'natural'}
        Equation of Newton's method, see `ImpulseNewton`.

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, sections 4 and 5.
    """

    tol: Positive = 1e-8
    max_iter: Count = 100_000
    function: Function = "alart-curnier"

    def _solve(self, run: Run) -> Solution:
        problem, scaled, count, safe = run.problem, run.scaled, 0, SAFE
        given = matrix(scaled.W), scaled.q, scaled.mu
        method: Equation = self.function, "none", steps(problem, "spectral")
        while count < self.max_iter:
            start = march(Run(problem, run.r, self.tol), min(safe, self.max_iter - count), "khobotov", extra=True)
            count += max(start.iterations, 1)
            if run.done(start.r) or count >= self.max_iter:
                break
            with np.errstate(over="ignore", invalid="ignore"):  # a Newton method that diverges has failed
                most = min(FACTORISATIONS, self.max_iter - count)
                _, used, _ = newton(given, run.r * scaled.root, method, lambda x, _: run.done(x / scaled.root), most)
            count += used
            if run.over:
                break
            safe *= 2
        return run.finish(count)
