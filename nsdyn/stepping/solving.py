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
from nsdyn.stepping.contact_kinematics import ContactKinematics, GapRule
from nsdyn.tools.arrays import Array, Bools

__all__ = ["again", "update_sliding", "solve"]

ALL = np.empty(0, np.bool_)


def solve(
    kin: ContactKinematics,
    solver: Solver,
    last: Solution | None,
    sliding: Bools,
    gap_rule: GapRule,
    effort: float,
    shares: bool,
    off: Bools | None,
) -> tuple[ContactKinematics, FC3D, Solution]:
    """What is met, its problem, and the impulses, where the contacts `sliding` (nc,) slide through.

    The `last` solution is of the same move with other contacts, or rough; where it has not converged no more is asked
    for than `Graded.loosely` gives, and where there is none, and effort is bounded, than `Graded.roughly` does. The
    solution differs from it in the islands alone of which rows are `off` (rows,). With `shares` those of the friction
    of ball joints are sought, by more solves.
    """

    def once(kin: ContactKinematics, last: Solution | None, off: Bools | None) -> tuple[FC3D, Solution]:
        """The same with the shares that there are."""
        problem = FC3D.from_blocks(kin.rows.blocks, kin.offsets(sliding, gap_rule), kin.mu)
        solution = again(solver, last, problem, kin.r_last, kin.u_begin, effort)
        if last is not None and off is not None:
            r, u = solution.r.copy(), solution.u.copy()
            _solving.thaw(kin.rows.full.arrays, off, (last.r, last.u), (r, u))
            solution = solution._replace(r=r, u=u)
        return problem, _held(kin, solver, problem, solution)

    if not kin.rows.balls.size:
        return kin, *once(kin, last, off)
    rows = kin.rows
    pushed, free = rows.ball_axes(kin.r_last), rows.ball_axes(kin.u_free)
    kin = kin.sharing(angles(np.where(pushed.any(axis=1, keepdims=True), pushed, free)), kin.r_last)
    problem, solution = once(kin, last, off)
    search = Search()
    for _ in range(SHARES if shares else 0):
        if (angle := search.next(kin.rows, solution.r, solution.u, problem.scales)) is None:
            break
        kin = kin.sharing(angle, solution.r)
        problem, solution = once(kin, solution, None)
    return kin, problem, solution


def update_sliding(
    kin: ContactKinematics, problem: FC3D, solution: Solution, sliding: Bools, back: bool, off: Bools | None
) -> Bools:
    """Contacts (nc,) that slip otherwise than as they `slide` through; then they do as the solution shows.

    Only those that stop, if it is only looked `back`, and only in islands of which a row is `off` (rows,).
    """
    out, some = np.empty(sliding.size, np.bool_), ALL if off is None else off
    shown = solution.r, solution.u, problem.q, kin.mu
    _solving.update_sliding(kin.rows.full.arrays, shown, kin.local, sliding, back, some, out)
    return out


def _held(kin: ContactKinematics, solver: Solver, problem: FC3D, solution: Solution) -> Solution:
    """The solution with the impulses that clutches have, beyond any tolerance."""
    r = kin.rows.held(solution.r)
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
