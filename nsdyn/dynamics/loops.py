"""Bilateral constraints of a tree: closed loops, gears and driven joints, B v = b, redundant ones included."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.dynamics import links as _links
from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.collision.distances import pose_views
from nsdyn.scene.articulations import Loop
from nsdyn.scene.gears import Gear, GearGaps
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.displacements import integrate

RANK = 1e-8
"""Singular values below this fraction of the largest count as those of redundant rows. The Jacobian is evaluated on the
manifold of closed loops, where redundancy leaves 1e-12. A mechanism that passes a singular configuration is this close
to it for less than a microsecond."""

SHORT = 1e-3
"""Least length of a row, as a fraction of the longest, that counts as a unit. Across its plane a planar loop has rows
of round-off and of gaps, 1e-12, and as units these would hold a direction at random."""

STEPS = 50
"""Most Newton steps to close loops. A start far away takes ten, a step of a simulation one or two."""

CLOSED = 1e-12
"""Gap below which a loop is closed, m and rad: a hundredth of a millionth of the accuracy that a long run must keep."""

ROUNDED = 16.0 * np.finfo(float).eps
"""The same as a fraction of the largest coordinate, of a joint or of its place in the world: no gap is known better."""


def supports(model: pin.Model) -> Bools:
    """Boolean table of shape (njoints, nv): entry (k, j) is true if coordinate j moves joint k."""
    out = np.zeros((model.njoints, model.nv), dtype=bool)
    for joint in range(1, model.njoints):
        for k in model.supports[joint]:
            if k:
                first = model.joints[k].idx_v
                out[joint, first : first + model.joints[k].nv] = True
    return out


def factored(model: pin.Model, data: pin.Data, q: Array) -> tuple[Array, Array, Array]:
    """(M, F, M⁻¹) at q, with M⁻¹ = Fᵀ F; raise the error of `indefinite` if M has no Cholesky factor."""
    M = np.array(pin.crba(model, data, q)).reshape(model.nv, model.nv)
    F, inverse = np.empty((2, *M.shape))
    if not _trees.factor(M, F, inverse):
        raise indefinite(model, M)
    return M, F, inverse


def indefinite(model: pin.Model, M: Array) -> Exception:
    """Return the error that describes a mass matrix without a Cholesky factor."""
    if not np.isfinite(M).all():
        return ArithmeticError(f"positions of {model.name!r} are no longer finite")
    return ValueError(
        f"mass matrix of {model.name!r} is not positive definite: a joint moves no mass; give it an armature"
    )


def admissible(B: Array, F: Array, loops: int = 0) -> tuple[Array, Array]:
    """(Z, P) with B Z = 0, Zᵀ M Z = I, and v = P b + Z y all velocities with B v = b; P b has the least vᵀ M v.

    Where no v has B v = b, P b is nearest to it, in a measure that does not depend on the world's axes.

    Parameters
    ----------
    B : ndarray, shape (m, n)
        Any rank. The rank is determined from rows of about unit length in the metric of M, so that units do not matter.
    F : ndarray, shape (n, n)
        M⁻¹ = Fᵀ F.
    loops : int
        Number of rows at the beginning that come in threes, for the axes of the world.
    """
    A = B @ F.T
    norm = np.linalg.norm(A, axis=1)
    threes = norm[:loops].reshape(-1, 3)
    threes[:] = threes.max(axis=1, keepdims=True)
    norm = np.maximum(norm, SHORT * norm.max()) if norm.any() else np.ones_like(norm)
    U, s, Vt = np.linalg.svd(A / norm[:, None])
    rank = int((s > RANK * s[0]).sum())
    V = F.T @ Vt.T
    P = (V[:, :rank] / s[:rank]) @ (U[:, :rank].T / norm)
    return V[:, rank:], P


class Closures:
    """Closed loops and gears of one tree as φ(q) = 0.

    A loop makes points of two links coincide, or their frames; a gear is q2 = a q1 + b. The rows `driven` (k, nv) are
    those of driven coordinates, which stay fixed when loops are closed. The first `of_loops` of all `size` rows are
    those of loops, in threes.
    """

    def __init__(
        self, model: pin.Model, loops: Sequence[Loop], gears: Sequence[Gear] = (), driven: Array | None = None
    ) -> None:
        self._model, self._loops, self._data = model, loops, model.createData()
        self.driven = np.empty((0, model.nv)) if driven is None else driven
        R, x = pose_views(self._data.oMi, model.njoints)
        self._tree = x, R, self._data.J.reshape(6, model.nv, order="A"), supports(model)
        joints = [(loop.joint1, loop.joint2) for loop in loops]
        points = [(loop.placement1.translation, loop.placement2.translation) for loop in loops]
        self._joints = np.array(joints, dtype=np.int64).reshape(-1, 2)
        self._points = np.array(points).reshape(-1, 2, 3)
        sizes = [6 if loop.kind == "frame" else 3 for loop in loops]
        self._rows = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self._gears, self._names = GearGaps(model, gears), [*(loop.name for loop in loops), *(g.name for g in gears)]
        self.of_loops = int(self._rows[-1])
        self.size = self.of_loops + len(gears)
        self._last: tuple[Array | None, tuple[Array, Array]] = None, (np.empty(0), np.empty((0, 0)))

    def at(self, q: Array) -> tuple[Array, Array]:
        """(φ, G) at q, shapes (m,) in m and rad and (m, nv): dφ/dt = G v where φ = 0; world axes."""
        if q is not self._last[0]:  # the configuration just closed is evaluated once more
            self._last = q, self._at(q)
        return self._last[1]

    def _at(self, q: Array) -> tuple[Array, Array]:
        pin.computeJointJacobians(self._model, self._data, q)
        phi, G = np.zeros(self.size), np.zeros((self.size, self._model.nv))
        _links.closures(self._tree, (self._joints, self._points, self._rows), phi, G)
        for loop, row in zip(self._loops, self._rows, strict=False):
            if loop.kind == "frame":
                a, b = self._data.oMi[loop.joint1].rotation, self._data.oMi[loop.joint2].rotation
                phi[row + 3 : row + 6] = pin.log3(a @ loop.placement1.rotation @ (b @ loop.placement2.rotation).T)
        if (first := self.of_loops) < self.size:
            phi[first:], G[first:] = self._gears.at(q), self._gears.rows
        return phi, G

    def close(self, q: Array) -> Array:
        """Configuration near q with φ = 0, the closest in the kinetic metric; q itself if its loops are closed.

        The Newton steps are -N Gᵀ (G N Gᵀ)⁻¹ φ, with N the inverse of M(q) for motions in which `driven` coordinates do
        not move. Levenberg's term, |φ| times the diagonal, keeps the steps finite at redundant loops and near singular
        configurations. ValueError if the loops cannot be closed.

        References
        ----------
        N. Yamashita, M. Fukushima, On the rate of convergence of the Levenberg–Marquardt method, 2001.
        """
        N: Array | None = None
        for _ in range(STEPS):
            phi, G = self.at(q)
            gap = _reductions.largest(phi)
            # `at` has placed the joints.
            if gap <= CLOSED or gap <= ROUNDED * max(_reductions.largest(q), np.abs(self._tree[0]).max()):
                return q
            if N is None:
                _, F, N = factored(self._model, self._data, q)
                if len(self.driven):
                    Z = admissible(self.driven, F)[0]
                    N = Z @ Z.T
            step = np.zeros(self._model.nv)
            if not _trees.closing(G, N, phi, min(gap, 1.0), step):
                break
            q = np.array(integrate(self._model, q, step))
        raise ValueError(f"loops or gears {self._names} do not close: they are apart by {gap:.3g} m or rad")
