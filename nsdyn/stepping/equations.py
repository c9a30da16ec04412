"""The equations of motion at an instant: M(q) v̇ + bias = joint forces + Jᵀ contact forces, v in Pinocchio's layout."""

from __future__ import annotations

import numpy as np

from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.stepping.scene_state import SceneState
from nsdyn.tools.arrays import Array


def mass_matrix(d: Dynamics, at: SceneState) -> Array:
    """Mass matrix M(q), shape (n, n), kg, kg m and kg m²."""
    return _factors(d, at)[1]


def bias(d: Dynamics, at: SceneState) -> Array:
    """Coriolis, centrifugal and gravity terms, shape (n,), N and N m."""
    _, v = d.pinocchio_state(at.position, at.v)
    linear, spin = v[: 6 * d.free].reshape(-1, 2, 3).swapaxes(0, 1)
    R = at.placement.R[: d.free]
    force = d.mass[:, None] * (np.cross(spin, linear) - np.einsum("kji,j->ki", R, d.gravity))
    torque = np.cross(spin, np.einsum("kij,kj->ki", d.J, spin))
    trees = [t.bias(q, v[t.coordinates]) for t, q in zip(d.trees, at.position.trees, strict=True)]
    return np.concatenate([np.concatenate((force, torque), axis=1).ravel(), *trees])


def jacobian(d: Dynamics, at: SceneState) -> tuple[Array, Array]:
    """Contact frames, (nc, 3, 3), rows n, t1, t2 in world axes, and the contact Jacobian J, (3 nc, n), of u = J v."""
    frame, _, H = _factors(d, at)
    for k, R in enumerate(at.placement.R[: d.free]):
        H[6 * k : 6 * k + 3] = R.T @ H[6 * k : 6 * k + 3]  # from world axes to body axes
    return frame, H.T


def _factors(d: Dynamics, at: SceneState) -> tuple[Array, Array, Array]:
    """Return (contact frames, M, H) in the coordinates of the step."""
    rows, frame = d.rows(at.contacts, at.placement, d.inertia(at.position, at.v), None)
    return frame, *rows.full.dense()
