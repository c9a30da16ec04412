"""PLY files, text and binary.

References
----------
G. Turk, The PLY polygon file format, Stanford University, 1994.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from nsdyn.scene.mesh_files.numbers import fans, numbers, whole
from nsdyn.tools.arrays import Array, Index

_NAMES = {
    "i1": "char int8",
    "u1": "uchar uint8",
    "i2": "short int16",
    "u2": "ushort uint16",
    "i4": "int int32",
    "u4": "uint uint32",
    "f4": "float float32",
    "f8": "double float64",
}
_TYPES = {name: kind for kind, names in _NAMES.items() for name in names.split()}


class _Property(NamedTuple):
    """A property of an element of a PLY file: its type, and for a list the type of its length."""

    name: str
    kind: str
    length: str | None


def read(data: bytes) -> tuple[Array, Index]:
    """Return vertices (nv, 3) and triangles (nt, 3)."""
    header, found, body = data.partition(b"end_header")
    if not data.startswith(b"ply") or not found:
        raise ValueError("it is no PLY: its header does not begin with ply and end with end_header")
    body = body.partition(b"\n")[2]
    elements: dict[str, tuple[int, list[_Property]]] = {}
    form = ""
    for words in (line.split() for line in header.decode(errors="replace").splitlines()[1:]):
        match words:
            case ["format", form, _]:
                pass
            case ["element", name, count] if count.isdecimal() and name not in elements:
                elements[name] = int(count), []
            case ["property", "list", length, kind, name] if elements and {length, kind} <= _TYPES.keys():
                list(elements.values())[-1][1].append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                list(elements.values())[-1][1].append(_Property(name, _TYPES[kind], None))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has a line {' '.join(words)[:80]!r}")
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    if form not in order:
        raise ValueError(f"its format must be one of {', '.join(order)}, got {form!r}")
    source = _Numbers(body, order[form])
    columns = {name: _columns(source, name, count, properties) for name, (count, properties) in elements.items()}
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    corners = face.get("vertex_indices", face.get("vertex_index"))
    if not {"x", "y", "z"} <= vertex.keys() or not isinstance(corners, tuple):
        raise ValueError("it must have vertices with x, y and z, and faces with a list vertex_indices")
    vertices = np.column_stack([vertex[axis] for axis in "xyz"]).astype(float)
    return vertices, fans(whole(corners[0], "corners of its faces"), corners[1])


class _Numbers:
    """Numbers of a file, one after the other: from the bytes of a binary one in some order, or the words of a text."""

    def __init__(self, data: bytes, order: str) -> None:
        self.order, self.at = order, 0
        self.data: Any = data if order else data.split()

    def left(self) -> int:
        """Return the number of bytes or words left."""
        return len(self.data) - self.at

    def take(self, kind: str, count: int) -> Any:
        """Return the next `count` numbers of a kind; of a text, all as floats."""
        size = count * (np.dtype(kind).itemsize if self.order else 1)
        if size > self.left():
            raise ValueError("it ends before all its elements")
        begin, self.at = self.at, self.at + size
        if self.order:
            return np.frombuffer(self.data, self.order + kind, count, begin)
        return numbers(b" ".join(self.data[begin : self.at]), "its elements")


def _columns(source: _Numbers, element: str, count: int, properties: Sequence[_Property]) -> dict[str, Any]:
    """Return the values of each property of an element; for a list (all values, lengths)."""
    if count > source.left():  # each element takes at least a byte or a word
        raise ValueError(f"it has {count} of {element} and only {source.left()} bytes or words left")
    kinds = {p.kind for p in properties}
    if len(kinds) == 1 and all(p.length is None for p in properties):
        table = source.take(kinds.pop(), count * len(properties)).reshape(count, -1)
        return {p.name: table[:, k] for k, p in enumerate(properties)}
    values: dict[str, list[Any]] = {p.name: [] for p in properties}
    sizes: dict[str, list[int]] = {p.name: [] for p in properties}
    for _ in range(count):
        for p in properties:
            size = 1.0 if p.length is None else float(source.take(p.length, 1)[0])
            if not 0.0 <= size <= source.left() or size % 1.0:
                raise ValueError(f"{p.name} of {element} must have as many values as there are, got {size:g}")
            sizes[p.name].append(int(size))
            values[p.name].append(source.take(p.kind, int(size)))
    joined = {name: np.concatenate(rows) if rows else np.empty(0) for name, rows in values.items()}
    return {
        p.name: joined[p.name] if p.length is None else (joined[p.name], np.array(sizes[p.name], np.int64))
        for p in properties
    }
