"""Geoms of MJCF as Pinocchio needs them: it reads the sizes that a type has whether they are there or not."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene.materials import Material
from nsdyn.scene.robot_files.elements import POSE
from nsdyn.scene.robot_files.mjcf_visuals import Look, look_of
from nsdyn.scene.robot_files.xml import Notes, Report, numbers
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

__all__ = ["Geoms", "mesh_name"]

SIZES = {"plane": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "mesh": 0}
"""Sizes of the types of geoms that have a shape here."""

MOST = 3
"""Sizes that MuJoCo takes of any type; at those beyond what the type has it does not look."""

SHAPELESS = ("hfield", "sdf")

LONG = ("capsule", "cylinder", "ellipsoid", "box")
"""Types that may lie between two points; their first size is then the only one."""

NEAREST = 1e-14
"""Half a distance of such points, m, below which MuJoCo refuses them."""


@dataclass(frozen=True)
class Geoms:
    """What the geoms of a file say beside their shapes, by name.

    Attributes
    ----------
    meshes, paints : dict of str to Element
        The meshes that the file has, and the materials that give colours.
    looks : dict of str to Look
    masks : dict of str to (int, int)
        Their contype and conaffinity.
    materials : dict of str to Material
        Of those that tell one.
    """

    meshes: dict[str, Element]
    paints: dict[str, Element]
    looks: dict[str, Look] = field(default_factory=dict)
    masks: dict[str, tuple[int, int]] = field(default_factory=dict)
    materials: dict[str, Material] = field(default_factory=dict)

    def read(self, body: Element, taken: set[str], report: Report) -> None:
        """Write the geoms of a body out, named and with exact sizes, and remove those without a shape here.

        `taken` are names that they may not have: one without a name, or with such a one, is called by its number.
        """
        where = body.get("name", "")
        for number, geom in enumerate(body.findall("geom")):
            if geom.get("name") in taken:
                del geom.attrib["name"]
            label = geom.attrib.setdefault("name", f"{where}_{number}")
            if label in self.masks:
                raise ValueError(f"geom {label!r} of body {where!r} must have a name of its own")
            kind = choice(geom.get("type", "sphere"), [*SIZES, *SHAPELESS], f"type of geom {label!r}")
            masks = _mask(geom, "contype", label), _mask(geom, "conaffinity", label)
            if kind in SHAPELESS:
                notes = report.missing if any(masks) or kind == "sdf" else report.unused  # an sdf has mass
                notes.append(f"geom {label!r} of type {kind!r} on body {where!r}")
                body.remove(geom)
                continue
            _check_mesh(geom, kind, label, self.meshes)
            self.looks[label] = look_of(geom, label, self.meshes, self.paints)
            geom.attrib.pop("material", None)
            _write_size(geom, kind, label)
            if material := _material(geom, label):
                self.materials[label] = material
            if geom.get("condim") in ("4", "6"):
                report.dropped.append(f"geom {label!r}: friction of spinning and rolling")
            self.masks[label] = masks
            if kind == "mesh" and any(masks):
                continue
            if kind == "mesh":  # where it is is that of a ball without mass
                geom.attrib |= {"type": "sphere", "size": "1", "mass": "0"}
                del geom.attrib["mesh"]
            # Pinocchio leaves the mass of a geom that touches nothing out; that of a mesh it never counts.
            geom.attrib |= {"contype": "1", "conaffinity": "1"}

    def collide(self, a: str, b: str) -> bool:
        """Whether the masks of two geoms let them touch."""
        (type1, affinity1), (type2, affinity2) = self.masks.get(a, (0, 0)), self.masks.get(b, (0, 0))
        return bool(type1 & affinity2 or type2 & affinity1)

    def note_pairs(self, root: Element, report: Report) -> None:
        """Note <pair>s: missing are those that touch only because of them."""
        for pair in root.iter("pair"):
            names = pair.get("geom1", ""), pair.get("geom2", "")
            notes: Notes = report.dropped if self.collide(*names) else report.missing
            notes.append(f"contact: <pair> of {names[0]!r} and {names[1]!r}")


def mesh_name(mesh: Element) -> str:
    """Name of an asset: that of its file where it has none of its own."""
    return mesh.get("name", Path(mesh.get("file", "")).stem)


def _mask(geom: Element, attribute: str, label: str) -> int:
    return int(numbers(geom.get(attribute), 1, (1.0,), f"{attribute} of geom {label!r}")[0])


def _check_mesh(geom: Element, kind: str, label: str, meshes: Mapping[str, Element]) -> None:
    """ValueError for a mesh that is not among the assets, and one that another shape is fitted to."""
    if kind == "mesh":
        choice(geom.get("mesh", ""), sorted(meshes), f"mesh of geom {label!r}")
    elif "mesh" in geom.attrib:
        raise ValueError(f"geom {label!r} must be of type mesh to name one, got {kind!r}: a fitted shape is not read")


def _write_size(geom: Element, kind: str, label: str) -> None:
    """Give a geom as many sizes as its type has, and the pose that its ``fromto`` says; ValueError as MuJoCo's."""
    size, between = numbers(geom.get("size"), None, (), f"size of geom {label!r}"), "fromto" in geom.attrib
    if between and kind not in LONG:
        raise ValueError(f"fromto of geom {label!r} must be of a {', '.join(LONG)}, got a {kind}")
    needed = 1 if between else SIZES[kind]
    if not needed <= size.size <= MOST:
        wanted = f"{needed} to {MOST}" if needed < MOST else f"{MOST}"
        raise ValueError(f"size of geom {label!r}, a {kind}, must be {wanted} numbers, got {size.size}")
    # The first two of a plane are how much of it is drawn.
    if (size[2 if kind == "plane" else 0 : needed] <= 0.0).any():
        raise ValueError(f"size of geom {label!r}, a {kind}, must be positive, got {geom.get('size')!r}")
    if between:
        ends = numbers(geom.attrib.pop("fromto"), 6, None, f"fromto of geom {label!r}")
        half = 0.5 * (ends[:3] - ends[3:])
        length = float(np.linalg.norm(half))
        if length < NEAREST:
            raise ValueError(f"fromto of geom {label!r} must be two points, got {ends[:3].tolist()} twice")
        size = np.r_[np.full(SIZES[kind] - 1, size[0]), length]
        if numbers(geom.get("pos"), 3, (0, 0, 0), f"pos of geom {label!r}").any():
            raise ValueError(f"geom {label!r} must have pos or fromto, got both")
        for attribute in POSE.split():
            geom.attrib.pop(attribute, None)
        geom.set("pos", _text(ends[3:] + half))
        geom.set("quat", _text(_turn(half / length)))
    if SIZES[kind]:
        geom.set("size", _text(size[: SIZES[kind]]))


def _turn(z: Array) -> Array:
    """Quaternion w x y z of the shortest turn of the z axis to a unit vector, about x where both are parallel."""
    sine = math.hypot(z[0], z[1])
    axis = np.array([-z[1], z[0], 0.0]) / sine if sine > 1e-10 else np.array([1.0, 0.0, 0.0])  # MuJoCo's bound
    angle = 0.5 * math.atan2(sine, z[2])
    return np.array([math.cos(angle), *(math.sin(angle) * axis)])


def _text(values: Array) -> str:
    return " ".join(map(repr, values.tolist()))


def _material(geom: Element, label: str) -> Material | None:
    """Material of a geom that gives Coulomb's friction, of sliding; a `condim` of 1 has none."""
    if geom.get("condim") == "1":
        return Material(mu=0.0)
    given = geom.get("friction")
    if given is None:
        return None
    return Material(mu=float(numbers(" ".join(given.split()[:1]), 1, None, f"friction of geom {label!r}")[0]))
