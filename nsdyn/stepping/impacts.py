"""Laws of impact: what contacts that strike give back, in no time and at one configuration.

With U⁻ and U⁺ before and after, U⁺ = U⁻ + W r, and per contact the restitution e, which is 0 where the contact rests.
On a single frictionless contact all laws agree. Impacts that others provoke follow in rounds, until nothing strikes.

To add a law:

1. a class with the methods of `Law` and a docstring with its equations, its source, and when it creates energy;
2. an entry in `LAWS`: its name is then an option of `nsdyn.Stepper`;
3. its line in the docstring of `nsdyn.Stepper` and in the README;
4. `tests/test_impacts.py` tries all of `LAWS` on single and multiple impacts: say there what it promises;
5. `python demos/bench/truth.py impacts` tries to prove that promise wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array, Bools

__all__ = ["LAWS", "Impact", "Law", "strike"]

ROUNDS = 60
"""Most rounds of impacts in no time; what then still approaches is caught without restitution by the step."""

Solve = Callable[[FC3D, Array | None], Solution]


class Round(NamedTuple):
    """One impact in no time, of the contacts that take part.

    Attributes
    ----------
    blocks : Blocks
    before : ndarray, shape (3 rows,)
        U⁻, m/s.
    mu, e : ndarray, shape (rows,)
    hit : ndarray of bool, shape (rows,)
        Which approach.
    solve : callable
        Solves a contact problem.
    """

    blocks: Blocks
    before: Array
    mu: Array
    e: Array
    hit: Bools
    solve: Callable[[FC3D], Solution]


class Law(Protocol):
    """What tells laws apart.

    Attributes
    ----------
    one_restitution : bool
        Whether energy is sure not to grow only where all contacts have one restitution.
    """

    one_restitution: bool

    def takes_part(self, hit: Bools, restitution: Array) -> Bools:
        """Which closed contacts of an island that is struck take part."""

    def given(self, impact: Round) -> tuple[Array, Array]:
        """Impulses r₀ that are given, and b: then r = r₀ + r' with K* ∋ y + μ‖y_T‖ e_N ⟂ r' ∈ K, y = W r' + b."""


class Newton:
    """U_N⁺ ≥ -e U_N⁻, friction opposes U_T⁺: the common law.

    With friction, or in chains of contacts, it may create energy (T. R. Kane, D. A. Levinson, Dynamics: theory and
    applications, 1985); `Step.created` says how much. Contacts that rest and have a restitution of their own follow in
    a round of their own, so that the balls of Newton's cradle strike one after the other.
    """

    one_restitution = False

    def takes_part(self, hit: Bools, restitution: Array) -> Bools:
        """What approaches, and what cannot rebound."""
        out: Bools = hit | (restitution == 0.0)
        return out

    def given(self, impact: Round) -> tuple[Array, Array]:
        """No impulse; b_N = (1 + e) U_N⁻, b_T = U_T⁻."""
        b = impact.before.copy()
        b[0::3] += impact.e * impact.before[0::3]
        return np.zeros_like(b), b


class Poisson:
    """Compression with e = 0 gives r_c; expansion e r_c, and more where bodies would meet else: r = r_c + e r_c + r'.

    K* ∋ U⁺ + μ‖U_T⁺‖ e_N ⟂ r' ∈ K. It never creates energy if all contacts have one e: the change is at most
    -½ ‖r_e - e r_c‖²_W - ½ (1 - e²) ‖r_c‖²_W with r_e = e r_c + r'. (F. Pfeiffer, C. Glocker, Multibody dynamics with
    unilateral contacts, 1996, chapter 8, with ε_T = ε_N.)
    """

    one_restitution = True

    def takes_part(self, hit: Bools, restitution: Array) -> Bools:
        """Every closed contact."""
        return np.ones_like(hit)

    def given(self, impact: Round) -> tuple[Array, Array]:
        """(1 + e) r_c, and U⁻ + W (1 + e) r_c."""
        blocks, b = impact.blocks, impact.before
        r = np.repeat(1.0 + impact.e, 3) * impact.solve(FC3D.from_blocks(blocks, b, impact.mu)).r
        return r, b + blocks.relative_velocity(blocks.velocity_change(r))


class Fremond:
    """U_N⁺ ≥ -e U_N⁻ where bodies approach, U_N⁺ ≥ -U_N⁻ where they part, friction opposes ½ (U_T⁺ + U_T⁻).

    No work is ever positive. Every closed contact takes part. Sticking turns U_T round, as a superball does.
    (M. Frémond, Rigid bodies collisions, Physics Letters A 204, 1995.)
    """

    one_restitution = False

    def takes_part(self, hit: Bools, restitution: Array) -> Bools:
        """Every closed contact."""
        return np.ones_like(hit)

    def given(self, impact: Round) -> tuple[Array, Array]:
        """No impulse; b_N = (1 + e) U_N⁻ where bodies approach, 2 U_N⁻ where they part, b_T = 2 U_T⁻."""
        before = impact.before
        b = 2.0 * before
        rebound = before[0::3] + impact.e * before[0::3]
        b[0::3] = np.where(impact.hit, rebound, rebound + np.maximum(before[0::3], 0.0))
        return np.zeros_like(b), b


LAWS: dict[str, Law] = {"newton": Newton(), "poisson": Poisson(), "fremond": Fremond()}
"""By the names that users give."""


class Impact(NamedTuple):
    """What a series of impacts did.

    Attributes
    ----------
    r : ndarray, shape (3 rows,)
        Sum of the impulses, N·s.
    u : ndarray, shape (3 rows,)
        Relative velocities after it, m/s.
    normal, friction : ndarray, shape (rows,)
        Works of the impulses, J.
    created : float
        Energy created, J: the sum over rounds and islands of contacts whose impulses together did positive work.
    problem, solution : FC3D and Solution, or None
        Of the round that was solved worst.
    """

    r: Array
    u: Array
    normal: Array
    friction: Array
    created: float
    problem: FC3D | None
    solution: Solution | None


def strike(
    law: Law,
    solver: Solve,
    blocks: Blocks,
    u: Array,
    mu: Array,
    restitution: Array,
    closed: Bools,
    resting: Array,
    slow: Array,
) -> Impact:
    """Impacts at one configuration until nothing strikes.

    Parameters
    ----------
    law : Law
    solver : callable
    blocks : Blocks
        Factors of W.
    u : ndarray, shape (3 rows,)
        Relative velocities before, m/s.
    mu, restitution : ndarray, shape (rows,)
    closed : ndarray of bool, shape (rows,)
        Rows that may carry an impulse.
    resting : ndarray, shape (rows,)
        Speeds of approach [m/s] below which a contact rests: what strikes with less does not rebound.
    slow : ndarray, shape (rows,)
        Speeds of approach below which it does not strike at all.
    """
    nc = mu.size
    label = np.empty(nc, np.int64)
    islands = int(_blocks.islands(blocks.block, blocks.offset.size - 1, label))
    total, normal, friction = np.zeros(3 * nc), np.zeros(nc), np.zeros(nc)
    created, worst, where = 0.0, None, None
    for _ in range(ROUNDS):
        hit = closed & (u[0::3] < -slow)
        if not hit.any():
            break
        # An island without an impact is not concerned.
        concerned = closed & np.isin(label, label[hit])
        part = concerned & law.takes_part(hit, restitution)
        e = np.where(hit & (u[0::3] < -resting), restitution, 0.0)
        problem, r, solution = _round(law, solver, blocks, u, mu, e, hit, part)
        after = u + blocks.relative_velocity(blocks.velocity_change(r))
        work = 0.5 * (u + after) * r
        normal += work[0::3]
        friction += work[1::3] + work[2::3]
        gained = np.bincount(label, work[0::3] + work[1::3] + work[2::3], islands)
        created += float(gained[gained > 0.0].sum())
        total += r
        u = after
        if worst is None or solution.error > worst.error:
            worst, where = solution, problem
        if not solution.accepted:  # what follows on no solution is none either
            break
    return Impact(total, u, normal, friction, created, where, worst)


def _round(
    law: Law, solver: Solve, blocks: Blocks, u: Array, mu: Array, e: Array, hit: Bools, part: Bools
) -> tuple[FC3D, Array, Solution]:
    """(problem, impulses, solution) of one impact of all contacts that take part, e the restitution of this time."""
    rows, own = np.repeat(part, 3), blocks._replace(block=blocks.block[part], start=blocks.start[part])
    solve = partial(_solve, solver)
    given, b = law.given(Round(own, u[rows], mu[part], e[part], hit[part], solve))
    problem, r = FC3D.from_blocks(own, b, mu[part]), np.zeros_like(u)
    solution = solve(problem)
    r[rows] = given + solution.r
    return problem, r, solution


def _solve(solver: Solve, problem: FC3D) -> Solution:
    """A solution near the impulses without friction, which keep what is symmetric so: with it there may be several."""
    if problem.nc == 1 or problem.blocks is None or not problem.mu.any():
        return solver(problem, None)
    smooth = FC3D.from_blocks(problem.blocks, problem.q, np.zeros(problem.nc))
    return solver(problem, solver(smooth, None).r)
