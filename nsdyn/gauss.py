"""Gauss's principle as the certificate of a step.

For any r ∈ K put v = v_f + M⁻¹ H r, u = Hᵀ v + w, and freeze s = μ‖u_T‖. The velocity v* of least constraint,
min ½‖v - v_f‖²_M under u + s e_N ∈ K*, is unique although impulses are not, and the duality gap Σ r·(u + s e_N)
bounds the distance to it: ½‖v - v*‖²_M ≤ gap. Where u_N < 0 the step is the exact solution of the problem shifted
by δ = max(0, -u_N), so ‖δ‖ is reported beside the bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from nsdyn._kernels import cones as _cones
from nsdyn.problem import FC3D, Array

__all__ = ["Certificate", "certify"]


class Certificate(NamedTuple):
    """Error bound of one solve.

    Attributes
    ----------
    gap : float
        Duality gap of the shifted problem, J.
    shift : float
        ‖δ‖₂ over the contacts, m/s: how far the certified problem is from the given one.
    bound : float
        √(2 gap), in √J: bounds the error of the velocity in the kinetic norm ‖v - v*‖_M.
    """

    gap: float
    shift: float
    bound: float


def certify(problem: FC3D, r: Array, u: Array) -> Certificate:
    """Certificate of the impulse r with u = W r + q.

    Parameters
    ----------
    problem : FC3D
        With symmetric W.
    r, u : ndarray, shape (3 nc,)
        Impulse [N·s], projected on K here, and relative velocity [m/s].

    References
    ----------
    J. J. Moreau, Quadratic programming in mechanics: dynamics of one-sided constraints, SIAM J. Control 4, 1966.
    """
    # Each term is ≥ 0 for r ∈ K; a negative sum is round-off and counts as 0.
    gap, shift = _cones.duality_gap(u, r, problem.mu)
    return Certificate(gap, shift, math.sqrt(2.0 * gap))
