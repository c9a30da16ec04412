"""Parameters of scenes as text: ``name=value`` of named ones, JSON in recordings."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from nsdyn.scene import named as scenes
from nsdyn.tools.naming import choice

__all__ = ["as_json", "as_text", "lists", "parameters", "values"]


def parameters(name: str) -> dict[str, Any]:
    """Parameters of a named scene with their default values."""
    return {p.name: p.default for p in inspect.signature(scenes.load(name)).parameters.values()}


def values(name: str, assignments: list[str]) -> dict[str, Any]:
    """Values of ``name=value`` settings, each of the type of its default; ValueError naming what is wrong."""
    return {key: parse(text, default, key) for key, text, default in _assignments(name, assignments)}


def lists(name: str, assignments: list[str]) -> dict[str, list[Any]]:
    """Lists of values of ``name=value,value,...`` settings, as `values`."""
    return {
        key: [parse(value, default, key) for value in text.split(",")]
        for key, text, default in _assignments(name, assignments)
    }


def _assignments(name: str, assignments: list[str]) -> Iterator[tuple[str, str, Any]]:
    """(name, text, default) of every setting of a scene."""
    known = parameters(name)
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals:
            raise ValueError(f"--set expects NAME=VALUE, got {assignment!r}")
        yield choice(key, known, f"parameter of scene {name}"), text, known[key]


def parse(text: str, default: Any, name: str) -> Any:
    """Text as a value of the type of the default; whole numbers count things, of which some are needed."""
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
    """How a value is written after ``--set name=``."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def as_json(parameters: Mapping[str, Any]) -> str:
    """Parameters of any kind as JSON; equal ones give equal text."""
    return json.dumps({str(name): value for name, value in parameters.items()}, default=_plain)


def _plain(value: Any) -> Any:
    """What stands in JSON for a value that it does not know: never an address in memory."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    text = repr(value)
    return getattr(value, "__qualname__", type(value).__qualname__) if " at 0x" in text else text
