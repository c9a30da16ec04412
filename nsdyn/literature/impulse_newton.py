"""Semismooth Newton method on a nonsmooth equation in the impulses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from nsdyn.literature._common import Method, Run, factor, matrix
from nsdyn.literature.formulations import ELEMENTS, block_diagonal, with_blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive

Function = Literal["alart-curnier", "fischer-burmeister", "jean-moreau", "natural"]
Search = Literal["goldstein-price", "armijo", "none"]
Rho = Literal["spectral", "split", "condition", "one"]
Equation = tuple[Function, Search, Array]

LIFT = 1e-10
"""Added to W (of unit blocks) in the matrix only, which redundant contacts make singular: it selects a solution."""


def steps(problem: FC3D, rule: Rho) -> Array:
    """Steps ρ = (ρ_N, ρ_T) from the diagonal blocks, times λ_max(W_cc), shape (nc, 2).

    'spectral' is 1/λ_max(W_cc) for both. 'split' is 1/W_NN and 1/λ_max(W_TT). 'condition' is 'split' with
    ρ_T = λ_min/λ_max² of W_TT. 'one' is ρ = 1 kg, whose effect the paper calls dramatic.
    """
    if rule == "spectral":
        return np.ones((problem.nc, 2))
    if rule == "one":
        return np.tile(problem.scales[:, None], (1, 2))
    row = np.repeat(np.arange(problem.nc), np.diff(problem.W.indptr))
    on = problem.W.indices == row
    D = np.zeros((problem.nc, 3, 3))
    D[row[on]] = problem.W.data[on]
    eigenvalues = np.linalg.eigvalsh(0.5 * (D + D.transpose(0, 2, 1))[:, 1:, 1:])
    # A direction in which the bodies cannot move (2D problems) has eigenvalue zero; its step only must be positive.
    low, high = np.maximum(eigenvalues, 1e-3 * problem.scales[:, None]).T
    normal = 1.0 / np.maximum(D[:, 0, 0], 1e-3 * problem.scales)
    tangent = 1.0 / high if rule == "split" else low / high**2
    return problem.scales[:, None] * np.column_stack((normal, tangent))


def _length(merit: Callable[[float], float], start: float, search: Search) -> float:
    """Return the step length along a Newton direction; merit(t) = ½‖F‖² with slope -2 merit(0).

    Armijo's rule halves the step until merit falls by at least m₁ times the linear prediction. Goldstein–Price also
    requires a fall of at most m₂ times the prediction, so that steps are not short: doubling and bisection,
    m₁ = 0.01 < ½ < m₂ = 0.99.
    """
    if search == "none":
        return 1.0
    t, low, high = 1.0, 0.0, np.inf
    for _ in range(20):
        fall = merit(t) - start
        if not fall <= -2.0 * 0.01 * t * start:
            high = t
        elif search == "goldstein-price" and fall < -2.0 * 0.99 * t * start:
            low = t
        else:
            return t
        t = 0.5 * (low + high) if np.isfinite(high) else 2.0 * t
        if t > 4.0:
            return low
    # A full step past a kink is better than no progress before it.
    return low if low > 0.0 else 1.0


def newton(
    given: tuple[Any, Array, Array], x: Array, method: Equation, done: Callable[[Array, float], bool], max_iter: int
) -> tuple[Array, int, bool]:
    """Apply Newton's method to a map from x (3 nc,); return (x, factorisations, whether `done` ended the iteration).

    `given` is (W, q, mu), with W sparse if a sparse factorisation is cheaper; `method` is (name in `ELEMENTS`, line
    search of `_length`, steps (nc, 2) of the map). done(x, ‖F(x)‖) is called at every iterate; True ends the iteration.
    """
    (W, q, mu), (function, search, rho) = given, method
    element, nc = ELEMENTS[function], mu.size
    sparse = not isinstance(W, np.ndarray)

    def evaluate(x: Array) -> tuple[Array, Array, Array]:
        return element((W @ x + q).reshape(-1, 3), x.reshape(-1, 3), mu, rho)

    F, F_u, F_r = evaluate(x)
    for k in range(max_iter):
        size = float(np.linalg.norm(F))
        if not np.isfinite(size) or done(x, size):
            return x, k, bool(np.isfinite(size))
        J = block_diagonal(F_u) @ W if sparse else (F_u @ W.reshape(nc, 3, 3 * nc)).reshape(3 * nc, 3 * nc)
        solve = factor(with_blocks(J, F_r + LIFT * F_u))
        if solve is None:
            return x, k, False
        step = solve(-F.ravel())

        def merit(t: float, x: Array = x, step: Array = step) -> float:
            return 0.5 * float((evaluate(x + t * step)[0] ** 2).sum())

        x = x + _length(merit, 0.5 * size**2, search) * step
        F, F_u, F_r = evaluate(x)
    return x, max_iter, done(x, float(np.linalg.norm(F)))


@dataclass(frozen=True)
class ImpulseNewton(Options, Method):
    """Semismooth Newton in the impulses, NSN, on one of four nonsmooth equations, with a line search.

    Strength: well-conditioned W, as of elastic bodies with few contacts per coordinate; quadratic convergence near the
    solution. Weakness: on redundant contacts W is singular, and Newton's matrix may be (`newton` works in velocities
    instead, `proximal` makes W definite). It also fails from cold starts with many changes of contact states.

    Parameters
    ----------
    tol : float
        Tolerance of both `FC3D.error` [-] and `FC3D.residual` [m/s].
    max_iter : int
        Largest number of factorisations.
    function : {'fischer-burmeister', 'alart-curnier', 'jean-moreau', 'natural'}
        Equation, see `nsdyn.literature.formulations`. Full steps on the first solve most problems: it is the smoothest.
        On the other equations a line search stops at kinks, and full steps cycle.
    search : {'none', 'goldstein-price', 'armijo'}
        Line search on ½‖F‖².
    rho : {'spectral', 'split', 'condition', 'one'}
        Rule for the steps ρ, see `steps`; only Alart–Curnier and Jean–Moreau have separate normal and tangential steps.

    Raises
    ------
    ValueError
        As `Options`, and for a split rule with a map that has one step per contact.

    References
    ----------
    P. Alart, A. Curnier, CMAME 92, 1991. V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb
    friction, 2018, section 4.
    """

    tol: Positive = 1e-8
    max_iter: Count = 200
    function: Function = "fischer-burmeister"
    search: Search = "none"
    rho: Rho = "spectral"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rho in ("split", "condition") and self.function in ("natural", "fischer-burmeister"):
            raise ValueError(f"rho={self.rho!r} splits the cone, which function={self.function!r} does not allow")

    def _solve(self, run: Run) -> Solution:
        scaled = run.scaled
        given = matrix(scaled.W), scaled.q, scaled.mu
        method = self.function, self.search, steps(run.problem, self.rho)
        start, most = run.r * scaled.root, self.max_iter
        _, count, ended = newton(given, start, method, lambda x, _: run.done(x / scaled.root), most)
        return run.finish(count, Status.MAX_ITERATIONS if ended or count == self.max_iter else Status.STALLED)
