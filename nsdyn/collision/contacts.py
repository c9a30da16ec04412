"""Contacts as values: what is found at a configuration, and between two."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from nsdyn._kernels.collision import advancement
from nsdyn.tools.arrays import Array, Bools, Index
from nsdyn.tools.naming import counted

__all__ = ["ContactSet", "DetectionPose", "Poses", "Touches", "carry", "joined", "ordered", "take", "united"]


class ContactSet(NamedTuple):
    """Contacts of one configuration, sorted by (geom1, geom2) with geom1 < geom2; kernels take its arrays.

    Attributes
    ----------
    names : ndarray of int, shape (5, nc)
        Indices of both geoms; moving frames they hang on, -1 for the world; key, which names a contact for as long as
        it lasts, and is never used twice.
    points : ndarray, shape (4, nc, 3)
        Point, world, m; normal, unit, world, from geom 1 to geom 2; where it was found, the point in the axes of either
        geom, m: by these it is recognised in the next configuration.
    scalars : ndarray, shape (3, nc)
        Gap, m, negative where the geoms overlap, whose derivative is normal · (velocity of 2 - velocity of 1) at the
        point; mu; restitution.
    next_key : int
        The first that no contact has.
    """

    names: Index
    points: Array
    scalars: Array
    next_key: int

    @classmethod
    def empty(cls) -> ContactSet:
        """No contacts, of which the first has the key 0."""
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
        """Names that last, shape (nc,)."""
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
        """The same with those of a later configuration that have some keys, unless they are known."""
        more = np.isin(other.key, keys) & ~np.isin(other.key, self.key)
        return united((self, take(other, more)))._replace(next_key=other.next_key)


class Poses(Protocol):
    """Whatever has poses of the moving frames, body to world."""

    @property
    def x(self) -> Array:
        """Origins, shape (nframes, 3), m."""

    @property
    def R(self) -> Array:
        """Orientations, shape (nframes, 3, 3)."""


class DetectionPose(NamedTuple):
    """Where contacts were looked for, and how far.

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
    """Contacts of the pairs that touch on the way from one configuration to another.

    Attributes
    ----------
    contacts : ContactSet
        As they are when the pair touches, carried to the end of the way by `carry`.
    fraction : ndarray, shape (nc,)
        Part of the way in [0, 1] at which the pair touches.
    memory : ContactSet
        Those given and these contacts at the end of the way.
    far : ndarray of int
        Codes of pairs that may touch of which a body turns so far that it is not known how: then no other is followed.
    """

    contacts: ContactSet
    fraction: Array
    memory: ContactSet
    far: Index


def take(contacts: ContactSet, kept: Bools) -> ContactSet:
    """Some of the contacts."""
    return contacts if kept.all() else ordered(contacts, np.flatnonzero(kept))


def ordered(contacts: ContactSet, order: Index) -> ContactSet:
    """Those of such indices, in their order."""
    names, points, scalars, next_key = contacts
    rows = names.take(order, axis=1), points.take(order, axis=1), scalars.take(order, axis=1)
    return ContactSet(*rows, next_key)


def joined(some: Iterable[ContactSet]) -> ContactSet:
    """Contacts one after the other."""
    *columns, next_keys = zip(*some, strict=True)
    names, points, scalars = (np.concatenate(parts, axis=1) for parts in columns)
    return ContactSet(names, points, scalars, max(next_keys))


def united(some: Iterable[ContactSet]) -> ContactSet:
    """Contacts sorted by their pairs, those of one as they come."""
    out = joined(some)
    return ordered(out, np.lexsort((out.geom2, out.geom1)))


def carry(contacts: ContactSet, begin: Poses, end: Poses, normal: Array | None = None) -> ContactSet:
    """Contacts at poses `begin` whose bodies go to poses `end`.

    The two points of a contact, x ± g n/2, stay fixed in their bodies and go to p1 and p2. With the normal n' there,
    n itself if none is given, the gap becomes n' · (p2 - p1), the point (p1 + p2)/2.
    """
    c, there = contacts, contacts.normal if normal is None else normal
    out = c._replace(points=c.points.copy(), scalars=c.scalars.copy())
    advancement.carry(out[:3], (begin.x, begin.R), (end.x, end.R), there)
    return out
