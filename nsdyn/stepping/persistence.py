"""Persistent contacts do no work: where the impulses of a move act, a couple per pair of free bodies sees to that.

Impulses at one configuration do a little work on contacts that stay closed, and stick: w = r·ū with ū the mean of the
relative velocities before and after, an error of second order of either sign. A couple along ω̄, the mean spin of one
body on the other, takes it: τ = -w ω̄/‖ω̄‖² on body 2, -τ on body 1. It is as if the contact force acted at a point moved
by O(h²), and keeps both momenta exactly. With the gaps closed where the move ends, for which `Encounter.corrected`
sees, it is a discrete gradient (O. Gonzalez, Time integration and discrete Hamiltonian systems, J. Nonlinear Science 6,
1996; P. Betsch, Energy-consistent numerical integration of mechanical systems with mixed holonomic and nonholonomic
constraints, CMAME 195, 2006) that leaves W and the solver as they are.

Contacts with links of articulations and with bodies that move as prescribed have no couples: their work, O(h²) of a
motion, is in the ledger as `integration`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nsdyn._kernels.compiled import clock
from nsdyn._kernels.stepping import persistence as _persistence
from nsdyn._kernels.stepping import workless as _workless
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.solvers.auto import LIMITS, Auto
from nsdyn.stepping.encounter import Encounter
from nsdyn.stepping.solving import Way, pose, solve
from nsdyn.tools.arrays import Array, Bools

if TYPE_CHECKING:
    from nsdyn.stepping.half import Half
    from nsdyn.stepping.instant import System

__all__ = ["NO_COUPLE", "Couple", "solve_workless"]


class Couple(NamedTuple):
    """Couples of the contacts of a move; all empty for none.

    Attributes
    ----------
    impulse : ndarray, shape (nc, 3)
        On body 2, world axes, N·m·s.
    work : ndarray, shape (nc,)
        J.
    dv : ndarray, shape (n,)
        Change of v by them.
    """

    impulse: Array
    work: Array
    dv: Array


NO_COUPLE = Couple(np.empty((0, 3)), np.empty(0), np.empty(0))


NO_ROWS = np.empty(0, np.bool_)


def solve_workless(
    s: System,
    met: Encounter,
    half: Half,
    last: Solution | None,
    slides: Bools,
    way: Way,
    start: Couple,
    off: Bools | None,
) -> tuple[Encounter, FC3D, Solution, Couple]:
    """`solve`, and couples with which contacts that persist do no work, from `start`; what is met with these.

    Only islands of which a row is `off` (rows,), or has another couple, change; all where nothing is known of that. A
    kernel does all this where `Auto` solves all islands in one, and else asks for a solve when it needs one.
    """
    d, c, rows, alone = s.dynamics, met.contacts, met.rows, met
    nc, made, first = c.gap.size, start.dv.size > 0, True
    if made:
        met = alone.turned(start.dv, alone.local[4])
    passes = _workless.PASSES if d.free and met.stays.any() and not way.rough else 0
    problem, solution = pose(met, slides, way.closing), last
    couple, dv = (start.impulse.copy(), start.dv.copy()) if made else (np.zeros((nc, 3)), np.zeros(d.n))
    local, b, r, u = met.local.copy(), problem.q.copy(), met.local[4].copy(), np.empty_like(problem.q)
    change, mean, other = np.empty(d.n), np.empty(d.n), np.empty(nc, np.bool_)
    state, solver = (couple, dv, change, mean, np.full(nc, np.inf), other, local, b, r, u), _means(s, met, way.most)
    while True:
        code, left, solved, begin = _workless.SOLVE, passes, 0, clock()
        if solver[0] or not first:
            code, left, solved, error, residual, count = _workless.workless(
                rows.full.arrays,
                (c.geom1, c.geom2, c.frame1, c.frame2, c.normal),
                (half.middle.v, half.forces.v),
                (half.middle.placement.R, d.inverse_J, s.arm, half.h),
                (met.mu, problem.scales, met.transport, alone.local, *((u, u) if last is None else (last.r, last.u))),
                (met.stays, met.sticks, slides),
                (met.end_gap, met.restitution, met.rebound, met.late, tuple(way.closing)),
                NO_ROWS if last is None or off is None else off,
                solver,
                (first, way.back, passes, (False, 0, 0.0, 0.0)),
                state,
            )
        if left < passes:
            problem, made = problem.with_velocity(b.copy()), True
            met = alone._replace(local=local.copy())
        elif solved > 1 or (solved and code == _workless.SOLVE):
            problem = problem.with_velocity(b.copy())
        if solved:
            solution = Solution(r.copy(), u.copy(), Status.CONVERGED, error, residual, count, clock() - begin)
        if code == _workless.DONE:
            break
        first = first and left == passes
        which, before = (off, last) if first else (other, solution)
        own = way if first else way._replace(back=True)
        met, problem, again = solve(met, s.solver, solution, slides, own, which, before)
        # Of what is solved loosely one more couple is as exact.
        most = left if again.converged else min(left, int(again.accepted))
        solution, passes, first = again, most, False
        r[:], u[:], change[:] = again.r, again.u, rows.velocity_change(again.r)
    assert solution is not None  # there was none to go on from, and so a solve
    return met, problem, solution, _acting(s, met, half, couple, dv, mean) if made else start


def _acting(s: System, met: Encounter, half: Half, couple: Array, dv: Array, mean: Array) -> Couple:
    """Couples that act, whose change of v is dv, with their works at the mean velocity."""
    work, c = np.empty(len(couple)), met.contacts
    _persistence.works(c.frame1, c.frame2, s.dynamics.free, half.middle.placement.R, mean, couple, work)
    return Couple(couple, work, dv)


def _means(s: System, met: Encounter, most: int) -> tuple[bool, float, float, tuple[int, float, int], float, int]:
    """What solves in passes, as of `_workless.workless`: the kernel does what `Auto` does with small islands."""
    solver = s.solver
    if isinstance(solver, Auto):
        return met.joints is None and met.rows.blocks is met.rows.full, *solver.aims, LIMITS, solver.tol, most
    return False, solver.tol, solver.tol, LIMITS, solver.tol, most
