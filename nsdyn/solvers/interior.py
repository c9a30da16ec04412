"""Interior point method for Coulomb's law as it is, nonassociated, with a Newton finish."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import interior as _kernels
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Local, Operator, Velocity
from nsdyn.problem.solution import Solution, Status
from nsdyn.solvers.newton import by_islands, solve_blocks, solve_impulses
from nsdyn.tools.arrays import Array

__all__ = ["Interior", "interior"]

SPAN = 10
"""Steps over which progress is measured. Of problems that take long to begin many converge after twice as many."""


def interior(
    W: Operator, q_given: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float, max_iter: int,
    useful: float = np.inf,
) -> tuple[int, float]:  # fmt: skip
    """The method of `_kernels.interior.dense` with any W: (factorisations, measure of r), the best impulse into r.

    It ends before where its progress foretells a measure of more than `useful` after all steps.
    """
    nc = mu.size
    speed, mean = float(np.abs(q_given).max()) or 1.0, float(scales.mean())
    q = q_given / speed
    u, z, F, nu, nz, lam, d, du = (np.empty((nc, 3)) for _ in range(8))
    dx, dz = np.zeros((nc, 3)), np.zeros((nc, 3))
    T, V, C, A = (np.empty((nc, 3, 3)) for _ in range(4))
    g, trial = np.empty(3 * nc), np.empty(3 * nc)
    _kernels.start(q, mu, u, z)
    best, last, short, count = np.inf, 1.0, 0, 0
    measures = []
    while True:
        gap = float(_kernels.scaling(u, z, mu, T, V, C, A, lam))
        _kernels.impulse(z, mu, speed / mean, trial)
        v = W.product(trial) + q_given
        now = float(_cones.measure_at(scales, v, trial, mu, q_norm))
        if now < best:
            best = now
            r[:] = trial
        if best <= tol or not gap > 1e-12 or short >= 6 or count >= max_iter:
            return count, best
        measures.append(best)
        if count >= 2 * SPAN and best * (best / measures[count - SPAN]) ** ((max_iter - count) / SPAN) > useful:
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
class Interior:
    """Nonassociated interior point method from nothing, finished by the Newton of `newton`, island by island.

    Good as the cold start of last resort: 20 to 40 factorisations whatever the masses, and it finds the contact
    states of kicked walls and piles where everything slides at once. It fails to use a warm start, ends between 1e-6
    and 1e-9 where contacts are redundant or weakly active (hence the finish), and costs a factorisation a step.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Factorisations of the interior point method per island.
    max_newton : int
        Factorisations of the finish per island.

    References
    ----------
    H. Nguyen, interior point methods for Coulomb's friction, thesis, Université Grenoble Alpes, 2025. V. Acary,
    P. Armand, H. Nguyen, M. Shpakovych, Second-order cone programming for frictional contact mechanics using interior
    point algorithm, Optim. Methods Softw. 39, 2024. Y. Nesterov, M. Todd, Self-scaled barriers and interior-point
    methods for convex programming, Math. Oper. Res. 22, 1997.
    """

    tol: float = 1e-8
    max_iter: int = 40
    max_newton: int = 500

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem; of r0 is only asked whether it is the solution."""
        start = clock()
        r = np.zeros_like(problem.q) if r0 is None else np.array(r0, dtype=float)
        count = 0
        if problem.nc and not problem.solved(r, self.tol)[0]:
            q_norm = problem.q_norm
            if problem.blocks is not None:

                def solve(part: Blocks, q: Array, mu: Array, scales: Array, x: Array, tol: float) -> int:
                    newton = partial(solve_blocks, part)
                    return self._solve(Velocity(part), newton, q, mu, scales, x, tol, q_norm)

                count = by_islands(problem, problem.blocks, r, self.tol, solve)
            else:
                W, given = Local(problem.W), (problem.q, problem.mu, problem.scales)
                count = self._solve(W, partial(solve_impulses, W), *given, r, 0.9 * self.tol, q_norm)
        return Solution.judge(problem, r, self.tol, count, clock() - start, Status.MAX_ITERATIONS)

    def _solve(
        self,
        W: Operator,
        newton: Callable[..., tuple[int, float]],
        q: Array,
        mu: Array,
        scales: Array,
        r: Array,
        tol: float,
        q_norm: float,
    ) -> int:
        """The method from nothing, then Newton, on one connected problem; best impulse into r, factorisations."""
        count, best = interior(W, q, mu, scales, r, tol, q_norm, self.max_iter)
        if best > tol:
            count += newton(q, mu, scales, r, tol, q_norm, 1e3, self.max_newton)[0]
        return count
