"""MJCF, the format of MuJoCo.

Pinocchio builds the tree, the inertias and the shapes. It gets a simplified file: one file without includes, classes
and pictures, with all defaults written out and every element named. All trees are under one body without a joint,
because Pinocchio reads only the first tree of a file.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene import meshes
from nsdyn.scene.articulations import WORLD, Description, check_count, check_joints, check_size, describe_model
from nsdyn.scene.mesh_files import stl
from nsdyn.scene.robot_files.elements import POSE, changes_nothing, tell
from nsdyn.scene.robot_files.inertias import check_mass, flaw
from nsdyn.scene.robot_files.mjcf_actuators import ACTUATORS, actuators_of, laid_over
from nsdyn.scene.robot_files.mjcf_elements import MACROS, TABLE, over
from nsdyn.scene.robot_files.mjcf_equalities import gears_of, loops_of
from nsdyn.scene.robot_files.mjcf_geoms import Geoms, as_box, mesh_name
from nsdyn.scene.robot_files.mjcf_joints import SIZES, joints_of, place_joints, set_joints, single, start_of
from nsdyn.scene.robot_files.mjcf_poses import write_quaternions
from nsdyn.scene.robot_files.mjcf_visuals import visuals_of
from nsdyn.scene.robot_files.model import links_of
from nsdyn.scene.robot_files.xml import Report, inside, mesh_file, numbers, parse, scalar
from nsdyn.tools import noise
from nsdyn.tools.naming import choice, unused

PASSIVE = {"range", "stiffness", "damping", "frictionloss", "armature"}
"""Attributes by which a tendon acts by itself; without them it only acts through an actuator."""

DRIVE = "actuator"
"""Where a class has its default of actuators, of whatever kind."""

NUMBERS = {*POSE.split(), "axis", "size", "fromto", "ref", "scale", "vertex"}
"""Attributes that must be numbers: Pinocchio reads other text as arbitrary values."""

CHOICES = {
    "angle": "degree radian",
    "autolimits": "true false",
    "inertia": "convex exact legacy shell",
    "inertiafromgeom": "true false auto",
    "active": "true false",
    "condim": "1 3 4 6",
} | dict.fromkeys(("limited", "ctrllimited", "forcelimited", "actuatorfrclimited"), "true false auto")
"""Attributes that must be one of some words: an unknown word must not be read as the default."""


def read_mjcf(name: str, path: Path, keyframe: str | None) -> Description:
    """Read an MJCF file; the file decides which bases are fixed or free, and `keyframe` names the initial state."""
    root = _with_includes(name, path, parse(name, path, "MJCF", "mujoco"), {path.resolve()})
    report = Report()
    try:
        _merge(root)
        tell(root.findall("default"), {"default": TABLE["default"]}, report)
        _write_out_defaults(root)
        driven = root.findall("actuator/*")
        geoms, trees = _simplify(root, report)
        flaws = [fault for body in root.iter("body") for fault in _flaws(body)]
        # Before Pinocchio builds the model: it makes one joint of several on a body, with tables of the same size.
        check_count(name, sum(SIZES[kind][1] for _, kind, _, _ in joints_of(root)))
        check_joints(name, [e.attrib["name"] for e, *_ in joints_of(root) if "name" in e.attrib])
        model, geometry = _build(root, path, geoms, report)
        check_size(name, model)
        stiffness, rest = set_joints(root, model, report)
        q, controls = start_of(root, model, keyframe, len(driven), report)
        loops = tuple(loops_of(root, model, q, report.missing))
        places = {e.get("name", ""): (a.start, b.start) for e, kind, a, b in joints_of(root) if SIZES[kind] == (1, 1)}
        gears = tuple(gears_of(root, model, places, report.missing))
        autolimits = all(e.get("autolimits", "true") == "true" for e in root.iterfind("compiler"))
        drives = zip(driven, controls, strict=True)
        actuators = actuators_of(drives, model, places, autolimits, report.dropped)
        links = [
            link._replace(material=geoms.materials[link.name], colour=geoms.looks[link.name].colour)
            for link in links_of(model, geometry.geometryObjects, report.dropped)
        ]
        drawn = [link for link in links if trees[link.body] != WORLD or not any(geoms.masks[link.name])]
        visuals = visuals_of(geoms, drawn, geometry, path.parent, report.unused)
        excluded = frozenset(
            frozenset(choice(e.get(end, ""), trees, f"{end} of an <exclude>") for end in ("body1", "body2"))
            for e in root.iterfind("contact/exclude")
        )
        links = [link for link in links if any(geoms.masks[link.name])]
        filtered = frozenset(
            frozenset((a.name, b.name)) for a, b in combinations(links, 2) if not geoms.collide(a.name, b.name)
        )
    except (ValueError, RuntimeError, LookupError) as failure:  # Pinocchio raises all of them
        raise ValueError(f"path of {name!r}: {path} could not be read: {noise.told(failure, [])}") from None
    return describe_model(
        model,
        links,
        q=q,
        stiffness=stiffness,
        rest=rest,
        loops=loops,
        gears=gears,
        actuators=actuators,
        excluded=excluded,
        filtered=filtered,
        world_touches=True,
        trees=_of_joints(trees, model) | trees,
        flaws=tuple(flaws),
        visuals=visuals,
        **report.told(),
    )


# -- a simpler file --------------------------------------------------------------------------------------------


def _with_includes(name: str, path: Path, element: Element, seen: set[Path]) -> Element:
    """Replace includes by the contents of their files; paths are relative to the main file, each file once."""
    for child in list(element):
        if child.tag == "include":
            k = list(element).index(child)
            element.remove(child)
            given = child.get("file", "")
            what = f"path of {name!r}: {path}: <include> of {given!r}"
            file = inside(path.parent / given, given, [path.parent], what)
            if file.resolve() in seen:
                raise ValueError(f"{what} must not come twice")
            seen.add(file.resolve())
            included = parse(name, file, "MJCF")
            for offset, inner in enumerate(_with_includes(name, path, included, seen)):
                element.insert(k + offset, inner)
        else:
            _with_includes(name, path, child, seen)
    return element


def _merge(root: Element) -> None:
    """Merge sections that occur several times, as in a file and its includes."""
    first: dict[str, Element] = {}
    for section in list(root):
        if first.setdefault(section.tag, section) is not section and section.tag != "default":
            first[section.tag].attrib.update(section.attrib)
            first[section.tag].extend(section)
            root.remove(section)


def _write_out_defaults(root: Element) -> None:
    """Give every joint, geom, site and mesh the attributes of its class, and remove the classes."""
    classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}

    def collect(default: Element, parent: str, name: str) -> None:
        own = {tag: dict(attributes) for tag, attributes in classes[parent].items()}
        for child in default:
            if child.tag in ACTUATORS:
                own[DRIVE] = laid_over(own.get(DRIVE, {}), child)
            elif child.tag != "default":
                own[child.tag] = over(own.get(child.tag, {}), child.attrib)
        classes[name] = own
        for child in default.findall("default"):
            if (inner := child.get("class", "")) in {"", *classes}:
                raise ValueError(f"class {inner!r} of a <default> must be a name of its own")
            collect(child, name, inner)

    def apply(element: Element, inherited: str, tag: str) -> None:
        inherited = element.get("childclass", inherited)
        element.attrib.pop("childclass", None)
        name = element.attrib.pop("class", inherited)
        if name not in classes:
            raise ValueError(f"class {name!r} of a <{element.tag}> is not defined")
        if tag in ACTUATORS:
            element.attrib = laid_over(classes[name].get(DRIVE, {}), element)
        else:
            element.attrib = over(classes[name].get(tag, {}), element.attrib)
        for child in element:
            apply(child, inherited, child.tag)

    for default in root.findall("default"):
        choice(default.get("class", "main"), ["main"], "class of the <default> at the top")
        collect(default, "main", "main")
        root.remove(default)
    for section in root:
        for child in section:
            apply(child, "main", section.tag if section.tag in ("tendon", "equality") else child.tag)


def _note(root: Element, report: Report) -> None:
    """Note contents that are not read, and refuse numbers and words that are invalid."""
    tell([root], TABLE, report)
    for element in root.iterfind("tendon/*"):
        notes = report.missing if PASSIVE & element.attrib.keys() else report.dropped
        notes.append(f"<tendon> {element.get('name')!r}")
    for element in (e for section in root if section.tag != "visual" for e in section.iter()):
        for attribute in CHOICES.keys() & element.attrib.keys():
            label = f"{attribute} of <{element.tag}> {element.get('name', '')!r}"
            choice(element.attrib[attribute], CHOICES[attribute].split(), label)
        for attribute in NUMBERS & element.attrib.keys():
            label = f"{attribute} of <{element.tag}> {element.get('name', '')!r}"
            numbers(element.attrib[attribute], None, None, label)


def _trees(world: Element, moving: set[str]) -> dict[str, str]:
    """Return for every body, by name, the top body that carries it; the world if the top body carries no `moving`."""
    out = {WORLD: WORLD}
    for body in world.findall("body"):
        names = {e.get("name", "") for e in body.iter("body")}
        out |= dict.fromkeys(names, body.get("name", "") if names & moving else WORLD)
    return out


def _name_bodies(world: Element) -> None:
    """Give every body a name that no other has; ValueError for a name given twice, or that the world has."""
    given = {WORLD}
    for name in [body.attrib["name"] for body in world.iter("body") if "name" in body.attrib]:
        if name in given:
            raise ValueError(f"body {name!r} must have a name of its own")
        given.add(name)
    for number, body in enumerate(world.iter("body")):
        body.attrib.setdefault("name", unused(f"body{number}", given))
    world.set("name", WORLD)


def _meshes(root: Element) -> dict[str, Element]:
    """Return the mesh assets by name; give each a name, and paths of files relative to the folder of the main file."""
    settings, out = getattr(root.find("compiler"), "attrib", {}), {}
    folder = settings.pop("meshdir", settings.pop("assetdir", ""))
    for element in root.iterfind("asset/mesh"):
        element.set("name", mesh_name(element))
        if "file" in element.attrib:
            element.set("file", str(Path(folder) / element.attrib["file"]))
        out[element.attrib["name"]] = Element("mesh", dict(element.attrib))
    return out


def _simplify(root: Element, report: Report) -> tuple[Geoms, dict[str, str]]:
    """Reduce the file to elements that Pinocchio reads, named and under one body; return geoms and trees of bodies."""
    world = root.find("worldbody")
    if world is None:
        raise ValueError("it has no <worldbody>")
    _name_bodies(world)
    _note(root, report)
    write_quaternions(root)
    carriers = [b for b in world.iter("body") if any(e.tag in ("joint", "freejoint") for e in b)]
    moving = {e.get("name", "") for carrier in carriers for e in carrier.iter("body")}
    paints = {e.get("name", ""): e for e in root.iterfind("asset/material")}
    settings = getattr(root.find("compiler"), "attrib", {})
    by_geoms = settings.get("inertiafromgeom") == "true" and settings.pop("inertiafromgeom")
    least, most = numbers(settings.get("inertiagrouprange"), 2, (0, 5), "inertiagrouprange of <compiler>")
    bound = scalar(settings.get("boundmass"), 0.0, "boundmass of <compiler>")
    trees, geoms = _trees(world, moving), Geoms(_meshes(root), paints)
    # Fixed geoms become bodies of the scene, whose names must differ from those of links and joints.
    taken = {name for name, tree in trees.items() if tree != WORLD} | {e.get("name", "") for e in world.iter("joint")}
    tops = world.findall("body")
    for body in [world, *world.iter("body")]:
        where = body.get("name", "")
        body[:] = sorted(body, key=lambda child: child.tag == "body")  # a body comes before the bodies it carries
        for child in list(body):
            if child.tag in MACROS.split():
                raise ValueError(
                    f"body {where!r} has a <{child.tag}>: save the file as MuJoCo compiles it, then read that"
                )
            if child.tag not in ("body", "joint", "freejoint", "inertial", "geom", "site"):
                body.remove(child)
            if child.tag == "geom" and child.get("type") == "plane" and where in moving:
                raise ValueError(f"geom {child.get('name', '')!r} must not be a plane: body {where!r} moves")
            if child.tag == "freejoint" or (child.tag == "joint" and child.get("type") == "free"):
                if body not in tops:
                    raise ValueError(f"body {where!r} must be at the top of the world to have a free joint")
                child.attrib.pop("pos", None)  # MuJoCo ignores it
        heavy = False
        for geom in body.findall("geom"):
            if not least <= scalar(geom.get("group"), 0.0, f"group of a <geom> of body {where!r}") <= most:
                geom.set("mass", "0")
            heavy |= not changes_nothing(geom.get("mass", geom.get("density", "1")), "0")
        if where not in moving or (by_geoms and heavy):
            body[:] = [child for child in body if child.tag != "inertial"]
        if where not in moving:  # only its shapes are used; Pinocchio gives a plane 1 kg
            ElementTree.SubElement(body, "inertial", {"mass": "0", "pos": "0 0 0", "diaginertia": "0 0 0"})
        elif bound and body.find("inertial") is None:
            # Pinocchio bounds <inertial>, and does not expose the mass that geoms give a body.
            report.missing.append(f"body {where!r}: boundmass where its geoms have less")
        geoms.read(body, taken if trees[where] == WORLD else set(), report)
    geoms.note_pairs(root, report)
    world.tag = "body"
    needed = {geom.get("mesh") for geom in world.iter("geom")}
    for section in list(root):
        if section.tag not in ("compiler", "equality", "contact", "asset", "keyframe"):
            root.remove(section)
    for asset in root.findall("asset"):
        for child in [c for c in asset if c.tag != "mesh" or mesh_name(c) not in needed]:
            asset.remove(child)
        tell(asset, TABLE, report, "mesh of shape")
    ElementTree.SubElement(root, "worldbody").append(world)
    return geoms, trees


def _build(root: Element, path: Path, geoms: Geoms, report: Report) -> tuple[Any, Any]:
    """Return (model, geometry) that Pinocchio builds from the simplified file."""
    if root.find("compiler") is None:
        ElementTree.SubElement(root, "compiler")
    bare = Element("mujoco", root.attrib)
    bare.extend(e for e in root if e.tag in ("compiler", "asset", "worldbody"))
    with tempfile.TemporaryDirectory() as scratch:
        _copy_meshes(bare, path.parent, Path(scratch))
        shaped, file = (Path(scratch) / f"{which}.xml" for which in (f"{path.stem}-shapes", path.stem))
        ElementTree.ElementTree(bare).write(shaped)
        for geom in [g for body in bare.iter("body") if body.find("inertial") is None for g in body.findall("geom")]:
            if (mesh := geoms.looks[geom.attrib["name"]].mesh) is not None:
                try:
                    as_box(geom, mesh, path.parent)
                except ValueError as failure:
                    report.missing.append(f"inertia of geom {geom.attrib['name']!r}: {failure}")
        ElementTree.ElementTree(bare).write(file)
        with noise.caught():
            model = pin.buildModelFromMJCF(str(file))
            geometry = pin.buildGeomFromMJCF(model, str(shaped), pin.GeometryType.COLLISION)
    place_joints(model)
    return single(root, model, geometry), geometry


def _copy_meshes(root: Element, home: Path, scratch: Path) -> None:
    """Write the meshes of a file to `scratch` in a form that Pinocchio surely reads; ValueError names their geom."""
    users = {geom.get("mesh"): geom.get("name") for geom in root.iter("geom")}
    for number, element in enumerate(root.iter("mesh")):
        name = element.get("name")
        if "vertex" in element.attrib:
            continue
        try:
            if "file" not in element.attrib:
                raise ValueError(f"mesh {name!r} has neither a file nor vertices")
            surface = meshes.read(mesh_file(element.attrib["file"], [home], ""))
        except ValueError as failure:
            raise ValueError(f"geom {users[name]!r}: {failure}") from None
        element.set("file", f"mesh{number}.stl")
        (scratch / f"mesh{number}.stl").write_bytes(stl.binary(surface.vertices, surface.triangles))


def _flaws(body: Element) -> Iterator[str]:
    """Yield in words why no body can have the inertia that a body gives in <inertial>."""
    inertial, where = body.find("inertial"), f"body {body.get('name')!r}"
    for geom in body.findall("geom"):
        for attribute in ("mass", "density"):
            check_mass(scalar(geom.get(attribute), 0.0, f"{attribute} of {where}"), where)
    if inertial is None:
        return
    check_mass(scalar(inertial.get("mass"), None, f"mass of {where}"), where)
    xx, yy, zz = numbers(inertial.get("diaginertia"), 3, (0, 0, 0), f"diaginertia of {where}")
    full = numbers(inertial.get("fullinertia"), 6, (xx, yy, zz, 0, 0, 0), f"fullinertia of {where}")
    xx, yy, zz, xy, xz, yz = full
    if fault := flaw(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), where):
        yield fault


def _of_joints(trees: Mapping[str, str], model: Any) -> dict[str, str]:
    """Return the trees of the joints, by name: the trees of the bodies that they carry."""
    carried = [f for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]
    return {model.names[f.parentJoint]: trees[f.name] for f in carried}
