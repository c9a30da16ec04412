"""Value types for contacts: those at one configuration, and those found on the way between two."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from nsdyn._kernels import sorting as _sorting
from nsdyn._kernels.collision import advancement
from nsdyn.tools.arrays import NONE, NOTHING, Array, Bools, Index
from nsdyn.tools.naming import counted


class ContactSet(NamedTuple):
    """Contacts of one configuration, sorted by (geom1, geom2) with geom1 < geom2; kernels take its arrays.

    Attributes
    ----------
    names : ndarray of int, shape (5, nc)
        Indices of both geoms; frames of both geoms, -1 for the world; key. The key identifies a contact for as long as
        it lasts, and is never used twice.
    points : ndarray, shape (4, nc, 3)
        Point, world, m; normal, unit, world, from geom 1 to geom 2; the point where it was found in the axes of geom 1
        and of geom 2, m. The last two identify the contact in the next configuration.
    scalars : ndarray, shape (3, nc)
        Gap, m, negative for penetration; mu; restitution. The derivative of the gap is normal · (velocity of 2 -
        velocity of 1) at the point.
    next_key : int
        The first unused key.
    """

    names: Index
    points: Array
    scalars: Array
    next_key: int

    @classmethod
    def empty(cls) -> ContactSet:
        """Return an empty set; the first contact found after it gets the key 0."""
        return cls(np.empty((5, 0), np.int64), np.empty((4, 0, 3)), np.empty((3, 0)), 0)

    @property
    def geom1(self) -> Index:
        """First geoms, shape (nc,)."""
        return self.names[0, :]

    @property
    def geom2(self) -> Index:
        """Second geoms, shape (nc,)."""
        return self.names[1, :]

    @property
    def frame1(self) -> Index:
        """Frames of the first geoms, shape (nc,)."""
        return self.names[2, :]

    @property
    def frame2(self) -> Index:
        """Frames of the second geoms, shape (nc,)."""
        return self.names[3, :]

    @property
    def key(self) -> Index:
        """Keys, shape (nc,)."""
        return self.names[4, :]

    @property
    def point(self) -> Array:
        """Shape (nc, 3), m."""
        return self.points[0, :]

    @property
    def normal(self) -> Array:
        """Shape (nc, 3)."""
        return self.points[1, :]

    @property
    def gap(self) -> Array:
        """Shape (nc,), m."""
        return self.scalars[0, :]

    @property
    def mu(self) -> Array:
        """Shape (nc,)."""
        return self.scalars[1, :]

    @property
    def restitution(self) -> Array:
        """Shape (nc,)."""
        return self.scalars[2, :]

    def __repr__(self) -> str:
        return f"<ContactSet of {counted(self.gap.size, 'contact')}>"

    def joined(self, other: ContactSet, keys: Index) -> ContactSet:
        """Return the contacts, and from a later configuration those with the given keys, unless already present."""
        more = np.isin(other.key, keys) & ~np.isin(other.key, self.key)
        return united((self, take(other, more)))._replace(next_key=other.next_key)


class Poses(Protocol):
    """Any object with poses of the moving frames, body to world."""

    @property
    def x(self) -> Array:
        """Origins, shape (nframes, 3), m."""

    @property
    def R(self) -> Array:
        """Orientations, shape (nframes, 3, 3)."""


class DetectionPose(NamedTuple):
    """Poses of a contact detection, and the reach of the frames.

    Attributes
    ----------
    x, R : ndarray, shapes (frames, 3), (frames, 3, 3)
    reach : ndarray, shape (frames,)
        m.
    """

    x: Array
    R: Array
    reach: Array


class Touches(NamedTuple):
    """Pairs of geoms that touch on the way from one configuration to another.

    Attributes
    ----------
    codes : ndarray of int, shape (k,)
        Codes of the pairs.
    fraction : ndarray, shape (k,)
        Part of the way in [0, 1] at which the pair touches.
    R, t : ndarray, shapes (k, 2, 3, 3), (k, 2, 3)
        Poses of both geoms then, m.
    far : ndarray of int
        Codes of pairs that may touch and of which one body turns so far that its rotation is ambiguous. If there are
        any, no pair is followed.
    """

    codes: Index
    fraction: Array
    R: Array
    t: Array
    far: Index


NO_TOUCHES = Touches(NONE, NOTHING, np.empty((0, 2, 3, 3)), np.empty((0, 2, 3)), NONE)


def take(contacts: ContactSet, kept: Bools) -> ContactSet:
    """Return the contacts that `kept` selects."""
    return contacts if kept.all() else ordered(contacts, np.flatnonzero(kept))


def ordered(contacts: ContactSet, order: Index) -> ContactSet:
    """Return the contacts with the given indices, in that order."""
    names, points, scalars, next_key = contacts
    rows = names.take(order, axis=1), points.take(order, axis=1), scalars.take(order, axis=1)
    return ContactSet(*rows, next_key)


def joined(some: Iterable[ContactSet]) -> ContactSet:
    """Concatenate contacts."""
    *columns, next_keys = zip(*some, strict=True)
    names, points, scalars = (np.concatenate(parts, axis=1) for parts in columns)
    return ContactSet(names, points, scalars, max(next_keys))


def united(some: Iterable[ContactSet]) -> ContactSet:
    """Concatenate contacts and sort them by pairs; contacts of one pair keep their order."""
    out = joined(some)
    return ordered(out, np.lexsort((out.geom2, out.geom1)))


def carry(contacts: ContactSet, begin: Poses, end: Poses, normal: Array | None = None) -> ContactSet:
    """Move contacts from the poses `begin` of their bodies to the poses `end`.

    The two points of a contact, x ± g n/2, stay fixed in their bodies and move to p1 and p2. With the new normal n',
    which is n if none is given, the gap becomes n' · (p2 - p1), and the point (p1 + p2)/2.
    """
    c, there = contacts, contacts.normal if normal is None else normal
    out = c._replace(points=c.points.copy(), scalars=c.scalars.copy())
    advancement.carry(out[:3], (begin.x, begin.R), (end.x, end.R), there)
    return out


def among(x: Index, some: Index) -> Bools:
    """Mark the elements of x (n,) that are among some: in small arrays ten times as fast as NumPy."""
    out = np.empty(x.size, np.bool_)
    _sorting.among(x, some, out)
    return out
