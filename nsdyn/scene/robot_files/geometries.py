"""Shapes and colours of URDF and SDF, which have the same names: in URDF they are attributes, in SDF elements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene import shapes
from nsdyn.scene.robot_files.xml import mesh_file, numbers
from nsdyn.scene.visuals import Colour, mesh_visual
from nsdyn.tools.arrays import Array

Text = Callable[[Element, str], str | None]
"""Finds the text of a name in an element: `Element.get` for attributes, `Element.findtext` for elements."""


def shape_of(
    geometry: Element | None, text: Text, folders: Sequence[Path], shown: bool = False
) -> tuple[Any, Array] | None:
    """Return (shape, its origin) of a <geometry>, None for one without a `Shape`; of a `shown` mesh its file."""
    if geometry is None or len(geometry) != 1:
        raise ValueError("<geometry> must hold one shape")
    (element,), origin = geometry, np.zeros(3)

    def value(name: str, count: int, default: Sequence[float] | None = None) -> Any:
        found = numbers(text(element, name), count, default, f"{name} of <{element.tag}>")
        return found if count > 1 else float(found[0])

    match element.tag:
        case "box":
            return shapes.box(value("size", 3)), origin
        case "sphere":
            return shapes.sphere(value("radius", 1)), origin
        case "cylinder":
            return shapes.cylinder(value("radius", 1), value("length", 1)), origin
        case "capsule":
            return shapes.capsule(value("radius", 1), value("length", 1)), origin
        case "ellipsoid":
            return shapes.ellipsoid(value("radii", 3)), origin
        case "plane":
            return shapes.halfspace(value("normal", 3, (0, 0, 1)), 0.0), origin
        case "mesh":
            uri = text(element, "filename") or text(element, "uri") or ""
            file, scale = mesh_file(uri.strip(), folders), value("scale", 3, (1, 1, 1))
            return (mesh_visual(file, scale), origin) if shown else shapes.mesh(file, scale)
        case _:
            return None


def colour_of(text: str, count: int | None, what: str) -> Colour:
    """Return the colour of `count` numbers, of 3 or 4 for None."""
    r, g, b, *a = np.clip(numbers(text, count, None, what), 0.0, 1.0).tolist()
    return r, g, b, a[0] if a else 1.0
