"""HDF5 files: new ones that survive a full disk, and fields of those that strangers made.

Sizes that a file declares are compared with the bytes it holds before anything is read: a few bytes may declare any
number of values, and HDF5 would make room for them. Fields that lead to other files are refused.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

__all__ = ["MULTIPLE", "check_heaps", "created", "dataset"]

MULTIPLE = 1100
"""Bytes that a byte of a file may stand for: gzip makes 1032 of one."""


@contextmanager
def created(path: Path, **options: Any) -> Iterator[Any]:
    """A new file with `options` of h5py, written as a whole when the block succeeds; OSError where it cannot be.

    It is made in memory: HDF5 itself ends the process where the disk is full.
    """
    image = io.BytesIO()
    with h5py.File(image, "w", **options) as file:
        yield file
    path.write_bytes(image.getvalue())  # no copy, nor a view, which the error of a full disk would keep open


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


BLOCK = 1 << 22
"""Bytes that are looked through at once."""


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
    size = path.stat().st_size
    with open(path, "rb") as file:  # not mapped: a map ends the process where the disk is full or the file is cut
        for begin in range(0, size, BLOCK):
            file.seek(begin)
            block = file.read(BLOCK + len(HEAP) - 1)
            found = block.find(HEAP)
            while found >= 0:
                _check_heap(file, begin + found, size, path)
                found = block.find(HEAP, found + 1)


def _check_heap(file: Any, at: int, size: int, path: Path) -> None:
    """Walk over the objects of a heap as HDF5 does."""

    def number(where: int) -> int:
        file.seek(where)
        return int.from_bytes(file.read(8), "little")

    end, item = at + number(at + 8), at + 16
    while item + 16 <= min(end, size):
        length, free = number(item + 8), number(item) % 2**16 == 0
        if item + length > end or (free and length < 16):
            raise ValueError(f"{path} is damaged: a heap of texts does not end")
        item += length if free else 16 + -(-length // 8) * 8
