"""Alternate between the normal and the tangential problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nsdyn.literature._common import Equilibrated, Method, Run
from nsdyn.literature._frozen import descend, freeze
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive, Whole


def _tangential_impulse(scaled: Equilibrated, x: Array) -> Array:
    return x.reshape(-1, 3)[:, 1:].ravel()


def _inner(scaled: Equilibrated, tangent: Array, x: Array, goal: float) -> tuple[Array, int]:
    x, ones = x.copy(), np.ones_like(scaled.mu)
    x.reshape(-1, 3)[:, 1:] = tangent.reshape(-1, 2)
    args = *scaled.csr, scaled.q
    x, normal = descend(lambda y: _kernels.cylinder_sweep(*args, ones, True, False, y), x, goal)
    x[::3] = np.maximum(x[::3], 0.0)
    radius = scaled.mu * x[::3]
    x, tangential = descend(lambda y: _kernels.cylinder_sweep(*args, radius, False, True, y), x, goal)
    return x, normal + tangential


@dataclass(frozen=True)
class Panagiotopoulos(Options, Method):
    """Alternate the normal problem at frozen friction and the friction problem on disks at frozen normal impulses.

    Strength: small W_NT, as on flat interfaces; both are quadratic programs of the simplest kind. Weakness: cases in
    which friction and pressure depend on each other (wedges, masonry, large μ): the alternation need not contract.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Alternations; the iterations reported are sweeps.
    memory : int
        Number of differences kept by Anderson's acceleration of the tangential impulses; 0 for the plain alternation.

    References
    ----------
    P. Panagiotopoulos, A nonlinear programming approach to the unilateral contact and friction boundary value
    problem, Ing.-Archiv 44, 1975. V. Acary, M. Brémond, O. Huber, 2018, section 4.
    """

    tol: Positive = 1e-8
    max_iter: Count = 1000
    memory: Whole = 5

    def _solve(self, run: Run) -> Solution:
        return freeze(run, self.max_iter, _tangential_impulse, _inner, self.memory)
