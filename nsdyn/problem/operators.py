"""W = Hᵀ M⁻¹ H as methods need it that factorise (I + A W): given by its factors, or as a sparse matrix.

A (nc, 3, 3) is block-diagonal; RuntimeError where I + A W is singular. The velocity change y = M⁻¹ H r of an impulse
has its own coordinates; those of a W given alone are relative velocities, with H = I.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.linear import Ordered, contact_graph, elimination_order
from nsdyn.tools.arrays import Array

if TYPE_CHECKING:
    from nsdyn.problem.fc3d import FC3D

__all__ = ["Local", "Operator", "Velocity", "operator"]


class Velocity:
    """W by its factors: W (I + A W)⁻¹ = Hᵀ (M + Σ H_c A_c H_cᵀ)⁻¹ H."""

    def __init__(self, blocks: Blocks) -> None:
        self.blocks, self.graph = blocks, contact_graph(blocks)
        self.change, self.relative = blocks.velocity_change, blocks.relative_velocity  # y = M⁻¹ H r, and Hᵀ y

    def product(self, r: Array) -> Array:
        """W r."""
        return self.relative(self.change(r))

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Function g ↦ W (I + A W)⁻¹ g."""
        solve = self.graph.factor(self.blocks, A)
        return lambda g: self.relative(solve(self.blocks.momentum(g)))

    def towards(self, A: Array, P: Array, y: Array) -> Array:
        """The dy of (I + M⁻¹ Σ H_c A_c H_cᵀ) dy = M⁻¹ H P - y."""
        missing = np.empty_like(y)
        _blocks.block_product(self.blocks.offset, self.blocks.m_start, self.blocks.m, y, missing)
        return self.graph.factor(self.blocks, A)(self.blocks.momentum(P) - missing)


class Local:
    """A given sparse W, which need not be symmetric."""

    def __init__(self, W: sp.bsr_array) -> None:
        self.W = W
        self.row = np.repeat(np.arange(W.shape[0] // 3), np.diff(W.indptr))
        self.diagonal = np.flatnonzero(self.row == W.indices)
        count, blocks = W.shape[0] // 3, np.arange(W.data.size).reshape(W.data.shape)
        order = elimination_order(count, self.row, W.indices)
        number = sp.csr_array((np.arange(self.row.size), W.indices, W.indptr), shape=(count, count))[order][:, order]
        # Where the entries of the matrix in that order are among those of W.
        entry = sp.csc_matrix(sp.bsr_array((blocks[number.data], number.indices, number.indptr), shape=W.shape))
        entry.sort_indices()
        to = np.empty((count, 3), np.int64)
        to[order] = np.arange(3 * count).reshape(-1, 3)
        self._entry, self._ordered = entry.data, Ordered(entry.indptr, entry.indices, to.ravel())

    def product(self, r: Array) -> Array:
        """W r."""
        return np.asarray(self.W @ r)

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Function g ↦ W (I + A W)⁻¹ g."""
        data = A[self.row] @ self.W.data
        data[self.diagonal] += np.eye(3)
        np.take(data, self._entry, out=self._ordered.K.data)
        solve = self._ordered.factor()
        return lambda g: self.product(solve(g))

    def change(self, r: Array) -> Array:
        """Velocity change y = W r."""
        return self.product(r)

    def relative(self, y: Array) -> Array:
        """The y itself."""
        return y

    def towards(self, A: Array, P: Array, y: Array) -> Array:
        """The dy of (I + W A) dy = W P - y."""
        # (I + W A)⁻¹ d = d - W (I + A W)⁻¹ A d
        d = self.product(P) - y
        out: Array = d - self.factor(A)((A @ d.reshape(-1, 3, 1)).ravel())
        return out


Operator = Velocity | Local


def operator(problem: FC3D) -> Operator:
    """W of a problem, by its factors where they are given."""
    return Local(problem.W) if problem.blocks is None else Velocity(problem.blocks)
