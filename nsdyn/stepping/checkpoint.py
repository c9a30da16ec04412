"""Checkpoints: the state of a run as plain arrays, from which the run continues bit for bit.

All of `nsdyn.stepping.stepper.State` is stored except the links of trees and their energies. Both are computed again
from the coordinates, to the last bit.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.problem.gauss import SlaterDirection
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import NOTHING

if TYPE_CHECKING:
    from nsdyn.stepping.state import State

Arrays = dict[str, NDArray[Any]]


OPENING = SlaterDirection(NOTHING, 0, 0.0)


def pack(state: State) -> Arrays:
    """Return the arrays of a state by the names of its parts, numbers as arrays without axes."""
    out = dict(_parts(_plain(state), "state"))
    if state.slater is not None:
        out |= _parts(state.slater, "opening")
    return out


def unpack(arrays: Arrays, like: State, dynamics: Dynamics) -> State:
    """Return the state that `pack` stored; `like` is any state of the same scene.

    Raises
    ------
    KeyError
        If an array is missing.
    """
    state: State = _made(_plain(like), "state", arrays)
    instant = state.instant
    links = tuple(t.links(q) for t, q in zip(dynamics.trees, instant.position.trees, strict=True))
    instant = instant._replace(
        placement=instant.placement._replace(links=links),
        energies=dynamics.tree_energies(instant.position, instant.v),
    )
    slater = _made(OPENING, "opening", arrays) if "opening.d" in arrays else None
    return state._replace(instant=instant, slater=slater)


def _plain(state: State) -> State:
    """The state without its Slater direction and last step, and without links and energies of trees."""
    i = state.instant
    i = i._replace(placement=i.placement._replace(links=()), energies=())
    return state._replace(instant=i, slater=None, last=None)


def _children(value: tuple[Any, ...], name: str) -> Iterator[tuple[str, Any]]:
    names = getattr(value, "_fields", range(len(value)))
    return ((f"{name}.{key}", child) for key, child in zip(names, value, strict=True))


def _parts(value: Any, name: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """Names and values of the arrays and numbers in nested tuples."""
    if isinstance(value, tuple):
        for key, child in _children(value, name):
            yield from _parts(child, key)
    elif value is not None:
        yield name, np.asarray(value)


def _made(like: Any, name: str, arrays: Arrays) -> Any:
    """Nested tuples of the same structure as `like`, filled from `arrays`."""
    if isinstance(like, tuple):
        children = [_made(child, key, arrays) for key, child in _children(like, name)]
        return type(like)(*children) if hasattr(like, "_fields") else tuple(children)
    if like is None:
        return None
    if isinstance(like, np.ndarray):
        return arrays[name].astype(like.dtype)
    return type(like)(arrays[name])


def checksums(scene: Scene) -> dict[str, int]:
    """CRC-32 checksums of the parts of a scene that `Scene.describe` omits: pairs, prescribed motions, articulations.

    Functions of time that prescribe motions are not included.
    """
    pairs = sorted((sorted(names), values) for names, values in scene.pairs.items())
    motions = [
        (m.name, m.kind, None if callable(m.velocity) else np.asarray(m.velocity).tolist())
        for m in scene.motions.values()
    ]
    out = {"pairs with coefficients of their own": _checksum(pairs), "prescribed motions": _checksum(motions)}
    for a in scene.articulations.values():
        laws = a.friction, a.damping, a.armature, a.stiffness, a.rest, a.effort
        loops = [(o.joint1, str(o.placement1), o.joint2, str(o.placement2), o.kind) for o in a.loops]
        gears = [(g.coordinate1, g.coordinate2, g.ratio, g.offset) for g in a.gears]
        of_joints = [a.limits, a.restitution, *(law.tolist() for law in laws), loops, gears]
        out[f"articulation {a.name!r}"] = _checksum([a.model.saveToString(), of_joints])
    return out


def _checksum(values: Any) -> int:
    return zlib.crc32(json.dumps(values).encode())
