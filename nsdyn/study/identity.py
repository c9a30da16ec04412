"""Texts by which a store knows the arguments of a sweep: of functions and objects with all that they use."""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cached_property, partial
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np


def told(value: Any) -> str:
    """Return the text of an argument: of numbers and texts themselves, else a name and a checksum of all that it uses.

    That is the code of functions and of the classes of objects, values in closures, defaults, fields and attributes,
    and of the module of the function or object also global variables, functions and classes. It is the same in every
    process.
    """
    if value is None or isinstance(value, str | int | float):
        return str(value)
    root = value
    while isinstance(root, partial | MethodType):
        root = root.func if isinstance(root, partial) else root.__self__
    named = isinstance(value, FunctionType)
    # Addresses differ in every process.
    name = f"{value.__module__}.{value.__qualname__}" if named else re.sub(" at 0x[0-9a-f]+", "", str(value))
    module = getattr(root if isinstance(root, FunctionType | type) else type(root), "__module__", None) or ""
    # Code of nsdyn is known by the name of its class: a store outlives a version.
    home = "" if module.partition(".")[0] == "nsdyn" else module
    return f"{name} {zlib.crc32(_parts(value, home, ()).encode()):08x}"


def _parts(value: Any, home: str, above: tuple[int, ...]) -> str:
    """Return a text of all that a value consists of; `above` are the ids of the values that it belongs to."""
    if id(value) in above:
        return "itself"

    def inside(part: Any) -> str:
        return _parts(part, home, (*above, id(value)))

    match value:
        case np.ndarray() if not value.dtype.hasobject:
            return f"{value.dtype}{value.shape}{zlib.crc32(np.ascontiguousarray(value).tobytes())}"
        case Mapping():
            return str([(inside(key), inside(x)) for key, x in value.items()])
        case list() | tuple() | np.ndarray():
            return str([inside(x) for x in value])
        case set() | frozenset():
            return str(sorted(inside(x) for x in value))
        case partial():
            return inside((value.func, value.args, value.keywords))
        case MethodType():
            return inside((value.__func__, value.__self__))
        case CodeType():
            return inside((value.co_code, value.co_consts, value.co_names))
        case FunctionType():
            cells = [x for cell in value.__closure__ or () for x in _content(cell)]
            names = _names(value.__code__) if value.__module__ == home else ()
            used = {name: value.__globals__[name] for name in names if name in value.__globals__}
            return inside((value.__code__, value.__defaults__, value.__kwdefaults__, cells, used))
        case type():
            members = vars(value).items() if value.__module__ == home else ()
            used = {name: _function(x) for name, x in members}
            used = {n: x for n, x in used.items() if isinstance(x, FunctionType) or not n.startswith("__")}
            return f"{value.__module__}.{value.__qualname__}" + inside((used, value.__bases__))
        case ModuleType():
            return value.__name__
    if is_dataclass(value):
        state = {field.name: getattr(value, field.name, None) for field in fields(value)}
    elif " at 0x" in (words := repr(value)):  # the words of Python, that say nothing of the object
        found: Any = object.__getstate__(value)  # None, the attributes, or a pair of these and of those in slots
        own, slots = found if isinstance(found, tuple) else (found, {})
        held = (own or {}) | slots
        state = {k: x for k, x in held.items() if not isinstance(getattr(type(value), k, None), cached_property)}
    else:
        return words
    return inside((type(value), state))


def _content(cell: Any) -> tuple[Any, ...]:
    """Return the value in a cell of a closure, if it has one yet."""
    try:
        return (cell.cell_contents,)
    except ValueError:
        return ()


def _names(code: CodeType) -> list[str]:
    """Return the names of globals and attributes in a code and in those within it."""
    return [*code.co_names, *(name for x in code.co_consts if isinstance(x, CodeType) for name in _names(x))]


def _function(member: Any) -> Any:
    """Return the function of a method or property of a class, any other member itself."""
    match member:
        case staticmethod() | classmethod():
            return member.__func__
        case property():
            return member.fget
        case cached_property():
            return member.func
    return member
