"""Continuation from smoothed laws to Coulomb's law along a path that is followed through its turning points.

Newton's methods stall at such points.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.problem import cones as _cones
from nsdyn._kernels.solvers import smoothing as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.operators import Operator
from nsdyn.problem.solution import Solution
from nsdyn.solvers.newton import PENALTY, Multipliers, by_islands
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import Count, Options, Positive

STRETCH = 40.0
"""κ λ_max(W_cc) of the normal map z = r - κ u."""

CLOSE, CONTRACTION, AGAIN = 1e-3, 0.7, 0.5
"""Largest defect of a point on the path, in units of the smoothing; largest ratio of the defects after and before a
correction; and largest such ratio at which the next correction reuses the same matrix."""

GROWTH, SHRINKAGE = 1.5, 0.5
"""Ratio of the next step length to the last: after one factorisation and little turning; and after more than two
factorisations or a refused step."""

STRAIGHT, SHARP = 0.9, 0.5
"""Cosines between the directions at both ends of a step: above the first the path turns little, below the second too
much."""

ATTEMPT, ATTEMPTS, FLOOR = 1e-7, 1e-2, 1e-14
"""Value of τ / (max r_N² λ_max) below which Newton's method for Coulomb's law itself is tried; factor by which this
threshold falls between attempts; and value below which the matrices are mere round-off, as are steps of that length."""

STEPS = 5
"""Newton steps of one such attempt."""


class Point(NamedTuple):
    """Point (z, t) with the impulse and velocity of the smoothed law; all but x and slip have the shape (3 nc,)."""

    x: Array  # z [N·s], the variable of the normal map, (3 nc,), then t = log τ, τ in J
    r: Array  # impulse of the law, N·s
    u: Array  # relative velocity of the law, m/s
    slip: Array  # λ, kg⁻¹, and D, (N·s)², of the law, (nc, 2)
    v: Array  # W r + q, m/s
    defect: Array  # G, m/s


class Path:
    """Curve G(z, t) = W r + q - u - (τ / τ_0) G_0 = 0 of the smoothed laws. Any z_0 lies on it at any τ_0.

    The curve begins at `start`: z_0 = r, an impulse (3 nc,) in N·s, and a τ_0 in J.
    """

    def __init__(self, p: FC3D, W: Operator, r: Array, tau: float) -> None:
        self.W, self.q, self.mu, self.scales, self.q_norm = W, p.q, p.mu, p.scales, p.q_norm
        self.kappa = STRETCH / p.scales  # κ of each contact, kg
        self.k = np.repeat(self.kappa, 3)  # and of each of its components
        self.obeyed = np.repeat(p.mu > 0.0, 3)  # components with an equation: not the tangents without friction
        self.obeyed[0::3] = True
        self.G0 = np.zeros_like(p.q)
        self.t0 = float(np.log(tau))
        begin = np.append(r, self.t0)
        self.G0 = self.at(begin).defect  # W r + q - u at z_0 and τ_0, m/s
        self.start = self.at(begin)

    def at(self, x: Array) -> Point:
        """Return the point x = (z, t); ZeroDivisionError if it is out of the range of floating-point numbers."""
        tau, part = float(np.exp(x[-1])), float(np.exp(x[-1] - self.t0))
        r, u = np.empty((2, self.q.size))
        slip = np.empty((self.mu.size, 2))
        _kernels.law(x[:-1], self.mu, self.kappa, tau, r, u, slip)
        v = self.W.product(r) + self.q
        return Point(x, r, u, slip, v, np.where(self.obeyed, v - (u + part * self.G0), 0.0))

    def rate(self, point: Point) -> Array:
        """∂G/∂t at a point, m/s."""
        tau, part = float(np.exp(point.x[-1])), float(np.exp(point.x[-1] - self.t0))
        dr = np.empty(self.q.size)
        _kernels.rate(point.r, point.u, point.slip, self.mu, self.kappa, tau, dr)
        return np.where(self.obeyed, self.W.product(dr) - (dr / self.k + part * self.G0), 0.0)

    def metric(self, t: float) -> Array:
        """Weights of (dz, dt): the z of a contact is in units of √(κ τ), the length that the smoothing rounds off."""
        return np.append(np.exp(-t) / self.k, 1.0)

    def measure(self, point: Point) -> float:
        """Larger of the literature's error and the residual in m/s, for the impulse of a point."""
        return float(_cones.measure_at(self.scales, point.v, point.r, self.mu, self.q_norm))

    def size(self, point: Point) -> float:
        """Root mean square of the defect, in units of the smoothing, √(τ / κ)."""
        return float(np.linalg.norm(point.defect * np.sqrt(self.k)) / np.sqrt(np.exp(point.x[-1]) * self.q.size))


class Linear:
    """Inverse of ∂G/∂z = (I + W A) (A + κ)⁻¹ at a point, from one factorisation.

    A, shape (nc, 3, 3), is -∂r/∂u of the law at constant τ, kg. RuntimeError where I + W A is singular.
    """

    def __init__(self, path: Path, point: Point) -> None:
        self.A, self.kappa, self.mu = np.empty((path.mu.size, 3, 3)), path.kappa, path.mu
        _kernels.stiffness(point.r, point.u, point.slip, path.mu, self.A)
        self.solve = path.W.factor(self.A)

    def __call__(self, g: Array) -> Array:
        """Return the change dz that changes G by g: (A + κ) (I + W A)⁻¹ g."""
        dz = np.empty_like(g)
        _kernels.product(self.A, np.zeros_like(self.kappa), self.mu, g, dz)
        _kernels.product(self.A, self.kappa, self.mu, g - self.solve(dz), dz)
        return dz

    def tangent(self, rate: Array) -> Array:
        """Return a tangent (dz, dt) of the path, for its `rate` ∂G/∂t."""
        return np.append(-self(rate), 1.0)


def _unit(direction: Array, metric: Array) -> Array:
    """Return the direction scaled to unit length in the metric."""
    return direction / np.sqrt(metric * direction @ direction)


@np.errstate(all="ignore")  # a point out of range is refused
def _corrected(path: Path, x: Array, plane: Array) -> tuple[Point | None, Array, int]:
    """Correct x to the path by Newton's method in a plane; return the point, its tangent, and the factorisations.

    The point is None if it is not reached. `plane` is the normal of the plane. A matrix is reused as long as the defect
    falls fast enough. The tangent uses the last matrix, which belongs to an earlier point.
    """
    last, tangent, count = np.inf, plane, 0
    linear: Linear | None = None
    while True:
        try:
            point = path.at(x)
            size = path.size(point)
            if linear is not None and size < CLOSE:
                return point, linear.tangent(path.rate(point)), count
            if not size <= CONTRACTION * last:
                break
            if linear is None or size > AGAIN * last:
                linear, count = Linear(path, point), count + 1
                tangent = linear.tangent(path.rate(point))
        except (ZeroDivisionError, RuntimeError):
            break
        last = size
        dz = linear(point.defect)
        x = x + (plane[:-1] @ dz) / (plane @ tangent) * tangent
        x[:-1] -= dz
    return None, tangent, count


class Following:
    """Follow the path of smoothed laws from an impulse r (3 nc,), with interruptions.

    The best impulse so far is in `r`, its measure in `best`, the number of factorisations in `count`. The initial
    smoothing τ_0 is `wide` times the square of the residual of the given r over λ_max(W_cc).

    The smoothed law of `_kernels.smoothing` has a solution for every z. As τ falls from large values to 0, the
    solutions form a path to a solution of Coulomb's law. Where many contacts slide, the path turns back in τ. Methods
    that only lower τ stall at such turning points. Here each step goes along the tangent, in z and t = log τ alike, and
    Newton's method returns to the path in the plane normal to the tangent (pseudo-arclength). On the way, where τ is
    small, Newton's method for Coulomb's law itself is tried.

    References
    ----------
    E. Allgower, K. Georg, Introduction to numerical continuation methods, SIAM 2003. H. Keller, Numerical solution of
    bifurcation and nonlinear eigenvalue problems, 1977. S. Robinson, Normal maps induced by linear transformations,
    Math. Oper. Res. 17, 1992.
    """

    def __init__(self, problem: FC3D, W: Operator, tol: float, r: Array, wide: float) -> None:
        self.problem, self.W, self.tol = problem, W, tol
        _, error, residual, _ = problem.solved(r, tol)
        self.r, self.count, self.best = r.copy(), 0, max(error, residual)
        tau = max(wide * residual**2 / problem.scales.mean(), np.finfo(float).tiny)
        self._steps = self._taken(r.copy(), tau)

    def run(self, most: int) -> None:
        """Continue to the tolerance or for `most` factorisations; the last step may exceed them."""
        end = self.count + most
        while self.best > self.tol and self.count < end and next(self._steps, None) is not None:
            pass

    def _keep(self, x: Array, measure: float) -> None:
        if measure < self.best:
            self.best = measure
            self.r[:] = x

    def _attempt(self, r: Array, most: float) -> Iterator[bool]:
        """Try Newton's method for Coulomb's law itself from r, until it ends or for `most` factorisations."""
        run = Multipliers(self.problem, self.W, r.copy(), PENALTY)
        while not run.ended and run.count < most:
            before = run.count
            run.run(self.tol, STEPS)
            self.count += run.count - before
            self._keep(run.r, run.best)
            yield True

    def _taken(self, r: Array, tau: float) -> Iterator[bool]:
        """Take the steps of the path from r at τ = tau, then the steps of Newton's method from its end."""
        length, attempt = 1.0, ATTEMPT
        self.count += 1
        try:
            path = Path(self.problem, self.W, r, tau)
            here, scale = path.start, float(path.scales.mean())
            direction = -_unit(Linear(path, here).tangent(path.rate(here)), path.metric(here.x[-1]))
        except (ZeroDivisionError, RuntimeError):  # point out of range, or no inverse
            return
        while True:
            yield True
            there, ahead, used = _corrected(path, here.x + length * direction, path.metric(here.x[-1]) * direction)
            self.count += used
            cosine = 0.0
            if there is not None:
                metric = path.metric(there.x[-1])
                new = _unit(ahead, metric)
                cosine = float(metric * new @ _unit(direction, metric))
            if there is None or not abs(cosine) >= SHARP:
                length *= SHRINKAGE
            else:
                here, direction = there, new if cosine > 0.0 else -new
                self._keep(here.r, path.measure(here))
                if used == 1 and abs(cosine) > STRAIGHT:
                    length *= GROWTH
                elif used > 2:
                    length *= SHRINKAGE
            small = float(np.exp(here.x[-1])) / (scale * float(here.r[0::3].max()) ** 2)
            if length < FLOOR or small < FLOOR:
                if small < ATTEMPT:
                    yield from self._attempt(here.r, np.inf)
                return
            if small < attempt:
                attempt *= ATTEMPTS
                yield from self._attempt(here.r, STEPS)


def continuation(problem: FC3D, W: Operator, r: Array, tol: float, most: int) -> tuple[int, float]:
    """Solve one connected problem from r = 0, with the best impulse written into r: (factorisations, its measure)."""
    way = Following(problem, W, tol, np.zeros_like(r), 1.0)
    way.run(most)
    r[:] = way.r
    return way.count, way.best


@dataclass(frozen=True)
class Continuation(Options):
    """Pseudo-arclength continuation from smoothed laws to Coulomb's law, island by island, from r = 0.

    It solves problems at which all other methods stall: collisions of many bodies, large friction, redundant contacts.
    It costs 20 to 100 factorisations where sweeps would do and up to 350 where they would not. It cannot use a warm
    start.

    Parameters
    ----------
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
    max_iter : int
        Factorisations per island.

    References
    ----------
    E. Allgower, K. Georg, Introduction to numerical continuation methods, SIAM 2003.
    """

    tol: Positive = 1e-8
    max_iter: Count = 1000

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem; r0 is only checked for being a solution already."""
        return by_islands(problem, r0, self.tol, partial(continuation, most=self.max_iter))
