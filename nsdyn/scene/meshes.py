"""Mesh files: STL, OBJ, PLY and COLLADA.

They come from strangers, so that nothing here trusts them: sizes that a file declares are compared with what it holds
before anything is made of them, indices are checked, and files that a file names (materials, pictures) are not opened.
General importers do worse: Assimp, which Coal loads meshes with, ends the process on many a damaged PLY file. trimesh
5.2 with pycollada reads 421 of 6000 damaged files that are refused here, in silence and as other surfaces than they
held, gets sound OBJ files wrong that have tabs or count from the end of the corners so far, keeps 7 digits of COLLADA's
numbers, and takes half a second to import.

References
----------
G. Turk, The PLY polygon file format, Stanford University, 1994. M. Barnes, E. Levy Finch, COLLADA: digital asset schema
release 1.4.1, The Khronos Group, 2008.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.files import is_file

__all__ = ["READERS", "Surface", "read", "write_stl"]

DEEPEST = 100
"""Nodes of a COLLADA scene inside each other: deeper ones go in a circle."""


FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
"""Of a binary STL, which begins with 80 bytes of text and the number of its facets in 4."""


class Surface(NamedTuple):
    """A triangulated surface.

    Attributes
    ----------
    vertices : ndarray, shape (nv, 3)
        In the unit of the file; corners of triangles only.
    triangles : ndarray of int, shape (nt, 3)
        Corners, anticlockwise seen from outside.
    """

    vertices: Array
    triangles: Index

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
        vertices, triangles = reader(data)
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
    return Surface(vertices, flat.reshape(-1, 3))


def write_stl(path: Path, surface: Surface) -> None:
    """Write a surface as a binary STL, whose numbers have seven digits."""
    facets = np.zeros(len(surface.triangles), FACET)
    with np.errstate(over="ignore"):
        facets["corners"] = surface.vertices[surface.triangles]
    path.write_bytes(bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes())


def _fans(corners: Index, sizes: Index) -> Index:
    """Triangles of polygons with so many corners each, all corners in a row."""
    if sizes.size and sizes.min() < 3:
        raise ValueError(f"its faces must have 3 or more corners, got {sizes.min()}")
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    ends = np.cumsum(sizes)
    first = np.repeat(ends - sizes, sizes - 2)
    count = np.arange(first.size) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    out: Index = corners[np.column_stack((first, first + count + 1, first + count + 2))]
    return out


def _numbers(text: str | bytes | None, what: str) -> Array:
    try:
        return np.array((text or "").split(), dtype=float)
    except ValueError:
        raise ValueError(f"{what} must be numbers") from None


def _whole(numbers: Array, what: str) -> Index:
    """The same numbers as integers."""
    if not (np.abs(numbers) < 2**31).all() or (numbers % 1.0).any():
        raise ValueError(f"{what} must be whole numbers")
    return numbers.astype(np.int64)


# -- STL -----------------------------------------------------------------------------------------------------------


def _stl(data: bytes) -> tuple[Array, Index]:
    count = int.from_bytes(data[80:84], "little")
    if len(data) >= 84 and len(data) == 84 + 50 * count:
        facets = np.frombuffer(data, FACET, count, 84)
        vertices = facets["corners"].reshape(-1, 3).astype(float)
    elif data.lstrip().startswith(b"solid"):
        found = re.findall(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        if len(found) % 3 or len(found) != 3 * len(re.findall(rb"\bendfacet\b", data)):
            raise ValueError("its facets must have 3 corners each")
        vertices = _numbers(b" ".join(map(b" ".join, found)), "its corners").reshape(-1, 3)
    else:
        raise ValueError(f"it is no STL: {len(data)} bytes, where {count} facets take {84 + 50 * count}")
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


# -- OBJ -----------------------------------------------------------------------------------------------------------


def _obj(data: bytes) -> tuple[Array, Index]:
    vertices: list[float] = []
    corners: list[int] = []
    sizes: list[int] = []
    for line in data.decode(errors="replace").replace("\\\n", " ").splitlines():
        key, _, rest = line.strip().partition(" ")
        if key == "v":
            given = _numbers(rest, "its corners")
            if given.size < 3:
                raise ValueError(f"its corners must be 3 numbers, got {line.strip()[:80]!r}")
            vertices += given[:3].tolist()
        elif key == "f":
            try:
                face = [int(corner.partition("/")[0]) for corner in rest.split()]
            except ValueError:
                raise ValueError(f"its faces must be numbers of corners, got {line.strip()[:80]!r}") from None
            if 0 in face or max(map(abs, face), default=0) > len(vertices) // 3:
                raise ValueError(f"its faces must have corners 1 to {len(vertices) // 3}, got {line.strip()[:80]!r}")
            corners += [k - 1 if k > 0 else len(vertices) // 3 + k for k in face]
            sizes.append(len(face))
    return np.array(vertices).reshape(-1, 3), _fans(np.array(corners, np.int64), np.array(sizes, np.int64))


# -- PLY -----------------------------------------------------------------------------------------------------------

_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


class _Property(NamedTuple):
    """Of an element of a PLY file: its type, and the type of its length where it is a list."""

    name: str
    kind: str
    length: str | None


def _ply(data: bytes) -> tuple[Array, Index]:
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
            case ["property", "list", length, kind, name] if elements and {length, kind} <= _PLY_TYPES.keys():
                list(elements.values())[-1][1].append(_Property(name, _PLY_TYPES[kind], _PLY_TYPES[length]))
            case ["property", kind, name] if elements and kind in _PLY_TYPES:
                list(elements.values())[-1][1].append(_Property(name, _PLY_TYPES[kind], None))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has a line {' '.join(words)[:80]!r}")
    order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
    if form not in order:
        raise ValueError(f"its format must be one of {', '.join(order)}, got {form!r}")
    source = _Words(body) if order[form] is None else _Bytes(body, str(order[form]))
    columns = {name: _columns(source, name, count, properties) for name, (count, properties) in elements.items()}
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    corners = face.get("vertex_indices", face.get("vertex_index"))
    if not {"x", "y", "z"} <= vertex.keys() or not isinstance(corners, tuple):
        raise ValueError("it must have vertices with x, y and z, and faces with a list vertex_indices")
    vertices = np.column_stack([vertex[axis] for axis in "xyz"]).astype(float)
    return vertices, _fans(_whole(corners[0], "corners of its faces"), corners[1])


class _Bytes:
    """Numbers of a binary file, one after the other."""

    def __init__(self, data: bytes, order: str) -> None:
        self.data, self.order, self.at = data, order, 0

    def left(self) -> int:
        """Bytes."""
        return len(self.data) - self.at

    def take(self, kind: str, count: int) -> Any:
        """So many numbers of a kind."""
        size = np.dtype(kind).itemsize * count
        if size > self.left():
            raise ValueError("it ends before all its elements")
        out = np.frombuffer(self.data, self.order + kind, count, self.at)
        self.at += size
        return out


class _Words:
    """The same of a text."""

    def __init__(self, data: bytes) -> None:
        self.words, self.at = data.split(), 0

    def left(self) -> int:
        """Words."""
        return len(self.words) - self.at

    def take(self, kind: str, count: int) -> Any:
        """So many numbers, all as floats."""
        if count > self.left():
            raise ValueError("it ends before all its elements")
        self.at += count
        return _numbers(b" ".join(self.words[self.at - count : self.at]), "its elements")


def _columns(source: _Bytes | _Words, element: str, count: int, properties: Sequence[_Property]) -> dict[str, Any]:
    """Values of each property of an element; of a list (all values, lengths)."""
    if count > source.left():  # each takes at least a byte, or a word
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


# -- COLLADA -------------------------------------------------------------------------------------------------------


def _dae(data: bytes) -> tuple[Array, Index]:
    root = ElementTree.fromstring(data)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # without the name space
    if root.tag != "COLLADA":
        raise ValueError(f"its root is <{root.tag}>, not <COLLADA>")
    known = {element.get("id"): element for element in root.iter() if element.get("id")}

    def named(element: Element, attribute: str, tag: str) -> Element:
        """What an element refers to in the same file."""
        there = known.get((element.get(attribute) or "").removeprefix("#"))
        if there is None or there.tag != tag:
            raise ValueError(f"<{element.tag}> names {element.get(attribute)!r}, which is no <{tag}> of the file")
        return there

    vertices: list[Array] = [np.empty((0, 3))]
    triangles: list[Index] = [np.empty((0, 3), np.int64)]
    count, spent = 0, 0

    def add(node: Element, pose: Array, depth: int) -> None:
        nonlocal count, spent
        if depth > DEEPEST:
            raise ValueError(f"its nodes lie more than {DEEPEST} deep in each other")
        pose = pose @ _pose(node)
        for child in node:
            if child.tag == "node":
                add(child, pose, depth + 1)
            elif child.tag == "instance_node":
                add(named(child, "url", "node"), pose, depth + 1)
            elif child.tag == "instance_geometry":
                for points, corners in _of_geometry(named(child, "url", "geometry"), named):
                    vertices.append(points @ pose[:3, :3].T + pose[:3, 3])
                    triangles.append(corners + count)
                    count, spent = count + len(points), spent + points.size + corners.size
                    if spent > len(data):  # a number takes two bytes: only what is shown many times comes here
                        raise ValueError("it shows the same geometry over and over")

    for instance in root.iterfind("scene/instance_visual_scene"):
        add(named(instance, "url", "visual_scene"), np.eye(4), 0)
    return np.concatenate(vertices), np.concatenate(triangles)


def _pose(node: Element) -> Array:
    """Product of the transformations of a node, in their order."""
    out = np.eye(4)
    for child in node:
        step = np.eye(4)
        if child.tag not in ("matrix", "translate", "scale", "rotate"):
            if child.tag in ("lookat", "skew"):
                raise ValueError(f"<{child.tag}> is not read")
            continue
        size = {"matrix": 16, "rotate": 4}.get(child.tag, 3)
        values = _numbers(child.text, f"<{child.tag}>")
        if values.size != size or not np.isfinite(values).all():
            raise ValueError(f"<{child.tag}> must be {size} finite numbers, got {values.size}")
        match child.tag:
            case "matrix":
                step = values.reshape(4, 4)
            case "translate":
                step[:3, 3] = values
            case "scale":
                step[:3, :3] = np.diag(values)
            case "rotate" if values[:3].any():
                x, y, z = values[:3] / np.linalg.norm(values[:3])
                K, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.deg2rad(values[3])
                step[:3, :3] += np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K  # Rodrigues
        out = out @ step
    return out


def _of_geometry(
    geometry: Element, named: Callable[[Element, str, str], Element]
) -> Iterator[tuple[Array, Index]]:  # fmt: skip
    """(vertices, triangles) of each list of faces of a geometry."""
    mesh = geometry.find("mesh")
    for faces in () if mesh is None else mesh:
        if faces.tag not in ("triangles", "polylist", "polygons"):
            if faces.tag in ("tristrips", "trifans"):
                raise ValueError(f"<{faces.tag}> is not read")
            continue
        inputs = faces.findall("input")
        offsets = [_numbers(e.get("offset"), "offset of <input>") for e in inputs]
        if any(o.shape != (1,) or not 0 <= o[0] < 100 for o in offsets):
            raise ValueError("offset of <input> must be a small number")
        stride = 1 + int(max((o[0] for o in offsets), default=0))
        at = [(int(o[0]), e) for o, e in zip(offsets, inputs, strict=True) if e.get("semantic") == "VERTEX"]
        if len(at) != 1:
            raise ValueError(f"<{faces.tag}> must have one <input> of its vertices")
        points = _points(named(at[0][1], "source", "vertices"), named)
        lists = [_numbers(p.text, "<p>") for p in faces.findall("p")]
        corners = np.concatenate([np.empty(0), *lists])
        if corners.size % stride:
            raise ValueError(f"<p> must have {stride} numbers per corner")
        corners = _whole(corners.reshape(-1, stride)[:, at[0][0]], "<p>")
        if ((corners < 0) | (corners >= len(points))).any():
            raise ValueError(f"<p> must have corners 0 to {len(points) - 1}")
        match faces.tag:
            case "triangles":
                sizes = np.full(corners.size // 3, 3)
            case "polylist":
                sizes = _whole(_numbers(faces.findtext("vcount"), "<vcount>"), "<vcount>")
            case _:
                sizes = np.array([size for p in lists if (size := p.size // stride)], np.int64)
        if sizes.sum() != corners.size:
            raise ValueError(f"<{faces.tag}> must have as many corners as its faces, got {corners.size}")
        yield points, _fans(corners, sizes)


def _points(vertices: Element, named: Callable[[Element, str, str], Element]) -> Array:
    """Positions of <vertices>."""
    for entry in vertices.findall("input"):
        if entry.get("semantic") == "POSITION":
            source = named(entry, "source", "source")
            accessor = source.find("technique_common/accessor")
            stride, offset = (
                _numbers("" if accessor is None else accessor.get(key, default), f"{key} of <accessor>")
                for key, default in (("stride", "1"), ("offset", "0"))
            )
            values = _numbers(source.findtext("float_array"), "<float_array>")
            if stride.tolist() != [3.0] or offset.tolist() != [0.0] or values.size % 3:
                raise ValueError("its positions must be 3 numbers each")
            return values.reshape(-1, 3)
    raise ValueError("<vertices> must have an <input> of positions")


READERS: dict[str, Callable[[bytes], tuple[Array, Index]]] = {".stl": _stl, ".obj": _obj, ".ply": _ply, ".dae": _dae}
"""By the suffixes of their files."""
