"""Visual shapes of robots, which a page shows in place of the collision shapes of their links."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.tools.array_text import from_text
from nsdyn.view.commands import Json, as_buffer, by_columns, set_object
from nsdyn.view.solids import shape_path, solid, surface

PLAIN = (0.72, 0.73, 0.75)
"""Colour if the file gives none."""

DETAIL = 16
"""Sides of half circles."""

BACK_SIDE, DOUBLE_SIDE = 1, 2
"""Constants of three.js: triangles of files must be visible from behind. As for all bodies, the sides that face away
from the sun cast the shadows; the sides that face it would show stripes of their own shadow."""


def veiled(scene: Json) -> list[bool]:
    """Return which collision shapes are hidden because their link has visual shapes."""
    seen = {(look["link"].partition("/")[0], look["frame"]) for look in scene.get("visuals", ())}
    return [(geom["body"], geom["frame"]) in seen for geom in scene["geoms"]]


def visual_commands(scene: Json, whole: bool = False) -> list[Json]:
    """Return commands for all visual shapes.

    The page's script adds the triangles of meshes, which shapes may share. Without the script, meshes are `whole`, with
    flat triangles.
    """
    commands = []
    for k, visual in enumerate(scene.get("visuals", ())):
        path, rgba = shape_path(scene, visual, f"look {k}"), visual["colour"] or PLAIN
        if visual["shape"] == "mesh":
            mesh = scene["meshes"][visual["mesh"]]
            triangles = from_text(mesh["triangles"], "<u4", 3).ravel() if whole else [0, 0, 0]
            node = surface(as_buffer(position=from_text(mesh["vertices"], "<f4", 3)[triangles]), rgba)
            node["material"] |= {"side": DOUBLE_SIDE, "shadowSide": BACK_SIDE, "flatShading": whole}
            matrix = by_columns(np.array(visual["placement"]))
            commands.append(set_object(path, {"type": "Group", "matrix": matrix, "children": [node]}))
        else:
            commands.append(set_object(path, solid(visual, rgba, DETAIL, marked=False)))
    return commands


def mesh_arrays(scene: Json) -> dict[str, NDArray[Any]]:
    """Return corners and triangles of the meshes of a page, one mesh after the other, and where each ends."""
    meshes = scene.get("meshes", ())
    corners = [np.empty((0, 3), "<f4"), *(from_text(mesh["vertices"], "<f4", 3) for mesh in meshes)]
    triangles = [np.empty((0, 3), "<u4"), *(from_text(mesh["triangles"], "<u4", 3) for mesh in meshes)]
    return {
        "meshes/position": np.concatenate(corners),
        "meshes/position_ends": np.cumsum([c.size for c in corners[1:]], dtype=np.uint32),
        "meshes/index": np.concatenate(triangles),
        "meshes/index_ends": np.cumsum([t.size for t in triangles[1:]], dtype=np.uint32),
    }
