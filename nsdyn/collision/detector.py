"""Contact detection: candidate pairs from bounding boxes, normals from Coal, contact manifolds from features.

Coal's own contact points are not used: its patches lose points, have one depth for all points, and are noisy near gap
0. Coal gives only the distance and the normal of each pair. `nsdyn._kernels.collision.manifold` then computes normals,
points and gaps from the faces, edges and curved surfaces that this normal selects.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import coal
import numpy as np

from nsdyn._kernels.collision import advancement, faces, geometry, keys, manifold, search
from nsdyn.collision.candidates import MARGIN, TOLERANCE, Candidates
from nsdyn.collision.contacts import NO_TOUCHES, ContactSet, Poses, Touches, among, carry, take, united
from nsdyn.collision.distances import distance_request
from nsdyn.tools.arrays import NONE, Array, Index

TOUCH = 1e-4
"""Approaching bodies closer than this fraction of the smaller bounding radius touch on their way."""

ADVANCES = 200
"""Most advances of a pair along its motion. A pair that is still close then, and has not reached the end of the motion,
counts as touching."""


class Detector(Candidates):
    """Finds the contacts of a fixed list of geoms at any configuration, and on the way between two.

    Results depend on the arguments alone: the state kept between calls (candidate pairs, models of Coal) changes none.
    """

    def find(self, x: Array, R: Array, reach: Array, memory: ContactSet) -> ContactSet:
        """Contacts of a configuration.

        Parameters
        ----------
        x, R : ndarray, shapes (nframes, 3), (nframes, 3, 3)
            Poses of the moving frames, body to world; m.
        reach : ndarray, shape (nframes,)
            Way that any point of the frame's geoms may still move, m. Contacts are found up to a gap of the sum of both
            reaches, plus `MARGIN` of the size.
        memory : ContactSet
            Contacts of the previous configuration: those found again keep their keys.
        """
        poses, placed = (x, R, reach), bool(self._batches)
        if placed:
            self.ask(*poses)
        count = search.seek(*self.searches[:3], placed, poses)
        if count == search.LEFT:
            self.ask(*poses)
            count = search.seek(*self.searches[:3], True, poses)
        elif not placed:
            self._served += 1
        out = _room(count)
        return ContactSet(*out, search.gather(*self.searches[:2], TOLERANCE, memory[:3], memory.next_key, out))

    def gaps(self, contacts: ContactSet, found: ContactSet, poses: Poses) -> Array:
        """Gaps of contacts at later poses, shape (nc,), m.

        A contact whose key is among those `found` at these poses has the gap found. For any other contact the gap is
        the separation of its geoms along its own normal, or the least gap found between them if that is larger. The
        reason: geoms penetrate each other only if a contact with a negative gap is found.
        """
        c, out = contacts, np.empty(contacts.gap.size)
        if keys.kept(c.key, found.key, found.gap, out):
            return out
        pose, room = (poses.x, poses.R), (self._R, self._t)
        keys.gaps(self.fields, pose, room, c[:3], found[:3], out)
        return out

    def made(self, contacts: ContactSet) -> bool:
        """Return whether contacts may be of this scene: whether it has their geoms, on their frames."""
        names = contacts.names
        return bool((names[:2] < self.frame.size).all() and (names[2:4] == self.frame[names[:2]]).all())

    def ways(self, contacts: ContactSet, poses: Poses, closed: float) -> tuple[Index, Array]:
        """Face normals along which geoms of contacts penetrate each other by no more than `closed`, m.

        Returns the index of the contact of each normal, shape (n,), and the normals, shape (n, 3). A contact of two
        edges has several.
        """
        most = int((np.diff(self._geometry.face_ptr)[contacts.names[:2]] + 2).sum())
        which, normal = np.empty(most, np.int64), np.empty((most, 3))
        pose, room = (poses.x, poses.R), (self._R, self._t)
        count = faces.ways(self.fields, pose, room, contacts.names, closed, which, normal)
        return which[:count], normal[:count]

    def carry(self, contacts: ContactSet, begin: Poses, end: Poses) -> tuple[ContactSet, Array]:
        """Move contacts from poses `begin` to poses `end`; return them and the separation of geoms along normals, m.

        The normal of a face turns with its body, the normal of two edges with both. Three normals are tried: fixed in
        space, turning with body 1, and turning with body 2. Each contact gets the one with the largest separation of
        its geoms.
        """
        c, normal, apart = contacts, np.empty_like(contacts.normal), np.empty_like(contacts.gap)
        advancement.turn_normals(self.fields, c[:3], begin.R, (end.x, end.R), (self._R, self._t), normal, apart)
        return carry(contacts, begin, end, normal), apart

    def touches(
        self,
        begin: Poses,
        end: Poses,
        memory: ContactSet,
        known: Callable[[], ContactSet] | None = None,
        least: Array | None = None,
        together: ContactSet | None = None,
        foreseen: Array | None = None,
    ) -> Touches:
        """Pairs that touch between two configurations, translation and rotation at constant rates.

        A pair is followed by conservative advancement [1]_: it cannot touch within its distance divided by a bound on
        its approach speed. A pair that is together at the beginning is found only after it has separated further, or if
        it penetrates deeply.

        Parameters
        ----------
        begin, end : Poses
        memory : ContactSet
            Contacts of the previous configuration, as for `find`.
        known : callable, optional
            Returns contacts whose pairs are left out; called only if a pair may touch.
        least : ndarray, shape (geoms,), optional
            A length per geom, m; default 0. Pairs that move past each other by no more than the smaller of their two
            lengths are left out.
        together : ContactSet, optional
            Pairs with a contact in this set are together at the beginning: they touch, or are about to.
        foreseen : ndarray, shape (nframes, 3), optional
            Predicted rotation vectors; default 0. Poses alone determine rotations of at most half a turn. If a pair may
            touch and one of its frames turns by more than `HALF_TURN`, the pair is returned in `Touches.far`, and no
            pair is followed.

        References
        ----------
        .. [1] B. Mirtich, Impulse-based Dynamic Simulation of Rigid Body Systems, PhD thesis, Berkeley 1996, ch. 2.
        """
        turn, reach = np.empty_like(begin.x), np.empty(len(begin.x))
        foreseen = np.zeros_like(begin.x) if foreseen is None else foreseen
        ends = (begin.x, begin.R), (end.x, end.R)
        far = advancement.motions(self.frame, self._arm, *ends, foreseen, turn, reach)
        self._renew(begin.x, begin.R, reach)
        candidates, pairs = (self._first, self._second), np.empty(len(self._first), dtype=np.int64)
        motion, placed = (begin.x, end.x, turn), (self._R, self._t, self._lower, self._upper)
        least = np.zeros(len(self._arm)) if least is None else least
        count = advancement.may_touch(self.fields, self._arm, least, candidates, motion, placed, memory[:2], pairs)
        if not count:
            return NO_TOUCHES
        pairs = pairs[:count]
        if far:
            # Do not leave out known pairs: contacts at both ends say nothing about whole turns between.
            whirls = np.append(np.linalg.norm(foreseen, axis=1) > advancement.HALF_TURN, False)[self.frame]
            if (of := whirls[self._first[pairs]] | whirls[self._second[pairs]]).any():
                return NO_TOUCHES._replace(far=self._codes[pairs[of]])
        if known is not None:
            pairs = pairs[~among(self._codes[pairs], self.codes(known()))]
        close = frozenset() if together is None else frozenset(self.codes(together).tolist())
        found = []
        for p in pairs.tolist():
            touch = self._first_touch(p, (begin, end), turn, least if int(self._codes[p]) in close else None)
            if touch is not None:
                found.append((p, *touch))
        if not found:
            return NO_TOUCHES
        pairs, fraction, R, t = (np.array(values) for values in zip(*found, strict=True))
        return Touches(self._codes[pairs], fraction, R, t, NONE)

    def _first_touch(
        self, p: int, ends: tuple[Poses, Poses], turn: Array, least: Array | None
    ) -> tuple[float, Array, Array] | None:
        """Time of impact of pair p as a fraction of the way, and poses (R, t) of its geoms then; None if it misses.

        For a pair that is together at the beginning, `least` (geoms,) is given, as in `touches`. Until the pair has
        separated, each advance is at least that long, and the pair touches when it penetrates by that length.
        """
        geoms, near, s = (int(self._first[p]), int(self._second[p])), TOUCH / MARGIN * self._pair_base[p], 0.0
        parted, stride = least is None, near if least is None else max(near, min(least[g] for g in geoms))
        together = near
        room, motion, some = (self._R.copy(), self._t.copy()), (ends[0].x, ends[0].R, ends[1].x, turn), list(geoms)
        unit = math.ldexp(1.0, int(self._exponent[p]))
        solids = [self._solids(g, unit, 0.0) for g in geoms]
        for _ in range(ADVANCES):
            advancement.place_at(self.fields, room, motion, s, geoms)
            R, t = (a[some] for a in room)
            distance, n, *points = _distance(solids, R, t, unit)
            if not np.isfinite(n).all():  # in deep penetration
                break
            together = near + max(0.0, distance) if s == 0.0 else together
            parted = parted or distance > together
            shown = s, distance, near if parted else stride, tuple(n), tuple(points)
            later, speed = advancement.advance(self.fields, self._arm, motion, geoms, shown, room)
            if distance <= (near if parted else -stride) and speed > 0.0:
                return s, R, t
            if later >= 1.0:
                return None
            s = later
        return (s, R, t) if parted else None

    def carried(self, touches: Touches, end: Poses, memory: ContactSet) -> tuple[ContactSet, ContactSet]:
        """Contacts of pairs that touch on the way to poses `end`, carried there; and `memory` with them.

        The normal of a contact turns as in `carry`.
        """
        if not touches.codes.size:
            return ContactSet.empty(), memory
        found = [self._manifold(k, touches) for k in range(touches.fraction.size)]
        sizes = [gap.size for _, _, gap in found]
        point, normal, gap = (np.concatenate(parts) for parts in zip(*found, strict=True))
        both = np.stack(np.divmod(touches.codes, self.frame.size))
        names, points, scalars = out = _room(gap.size)
        names[:2] = np.repeat(both, sizes, axis=1)
        names[2:4] = self.frame[names[:2]]
        R, t = self._R.copy(), self._t.copy()
        geometry.place(self.fields, end.x, end.R, R, t)
        # Move them from the poses at which the geoms of each pair touch to the end. Fixed geoms belong to the world.
        geoms = both.T.ravel()
        begin = touches.t.reshape(-1, 3), touches.R.reshape(-1, 3, 3)
        where = np.repeat(np.arange(geoms.size).reshape(-1, 2), sizes, axis=0).T
        points[:2], scalars[0], scalars[1:] = (point, normal), gap, self._pair_material(names[0], names[1])
        bodies = names.copy()
        bodies[2:4] = np.where(names[2:4] >= 0, where, -1)
        advancement.carry((bodies, points, scalars), begin, (t[geoms], R[geoms]), normal)
        placed = self._geometry.radius, R, t, np.zeros(len(R))
        contacts = ContactSet(*out, keys.match(placed, TOLERANCE, memory[:3], memory.next_key, names, points))
        others = ~among(self.codes(memory), self.codes(contacts))
        return contacts, united((take(memory, others), contacts))

    def _manifold(self, k: int, touches: Touches) -> tuple[Array, Array, Array]:
        """Points, normals and gaps of the k-th pair where it touches, at rest."""
        p, R, t = int(np.searchsorted(self._codes, touches.codes[k])), touches.R[k], touches.t[k]
        one, geoms = slice(p, p + 1), [int(self._first[p]), int(self._second[p])]
        all_R, all_t, asked = self._R.copy(), self._t.copy(), np.empty((1, 4))
        all_R[geoms], all_t[geoms] = R, t
        if self._asked[p]:
            unit = math.ldexp(1.0, int(self._exponent[p]))
            asked[0, 0], asked[0, 1:4], *_ = _distance([self._solids(g, unit) for g in geoms], R, t, unit)
        found = np.empty((self._max_points, 3)), np.empty((self._max_points, 3)), np.empty(self._max_points)
        slot, pair = np.where(self._asked[one], 0, -1), np.empty(self._max_points, np.int64)
        placed = self.fields, all_R, all_t, np.zeros(len(all_R)), self._slack
        pairs = self._first[one], self._second[one], slot, asked, self._pair_base[one]
        room = self._max_points, *self._scratch
        count = manifold.manifolds(placed, pairs, room, (*found, pair))
        return found[0][:count], found[1][:count], found[2][:count]


def _distance(solids: Any, R: Array, t: Array, unit: float) -> tuple[float, Array, Array, Array]:
    """Distance of two solids of Coal, in a unit in m, at their poses; normal and nearest points. All in m."""
    placed, result = [coal.Transform3s(R[k], t[k] / unit) for k in (0, 1)], coal.DistanceResult()
    distance = coal.distance(solids[0], placed[0], solids[1], placed[1], distance_request(), result)
    points = unit * result.getNearestPoint1(), unit * result.getNearestPoint2()
    return unit * distance, np.array(result.normal), *points


def _room(count: int) -> tuple[Index, Array, Array]:
    """Arrays for `count` contacts, as `search.gather` fills them."""
    return np.empty((5, count), np.int64), np.empty((4, count, 3)), np.empty((3, count))
