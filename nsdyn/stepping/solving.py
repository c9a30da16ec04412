"""The problem of a move, and its solution: that along whose friction ball joints slip."""

from __future__ import annotations

import math
from functools import cache
from typing import cast

import numpy as np

from nsdyn._kernels.stepping import solving as _solving
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Graded, Solver
from nsdyn.stepping.ball_joints import SHARES, Search, angles
from nsdyn.stepping.encounter import Closing, Encounter
from nsdyn.tools.arrays import Array, Bools

__all__ = ["again", "slips_otherwise", "solve"]

ALL = np.empty(0, np.bool_)


def solve(
    met: Encounter,
    solver: Solver,
    last: Solution | None,
    slides: Bools,
    closing: Closing,
    effort: float,
    shares: bool,
    off: Bools | None,
) -> tuple[Encounter, FC3D, Solution]:
    """What is met, its problem, and the impulses, where the contacts `slides` (nc,) slide through.

    The `last` solution is of the same move with other contacts, or rough; where it has not converged no more is asked
    for than `Graded.loosely` gives, and where there is none, and effort is bounded, than `Graded.roughly` does. The
    solution differs from it in the islands alone of which rows are `off` (rows,). With `shares` those of the friction
    of ball joints are sought, by more solves.
    """

    def once(met: Encounter, last: Solution | None, off: Bools | None) -> tuple[FC3D, Solution]:
        """The same with the shares that there are."""
        problem = FC3D.from_blocks(met.rows.blocks, met.offsets(slides, closing), met.mu)
        solution = again(solver, last, problem, met.local[4], met.local[0], effort)
        if last is not None and off is not None:
            r, u = solution.r.copy(), solution.u.copy()
            _solving.thaw(met.rows.full.arrays, off, (last.r, last.u), (r, u))
            solution = solution._replace(r=r, u=u)
        return problem, _held(met, solver, problem, solution)

    if not met.rows.balls.size:
        return met, *once(met, last, off)
    rows, local = met.rows, met.local
    pushed, free = rows.ball_axes(local[4]), rows.ball_axes(local[2])
    met = met.sharing(angles(np.where(pushed.any(axis=1, keepdims=True), pushed, free)), local[4])
    problem, solution = once(met, last, off)
    search = Search()
    for _ in range(SHARES if shares else 0):
        if (angle := search.next(met.rows, solution.r, solution.u, problem.scales)) is None:
            break
        met = met.sharing(angle, solution.r)
        problem, solution = once(met, solution, None)
    return met, problem, solution


def slips_otherwise(
    met: Encounter, problem: FC3D, solution: Solution, slides: Bools, back: bool, off: Bools | None
) -> Bools:
    """Contacts (nc,) that slip otherwise than as they `slide` through; then they do as the solution shows.

    Only those that stop, if it is only looked `back`, and only in islands of which a row is `off` (rows,).
    """
    out, some = np.empty(slides.size, np.bool_), ALL if off is None else off
    shown = solution.r, solution.u, problem.q, met.mu
    _solving.slips_otherwise(met.rows.full.arrays, shown, met.local, slides, back, some, out)
    return out


def _held(met: Encounter, solver: Solver, problem: FC3D, solution: Solution) -> Solution:
    """The solution with the impulses that clutches have, beyond any tolerance."""
    r = met.rows.held(solution.r)
    if r is solution.r:
        return solution
    _, error, residual, u = problem.solved(r, solver.tol)
    return solution._replace(r=r, u=u, error=error, residual=residual)


@cache
def is_graded(kind: type) -> bool:
    """Whether solvers of a kind are `Graded`, which takes as long to ask of one as a small problem to solve."""
    return all(hasattr(kind, name) for name in ("balanced", "loosely", "roughly"))


def again(solver: Solver, last: Solution | None, problem: FC3D, r: Array, before: Array, effort: float) -> Solution:
    """Solve a problem that follows on a loose or rough solution as loosely, one of a collision with bounded effort."""
    if not is_graded(type(solver)):
        return solver(problem, r)
    graded = cast(Graded, solver)
    if last is not None and not last.converged:
        return graded.loosely(problem, r)
    if last is None and effort < math.inf and (found := graded.roughly(problem, r, effort)) is not None:
        return found
    return graded.balanced(problem, r, before)
