"""Files to write: complete or not at all, links followed, what is no regular file written through."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["STDOUT", "check_folder", "check_writable", "is_file", "is_special", "resolved", "writing"]

STDOUT = Path("-")
"""Stands for standard output."""


def resolved(path: str | Path) -> Path:
    """Absolute path with links followed; ValueError naming it where they lead in a circle."""
    out = Path(os.path.realpath(path))
    if any(map(os.path.islink, (out, *out.parents))):  # which no other links are left as
        raise ValueError(f"cannot write {path}: its links lead in a circle")
    return out


def is_file(path: str | Path) -> bool:
    """Whether there is a file at a path, whatever the path is."""
    try:
        return Path(path).is_file()
    except OSError:  # of a name that is too long
        return False


def is_special(path: str | Path) -> bool:
    """Whether a path cannot be replaced, only written: standard output, a FIFO, a device."""
    path = Path(path)
    if path == STDOUT:
        return True
    # /dev/stdout may lead to a regular file, which the shell has open and would lose.
    opened = str(path.absolute()).startswith(("/dev/", "/proc/"))
    return os.path.exists(path) and not path.is_dir() and (opened or not path.is_file())


def check_writable(path: str | Path) -> None:
    """Raise a ValueError that names a path `writing` could not write, as far as one can tell before."""
    if path == STDOUT:
        return
    try:
        _check_writable(path)
    except PermissionError:  # of a folder on the way, which hides what is in it
        raise ValueError(f"cannot write {path}: permission denied") from None


def check_folder(path: str | Path) -> None:
    """Raise a ValueError that names a folder that is not there and cannot be made, or that nothing can be added to."""
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
    """`os.access` by the rights that opening goes by, the effective ones, where the system can tell."""
    return os.access(path, mode, effective_ids=os.access in os.supports_effective_ids)


@contextmanager
def writing(path: str | Path) -> Iterator[Path]:
    """Yield a file to write, which becomes `path` when the block succeeds; else nothing is left.

    A regular file is replaced as a whole and keeps its permissions; a link is followed. What is no regular file, and
    standard output for ``-``, is written through, also when the block succeeds only.

    Raises
    ------
    ValueError
        Naming the path, when it cannot be written.
    """
    path = Path(path)
    check_writable(path)
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


def _write_through(source: Path, path: Path) -> None:
    with open(source, "rb") as data:
        if path == STDOUT:
            sys.stdout.flush()
            shutil.copyfileobj(data, sys.stdout.buffer)
            sys.stdout.flush()
        else:
            with open(path, "wb") as sink:
                shutil.copyfileobj(data, sink)
