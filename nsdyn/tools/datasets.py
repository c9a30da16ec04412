"""HDF5 files: safe writing of new files on a full disk, and safe reading of files from untrusted sources.

The sizes that a file declares are compared with the bytes in the file before any data are read: a few bytes may declare
any number of values, and HDF5 would allocate memory for them. Fields that lead to other files are refused.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

MULTIPLE = 1100
"""Largest number of bytes from one byte of a compressed file: gzip makes up to 1032."""


@contextmanager
def created(path: Path, **options: Any) -> Iterator[Any]:
    """Yield a new file with `options` of h5py, written as a whole when the block succeeds; OSError if that fails.

    It is made in memory, since HDF5 itself ends the process if the disk is full.
    """
    image = io.BytesIO()
    with h5py.File(image, "w", **options) as file:
        yield file
    path.write_bytes(image.getvalue())  # makes no copy, and no view, which the error of a full disk would keep open


def dataset(group: Any, name: str, rows: int | None = None) -> Any:
    """Return a dataset after a check that its first rows, or all, are in the file itself.

    ValueError naming a dataset that does not exist, or for which the file has fewer bytes than its size needs.
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
"""First bytes of a global heap collection, which holds texts."""


BLOCK = 1 << 22
"""Number of bytes searched at once."""


def check_heaps(path: Path) -> None:
    """Refuse files on whose texts HDF5 would loop forever: heaps have no checksums, and damaged ones steps of length 0.

    References
    ----------
    The HDF Group, HDF5 file format specification version 3.0, section III.E.
    """
    size = path.stat().st_size
    with open(path, "rb") as file:  # not mapped: with a map, a full disk or a cut file would end the process
        for begin in range(0, size, BLOCK):
            file.seek(begin)
            block = file.read(BLOCK + len(HEAP) - 1)
            found = block.find(HEAP)
            while found >= 0:
                _check_heap(file, begin + found, size, path)
                found = block.find(HEAP, found + 1)


def _check_heap(file: Any, at: int, size: int, path: Path) -> None:
    """Visit the objects of a heap in the way of HDF5; ValueError if the heap does not end."""

    def number(where: int) -> int:
        file.seek(where)
        return int.from_bytes(file.read(8), "little")

    end, item = at + number(at + 8), at + 16
    while item + 16 <= min(end, size):
        length, free = number(item + 8), number(item) % 2**16 == 0
        if item + length > end or (free and length < 16):
            raise ValueError(f"{path} is damaged: a heap of texts does not end")
        item += length if free else 16 + -(-length // 8) * 8
