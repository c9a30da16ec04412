"""Commands of meshcat and objects of three.js, as JSON values; identifiers are made from names."""

from __future__ import annotations

import uuid
from collections.abc import Iterable
from typing import Any

import numpy as np
import umsgpack

from nsdyn.tools.arrays import Array

Json = dict[str, Any]

UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Rotation of y, the vertical axis of three.js, to z."""


def set_object(path: str, content: Json) -> Json:
    """Return the command that puts a three.js object, in JSON format 4, at a path.

    `content` is a node tree whose ``geometry`` and ``material`` are JSON. three.js needs them in lists, referred to by
    identifiers; this function makes the identifiers from the path.
    """
    lists: dict[str, list[Json]] = {"geometries": [], "materials": []}

    def place(node: Json, name: str) -> Json:
        out = node | {"uuid": uuid_of(name)}
        for key, field in (("geometry", "geometries"), ("material", "materials")):
            if key in node:
                out[key] = uuid_of(f"{name}:{key}")
                lists[field].append(node[key] | {"uuid": out[key]})
        out["children"] = [place(child, f"{name}.{k}") for k, child in enumerate(node.get("children", ()))]
        return out

    root = place(content, path)
    data = {"metadata": {"version": 4.5, "type": "Object"}, "object": root, **lists}
    return {"type": "set_object", "path": path, "object": data}


def set_property(path: str, name: str, value: Any) -> Json:
    """Return the command that sets a property of the object at a path."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def uuid_of(name: str) -> str:
    """Return an identifier made from a name, so that equal recordings give equal bytes."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"nsdyn:{name}"))


def as_buffer(**attributes: Array) -> Json:
    """Return a BufferGeometry with attributes of three components."""
    data = {}
    for name, values in attributes.items():
        array = umsgpack.Ext(0x17, np.ascontiguousarray(values, dtype="<f4").tobytes())  # the viewer's Float32Array
        data[name] = {"itemSize": 3, "type": "Float32Array", "array": array, "normalized": False}
    return {"type": "BufferGeometry", "data": {"attributes": data}}


def as_hex(colour: Iterable[float]) -> int:
    """Return RGB in [0, 1] as the number 0xrrggbb."""
    r, g, b = (round(255 * c) for c in list(colour)[:3])
    return r << 16 | g << 8 | b


def shaded(colour: Iterable[float], factor: float) -> tuple[float, ...]:
    """Darken (factor < 1) or lighten (factor > 1, towards white) a colour; alpha stays."""
    r, g, b, *alpha = colour
    mixed = [c * factor if factor <= 1 else 1 - (1 - c) / factor for c in (r, g, b)]
    return (*mixed, *alpha)


def by_columns(matrix: Array) -> list[float]:
    """Return the entries of a matrix column by column, as three.js stores it."""
    return matrix.T.ravel().tolist()


def as_three(vector: Array) -> list[float]:
    """Return a vector in the viewer's world coordinates, y up."""
    x, y, z = (float(c) for c in vector)
    return [x, z, -y]
