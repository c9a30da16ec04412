"""Linear systems on the graph of contacts.

Newton's methods for contact solve with (I + A W), A block-diagonal. By the factors that is the matrix of the bodies,
K = M + Σ H_c A_c H_cᵀ, as large as the coordinates and sparse as the graph of contacts, which outlives many solves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from threading import get_ident
from typing import Any

import numpy as np
import qdldl
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from nsdyn._kernels.problem import sparse as _matrix
from nsdyn.problem.blocks import Blocks
from nsdyn.tools.arrays import Array, Index

__all__ = ["Factor", "Lu", "contact_graph"]


class Lu:
    """LU factorisations of matrices of one symmetric pattern, with pivots on the diagonal.

    In which order to eliminate is found by the first: that takes as long as a quarter of a factorisation.

    Parameters
    ----------
    indptr, indices : ndarray
        Of the pattern by columns.
    """

    def __init__(self, indptr: Index, indices: Index) -> None:
        self._pattern, self._order, self._take = (indices, indptr), np.empty(0, np.int64), np.empty(0, np.int64)
        self._ordered: Any = None

    def __call__(self, data: Array) -> Callable[[Array], Array]:
        """Function b ↦ K⁻¹ b for the entries of K; RuntimeError when K is singular."""
        if not self._order.size:
            lu = self._factorised(self._matrix(data), "MMD_AT_PLUS_A")
            self._order = np.argsort(lu.perm_c)
            return lambda b: np.asarray(lu.solve(b))
        if self._ordered is None:
            numbered = self._matrix(np.arange(data.size))
            self._ordered = numbered[self._order][:, self._order].tocsc()
            self._ordered.sort_indices()
            self._take, self._ordered.data = self._ordered.data, np.empty(data.size)
        np.take(data, self._take, out=self._ordered.data)
        lu, order = self._factorised(self._ordered, "NATURAL"), self._order

        def solve(b: Array) -> Array:
            x = np.empty(b.size)
            x[order] = lu.solve(b[order])
            return x

        return solve

    def _matrix(self, data: Any) -> Any:
        n = self._pattern[1].size - 1
        return sp.csc_matrix((data, *self._pattern), shape=(n, n))

    @staticmethod
    def _factorised(K: Any, order: str) -> Any:
        return splu(K, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class Factor:
    """Sparse factorisations of K on one contact graph: Cholesky-like where K is symmetric, LU elsewhere."""

    def __init__(self, offset: Index, block: Index) -> None:
        self.indptr, self.indices, self.slot, self.diagonal = _matrix.pattern(offset, block)
        n = int(offset[-1])
        self.K = sp.csc_matrix((np.empty(self.indices.size), self.indices, self.indptr), shape=(n, n))
        column = np.repeat(np.arange(n), np.diff(self.indptr))
        self.upper = np.flatnonzero(self.indices <= column)
        end = np.searchsorted(self.upper, self.indptr)
        self.U = sp.csc_matrix((np.empty(self.upper.size), self.indices[self.upper], end), shape=(n, n))
        self.ldl: Any = None
        self._lu = Lu(self.indptr, self.indices)

    def _assemble(self, blocks: Blocks, A: Array) -> None:
        _matrix.assemble_sparse(blocks.arrays, A, self.indptr, self.slot, self.diagonal, self.K.data)

    def lu(self, blocks: Blocks, A: Array) -> Callable[[Array], Array]:
        """Function b ↦ K⁻¹ b for K = M + Σ H_c A_c H_cᵀ; RuntimeError when K is singular."""
        self._assemble(blocks, A)
        return self._lu(self.K.data)

    def solve(self, blocks: Blocks, A: Array, b: Array) -> Array:
        """K⁻¹ b, by LDLᵀ where K is symmetric."""
        if not _matrix.symmetric(A):
            return self.lu(blocks, A)(b)
        self._assemble(blocks, A)
        # QDLDL wants the upper triangle; to have it cut out by SciPy costs as much as the factorisation.
        np.take(self.K.data, self.upper, out=self.U.data)
        if self.ldl is None:
            self.ldl = qdldl.Solver(self.U, upper=True)
        else:
            self.ldl.update(self.U, upper=True)
        out: Array = self.ldl.solve(b)
        return out


@lru_cache(maxsize=16)
def _factor(thread: int, offset: bytes, block: bytes) -> Factor:
    """One `Factor` per contact graph, so that the symbolic part lives as long as the graph, for each thread its own."""
    return Factor(np.frombuffer(offset, np.int64), np.frombuffer(block, np.int64).reshape(-1, 2))


def contact_graph(blocks: Blocks) -> Factor:
    """The factorisations on the contact graph of some blocks."""
    return _factor(get_ident(), blocks.offset.tobytes(), blocks.block.tobytes())
