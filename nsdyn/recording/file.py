"""Files of recordings: HDF5 that any HDF5 library reads, with the layout of `nsdyn.recording.columns`.

During a run the file is open only for the few milliseconds in which rows are added, and then in HDF5's
single-writer-multiple-readers mode. A run that is killed therefore leaves the rows written so far in a file that opens
like any other. If the kill falls into these milliseconds, ``h5py.File(path, swmr=True)`` opens the file.
`nsdyn.Trajectory.load` opens it in either case. `/t` is written last: its length is the number of complete rows.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from nsdyn.recording import labels, schema, slots
from nsdyn.recording.columns import FORMAT_VERSION, LAYOUT, RAGGED, Columns, row_shapes, rows_of
from nsdyn.tools.datasets import check_heaps, created, dataset
from nsdyn.tools.files import is_file
from nsdyn.tools.unfinished import open_to_read

Saved = tuple[int, Columns]
Contents = tuple[Mapping[str, Any], Mapping[str, Any], Columns]
"""(meta, scene, columns) of a recording, as in `nsdyn.Trajectory`."""

GROWING, PACKED = 1 << 16, 1 << 18
"""Bytes of a chunk. In a growing file: quick to write, and small, so that small files stay small. In a complete file:
many steps, whose similarity compresses best."""

ROOM = 1 << 17
"""Additional bytes that HDF5 needs for its own tables when rows are added."""

REREADS = 5
"""How often a file is read again that a writer, which comes every half second, changed while it was read."""

WORTH = 4096
"""Smallest size in bytes of a dataset that is compressed: compression would make most smaller ones larger."""

COMPRESSED = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
"""Compression that every HDF5 library reads. Only complete files are compressed: a chunk that changes its size is
written to a new place, so that a file that grows by a few rows at a time would become larger with compression."""


def _row_counts(names: Iterable[str], states: int, ends: Mapping[str, int]) -> dict[str, int]:
    """Return the number of rows of each dataset in a recording with `states` states; `ends` are those of `RAGGED`."""
    count = {"states": states, "steps": states - 1, **ends}
    return {name: count[rows_of(name)] for name in names}


def _ends(source: Mapping[str, Any], row: int) -> dict[str, int]:
    """Return the number of rows until a state of each group of `RAGGED` that a file or columns contain."""
    return {group: int(source[f"{group}/offset"][row]) for group in RAGGED if f"{group}/offset" in source}


def until(columns: Columns, row: int) -> Columns:
    """Return the columns cut after the state of a row and the step before it."""
    sizes = _row_counts(columns, row + 1, _ends(columns, row))
    return {name: columns[name][:size] for name, size in sizes.items()}


def create(path: Path, contents: Contents, grow: bool, state: Saved | None = None) -> None:
    """Write a new file with datasets of fixed size, or ready to grow; `state` is (its row, its arrays)."""
    meta, scene, columns = contents
    with created(path, libver="latest") as file:
        file.create_group("meta").attrs.update(meta)
        text = json.dumps(scene)
        file["meta/scene"] = text
        file["meta/scene"].attrs["crc32"] = zlib.crc32(text.encode())
        for name, data in columns.items():
            options: dict[str, Any] = {}
            shape = tuple(max(1, size) for size in data.shape[1:])
            if grow:
                options = {"maxshape": (None, *data.shape[1:]), "chunks": (_growing(data), *shape)}
            elif data.size:
                rows = PACKED // (data.itemsize * math.prod(shape))
                options = {"chunks": (min(len(data), max(1, rows)), *shape), "fletcher32": True}
                if data.nbytes >= WORTH:
                    options |= COMPRESSED
            file.create_dataset(name, data=data, **options)
        if state is not None:
            slots.create(file, *state)
        labels.name_units(file, meta, columns)
        if not grow:
            labels.name_axes(file, scene, columns)


def _growing(data: NDArray[Any]) -> int:
    """Return the number of rows in a chunk of a growing dataset."""
    return min(1024, max(16, GROWING // (data.itemsize * max(1, math.prod(data.shape[1:])))))


def _reserve(path: Path, columns: Columns, state: Saved | None) -> None:
    """Reserve room for rows and a state at the end of a file, which HDF5 cuts off again; OSError without room.

    HDF5 does not survive a full disk: it writes only a part of the data, and the file no longer opens.
    """
    rows = sum(data.nbytes + 2 * data.nbytes // max(1, len(data)) * _growing(data) for data in columns.values())
    arrays = [] if state is None else list(state[1].values())
    room = rows + 2 * sum(a.nbytes for a in arrays) + ROOM
    with open(path, "r+b") as file:
        size = file.seek(0, os.SEEK_END)
        try:
            os.posix_fallocate(file.fileno(), size, room)
        except OSError as error:
            file.truncate(size)
            raise OSError(error.errno, f"cannot record in {path}: {os.strerror(error.errno or 0)}") from None


def extend(path: Path, columns: Columns, state: Saved | None = None) -> None:
    """Add rows to a file: all columns but `/t`, then, once these are written, `/t`; and the state of a row.

    Rows that an interrupted call left beyond the end of `/t` are overwritten. Locking is off, so that readers of the
    file cannot stop the simulation. Single-writer mode keeps the file readable at every moment.
    """
    _reserve(path, columns, state)
    with h5py.File(path, "r+", libver="latest", locking=False) as file:
        file.swmr_mode = True
        states = len(file["t"])
        ends = _ends(file, states - 1)
        for name, old in sorted(_row_counts(columns, states, ends).items(), key=lambda item: item[0] == "t"):
            if name == "t":
                file.flush()
            file[name].resize(old + len(columns[name]), axis=0)
            file[name][old:] = columns[name]
        if state is not None:
            slots.write(file, *state)


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns]:
    """Return (meta, scene, columns) of a file, as in `nsdyn.Trajectory`; errors as in `nsdyn.Trajectory.load`."""
    return read_state(path)[:3]


def read_state(path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns, Saved | None]:
    """Return (meta, scene, columns, last state with its row, or None) of a file; errors as in `read`."""
    if not is_file(path):
        raise FileNotFoundError(f"no such recording: {path}")
    if not h5py.is_hdf5(path):
        raise ValueError(f"{path} is not a recording of nsdyn: it is not an HDF5 file")
    check_heaps(path)
    left = REREADS
    while True:
        found = _changed(path)
        try:
            with open_to_read(path) as file:
                contents = _contents(file, path)
                return *contents, slots.read(file, len(contents[2]["t"]))
        except Exception as failure:  # h5py raises exceptions of many kinds for damaged files
            left -= 1
            if left >= 0 and _changed(path) != found:
                continue
            if isinstance(failure, ValueError) and str(path) in str(failure):
                raise
            raise ValueError(f"{path} is damaged: {failure.args[0] if failure.args else failure}") from None


def _changed(path: Path) -> tuple[int, int, int]:
    """Return what differs once a file has been written to or replaced."""
    status = path.stat()
    return status.st_ino, status.st_mtime_ns, status.st_size


def _contents(file: Any, path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns]:
    attributes = file["meta"].attrs if isinstance(file.get("meta"), h5py.Group) else {}
    meta = {k: v.item() if isinstance(v, np.generic) else v for k, v in attributes.items()}
    if not isinstance(meta.get("format"), str) or meta["format"] != "nsdyn":
        raise ValueError(f"{path} is not a recording of nsdyn: /meta with format='nsdyn' is missing")
    if not isinstance(meta.get("format_version"), int):
        raise ValueError(f"{path} is not a recording of nsdyn: /meta has no format_version")
    if meta["format_version"] != FORMAT_VERSION:
        raise ValueError(f"{path} has format_version {meta['format_version']}, this nsdyn reads {FORMAT_VERSION}")
    if "meta/scene" not in file:
        raise ValueError(f"{path} is not a recording of nsdyn: /meta/scene is missing")
    schema.check_meta(meta)
    described = dataset(file, "meta/scene")
    text = described[()]
    if zlib.crc32(text) != described.attrs.get("crc32", zlib.crc32(text)):
        raise ValueError("/meta/scene is not what was written")
    scene = schema.scene(text)
    shapes = row_shapes(meta, scene)
    if missing := [name for name in shapes if name not in file]:
        raise ValueError(f"{path} is not a recording of nsdyn: /{missing[0]} is missing")
    states = len(schema.column(file, "t", None, "f8", ()))
    if not states:
        raise ValueError("/t has no rows")
    offsets = {f"{group}/offset" for group in RAGGED} & shapes.keys()
    ends = _ends({name: schema.column(file, name, states, "i8", ()) for name in offsets}, -1)
    sizes = _row_counts(shapes, states, ends)
    columns = {name: schema.column(file, name, sizes[name], LAYOUT[name].kind, shapes[name]) for name in shapes}
    schema.check_rows(columns, scene)
    return meta, scene, columns
