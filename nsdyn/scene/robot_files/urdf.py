"""URDF files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.articulations import Description, Link, describe_model
from nsdyn.scene.gears import Gear, following, gear
from nsdyn.scene.robot_files.elements import Rules, tell
from nsdyn.scene.robot_files.geometries import colour_of, shape_of
from nsdyn.scene.robot_files.inertias import check_mass, flaw
from nsdyn.scene.robot_files.xml import XACRO, Report, is_limit, numbers, parse, scalar, text_of
from nsdyn.scene.visuals import Colour, Visual
from nsdyn.tools import noise
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

UNREAD = dict.fromkeys(("planar", "floating"), "limit dynamics mimic") | {"fixed": "mimic"}
"""Elements of a joint that are not read, by its type."""

TABLE = {
    "robot": Rules(
        "name version link joint material gazebo",
        many="link joint material gazebo",
        unused="transmission ros2_control sensor",
        missing="loop_joint",
    ),
    "link": Rules("name type inertial collision visual", unused="sensor", many="collision visual"),
    "inertial": Rules("name origin mass inertia"),
    "collision": Rules("name origin geometry", unused="verbose material"),
    "origin": Rules("xyz rpy"),
    "mass": Rules("value"),
    "inertia": Rules("ixx iyy izz ixy ixz iyz"),
    "geometry": Rules("name box sphere cylinder capsule mesh"),
    "box": Rules("name size"),
    "sphere": Rules("name radius"),
    "cylinder": Rules("name radius length"),
    "capsule": Rules("name radius length"),
    "mesh": Rules("name filename scale"),
    "joint": Rules("name type dont_collapse parent child origin axis limit dynamics mimic", unused="calibration"),
    "axis": Rules("xyz"),
    "limit": Rules("lower upper effort velocity"),
    "dynamics": Rules("damping friction"),
    "mimic": Rules("joint multiplier offset"),
    # Gazebo's additions to a link or joint; self-contact at "true" changes nothing, since links may touch anyway.
    "gazebo": Rules(
        "reference material visual frame",
        many="material visual frame",
        unused="sensor light laserRetro provideFeedback implicitSpringDamper cfmDamping maxContacts "
        "preserveFixedJoint disableFixedJointLumping canonicalBody",
        missing="joint link",
        still={
            "gravity": "true",
            "turnGravityOff": "false",
            "kinematic": "false",
            "static": "false",
            "enable_wind": "false",
            "selfCollide": "true",
            "self_collide": "true",
            "dampingFactor": "0",
            "springStiffness": "0",
            "springReference": "0",
            "fdir1": "0 0 0",
            "slip1": "0",
            "slip2": "0",
        },
    ),
}
"""Rules for the elements of a URDF; visual shapes are not searched."""


def read_urdf(name: str, path: Path, base: str, package_dirs: Sequence[Path]) -> Description:
    """Read a URDF file.

    Pinocchio reads links, inertias and joints. This module reads the collision shapes, because urdfdom, which Pinocchio
    uses, has no capsules and drops all shapes of a link that has one.
    """
    if base not in ("fixed", "free"):
        raise ValueError(f"base of {name!r} must be 'fixed' or 'free', got {base!r}")
    root = parse(name, path, "URDF", "robot")
    if any("xacro" in e.tag or "${" in "".join(e.attrib.values()) for e in root.iter()):
        raise ValueError(f"path of {name!r}: {path} {XACRO}")
    _write_angles(name, path, root)
    report = Report()
    dropped, unused = report.dropped, report.unused
    elements, joints = root.findall("link"), [e for e in root if e.tag == "joint"]
    _note_unread(report, root, joints)
    collisions = [(e.get("name", ""), c) for e in elements for c in e.findall("collision")]
    looks = [(e.get("name", ""), v) for e in elements for v in e.findall("visual")]
    colours = {e.get("name"): e for e in root.findall("material")}
    for element in elements:
        for child in [c for c in element if c.tag != "inertial"]:
            element.remove(child)
    lines: list[str] = []
    try:
        _check_tree(elements, joints)
        flaws = [fault for e in elements for fault in _flaws(e)]
        for joint in joints:
            if joint.get("type") == "planar":
                _turn_plane(root, joint)
        root_joint = (pin.JointModelFreeFlyer(),) if base == "free" else ()
        with noise.caught() as lines:
            model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"), *root_joint)
    except (ValueError, RuntimeError) as failure:
        raise ValueError(f"path of {name!r}: {path} could not be read: {noise.told(failure, lines)}") from None
    links: list[Link] = []
    folders = [path.parent, *package_dirs]
    for body, collision in collisions:
        frame = model.frames[model.getFrameId(body, pin.FrameType.BODY)]
        link = f"{body}_{sum(other.body == body for other in links)}"
        try:
            with dropped.of_warnings(link):
                shape, shift = _shape(collision.find("geometry"), folders)
            placement = frame.placement * _pose(collision.find("origin")) * pin.SE3(np.eye(3), shift)
        except ValueError as failure:
            raise ValueError(f"path of {name!r}: {path}, collision of {body!r}: {failure}") from None
        links.append(Link(link, body, int(frame.parentJoint), placement, shape))
    visuals = []
    for body, visual in looks:
        try:
            visuals.append(_visual(body, visual, model, folders, colours))
        except ValueError as failure:
            unused.append(f"visual of link {body!r}: {failure}")
    try:
        q, gears = _mimics(joints, model)
    except ValueError as failure:
        raise ValueError(f"path of {name!r}: {path}, {failure}") from None
    more = {"q": q, "gears": gears, "flaws": tuple(flaws), "visuals": tuple(visuals)}
    return describe_model(model, links, **more, **report.told())


def _write_angles(name: str, path: Path, root: Element) -> None:
    """Write quat_xyzw as rpy: urdfdom reads it only if the file gives a version, and ignores it silently otherwise."""
    for origin in root.iter("origin"):
        if "quat_xyzw" in origin.attrib:
            what = f"path of {name!r}: {path}, quat_xyzw"
            values = numbers(origin.attrib.pop("quat_xyzw"), 4, None, what)
            if not values.any():
                raise ValueError(f"{what} must not be zero")
            angles = pin.rpy.matrixToRpy(pin.Quaternion(np.array(values)).normalized().toRotationMatrix())
            origin.set("rpy", text_of(angles))


def _note_unread(report: Report, root: Element, joints: Sequence[Element]) -> None:
    """Note contents of a file that Pinocchio or nsdyn does not read."""
    report.missing.extend(
        f"joint {joint.get('name')!r}: <{e.tag}> of a {joint.get('type')} joint"
        for joint in joints
        for e in joint
        if e.tag in UNREAD.get(joint.get("type", ""), "").split()
    )
    fast = [joint.get("name") for joint in joints for e in joint.iter("limit") if is_limit(e.get("velocity"))]
    if fast:
        report.dropped.append(f"joint {fast[0]!r}: velocity of <limit> ({len(fast)})")
    report.dropped.extend(
        f"joint {joint.get('name')!r}: its motion, since a <limit> without lower and upper is from 0 to 0"
        for joint in joints
        for e in joint.findall("limit")
        if joint.get("type") in ("revolute", "prismatic") and not {"lower", "upper"} & set(e.attrib)
    )
    tell([root], TABLE, report)


def _mimics(joints: Sequence[Element], model: Any) -> tuple[Array, tuple[Gear, ...]]:
    """Return (zero configuration with mimic joints at the values of their gears, gears of <mimic>)."""
    gears = []
    for joint in joints:
        for mimic in joint.findall("mimic") if joint.get("type") not in UNREAD else ():
            label = f"mimic of {joint.get('name')!r}"
            ratio, offset = (
                scalar(mimic.get(what), default, f"{what} of {label}")
                for what, default in (("multiplier", 1.0), ("offset", 0.0))
            )
            pair = mimic.get("joint", ""), joint.get("name", "")
            gears.append(gear(model, label, pair, ratio, offset))
    return following(model, gears, pin.neutral(model)), tuple(gears)


def _check_tree(links: Sequence[Element], joints: Sequence[Element]) -> None:
    """Refuse joints between unknown links, and links that are not all connected to one root."""
    names = [e.get("name", "") for e in links]
    parents: dict[str, str] = {}
    for joint in joints:
        label = f"joint {joint.get('name')!r}"
        parent, child = (
            choice("" if (e := joint.find(end)) is None else e.get("link", ""), names, f"{end} of {label}")
            for end in ("parent", "child")
        )
        if child in parents:
            raise ValueError(f"child of {label} must hang on one joint, link {child!r} hangs on two: cut the loop")
        parents[child] = parent
    roots = [name for name in names if name not in parents]
    if names and len(roots) != 1:
        raise ValueError(f"its links must hang on one root by joints, got {roots or 'a circle'}")
    for name in names:
        seen = {name}
        while (name := parents.get(name, "")) and name not in seen:
            seen.add(name)
        if name:
            raise ValueError(f"its links must hang on one root, but {sorted(seen)} hang on each other in a circle")


def _turn_plane(root: Element, joint: Element) -> None:
    """Put a planar joint that Pinocchio lays in its xy plane across its axis: its frame turns, and its child back."""
    label, axis = joint.get("name", ""), joint.find("axis")
    xyz = numbers(None if axis is None else axis.get("xyz"), 3, (1, 0, 0), f"axis of joint {label!r}")
    if not xyz.any():
        raise ValueError(f"axis of joint {label!r} must not be zero")
    if xyz[2] > 0.0 and not xyz[:2].any():
        return
    turn = pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), xyz), np.zeros(3))
    child, origin = joint.find("child"), joint.find("origin")
    place = _pose(origin, f" of joint {label!r}") * turn
    between = ElementTree.SubElement(root, "link", {"name": f"{label} across"})
    back = ElementTree.SubElement(root, "joint", {"name": f"{label} back", "type": "fixed"})
    ElementTree.SubElement(back, "parent", {"link": between.attrib["name"]})
    ElementTree.SubElement(back, "child", {"link": "" if child is None else child.get("link", "")})
    for element, pose in ((joint, place), (back, turn.inverse())):
        for old in element.findall("origin"):
            element.remove(old)
        rpy = pin.rpy.matrixToRpy(pose.rotation)
        ElementTree.SubElement(element, "origin", {"xyz": text_of(pose.translation), "rpy": text_of(rpy)})
    for old in joint.findall("child"):
        old.set("link", between.attrib["name"])


def _flaws(link: Element) -> Iterator[str]:
    """Yield in words why no body can have the inertia of a link."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    where = f"link {link.get('name')!r}"
    mass, inertia = (Element(tag) if (e := inertial.find(tag)) is None else e for tag in ("mass", "inertia"))
    check_mass(scalar(mass.get("value"), None, f"mass of {where}"), where)
    xx, yy, zz, xy, xz, yz = (
        scalar(inertia.get(f"i{axes}"), None, f"i{axes} of {where}") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")
    )
    _pose(inertial.find("origin"), f" of <inertial> of {where}")  # urdfdom drops the mass with a wrong origin
    if fault := flaw(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), where):
        yield fault


def _pose(origin: Element | None, of: str = "") -> Any:
    """Return the SE3 of an <origin>: xyz, and rpy about fixed axes."""
    if origin is None:
        return pin.SE3.Identity()
    rpy = numbers(origin.get("rpy"), 3, (0, 0, 0), f"rpy{of}")
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), numbers(origin.get("xyz"), 3, (0, 0, 0), f"xyz{of}"))


def _visual(
    body: str, visual: Element, model: Any, folders: Sequence[Path], colours: Mapping[str | None, Element]
) -> Visual:
    """Return the visual shape of a body; ValueError for a shape that is not read."""
    frame = model.frames[model.getFrameId(body, pin.FrameType.BODY)]
    shape, shift = _shape(visual.find("geometry"), folders, shown=True)
    placement = frame.placement * _pose(visual.find("origin")) * pin.SE3(np.eye(3), shift)
    return Visual(body, int(frame.parentJoint), placement, shape, _colour(visual.find("material"), colours))


def _colour(material: Element | None, known: Mapping[str | None, Element]) -> Colour | None:
    """Return the colour of a <material>: its own, or the colour of the material that it names."""
    if material is None:
        return None
    colour = material.find("color")
    if colour is None:
        colour = known.get(material.get("name"), material).find("color")
    return None if colour is None else colour_of(colour.get("rgba", ""), 4, "rgba of <color>")


def _shape(geometry: Element | None, folders: Sequence[Path], shown: bool = False) -> tuple[Any, Array]:
    """Return (shape, its origin) of a <geometry>, as `shape_of`; URDF has fewer shapes."""
    elements = [] if geometry is None else list(geometry)
    odd = [e.tag for e in elements if e.tag not in ("box", "sphere", "cylinder", "capsule", "mesh")]
    if odd or (found := shape_of(geometry, Element.get, folders, shown)) is None:
        raise ValueError(f"<{odd[0]}> is no shape of a URDF")
    return found
