"""File with the points of a sweep, each written as soon as it is computed, so that a stopped sweep can go on."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from nsdyn.tools import files


class Store:
    """JSON lines: the description of the sweep, then a line per point; after a kill the last line may be incomplete.

    ValueError for a file that cannot be written, is written by another process, is not a store, or is the store of
    another sweep, naming the difference. OSError naming the file, here or when a point is added, if the disk is full.

    Parameters
    ----------
    path : path
        A file that does not exist yet, or the store of the same sweep.
    sweep : mapping
        All data on which the results depend, as JSON values.
    """

    def __init__(self, path: str | Path, sweep: Mapping[str, Any]) -> None:
        self.path = files.as_path(path, "store")
        files.check_writable(self.path, files.STORE)
        if files.is_special(self.path):
            raise ValueError(f"cannot store a sweep in {path}: it is no regular file, which lines could be added to")
        self._sweep = json.loads(_write({"sweep": sweep}))["sweep"]
        with self._told():
            self._file = open(self.path, "a+b")  # closed by __exit__
        try:
            self._begin(sweep)
        except BaseException:
            with suppress(OSError):  # closing writes again the data that a full disk did not accept
                self._file.close()
            raise

    def _begin(self, sweep: Mapping[str, Any]) -> None:
        """Lock the file until it is closed, read it, and cut off an incomplete last line."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"{self.path} is being written by another process, which runs this sweep") from None
        self._points, whole = self._found()
        with self._told():
            self._file.truncate(whole)
            if not whole:
                self._file.write(_write({"sweep": sweep}))
            self._file.flush()

    def _found(self) -> tuple[dict[str, dict[str, Any]], int]:
        """Return the points of the file by their parameters, and the number of bytes of its complete lines."""
        if not (lines := self.path.read_bytes().splitlines(keepends=True)):
            return {}, 0
        lines = lines if lines[-1].endswith(b"\n") else lines[:-1]
        try:
            head, *rows = map(json.loads, lines)
            found = head["sweep"]
            points = {_key(row["parameters"]): row for row in rows}
        except (ValueError, KeyError, TypeError):
            raise ValueError(f"{self.path} is not the store of a sweep: give another name, or remove it") from None
        for name in self._sweep.keys() | found.keys():
            if found.get(name) != self._sweep.get(name):
                raise ValueError(
                    f"{self.path} is the store of another sweep: its {name} is {found.get(name)!r}, "
                    f"not {self._sweep.get(name)!r}; give another name"
                )
        return points, sum(map(len, lines))

    def point(self, parameters: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return the stored parameters, result and failure of a point, None if it is not stored."""
        return self._points.get(_key(parameters))

    def count(self, points: Iterable[Mapping[str, Any]]) -> int:
        """Return how many of some points, given by their parameters, the file contains now."""
        found, _ = self._found()
        return sum(_key(parameters) in found for parameters in points)

    def add(self, point: Mapping[str, Any]) -> dict[str, Any]:
        """Write a point to the disk and return it as it will be read; ValueError for values that JSON does not have."""
        line = _write(point)
        with self._told():
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
        return json.loads(line)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Name the file in errors of the operating system."""
        try:
            yield
        except OSError as error:
            raise OSError(error.errno, f"cannot store the sweep in {self.path}: {error.strerror}") from None

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        with self._told():  # closing writes again the data that a full disk did not accept
            self._file.close()


def _write(value: Any) -> bytes:
    return _text(value).encode() + b"\n"


def _text(value: Any, sort_keys: bool = False) -> str:
    try:
        return json.dumps(value, default=_plain, sort_keys=sort_keys)
    except TypeError as error:
        raise ValueError(f"a store holds numbers, texts, lists and dicts of them: {error}; see `keep`") from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"got {type(value).__name__}")


def _key(parameters: Mapping[str, Any]) -> str:
    return _text(parameters, sort_keys=True)
