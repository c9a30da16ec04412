"""Visual shapes of an MJCF file: the geoms that MuJoCo's viewer shows, of groups 0 to 2, in their colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree.ElementTree import Element

from nsdyn.scene.articulations import Link
from nsdyn.scene.robot_files.geometries import colour_of
from nsdyn.scene.robot_files.xml import Notes, mesh_file, numbers
from nsdyn.scene.shapes import HALFSPACE
from nsdyn.scene.visuals import Colour, Visual, mesh_visual

if TYPE_CHECKING:
    from nsdyn.scene.robot_files.mjcf_geoms import Geoms

SHOWN = 2
"""Last group that MuJoCo shows by default."""


class Look(NamedTuple):
    """Appearance of a geom: its mesh, if it has one, its colour, if the file gives one, and whether it is shown."""

    mesh: Element | None
    colour: Colour | None
    shown: bool


def look_of(geom: Element, label: str, meshes: Mapping[str, Element], materials: Mapping[str, Element]) -> Look:
    """Return the look of a geom, with its mesh if it is of type mesh; ValueError for an invalid colour."""
    mesh = meshes.get(geom.get("mesh", "")) if geom.get("type") == "mesh" else None
    material = materials.get(geom.get("material", ""), geom)
    given = geom.get("rgba", material.get("rgba"))
    colour = None if given is None else colour_of(given, 4, f"rgba of geom {label!r}")
    group = numbers(geom.get("group"), 1, (0.0,), f"group of geom {label!r}")[0]
    return Look(mesh, colour, group <= SHOWN and (colour is None or colour[3] > 0.0))


def visuals_of(geoms: Geoms, links: Sequence[Link], geometry: Any, home: Path, notes: Notes) -> tuple[Visual, ...]:
    """Return the visual shapes of geoms; no shapes if they would equal the collision shapes.

    `links` are the geoms as shapes, and `geometry` has them as Pinocchio's objects, where the placement of a mesh is
    the pose of the origin of its file. `home` is the folder of the file; `notes` tell of geoms that are not shown.
    """
    placed, out, more = {g.name: g.placement for g in geometry.geometryObjects}, [], False
    for link in links:
        look = geoms.looks[link.name]
        if not look.shown or link.shape.kind == HALFSPACE:
            continue
        more |= look.mesh is not None or look.colour is not None or not any(geoms.masks[link.name])
        if look.mesh is None:
            out.append(Visual(link.body, link.joint, link.placement, link.shape, look.colour))
            continue
        try:
            if "file" not in look.mesh.attrib:
                raise ValueError("its mesh has no file")
            scale = numbers(look.mesh.get("scale"), 3, (1, 1, 1), "scale of <mesh>")
            mesh = mesh_visual(mesh_file(look.mesh.attrib["file"], [home], ""), scale)
        except ValueError as failure:
            notes.append(f"visual of geom {link.name!r}: {failure}")
            continue
        out.append(Visual(link.body, link.joint, placed[link.name], mesh, look.colour))
    return tuple(out) if more else ()
