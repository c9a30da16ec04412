"""Names that a user gives: looked up among the known ones, with what was meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

__all__ = ["check_known", "choice", "meant"]


def choice(value: Any, known: Iterable[str], what: str) -> str:
    """A known name; ValueError naming those there are, and the one that was meant if one is close."""
    names = list(known)
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"{meant(value, names)}{what} must be one of {', '.join(names) or 'none'}; got {value!r}")
    return value


def check_known(given: Iterable[str], known: Iterable[str]) -> None:
    """ValueError for keywords that are not among the known ones, naming these and the one that was meant."""
    names = sorted(known)
    for name in sorted(set(given) - set(names)):
        raise ValueError(f"{meant(name, names)}unknown argument {name!r}; known are {names}")


def meant(value: Any, known: Iterable[str]) -> str:
    """``did you mean 'x'? `` for the closest known name, to begin with, empty where none is close."""
    names = {name.lower(): name for name in known}
    close = get_close_matches(str(value).lower(), names, n=1)
    return f"did you mean {names[close[0]]!r}? " if close else ""
