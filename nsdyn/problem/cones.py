"""The cone of Coulomb in NumPy: projections, dual cone, de Saxcé's shift, generalised Jacobian.

Arrays of contacts have shape (nc, 3), normal component first; K = {‖r_T‖ ≤ μ r_N} and its dual
K* = {x_N ≥ μ ‖x_T‖}. These are the definitions; `nsdyn._kernels.problem.cones` holds their compiled twins.
"""

from __future__ import annotations

import numpy as np

from nsdyn.tools.arrays import Array

__all__ = ["project", "project_dual", "projection_jacobian", "saxce"]


def project(z: Array, mu: Array) -> Array:
    """Projection P_K(z) on the friction cone of each contact.

    Parameters
    ----------
    z : ndarray, shape (nc, 3)
    mu : ndarray, shape (nc,)
        Friction coefficients; 0 gives the half-line r_N ≥ 0.

    Returns
    -------
    ndarray, shape (nc, 3)

    References
    ----------
    V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, appendix.
    """
    n, t = z[:, 0], np.hypot(z[:, 1], z[:, 2])
    inside, polar = (n >= 0.0) & (t <= mu * n), mu * t <= -n  # n ≥ 0 matters for μ = 0
    pn = (n + mu * t) / (1.0 + mu**2)
    scale = np.divide(mu * pn, t, out=np.zeros_like(t), where=t > 0.0)
    boundary = np.column_stack((pn, scale[:, None] * z[:, 1:]))
    out: Array = np.where(inside[:, None], z, np.where(polar[:, None], 0.0, boundary))
    return out


def project_dual(x: Array, mu: Array) -> Array:
    """Projection on the dual cone, P_K*(x) = x + P_K(-x) (Moreau's decomposition), shape (nc, 3)."""
    return x + project(-x, mu)


def saxce(u: Array, mu: Array) -> Array:
    """Modified velocity û = u + μ ‖u_T‖ e_N, shape (nc, 3), in the unit of u.

    Notes
    -----
    With it Coulomb's law with Signorini's condition is the complementarity K* ∋ û ⟂ r ∈ K.

    References
    ----------
    G. de Saxcé, Z.-Q. Feng, The bipotential method, Math. Comput. Modelling 28, 1998.
    """
    out = u.copy()
    out[:, 0] += mu * np.hypot(u[:, 1], u[:, 2])
    return out


def projection_jacobian(z: Array, mu: Array) -> Array:
    """Element of the generalised Jacobian of P_K at z, shape (nc, 3, 3), symmetric with eigenvalues in [0, 1]."""
    n, t = z[:, 0], np.hypot(z[:, 1], z[:, 2])
    inside, polar = (n >= 0.0) & (t <= mu * n), mu * t <= -n
    c = 1.0 / (1.0 + mu**2)
    safe = np.where(t > 0.0, t, 1.0)
    d = z[:, 1:] / safe[:, None]
    ray = np.column_stack((np.ones_like(mu), mu[:, None] * d))
    D = c[:, None, None] * ray[:, :, None] * ray[:, None, :]
    D[:, 1:, 1:] += (mu * c * (n + mu * t) / safe)[:, None, None] * (np.eye(2) - d[:, :, None] * d[:, None, :])
    D[inside] = np.eye(3)
    D[polar & ~inside] = 0.0
    return D
