"""Orientations of an MJCF file as quaternions: Pinocchio misreads some of the other forms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from nsdyn.scene.robot_files.xml import numbers, text_of
from nsdyn.tools.arrays import Array

COUNTS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}
"""How many numbers each form of an orientation has."""

SHORTEST = 1e-14
"""Length below which MuJoCo takes a vector for no direction; round-off of two parallel unit vectors is below it."""

PARALLEL = 1e-14
"""1 - |cosine| of the angle to the z axis up to which MuJoCo takes a direction for parallel to it."""


def write_quaternions(root: Element) -> None:
    """Replace all forms of orientations by quaternions, in the unit and order that the compiler has."""
    settings: Mapping[str, str] = getattr(root.find("compiler"), "attrib", {})
    unit = 1.0 if settings.get("angle", "degree") == "radian" else math.pi / 180.0
    order = settings.get("eulerseq", "xyz")
    if len(order) != 3 or set(order.lower()) - set("xyz"):
        raise ValueError(f"eulerseq must be three of x, y, z, X, Y, Z, got {order!r}")
    for element in root.iter():
        given = sorted(COUNTS.keys() & element.attrib.keys())
        if element.tag == "inertial" and "fullinertia" in element.attrib:
            given.append("fullinertia")
        of = f"of <{element.tag}> {element.get('name', '')!r}"
        if len(given) > 1:
            raise ValueError(f"orientation {of} must be given once, got {' and '.join(given)}")
        for form in COUNTS.keys() & given:
            turn = _read(form, element.attrib.pop(form), f"{form} {of}", unit, order)
            element.set("quat", text_of(turn))


def _read(form: str, text: str, label: str, unit: float, order: str) -> Array:
    """Return the quaternion w x y z of an orientation that is given in some form."""
    values = numbers(text, COUNTS[form], None, label)

    def direction(vector: Array) -> Array:
        length = float(np.linalg.norm(vector))
        if length < SHORTEST:
            raise ValueError(f"{label} must give an orientation, got {text!r}")
        return vector / length

    match form:
        case "euler":
            return quaternion(_euler(unit * values, order))
        case "axisangle":
            return quaternion(_about(direction(values[:3]), unit * values[3]))
        case "zaxis":
            return along(direction(values))
        case "xyaxes":
            x, y = direction(values[:3]), direction(values[3:])
            y = direction(y - x * (x @ y))
            return quaternion(np.column_stack((x, y, np.cross(x, y))))
        case _:
            return direction(values)


def along(z: Array) -> Array:
    """Return the quaternion w x y z of the shortest turn from the z axis to a unit vector, about x if parallel."""
    x, y, sine = -z[1], z[0], math.hypot(z[0], z[1])
    if 1.0 - abs(z[2]) <= PARALLEL:
        x, y, sine = 1.0, 0.0, 0.0
    angle = 0.5 * math.atan2(sine, z[2])
    scale = math.sin(angle) / math.hypot(x, y)
    return np.array([math.cos(angle), scale * x, scale * y, 0.0])


def quaternion(turn: Array) -> Array:
    """Return the quaternion w x y z of a rotation matrix."""
    return np.roll(pin.Quaternion(turn).coeffs(), 1)


def _about(axis: Array, angle: float) -> Array:
    return pin.AngleAxis(angle, axis).toRotationMatrix()


def _euler(angles: Array, order: str) -> Array:
    """Return the rotation by angles about axes that move with the body (small letters) or stay (capital letters)."""
    out: Array = np.eye(3)
    for letter, angle in zip(order, angles, strict=True):
        turn = _about(np.eye(3)["xyz".index(letter.lower())], angle)
        out = out @ turn if letter.islower() else turn @ out
    return out
