"""3D frictional contact problem: its data, its factors and its measures of error.

Find r with u = W r + q and K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K, per contact, normal first (N, T1, T2); W in 1/kg, q and u in
m/s, r in N·s. The problem, not the solver, measures every solution.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.problem import given as _given
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.tools.arrays import Array, Index, numbers


def _as_blocks3(W: Any) -> tuple[Index, Index, Array]:
    """Return W in 3 x 3 blocks as `FC3D.csr`; ValueError when it is not square, finite or a multiple of 3."""
    if sp.issparse(W) and W.dtype.kind == "c":
        raise ValueError("W must be real, got complex numbers")
    if not sp.issparse(W):
        W = numbers(W, "real and square with 3 rows per contact", "W")
    if W.ndim != 2 or W.shape[0] != W.shape[1] or W.shape[0] % 3:
        raise ValueError(f"W must be square with 3 rows per contact, got shape {W.shape}")
    nc = W.shape[0] // 3
    if sp.issparse(W) and nc:
        W = sp.bsr_array(W.tobsr((3, 3)), dtype=float, copy=True)
        W.sum_duplicates()
        out = _csr(W)
    else:
        # Keep non-zero blocks and those of the diagonal; SciPy's conversion takes ten times as long.
        blocks = np.reshape(W if nc else np.empty((0, 0)), (nc, 3, nc, 3)).transpose(0, 2, 1, 3)
        kept = blocks.any(axis=(2, 3))
        kept.flat[:: nc + 1] = True
        row, column = np.nonzero(kept)
        out = np.searchsorted(row, np.arange(nc + 1)), column.copy(), blocks[row, column]
    if not np.isfinite(out[2]).all():
        raise ValueError("W must be finite, got NaN or infinity")
    return out


class FC3D:
    """Frictional contact problem: find r with u = W r + q, K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K.

    Parameters
    ----------
    W : array or sparse array, shape (3 nc, 3 nc)
        Delassus operator in 1/kg, positive semi-definite; singular if contacts are redundant. It need not be symmetric
        (files of the literature are not always).
    q : ndarray, shape (3 nc,)
        Relative velocity without contact impulses, m/s, normal first.
    mu : ndarray, shape (nc,)
        Friction coefficients.

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite, a q whose square is not finite, μ < 0, or a diagonal block of W
        that is zero.

    Examples
    --------
    >>> problem = FC3D([[2.0, 0, 0], [0, 1, 0], [0, 0, 1]], [-1.0, 3.0, 0.0], [0.5])
    >>> r = [0.5, -0.25, 0.0]  # slips: |r_T| = mu r_N against the slip, and u_N = 0
    >>> problem.error(r) < 1e-15, problem.residual(r) < 1e-15, problem.velocity(r).tolist()
    (True, True, [0.0, 2.75, 0.0])
    """

    def __init__(self, W: Any, q: Any, mu: Any) -> None:
        self._set(q, mu)
        self.blocks: DelassusFactors | None = None
        self.csr = _as_blocks3(W)
        rows = 3 * (self.csr[0].size - 1)
        if rows != self.q.size:
            raise ValueError(f"W must have {self.q.size} rows like q, got {rows}")
        self._check_scales()
        if not (normal := self.W.diagonal()[0::3] > 0.0).all():
            raise ValueError(f"W must have a positive normal diagonal, not at {np.flatnonzero(~normal).tolist()[:5]}")

    def __repr__(self) -> str:
        mu = f"mu from {self.mu.min():g} to {self.mu.max():g}, " if self.nc else ""
        return f"<FC3D, nc = {self.nc}: {mu}‖q‖ = {np.linalg.norm(self.q):.3g} m/s>"

    @classmethod
    def from_blocks(cls, blocks: DelassusFactors, q: Any, mu: Any, scales: Array | None = None) -> FC3D:
        """Return the problem with W = Hᵀ M⁻¹ H given by its factors, and the `scales` if known.

        W is assembled at its first use.
        """
        problem = cls.__new__(cls)
        problem._set(q, mu)
        problem.blocks = blocks
        if blocks.nc != problem.nc:
            raise ValueError(f"blocks must have {problem.nc} contacts like mu, got {blocks.nc}")
        if scales is None:
            scales = np.empty(problem.nc)
            _blocks.delassus_scales(blocks.arrays, 0.0, scales[:0], scales)
        problem.scales = scales
        problem._check_scales()
        return problem

    @classmethod
    def prepared(cls, blocks: DelassusFactors, q: Array, mu: Array, scales: Array, q_norm: float) -> FC3D:
        """Return the problem as `from_blocks`, without checks, for data already checked, with ‖q‖₂, m/s."""
        problem = cls.__new__(cls)
        problem.blocks, problem.q, problem.mu, problem.scales, problem.q_norm = blocks, q, mu, scales, q_norm or 1.0
        return problem

    def with_velocity(self, q: Any, mu: Any = None) -> FC3D:
        """Return the problem of the same contacts with another q (and μ), without checking W again."""
        problem = FC3D.__new__(FC3D)
        problem.__dict__.update(self.__dict__, kept=self.kept if mu is None else {})
        problem._set(q, self.mu if mu is None else mu)
        if problem.nc != self.nc:
            raise ValueError(f"q must have {3 * self.nc} entries, 3 per contact of W, got {problem.q.size}")
        return problem

    def _set(self, q: Any, mu: Any) -> None:
        """Set q and μ; ValueError for invalid values."""
        # Copies: what is remembered of them would not fit if the caller changed his own.
        self.q: Array = np.array(numbers(q, "3 numbers per contact", "q"), order="C")
        self.mu: Array = np.array(numbers(mu, "a number per contact", "mu"), order="C")
        if self.mu.ndim != 1 or self.q.shape != (3 * self.mu.size,):
            raise ValueError(f"q must have 3 entries per entry of mu, got {self.q.shape} and {self.mu.shape}")
        q_norm, good = _blocks.size_of(self.q, self.mu)
        self.q_norm: float = q_norm or 1.0
        """‖q‖₂ in m/s, or 1 where q = 0."""
        if good:
            return
        if not np.isfinite(self.q).all():
            raise ValueError("q must be finite, got NaN or infinity")
        if (bad := ~(np.isfinite(self.mu) & (self.mu >= 0.0))).any():
            raise ValueError(f"mu must be finite and not negative, got {self.mu[bad][0]:g}")
        raise ValueError(f"q must have a norm whose square is finite, got {np.abs(self.q).max():g} m/s")

    def _check_scales(self) -> None:
        """Raise ValueError if the size of a diagonal block is zero or out of range."""
        if _blocks.in_range(self.scales):
            return
        fine = (self.scales >= _blocks.SMALLEST) & (self.scales <= _blocks.LARGEST)
        bad = np.flatnonzero(~fine).tolist()
        raise ValueError(
            f"W must have a non-zero positive diagonal block at every contact, not at {bad[:5]}, "
            f"and none below {_blocks.SMALLEST:g} or above {_blocks.LARGEST:g}"
        )

    @cached_property
    def kept(self) -> dict[Any, Any]:
        """Quantities that solvers derive from W and μ alone. The problems of `with_velocity` share them."""
        return {}

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
        """(indptr, indices, data (nnz, 3, 3)) of W, sorted, with 64-bit indices, as the kernels need them."""
        return _csr(self.W)

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return len(self.mu)

    def islands(self) -> Index:
        """Return the island of each contact, as `DelassusFactors.islands`."""
        if self.blocks is not None:
            return self.blocks.islands()
        indptr, indices, data = self.csr
        return connected_components(sp.csr_array((np.ones(len(data)), indices, indptr)))[1].astype(np.int64)

    def velocity(self, r: Any) -> Array:
        """Return u = W r + q, shape (3 nc,), m/s."""
        if self.blocks is None:
            u = np.empty_like(self.q)
            _given.velocity(self.csr, self.q, self.impulse(r), u)
            return u
        return self.product(r) + self.q

    def product(self, r: Any) -> Array:
        """Return W r, shape (3 nc,), m/s, without the round-off of q that `velocity` less q would have."""
        if self.blocks is None:
            return self.with_velocity(np.zeros_like(self.q)).velocity(r)
        return self.blocks.product(self.impulse(r))

    def error(self, r: Any) -> float:
        """Return the error of the literature, ‖r - P_K(r - û)‖₂ / ‖q‖₂ (ρ = 1 in the given units).

        Notes
        -----
        It mixes impulses and velocities, so it changes with the unit of mass: read `residual` beside it. For q = 0 it
        is not divided.

        References
        ----------
        V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018, section 6.
        """
        return self.solved(r, 0.0)[1]

    def residual(self, r: Any) -> float:
        """Return the unit-invariant residual, m/s: max over contacts of ‖r - P_K(r - ρ û)‖ / ρ and -u_N.

        ρ = 1/λ_max(W_cc). The first term alone would be |u_N| / (1 + μ²)^½ at a contact that closes without impulse.
        """
        return self.solved(r, 0.0)[2]

    def round_off(self, r: Any) -> float:
        """Return the round-off in the larger of `residual` and `error` of r (3 nc,), N·s.

        The round-off of the residual is about 4 ε max_c (|q_c| + λ_max(W_cc) |r_c|) m/s, that of u_c = Σ W_cd r_d + q_c
        where no W_cd is larger than W_cc. The round-off of the error is ε ‖r‖/‖q‖, since an r on the edge of its cone
        lies there only up to rounding: 1e-8 for bodies of 1e8 kg. On random problems, redundant ones too, solvers reach
        0.2 to 0.9 of this value and no less.
        """
        return float(_cones.round_off(self.scales, self.q, self.impulse(r), self.q_norm))

    def gap(self, r: Any) -> float:
        """Return the duality gap Σ r·(u + δ e_N + μ‖u_T‖ e_N) in J of the problem shifted by δ = max(0, -u_N).

        See `gauss`.
        """
        r = self.impulse(r)
        return float(_cones.duality_gap(self.velocity(r), r, self.mu)[0])

    def impulse(self, r: Any, what: str = "r") -> Array:
        """Return r as an array (3 nc,); ValueError naming `what` if its shape does not fit."""
        out: Array = np.ascontiguousarray(numbers(r, "3 numbers per contact", what))
        if out.shape != self.q.shape:
            raise ValueError(f"{what} must have shape {self.q.shape} like q, got {out.shape}")
        return out

    def solved(self, r: Array, tol: float) -> tuple[bool, float, float, Array]:
        """Return (both measures within tol, error, residual in m/s, u) of an impulse r."""
        r = self.impulse(r)
        u = self.velocity(r)
        top, residual = _cones.measures(self.scales, u, r, self.mu)
        error = top / self.q_norm
        return error <= tol and residual <= tol, error, residual, u


def _csr(W: sp.bsr_array) -> tuple[Index, Index, Array]:
    """Return (indptr, indices, data) of a BSR array with 64-bit indices, as the kernels need them."""
    data = np.ascontiguousarray(W.data).reshape(-1, 3, 3)
    return W.indptr.astype(np.int64, copy=False), W.indices.astype(np.int64, copy=False), data
