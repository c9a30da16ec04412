"""Contact detection: candidate pairs from bounding boxes, touching features from Coal, exact points from the features.

Coal's own contact points are not used: its patches lose points, share one depth among all of them and are noisy near
gap 0. It is asked only for the distance and the direction of each pair; `nsdyn._kernels.collision.manifold` computes
normals, points and gaps from the faces, edges and curved surfaces that this direction singles out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from nsdyn._kernels import sorting
from nsdyn._kernels.collision import advancement, broadphase, keys, manifold, search
from nsdyn._kernels.collision.geometry import Geometry, Placed
from nsdyn._kernels.packing import pack
from nsdyn.collision.contacts import ContactMemory, ContactSet, Poses, Touches, carry
from nsdyn.collision.distances import SHRINK, Batch, distance_request, empty_model, split
from nsdyn.scene.bodies import Geom
from nsdyn.scene.shapes import HALFSPACE, ROUND
from nsdyn.tools.arrays import Array, Index

__all__ = ["Detector"]

MARGIN = 1e-3
"""Contacts start at a gap of this fraction of the smaller bounding radius, plus what the bodies may move in a step."""

SKIN = 0.05
"""The candidate pairs serve until a geom has moved this fraction of its bounding radius, and beyond that as far as it
may in as many steps as the pairs before them served, at most `AHEAD`: where bodies knock each other about, a list that
looks far ahead is long and outlived in a step all the same."""

AHEAD = 4

TOLERANCE = 0.05
"""A contact keeps its key while it moves less than this fraction of the smaller bounding radius, on either geom, beyond
what the geoms themselves may move in the step."""

TOUCH = 1e-4
"""Bodies closer than this fraction of the smaller bounding radius, and approaching, touch on their way."""

ADVANCES = 200
"""Most advances of a pair along its motion; one that is still close then, and not past, counts as touching."""

_NONE, _NOWHERE, _NOTHING = np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty(0)
_NO_CONTACTS = ContactSet(_NONE, _NONE, _NONE, _NONE, _NOWHERE, _NOWHERE, _NOTHING, _NOTHING, _NOTHING, _NONE)


class Detector:
    """Finds the contacts of a fixed list of geoms in any configuration.

    A function of its arguments: what it keeps between calls (candidate pairs, models of Coal) changes no result.

    Parameters
    ----------
    geoms : sequence of Geom
        Half-spaces must be fixed.
    pair_material : callable
        ``pair_material(i, j) -> (mu, restitution)`` for index arrays of pairs.
    excluded : collection of (int, int)
        Pairs of geoms that never touch. Pairs of fixed geoms and those on one frame are left out anyway.
    max_points : int
        Most contacts of one pair, at least 4. More are reduced to those that hold the area of the patch.
    """

    def __init__(
        self,
        geoms: Sequence[Geom],
        pair_material: Callable[[Index, Index], tuple[Array, Array]],
        excluded: Collection[tuple[int, int]] = (),
        max_points: int = 8,
    ) -> None:
        if max_points < 4:
            raise ValueError(f"max_points must be at least 4, got {max_points}")
        for g in geoms:
            if g.shape.kind == HALFSPACE and g.frame >= 0:
                raise ValueError(f"halfspace {g.name!r} must be fixed, not on a moving frame")
        n = len(geoms)
        self._geoms, self._max_points = list(geoms), max_points
        self._pair_material = pair_material
        self._excluded = np.unique(np.array([min(p) * n + max(p) for p in excluded], dtype=np.int64))
        self._geometry = _flatten(geoms)
        self.fields = self._fields = tuple(self._geometry)
        cores: dict[int, Any] = {id(g.shape): g.shape.core(SHRINK) for g in geoms}
        self._solids = [g.shape.geometry for g in geoms]
        for solid in (*cores.values(), *self._solids):
            solid.computeLocalAABB()
        self._cores = [cores[id(g.shape)] for g in geoms]
        self._slack = np.where(np.isin(self._geometry.kind, ROUND), 0.0, 2.0 * SHRINK * self._geometry.radius)
        self.frame = self._frame = self._geometry.frame
        self._moving = self._frame >= 0
        self._R = self._geometry.placement_R.copy()
        self._t = self._geometry.placement_t.copy()
        arm = np.linalg.norm(self._t, axis=1) + self._geometry.radius
        self._arm = np.where(self._moving, arm, 0.0)  # farthest any point is from the origin of its frame
        self.base = self._base = np.where(self._moving, MARGIN * self._geometry.radius, 0.0)
        self._reach = np.zeros(n)
        self._lower, self._upper = np.empty((n, 3)), np.empty((n, 3))
        for k in range(n):
            broadphase.bound(Placed._make((*self._geometry, self._R, self._t)), k, self._lower, self._upper)
        self._fat_lower, self._fat_upper = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
        self._served = 0  # calls served by the present candidates
        self._batches: list[Batch] = []
        self._models: list[pin.GeometryModel] = []
        # Largest polygon: a face clipped by a face or by a circle, or all vertices against a half-space.
        loops = np.diff(self._geometry.loop_ptr).max(initial=max_points)
        room = int(max(4 * max(loops, max_points), np.diff(self._geometry.vertex_ptr).max(initial=0)))
        faces = int(np.diff(self._geometry.face_ptr).max(initial=2))
        points = np.empty((faces * room, 3)), np.empty(faces * room)
        self._scratch = np.empty((room, 3)), np.empty((room, 3)), np.empty(room), *points
        self._pack_geoms()
        self._set_pairs(np.empty(0, dtype=np.int64))

    def only(self, geoms: Index, frame: Index) -> Detector:
        """That of some geoms, ascending, which finds the same contacts among them.

        Parameters
        ----------
        geoms : ndarray of int, shape (k,)
        frame : ndarray of int, shape (k,)
            Frames they hang on there.
        """
        some = [replace(self._geoms[g], frame=f) for g, f in zip(geoms.tolist(), frame.tolist(), strict=True)]
        place = np.full(len(self._geoms), -1)
        place[geoms] = np.arange(geoms.size)
        apart = place[np.array(np.divmod(self._excluded, len(self._geoms)))].T
        excluded = [(int(i), int(j)) for i, j in apart if i >= 0 and j >= 0]
        return Detector(some, lambda i, j: self._pair_material(geoms[i], geoms[j]), excluded, self._max_points)

    def boxes(self, x: Array, R: Array) -> tuple[Array, Array]:
        """Least boxes about the geoms of frames at such poses, along the axes: (lower, upper), (geoms, 3) each, m."""
        lower, upper = self._lower.copy(), self._upper.copy()
        broadphase.bounds(self._fields, x, R, lower, upper)
        return lower, upper

    @property
    def pairs(self) -> tuple[Index, Index]:
        """The candidate pairs of geoms, sorted."""
        return self._first, self._second

    @property
    def asks(self) -> bool:
        """Whether Coal is asked of any candidate pair."""
        return bool(self._batches)

    @property
    def searches(self) -> tuple[Any, ...]:
        """What `nsdyn._kernels.collision.search.search` takes first: geoms, pairs, most points of a pair, tolerance."""
        return self._search

    def codes(self, contacts: ContactSet) -> Index:
        """One number for the pair of geoms of every contact, shape (nc,)."""
        return contacts.geom1 * len(self._cores) + contacts.geom2

    def find(self, x: Array, R: Array, reach: Array, memory: ContactMemory) -> tuple[ContactSet, ContactMemory]:
        """Contacts of a configuration.

        Parameters
        ----------
        x, R : ndarray, shapes (nframes, 3), (nframes, 3, 3)
            Poses of the moving frames, body to world; m.
        reach : ndarray, shape (nframes,)
            How far any point of the frame's geoms may still move, m. Contacts up to a gap of the sum of both reaches
            (and `MARGIN` of the size) are found.
        memory : ContactMemory
            Of the configuration whose contacts go on: those found again keep their keys.

        Returns
        -------
        ContactSet
        ContactMemory
            To go on from these contacts.
        """
        poses, placed = (x, R, reach), bool(self._batches)
        if placed:
            self.ask(*poses)
        # Mostly there are as many contacts as before.
        out, before = _room(memory.names.shape[1]), (memory.names, memory.points)
        count, next_key = search.search(*self._search, placed, poses, before, memory.next_key, out)
        if count == search.LEFT:
            self.ask(*poses)
            count, next_key = search.search(*self._search, True, poses, before, memory.next_key, out)
        elif not placed:
            self._served += 1
        names, points, scalars = out
        if count != names.shape[1]:
            names, points, scalars = _room(count)
            next_key = keys.collect(*self._found, before, memory.next_key, (names, points, scalars))
        # By index: to unpack an array takes twice as long.
        found = ContactSet(
            names[0], names[1], names[2], names[3], points[0], points[1], scalars[0], scalars[1], scalars[2], names[4]
        )
        return found, ContactMemory(names, points, next_key)

    def gaps(self, contacts: ContactSet, found: ContactSet, poses: Poses) -> Array:
        """Gaps of contacts at later poses, shape (nc,), m.

        A contact that is still among those `found` there has its gap, known by its key. Any other has the separation of
        its geoms along its own normal, or their least gap found, if that is more: they overlap only where one is found.
        """
        c, out = contacts, np.empty(contacts.gap.size)
        if keys.kept(c.key, found.key, found.gap, out):
            return out
        pose, room = (poses.x, poses.R), (self._R, self._t)
        old, new = (c.geom1, c.geom2, c.normal, c.key), (found.geom1, found.geom2, found.key, found.gap)
        keys.gaps(self._fields, pose, room, old, new, out)
        return out

    def carry(self, contacts: ContactSet, begin: Poses, end: Poses) -> tuple[ContactSet, Array]:
        """Contacts at poses `begin` as they are at poses `end`, and how far apart geoms are along their normals, m.

        The normal of a face turns with its body, that of two edges with both: of the normals that stay in space, turn
        with body 1 and turn with body 2, each contact has the one along which its geoms are farthest apart.
        """
        c, normal, apart = contacts, np.empty_like(contacts.normal), np.empty_like(contacts.gap)
        who, room = (c.frame1, c.frame2, c.geom1, c.geom2, c.normal), (self._R, self._t)
        advancement.turn_normals(self._fields, who, begin.R, tuple(end), room, normal, apart)
        return carry(contacts, begin, end, normal), apart

    def touches(
        self,
        begin: Poses,
        end: Poses,
        memory: ContactMemory,
        known: ContactSet | None = None,
        least: Array | None = None,
    ) -> Touches:
        """Contacts of the pairs that touch between two configurations, translation and rotation at constant rates.

        A pair is followed by conservative advancement [1]_: its distance over a bound of its approach speed is a time
        in which it cannot touch.

        Parameters
        ----------
        begin, end : Poses
            No frame turns by more than half a turn between them.
        memory : ContactMemory
            Of the configuration whose contacts go on, as for `find`.
        known : ContactSet, optional
            Pairs with a contact here, sorted as `find` returns them, are left out.
        least : ndarray, shape (geoms,), optional
            Pairs that move past each other by no more than the smaller of theirs are left out, m; default 0.

        References
        ----------
        .. [1] B. Mirtich, Impulse-based Dynamic Simulation of Rigid Body Systems, PhD thesis, Berkeley 1996, ch. 2.
        """
        turn, reach = np.empty_like(begin.x), np.empty(len(begin.x))
        advancement.motions(self._frame, self._arm, *begin, *end, turn, reach)
        self._renew(begin.x, begin.R, reach)
        codes = _NONE if known is None else known.geom1 * len(self._cores) + known.geom2
        pairs, motion = np.empty(len(self._first), dtype=np.int64), (begin.x, end.x, turn)
        candidates, placed = (self._first, self._second, codes), (self._R, self._t, self._lower, self._upper)
        least = np.zeros(len(self._arm)) if least is None else least
        count = advancement.may_touch(self._fields, self._arm, least, candidates, motion, placed, pairs)
        parts, fractions = [], []
        for p in pairs[:count].tolist():
            fraction = self._first_touch(p, begin, end, turn)
            if fraction is not None:
                there = self._between(p, begin, end, turn, fraction)
                found = carry(self._manifold(p, there), there, end)
                parts.append(found)
                fractions.append(np.full(found.gap.size, fraction))
        return self._remember(parts, fractions, end, memory)

    def _between(self, p: int, begin: Poses, end: Poses, turn: Array, s: float) -> Poses:
        """Poses at the fraction s of the way; only those of the frames of pair p are right."""
        x, R = begin.x.copy(), begin.R.copy()
        for f in self._frame[[self._first[p], self._second[p]]]:
            if f >= 0:
                x[f] += s * (end.x[f] - begin.x[f])
                R[f] = pin.exp3(s * turn[f]) @ begin.R[f]
        return Poses(x, R)

    def _placed(self, g: int, poses: Poses) -> tuple[Array, Array]:
        """World pose (R, t) of a geom."""
        f = self._frame[g]
        if f < 0:
            return self._R[g], self._t[g]
        R = poses.R[f]
        return R @ self._geometry.placement_R[g], poses.x[f] + R @ self._geometry.placement_t[g]

    def _first_touch(self, p: int, begin: Poses, end: Poses, turn: Array) -> float | None:
        """Fraction of the way at which pair p touches, None if it does not."""
        i, j = geoms = int(self._first[p]), int(self._second[p])
        placements = self._frame, self._geometry.placement_R, self._geometry.placement_t
        near = TOUCH / MARGIN * self._pair_base[p]
        R, t = np.empty((2, 3, 3)), np.empty((2, 3))
        request, s = distance_request(), 0.0
        for _ in range(ADVANCES):
            advancement.place_at(placements, (begin.x, begin.R, end.x, turn), s, geoms, R, t)
            placed, result = [coal.Transform3s(R[k], t[k]) for k in (0, 1)], coal.DistanceResult()
            distance = coal.distance(self._solids[i], placed[0], self._solids[j], placed[1], request, result)
            n, points = result.normal, (result.getNearestPoint1(), result.getNearestPoint2())
            if not np.isfinite(n).all():  # deep inside each other
                return s
            bound, speed = advancement.approach(self._frame, self._arm, (begin.x, end.x, turn), s, geoms, n, points)
            if distance <= near and speed > 0.0:
                return s
            if bound * (1.0 - s) <= distance or bound == 0.0:
                return None
            s += max(distance, near) / bound
            if s >= 1.0:
                return None
        return s

    def _manifold(self, p: int, poses: Poses) -> ContactSet:
        """Contacts of pair p at rest at poses."""
        i, j = int(self._first[p]), int(self._second[p])
        R, t = self._R.copy(), self._t.copy()
        for g in (i, j):
            R[g], t[g] = self._placed(g, poses)
        one, row = slice(p, p + 1), np.empty((1, 10))
        slot = np.where(self._asked[one], 0, -1)
        if self._asked[p]:
            request, result = distance_request(), coal.DistanceResult()
            placed = coal.Transform3s(R[i], t[i]), coal.Transform3s(R[j], t[j])
            row[0, 0] = coal.distance(self._cores[i], placed[0], self._cores[j], placed[1], request, result)
            row[0, 1:4] = result.normal
        point, normal = np.empty((self._max_points, 3)), np.empty((self._max_points, 3))
        gap, pair = np.empty(self._max_points), np.empty(self._max_points, dtype=np.int64)
        first, second = self._first[one], self._second[one]
        geoms = self._fields, R, t, np.zeros(len(R)), self._slack
        pairs, room = (first, second, slot, row, self._pair_base[one]), (self._max_points, *self._scratch)
        count = manifold.manifolds(geoms, pairs, room, (point, normal, gap, pair))
        mu, restitution = self._pair_material(first, second)
        each = np.zeros(count, dtype=np.int64)
        return ContactSet(
            first[each],
            second[each],
            self._frame[first[each]],
            self._frame[second[each]],
            point[:count],
            normal[:count],
            gap[:count],
            mu[each],
            restitution[each],
            each,
        )

    def _remember(self, parts: list[ContactSet], fractions: list[Array], end: Poses, memory: ContactMemory) -> Touches:
        """Put contacts of several pairs together and give them keys."""
        if not parts:
            return Touches(_NO_CONTACTS, np.empty(0), memory)
        found = ContactSet(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        count = found.gap.size
        names, points = np.empty((5, count), np.int64), np.empty((4, count, 3))
        names[:4], points[0], points[1] = found[:4], found.point, found.normal
        R, t, reach = self._R.copy(), self._t.copy(), np.zeros(len(self._R))
        for g in np.unique(names[:2]).tolist():
            R[g], t[g] = self._placed(g, end)
        geoms, before = (self._geometry.radius, R, t, reach), (memory.names, memory.points)
        next_key = keys.match(geoms, TOLERANCE, before, memory.next_key, names, points)
        n = len(self._R)
        known = np.empty(memory.names.shape[1], np.bool_)
        sorting.among(memory.names[0] * n + memory.names[1], names[0] * n + names[1], known)
        others = ~known
        names = np.concatenate((memory.names[:, others], names), axis=1)
        points = np.concatenate((memory.points[:, others], points), axis=1)
        order = np.argsort(names[0] * n + names[1], kind="stable")
        remembered = ContactMemory(names.take(order, axis=1), points.take(order, axis=1), next_key)
        return Touches(found._replace(key=names[4, -count:].copy()), np.concatenate(fractions), remembered)

    def ask(self, x: Array, R: Array, reach: Array) -> None:
        """Place the geoms, and ask Coal for the distances of the candidate pairs."""
        self._renew(x, R, reach)
        for batch in self._batches:
            batch.run(self._fields, (self._R, self._t, self._reach), (self._lower, self._upper))

    def _renew(self, x: Array, R: Array, reach: Array) -> None:
        """Place the geoms, and renew the candidate pairs if one has left its fat box."""
        fields, boxes = self._fields, (self._lower, self._upper)
        placed, fat = (self._R, self._t, self._reach), (self._fat_lower, self._fat_upper)
        if broadphase.follow(fields, (x, R, reach), self._base, placed, boxes, fat):
            ahead = 1 + min(self._served, AHEAD)
            broadphase.fatten(fields, self._base, self._reach, SKIN, ahead, boxes, fat)
            self._served = 0
            codes = broadphase.candidates(fields, self._R, self._t, *fat, self._excluded)
            if not np.array_equal(codes, self._codes):
                self._set_pairs(codes)
        self._served += 1

    def _set_pairs(self, codes: Index) -> None:
        """Everything that depends on the candidate list alone."""
        self._codes = codes
        first, second = np.divmod(codes, len(self._cores))
        kind1, kind2 = self._geometry.kind[first], self._geometry.kind[second]
        both_round = np.isin(kind1, ROUND) & np.isin(kind2, ROUND)
        asked = ~((kind1 == HALFSPACE) | (kind2 == HALFSPACE) | both_round)
        self._first, self._second, self._asked = first, second, asked
        slot = np.where(asked, np.cumsum(asked) - 1, -1)
        radius = np.where(self._moving, self._geometry.radius, np.inf)
        self._pair_base = base = MARGIN * np.minimum(radius[first], radius[second])
        room, material = len(codes) * self._max_points, self._pair_material(first, second)
        found, asks = (np.empty((room, 3)), np.empty((room, 3)), np.empty(room)), np.empty((int(asked.sum()), 10))
        floats, integers, f, i = pack([*found, asks, base, *material], [np.empty(room, np.int64), first, second, slot])
        self._search = (self._packed, (floats, integers), self._max_points, TOLERANCE)
        geoms = self._frame, (self._geometry.radius, self._R, self._t, self._reach)
        self._found = geoms, (first, second, *material), (*f[:3], i[0]), TOLERANCE
        self._coal, self._batches = f[3], []
        of_coal = first[asked], second[asked], base[asked]
        for k, (lo, hi) in enumerate(split(*of_coal[:2])):
            if k == len(self._models):
                self._models.append(empty_model(len(self._cores)))
            one, other, margin = (part[lo:hi] for part in of_coal)
            self._batches.append(Batch(self._models[k], self._cores, one, other, margin, self._coal[lo:hi]))

    def _pack_geoms(self) -> None:
        """What does not change with the candidates, as `search` takes it; the arrays become views of that."""
        g, pose = self._geometry, (self._R, self._t, self._reach, self._slack, self._base)
        boxes = self._lower, self._upper, self._fat_lower, self._fat_upper
        shapes = g.size, g.offset, g.radius, g.vertices, g.face_normals, g.face_offsets, g.placement_R, g.placement_t
        *packed, f, _ = pack(
            [*shapes, *pose, *boxes, *self._scratch],
            [g.kind, g.vertex_ptr, g.face_ptr, g.loop_ptr, g.loop, g.frame],
        )
        self._packed = tuple(packed)
        self._R, self._t, self._reach, self._slack, self._base = f[8:13]
        self._lower, self._upper, self._fat_lower, self._fat_upper = f[13:17]
        self._scratch = tuple(f[17:])


def _room(count: int) -> tuple[Index, Array, Array]:
    """Room for so many contacts, as `keys.collect` fills it."""
    return np.empty((5, count), np.int64), np.empty((4, count, 3)), np.empty((3, count))


def _flatten(geoms: Sequence[Geom]) -> Geometry:
    """The shapes of all geoms in flat arrays."""
    all_shapes = [g.shape for g in geoms]

    def pointer(lengths: list[int]) -> Index:
        return np.cumsum([0, *lengths], dtype=np.int64)

    return Geometry(
        kind=np.array([s.kind for s in all_shapes], dtype=np.int64),
        size=np.array([s.size for s in all_shapes]).reshape(-1, 3),
        offset=np.array([s.offset for s in all_shapes], dtype=float),
        radius=np.array([s.bounding_radius for s in all_shapes], dtype=float),
        vertex_ptr=pointer([len(s.vertices) for s in all_shapes]),
        vertices=np.concatenate([np.zeros((0, 3)), *(s.vertices for s in all_shapes)]),
        face_ptr=pointer([len(s.face_normals) for s in all_shapes]),
        face_normals=np.concatenate([np.zeros((0, 3)), *(s.face_normals for s in all_shapes)]),
        face_offsets=np.concatenate([np.zeros(0), *(s.face_offsets for s in all_shapes)]),
        loop_ptr=pointer([n for s in all_shapes for n in np.diff(s.face_ptr)]),
        loop=np.concatenate([np.zeros(0, dtype=np.int64), *(s.face_loop for s in all_shapes)]),
        frame=np.array([g.frame for g in geoms], dtype=np.int64),
        placement_R=np.array([g.placement_R for g in geoms], dtype=float).reshape(-1, 3, 3),
        placement_t=np.array([g.placement_t for g in geoms], dtype=float).reshape(-1, 3),
    )
