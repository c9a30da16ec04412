"""Coulomb's friction cone: projections, dual cone, de Saxcé's shift, generalised Jacobian.

Arrays of contacts have shape (nc, 3), normal component first; K = {‖r_T‖ ≤ μ r_N} is a second-order cone with dual cone
K* = {x_N ≥ μ ‖x_T‖}.
"""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.problem import cones as _kernels
from nsdyn.tools.arrays import Array


def project(z: Array, mu: Array) -> Array:
    """Return the projection P_K(z) on the friction cone of each contact, shape (nc, 3).

    Parameters
    ----------
    z : ndarray, shape (nc, 3)
    mu : ndarray, shape (nc,)
        Friction coefficients; 0 gives the half-line r_N ≥ 0.

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, appendix.
    """
    out = np.empty(z.size)
    _kernels.into_cones(np.ascontiguousarray(z, dtype=float).ravel(), mu, out)
    return out.reshape(-1, 3)


def project_dual(x: Array, mu: Array) -> Array:
    """Return the projection on the dual cone, P_K*(x) = x + P_K(-x) (Moreau's decomposition), shape (nc, 3)."""
    return x + project(-x, mu)


def saxce(u: Array, mu: Array) -> Array:
    """Return the modified velocity û = u + μ ‖u_T‖ e_N, shape (nc, 3), in the unit of u.

    Notes
    -----
    With û, Coulomb's law and Signorini's condition together are the complementarity K* ∋ û ⟂ r ∈ K.

    References
    ----------
    G. de Saxcé, Z.-Q. Feng, The bipotential method, Math. Comput. Modelling 28, 1998.
    """
    out = u.copy()
    out[:, 0] += mu * np.hypot(u[:, 1], u[:, 2])
    return out


def projection_jacobian(z: Array, mu: Array) -> Array:
    """Return an element of the generalised Jacobian of P_K at z, shape (nc, 3, 3).

    It is symmetric with eigenvalues in [0, 1].
    """
    D = np.empty((mu.size, 3, 3))
    _kernels.jacobians(np.ascontiguousarray(z, dtype=float), mu, D)
    return D
