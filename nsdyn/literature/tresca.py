"""Frozen friction bounds: a sequence of convex problems on cylinders."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn.literature._common import Equilibrated, Method, Run
from nsdyn.literature._frozen import descend, freeze, normal_impulse
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive, Whole


def _inner(scaled: Equilibrated, theta: Array, x: Array, goal: float) -> tuple[Array, int]:
    radius = scaled.mu * np.maximum(theta, 0.0)
    return descend(lambda y: _kernels.cylinder_sweep(*scaled.csr, scaled.q, radius, True, True, y), x, goal)


@dataclass(frozen=True)
class Tresca(Options, Method):
    """Haslinger's fixed point: freeze the bounds μθ, minimise ½ rᵀWr + rᵀq on r_N ≥ 0, ‖r_T‖ ≤ μθ, set θ = r_N.

    Strength: weak coupling of normal and tangential impulses, as in granular packings and elastic bodies at small μ,
    where the map contracts. Weakness: it fails at large μ with strong coupling. On redundant contacts it is as slow as
    its sweeps.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Passes; the iterations reported are sweeps.
    memory : int
        Number of differences kept by Anderson's acceleration of the bounds; 0 for the plain fixed point.

    References
    ----------
    J. Haslinger, Approximation of the Signorini problem with friction obeying the Coulomb law, Math. Methods Appl.
    Sci. 5, 1983. V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 4.
    """

    tol: Positive = 1e-8
    max_iter: Count = 500
    memory: Whole = 5

    def _solve(self, run: Run) -> Solution:
        return freeze(run, self.max_iter, normal_impulse, _inner, self.memory)
