"""Fields of HDF5 files that strangers made.

Sizes that a file declares are compared with the bytes it holds before anything is read: a few bytes may declare any
number of values, and HDF5 would make room for them. Fields that lead to other files are refused.
"""

from __future__ import annotations

import math
from typing import Any

import h5py

__all__ = ["MULTIPLE", "dataset"]

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
