"""Least velocity change that opens contacts by given velocities, from its augmented Lagrangian.

    min ½‖y‖²_M  under  Hᵀ y ∈ b + K*,        whose dual is   K* ∋ W x - b ⟂ x ∈ K,  y = M⁻¹ H x.

With b = -(q + s e_N) this is the frozen problem of Gauss's principle. Unlike Coulomb's problem it is convex, so that it
can be solved from any start. For an estimate x of the impulse and ρ > 0 per contact Newton's method minimises

    ½‖y‖²_M + Σ ‖P_K(x + ρ (b - Hᵀ y))‖² / 2ρ,   y = M⁻¹ H d,

with the symmetric matrix M + Σ H_c A_c H_cᵀ, A_c = ρ ∂P_K. Its step is halved until the function descends. The
projections are the next estimate.

References
----------
R. T. Rockafellar, Augmented Lagrangians and applications of the proximal point algorithm in convex programming, Math.
Oper. Res. 1, 1976.
"""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.problem import gauss as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import operator
from nsdyn.tools.arrays import Array

SHORTEST, ROUND_OFF = 1e-3, 1e-14
"""Shortest fraction of a Newton step, and relative round-off of the function that descends."""


class Least:
    """Newton's method for the augmented Lagrangian of the least velocity change.

    Parameters
    ----------
    problem : FC3D
        Its contacts, friction and W, which is symmetric.
    b : ndarray, shape (3 nc,)
        m/s.
    d : ndarray, shape (3 nc,)
        Impulse whose velocity change is the start, N·s.

    Attributes
    ----------
    d, o : ndarray, shape (3 nc,)
        The unknown y = M⁻¹ H d, and Hᵀ y.
    square : float
        ‖y‖²_M, J.
    estimate : ndarray, shape (3 nc,)
        P_K(x + ρ (b - o)) after the last step, N·s.
    """

    def __init__(self, problem: FC3D, b: Array, d: Array) -> None:
        self._W = operator(problem)
        self._mu, self._scales, self._b = problem.mu, problem.scales, b
        self._A = np.empty((problem.nc, 3, 3))
        self.restart(d)
        self.estimate = np.empty_like(b)

    def restart(self, d: Array) -> None:
        """Continue from the velocity change of another impulse d."""
        self.d, self.o, self.square = d, *self._along(d)

    def _along(self, d: Array) -> tuple[Array, float]:
        o = self._W.product(d)
        return o, float(d @ o)

    def step(self, x: Array, penalty: float) -> tuple[float, float]:
        """Take a Newton step at an estimate x, with ρ = `penalty`/λ_max(W_cc).

        Returns the fraction of the step taken, 0 if the matrix is singular, and the defect ‖y - M⁻¹ H `estimate`‖_M,
        √J.
        """
        given = self._b, x, penalty / self._scales, self._mu
        last = _kernels.merit(self.square, self.o, *given, self.estimate)
        _kernels.curvature(self.o, *given, self._A)
        g = self.estimate - self.d
        try:
            moved = self._W.factor(self._A)(g)
        except RuntimeError:  # singular up to round-off
            return 0.0, np.inf
        change, fraction = g - np.einsum("cij,cj->ci", self._A, moved.reshape(-1, 3)).ravel(), 1.0
        while True:
            d = self.d + fraction * change
            o, square = self._along(d)
            if _kernels.merit(square, o, *given, self.estimate) <= last + ROUND_OFF * last or fraction < SHORTEST:
                break
            fraction *= 0.5
        self.d, self.o, self.square = d, o, square
        _, left = self._along(self.estimate - d)
        return fraction, float(np.sqrt(max(0.0, left)))
