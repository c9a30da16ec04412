"""Names that a user gives: looked up among the known ones, with what was meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

__all__ = ["choice", "known_only", "meant"]


def choice(value: Any, known: Iterable[str], what: str) -> str:
    """A known name; ValueError naming those there are, and the one that was meant if one is close."""
    names = list(known)
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"{what} must be one of {', '.join(names) or 'none'}; got {value!r}{meant(value, names)}")
    return value


def known_only(keywords: Iterable[str], known: Iterable[str]) -> None:
    """Refuse keywords that are not known with a ValueError naming those there are, and the one that was meant."""
    names = sorted(known)
    for unknown in sorted(set(keywords) - set(names)):
        raise ValueError(f"unknown argument {unknown!r}; known are {names}{meant(unknown, names)}")


def meant(value: Any, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` for the closest known name, empty where none is close."""
    names = {name.lower(): name for name in known}
    close = get_close_matches(str(value).lower(), names, n=1)
    return f"; did you mean {names[close[0]]!r}?" if close else ""
