"""How bodies move at each contact where its step begins, and before and after its impulse."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.audit.poses import CONJUGATE
from nsdyn.recording.series import rotate
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Meetings", "Side"]


class Side(NamedTuple):
    """Bodies at contacts, one by one; world axes.

    Attributes
    ----------
    x, quaternion : ndarray, shapes (m, 3), (m, 4)
        Where they are when the impulse acts, m.
    v : ndarray, shape (3, m, 3)
        Velocities of their points: where the piece of the step begins, as the bodies carry the point, before and after
        all that acts with the impulse, m/s.
    spin : ndarray, shape (2, m, 3)
        How they turn before and after, rad/s.
    back : ndarray, shape (m, 4)
        How they turn back from there to where the piece begins.
    """

    x: Array
    quaternion: Array
    v: Array
    spin: Array
    back: Array

    @classmethod
    def nowhere(cls, m: int) -> Side:
        """Of m bodies that are not known."""
        shapes = (m, 3), (m, 4), (3, m, 3), (2, m, 3), (m, 4)
        return cls(*(np.full(shape, np.nan) for shape in shapes))

    @classmethod
    def still(cls, m: int) -> Side:
        """Of m bodies that do not move; where they are is not told."""
        out = cls.nowhere(m)
        for values in out[2:4]:
            values[:] = 0.0
        out.back[:] = 0.0, 0.0, 0.0, 1.0
        return out

    def put(self, rows: Index, other: Side) -> None:
        """Those of `other` in some rows."""
        for own, new, axis in zip(self, other, (0, 0, 1, 1, 0), strict=True):
            own[(slice(None),) * axis + (rows,)] = new

    def some(self, rows: Index | Bools) -> Side:
        """Some of them."""
        return Side(*(x[(slice(None),) * axis + (rows,)] for x, axis in zip(self, (0, 0, 1, 1, 0), strict=True)))


class Meetings(NamedTuple):
    """Of each contact; NaN where what moves is not known.

    Attributes
    ----------
    sides : (Side, Side)
        The first and the second bodies.
    begin : ndarray, shape (3, contacts, 3)
        Relative velocity where the piece of the step begins, in a frame that stays in space, turns with the first body,
        and with the second, m/s.
    before, after : ndarray, shape (contacts, 3)
        The same before and after all that acts with the impulse, in the frame of the contact.
    spin : ndarray, shape (contacts, 3)
        How the second body turns on the first, the mean of before and after, world axes, rad/s.
    bent : ndarray, shape (contacts,)
        Most that relative velocities change in a second by what turns, bodies and normals of what is round, m/s².
    """

    sides: tuple[Side, Side]
    begin: Array
    before: Array
    after: Array
    spin: Array
    bent: Array

    @property
    def mean(self) -> Array:
        """The mean of before and after."""
        out: Array = 0.5 * (self.before + self.after)
        return out

    @classmethod
    def of(cls, sides: tuple[Side, Side], axes: Array, point: Array, rounding: Array, wander: Array) -> Meetings:
        """From frames (contacts, 3, 3), whose rows are axes, points, and sums of the radii of curvature of both, m.

        And from how fast contacts move, m/s: where bodies roll other points of theirs meet.
        """
        one, other = sides
        apart = other.v - one.v
        begin, before, after = (np.einsum("cij,cj->ci", axes, v) for v in apart)
        # u_i = a_i · v with the axes a turned back: of what is turned forth.
        turned = [np.einsum("cij,cj->ci", axes, rotate(s.back * CONJUGATE, apart[0])) for s in sides]
        speed = np.linalg.norm(apart, axis=2).max(axis=0)
        # What slides around what is round turns the normal; corners and faces turn it with their bodies.
        bent = speed * speed / np.where(rounding > 0.0, rounding, np.inf)
        for side in sides:
            # What turns changes its axes by as much, and its own ω no faster than that.
            turning = np.linalg.norm(side.spin, axis=2).max(axis=0)
            arm = np.where(turning > 0.0, np.linalg.norm(point - side.x, axis=1), 0.0)
            bent += turning * (speed + wander + 2.0 * turning * arm)
        spin = (other.spin - one.spin).mean(axis=0)
        return cls(sides, np.stack([begin, *turned]), before, after, spin, bent)
