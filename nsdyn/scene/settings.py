"""Parameters of scenes as text: ``name=value`` for named scenes, JSON in recordings."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from nsdyn.scene import named as scenes
from nsdyn.tools.naming import choice


def parameters(name: str) -> dict[str, Any]:
    """Return the parameters of a named scene with their default values."""
    return {p.name: p.default for p in inspect.signature(scenes.load(name)).parameters.values()}


def values(name: str, assignments: list[str]) -> dict[str, Any]:
    """Parse ``name=value`` settings, each value with the type of its default; ValueError names the mistake."""
    return {key: parse(text, default, key) for key, text, default in _assignments(name, assignments)}


def lists(name: str, assignments: list[str]) -> dict[str, list[Any]]:
    """Parse ``name=value,value,...`` settings into lists of values, as `values` does."""
    return {
        key: [parse(value, default, key) for value in text.split(",")]
        for key, text, default in _assignments(name, assignments)
    }


def _assignments(name: str, assignments: list[str]) -> Iterator[tuple[str, str, Any]]:
    """Yield (name, text, default) for every setting of a scene; ValueError for a name that is set twice."""
    known, given = parameters(name), set()
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise ValueError(f"--set expects NAME=VALUE, got {assignment!r}")
        default = known[choice(key, known, f"parameter of scene {name}")]
        if key in given:
            raise ValueError(f"--set expects every name once, got {key!r} again; a sweep takes {key}=VALUE,VALUE,...")
        given.add(key)
        yield key, text, default


def parse(text: str, default: Any, name: str) -> Any:
    """Parse text as a value of the type of the default; a whole number is a count and at least min(default, 1)."""
    if isinstance(default, bool):
        if text.lower() not in ("true", "false"):
            raise ValueError(f"{name} must be true or false, got {text!r}")
        return text.lower() == "true"
    for kind, word in ((int, "a whole number"), (float, "a number")):
        if isinstance(default, kind):
            try:
                value = kind(text)
            except ValueError:
                raise ValueError(f"{name} must be {word}, got {text!r}") from None
            least = min(default, 1)
            if kind is int and value < least:
                raise ValueError(f"{name} must be at least {least}, got {value}")
            return value
    return text


def as_text(value: Any) -> str:
    """Return a value as text that can follow ``--set name=``."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def as_json(parameters: Mapping[str, Any]) -> str:
    """Return parameters of any type as JSON; equal parameters give equal text."""
    return json.dumps({str(name): value for name, value in parameters.items()}, default=_plain)


def _plain(value: Any) -> Any:
    """Return a JSON value for a Python value that JSON cannot hold; it never contains an address in memory."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    text = repr(value)
    return getattr(value, "__qualname__", type(value).__qualname__) if " at 0x" in text else text
