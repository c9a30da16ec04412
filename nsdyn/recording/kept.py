"""Columns of a recording in memory, which grow during the run."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from nsdyn.recording.columns import Columns, rows_of

Part = tuple[Columns, tuple[int, ...] | None]
"""Arrays by columns, and the shape of the axes of rows to which they are broadcast; None for one axis of rows."""

MOST = 16
"""Largest factor by which memory grows at once: a run may end long before the expected number of steps."""


class Kept:
    """Growing columns. Columns with the same number of rows share a piece of memory: small pieces take 5 times as long.

    Parameters
    ----------
    columns : dict of str to ndarray
        First rows.
    expected : int
        Expected number of rows of steps, 0 if not known.
    """

    def __init__(self, columns: Columns, expected: int) -> None:
        self._arrays, self._expected = dict(columns), expected
        self._rows = {name: len(values) for name, values in columns.items()}

    def add(self, parts: Iterable[Part]) -> None:
        """Add rows to some of the columns."""
        ends = dict(self._rows)
        for columns, fitted in parts:
            for name, values in columns.items():
                shape = fitted or (len(values),)
                begin, end = ends[name], ends[name] + math.prod(shape)
                if end > len(self._arrays[name]):
                    self._grow(rows_of(name), end, ends)
                array = self._arrays[name]
                np.copyto(array[begin:end].reshape(*shape, *array.shape[1:]), values, casting="same_kind")
                ends[name] = end
        self._rows = ends  # for all columns at once: an earlier interrupt leaves the old rows

    def _grow(self, group: str, rows: int, ends: dict[str, int]) -> None:
        """Make room for `rows` rows of a group of columns, and for the rest of the run at the present rate of rows."""
        rows = int(rows * min(max(2.0, 1.1 * self._expected / max(1, ends["t"])), MOST))
        old = {name: array for name, array in self._arrays.items() if rows_of(name) == group}
        sizes = [rows * array.itemsize * math.prod(array.shape[1:]) for array in old.values()]
        room, at = np.empty(sum(sizes) + 8 * len(sizes), np.uint8), 0
        for (name, array), size in zip(old.items(), sizes, strict=True):
            self._arrays[name] = np.ndarray((rows, *array.shape[1:]), array.dtype, room, at)
            self._arrays[name][: ends[name]] = array[: ends[name]]
            at += size + -size % 8

    def columns(self) -> Columns:
        """Return the columns as views."""
        return {name: array[: self._rows[name]] for name, array in self._arrays.items()}

    def clear(self) -> None:
        """Remove all rows; keep the memory."""
        self._rows = dict.fromkeys(self._rows, 0)
