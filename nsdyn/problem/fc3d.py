"""The 3D frictional contact problem, its factors, its measures of error, and what a solver returns.

Find r with u = W r + q and K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K, per contact, normal first (N, T1, T2); W in 1/kg, q and u
in m/s, r in N·s. The judge is not the player: every solver's answer is measured here.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import pgs as _pgs

Array = NDArray[np.float64]
Index = NDArray[np.int64]

__all__ = ["FC3D", "Blocks", "NotConverged", "Solution", "Status"]


class Status(IntEnum):
    """How a solve ended; `message` says it in words."""

    CONVERGED = 0
    MAX_ITERATIONS = 1
    STALLED = 2
    NOT_FINITE = 3
    NO_SLATER_POINT = 4
    OVERLAP = 5
    LOOSE = 6

    @property
    def message(self) -> str:
        """One sentence for a person, with the remedy."""
        return {
            Status.CONVERGED: "converged",
            Status.MAX_ITERATIONS: "the iteration limit was reached; allow more or use solver='auto'",
            Status.STALLED: "the residual no longer falls; loosen tol or use another solver",
            Status.NOT_FINITE: "the iterates are not finite; check W, q and mu",
            Status.NO_SLATER_POINT: "no velocity opens every contact, so that a solution need not exist; "
            "look for walls or prescribed motions that contradict each other",
            Status.OVERLAP: "converged, but no position without overlap was found where the step ends; look for bodies "
            "that are squeezed",
            Status.LOOSE: "within the loose tolerance, where the other costs too much; accepted",
        }[self]


class Blocks(NamedTuple):
    """Factors of W = Hᵀ M⁻¹ H in blocks of coordinates.

    Attributes
    ----------
    offset : ndarray of int, shape (nb + 1,)
        First coordinate of each block: 6 per free body, nv per articulated tree.
    block : ndarray of int, shape (nc, 2)
        The blocks contact c touches, -1 for none.
    start : ndarray of int, shape (nc, 2)
        Where the 3 x n rows of Hᵀ for that block begin in `h`.
    h : ndarray
        Rows of Hᵀ, one row after the other, u = Hᵀ v [m/s].
    m_start : ndarray of int, shape (nb,)
        Where the n x n block of M (and of M⁻¹) begins in `m` (and `minv`).
    m, minv : ndarray
        Blocks of M [kg, kg m²] and of M⁻¹, row by row.
    """

    offset: Index
    block: Index
    start: Index
    h: Array
    m_start: Index
    m: Array
    minv: Array

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self.offset[-1])

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return len(self.block)

    def relative_velocity(self, v: Array) -> Array:
        """u = Hᵀ v, shape (3 nc,)."""
        u = np.empty(3 * self.nc)
        _blocks.relative_velocity(self.offset, self.block, self.start, self.h, v, u)
        return u

    def momentum(self, r: Array) -> Array:
        """H r, shape (n,)."""
        p = np.empty(self.n)
        _blocks.momentum(self.offset, self.block, self.start, self.h, r, p)
        return p

    def velocity_change(self, r: Array) -> Array:
        """M⁻¹ H r, shape (n,)."""
        dv = np.empty(self.n)
        _blocks.velocity_change(self.offset, self.block, self.start, self.h, self.m_start, self.minv, r, dv)
        return dv

    def delassus(self) -> sp.bsr_array:
        """W = Hᵀ M⁻¹ H as a BSR array of 3 x 3 blocks, exactly symmetric."""
        indptr, indices, data = _blocks.delassus(self.offset, self.block, self.start, self.h, self.m_start, self.minv)
        return sp.bsr_array((data, indices, indptr), shape=(3 * self.nc, 3 * self.nc))

    def jacobian(self) -> sp.csr_array:
        """Hᵀ, shape (3 nc, n), u = Hᵀ v."""
        c, side = np.nonzero(self.block >= 0)
        k, start = self.block[c, side], self.start[c, side]
        n = np.diff(self.offset)[k]
        pair = np.repeat(np.arange(k.size), 3 * n)
        inside = np.arange(pair.size) - np.repeat(3 * (np.cumsum(n) - n), 3 * n)
        row, column = np.divmod(inside, n[pair])
        places = 3 * c[pair] + row, self.offset[k][pair] + column
        return sp.csr_array((self.h[start[pair] + inside], places), shape=(3 * self.nc, self.n))

    def dense(self) -> tuple[Array, Array]:
        """(M, H) as dense arrays of shapes (n, n) and (n, 3 nc), for checks on small problems."""
        M = np.zeros((self.n, self.n))
        for k, o in enumerate(self.offset[:-1]):
            n = self.offset[k + 1] - o
            M[o : o + n, o : o + n] = self.m[self.m_start[k] : self.m_start[k] + n * n].reshape(n, n)
        return M, self.jacobian().toarray().T

    @staticmethod
    def from_delassus(W: Any) -> Blocks:
        """Factors M = I and H = V Λ^½ of the symmetric part of a given W, one block of rank(W) coordinates.

        Eigenvalues below 1e-14 of the largest are round-off of a rank-deficient W and are left out.
        """
        A = W.toarray() if sp.issparse(W) else np.asarray(W)
        eigenvalues, V = np.linalg.eigh(0.5 * (A + A.T))
        keep = eigenvalues > 1e-14 * eigenvalues[-1]
        h = V[:, keep] * np.sqrt(eigenvalues[keep])
        nc, n = A.shape[0] // 3, h.shape[1]
        eye = np.eye(n).ravel()
        block = np.column_stack((np.zeros(nc, np.int64), np.full(nc, -1, np.int64)))
        start = np.column_stack((3 * n * np.arange(nc), np.zeros(nc, np.int64)))
        return Blocks(np.array([0, n]), block, start, np.ascontiguousarray(h).ravel(), np.array([0]), eye, eye)


def _as_blocks3(W: Any, name: str) -> tuple[Index, Index, Array]:
    """W in 3 x 3 blocks as `FC3D.csr`; ValueError when it is not square, finite or a multiple of 3."""
    if not sp.issparse(W):
        W = np.asarray(W, dtype=float)
    if W.ndim != 2 or W.shape[0] != W.shape[1] or W.shape[0] % 3:
        raise ValueError(f"{name} must be square with 3 rows per contact, got shape {W.shape}")
    nc = W.shape[0] // 3
    if sp.issparse(W) and nc:
        W = sp.bsr_array(W, blocksize=(3, 3))
        W.sort_indices()
        out = _csr(W)
    else:
        # The blocks that are not zero and those of the diagonal; SciPy's conversion takes ten times as long.
        blocks = np.reshape(W if nc else np.empty((0, 0)), (nc, 3, nc, 3)).transpose(0, 2, 1, 3)
        kept = blocks.any(axis=(2, 3))
        kept.flat[:: nc + 1] = True
        row, column = np.nonzero(kept)
        out = np.searchsorted(row, np.arange(nc + 1)), column, blocks[row, column]
    if not np.isfinite(out[2]).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity")
    return out


class FC3D:
    """Frictional contact problem: find r with u = W r + q, K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K.

    Parameters
    ----------
    W : array or sparse array, shape (3 nc, 3 nc)
        Delassus operator in 1/kg, positive semi-definite; singular as soon as contacts are redundant. It need not be
        symmetric (files of the literature are not always).
    q : ndarray, shape (3 nc,)
        Relative velocity without contact impulses, m/s, normal first.
    mu : ndarray, shape (nc,)
        Friction coefficients.

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite, μ < 0, or a diagonal block of W that is zero.

    Examples
    --------
    >>> problem = FC3D([[2.0, 0, 0], [0, 1, 0], [0, 0, 1]], [-1.0, 3.0, 0.0], [0.5])
    >>> r = [0.5, -0.25, 0.0]  # slips: |r_T| = mu r_N against the slip, and u_N = 0
    >>> problem.error(r) < 1e-15, problem.residual(r) < 1e-15, problem.velocity(np.array(r)).tolist()
    (True, True, [0.0, 2.75, 0.0])
    """

    def __init__(self, W: Any, q: Any, mu: Any) -> None:
        self._set(q, mu)
        self._check_values()
        self.blocks: Blocks | None = None
        self.csr = _as_blocks3(W, "W")
        rows = 3 * (self.csr[0].size - 1)
        if rows != self.q.size:
            raise ValueError(f"W must have {self.q.size} rows like q, got {rows}")
        self._check_scales()

    @classmethod
    def from_blocks(cls, blocks: Blocks, q: Any, mu: Any, scales: Array | None = None) -> FC3D:
        """Problem with W = Hᵀ M⁻¹ H given by its factors, and the `scales` if known; W is assembled when asked for."""
        problem = cls.__new__(cls)
        problem._set(q, mu)
        offset, block, start, h, m_start, _, minv = problem.blocks = blocks
        nc = len(problem.mu)
        if len(block) != nc:
            raise ValueError(f"blocks must have {nc} contacts like mu, got {len(block)}")
        if scales is None:
            scales = np.empty(nc)
            q_norm, good = _blocks.prepare(offset, block, start, h, m_start, minv, problem.q, problem.mu, scales)
        else:
            q_norm, good = _blocks.size_of(problem.q, problem.mu)
        problem.scales = scales
        if not good:
            problem._check_values()
            problem._check_scales()
        problem.q_norm = q_norm or 1.0
        return problem

    def with_velocity(self, q: Any, mu: Any = None) -> FC3D:
        """The same contacts with another q (and μ), without looking at W again."""
        problem = FC3D.__new__(FC3D)
        problem.__dict__.update(self.__dict__)
        problem._set(q, self.mu if mu is None else mu)
        q_norm, good = _blocks.size_of(problem.q, problem.mu)
        if not good:
            problem._check_values()
        problem.q_norm = q_norm or 1.0
        return problem

    def _set(self, q: Any, mu: Any) -> None:
        self.q: Array = np.ascontiguousarray(q, dtype=float)
        self.mu: Array = np.ascontiguousarray(mu, dtype=float)
        if self.mu.ndim != 1 or self.q.shape != (3 * self.mu.size,):
            raise ValueError(f"q must have 3 entries per entry of mu, got {self.q.shape} and {self.mu.shape}")

    def _check_values(self) -> None:
        if not np.isfinite(self.q).all():
            raise ValueError("q must be finite, got NaN or infinity")
        if not (np.isfinite(self.mu).all() and (self.mu >= 0).all()):
            raise ValueError("mu must be finite and not negative")

    def _check_scales(self) -> None:
        if not (self.scales > 0).all():
            bad = np.flatnonzero(~(self.scales > 0)).tolist()
            raise ValueError(f"W must have a non-zero positive diagonal block at every contact, not at {bad[:5]}")

    @cached_property
    def W(self) -> sp.bsr_array:
        """Delassus operator, BSR with 3 x 3 blocks."""
        if self.blocks is not None:
            return self.blocks.delassus()
        indptr, indices, data = self.csr
        return sp.bsr_array((data, indices, indptr), shape=(self.q.size, self.q.size))

    @cached_property
    def scales(self) -> Array:
        """λ_max(W_cc) of each contact, shape (nc,), 1/kg."""
        out = np.empty(self.nc)
        _cones.diagonal_scales(*self.csr, out)
        return out

    @cached_property
    def csr(self) -> tuple[Index, Index, Array]:
        """(indptr, indices, data (nnz, 3, 3)) of W, sorted, with 64-bit indices, as the kernels take them."""
        return _csr(self.W)

    @cached_property
    def q_norm(self) -> float:
        """‖q‖₂ in m/s, or 1 where q = 0."""
        return math.sqrt(self.q @ self.q) or 1.0

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return len(self.mu)

    def velocity(self, r: Array) -> Array:
        """u = W r + q, shape (3 nc,), m/s."""
        if self.blocks is None:
            u = np.empty_like(self.q)
            _pgs.velocity(*self.csr, self.q, r, u)
            return u
        return self.blocks.relative_velocity(self.blocks.velocity_change(r)) + self.q

    def error(self, r: Any, u: Array | None = None) -> float:
        """Error of the literature, ‖r - P_K(r - û)‖₂ / ‖q‖₂ (ρ = 1 in the given units).

        Notes
        -----
        It mixes impulses and velocities, so it changes with the unit of mass: read `residual` beside it.

        References
        ----------
        V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 6.
        """
        r = self.impulse(r)
        u = self.velocity(r) if u is None else u
        return float(_cones.natural_error(u, r, self.mu)) / self.q_norm

    def residual(self, r: Any, u: Array | None = None) -> float:
        """Unit-invariant residual in m/s: max over contacts of ‖r - P_K(r - ρ û)‖ / ρ with ρ = 1/λ_max(W_aa)."""
        r = self.impulse(r)
        u = self.velocity(r) if u is None else u
        return float(_cones.natural_residual(self.scales, u, r, self.mu))

    def gap(self, r: Any) -> float:
        """Duality gap Σ r·(u + δ e_N + μ‖u_T‖ e_N) in J of the problem shifted by δ = max(0, -u_N): see `gauss`."""
        r = self.impulse(r)
        return float(_cones.duality_gap(self.velocity(r), r, self.mu)[0])

    def impulse(self, r: Any) -> Array:
        """The array r (3 nc,) that is meant; ValueError if its shape does not fit."""
        out: Array = np.ascontiguousarray(r, dtype=float)
        if out.shape != self.q.shape:
            raise ValueError(f"r must have shape {self.q.shape} like q, got {out.shape}")
        return out

    def solved(self, r: Array, tol: float) -> tuple[bool, float, float, Array]:
        """(both measures within tol, error, residual in m/s, u) of an impulse r."""
        r = self.impulse(r)
        if self.blocks is None:
            u = self.velocity(r)
            top, residual = _cones.measures(self.scales, u, r, self.mu)
        else:
            b, u = self.blocks, np.empty_like(self.q)
            factors = b.offset, b.block, b.start, b.h, b.m_start, b.minv
            top, residual = _blocks.judged(*factors, self.q, self.mu, self.scales, r, u)
        error = top / self.q_norm
        return error <= tol and residual <= tol, error, residual, u


def _csr(W: sp.bsr_array) -> tuple[Index, Index, Array]:
    """(indptr, indices, data) of a BSR array with 64-bit indices, as the kernels take them."""
    data = np.ascontiguousarray(W.data).reshape(-1, 3, 3)
    return W.indptr.astype(np.int64, copy=False), W.indices.astype(np.int64, copy=False), data


class Solution(NamedTuple):
    """What a solver returns, measured by the problem itself.

    Attributes
    ----------
    r : ndarray, shape (3 nc,)
        Impulses, N·s; not unique when contacts are redundant.
    u : ndarray, shape (3 nc,)
        u = W r + q, m/s.
    status : Status
    error : float
        `FC3D.error` of r.
    residual : float
        `FC3D.residual` of r, m/s.
    iterations : int
        Sweeps, factorisations or iterations, in the unit of the solver.
    time : float
        Wall time of the solve, s.
    """

    r: Array
    u: Array
    status: Status
    error: float
    residual: float
    iterations: int
    time: float

    @property
    def converged(self) -> bool:
        """Whether both measures met the tolerance."""
        return self.status is Status.CONVERGED

    @property
    def accepted(self) -> bool:
        """Whether a simulation goes on with it: converged, or within a loose tolerance where that was given."""
        return self.status in (Status.CONVERGED, Status.LOOSE)

    @staticmethod
    def judge(
        problem: FC3D, r: Array, tol: float, iterations: int, time: float, otherwise: Status = Status.STALLED
    ) -> Solution:
        """Solution of impulse r; converged only if the problem's own measures say so."""
        _, error, residual, u = problem.solved(r, tol)
        return Solution.measured(r, u, error, residual, tol, iterations, time, otherwise)

    @staticmethod
    def measured(
        r: Array, u: Array, error: float, residual: float, tol: float, iterations: int, time: float, otherwise: Status
    ) -> Solution:
        """Solution of an impulse with the velocity and the measures that its problem gives it."""
        if error <= tol and residual <= tol:
            status = Status.CONVERGED
        else:
            status = otherwise if math.isfinite(error) and math.isfinite(residual) else Status.NOT_FINITE
        return Solution(r, u, status, error, residual, iterations, time)


class NotConverged(RuntimeError):
    """A solve missed its tolerance; carries the `problem` and its best `solution`."""

    def __init__(self, message: str, problem: FC3D, solution: Solution) -> None:
        super().__init__(message)
        self.problem = problem
        self.solution = solution
