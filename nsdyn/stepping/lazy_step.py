"""Results of steps of the kernel, computed on demand: of one step, or of many together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nsdyn._kernels.stepping import columns as _col
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.ledger import Ledger, Works
from nsdyn.problem.gauss import Certificate
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.flat_state import FlatState
from nsdyn.stepping.state import OnBodies, State, Step
from nsdyn.tools.arrays import Array

if TYPE_CHECKING:
    from nsdyn.stepping.scene_state import System

COLUMNS: dict[str, tuple[int, ...]] = {
    "gap": (_col.GAP_END,),
    "u": (_col.U_END, 3),
    "r": (_col.IMPULSE, 3),
    "couple": (_col.COUPLE, 3),
    "work_normal": (_col.NORMAL_WORK,),
    "work_friction": (_col.FRICTION_WORK,),
}
"""Contact values of a step that are columns of a state: the first column, and the shape of the value of one contact."""


class LazyStep(NamedTuple):
    """Results of an eventless step, computed on demand, for one step or for many together.

    Attributes
    ----------
    flat : FlatState
        The state at the end.
    before : State or FlatState
        The state at the beginning.
    system : System
    """

    flat: FlatState
    before: State | FlatState
    system: System

    @property
    def nc(self) -> int:
        """Number of contacts."""
        return self.flat.status.size

    def told_with(self, name: str) -> dict[str, Any]:
        """Attributes of `Step` that are computed together with `name`: contacts, problem and solution, or the rest."""
        flat = self.flat
        if name in COLUMNS:
            return {name: _column(flat.contact(0, _col.CONTACT), self.nc, *COLUMNS[name])}
        if name in ("contacts", "frame", "contact_status", "contact_time", "contact_duration"):
            return _told(flat.active.contacts(), flat.active.frame, flat.status, self._times(self.nc))
        if name in ("problem", "solution"):
            problem, solution = flat.solved(self.system.dynamics, self.system.solver.tol)
            return {"problem": problem, "solution": solution}
        if name in ("ledger", "joints", "links"):
            works, joints, links = self._booked()
            ledger = Ledger.of(self.before.energies, self.flat.energies, works)
            return {"ledger": ledger, "joints": joints if self.system.dynamics.trees else None, "links": links}
        return self.told()

    def told(self) -> dict[str, Any]:
        """Return the state after the step and its other results, by the names of `Step`."""
        flat, d = self.flat, self.system.dynamics
        x, quaternion = d.poses(flat.position, flat.place)
        q, v = d.pinocchio_state(flat.position, flat.coordinate(_col.V))
        return {
            "q": q,
            "v": v,
            "frames_x": x,
            "frames_quat": quaternion,
            "pieces": None,
            "wrenches": self._wrenches(),
            "lifts": None,
            "created": 0.0,
            "gauss": Certificate(*flat.floats[_col.GAP : _col.WENT].tolist()),
            "twists": flat.twists,
        }

    def _booked(self) -> tuple[Works, Array, Array]:
        """Return the works, with those of trees and loads computed in Python, and `joints`, `links` as in `Step`."""
        flat, d = self.flat, self.system.dynamics
        own = Works(*flat.floats[_col.EXTERNAL : _col.NORM].tolist())
        if flat.motion is None:
            return own, d.no_impulses[1], d.no_push
        return flat.motion.told(own)

    def _wrenches(self) -> OnBodies | None:
        """External wrenches on the free bodies."""
        motion, ((time,), (duration,)) = self.flat.motion, self._times(1)
        return None if motion is None else OnBodies.of([(time, duration, motion.mid.wrench())])

    def _times(self, *shape: int) -> tuple[Array, Array]:
        """Times of the contact impulses, s after the beginning of the step, and its duration, as arrays of `shape`."""
        dt = self.flat.dt
        return np.full(shape, (1.0 - self.system.theta) * dt), np.full(shape, dt)

    @staticmethod
    def steps(some: Sequence[LazyStep]) -> Step:
        """Results of m steps of a scene without their contacts; arrays have a leading axis of m, `joints` (8, m)."""
        first, d, m, nothing = some[0].flat, some[0].system.dynamics, len(some), np.zeros(len(some))
        x = quaternion = joints = links = pieces = None
        booked = [one._booked() for one in some]
        if d.trees:
            told = [one.told() for one in some]
            q, v = (np.stack([t[name] for t in told]) for name in ("q", "v"))
            if d.frames > d.free:
                x, quaternion = (np.stack([t[name] for t in told]) for name in ("frames_x", "frames_quat"))
            joints, pieces = np.stack([joints for _, joints, _ in booked], axis=1), (None,) * m
            links = np.stack([links for *_, links in booked])
        else:
            columns = [
                np.concatenate([one.flat.frame(*of) for one in some]) for of in ((_col.X, 3), (_col.QUATERNION, 4))
            ]
            v = np.concatenate([one.flat.coordinate(_col.V) for one in some])
            q, v = (a.reshape(m, -1) for a in d.pinocchio_state(first.position.moved(*columns), v))
        works = Works(*np.array([works for works, *_ in booked]).T)
        before: Any = np.array([one.before.energies for one in some]).T
        results: Any = np.array([one.flat.floats[: _col.RESULTS] for one in some]).T
        after: Any = np.array([one.flat.energies for one in some]).T if d.trees else results[: _col.EXTERNAL]
        error, residual, count, time = results[_col.ERROR : _col.CERTIFIED]
        good = np.maximum(error, residual) <= some[0].system.solver.tol
        status: Any = np.where(good, Status.CONVERGED, Status.LOOSE).astype(np.int8)
        return Step(
            t=np.array([one.flat.t for one in some]),
            q=q,
            v=v,
            frames_x=x,
            frames_quat=quaternion,
            joints=joints,
            links=links,
            pieces=pieces,
            wrenches=[one._wrenches() for one in some],
            lifts=[None] * m,
            created=nothing,
            ledger=Ledger.of(before, after, works),
            gauss=Certificate(*results[_col.GAP : _col.WENT]),
            solution=Solution(nothing, nothing, status, error, residual, count.astype(np.int64), time),
        )

    @staticmethod
    def contacts(some: Sequence[LazyStep]) -> Step:
        """The contacts of m steps of a scene with nc each, every array with leading axes (m, nc) or (1, nc)."""
        m, nc, active = len(some), some[0].nc, [one.flat.active for one in some]
        if all(each is active[0] for each in active):  # bodies at rest keep their contacts
            active = active[:1]
        names, points, scalars, next_keys = zip(*(each.contacts() for each in active), strict=True)
        arrays = np.stack(names, axis=1), np.stack(points, axis=1), np.stack(scalars, axis=1)
        found = ContactSet(*arrays, max(next_keys))
        frame = np.stack([each.frame for each in active])
        acted = np.concatenate([one.flat.contact(0, _col.CONTACT) for one in some]).reshape(m, -1)
        status = np.concatenate([one.flat.status for one in some]).reshape(m, nc)
        columns = {name: _column(acted, nc, *of) for name, of in COLUMNS.items()}
        return Step(**_told(found, frame, status, some[0]._times(1, nc)), **columns)


def _column(source: Array, nc: int, column: int, *shape: int) -> Array:
    """Columns of nc contacts from `column` on, in `shape` per contact, of one state or of many with a leading axis."""
    return source[..., column * nc : (column + math.prod(shape)) * nc].reshape(*source.shape[:-1], nc, *shape)


def _told(contacts: ContactSet, frame: Array, status: Any, times: tuple[Array, Array]) -> dict[str, Any]:
    """Contacts of a step, or of many with an axis before that of the contacts, by the names of `Step`."""
    return {
        "contacts": contacts,
        "frame": frame,
        "contact_status": status,
        "contact_time": times[0],
        "contact_duration": times[1],
    }
