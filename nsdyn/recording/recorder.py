"""What writes a recording while a simulation runs."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import version
from itertools import repeat
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn
from nsdyn.problem.solution import Status
from nsdyn.recording import file as recording
from nsdyn.recording import link_names
from nsdyn.recording.columns import (
    ADDED_META,
    CONTACT,
    ENERGIES,
    FORMAT_VERSION,
    JOINTS,
    ON_JOINTS,
    ON_LINKS,
    PIECES,
    STEP,
    WORKS,
    Columns,
)
from nsdyn.recording.file import Saved
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools import files
from nsdyn.tools.arrays import Array

__all__ = ["Recorder"]

State = Callable[[], Columns]

_FLUSH_SECONDS = 0.5  # a write takes about 10 ms, so recording costs about 2 %
PIECE = -len(CONTACT) - 1
PICTURES = {"visuals", "meshes"}
"""Where the pieces of a step stand in what is read of it, before them what acts on links."""

_BLOCK_ROWS = 256  # rows kept as they are read before they are packed into arrays

# What is read of every state, and of every step besides, at once.
_read_state = attrgetter("t", "q", "v", "frames_x", "frames_quat", "energy")
_read_step = attrgetter(
    *(column.path for column in STEP.values()),
    "joints",
    "links",
    "pieces",
    *(column.path for column in CONTACT.values()),
)


_NO_CONTACTS = tuple(np.empty((0, c.components) if c.components > 1 else 0, c.kind) for c in CONTACT.values())


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
        dt, theta, solver (its repr) and other options, as str, int, float or bool. `every`, by default 1: how many
        steps make a row; `contacts`, by default True: whether contacts are recorded.
    scene : mapping
        What `Scene.describe` returns.
    first : object
        The initial state: attributes t, q, v, frames_x, frames_quat and energy as below; of the energies only
        "kinetic" and "potential" are read.
    state : callable, optional
        Arrays by names from which the run goes on from the initial state; without it a recording cannot be resumed.

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
    gauss, solution, created      what `STEP` of `nsdyn.recording.columns` names, at its path
    contacts                      ContactSet: geom1, geom2, point, normal, mu, restitution, key
    gap                           (nc,), at the end of the step
    u, r, couple, tangent         (nc, 3) each
    contact_status                (nc,), 0 open, 1 stick, 2 slip, 3 jam
    contact_time                  (nc,), s after the beginning of the step
    joints                        (7, nv) impulses of actuation, limits, friction and external wrenches,
                                  displacement by projections, most that actuators may give, change of velocity
                                  of driven joints; None without articulations
    links                         (links, 6) impulses of external wrenches on the links of articulations, force and
                                  moment about the origin; only read where they are recorded
    pieces                        begin, duration and contacts (m,), moves (m, nv) and joints (7, m, nv) of what a
                                  step with articulations was cut into; None if it was not
    work_normal, work_friction    (nc,)
    ============================  =====================================================================

    and keeps references to these until the next flush: the arrays must not be changed afterwards. Use it as a context
    manager, so that the last rows reach the file also when the simulation raises; the file is then compressed and takes
    no more.
    """

    def __init__(
        self,
        path: str | Path | None,
        meta: Mapping[str, Any],
        scene: Mapping[str, Any],
        first: Any,
        state: State | None = None,
    ) -> None:
        columns = _pack([_read_state(first)], [])
        columns |= {"contacts/offset": np.zeros(1, dtype=np.int64), "wall_time": np.empty(0)}
        if trees := scene["articulations"]:
            none = np.empty((0, sum(tree["nv"] for tree in trees)))
            columns |= dict.fromkeys(JOINTS, none) | _no_pieces(none) | {"pieces/offset": np.zeros(1, np.int64)}
            if _left_out({**ADDED_META, **meta}):
                columns[ON_LINKS] = np.empty((0, len(link_names.joints(scene)), 6))
        self._begin(path, _full(meta, scene), scene, columns, None if state is None else (0, state()))

    def _begin(
        self,
        path: str | Path | None,
        meta: Mapping[str, Any],
        scene: Mapping[str, Any],
        columns: Columns,
        saved: Saved | None,
    ) -> None:
        self.meta, self.scene = dict(meta), dict(scene)
        if path is not None and files.is_special(path):
            raise ValueError(f"cannot record in {path}: it is no regular file, which rows could be added to")
        self.path = None if path is None else files.resolved(path)
        self._states: list[tuple[Any, ...]] = []
        self._steps: list[tuple[Any, ...]] = []
        self._open: list[tuple[tuple[Any, ...], tuple[Any, ...], float]] = []  # steps of a row that is not complete
        self._state: State | None = None
        self._blocks = [columns]
        self._rows = len(columns["t"]) - 1
        self._ends = {name: int(values[-1]) for name, values in columns.items() if name.endswith("/offset")}
        if self.path is not None:
            with files.writing(self.path, files.RECORDING) as part:
                recording.create(part, self.meta, self.scene, columns, grow=True, state=saved)
            self._blocks = []
        self._carriers = link_names.carriers(scene) if scene["articulations"] and _left_out(meta) else None
        self._wall: list[float] = []
        self._clock = time.perf_counter()
        self._deadline = self._clock + _FLUSH_SECONDS

    @classmethod
    def resumed(
        cls, path: str | Path, meta: Mapping[str, Any], scene: Mapping[str, Any], first: Any, duration: float
    ) -> tuple[Recorder, Columns]:
        """Go on with a recording whose run ended or was killed, from the last state in it.

        Parameters
        ----------
        path, meta, scene, first
            As of the recorder that began it.
        duration : float
            Of the whole run, s.

        Returns
        -------
        recorder : Recorder
            With the rows until that state; the file has been replaced by one that has no others.
        state : dict of str to ndarray
            Arrays that `state` of `append` gave.

        Raises
        ------
        FileNotFoundError
        ValueError
            If the file is no recording, has no state, is of another scene or of other options, naming one, or longer.
        """
        found, described, columns, saved = recording.read_state(Path(path))
        if saved is None:
            raise ValueError(f"{path} cannot be resumed: it holds no state of its run")
        given, begun = _full(meta, scene), _pack([_read_state(first)], [])
        versions = [name for name in given if name.endswith("_version")]
        told = {*versions, "parameters", "command"}  # what they make of the scene and the options is compared
        _refuse(path, {k: v for k, v in found.items() if k not in told}, given, "option")
        described, new = ({k: v for k, v in s.items() if k not in PICTURES} for s in (described, scene))
        _refuse(path, described, json.loads(json.dumps(new)), "scene")
        for name in ("q", "v"):
            if columns[name][0].tobytes() != begun[name][0].tobytes():
                raise ValueError(f"{path} cannot be resumed: its initial {name} is another")
        if (last := float(columns["t"][saved[0]])) >= duration + 0.999 * given["every"] * given["dt"]:  # round-off of t
            raise ValueError(f"duration must be at least the {last:g} s that {path} has, got {duration:g}")
        for name in versions:
            if found[name] != given[name]:
                warnings.warn(
                    f"{path} was begun with {name} {found[name]}, this is {given[name]}: last bits may differ",
                    stacklevel=3,
                )
        out = cls.__new__(cls)
        out._begin(path, found, described, recording.until(columns, saved[0]), saved)
        return out, saved[1]

    @property
    def rows(self) -> int:
        """Number of rows that are complete, the initial state apart."""
        return self._rows

    def append(self, step: Any, state: State | None = None) -> None:
        """Record one step; see the notes of the class for what it must carry.

        Where `state` is given it is called, now or later, for arrays by names from which the run goes on after it.
        """
        self._open.append((_read_state(step), _read_step(step), time.perf_counter() - self._clock))
        if len(self._open) == self.meta["every"]:
            row, did, wall = self._open[0] if len(self._open) == 1 else _merged(self._open)
            did = (*did[: PIECE - 1], self._on_links(), *did[PIECE:])
            self._states.append(row)
            self._steps.append(did if self.meta["contacts"] else (*did[: -len(CONTACT)], *_NO_CONTACTS))
            self._wall.append(wall)
            self._open, self._state, self._rows = [], state, self._rows + 1
            if len(self._steps) == _BLOCK_ROWS:
                self._pack_rows()
            if self.path is not None and time.perf_counter() >= self._deadline:
                self.flush()
        self._clock = time.perf_counter()

    def _on_links(self) -> Array | None:
        """What acted on the links in the steps of a row, (links, 6), where it is recorded."""
        if self._carriers is None:
            return None
        steps = [step for _, step, _ in self._open]
        out: Array = np.sum([step[PIECE - 1] for step in steps], axis=0)
        if self.meta["every"] > 1 or not self.meta["contacts"]:
            columns = zip(CONTACT, zip(*(step[-len(CONTACT) :] for step in steps), strict=True), strict=True)
            found = {f"contacts/{name}": np.concatenate(parts) for name, parts in columns}
            link_names.by_contacts(self._carriers, found, np.zeros(len(found["contacts/gap"]), np.int64), out[None])
        return out

    def flush(self) -> None:
        """Write the rows collected so far to the file, if there is one, and the state after them."""
        self._pack_rows()
        if self.path is not None and self._blocks:
            state = None if self._state is None else (self._rows, self._state())
            recording.extend(self.path, _concatenate(self._blocks), state)
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
            counts = {"contacts/offset": [len(row[-1]) for row in self._steps]}
            if "pieces/offset" in self._ends:
                counts["pieces/offset"] = [len(row[PIECE].duration) if row[PIECE] else 0 for row in self._steps]
            for name, count in counts.items():
                block[name] = self._ends[name] + np.cumsum(count)
                self._ends[name] = int(block[name][-1])
            self._blocks.append(block)
            block["wall_time"] = np.array(self._wall)
            self._states, self._steps, self._wall = [], [], []

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        if self.path is not None:
            contents = recording.read_state(self.path)
            try:
                with files.writing(self.path, files.RECORDING) as part:
                    recording.create(part, *contents[:3], grow=False, state=contents[3])
            except ValueError as failure:  # for instance of a full disk
                warnings.warn(f"{self.path} is complete, but not compressed: {failure}", stacklevel=2)


def _full(meta: Mapping[str, Any], scene: Mapping[str, Any]) -> dict[str, Any]:
    """All attributes of a recording."""
    return {
        "format": "nsdyn",
        "format_version": FORMAT_VERSION,
        "nsdyn_version": nsdyn.__version__,
        **_versions(),
        "scene_name": scene["name"],
        **ADDED_META,
        **meta,
    }


def _refuse(path: str | Path, found: Any, given: Any, name: str) -> None:
    """Raise a ValueError that names the first difference between what is in a file and what is given."""
    if name == "option checksums":
        found, given, name = json.loads(found), json.loads(given), "scene"
        if differ := sorted(what for what in found.keys() | given.keys() if found.get(what) != given.get(what)):
            raise ValueError(f"{path} cannot be resumed: its {differ[0]} differ from those of the scene given")
    elif isinstance(found, dict) and isinstance(given, dict):
        for key in sorted(found.keys() | (given.keys() if name == "scene" else set())):
            _refuse(path, found.get(key), given.get(key), f"{name} {key}")
    elif isinstance(found, list) and isinstance(given, list) and len(found) == len(given):
        for k, (one, other) in enumerate(zip(found, given, strict=True)):
            _refuse(path, one, other, f"{name}[{k}]")
    elif found != given:
        raise ValueError(f"{path} cannot be resumed: its {name} is {_short(found)}, not {_short(given)}")


def _short(value: Any) -> str:
    return f"a list of {len(value)}" if isinstance(value, list) else repr(value)


def _left_out(meta: Mapping[str, Any]) -> bool:
    """Whether of what acts on links something is not among the contacts recorded."""
    return bool(meta.get("external_force", False) or meta["every"] > 1 or not meta["contacts"])


def _merged(
    parts: list[tuple[tuple[Any, ...], tuple[Any, ...], float]],
) -> tuple[tuple[Any, ...], tuple[Any, ...], float]:
    """What was read of several steps as one row, as the layout of the file has it."""
    states, steps, wall = zip(*parts, strict=True)
    *state, energy = states[-1]
    energy = {**energy, **{name: sum(s[-1][name] for s in states) for name in WORKS}}
    told = dict(zip(STEP, zip(*(step[: len(STEP)] for step in steps), strict=True), strict=True))
    fine, status, error = (Status.CONVERGED, Status.LOOSE), told["solver/status"], told["solver/error"]
    worst = max(range(len(steps)), key=lambda k: (status[k] not in fine, error[k]))
    rules: dict[str, Callable[[Any], Any]] = {"sum": sum, "most": max, "worst": lambda values: values[worst]}
    did = (rules[column.merged](told[name]) for name, column in STEP.items())
    joints = [step[len(STEP)] for step in steps]
    total = None if joints[0] is None else sum(joints)
    return (*state, energy), (*did, total, None, None, *steps[-1][-len(CONTACT) :]), sum(wall)


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
    for name, column in STEP.items():
        out[name] = np.array(next(columns), dtype=column.kind)
    if (joints := next(columns)) and joints[0] is not None:
        out |= dict(zip(JOINTS, np.stack(joints, axis=1), strict=True)) | _no_pieces(np.empty((0, joints[0].shape[1])))
    if (on_links := next(columns, ())) and on_links[0] is not None:
        out[ON_LINKS] = np.stack(on_links)
    if cut := [piece for piece in next(columns, ()) if piece is not None]:
        own = [name for name in PIECES if name not in ON_JOINTS]
        out |= {f"pieces/{name}": np.concatenate([getattr(p, name) for p in cut]) for name in own}
        parts = np.concatenate([p.joints for p in cut], axis=1)
        out |= {f"pieces/{name}": part for name, part in zip(ON_JOINTS, parts, strict=True)}
    for name, empty in zip(CONTACT, _NO_CONTACTS, strict=True):
        out[f"contacts/{name}"] = np.concatenate([empty, *next(columns)], dtype=empty.dtype, casting="same_kind")
    return out


def _no_pieces(joints: Array) -> Columns:
    """Columns of no pieces, from those of no joints."""
    rows = (*ON_JOINTS, "moves")
    return {f"pieces/{n}": np.empty((0, joints.shape[1]) if n in rows else 0, kind) for n, kind in PIECES.items()}


def _stack(rows: tuple[Array, ...]) -> Array:
    """Rows of one shape as an array; NumPy's own function takes five times as long for short ones."""
    return np.concatenate(rows, dtype=float).reshape(len(rows), *rows[0].shape)


def _concatenate(blocks: list[Columns]) -> Columns:
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
