"""Recorder: it collects the recording of a simulation while the simulation runs."""

from __future__ import annotations

import json
import os
import time
import warnings
import weakref
from collections.abc import Callable, Collection, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn
from nsdyn.recording import file as recording
from nsdyn.recording import link_names, rows
from nsdyn.recording.columns import DEFAULTS, FORMAT_VERSION, ON_LINKS, Columns
from nsdyn.recording.file import Contents, Saved
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools import files

State = Callable[[], Columns]
Values = Mapping[str, Any]

_FLUSH_SECONDS = 0.5  # a write takes about 10 ms, so recording costs about 2 %
_HELD, _STEP = 8192, 32
"""Number of contacts in the steps that are kept before they are packed, and number of contacts for which a step itself
counts: 256 steps without contacts; in large scenes so few steps that they stay in the processor's cache."""

PICTURES = {"visuals", "meshes"}


@cache
def _versions() -> dict[str, str]:
    """Return the versions of the libraries that compute; a look-up takes a millisecond."""
    return {f"{name}_version": version(name) for name in ("pin", "coal", "numpy")}


class Recorder:
    """Recorder of the rows of a simulation, in memory or in a file that grows during the run.

    ValueError naming a file that cannot be written.

    Parameters
    ----------
    path : path, optional
        HDF5 file to write. An existing file is replaced as a whole. None keeps the recording in memory.
    meta : mapping
        dt, theta, solver (its repr) and other options, as str, int, float or bool. `every`, by default 1: number of
        steps per row; `contacts`, by default True: whether contacts are recorded.
    scene : mapping
        Return value of `Scene.describe`.
    first : object
        The initial state: attributes t, q, v, frames_x, frames_quat and energy as below; of the energies only
        "kinetic" and "potential" are read.
    state : callable, optional
        Returns the arrays, by names, with which the run continues from the initial state. Without it a recording cannot
        be resumed.

    Notes
    -----
    `append(step)` reads t, q, v, frames_x, frames_quat, the mapping energy, joints, links, pieces, wrenches and
    lifts as in `nsdyn.stepping.state.Step`, and the attributes that `STEP` and `CONTACT` of `nsdyn.recording.columns`
    name by their paths. It keeps references for a while: the arrays must not be changed afterwards.

    If `untold` of a step is not None, the recorder keeps only this object. `untold` has nc, the number of contacts, and
    methods `steps` and `contacts`. They take the `untold` of m consecutive steps with equal numbers of contacts, and
    return an object with the attributes above as arrays. Arrays of steps have a leading axis of m, arrays of contacts
    have leading axes that can be broadcast to (m, nc).

    Use it as a context manager, so that the last rows reach the file even if the simulation raises. The file is then
    compressed and accepts no more rows.
    """

    def __init__(
        self, path: str | Path | None, meta: Values, scene: Values, first: Any, state: State | None = None
    ) -> None:
        meta = _full(meta, scene)
        columns = rows.begin(first) | rows.none(meta, scene)
        self._begin(path, (meta, scene, columns), None if state is None else (0, state()))

    def _begin(self, path: str | Path | None, contents: Contents, saved: Saved | None) -> None:
        meta, scene, columns = contents
        self.meta, self.scene = dict(meta), dict(scene)
        if path is not None and files.is_special(path):
            raise ValueError(f"cannot record in {path}: it is no regular file, which rows could be added to")
        self.path = None if path is None else files.resolved(path)
        self._steps: list[Any] = []
        self._wall: list[float] = []
        self._held = 0
        self._state: State | None = None
        self._whole: Trajectory | None = None  # the recording, once its file accepts no more rows
        self._blocks = [columns]  # rows that are in no file, in the order of time
        self._rows = len(columns["t"]) - 1
        self._ends = {name: int(values[-1]) for name, values in columns.items() if name.endswith("/offset")}
        if self.path is not None:
            if files.is_file(self.path):
                files.check_writable(self.path, files.RECORDING)
                os.close(files.lock(self.path))
            with files.writing(self.path, files.RECORDING) as part:
                recording.create(part, contents, grow=True, state=saved)
            lock = files.lock(self.path)
            self._file, self._release = os.fstat(lock), weakref.finalize(self, os.close, lock)
            self._blocks = []
        self._carriers = link_names.carriers(scene) if ON_LINKS in columns else None
        self._clock = time.perf_counter()
        self._deadline = self._clock + _FLUSH_SECONDS

    @classmethod
    def resumed(
        cls, path: str | Path, meta: Values, scene: Values, first: Any, state: Collection[str], duration: float
    ) -> tuple[Recorder, Columns]:
        """Continue a recording whose run ended or was killed, from the last state in the recording.

        The recorder has the rows until the last state; the file has been replaced by one with only these rows. The
        arrays of that state, which `state` of `append` returned, are returned too. ValueError for what is not a
        recording, has no state, has another scene or other options (naming one), or is longer.

        Parameters
        ----------
        path, meta, scene, first
            As for the recorder that began the recording.
        state : collection of str
            Names of the arrays of a state.
        duration : float
            Duration of the whole run, s.
        """
        found, described, columns, saved = recording.read_state(files.as_path(path))
        if saved is None:
            raise ValueError(f"{path} cannot be resumed: it holds no state of its run")
        given, begun = _full(meta, scene), rows.begin(first)
        versions = [name for name in given if name.endswith("_version")]
        told = {*versions, "parameters", "command"}  # their effects, the scene and the options, are compared instead
        _refuse(path, {k: v for k, v in found.items() if k not in told}, given, "option")
        old, new = ({k: v for k, v in s.items() if k not in PICTURES} for s in (described, scene))
        _refuse(path, old, json.loads(json.dumps(new)), "scene")
        if lacking := sorted(set(state) - saved[1].keys()):
            raise ValueError(f"{path} cannot be resumed: its state has no {lacking[0]}, being of an older nsdyn")
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
        out._begin(path, (found, described, recording.until(columns, saved[0])), saved)
        return out, saved[1]

    @property
    def rows(self) -> int:
        """Number of complete rows, without the initial state."""
        return self._rows

    def append(self, step: Any, state: State | None = None) -> None:
        """Record one step; the notes of the class list the attributes that it must have.

        `state`, if given, is called now or later. It returns the arrays, by names, with which the run continues after
        the step.
        """
        now = time.perf_counter()
        kept = rows.keep(step)
        self._steps.append(kept)
        self._wall.append(now - self._clock)
        self._held += kept.nc + _STEP
        if len(self._steps) % self.meta["every"] == 0:
            self._state, self._rows = state, self._rows + 1
            if self._held >= _HELD:
                self._pack()
            if self.path is not None and now >= self._deadline:
                self.flush()
        self._clock = time.perf_counter()

    def flush(self) -> None:
        """Write the rows collected so far, and the state after them, to the file, if there is one."""
        self._pack()
        if self.path is not None and self._blocks:
            state = None if self._state is None else (self._rows, self._state())
            if not os.path.exists(self.path) or not os.path.samestat(os.stat(self.path), self._file):
                raise ValueError(f"{self.path} was replaced or removed while it was being recorded")
            recording.extend(self.path, self._columns(), state)
            self._blocks = []
            self._deadline = time.perf_counter() + _FLUSH_SECONDS

    def trajectory(self) -> Trajectory:
        """Return all that was recorded so far."""
        self.flush()
        if self.path is None:
            return Trajectory(self.meta, self.scene, self._columns())
        return Trajectory.load(self.path) if self._whole is None else self._whole

    def _columns(self) -> Columns:
        """Return the rows of all blocks, which become one block."""
        blocks = self._blocks
        if len(blocks) > 1:
            # Memory is let go column by column, but an interrupt must lose no rows of a file.
            take = dict.pop if self.path is None else dict.get
            whole: Columns = {}
            for name in [*blocks[0]]:
                whole[name] = np.concatenate([take(block, name) for block in blocks if name in block])
            self._blocks = [whole]
        return dict(self._blocks[0])

    def _pack(self) -> None:
        """Move the complete rows into arrays."""
        every = self.meta["every"]
        if size := len(self._steps) // every * every:
            shown, pushed = self.meta["contacts"], "wrenches/offset" in self._ends
            block = rows.pack(self._steps[:size], every, shown, self._carriers, pushed)
            wall, ends = np.array(self._wall[:size]).reshape(-1, every), dict(self._ends)
            block["wall_time"] = wall.sum(axis=1)
            for name, end in ends.items():
                block[name] = end + np.cumsum(block[name])
                ends[name] = int(block[name][-1])
            self._blocks.append(block)
            self._steps, self._wall, self._held, self._ends = self._steps[size:], self._wall[size:], 0, ends

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        if self.path is not None:
            meta, scene, columns, state = recording.read_state(self.path)
            self._whole = Trajectory(meta, scene, columns)
            try:
                with files.writing(self.path, files.RECORDING) as part:
                    recording.create(part, (meta, scene, columns), grow=False, state=state)
            except ValueError as failure:  # for instance because of a full disk
                warnings.warn(f"{self.path} is complete, but not compressed: {failure}", stacklevel=2)
            finally:
                self._release()


def _full(meta: Values, scene: Values) -> dict[str, Any]:
    """Return all attributes of a recording."""
    return {
        "format": "nsdyn",
        "format_version": FORMAT_VERSION,
        "nsdyn_version": nsdyn.__version__,
        **_versions(),
        "scene_name": scene["name"],
        **DEFAULTS,
        **meta,
    }


def _refuse(path: str | Path, found: Any, given: Any, name: str) -> None:
    """Raise a ValueError that names the first difference between the contents of a file and given values."""
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
