"""Motion of the bodies at each contact: at the start of its piece of the step, and before and after its impulse."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.audit.poses import CONJUGATE
from nsdyn.recording.series import rotate
from nsdyn.tools.arrays import Array, Bools, Index


class Side(NamedTuple):
    """Bodies on one side of contacts, one by one; world axes.

    Attributes
    ----------
    x, quaternion : ndarray, shapes (m, 3), (m, 4)
        Pose at the time of the impulse, m.
    v : ndarray, shape (3, m, 3)
        Velocities of the body's point: at the start of the piece of the step, with the point carried back by the body,
        then before and after all that acts together with the impulse, m/s.
    spin : ndarray, shape (2, m, 3)
        Angular velocities before and after, rad/s.
    back : ndarray, shape (m, 4)
        Rotation from the time of the impulse back to the start of the piece.
    """

    x: Array
    quaternion: Array
    v: Array
    spin: Array
    back: Array

    @classmethod
    def nowhere(cls, m: int) -> Side:
        """Build m bodies whose motion is unknown (NaN)."""
        shapes = (m, 3), (m, 4), (3, m, 3), (2, m, 3), (m, 4)
        return cls(*(np.full(shape, np.nan) for shape in shapes))

    @classmethod
    def still(cls, m: int) -> Side:
        """Build m bodies that do not move; their poses stay NaN."""
        out = cls.nowhere(m)
        for values in out[2:4]:
            values[:] = 0.0
        out.back[:] = 0.0, 0.0, 0.0, 1.0
        return out

    def put(self, rows: Index, other: Side) -> None:
        """Copy `other` into the given rows."""
        for own, new, axis in zip(self, other, (0, 0, 1, 1, 0), strict=True):
            own[(slice(None),) * axis + (rows,)] = new

    def some(self, rows: Index | Bools) -> Side:
        """Return the given rows."""
        return Side(*(x[(slice(None),) * axis + (rows,)] for x, axis in zip(self, (0, 0, 1, 1, 0), strict=True)))


class Meetings(NamedTuple):
    """Relative motion at each contact; NaN where the motion of a body is unknown.

    Attributes
    ----------
    sides : (Side, Side)
        The first and the second bodies.
    begin : ndarray, shape (3, contacts, 3)
        Relative velocity at the start of the piece of the step, m/s, in a frame fixed in space, one that turns with the
        first body, and one that turns with the second.
    before, after : ndarray, shape (contacts, 3)
        Relative velocity before and after all that acts with the impulse, in the frame of the contact, m/s.
    spin : ndarray, shape (contacts, 3)
        Angular velocity of the second body relative to the first, mean of before and after, world axes, rad/s.
    bent : ndarray, shape (contacts,)
        Largest rate at which relative velocities change by rotation, of bodies and of normals of round shapes, m/s².
    """

    sides: tuple[Side, Side]
    begin: Array
    before: Array
    after: Array
    spin: Array
    bent: Array

    @property
    def mean(self) -> Array:
        """Mean of the relative velocities before and after."""
        return 0.5 * (self.before + self.after)

    @classmethod
    def of(cls, sides: tuple[Side, Side], axes: Array, point: Array, rounding: Array, wander: Array) -> Meetings:
        """Build from frames (contacts, 3, 3) with axes as rows, points, and sums of both radii of curvature, m.

        `wander` is the mean speed at which contacts move, m/s: where bodies roll, to other points of them.
        """
        one, other = sides
        apart = other.v - one.v
        begin, before, after = (np.einsum("cij,cj->ci", axes, v) for v in apart)
        # u_i = a_i · v with axes a turned back equals a_i · (v turned forward).
        turned = [np.einsum("cij,cj->ci", axes, rotate(s.back * CONJUGATE, apart[0])) for s in sides]
        speed = np.linalg.norm(apart, axis=2).max(axis=0)
        # Sliding around a round shape turns the normal; corners and faces turn it with their bodies.
        bent = speed * speed / np.where(rounding > 0.0, rounding, np.inf)
        for side in sides:
            # Rotation changes a body's axes at the rate ω, and ω itself no faster than that. What gets faster moves at
            # up to twice its mean speed.
            turning = np.linalg.norm(side.spin, axis=2).max(axis=0)
            arm = np.where(turning > 0.0, np.linalg.norm(point - side.x, axis=1), 0.0)
            bent += turning * (speed + 2.0 * wander + 2.0 * turning * arm)
        spin = (other.spin - one.spin).mean(axis=0)
        return cls(sides, np.stack([begin, *turned]), before, after, spin, bent)
