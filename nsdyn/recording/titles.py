"""What recordings are called: by what tells two of them apart where they are shown beside each other."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["differing", "document", "labels", "parameters"]

UNTOLD = {"parameters", "command", "checksums"}
"""Of the attributes of a recording, what is no option of its run."""

SHOWN = {"dt": " s", "theta": "", "impact": "", "solver": ""}
"""Options that make a motion another, and their units."""


LONG = 60
"""Letters of a value; what a longer one has beyond is left out."""


def differing(a: Trajectory, b: Trajectory) -> dict[str, tuple[Any, Any]]:
    """Parameters of the scenes and options of the runs that are not equal, by name; None where one has none."""
    one, other = (_parameters(t) | {k: v for k, v in t.meta.items() if k not in UNTOLD} for t in (a, b))
    names = sorted(one.keys() | other.keys())
    return {name: (one.get(name), other.get(name)) for name in names if one.get(name) != other.get(name)}


def labels(shown: list[Trajectory]) -> list[str]:
    """A name for one recording; for two of equal names what differs, as "mu=0.2", their names if nothing does."""
    names = [str(t.meta["scene_name"]) for t in shown]
    if len(shown) == 1:
        return names
    differ = differing(shown[0], shown[1])
    of_scene = _parameters(shown[0]) if names[0] == names[1] else ()
    told = [_told(k, *differ[k]) for k in dict.fromkeys((*of_scene, *SHOWN)) if None not in differ.get(k, (None,))]
    out = []
    for name, parts in zip(names, zip(*told, strict=True) if told else ((), ()), strict=True):
        own = [name] if names[0] != names[1] or not parts else []
        out.append(", ".join([*own, *parts]))
    return out


def document(shown: list[Trajectory]) -> str:
    """Name of a page: "slide: mu=0.2 | mu=0.5"."""
    names, parts = [str(t.meta["scene_name"]) for t in shown], labels(shown)
    common = f"{names[0]}: " if len(set(names)) == 1 and parts != names else ""
    return common + " | ".join(parts)


def parameters(trajectory: Trajectory) -> str:
    """All parameters of a scene: "mu=0.2, speed=2.0"."""
    return ", ".join(f"{name}={_text(value)}" for name, value in _parameters(trajectory).items())


def _parameters(trajectory: Trajectory) -> dict[str, Any]:
    out: dict[str, Any] = json.loads(trajectory.meta.get("parameters", "{}"))
    return out


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONG else text[:LONG] + "…"


def _told(name: str, *values: Any) -> list[str]:
    """One setting of each recording as text, with as many digits as tell the two apart."""
    if name in ("solver", "impact"):
        kinds, inner = zip(*(re.findall(r"^(\w*)\(?(.*?)\)?$", str(value), re.S)[0] for value in values), strict=True)
        if kinds[0] != kinds[1]:
            return [f"{name}={kind}" for kind in kinds]
        words = [text.split(", ") for text in inner]
        return [", ".join(w for w in mine if w not in other) for mine, other in zip(words, words[::-1], strict=True)]
    texts = [_text(value) for value in values]
    short = [f"{value:.6g}" if isinstance(value, float) else text for value, text in zip(values, texts, strict=True)]
    if short[0] != short[1]:
        texts = short
    return [f"{name}={text}{SHOWN.get(name, '')}" for text in texts]
