"""Geoms of MJCF prepared for Pinocchio, which reads all sizes of a type even if the file does not give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene import hulls, meshes
from nsdyn.scene.materials import Material
from nsdyn.scene.robot_files.elements import POSE
from nsdyn.scene.robot_files.inertias import check_mass
from nsdyn.scene.robot_files.mjcf_poses import along, quaternion
from nsdyn.scene.robot_files.mjcf_visuals import Look, look_of
from nsdyn.scene.robot_files.xml import Notes, Report, mesh_file, numbers, scalar, text_of
from nsdyn.tools.arrays import Array
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
            if kind == "mesh":  # a ball for Pinocchio, at the pose of the mesh
                geom.attrib |= {"type": "sphere", "size": "1"}
                del geom.attrib["mesh"]
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


def as_box(geom: Element, mesh: Element, home: Path) -> None:
    """Make a mesh the box of its mass, centre and inertia: to Pinocchio every mesh has 1 kg and 1 kg m².

    `home` is the folder of the file. ValueError, and a box without mass, if the mesh is not there or not a solid.
    """
    label, given = f"of geom {geom.get('name')!r}", dict(geom.attrib)
    mass = scalar(given.get("mass", given.get("density")), 1000.0, f"mass {label}")
    geom.attrib |= {"type": "box", "size": "1 1 1", "mass": "0"}
    geom.attrib.pop("mesh", None)
    if mass != 0.0:
        volume, centre, products = _solid(mesh, home)
        squares, axes = np.linalg.eigh(products)
        turn = pin.Quaternion(*numbers(given.get("quat"), 4, (1, 0, 0, 0), f"quat {label}")).toRotationMatrix()
        geom.set("mass", repr(check_mass(mass * (1.0 if "mass" in given else volume), label)))
        geom.set("size", text_of(np.sqrt(3.0 * squares.clip(0.0))))
        geom.set("pos", text_of(numbers(given.get("pos"), 3, (0, 0, 0), f"pos {label}") + turn @ centre))
        geom.set("quat", text_of(quaternion(turn @ axes * np.sign(np.linalg.det(axes)))))


@np.errstate(all="ignore")
def _solid(mesh: Element, home: Path) -> tuple[float, Array, Array]:
    """Return volume (of a shell: area), centroid and mean products of coordinates about it, (3, 3), as MuJoCo does."""
    label, how = f"of mesh {mesh.get('name')!r}", mesh.get("inertia", "legacy")
    if "vertex" in mesh.attrib:
        vertices = numbers(mesh.get("vertex"), None, None, f"vertex {label}").reshape(-1, 3)
        triangles = numbers(mesh.get("face"), None, (), f"face {label}").reshape(-1, 3).astype(int)
        if not ((triangles >= 0) & (triangles < len(vertices))).all():
            raise ValueError(f"face {label} must have corners 0 to {len(vertices) - 1}, got {mesh.get('face')!r}")
    else:
        vertices, triangles, _ = meshes.read(mesh_file(mesh.get("file", ""), [home], ""))
    turn = pin.Quaternion(*numbers(mesh.get("refquat"), 4, (1, 0, 0, 0), f"refquat {label}")).normalized()
    vertices = (vertices - numbers(mesh.get("refpos"), 3, (0, 0, 0), f"refpos {label}")) @ turn.toRotationMatrix()
    vertices = vertices * numbers(mesh.get("scale"), 3, (1, 1, 1), f"scale {label}")
    if how == "convex" or not triangles.size:
        triangles = np.array([(loop[0], a, b) for loop in hulls.faces(vertices) for a, b in pairwise(loop[1:])])
    corners = vertices[triangles]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    centre, order = sizes @ corners.mean(axis=1) / sizes.sum(), 2.0
    # Pyramids over the triangles: those of the legacy law overlap where the apex does not see all of the surface.
    for shift in (0.25, 0.0):
        edges = corners - centre
        if how != "shell":
            sizes, order = np.linalg.det(edges) / 6.0, 3.0
            sizes = sizes if how == "exact" else np.abs(sizes)
        centre = centre + shift * (sizes @ edges.sum(axis=1)) / sizes.sum()
    edges = np.concatenate((edges, edges.sum(axis=1, keepdims=True)), axis=1)
    products = np.einsum("i,ija,ijb->ab", sizes, edges, edges) / ((order + 1.0) * (order + 2.0) * sizes.sum())
    if not np.isfinite(products).all():
        raise ValueError(f"volume {label} must be finite and not 0")
    return abs(float(sizes.sum())), centre, products


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
