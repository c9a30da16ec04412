"""What a step leaves to the next one: a warm start, and what of the motion is smooth enough to be foreseen.

A step sees its contacts at one configuration, the midpoint, so two first-order terms are missing from its equations:
the rows of the contacts turn until the end of the step, and contacts bend the motion that the gyroscopic terms belong
to. The last step knows both up to a first-order error, which makes the scheme second order on smooth motion. What is
not smooth (an impact, a new corner on the ground) must not be foreseen: only what two successive steps agree on is, the
smaller of two changes in one direction and nothing otherwise, as slope limiters do for conservation laws.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels import motion as _motion
from nsdyn.contacts import ContactSet
from nsdyn.joints import JointRows, Rows
from nsdyn.problem import Array, Index

__all__ = ["History", "foresee_slip", "forget_stopped", "slip_status"]


@dataclass(frozen=True, eq=False)
class History:
    """Memory of the last step; world axes.

    Attributes
    ----------
    key : ndarray of int, shape (nc,)
        Names of its contacts.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    normal : ndarray, shape (nc, 3)
    impulse : ndarray, shape (nc, 3)
        N·s.
    velocity : ndarray, shape (nc, 3)
        Relative velocity Hᵀ v_{k+1} with the rows of its midpoint, m/s.
    turn : ndarray, shape (nc, 3)
        (H - H_last)ᵀ v_k, the change of relative velocity by the turning of the rows alone, m/s; 0 where the step
        before had no such contact. H_last is turned by the least rotation that brings its normal to that of H.
    change : ndarray, shape (n,)
        Change of v by contacts, joint limits and joint friction.
    push : ndarray, shape (n,)
        What of it to expect again.
    joints : ndarray, shape (slots, 3)
        Impulses of joint limits and joint friction, by the slots of `nsdyn.joints.JointLaws`.
    solved : bool
        Whether the impulses were solved for, and not those of the step before.
    """

    key: Index
    status: NDArray[np.int8]
    normal: Array
    impulse: Array
    velocity: Array
    turn: Array
    change: Array
    push: Array
    joints: Array
    solved: bool

    @staticmethod
    def empty(n: int, slots: int) -> History:
        """Of a scene with n coordinates and so many slots of joint rows, before its first step."""
        key, status, none = np.empty(0, np.int64), np.empty(0, np.int8), np.empty((0, 3))
        return History(key, status, none, none, none, none, np.zeros(n), np.zeros(n), np.zeros((slots, 3)), False)

    def scaled(self, ratio: float) -> History:
        """For steps longer by `ratio`."""
        return replace(
            self, impulse=ratio * self.impulse, turn=ratio * self.turn, change=ratio * self.change,
            push=ratio * self.push, joints=ratio * self.joints,
        )  # fmt: skip

    def warm_start(self, contacts: ContactSet, frame: Array, joints: JointRows | None) -> Array:
        """Last impulses of the contacts that are still there, in the frames of now, and of the joint rows, N·s."""
        r = np.empty(3 * contacts.key.size)
        _motion.warm_start(self.key, self.impulse, contacts.key, frame, r)
        return r if joints is None else np.concatenate((r, self.joints[joints.slot].ravel()))

    def turning(self, contacts: ContactSet, frame: Array, u: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """h dHᵀ/dt v of the contacts that were closed.

        Parameters
        ----------
        contacts : ContactSet
        frame : ndarray, shape (nc, 3, 3)
        u : ndarray, shape (3 rows,)
            Relative velocities at v_k with the rows of now, contacts first.

        Returns
        -------
        foreseen : ndarray, shape (3 rows,)
            Contact frames, m/s; 0 beyond the contacts.
        turn : ndarray, shape (nc, 3)
            For the next `History`.
        slides : ndarray of bool, shape (nc,)
            Which of them slid.
        """
        nc = contacts.key.size
        foreseen, turn, slides = np.zeros_like(u), np.empty((nc, 3)), np.empty(nc, np.bool_)
        last = self.key, self.status, self.normal, self.velocity, self.turn
        _motion.turning(*last, contacts.key, frame, u, foreseen, turn, slides)
        return foreseen, turn, slides

    def after(
        self,
        contacts: ContactSet,
        status: NDArray[np.int8],
        frame: Array,
        change: Array,
        r: Array,
        u: Array,
        turn: Array,
        joints: Array,
        solved: bool,
    ) -> History:
        """History after a step with impulses r (rows, 3), their change of v, and relative velocities u at v_{k+1}."""
        impulse, velocity = np.empty_like(turn), np.empty_like(turn)
        _motion.to_world(frame, r, impulse)
        _motion.to_world(frame, u.reshape(-1, 3), velocity)
        agreed = np.minimum(np.abs(change), np.abs(self.change))
        push = np.where(change * self.change > 0.0, np.copysign(agreed, change), 0.0)
        return History(contacts.key, status, contacts.normal, impulse, velocity, turn, change, push, joints, solved)


def foresee_slip(rows: Rows, u_begin: Array, u_free: Array, slides: NDArray[np.bool_], guess: Array) -> Array:
    """Offset of tangential velocities that lets friction oppose the slip of the middle of the step, shape (3 rows,).

    Parameters
    ----------
    rows : Rows
    u_begin, u_free : ndarray, shape (3 rows,)
        Relative velocities at the beginning of the step, and at its end without impulses, m/s.
    slides : ndarray of bool, shape (nc,)
        Contacts that slide.
    guess : ndarray, shape (3 rows,)
        Impulses to expect, N·s.
    """
    curve = np.zeros_like(u_begin)
    if slides.any():
        u_end = u_free + rows.full.relative_velocity(rows.velocity_change(guess))
        _motion.curve(u_begin, u_end, slides, curve)
    return curve


def forget_stopped(u: Array, r: Array, mu: Array, curve: Array) -> bool:
    """Put `curve` to 0 if a contact that was to slide on has stopped, and tell whether one has."""
    if not curve.any():
        return False
    stopped = bool(curve[: 3 * mu.size].reshape(-1, 3)[slip_status(u, r, mu) == 1].any())
    if stopped:
        curve[:] = 0.0
    return stopped


def slip_status(u: Array, r: Array, mu: Array) -> NDArray[np.int8]:
    """0 open, 1 stick, 2 slip of the contacts, those with a friction coefficient in mu (nc,)."""
    status = np.empty(mu.size, np.int8)
    _motion.contact_status(u, r, mu, status)
    return status
