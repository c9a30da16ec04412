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
from nsdyn.problem import Array, Index

__all__ = ["History"]


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
        Change of v by the contacts.
    push : ndarray, shape (n,)
        What of it to expect again.
    """

    key: Index
    status: NDArray[np.int8]
    normal: Array
    impulse: Array
    velocity: Array
    turn: Array
    change: Array
    push: Array

    @staticmethod
    def empty(n: int) -> History:
        """Of a scene with n coordinates, before its first step."""
        none = np.empty((0, 3))
        return History(np.empty(0, np.int64), np.empty(0, np.int8), none, none, none, none, np.zeros(n), np.zeros(n))

    def scaled(self, ratio: float) -> History:
        """For steps longer by `ratio`."""
        return replace(
            self, impulse=ratio * self.impulse, turn=ratio * self.turn, change=ratio * self.change,
            push=ratio * self.push,
        )  # fmt: skip

    def warm_start(self, contacts: ContactSet, frame: Array) -> Array:
        """Last impulses of the contacts that are still there, in the frames of now, shape (3 nc,), N·s."""
        r = np.empty(3 * contacts.key.size)
        _motion.warm_start(self.key, self.impulse, contacts.key, frame, r)
        return r

    def turning(self, contacts: ContactSet, frame: Array, u: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """h dHᵀ/dt v of the contacts that were closed.

        Parameters
        ----------
        contacts : ContactSet
        frame : ndarray, shape (nc, 3, 3)
        u : ndarray, shape (3 m,)
            Relative velocities at the beginning of the step with the rows of now; those of the contacts come first.

        Returns
        -------
        foreseen : ndarray, shape (3 m,)
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
    ) -> History:
        """History after a step with impulses r, their velocity change M⁻¹ H r, and u = Hᵀ v_{k+1}."""
        impulse, velocity = np.empty_like(turn), np.empty_like(turn)
        _motion.to_world(frame, r.reshape(-1, 3), impulse)
        _motion.to_world(frame, u.reshape(-1, 3), velocity)
        agreed = np.minimum(np.abs(change), np.abs(self.change))
        push = np.where(change * self.change > 0.0, np.copysign(agreed, change), 0.0)
        return History(contacts.key, status, contacts.normal, impulse, velocity, turn, change, push)
