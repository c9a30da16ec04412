"""Uzawa's method for given friction, in an outer loop on the friction bound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from nsdyn._kernels.problem import given as _given
from nsdyn.literature._common import Equilibrated
from nsdyn.literature._frozen import freeze, normal_impulse
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.options import Allowed, Count, Options, Positive

Step = Annotated[float, Allowed("between 0 and 2 (in units of 1/λ_max)", lambda step: 0.0 < step < 2.0)]


def uzawa_iterates(csr: tuple[Index, Index, Array], q: Array, radius: Array, rho: float, r: Array) -> Iterator[Array]:
    """Iterates r ← P_C(r - ρ (W r + q)) on C = {r_N ≥ 0, ‖r_T‖ ≤ radius}, without end.

    W r + q is the velocity Hᵀv + w of the bodies v that Uzawa's primal step computes from r. For symmetric W the map
    is non-expansive, the distance to every solution falls monotonically, if 0 < ρ < 2/λ_max(W), and only then.
    """
    r, u = r.copy(), np.empty_like(r)
    while True:
        _given.velocity(csr, q, r, u)
        new = np.empty_like(r)
        _kernels.step_on_cylinders(r, u, rho, radius, new)
        r = new
        yield r


@dataclass(frozen=True)
class Uzawa(Options):
    """Uzawa: a gradient step on the impulses of given friction (Tresca), the bound μ r_N updated outside.

    Good as the plainest method with a proof: for symmetric W it converges for every step below 2/λ_max(W), linearly.
    It fails by being slow: the rate is 1 - λ_min/λ_max over the active contacts, so that tall stacks and heavy on
    light bodies need thousands of products with W; the outer loop is that of `tresca`, unaccelerated.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Updates of the bound; the iterations reported are Uzawa's.
    step : float
        Step times λ_max of the equilibrated W, between 0 and 2.

    References
    ----------
    N. Pop, A mixed finite element discretization of a quasistatic contact problem with friction, section 4: its
    2ρ - 2ρ² ≥ β > 0 is 0 < ρ < 2/λ_max(W) here.
    """

    tol: Positive = 1e-8
    max_iter: Count = 500
    step: Step = 1.8

    @np.errstate(over="ignore", invalid="ignore")  # what diverges is told by the status
    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        length: list[float] = []  # once per problem, not once per pass

        def inner(scaled: Equilibrated, theta: Array, x: Array, goal: float) -> tuple[Array, int]:
            if not length:
                length.append(self.step / scaled.largest_eigenvalue())
            iterates = uzawa_iterates(scaled.csr, scaled.q, scaled.mu * np.maximum(theta, 0.0), length[0], x)
            for k, new in zip(range(1, 20_001), iterates, strict=False):
                if k % 10 == 0 and np.linalg.norm(new - x) <= goal * length[0]:
                    break
                x = new
            return new, k

        return freeze(problem, r0, self.tol, self.max_iter, normal_impulse, inner, 0)
