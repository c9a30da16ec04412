"""Proximal alternating direction method of multipliers with a spectral penalty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np

from nsdyn.literature._common import CHECK, Method, Run, factor, matrix
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.literature.formulations import with_blocks
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Allowed, Count, Options, Positive

Relaxation = Annotated[float, Allowed("in [1, 2)", lambda a: 1.0 <= a < 2.0)]

PROXIMAL = 1e-6
"""Proximal term η added to W of unit blocks; redundant contacts need it."""


@dataclass(frozen=True)
class ADMM(Options, Method):
    """Proximal ADMM: x minimises on the affine part, z is the projection on the cones, y is the multiplier -û.

    x = (W + (η + ρ) I)⁻¹ (η x + ρ z - y - q - s),  z ← P_K(x̂ + y/ρ),  y ← y + ρ (x̂ - z), with over-relaxed
    x̂ = a x + (1 - a) z. De Saxcé's shift s = μ‖y_T‖ is updated along the way. The penalty is ρ = (η L)^½ (L/η)^p with
    L = λ_max(W); p moves by 0.05 when primal and dual residuals differ tenfold. The factorisation of each p is kept.

    Strength: medium accuracy on all redundant problems, with one factorisation and then cheap iterations. Weakness: a
    long linear tail if masses differ or all contacts slide at once, since the shift lags behind.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Iterations.
    relaxation : float
        Over-relaxation a in [1, 2). Values above 1 help convex problems but amplify the lag of the shift: 1.6 reaches
        1e-8 on fewer frictional problems, and more slowly.

    References
    ----------
    J. Carpentier, Q. Le Lidec, L. Montaut, From compliant to rigid contact simulation: a unified and efficient
    approach, RSS 2024.
    """

    tol: Positive = 1e-8
    max_iter: Count = 100_000
    relaxation: Relaxation = 1.0

    @np.errstate(over="ignore", invalid="ignore")  # the status reports divergence
    def _solve(self, run: Run) -> Solution:
        scaled = run.scaled
        W, top = matrix(scaled.W), scaled.largest_eigenvalue()

        @cache
        def penalty(power: int) -> tuple[float, Callable[[Array], Array] | None]:
            """Return (ρ, function that solves with W + (η + ρ) I) for an exponent p in twentieths."""
            rho = float(np.sqrt(PROXIMAL * top) * (top / PROXIMAL) ** (0.05 * power))
            return rho, factor(with_blocks(W, (PROXIMAL + rho) * np.eye(3)))

        power = 4  # p = 0.2 in twentieths
        x = run.r * scaled.root
        z, y = x.copy(), -(W @ x + scaled.q)
        rho, solve = penalty(power)
        k = 0
        for k in range(1, self.max_iter + 1):
            if solve is None:
                return run.finish(k, Status.STALLED)
            b = PROXIMAL * x + rho * z - y - scaled.q
            b[::3] -= scaled.mu * np.hypot(y[1::3], y[2::3])
            x = solve(b)
            ahead = self.relaxation * x + (1.0 - self.relaxation) * z
            last, z = z, np.empty_like(z)
            _kernels.step_on_cones(ahead, y, -1.0 / rho, scaled.mu, z)
            y = y + rho * (ahead - z)
            if k % CHECK:
                continue
            if run.done(z / scaled.root):
                break
            primal, dual = np.linalg.norm(x - z), rho * np.linalg.norm(z - last)
            move = int(primal > 10.0 * dual) - int(dual > 10.0 * primal)
            if move and -10 <= power + move <= 20:
                power += move
                rho, solve = penalty(power)
        return run.finish(k)
