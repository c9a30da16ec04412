"""Shapes of a recording as objects of a page."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from nsdyn.tools.arrays import Array
from nsdyn.view.commands import UPRIGHT, Json, as_buffer, as_hex, by_columns, set_object, shaded
from nsdyn.view.stage import BEHIND_LINES, GROUND, View, corner_object, halfspace_object, halfspaces

# Paul Tol's "bright" scheme, whose colours colour-blind readers can tell apart.
PALETTE = [(68, 119, 170), (238, 102, 119), (34, 136, 51), (204, 187, 68), (102, 204, 238), (170, 51, 119)]

FEW = 20
"""Most shapes that are drawn in detail: with software rendering, the triangles of many round shapes are slow."""

FIXED_COLOUR = (0.62, 0.65, 0.68)

HALF, SECTOR = (np.pi, 0.72), (np.pi / 16, 0.3)
"""Angle and tone of the part of a round shape that shows its rotation; half of a flat end would look like a shadow."""


def body_path(frame: str) -> str:
    """Return the path of a moving frame in the page's tree."""
    return f"/nsdyn/bodies/{frame.replace('/', '.')}"


def shape_path(scene: Json, shape: Json, name: str) -> str:
    """Return the path of a shape by its name: under its moving frame, or fixed."""
    frame = shape["frame"]
    return f"{body_path(scene['frames'][frame]) if frame >= 0 else '/nsdyn/fixed'}/{name.replace('/', '.')}"


def colour(geom: Json) -> tuple[float, ...]:
    """Return red, green, blue and perhaps alpha of a shape: as given, else by the number of its frame."""
    if geom["colour"]:
        return tuple(geom["colour"])
    k = geom["frame"]
    if k < 0:
        return GROUND if geom["shape"] == "halfspace" else FIXED_COLOUR
    # Each further pass through the palette is lighter.
    return shaded(np.array(PALETTE[k % len(PALETTE)]) / 255, 1.0 + 0.35 * (k // len(PALETTE) % 4))


def shape_commands(scene: Json, view: View) -> list[Json]:
    """Return commands for all collision shapes; moving shapes are under the node of their frame."""
    commands = []
    detail = 32 if len(scene["geoms"]) <= FEW else 16
    for geom in scene["geoms"]:
        path = shape_path(scene, geom, geom["name"])
        if geom["shape"] == "halfspace":
            plane = halfspace_object(np.array(geom["size"]), geom["offset"], colour(geom), view)
            commands.append(set_object(path, plane))
            continue
        commands.append(set_object(path, solid(geom, colour(geom), detail)))
    corners = corner_object(halfspaces(scene["geoms"]), view)  # of this recording only
    return commands + ([set_object("/nsdyn/corners", corners)] if corners else [])


def solid(geom: Json, colour: Iterable[float], detail: int, marked: bool = True) -> Json:
    """Return the node of a bounded shape at its placement: a polytope with its edges, or a round shape.

    Half circles have `detail` sides; a part of a round shape is darker if it is `marked`.
    """
    children = _nodes(geom, colour, detail, marked)
    return {"type": "Group", "matrix": by_columns(np.array(geom["placement"])), "children": children}


def _nodes(geom: Json, colour: Iterable[float], detail: int, marked: bool) -> list[Json]:
    kind, size = geom["shape"], geom["size"]
    if "vertices" in geom:
        return _polytope(np.array(geom["vertices"]), geom["faces"], colour)
    quarter = np.linspace(-np.pi / 2, np.pi / 2, detail + 1)
    arc = np.column_stack([np.cos(quarter), np.sin(quarter)])
    arc[[0, -1], 0] = 0.0
    scale = np.eye(4)
    if kind == "cylinder":
        r, h = size[0], size[1]
        profile = np.array([(0, -h), (r, -h), (r, -h), (r, h), (r, h), (0, h)])
    elif kind == "capsule":
        middle = len(arc) // 2
        lift = np.array([0.0, size[1]])
        profile = np.concatenate([arc[: middle + 1] * size[0] - lift, arc[middle:] * size[0] + lift])
    elif kind == "ellipsoid":
        profile, scale = arc, np.diag([*size, 1.0])
    else:
        profile = arc * size[0]
    part, tone = (SECTOR if kind == "cylinder" else HALF) if marked else (0.0, 1.0)
    nodes = []
    for start, angle, factor in ((part, 2.0 * np.pi - part, 1.0), (0.0, part, tone)):
        points = [{"x": float(x), "y": float(y)} for x, y in profile]
        lathe = {
            "type": "LatheGeometry",
            "points": points,
            "segments": round(detail * angle / np.pi),
            "phiStart": start,
            "phiLength": angle,
        }
        if angle:
            nodes.append(surface(lathe, shaded(colour, factor)) | {"matrix": by_columns(scale @ UPRIGHT)})
    return nodes


def _polytope(vertices: Array, faces: list[list[int]], colour: Iterable[float]) -> list[Json]:
    fans = [(face[0], face[i], face[i + 1]) for face in faces for i in range(1, len(face) - 1)]
    edges = sorted({(min(e), max(e)) for face in faces for e in zip(face, face[1:] + face[:1], strict=True)})
    lines = {
        "type": "LineSegments",
        "geometry": as_buffer(position=vertices[np.array(edges).ravel()]),
        "material": {"type": "LineBasicMaterial", "color": as_hex(shaded(colour, 0.55))},
    }
    corners = vertices[np.array(fans)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    triangles = as_buffer(position=corners.reshape(-1, 3), normal=np.repeat(normals, 3, axis=0))
    return [surface(triangles, colour), lines]


def surface(geometry: Json, colour: Iterable[float]) -> Json:
    """Return the node of a three.js geometry in a colour."""
    alpha = [*colour, 1.0][3]
    material = {
        "type": "MeshPhongMaterial",
        "color": as_hex(colour),
        "specular": 0x222222,
        "shininess": 25,
        "opacity": alpha,
        "transparent": alpha < 1.0,
        **BEHIND_LINES,
    }
    return {
        "type": "Mesh",
        "geometry": geometry,
        "material": material,
        "castShadow": True,
        "receiveShadow": True,
    }
