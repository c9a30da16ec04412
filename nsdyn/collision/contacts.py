"""Contacts as values: what is found at a configuration, and between two."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.collision import advancement
from nsdyn.tools.arrays import Array, Bools, Index
from nsdyn.tools.naming import counted

__all__ = ["ContactMemory", "ContactSet", "Looked", "Poses", "Touches", "carry", "joined", "take"]


class ContactSet(NamedTuple):
    """Contacts of one configuration, sorted by (geom1, geom2) with geom1 < geom2.

    Attributes
    ----------
    geom1, geom2 : ndarray, shape (nc,)
        Indices of the geoms.
    frame1, frame2 : ndarray, shape (nc,)
        Moving frames they hang on, -1 for the world.
    point : ndarray, shape (nc, 3)
        World, m.
    normal : ndarray, shape (nc, 3)
        Unit, world, from geom 1 to geom 2.
    gap : ndarray, shape (nc,)
        m, negative where the geoms overlap. Its derivative is normal · (velocity of 2 - velocity of 1) at the point.
    mu, restitution : ndarray, shape (nc,)
    key : ndarray, shape (nc,)
        Names a contact for as long as it lasts; never used twice.
    """

    geom1: Index
    geom2: Index
    frame1: Index
    frame2: Index
    point: Array
    normal: Array
    gap: Array
    mu: Array
    restitution: Array
    key: Index

    def __repr__(self) -> str:
        return f"<ContactSet of {counted(self.gap.size, 'contact')}>"


class ContactMemory(NamedTuple):
    """What it takes to recognise contacts in the next configuration, all of it.

    Attributes
    ----------
    names : ndarray, shape (5, nc)
        Both geoms, both frames, the key.
    points : ndarray, shape (4, nc, 3)
        Point and normal in world axes, the point in the frames of the two geoms; m.
    next_key : int
    """

    names: Index
    points: Array
    next_key: int

    @classmethod
    def empty(cls) -> ContactMemory:
        """Of no contacts: keys start at 0."""
        return cls(np.empty((5, 0), dtype=np.int64), np.empty((4, 0, 3)), 0)

    def joined(self, other: ContactMemory, keys: Index) -> ContactMemory:
        """The same with those of a later configuration that have some keys, unless they are known."""
        more = np.isin(other.names[4], keys) & ~np.isin(other.names[4], self.names[4])
        names = np.concatenate((self.names, other.names[:, more]), axis=1)
        points = np.concatenate((self.points, other.points[:, more]), axis=1)
        order = np.lexsort((names[1], names[0]))
        return ContactMemory(names.take(order, axis=1), points.take(order, axis=1), other.next_key)


class Poses(NamedTuple):
    """Poses of the moving frames, body to world.

    Attributes
    ----------
    x : ndarray, shape (nframes, 3)
        m.
    R : ndarray, shape (nframes, 3, 3)
    """

    x: Array
    R: Array


class Looked(NamedTuple):
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
    memory : ContactMemory
        The one given and these contacts at the end of the way.
    far : ndarray of int
        Codes of pairs that may touch of which a body turns so far that it is not known how: then no other is followed.
    """

    contacts: ContactSet
    fraction: Array
    memory: ContactMemory
    far: Index


def take(contacts: ContactSet, kept: Bools) -> ContactSet:
    """Some of the contacts."""
    return contacts if kept.all() else ContactSet._make([column[kept] for column in contacts])


def joined(some: Iterable[ContactSet]) -> ContactSet:
    """Contacts one after the other."""
    return ContactSet._make([np.concatenate(columns) for columns in zip(*some, strict=True)])


def carry(contacts: ContactSet, begin: Poses, end: Poses, normal: Array | None = None) -> ContactSet:
    """Contacts at poses `begin` whose bodies go to poses `end`.

    The two points of a contact, x ± g n/2, stay fixed in their bodies and go to p1 and p2. With the normal n' there,
    n itself if none is given, the gap becomes n' · (p2 - p1), the point (p1 + p2)/2.
    """
    c, there = contacts, contacts.normal if normal is None else normal
    point, gap = np.empty_like(c.point), np.empty_like(c.gap)
    old = c.frame1, c.frame2, c.point, c.normal, c.gap
    advancement.carry(old, tuple(begin), tuple(end), there, point, gap)
    return c._replace(point=point, normal=there, gap=gap)
