"""Subsystems: systems of some nodes of a scene. States are split into subsystems and merged again.

A node is a free body or a tree; its index is that of its block of coordinates. Every subsystem has all fixed and all
kinematic (prescribed) bodies. "Whole" is the system of all nodes, "part" a subsystem.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from nsdyn._kernels.dynamics import motion as _motion
from nsdyn.collision.contacts import ContactSet, DetectionPose, among, take, united
from nsdyn.dynamics.dynamics import Controls, Wrenches
from nsdyn.dynamics.values import Placement, Position
from nsdyn.stepping.impulses import Impulses
from nsdyn.stepping.midpoint import Callbacks, Given, Loads
from nsdyn.stepping.move_kernel import MoveKernel
from nsdyn.stepping.scene_state import SceneState, System, WarmStart
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Bools, Index

T = TypeVar("T")


class Subsystem:
    """A system of some nodes of a scene.

    Attributes
    ----------
    system : System
    nodes, geoms, coordinates : ndarray of int
        Indices in the whole system of the nodes, geoms and coordinates of the subsystem, ascending.
    """

    def __init__(self, whole: System, nodes: Index) -> None:
        d, frame_of_geom = whole.dynamics, whole.detector.frame
        self.nodes, self._bodies, self._trees = nodes, nodes[nodes < d.free], nodes[nodes >= d.free] - d.free
        self._whole = d
        mine = among(d.node[:-1], nodes)
        self._frames = np.append(np.flatnonzero(mine | (d.node[:-1] < 0)), -1)
        self._moved, frames = np.flatnonzero(mine), self._frames[:-1]
        self._frame = np.full(d.frames + 1, -1)
        self._frame[frames] = np.arange(frames.size)
        self.geoms = np.flatnonzero((frame_of_geom < 0) | (self._frame[frame_of_geom] >= 0))
        self._geom, self._frame_of_geom = np.full(frame_of_geom.size, -1), frame_of_geom
        self._geom[self.geoms] = np.arange(self.geoms.size)
        spans = [np.arange(d.offset[k], d.offset[k + 1]) for k in nodes.tolist()]
        self.coordinates = np.concatenate([np.empty(0, np.int64), *spans])
        first = np.cumsum([0, *(t.model.njoints - 1 for t in d.trees)])
        spans = [np.arange(first[k], first[k + 1]) for k in self._trees.tolist()]
        self._links, self._count = np.concatenate([np.empty(0, np.int64), *spans]), (d.n - 6 * d.free, d.links, d.free)
        self._columns = self.coordinates[6 * self._bodies.size :] - 6 * d.free
        block = d.joints.block
        self._slots = np.flatnonzero(among(block, nodes))
        self._limits = np.flatnonzero(among(block[d.joints.limits], nodes))
        own = whole._replace(
            dynamics=d.only(self._bodies, self._trees, self.geoms),
            detector=whole.detector.only(self.geoms, self._frame[frame_of_geom[self.geoms]]),
            inscribed=whole.inscribed[self.geoms],
            rounding=whole.rounding[self.geoms],
        )
        self.system = own._replace(mover=MoveKernel(own)) if whole.mover is not None else own

    def _has(self, frame1: Index, frame2: Index) -> Bools:
        """Which contacts, given by their two frames, belong to the subsystem."""
        return among(self._whole.node_of(frame1, frame2), self.nodes)

    def cut(self, at: SceneState, next_key: int) -> SceneState:
        """Return the state of the subsystem; keys of its new contacts start at `next_key`."""
        p, place, w, frames, trees = at.position, at.placement, at.warm, self._frames[:-1], self._trees.tolist()
        position = Position(
            p.x[self._bodies],
            p.quaternion[self._bodies],
            tuple([p.trees[k] for k in trees]),
            p.driven_x,
            p.driven_quaternion,
        )
        contacts = memory = self._own(at.contacts, next_key)
        if at.memory is not at.contacts:
            memory = self._own(at.memory, next_key)
        geoms = np.divmod(w.pair, self._geom.size)
        kept = self._has(*(self._frame_of_geom[g] for g in geoms))
        first, second = (self._geom[g[kept]] for g in geoms)
        warm = WarmStart(
            w.key[kept], first * self.geoms.size + second, w.force[kept], w.status[kept], w.joints[self._slots]
        )
        there = Placement(place.x[frames], place.R[frames], tuple([place.links[k] for k in trees]))
        return SceneState(
            position,
            at.v[self.coordinates],
            there,
            contacts,
            at.limits[self._limits],
            memory,
            DetectionPose._make([column[frames] for column in at.detected_at]),
            warm,
            (at.twists[0][frames], at.twists[1][frames]),
            tuple([at.energies[k] for k in trees]),
        )

    def _own(self, c: ContactSet, next_key: int) -> ContactSet:
        """Contacts of the whole system that belong to the subsystem, in the indices of the subsystem."""
        return _renamed(take(c, self._has(c.frame1, c.frame2)), self._geom, self._frame)._replace(next_key=next_key)

    def given(self, wrenches: Wrenches | None, controls: Controls) -> tuple[Wrenches | None, Controls]:
        """Forces and controls of the user's functions, cut to the subsystem."""
        trees = self._trees.tolist()
        own = {j: controls[k] for j, k in enumerate(trees) if k in controls}
        if wrenches is None:
            return None, own
        loads, applied = wrenches
        pushed = {j: applied[k] for j, k in enumerate(trees) if k in applied}
        return ({name: load[:, self._bodies] for name, load in loads.items()}, pushed), own

    def loads(self, loads: Loads, at: SceneState) -> Loads:
        """The user's callbacks for the subsystem; other nodes of the whole stay where they are in the state `at`."""

        def of_part(t: float) -> Callbacks:
            if (said := loads(t)) is None:
                return None

            def at_position(position: Position, v: Array) -> Given:
                p = at.position
                x, quaternion, all_v = p.x.copy(), p.quaternion.copy(), at.v.copy()
                x[self._bodies], quaternion[self._bodies] = position.x, position.quaternion
                all_v[self.coordinates] = v
                trees = self.among(p.trees, position.trees)
                return self.given(*said(Position(x, quaternion, trees, *position[3:]), all_v))

            return at_position

        return of_part

    def state(self, whole: State, next_key: int) -> State:
        """The state of the subsystem; keys of its new contacts start at `next_key`."""
        return whole._replace(instant=self.cut(whole.instant, next_key), rate=whole.rate[self.coordinates])

    def contacts(self, c: ContactSet) -> ContactSet:
        """Contacts of the subsystem in the indices of the whole system."""
        return _renamed(c, self.geoms, self._frames)

    def warm(self, w: WarmStart) -> WarmStart:
        """The warm start of the subsystem in the indices of the whole system, except for the joints."""
        first, second = np.divmod(w.pair, self.geoms.size)
        return w._replace(pair=self.geoms[first] * self._geom.size + self.geoms[second])

    def impulses(self, a: Impulses) -> Impulses:
        """Impulses of the subsystem in the indices of the whole system."""
        nv, all_links, _ = self._count
        joints, moves, links = np.zeros((8, nv)), np.zeros(nv, np.bool_), np.zeros((all_links, 6))
        joints[:, self._columns], links[self._links], moves[self._columns] = a.joints, a.links, True
        a = a._replace(wrench=self._of_bodies(a.wrench), lift=self._of_bodies(a.lift))
        return a._replace(contacts=self.contacts(a.contacts), joints=joints, links=links, moves=moves)

    def _of_bodies(self, own: Array | None) -> Array | None:
        """Wrenches on the free bodies of the subsystem, as an array (free, 6) of the whole system."""
        if own is None:
            return None
        out = np.zeros((self._count[2], 6))
        out[self._bodies] = own
        return out

    def fill(self, at: SceneState, end: SceneState) -> None:
        """Write the state `end` of the subsystem, without its contacts, into the arrays of the whole state `at`."""
        p, own, mine = at.position, end.position, self._frame[self._moved]
        p.x[self._bodies], p.quaternion[self._bodies], at.v[self.coordinates] = own.x, own.quaternion, end.v
        at.limits[self._limits], at.warm.joints[self._slots] = end.limits, end.warm.joints
        of_frames = [(*i.placement[:2], *i.detected_at, *i.twists) for i in (at, end)]
        for column, given in zip(*of_frames, strict=True):
            column[self._moved] = given[mine]

    def among(self, all_trees: Sequence[T], own: Sequence[T]) -> tuple[T, ...]:
        """Values of all trees, with the subsystem's trees replaced by its `own` values."""
        out = list(all_trees)
        for k, value in zip(self._trees.tolist(), own, strict=True):
            out[k] = value
        return tuple(out)


def merged(whole: System, base: SceneState, left: Bools, parts: Sequence[tuple[Subsystem, SceneState]]) -> SceneState:
    """Merge the states of subsystems with the nodes `left` (nodes,) of a whole state `base` into one whole state."""
    out, p, w = _copied(base), base.position.trees, base.warm
    links, energies = base.placement.links, base.energies
    frames = (whole.detector.frame[g] for g in np.divmod(w.pair, whole.inscribed.size))
    pressed = left[whole.dynamics.node_of(*frames)]
    warm = [[x[pressed] for x in _columns(w)]]
    contacts, memory = ([take(c, left[whole.nodes(c)])] for c in (base.contacts, base.memory))
    for part, end in parts:
        part.fill(out, end)
        p, links = part.among(p, end.position.trees), part.among(links, end.placement.links)
        energies = part.among(energies, end.energies)
        contacts.append(part.contacts(end.contacts))
        memory.append(part.contacts(end.memory))
        warm.append(_columns(part.warm(end.warm)))
    key, pair, force, status = [np.concatenate(columns) for columns in zip(*warm, strict=True)]
    return out._replace(
        position=out.position._replace(trees=p),
        placement=out.placement._replace(links=links),
        energies=energies,
        contacts=united(contacts),
        memory=united(memory),
        warm=WarmStart(key, pair, force, status, out.warm.joints),
    )


def _renamed(c: ContactSet, geoms: Index, frames: Index) -> ContactSet:
    """Contacts whose indices of geoms and of frames are replaced by `geoms[i]` and `frames[i]`."""
    return c._replace(names=np.concatenate((geoms[c.names[:2]], frames[c.names[2:4]], c.names[4:])))


def driven(at: SceneState, x: Array, quaternion: Array) -> SceneState:
    """The state with the kinematic bodies at the poses x (nd, 3), quaternion (nd, 4)."""
    out, own = _copied(at), slice(-len(x), None)
    out.placement.x[own] = x
    _motion.rotations(quaternion, out.placement.R[own])
    out.detected_at.x[own], out.detected_at.R[own], out.detected_at.reach[own] = x, out.placement.R[own], 0.0
    return out._replace(position=out.position._replace(driven_x=x, driven_quaternion=quaternion))


def _columns(w: WarmStart) -> list[Any]:
    """The columns per contact of a warm start."""
    return [w.key, w.pair, w.force, w.status]


def _copied(at: SceneState) -> SceneState:
    """The same state with copies of the arrays that subsystems write into."""
    p, w = at.position, at.warm
    return at._replace(
        position=p._replace(x=p.x.copy(), quaternion=p.quaternion.copy()),
        v=at.v.copy(),
        limits=at.limits.copy(),
        placement=at.placement._replace(x=at.placement.x.copy(), R=at.placement.R.copy()),
        detected_at=DetectionPose._make([column.copy() for column in at.detected_at]),
        warm=w._replace(joints=w.joints.copy()),
        twists=(at.twists[0].copy(), at.twists[1].copy()),
    )
