"""The Lorentz cone x_0 ≥ ‖x_T‖ for interior point methods; points are arrays (nc, 3), one for each contact.

References
----------
Y. Nesterov, M. Todd, Self-scaled barriers and interior-point methods for convex programming, Math. Oper. Res. 22, 1997.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from nsdyn.tools.arrays import Array


def times(A: Any, x: Any) -> Array:
    """Return A_c x_c of every contact."""
    return np.asarray((A @ x[:, :, None])[:, :, 0])


def jordan(x: Array, y: Array) -> Array:
    """Return the Jordan product x ∘ y = (xᵀy, x_0 y_T + y_0 x_T)."""
    return np.column_stack(((x * y).sum(axis=1), x[:, :1] * y[:, 1:] + y[:, :1] * x[:, 1:]))


def tangent(x: Array) -> Array:
    """Return ‖x_T‖, shape (nc,)."""
    return np.asarray(np.hypot(x[:, 1], x[:, 2]))


def root(x: Array) -> Array:
    """Return (x_0² - ‖x_T‖²)^½, shape (nc,), kept above round-off."""
    t = tangent(x)
    return np.asarray(np.sqrt(np.maximum(x[:, 0] - t, 1e-16 * x[:, 0]) * (x[:, 0] + t)))


def nesterov_todd(x: Array, z: Array, dx: Array, dz: Array) -> tuple[Array, Array, Array]:
    """Return the symmetric T with T z = T⁻¹ x = λ, shape (nc, 3, 3), its inverse, and λ, inside the cone.

    dx and dz are the `root` of x and z.
    """
    x, z = x / dx[:, None], z / dz[:, None]
    g = np.sqrt(0.5 * (1.0 + (x * z).sum(axis=1)))[:, None]
    w = (x + z * (1.0, -1.0, -1.0)) / (2.0 * g)
    turn = np.tile(np.eye(3), (len(x), 1, 1))
    turn[:, 0, 0] = w[:, 0]
    turn[:, 1:, 1:] += w[:, 1:, None] * w[:, None, 1:] / (1.0 + w[:, :1, None])
    across = np.zeros_like(turn)
    across[:, 0, 1:] = across[:, 1:, 0] = w[:, 1:]
    size = np.sqrt(dx / dz)[:, None, None]
    a, b = (g + z[:, :1]) * x[:, 1:], (g + x[:, :1]) * z[:, 1:]
    lam = np.sqrt(dx * dz)[:, None] * np.hstack((g, (a + b) / (x[:, :1] + z[:, :1] + 2.0 * g)))
    return size * (turn + across), (turn - across) / size, lam


def target(lam: Array, sigma: float, product: Array | float = 0.0) -> Array:
    """Return d with λ ∘ d = σ e - λ ∘ λ - product; the last is Mehrotra's (T⁻¹ dx) ∘ (T dz)."""
    b = sigma * np.eye(3)[0] - jordan(lam, lam) - product
    first = ((b * lam) @ (1.0, -1.0, -1.0) / root(lam) ** 2)[:, None]
    return np.hstack((first, (b[:, 1:] - first * lam[:, 1:]) / lam[:, :1]))
