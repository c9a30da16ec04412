"""Reversal of slip within a move, of a contact or of a joint with dry friction.

Friction opposes the slip until the slip is zero. It has the opposite direction afterwards, unless the contact sticks. A
move has only one direction of friction, so its friction would be wrong by up to 2 μ r_N: the move has to end where the
slip is zero. A contact that stops, and does not slide back, needs no such cut: the impulse that holds it at rest at the
end is right however early it stops. But where bodies turn, slip may stop by itself. The friction that then holds the
contact may be along the slip it had: on the mean slip of the move this friction would create energy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.stepping import slip_reversal as _slip_reversal
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.solvers import Solver
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.tools.arrays import Bools


def reversal(
    kin: ContactKinematics, solver: Solver, problem: FC3D, solution: Solution, soon: float, cut: bool = False
) -> float:
    """Return the fraction of a move, above `soon`, after which the first slip reverses; 1 if none does.

    The fraction is u_k/(u_k - u_e), with the slip u_k where the move begins and u_e where it would end if friction did
    not change its direction, the forces of the move being constant. A loose solution shows no reversal. Where the move
    has been `cut`, a reversal counts only if friction still drives the slip, as where stiff forces change with the
    time.
    """
    local = kin.begun
    if not solution.converged or (end := endings(kin, problem, solution, solver.tol)) is None:
        return 1.0
    begin, _, free, jacobian_drift, _ = local.reshape(5, -1, 3)[..., 1:]
    free, turned, b = free + jacobian_drift, end > 0, problem.q.reshape(-1, 3)
    now = (solution.u - problem.q).reshape(-1, 3)[:, 1:] + free
    if cut:
        turned &= (solution.r.reshape(-1, 3)[:, 1:] * (begin + now)).sum(axis=1) > 0.0
    # Dry joints that slide on do so whatever the others do: friction has its first direction until the first reversal.
    slides = np.zeros(turned.size, np.bool_)
    slides[kin.contacts.gap.size :] = _slipping(kin, solver.tol) & ~kin.turning
    while turned.any():
        some = turned | slides
        u = begin[some]
        speed = np.linalg.norm(u, axis=1)
        # A slip so fast that in the law it goes on whatever friction does.
        drag = np.zeros_like(b)
        drag[some, 1:] = (kin.mu[some] * solution.r[::3][some] / speed)[:, None] * u
        slowed = problem.product(drag.ravel()).reshape(-1, 3)[some, 1:]
        fast = 2.0 * (2.0 * np.linalg.norm(free[some], axis=1) + np.linalg.norm(now[some], axis=1) + speed)
        fast += 2.0 * np.linalg.norm(slowed, axis=1)
        on = (fast / speed)[:, None] * u
        onward = b.copy()
        onward[some, 1:] = free[some] + on
        again = solver(problem.with_velocity(onward.ravel()), solution.r)
        if not again.converged:
            return 1.0
        change = again.u.reshape(-1, 3)[some, 1:] - on - u
        at = -(u * change).sum(axis=1) / np.maximum((change * change).sum(axis=1), np.finfo(float).tiny)
        if not (gone := turned[some] & (at <= soon)).any():
            return float(at[at > soon].min(initial=1.0))
        # Friction of these is against their new slip from the beginning.
        turned[some] &= ~gone
        slides[some] &= ~gone
    return 1.0


def endings(kin: ContactKinematics, problem: FC3D, solution: Solution, tol: float) -> NDArray[np.int8] | None:
    """Classify how the slip of rows that slide ends; None where all go on. Slip of joints up to `tol` is none.

    0 if the slip goes on, 1 if it stops, 2 if it reverses, or is stopped by friction along the slip.
    """
    out, shown = np.empty(kin.mu.size, np.int8), (solution.r, solution.u, problem.q)
    return out if _slip_reversal.ending(*shown, kin.mu, kin.begun, kin.was, _slipping(kin, tol), out) else None


def _slipping(kin: ContactKinematics, tol: float) -> Bools:
    """Mark dry joints (joint rows,) that slide faster than `tol` where the move begins."""
    if not kin.slid.size:
        return kin.slid
    slip = kin.u_begin.reshape(-1, 3)[kin.contacts.gap.size :, 1:]
    return kin.slid & (np.hypot(*slip.T) > tol)
