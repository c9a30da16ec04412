"""Mesh files: STL, OBJ, PLY and COLLADA.

Mesh files may come from anywhere, so this module does not trust them. It compares the sizes that a file declares with
the contents of the file before it allocates memory, checks indices, and does not open files that a mesh file names
(materials, pictures). General importers are less safe. Assimp, with which Coal loads meshes, ends the process on many
damaged PLY files. trimesh 5.2 with pycollada reads 421 of 6000 damaged files that this module refuses, silently and as
other surfaces than the files held. It also misreads valid OBJ files that have tabs or count back from the latest
corner, keeps 7 digits of COLLADA's numbers, and takes half a second to import.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from nsdyn.scene.mesh_files import collada, obj, ply, stl
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.files import is_file

READERS: dict[str, Callable[[bytes], tuple[Any, ...]]] = {
    ".stl": stl.read,
    ".obj": obj.read,
    ".ply": ply.read,
    ".dae": collada.read,
}
"""Readers by the suffixes of their files."""


class Surface(NamedTuple):
    """A triangulated surface.

    Attributes
    ----------
    vertices : ndarray, shape (nv, 3)
        In the unit of the file; only vertices that are corners of triangles.
    triangles : ndarray of int, shape (nt, 3)
        Indices of the corners, anticlockwise seen from outside.
    colours : ndarray, shape (nt, 4), optional
        Red, green, blue and alpha of the triangles in [0, 1], NaN for triangles without colour; only from COLLADA.
    """

    vertices: Array
    triangles: Index
    colours: Array | None = None

    @property
    def volume(self) -> float:
        """Σ a·(b × c) / 6 over the triangles: negative if they face inwards, meaningless if they are not closed."""
        a, b, c = (self.vertices - self.vertices.mean(axis=0))[self.triangles].transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def read(path: Path) -> Surface:
    """Read the surface in a file, whose suffix gives its format.

    ValueError naming a file that does not exist, has another format, is damaged, or has no triangles or corners that
    are not finite.
    """
    if not is_file(path):
        raise ValueError(f"path must be a mesh file, got {str(path)!r}")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"path: {path} must be a mesh in one of {', '.join(READERS)}: convert it to one of them")
    try:
        data = path.read_bytes()
        if not data:
            raise ValueError("it is empty")
        vertices, triangles, *colours = reader(data)
        if not triangles.size:
            raise ValueError("it has no triangles")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ValueError(f"its triangles must have corners 0 to {len(vertices) - 1}, got {triangles.max()}")
        used, flat = np.unique(triangles, return_inverse=True)
        vertices = vertices[used]
        if not np.isfinite(vertices).all():
            raise ValueError("its corners must be finite, got NaN or infinity")
    except (ValueError, OverflowError, ElementTree.ParseError) as failure:
        raise ValueError(f"path: {path} could not be read as a mesh of triangles: {failure}") from None
    return Surface(vertices, flat.reshape(-1, 3), *colours)
