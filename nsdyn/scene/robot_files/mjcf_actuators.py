"""Actuators of an MJCF file on hinges and slides: motors, servos and general ones without internal state."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene.actuation import Actuator
from nsdyn.scene.robot_files.mjcf_elements import DRIVES, over
from nsdyn.scene.robot_files.xml import Notes, numbers, range_of, scalar, text_of
from nsdyn.tools.arrays import Array

OWN = {
    "motor": set(),
    "position": {"kp", "kv", "inheritrange", "timeconst", "dampratio"},
    "velocity": {"kv"},
    "general": {"gaintype", "biastype", "dyntype", "gainprm", "biasprm"},
}
"""Attributes that only one kind has."""

USED = {"gear", "ctrllimited", "forcelimited", "ctrlrange", "forcerange"}
"""Attributes that all kinds have and that are read."""

SHARED = USED | {"armature", "cranklength", "damping", "delay", "nsample"}
"""Attributes that all kinds have, also when the default of another kind gives them."""

ACTUATORS = {*DRIVES.split()}
"""All kinds of actuators of MuJoCo."""

HARMLESS = {"name", "joint", "group", "lengthrange", "user", "interp"}

NONE = (-math.inf, math.inf)

KIND = "its kind"
"""A name, which no attribute can have, of the kind from which `laid_over` has made attributes of `general`."""

MIXED = "gains of several kinds in its class"
"""A note that defaults of kinds with gains of their own follow each other; MuJoCo may then take those of one before."""

GENERAL = OWN["general"] | {KIND, "inheritrange", "timeconst", "dampratio"}
"""Attributes that `laid_over` leaves, and that are read."""


def actuators_of(
    drives: Iterable[tuple[Element, float | None]],
    model: Any,
    places: Mapping[str, tuple[int, int]],
    autolimits: bool,
    dropped: Notes,
) -> tuple[Actuator, ...]:
    """Return the actuators of the joints at `places`, in q and v, with a keyframe's controls; note unused actuators."""
    out: dict[str, Actuator] = {}
    for element, control in drives:
        joint = element.get("joint", "")
        label = element.get(
            "name", joint or next((v for k, v in element.items() if k in ("tendon", "site", "body")), "")
        )
        if why := _unused(element, joint, places):
            dropped.append(f"<actuator> {label!r}: {why}")
            continue
        q, v = places[joint]
        a = _read(element, label, joint, v, autolimits)._replace(control=control)
        if element.get("inheritrange"):
            share = scalar(element.get("inheritrange"), None, f"inheritrange of actuator {label!r}")
            low, high = model.lowerPositionLimit[q], model.upperPositionLimit[q]
            if not math.isfinite(low):
                raise ValueError(f"inheritrange of actuator {label!r} needs a range of joint {joint!r}")
            middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
            a = a._replace(control_range=(middle - half, middle + half))
        if max(a.bias[1:]) > 0.0:
            dropped.append(f"<actuator> {label!r}: biasprm that drives it away")
            continue
        if label in out:
            raise ValueError(f"actuator {label!r} comes twice: name both")
        if element.tag == "motor":
            element.attrib.pop(MIXED, None)
        if others := sorted(element.attrib.keys() - USED - HARMLESS - GENERAL):
            dropped.append(f"actuator {label!r}: {', '.join(others)}")
        out[label] = a
    count = Counter(a.coordinate for a in out.values())
    for label, a in out.items():
        low, high = a.force_range
        if a.servo and (low, high) != NONE and count[a.coordinate] > 1:
            dropped.append(f"actuator {label!r}: forcerange of a servo that has others beside it")
            out[label] = a._replace(force_range=NONE)
        elif a.servo and low != -high:
            most = max(-low, high)
            dropped.append(f"actuator {label!r}: forcerange of a servo, but for ±{most:g}")
            out[label] = a._replace(force_range=(-most, most))
    return tuple(out.values())


def laid_over(inherited: Mapping[str, str], element: Element) -> dict[str, str]:
    """Return the attributes of `general` that an actuator, or a default, has with those `inherited` from its class.

    All kinds of a class share their attributes, in the order of the file. As in MuJoCo 4, a kind begins from the gains
    of its own kind or of `general`, and from none of any other kind.
    """
    kind, own, out = element.tag, dict(element.attrib), {**inherited, KIND: element.tag}
    if kind != "general":
        if inherited.get(KIND, kind) not in (kind, "general") or out.get("gaintype", "fixed") != "fixed":
            if inherited.get(KIND) != "motor":
                out[MIXED] = ""
            out = {name: value for name, value in out.items() if name in SHARED | {KIND, MIXED}}
        out |= {"gaintype": "fixed" if kind in OWN else kind, "dyntype": "none"}
        own = {f"{name} of a {kind}" if name in OWN["general"] else name: value for name, value in own.items()}
    out = over(out, own)

    def first(attribute: str, count: int, default: Sequence[float]) -> Array:
        given = numbers(out.get(attribute), None, default, f"{attribute} of <{kind}> {own.get('name', '')!r}")[:count]
        return np.append(given, np.zeros(count - given.size))

    (gain,), bias = first("gainprm", 1, (1.0,)), first("biasprm", 3, (0.0,))
    match kind:
        case "motor":
            if gain != 1.0 or bias.any():
                out[MIXED] = ""
            gain, bias = 1.0, np.zeros(3)
        case "position":
            (gain,), (damping,) = first("kp", 1, (gain,)), first("kv", 1, (-bias[2],))
            bias = np.array([0.0, -gain, -damping])
            if "kv" in own:
                out.pop("dampratio", None)
        case "velocity":
            (gain,) = first("kv", 1, (gain,))
            bias = np.array([0.0, 0.0, -gain])
        case _:
            return out
    out |= {"gainprm": repr(float(gain)), "biasprm": text_of(bias)}
    out["biastype"] = "none" if kind == "motor" else "affine"
    gains = OWN[kind] & {"kp", "kv"}
    if gains <= own.keys() and kind != "motor":
        out.pop(MIXED, None)
    return {name: value for name, value in out.items() if name not in gains}


def _unused(element: Element, joint: str, places: Mapping[str, tuple[int, int]]) -> str:
    """Return the reason why an actuator cannot be used, empty if it can."""
    if element.tag not in OWN:
        return f"of kind {element.tag!r}"
    if joint not in places:
        return "on no hinge or slide"
    for attribute, known in (("gaintype", "fixed"), ("biastype", "none affine"), ("dyntype", "none")):
        if element.get(attribute, "none") not in ("none", *known.split()):
            return f"{attribute}={element.get(attribute)!r}"
    for attribute in ("timeconst", "dampratio"):
        if any(float(x) for x in element.get(attribute, "").split()):
            return attribute
    return ""


def _read(element: Element, label: str, joint: str, v: int, autolimits: bool) -> Actuator:
    """Read an actuator of the file."""

    def value(attribute: str, default: float) -> float:
        return float(numbers(element.get(attribute), None, (default,), f"{attribute} of actuator {label!r}")[0])

    def limits(what: str) -> tuple[float, float]:
        return range_of(element, f"{what}range", f"{what}limited", autolimits, f"actuator {label!r}") or NONE

    bias = np.zeros(3)
    if element.get("biastype", "none") == "affine":
        given = numbers(element.get("biasprm"), None, (0.0,), f"biasprm of actuator {label!r}")[:3]
        bias[: given.size] = given
    b0, b1, b2 = bias.tolist()
    gear, gain = value("gear", 1.0), value("gainprm", 1.0)
    return Actuator(label, joint, v, gear, gain, (b0, b1, b2), limits("ctrl"), limits("force"))
