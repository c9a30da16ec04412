"""Surfaces with fewer triangles: all corners in one cell of a grid are merged into one corner.

References
----------
J. Rossignac, P. Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993.
P. Lindstrom, Out-of-core simplification of large polygonal models, 2000.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.scene.meshes import Surface
from nsdyn.tools.arrays import Array, Index

FINEST = 2.0**-14
"""Side of a cell over the extent of the surface: corners in one cell are merged, and rounded to a quarter of a cell."""

GROWTH = 1.25
"""Factor by which the cells grow until the number of triangles is small enough."""

WORTH = 0.8
"""Greatest share of its triangles that a simplified surface keeps; above it simplification costs more than it saves."""


def simpler(surfaces: Sequence[tuple[float, Surface]], most: int) -> list[Surface]:
    """Simplify surfaces, each after the length of its unit in m, to at most `most` triangles, in cells of one size."""
    whole = [_welded(surface) for _, surface in surfaces]
    lengths = [length for length, _ in surfaces]
    out, cell = whole, 0.0
    while sum(len(surface.triangles) for surface in out) > most:
        area = sum(length**2 * _area(surface) for length, surface in zip(lengths, whole, strict=True))
        cell = GROWTH * cell or float(np.sqrt(area / most))
        out = [_clustered(surface, cell / length) for surface, length in zip(whole, lengths, strict=True)]
    return out


def _area(surface: Surface) -> float:
    a, b, c = surface.vertices[surface.triangles].transpose(1, 0, 2)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _welded(surface: Surface) -> Surface:
    """Return the same surface with every corner once, with coordinates rounded so that they compress well."""
    corners = surface.vertices[np.unique(surface.triangles)]
    extent = float(np.ptp(corners, axis=0).max())
    grid = 2.0 ** np.floor(np.log2(max(FINEST * extent, 1e-300)))
    vertices, triangles = _merged(surface, np.floor(surface.vertices / grid))
    return Surface(np.round(vertices / grid * 4.0) * grid / 4.0, triangles)


def _clustered(surface: Surface, cell: float) -> Surface:
    vertices, triangles = _merged(surface, np.floor(surface.vertices / cell))
    if len(triangles) > WORTH * len(surface.triangles):
        return surface
    grid = 2.0 ** np.floor(np.log2(cell / 64.0))
    return Surface(np.round(vertices / grid) * grid, triangles)


def _merged(surface: Surface, cells: Array) -> tuple[Array, Index]:
    """Merge the corners in each cell into their mean; return (vertices, triangles)."""
    used, corners = np.unique(surface.triangles, return_inverse=True)
    _, cell = np.unique(_numbers(cells[used]), return_inverse=True)
    triangles = cell[corners].reshape(-1, 3)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(_numbers(np.sort(triangles, axis=1)), return_index=True)
    triangles = triangles[np.sort(first)]
    count = np.bincount(cell)
    middle = [np.bincount(cell, weights=x) / count for x in surface.vertices[used].T]
    left, triangles = np.unique(triangles, return_inverse=True)
    return np.column_stack(middle)[left], triangles.reshape(-1, 3)


def _numbers(rows: NDArray[Any]) -> Index:
    """Return one number for each row of whole numbers, equal for equal rows; columns must span less than 2²¹."""
    low = rows.min(axis=0, initial=0)
    x, y, z = (rows - low).astype(np.int64).T
    return (x << 42) + (y << 21) + z
