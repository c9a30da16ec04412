"""Semismooth Newton in velocity space."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.solvers import newton as _kernels
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.linear import contact_graph
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array, Index

__all__ = ["Newton", "each_island", "island", "rows", "solve_blocks"]

DENSE = 120
"""Islands up to this many coordinates are factorised densely: below it LAPACK in the kernel beats a sparse call."""


def _sparse(
    blocks: Blocks,
    q: Array,
    mu: Array,
    scales: Array,
    r: Array,
    tol: float,
    q_norm: float,
    penalty: float,
    max_iter: int,
) -> tuple[int, float]:
    """The method of `_kernels.newton.dense` with sparse factorisations, in place of r."""
    n, nr = blocks.n, q.size
    factors, graph = blocks.arrays, contact_graph(blocks)
    y, u, F, work = np.empty(n), np.empty(nr), np.empty(n), np.empty(n)
    P, own_y, own_u, A = np.empty(nr), np.empty(n), np.empty(nr), np.empty((mu.size, 3, 3))
    best = float(_kernels.measure_of(factors, q, mu, scales, q_norm, r, y, u, work))
    estimate, rho = r.copy(), penalty / scales
    count = inner = 0
    _kernels.projected(u, estimate, rho, mu, P)
    while best > tol and count < max_iter and penalty > 1e-3:
        _kernels.defect(factors, y, P, F, work)
        _kernels.stiffness(u, estimate, rho, mu, A)
        y -= graph.solve(blocks, A, F)
        count, inner = count + 1, inner + 1
        _blocks.relative_velocity(factors, y, u)
        u += q
        _kernels.projected(u, estimate, rho, mu, P)
        new = float(_kernels.measure_of(factors, q, mu, scales, q_norm, P, own_y, own_u, work))
        if new < best:
            best = new
            r[:] = P
        if _kernels.settled(factors, scales, y, P, estimate, F, work):
            penalty = _kernels.grown(penalty, inner)
            estimate[:] = P
            inner = 0
        elif inner >= _kernels.PATIENCE:
            penalty *= 0.1
            inner = 0
            _kernels.velocity_of(factors, q, estimate, y, u, work)
        else:
            continue
        rho = penalty / scales
        _kernels.projected(u, estimate, rho, mu, P)
    return count, best


def island(blocks: Blocks, label: Index, k: int) -> tuple[Any, Blocks]:
    """(contacts, blocks) of island k; contacts is a slice when it is all there is."""
    if not label.any() and np.unique(blocks.block[blocks.block >= 0]).size == blocks.offset.size - 1:
        return slice(None), blocks
    contacts, part = _kernels.extract(blocks.arrays, label, k)
    return contacts, Blocks(*part)


def each_island(blocks: Blocks) -> list[tuple[Any, Blocks]]:
    """(contacts, blocks) of every island."""
    label = np.empty(blocks.nc, np.int64)
    found = _blocks.islands(blocks.block, blocks.offset.size - 1, label)
    return [island(blocks, label, k) for k in range(found)]


def rows(contacts: Any, nc: int) -> Any:
    """Rows of the 3 nc vectors that belong to some contacts."""
    if isinstance(contacts, slice):
        return slice(None)
    return (3 * contacts[:, None] + np.arange(3)).ravel()


def solve_blocks(
    blocks: Blocks,
    q: Array,
    mu: Array,
    scales: Array,
    r: Array,
    tol: float,
    q_norm: float,
    penalty: float,
    max_iter: int,
) -> tuple[int, float]:
    """Newton on one connected problem, dense or sparse by its size, in place of r; (factorisations, measure)."""
    if blocks.n <= DENSE:
        count, best = _kernels.dense(blocks.arrays, q, mu, scales, r, tol, q_norm, penalty, max_iter)
        return int(count), float(best)
    return _sparse(blocks, q, mu, scales, r, tol, q_norm, penalty, max_iter)


@dataclass(frozen=True)
class Newton:
    """Semismooth Newton on the augmented Lagrangian of the velocity problem, island by island.

    Good near the solution: quadratic, immune to mass ratios, and a rank-deficient W is no obstacle since the matrix
    M + Σ H_c A_c H_cᵀ is as large as the coordinates. It fails from a cold start when many contacts change their
    state at once: `auto` finds the states first.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    penalty : float
        First penalty times λ_max(W_cc); it adapts.
    max_iter : int
        Factorisations per island.

    References
    ----------
    P. Alart, A. Curnier, A mixed formulation for frictional contact problems prone to Newton like solution methods,
    CMAME 92, 1991. V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction, 2018.
    """

    tol: float = 1e-8
    penalty: float = 10.0
    max_iter: int = 200

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from r0 (default 0)."""
        start = time.perf_counter()
        r = np.zeros_like(problem.q) if r0 is None else np.array(r0, dtype=float)
        count = 0
        if problem.nc and not problem.solved(r, self.tol)[0]:
            blocks = problem.blocks or Blocks.from_delassus(problem.W)
            q_norm = problem.q_norm
            # Half the tolerance: the judge measures the islands together and, for a given W, with W itself.
            for contacts, part in each_island(blocks):
                i = rows(contacts, problem.nc)
                x = r[i].copy()
                tol = 0.5 * self.tol
                count += solve_blocks(
                    part, problem.q[i], problem.mu[contacts], problem.scales[contacts], x, tol, q_norm,
                    self.penalty, self.max_iter,
                )[0]  # fmt: skip
                r[i] = x
        return Solution.judge(problem, r, self.tol, count, time.perf_counter() - start, Status.MAX_ITERATIONS)
