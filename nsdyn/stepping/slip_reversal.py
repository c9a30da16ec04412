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


def reversal(kin: ContactKinematics, solver: Solver, problem: FC3D, solution: Solution, cut: bool = False) -> float:
    """Return the fraction of a move after which the first slip reverses, 1 if none does.

    The fraction is u_k/(u_k - u_e), with the slip u_k where the move begins and u_e where it would end if friction did
    not change its direction, the forces of the move being constant. A loose solution shows no reversal. Where the move
    has been `cut`, a reversal counts only if friction still drives the slip, as where stiff forces change with the
    time.
    """
    local = kin.begun
    if not solution.converged or (end := endings(kin, problem, solution)) is None:
        return 1.0
    begin, _, free, jacobian_drift, _ = local.reshape(5, -1, 3)[..., 1:]
    free, turned = free + jacobian_drift, end == 2
    b = problem.q.reshape(-1, 3).copy()
    if (stops := end == 1).any():
        # Solve again: would contacts that stop slide back from rest?
        rest = b.copy()
        rest[stops, 1:] = (free - begin)[stops]
        again = solver(problem.with_velocity(rest.ravel()), solution.r)
        back = -(again.u.reshape(-1, 3)[:, 1:] * begin).sum(axis=1)
        turned |= stops & (back > _slip_reversal.STANDS * (begin * begin).sum(axis=1))
    now = (solution.u - problem.q).reshape(-1, 3)[:, 1:] + free
    if cut:
        turned &= (solution.r.reshape(-1, 3)[:, 1:] * (begin + now)).sum(axis=1) > 0.0
    if not turned.any():
        return 1.0
    begin, free, now = begin[turned], free[turned], now[turned]
    speed = np.linalg.norm(begin, axis=1)
    # A slip so fast that in the law it goes on whatever friction does.
    fast = 2.0 * (2.0 * np.linalg.norm(free, axis=1) + np.linalg.norm(now, axis=1) + speed)
    on = (fast / speed)[:, None] * begin
    b[turned, 1:] = free + on
    again = solver(problem.with_velocity(b.ravel()), solution.r)
    if not again.converged:
        return 1.0
    change = again.u.reshape(-1, 3)[turned, 1:] - on - begin
    at = -(begin * change).sum(axis=1) / np.maximum((change * change).sum(axis=1), np.finfo(float).tiny)
    return float(np.clip(at, 0.0, 1.0).min())


def endings(kin: ContactKinematics, problem: FC3D, solution: Solution) -> NDArray[np.int8] | None:
    """Classify how the slip of rows that slide ends; None where all go on.

    0 if the slip goes on, 1 if it stops, 2 if it reverses, or is stopped by friction along the slip.
    """
    out = np.empty(kin.mu.size, np.int8)
    shown = solution.r, solution.u, problem.q
    return out if _slip_reversal.ending(*shown, kin.mu, kin.begun, kin.was, kin.slid, out) else None
