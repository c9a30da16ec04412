"""Fixed points that freeze a part of the problem, solve the remaining convex problem, and repeat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nsdyn.literature._common import Anderson, Equilibrated, Run
from nsdyn.literature._kernels import variational as _kernels
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array

SWEEPS = 2000
"""Largest number of sweeps for one convex problem."""

State = Callable[[Equilibrated, Array], Array]
"""(problem, x) → frozen part."""

Inner = Callable[[Equilibrated, Array, Array, float], tuple[Array, int]]
"""(problem, frozen, x, goal) → (solution x of the convex problem, iterations)."""


def slip_shift(scaled: Equilibrated, x: Array) -> Array:
    """De Saxcé's shift s = μ‖u_T‖, shape (nc,)."""
    u = (scaled.W @ x + scaled.q).reshape(-1, 3)
    return scaled.mu * np.hypot(u[:, 1], u[:, 2])


def normal_impulse(scaled: Equilibrated, x: Array) -> Array:
    """Normal impulses θ = x_N, shape (nc,)."""
    return x[::3].copy()


def shifted(scaled: Equilibrated, s: Array) -> Array:
    """Free velocity with the shift added, q + s e_N."""
    out = scaled.q.copy()
    out[::3] += np.maximum(s, 0.0)
    return out


def defect(scaled: Equilibrated, x: Array) -> float:
    """‖x - P_K(x - F(x))‖, the natural map of the Coulomb problem with ρ = 1."""
    F, P = np.empty_like(x), np.empty_like(x)
    _kernels.operator(*scaled.csr, scaled.q, scaled.mu, x, F)
    _kernels.step_on_cones(x, F, 1.0, scaled.mu, P)
    return float(np.linalg.norm(x - P))


def descend(sweep: Callable[[Array], None], x: Array, goal: float, max_sweeps: int = SWEEPS) -> tuple[Array, int]:
    """Repeat sweeps, which work in place on their argument, with Anderson's acceleration until x changes by ≤ goal."""
    mix = Anderson(20)
    for k in range(1, max_sweeps + 1):
        g = x.copy()
        sweep(g)
        if np.linalg.norm(g - x) <= goal:
            return g, k
        x = mix.next(x, g)
    sweep(x)
    return x, max_sweeps


def freeze(run: Run, max_iter: int, state: State, inner: Inner, memory: int) -> Solution:
    """Fixed point of frozen ↦ state(inner(frozen)), Anderson-accelerated where memory > 0.

    Each convex problem is solved to a tenth of the defect of the Coulomb problem, the rule of the paper.
    """
    scaled, mix, count = run.scaled, Anderson(memory), 0
    x = run.r * scaled.root
    frozen = state(scaled, x)
    for _ in range(max_iter):
        x, used = inner(scaled, frozen, x, max(0.1 * defect(scaled, x), 1e-15))
        count += used
        if run.done(x / scaled.root):
            break
        new = state(scaled, x)
        frozen = mix.next(frozen, new) if memory else new
    return run.finish(count)
