"""Collision shapes: convex, homogeneous, with their origin at the centre of mass.

A `Shape` carries data for three users: a geometry object for Coal, the exact features (vertices, faces, sizes) for
the contact kernels, and the mass properties for the dynamics. Lengths in m, volumes in m³.

To add a polytope, write a function that returns `convex` of its corners. To add a curved shape, follow the recipe in
`demos/guide/extending.md`; this module needs a kind, a line in `CURVED` and a function that returns the shape.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import numpy as np
from numpy.typing import ArrayLike

from nsdyn.scene import checks, hulls, meshes
from nsdyn.tools import noise
from nsdyn.tools.arrays import Array, Index, numbers
from nsdyn.tools.files import as_path

HALFSPACE, POLYTOPE, SPHERE, CAPSULE, CYLINDER, ELLIPSOID = range(6)
"""Kinds of shapes; `nsdyn._kernels.collision.kinds` has the same kinds and the functions that each provides."""

CURVED: dict[int, tuple[str, Callable[[Array], Any]]] = {
    SPHERE: ("sphere", lambda size: coal.Sphere(size[0])),
    CAPSULE: ("capsule", lambda size: coal.Capsule(size[0], 2.0 * size[1])),
    CYLINDER: ("cylinder", lambda size: coal.Cylinder(size[0], 2.0 * size[1])),
    ELLIPSOID: ("ellipsoid", lambda size: coal.Ellipsoid(*size)),
}
"""Name of each curved kind, and the function that makes Coal's solid from its `Shape.size`."""

ROUND = (SPHERE, CAPSULE)
"""Kinds that are all points within a radius of a point or a segment: contacts of two such shapes do not need Coal."""

CONCAVE = 1.02
"""Ratio of the volumes of hull and mesh above which a mesh is reported as not convex."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A convex solid in its own frame; the origin is the centre of mass (for a half-space, any point).

    Attributes
    ----------
    kind : int
        HALFSPACE, POLYTOPE, SPHERE, CAPSULE, CYLINDER or ELLIPSOID.
    geometry : coal.ShapeBase
        The same solid for Coal.
    size : ndarray, shape (3,)
        Half-space: outward unit normal. Box: full edge lengths; other polytopes: zeros. Sphere: (radius, 0, 0).
        Capsule and cylinder: (radius, half length, 0), axis along z. Ellipsoid: the three radii. m.
    vertices : ndarray, shape (nv, 3)
        Corners of a polytope, m; empty for other kinds.
    face_normals, face_offsets : ndarray, shapes (nf, 3), (nf,)
        A polytope is {x : face_normals @ x ≤ face_offsets}; normals point outwards.
    face_ptr : ndarray, shape (nf + 1,)
        Face f has the corners ``face_loop[face_ptr[f]:face_ptr[f + 1]]``.
    face_loop : ndarray
        Vertex indices, anticlockwise seen from outside.
    offset : float
        Half-space only: the solid is {x : normal·x ≤ offset}, m.
    volume : float
        m³; infinite for a half-space.
    moment : ndarray, shape (3, 3)
        Inertia at density 1 about the origin, shape axes, m⁵; zeros for a half-space.
    bounding_radius, inscribed_radius : float
        Radius of the smallest sphere about the origin that contains the shape, and of the largest one inside it, m.
    """

    kind: int
    geometry: Any
    size: Array
    vertices: Array
    face_normals: Array
    face_offsets: Array
    face_ptr: Index
    face_loop: Index
    offset: float
    volume: float
    moment: Array
    bounding_radius: float
    inscribed_radius: float

    def __repr__(self) -> str:
        return f"<Shape {self.name}: {self.volume:.4g} m³>"

    @property
    def name(self) -> str:
        """One of "halfspace", "box", "convex", "sphere", "capsule", "cylinder", "ellipsoid"."""
        if self.kind in CURVED:
            return CURVED[self.kind][0]
        return "halfspace" if self.kind == HALFSPACE else "box" if self.size.any() else "convex"

    def core(self, fraction: float, unit: float = 1.0) -> Any:
        """Return Coal's geometry of the shape shrunk by a fraction of its inscribed radius, with the same normals.

        The fraction is below 1, and lengths are in a `unit` in m. Half-spaces, spheres and capsules are not shrunk.
        """
        thinner = 0.0 if self.kind in ROUND else fraction * self.inscribed_radius
        if self.kind == HALFSPACE:
            return coal.Halfspace(self.size, self.offset / unit)
        if self.kind in CURVED:
            return CURVED[self.kind][1]((self.size - thinner) / unit)
        if self.size.any():
            return coal.Box(*((self.size - 2.0 * thinner) / unit))
        return coal_convex(self.vertices * (1.0 - fraction) / unit, self.face_loop, self.face_ptr)

    def inertia(self, mass: float) -> Array:
        """Return the inertia of the homogeneous solid of a mass in kg about its centre of mass, shape axes, (3, 3).

        In kg m². ValueError for a half-space, which has no inertia.
        """
        if self.kind == HALFSPACE:
            raise ValueError("a halfspace has no inertia: it can only be fixed")
        return mass / self.volume * self.moment

    def describe(self) -> dict[str, Any]:
        """Return name and dimensions as JSON values: ``shape``, ``size``, for a polytope ``vertices`` and ``faces``.

        A half-space also has ``offset``. ``shape`` is the property `name`, ``size`` the attribute `size`.
        """
        out: dict[str, Any] = {"shape": self.name, "size": self.size.tolist()}
        if self.kind == HALFSPACE:
            out["offset"] = self.offset
        if self.kind == POLYTOPE:
            out["vertices"] = self.vertices.tolist()
            out["faces"] = [loop.tolist() for loop in np.split(self.face_loop, self.face_ptr[1:-1])]
        return out


_NO_FACES = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
"""Vertices, normals, offsets, pointers and loops of a shape without faces."""


def _curved(
    kind: int, size: Sequence[float], bounding: float, inscribed: float, solid: tuple[float, Array] | None = None
) -> Shape:
    """Return a shape of a kind in `CURVED`; `solid` is (volume, moment), where Coal's are not of the whole solid."""
    array = np.array(size, dtype=float)
    geometry = CURVED[kind][1](array)
    volume, moment = solid or (geometry.computeVolume(), _moment(geometry))
    return Shape(kind, geometry, array, *_NO_FACES, 0.0, volume, moment, bounding, inscribed)


def _moment(geometry: Any) -> Array:
    """Return Coal's inertia of a solid at density 1 about its centre of mass, made symmetric to the last bit."""
    inertia: Array = geometry.computeMomentofInertiaRelatedToCOM()
    return 0.5 * (inertia + inertia.T)


def halfspace(normal: ArrayLike, offset: float) -> Shape:
    """Return the solid {x : normal·x ≤ offset} below a plane.

    Parameters
    ----------
    normal : array, shape (3,)
        Outward normal of any length but zero. It is normalised and `offset` divided by its length: the plane stays.
    offset : float
        m, for a unit normal.
    """
    n = checks.vector(normal, 3, "normal")
    length = float(np.linalg.norm(n))
    if length == 0.0:
        raise ValueError("normal must not be zero")
    d = checks.number(offset, "offset") / length
    n /= length
    return Shape(HALFSPACE, coal.Halfspace(n, d), n, *_NO_FACES, d, np.inf, np.zeros((3, 3)), np.inf, np.inf)


def box(size: ArrayLike) -> Shape:
    """Return a box with the full edge lengths `size`, shape (3,), in m."""
    lengths = checks.lengths(size, "size")
    half = 0.5 * lengths
    # Vertex 4 i + 2 j + k has the signs of (i, j, k).
    vertices = np.array(list(np.ndindex(2, 2, 2))) * lengths - half
    loops = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    normals = np.repeat(np.eye(3), 2, axis=0)
    normals[::2] *= -1.0
    geometry, faces = coal.Box(*lengths), (vertices, normals, np.repeat(half, 2), np.arange(0, 25, 4), loops.ravel())
    solid = float(np.prod(lengths)), _moment(geometry)
    return Shape(POLYTOPE, geometry, lengths, *faces, 0.0, *solid, float(np.linalg.norm(half)), float(half.min()))


def sphere(radius: float) -> Shape:
    """Return a solid sphere of the given radius in m."""
    r = checks.positive(radius, "radius")
    return _curved(SPHERE, (r, 0.0, 0.0), r, r)


def capsule(radius: float, length: float) -> Shape:
    """Return the solid within `radius` of a segment along z; `length` is the distance of the sphere centres, m."""
    r, full = checks.positive(radius, "radius"), checks.positive(length, "length")
    return _curved(CAPSULE, (r, 0.5 * full, 0.0), r + 0.5 * full, r)


def cylinder(radius: float, length: float) -> Shape:
    """Return a cylinder of full height `length` along z, in m."""
    r, full = checks.positive(radius, "radius"), checks.positive(length, "length")
    bounding = float(np.hypot(r, 0.5 * full))
    return _curved(CYLINDER, (r, 0.5 * full, 0.0), bounding, min(r, 0.5 * full))


def ellipsoid(radii: ArrayLike) -> Shape:
    """Return an ellipsoid with the given semi-axes along x, y, z, shape (3,), in m."""
    r = checks.lengths(radii, "radii")
    return _curved(ELLIPSOID, r.tolist(), float(r.max()), float(r.min()))


def convex(vertices: ArrayLike) -> tuple[Shape, Array]:
    """Return the convex hull of points.

    Parameters
    ----------
    vertices : array, shape (n, 3)
        m, at least four points that do not lie in one plane.

    Returns
    -------
    Shape
        The hull, in a frame parallel to the frame of the points, with its origin at the centroid of the hull.
    centroid : ndarray, shape (3,)
        Centroid of the hull in the frame of the points.
    """
    points = numbers(vertices, words := "an array of shape (n, 3) with n ≥ 4", "vertices")
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f"vertices must be {words}, got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("vertices must be finite")
    loops = hulls.faces(points)
    used, flat = np.unique(np.concatenate(loops), return_inverse=True)
    face_ptr = np.cumsum([0, *map(len, loops)])
    corners = points[used]
    # Computed twice, because the centroid of a solid far from the origin loses digits.
    centroid = corners.mean(axis=0)
    try:
        for _ in range(2):
            geometry = coal_convex(corners - centroid, flat, face_ptr)
            centroid = centroid + geometry.computeCOM()
        corners = corners - centroid
        geometry = coal_convex(corners, flat, face_ptr)
    except RuntimeError as failure:  # for instance a corner with more neighbours than Coal can count
        raise ValueError(f"vertices must make a simpler hull: {noise.told(failure, [])}") from None
    sides = [corners[flat[a:b]] - corners[flat[a]] for a, b in pairwise(face_ptr)]
    normals = np.array([np.cross(side, np.roll(side, -1, axis=0)).sum(axis=0) for side in sides])  # Newell
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    offsets = np.array([(corners[flat[face_ptr[f] : face_ptr[f + 1]]] @ n).max() for f, n in enumerate(normals)])
    faces, solid = (corners, normals, offsets, face_ptr, flat), (float(geometry.computeVolume()), _moment(geometry))
    bounding, inscribed = float(np.linalg.norm(corners, axis=1).max()), float(offsets.min())
    return Shape(POLYTOPE, geometry, np.zeros(3), *faces, 0.0, *solid, bounding, inscribed), centroid


def coal_convex(vertices: Array, loop: Index, ptr: Index) -> Any:
    """Return Coal's polytope, with each face cut into a fan of triangles."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for v in vertices:
        points.append(v)
    for a, b in pairwise(ptr):
        for k in range(a + 1, b - 1):
            triangles.append(coal.Triangle(int(loop[a]), int(loop[k]), int(loop[k + 1])))
    return coal.Convex(points, triangles)


def mesh(path: str | Path, scale: ArrayLike = 1.0) -> tuple[Shape, Array]:
    """Return the convex hull of a mesh file: STL, OBJ, PLY or COLLADA, whose unit and upward axis are ignored.

    Parameters
    ----------
    path : str or Path
    scale : float, or 3 floats
        Factor from lengths in the file to m; one for all axes, or one per axis. A negative factor mirrors.

    Returns
    -------
    Shape, ndarray
        The hull and its centroid, as from `convex`.

    Warns
    -----
    UserWarning
        When the hull has more than 1.02 times the volume of the mesh: hollows of the mesh are filled.
    """
    words = "a number or 3 numbers other than 0"
    factor = np.full(3, checks.positive(scale, "scale")) if np.ndim(scale) == 0 else numbers(scale, words, "scale")
    if factor.shape != (3,) or not (np.isfinite(factor).all() and factor.all()):
        raise ValueError(f"scale must be {words}, got {scale!r}")
    surface = meshes.read(as_path(path, "path"))
    try:
        with np.errstate(over="ignore"):
            surface = surface._replace(vertices=surface.vertices * factor)
        return hull_of_surface(surface.vertices, surface.volume, str(path))
    except ValueError as failure:
        raise ValueError(f"path: {path} has no hull: {failure}") from None


def hull_of_surface(vertices: Array, volume: float, name: str) -> tuple[Shape, Array]:
    """Return the hull of a surface with vertices (n, 3), m, and volume, m³, as `convex`; warn if it is not convex."""
    shape, centroid = convex(vertices)
    volume = abs(volume)
    if shape.volume > CONCAVE * volume:
        warnings.warn(
            f"{name} is not convex (or not closed): its hull has {shape.volume:.4g} m³, the mesh {volume:.4g} m³. "
            "Only the hull takes part in contact; split the mesh into convex pieces if its hollows matter",
            stacklevel=3,
        )
    return shape, centroid


def _settle_boxes() -> None:
    """Call Coal once with a box, so that its later results for boxes do not depend on earlier calls.

    Until the process ends, Coal's support function remembers whether the first direction it was called with has a zero
    component. If so, it makes the lower sides of boxes wider by 1e-10. The bits of a run would then depend on the calls
    before it. The direction of this call has no zero component.
    """
    turn = np.array([[2.0, -1.0, 2.0], [2.0, 2.0, -1.0], [-1.0, 2.0, 2.0]]) / 3.0
    there = coal.Transform3s(turn, np.array([3.0, 0.0, 0.0]))
    asked = coal.Capsule(1.0, 1.0), coal.Transform3s(), coal.Box(1.0, 1.0, 1.0), there
    coal.distance(*asked, coal.DistanceRequest(), coal.DistanceResult())


_settle_boxes()
