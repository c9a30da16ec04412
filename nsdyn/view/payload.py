"""Values and arrays packed into one text that a page can unpack: JSON and bytes, deflated, in base64."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

ALIGNMENT = 8
"""Arrays begin at multiples of this number of bytes, as views of a browser's buffers require."""

BITS = 15
"""Bits of the mantissa of values that are shown as numbers: four and a half digits."""


def pack(values: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    """Pack JSON values and arrays into a text; bytes of equal weight are stored together and so compress best."""
    table, parts, at = {}, [], 0
    for name, array in arrays.items():
        array = np.ascontiguousarray(array)
        data = array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T.tobytes()
        table[name] = {"type": array.dtype.str[1:], "at": at, "size": array.size}
        parts.append(data.ljust(-(-len(data) // ALIGNMENT) * ALIGNMENT, b"\0"))
        at += len(parts[-1])
    head = json.dumps({"values": values, "arrays": table}, allow_nan=False).encode()
    head = head.ljust(-(-len(head) // ALIGNMENT) * ALIGNMENT)
    data = zlib.compress(len(head).to_bytes(ALIGNMENT, "little") + head + b"".join(parts), 6)
    return base64.b64encode(data).decode()


def rounded(values: ArrayLike) -> NDArray[np.float32]:
    """Round to single precision with BITS of 23 bits of mantissa: the remaining bits are zero and compress well."""
    whole = np.ascontiguousarray(values, dtype="<f4").view(np.uint32)
    cut = 23 - BITS
    finite = np.isfinite(whole.view("<f4"))
    out = np.where(finite, (whole + np.uint32(1 << (cut - 1))) & np.uint32(0xFFFFFFFF << cut & 0xFFFFFFFF), whole)
    return out.astype(np.uint32).view("<f4")
