"""Calls of users' functions: return values are checked, and errors begin with the user's file and line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import CodeType, TracebackType
from typing import Any, TypeVar

from nsdyn.tools.naming import counted

T = TypeVar("T")


def called(function: Callable[..., Any], what: str, fit: Callable[[Any], T], *given: Any, **keywords: Any) -> T:
    """Call a function of the user and return its value after conversion by `fit`.

    ValueError of `fit`, which names the value, or for a function with other arguments, each preceded by the place of
    the function; and if it is no function. Its own errors get a note of the line in its file and of its role `what`.
    """
    try:
        returned = function(*given, **keywords)
    except Exception as error:
        where = line(error)
        if not callable(function):
            raise ValueError(f"{what} must be a function, got {function!r}") from None
        if not where and isinstance(error, TypeError):  # it takes other arguments
            own, count = misfit(function, *given, **keywords), counted(len(given) + len(keywords), "argument")
            told = f"{what} must be a function of {count}, got one of {own}" if own else error
            raise ValueError(f"{source_line(function)}: {told}") from None
        error.add_note(f"{where or source_line(function)}: in {what}")
        raise
    try:
        return fit(returned)
    except ValueError as error:
        raise ValueError(f"{source_line(function)}: {error}") from None


def misfit(function: Callable[..., Any], *given: Any, **keywords: Any) -> str:
    """Return the signature of a user's function if it does not accept the arguments; else, or if unknown, empty."""
    try:
        own = inspect.signature(function)
    except (TypeError, ValueError):  # functions written in C may have no signature
        return ""
    try:
        own.bind(*given, **keywords)
    except TypeError:
        return str(own)
    return ""


def takes(function: Callable[..., Any], argument: str) -> bool:
    """Return whether a function of the user has an argument of that name."""
    try:
        return argument in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def below(error: BaseException) -> TracebackType | None:
    """Return the traceback from the call of a user's function on; None if the error did not come from such a call."""
    at = error.__traceback__
    while at is not None and at.tb_frame.f_code is not called.__code__:
        at = at.tb_next
    return at


def line(error: BaseException) -> str:
    """Return the user's file and the line in it that raised an error; empty if no user's function raised it."""
    at = below(error)
    if at is None or (at := at.tb_next) is None:
        return ""
    own, number = at.tb_frame.f_code.co_filename, 0
    while at is not None:
        if at.tb_frame.f_code.co_filename == own:
            number = at.tb_lineno
        at = at.tb_next
    return f"{Path(own).name}, line {number}"


def text(error: BaseException) -> str:
    """Return an error in words: the user's line, the kind of error unless it is a ValueError, and its message."""
    kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
    return ": ".join(filter(None, (line(error), f"{kind}{error}")))


def source_line(function: Callable[..., Any]) -> str:
    """Return file and line where a function begins; its repr if it has none."""
    while isinstance(function, partial):
        function = function.func
    function = inspect.unwrap(function)
    for known in (function, type(function).__call__):
        if isinstance(code := getattr(known, "__code__", None), CodeType):
            return f"{Path(code.co_filename).name}, line {code.co_firstlineno}"
    return repr(function)
