"""Fields of HDF5 files that strangers made.

Sizes that a file declares are compared with the bytes it holds before anything is read: a few bytes may declare any
number of values, and HDF5 would make room for them. Fields that lead to other files are refused.
"""

from __future__ import annotations

import math
import mmap
from pathlib import Path
from typing import Any

import h5py

__all__ = ["MULTIPLE", "check_heaps", "dataset"]

MULTIPLE = 1100
"""Bytes that a byte of a file may stand for: gzip makes 1032 of one."""


def dataset(group: Any, name: str, rows: int | None = None) -> Any:
    """A dataset whose first rows, or all, are in the file itself.

    Raises
    ------
    ValueError
        Naming it, where there is none, or fewer bytes than its size takes.
    """
    where = f"{group.name}/{name}".replace("//", "/")
    item = None
    if isinstance(group.get(name, getlink=True), h5py.HardLink):
        item = group[name]
    if not isinstance(item, h5py.Dataset) or item.shape is None or item.is_virtual or item.external:
        raise ValueError(f"{where} is missing, or no dataset of its own")
    count = min(len(item) if rows is None else rows, len(item)) if item.ndim else 1
    wanted = item.dtype.itemsize * count * math.prod(item.shape[1:])
    chunk = item.dtype.itemsize * math.prod(item.chunks or ()) if wanted else 0
    stored = min(item.id.get_storage_size(), item.file.id.get_filesize())
    filtered = item.id.get_create_plist().get_nfilters() > 0
    if max(wanted, chunk) > stored * (MULTIPLE if filtered else 1):
        raise ValueError(f"{where} has a size of {item.shape} and {stored} bytes in the file")
    return item


HEAP = b"GCOL\x01\0\0\0"
"""What a global heap collection, which holds texts, begins with."""


def check_heaps(path: Path) -> None:
    """Refuse files on whose texts HDF5 would not come to an end: its heaps have no checksums, and steps of no length.

    Raises
    ------
    ValueError
        Naming the file.

    References
    ----------
    The HDF Group, HDF5 file format specification version 3.0, section III.E.
    """
    if not path.stat().st_size:
        return
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(HEAP)
        while at >= 0:
            end, item = at + int.from_bytes(data[at + 8 : at + 16], "little"), at + 16
            while item + 16 <= min(end, len(data)):
                size = int.from_bytes(data[item + 8 : item + 16], "little")
                free = data[item : item + 2] == b"\0\0"
                if item + size > end or (free and size < 16):
                    raise ValueError(f"{path} is damaged: a heap of texts does not end")
                item += size if free else 16 + -(-size // 8) * 8
            at = data.find(HEAP, at + len(HEAP))
