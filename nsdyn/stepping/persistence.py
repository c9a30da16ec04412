"""Couples with which persistent contacts do no work: one per pair of free bodies, at the midpoint of a move.

Impulses act at one configuration. On contacts that stay closed and stick they do a small work w = r·ū, where ū is the
mean of the relative velocities before and after. This work is an error of second order, of either sign. A couple along
ω̄, the mean angular velocity of body 2 relative to body 1, cancels it: τ = -w ω̄/‖ω̄‖² on body 2, -τ on body 1. It is
as if the contact force acted at a point moved by O(h²), and it keeps both momenta exactly.
`ContactKinematics.corrected` closes the gaps at the end of the move. With both, the scheme is a discrete gradient (O.
Gonzalez, Time integration and discrete Hamiltonian systems, J. Nonlinear Science 6, 1996; P. Betsch, Energy-consistent
numerical integration of mechanical systems with mixed holonomic and nonholonomic constraints, CMAME 195, 2006). W and
the solver are unchanged.

Contacts with links of articulations and with kinematic bodies have no couples. Their work, O(h²) of a motion, is in the
ledger as `integration`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from nsdyn._kernels.stepping import persistence as _persistence
from nsdyn.problem.solution import Solution
from nsdyn.solvers.auto import Auto
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.tools.arrays import NOTHING, Array, Bools

if TYPE_CHECKING:
    from nsdyn.stepping.midpoint import Midpoint
    from nsdyn.stepping.scene_state import System


class Couple(NamedTuple):
    """Couples of the contacts of a move; all arrays are empty if there are none.

    Attributes
    ----------
    impulse : ndarray, shape (nc, 3)
        Couples on body 2, world axes, N·m·s.
    work : ndarray, shape (nc,)
        Work of the couples, J.
    dv : ndarray, shape (n,)
        Change of v by the couples.
    """

    impulse: Array
    work: Array
    dv: Array


NO_COUPLE = Couple(np.empty((0, 3)), NOTHING, NOTHING)


def turned(
    kin: ContactKinematics,
    mid: Midpoint,
    solution: Solution,
    errors: Array,
    v: Array,
    sliding: Bools,
    couple: Couple,
    left: Array,
) -> tuple[Couple, Bools] | None:
    """Return the couples with which persistent contacts do no work, and the contacts whose couples changed.

    None if no couple changes.

    Parameters
    ----------
    kin : ContactKinematics
    mid : Midpoint
    solution : Solution
    errors : ndarray, shape (rows,)
        Errors of its relative velocities, m/s.
    v : ndarray, shape (n,)
        Velocity to which its impulses lead.
    sliding : ndarray of bool, shape (nc,)
        Contacts that slide through the step.
    couple : Couple
        The couples so far.
    left : ndarray, shape (nc,)
        The work that couples leave, J; updated as in the kernel `couples`.
    """
    s, c, rows = mid.s, kin.contacts, kin.rows.full
    d = s.dynamics
    if not d.free:
        return None
    impulse, dv = couple.impulse.copy(), couple.dv.copy()
    if not dv.size:
        impulse, dv = np.zeros((c.gap.size, 3)), np.zeros(d.n)
    other = np.empty(c.gap.size, np.bool_)
    exact = np.maximum(s.solver.aims[0] if isinstance(s.solver, Auto) else s.solver.tol, errors)
    turns = _persistence.turn(
        rows.arrays,
        c[:3],
        0.5 * (mid.state.v + v),
        (mid.state.placement.R, d.inverse_J, d.radii, mid.h),
        (solution.r, solution.u, kin.mu, kin.surface_velocity[0], exact),
        (kin.stays, kin.sticks, sliding),
        (impulse, dv, left, other),
    )
    return (Couple(impulse, couple.work, dv), other) if turns else None


def worked(s: System, kin: ContactKinematics, mid: Midpoint, v: Array, couple: Couple) -> Couple:
    """Return the couples with their works, for a move that leads to the velocity v (n,)."""
    if not couple.dv.size:
        return couple
    work, c, R = np.empty(len(couple.impulse)), kin.contacts, mid.state.placement.R
    _persistence.works(c.names, s.dynamics.free, R, 0.5 * (mid.state.v + v), couple.impulse, work)
    return couple._replace(work=work)
