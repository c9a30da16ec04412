"""Direct solves of the regions where sweeps over a large problem are stuck.

Sweeps bring most of a pile to the tolerance and then circle in a few places, each a handful of bodies with
contacts that open and slip in turn. Such a place with what surrounds it is a small problem of its own, the impulses
elsewhere frozen: a block of a block Gauss–Seidel method, chosen where it is needed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels import cones as _cones
from nsdyn._kernels import newton as _newton
from nsdyn.problem import FC3D, Array, Blocks
from nsdyn.solvers.newton import rows

__all__ = ["mend"]

SEEDS, SHARE = 40, 0.1
"""A region grows from at most so many contacts, those whose residual is at least this fraction of the largest."""

REACH, LARGEST = 3, 600
"""Rings of neighbours around them, as long as the region has at most so many contacts."""

Direct = Callable[[Blocks, Array, Array, Array, Array], tuple[Array, int]]


def _region(blocks: Blocks, residual: Array) -> NDArray[np.bool_]:
    """The worst contacts and the rings of contacts around them, mask of shape (nc,)."""
    worst = np.argsort(-residual, kind="stable")[:SEEDS]
    inside = np.zeros(blocks.nc, np.bool_)
    inside[worst[residual[worst] >= SHARE * residual[worst[0]]]] = True
    near = np.zeros(blocks.offset.size, np.bool_)
    for _ in range(REACH):
        near[blocks.block[inside]] = True
        near[-1] = False  # where -1, the world, points
        wider = np.asarray(near[blocks.block].any(axis=1))
        if np.count_nonzero(wider) > LARGEST:
            break
        inside = wider
    return inside


def mend(problem: FC3D, r: Array, tol: float, direct: Direct) -> int:
    """Solve the region around the largest residuals, the other impulses frozen, in place of r.

    Parameters
    ----------
    problem : FC3D
        Given by factors.
    r : ndarray, shape (3 nc,)
        Impulses, N·s.
    tol : float
        Nothing is done where the residual is within it, m/s.
    direct : callable
        ``direct(blocks, q, mu, scales, r)`` solves a small problem: (impulses, iterations).

    Returns
    -------
    int
        Iterations, 0 if nothing was done, as where the region is most of the problem.
    """
    blocks = problem.blocks
    assert blocks is not None
    u, residual = problem.velocity(r), np.empty(problem.nc)
    _cones.natural_residuals(problem.scales, u, r, problem.mu, residual)
    inside = _region(blocks, residual)
    if residual.max() <= tol or 2 * np.count_nonzero(inside) > problem.nc:
        return 0
    contacts, *parts = _newton.extract(
        blocks.offset, blocks.block, blocks.start, blocks.h, blocks.m_start, blocks.m, blocks.minv,
        inside.astype(np.int64), 1,
    )  # fmt: skip
    part, i = Blocks(*parts), rows(contacts, problem.nc)
    q = u[i] - part.relative_velocity(part.velocity_change(r[i]))
    r[i], count = direct(part, q, problem.mu[contacts], problem.scales[contacts], r[i])
    return count
