"""Numbers of mesh files: checked, since they come from strangers, and polygons in triangles."""

from __future__ import annotations

import numpy as np

from nsdyn.tools.arrays import Array, Index

__all__ = ["fans", "numbers", "whole"]


def fans(corners: Index, sizes: Index) -> Index:
    """Triangles of polygons with so many corners each, all corners in a row."""
    if sizes.size and sizes.min() < 3:
        raise ValueError(f"its faces must have 3 or more corners, got {sizes.min()}")
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    ends = np.cumsum(sizes)
    first = np.repeat(ends - sizes, sizes - 2)
    count = np.arange(first.size) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    out: Index = corners[np.column_stack((first, first + count + 1, first + count + 2))]
    return out


def numbers(text: str | bytes | None, what: str) -> Array:
    """The numbers in a text."""
    try:
        return np.array((text or "").split(), dtype=float)
    except ValueError:
        raise ValueError(f"{what} must be numbers") from None


def whole(values: Array, what: str) -> Index:
    """The same numbers as integers."""
    if not (np.abs(values) < 2**31).all() or (values % 1.0).any():
        raise ValueError(f"{what} must be whole numbers")
    return values.astype(np.int64)
