"""Numbers of mesh files, checked because the files may come from anywhere, and polygons cut into triangles."""

from __future__ import annotations

import numpy as np

from nsdyn.tools.arrays import Array, Index


def fans(corners: Index, sizes: Index) -> Index:
    """Cut polygons into triangles; `corners` holds the corners of all polygons in a row, `sizes` their numbers."""
    if sizes.size and sizes.min() < 3:
        raise ValueError(f"its faces must have 3 or more corners, got {sizes.min()}")
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    ends = np.cumsum(sizes)
    first = np.repeat(ends - sizes, sizes - 2)
    count = np.arange(first.size) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return corners[np.column_stack((first, first + count + 1, first + count + 2))]


def numbers(text: str | bytes | None, what: str) -> Array:
    """Return the numbers in a text."""
    try:
        return np.array((text or "").split(), dtype=float)
    except ValueError:
        raise ValueError(f"{what} must be numbers") from None


def whole(values: Array, what: str) -> Index:
    """Return the numbers as integers; ValueError if they are not whole."""
    if not (np.abs(values) < 2**31).all() or (values % 1.0).any():
        raise ValueError(f"{what} must be whole numbers")
    return values.astype(np.int64)
