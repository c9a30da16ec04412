"""Text of arrays for JSON: little-endian numbers, bytes of equal significance together, deflated, in base64."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_text(array: NDArray[Any], kind: str) -> str:
    """Return the text of an array, with its numbers converted to a type of NumPy, for instance "<f4"."""
    numbers = np.ascontiguousarray(array, kind).reshape(-1)
    return base64.b64encode(zlib.compress(numbers.view(np.uint8).reshape(-1, numbers.itemsize).T.tobytes(), 6)).decode()


def from_text(text: str, kind: str, columns: int) -> NDArray[Any]:
    """Return the array (., columns) from a text of `to_text`; ValueError for any other text."""
    try:
        data = np.frombuffer(zlib.decompress(base64.b64decode(text, validate=True)), np.uint8)
        width = np.dtype(kind).itemsize
        return np.ascontiguousarray(data.reshape(width, -1).T).reshape(-1).view(kind).reshape(-1, columns)
    except (ValueError, zlib.error) as failure:
        raise ValueError(f"is no text of numbers: {failure}") from None
