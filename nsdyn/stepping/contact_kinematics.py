"""Contact kinematics of a step: relative velocities at contacts and joint rows, and the contact law at the end.

Impulses act at one configuration, between two flows. Up to there the relative velocities of the contacts change from
u_k to u⁻ though no impulse acts, because contact rows turn with their bodies. The second half of the motion adds the
same change once more, to first order. So the law applies to u⁺ + c with c = u⁻ - u_k, and no earlier step is
remembered:

    K* ∋ y + μ‖y_T‖ e_N ⟂ r ∈ K,   y = W r + b,
    b_N = u_f + c_N + [G > closed or stays] (G - L) / τ     u_f = u⁻ + Hᵀ M̃⁻¹ h f̃,  G = g̃ - h₂ c_N / 2
    b_T = u_f + c_T       of a contact that sticks, or stops: slip of the end
        = u⁻ + u_f        of one that slides through: twice the mean slip, exactly
    b_N = u⁻ + u_f        of one that separates (u_k > 0) faster than G closes: it returns as fast, and gives no energy

where h₂ is the time left after the impulses, and G the gap that the end would have if the normal velocity were 0 there.
The bracket is 1 where the gap exceeds the gap tolerance (closed) or the contact persists (stays), else 0. L, less than
the gap tolerance, keeps the normal velocities of persistent contacts from alternating (`left_open`). A gap closes at
the constant speed (G - L) / τ. With τ = h₂ bodies would touch where the step ends, with that speed. They would
penetrate by as much as the gap was, until the next impulses stop them. The position projection would lift each body,
which opens the gaps around it as far, and a pile would never come to rest. So τ is the time until the next impulses
where the gap is shallow and no contact may rebound, except in moves that are cut where bodies touch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.stepping import law as _law
from nsdyn._kernels.stepping import persistence as _persistence
from nsdyn._kernels.stepping import touching as _touching
from nsdyn.collision.contacts import ContactSet, among, take
from nsdyn.dynamics.joints import NO_CLUTCHES, ContactJacobian, JointRows
from nsdyn.dynamics.values import Placement
from nsdyn.tools.arrays import NEVER, NOTHING, Array, Bools, Index

if TYPE_CHECKING:
    from nsdyn.problem.fc3d import FC3D
    from nsdyn.problem.solution import Solution
    from nsdyn.stepping.midpoint import Midpoint
    from nsdyn.stepping.scene_state import SceneState, System, WarmStart

SLIPS = 1.0 - 1e-9
"""Share of its largest friction from which on a dry joint counts as sliding."""

STOPPED = 1e-13
"""Share of a velocity change by impacts that is round-off after some hundred impacts."""

UNKNOWN = np.empty(0, np.int8)
NO_TRANSPORT = np.empty((2, 0))


GapRule = tuple[float, float, float, float]
"""Rule by which gaps close in a move: the gap tolerance, and the largest gap that may stay open until the next
impulses, m or rad; the times from the impulses to the end of the move, h₂, and to the next impulses at the latest,
s."""


class ContactKinematics(NamedTuple):
    """The contacts of a step, then its joint rows, where the impulses act.

    Attributes
    ----------
    contacts : ContactSet
    joints : JointRows or None
    rows : ContactJacobian
    frame : ndarray, shape (nc, 3, 3)
        Rows (n, t1, t2), world axes.
    mu, restitution : ndarray, shape (rows,)
    local : ndarray, shape (5, 3 rows)
        u_k, u⁻, u_f and c [m/s], and the last impulses [N·s].
    end_gap : ndarray, shape (rows,)
        G, m or rad.
    surface_velocity : ndarray, shape (2, 3 rows)
        Velocities that moving surfaces add to u⁻ and u⁺, and those they would add at the end of the step, m/s; empty if
        none move.
    far : ndarray of bool, shape (nc,)
        Contacts that turn far: `nsdyn._kernels.stepping.touching.turns_far`.
    struck : ndarray of bool, shape (rows,)
        Rows in which an impact acts in this move; empty if there are none.
    stays, sticks, was : ndarrays of bool, bool and int8, shapes (rows,), (nc,), (nc,)
        Rows that persist along their normals, contacts that persist across them, and the status of contacts in the last
        move: `nsdyn._kernels.stepping.persistence.persists`.
    slid, turning : ndarrays of bool, shape (joint rows,)
        Dry joints that slide where the move begins, by their last impulses; new rows are taken to slide. And those that
        slip along axes which turn with them.
    excess_speed : ndarray, shape (rows,)
        How much faster than predicted rows separate where the move ends, m/s, as far as that is known.
    """

    contacts: ContactSet
    joints: JointRows | None
    rows: ContactJacobian
    frame: Array
    mu: Array
    restitution: Array
    local: Array
    end_gap: Array
    surface_velocity: Array = NO_TRANSPORT
    far: Bools = NEVER
    struck: Bools = NEVER
    stays: Bools = NEVER
    sticks: Bools = NEVER
    was: NDArray[np.int8] = UNKNOWN
    excess_speed: Array = NOTHING
    slid: Bools = NEVER
    turning: Bools = NEVER

    @classmethod
    def of(
        cls, mid: Midpoint, there: Placement, contacts: ContactSet, joints: JointRows | None, begin: SceneState
    ) -> ContactKinematics:
        """Compute the relative velocities of a move at its contacts and joint rows, with the frames placed `there`.

        Contacts and joint rows that no motion opens or closes are left out: those whose normal meets the axis of their
        link's only joint, as that of a wheel, and those of a truss.
        """
        d, middle, forces, old, warm = mid.s.dynamics, mid.state, mid.forces, begin.contacts, begin.warm
        rows, frame = d.rows(contacts, there, forces, joints)
        full, nc, nr = rows.full, contacts.gap.size, rows.full.nc
        # Points of contacts are known to within the gap tolerance.
        if d.trees and not (moved := rows.moved(mid.s.gap_tol, contacts.gap)).all():
            return cls.of(mid, there, take(contacts, moved[:nc]), joints and joints.take(moved[nc:]), begin)
        local, end_gap, where, far = np.empty((5, 3 * nr)), np.empty(nr), np.empty(nc, np.int64), np.empty(nc, np.bool_)
        _, here, ended = mid.surfaces
        surface_velocity = d.surfaces.surface_velocity(contacts, frame, middle.position.driven_x, nr, here, ended)
        carried = d.surfaces.velocities(old, begin.position.driven_x, here)
        _law.local_velocities(
            full.arrays,
            (begin.v, middle.v, forces.v),
            (carried, *surface_velocity, rows.joint_load),
            (old[:3], begin.placement.x, begin.twists, (mid.reach, mid.s.gap_tol, mid.s.rounding, d.free)),
            (contacts[:3], frame, there.x),
            (warm.key, warm.force, mid.h),
            mid.ahead,
            (local, end_gap, where, far),
        )
        mu, restitution, slid, turning = contacts.mu, contacts.restitution, NEVER, NEVER
        if joints is not None:
            turning = _of_joints(mid, joints, warm, local[:, 3 * nc :], end_gap[nc:])
            mu, restitution = np.concatenate((mu, joints.mu)), np.concatenate((restitution, joints.restitution))
            last, at = local[4, 3 * nc :].reshape(-1, 3), d.joints.coordinate[joints.slot]
            slid = (joints.mu > 0.0) & ~joints.actuated & (np.hypot(last[:, 1], last[:, 2]) >= SLIPS * last[:, 0])
            # A joint that rests at its limit does not slip, however the limit and its friction share the load.
            slid &= ~among(at, at[(joints.mu == 0.0) & (last[:, 0] > 0.0)])
        laws = frame, mu, restitution
        return cls(contacts, joints, rows, *laws, local, end_gap, surface_velocity, far, slid=slid, turning=turning)

    def changed(self, dv: Array, dv_free: Array, struck: Bools) -> ContactKinematics:
        """Return the kinematics after impacts, in the rows `struck`: the rows they affect lose their drift c.

        They change v by dv (n,), and by dv_free (n,) with the forces that see the velocity after them.
        """
        du, local = self.rows.full.relative_velocity(dv), self.local.copy()
        local[1] += du
        local[2] += self.rows.full.relative_velocity(dv_free)
        # The rest of a velocity that impacts have stopped is round-off, which no contact need resist.
        local[1:3][np.abs(local[1:3]) <= STOPPED * np.abs(du)] = 0.0
        local[3, np.repeat(np.abs(du).reshape(-1, 3).max(axis=1, initial=0.0) > 0.0, 3)] = 0.0
        end_gap = np.where(struck, np.minimum(self.end_gap, 0.0), self.end_gap)
        return self._replace(local=local, end_gap=end_gap, struck=struck)

    def offsets(self, sliding: Bools, gap_rule: GapRule) -> Array:
        """Return b, shape (3 rows,), m/s, where the rows `sliding` (rows,) slide through the move."""
        b = np.empty(self.local.shape[1])
        laws = self.end_gap, self.restitution, self.struck, self.excess_speed, gap_rule
        _law.offsets(self.local, laws, self.stays, sliding, b)
        return b

    def take(self, kept: Bools) -> ContactKinematics:
        """Return the kinematics of some of the rows, to evaluate their impulses."""
        nc, full = self.contacts.gap.size, self.rows.full
        rows, contacts = np.repeat(kept, 3), take(self.contacts, kept[:nc])
        own = ContactJacobian(full.of(kept), {}, *NO_CLUTCHES)
        return self._replace(
            contacts=contacts,
            joints=self.joints and self.joints.take(kept[nc:]),
            rows=own,
            frame=self.frame[kept[:nc]],
            mu=self.mu[kept],
            restitution=self.restitution[kept],
            local=self.local[:, rows],
            end_gap=self.end_gap[kept],
            surface_velocity=self.surface_velocity.compress(rows, axis=1)
            if self.surface_velocity.size
            else self.surface_velocity,
            far=self.far[kept[:nc]],
            stays=self.stays[kept],
            sticks=self.sticks[kept[:nc]],
            was=self.was[kept[:nc]],
            excess_speed=self.excess_speed[kept],
            slid=self.slid[kept[nc:]],
            turning=self.turning[kept[nc:]],
        )

    @property
    def u_begin(self) -> Array:
        """u_k, relative velocities where the move begins, shape (3 rows,), m/s."""
        return self.local[0, :]

    @property
    def u(self) -> Array:
        """u⁻, relative velocities at the midpoint before forces and impulses, shape (3 rows,), m/s."""
        return self.local[1, :]

    @property
    def u_free(self) -> Array:
        """u_f, relative velocities after the forces without impulses, shape (3 rows,), m/s."""
        return self.local[2, :]

    @property
    def jacobian_drift(self) -> Array:
        """c, change of the relative velocities while the rows turn with their bodies, shape (3 rows,), m/s."""
        return self.local[3, :]

    @property
    def r_last(self) -> Array:
        """Impulses from which the solver starts, shape (3 rows,), N·s."""
        return self.local[4, :]

    @property
    def begun(self) -> Array:
        """`local` with the surface velocities of the beginning of the move in u_k, for accelerating surfaces too."""
        if not self.surface_velocity.size:
            return self.local
        out = self.local.copy()
        out[0] -= self.quicker
        return out

    @property
    def quicker(self) -> Array:
        """How much faster moving surfaces are at the end than at the midpoint, (3 rows,), m/s; empty if none move."""
        return self.surface_velocity[1] - self.surface_velocity[0] if self.surface_velocity.size else NOTHING

    def lasting(self, s: System, begin: SceneState, limits: Array, h: float, struck: bool) -> ContactKinematics:
        """Return the kinematics with its persistent rows marked, for a move of h s; no row persists if `struck`.

        Rows persist from the beginning of the move, where joint rows have the gaps `limits`.
        """
        warm, geoms = begin.warm, s.inscribed.size
        nc, rows = self.contacts.gap.size, self.end_gap.size
        stays, sticks, was = np.empty(rows, np.bool_), np.empty(nc, np.bool_), np.empty(nc, np.int8)
        last = warm.key, warm.pair, warm.status
        before = begin.contacts[:3], self.quicker, (s.gap_tol, h, s.theta * h)
        pressed = NEVER if self.joints is None else (warm.joints[self.joints.slot, 0] > 0.0) & (self.joints.mu == 0.0)
        given = self.contacts.names, geoms, last, before, (limits, pressed), self.local, self.end_gap
        _persistence.persists(*given, struck, (stays, sticks, was))
        return self._replace(stays=stays, sticks=sticks, was=was, excess_speed=np.zeros(rows))

    def turned(self, dv: Array, r: Array) -> ContactKinematics:
        """Return the kinematics with couples that change v by dv (n,), and with impulses r to start from."""
        local = self.local.copy()
        if dv.size:
            local[2] += self.rows.full.relative_velocity(dv)
        local[4] = r
        return self._replace(local=local)

    def corrected(
        self, gap: Array, off: Bools, closed: Array, ahead: float, ended: tuple[Index, Array, Array]
    ) -> ContactKinematics:
        """Return the kinematics corrected in the rows that are `off` by the gaps (rows,) at the end of the move.

        The move lasts `ahead` s after the impulses. `ended` holds the keys and normal velocities, m/s, of the contacts
        at its end, and the velocities of its joint rows. Rows whose gaps are not their own are no longer `off`.
        """
        end_gap, excess_speed = self.end_gap.copy(), self.excess_speed.copy()
        own = self.contacts.key, ended, self.local, (ahead, closed)
        _law.end_otherwise(off, gap, *own, end_gap, excess_speed)
        return self._replace(end_gap=end_gap, excess_speed=excess_speed)

    def unforeseen(self) -> ContactKinematics:
        """Return the kinematics without what is foreseen of the second half: rows do not turn, and none is pushed out.

        Drifts are extrapolated from the first half. Where bodies grip another from two sides, contacts may ask of each
        other, by O(h²), what no velocity obeys; of rows that do not turn some velocity obeys all.
        """
        local = self.local.copy()
        local[3] = 0.0
        return self._replace(local=local, end_gap=np.maximum(self.end_gap, 0.0))

    def of_joint(self, x: Array | Bools) -> Array:
        """Sum values x (joint rows,) over the rows of each joint: the friction of a ball joint has two."""
        out, first = x.astype(float), self.rows.balls - self.contacts.gap.size
        out[first] += out[first + 1]
        out[first + 1] = out[first]
        return out

    def sharing(self, angle: Array, r: Array) -> ContactKinematics:
        """Return the kinematics with ball-joint friction split by angles (balls,), and impulses r to start from."""
        rows, local = self.rows.sharing(angle), self.local.copy()
        local[2] += rows.joint_load - self.rows.joint_load
        local[4] = r
        return self._replace(rows=rows, local=local)

    def off(self, gap: Array, r: Array, closed: Array) -> Bools:
        """Mark rows that persist and are pressed by r, but end with a gap (rows,), open or not."""
        out = np.empty(gap.size, np.bool_)
        _law.off(gap, r, self.stays, closed, out)
        return out


def _of_joints(mid: Midpoint, joints: JointRows, warm: WarmStart, local: Array, end_gap: Array) -> Bools:
    """Write the warm start, the drift c and the gaps G of the joint rows of a move into local and end_gap.

    Return which of them, (rows,), slip along axes that turn.
    """
    turning: Bools = mid.s.dynamics.joints.turning[joints.slot]
    local[4] = mid.h * warm.joints[joints.slot].ravel()
    # Like that of springs, the law of actuators applies to the velocity here; so does that of slip in axes that turn.
    local[3].reshape(-1, 3)[joints.actuated | turning, 1:] = 0.0
    end_gap[:] = joints.gap - 0.5 * mid.ahead * local[3, ::3]
    return turning


def predict_sliding(kin: ContactKinematics, warm: WarmStart) -> Bools:
    """Mark the rows that will slide through the step, by their last status and the predicted friction.

    Of joint rows only those along turning axes are marked: along an axis that does not turn, friction against the mean
    slip and against that at the end is the same.
    """
    nc = kin.contacts.gap.size
    sliding, place = np.zeros(kin.mu.size, np.bool_), np.empty(nc, np.int64)
    _touching.places(warm.key, kin.contacts.key, place)
    _law.predict_sliding(kin.rows.full.arrays, kin.mu, place, warm.status, kin.local, sliding[:nc])
    if kin.turning.any():
        slip = kin.u_begin.reshape(-1, 3)[nc:, 1:]
        sliding[nc:] = kin.turning & (kin.of_joint(~kin.slid) == 0.0)
        sliding[nc:] &= kin.of_joint((slip * slip).sum(axis=1)) > _law.NO_SLIP**2
    return sliding


def reconsidered_joints(kin: ContactKinematics, problem: FC3D, solution: Solution, sliding: Bools, back: bool) -> Bools:
    """Mark joint rows along turning axes that slip otherwise than `sliding` says, as `law.reconsider` does contacts."""
    shown = kin.u_begin, kin.u, kin.u_free + solution.u - problem.q
    begin, mid, end = (x.reshape(-1, 3)[kin.contacts.gap.size :, 1:] for x in shown)
    r = solution.r.reshape(-1, 3)[kin.contacts.gap.size :]
    sticks = kin.of_joint(np.hypot(r[:, 1], r[:, 2]) < SLIPS * r[:, 0]) > 0.0
    mean, onward, after = (kin.of_joint((x * end).sum(axis=1)) for x in (mid + end, begin, end))
    stops = sliding & (sticks | (mean <= _law.REVERSED * after))
    goes = kin.turning & ~sliding & ~sticks & (onward > _law.NO_SLIP**2) & (not back)
    return stops | goes
