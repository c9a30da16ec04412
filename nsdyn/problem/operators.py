"""W as methods need it that factorise (I + A W): given by its factors, or as a sparse matrix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from nsdyn.problem.blocks import Blocks
from nsdyn.problem.linear import Ordered, contact_graph, elimination_order
from nsdyn.tools.arrays import Array

__all__ = ["Local", "Operator", "Velocity"]


class Operator(Protocol):
    """W as the method needs it: products, and W (I + A W)⁻¹ for block-diagonal A."""

    def product(self, r: Array) -> Array:
        """W r."""

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Function g ↦ W (I + A W)⁻¹ g for blocks A (nc, 3, 3); RuntimeError when that is singular."""


class Velocity:
    """W = Hᵀ M⁻¹ H by its factors: W (I + A W)⁻¹ = Hᵀ (M + Σ H_c A_c H_cᵀ)⁻¹ H."""

    def __init__(self, blocks: Blocks) -> None:
        self.blocks, self.graph = blocks, contact_graph(blocks)

    def product(self, r: Array) -> Array:
        """W r."""
        return self.blocks.relative_velocity(self.blocks.velocity_change(r))

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Function g ↦ W (I + A W)⁻¹ g."""
        solve = self.graph.lu(self.blocks, A)
        return lambda g: self.blocks.relative_velocity(solve(self.blocks.momentum(g)))


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
