"""Whether a solution is sure to exist: a Slater point, velocities that open every contact."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from nsdyn.problem import cones
from nsdyn.problem.fc3d import FC3D
from nsdyn.tools.arrays import Array

__all__ = ["has_slater_point"]

SIMPLEX = 2_000_000
"""Iterations of the simplex method times contacts, some seconds of work, after which `has_slater_point` gives up."""

POWER, ASCENT = 20, 300
"""Steps of the power method and of Nesterov's, tens of milliseconds, before `has_slater_point` takes a program."""


def _some_impulse_opens(problem: FC3D) -> bool:
    """Whether an impulse is found soon that opens every contact, u = W r + q ∈ int K*: then True is a proof.

    Nesterov's method with restarts on the convex problem r ∈ K, W r + q - e ∈ K*, r ⟂ W r + q - e, whose velocities
    clear the cone by e: they need not be reached, half way is inside. A few dozen to two hundred steps suffice but
    where masses differ by much.
    """
    q, mu, blocks = problem.q, problem.mu, problem.blocks
    # Impulses in units in which the diagonal of W is of size one
    unit = np.repeat(1.0 / np.sqrt(problem.scales), 3)

    def product(x: Array) -> Array:
        r = unit * x
        return unit * (problem.W @ r if blocks is None else blocks.relative_velocity(blocks.velocity_change(r)))

    speed = float(np.abs(q).max()) or 1.0
    wanted = unit * (q - np.kron(speed * (1.0 + mu), [1.0, 0.0, 0.0]))
    x = np.random.default_rng(0).normal(size=q.size)
    for _ in range(POWER):
        x = product(x / np.linalg.norm(x))
    step = 0.9 / float(np.linalg.norm(x))
    x, Wx, y, Wy, momentum = *np.zeros((4, q.size)), 1.0
    for _ in range(ASCENT):
        g = Wy + wanted
        new = cones.project((y - step * g).reshape(-1, 3), mu).ravel()
        Wnew = product(new)
        u = Wnew / unit + q
        if (u[0::3] - mu * np.hypot(u[1::3], u[2::3])).min() > 1e-3 * speed:
            return True
        if g @ (new - x) > 0.0:
            push, momentum = 0.0, 1.0
        else:
            before, momentum = momentum, 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum * momentum))
            push = (before - 1.0) / momentum
        y, Wy = new + push * (new - x), Wnew + push * (Wnew - Wx)
        x, Wx = new, Wnew
    return False


def has_slater_point(problem: FC3D, facets: int = 16) -> bool | None:
    """Whether velocities exist that open every contact: Hᵀ v + q ∈ int K* for some v. Then a solution exists.

    An impulse that opens them, or, where none is found soon, a linear program on a pyramid of that many facets inside
    K*: True is a proof; False may be wrong only when no velocity clears the cone by more than the gap between pyramid
    and cone (2 % of μ ‖u_T‖ for 16 facets). None if the program took too many iterations (some seconds). Without
    factors the range of W stands for that of Hᵀ. A body on one side of everything it touches can leave and has such a
    point; a box jammed between two walls has no such point.

    References
    ----------
    V. Acary, F. Cadoux, C. Lemaréchal, J. Malick, A formulation of the linear discrete Coulomb friction problem via
    convex optimization, ZAMM 91, 2011. A. Klarbring, J.-S. Pang, SIAM J. Optim. 8, 1998.
    """
    from scipy.optimize import linprog  # a tenth of a second that few need

    if problem.nc == 0 or _some_impulse_opens(problem):
        return True
    angle = 2.0 * np.pi * np.arange(facets) / facets
    nc, steep = problem.nc, problem.mu / np.cos(np.pi / facets)
    rows = np.empty((nc, facets, 3))  # u_N - steep d_k·u_T ≥ t for every facet
    rows[:, :, 0] = 1.0
    rows[:, :, 1:] = -steep[:, None, None] * np.column_stack((np.cos(angle), np.sin(angle)))
    G = sp.csr_array(
        sp.bsr_array((rows, np.arange(nc), np.arange(nc + 1)), shape=(facets * nc, 3 * nc), blocksize=(facets, 3))
    )
    speed = float(np.abs(problem.q).max()) or 1.0
    # W scaled to a mean of one; the velocities of the bodies are fewer, if they are known.
    B = problem.W / problem.scales.mean() if problem.blocks is None else problem.blocks.jacobian()
    A = sp.hstack((-(G @ B), sp.csr_array(np.ones((facets * nc, 1)))))
    cost = np.zeros(A.shape[1])
    cost[-1] = -1.0
    bounds = [(None, None)] * B.shape[1] + [(None, 1.0)]  # one unit of speed is clearance enough
    limit = {"maxiter": SIMPLEX // nc}
    out = linprog(cost, A_ub=A, b_ub=G @ problem.q / speed, bounds=bounds, method="highs-ds", options=limit)
    return bool(-out.fun > 1e-7) if out.status == 0 else None  # the feasibility tolerance of the library
