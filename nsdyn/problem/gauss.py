"""Gauss's principle as the certificate of a step.

For any r ∈ K put v = v_f + M⁻¹ H r, u = Hᵀ v + w, freeze s = μ‖u_T‖, and write û(x) = Hᵀ x + w + s e_N. The velocity
v* of least constraint, min ½‖x - v_f‖²_M under û(x) ∈ K*, is unique although impulses are not. For any direction d
and λ ≥ 0 with û(v + λ d) ∈ K*,

    ‖v - v*‖_M ≤ ½ λ‖d‖_M + (G + ¼ λ²‖d‖²_M)^½,   G = Σ r·û(v + λ d) = Σ r·(u + s e_N) + λ r·Hᵀ d ≥ 0.

Proof. Let f be the objective and a = v + λ d. As M (v - v_f) = H r, f(x) = f(v) + r·Hᵀ(x - v) + ½‖x - v‖²_M. At
x = v* this gives f(v*) ≥ f(v) - r·û(v) + ½‖v* - v‖²_M, for r·û(v*) ≥ 0; at x = a it gives f(a); and
f(a) ≥ f(v*) + ½‖a - v*‖²_M, since v* is the minimum over a convex set that a belongs to. Together,
‖v - v*‖²_M + ‖v + λ d - v*‖²_M ≤ 2 G + λ²‖d‖²_M: the ball of centre v + ½ λ d and radius (G + ¼ λ²‖d‖²_M)^½ holds v*.
The terms of Σ r·(u + s e_N) are negative where u_N < 0, and every r·û(a) is ≥ 0 again because both are in cones that
are dual to each other. (Without the term ½‖a - v*‖²_M the same lines give the weaker √(2 G + λ²‖d‖²_M).)

Where u_N ≥ 0 everywhere, λ = 0 will do and the bound is the root of the duality gap. Else û(v) + λ Hᵀ d is in K* if
u_N + λ κ ≥ 0 with κ = (Hᵀ d)_N - μ‖(Hᵀ d)_T‖, at every contact: d must open those that close, and may close those that
open fast enough. So r = 0, whose gap is 0, gets a bound that is worth something. A direction with κ ≥ 1 everywhere
depends on the contacts alone. It is found once and used as long as it serves, which one product with Hᵀ verifies. Where
bodies are wedged there is none, and each û is brought into K* by projections of its own.

Where r is right up to η and contacts carry impulses, the bound is of the order of √η: of an answer to 1e-13 m/s it
says 1e-7 √J. `nsdyn.problem.polished` has one of the order of η, which costs a solve. Where the frozen problem has no
velocity inside all cones it has no bound, for then the least error of u may leave it without any velocity at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.problem import gauss as _kernels
from nsdyn._kernels.problem.cones import ROUNDING, into_cones
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.frozen import Least
from nsdyn.tools.arrays import Array

__all__ = ["Certificate", "SlaterDirection", "along", "certify", "least_direction", "of_all", "of_own"]

NOTHING = np.empty(0)

SLACK = 0.1
"""Fraction of its margin that a direction may miss: the least one is hardly shorter."""

WEAK = 4.0
"""Where a direction found for other contacts needs a λ of so many times the largest -u_N, a new one is found."""

AIM, ENOUGH, SWEEPS = 0.1, 0.01, 2000
"""How far inside K* the velocity of one answer is brought, in units of its largest -u_N: changes are to the first, in
at most so many sweeps, until all have the second. Where sweeps fail, Newton's method brings it that far."""

RESOLVED = 100.0 * ROUNDING
"""The least of that unit over the largest velocity."""

FEWER = 0.9
"""Contacts over those at which no direction opened all, from which on one is looked for again."""

PENALTY, GROWTH, LARGEST = 10.0, 10.0, 1e9
"""Penalty times λ_max(W_cc) of the first Newton step, its growth with every full step, and its limit."""

STEPS = 20
"""Newton steps for a direction. About five are needed. In a heap of spheres 50 find one that bounds no better than what
projections give, and where none exists no number of them is enough."""


class Certificate(NamedTuple):
    """Error bound of one solve.

    Attributes
    ----------
    gap : float
        Duality gap Σ r·(u + δ e_N + s e_N) of the problem shifted by δ = max(0, -u_N), J.
    shift : float
        ‖δ‖₂ over the contacts, m/s: how far that problem is from the given one.
    bound : float
        At least ‖v - v*‖_M, in √J, where v is the velocity of the computed impulse and v* the exact solution of the
        convex problem with the computed friction shifts s = μ‖u_T‖ frozen. It is not the distance to a solution of
        Coulomb's problem, which need not be unique, nor the error of time stepping; round-off in u is not counted.
        Infinite where some u_N < 0 and no velocity with û inside K* is found (two walls that close on a body, a roller
        that friction grips in a nip), or where the impulse is not finite.
    coulomb : float
        Defect in Coulomb's law, √J: how far v* moves when the shifts s are updated once more, to those of v*. It is no
        bound, and known to some hundredths of `bound`. NaN where it was not asked for (`nsdyn.problem.polished`).
    """

    gap: float
    shift: float
    bound: float
    coulomb: float = math.nan


class SlaterDirection(NamedTuple):
    """A direction that opens contacts, kept from one certificate to the next.

    Attributes
    ----------
    d : ndarray, shape (n,)
        Velocity in the coordinates of `FC3D.blocks`; the impulse x (3 nc,) of d = M⁻¹ H x where W is given alone. Empty
        where none was found.
    nc : int
        Number of contacts it was found for.
    speed : float
        Largest -u_N that it was sought for, m/s.
    wedged : int
        Number of contacts at which no d had κ > 0 everywhere; 0 where one had.
    """

    d: Array
    nc: int
    speed: float
    wedged: int = 0

    def hopeless(self, nc: int, speed: float) -> bool:
        """Whether another search is not worth its cost: as many contacts, and not much less to open."""
        return not self.d.size and nc == self.nc and speed > 0.1 * self.speed


def certify(
    problem: FC3D, r: Array, u: Array | None = None, slater: SlaterDirection | None = None
) -> tuple[Certificate, SlaterDirection | None]:
    """Certificate of the impulse r, and the direction it rests on, for the certificate of the next step.

    Parameters
    ----------
    problem : FC3D
        With symmetric W.
    r : ndarray, shape (3 nc,)
        Impulse, N·s; outside K it stands for P_K(r).
    u : ndarray, shape (3 nc,), optional
        Relative velocity W r + q, m/s; computed where it is not given, or r is outside K.
    slater : SlaterDirection, optional
        What the last certificate returned. Any gives a valid bound, and the same one the same bound.

    Returns
    -------
    certificate : Certificate
    slater : SlaterDirection or None
        That given, unless it had to be replaced.

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
        # What lasts is worth its cost where contacts do: where there are as many as at the last search.
        if not wedged and problem.nc == last.nc:
            d = of_all(problem)
            wedged = 0 if d.size else problem.nc
        if not d.size:
            hat = u.copy()
            hat[0::3] += problem.mu * np.hypot(u[1::3], u[2::3])
            d = of_own(problem, hat, speed)
        if d.size or step == math.inf:
            slater = SlaterDirection(d, problem.nc, speed, wedged)
            step, total, square = _along_direction(problem, u, impulse, d)[3:]
    half = 0.5 * step * math.sqrt(square) if step < math.inf else math.inf
    return Certificate(gap, shift, half + math.sqrt(half * half + total)), slater


def _along_direction(problem: FC3D, u: Array, r: Array, d: Array) -> tuple[float, float, float, float, float, float]:
    """(gap, |δ|_2, max δ, λ, Σ r·(û + λ Hᵀ d), ‖d‖²_M) along `SlaterDirection.d`."""
    o, square = along(problem, d)
    return *_kernels.certificate(u, r, o, problem.mu, problem.scales), square


def along(problem: FC3D, d: Array) -> tuple[Array, float]:
    """(Hᵀ d, ‖d‖²_M) of `SlaterDirection.d`; zeros, which open nothing, where it is of other coordinates."""
    o, b = np.zeros_like(problem.q), problem.blocks
    if b is None and d.size == o.size:
        o = problem.product(d)
        return o, float(d @ o)
    if b is not None and d.size == b.n:
        return o, float(_kernels.along_blocks(b.arrays, d, o))
    return o, 0.0


def of_all(problem: FC3D) -> Array:
    """`SlaterDirection.d` with κ > 0 at every contact; empty if none is found."""
    return least_direction(problem, np.tile((1.0, 0.0, 0.0), problem.nc), SLACK)


def of_own(problem: FC3D, hat: Array, speed: float) -> Array:
    """`SlaterDirection.d` with û + λ Hᵀ d in K* at λ = `speed`, by which û (3 nc,) misses it at most; empty if none."""
    unit = max(speed, RESOLVED * float(np.abs(hat).max()))
    inside = -hat / unit
    if problem.blocks is not None:
        d = np.zeros(problem.blocks.n)
        if _kernels.relax(problem.blocks.arrays, problem.mu, inside, AIM, ENOUGH, SWEEPS, d):
            return d * (unit / speed)
    inside[0::3] += ENOUGH
    return least_direction(problem, inside, SLACK * ENOUGH) * (unit / speed)


def least_direction(problem: FC3D, b: Array, slack: float) -> Array:
    """`SlaterDirection.d` of least ‖d‖_M with Hᵀ d ∈ b - slack e_N + K*, by a growing penalty; empty if there is none.

    The minimum of ½‖d‖²_M + Σ ρ/2 dist²(Hᵀ d, b + K*) grows with ρ to the least ‖d‖_M without slack, so that the first
    one that will do is hardly longer.
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
