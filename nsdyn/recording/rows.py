"""Rows of a recording from steps, of which many are packed at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from nsdyn.dynamics.ledger import WORKS
from nsdyn.problem.solution import Status
from nsdyn.recording import link_names
from nsdyn.recording.columns import (
    CONTACT,
    CONTACTS,
    JOINTS,
    LINKS,
    OF_MOVES,
    ON_BODIES,
    ON_JOINTS,
    ON_LINKS,
    PIECES,
    RAGGED,
    STATES,
    STEP,
    Columns,
)
from nsdyn.recording.kept import Part
from nsdyn.tools.arrays import Array, Index

__all__ = ["begin", "keep", "none", "pack"]

_STATE = "t", "q", "v", "frames_x", "frames_quat", "energy"
_read_state = attrgetter(*_STATE)
_read_step = attrgetter(*_STATE, "joints", "links", "pieces", *ON_BODIES, *(column.path for column in STEP.values()))
_read_contacts = attrgetter(*(column.path for column in CONTACT.values()))


class _Known(NamedTuple):
    """What was read of a step, and of its contacts; the rest of the step may go."""

    step: tuple[Any, ...]
    contacts: tuple[Any, ...]

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return len(self.contacts[-1])


def keep(step: Any) -> Any:
    """What `pack` needs of a step: what is known of it, or what tells of many, as of `Recorder`."""
    return _Known(_read_step(step), _read_contacts(step)) if step.untold is None else step.untold


def begin(state: Any) -> Columns:
    """Columns of the initial state."""
    columns = _columns(_stacked([_read_state(state)]))
    return {name: x for name, x in columns.items() if name in STATES + LINKS}


def none(scene: Mapping[str, Any], links: bool, pushed: bool) -> Columns:
    """Columns of no steps, of all that is recorded of steps; with what acts on links and free bodies, if that is."""
    kinds = dict.fromkeys([f"energy/{name}" for name in WORKS], "f8") | {n: c.kind for n, c in STEP.items()}
    out = {name: np.empty(0, kind) for name, kind in kinds.items()}
    for name, c in CONTACT.items():
        out[f"contacts/{name}"] = np.empty((0, c.components) if c.components > 1 else 0, c.kind)
    out |= {"wall_time": np.empty(0), "contacts/offset": np.zeros(1, np.int64)}
    if trees := scene["articulations"]:
        nothing = np.empty((0, sum(tree["nv"] for tree in trees)))
        out |= dict.fromkeys(JOINTS, nothing) | _pieces((), nothing.shape[1]) | {"pieces/offset": np.zeros(1, np.int64)}
        if links:
            out[ON_LINKS] = np.empty((0, len(link_names.joints(scene)), 6))
    for group in ON_BODIES if pushed else ("lifts",):
        out |= _of_bodies(group, ()) | {f"{group}/offset": np.zeros(1, np.int64)}
    return out


def pack(steps: Sequence[Any], every: int, contacts: bool, carriers: Index | None, pushed: bool) -> list[Part]:
    """Columns of steps but for wall times, with counts in place of offsets.

    Parameters
    ----------
    steps : sequence
        What was kept of them.
    every : int
        How many make a row.
    contacts : bool
        Whether they are recorded.
    carriers : ndarray of int, optional
        As of `link_names.carriers`, where what acts on links is recorded.
    pushed : bool
        Whether wrenches on free bodies are.
    """
    parts = [_steps(run) for run in _runs(steps)]
    block = parts[0] if len(parts) == 1 else {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    shown = steps[every - 1 :: every] if contacts else ()
    if not pushed:
        block = {name: x for name, x in block.items() if not name.startswith("wrenches/")}
    if every > 1:
        block = _merged(block, every)
    if carriers is None:
        block.pop(ON_LINKS, None)
    elif len(shown) < len(steps):
        row = np.repeat(np.arange(len(steps)) // every, [step.nc for step in steps])
        of_all = [_one_by_one(*_contacts(run)) for run in _runs(steps)]
        columns = {name: np.concatenate([of[name] for of in of_all]) for name in of_all[0]}
        link_names.by_contacts(carriers, columns, row, block[ON_LINKS])
    block["contacts/offset"] = np.array([step.nc for step in shown] if contacts else [0] * len(block["t"]))
    return [(block, None), *map(_contacts, _runs(shown))]


def _runs(steps: Sequence[Any]) -> list[list[Any]]:
    """Steps in a row that are packed together: those that are known, and others of as many contacts."""
    return [list(run) for _, run in groupby(steps, lambda step: None if isinstance(step, _Known) else step.nc)]


def _steps(run: Sequence[Any]) -> Columns:
    """Columns of steps but for their contacts."""
    return _columns(_stacked([s.step for s in run]) if isinstance(run[0], _Known) else _read_step(run[0].steps(run)))


def _contacts(run: Sequence[Any]) -> Part:
    """Columns of the contacts of steps."""
    if isinstance(run[0], _Known):
        columns = [np.concatenate(of) for of in zip(*(step.contacts for step in run), strict=True)]
        return dict(zip(CONTACTS, columns, strict=True)), (len(columns[-1]),)
    return dict(zip(CONTACTS, _read_contacts(run[0].contacts(run)), strict=True)), (len(run), run[0].nc)


def _one_by_one(columns: Columns, fitted: tuple[int, ...] | None) -> Columns:
    """Columns of contacts with one axis for all of them."""
    if fitted is None or len(fitted) == 1:
        return columns
    return {n: np.broadcast_to(c, (*fitted, *c.shape[2:])).reshape(-1, *c.shape[2:]) for n, c in columns.items()}


def _stacked(rows: list[tuple[Any, ...]]) -> tuple[Any, ...]:
    """What was read of steps, or of states alone, one by one as it is read of many together."""
    t, q, v, x, quaternion, energies, *more = zip(*rows, strict=True)
    energy = {name: np.array([one[name] for one in energies], dtype=float) for name in energies[0]}
    out = np.array(t, dtype=float), *(None if of[0] is None else _stack(of) for of in (q, v, x, quaternion)), energy
    if not more:
        return out
    joints, links, pieces, wrenches, lifts, *values = more
    columns = (np.array(of, dtype=column.kind) for of, column in zip(values, STEP.values(), strict=True))
    if joints[0] is None:
        return *out, None, None, None, wrenches, lifts, *columns
    return *out, np.stack(joints, axis=1), np.stack(links), pieces, wrenches, lifts, *columns


def _columns(read: tuple[Any, ...]) -> Columns:
    """Columns of what is read of many steps, or of states alone, by name; counts in place of offsets."""
    t, q, v, x, quaternion, energy, *more = read
    out: Columns = {"t": t, "q": q, "v": v} | {f"energy/{name}": values for name, values in energy.items()}
    if x is not None:
        out |= {"frames/x": x, "frames/quat": quaternion}
    if more:
        joints, links, pieces, wrenches, lifts, *values = more
        out |= dict(zip(STEP, values, strict=True))
        for group, acted in zip(ON_BODIES, (wrenches, lifts), strict=True):
            out |= _of_bodies(group, acted) | {f"{group}/offset": np.array([a.body.size if a else 0 for a in acted])}
        if joints is not None:
            out |= dict(zip(JOINTS, joints, strict=True)) | {ON_LINKS: links} | _pieces(pieces, joints.shape[2])
            out["pieces/offset"] = np.array([len(p.duration) if p else 0 for p in pieces])
    return out


def _pieces(pieces: Sequence[Any], nv: int) -> Columns:
    """Columns of what steps were cut into."""
    cut = [p for p in pieces if p]
    joints = np.concatenate([np.empty((len(ON_JOINTS), 0, nv)), *(p.joints for p in cut)], axis=1)
    out = dict(zip((f"pieces/{name}" for name in ON_JOINTS), joints, strict=True))
    for name in [name for name in PIECES if name not in ON_JOINTS]:
        none = np.empty((0, nv) if name == "moves" else 0, PIECES[name])
        out[f"pieces/{name}"] = np.concatenate([none, *(getattr(p, name) for p in cut)])
    return out


def _of_bodies(group: str, acted: Sequence[Any]) -> Columns:
    """Columns of what was done to the free bodies in the moves of steps, by a name of `ON_BODIES`."""
    out = {}
    for name in OF_MOVES:
        columns = [getattr(a, name) for a in acted if a]
        out[f"{group}/{name}"] = np.concatenate([np.empty(0), *columns]).astype(OF_MOVES[name])
    return out | {f"{group}/{ON_BODIES[group]}": np.concatenate([np.empty((0, 6)), *(a.done for a in acted if a)])}


def _merged(columns: Columns, every: int) -> Columns:
    """Rows of so many steps each, as the layout of the file has them."""
    ragged = [name for name in (f"{group}/offset" for group in RAGGED) if name in columns]
    rows = {n: x.reshape(-1, every, *x.shape[1:]) for n, x in columns.items() if n.partition("/")[0] not in RAGGED}
    bad, error = ~np.isin(rows["solver/status"], (Status.CONVERGED, Status.LOOSE)), rows["solver/error"]
    worst = np.where(bad | ~bad.any(axis=1, keepdims=True), error, -np.inf).argmax(axis=1)
    out = {}
    for name, x in rows.items():
        rule = STEP[name].merged if name in STEP else "last" if name in STATES + LINKS else "sum"
        if rule == "sum":
            out[name] = np.add.accumulate(x, axis=1)[:, -1]  # one after the other, as a run that is resumed has them
        else:
            last = worst if rule == "worst" else -1
            out[name] = x.max(axis=1) if rule == "most" else x[np.arange(len(x)), last]
    return out | {name: np.zeros(len(out["t"]), np.int64) for name in ragged}


def _stack(rows: tuple[Array, ...]) -> Array:
    """Rows of one shape as an array; NumPy's own function takes five times as long for short ones."""
    return np.concatenate(rows, dtype=float).reshape(len(rows), *rows[0].shape)
