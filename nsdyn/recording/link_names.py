"""The links of a recording's articulations, one by joint and in the order of the joints, and what acts on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording.tables import impulses_world
from nsdyn.tools.arrays import Array, Index

__all__ = ["by_contacts", "carriers", "joints", "loops"]


def joints(scene: Mapping[str, Any]) -> list[str]:
    """Names of all joints, "articulation/joint"."""
    return [f"{a['name']}/{joint}" for a in scene["articulations"] for joint in a.get("joints", ())]


def loops(scene: Mapping[str, Any]) -> list[str]:
    """Names of all loops, "articulation/loop"."""
    told = [(a["name"], a.get("model", {})) for a in scene["articulations"]]
    return [f"{owner}/{loop['name']}" for owner, model in told for loop in model.get("loops", ())]


def carriers(scene: Mapping[str, Any]) -> Index:
    """Number of the link that carries each shape, -1 of others."""
    link = {name: k for k, name in enumerate(joints(scene))}
    frames = [link.get(name, -1) if k >= scene["free"] else -1 for k, name in enumerate(scene["frames"])]
    out: Index = np.array([*frames, -1], dtype=np.int64)[[geom["frame"] for geom in scene["geoms"]]]
    return out


def by_contacts(carrier: Index, columns: Mapping[str, NDArray[Any]], step: Index, out: Array) -> None:
    """Add impulses of contacts on links to those in `out`: force and moment about the world's origin, N·s and N·m·s.

    Parameters
    ----------
    carrier : ndarray of int
        As of `carriers`.
    columns : mapping
        Of contacts, as of a recording.
    step : ndarray of int
        Their steps, from 0 on.
    out : ndarray, shape (steps, links, 6)
    """
    push = impulses_world(columns)
    wrench = np.concatenate((push, np.cross(columns["contacts/point"], push)), axis=1)
    for side, sign in (("geom1", -1.0), ("geom2", 1.0)):
        link = carrier[columns[f"contacts/{side}"]]
        on = link >= 0
        np.add.at(out, (step[on], link[on]), sign * wrench[on])
