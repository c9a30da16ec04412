"""Frozen shift: a sequence of convex problems on the cones."""

from __future__ import annotations

from dataclasses import dataclass

from nsdyn.literature._common import Equilibrated, Method, Run
from nsdyn.literature._frozen import descend, freeze, shifted, slip_shift
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive, Whole


def _inner(scaled: Equilibrated, shift: Array, x: Array, goal: float) -> tuple[Array, int]:
    q = shifted(scaled, shift)
    return descend(lambda y: _kernels.cone_sweep(*scaled.csr, q, scaled.mu, y), x, goal)


@dataclass(frozen=True)
class ACLM(Options, Method):
    """Acary–Cadoux–Lemaréchal–Malick: freeze s = μ‖u_T‖, minimise ½ rᵀWr + rᵀ(q + s e_N) on K, update s.

    The method follows the proof of existence. Strength: moderate friction. The shift then contracts quickly, more so
    with Anderson's acceleration, and each problem is convex; accelerated Gauss–Seidel sweeps solve it. Weakness: on
    strongly sliding piles at μ = 1 the shift hardly contracts, and on redundant contacts it is as slow as its sweeps
    (`interior_point` has the same outer loop without sweeps).

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Passes; the iterations reported are sweeps.
    memory : int
        Number of differences kept by Anderson's acceleration of the shift; 0 for the plain fixed point.

    References
    ----------
    V. Acary, F. Cadoux, C. Lemaréchal, J. Malick, A formulation of the linear discrete Coulomb friction problem via
    convex optimization, ZAMM 91, 2011.
    """

    tol: Positive = 1e-8
    max_iter: Count = 200
    memory: Whole = 5

    def _solve(self, run: Run) -> Solution:
        return freeze(run, self.max_iter, slip_shift, _inner, self.memory)
