"""One connected problem and the means to solve it, alike for a problem given by factors and for one given by W."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from nsdyn._kernels.problem import sparse as _matrix
from nsdyn._kernels.solvers import pgs as _pgs
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Local, Operator, Velocity
from nsdyn.solvers.nesterov import MatrixSweeps, Sweeps
from nsdyn.solvers.newton import solve_blocks, solve_impulses
from nsdyn.tools.arrays import Array, Index

COORDINATE, ROW, ROOT, BLOCK = 6e-7, 2.5e-7, 1.4e-7, 6e-7
"""Seconds that a factorisation takes per coordinate, per contact, and per root of `elimination_work`, with which the
work in a better order grows, or per block of a given W: measured, 0.8 to 1.8 times as much from 60 to 4900 contacts."""

CONTACT, COUPLING, ACCELERATED = 22e-9, 12e-9, 3e-7
"""Seconds that a sweep with momentum takes per contact of free bodies and per block of W, and an accelerated one per
contact: measured."""


class Interruptible(Protocol):
    """Sweeps with momentum that may be interrupted: `nesterov.Sweeps`."""

    count: int
    best: float

    def run(self, tol: float, most: int, patience: int) -> bool:
        """Go on; whether it is worth going on."""


class Means(Protocol):
    """A connected problem and ways to solve it, all in place of an impulse r, returning (iterations, measure of r).

    Attributes
    ----------
    problem : FC3D
    factorisation, sweep, accelerated_sweep : float
        Seconds they take, by counts of operations: the same whatever the machine is busy with.
    """

    problem: FC3D
    factorisation: float
    sweep: float
    accelerated_sweep: float

    @property
    def operator(self) -> Operator:
        """W for `interior` and `continuation`."""

    def accelerated(self, r: Array, tol: float, most: int, patience: int) -> tuple[int, float]:
        """Accelerated Gauss–Seidel."""

    def nesterov(self, r: Array) -> Interruptible:
        """Sweeps with momentum from r, the best into r."""

    def newton(self, r: Array, tol: float, penalty: float, most: int) -> tuple[int, float]:
        """Semismooth Newton of at most so many factorisations."""


def _accelerated(
    W: Any, q: Array, mu: Array, scales: Array, r: Array, tol: float, q_norm: float, most: int, patience: int
) -> tuple[int, float]:
    """Accelerated Gauss–Seidel in place of r, W a `Matrix` or `Factors`: (sweeps, measure)."""
    used, best = _pgs.accelerated(W, q, mu, scales, r, tol, q_norm, most, 5, min(20, mu.size + 1), patience)
    return int(used), float(best)


class ByFactors:
    """Means for a problem given by factors."""

    def __init__(self, blocks: Blocks, q: Array, mu: Array, scales: Array) -> None:
        self.blocks, self.problem = blocks, FC3D.from_blocks(blocks, q, mu, scales)
        self._given = q, mu, scales
        work = float(_matrix.elimination_work(blocks.offset, blocks.block))
        self.factorisation = COORDINATE * blocks.n + ROW * blocks.nc + ROOT * math.sqrt(work)
        self.free = bool((np.diff(blocks.offset) == 6).all())
        self.sweep = CONTACT * blocks.nc if self.free else COUPLING * self.problem.csr[1].size
        self.accelerated_sweep = ACCELERATED * blocks.nc

    @cached_property
    def operator(self) -> Operator:
        """W for `interior` and `continuation`, whose pattern is found only where it is factorised."""
        return Velocity(self.blocks)

    def accelerated(self, r: Array, tol: float, most: int, patience: int) -> tuple[int, float]:
        """Accelerated Gauss–Seidel."""
        return _accelerated(_pgs.factors(self.blocks.arrays), *self._given, r, tol, self.problem.q_norm, most, patience)

    def nesterov(self, r: Array) -> Interruptible:
        """Sweeps with momentum from r, the best into r."""
        if self.free:
            return Sweeps(self.blocks, *self._given, r, self.problem.q_norm)
        return MatrixSweeps(self.problem.csr, *self._given, r, self.problem.q_norm)

    def newton(self, r: Array, tol: float, penalty: float, most: int) -> tuple[int, float]:
        """Semismooth Newton of at most so many factorisations."""
        return solve_blocks(self.blocks, *self._given, r, tol, self.problem.q_norm, penalty, most)


class ByMatrix:
    """Means for a problem given by a block-sparse W, which need not be symmetric."""

    def __init__(self, W: tuple[Index, Index, Array], q: Array, mu: Array, scales: Array) -> None:
        self.W = W
        start, columns, values = W
        self.problem = FC3D(sp.bsr_array((values, columns, start), shape=(q.size, q.size)), q, mu)
        self._given = q, mu, scales
        self.factorisation, self.sweep = BLOCK * columns.size, COUPLING * columns.size
        self.accelerated_sweep = self.sweep + ACCELERATED * mu.size

    @cached_property
    def operator(self) -> Operator:
        """W for `interior`, `continuation` and Newton."""
        return Local(self.problem.W)

    def accelerated(self, r: Array, tol: float, most: int, patience: int) -> tuple[int, float]:
        """Accelerated Gauss–Seidel."""
        return _accelerated(_pgs.matrix(*self.W), *self._given, r, tol, self.problem.q_norm, most, patience)

    def nesterov(self, r: Array) -> Interruptible:
        """Sweeps with momentum from r, the best into r."""
        return MatrixSweeps(self.W, *self._given, r, self.problem.q_norm)

    def newton(self, r: Array, tol: float, penalty: float, most: int) -> tuple[int, float]:
        """Semismooth Newton of at most so many factorisations."""
        return solve_impulses(self.operator, *self._given, r, tol, self.problem.q_norm, penalty, most)
