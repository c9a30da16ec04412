"""The contact problem of a move, and its solution; ball joints slip along their friction in it."""

from __future__ import annotations

import math
from functools import cache
from typing import cast

import numpy as np

from nsdyn._kernels.stepping import solving as _solving
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.solvers import Graded, Solver
from nsdyn.stepping.ball_joints import SHARES, Search, angles
from nsdyn.stepping.contact_kinematics import ContactKinematics, GapRule, reconsidered_joints
from nsdyn.tools.arrays import Array, Bools

ALL = np.empty(0, np.bool_)

CANCEL = 1e-4
"""Share of the velocity change of the largest impulse alone below which that of all impulses together is none."""


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
    """Solve the contact problem of a move in which the rows `sliding` (rows,) slide through.

    Return the kinematics, the problem and the solution. The `last` solution is of the same move with other contacts, or
    rough. If it has not converged, the accuracy of `Graded.loosely` is enough; if there is none, and `effort` is
    bounded, that of `Graded.roughly`. The solution differs from the last one only in islands with a row that is `off`
    (rows,). With `shares`, the split of the friction of ball joints is found, by further solves; and where no motion
    obeys what the kinematics foresee, they are returned without it, as the problem then solved.
    """

    def once(kin: ContactKinematics, last: Solution | None, off: Bools | None) -> tuple[FC3D, Solution]:
        """Solve the problem with the present split of ball-joint friction."""
        problem = kin.rows.problem(kin.offsets(sliding, gap_rule), kin.mu)
        solution = again(solver, last, problem, kin.r_last, kin.u_begin, effort)
        if last is not None and off is not None:
            r, u = solution.r.copy(), solution.u.copy()
            _solving.thaw(kin.rows.full.arrays, off, (last.r, last.u), (r, u))
            solution = solution._replace(r=r, u=u)
        return problem, _held(kin, solver, problem, solution)

    if not kin.rows.balls.size:
        problem, solution = once(kin, last, off)
        if shares and grips(problem, solution):
            kin = kin.unforeseen()
            problem, solution = once(kin, last, off)
        return kin, problem, solution
    rows = kin.rows
    pushed, free = rows.ball_axes(kin.r_last), rows.ball_axes(kin.u_free)
    split = angles(np.where(pushed.any(axis=1, keepdims=True), pushed, free))
    if last is not None:  # islands that are not solved again keep their split, also where a part sticks
        split = np.arctan2(kin.r_last[3 * rows.balls + 3], kin.r_last[3 * rows.balls])
    kin = kin.sharing(split, kin.r_last)
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
    """Mark rows (rows,) that slip otherwise than `sliding` says, and correct `sliding` by the solution.

    With `back`, only rows that stop are changed. With `off`, only rows in islands with a row that is off (rows,) are
    changed.
    """
    nc, arrays, out = kin.contacts.gap.size, kin.rows.full.arrays, sliding.copy()
    shown = solution.r, solution.u, problem.q, kin.mu
    _solving.update_sliding(arrays, shown, kin.local, sliding[:nc], back, ALL if off is None else off, out[:nc])
    if kin.turning.any():
        changed = reconsidered_joints(kin, problem, solution, sliding[nc:], back)
        out[nc:] = changed if off is None else changed & _solving.concerned(arrays, off)[nc:]
        sliding[nc:] ^= out[nc:]
    return out


def residuals(kin: ContactKinematics, problem: FC3D, solution: Solution) -> Array:
    """Return the residual of the island of each row, shape (rows,), m/s."""
    out = np.empty(problem.nc)
    sizes, answer = (problem.scales, problem.mu), (solution.r, solution.u)
    _solving.residuals(kin.rows.full.arrays, sizes, answer, solution.residual, 0.0, out)
    return out


def grips(problem: FC3D, solution: Solution) -> bool:
    """Return whether no motion obeys a problem: no velocity opens its contacts, or impulses grow that move nothing."""
    if solution.converged:
        return False
    alone = problem.scales * np.linalg.norm(solution.r.reshape(-1, 3), axis=1)
    still = np.abs(solution.u - problem.q).max(initial=0.0) < CANCEL * alone.max(initial=0.0)
    return solution.status is Status.NO_SLATER_POINT or bool(still)


def _held(kin: ContactKinematics, solver: Solver, problem: FC3D, solution: Solution) -> Solution:
    """Return the solution with exactly the impulses that clutches have, beyond any tolerance."""
    r = kin.rows.held(solution.r)
    if r is solution.r:
        return solution
    _, error, residual, u = problem.solved(r, solver.tol)
    return solution._replace(r=r, u=u, error=error, residual=residual)


@cache
def is_graded(kind: type) -> bool:
    """Return whether solvers of a kind are `Graded`: to find out takes as long as to solve a small problem."""
    return all(hasattr(kind, name) for name in ("balanced", "loosely", "roughly"))


def again(solver: Solver, last: Solution | None, problem: FC3D, r: Array, before: Array, effort: float) -> Solution:
    """Solve a problem: loosely after a loose or rough solution, with bounded effort where it is of a collision."""
    if not is_graded(type(solver)):
        return solver(problem, r)
    graded = cast(Graded, solver)
    if last is not None and not last.converged:
        return graded.loosely(problem, r)
    if last is None and effort < math.inf and (found := graded.roughly(problem, r, effort)) is not None:
        return found
    return graded.balanced(problem, r, before)
