"""Actuators of an MJCF file on hinges and slides: motors, servos and general ones without internal state."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene.actuation import Actuator
from nsdyn.scene.robot_files.mjcf_elements import DRIVES
from nsdyn.scene.robot_files.xml import Notes, numbers, range_of

__all__ = ["ACTUATORS", "actuators_of", "of_other_kinds"]

OWN = {
    "motor": set(),
    "position": {"kp", "kv", "inheritrange"},
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

GAINS = {"general": "gainprm", "position": "kp", "velocity": "kv"}
"""Attributes that are one gain in MuJoCo: the attribute of general also sets the gain of the other kinds."""

NONE = (-math.inf, math.inf)


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
            share = float(numbers(element.get("inheritrange"), 1, None, f"inheritrange of actuator {label!r}")[0])
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
        if others := sorted(element.attrib.keys() - USED - HARMLESS - OWN[element.tag]):
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


def of_other_kinds(tag: str, given: Mapping[str, str], defaults: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return attributes of a `given` actuator from the defaults of other kinds; a gain gets a name that is reported."""
    out: dict[str, str] = {}
    for other, values in defaults.items():
        if other not in ACTUATORS - {tag}:
            continue
        out |= {k: v for k, v in values.items() if k in SHARED}
        gain = GAINS.get(other, "kp")
        if gain in values and "general" in (tag, other) and GAINS.get(tag, gain) not in {*given, gain}:
            out[f"{gain} of the default of {other!r}"] = ""
    return out


def _unused(element: Element, joint: str, places: Mapping[str, tuple[int, int]]) -> str:
    """Return the reason why an actuator cannot be used, empty if it can."""
    if element.tag not in OWN:
        return f"of kind {element.tag!r}"
    if joint not in places:
        return "on no hinge or slide"
    for attribute, known in (("gaintype", "fixed"), ("biastype", "none affine"), ("dyntype", "none")):
        if element.tag == "general" and element.get(attribute, "none") not in ("none", *known.split()):
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

    gain, bias = 1.0, np.zeros(3)
    if element.tag == "position":
        gain = value("kp", 1.0)
        bias[1:] = -gain, -value("kv", 0.0)
    elif element.tag == "velocity":
        gain = value("kv", 1.0)
        bias[2] = -gain
    elif element.tag == "general":
        gain = value("gainprm", 1.0)
        if element.get("biastype", "none") == "affine":
            given = numbers(element.get("biasprm"), None, (0.0,), f"biasprm of actuator {label!r}")[:3]
            bias[: given.size] = given
    b0, b1, b2 = bias.tolist()
    return Actuator(label, joint, v, value("gear", 1.0), gain, (b0, b1, b2), limits("ctrl"), limits("force"))
