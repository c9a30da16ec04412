"""Surfaces with fewer triangles: corners in the same cell of a grid become one.

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

__all__ = ["simpler"]

FINEST = 2.0**-14
"""Side of a cell, of the surface: corners within one are the same, and coordinates are rounded to a quarter of it."""

GROWTH = 1.25
"""Of the cells, until there are few enough triangles."""

WORTH = 0.8
"""Triangles that a surface keeps at most where it is simplified: it would lose more than it saves."""


def simpler(surfaces: Sequence[tuple[float, Surface]], most: int) -> list[Surface]:
    """Surfaces with no more triangles than `most` in all, in cells of one size.

    Parameters
    ----------
    surfaces : sequence of (float, Surface)
        With the length in m of a unit of each.
    most : int
    """
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
    """The same with every corner once, in numbers that deflate well."""
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
    """(vertices, triangles) where corners in the same cell are one, in their middle."""
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
    """One number for each row of whole numbers, equal for equal rows; less than 2²¹ apart in each column."""
    low = rows.min(axis=0, initial=0)
    x, y, z = (rows - low).astype(np.int64).T
    out: Index = (x << 42) + (y << 21) + z
    return out
