"""The file of a recording: HDF5 that any HDF5 library reads.

Layout of the file (n steps, row 0 of a state is the initial one; SI units; quaternions xyzw)::

    /meta            attributes: format "nsdyn", format_version, dt, theta, solver, scene_name, external_force
                     (whether there was one; since version 3), versions of nsdyn, pin, coal, numpy; since
                     version 5 controller (whether there was one), impact, max_points, every, contacts, and
                     checksums, JSON {what: CRC-32} of what moves the scene and its description does not tell;
                     where they are known parameters, JSON {name: value} of what the scene was made with, and
                     command, the words typed after the prompt
    /meta/scene      JSON string, what `Scene.describe` returns: shapes, poses, gravity, frames; since version 3 the
                     pairs of shapes that may overlap; since version 7 the joints, inertias, loops and laws of
                     articulations
    /t               (n+1,)  s
    /q, /v           (n+1, nq), (n+1, nv)  Pinocchio's free-flyer of every free body (x y z qx qy qz qw;
                     linear then angular velocity in the body frame), then the articulations
    /frames/x, quat  (n+1, nframes, 3), (n+1, nframes, 4)  world poses; only in scenes with articulations
                                                   or driven bodies
    /energy/kinetic, potential                     (n+1,)  J
    /energy/external, normal, friction, damping, constraint, integration, projection, defect
                                                   (n,)  work of the step, J; damping and constraint since version 2;
                                                   before version 3 gyroscopic, theta and mass make up integration
    /energy/created                                (n,)  J, no term of the balance; since version 3
    /gauss/gap, shift, bound, coulomb              (n,)  J, m/s, sqrt(J), sqrt(J); coulomb since version 9, NaN unless
                                                   /meta has polish
    /solver/error, residual, iterations, status, time
                                                   (n,)  -, m/s, -, `nd.Status`, s; error since version 3
    /wall_time                                     (n,)  s that the step took, recording apart; since version 4
    /joints/actuation, limit, friction, external   (n, nv)  impulses on the coordinates of the articulations, N m s or
                                                   N s; only in scenes with articulations; since version 5, external
                                                   (of wrenches on their bodies) since version 7
    /joints/shift                                  (n, nv)  displacement by position projections, rad or m; since
                                                   version 7
    /joints/strength                               (n, nv)  most impulse that the actuators may give, N m s or N s;
                                                   infinite where they have no limit; since version 7
    /links/impulse                                 (n, links, 6)  on the links, one by joint in its order, of external
                                                   wrenches, and where not every step has its contacts here of all
                                                   contacts: force and moment about the world's origin, N s and N m s;
                                                   only where there are such; since version 7
    /joints/drive                                  (n, nv)  change of velocity of driven joints, rad/s or m/s; since
                                                   version 7
    /pieces/offset                                 (n+1,)  moves and impacts of step k are rows offset[k-1] to
                                                   offset[k] of the following, none of a step made in one move; only
                                                   in scenes with articulations; since version 7
    /pieces/begin, duration, contacts              (.,)  s after the beginning of the step; s, 0 of impacts in no time;
                                                   how many of the step's contacts, in their order, are of it
    /pieces/moves                                  (., nv)  1 for the coordinates of its island, 0 for others
    /pieces/actuation, limit, friction, external, shift, strength, drive
                                                   (., nv)  as of /joints
    /contacts/offset                               (n+1,)  contacts of step k, the one that ends at t[k], are
                                                   rows offset[k-1] to offset[k] of
    /contacts/geom1, geom2, key                    indices of the shapes; key of the warm start
    /contacts/point, normal, tangent               (., 3)  world; normal from 1 to 2; t1, and t2 = n x t1
    /contacts/gap, mu, restitution                 m, -, -
    /contacts/u, impulse                           (., 3)  (N, T1, T2) of 2 relative to 1, m/s; on 2, N·s, as the solver
                                                   found it: `impulse_raw` of `nsdyn.recording.series.ContactTable`
    /contacts/couple                               (., 3)  on 2, world, N·m·s, with which contacts that persist do no
                                                   work; since version 8
    /contacts/status                               0 open, 1 stick, 2 slip, 3 jam
    /contacts/work_normal, work_friction           J
    /contacts/time                                 s after the beginning of the step; since version 6
    /state           the last states of the run, from which it can go on: see `nsdyn.recording.slots`; since version 5

Where only every N-th step is recorded, a row stands for N steps: `/energy`'s works, `created` and `gap` are sums over
them, so that the ledger closes, as are `/joints`, `/links`, `/solver/iterations`, `time` and `/wall_time`; `shift`,
`bound` and `coulomb` are the largest, `error`, `residual` and `status` those of the worst; contacts are those of the
last, their impulses and works too; there are no `/pieces`. With contacts false there are none. A recording that is
complete is compressed (byte shuffle and gzip).

A file that is being recorded is open only for the few milliseconds in which rows are added to it, and then in
HDF5's single-writer-multiple-readers mode. So a run that is killed leaves the rows written so far in a file
that opens as any other; if the kill falls into those milliseconds, ``h5py.File(path, swmr=True)`` opens it,
and `nsdyn.Trajectory.load` does in either case. `/t` is written last: its length is the number of complete rows.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from nsdyn.recording import schema, slots
from nsdyn.tools.datasets import check_heaps, created, dataset
from nsdyn.tools.files import is_file
from nsdyn.tools.unfinished import open_to_read

__all__ = ["create", "extend", "read", "read_state", "until"]

Columns = dict[str, NDArray[Any]]
Saved = tuple[int, Columns]

FORMAT_VERSION = 9
CONTACT_STATES = ("open", "stick", "slip", "jam")

ENERGIES = ("kinetic", "potential")
PHYSICS = ("external", "normal", "friction", "damping", "constraint")
WORKS = (*PHYSICS, "integration", "projection", "defect")
GAUSS = ("gap", "shift", "bound", "coulomb")
SOLVER = {"error": "f8", "residual": "f8", "iterations": "i4", "status": "i1", "time": "f8"}
# Columns of a contact by name: (where a step has it, type, components).
CONTACT = {
    "geom1": ("contacts.geom1", "i4", 1),
    "geom2": ("contacts.geom2", "i4", 1),
    "point": ("contacts.point", "f8", 3),
    "normal": ("contacts.normal", "f8", 3),
    "gap": ("gap", "f8", 1),
    "mu": ("contacts.mu", "f8", 1),
    "restitution": ("contacts.restitution", "f8", 1),
    "key": ("contacts.key", "i8", 1),
    "u": ("u", "f8", 3),
    "impulse": ("r", "f8", 3),
    "status": ("contact_status", "i1", 1),
    "couple": ("couple", "f8", 3),
    "time": ("contact_time", "f8", 1),
    "tangent": ("tangent", "f8", 3),
    "work_normal": ("work_normal", "f8", 1),
    "work_friction": ("work_friction", "f8", 1),
}

# Datasets of a file by their number of rows: n + 1, n, and one per contact.
STATES = ["t", "q", "v", *(f"energy/{name}" for name in ENERGIES), "contacts/offset"]
LINKS = ["frames/x", "frames/quat"]
ON_JOINTS = ("actuation", "limit", "friction", "external", "shift", "strength", "drive")
JOINTS = [f"joints/{name}" for name in ON_JOINTS]
ON_LINKS = "links/impulse"
PIECES = {"begin": "f8", "duration": "f8", "contacts": "i8", "moves": "i1", **dict.fromkeys(ON_JOINTS, "f8")}
STEPS = [f"energy/{name}" for name in WORKS]
STEPS += [f"gauss/{name}" for name in GAUSS] + [f"solver/{name}" for name in SOLVER] + ["energy/created", "wall_time"]
# Columns that older files lack: (version, column, those that it is the sum of, its value without any).
ADDED: list[tuple[int, str, tuple[str, ...], float]] = [
    (2, "energy/damping", (), 0.0),
    (2, "energy/constraint", (), 0.0),
    (3, "energy/integration", ("energy/gyroscopic", "energy/theta", "energy/mass"), 0.0),
    (3, "energy/created", (), math.nan),
    (3, "solver/error", (), math.nan),
    (4, "wall_time", (), math.nan),
    (6, "contacts/time", (), math.nan),
    (8, "contacts/couple", (), math.nan),
    (9, "gauss/coulomb", (), math.nan),
]
# Attributes of /meta that older files lack.
ADDED_META = {"every": 1, "contacts": True, "parameters": "{}", "command": "", "polish": False}
CONTACTS = [f"contacts/{name}" for name in CONTACT]
RAGGED = ("contacts", "pieces")

GROWING, PACKED = 1 << 16, 1 << 18
"""Bytes of a chunk of a file that grows, quick to write and so small that small files stay small, and of one that is
complete: many steps, whose likeness compresses best."""

ROOM = 1 << 17
"""Bytes that HDF5 needs besides for its own tables when rows are added."""

WORTH = 4096
"""Bytes of a dataset from which on it is compressed: smaller ones would rather grow."""

COMPRESSED = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
"""What every HDF5 library reads. Only complete files are compressed: a chunk that changes its size is written to a new
place, so that one that grows, a few rows at a time, would become larger than without."""


def _rows(names: Iterable[str], states: int, ends: Mapping[str, int]) -> dict[str, int]:
    """Count the rows of each dataset in a recording of that many states; `ends` are those of contacts and pieces."""
    count = dict.fromkeys([*STATES, *LINKS, *(f"{group}/offset" for group in ends)], states)
    return {name: count.get(name, ends.get(name.partition("/")[0], states - 1)) for name in names}


def _ends(source: Mapping[str, Any], row: int) -> dict[str, int]:
    """How many contacts and pieces, where there are any, a file or columns have until a row."""
    return {group: int(source[f"{group}/offset"][row]) for group in RAGGED if f"{group}/offset" in source}


def until(columns: Columns, row: int) -> Columns:
    """The columns of the states until a row, and of the steps before it."""
    sizes = _rows(columns, row + 1, _ends(columns, row))
    return {name: columns[name][:size] for name, size in sizes.items()}


def create(
    path: Path, meta: Mapping[str, Any], scene: Mapping[str, Any], columns: Columns, grow: bool,
    state: Saved | None = None,
) -> None:  # fmt: skip
    """Write a new file, its datasets of fixed size or ready to grow; a state, the row it belongs to and its arrays."""
    with created(path, libver="latest") as file:
        file.create_group("meta").attrs.update(meta)
        file["meta/scene"] = json.dumps(scene)
        for name, data in columns.items():
            options: dict[str, Any] = {}
            shape = tuple(max(1, size) for size in data.shape[1:])
            if grow:
                options = {"maxshape": (None, *data.shape[1:]), "chunks": (_growing(data), *shape)}
            elif data.nbytes >= WORTH:
                rows = PACKED // (data.itemsize * math.prod(shape))
                options = {"chunks": (min(len(data), max(1, rows)), *shape), **COMPRESSED}
            file.create_dataset(name, data=data, **options)
        if state is not None:
            slots.create(file, *state)


def _growing(data: NDArray[Any]) -> int:
    """Rows of a chunk of a dataset that grows."""
    return min(1024, max(16, GROWING // (data.itemsize * max(1, math.prod(data.shape[1:])))))


def _reserve(path: Path, columns: Columns, state: Saved | None) -> None:
    """Have room for rows and a state at the end of a file, which HDF5 cuts off again; OSError where there is none.

    HDF5 does not survive a full disk: it goes on writing what still fits, and the file no longer opens.
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
    """Add rows to a file: all columns, then, when they have reached it, `/t`; and the state of a row.

    Rows an interrupted call left beyond the end of `/t` are written over. Locking is off, so that nobody who
    reads the file can stop the simulation; single-writer mode keeps it readable at every moment.
    """
    _reserve(path, columns, state)
    with h5py.File(path, "r+", libver="latest", locking=False) as file:
        file.swmr_mode = True
        states = len(file["t"])
        ends = _ends(file, states - 1)
        for name, old in sorted(_rows(columns, states, ends).items(), key=lambda item: item[0] == "t"):
            if name == "t":
                file.flush()
            file[name].resize(old + len(columns[name]), axis=0)
            file[name][old:] = columns[name]
        if state is not None:
            slots.write(file, *state)


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns]:
    """(meta, scene, columns) of a file, as `nsdyn.Trajectory` has them; errors as of `nsdyn.Trajectory.load`."""
    return _read(path)[:3]


def read_state(path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns, Saved | None]:
    """(meta, scene, columns, last state and the row it belongs to, if there is any) of a file; errors as of `read`."""
    return _read(path)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns, Saved | None]:
    if not is_file(path):
        raise FileNotFoundError(f"no such recording: {path}")
    if not h5py.is_hdf5(path):
        raise ValueError(f"{path} is not a recording of nsdyn: it is not an HDF5 file")
    check_heaps(path)
    try:
        with open_to_read(path) as file:
            contents = _contents(file, path)
            return *contents, slots.read(file, len(contents[2]["t"]))
    except Exception as failure:  # h5py raises many kinds for damaged files
        if isinstance(failure, ValueError) and str(path) in str(failure):
            raise
        raise ValueError(f"{path} is damaged: {failure.args[0] if failure.args else failure}") from None


def _contents(file: Any, path: Path) -> tuple[dict[str, Any], dict[str, Any], Columns]:
    attributes = file["meta"].attrs if isinstance(file.get("meta"), h5py.Group) else {}
    meta = {k: v.item() if isinstance(v, np.generic) else v for k, v in attributes.items()}
    if not isinstance(meta.get("format"), str) or meta["format"] != "nsdyn":
        raise ValueError(f"{path} is not a recording of nsdyn: /meta with format='nsdyn' is missing")
    if not isinstance(meta.get("format_version"), int):
        raise ValueError(f"{path} is not a recording of nsdyn: /meta has no format_version")
    if meta["format_version"] > FORMAT_VERSION:
        raise ValueError(f"{path} has format_version {meta['format_version']}, this nsdyn reads up to {FORMAT_VERSION}")
    added = [row for row in ADDED if meta["format_version"] < row[0]]
    parts = [part for _, _, parts, _ in added for part in parts]
    absent = {column for _, column, _, _ in added}
    steps, contacts = ([name for name in group if name not in absent] for group in (STEPS + parts, CONTACTS))
    missing = [name for name in ["meta/scene", *STATES, *steps, *contacts] if name not in file]
    if missing:
        raise ValueError(f"{path} is not a recording of nsdyn: /{missing[0]} is missing")
    meta = ADDED_META | meta | {"format_version": FORMAT_VERSION}
    schema.check_meta(meta)
    states = len(schema.column(file, "t", None, "f8", ()))
    if not states:
        raise ValueError("/t has no rows")
    joints = [name for name in (*JOINTS, ON_LINKS) if name in file]
    pieces = ["pieces/offset", *(f"pieces/{name}" for name in PIECES)] if "pieces" in file else []
    offsets = [name for name in (*STATES, *pieces) if name.endswith("/offset")]
    ends = _ends({name: schema.column(file, name, states, "i8", ()) for name in offsets}, -1)
    names = STATES + (LINKS if "frames" in file else []) + steps + joints + pieces + contacts
    rows = _rows(names, states, ends)
    columns = {name: schema.column(file, name, size, *_layout(name)) for name, size in rows.items()}
    for name, size in _rows(absent, states, ends).items():
        width = CONTACT.get(name.rpartition("/")[2], ("", "", 1))[2]
        columns[name] = np.empty((size, width) if width > 1 else size)
    for _, column, summed, value in added:
        columns[column] = sum((columns.pop(part) for part in summed), np.full(columns[column].shape, value))
    text = dataset(file, "meta/scene")
    return meta, schema.scene(text[()], columns), columns


def _layout(name: str) -> tuple[str, tuple[int | None, ...]]:
    """(type, shape of a row) of a column, None for any length."""
    group, _, inner = name.partition("/")
    if group == "contacts" and inner in CONTACT:
        _, kind, components = CONTACT[inner]
        return kind, () if components == 1 else (components,)
    if group == "solver":
        return SOLVER[inner], ()
    if group == "pieces" and inner != "offset":
        return PIECES[inner], (None,) if inner in (*ON_JOINTS, "moves") else ()
    row: tuple[str, tuple[int | None, ...]] = ("f8", (None,))
    return {
        "q": row, "v": row, **dict.fromkeys(JOINTS, row), ON_LINKS: ("f8", (None, 6)),
        "frames/x": ("f8", (None, 3)), "frames/quat": ("f8", (None, 4)),
        "contacts/offset": ("i8", ()), "pieces/offset": ("i8", ()),
    }.get(name, ("f8", ()))  # fmt: skip
