"""Equalities of an MJCF file: loops of points and frames, gears of joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.articulations import WORLD, Loop
from nsdyn.scene.gears import Gear
from nsdyn.scene.robot_files.xml import Notes, numbers
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice


def loops_of(root: Element, model: Any, q: Array, missing: Notes) -> Iterator[Loop]:
    """Yield the loops of <connect> and <weld>; if the file gives no second point, they are closed at q."""
    frames = {f.name: f for f in model.frames if f.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME)}
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    for number, element in enumerate(root.iterfind("equality/*")):
        label = element.get("name", f"{element.tag}{number}")
        if element.get("active", "true") == "false":
            continue
        if element.tag not in ("connect", "weld", "joint"):
            missing.append(f"equality {label!r} of type {element.tag!r}")
        if element.tag not in ("connect", "weld"):
            continue
        names = [element.get(f"{what}{k}") for what in ("site", "body") for k in (1, 2)]
        sites = names[0] is not None
        first, second = (frames.get(n or WORLD) for n in (names[:2] if sites else names[2:]))
        if first is None or second is None or (names[0] is None) != (names[1] is None):
            raise ValueError(f"equality {label!r} joins {names}, which are not both bodies or sites of the file")
        if first is second:
            raise ValueError(f"equality {label!r} must join two bodies or sites, got {first.name!r} twice")
        joint1, joint2 = int(first.parentJoint), int(second.parentJoint)
        placement1, placement2 = first.placement.copy(), second.placement.copy()
        pose = numbers(element.get("relpose"), 7, (0, 0, 0, 0, 0, 0, 0), f"relpose of {label!r}")
        if element.tag == "connect" and not sites:
            anchor = numbers(element.get("anchor"), 3, None, f"anchor of {label!r}")
            placement1 = placement1 * pin.SE3(np.eye(3), anchor)
        elif pose[3:].any():
            placement1 = placement1 * pin.XYZQUATToSE3(
                np.r_[pose[:3], np.roll(pose[3:], -1) / np.linalg.norm(pose[3:])]
            )
            # The point is the anchor, fixed in the second body; `relpose` gives its place in the first.
            anchor = numbers(element.get("anchor"), 3, (0, 0, 0), f"anchor of {label!r}")
            placement2 = placement2 * pin.SE3(np.eye(3), anchor)
        if not sites and not pose[3:].any():
            placement2 = data.oMi[joint2].actInv(data.oMi[joint1] * placement1)
        yield Loop(label, joint1, placement1, joint2, placement2, "point" if element.tag == "connect" else "frame")


def gears_of(root: Element, model: Any, places: Mapping[str, tuple[int, int]], missing: Notes) -> Iterator[Gear]:
    """Yield the gears of linear equalities of joints; a joint without a second one is held at the given value.

    Equalities relate the deviations of joints from their initial values in the file. `places` are the indices of hinges
    and slides in q and v.
    """
    zero = model.referenceConfigurations["qpos0"]
    for element in root.iterfind("equality/joint"):
        given = element.get("joint1", "")
        label = element.get("name", given)
        if element.get("active", "true") == "false":
            continue
        q2, v2 = places[choice(given, places, f"joint1 of equality {label!r}")]
        q1, v1 = places[choice(element.get("joint2", given), places, f"joint2 of equality {label!r}")]
        if element.get("joint2") == given:
            raise ValueError(f"joint2 of equality {label!r} must be another than joint1, got {given!r}")
        polynomial = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
        terms = numbers(element.get("polycoef"), None, (), f"polycoef of equality {label!r}")
        if terms.size > polynomial.size:
            raise ValueError(f"polycoef of equality {label!r} must be at most 5 numbers, got {terms.size}")
        polynomial[: terms.size] = terms
        if "joint2" not in element.attrib:
            polynomial[1:] = 0.0
        if polynomial[2:].any():
            missing.append(f"equality {label!r}: polycoef of degree {int(np.flatnonzero(polynomial)[-1])}, not linear")
            continue
        ratio = float(polynomial[1])
        yield Gear(label, v1, v2, ratio, float(zero[q2] + polynomial[0] - ratio * zero[q1]))
