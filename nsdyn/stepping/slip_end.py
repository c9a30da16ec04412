"""End of slip within a move, of a contact or of a joint with dry friction.

Friction opposes the slip until the slip is zero. Then the contact sticks, or slips in the opposite direction. A move
has only one direction of friction, and one mean slip. So the move has to end where the slip is zero, or friction would
be wrong by up to 2 μ r_N after a reversal, and the way by up to μ g h²/8 after a stop.
"""

from __future__ import annotations

import numpy as np

from nsdyn._kernels.stepping import slip_end as _slip_end
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Solver
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.tools.arrays import Bools


def first_end(
    kin: ContactKinematics, solver: Solver, problem: FC3D, solution: Solution, soon: float, cut: bool = False
) -> float:
    """Return the fraction of a move, above `soon`, after which the first slip stops or reverses; 1 if none does.

    The fraction is u_k/(u_k - u_e), with the slip u_k where the move begins and u_e where it would end if friction did
    not change its direction, the forces of the move being constant. A loose solution shows no end. Where the move has
    been `cut`, an end counts only if friction still drives the slip, as where stiff forces change with the time.
    """
    local = kin.begun
    if not solution.converged or (ends := ending(kin, problem, solution, solver.tol)) is None:
        return 1.0
    begin, _, free, jacobian_drift, _ = local.reshape(5, -1, 3)[..., 1:]
    free, b = free + jacobian_drift, problem.q.reshape(-1, 3)
    now = (solution.u - problem.q).reshape(-1, 3)[:, 1:] + free
    if cut:
        ends &= (solution.r.reshape(-1, 3)[:, 1:] * (begin + now)).sum(axis=1) > 0.0
    # Dry joints that slide on do so whatever the others do: friction has its first direction until the first end.
    slides = np.zeros(ends.size, np.bool_)
    slides[kin.contacts.gap.size :] = _slipping(kin, solver.tol) & ~kin.turning
    while ends.any():
        some = ends | slides
        u = begin[some]
        speed = np.linalg.norm(u, axis=1)
        # A slip so fast that in the law it goes on whatever friction does.
        drag = np.zeros_like(b)
        drag[some, 1:] = (kin.mu[some] * solution.r[::3][some] / speed)[:, None] * u
        slowed = problem.product(drag.ravel()).reshape(-1, 3)[some, 1:]
        most = 2.0 * np.linalg.norm(free[some], axis=1) + np.linalg.norm(now[some], axis=1)
        fast = 2.0 * (most + np.linalg.norm(slowed, axis=1) + speed)
        on = (fast / speed)[:, None] * u
        onward = b.copy()
        onward[some, 1:] = free[some] + on
        again = solver(problem.with_velocity(onward.ravel()), solution.r)
        if not again.converged:
            return 1.0
        change = again.u.reshape(-1, 3)[some, 1:] - on - u
        at = -(u * change).sum(axis=1) / np.maximum((change * change).sum(axis=1), np.finfo(float).tiny)
        if not (gone := ends[some] & (at <= soon)).any():
            return float(at[at > soon].min(initial=1.0))
        # Friction of these is against their new slip from the beginning.
        ends[some] &= ~gone
        slides[some] &= ~gone
    return 1.0


def ending(kin: ContactKinematics, problem: FC3D, solution: Solution, tol: float) -> Bools | None:
    """Mark the rows whose slip stops or reverses; None where no slip ends. Slip of joints up to `tol` is none."""
    out, shown = np.empty(kin.mu.size, np.bool_), (solution.r, solution.u, problem.q)
    return out if _slip_end.ending(*shown, kin.mu, kin.begun, kin.was, _slipping(kin, tol), out) else None


def _slipping(kin: ContactKinematics, tol: float) -> Bools:
    """Mark dry joints (joint rows,) that slide faster than `tol` where the move begins."""
    if not kin.slid.size:
        return kin.slid
    slip = kin.u_begin.reshape(-1, 3)[kin.contacts.gap.size :, 1:]
    return kin.slid & (np.hypot(*slip.T) > tol)
