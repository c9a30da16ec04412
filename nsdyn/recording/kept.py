"""Columns of a recording that grow while it is made."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from nsdyn.recording.columns import RAGGED, Columns

__all__ = ["Kept", "Part"]

Part = tuple[Columns, tuple[int, ...] | None]
"""Arrays by columns, and axes of the rows that they make, along which they may be stretched; None for one, as it is."""

MOST = 16
"""Most that memory for rows grows at once: what a run is expected to need may be far beyond what it will."""


class Kept:
    """Columns that grow, those with as many rows in one piece of memory: small pieces take five times as long.

    Parameters
    ----------
    columns : dict of str to ndarray
        That they begin with.
    expected : int
        How many rows of steps there will be, 0 where that is not known.
    """

    def __init__(self, columns: Columns, expected: int) -> None:
        self._arrays, self._expected = dict(columns), expected
        self._rows = {name: len(values) for name, values in columns.items()}

    def add(self, parts: Iterable[Part]) -> None:
        """Add rows to some of them."""
        ends = dict(self._rows)
        for columns, fitted in parts:
            for name, values in columns.items():
                shape = fitted or (len(values),)
                begin, end = ends[name], ends[name] + math.prod(shape)
                if end > len(self._arrays[name]):
                    self._grow(_group(name), end, ends)
                array = self._arrays[name]
                np.copyto(array[begin:end].reshape(*shape, *array.shape[1:]), values, casting="same_kind")
                ends[name] = end
        self._rows = ends  # all at once: an interrupt before leaves what was there

    def _grow(self, group: str, rows: int, ends: dict[str, int]) -> None:
        """Make room for rows of a group of columns, and for all that follow if the run goes on like this."""
        rows = int(rows * min(max(2.0, 1.1 * self._expected / max(1, ends["t"])), MOST))
        old = {name: array for name, array in self._arrays.items() if _group(name) == group}
        sizes = [rows * array.itemsize * math.prod(array.shape[1:]) for array in old.values()]
        room, at = np.empty(sum(sizes) + 8 * len(sizes), np.uint8), 0
        for (name, array), size in zip(old.items(), sizes, strict=True):
            self._arrays[name] = np.ndarray((rows, *array.shape[1:]), array.dtype, room, at)
            self._arrays[name][: ends[name]] = array[: ends[name]]
            at += size + -size % 8

    def columns(self) -> Columns:
        """Them, as views."""
        return {name: array[: self._rows[name]] for name, array in self._arrays.items()}

    def clear(self) -> None:
        """Begin anew, in the same arrays."""
        self._rows = dict.fromkeys(self._rows, 0)


def _group(name: str) -> str:
    """Which columns have as many rows: those of one of `RAGGED`, or of steps."""
    group, _, inner = name.partition("/")
    return group if group in RAGGED and inner != "offset" else "steps"
