"""W as methods need it that factorise (I + A W): given by its factors, or as a sparse matrix."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from nsdyn.problem.blocks import Blocks
from nsdyn.problem.linear import Lu, contact_graph
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
        numbered = sp.csc_matrix(sp.bsr_array((np.arange(W.data.size).reshape(W.data.shape), W.indices, W.indptr)))
        self._take, self._lu = numbered.data, Lu(numbered.indptr, numbered.indices)

    def product(self, r: Array) -> Array:
        """W r."""
        return np.asarray(self.W @ r)

    def factor(self, A: Array) -> Callable[[Array], Array]:
        """Function g ↦ W (I + A W)⁻¹ g."""
        data = A[self.row] @ self.W.data
        data[self.diagonal] += np.eye(3)
        solve = self._lu(data.reshape(-1)[self._take])
        return lambda g: self.product(solve(g))
