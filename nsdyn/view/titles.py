"""Titles of recordings; recordings shown beside each other are named by the parameters in which they differ."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from nsdyn.problem.solution import TOLD, Status

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

UNTOLD = {"parameters", "command", "checksums"}
"""Attributes of a recording that are not options of its run."""

SHOWN = {"dt": " s", "theta": "", "impact": "", "solver": ""}
"""Options that change the motion, and their units."""


LONG = 60
"""Most characters of a value; longer values are cut."""


def differing(a: Trajectory, b: Trajectory) -> dict[str, tuple[Any, Any]]:
    """Return the parameters of the scenes and options of the runs that differ, by name; None for a missing value."""
    one, other = _settings(a), _settings(b)
    names = sorted(one.keys() | other.keys())
    return {name: (one.get(name), other.get(name)) for name in names if one.get(name) != other.get(name)}


def labels(shown: list[Trajectory]) -> list[str]:
    """Return names that distinguish recordings; of equal scenes the differing values, as "mu=0.2", else their names."""
    names = [str(t.meta["scene_name"]) for t in shown]
    if len(set(names)) > 1:
        same = {name: iter(labels([t for t in shown if t.meta["scene_name"] == name])) for name in names}
        own = [(name, next(same[name])) for name in names]
        return [name if name == label else f"{name}, {label}" for name, label in own]
    settings, told = [_settings(t) for t in shown], []
    for key in dict.fromkeys((*_parameters(shown[0]), *SHOWN)):
        values = [own.get(key) for own in settings]
        if None not in values and any(value != values[0] for value in values):
            told.append(_told(key, *values))
    return [", ".join(parts) for parts in zip(*told, strict=True)] if told else names


def document(shown: list[Trajectory]) -> str:
    """Return the title of a page: "slide: mu=0.2 | mu=0.5"."""
    names, parts = [str(t.meta["scene_name"]) for t in shown], labels(shown)
    common = f"{names[0]}: " if len(set(names)) == 1 and parts != names else ""
    return common + " | ".join(parts)


def parameters(trajectory: Trajectory) -> str:
    """Return all parameters of a scene: "mu=0.2, speed=2.0"."""
    return ", ".join(f"{name}={_text(value)}" for name, value in _parameters(trajectory).items())


def _power(tol: str) -> str:
    """Return a tolerance as text, for instance "1e-8"."""
    digits, _, power = f"{float(tol):e}".partition("e")
    return f"{float(digits):g}e{int(power)}"


def words(trajectory: Trajectory) -> str:
    """Describe step and solver: "steps of 1 ms, contacts solved to 1e-8 m/s by auto, 130 of 200 steps to 1e-4"."""
    dt = f"{1e3 * trajectory.dt:g} ms" if trajectory.dt < 1.0 else f"{trajectory.dt:g} s"
    name, tol = re.findall(r"^(\w*)(?:\(tol=([^,)]*))?", str(trajectory.meta.get("solver", "")))[0]
    solved = f", contacts solved{f' to {_power(tol)} m/s' if tol else ''} by {name.lower()}" if name else ""
    return f"steps of {dt}{solved}{''.join(_short_of(trajectory))}"


def _short_of(trajectory: Trajectory) -> list[str]:
    """Return how many steps met only the solver's looser tolerance, and how many met none."""
    status, steps = trajectory.solver.status, "steps" if trajectory.every == 1 else "recorded steps"
    loose = re.findall(r"loose=([^,)]*)", str(trajectory.meta.get("solver", "")))
    found = {
        f"to {_power(loose[0])}" if loose else "to a looser one": status == Status.LOOSE,
        "missed it": ~np.isin(status, [*TOLD, Status.OVERLAP, Status.LOOSE]),
    }
    return [f", {which.sum()} of {status.size} {steps} {what}" for what, which in found.items() if which.any()]


def _settings(trajectory: Trajectory) -> dict[str, Any]:
    """Return the parameters of the scene and the options of the run."""
    return _parameters(trajectory) | {k: v for k, v in trajectory.meta.items() if k not in UNTOLD}


def _parameters(trajectory: Trajectory) -> dict[str, Any]:
    return json.loads(trajectory.meta.get("parameters", "{}"))


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONG else text[:LONG] + "…"


def _told(name: str, *values: Any) -> list[str]:
    """Return one setting of each recording as text, with enough digits to distinguish the values."""
    if name in ("solver", "impact"):
        kinds, inner = zip(*(re.findall(r"^(\w*)\(?(.*?)\)?$", str(value), re.S)[0] for value in values), strict=True)
        if len(set(kinds)) > 1:
            return [f"{name}={kind}" for kind in kinds]
        words = [text.split(", ") for text in inner]
        return [", ".join(w for w in mine if not all(w in other for other in words)) for mine in words]
    texts = [_text(value) for value in values]
    short = [f"{value:.6g}" if isinstance(value, float) else text for value, text in zip(values, texts, strict=True)]
    if len(set(short)) == len(set(texts)):
        texts = short
    return [f"{name}={text}{SHOWN.get(name, '')}" for text in texts]
