"""Bilateral constraints of a tree: closed loops, gears and driven joints, B v = b, redundant ones included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from nsdyn.scene.articulations import Loop
from nsdyn.scene.gears import Gear, GearGaps
from nsdyn.tools.arrays import Array

__all__ = ["Closures", "admissible", "supports"]

RANK = 1e-8
"""Singular values below this fraction of the largest are those of redundant rows: on the manifold of closed loops,
where the Jacobian is evaluated, redundancy leaves 1e-12, and a mechanism that passes a singular configuration is this
close to it for less than a microsecond."""

STEPS = 50
"""Newton steps to close loops; a start that is far away takes ten, a step of a simulation one or two."""

CLOSED = 1e-12
"""Gap of a closed loop, m and rad; a hundredth of a millionth of what a long run must keep."""


def supports(model: pin.Model) -> NDArray[np.bool_]:
    """Whether coordinate j moves joint k, shape (njoints, nv)."""
    out = np.zeros((model.njoints, model.nv), dtype=bool)
    for joint in range(1, model.njoints):
        for k in model.supports[joint]:
            if k:
                first = model.joints[k].idx_v
                out[joint, first : first + model.joints[k].nv] = True
    return out


def admissible(B: Array, F: Array) -> tuple[Array, Array]:
    """(Z, P) with B Z = 0, Zᵀ M Z = I, and v = P b + Z y all velocities with B v = b; P b has the least vᵀ M v.

    Parameters
    ----------
    B : ndarray, shape (m, n)
        Any rank; it is decided on rows of unit length in the metric of M, so that units do not matter.
    F : ndarray, shape (n, n)
        M⁻¹ = Fᵀ F.
    """
    A = B @ F.T
    norm = np.linalg.norm(A, axis=1)
    norm[norm == 0.0] = 1.0
    U, s, Vt = np.linalg.svd(A / norm[:, None])
    rank = int((s > RANK * s[0]).sum())
    V = F.T @ Vt.T
    P = (V[:, :rank] / s[:rank]) @ (U[:, :rank].T / norm)
    return V[:, rank:], P


class Closures:
    """Closed loops and gears of one tree as φ(q) = 0: points of two links coincide, or frames do; q2 = a q1 + b.

    Parameters
    ----------
    model : pinocchio.Model
    loops : sequence of Loop
    gears : sequence of Gear
    """

    def __init__(self, model: pin.Model, loops: Sequence[Loop], gears: Sequence[Gear] = ()) -> None:
        self._model, self._loops, self._data = model, loops, model.createData()
        self._gears, self._names = GearGaps(model, gears), [*(loop.name for loop in loops), *(g.name for g in gears)]
        self._support = supports(model)
        self.size = sum(6 if loop.kind == "frame" else 3 for loop in loops) + len(gears)

    def at(self, q: Array) -> tuple[Array, Array]:
        """(φ, G) at q, shapes (m,) in m and rad and (m, nv): dφ/dt = G v where φ = 0; world axes."""
        pin.computeJointJacobians(self._model, self._data, q)
        J = self._data.J.reshape(6, -1, order="A")
        phi, G, row = np.empty(self.size), np.empty((self.size, self._model.nv)), 0
        for loop in self._loops:
            a = self._data.oMi[loop.joint1] * loop.placement1
            b = self._data.oMi[loop.joint2] * loop.placement2
            Ja, Jb = J * self._support[loop.joint1], J * self._support[loop.joint2]
            phi[row : row + 3] = a.translation - b.translation
            G[row : row + 3] = Ja[:3] - Jb[:3] - pin.skew(a.translation) @ Ja[3:] + pin.skew(b.translation) @ Jb[3:]
            row += 3
            if loop.kind == "frame":
                phi[row : row + 3] = pin.log3(a.rotation @ b.rotation.T)
                G[row : row + 3] = Ja[3:] - Jb[3:]
                row += 3
        phi[row:], G[row:] = self._gears.at(q), self._gears.rows
        return phi, G

    def close(self, q: Array, driven: Array) -> Array:
        """Configuration near q where φ = 0, the closest in the kinetic metric; q itself if it is one.

        Newton's steps -N Gᵀ (G N Gᵀ)⁻¹ φ, with N the inverse of M(q) where coordinates with a row of `driven` (k, nv)
        do not move. Levenberg's term, |φ| of the diagonal, keeps them finite at redundant loops and near singular
        configurations.

        Raises
        ------
        ValueError
            When the loops cannot be closed.

        References
        ----------
        N. Yamashita, M. Fukushima, On the rate of convergence of the Levenberg–Marquardt method, 2001.
        """
        N: Array | None = None
        for _ in range(STEPS):
            phi, G = self.at(q)
            gap = float(np.abs(phi).max())
            if gap <= CLOSED:
                return q
            if N is None:
                F = np.linalg.inv(np.linalg.cholesky(pin.crba(self._model, self._data, q)))
                Z = admissible(driven, F)[0] if len(driven) else F.T
                N = Z @ Z.T
            S = G @ N @ G.T
            scale = np.sqrt(np.diag(S))
            scale[scale == 0.0] = 1.0
            A = S / np.outer(scale, scale) + min(gap, 1.0) * np.eye(self.size)
            q = np.array(pin.integrate(self._model, q, -N @ (G.T @ (np.linalg.solve(A, phi / scale) / scale))))
        raise ValueError(f"loops or gears {self._names} do not close: they are apart by {gap:.3g} m or rad")
