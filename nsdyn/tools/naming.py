"""Names given by users: look-up among the known names, with a suggestion in the error."""

from __future__ import annotations

from collections.abc import Container, Iterable
from difflib import get_close_matches
from typing import Any

MANY = 12
"""Largest number of names that are all listed."""

NEAR = 6
"""Number of names listed if there are more than `MANY`: those closest to the given one."""


def counted(number: int, one: str, more: str = "") -> str:
    """Return a number with its noun: ``1 step``, ``2 bodies``; `more` is the plural if it is not `one` with an s."""
    return f"{number} {one if number == 1 else more or one + 's'}"


def unused(name: str, names: Container[str]) -> str:
    """Return a name, with as many _ after it as make it none of `names`."""
    while name in names:
        name += "_"
    return name


def choice(value: Any, known: Iterable[str], what: str) -> str:
    """Return a value if it is a known name; else a ValueError with the message of `unknown`."""
    names = list(known)
    if not isinstance(value, str) or value not in names:
        raise ValueError(unknown(value, names, what))
    return value


def check_known(given: Iterable[str], known: Iterable[str]) -> None:
    """Raise a ValueError with the message of `unknown` for keywords that are not among the known ones."""
    names = sorted(known)
    for name in sorted(set(given) - set(names)):
        raise ValueError(unknown(name, names, "keyword"))


def unknown(value: Any, known: Iterable[str], what: str) -> str:
    """Return the message for an unknown name: first the name that was probably meant, then the known names.

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
    """Return ``did you mean 'x'? `` with the closest known name; empty if no name is close.

    Names may be given without the part before their last slash: "robot/knee" as "knee".
    """
    names = {own.lower(): name for name in known for own in (name.rpartition("/")[2], name)}
    close = get_close_matches(str(value).lower(), names, n=1)
    return f"did you mean {names[close[0]]!r}? " if close else ""
