"""Small HTML tables for `_repr_html_`, which notebooks show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

ROWS = 20
"""Largest number of rows of a table in a notebook; the object itself has all rows."""


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[object]], most: int = ROWS) -> str:
    """Return a table of texts and numbers with a title; numbers have four digits, and at most `most` rows are shown."""
    cut = [[f"... {len(rows) - most} more", *[""] * (len(head) - 1)]] if len(rows) > most else []
    body = "".join(_row("td", row) for row in [*rows[:most], *cut])
    return f"<table>{_caption(title)}<thead>{_row('th', head)}</thead><tbody>{body}</tbody></table>"


def figures(title: str, pairs: Iterable[tuple[str, object]]) -> str:
    """Return a table of names and values."""
    return f"<table>{_caption(title)}<tbody>{''.join(_row('td', pair) for pair in pairs)}</tbody></table>"


def _caption(title: str) -> str:
    return f'<caption style="white-space: nowrap">{escape(title)}</caption>'


def _row(tag: str, cells: Iterable[object]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(_text(cell))}</{tag}>' for cell in cells)}</tr>"


def _text(cell: object) -> str:
    if isinstance(cell, float):
        return f"{cell + 0.0:.4g}"  # no -0
    if isinstance(cell, (tuple, list)):
        return "(" + ", ".join(_text(part) for part in cell) + ")"
    return str(cell)
