"""Parts of a scene: systems of some of the bodies, and states cut into such and put together again.

What moves freely is a node: a free body or a tree, by the index of its block of coordinates. What stands still or moves
as prescribed is in every part.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.dynamics.dynamics import Controls, Wrenches
from nsdyn.dynamics.values import Placement, Position
from nsdyn.stepping.encounter import Warm
from nsdyn.stepping.instant import Impulses, Instant, System
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Part", "Parts"]

KEPT = 512
"""Most parts that are kept for when they are asked for again."""


class Part:
    """Some nodes of a scene as a system of their own.

    Parameters
    ----------
    whole : System
    nodes : ndarray of int
        Ascending.

    Attributes
    ----------
    system : System
    nodes : ndarray of int
    frames, geoms, coordinates : ndarray of int
        Those of the part in the whole, ascending.
    moved : ndarray of int
        The frames of its nodes.
    """

    def __init__(self, whole: System, nodes: Index) -> None:
        d = whole.dynamics
        mine = np.zeros(d.offset.size, np.bool_)
        mine[nodes] = True
        self.nodes, self._mine = nodes, mine
        self._bodies, self._trees = nodes[nodes < d.free], nodes[nodes >= d.free] - d.free
        free = d.block_of_frame >= 0
        self.frames = np.flatnonzero(mine[d.block_of_frame] | ~free)
        self.moved = self.frames[free[self.frames]]
        frame_of_geom = whole.detector.frame
        self._frame = np.full(d.frames + 1, -1)
        self._frame[self.frames] = np.arange(self.frames.size)
        self.geoms = np.flatnonzero((frame_of_geom < 0) | (self._frame[frame_of_geom] >= 0))
        self._geom = np.full(frame_of_geom.size, -1)
        self._geom[self.geoms] = np.arange(self.geoms.size)
        spans = [np.arange(d.offset[k], d.offset[k + 1]) for k in nodes.tolist()]
        self.coordinates = np.concatenate([np.empty(0, np.int64), *spans])
        self._slots = np.flatnonzero(mine[d.joints.block])
        self._limits = np.flatnonzero(mine[d.joints.block[d.joints.limits]])
        self._owner = np.append(d.block_of_frame, -1)
        self.system = whole.only(
            self._bodies, self._trees, self.frames, self.geoms, self._frame[frame_of_geom[self.geoms]]
        )

    def contacts(self, c: ContactSet) -> ContactSet:
        """Those of the part, of contacts of the whole."""
        kept = self._has(c.frame1, c.frame2)
        c = ContactSet._make([column[kept] for column in c])
        geoms, frames = (self._geom[c.geom1], self._geom[c.geom2]), (self._frame[c.frame1], self._frame[c.frame2])
        return ContactSet(*geoms, *frames, *c[4:])

    def _has(self, frame1: Index, frame2: Index) -> Bools:
        """Whether contacts of such frames are of the part."""
        first, second = self._owner[frame1], self._owner[frame2]
        out: Bools = self._mine[np.where(first >= 0, first, second)]
        return out

    def cut(self, at: Instant, next_key: int) -> Instant:
        """The instant of the part, whose new contacts get names from a number on."""
        p, place, f, k = at.position, at.placement, self.frames, self._trees.tolist()
        position = Position(
            p.x[self._bodies], p.quaternion[self._bodies], tuple([p.trees[j] for j in k]), p.driven_x,
            p.driven_quaternion,
        )  # fmt: skip
        kept = self._has(at.memory.names[2], at.memory.names[3])
        names = at.memory.names[:, kept]
        names[:2], names[2:4] = self._geom[names[:2]], self._frame[names[2:4]]
        memory, w = ContactMemory(names, at.memory.points[:, kept], next_key), at.warm
        pressed = self._has(w.frame1, w.frame2)
        warm = Warm(
            w.key[pressed], self._frame[w.frame1[pressed]], self._frame[w.frame2[pressed]], w.force[pressed],
            w.status[pressed], w.joints[self._slots], None,
        )  # fmt: skip
        return Instant(
            position, at.v[self.coordinates], Placement(place.x[f], place.R[f], tuple([place.links[j] for j in k])),
            self.contacts(at.contacts), at.limits[self._limits], memory, Looked(*(column[f] for column in at.looked)),
            warm, (at.twists[0][f], at.twists[1][f]), tuple([at.energies[j] for j in k]),
        )  # fmt: skip

    def given(self, wrenches: Wrenches | None, controls: Controls) -> tuple[Wrenches | None, Controls]:
        """What the user's functions gave, of the part."""
        place = {k: j for j, k in enumerate(self._trees.tolist())}
        own = {place[k]: law for k, law in controls.items() if k in place}
        if wrenches is None:
            return None, own
        force, torque, applied = wrenches
        pushed = {place[k]: push for k, push in applied.items() if k in place}
        return (force[self._bodies], torque[self._bodies], pushed), own

    def of_whole(self, c: ContactSet) -> ContactSet:
        """Contacts of the part as those of the whole."""
        frames = np.append(self.frames, -1)
        return ContactSet(self.geoms[c.geom1], self.geoms[c.geom2], frames[c.frame1], frames[c.frame2], *c[4:])

    def acted(self, a: Impulses, n: int) -> Impulses:
        """Impulses of the part as those of the whole, of n coordinates."""
        joints = np.zeros((6, n))
        joints[:, self.coordinates] = a.joints
        return a._replace(contacts=self.of_whole(a.contacts), joints=joints)

    def fill(self, at: Instant, end: Instant) -> None:
        """Put what is of the nodes of the part, and no contact, where it is in the whole."""
        p, own, f, mine = at.position, end.position, self.moved, self._frame[self.moved]
        p.x[self._bodies], p.quaternion[self._bodies], at.v[self.coordinates] = own.x, own.quaternion, end.v
        at.limits[self._limits], at.warm.joints[self._slots] = end.limits, end.warm.joints
        for column, given in zip(
            (*at.placement[:2], *at.looked, *at.twists), (*end.placement[:2], *end.looked, *end.twists), strict=True
        ):
            column[f] = given[mine]

    def trees_of(self, whole: Sequence[object], own: Sequence[object]) -> tuple[object, ...]:
        """Values of all trees, of which those of the part are its own."""
        out = list(whole)
        for k, value in zip(self._trees.tolist(), own, strict=True):
            out[k] = value
        return tuple(out)
