"""Writing of files: complete or not at all, never over a file of another kind; to links and devices, too."""

from __future__ import annotations

import csv
import errno
import fcntl
import os
import re
import shutil
import struct
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Kind:
    """Kind of a file: its name in words, and the endings that a file name may have, if it has one."""

    what: str
    endings: tuple[str, ...]


RECORDING, PROBLEM = Kind("recording", ("h5", "hdf5")), Kind("contact problem", ("hdf5", "h5"))
PAGE, FILM = Kind("page", ("html", "htm")), Kind("film", ("mp4",))
PICTURE, FRAME = Kind("picture", ("png", "pdf", "svg")), Kind("picture", ("png",))
TABLE, PARQUET = Kind("table", ("csv", "txt")), Kind("Parquet table", ("parquet",))
STORE, SCENE = Kind("store", ("jsonl",)), Kind("scene file", ("py",))

_HDF5 = b"\x89HDF\r\n\x1a\n"
_BEGIN = {
    "picture": rb"\x89PNG|%PDF|\s*<\?xml.*<svg|\s*<svg",
    "film": rb".{4}ftyp",
    "Parquet table": rb"PAR1",
    "page": rb"(?i:\s*<(!doctype )?html)",
    "store": rb'\{"sweep"',
}
"""First bytes of files of each kind, as regular expressions."""

STDOUT = Path("-")
"""Path that means standard output."""


def as_path(value: Any, what: str = "path") -> Path:
    """Return a value as a path; ValueError naming `what` if it is not a path."""
    if not isinstance(value, (str, os.PathLike)) or "\0" in str(value):
        raise ValueError(f"{what} must be a path, got {value!r}")
    return Path(value)


def resolved(path: str | Path) -> Path:
    """Return the absolute path with links followed; ValueError naming the path if its links lead in a circle."""
    out = Path(os.path.realpath(path))
    if any(map(os.path.islink, (out, *out.parents))):  # only circular links remain
        raise ValueError(f"cannot write {path}: its links lead in a circle")
    return out


def is_file(path: str | Path) -> bool:
    """Return whether a path leads to a file; False also for invalid paths."""
    try:
        return Path(path).is_file()
    except OSError:  # for instance a name that is too long
        return False


def is_special(path: str | Path) -> bool:
    """Return whether a path can be written but not replaced: standard output, a FIFO, a device."""
    path = as_path(path)
    if path == STDOUT:
        return True
    # /dev/stdout may lead to a regular file, which the shell has open and would lose.
    opened = str(path.absolute()).startswith(("/dev/", "/proc/"))
    return os.path.exists(path) and not path.is_dir() and (opened or not path.is_file())


def check_writable(path: str | Path, kind: Kind) -> None:
    """Raise a ValueError naming the path if `writing` could not write it, as far as that is known in advance."""
    if (path := as_path(path)) == STDOUT:
        return
    try:
        _check_writable(path)
        if not is_special(path):
            _check_kind(path, kind)
    except PermissionError:  # a folder on the path hides its contents
        raise ValueError(f"cannot write {path}: permission denied") from None


def _check_kind(path: Path, kind: Kind) -> None:
    """Refuse an ending of another kind, and to replace a file that is known to be of another kind."""
    if path.suffix and path.suffix[1:].lower() not in kind.endings:
        raise ValueError(f"cannot write {path}: a {kind.what} must be {' or '.join(kind.endings)}, got {path.suffix}")
    if is_file(path) and (there := _kind_of(path)) and there != kind.what:
        raise ValueError(f"cannot write {path}: the file there is a {there}, no {kind.what}; remove it first")


def _kind_of(path: Path) -> str:
    """Return the kind of a file in words; empty if it is not known, or the file is too damaged."""
    with suppress(OSError), open(path, "rb") as file:
        head = file.read(1024)
        if head.startswith(_HDF5):
            return _kind_of_hdf5(path)
        return next((what for what, begin in _BEGIN.items() if re.match(begin, head, re.DOTALL)), "")
    return ""


def _kind_of_hdf5(path: Path) -> str:
    import h5py  # slow to import, and seldom needed here

    with suppress(Exception), h5py.File(path, "r", locking=False) as file:  # damaged files raise many kinds of errors
        if "meta" in file and file["meta"].attrs.get("format") == "nsdyn":
            return RECORDING.what
        if any(name.startswith("fclib_") for name in file):
            return PROBLEM.what
        return "HDF5 file of another program" if len(file) else ""
    return ""


def lock(path: Path) -> int:
    """Open a file and lock it until its descriptor is closed; ValueError naming the file if another run has locked it.

    Readers and HDF5's own locks are not affected. Systems without locks of open files do not lock.
    """
    descriptor = os.open(path, os.O_WRONLY)
    if kind := getattr(fcntl, "F_OFD_SETLK", None):
        try:
            fcntl.fcntl(descriptor, kind, struct.pack("hhqqi", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0))
        except OSError as failure:
            if failure.errno in (errno.EAGAIN, errno.EACCES):
                os.close(descriptor)
                raise ValueError(f"{path} is being recorded by another run: give another name, or wait") from None
    return descriptor


def check_folder(path: str | Path) -> None:
    """Raise a ValueError naming a folder that does not exist and cannot be made, or to which no file can be added."""
    there = resolved(path)
    while not os.path.lexists(there):
        there = there.parent
    if not there.is_dir() or not _may(there, os.W_OK | os.X_OK):
        raise ValueError(f"cannot write in {path}: {'permission denied' if there.is_dir() else f'{there} is a file'}")


def _check_writable(path: str | Path) -> None:
    target = resolved(path)
    special = is_special(path)
    if target.is_dir():
        raise ValueError(f"cannot write {path}: it is a folder")
    if not special and not target.parent.is_dir():
        raise ValueError(f"cannot write {path}: there is no folder {target.parent}")
    if not _may(path if special else target.parent, os.W_OK) or (target.exists() and not _may(target, os.W_OK)):
        raise ValueError(f"cannot write {path}: permission denied")


def _may(path: str | Path, mode: int) -> bool:
    """Call `os.access` with the effective rights, which are those for opening files, if the system supports it."""
    return os.access(path, mode, effective_ids=os.access in os.supports_effective_ids)


@contextmanager
def writing(path: str | Path, kind: Kind) -> Iterator[Path]:
    """Yield a file of a kind to write, which becomes `path` when the block succeeds; otherwise no file is left.

    A regular file is replaced as a whole and keeps its permissions; a link is followed. Data for a path that is not a
    regular file, and for standard output (``-``), are copied to it, also only when the block succeeds. ValueError
    naming a path that cannot be written, or whose ending or existing file is of another kind.
    """
    path = as_path(path)
    check_writable(path, kind)
    try:
        if is_special(path):
            with tempfile.TemporaryDirectory(prefix="nsdyn-") as folder:
                part = Path(folder) / "part"
                yield part
                _write_through(part, path)
            return
        target = resolved(path)
        part = target.with_name(f".{target.name}.{os.getpid()}.part")
        try:
            part.touch()
            if target.exists():
                shutil.copymode(target, part)
            yield part
            os.replace(part, target)
        finally:
            part.unlink(missing_ok=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from error


def write_csv(path: str | Path, headers: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table with all digits; cells are empty for None and NaN. Errors as in `writing`."""
    with writing(path, TABLE) as part, open(part, "w", newline="", encoding="utf-8") as file:
        sink = csv.writer(file, lineterminator="\n")
        sink.writerow(headers)
        sink.writerows([None if cell != cell else cell for cell in row] for row in rows)


def _write_through(source: Path, path: Path) -> None:
    with open(source, "rb") as data:
        if path == STDOUT:
            sys.stdout.flush()
            shutil.copyfileobj(data, sys.stdout.buffer)
            sys.stdout.flush()
        else:
            with open(path, "wb") as sink:
                shutil.copyfileobj(data, sink)
