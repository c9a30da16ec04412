"""STL files, binary and text."""

from __future__ import annotations

import re

import numpy as np

from nsdyn.scene.mesh_files.numbers import numbers
from nsdyn.tools.arrays import Array, Index

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
"""Layout of a facet of a binary STL, which begins with 80 bytes of text and 4 bytes for the number of facets."""


def read(data: bytes) -> tuple[Array, Index]:
    """Return vertices (nv, 3) and triangles (nt, 3), which share no vertices."""
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= 84 and len(data) == 84 + 50 * count:
        facets = np.frombuffer(data, FACET, count, 84)
        vertices = facets["corners"].reshape(-1, 3).astype(float)
    elif data.lstrip().startswith(b"solid"):
        found = re.findall(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        if len(found) % 3 or len(found) != 3 * len(re.findall(rb"\bendfacet\b", data)):
            raise ValueError("its facets must have 3 corners each")
        vertices = numbers(b" ".join(map(b" ".join, found)), "its corners").reshape(-1, 3)
    else:
        raise ValueError(f"it is no STL: {len(data)} bytes, where {count} facets take {84 + 50 * count}")
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def binary(vertices: Array, triangles: Index) -> bytes:
    """Return a binary STL, with numbers of seven digits."""
    facets = np.zeros(len(triangles), FACET)
    with np.errstate(over="ignore"):
        facets["corners"] = vertices[triangles]
    return bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes()
