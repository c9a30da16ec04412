"""Links of a recording's articulations, one per joint and in the order of joints, and impulses of contacts on links."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording.tables import impulses_world
from nsdyn.tools.arrays import Array, Index


def joints(scene: Mapping[str, Any]) -> list[str]:
    """Return the names of all joints, "articulation/joint"."""
    return [f"{a['name']}/{joint}" for a in scene["articulations"] for joint in a["joints"]]


def loops(scene: Mapping[str, Any]) -> list[str]:
    """Return the names of all loops, "articulation/loop"."""
    return [f"{a['name']}/{loop['name']}" for a in scene["articulations"] for loop in a["model"]["loops"]]


def carriers(scene: Mapping[str, Any]) -> Index:
    """Return for each shape the number of the link that carries it, -1 for shapes on no link."""
    link = {name: k for k, name in enumerate(joints(scene))}
    frames = [link.get(name, -1) if k >= scene["free"] else -1 for k, name in enumerate(scene["frames"])]
    return np.array([*frames, -1], dtype=np.int64)[[geom["frame"] for geom in scene["geoms"]]]


def by_contacts(carrier: Index, columns: Mapping[str, NDArray[Any]], step: Index, out: Array) -> None:
    """Add impulses of contacts on links to `out` (steps, links, 6), with their moments about the world's origin.

    In N·s and N·m·s. The contacts, with their `columns` of a recording, are of the steps `step`, from 0 on; `carrier`
    is that of `carriers`.
    """
    push = impulses_world(columns)
    wrench = np.concatenate((push, np.cross(columns["contacts/point"], push)), axis=1)
    for side, sign in (("geom1", -1.0), ("geom2", 1.0)):
        link = carrier[columns[f"contacts/{side}"]]
        on = link >= 0
        np.add.at(out, (step[on], link[on]), sign * wrench[on])
