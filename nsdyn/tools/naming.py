"""Names that a user gives: looked up among the known ones, with what was meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

__all__ = ["check_known", "choice", "counted", "unknown"]

MANY = 12
"""More names than these are not listed whole."""

NEAR = 6
"""Of many names so many are listed, those nearest to what was given."""


def counted(number: int, one: str, more: str = "") -> str:
    """So many of something, of which `more` is the plural if it is no s: ``1 step``, ``2 bodies``."""
    return f"{number} {one if number == 1 else more or one + 's'}"


def choice(value: Any, known: Iterable[str], what: str) -> str:
    """A known name; ValueError in the words of `unknown`."""
    names = list(known)
    if not isinstance(value, str) or value not in names:
        raise ValueError(unknown(value, names, what))
    return value


def check_known(given: Iterable[str], known: Iterable[str]) -> None:
    """ValueError for keywords that are not among the known ones, in the words of `unknown`."""
    names = sorted(known)
    for name in sorted(set(given) - set(names)):
        raise ValueError(unknown(name, names, "keyword"))


def unknown(value: Any, known: Iterable[str], what: str) -> str:
    """What to say of a name that is not among the known ones: the one that was meant first, then those there are.

    >>> unknown("bx", ["box", "ground"], "body")
    "did you mean 'box'? body must be one of box, ground; got 'bx'"
    """
    names = list(known)
    shown = ", ".join(names) or "none"
    if len(names) > MANY:
        near = get_close_matches(str(value), names, n=NEAR, cutoff=0.0)
        shown = f"{', '.join(near)} and {len(names) - len(near)} others"
    return f"{_meant(value, names)}{what} must be one of {shown}; got {value!r}"


def _meant(value: Any, known: Iterable[str]) -> str:
    """``did you mean 'x'? `` for the closest known name, to begin with, empty where none is close.

    A name may be given without what stands before its slash: of "robot/knee" as "knee".
    """
    names = {own.lower(): name for name in known for own in (name.rpartition("/")[2], name)}
    close = get_close_matches(str(value).lower(), names, n=1)
    return f"did you mean {names[close[0]]!r}? " if close else ""
