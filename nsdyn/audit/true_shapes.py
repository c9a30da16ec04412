"""Geometry of each kind of shape for the audit, by code that shares nothing with the detection of contacts.

Support for a kind that is no hull of balls takes: its `SIZES`, what `Solid.described` derives from them (extents,
normals of flat faces, axes of straight sides), `rounding`, `support`, `curvature`, and the distance `beyond` its
surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nsdyn.tools.arrays import Array, cross

SIZES = {"halfspace": 3, "box": 3, "convex": 0, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3}
"""Number of size parameters of each kind."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex solid in its own frame: a hull of points with a ball around each, or a smooth body.

    Attributes
    ----------
    kind : str
        Kind of shape, as in `Shape.describe`.
    size : ndarray, shape (3,)
        Sizes as in `Shape.describe`, m.
    offset : float
        Of a half-space, m.
    corners : ndarray, shape (nv, 3)
        Corners, m; for spheres and capsules the centres of their balls.
    normals, edges : ndarray, shapes (nf, 3), (ne, 3)
        Unit vectors of faces and edges, each direction once.
    feet : ndarray, shape (nl, 6)
        A point on the line of every edge, and the unit vector of the line.
    radius : float
        Of the balls, m.
    bounding_radius : float
        Radius of a ball about the origin that contains the solid, m; infinite for a half-space.
    extent : float
        Smallest extent, twice the radius of the largest ball about the origin inside it, m.
    """

    kind: str
    size: Array
    offset: float
    corners: Array
    normals: Array
    edges: Array
    feet: Array
    radius: float
    bounding_radius: float
    extent: float

    @classmethod
    def described(cls, shape: Mapping[str, Any]) -> Solid:
        """Build the solid of a shape from the output of `Shape.describe`; ValueError for an unknown kind."""
        kind, size = shape["shape"], np.array(shape["size"], dtype=float)
        axis, none, offset, radius = np.array([[0.0, 0.0, 1.0]]), np.empty((0, 3)), 0.0, 0.0
        corners, normals, edges, feet = none, none, none, np.empty((0, 6))
        if kind == "halfspace":
            offset, bounding, extent = float(shape["offset"]), np.inf, np.inf
        elif kind == "sphere":
            corners, radius = np.zeros((1, 3)), float(size[0])
            bounding, extent = radius, 2.0 * radius
        elif kind == "capsule":
            corners, radius = np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]]), float(size[0])
            edges, feet = axis, np.hstack([corners[:1], axis])
            bounding, extent = radius + float(size[1]), 2.0 * radius
        elif kind == "cylinder":
            normals, edges = axis, axis
            bounding, extent = float(np.hypot(size[0], size[1])), 2.0 * float(size[:2].min())
        elif kind == "ellipsoid":
            bounding, extent = float(size.max()), 2.0 * float(size.min())
        elif kind in ("box", "convex"):
            corners = np.array(shape["vertices"], dtype=float)
            normals, edges, feet, depth = _features(corners, str(shape.get("name", kind)))
            bounding, extent = float(np.linalg.norm(corners, axis=1).max()), 2.0 * depth
        else:
            raise ValueError(f"shape must be one that Shape.describe names, got {kind!r}")
        return cls(kind, size, offset, corners, normals, edges, feet, radius, bounding, extent)

    @cached_property
    def span(self) -> tuple[Array, Array]:
        """Smallest and largest coordinate of the corners along each normal, shape (nf,) each, m."""
        along = self.corners @ self.normals.T
        return along.min(axis=0), along.max(axis=0)

    @cached_property
    def meeting(self) -> int:
        """Most edges that meet in one corner."""
        start, line = self.feet[:, :3], self.feet[:, 3:]
        off = np.linalg.norm(cross(self.corners[:, None] - start, line), axis=2)
        return int((off < 1e-9 * self.bounding_radius).sum(axis=1).max(initial=0))

    @property
    def smooth(self) -> bool:
        """Whether the solid is no hull of balls (a cylinder or an ellipsoid)."""
        return not len(self.corners) and self.kind != "halfspace"

    @property
    def rounding(self) -> float:
        """Smallest radius of curvature of the round part, m; 0 for solids with corners, infinite for a half-space."""
        if self.kind == "ellipsoid":
            return float(self.size.min() ** 2 / self.size.max())
        return {"halfspace": np.inf, "cylinder": float(self.size[0])}.get(self.kind, self.radius)

    @property
    def half(self) -> Array:
        """Half extents along the axes, shape (3,), m."""
        return 0.5 * (self.support(np.eye(3)) + self.support(-np.eye(3)))

    def support(self, n: Array) -> Array:
        """Largest n·x over the points x of the solid for unit vectors n (..., 3), shape (...), m."""
        out: Array
        if self.kind == "cylinder":
            out = self.size[0] * np.hypot(n[..., 0], n[..., 1]) + self.size[1] * np.abs(n[..., 2])
        elif self.kind == "ellipsoid":
            out = np.linalg.norm(n * self.size, axis=-1)
        else:
            out = (n @ self.corners.T).max(axis=-1) + self.radius
        return out

    def curvature(self, n: Array) -> tuple[Array, Array]:
        """Gradient of the support (a surface point) and its Hessian, for unit vectors n (m, 3), away from kinks."""
        hessian = np.zeros((len(n), 3, 3))
        if self.kind == "cylinder":
            side = np.maximum(np.hypot(n[:, 0], n[:, 1]), 1e-9)[:, None]  # the cap is a kink
            rim = n[:, :2] / side
            point = np.column_stack([self.size[0] * rim, np.copysign(self.size[1], n[:, 2])])
            hessian[:, :2, :2] = self.size[0] / side[..., None] * (np.eye(2) - rim[:, :, None] * rim[:, None, :])
        elif self.kind == "ellipsoid":
            h = np.linalg.norm(n * self.size, axis=1)
            point = n * self.size**2 / h[:, None]
            hessian = (np.diag(self.size**2) - point[:, :, None] * point[:, None, :]) / h[:, None, None]
        else:
            point = self.corners[(n @ self.corners.T).argmax(axis=1)] + self.radius * n
            hessian += self.radius * (np.eye(3) - n[:, :, None] * n[:, None, :])
        return point, hessian

    def beyond(self, x: Array) -> Array:
        """Distance of points x (m, 3) from the surface, negative inside, (m,), m; ellipsoids: to first order."""
        out: Array
        if self.kind == "cylinder":
            off = np.stack([np.hypot(x[:, 0], x[:, 1]) - self.size[0], np.abs(x[:, 2]) - self.size[1]], axis=1)
            out = np.linalg.norm(off.clip(0.0), axis=1) + off.max(axis=1).clip(None, 0.0)
        else:
            far = np.linalg.norm(x / self.size, axis=1)
            out = (far - 1.0) * far / np.maximum(np.linalg.norm(x / self.size**2, axis=1), 1e-300)
        return out


def _features(corners: Array, name: str) -> tuple[Array, Array, Array, float]:
    """Normals, edges, lines of edges and distance of the closest face of a hull, from its corners alone."""
    from scipy.spatial import ConvexHull, QhullError  # takes a tenth of a second to import, needless for spheres

    try:
        hull = ConvexHull(corners)
    except QhullError:
        raise ValueError(f"{name!r} must be thicker than the rounding of its corners for its overlaps") from None
    normals, depth = hull.equations[:, :3], float(-hull.equations[:, 3].max())
    lines = []
    for facet, neighbours in enumerate(hull.neighbors):
        for side, other in enumerate(neighbours):  # the neighbour opposite of a corner
            # An edge between faces that differ by less changes no separation by more than that fraction of the size.
            if facet < other and np.linalg.norm(normals[facet] - normals[other]) > 1e-8:
                i, j = np.delete(hull.simplices[facet], side)
                lines.append(np.r_[corners[i], (corners[j] - corners[i]) / np.linalg.norm(corners[j] - corners[i])])
    feet = np.array(lines)
    return _distinct(normals), _distinct(feet[:, 3:]), feet, depth


def _distinct(directions: Array) -> Array:
    """Unit vectors without repetitions and opposites."""
    from scipy.spatial import KDTree

    tree, near = KDTree(directions), 1e-9
    alike = zip(tree.query_ball_point(directions, near), tree.query_ball_point(-directions, near), strict=True)
    return directions[[min(same + opposite) == k for k, (same, opposite) in enumerate(alike)]]
