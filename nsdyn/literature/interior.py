"""Interior point method for Coulomb's law as it is (nonassociated), with a final Newton method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn._kernels.problem import cones as _cones
from nsdyn.literature._kernels import interior as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Operator
from nsdyn.problem.solution import Solution
from nsdyn.solvers.newton import by_islands, newton
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive, Whole

PENALTY = 1e3
"""First penalty of Newton's method when it starts from the result of the interior point method."""


def interior(problem: FC3D, W: Operator, r: Array, tol: float, most: int) -> tuple[int, float]:
    """Run the method of `_kernels.interior` from a cold start; put the best impulse into r.

    Returns (factorisations, measure of r).
    """
    mu, scales, q_norm, nc = problem.mu, problem.scales, problem.q_norm, problem.nc
    speed, mean = float(np.abs(problem.q).max()) or 1.0, float(scales.mean())
    q = problem.q / speed
    u, z, F, nu, nz, lam, d, du = (np.empty((nc, 3)) for _ in range(8))
    dx, dz = np.zeros((nc, 3)), np.zeros((nc, 3))
    T, V, C, A = (np.empty((nc, 3, 3)) for _ in range(4))
    g, trial = np.empty(3 * nc), np.empty(3 * nc)
    _kernels.start(q, mu, u, z)
    best, last, short, count = np.inf, 1.0, 0, 0
    while True:
        gap = float(_kernels.scaling(u, z, mu, T, V, C, A, lam))
        _kernels.impulse(z, mu, speed / mean, trial)
        v = W.product(trial) + problem.q
        now = float(_cones.measure_at(scales, v, trial, mu, q_norm))
        if now < best:
            best = now
            r[:] = trial
        if best <= tol or not gap > 1e-12 or short >= 6 or count >= most:
            return count, best
        worst = _kernels.defect(u, v / speed, mu, F)
        try:
            solve = W.factor(A / mean)
        except RuntimeError:
            return count, best
        count += 1
        sigma = 0.0
        for stage in range(2):
            _kernels.target(lam, T, V, dx, dz, sigma * gap, stage == 1, d)
            _kernels.right_side(mu, V, A, d, F, g)
            _kernels.recover(mu, V, C, d, F, solve(g) / mean, du, dx, dz)
            reach = float(_kernels.longest(u, z, du, dz))
            if stage == 0:
                full = min(1.0, reach)
                after = max(0.0, _kernels.move(mu, u, z, du, dz, full, nu, nz))
                sigma = _kernels.centring(gap, after, full, worst, last)
        last = min(1.0, 0.99 * reach)
        _kernels.move(mu, u, z, du, dz, last, nu, nz)
        u, nu, z, nz = nu, u, nz, z
        short = short + 1 if last < 0.02 else 0


@dataclass(frozen=True)
class Interior(Options):
    """Nonassociated interior point method from a cold start, then the Newton method of `newton`, island by island.

    Strength: the cold start of last resort. It takes 20 to 40 factorisations whatever the masses, and finds the contact
    states of kicked walls and of piles in which all contacts slide at once. Weakness: it cannot use a warm start and
    costs one factorisation per step. On redundant or weakly active contacts it ends between 1e-6 and 1e-9, hence the
    Newton method at the end.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Factorisations of the interior point method per island.
    max_newton : int
        Factorisations of the final Newton method per island.

    References
    ----------
    H. Nguyen, interior point methods for Coulomb's friction, thesis, Université Grenoble Alpes, 2025. V. Acary,
    P. Armand, H. Nguyen, M. Shpakovych, Second-order cone programming for frictional contact mechanics using interior
    point algorithm, Optim. Methods Softw. 39, 2024. Y. Nesterov, M. Todd, Self-scaled barriers and interior-point
    methods for convex programming, Math. Oper. Res. 22, 1997.
    """

    tol: Positive = 1e-8
    max_iter: Count = 40
    max_newton: Whole = 500

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem; r0 is only tested for being the solution."""

        def solve(part: FC3D, W: Operator, x: Array, tol: float) -> tuple[int, float]:
            count, best = interior(part, W, x, tol, self.max_iter)
            if best > tol:
                used, best = newton(part, W, x, tol, PENALTY, self.max_newton)
                count += used
            return count, best

        return by_islands(problem, r0, self.tol, solve)
