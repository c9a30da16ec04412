"""Interior point method for the convex problem at a frozen shift."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from nsdyn.literature._common import Equilibrated, Method, Run, factor, matrix
from nsdyn.literature._frozen import freeze, shifted, slip_shift
from nsdyn.literature._kernels import interior as _interior
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.literature.formulations import with_blocks
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive, Whole

FACTORISATIONS = 60
"""Largest number of iterations for one convex problem."""


def _times(A: Any, x: Any) -> Array:
    """Return A_c x_c of every contact."""
    return np.asarray((A @ x[:, :, None])[:, :, 0])


def _longest(x: Array, dx: Array) -> float:
    """Return the largest step along dx that stays in the cones."""
    a = dx[:, 0] ** 2 - dx[:, 1] ** 2 - dx[:, 2] ** 2
    b = x[:, 0] * dx[:, 0] - x[:, 1] * dx[:, 1] - x[:, 2] * dx[:, 2]
    t = np.hypot(x[:, 1], x[:, 2])
    c = np.maximum(x[:, 0] - t, 1e-16 * x[:, 0]) * (x[:, 0] + t)
    below = -b + np.sqrt(np.maximum(b * b - a * c, 0.0))
    crosses = (below > 0.0) & (b * b >= a * c)
    falls = dx[:, 0] < 0.0  # a step through the apex has a double root, which rounding may hide
    apex = float(np.min(-x[falls, 0] / dx[falls, 0], initial=1e3))
    return float(np.min(c[crosses] / below[crosses], initial=apex))


def minimise(scaled: Equilibrated, q: Array, goal: float) -> tuple[Array, int]:
    """Return the impulse x ∈ K with W x + q ∈ K* orthogonal to it, and the number of factorisations.

    In z = (μ x_N, x_T) and s = (u_N/μ, u_T) both cones are the Lorentz cone. A step solves
    (D W D + T²) dz = T d - (residual) with Nesterov–Todd's T and Mehrotra's predictor and corrector. W need not be
    symmetric; only its symmetric part must be positive semi-definite.
    """
    mu, nc = scaled.mu, scaled.mu.size
    D = np.ones((nc, 3))
    D[:, 0] = 1.0 / np.where(mu > 0.0, mu, 1.0)
    D[mu == 0.0, 1:] = 0.0
    flat = D.ravel()
    scaling = sp.diags_array(flat)
    A = matrix(sp.bsr_array(scaling @ scaled.W @ scaling, blocksize=(3, 3)))
    b = (flat * q).reshape(-1, 3)
    z = np.zeros((nc, 3))
    z[:, 0] = float(np.abs(b).max()) or 1.0
    s = z.copy()
    T, inverse, (lam, d, ds, dz) = np.empty((nc, 3, 3)), np.empty((nc, 3, 3)), np.zeros((4, nc, 3))
    best, least, F, P = np.zeros(3 * nc), np.inf, np.empty(3 * nc), np.empty(3 * nc)
    for k in range(FACTORISATIONS):
        x = flat * z.ravel()
        F[:] = scaled.W @ x + q
        _kernels.step_on_cones(x, F, 1.0, mu, P)
        size = float(np.linalg.norm(x - P))
        if size < least:
            best, least = P.copy(), size
        gap = float((s * z).sum()) / nc
        if least <= goal or not gap > 1e-30:
            return best, k
        _interior.scalings(s, z, T, inverse, lam)
        solve = factor(with_blocks(A, T @ T))
        if solve is None:
            return best, k
        defect = (A @ z.ravel()).reshape(-1, 3) + b - s
        sigma = 0.0
        for stage in range(2):
            _interior.target(lam, T, inverse, ds, dz, sigma * gap, stage == 1, d)
            dz = solve((_times(T, d) - defect).ravel()).reshape(-1, 3)
            ds = _times(T, d - _times(T, dz))
            step = min(1.0, 0.99 * min(_longest(z, dz), _longest(s, ds)))
            if stage == 0:
                after = float(((s + step * ds) * (z + step * dz)).sum()) / nc
                sigma = min(1.0, max(after / gap, 0.0) ** 3)
        z, s = z + step * dz, s + step * ds
        if not (np.isfinite(z).all() and step > 1e-8):
            return best, k + 1
    return best, FACTORISATIONS


def _inner(scaled: Equilibrated, shift: Array, x: Array, goal: float) -> tuple[Array, int]:
    return minimise(scaled, shifted(scaled, shift), goal)


@dataclass(frozen=True)
class InteriorPoint(Options, Method):
    """Frozen shift as in `ACLM`; a primal-dual interior point method solves each convex problem.

    Strength: high accuracy on redundant contacts, where sweeps are slow. It takes 10 to 25 factorisations per problem,
    whatever its condition. Weakness: no warm start, so that each of the 5 to 30 shifts costs a full solve. On strongly
    sliding piles at μ = 1 the shift hardly contracts.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Largest number of shifts; the iterations reported are factorisations.
    memory : int
        Number of differences kept by Anderson's acceleration of the shift.

    References
    ----------
    V. Acary, P. Armand, H. M. Nguyen, M. Shpakovych, Second order cone programming for frictional contact mechanics
    using interior point algorithm, Optim. Methods Softw. 39, 2024.
    """

    tol: Positive = 1e-8
    max_iter: Count = 200
    memory: Whole = 5

    def _solve(self, run: Run) -> Solution:
        return freeze(run, self.max_iter, slip_shift, _inner, self.memory)
