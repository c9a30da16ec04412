"""What writes a recording while a simulation runs."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import version
from itertools import repeat
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn
from nsdyn.recording import file as recording
from nsdyn.recording.file import CONTACT, ENERGIES, FORMAT_VERSION, GAUSS, SOLVER, WORKS, Columns
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools import files
from nsdyn.tools.arrays import Array

__all__ = ["Recorder"]

_FLUSH_SECONDS = 0.5  # a write takes about 10 ms, so recording costs about 2 %
_BLOCK_ROWS = 256  # rows kept as they are read before they are packed into arrays

# What is read of every state, and of every step besides, at once.
_read_state = attrgetter("t", "q", "v", "frames_x", "frames_quat", "energy")
_read_step = attrgetter(
    *(f"gauss.{name}" for name in GAUSS),
    *(f"solution.{name}" for name in SOLVER),
    "created",
    *(path for path, _, _ in CONTACT.values()),
)


@cache
def _versions() -> dict[str, str]:
    """Versions of what computes; to look them up takes a millisecond."""
    return {f"{name}_version": version(name) for name in ("pin", "coal", "numpy")}


class Recorder:
    """Collects the rows of a simulation, in memory or in a file that grows while it runs.

    Parameters
    ----------
    path : path, optional
        HDF5 file to write. An existing one is replaced as a whole. None keeps everything in memory.
    meta : mapping
        dt, theta, solver (its repr), as str, int or float.
    scene : mapping
        What `Scene.describe` returns.
    first : object
        The initial state: attributes t, q, v, frames_x, frames_quat and energy as below; of the energies only
        "kinetic" and "potential" are read.

    Raises
    ------
    ValueError
        If the file cannot be written, naming it.

    Notes
    -----
    `append(step)` reads from a step

    ============================  =====================================================================
    t, q, v                       float, (nq,), (nv,) at the end of the step
    frames_x, frames_quat         (nframes, 3), (nframes, 4) xyzw, or None in scenes without articulations
    energy                        mapping of the `names` of `Energy` to floats, J
    gauss                         attributes gap, shift, bound
    solution                      attributes error, residual, iterations, status, time
    contacts                      ContactSet: geom1, geom2, point, normal, mu, restitution, key
    gap                           (nc,), at the end of the step
    u, r, tangent                 (nc, 3) each
    contact_status                (nc,), 0 open, 1 stick, 2 slip
    created                       float, J
    work_normal, work_friction    (nc,)
    ============================  =====================================================================

    and keeps references to these until the next flush: the arrays must not be changed afterwards. Use it as a context
    manager, so that the last rows reach the file also when the simulation raises.
    """

    def __init__(self, path: str | Path | None, meta: Mapping[str, Any], scene: Mapping[str, Any], first: Any) -> None:
        self.meta = {
            "format": "nsdyn",
            "format_version": FORMAT_VERSION,
            "nsdyn_version": nsdyn.__version__,
            **_versions(),
            "scene_name": scene["name"],
            **meta,
        }
        self.scene = dict(scene)
        if path is not None and files.is_special(path):
            raise ValueError(f"cannot record in {path}: it is no regular file, which rows could be added to")
        self.path = None if path is None else files.resolved(path)
        self._states: list[tuple[Any, ...]] = []
        self._steps: list[tuple[Any, ...]] = []
        self._blocks = [_pack([_read_state(first)], [])]
        self._blocks[0] |= {"contacts/offset": np.zeros(1, dtype=np.int64), "wall_time": np.empty(0)}
        self._contacts = 0
        if self.path is not None:
            with files.writing(self.path) as part:
                recording.create(part, self.meta, self.scene, self._blocks[0], grow=True)
            self._blocks = []
        self._wall: list[float] = []
        self._clock = time.perf_counter()
        self._deadline = self._clock + _FLUSH_SECONDS

    def append(self, step: Any) -> None:
        """Record one step; see the notes of the class for what it must carry."""
        self._wall.append(time.perf_counter() - self._clock)
        self._states.append(_read_state(step))
        self._steps.append(_read_step(step))
        if len(self._steps) == _BLOCK_ROWS:
            self._pack_rows()
        if self.path is not None and time.perf_counter() >= self._deadline:
            self.flush()
        self._clock = time.perf_counter()

    def flush(self) -> None:
        """Write the rows collected so far to the file, if there is one."""
        self._pack_rows()
        if self.path is not None and self._blocks:
            recording.extend(self.path, _concatenate(self._blocks))
            self._blocks = []
            self._deadline = time.perf_counter() + _FLUSH_SECONDS

    def trajectory(self) -> Trajectory:
        """Everything recorded so far."""
        self.flush()
        if self.path is not None:
            return Trajectory.load(self.path)
        return Trajectory(self.meta, self.scene, _concatenate(self._blocks))

    def _pack_rows(self) -> None:
        if self._steps:
            block = _pack(self._states, self._steps)
            block["contacts/offset"] = self._contacts + np.cumsum([len(row[-1]) for row in self._steps])
            self._contacts = int(block["contacts/offset"][-1])
            self._blocks.append(block)
            block["wall_time"] = np.array(self._wall)
            self._states, self._steps, self._wall = [], [], []

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()


def _pack(states: list[tuple[Any, ...]], steps: list[tuple[Any, ...]]) -> Columns:
    """Arrays of the file from what was read of states and steps, without the offsets of the contacts and times."""
    out: Columns = {}
    t, q, v, x, quaternion, energies = zip(*states, strict=True)
    out |= {"t": np.array(t, dtype=float), "q": _stack(q), "v": _stack(v)}
    if x[0] is not None:
        out |= {"frames/x": _stack(x), "frames/quat": _stack(quaternion)}
    for name in ENERGIES:
        out[f"energy/{name}"] = np.array([energy[name] for energy in energies], dtype=float)
    columns: Iterator[Any] = zip(*steps, strict=True) if steps else repeat(())
    for name in WORKS:
        out[f"energy/{name}"] = np.array([energy[name] for energy in energies if steps], dtype=float)
    for name in GAUSS:
        out[f"gauss/{name}"] = np.array(next(columns), dtype=float)
    for name, kind in SOLVER.items():
        out[f"solver/{name}"] = np.array(next(columns), dtype=kind)
    out["energy/created"] = np.array(next(columns), dtype=float)
    for name, (_, kind, components) in CONTACT.items():
        empty = np.empty((0, components) if components > 1 else 0, dtype=kind)
        out[f"contacts/{name}"] = np.concatenate([empty, *next(columns)], dtype=kind, casting="same_kind")
    return out


def _stack(rows: tuple[Array, ...]) -> Array:
    """Rows of one shape as an array; NumPy's own function takes five times as long for short ones."""
    return np.concatenate(rows, dtype=float).reshape(len(rows), *rows[0].shape)


def _concatenate(blocks: list[Columns]) -> Columns:
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
