"""Functions of the user: what they return is checked, and what goes wrong is told with their file and line first."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import CodeType, TracebackType
from typing import Any, TypeVar

from nsdyn.tools.naming import counted

__all__ = ["below", "called", "line", "misfit", "source_line", "takes", "text"]

T = TypeVar("T")


def called(function: Callable[..., Any], what: str, fit: Callable[[Any], T], *given: Any, **keywords: Any) -> T:
    """What a function of the user returns, made to `fit`.

    Raises
    ------
    ValueError
        As `fit`, which names what was returned, and for a function that takes other arguments; the place of the
        function first. For what is no function.
    Exception
        As the function, with a note of the line in its file and of `what` it is.
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
    """The arguments of a function of the user that does not take what is given; else empty, as where none are known."""
    try:
        own = inspect.signature(function)
    except (TypeError, ValueError):  # of what is written in C nothing may be known
        return ""
    try:
        own.bind(*given, **keywords)
    except TypeError:
        return str(own)
    return ""


def takes(function: Callable[..., Any], argument: str) -> bool:
    """Whether a function of the user has an argument of that name."""
    try:
        return argument in inspect.signature(function).parameters
    except (TypeError, ValueError):
        return False


def below(error: BaseException) -> TracebackType | None:
    """The part of the traceback from where a function of the user was called; None if that is not what failed."""
    at = error.__traceback__
    while at is not None and at.tb_frame.f_code is not called.__code__:
        at = at.tb_next
    return at


def line(error: BaseException) -> str:
    """The user's file and the line in it where an error came from; empty where it is none of theirs."""
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
    """An error in words: the user's line first, then its kind unless it is a ValueError, then what it says."""
    kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
    return ": ".join(filter(None, (line(error), f"{kind}{error}")))


def source_line(function: Callable[..., Any]) -> str:
    """File and line where a function begins, what it is if it has none."""
    while isinstance(function, partial):
        function = function.func
    function = inspect.unwrap(function)
    for known in (function, type(function).__call__):
        if isinstance(code := getattr(known, "__code__", None), CodeType):
            return f"{Path(code.co_filename).name}, line {code.co_firstlineno}"
    return repr(function)
