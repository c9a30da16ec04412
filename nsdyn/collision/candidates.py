"""Broad phase: poses of the geoms, bounding boxes valid for several steps, candidate pairs and their distances."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from copy import copy
from typing import Any, Self

import numpy as np
import pinocchio as pin

from nsdyn._kernels.collision import broadphase
from nsdyn._kernels.collision.geometry import Geometry
from nsdyn._kernels.packing import pack
from nsdyn.collision.contacts import ContactSet
from nsdyn.collision.distances import SHRINK, SLOTS, Batch, Solids, empty_model, exponents, numbered, split
from nsdyn.scene.bodies import Geom
from nsdyn.scene.shapes import HALFSPACE, ROUND
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.options import is_number

MARGIN = 1e-3
"""Contacts begin at a gap of this fraction of the smaller bounding radius, plus the way that the bodies may move in a
step."""

SKIN = 0.05
"""The candidate pairs stay valid until a geom has moved by this fraction of its bounding radius, plus the way it may
move in some further steps. Their number is that of the steps for which the previous pairs stayed valid, at most
`AHEAD`. Among colliding bodies a list for many steps is long, and is outdated after one step all the same."""

AHEAD = 4

TOLERANCE = 0.05
"""A contact keeps its key while it moves by less than this fraction of the smaller bounding radius, on either geom,
plus the way that the geoms themselves may move in the step."""


class Candidates:
    """Candidate pairs of a fixed list of geoms: the pairs that may touch in a configuration.

    Parameters
    ----------
    geoms : sequence of Geom
        Half-spaces must be fixed.
    pair_material : callable
        ``pair_material(i, j) -> (mu, restitution)`` for index arrays of pairs.
    excluded : collection of (int, int)
        Pairs of geoms that never touch. Pairs of fixed geoms and pairs on one frame are left out anyway.
    max_points : int
        Most contacts of one pair, at least 4. A larger patch is reduced to the contacts that preserve its area.

    Attributes
    ----------
    pairs : two ndarrays of int
        The candidate pairs of geoms, sorted.
    searches : tuple
        First arguments of `nsdyn._kernels.collision.search`: geoms, pairs, most points of a pair, tolerance.
    """

    def __init__(
        self,
        geoms: Sequence[Geom],
        pair_material: Callable[[Index, Index], tuple[Array, Array]],
        excluded: Collection[tuple[int, int]] = (),
        max_points: int = 8,
    ) -> None:
        if not is_number(max_points, int) or max_points < 4:
            raise ValueError(f"max_points must be a whole number, at least 4, got {max_points!r}")
        for g in geoms:
            if g.shape.kind == HALFSPACE and g.frame >= 0:
                raise ValueError(f"halfspace {g.name!r} must be fixed, not on a moving frame")
        n = len(geoms)
        self._max_points, self._pair_material = int(max_points), pair_material
        self._excluded = np.unique(np.array([min(p) * n + max(p) for p in excluded], dtype=np.int64))
        self._set_geoms(_flatten(geoms), Solids([g.shape for g in geoms]))

    def only(self, geoms: Index, frame: Index) -> Self:
        """Return the candidates of some geoms (k,), ascending, on other frames (k,); their contacts are the same."""
        out, n, material = copy(self), self.frame.size, self._pair_material
        out._pair_material = lambda i, j: material(geoms[i], geoms[j])
        place = np.full(n, -1)
        place[geoms] = np.arange(geoms.size)
        first, second = place[np.array(np.divmod(self._excluded, n))]
        out._excluded = (first * geoms.size + second)[(first >= 0) & (second >= 0)]
        out._set_geoms(_some(self._geometry, geoms, frame), self._solids.only(geoms))
        return out

    def _set_geoms(self, geometry: Geometry, solids: Solids) -> None:
        """Set up all arrays that depend on the geoms: their shapes, with those of Coal."""
        n, kind, self._geometry, self._solids = geometry.kind.size, geometry.kind, geometry, solids
        self.fields = tuple(geometry)
        self._half, self._round = kind == HALFSPACE, np.isin(kind, ROUND)
        self._slack = np.where(self._round, 0.0, 2.0 * SHRINK * geometry.radius)
        self.frame = geometry.frame
        self._moving = self.frame >= 0
        self._R, self._t = geometry.placement_R.copy(), geometry.placement_t.copy()
        arm = np.linalg.norm(self._t, axis=1) + geometry.radius
        self._arm = np.where(self._moving, arm, 0.0)  # largest distance of any point from the origin of its frame
        self.base = self._base = np.where(self._moving, MARGIN * geometry.radius, 0.0)
        self._reach = np.zeros(n)
        self._lower, self._upper = boxes = np.empty((n, 3)), np.empty((n, 3))
        # Compute the boxes of fixed geoms once, with a frame at the origin.
        fixed, placed = geometry._replace(frame=np.zeros(n, np.int64)), (self._R.copy(), self._t.copy())
        still = np.zeros((1, 3)), np.eye(3)[None], np.zeros(1)
        broadphase.follow(tuple(fixed), still, self.base, (*placed, np.empty(n)), boxes, boxes)
        self._fat_lower, self._fat_upper = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
        self._served = 0  # calls for which the present candidates were valid
        self._batches: list[Batch] = []
        self._models: list[pin.GeometryModel] = []
        # Largest polygon: a face clipped by a face or by a circle, or all vertices against a half-space.
        loops = np.diff(geometry.loop_ptr).max(initial=self._max_points)
        room = int(max(4 * max(loops, self._max_points), np.diff(geometry.vertex_ptr).max(initial=0)))
        faces = int(np.diff(geometry.face_ptr).max(initial=2))
        points = np.empty((faces * room, 3)), np.empty(faces * room)
        self._scratch = np.empty((room, 3)), np.empty((room, 3)), np.empty(room), *points
        self._pack_geoms()
        self._set_pairs(np.empty(0, dtype=np.int64))

    def boxes(self, x: Array, R: Array) -> tuple[Array, Array]:
        """Smallest axis-aligned boxes of the geoms at these poses of the frames: (lower, upper), (geoms, 3) each, m."""
        lower, upper = self._lower.copy(), self._upper.copy()
        broadphase.bounds(self.fields, x, R, lower, upper)
        return lower, upper

    @property
    def asks(self) -> bool:
        """True if the distance of any candidate pair is computed by Coal."""
        return bool(self._batches)

    def codes(self, contacts: ContactSet) -> Index:
        """Code of the pair of geoms of every contact, one number each, shape (nc,)."""
        return contacts.geom1 * self.frame.size + contacts.geom2

    def ask(self, x: Array, R: Array, reach: Array) -> None:
        """Place the geoms, and compute the distances of the candidate pairs with Coal."""
        self._renew(x, R, reach)
        for batch in self._batches:
            batch.run(self.fields, (self._R, self._t, self._reach), (self._lower, self._upper))

    def _renew(self, x: Array, R: Array, reach: Array) -> None:
        """Place the geoms, and renew the candidate pairs if a geom has left its enlarged box."""
        fields, boxes = self.fields, (self._lower, self._upper)
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
        """Set up all arrays that depend on the list of candidate pairs alone."""
        self._codes = codes
        self.pairs = first, second = np.divmod(codes, self.frame.size)
        half, both_round = self._half[first] | self._half[second], self._round[first] & self._round[second]
        asked = ~(half | both_round)
        self._first, self._second, self._asked = first, second, asked
        slot = np.where(asked, np.cumsum(asked) - 1, -1)
        radius = np.where(self._moving, self._geometry.radius, np.inf)
        radius = np.minimum(radius[first], radius[second])
        self._pair_base, self._exponent = base, k = MARGIN * radius, exponents(radius)
        room, material = len(codes) * self._max_points, self._pair_material(first, second)
        found, asks = (np.empty((room, 3)), np.empty((room, 3)), np.empty(room)), np.empty((int(asked.sum()), 4))
        floats, integers, f, _ = pack([*found, asks, base, *material], [np.empty(room, np.int64), first, second, slot])
        self.searches: tuple[Any, ...] = (self._packed, (floats, integers), self._max_points, TOLERANCE)
        self._coal, self._batches = f[3], []
        solids, margin = np.stack([numbered(side, k)[asked] for side in (first, second)]), base[asked]
        for lo, hi in split(*solids):
            given = solids[:, lo:hi], margin[lo:hi], self._coal[lo:hi]
            self._batches.append(Batch(self._model, self._solids, *given))

    def _model(self, solids: int) -> pin.GeometryModel:
        """Return the model of the next batch, that of an earlier one if it has room."""
        k = len(self._batches)
        if k == len(self._models):
            self._models.append(empty_model(min(max(solids, self.frame.size), SLOTS)))
        elif self._models[k].ngeoms < solids:
            self._models[k] = empty_model(solids)
        return self._models[k]

    def _pack_geoms(self) -> None:
        """Pack the arrays of the geoms, which do not depend on the candidates, for `seek`, and make them views."""
        g, pose = self._geometry, (self._R, self._t, self._reach, self._slack, self._base)
        boxes = self._lower, self._upper, self._fat_lower, self._fat_upper
        shapes = g.size, g.offset, g.radius, g.vertices, g.face_normals, g.face_offsets, g.placement_R, g.placement_t
        *packed, f, _ = pack(
            [*shapes, *pose, *boxes, *self._scratch], [g.kind, g.vertex_ptr, g.face_ptr, g.loop_ptr, g.loop, g.frame]
        )
        self._packed = tuple(packed)
        self._R, self._t, self._reach, self._slack, self._base = f[8:13]
        self._lower, self._upper, self._fat_lower, self._fat_upper = f[13:17]
        self._scratch = tuple(f[17:])


def _flatten(geoms: Sequence[Geom]) -> Geometry:
    """Shapes of all geoms in flat arrays."""
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


def _some(g: Geometry, geoms: Index, frame: Index) -> Geometry:
    """Return the shapes of some geoms (k,) on other frames (k,)."""

    def entries(start: Index, which: Index) -> tuple[Index, Index]:
        """Pointers to the entries of some objects, which begin at `start` (n + 1,) with those of all; and these."""
        count = np.diff(start)[which]
        pointer = np.concatenate(([0], np.cumsum(count)))
        return pointer, np.repeat(start[which] - pointer[:-1], count) + np.arange(pointer[-1])

    (vertex_ptr, vertices), (face_ptr, faces) = entries(g.vertex_ptr, geoms), entries(g.face_ptr, geoms)
    loop_ptr, loops = entries(g.loop_ptr, faces)
    of_faces = face_ptr, g.face_normals[faces], g.face_offsets[faces], loop_ptr, g.loop[loops]
    sizes = g.kind[geoms], g.size[geoms], g.offset[geoms], g.radius[geoms]
    return Geometry(
        *sizes, vertex_ptr, g.vertices[vertices], *of_faces, frame, g.placement_R[geoms], g.placement_t[geoms]
    )
