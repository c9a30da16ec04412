"""Laws of impact: what contacts that strike give back, in no time and at one configuration.

With U⁻ and U⁺ before and after, U⁺ = U⁻ + W r, and per contact the restitution e:

newton
    U_N⁺ ≥ -e U_N⁻, friction opposes U_T⁺. The common law. With friction, or in chains of contacts, it may create
    energy (T. R. Kane, D. A. Levinson, Dynamics: theory and applications, 1985); `Step.created` says how much. Contacts
    that rest and have a restitution of their own follow in a round of their own, so that the balls of Newton's cradle
    strike one after the other.
poisson
    Compression with e = 0 gives r_c; expansion gives back e r_c, and more where bodies would meet else: r = r_c + e r_c
    + r', with K* ∋ U⁺ + μ‖U_T⁺‖ e_N ⟂ r' ∈ K. It never creates energy if all contacts have one e: the change is at
    most -½ ‖r_e - e r_c‖²_W - ½ (1 - e²) ‖r_c‖²_W with r_e = e r_c + r'. (F. Pfeiffer, C. Glocker, Multibody dynamics
    with unilateral contacts, 1996, chapter 8, with ε_T = ε_N.)
fremond
    U_N⁺ ≥ -e U_N⁻ where bodies approach, U_N⁺ ≥ -U_N⁻ where they part, friction opposes the mean ½ (U_T⁺ + U_T⁻), so
    that no work is ever positive. Every closed contact takes part. Sticking turns U_T round, as a superball does.
    (M. Frémond, Rigid bodies collisions, Physics Letters A 204, 1995.)

On a single frictionless contact all three agree. Impacts that others provoke follow in rounds, until nothing strikes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn.problem.blocks import Blocks
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array, Bools

__all__ = ["LAWS", "Impact", "strike"]

LAWS = ("newton", "poisson", "fremond")

ROUNDS = 60
"""Most rounds of impacts in no time; what then still approaches is caught without restitution by the step."""

Solve = Callable[[FC3D, Array | None], Solution]


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
    law: str,
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
    law : str
        One of `LAWS`.
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
        part = concerned & (hit | (restitution == 0.0)) if law == "newton" else concerned
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
    return Impact(total, u, normal, friction, created, where, worst)


def _round(
    law: str, solver: Solve, blocks: Blocks, u: Array, mu: Array, e: Array, hit: Bools, part: Bools
) -> tuple[FC3D, Array, Solution]:
    """(problem, impulses, solution) of one impact of all contacts that take part, e the restitution of this time."""
    rows, own = np.repeat(part, 3), blocks._replace(block=blocks.block[part], start=blocks.start[part])
    before, mu, e, hit = u[rows], mu[part], e[part], hit[part]
    r, b = np.zeros_like(u), before.copy()
    if law == "poisson":
        given = np.repeat(1.0 + e, 3) * _solve(solver, FC3D.from_blocks(own, b, mu)).r
        b += own.relative_velocity(own.velocity_change(given))
    else:
        given = np.zeros_like(b)
        b[0::3] += e * before[0::3]
    if law == "fremond":
        b[0::3] += np.where(hit, 0.0, np.maximum(before[0::3], 0.0))
        b[1::3] += before[1::3]
        b[2::3] += before[2::3]
    problem = FC3D.from_blocks(own, b, mu)
    solution = _solve(solver, problem)
    r[rows] = given + solution.r
    return problem, r, solution


def _solve(solver: Solve, problem: FC3D) -> Solution:
    """A solution near the impulses without friction, which keep what is symmetric so: with it there may be several."""
    if problem.nc == 1 or problem.blocks is None or not problem.mu.any():
        return solver(problem, None)
    smooth = FC3D.from_blocks(problem.blocks, problem.q, np.zeros(problem.nc))
    return solver(problem, solver(smooth, None).r)
