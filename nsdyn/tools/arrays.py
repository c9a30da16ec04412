"""Arrays as annotations name them, and of what a user gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Array", "Bools", "Index", "numbers"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


def numbers(value: ArrayLike, words: str, what: str) -> Array:
    """An array of numbers, the same if it is one; ValueError with what it must be, in words, for what is none."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be {words}, got {value!r}") from None
