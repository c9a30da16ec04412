"""Options as fields of a frozen dataclass, checked against their annotations when an instance is made."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from nsdyn.tools.naming import choice


class Allowed(NamedTuple):
    """Numbers allowed for an option: the requirement in words, and a function that tests a number."""

    words: str
    holds: Callable[[float], bool]


Positive = Annotated[float, Allowed("positive and finite", lambda x: 0.0 < x < math.inf)]
NonNegative = Annotated[float, Allowed("finite and not negative", lambda x: 0.0 <= x < math.inf)]
Count = Annotated[int, Allowed("a whole number, at least 1", lambda n: n >= 1)]
Whole = Annotated[int, Allowed("a whole number, at least 0", lambda n: n >= 0)]


class Options:
    """Base of frozen dataclasses that refuse values that their annotations do not allow.

    The annotation of a field is a Literal, or Annotated with the type of number and `Allowed`, and may include None.
    Only the fields of the class directly below this base are checked, not fields that classes derived from it add.
    Numbers of NumPy become those of Python, so that a kernel is compiled for one type of them only. A ValueError names
    the option, the requirement and the given value; TypeError for an annotation that does not define allowed values.
    """

    def __post_init__(self) -> None:
        made: type = type(self)
        for name, annotation in _annotations(made).items():
            value, kinds = getattr(self, name), get_args(annotation)
            if get_origin(annotation) is Literal:
                choice(value, kinds, name)
            elif not (value is None and NoneType in kinds):
                kind, allowed = get_args(kinds[0]) if NoneType in kinds else kinds
                value = value.item() if isinstance(value, np.generic) else value
                if not is_number(value, kind) or not allowed.holds(value):
                    raise ValueError(f"{name} must be {allowed.words}, got {value!r}")
                object.__setattr__(self, name, kind(value))


@cache
def _annotations(made: type) -> dict[str, Any]:
    """Return the annotations of the class directly below `Options` that a class is or derives from; evaluated once."""
    line = made.__mro__
    out = get_type_hints(line[line.index(Options) - 1], include_extras=True)
    for name, annotation in out.items():
        if not get_args(annotation):
            raise TypeError(f"{made.__name__}.{name} must be a Literal or say what is Allowed, got {annotation}")
    return out


def is_number(value: Any, kind: type = float) -> bool:
    """Return whether a value is a number of a kind, of NumPy too, for int a whole one; True and False are none."""
    value = value.item() if isinstance(value, np.generic) else value
    return isinstance(value, (int, kind)) and not isinstance(value, bool)


def check_flags(**given: Any) -> None:
    """ValueError for a flag that is neither True nor False."""
    for name, value in given.items():
        if not isinstance(value, bool):
            raise ValueError(f"{name} must be True or False, got {value!r}")
