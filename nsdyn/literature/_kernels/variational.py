"""Loops of the reference solvers: operator of the variational inequality, projections, sweeps on convex problems."""

import math

from nsdyn._kernels.compiled import no_alloc
from nsdyn._kernels.problem.cones import project
from nsdyn._kernels.problem.given import velocity, velocity_of


@no_alloc
def operator(indptr, indices, data, q, mu, r, out):
    """Compute F(r) = W r + q + mu |u_T| e_N, into out (3 nc,)."""
    velocity((indptr, indices, data), q, r, out)
    for c in range(mu.size):
        i = 3 * c
        out[i] += mu[c] * math.sqrt(out[i + 1] * out[i + 1] + out[i + 2] * out[i + 2])


@no_alloc
def step_on_cones(r, F, rho, mu, out):
    """Compute P_K(r - rho F), into out (3 nc,)."""
    for c in range(mu.size):
        i = 3 * c
        a = project(r[i] - rho * F[i], r[i + 1] - rho * F[i + 1], r[i + 2] - rho * F[i + 2], mu[c])
        out[i], out[i + 1], out[i + 2] = a


@no_alloc
def step_on_cylinders(r, F, rho, radius, out):
    """Project r - rho F on r_N >= 0, |r_T| <= radius, into out (3 nc,)."""
    for c in range(radius.size):
        i = 3 * c
        out[i] = max(0.0, r[i] - rho * F[i])
        x, y = r[i + 1] - rho * F[i + 1], r[i + 2] - rho * F[i + 2]
        t = math.sqrt(x * x + y * y)
        s = radius[c] / t if t > radius[c] else 1.0
        out[i + 1], out[i + 2] = s * x, s * y


@no_alloc
def cone_sweep(indptr, indices, data, q, mu, r):
    """One projected Gauss–Seidel sweep of min ½ rᵀ W r + qᵀ r on the cones, in place of r, for W_cc of norm 1."""
    for c in range(mu.size):
        i = 3 * c
        u0, u1, u2 = velocity_of((indptr, indices, data), q, r, c)
        r[i], r[i + 1], r[i + 2] = project(r[i] - u0, r[i + 1] - u1, r[i + 2] - u2, mu[c])


@no_alloc
def cylinder_sweep(indptr, indices, data, q, radius, normal, tangent, r):
    """One projected Gauss–Seidel sweep of min ½ rᵀ W r + qᵀ r on r_N >= 0, |r_T| <= radius, in place of r.

    Parameters
    ----------
    indptr, indices, data : ndarray
        W in 3 x 3 blocks, W_cc of norm 1.
    q, r : ndarray, shape (3 nc,)
    radius : ndarray, shape (nc,)
        Radii of the cylinders.
    normal, tangent : bool
        Whether normal and tangential parts are updated.
    """
    for c in range(radius.size):
        i = 3 * c
        u0, u1, u2 = velocity_of((indptr, indices, data), q, r, c)
        if normal:
            r[i] = max(0.0, r[i] - u0)
        if tangent:
            x, y = r[i + 1] - u1, r[i + 2] - u2
            t = math.sqrt(x * x + y * y)
            s = radius[c] / t if t > radius[c] else 1.0
            r[i + 1], r[i + 2] = s * x, s * y
