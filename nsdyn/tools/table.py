"""Tables: named columns with units, for printing, notebooks, spreadsheets and data frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from importlib import import_module
from math import inf, isnan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.tools import files, notebook
from nsdyn.tools.naming import choice, counted, unknown
from nsdyn.tools.options import is_number

SHOWN = 40
"""Largest number of rows that are printed."""

WIDTH = 100
"""Largest number of characters in a line of a table's repr."""

NOTHING = 1e-12
"""Fraction of the largest printed number of a unit, at least of 1: smaller numbers are round-off and printed as 0."""


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length by name: ``table["speed"]`` is an array, ``table[rows]`` a table of some rows.

    Attributes
    ----------
    title : str
    columns : dict of str to ndarray, shape (rows,)
        Texts, or numbers with NaN for empty cells.
    units : dict of str to str
        Units of the columns that have one.

    Examples
    --------
    >>> import nsdyn as nd
    >>> table = nd.simulate(nd.scenes.load("slide")(), 0.02, dt=0.01).table("bodies")
    >>> table["speed"].round(3).tolist(), table.headers[-1]
    ([2.0, 1.951, 1.902], 'force_z [N]')
    """

    title: str
    columns: dict[str, NDArray[Any]]
    units: Mapping[str, str]

    @property
    def headers(self) -> tuple[str, ...]:
        """Names of the columns with their units, ``speed [m/s]``."""
        return tuple(f"{name} [{unit}]" if (unit := self.units.get(name)) else name for name in self.columns)

    def __getitem__(self, which: Any) -> Any:
        if isinstance(which, str):
            return self.columns[choice(which, self.columns, "column")]
        return Table(self.title, {name: values[which] for name, values in self.columns.items()}, self.units)

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def select(self, *names: str) -> Table:
        """Return a table with only the named columns."""
        columns = {name: self.columns[choice(name, self.columns, "column")] for name in names}
        return Table(self.title, columns, self.units)

    def to_pandas(self) -> Any:
        """Return a pandas.DataFrame with the `headers` as names of columns; ValueError if pandas is not installed."""
        return _needed("pandas").DataFrame(dict(zip(self.headers, self.columns.values(), strict=True)))

    def to_parquet(self, path: str | Path) -> None:
        """Write an Apache Parquet file; ValueError if pyarrow is not installed, or naming the path if writing fails."""
        arrow, parquet = _needed("pyarrow"), _needed("pyarrow.parquet")
        with files.writing(path, files.PARQUET) as part:
            parquet.write_table(arrow.table(dict(zip(self.headers, self.columns.values(), strict=True))), part)

    def to_csv(self, path: str | Path) -> None:
        """Write a CSV file with all digits and empty cells for NaN; ValueError naming the path if writing fails."""
        files.write_csv(path, self.headers, zip(*(x.tolist() for x in self.columns.values()), strict=True))

    def text(self, width: float = inf) -> str:
        """Return the first rows, right-aligned; middle columns are left out of lines longer than `width` characters."""
        if not is_number(width) or isnan(width):
            raise ValueError(f"width must be a number of characters, got {width!r}")
        lines = self._fitting([list(self.headers), *self._cells(SHOWN)], width)
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        out = ["  ".join(map(str.rjust, line, widths)) for line in lines]
        return "\n".join([*out, *([f"... {more}"] if (more := self._more(SHOWN, lines[0])) else [])])

    def __repr__(self) -> str:
        return self.text(WIDTH)

    def _fitting(self, lines: list[list[str]], width: float) -> list[list[str]]:
        """Return the columns from both ends that fit into the width, with a column of dots between them."""
        widths = [max(map(len, column)) + 2 for column in zip(*lines, strict=True)]
        if sum(widths) - 2 <= width:
            return lines
        left = right = 0
        room = width - len("...")
        while (room := room - (widths[left] if left == right else widths[-1 - right])) >= 0:
            left, right = (left + 1, right) if left == right else (left, right + 1)
        return [[*line[:left], "...", *line[len(line) - right :]] for line in lines]

    def _more(self, rows: int, headers: Sequence[str]) -> str:
        """Say how many rows and columns are not shown."""
        rest = [counted(len(self) - rows, "more row")] if len(self) > rows else []
        if "..." in headers:
            columns = counted(len(self.columns) - len(headers) + 1, "more column")
            rest.append(f"{columns}, of which `headers` has the names")
        return ", ".join(rest)

    def _cells(self, rows: int) -> list[list[str]]:
        first, largest = self[:rows].columns, dict[str, float]()
        for name, values in first.items():
            if values.dtype.kind == "f":
                unit = self.units.get(name, "")
                largest[unit] = max(largest.get(unit, 1.0), float(np.nan_to_num(np.abs(values)).max(initial=0.0)))
        columns = []
        for name, values in first.items():
            least = NOTHING * largest.get(self.units.get(name, ""), 1.0)
            columns.append([_text(cell, least) for cell in values.tolist()])
        return [list(row) for row in zip(*columns, strict=True)]

    def _repr_html_(self) -> str:
        headers, *cells = self._fitting([list(self.headers), *self._cells(notebook.ROWS)], WIDTH)
        more = f": {rest}" if (rest := self._more(notebook.ROWS, headers)) else ""
        return notebook.table(f"{self.title}, {counted(len(cells), 'row')}{more}", headers, cells)


def matching(known: list[str], pattern: str, what: str) -> list[str]:
    """Return the known names that a pattern matches, where * matches any text; ValueError if none matches.

    If no whole name matches, the parts after the first slash are compared: "knee" matches "robot/knee", as in plots.
    """
    if not known:
        raise ValueError(f"the recording has no {what}")
    for name_of in (str, lambda name: name.partition("/")[2]):
        if out := [name for name in known if matches(name_of(name), pattern)]:
            return out
    raise ValueError(unknown(pattern, known, what))


def matches(name: str, pattern: str) -> bool:
    """Return whether a pattern matches a name. Every name matches itself, also "box[0]", whose brackets are literal."""
    if not isinstance(pattern, str):
        raise ValueError(f"a pattern of names must be a text, as '*knee*', got {pattern!r}")
    return name == pattern or fnmatchcase(name, pattern)


def _needed(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise ValueError(f"{name.partition('.')[0]} is needed: pip install 'nsdyn[tables]'") from None


def _text(cell: Any, least: float) -> str:
    if not isinstance(cell, float):
        return str(cell) or "-"
    return "-" if cell != cell else f"{0.0 if abs(cell) < least else cell + 0.0:.6g}"
