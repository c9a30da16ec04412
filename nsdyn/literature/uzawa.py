"""Uzawa's method for given friction bounds (Tresca), in an outer loop that updates the bounds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from nsdyn._kernels.problem import given as _given
from nsdyn.literature._common import Equilibrated, Method, Run
from nsdyn.literature._frozen import freeze, normal_impulse
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.options import Allowed, Count, Options, Positive

Step = Annotated[float, Allowed("between 0 and 2 (in units of 1/λ_max)", lambda step: 0.0 < step < 2.0)]


def uzawa_iterates(csr: tuple[Index, Index, Array], q: Array, radius: Array, rho: float, r: Array) -> Iterator[Array]:
    """Yield iterates r ← P_C(r - ρ (W r + q)) on C = {r_N ≥ 0, ‖r_T‖ ≤ radius}, without end.

    W r + q is Hᵀv + w with the velocities v of the bodies that Uzawa's primal step computes from r. For symmetric W the
    map is non-expansive if and only if 0 < ρ < 2/λ_max(W). The distance to every solution then falls monotonically.
    """
    r, u = r.copy(), np.empty_like(r)
    while True:
        _given.velocity(csr, q, r, u)
        new = np.empty_like(r)
        _kernels.step_on_cylinders(r, u, rho, radius, new)
        r = new
        yield r


@dataclass(frozen=True)
class Uzawa(Options, Method):
    """Uzawa: gradient steps on the impulses at given friction bounds (Tresca); an outer loop updates the bounds μ r_N.

    Strength: the plainest method with a proof. For symmetric W it converges linearly for every step below 2/λ_max(W).
    Weakness: it is slow. The rate is 1 - λ_min/λ_max over the active contacts, so tall stacks and heavy bodies on light
    ones need thousands of products with W. The outer loop is that of `tresca`, unaccelerated.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Updates of the bounds; the iterations reported are Uzawa's.
    step : float
        Step length times λ_max of the equilibrated W, between 0 and 2.

    References
    ----------
    N. Pop, A mixed finite element discretization of a quasistatic contact problem with friction, section 4: the paper's
    condition 2ρ - 2ρ² ≥ β > 0 corresponds to 0 < ρ < 2/λ_max(W).
    """

    tol: Positive = 1e-8
    max_iter: Count = 500
    step: Step = 1.8

    @np.errstate(over="ignore", invalid="ignore")  # the status reports divergence
    def _solve(self, run: Run) -> Solution:
        length = self.step / run.scaled.largest_eigenvalue()

        def inner(scaled: Equilibrated, theta: Array, x: Array, goal: float) -> tuple[Array, int]:
            iterates = uzawa_iterates(scaled.csr, scaled.q, scaled.mu * np.maximum(theta, 0.0), length, x)
            for k, new in zip(range(1, 20_001), iterates, strict=False):
                if k % 10 == 0 and np.linalg.norm(new - x) <= goal * length:
                    break
                x = new
            return new, k

        return freeze(run, self.max_iter, normal_impulse, inner, 0)
