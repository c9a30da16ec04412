"""COLLADA files: the geometry that their scene shows, in its place.

References
----------
M. Barnes, E. Levy Finch, COLLADA: digital asset schema release 1.4.1, The Khronos Group, 2008.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene.mesh_files.numbers import fans, numbers, whole
from nsdyn.tools.arrays import Array, Index

DEEPEST = 100
"""Greatest depth of nested nodes in a scene; deeper nodes refer to each other in a circle."""

NONE = np.full(4, np.nan)
"""No colour."""


def read(data: bytes) -> tuple[Array, Index, Array]:
    """Return vertices (nv, 3), triangles (nt, 3) and their colours (nt, 4), NaN for none; ParseError if not XML."""
    root = ElementTree.fromstring(data)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # without the name space
    if root.tag != "COLLADA":
        raise ValueError(f"its root is <{root.tag}>, not <COLLADA>")
    known = {element.get("id"): element for element in root.iter() if element.get("id")}

    def named(element: Element, attribute: str, tag: str) -> Element:
        """Return the element of the same file to which an attribute refers."""
        there = known.get((element.get(attribute) or "").removeprefix("#"))
        if there is None or there.tag != tag:
            raise ValueError(f"<{element.tag}> names {element.get(attribute)!r}, which is no <{tag}> of the file")
        return there

    vertices: list[Array] = [np.empty((0, 3))]
    triangles: list[Index] = [np.empty((0, 3), np.int64)]
    colours: list[Array] = [np.empty((0, 4))]
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
                paints = {e.get("symbol"): _diffuse(e, known) for e in child.iter("instance_material")}
                for points, corners, symbol in _of_geometry(named(child, "url", "geometry"), named):
                    colours.append(np.tile(paints.get(symbol, NONE), (len(corners), 1)))
                    vertices.append(points @ pose[:3, :3].T + pose[:3, 3])
                    triangles.append(corners + count)
                    count, spent = count + len(points), spent + points.size + corners.size
                    if spent > len(data):  # a number takes two bytes, so only repeated geometry gets here
                        raise ValueError("it shows the same geometry over and over")

    for instance in root.iterfind("scene/instance_visual_scene"):
        add(named(instance, "url", "visual_scene"), np.eye(4), 0)
    return np.concatenate(vertices), np.concatenate(triangles), np.concatenate(colours)


def _diffuse(bound: Element, known: Mapping[str | None, Element]) -> Array:
    """Return diffuse red, green, blue and alpha of an <instance_material>, NaN if it has none that can be read."""
    material = known.get((bound.get("target") or "").removeprefix("#"), bound)
    effect = material.find("instance_effect")
    source = known.get(("" if effect is None else effect.get("url") or "").removeprefix("#"), bound)
    rgba = numbers(next((e.text for e in source.iterfind(".//diffuse/color")), ""), "<color>")
    return np.clip(rgba, 0.0, 1.0) if rgba.shape == (4,) and np.isfinite(rgba).all() else NONE


def _pose(node: Element) -> Array:
    """Return the product of the transformations of a node, in their order."""
    out = np.eye(4)
    for child in node:
        step = np.eye(4)
        if child.tag not in ("matrix", "translate", "scale", "rotate"):
            if child.tag in ("lookat", "skew"):
                raise ValueError(f"<{child.tag}> is not read")
            continue
        size = {"matrix": 16, "rotate": 4}.get(child.tag, 3)
        values = numbers(child.text, f"<{child.tag}>")
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
) -> Iterator[tuple[Array, Index, str | None]]:
    """Yield (vertices, triangles, symbol of their material) for each list of faces of a geometry."""
    mesh = geometry.find("mesh")
    for faces in () if mesh is None else mesh:
        if faces.tag not in ("triangles", "polylist", "polygons"):
            if faces.tag in ("tristrips", "trifans"):
                raise ValueError(f"<{faces.tag}> is not read")
            continue
        inputs = faces.findall("input")
        offsets = [numbers(e.get("offset"), "offset of <input>") for e in inputs]
        if any(o.shape != (1,) or not 0 <= o[0] < 100 for o in offsets):
            raise ValueError("offset of <input> must be a small number")
        stride = 1 + int(max((o[0] for o in offsets), default=0))
        at = [(int(o[0]), e) for o, e in zip(offsets, inputs, strict=True) if e.get("semantic") == "VERTEX"]
        if len(at) != 1:
            raise ValueError(f"<{faces.tag}> must have one <input> of its vertices")
        points = _points(named(at[0][1], "source", "vertices"), named)
        lists = [numbers(p.text, "<p>") for p in faces.findall("p")]
        corners = np.concatenate([np.empty(0), *lists])
        if corners.size % stride:
            raise ValueError(f"<p> must have {stride} numbers per corner")
        corners = whole(corners.reshape(-1, stride)[:, at[0][0]], "<p>")
        if ((corners < 0) | (corners >= len(points))).any():
            raise ValueError(f"<p> must have corners 0 to {len(points) - 1}")
        match faces.tag:
            case "triangles":
                sizes = np.full(corners.size // 3, 3)
            case "polylist":
                sizes = whole(numbers(faces.findtext("vcount"), "<vcount>"), "<vcount>")
            case _:
                sizes = np.array([size for p in lists if (size := p.size // stride)], np.int64)
        if sizes.sum() != corners.size:
            raise ValueError(f"<{faces.tag}> must have as many corners as its faces, got {corners.size}")
        yield points, fans(corners, sizes), faces.get("material")


def _points(vertices: Element, named: Callable[[Element, str, str], Element]) -> Array:
    """Return the positions of <vertices>."""
    for entry in vertices.findall("input"):
        if entry.get("semantic") == "POSITION":
            source = named(entry, "source", "source")
            accessor = source.find("technique_common/accessor")
            stride, offset = (
                numbers("" if accessor is None else accessor.get(key, default), f"{key} of <accessor>")
                for key, default in (("stride", "1"), ("offset", "0"))
            )
            values = numbers(source.findtext("float_array"), "<float_array>")
            if stride.tolist() != [3.0] or offset.tolist() != [0.0] or values.size % 3:
                raise ValueError("its positions must be 3 numbers each")
            return values.reshape(-1, 3)
    raise ValueError("<vertices> must have an <input> of positions")
