"""Readers of robot files: each turns one into a `Description` and tells what it left out."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from nsdyn import shapes
from nsdyn.articulations import Description, Link, describe_model
from nsdyn.shapes import Shape

Array = NDArray[np.float64]

__all__ = ["read_model", "read_urdf"]


class _Notes(list[str]):
    """What a reader leaves out, in words."""

    @contextmanager
    def of_warnings(self, where: str) -> Iterator[None]:
        """Note the warnings given inside instead of showing them one by one."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
        self += [f"{where}: {w.message}" for w in caught]

    def count(self, elements: Iterable[Element], used: set[str], where: str) -> None:  # type: ignore[override]
        """Note the children of `elements` whose tag is not `used`."""
        found = Counter(child.tag for element in elements for child in element if child.tag not in used)
        self += [f"{where}: <{tag}> ({n})" for tag, n in sorted(found.items())]


# -- hand-made models ------------------------------------------------------------------------------------------


def read_model(name: str, model: Any, geometry: Any | None) -> Description:
    """Description of a pinocchio.Model made by hand and its collision shapes, a pinocchio.GeometryModel or None."""
    if not isinstance(model, pin.Model):
        raise ValueError(f"model of {name!r} must be a pinocchio.Model, got {type(model).__name__}")
    if geometry is not None and not isinstance(geometry, pin.GeometryModel):
        raise ValueError(
            f"geometry_model of {name!r} must be a pinocchio.GeometryModel or None, got {type(geometry).__name__}"
        )
    dropped = _Notes()
    links, bodies = _links(model, geometry.geometryObjects if geometry else (), dropped)
    return describe_model(model, links, bodies, dropped=tuple(dropped))


def _links(model: Any, objects: Iterable[Any], dropped: _Notes) -> tuple[list[Link], list[str]]:
    """(links, the bodies they belong to) of Pinocchio's geometry objects."""
    links, bodies = [], []
    for g in objects:
        joint = int(g.parentJoint)
        with dropped.of_warnings(g.name):
            shape, shift = shapes.from_coal(g.geometry)
        links.append(Link(g.name, joint, g.placement * pin.SE3(np.eye(3), shift), shape))
        # Objects made by hand often name no frame: then the joint stands for the body.
        bodies.append(model.frames[g.parentFrame].name if g.parentFrame < model.nframes else model.names[joint])
    return links, bodies


# -- XML -------------------------------------------------------------------------------------------------------


def _parse(name: str, path: Path, kind: str) -> Element:
    """Root of an XML file."""
    if not path.is_file():
        raise ValueError(f"path of {name!r} must be a {kind} file, got {str(path)!r}")
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError) as failure:
        raise ValueError(f"path of {name!r}: {path} could not be read: {failure}") from None


def _numbers(text: str | None, count: int, default: Sequence[float] | None, what: str) -> Array:
    """`count` numbers of a text; `default` where there is none."""
    if text is None:
        if default is None:
            raise ValueError(f"{what} is missing")
        return np.array(default, dtype=float)
    try:
        out = np.array(text.split(), dtype=float)
    except ValueError:
        out = np.empty(0)
    if out.shape != (count,) or not np.isfinite(out).all():
        raise ValueError(f"{what} must be {'a number' if count == 1 else f'{count} numbers'}, got {text!r}")
    return out


def _mesh_file(uri: str, folders: Sequence[Path]) -> Path:
    """File of ``package://package/rest``, ``model://...``, ``file://...`` or a path, looked up in `folders`."""
    scheme, _, rest = uri.rpartition("://")
    tried = [Path(rest)] if scheme == "file" else [folder / rest for folder in folders]
    if scheme in ("package", "model"):
        package, _, inner = rest.partition("/")
        tried += [folder / inner for folder in folders if folder.name == package]
    for path in tried:
        if path.is_file():
            return path
    raise ValueError(f"mesh {uri!r} was not found in {', '.join(map(str, folders))}; give its folder in package_dirs")


# -- URDF ------------------------------------------------------------------------------------------------------


def read_urdf(name: str, path: Path, base: str, package_dirs: Sequence[Path]) -> Description:
    """Description of a URDF file.

    Pinocchio reads links, inertias and joints. The collision shapes are read here: urdfdom, which Pinocchio uses, knows
    no capsules and drops all shapes of a link that has one.
    """
    if base not in ("fixed", "free"):
        raise ValueError(f"base of {name!r} must be 'fixed' or 'free', got {base!r}")
    root = _parse(name, path, "URDF")
    if root.tag != "robot":
        raise ValueError(f"path of {name!r}: {path} could not be read: its root is <{root.tag}>, not <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise ValueError(f"path of {name!r}: {path} could not be read: it has xacro macros; expand them first")
    dropped, unused = _Notes(), _Notes()
    elements, joints = list(root.iter("link")), [e for e in root if e.tag == "joint"]
    dropped += [
        f"joint {e.get('name')!r}: <mimic> of {m.get('joint')!r}, it moves on its own"
        for e in joints
        for m in e.iter("mimic")
    ]
    if any(e.get("effort") or e.get("velocity") for joint in joints for e in joint.iter("limit")):
        unused.append("joint: effort and velocity of <limit>")
    unused.count([root], {"link", "joint"}, "robot")
    unused.count(elements, {"inertial", "collision"}, "link")
    unused.count(joints, {"parent", "child", "origin", "axis", "limit", "dynamics", "mimic"}, "joint")
    collisions = [(e.get("name", ""), c) for e in elements for c in e.findall("collision")]
    unused.count([c for _, c in collisions], {"origin", "geometry"}, "collision")
    for element in elements:
        for child in [c for c in element if c.tag != "inertial"]:
            element.remove(child)
    try:
        root_joint = (pin.JointModelFreeFlyer(),) if base == "free" else ()
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"), *root_joint)
    except (ValueError, RuntimeError) as failure:
        raise ValueError(f"path of {name!r}: {path} could not be read: {failure}") from None
    links: list[Link] = []
    bodies: list[str] = []
    for body, collision in collisions:
        frame = model.frames[model.getFrameId(body, pin.FrameType.BODY)]
        link = f"{body}_{bodies.count(body)}"
        try:
            with dropped.of_warnings(link):
                shape, shift = _urdf_shape(collision.find("geometry"), [path.parent, *package_dirs])
            placement = frame.placement * _urdf_pose(collision.find("origin")) * pin.SE3(np.eye(3), shift)
        except ValueError as failure:
            raise ValueError(f"path of {name!r}: {path}, collision of {body!r}: {failure}") from None
        links.append(Link(link, int(frame.parentJoint), placement, shape))
        bodies.append(body)
    return describe_model(model, links, bodies, dropped=tuple(dropped), unused=tuple(unused))


def _urdf_pose(origin: Element | None) -> Any:
    """SE3 of an <origin>: xyz, and rpy about fixed axes."""
    if origin is None:
        return pin.SE3.Identity()
    rpy = _numbers(origin.get("rpy"), 3, (0, 0, 0), "rpy")
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), _numbers(origin.get("xyz"), 3, (0, 0, 0), "xyz"))


def _urdf_shape(geometry: Element | None, folders: Sequence[Path]) -> tuple[Shape, Array]:
    """(shape, its origin) of a <geometry>."""
    if geometry is None or len(geometry) != 1:
        raise ValueError("<geometry> must hold one shape")
    (shape,), origin = geometry, np.zeros(3)

    def length(attribute: str) -> float:
        return float(_numbers(shape.get(attribute), 1, None, f"{attribute} of <{shape.tag}>")[0])

    match shape.tag:
        case "box":
            return shapes.box(_numbers(shape.get("size"), 3, None, "size of <box>")), origin
        case "sphere":
            return shapes.sphere(length("radius")), origin
        case "cylinder":
            return shapes.cylinder(length("radius"), length("length")), origin
        case "capsule":
            return shapes.capsule(length("radius"), length("length")), origin
        case "mesh":
            scale = _numbers(shape.get("scale"), 3, (1, 1, 1), "scale of <mesh>")
            return shapes.mesh(_mesh_file(shape.get("filename", ""), folders), scale)
        case tag:
            raise ValueError(f"<{tag}> is no shape of a URDF")
