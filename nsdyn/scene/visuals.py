"""Visual shapes of robot files; only pages and films use them."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nsdyn.scene import meshes
from nsdyn.scene.shapes import Shape
from nsdyn.scene.simplified import simpler
from nsdyn.tools.array_text import to_text
from nsdyn.tools.arrays import Array

Colour = tuple[float, float, float, float]
"""Red, green, blue and alpha in [0, 1]."""

TRIANGLES = 60_000
"""Most triangles of all robots of a scene, about half a megabyte of a recording or page; more are simplified to it."""

LARGEST = 64_000_000
"""Size of the largest mesh file that is read, bytes."""


class MeshFile(NamedTuple):
    """A mesh file, and the factors from its lengths to m, one per axis."""

    path: Path
    scale: tuple[float, float, float]


class Visual(NamedTuple):
    """A visual shape: its body, its joint (0 for the world), its SE3 in the joint's frame, its solid, its colour."""

    body: str
    joint: int
    placement: Any
    shape: Shape | MeshFile
    colour: Colour | None


class _Piece(NamedTuple):
    """The part of a mesh file in one colour: texts of corners and triangles, the largest coordinates, the colour."""

    vertices: str
    triangles: str
    size: Array
    colour: Colour | None


def mesh_visual(path: Path, scale: Array) -> MeshFile:
    """Return the mesh of a visual shape; ValueError for a format that is not read or an invalid scale."""
    if path.suffix.lower() not in meshes.READERS:
        raise ValueError(f"{path.name} is not in one of {', '.join(meshes.READERS)}")
    if not (np.isfinite(scale).all() and scale.all()):
        raise ValueError(f"scale must be 3 numbers other than 0, got {scale.tolist()}")
    x, y, z = scale.tolist()
    return MeshFile(path, (x, y, z))


def describe_visuals(placed: Iterable[tuple[str, int, Visual]]) -> dict[str, list[dict[str, Any]]]:
    """Return visual shapes as JSON values.

    Parameters
    ----------
    placed : iterable of (str, int, Visual)
        Each visual shape, after the name of the link and the moving frame that carries the link, -1 for the world.

    Returns
    -------
    dict
        visuals: link, frame, placement (including the scale of a mesh), colour, and shape and size as of a collision
        shape; the shape "mesh" also has the number of its mesh, and its size are the largest coordinates in m.
        meshes: vertices and triangles, texts of `nsdyn.tools.array_text`, "<f4" and "<u4", three to a row.
    """
    shown = list(placed)
    scales = {v.shape.path: v.shape.scale for _, _, v in shown if isinstance(v.shape, MeshFile)}
    pieces = dict(zip(scales, _pieces(tuple((*_stamp(p), s) for p, s in scales.items())), strict=True))
    numbers = {piece: k for k, piece in enumerate(id(piece) for each in pieces.values() for piece in each)}
    visuals = []
    for link, frame, (_, _, placement, shape, colour) in shown:
        common = {"link": link, "frame": frame}
        if isinstance(shape, Shape):
            rgba = None if colour is None else list(colour)
            visuals.append({**common, "placement": placement.homogeneous.tolist(), "colour": rgba, **shape.describe()})
            continue
        matrix = placement.homogeneous @ np.diag([*shape.scale, 1.0])
        for piece in pieces[shape.path]:
            paint = colour or piece.colour
            mesh = {"shape": "mesh", "size": (np.abs(shape.scale) * piece.size).tolist(), "mesh": numbers[id(piece)]}
            look = {"placement": matrix.tolist(), "colour": None if paint is None else list(paint)}
            visuals.append({**common, **look, **mesh})
    told = [{"vertices": p.vertices, "triangles": p.triangles} for each in pieces.values() for p in each]
    return {"visuals": visuals, "meshes": told}


def _stamp(path: Path) -> tuple[Path, int, int]:
    """Return the path with the time of change and the size of the file, which differ once the file has changed."""
    try:
        found = path.stat()
    except OSError:
        return path, 0, 0
    return path, found.st_mtime_ns, found.st_size


@lru_cache(maxsize=16)
def _pieces(files: tuple[tuple[Path, int, int, tuple[float, float, float]], ...]) -> tuple[tuple[_Piece, ...], ...]:
    """Return the pieces of mesh files by colour, at most TRIANGLES in all; a file that cannot be read has none."""
    found: list[tuple[int, float, Colour | None, meshes.Surface]] = []
    for k, (path, _, size, scale) in enumerate(files):
        try:
            if size > LARGEST:
                raise ValueError(f"{path} has {size / 1e6:.0f} MB, more than {LARGEST / 1e6:.0f}: simplify it")
            length = float(np.abs(scale).prod()) ** (1.0 / 3.0)
            found += [(k, length, colour, part) for colour, part in _by_colour(meshes.read(path))]
        except ValueError as failure:
            warnings.warn(f"a visual mesh is not shown: {failure}", stacklevel=6)
    drawn = simpler([(length, part) for _, length, _, part in found], TRIANGLES)
    out: list[list[_Piece]] = [[] for _ in files]
    for (k, _, colour, _), (vertices, triangles, _) in zip(found, drawn, strict=True):
        if triangles.size:
            texts = to_text(vertices, "<f4"), to_text(triangles, "<u4")
            out[k].append(_Piece(*texts, np.abs(vertices).max(axis=0), colour))
    return tuple(map(tuple, out))


def _by_colour(surface: meshes.Surface) -> list[tuple[Colour | None, meshes.Surface]]:
    """Split a surface into parts of one colour each."""
    if surface.colours is None:
        return [(None, surface)]
    colours, which = np.unique(np.nan_to_num(surface.colours, nan=-1.0), axis=0, return_inverse=True)
    out: list[tuple[Colour | None, meshes.Surface]] = []
    for k, (r, g, b, a) in enumerate(colours.tolist()):
        part = meshes.Surface(surface.vertices, surface.triangles[which.ravel() == k])
        out.append((None if r < 0.0 else (r, g, b, a), part))
    return out
