"""Smoothing Newton on the normal map: a cold start for what slides and turns everywhere at once."""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import smoothing as _kernels
from nsdyn.problem.operators import Operator
from nsdyn.tools.arrays import Array

STRETCH = 10.0
"""κ λ_max(W_cc) of the normal map z = r - κ u."""

SHORTEST, GAIN = 0.05, 0.1
"""Shortest step of the line search, and the fraction of its length by which a step has to reduce the merit."""

LEAST, MOST = 1e2, 1e12
"""Range of the damping 1 / (R W_cc), from none to all but a standstill."""

NEAR = 0.3
"""The smoothing falls tenfold where the merit is at most this times √(τ nc), the size of what smoothing changes."""


def smoothing(
    W: Operator, q: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float, max_iter: int
) -> tuple[int, float]:
    """Solve one connected problem from nothing: (factorisations, measure of r), the best impulse into r.

    Unknowns are z of the law in `_kernels.smoothing`, which has a solution whatever z is, so that no rule keeps steps
    inside a cone, and an impulse x with v = W x + q. Newton on

        x = r(z),   v = u(z)

    backtracks on θ² = (x - r)ᵀ W (x - r) + Σ κ ‖v - u‖², is damped by a compliance R per contact, and τ falls as soon
    as θ is small beside it. There is no term of dilation, μ‖u_T‖, in the law, hence no kink where slip begins.

    References
    ----------
    S. Robinson, Normal maps induced by linear transformations, Math. Oper. Res. 17, 1992. X. Chen, L. Qi, D. Sun,
    Global and superlinear convergence of the smoothing Newton method, Math. Comput. 67, 1998.
    """
    nc, n = mu.size, q.size
    kappa = STRETCH / scales
    tau = (float(np.abs(q).max()) or 1.0) ** 2 / float(scales.mean())
    x, z, v = np.zeros(n), np.zeros(n), q.copy()
    p, u, G, g, dx, dz = (np.empty(n) for _ in range(6))
    slip, A = np.empty((nc, 2)), np.empty((nc, 3, 3))

    def at(x: Array, v: Array, z: Array) -> tuple[Array, float]:
        """The velocity of the law's impulse p, and the merit."""
        _kernels.law(z, mu, kappa, tau, p, u, slip)
        own = W.product(p) + q
        return own, float(_kernels.merit(x, v, p, own, u, mu, kappa))

    own, theta = at(x, v, z)
    least, best, damping, count = theta, np.inf, 1e6, 0
    while True:
        now = max(_cones.natural_residual(scales, own, p, mu), _cones.natural_error(own, p, mu) / q_norm)
        if now < best:
            best = float(now)
            r[:] = p
        if not (best > tol and count < max_iter and np.isfinite(theta)):
            return count, best
        while theta <= NEAR * np.sqrt(tau * nc) and tau > 1e-30:
            tau *= 0.1
            own, theta = at(x, v, z)
            least = theta
        _kernels.tangent(p, u, slip, mu, scales, damping, A)
        _kernels.right_side(x, v, p, u, mu, A, G, g)
        try:
            dv = W.factor(A)(g)
        except RuntimeError:
            return count, best
        count += 1
        _kernels.direction(dv, p, x, G, mu, kappa, scales, damping, A, dx, dz)
        a = length = 1.0
        lowest = np.inf
        while True:
            own, now = at(x + a * dx, v + a * dv, z + a * dz)
            if now < lowest:
                lowest, length = now, a
            if now <= (1.0 - GAIN * a) * theta or a <= SHORTEST:
                break
            a = max(SHORTEST, 0.5 * a)
        if now <= (1.0 - GAIN * a) * theta:
            damping *= 5.0 if a == 1.0 else 0.2 if a < 0.3 else 1.0
        elif lowest <= min(1.1 * theta, 3.0 * least):
            # A small detour often leads past a kink.
            a = length
            damping *= 3.0
        else:
            a = 0.0
            damping *= 0.2
        damping = min(MOST, max(LEAST, damping))
        x, v, z = x + a * dx, v + a * dv, z + a * dz
        own, theta = at(x, v, z)
        least = min(least, theta)
