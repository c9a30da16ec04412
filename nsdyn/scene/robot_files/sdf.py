"""SDF, the format of Gazebo, read without Pinocchio, whose packages come without SDFormat.

A link with several parents closes a loop. The reader cuts the link into equal parts, one per parent, and a `Loop` welds
them together. Every joint of the file is then a joint of the tree, with its limits, springs and friction.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.articulations import Description, Link, Loop, describe_model
from nsdyn.scene.gears import Gear, following, gear, joints_of
from nsdyn.scene.materials import Material
from nsdyn.scene.robot_files.elements import changes_nothing, tell
from nsdyn.scene.robot_files.geometries import colour_of, shape_of
from nsdyn.scene.robot_files.inertias import check_mass, flaw
from nsdyn.scene.robot_files.sdf_elements import TABLE
from nsdyn.scene.robot_files.sdf_frames import AXES, Frames, Joint, is_true
from nsdyn.scene.robot_files.xml import Report, is_limit, numbers, parse, scalar
from nsdyn.scene.visuals import Visual
from nsdyn.tools import noise
from nsdyn.tools.naming import choice

FRICTION = "surface/friction/ode"
"""Path of the coefficients of friction in a <collision>."""


def read_sdf(name: str, path: Path, package_dirs: Sequence[Path]) -> Description:
    """Read an SDF file with one model; a base that no joint holds is free, unless the model is static."""
    root = parse(name, path, "SDF", "sdf")
    try:
        found = [*root.findall("model"), *root.findall("world/model")]
        if len(found) != 1:
            raise ValueError(f"it must hold one model, got {[m.get('name') for m in found]}")
        # Up to SDF 1.4 axes were in the frame of the model, as its converter to later versions says.
        old = re.match(r"\s*1\.[0-4]\b", root.get("version", "")) is not None
        reader = _Reader(found[0], [path.parent, *package_dirs], old)
        for gravity in root.iterfind("world/gravity"):  # the scene's is used; 9.8 is SDF's default
            if np.abs(numbers(gravity.text, 3, None, "<gravity>") - (0.0, 0.0, -9.81)).max() > 0.02:
                reader.report.dropped.append("world: <gravity>")
        tell([root], TABLE, reader.report)
        return reader.description()
    except ValueError as failure:
        raise ValueError(f"path of {name!r}: {path} could not be read: {noise.told(failure, [])}") from None


class _Reader:
    """Builds a Pinocchio model from the elements of an SDF model."""

    def __init__(self, element: Element, folders: Sequence[Path], axes_in_model: bool) -> None:
        self.element, self.folders = element, folders
        self.report = Report()
        self.static = is_true(element.findtext("static"))  # if so, all of it is fixed, with any joints
        self.flaws: list[str] = []
        for tag in ("model", "include"):
            if element.find(tag) is not None:
                raise ValueError(f"a <{tag}> inside the model is not read: write it out")
        self.frames = Frames(element, axes_in_model)
        self.links = self.frames.links
        if not self.links:
            raise ValueError("it has no <link>")
        for tag in ("link", "joint"):
            (name, count), *_ = [*Counter(e.get("name", "") for e in element.findall(tag)).most_common(1), ("", 0)]
            if count > 1:
                raise ValueError(f"{tag} {name!r} must have a name of its own")
        joints = element.findall("joint")
        self.joints = [self.frames.joint(e) for e in joints]
        self._note_unused(joints)
        self.model = pin.Model()
        self.at = {0: pin.SE3.Identity()}  # joint -> pose of its frame in the world at zero configuration
        self.base = [np.empty(0)]  # initial q, joint by joint
        self.values: list[tuple[float, ...]] = []  # per coordinate, as `Frames.values_of` returns them
        self.where: dict[str, int] = {}  # link -> its joint of the model
        self.loops: list[Loop] = []
        self.parts = Counter(j.child for j in self.joints)
        self.shapes: list[Link] = []
        self.visuals: list[Visual] = []

    def _note_unused(self, joints: Sequence[Element]) -> None:
        missing, dropped = self.report.missing, self.report.dropped
        fast = [e.get("name") for e in joints for v in e.iterfind("*/limit/velocity") if is_limit(v.text)]
        if fast:
            dropped.append(f"joint {fast[0]!r}: velocity of <limit> ({len(fast)})")
        missing += [
            f"joint {e.get('name')!r}: <{tag}> of a {e.get('type')} joint"
            for e in joints
            for tag in ("axis", "axis2")
            if e.get("type") != "fixed" and e.find(tag) is not None and tag not in AXES.get(e.get("type", ""), ())
        ]
        inertials = [(link, e) for link, element in self.links.items() for e in element.findall("inertial")]
        missing += [f"link {link!r}: automatic inertia" for link, e in inertials if is_true(e.get("auto"))]
        dropped += [
            f"collision {c.get('name')!r}: friction across that is not that along"
            for c in self.element.iter("collision")
            if (across := c.findtext(f"{FRICTION}/mu2")) is not None
            and not changes_nothing(across, c.findtext(f"{FRICTION}/mu", "1"))
        ]

    # -- the tree --------------------------------------------------------------------------------------------

    def description(self) -> Description:
        """Build the model and describe it."""
        for link in self.links:
            if link not in self.parts:
                self._hang(link, 0 if self.static else self._free(link))
                self._descend(link)
        self._descend("world")
        lost = [link for link in self.links if link not in self.where]
        if lost:
            raise ValueError(f"links {lost} hang on each other in a circle that no base holds")
        model = self.model
        lower, upper, damping, friction, stiffness, rest, effort = np.array(self.values).reshape(-1, 7).T
        model.upperEffortLimit = effort
        q = np.concatenate(self.base)
        for which, limit in (("lowerPositionLimit", lower), ("upperPositionLimit", upper)):
            values = np.array(getattr(model, which))
            for joint in joints_of(model):
                if joint.plain:
                    values[joint.q] = limit[joint.v]
            setattr(model, which, values)
        model.damping, model.lowerDryFrictionLimit, model.upperDryFrictionLimit = damping, -friction, friction
        apart: frozenset[frozenset[str]] = frozenset()
        if not is_true(self.element.findtext("self_collide")):
            apart = frozenset(frozenset(pair) for pair in combinations(self.links, 2))
        return describe_model(
            model,
            self.shapes,
            q=following(model, gears := tuple(self._gears()), q),
            stiffness=stiffness,
            rest=rest,
            loops=tuple(self.loops),
            gears=gears,
            excluded=apart,
            flaws=tuple(self.flaws),
            visuals=tuple(self.visuals),
            **self.report.told(),
        )

    def _gears(self) -> Iterator[Gear]:
        """Yield the gears of <mimic>: offset + multiplier * (position of the other joint - reference)."""
        moving = [] if self.static else self.joints
        for joint, k, tag in ((j, k, tag) for j in moving for k, tag in enumerate(AXES[j.kind])):
            for mimic in joint.element.iterfind(f"{tag}/mimic"):
                label, pair = f"mimic of {joint.name!r}", (mimic.get("joint", ""), joint.name)
                ratio, offset, zero = (
                    scalar(mimic.findtext(what), default, f"{what} of {label}")
                    for what, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
                )
                word = choice(mimic.get("axis", "axis"), ("axis", "axis2"), f"axis of {label}")
                which = int(word == "axis2"), k
                yield gear(self.model, label, pair, ratio, offset - ratio * zero, which)

    def _descend(self, parent: str) -> None:
        """Add the joints below a link, and below their children."""
        for joint in self.joints:
            if joint.parent != parent:
                continue
            index = self._add(joint)
            if joint.child in self.where:
                self._close(joint, index)
            else:
                self._hang(joint.child, index)
                self._descend(joint.child)

    def _free(self, link: str) -> int:
        index = self._add_joint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"{link}_free")
        pose = self.frames.pose_of(link)
        self.base.append(np.array(pin.SE3ToXYZQUAT(pose)))
        self.values += [(-np.inf, np.inf, 0.0, 0.0, 0.0, 0.0, np.inf)] * 6
        self.at[index] = pose
        return index

    def _add_joint(self, parent: int, kind: Any, placement: Any, name: str) -> int:
        index = int(self.model.addJoint(parent, kind, placement, name))
        self.model.addJointFrame(index)
        return index

    def _add(self, joint: Joint) -> int:
        """Add a joint and return the joint of the model that carries the child; for a fixed joint, the parent's."""
        parent = 0 if joint.parent == "world" else self.where[joint.parent]
        if joint.kind == "fixed" or self.static:
            return parent
        axes = [self.frames.axis(joint, tag) for tag in AXES[joint.kind]]
        if joint.kind == "ball":
            kind = pin.JointModelSpherical()
            self.base.append(np.array([0.0, 0.0, 0.0, 1.0]))
            self.values += [(-np.inf, np.inf, 0.0, 0.0, 0.0, 0.0, np.inf)] * 3
        else:
            prismatic = joint.kind == "prismatic"
            kinds = [
                (pin.JointModelPrismaticUnaligned if prismatic else pin.JointModelRevoluteUnaligned)(a) for a in axes
            ]
            kind = kinds[0]
            if len(kinds) > 1:
                kind = pin.JointModelComposite(kinds[0])
                kind.addJoint(kinds[1])
            self.base.append(np.zeros(len(axes)))
            self.values += [self.frames.values_of(joint, tag) for tag in AXES[joint.kind]]
        index = self._add_joint(parent, kind, self.at[parent].actInv(joint.pose), joint.name)
        self.at[index] = joint.pose
        return index

    # -- bodies ------------------------------------------------------------------------------------------------

    def _hang(self, link: str, joint: int) -> None:
        """Attach a link to a joint: its frame, the part of its mass that the joint carries, its shapes."""
        self.where[link] = joint
        element, pose = self.links[link], self.at[joint].actInv(self.frames.pose_of(link))
        self.model.addFrame(pin.Frame(link, joint, 0, pose, pin.FrameType.BODY))
        self._add_mass(link, joint)
        for number, collision in enumerate(element.findall("collision")):
            label = f"{link}_{number}"
            with self.report.dropped.of_warnings(label):
                found = shape_of(collision.find("geometry"), Element.findtext, self.folders)
            if found is None and collision.find("geometry/empty") is not None:
                continue
            if found is None:
                self.report.missing.append(f"collision {collision.get('name')!r} of link {link!r}: its shape")
                continue
            shape, shift = found
            placement = pose * self.frames.pose_in(link, collision.find("pose")) * pin.SE3(np.eye(3), shift)
            mu = scalar(collision.findtext(f"{FRICTION}/mu"), Material().mu, f"mu of link {link!r}")
            self.shapes.append(Link(label, link, joint, placement, shape, Material(mu)))
        for visual in element.findall("visual"):
            try:
                self.visuals += self._visual(link, joint, pose, visual)
            except ValueError as failure:
                self.report.unused.append(f"visual of link {link!r}: {failure}")

    def _visual(self, link: str, joint: int, pose: Any, visual: Element) -> Iterator[Visual]:
        """Yield the visual shape of a link, if it is bounded; ValueError for a shape that is not read."""
        paint = visual.findtext("material/diffuse", visual.findtext("material/ambient"))
        colour = None if paint is None else colour_of(paint, None, "colour")
        found = shape_of(visual.find("geometry"), Element.findtext, self.folders, shown=True)
        if found is None or visual.find("geometry/plane") is not None:
            return
        shape, shift = found
        placement = pose * self.frames.pose_in(link, visual.find("pose")) * pin.SE3(np.eye(3), shift)
        yield Visual(link, joint, placement, shape, colour)

    def _close(self, joint: Joint, index: int) -> None:
        """Weld the part of a link that another parent carries to the link."""
        self._add_mass(joint.child, index)
        pose, own = self.frames.pose_of(joint.child), self.where[joint.child]
        if own == index:  # both joints are fixed
            return
        placements = self.at[own].actInv(pose), self.at[index].actInv(pose)
        self.loops.append(Loop(joint.name, own, placements[0], index, placements[1], "frame"))

    def _add_mass(self, link: str, joint: int) -> None:
        """Add the mass of a link, divided by the number of joints that carry it."""
        element = self.links[link].find("inertial")
        part = 1.0 / max(1, self.parts[link])

        def value(where: str, default: float) -> float:
            text = None if element is None else element.findtext(where)
            return scalar(text, default, f"{where} of link {link!r}")

        xx, yy, zz = (value(f"inertia/i{a}", 1.0) for a in ("xx", "yy", "zz"))
        xy, xz, yz = (value(f"inertia/i{a}", 0.0) for a in ("xy", "xz", "yz"))
        inertia = part * np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        centre = self.frames.pose_of(link) * self.frames.pose_in(
            link, None if element is None else element.find("pose")
        )
        mass = check_mass(value("mass", 1.0), f"link {link!r}")
        if fault := flaw(inertia, f"link {link!r}"):
            self.flaws.append(fault)
        body = pin.Inertia.Zero()  # its constructor refuses what is told as a flaw
        body.mass, body.inertia = part * mass, inertia
        self.model.appendBodyToJoint(joint, body, self.at[joint].actInv(centre))
