"""The problem of a move, solved until contacts slip as foreseen and ball joints along their friction."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple, cast

import numpy as np

from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.stepping import workless as _workless
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Graded, Solver
from nsdyn.stepping.ball_joints import SHARES, Search, angles
from nsdyn.stepping.encounter import Closing, Encounter
from nsdyn.tools.arrays import Array, Bools

__all__ = ["Way", "again", "pose", "solve"]


class Way(NamedTuple):
    """How the problem of a move is posed and solved.

    Attributes
    ----------
    closing : Closing
    back : bool
        Whether only contacts that stop are to be changed, of those that slip otherwise than foreseen.
    most : int
        Most solves more for them.
    rough : bool
        Whether what `Graded.roughly` gives is enough, and persistent contacts may do work.
    shares : int
        Most solves more for the friction of ball joints.
    """

    closing: Closing
    back: bool
    most: int
    rough: bool = False
    shares: int = SHARES


def pose(met: Encounter, slides: Bools, closing: Closing) -> FC3D:
    """The problem of what is met, where the contacts `slides` (nc,) slide through."""
    return FC3D.from_blocks(met.rows.blocks, met.offsets(slides, closing), met.mu)


def solve(
    met: Encounter,
    solver: Solver,
    last: Solution | None,
    slides: Bools,
    way: Way,
    off: Bools | None = None,
    kept: Solution | None = None,
) -> tuple[Encounter, FC3D, Solution]:
    """What is met, impulses that make it obey the contact law, and their problem.

    Parameters
    ----------
    met : Encounter
    solver : Solver
    last : Solution, optional
        Of the same move with other contacts, or rough. Where it has not converged no more is asked for than
        `Graded.loosely` gives.
    slides : ndarray of bool, shape (nc,)
        Which contacts slide through, as `foresee` says; changed to what the impulses show.
    way : Way
    off : ndarray of bool, shape (rows,) or (nc,), optional
        Rows that end otherwise than they should.
    kept : Solution, optional
        From which the islands without such rows do not change.
    """
    if not met.rows.balls.size:
        return met, *_solve(met, solver, last, slides, way, off, kept)
    rows, local = met.rows, met.local
    pushed, free = rows.ball_axes(local[4]), rows.ball_axes(local[2])
    met = met.sharing(angles(np.where(pushed.any(axis=1, keepdims=True), pushed, free)), local[4])
    problem, solution = _solve(met, solver, last, slides, way, off, kept)
    search = Search()
    for _ in range(way.shares):
        if (angle := search.next(met.rows, solution.r, solution.u, problem.scales)) is None:
            break
        met = met.sharing(angle, solution.r)
        problem, solution = _solve(met, solver, solution, slides, way, None, None)
    return met, problem, solution


def _solve(
    met: Encounter,
    solver: Solver,
    last: Solution | None,
    slides: Bools,
    way: Way,
    off: Bools | None,
    kept: Solution | None,
) -> tuple[FC3D, Solution]:
    """The same with the shares that the friction of ball joints has."""
    closing, back, most, rough, _ = way
    label, changed, full = np.empty(met.mu.size, np.int64), np.empty(slides.size, np.bool_), met.rows.full
    islands = np.ones(_blocks.islands(full.block, full.offset.size - 1, label), np.bool_)
    problem = pose(met, slides, closing)
    solution = again(solver, last, problem, met.local[4], met.local[0], rough)
    for k in range(most + 1):
        if kept is not None and off is not None:
            r, u = solution.r.copy(), solution.u.copy()
            _workless.thaw(label, off, islands, (kept.r, kept.u), (r, u))
            solution = solution._replace(r=r, u=u)
        shown, own = (solution.r, solution.u, problem.q, met.mu), (label, islands, changed)
        if not _workless.reconsider_some(shown, met.local, slides, back or k > 0, *own):
            break
        if k < most:
            kept, off = solution, changed.copy()
            problem = problem.with_velocity(met.offsets(slides, closing))
            solution = again(solver, solution, problem, solution.r, met.local[0], rough)
    return problem, _held(met, solver, problem, solution)


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


def again(solver: Solver, last: Solution | None, problem: FC3D, r: Array, before: Array, rough: bool) -> Solution:
    """Solve a problem roughly where that is enough, and one that follows on a loose or rough solution as loosely."""
    if not is_graded(type(solver)):
        return solver(problem, r)
    graded = cast(Graded, solver)
    if rough and (found := graded.roughly(problem, r)) is not None:
        return found
    if last is not None and not last.converged:
        return graded.loosely(problem, r)
    return graded.balanced(problem, r, before)
