"""Checks of the contents of a recording, so that reading detects files of another kind and damaged files.

`jsonschema` is not used: for the scene of a wall (106 shapes) it takes 167 ms instead of 26, its table is longer, and
it accepts NaN as a number. References to other parts (frames, corners, meshes) would need the checks below anyway.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording.columns import ON_BODIES, RAGGED
from nsdyn.recording.mechanism import KINDS, LAWS
from nsdyn.scene.materials import COMBINATION_RULES
from nsdyn.tools.array_text import from_text
from nsdyn.tools.datasets import dataset

TRIPLE = [float, float, float]
PLACEMENT = [[float] * 4] * 4

JOINT = {
    "kind": str,
    "?parts": (dict,),
    "?placements": (PLACEMENT,),
    **{f"?{name}": TRIPLE if "axis" in name else float for names in KINDS.values() for name in names},
    "parent": int,
    "placement": PLACEMENT,
    "mass": float,
    "com": TRIPLE,
    "inertia": [TRIPLE, TRIPLE, TRIPLE],
}
MODEL = {
    "joints": (JOINT,),
    **dict.fromkeys(LAWS, (float,)),
    **dict.fromkeys(("effort", "lower", "upper"), (object,)),
    "restitution": float,
    "loops": ({"name": str, "kind": str, "joints": [int, int], "placements": [PLACEMENT, PLACEMENT]},),
    "driven": dict,
}
"""Pattern of the return value of `nsdyn.scene.tree_description.describe_tree`."""

DRAWN = {
    "frame": int,
    "placement": PLACEMENT,
    "colour": object,
    "shape": str,
    "size": TRIPLE,
    "?vertices": (TRIPLE,),
    "?faces": ((int,),),
}
"""Pattern of what is drawn of a shape."""

# A pattern is a type, a list of patterns for a list of as many values, (pattern,) for a list of any length,
# {name: pattern}, or {"?name": pattern} if the name may be missing.
SCENE: dict[str, Any] = {
    "name": str,
    "gravity": TRIPLE,
    "friction_rule": str,
    "restitution_rule": str,
    "pairs": ({"first": str, "second": str, "mu": object, "restitution": object},),
    "geoms": ({"name": str, "body": str, "link": str, **DRAWN, "mu": float, "restitution": float, "?offset": float},),
    "excluded": ([int, int],),
    "frames": (str,),
    "links": ({"name": str, "frame": int, "placement": PLACEMENT},),
    "?visuals": ({"link": str, **DRAWN, "?mesh": int},),
    "?meshes": ({"vertices": str, "triangles": str},),
    "motions": dict,
    "free": int,
    "masses": (float,),
    "inertias": ([TRIPLE, TRIPLE, TRIPLE],),
    "articulations": ({"name": str, "nq": int, "nv": int, "joints": (str,), "sizes": ([int, int],), "model": MODEL},),
}
"""Pattern of the return value of `nsdyn.Scene.describe`."""

META = {
    "dt": float,
    "theta": float,
    "every": int,
    "contacts": bool,
    "controller": bool,
    "external_force": bool,
    "scene_name": str,
    "parameters": str,
    "command": str,
}


def column(file: Any, name: str, rows: int | None, kind: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the first rows of a dataset, or all, as numbers of a kind; `shape` is that of a row.

    ValueError for another type or shape, or too few rows.
    """
    item = dataset(file, name, rows)
    if item.shape[1:] != shape or not item.ndim or item.dtype.kind not in ("iuf" if kind[0] == "f" else "iu"):
        raise ValueError(f"/{name} has {item.dtype} of shape {item.shape}, {kind} of shape {('n', *shape)} expected")
    if rows is not None and len(item) < rows:
        raise ValueError(f"/{name} has {len(item)} rows, {rows} expected")
    return item[:rows].astype(kind, copy=False)


def check_meta(meta: Mapping[str, Any]) -> None:
    """Raise a ValueError naming an attribute of /meta that is missing or has another type."""
    for name, kind in META.items():
        value = meta.get(name)
        if not _fits(value, kind):
            raise ValueError(f"the attribute {name} of /meta is {value!r}, {kind.__name__} expected")
    if not isinstance(_from_json(meta["parameters"], "/meta/parameters"), dict):
        raise ValueError(f"/meta/parameters is {meta['parameters']}, a JSON object expected")


def _from_json(text: Any, name: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, TypeError, RecursionError) as failure:
        raise ValueError(f"{name} is no JSON: {failure}") from None


def scene(text: Any) -> dict[str, Any]:
    """Return the scene of a recording from its JSON text; ValueError if it is invalid."""
    out = _from_json(text, "/meta/scene")
    if where := _misfit(out, SCENE, "scene"):
        raise ValueError(f"/meta/scene has a wrong {where}")
    found: dict[str, Any] = out
    moving, free, shapes = len(found["frames"]), found["free"], len(found["geoms"])
    drawn = [*found["geoms"], *found.get("visuals", ())]
    frames = [part["frame"] for part in (*drawn, *found["links"])]
    corners = [(g, k) for g in drawn for loop in g.get("faces", ()) for k in loop]
    if not 0 <= free <= moving or any(not -1 <= k < moving for k in frames):
        raise ValueError("/meta/scene names moving bodies that it does not have")
    if any(not 0 <= k < len(g.get("vertices", ())) for g, k in corners):
        raise ValueError("/meta/scene has faces whose corners it does not have")
    _check_meshes(found)
    for rule in ("friction_rule", "restitution_rule"):
        if found[rule] not in COMBINATION_RULES:
            raise ValueError(f"/meta/scene has the unknown {rule} {found[rule]!r}")
    if any(not 0 <= k < shapes for pair in found["excluded"] for k in pair):
        raise ValueError("/meta/scene has pairs of shapes that it does not have")
    if any(len(found[name]) != free for name in ("masses", "inertias")):
        raise ValueError(f"/meta/scene must have {free} masses and inertias like free bodies")
    return found


def _check_meshes(found: Mapping[str, Any]) -> None:
    """Raise a ValueError for missing visual meshes and triangles without corners."""
    meshes = found.get("meshes", ())
    looks = [v for v in found.get("visuals", ()) if v["shape"] == "mesh"]
    if any(not 0 <= v.get("mesh", -1) < len(meshes) for v in looks):
        raise ValueError("/meta/scene has visual meshes that it does not have")
    for k, mesh in enumerate(meshes):
        try:
            vertices, triangles = from_text(mesh["vertices"], "<f4", 3), from_text(mesh["triangles"], "<u4", 3)
        except ValueError as failure:
            raise ValueError(f"/meta/scene meshes[{k}] {failure}") from None
        if not (triangles.max(initial=0) < len(vertices) and np.isfinite(vertices).all()):
            raise ValueError(f"/meta/scene meshes[{k}] has triangles whose corners it does not have")


def check_rows(columns: Mapping[str, NDArray[Any]], scene: Mapping[str, Any]) -> None:
    """Raise a ValueError for rows of shapes, steps or free bodies that do not exist."""
    shapes, free = len(scene["geoms"]), scene["free"]
    for group in RAGGED:
        offset = columns.get(f"{group}/offset", np.zeros(1))
        if offset[0] != 0 or (np.diff(offset) < 0).any():
            raise ValueError(f"/{group}/offset must ascend from 0")
    sides = {"contacts/geom1": shapes, "contacts/geom2": shapes, "contacts/status": 4}
    sides |= {f"{group}/body": free for group in ON_BODIES}
    for name, most in sides.items():
        values = columns.get(name, np.empty(0))
        if values.size and not (values.min() >= 0 and values.max() < most):
            raise ValueError(f"/{name} must lie between 0 and {most - 1}")


def _fits(value: Any, kind: Any) -> bool:
    if kind is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53
    return isinstance(value, kind)


def _misfit(value: Any, pattern: Any, where: str) -> str:
    """Return the place where a value does not fit its pattern, empty if it fits."""
    parts: Iterable[tuple[str, Any, Any]]
    if isinstance(pattern, dict):
        if not isinstance(value, dict):
            return where
        names = {name.removeprefix("?"): inner for name, inner in pattern.items() if name in value or name[0] != "?"}
        names |= {name[1:]: inner for name, inner in pattern.items() if name[0] == "?" and name[1:] in value}
        parts = ((f"{where} {name}", value.get(name, ...), inner) for name, inner in names.items())
    elif isinstance(pattern, (list, tuple)):
        if not isinstance(value, list) or (isinstance(pattern, list) and len(value) != len(pattern)):
            return where
        inside = pattern if isinstance(pattern, list) else pattern * len(value)
        parts = ((f"{where}[{k}]", v, p) for k, (v, p) in enumerate(zip(value, inside, strict=True)))
    else:
        return "" if value is not ... and _fits(value, pattern) else where
    return next((found for name, inner, p in parts if (found := _misfit(inner, p, name))), "")
