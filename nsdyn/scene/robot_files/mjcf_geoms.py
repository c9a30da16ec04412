"""Geoms of MJCF prepared for Pinocchio, which reads all sizes of a type even if the file does not give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene.materials import Material
from nsdyn.scene.robot_files.elements import POSE
from nsdyn.scene.robot_files.mjcf_poses import along
from nsdyn.scene.robot_files.mjcf_visuals import Look, look_of
from nsdyn.scene.robot_files.xml import Notes, Report, numbers, scalar, text_of
from nsdyn.tools.naming import choice

SIZES = {"plane": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "mesh": 0}
"""Number of sizes of the types of geoms that have a `Shape`."""

MOST = 3
"""Most sizes that MuJoCo accepts for any type; it ignores sizes that the type does not have."""

SHAPELESS = ("hfield", "sdf")

LONG = ("capsule", "cylinder", "ellipsoid", "box")
"""Types that two points may define; the first size is then the only one."""

NEAREST = 1e-14
"""Half the distance of the two points, m, below which MuJoCo refuses them."""


@dataclass(frozen=True)
class Geoms:
    """Properties of the geoms of a file besides their shapes, by name.

    Attributes
    ----------
    meshes, paints : dict of str to Element
        Meshes of the file, and materials that give colours.
    looks : dict of str to Look
    masks : dict of str to (int, int)
        contype and conaffinity.
    materials : dict of str to Material
    """

    meshes: dict[str, Element]
    paints: dict[str, Element]
    looks: dict[str, Look] = field(default_factory=dict)
    masks: dict[str, tuple[int, int]] = field(default_factory=dict)
    materials: dict[str, Material] = field(default_factory=dict)

    def read(self, body: Element, taken: set[str], report: Report) -> None:
        """Write out the geoms of a body with names and exact sizes, and remove geoms without a `Shape`.

        `taken` are names that geoms may not have: a geom with such a name, or without a name, is named by its number.
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
            self.materials[label] = _material(geom, label)
            if geom.get("condim") in ("4", "6"):
                report.dropped.append(f"geom {label!r}: friction of spinning and rolling")
            self.masks[label] = masks
            if kind == "mesh" and any(masks):
                continue
            if kind == "mesh":
                as_ball(geom)
            # Pinocchio ignores the mass of geoms that touch nothing.
            geom.attrib |= {"contype": "1", "conaffinity": "1"}

    def collide(self, a: str, b: str) -> bool:
        """Whether the masks of two geoms let them touch."""
        (type1, affinity1), (type2, affinity2) = self.masks.get(a, (0, 0)), self.masks.get(b, (0, 0))
        return bool(type1 & affinity2 or type2 & affinity1)

    def note_pairs(self, root: Element, report: Report) -> None:
        """Note the <pair>s; as missing if the two geoms touch only because of the <pair>."""
        for pair in root.iter("pair"):
            names = pair.get("geom1", ""), pair.get("geom2", "")
            notes: Notes = report.dropped if self.collide(*names) else report.missing
            notes.append(f"contact: <pair> of {names[0]!r} and {names[1]!r}")


def as_ball(geom: Element) -> None:
    """Make a mesh a massless ball at its pose: to Pinocchio every mesh has 1 kg and 1 kg m², whatever its mass."""
    geom.attrib |= {"type": "sphere", "size": "1", "mass": "0"}
    del geom.attrib["mesh"]


def mesh_name(mesh: Element) -> str:
    """Return the name of a mesh asset; without a name, the stem of its file."""
    return mesh.get("name", Path(mesh.get("file", "")).stem)


def _mask(geom: Element, attribute: str, label: str) -> int:
    (mask,) = numbers(geom.get(attribute), 1, (1.0,), f"{attribute} of geom {label!r}").tolist()
    if mask != int(mask):
        raise ValueError(f"{attribute} of geom {label!r} must be a whole number, got {mask!r}")
    return int(mask)


def _check_mesh(geom: Element, kind: str, label: str, meshes: Mapping[str, Element]) -> None:
    """Raise ValueError for a mesh that is not among the assets, and for a shape fitted to a mesh."""
    if kind == "mesh":
        choice(geom.get("mesh", ""), sorted(meshes), f"mesh of geom {label!r}")
    elif "mesh" in geom.attrib:
        raise ValueError(f"geom {label!r} must be of type mesh to name one, got {kind!r}: a fitted shape is not read")


def _write_size(geom: Element, kind: str, label: str) -> None:
    """Give a geom all sizes of its type, and the pose of its ``fromto``; ValueError where MuJoCo raises an error."""
    size, between = numbers(geom.get("size"), None, (), f"size of geom {label!r}"), "fromto" in geom.attrib
    if between and kind not in LONG:
        raise ValueError(f"fromto of geom {label!r} must be of a {', '.join(LONG)}, got a {kind}")
    needed = 1 if between else SIZES[kind]
    if not needed <= size.size <= MOST:
        wanted = f"{needed} to {MOST}" if needed < MOST else f"{MOST}"
        raise ValueError(f"size of geom {label!r}, a {kind}, must be {wanted} numbers, got {size.size}")
    # The first two sizes of a plane are the extent that is drawn.
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
        geom.set("pos", text_of(ends[3:] + half))
        geom.set("quat", text_of(along(half / length)))
    if SIZES[kind]:
        geom.set("size", text_of(size[: SIZES[kind]]))


def _material(geom: Element, label: str) -> Material:
    """Return the material of a geom, by its sliding friction if it gives one; with a `condim` of 1, mu is 0."""
    if geom.get("condim") == "1":
        return Material(mu=0.0)
    given = geom.get("friction")
    if given is None:
        return Material()
    return Material(mu=scalar(" ".join(given.split()[:1]), None, f"friction of geom {label!r}"))
