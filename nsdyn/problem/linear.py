"""Linear systems on the graph of contacts.

Newton's methods for contact solve with (I + A W), A block-diagonal. By the factors that is the matrix of the bodies,
K = M + Σ H_c A_c H_cᵀ, as large as the coordinates and sparse as the graph of contacts, which outlives many solves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from threading import get_ident
from typing import Any

import numpy as np
import qdldl
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from nsdyn._kernels.problem import sparse as _matrix
from nsdyn.problem.blocks import Blocks
from nsdyn.tools.arrays import Array, Index

__all__ = ["Factor", "Ordered", "contact_graph", "elimination_order", "forget"]


def elimination_order(count: int, rows: Index, columns: Index) -> Index:
    """Order of minimum degree for a symmetric pattern: the blocks as they are eliminated, shape (count,).

    Blocks take a fraction of the time of their coordinates, and a pattern is ordered once for many matrices.

    Parameters
    ----------
    count : int
        Blocks.
    rows, columns : ndarray of int, shape (k,)
        Blocks that are coupled, in one triangle or both.

    References
    ----------
    J. W. H. Liu, Modification of the minimum-degree algorithm by multiple elimination, ACM Trans. Math. Softw. 11,
    1985.
    """
    diagonal = np.arange(count)
    i, j = np.concatenate((diagonal, rows)), np.concatenate((diagonal, columns))
    values = np.where(np.arange(i.size) < count, 1.0 + rows.size, -1.0)
    lu = _splu(sp.csc_matrix((values, (i, j)), shape=(count, count)), "MMD_AT_PLUS_A")
    return np.argsort(lu.perm_c)


class Ordered:
    """LU factorisations of matrices K whose rows and columns are in the order of their elimination, pivots in place.

    Parameters
    ----------
    indptr, indices : ndarray, shapes (n + 1,), (entries,)
        Pattern of K by columns.
    to : ndarray, shape (n,)
        Where coordinates stand in K.
    """

    def __init__(self, indptr: Index, indices: Index, to: Index) -> None:
        self.K = sp.csc_matrix((np.empty(indices.size), indices, indptr), shape=(to.size, to.size))
        self._to = to

    def factor(self) -> Callable[[Array], Array]:
        """Function b ↦ K⁻¹ b for the entries that K has now; RuntimeError when K is singular."""
        lu, to = _splu(self.K, "NATURAL"), self._to

        def solve(b: Array) -> Array:
            y = np.empty(to.size)
            y[to] = b
            x: Array = lu.solve(y)[to]
            return x

        return solve


def _splu(K: Any, order: str) -> Any:
    return splu(K, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class _Layout:
    """K with its blocks in some order.

    Attributes
    ----------
    indptr, indices, slot, diagonal
        As of `_matrix.pattern`, the diagonal blocks by the numbers of the blocks.
    begin : ndarray, shape (blocks,)
        First coordinate of every block in K.
    to : ndarray, shape (n,)
        Where coordinates stand in K.
    """

    def __init__(self, offset: Index, block: Index, order: Index) -> None:
        sizes, place = np.diff(offset), np.empty_like(order)
        place[order] = np.arange(order.size)
        ordered = np.concatenate(([0], np.cumsum(sizes[order])))
        self.indptr, self.indices, self.slot, diagonal = _matrix.pattern(ordered, np.where(block < 0, -1, place[block]))
        self.begin, self.diagonal = ordered[place], diagonal[place]
        self.to = np.repeat(self.begin - offset[:-1], sizes) + np.arange(offset[-1])

    def assemble(self, blocks: Blocks, A: Array, data: Array) -> None:
        """K = M + Σ H_c A_c H_cᵀ, into data."""
        given = self.indptr, self.begin, self.slot, self.diagonal
        _matrix.assemble(blocks.arrays, A, *given, data)


class Factor:
    """Sparse factorisations of K on one contact graph: Cholesky-like where K is symmetric, LU elsewhere."""

    def __init__(self, offset: Index, block: Index) -> None:
        self._graph, n = (offset, block), int(offset[-1])
        self._layout = layout = _Layout(offset, block, np.arange(offset.size - 1))
        self._data = np.empty(layout.indices.size)
        column = np.repeat(np.arange(n), np.diff(layout.indptr))
        self.upper = np.flatnonzero(layout.indices <= column)
        end = np.searchsorted(self.upper, layout.indptr)
        self.U = sp.csc_matrix((np.empty(self.upper.size), layout.indices[self.upper], end), shape=(n, n))
        self.ldl: Any = None

    @cached_property
    def _ordered(self) -> tuple[_Layout, Ordered]:
        offset, block = self._graph
        first, second = block[(block >= 0).all(axis=1)].T
        layout = _Layout(offset, block, elimination_order(offset.size - 1, first, second))
        return layout, Ordered(layout.indptr, layout.indices, layout.to)

    def factor(self, blocks: Blocks, A: Array) -> Callable[[Array], Array]:
        """Function b ↦ K⁻¹ b, until the next on this graph, for K = M + Σ H_c A_c H_cᵀ; RuntimeError when singular."""
        if not _matrix.symmetric(A):
            layout, matrix = self._ordered
            # The rows of Kᵀ are the columns of K.
            layout.assemble(blocks, np.ascontiguousarray(A.transpose(0, 2, 1)), matrix.K.data)
            return matrix.factor()
        self._layout.assemble(blocks, A, self._data)
        # QDLDL wants the upper triangle; to have it cut out by SciPy costs as much as the factorisation.
        np.take(self._data, self.upper, out=self.U.data)
        if self.ldl is None:
            self.ldl = qdldl.Solver(self.U, upper=True)
        else:
            self.ldl.update(self.U, upper=True)
        return self.ldl.solve  # type: ignore[no-any-return]


@lru_cache(maxsize=16)
def _factor(thread: int, offset: bytes, block: bytes) -> Factor:
    """One `Factor` per contact graph, so that the symbolic part lives as long as the graph, for each thread its own."""
    return Factor(np.frombuffer(offset, np.int64), np.frombuffer(block, np.int64).reshape(-1, 2))


def contact_graph(blocks: Blocks) -> Factor:
    """The factorisations on the contact graph of some blocks."""
    return _factor(get_ident(), blocks.offset.tobytes(), blocks.block.tobytes())


def forget() -> None:
    """Forget all contact graphs: what is timed next finds nothing prepared."""
    _factor.cache_clear()
