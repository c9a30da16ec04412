"""Frames and joints of an SDF model: their poses, and the values of joint axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.robot_files.xml import UNLIMITED, numbers, scalar
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

AXES = {
    "fixed": (),
    "ball": (),
    "revolute": ("axis",),
    "continuous": ("axis",),
    "prismatic": ("axis",),
    "universal": ("axis", "axis2"),
    "revolute2": ("axis", "axis2"),
}
"""Axes of the joint types that are read."""

FORMATS = "euler_rpy", "quat_xyzw"

DYNAMICS = "damping", "friction", "spring_stiffness", "spring_reference"


@dataclass(frozen=True)
class Joint:
    """A joint of the file; its pose is the pose of its frame in the world at zero configuration."""

    name: str
    kind: str
    parent: str
    child: str
    pose: Any
    element: Element


class Frames:
    """Links, joints and frames of a model, by their names; in old files the model's frame has the axes of joints."""

    def __init__(self, element: Element, axes_in_model: bool) -> None:
        self._element, self._axes_in_model = element, axes_in_model
        self.links = {e.get("name", ""): e for e in element.findall("link")}
        self._frames = self.links | {
            e.get("name", ""): e for e in [*element.findall("joint"), *element.findall("frame")]
        }

    def pose_of(self, name: str, seen: tuple[str, ...] = ()) -> Any:
        """Return the pose in the world of a link, joint, frame, the model ("__model__") or "world"."""
        if name == "world":
            return pin.SE3.Identity()
        if name in ("__model__", ""):
            return read_pose(self._element.find("pose"))
        if name not in self._frames or name in seen:
            raise ValueError(
                f"frame {name!r} is not defined" if name not in seen else f"frame {name!r} hangs on itself"
            )
        element = self._frames[name]
        pose = element.find("pose")
        default = {"joint": element.findtext("child", ""), "frame": element.get("attached_to", "")}.get(element.tag, "")
        relative_to = (None if pose is None else pose.get("relative_to")) or default
        return self.pose_of(relative_to, (*seen, name)) * read_pose(pose)

    def pose_in(self, link: str, pose: Element | None) -> Any:
        """Return the pose in a link of an element of the link; `pose` may be relative to any frame."""
        frame = "" if pose is None else pose.get("relative_to", "")
        return (self.pose_of(link).actInv(self.pose_of(frame)) if frame else pin.SE3.Identity()) * read_pose(pose)

    def joint(self, element: Element) -> Joint:
        """Read a <joint>; ValueError for a type that is not read, and for a joint without a link."""
        name, kind = element.get("name", ""), element.get("type", "")
        if kind not in AXES:
            raise ValueError(f"joint {name!r} is of type {kind!r}; read are {sorted(AXES)}")
        parent, child = (self._link_of(element.findtext(end, ""), name) for end in ("parent", "child"))
        if child == "world":
            raise ValueError(f"joint {name!r} has the world for a child")
        return Joint(name, kind, parent, child, self.pose_of(name), element)

    def _link_of(self, frame: str, joint: str) -> str:
        """Return the link to which a frame named by a joint is attached."""
        for _ in range(len(self._frames) + 1):
            if frame == "world" or frame in self.links:
                return frame
            element = self._frames.get(frame)
            if element is None or element.tag != "frame":
                break
            frame = element.get("attached_to", "")
        raise ValueError(f"joint {joint!r} names {frame!r}, which is no link")

    def axis(self, joint: Joint, tag: str) -> Array:
        """Return an axis of a joint in the frame of the joint."""
        axis = joint.element.find(f"{tag}/xyz")
        text, frame = (None, None) if axis is None else (axis.text, axis.get("expressed_in"))
        xyz = numbers(text, 3, (0, 0, 1), f"{tag} of joint {joint.name!r}")
        if self._axes_in_model or is_true(joint.element.findtext(f"{tag}/use_parent_model_frame")):
            frame = "__model__"
        if frame:
            xyz = joint.pose.rotation.T @ self.pose_of(frame).rotation @ xyz
        if not xyz.any():
            raise ValueError(f"{tag} of joint {joint.name!r} must not be zero")
        return xyz / np.linalg.norm(xyz)

    @staticmethod
    def values_of(joint: Joint, tag: str) -> tuple[float, ...]:
        """Return (lower, upper, damping, friction, stiffness, rest, effort) of an axis."""
        axis = joint.element.find(tag)

        def value(where: str, default: float) -> float:
            text = None if axis is None else axis.findtext(where)
            try:
                if abs(float(text or "")) >= UNLIMITED:
                    return float(np.copysign(np.inf, float(text or "")))
            except ValueError:  # `numbers` raises below
                pass
            return scalar(text, default, f"{where} of joint {joint.name!r}")

        limits = (-np.inf, np.inf)
        if joint.kind != "continuous":
            limits = value("limit/lower", -np.inf), value("limit/upper", np.inf)
        return (*limits, *(value(f"dynamics/{what}", 0.0) for what in DYNAMICS), value("limit/effort", np.inf))


def is_true(text: str | None) -> bool:
    """Whether the text of an element is true; ValueError for words that SDF does not have."""
    word = (text or "false").strip().lower()
    if word not in ("true", "1", "false", "0"):
        raise ValueError(f"<static>, <self_collide> and their like must be true or false, got {text!r}")
    return word in ("true", "1")


def read_pose(element: Element | None) -> Any:
    """Return the SE3 of a <pose>: x y z and roll pitch yaw, or a quaternion x y z w."""
    if element is None or element.text is None:
        return pin.SE3.Identity()
    if choice(element.get("rotation_format", "euler_rpy"), FORMATS, "rotation_format of <pose>") == "quat_xyzw":
        values = numbers(element.text, 7, None, "<pose>")
        if not values[3:].any():
            raise ValueError(f"<pose> must have a quaternion that is not zero, got {element.text!r}")
        return pin.XYZQUATToSE3(np.r_[values[:3], values[3:] / np.linalg.norm(values[3:])])
    values = numbers(element.text, 6, None, "<pose>")
    unit = np.pi / 180.0 if is_true(element.get("degrees")) else 1.0
    return pin.SE3(pin.rpy.rpyToMatrix(unit * values[3:]), values[:3])
