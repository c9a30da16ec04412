"""Error bound of a step from Gauss's principle, its certificate.

For any r ∈ K put v = v_f + M⁻¹ H r, u = Hᵀ v + w, freeze s = μ‖u_T‖, and write û(x) = Hᵀ x + w + s e_N. The velocity v*
of least constraint, min ½‖x - v_f‖²_M under û(x) ∈ K*, is unique although impulses are not. For any direction d and
λ ≥ 0 with û(v + λ d) ∈ K*,

    ‖v - v*‖_M ≤ ½ λ‖d‖_M + (G + ¼ λ²‖d‖²_M)^½,   G = Σ r·û(v + λ d) = Σ r·(u + s e_N) + λ r·Hᵀ d ≥ 0.

Proof. Let f be the objective and a = v + λ d. As M (v - v_f) = H r, f(x) = f(v) + r·Hᵀ(x - v) + ½‖x - v‖²_M. At x = v*
this gives f(v*) ≥ f(v) - r·û(v) + ½‖v* - v‖²_M, for r·û(v*) ≥ 0; at x = a it gives f(a); and
f(a) ≥ f(v*) + ½‖a - v*‖²_M, since v* is the minimum over a convex set that a belongs to. Together,
‖v - v*‖²_M + ‖v + λ d - v*‖²_M ≤ 2 G + λ²‖d‖²_M: the ball of centre v + ½ λ d and radius (G + ¼ λ²‖d‖²_M)^½ holds v*.
The terms of Σ r·(u + s e_N) are negative where u_N < 0, and every r·û(a) is ≥ 0 again because r and û(a) are in cones
that are dual to each other. (Without the term ½‖a - v*‖²_M the same lines give the weaker √(2 G + λ²‖d‖²_M).)

Where u_N ≥ 0 at every contact, λ = 0 is enough and the bound is the root of the duality gap. Otherwise û(v) + λ Hᵀ d is
in K* if u_N + λ κ ≥ 0 at every contact, with κ = (Hᵀ d)_N - μ‖(Hᵀ d)_T‖. So d must open contacts that approach, and may
close contacts that separate fast enough. The trivial r = 0, whose gap is 0, therefore gets a large bound. A Slater
direction with κ ≥ 1 everywhere depends on the contacts alone. It is found once and reused as long as it opens the
contacts, which one product with Hᵀ verifies. Where bodies are wedged no such direction exists, and each û gets a
direction of its own by projections into K*.

Where r is right up to η and contacts carry impulses, the bound is of the order of √η: for a solution to 1e-13 m/s it is
1e-7 √J. `nsdyn.problem.polished` has a bound of the order of η, at the cost of a solve. Where the frozen problem has no
velocity inside all cones there is no bound, for the least error of u may then leave it without any admissible velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.problem import gauss as _kernels
from nsdyn._kernels.problem.cones import ROUNDING, into_cones
from nsdyn.problem.cones import saxce
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.frozen import Least
from nsdyn.tools.arrays import NOTHING, Array

__all__ = ["Certificate", "SlaterDirection", "along", "certify", "least_direction", "of_all", "of_own"]


SLACK = 0.1
"""Fraction of its margin that a direction may lack: the shortest direction is hardly shorter."""

WEAK = 4.0
"""A direction found for other contacts is replaced if it needs a λ of more than this many times the largest -u_N."""

AIM, ENOUGH, SWEEPS = 0.1, 0.01, 2000
"""Distances inside K*, in units of the largest -u_N of one solution, and most sweeps. Each change brings a contact to
the first distance, until all contacts have the second. Where sweeps fail, Newton's method aims at the second."""

RESOLVED = 100.0 * ROUNDING
"""Least value of that unit over the largest velocity."""

FEWER = 0.9
"""Where no direction opened all contacts, the search is repeated once at most this fraction of their number is left."""

PENALTY, GROWTH, LARGEST = 10.0, 10.0, 1e9
"""Penalty times λ_max(W_cc) of the first Newton step, its growth with every full step, and its limit."""

STEPS = 20
"""Most Newton steps for a direction. About five are needed. In a heap of spheres 50 steps find a direction whose bound
is no better than that of projections. Where no direction exists, no number of steps is enough."""


class Certificate(NamedTuple):
    """Error bound of one solve.

    Attributes
    ----------
    gap : float
        Duality gap Σ r·(u + δ e_N + s e_N) of the problem shifted by δ = max(0, -u_N), J.
    shift : float
        ‖δ‖₂ over the contacts, m/s: the distance of that problem from the given one.
    bound : float
        Upper bound of ‖v - v*‖_M, in √J. v is the velocity of the computed impulse. v* is the exact solution of the
        convex problem with the computed friction shifts s = μ‖u_T‖ frozen. The bound is not the distance to a solution
        of Coulomb's problem, which need not be unique, nor the error of time stepping. Round-off in u is not counted.
        The bound is infinite where some u_N < 0 and no velocity with û inside K* is found (two walls that close on a
        body, a roller that friction grips in a nip), or where the impulse is not finite.
    coulomb : float
        Defect in Coulomb's law, √J: the change of v* when the shifts s are updated once more, to those of v*. It is no
        bound, and is accurate to some hundredths of `bound`. NaN if it was not computed (`nsdyn.problem.polished`).
    """

    gap: float
    shift: float
    bound: float
    coulomb: float = math.nan


class SlaterDirection(NamedTuple):
    """Direction that opens contacts, kept from one certificate to the next.

    Attributes
    ----------
    d : ndarray, shape (n,)
        Velocity in the coordinates of `FC3D.blocks`; the impulse x (3 nc,) of d = M⁻¹ H x where W is given alone. Empty
        if none was found.
    nc : int
        Number of contacts for which it was found.
    speed : float
        Largest -u_N for which it was sought, m/s.
    wedged : int
        Number of contacts at which no d had κ > 0 everywhere; 0 if one had.
    """

    d: Array
    nc: int
    speed: float
    wedged: int = 0

    def hopeless(self, nc: int, speed: float) -> bool:
        """Whether a search is not worth its cost: one failed for as many contacts and up to 10 times the `speed`."""
        return not self.d.size and nc == self.nc and speed > 0.1 * self.speed


def certify(
    problem: FC3D, r: Array, u: Array | None = None, slater: SlaterDirection | None = None
) -> tuple[Certificate, SlaterDirection | None]:
    """Return the certificate of the impulse r, and its direction for the certificate of the next step.

    That is the given one, unless it had to be replaced.

    Parameters
    ----------
    problem : FC3D
        With symmetric W.
    r : ndarray, shape (3 nc,)
        Impulse, N·s; if it is outside K, P_K(r) is taken.
    u : ndarray, shape (3 nc,), optional
        Relative velocity W r + q, m/s; computed if it is not given, or if r is outside K.
    slater : SlaterDirection, optional
        Result of the last certificate. Any direction gives a valid bound, and the same one the same bound.

    References
    ----------
    J. J. Moreau, Quadratic programming in mechanics: dynamics of one-sided constraints, SIAM J. Control 4, 1966.
    """
    impulse, d = np.empty(problem.q.size), slater.d if slater else NOTHING
    if into_cones(problem.impulse(r), problem.mu, impulse) or u is None:
        u = problem.velocity(impulse)
    gap, shift, speed, step, total, square = _along_direction(problem, u, impulse, d)
    if not math.isfinite(gap + shift):
        return Certificate(gap, shift, math.inf), slater
    if step > WEAK * speed and not (slater and slater.hopeless(problem.nc, speed)):
        last = slater or SlaterDirection(NOTHING, problem.nc, 0.0)
        d, wedged = NOTHING, last.wedged if problem.nc > FEWER * last.wedged else 0
        # A direction for all contacts is worth its cost if they last: if there are as many as at the last search.
        if not wedged and problem.nc == last.nc:
            d = of_all(problem)
            wedged = 0 if d.size else problem.nc
        if not d.size:
            d = of_own(problem, saxce(u.reshape(-1, 3), problem.mu).ravel(), speed)
        if d.size or step == math.inf:
            slater = SlaterDirection(d, problem.nc, speed, wedged)
            step, total, square = _along_direction(problem, u, impulse, d)[3:]
    half = 0.5 * step * math.sqrt(square) if step < math.inf else math.inf
    return Certificate(gap, shift, half + math.sqrt(half * half + total)), slater


def _along_direction(problem: FC3D, u: Array, r: Array, d: Array) -> tuple[float, float, float, float, float, float]:
    """Return (gap, |δ|_2, max δ, λ, Σ r·(û + λ Hᵀ d), ‖d‖²_M) along `SlaterDirection.d`."""
    o, square = along(problem, d)
    return *_kernels.certificate(u, r, o, problem.mu, problem.scales), square


def along(problem: FC3D, d: Array) -> tuple[Array, float]:
    """Return (Hᵀ d, ‖d‖²_M) of `SlaterDirection.d`; zeros, which open no contact, if d has other coordinates."""
    o, b = np.zeros_like(problem.q), problem.blocks
    if b is None and d.size == o.size:
        o = problem.product(d)
        return o, float(d @ o)
    if b is not None and d.size == b.n:
        return o, float(_kernels.along_blocks(b.arrays, d, o))
    return o, 0.0


def of_all(problem: FC3D) -> Array:
    """Return a `SlaterDirection.d` with κ > 0 at every contact; empty if none is found."""
    return least_direction(problem, np.tile((1.0, 0.0, 0.0), problem.nc), SLACK)


def of_own(problem: FC3D, hat: Array, speed: float) -> Array:
    """Return a `SlaterDirection.d` with û + λ Hᵀ d in K* at λ = `speed`; empty if none is found.

    û (3 nc,) misses K* by at most `speed`.
    """
    unit = max(speed, RESOLVED * float(np.abs(hat).max()))
    inside = -hat / unit
    if problem.blocks is not None:
        d = np.zeros(problem.blocks.n)
        if _kernels.relax(problem.blocks.arrays, problem.mu, inside, AIM, ENOUGH, SWEEPS, d):
            return d * (unit / speed)
    inside[0::3] += ENOUGH
    return least_direction(problem, inside, SLACK * ENOUGH) * (unit / speed)


def least_direction(problem: FC3D, b: Array, slack: float) -> Array:
    """Return the `SlaterDirection.d` of least ‖d‖_M with Hᵀ d ∈ b - slack e_N + K*; empty if none is found.

    The penalty ρ grows. The minimum of ½‖d‖²_M + Σ ρ/2 dist²(Hᵀ d, b + K*) grows with ρ to the least ‖d‖_M without
    slack, so that the first sufficient direction is hardly longer.
    """
    nothing, penalty = np.zeros_like(problem.q), PENALTY
    least = Least(problem, b, nothing)
    for _ in range(STEPS):
        fraction, _ = least.step(nothing, penalty)
        if fraction and _kernels.least_opening(least.o, b, problem.mu) >= -slack:
            return least.d if problem.blocks is None else problem.blocks.velocity_change(least.d)
        if fraction == 1.0:
            penalty *= GROWTH
        if not fraction or penalty > LARGEST:
            break
    return NOTHING
