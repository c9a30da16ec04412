"""The record of a simulation, in memory and as an HDF5 file any HDF5 library reads.

Layout of the file (n steps, row 0 of a state is the initial one; SI units; quaternions xyzw)::

    /meta            attributes: format "nsdyn", format_version, dt, theta, solver, scene_name, external_force
                     (whether there was one; since version 3), versions of nsdyn, pin, coal, numpy
    /meta/scene      JSON string, what `Scene.describe` returns: shapes, poses, gravity, frames; since version 3 the
                     pairs of shapes that may overlap
    /t               (n+1,)  s
    /q, /v           (n+1, nq), (n+1, nv)  Pinocchio's free-flyer of every free body (x y z qx qy qz qw;
                     linear then angular velocity in the body frame), then the articulations
    /frames/x, quat  (n+1, nframes, 3), (n+1, nframes, 4)  world poses; only in scenes with articulations
                                                   or driven bodies
    /energy/kinetic, potential                     (n+1,)  J
    /energy/external, normal, friction, damping, constraint, integration, projection, defect
                                                   (n,)  work of the step, J; damping and constraint since version 2;
                                                   before version 3 gyroscopic, theta and mass make up integration
    /energy/created                                (n,)  J, no term of the balance; since version 3
    /gauss/gap, shift, bound                       (n,)  J, m/s, sqrt(J)
    /solver/error, residual, iterations, status, time
                                                   (n,)  -, m/s, -, `nsdyn.problem.Status`, s; error since version 3
    /contacts/offset                               (n+1,)  contacts of step k, the one that ends at t[k], are
                                                   rows offset[k-1] to offset[k] of
    /contacts/geom1, geom2, key                    indices of the shapes; key of the warm start
    /contacts/point, normal, tangent               (., 3)  world; normal from 1 to 2; t1, and t2 = n x t1
    /contacts/gap, mu, restitution                 m, -, -
    /contacts/u, impulse                           (., 3)  (N, T1, T2) of 2 relative to 1, m/s; on 2, N·s
    /contacts/status                               0 open, 1 stick, 2 slip
    /contacts/work_normal, work_friction           J

A file that is being recorded is open only for the few milliseconds in which rows are added to it, and then in
HDF5's single-writer-multiple-readers mode. So a run that is killed leaves the rows written so far in a file
that opens as any other; if the kill falls into those milliseconds, ``h5py.File(path, swmr=True)`` opens it,
and `Trajectory.load` does in either case. `/t` is written last: its length is the number of complete rows.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import cache
from importlib.metadata import version
from itertools import repeat
from operator import attrgetter
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

import nsdyn

Array = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

__all__ = ["BodyMotion", "ContactTable", "Energy", "Gauss", "Recorder", "SolverLog", "Trajectory"]

FORMAT_VERSION = 3
CONTACT_STATES = ("open", "stick", "slip")

_FLUSH_SECONDS = 0.5  # a write takes about 10 ms, so recording costs about 2 %
_BLOCK_ROWS = 256  # rows kept as they are read before they are packed into arrays


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies and works in J: kinetic + potential grows in each step by the sum of the works and the defect.

    Attributes
    ----------
    kinetic, potential : ndarray, shape (n + 1,)
        At the times t.
    external, normal, friction, damping, constraint : ndarray, shape (n,)
        Physics, work done on the system in each step: by applied forces and joint actuation, by the normal and the
        tangential impulses of contacts and joints, by viscous joint damping, by prescribed motion and closed loops.
    integration, projection : ndarray, shape (n,)
        Numerics: by the time discretisation of smooth motion, by position projection and what takes back such gains.
    defect : ndarray, shape (n,)
        What the ledger of each step fails to explain; round-off when all is well.
    created : ndarray, shape (n,)
        What of `normal` and `friction` the contacts of a step with an impact created, by a paradox of its law; no
        term of the balance. NaN in recordings that do not tell.
    """

    kinetic: Array
    potential: Array
    external: Array
    normal: Array
    friction: Array
    damping: Array
    constraint: Array
    integration: Array
    projection: Array
    defect: Array
    created: Array

    @property
    def names(self) -> tuple[str, ...]:
        """The terms of the balance, states first."""
        return _ENERGIES + _WORKS

    @property
    def total(self) -> Array:
        """Kinetic + potential, shape (n + 1,)."""
        return self.kinetic + self.potential


@dataclass(frozen=True, eq=False)
class Gauss:
    """Certificate of each step by Gauss's principle, shape (n,).

    Attributes
    ----------
    gap : ndarray
        Duality gap, J.
    shift : ndarray
        Size of the perturbation of the step that was solved exactly, m/s.
    bound : ndarray
        At least the error of the velocity in the kinetic norm, √J; infinite where there is none: see `nsdyn.gauss`.
    """

    gap: Array
    shift: Array
    bound: Array


@dataclass(frozen=True, eq=False)
class SolverLog:
    """What the solver reported in each step, shape (n,).

    Attributes
    ----------
    error, residual : ndarray
        `FC3D.error` [-] and `FC3D.residual` [m/s].
    iterations : ndarray of int
    status : ndarray of int8
        Values of `nsdyn.problem.Status`; 0 is converged.
    time : ndarray
        Wall time of the solve, s.
    """

    error: Array
    residual: Array
    iterations: NDArray[np.int32]
    status: NDArray[np.int8]
    time: Array

    @property
    def status_names(self) -> list[str]:
        """Names of the status of each step."""
        from nsdyn.problem import Status

        return [Status(int(s)).name for s in self.status]


_ENERGIES = ("kinetic", "potential")
_PHYSICS = ("external", "normal", "friction", "damping", "constraint")
_WORKS = (*_PHYSICS, "integration", "projection", "defect")
_GAUSS = tuple(f.name for f in fields(Gauss))
_SOLVER = {"error": "f8", "residual": "f8", "iterations": "i4", "status": "i1", "time": "f8"}
# Columns of a contact by name: (where a step has it, type, components).
_CONTACT = {
    "geom1": ("contacts.geom1", "i4", 1),
    "geom2": ("contacts.geom2", "i4", 1),
    "point": ("contacts.point", "f8", 3),
    "normal": ("contacts.normal", "f8", 3),
    "gap": ("gap", "f8", 1),
    "mu": ("contacts.mu", "f8", 1),
    "restitution": ("contacts.restitution", "f8", 1),
    "key": ("contacts.key", "i8", 1),
    "u": ("u", "f8", 3),
    "impulse": ("r", "f8", 3),
    "status": ("contact_status", "i1", 1),
    "tangent": ("tangent", "f8", 3),
    "work_normal": ("work_normal", "f8", 1),
    "work_friction": ("work_friction", "f8", 1),
}

# What is read of every state, and of every step besides, at once.
_read_state = attrgetter("t", "q", "v", "frames_x", "frames_quat", "energy")
_read_step = attrgetter(
    *(f"gauss.{name}" for name in _GAUSS),
    *(f"solution.{name}" for name in _SOLVER),
    "created",
    *(path for path, _, _ in _CONTACT.values()),
)

# Datasets of a file by their number of rows: n + 1, n, and one per contact.
_STATES = ["t", "q", "v", *(f"energy/{name}" for name in _ENERGIES), "contacts/offset"]
_LINKS = ["frames/x", "frames/quat"]
_STEPS = [f"energy/{name}" for name in _WORKS]
_STEPS += [f"gauss/{name}" for name in _GAUSS] + [f"solver/{name}" for name in _SOLVER] + ["energy/created"]
# Columns that older files lack: (version, column, those that it is the sum of, its value without any).
_ADDED: list[tuple[int, str, tuple[str, ...], float]] = [
    (2, "energy/damping", (), 0.0),
    (2, "energy/constraint", (), 0.0),
    (3, "energy/integration", ("energy/gyroscopic", "energy/theta", "energy/mass"), 0.0),
    (3, "energy/created", (), math.nan),
    (3, "solver/error", (), math.nan),
]
_CONTACTS = [f"contacts/{name}" for name in _CONTACT]


@cache
def _versions() -> dict[str, str]:
    """Versions of what computes; to look them up takes a millisecond."""
    return {f"{name}_version": version(name) for name in ("pin", "coal", "numpy")}


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a file to write beside `path` that takes its place when the block succeeds; else nothing is left.

    Raises
    ------
    ValueError
        Naming the path, when it cannot be written.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        part.touch()
        try:
            yield part
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from error


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
        self.path = None if path is None else Path(path).absolute()
        self._states: list[tuple[Any, ...]] = []
        self._steps: list[tuple[Any, ...]] = []
        self._blocks = [_pack([_read_state(first)], []) | {"contacts/offset": np.zeros(1, dtype=np.int64)}]
        self._contacts = 0
        if self.path is not None:
            with replacing(self.path) as part:
                _create(part, self.meta, self.scene, self._blocks[0], grow=True)
            self._blocks = []
        self._deadline = time.perf_counter() + _FLUSH_SECONDS

    def append(self, step: Any) -> None:
        """Record one step; see the notes of the class for what it must carry."""
        self._states.append(_read_state(step))
        self._steps.append(_read_step(step))
        if len(self._steps) == _BLOCK_ROWS:
            self._pack_rows()
        if self.path is not None and time.perf_counter() >= self._deadline:
            self.flush()

    def flush(self) -> None:
        """Write the rows collected so far to the file, if there is one."""
        self._pack_rows()
        if self.path is not None and self._blocks:
            _extend(self.path, _concatenate(self._blocks))
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
            self._states, self._steps = [], []

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()


def _pack(states: list[tuple[Any, ...]], steps: list[tuple[Any, ...]]) -> Columns:
    """Arrays of the file from what was read of states and steps, without the offsets of the contacts."""
    out: Columns = {}
    t, q, v, x, quaternion, energies = zip(*states, strict=True)
    out |= {"t": np.array(t, dtype=float), "q": _stack(q), "v": _stack(v)}
    if x[0] is not None:
        out |= {"frames/x": _stack(x), "frames/quat": _stack(quaternion)}
    for name in _ENERGIES:
        out[f"energy/{name}"] = np.array([energy[name] for energy in energies], dtype=float)
    columns: Iterator[Any] = zip(*steps, strict=True) if steps else repeat(())
    for name in _WORKS:
        out[f"energy/{name}"] = np.array([energy[name] for energy in energies if steps], dtype=float)
    for name in _GAUSS:
        out[f"gauss/{name}"] = np.array(next(columns), dtype=float)
    for name, kind in _SOLVER.items():
        out[f"solver/{name}"] = np.array(next(columns), dtype=kind)
    out["energy/created"] = np.array(next(columns), dtype=float)
    for name, (_, kind, components) in _CONTACT.items():
        empty = np.empty((0, components) if components > 1 else 0, dtype=kind)
        out[f"contacts/{name}"] = np.concatenate([empty, *next(columns)], dtype=kind, casting="same_kind")
    return out


def _stack(rows: tuple[Array, ...]) -> Array:
    """Rows of one shape as an array; NumPy's own function takes five times as long for short ones."""
    return np.concatenate(rows, dtype=float).reshape(len(rows), *rows[0].shape)


def _concatenate(blocks: list[Columns]) -> Columns:
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def _rows(names: Iterable[str], states: int, contacts: int) -> dict[str, int]:
    """Count the rows of each dataset in a recording of that many states and contacts."""
    count = dict.fromkeys(_CONTACTS, contacts) | dict.fromkeys([*_STATES, *_LINKS], states)
    return {name: count.get(name, states - 1) for name in names}


def _create(path: Path, meta: Mapping[str, Any], scene: Mapping[str, Any], columns: Columns, grow: bool) -> None:
    """Write a new file, its datasets of fixed size or ready to grow."""
    with h5py.File(path, "w", libver="latest", locking=False) as file:
        file.create_group("meta").attrs.update(meta)
        file["meta/scene"] = json.dumps(scene)
        for name, data in columns.items():
            options: dict[str, Any] = {}
            if grow:
                shape = tuple(max(1, size) for size in data.shape[1:])
                rows = 65536 // (data.itemsize * math.prod(shape))  # 64 kB: quick, yet small files stay small
                options = {"maxshape": (None, *data.shape[1:]), "chunks": (min(1024, max(16, rows)), *shape)}
            file.create_dataset(name, data=data, **options)


def _extend(path: Path, columns: Columns) -> None:
    """Add rows to a file: all columns, then, when they have reached it, `/t`.

    Rows an interrupted call left beyond the end of `/t` are written over. Locking is off, so that nobody who
    reads the file can stop the simulation; single-writer mode keeps it readable at every moment.
    """
    with h5py.File(path, "r+", libver="latest", locking=False) as file:
        file.swmr_mode = True
        states = len(file["t"])
        contacts = int(file["contacts/offset"][states - 1])
        for name, old in sorted(_rows(columns, states, contacts).items(), key=lambda item: item[0] == "t"):
            if name == "t":
                file.flush()
            file[name].resize(old + len(columns[name]), axis=0)
            file[name][old:] = columns[name]


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Motion of one free body or link in the world frame.

    Attributes
    ----------
    name : str
    position : ndarray, shape (n + 1, 3)
        m. Of the centre of mass of a free body, of the joint frame of a link.
    quaternion : ndarray, shape (n + 1, 4)
        xyzw, body to world.
    """

    name: str
    position: Array
    quaternion: Array
    _twist: Array | None

    @property
    def linear_velocity(self) -> Array:
        """Velocity of the centre of mass, shape (n + 1, 3), m/s; ValueError for a link."""
        return self._velocity(0)

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity, shape (n + 1, 3), rad/s; ValueError for a link."""
        return self._velocity(3)

    def _velocity(self, start: int) -> Array:
        if self._twist is None:
            raise ValueError(f"velocities of link {self.name!r} are not recorded: they follow from q and v")
        return rotate(self.quaternion, self._twist[:, start : start + 3])


def rotate(quaternion: Array, vector: Array) -> Array:
    """R(quaternion) vector, xyzw in the last axis."""
    axis, w = quaternion[..., :3], quaternion[..., 3:]
    turn = 2.0 * np.cross(axis, vector)
    out: Array = vector + w * turn + np.cross(axis, turn)
    return out


@dataclass(frozen=True, eq=False)
class ContactTable:
    """Contacts of one step, nc rows; SI units, world frame.

    Attributes
    ----------
    body1, body2 : tuple of str
        Names of the bodies (of the link's shape, for an articulation).
    point, normal, tangent : ndarray, shape (nc, 3)
        Normal from body 1 to body 2; t1, with t2 = n x t1.
    gap : ndarray, shape (nc,)
        At the end of the step, m, positive apart.
    u : ndarray, shape (nc, 3)
        Velocity of body 2 relative to body 1 after the step, (N, T1, T2), m/s.
    impulse : ndarray, shape (nc, 3)
        On body 2, its opposite on body 1, (N, T1, T2), N·s; not unique when contacts are redundant.
    mu, restitution : ndarray, shape (nc,)
    key : ndarray of int64, shape (nc,)
        The same for the same features of the same pair of shapes in the next step.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    work_normal, work_friction : ndarray, shape (nc,)
        J.
    """

    body1: tuple[str, ...]
    body2: tuple[str, ...]
    point: Array
    normal: Array
    tangent: Array
    gap: Array
    u: Array
    impulse: Array
    mu: Array
    restitution: Array
    key: NDArray[np.int64]
    status: NDArray[np.int8]
    work_normal: Array
    work_friction: Array

    @property
    def impulse_world(self) -> Array:
        """Impulse on body 2 in the world frame, shape (nc, 3), N·s."""
        other = np.cross(self.normal, self.tangent)
        r = self.impulse
        out: Array = r[:, :1] * self.normal + r[:, 1:2] * self.tangent + r[:, 2:] * other
        return out

    @property
    def status_names(self) -> list[str]:
        """Words for the status of each contact: open, stick or slip."""
        return [CONTACT_STATES[s] for s in self.status]

    def __len__(self) -> int:
        return self.gap.size

    def __repr__(self) -> str:
        width = max([5, *map(len, self.body1 + self.body2)])
        lines = [
            f"{'body1':{width}} {'body2':{width}} {'gap [m]':>10} {'u_N [m/s]':>10} {'|u_T|':>9}"
            f" {'r_N [N·s]':>10} {'|r_T|':>9} {'mu':>5} status"
        ]
        for k, state in enumerate(self.status_names[:_SHOWN]):
            slip, drag = np.hypot(*self.u[k, 1:]), np.hypot(*self.impulse[k, 1:])
            lines.append(
                f"{self.body1[k]:{width}} {self.body2[k]:{width}} {self.gap[k]:10.2e} {self.u[k, 0]:10.2e}"
                f" {slip:9.2e} {self.impulse[k, 0]:10.3e} {drag:9.2e} {self.mu[k]:5.3g} {state}"
            )
        if len(self) > _SHOWN:
            lines.append(f"... {len(self) - _SHOWN} more")
        return "\n".join(lines)


_SHOWN = 40  # contacts a printed table shows


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States, energies, certificates and contacts of a simulation of n steps.

    Attributes
    ----------
    meta : dict
        dt, theta, solver, scene_name, format and versions.
    scene : dict
        What `Scene.describe` returned: enough to draw it.
    columns : dict of str to ndarray
        The datasets by their name in the file, see the module.
    """

    meta: dict[str, Any]
    scene: dict[str, Any]
    columns: Columns

    @property
    def t(self) -> Array:
        """Times, shape (n + 1,), s."""
        return self.columns["t"]

    @property
    def q(self) -> Array:
        """Configurations, shape (n + 1, nq), Pinocchio's convention; row 0 is the initial one."""
        return self.columns["q"]

    @property
    def v(self) -> Array:
        """Velocities, shape (n + 1, nv), Pinocchio's convention (body frame for a free body)."""
        return self.columns["v"]

    @property
    def dt(self) -> float:
        """Time step, s."""
        return float(self.meta["dt"])

    @property
    def steps(self) -> int:
        """Number of steps n."""
        return self.t.size - 1

    @property
    def energy(self) -> Energy:
        """Energies and works, J."""
        return Energy(**{f.name: self.columns[f"energy/{f.name}"] for f in fields(Energy)})

    @property
    def gauss(self) -> Gauss:
        """Certificates."""
        return Gauss(**{name: self.columns[f"gauss/{name}"] for name in _GAUSS})

    @property
    def solver(self) -> SolverLog:
        """Reports of the solver."""
        return SolverLog(**{name: self.columns[f"solver/{name}"] for name in _SOLVER})

    def body(self, name: str) -> BodyMotion:
        """Motion of a free body, or of a link ("arm/link2"); ValueError naming the known ones."""
        frames = self.scene["frames"]
        if name not in frames:
            raise ValueError(f"no moving body {name!r}; the recording has {frames}")
        k = frames.index(name)
        if k < self.scene["free"]:
            pose, twist = self.q[:, 7 * k : 7 * k + 7], self.v[:, 6 * k : 6 * k + 6]
            return BodyMotion(name, pose[:, :3], pose[:, 3:], twist)
        return BodyMotion(name, self.columns["frames/x"][:, k], self.columns["frames/quat"][:, k], None)

    def contacts(self, k: int) -> ContactTable:
        """Contacts of step k, the one that ends at t[k]; k from 1 to n or from -1 back, else IndexError."""
        step = k + self.steps + 1 if k < 0 else k
        if not 1 <= step <= self.steps:
            raise IndexError(f"contacts belong to steps 1 to {self.steps}, got {k}")
        offset = self.columns["contacts/offset"]
        rows = slice(int(offset[step - 1]), int(offset[step]))
        part = {name: self.columns[f"contacts/{name}"][rows] for name in _CONTACT}
        # A link is named by its shape, a body by itself: the same string for the one shape it has.
        names = [geom["name"] for geom in self.scene["geoms"]]
        body1, body2 = (tuple(names[g] for g in part.pop(side)) for side in ("geom1", "geom2"))
        return ContactTable(body1=body1, body2=body2, **part)

    def save(self, path: str | Path) -> None:
        """Write an HDF5 file, which replaces one of that name once complete; ValueError naming the path."""
        with replacing(path) as part:
            _create(part, self.meta, self.scene, self.columns, grow=False)

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a recording, also one whose simulation is running or was killed.

        Raises
        ------
        FileNotFoundError
        ValueError
            If the file is no recording, naming the file and what is missing.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"no such recording: {path}")
        if not h5py.is_hdf5(path):
            raise ValueError(f"{path} is not a recording of nsdyn: it is not an HDF5 file")
        try:
            file = h5py.File(path, "r", locking=False)
        except OSError:  # marked as being written: the simulation is writing rows, or was killed while it did
            file = h5py.File(path, "r", swmr=True, locking=False)
        with file:
            return cls._read(file, path)

    @classmethod
    def _read(cls, file: Any, path: Path) -> Trajectory:
        attributes = file["meta"].attrs if "meta" in file else {}
        meta = {k: v.item() if isinstance(v, np.generic) else v for k, v in attributes.items()}
        if meta.get("format") != "nsdyn":
            raise ValueError(f"{path} is not a recording of nsdyn: /meta with format='nsdyn' is missing")
        if meta["format_version"] > FORMAT_VERSION:
            raise ValueError(
                f"{path} has format_version {meta['format_version']}, this nsdyn reads up to {FORMAT_VERSION}"
            )
        added = [row for row in _ADDED if meta["format_version"] < row[0]]
        parts = [part for _, _, parts, _ in added for part in parts]
        steps = [name for name in _STEPS if name not in {column for _, column, _, _ in added}] + parts
        missing = [name for name in ["meta/scene", *_STATES, *steps, *_CONTACTS] if name not in file]
        if missing:
            raise ValueError(f"{path} is not a recording of nsdyn: /{missing[0]} is missing")
        scene = json.loads(file["meta/scene"][()])
        states = len(file["t"])
        offset = file["contacts/offset"][:states]
        names = _STATES + (_LINKS if "frames" in file else []) + steps + _CONTACTS
        rows = _rows(names, states, int(offset[-1]) if len(offset) else 0)
        for name, size in rows.items():
            if len(file[name]) < size or not states:
                raise ValueError(f"{path} is damaged: /{name} has {len(file[name])} rows, {size} expected")
        columns = {name: file[name][:size] for name, size in rows.items()}
        for _, column, summed, value in added:
            columns[column] = sum((columns.pop(part) for part in summed), np.full(states - 1, value))
        meta["format_version"] = FORMAT_VERSION
        return cls(meta, scene, columns)

    def to_html(self, path: str | Path, **options: Any) -> None:
        """Write a self-contained animated page; options as in `nsdyn.viewer.write_html`."""
        from nsdyn.viewer import write_html

        write_html(self, path, **options)

    def plot_energy(self, ax: Any = None) -> Any:
        """Draw kinetic and potential energy, stacked, and over them the works done so far.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            A new one by default.

        Returns
        -------
        matplotlib Axes
        """
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(layout="constrained")[1]
        e = self.energy
        potential = e.potential - e.potential.min()
        labels, colours = ["kinetic", "potential, from its minimum"], ["#88bbdd", "#dde5ea"]
        ax.stackplot(self.t, e.kinetic, potential, labels=labels, colors=colours)
        for name in self._active_works():
            ax.plot(self.t, self._cumulative(name), label=f"work: {name}")
        ax.plot(self.t, e.kinetic + potential, "k", lw=1, label="kinetic + potential")
        ax.set(xlabel="t [s]", ylabel="energy, work so far [J]", title=self.meta["scene_name"])
        ax.margins(x=0)
        ax.legend(loc="best", frameon=False)
        return ax

    def ledger(self, rows: int = 10) -> dict[str, Array]:
        """Energies and works done so far, J, at about `rows` times "t" from the first to the last: physics, numerics.

        Works that never exceed a billionth of the largest energy are left out, the defect is not.
        """
        k = np.unique(np.linspace(0, self.steps, rows + 1).round().astype(int))
        out = {"t": self.t[k], "kinetic": self.energy.kinetic[k], "potential": self.energy.potential[k]}
        return out | {name: self._cumulative(name)[k] for name in [*self._active_works(), "defect"]}

    def energy_table(self, rows: int = 10) -> str:
        """Text table of `ledger`, and the worst figures of all steps."""
        ledger, worst = self.ledger(rows), self.worst()
        times, *energies = ledger.values()
        lines = [f"{'t [s]':>12}" + "".join(f"{name:>12}" for name in list(ledger)[1:])]
        for k, t in enumerate(times):
            lines.append(f"{t:12.6g}" + "".join(f"{values[k]:12.4e}" for values in energies))
        shares = self.shares()
        lines.append(f"{'':12}{'in all':>12}{'at most':>12}{'share':>12}  of the energy at play, {self.at_play:.4g} J")
        for name, (total, most) in shares.items():
            lines.append(f"{name:12}{total:12.4e}{most:12.4e}{most / max(self.at_play, 1e-300):12.1e}")
        lines.append(
            f"energies and works so far in J; max |defect| {worst['defect']:.1e} J, "
            f"max Gauss bound {worst['gauss_bound']:.1e} √J, max residual {worst['residual']:.1e} m/s"
        )
        return "\n".join(lines)

    @property
    def at_play(self) -> float:
        """Energy at play, J: the most of kinetic energy, range of potential energy and physical works so far."""
        e = self.energy
        works = (float(np.abs(self._cumulative(name)).max()) for name in _PHYSICS)
        return max(float(e.kinetic.max()), float(np.ptp(e.potential)), *works)

    def shares(self) -> dict[str, tuple[float, float]]:
        """Works of physics, numerics (integration, defect) and projection, J: (in all, largest absolute sum so far)."""
        groups = {"physics": _PHYSICS, "numerics": ("integration", "defect"), "projection": ("projection",)}
        out = {}
        for group, names in groups.items():
            work = sum((self._cumulative(name) for name in names), np.zeros(self.t.size))
            out[group] = float(work[-1]), float(np.abs(work).max())
        return out

    def worst(self) -> dict[str, float]:
        """Largest |defect| [J], Gauss bound [√J] and shift [m/s], residual [m/s] and penetration [m].

        The penetration is that of the recorded gaps; `nsdyn.check` finds the true overlaps.
        """
        return {
            "defect": _largest(np.abs(self.energy.defect)),
            "gauss_bound": _largest(self.gauss.bound),
            "gauss_shift": _largest(self.gauss.shift),
            "residual": _largest(self.solver.residual),
            "penetration": _largest(-self.columns["contacts/gap"]),
        }

    def _active_works(self) -> list[str]:
        """Works of more than round-off, without the defect."""
        works = {name: np.abs(self._cumulative(name)).max() for name in _WORKS if name != "defect"}
        return [name for name, work in works.items() if work > 1e-9 * max(self.at_play, 1e-300, *works.values())]

    def _cumulative(self, work: str) -> Array:
        """Work from 0 to t, shape (n + 1,)."""
        return np.concatenate([[0.0], np.cumsum(self.columns[f"energy/{work}"])])

    def __repr__(self) -> str:
        return (
            f"<Trajectory of {self.meta['scene_name']!r}: {self.steps} steps of {self.dt:g} s, "
            f"{len(self.scene['frames'])} moving bodies>"
        )


def _largest(values: ArrayLike) -> float:
    """Maximum of non-negative numbers, 0 if there are none; NaN if one is."""
    return float(np.max(values, initial=0.0))
