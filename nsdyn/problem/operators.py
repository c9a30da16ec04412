"""W = Hᵀ M⁻¹ H for methods that factorise (I + A W): given by its factors, or as a sparse matrix.

A (nc, 3, 3) is block-diagonal; RuntimeError where I + A W is singular. With factors, the velocity change y = M⁻¹ H r of
an impulse is in the coordinates of the bodies; with W given alone it is a relative velocity, with H = I.

With factors, the matrix is that of the bodies, K = M + Σ H_c A_c H_cᵀ. It has the size of the coordinates and the
sparsity of the contact graph, which stays the same over many solves.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from threading import get_ident
from typing import TYPE_CHECKING, Any

import numpy as np
import qdldl
import scipy.sparse as sp
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse.linalg import splu

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem import sparse as _matrix
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.problem.fc3d import FC3D


def elimination_order(count: int, rows: Index, columns: Index) -> Index:
    """Return the order of minimum degree for a symmetric pattern: the blocks as they are eliminated, shape (count,).

    The k pairs of coupled blocks are in `rows` and `columns`, in one triangle or both. Ordering blocks takes a fraction
    of the time of ordering their coordinates. A pattern is ordered once for many matrices.

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
    """LU factorisations of matrices K with rows and columns in elimination order and pivots on the diagonal.

    Parameters
    ----------
    indptr, indices : ndarray, shapes (n + 1,), (entries,)
        Pattern of K by columns.
    to : ndarray, shape (n,)
        Position of each coordinate in K.
    """

    def __init__(self, indptr: Index, indices: Index, to: Index) -> None:
        self.K = sp.csc_matrix((np.empty(indices.size), indices, indptr), shape=(to.size, to.size))
        self._to = to

    def factor(self) -> Callable[[Array], Array]:
        """Return the function b ↦ K⁻¹ b for the present entries of K; RuntimeError when K is singular."""
        return self.solving(_splu(self.K, "NATURAL").solve)

    def solving(self, inverse: Callable[[Array], Array]) -> Callable[[Array], Array]:
        """Return the function b ↦ K⁻¹ b from the inverse in elimination order."""

        def solve(b: Array) -> Array:
            y = np.empty(b.size)
            y[self._to] = b
            return inverse(y)[self._to]

        return solve


def _splu(K: Any, order: str) -> Any:
    return splu(K, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class Factor:
    """Factorisations of K on one contact graph: LDLᵀ where K is symmetric, which keeps its symbolic part, else LU."""

    def __init__(self, offset: Index, block: Index) -> None:
        sizes = np.diff(offset)
        order = elimination_order(sizes.size, *block[(block >= 0).all(axis=1)].T)
        place = np.argsort(order)
        ordered = np.concatenate(([0], np.cumsum(sizes[order])))
        indptr, indices, self._slot, diagonal = pattern(ordered, np.where(block < 0, -1, place[block]))
        self._begin, self._diagonal = ordered[place], diagonal[place]
        self._ordered = Ordered(indptr, indices, np.repeat(self._begin - offset[:-1], sizes) + np.arange(offset[-1]))
        column = np.repeat(np.arange(offset[-1]), np.diff(indptr))
        self._upper = np.flatnonzero(indices <= column)
        end = np.searchsorted(self._upper, indptr)
        self._U = sp.csc_matrix((np.empty(self._upper.size), indices[self._upper], end), shape=self._ordered.K.shape)
        self._ldl: Any = None

    def factor(self, blocks: DelassusFactors, A: Array) -> Callable[[Array], Array]:
        """Return the function b ↦ K⁻¹ b for K = M + Σ H_c A_c H_cᵀ; RuntimeError when K is singular.

        It is valid until the next factorisation on this graph.
        """
        K = self._ordered.K
        turned = np.ascontiguousarray(A.transpose(0, 2, 1))  # the rows of Kᵀ are the columns of K
        _matrix.assemble(blocks.arrays, turned, K.indptr, self._begin, self._slot, self._diagonal, K.data)
        if not np.array_equal(A, turned):
            return self._ordered.factor()
        # QDLDL needs the upper triangle. Extracting it by SciPy costs as much as the factorisation.
        np.take(K.data, self._upper, out=self._U.data)
        if self._ldl is None:
            self._ldl = qdldl.Solver(self._U, upper=True)
        else:
            self._ldl.update(self._U, upper=True)
        return self._ordered.solving(self._ldl.solve)


def pattern(offset: Index, block: Index) -> tuple[Index, Index, Index, Index]:
    """Return the sparsity of K in compressed rows: (indptr, indices, slot, diagonal).

    Entry (i, j) of the coupling of block[c, s] (rows) with block[c, t] (columns) is stored at indptr[offset[block[c,
    s]] + i] + slot[c, t, s] + j; of a diagonal block k at indptr[offset[k] + i] + diagonal[k] + j.
    """
    sizes, count = np.diff(offset), offset.size - 1
    first, second = block[(block >= 0).all(axis=1)].T
    own = np.arange(count) * (count + 1)
    codes = np.unique(np.concatenate((own, first * count + second, second * count + first)))
    row, column = np.divmod(codes, count)  # of blocks
    width = sizes[column]
    before = np.cumsum(width) - width
    begin = before[np.searchsorted(row, np.arange(count))]
    place, height = before - begin[row], np.bincount(row, width, count).astype(np.int64)
    of_coordinates = np.repeat(height, sizes)
    indptr = np.concatenate(([0], np.cumsum(of_coordinates)))
    columns = np.repeat(offset[column] - before, width) + np.arange(width.sum())  # of the first row of each block
    indices = columns[np.repeat(np.repeat(begin, sizes) - indptr[:-1], of_coordinates) + np.arange(indptr[-1])]
    both = (block[:, :, None] >= 0) & (block[:, None, :] >= 0)
    slot = np.full(both.shape, -1, np.int64)
    slot[both] = place[np.searchsorted(codes, (block[:, None, :] * count + block[:, :, None])[both])]
    return indptr.astype(np.int32), indices.astype(np.int32), slot, place[np.searchsorted(codes, own)]


@lru_cache(maxsize=16)
def _factor(thread: int, offset: bytes, block: bytes) -> Factor:
    """Return the `Factor` of a contact graph, one per thread, cached so that its symbolic part lives with the graph."""
    return Factor(np.frombuffer(offset, np.int64), np.frombuffer(block, np.int64).reshape(-1, 2))


def forget() -> None:
    """Clear the cache of contact graphs, so that a timing begins with nothing prepared."""
    _factor.cache_clear()


class Velocity:
    """W given by its factors: W (I + A W)⁻¹ = Hᵀ (M + Σ H_c A_c H_cᵀ)⁻¹ H."""

    def __init__(self, blocks: DelassusFactors) -> None:
        self.blocks, self.graph = blocks, _factor(get_ident(), blocks.offset.tobytes(), blocks.block.tobytes())
        # y = M⁻¹ H r, Hᵀ y and W r
        self.change, self.relative, self.product = blocks.velocity_change, blocks.relative_velocity, blocks.product

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Return the function g ↦ W (I + A W)⁻¹ g."""
        solve = self.graph.factor(self.blocks, A)
        return lambda g: self.relative(solve(self.blocks.momentum(g)))

    def towards(self, A: Array, P: Array, y: Array) -> Array:
        """Return the dy of (I + M⁻¹ Σ H_c A_c H_cᵀ) dy = M⁻¹ H P - y."""
        missing = np.empty_like(y)
        _blocks.block_product(self.blocks.offset, self.blocks.m_start, self.blocks.m, y, missing)
        return self.graph.factor(self.blocks, A)(self.blocks.momentum(P) - missing)


def dense(K: Array) -> Callable[[Array], Array]:
    """Return the function b ↦ K⁻¹ b; RuntimeError when K is singular."""
    lu, pivots, bad = dgetrf(K)
    if bad:
        raise RuntimeError("the matrix is singular")
    return lambda b: np.asarray(dgetrs(lu, pivots, b)[0])


class Local:
    """W given as a sparse matrix, which need not be symmetric. LAPACK factorises it where all contacts are coupled."""

    def __init__(self, W: sp.bsr_array) -> None:
        self.W = W
        self.row = np.repeat(np.arange(W.shape[0] // 3), np.diff(W.indptr))
        self.diagonal = np.flatnonzero(self.row == W.indices)
        count, blocks = W.shape[0] // 3, np.arange(W.data.size).reshape(W.data.shape)
        self._ordered: Ordered | None = None
        if self.row.size == count * count:
            return
        order = elimination_order(count, self.row, W.indices)
        number = sp.csr_array((np.arange(self.row.size), W.indices, W.indptr), shape=(count, count))[order][:, order]
        # Indices, among the entries of W, of the entries of the matrix in that order.
        entry = sp.csc_matrix(sp.bsr_array((blocks[number.data], number.indices, number.indptr), shape=W.shape))
        entry.sort_indices()
        to = np.empty((count, 3), np.int64)
        to[order] = np.arange(3 * count).reshape(-1, 3)
        self._entry, self._ordered = entry.data, Ordered(entry.indptr, entry.indices, to.ravel())

    def product(self, r: Array) -> Array:
        """Return W r."""
        return np.asarray(self.W @ r)

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Return the function g ↦ W (I + A W)⁻¹ g."""
        data = A[self.row] @ self.W.data
        data[self.diagonal] += np.eye(3)
        if self._ordered is None:
            solve = dense(data.reshape(A.shape[0], -1, 3, 3).swapaxes(1, 2).reshape(self.W.shape))
        else:
            np.take(data, self._entry, out=self._ordered.K.data)
            solve = self._ordered.factor()
        return lambda g: self.product(solve(g))

    def change(self, r: Array) -> Array:
        """Return the velocity change y = W r."""
        return self.product(r)

    def relative(self, y: Array) -> Array:
        """Return y itself."""
        return y

    def towards(self, A: Array, P: Array, y: Array) -> Array:
        """Return the dy of (I + W A) dy = W P - y."""
        # (I + W A)⁻¹ d = d - W (I + A W)⁻¹ A d
        d = self.product(P) - y
        return d - self.factor(A)((A @ d.reshape(-1, 3, 1)).ravel())


Operator = Velocity | Local


def operator(problem: FC3D) -> Operator:
    """Return W of a problem in terms of its factors, or as a matrix if they are not given."""
    return Local(problem.W) if problem.blocks is None else Velocity(problem.blocks)
