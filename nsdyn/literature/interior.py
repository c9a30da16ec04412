"""Interior point method for K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K, Coulomb's law as it is (nonassociated), then Newton's method.

Per contact x = (u_N / μ + ‖u_T‖, u_T) and z = (μ r_N, r_T) lie in the Lorentz cone, and x ∘ z = σ e on the central
path. With Nesterov and Todd's matrix T (T z = T⁻¹ x = λ) the Newton step along the path reads dr = E T⁻¹ d - A du,

    A = E T⁻² C,   E = diag(1/μ, 1, 1),   C = [[1/μ, tᵀ], [0, I]],   t = u_T / ‖u_T‖.

So (I + A W) p = g gives du = W p - F, with g = E T⁻¹ d + A F and F the defect u - W r - q. u stays linear in the
step; its only constraint is u_N > 0. z moves along the cone, because the direction of slip may turn. All quantities
are in units in which max |q| = 1 and the mean of λ_max(W_cc) = 1. A contact with μ = 0 has only its normal component.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn._kernels.problem import cones as _cones
from nsdyn.literature._lorentz import jordan, nesterov_todd, root, tangent, target, times
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Operator
from nsdyn.problem.solution import Solution
from nsdyn.solvers.newton import by_islands, newton
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive, Whole

__all__ = ["Interior", "interior"]

PENALTY = 1e3
"""First penalty of Newton's method when it starts from the result of the interior point method."""

START = 100.0
"""First x and z: far inside the cones, whatever the solution of a problem of unit size."""


def interior(problem: FC3D, W: Operator, r: Array, tol: float, most: int) -> tuple[int, float]:
    """Run the method from a cold start; put the best impulse into r.

    Returns (factorisations, measure of r).
    """
    mu, scales, q_norm, nc = problem.mu, problem.scales, problem.q_norm, problem.nc
    speed, mean = float(np.abs(problem.q).max()) or 1.0, float(scales.mean())
    slides = mu > 0.0
    m, on = np.where(slides, mu, 1.0), np.column_stack((np.ones(nc, bool), slides, slides))
    E = np.column_stack((1.0 / m, np.ones((nc, 2))))
    u, z = problem.q.reshape(-1, 3) / speed * on, np.zeros((nc, 3))
    u[:, 0], z[:, 0] = START * m, START
    best, last, short, count = np.inf, 1.0, 0, 0
    while True:
        x = _point(u, m)
        gap = float((x * z).sum()) / nc
        trial = (E * z).ravel() * (speed / mean)
        v = W.product(trial) + problem.q
        now = float(_cones.measure_at(scales, v, trial, mu, q_norm))
        if now < best:
            best = now
            r[:] = trial
        if best <= tol or not gap > 1e-12 or short >= 6 or count >= most:
            return count, best
        T, V, lam = nesterov_todd(x, z, np.sqrt(u[:, 0] / m * (x[:, 0] + tangent(x))), root(z))
        C = on[:, :, None] * np.eye(3)
        C[:, 0, 0] = 1.0 / m
        C[:, 0, 1:] = u[:, 1:] / np.where(u[:, 1:].any(axis=1), tangent(u), 1.0)[:, None]
        A = on[:, :, None] * on[:, None, :] * (E[:, :, None] * (V @ V @ C))
        F = (u - v.reshape(-1, 3) / speed) * on
        try:
            solve = W.factor(A / mean)
        except RuntimeError:
            return count, best
        count += 1
        sigma, product = 0.0, np.zeros((nc, 3))
        for stage in range(2):
            d = target(lam, sigma * gap, product)
            g = on * (E * times(V, d) + times(A, F))
            du = on * (solve(g.ravel()).reshape(-1, 3) / mean - F)
            dx = times(C, du)
            dz = on * times(V, d - times(V, dx))
            reach = _longest(u, z, du, dz)
            if stage == 0:
                full = min(1.0, reach)
                there, after = u + full * du, _moved(z, dz, full)
                left = max(0.0, float((_point(there, m) * after).sum()) / nc)
                sigma = _centring(gap, left, full, float(np.abs(F).max()), last)
                product = jordan(times(V, dx), times(T, dz))
        last = min(1.0, 0.99 * reach)
        u, z = u + last * du, _moved(z, dz, last)
        short = short + 1 if last < 0.02 else 0


def _point(u: Array, m: Array) -> Array:
    """Return x = (u_N / μ + ‖u_T‖, u_T)."""
    return np.column_stack((u[:, 0] / m + tangent(u), u[:, 1:]))


def _slack(z: Array, dz: Array) -> tuple[Array, Array]:
    """Return z_N - ‖z_T‖ and its slope along dz."""
    t = tangent(z)
    return z[:, 0] - t, dz[:, 0] - (z[:, 1:] * dz[:, 1:]).sum(axis=1) / np.where(t > 0.0, t, 1.0)


def _longest(u: Array, z: Array, du: Array, dz: Array) -> float:
    """Return the largest step for which u_N, z_N and the slack z_N - ‖z_T‖ (to first order) do not become negative."""
    value, slope = np.hstack(((u[:, 0], du[:, 0]), (z[:, 0], dz[:, 0]), _slack(z, dz)))
    falls = slope < 0.0
    return float(np.min(-value[falls] / slope[falls], initial=1e300))


def _moved(z: Array, dz: Array, a: float) -> Array:
    """Return z after a step a.

    If the straight step leaves less than half the slack of the linear model, z_T is shortened: the cone is round and
    the direction of slip has turned.
    """
    now, slope = _slack(z, dz)
    slack, out = now + a * slope, z + a * dz
    t = tangent(out)
    short = (out[:, 0] - t < 0.5 * slack) & (t > 0.0)
    out[short, 1:] *= ((out[:, 0] - np.minimum(slack, 0.9 * out[:, 0]))[short] / t[short])[:, None]
    return out


def _centring(gap: float, after: float, full: float, worst: float, last: float) -> float:
    """Return the target share of the gap, from the affine step `full`, the defect `worst` and the last step `last`."""
    if last < 0.1:  # the last step hit the boundary almost immediately
        return 1.0
    return max(min(1.0, (after / gap) ** 3), 1e-4, 0.5 * (1.0 - full) ** 3, min(1.0, 0.1 * worst / gap))


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
