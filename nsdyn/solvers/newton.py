"""Semismooth Newton in the proximal method of multipliers, for velocities or for impulses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import local as _local
from nsdyn._kernels.solvers import newton as _kernels
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.linear import contact_graph
from nsdyn.problem.operators import Operator
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array, Index

__all__ = ["Newton", "by_islands", "island", "rows", "solve_blocks", "solve_impulses"]

DENSE = 120
"""Islands up to this many coordinates are factorised densely: below it LAPACK in the kernel beats a sparse call."""

PART, DIVERGED, SHRINKAGE = 1e-2, 10.0, 0.3
"""Large islands settle earlier than in the kernels, which may have to reach round-off: what the square of the defect is
of that of the multiplier step then, its growth in one step from which on a penalty is called too large at once, and
what is left of such a penalty. A fifth fewer steps, and more walls solved to 1e-8."""


class Unknown(Protocol):
    """What Newton's method solves for at an estimate of the impulse.

    Attributes
    ----------
    u : ndarray, shape (3 nc,)
        Relative velocity of the unknown, m/s.
    """

    u: Array

    def restart(self, r: Array) -> None:
        """Take the unknown of an impulse."""

    def measure(self, r: Array) -> float:
        """Larger of the literature's error and the residual in m/s of an impulse."""

    def step(self, A: Array, P: Array) -> None:
        """Newton's step towards the fixed point of P(u), A = -dP/du; RuntimeError where its matrix is singular."""

    def settled(self, P: Array, estimate: Array) -> tuple[bool, float]:
        """Whether the defect is small beside the step P - estimate, and its square, J; P was the last measured."""

    def keep(self) -> None:
        """Remember the unknown as it is."""

    def back(self) -> None:
        """Take what was remembered."""


class Velocities:
    """The velocity change y = M⁻¹ H r, by sparse factorisations as large as the coordinates."""

    def __init__(self, blocks: Blocks, q: Array, mu: Array, scales: Array, q_norm: float) -> None:
        self._blocks, self._graph = blocks, contact_graph(blocks)
        self._q, self._scales, self._judge = q, scales, (q, mu, scales, q_norm)
        self.u, self._own_u = np.empty((2, q.size))
        self._y, self._own_y, self._last, self._F, self._work = np.empty((5, blocks.n))

    def restart(self, r: Array) -> None:
        """Take the velocity change of an impulse."""
        _kernels.velocity_of(self._blocks.arrays, self._q, r, self._y, self.u, self._work)

    def measure(self, r: Array) -> float:
        """As `Unknown.measure`."""
        own = self._own_y, self._own_u, self._work
        return float(_kernels.measure_of(self._blocks.arrays, *self._judge, r, *own))

    def step(self, A: Array, P: Array) -> None:
        """(M + Σ H_c A_c H_cᵀ) dy = H P - M y."""
        _kernels.defect(self._blocks.arrays, self._y, P, self._F, self._work)
        self._y -= self._graph.solve(self._blocks, A, self._F)
        self._move()

    def _move(self) -> None:
        """u = Hᵀ y + q."""
        _blocks.relative_velocity(self._blocks.arrays, self._y, self.u)
        self.u += self._q

    def settled(self, P: Array, estimate: Array) -> tuple[bool, float]:
        """As `Unknown.settled`."""
        given = self._scales, self._y, P, estimate, PART
        done, left = _kernels.settled(self._blocks.arrays, *given, self._F, self._work, self._own_u)
        return bool(done), float(left)

    def keep(self) -> None:
        """As `Unknown.keep`."""
        self._last[:] = self._y

    def back(self) -> None:
        """As `Unknown.back`."""
        self._y[:] = self._last
        self._move()


class Impulses:
    """An impulse x, with any W: it need not be symmetric."""

    def __init__(self, W: Operator, q: Array, mu: Array, scales: Array, q_norm: float) -> None:
        self._W, self._q, self._mu, self._scales, self._q_norm = W, q, mu, scales, q_norm
        self.u = self._own = self._x = q
        self._last = q, q

    def restart(self, r: Array) -> None:
        """Take an impulse."""
        self._x = r.copy()
        self.u = self._W.product(self._x) + self._q

    def measure(self, r: Array) -> float:
        """As `Unknown.measure`."""
        self._own = u = self._W.product(r) + self._q
        return float(_cones.measure_at(self._scales, u, r, self._mu, self._q_norm))

    def step(self, A: Array, P: Array) -> None:
        """(I + A W) dx = P - x, by dx = P - x - A du."""
        du = self._W.factor(A)(P - self._x)
        self._x = P - (A @ du.reshape(-1, 3, 1)).ravel()
        self.u = self._W.product(self._x) + self._q

    def settled(self, P: Array, estimate: Array) -> tuple[bool, float]:
        """As `Unknown.settled`."""
        step = P - estimate
        done, left = _local.settled(self.u - self._own, self._x - P, self._W.product(step), step, PART, self._scales)
        return bool(done), float(left)

    def keep(self) -> None:
        """As `Unknown.keep`."""
        self._last = self._x, self.u

    def back(self) -> None:
        """As `Unknown.back`."""
        self._x, self.u = self._last


def _multipliers(
    x: Unknown, mu: Array, scales: Array, r: Array, tol: float, penalty: float, max_iter: int
) -> tuple[int, float]:
    """The method of `_kernels.newton.dense` for any unknown, in place of r: (factorisations, measure).

    A failure goes back to where F had settled last, which is nearer than the velocity of the estimate.
    """
    P, A = np.empty_like(r), np.empty((mu.size, 3, 3))
    x.restart(r)
    x.keep()
    best = x.measure(r)
    estimate, rho = r.copy(), penalty / scales
    count, inner, before = 0, 0, np.inf
    _kernels.projected(x.u, estimate, rho, mu, P)
    while best > tol and count < max_iter and penalty > 1e-3:
        _kernels.stiffness(x.u, estimate, rho, mu, A)
        try:
            x.step(A, P)
        except RuntimeError:
            break
        count, inner = count + 1, inner + 1
        _kernels.projected(x.u, estimate, rho, mu, P)
        now = x.measure(P)
        if now < best:
            best = now
            r[:] = P
        done, left = x.settled(P, estimate)
        if done:
            penalty = _kernels.grown(penalty, inner)
            estimate[:] = P
            x.keep()
        elif inner >= _kernels.PATIENCE or not left <= DIVERGED * before:
            penalty *= SHRINKAGE
            x.back()
        else:
            before = left
            continue
        inner, before = 0, np.inf
        rho = penalty / scales
        _kernels.projected(x.u, estimate, rho, mu, P)
    return count, best


def island(blocks: Blocks, label: Index, k: int) -> tuple[Any, Blocks]:
    """(contacts, blocks) of island k; contacts is a slice when it is all there is."""
    if not label.any() and np.unique(blocks.block[blocks.block >= 0]).size == blocks.offset.size - 1:
        return slice(None), blocks
    contacts, part = _kernels.extract(blocks.arrays, label, k)
    return contacts, Blocks(*part)


def rows(contacts: Any, nc: int) -> Any:
    """Rows of the 3 nc vectors that belong to some contacts."""
    if isinstance(contacts, slice):
        return slice(None)
    return (3 * contacts[:, None] + np.arange(3)).ravel()


def by_islands(
    problem: FC3D,
    blocks: Blocks,
    r: Array,
    tol: float,
    solve: Callable[[Blocks, Array, Array, Array, Array, float], int],
) -> int:
    """Solve every island of a problem by itself, in place of r: iterations of all.

    `solve` takes an island's blocks, q, mu, scales, impulse to improve in place, and its share of the tolerance: half
    of it over the root of their number, for the judge measures all together and, where W was given, with W itself.
    """
    label, count = np.empty(problem.nc, np.int64), 0
    found = _blocks.islands(blocks.block, blocks.offset.size - 1, label)
    for k in range(found):
        contacts, part = island(blocks, label, k)
        i = rows(contacts, problem.nc)
        x = r[i].copy()
        given = problem.q[i], problem.mu[contacts], problem.scales[contacts]
        count += solve(part, *given, x, 0.5 * tol / np.sqrt(found))
        r[i] = x
    return count


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
    return _multipliers(Velocities(blocks, q, mu, scales, q_norm), mu, scales, r, tol, penalty, max_iter)


def solve_impulses(
    W: Operator,
    q: Array,
    mu: Array,
    scales: Array,
    r: Array,
    tol: float,
    q_norm: float,
    penalty: float,
    max_iter: int,
) -> tuple[int, float]:
    """Newton on one connected problem with any W, in place of r; (factorisations, measure)."""
    return _multipliers(Impulses(W, q, mu, scales, q_norm), mu, scales, r, tol, penalty, max_iter)


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
        start = clock()
        r = np.zeros_like(problem.q) if r0 is None else np.array(r0, dtype=float)
        count = 0
        if problem.nc and not problem.solved(r, self.tol)[0]:
            blocks = problem.blocks or Blocks.from_delassus(problem.W)
            q_norm = problem.q_norm

            def solve(part: Blocks, q: Array, mu: Array, scales: Array, x: Array, tol: float) -> int:
                return solve_blocks(part, q, mu, scales, x, tol, q_norm, self.penalty, self.max_iter)[0]

            count = by_islands(problem, blocks, r, self.tol, solve)
        return Solution.judge(problem, r, self.tol, count, clock() - start, Status.MAX_ITERATIONS)
