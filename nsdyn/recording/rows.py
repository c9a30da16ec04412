"""Conversion of steps to rows of a recording, many steps at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn.problem.solution import Status
from nsdyn.recording import link_names
from nsdyn.recording.columns import (
    CONTACT,
    JOINTS,
    LAYOUT,
    LINKS,
    ON_BODIES,
    ON_JOINTS,
    ON_LINKS,
    RAGGED,
    STATES,
    STEP,
    WIDTHS,
    Columns,
    row_shapes,
    rows_of,
)
from nsdyn.tools.arrays import Index

_STATE = "t", "q", "v", "frames_x", "frames_quat", "energy"
_read_state = attrgetter(*_STATE)
_read_step = attrgetter(*_STATE, "joints", "links", "pieces", *ON_BODIES, *(column.path for column in STEP.values()))
_read_contacts = attrgetter(*(column.path for column in CONTACT.values()))
_CONTACTS = [f"contacts/{name}" for name in CONTACT]


class _Known(NamedTuple):
    """Values read from a step and from its contacts; the step itself may be released."""

    step: tuple[Any, ...]
    contacts: tuple[Any, ...]

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return len(self.contacts[-1])


def keep(step: Any) -> Any:
    """Return the data that `pack` needs of a step: its values, or its `untold` (see `Recorder`)."""
    return _Known(_read_step(step), _read_contacts(step)) if step.untold is None else step.untold


def begin(state: Any) -> Columns:
    """Return the columns of the initial state."""
    columns = _columns(_stacked([_read_state(state)]))
    return {name: x for name, x in columns.items() if rows_of(name) == "states"}


def none(meta: Mapping[str, Any], scene: Mapping[str, Any]) -> Columns:
    """Return all columns of steps, without rows."""
    shapes = row_shapes(meta, scene)
    rows = {name: int(name.endswith("/offset")) for name in shapes if name not in STATES and name not in LINKS}
    return {name: np.zeros((n, *shapes[name]), LAYOUT[name].kind) for name, n in rows.items()}


def _none(name: str, sizes: Mapping[str, int]) -> NDArray[Any]:
    """Return a column without rows; `sizes` are lengths of axes that are not the same in all recordings."""
    column, lengths = LAYOUT[name], {**WIDTHS, **sizes}
    return np.empty((0, *(lengths[axis] for axis in column.axes)), column.kind)


def pack(steps: Sequence[Any], every: int, contacts: bool, carriers: Index | None, pushed: bool) -> Columns:
    """Return the columns of steps and of their contacts, without wall times, with counts in place of offsets.

    The `steps` are return values of `keep`, and `every` of them make a row. Recorded are `contacts` or none, wrenches
    on free bodies if some may be `pushed`, and impulses on links if their `link_names.carriers` are given.
    """
    parts = [_steps(run) for run in _runs(steps)]
    block = {name: _joined(name, [part[name] for part in parts]) for name in parts[0]}
    shown = steps[every - 1 :: every] if contacts else ()
    if not pushed:
        block = {name: x for name, x in block.items() if not name.startswith("wrenches/")}
    if every > 1:
        block = _merged(block, every)
    if carriers is None:
        block.pop(ON_LINKS, None)
    elif len(shown) < len(steps):
        row = np.repeat(np.arange(len(steps)) // every, [step.nc for step in steps])
        link_names.by_contacts(carriers, _of_contacts(steps), row, block[ON_LINKS])
    block["contacts/offset"] = np.array([step.nc for step in shown] if contacts else [0] * len(block["t"]))
    return block | _of_contacts(shown)


def _runs(steps: Sequence[Any]) -> list[list[Any]]:
    """Return groups of consecutive steps to pack together: read steps, or unread ones with equal contact counts."""
    return [list(run) for _, run in groupby(steps, lambda step: None if isinstance(step, _Known) else step.nc)]


def _steps(run: Sequence[Any]) -> Columns:
    """Return the columns of steps without their contacts."""
    return _columns(_stacked([s.step for s in run]) if isinstance(run[0], _Known) else _read_step(run[0].steps(run)))


def _of_contacts(steps: Sequence[Any]) -> Columns:
    """Return the columns of the contacts of steps."""
    runs = [_contacts(run) for run in _runs(steps)]
    return {name: _joined(name, [_none(name, {}), *(run[k] for run in runs)]) for k, name in enumerate(_CONTACTS)}


def _contacts(run: Sequence[Any]) -> list[NDArray[Any]]:
    """Return the values of the contacts of steps that are packed together, by the columns of `CONTACT`."""
    if isinstance(run[0], _Known):
        return [np.concatenate(of) for of in zip(*(step.contacts for step in run), strict=True)]
    m, nc, read = len(run), run[0].nc, _read_contacts(run[0].contacts(run))
    return [np.broadcast_to(x, (m, nc, *x.shape[2:])).reshape(m * nc, *x.shape[2:]) for x in read]


def _joined(name: str, parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Return parts of a column as one array of its own, of the kind that it has in files."""
    return np.concatenate(parts, dtype=LAYOUT[name].kind, casting="same_kind")


def _stacked(rows: list[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Stack values read from single steps, or from single states, in the form of values read from many together."""
    t, q, v, x, quaternion, energies, *more = zip(*rows, strict=True)
    energy = {name: np.array([one[name] for one in energies], dtype=float) for name in energies[0]}
    # For short rows `np.stack` takes five times as long.
    joined = (
        None if of[0] is None else np.concatenate(of, dtype=float).reshape(len(of), *of[0].shape)
        for of in (q, v, x, quaternion)
    )
    out = np.array(t, dtype=float), *joined, energy
    if not more:
        return out
    joints, links, pieces, wrenches, lifts, *values = more
    columns = (np.array(of, dtype=column.kind) for of, column in zip(values, STEP.values(), strict=True))
    if joints[0] is None:
        return *out, None, None, None, wrenches, lifts, *columns
    return *out, np.stack(joints, axis=1), np.stack(links), pieces, wrenches, lifts, *columns


def _columns(read: tuple[Any, ...]) -> Columns:
    """Return columns by name of values read from many steps, or from states alone; counts in place of offsets."""
    t, q, v, x, quaternion, energy, *more = read
    out: Columns = {"t": t, "q": q, "v": v} | {f"energy/{name}": values for name, values in energy.items()}
    if x is not None:
        out |= {"frames/x": x, "frames/quat": quaternion}
    if more:
        joints, links, pieces, wrenches, lifts, *values = more
        out |= dict(zip(STEP, values, strict=True))
        for group, acted in zip(ON_BODIES, (wrenches, lifts), strict=True):
            out |= _of_moves(group, acted, 0)
        if joints is not None:
            out |= dict(zip(JOINTS, joints, strict=True)) | {ON_LINKS: links}
            out |= _of_moves("pieces", pieces, joints.shape[2])
    return out


def _of_moves(group: str, acted: Sequence[Any], nv: int) -> Columns:
    """Return the columns of a group of `RAGGED` from what each step has of it, if anything."""
    out: Columns = {f"{group}/offset": np.array([len(a.duration) if a else 0 for a in acted])}
    order = {name: k for k, name in enumerate(ON_JOINTS)} if group == "pieces" else {}
    for name, column in RAGGED[group].items():
        none = _none(f"{group}/{name}", {"joint_coordinate": nv})
        values = [a.joints[order[name]] if name in order else getattr(a, column.path or name) for a in acted if a]
        out[f"{group}/{name}"] = np.concatenate([none, *values]).astype(column.kind, copy=False)
    return out


def _merged(columns: Columns, every: int) -> Columns:
    """Return rows of `every` steps each, by the rules of the file's layout."""
    ragged = [name for name in (f"{group}/offset" for group in RAGGED) if name in columns]
    rows = {n: x.reshape(-1, every, *x.shape[1:]) for n, x in columns.items() if n.partition("/")[0] not in RAGGED}
    bad, error = ~np.isin(rows["solver/status"], (Status.CONVERGED, Status.LOOSE)), rows["solver/error"]
    worst = np.where(bad | ~bad.any(axis=1, keepdims=True), error, -np.inf).argmax(axis=1)
    out = {}
    for name, x in rows.items():
        rule = "last" if rows_of(name) == "states" else LAYOUT[name].merged
        if rule == "sum":
            out[name] = np.add.accumulate(x, axis=1)[:, -1]  # one after the other, in the order of a resumed run
        else:
            last = worst if rule == "worst" else -1
            out[name] = x.max(axis=1) if rule == "most" else x[np.arange(len(x)), last]
    return out | {name: np.zeros(len(out["t"]), np.int64) for name in ragged}
