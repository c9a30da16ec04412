"""What a step leaves to the next one: a warm start, and what of the motion is smooth enough to be foreseen.

A step sees its contacts at one configuration, the midpoint, so two first-order terms are missing from its equations:
the rows of the contacts turn until the end of the step, and contacts bend the motion that the gyroscopic terms belong
to. The last step knows both up to a first-order error, which makes the scheme second order on smooth motion. What is
not smooth (an impact, a new corner on the ground) must not be foreseen: only what two successive steps agree on is, the
smaller of two changes in one direction and nothing otherwise, as slope limiters do for conservation laws.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels import encounter as _encounter
from nsdyn._kernels import trees as _trees
from nsdyn.contacts import ContactSet
from nsdyn.joints import JointRows, Rows
from nsdyn.problem import Array, Index

__all__ = ["Departure", "Encounter", "History", "foresee_slip", "release_stopped"]

NOTHING = np.empty(0)


class Encounter(NamedTuple):
    """What a step begins with at its contacts, in their frames, then at its joint rows.

    Attributes
    ----------
    u_before : ndarray, shape (3 rows,)
        Relative velocities at v_k with the rows of now, m/s.
    u_begin, u_free : ndarray, shape (3 rows,)
        At v_k with the rows of the beginning, and without impulses at the end of the step with the rows of the end.
    bend : ndarray, shape (3 rows,)
        h dHᵀ/dt v, what the rows turn in a step as far as it can be foreseen, m/s.
    turn : ndarray, shape (nc, 3)
        For the next `History`.
    slides : ndarray of bool, shape (nc,), or None
        Contacts that slid in the last step, None if there are none.
    guess : ndarray, shape (3 rows,)
        Last impulses of the contacts that are still there and of the joint rows, N·s.
    gap, mu : ndarray, shape (rows,)
        At the midpoint, m, and friction coefficients.
    w : ndarray, shape (3 rows,)
        Offsets of Newton's impact law, u_N + w_N ≥ 0, m/s.
    struck : ndarray of bool, shape (rows,), or None
        Contacts that have an impact, None if there are none.
    elastic : bool
        Whether any could have one.
    """

    u_before: Array
    u_begin: Array
    u_free: Array
    bend: Array
    turn: Array
    slides: NDArray[np.bool_] | None
    guess: Array
    gap: Array
    mu: Array
    w: Array
    struck: NDArray[np.bool_] | None
    elastic: bool


class Departure(NamedTuple):
    """What a step ends with.

    Attributes
    ----------
    change : ndarray, shape (n,)
        M⁻¹ H r.
    v, v_theta : ndarray, shape (n,)
        v_{k+1} and v_{k+θ}.
    u : ndarray, shape (3 rows,)
        Relative velocities at v_{k+1} with the rows of the end, m/s.
    gap : ndarray, shape (rows,)
        At the end, linear in the motion since the midpoint, m.
    normal, friction : ndarray, shape (rows,)
        Works of the impulses, J.
    works : (float, float)
        Their sums.
    impulse, velocity, push : ndarray
        As in `History`.
    """

    change: Array
    v: Array
    v_theta: Array
    u: Array
    gap: Array
    normal: Array
    friction: Array
    works: tuple[float, float]
    impulse: Array
    velocity: Array
    push: Array


class History(NamedTuple):
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
        return self._replace(
            impulse=ratio * self.impulse, turn=ratio * self.turn, change=ratio * self.change,
            push=ratio * self.push, joints=ratio * self.joints,
        )  # fmt: skip

    def meet(
        self,
        contacts: ContactSet,
        joints: JointRows | None,
        rows: Rows,
        frame: Array,
        velocities: tuple[Array, Array],
        drags: tuple[Array, Array],
        law: tuple[float, float, float, float],
        fast: bool,
    ) -> Encounter:
        """What a step begins with at its contacts and joint rows.

        Parameters
        ----------
        contacts : ContactSet
        joints : JointRows, optional
        rows : Rows
        frame : ndarray, shape (nc, 3, 3)
        velocities : (v, v_free)
            At the beginning of the step, and at its end without impulses.
        drags : two ndarrays of shape (3 rows,)
            What sliding surfaces add to the relative velocities then, m/s; empty where there are none.
        law : (h, theta, resting speed, largest gap that counts as closed)
        fast : bool
            Whether the contacts were looked for where the step begins, and not at its midpoint.
        """
        nc, full, mu = len(frame), rows.full, contacts.mu
        size = 3 * full.nc
        rates, guess, turn, slides = np.empty((4, size)), np.empty(size), np.empty((nc, 3)), np.empty(nc, np.bool_)
        gap, w, struck = np.empty(nc), np.empty(size), np.empty(full.nc, np.bool_)
        sliding, some, elastic = _encounter.meet(
            full.offset, full.block, full.start, full.h, *velocities, *drags, rows.press, *law, fast, self.key,
            self.status, self.normal, self.velocity, self.turn, self.impulse, contacts.key, frame, contacts.gap,
            contacts.restitution, rates, guess, turn, slides, gap, w, struck,
        )  # fmt: skip
        u_before, u_begin, u_free, bend = rates[0], rates[1], rates[2], rates[3]
        if joints is not None:  # one that rebounds half a step late is behind its limit, and counts as not struck
            guess[3 * nc :] = self.joints[joints.slot].ravel()
            h, theta, _, closed = law
            u, free = u_begin[3 * nc :], u_free[3 * nc :]
            _trees.joint_impact_law(u, free, joints.gap, joints.restitution, theta * h, closed, w[3 * nc :: 3])
            gap, mu = np.concatenate((gap, joints.gap)), np.concatenate((mu, joints.mu))
        return Encounter(
            u_before, u_begin, u_free, bend, turn, slides if sliding else None, guess, gap, mu, w,
            struck if some else None, elastic,
        )  # fmt: skip

    def leave(
        self,
        rows: Rows,
        frame: Array,
        velocities: tuple[Array, Array],
        drag: Array,
        met: Encounter,
        r: Array,
        h: float,
        theta: float,
    ) -> Departure:
        """What a step ends with.

        Parameters
        ----------
        rows : Rows
        frame : ndarray, shape (nc, 3, 3)
        velocities : (v, v_free)
            At the beginning of the step, and at its end without impulses.
        drag : ndarray, shape (3 rows,)
            What sliding surfaces add to the relative velocities at the end, m/s; empty where there are none.
        met : Encounter
        r : ndarray, shape (3 rows,)
            Impulses.
        h, theta : float
        """
        full, change = rows.full, rows.velocity_change(r)
        n, size, world = change.size, full.nc, (len(frame), 3)
        v, v_theta, push, u = np.empty(n), np.empty(n), np.empty(n), np.empty(r.size)
        after, normal, friction = np.empty(size), np.empty(size), np.empty(size)
        impulse, velocity = np.empty(world), np.empty(world)
        works = _encounter.leave(
            full.offset, full.block, full.start, full.h, *velocities, change, self.change, drag, met.u_before, met.bend,
            met.gap, frame, r, h, theta, v, v_theta, u, after, normal, friction, impulse, velocity, push,
        )  # fmt: skip
        return Departure(change, v, v_theta, u, after, normal, friction, works, impulse, velocity, push)


def foresee_slip(rows: Rows, u_free: Array, met: Encounter) -> Array | None:
    """Offset of tangential velocities that lets friction oppose the slip of the middle of the step, shape (3 rows,).

    None where nothing slides.

    Parameters
    ----------
    rows : Rows
    u_free : ndarray, shape (3 rows,)
        Relative velocities at the end of the step without impulses, m/s.
    met : Encounter
    """
    if met.slides is None:
        return None
    full, curve = rows.full, np.empty(u_free.size)
    change = rows.velocity_change(met.guess)
    _encounter.curve(full.offset, full.block, full.start, full.h, change, met.u_begin, u_free, met.slides, curve)
    return curve


def release_stopped(r: Array, mu: Array, curve: Array | None, every: bool) -> tuple[NDArray[np.int8], bool]:
    """0 open, 1 stick, 2 slip of the contacts, those with a friction coefficient in mu (nc,), from the impulses.

    And whether any that were to slide on, with offsets in `curve`, have stopped: theirs are dropped, or `every`.
    """
    status = np.empty(mu.size, np.int8)
    return status, _encounter.release(r, mu, NOTHING if curve is None else curve, every, status)
