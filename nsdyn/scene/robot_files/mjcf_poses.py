"""Orientations of an MJCF file as quaternions: Pinocchio misreads some of the other forms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.robot_files.xml import numbers
from nsdyn.tools.arrays import Array

__all__ = ["write_quaternions"]


def write_quaternions(root: Element) -> None:
    """Replace euler and axisangle by quaternions, in the unit and order that the compiler has."""
    settings: Mapping[str, str] = root.attrib if (compiler := root.find("compiler")) is None else compiler.attrib
    unit = 1.0 if settings.get("angle", "degree") == "radian" else math.pi / 180.0
    order = settings.get("eulerseq", "xyz")
    if len(order) != 3 or set(order.lower()) - set("xyz"):
        raise ValueError(f"eulerseq must be three of x, y, z, X, Y, Z, got {order!r}")
    for element in root.iter():
        label = f"of <{element.tag}> {element.get('name', '')!r}"
        if "euler" in element.attrib:
            turn = _euler(unit * numbers(element.attrib.pop("euler"), 3, None, f"euler {label}"), order)
        elif "axisangle" in element.attrib:
            given = numbers(element.attrib.pop("axisangle"), 4, None, f"axisangle {label}")
            if not given[:3].any():
                raise ValueError(f"axisangle {label} must have an axis that is not zero")
            turn = _about(given[:3] / np.linalg.norm(given[:3]), unit * given[3])
        else:
            continue
        w, x, y, z = np.roll(pin.Quaternion(turn).coeffs(), 1).tolist()
        element.set("quat", f"{w!r} {x!r} {y!r} {z!r}")


def _about(axis: Array, angle: float) -> Array:
    out: Array = pin.AngleAxis(angle, axis).toRotationMatrix()
    return out


def _euler(angles: Array, order: str) -> Array:
    """Return the rotation by angles about axes that move with the body (small letters) or stay (capital letters)."""
    out: Array = np.eye(3)
    for letter, angle in zip(order, angles, strict=True):
        turn = _about(np.eye(3)["xyz".index(letter.lower())], angle)
        out = out @ turn if letter.islower() else turn @ out
    return out
