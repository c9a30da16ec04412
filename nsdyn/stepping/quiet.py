"""Steps of free bodies that meet no event: what rests, slides and rolls on what it touches, and what flies.

One call of a kernel in place of the stages of `nsdyn.stepping.move`, which begins again where anything else shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from nsdyn._kernels.compiled import is_ready
from nsdyn._kernels.packing import pack
from nsdyn._kernels.stepping import columns as _col
from nsdyn._kernels.stepping import quiet as _quiet
from nsdyn.collision.contacts import ContactMemory, Poses
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.gauss import WEAK, Certificate, Opening
from nsdyn.solvers.auto import LIMITS, Auto
from nsdyn.stepping.flat import Flat, Found
from nsdyn.stepping.instant import FAST, NOTHING, STILL, System
from nsdyn.stepping.sight import touched
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Quiet"]

Certify = Callable[[FC3D, Array, Array, Opening | None], tuple[Certificate, Opening | None]]

Rooms = tuple[tuple[Array, Index], ...]

PAUSE = 16
"""Most steps that are made by stages after some that were not quiet, before the kernel is asked again."""

ASKS = 50
"""Steps after which it is asked again whether the kernel of quiet steps is compiled."""


class Quiet:
    """Steps of free bodies under gravity alone, in one call of a kernel as long as they meet no event.

    Nothing strikes or overlaps, and no slip turns round.

    Parameters
    ----------
    system : System
    polish : bool
        Whether certificates are polished: no one of the kernel is then enough.
    """

    def __init__(self, system: System, polish: bool) -> None:
        s, d, solver = system, system.dynamics, system.solver
        closing, own = s.closing(s.dt, False), isinstance(solver, Auto)
        moments, axes, inverse_mass, inverse_J, radius = d.bodies
        block_of_frame, offset, m_start, m, minv = d.masses
        numbers = (
            d.weight,
            s.dt,
            s.theta,
            s.closed,
            closing.shallow,
            closing.until,
            s.depth,
            FAST * s.smallest,
            s.slow,
            STILL * s.closed,
            s.elastic,
            *s.bounces,
            solver.tol,
            own,
            *(solver.aims if isinstance(solver, Auto) else (0.0, 0.0)),
            *LIMITS,
            math.nan if polish else WEAK,
            s.inscribed.size,
        )
        floats = [moments, axes, inverse_mass, inverse_J, radius, d.mass, d.J, m, minv, d.gravity, d.no_load, s.arm]
        floats += [d.nowhere, s.inscribed, np.array(numbers, dtype=float)]
        self._system = s
        self._arrays, self._solver, self._detector = (
            pack(floats, [block_of_frame, offset, m_start])[:2],
            solver,
            s.detector,
        )
        self._dynamics, self._size, self._moved, self._work = d, d.free, False, _room(d.free, 0)
        self._most, self._ready, self._asked = 0, False, 0
        self._pause = self._left = 0

    def step(self, now: State | Flat, certify: Certify) -> tuple[Flat, Flat] | None:
        """The state and the next one; None where more may happen, or is likely to, as it did in the steps before."""
        if self._left > 0:
            self._left -= 1
            return None
        old = now if isinstance(now, Flat) else Flat.of(now)
        if old is not None:
            if not (self._ready or self._is_ready(old)):
                return None
            if (new := self._next(old, certify)) is not None:
                self._pause = 0
                return old, new
        self._left, self._pause = self._pause, min(2 * self._pause + 1, PAUSE)
        return None

    def _next(self, old: Flat, certify: Certify) -> Flat | None:
        """The next state, None where more may happen."""
        n, detector = self._size, self._detector
        before, direction = tuple(old[3:6]), old.opening.d if old.opening else NOTHING
        self._most = max(self._most, old.found.nc)
        new, rooms = self._rooms()
        stage, ready = 0, False
        while True:
            floats, head = new[0], self._work[1]
            code = _quiet.quiet(
                self._arrays,
                detector.searches,
                before,
                tuple(old.found),
                new,
                rooms,
                old.next_key,
                direction,
                self._work,
                stage,
                ready,
                detector.asks,
            )
            if code in (_quiet.DONE, _quiet.OTHERWISE):
                break
            if code == _quiet.MORE:
                self._most, self._moved = max(self._most, int(head[_col.NEEDED])), True
                new, rooms = self._rooms()
                stage, ready = 0, False
                continue
            nc = int(head[_col.MET])
            middle, some, _ = rooms
            met = Found(*some).of(nc) if head[_col.SOME] else Found(*middle).of(nc) if floats[_col.WENT] else old.found
            if code == _quiet.SOLVE:
                if not self._solve(met, floats, nc):
                    return None
            else:
                detector.ask(*self._looked(floats, code, n))
            stage, ready = code, True
        self._moved = bool(floats[_col.WENT] or floats[_col.GOES] or head[_col.SOME])
        if code == _quiet.OTHERWISE or not math.isfinite(floats[_col.KINETIC] + floats[_col.POTENTIAL]):
            return None
        out = self._made(old, certify, new, rooms)
        middle = Found(*rooms[0]).of(int(head[_col.MIDDLE])) if floats[_col.WENT] else old.found
        return None if head[_col.FAST] and self._passes(old, out, middle) else out

    def _made(self, old: Flat, certify: Certify, new: tuple[Array, Index, Any], rooms: Rooms) -> Flat:
        """The state that the kernel has made, as large as it is."""
        (floats, acted, status), (middle, some, end), head = new, (Found(*room) for room in rooms), self._work[1]
        nc, n = int(head[_col.MET]), self._size
        found = middle.of(int(head[_col.MIDDLE])) if floats[_col.WENT] else old.found
        met, goes = some.of(nc) if head[_col.SOME] else found, floats[_col.GOES] > 0.0
        out = old._replace(
            count=old.count + 1,
            floats=floats[: _col.RESULTS + _col.BODY * n + _col.CONTACT * nc],
            acted=acted[: 2 * nc],
            status=status[:nc],
            met=met,
            found=end.of(int(head[_col.END])) if goes else found,
            next_key=int(head[_col.KEY_END if goes else _col.KEY_MIDDLE]),
        )
        if not floats[_col.CERTIFIED]:
            solution = out.solution(self._solver.tol)
            certificate, opening = certify(out.problem(self._dynamics), solution.r, solution.u, old.opening)
            floats[_col.GAP : _col.WENT] = certificate
            out = out._replace(opening=opening)
        return out

    def _passes(self, old: Flat, new: Flat, middle: Found) -> bool:
        """Whether anything touches on its way what it is not seen to meet; it found the contacts `middle` on it."""
        s, n, w = self._system, self._size, self._work[0]
        there = Poses(w[: 3 * n].reshape(n, 3), w[_col.R_THERE * n : _col.V_THERE * n].reshape(n, 3, 3))
        places, reach = (old.poses, there, new.poses), w[_col.REACH * n : _col.LOOKED_THERE * n]
        memory = ContactMemory(middle.names, middle.points, new.next_key)
        own = old.found.contacts(), new.found.contacts(), places, memory
        return touched(s, *own, s.dt, reach / (s.theta * s.dt)) < s.dt

    def _rooms(self) -> tuple[tuple[Array, Index, Any], Rooms]:
        """Room for a state, and for what is found on the way there if anything moves."""
        n, nc = self._size, self._most
        if self._work[2].shape[1] != nc:
            self._work = _room(n, nc)
        floats = np.empty(_col.RESULTS + _col.BODY * n + _col.CONTACT * nc)
        new = floats, np.empty(2 * nc, np.int64), np.empty(nc, np.int8)
        most = nc if self._moved else 0
        return new, tuple([tuple(Found.room(most)) for _ in range(3)])

    def _is_ready(self, old: Flat) -> bool:
        """Whether the kernel is compiled: that takes half a minute, in which general steps do the same.

        It does not begin before these have what they need: two processes on one core would wait for each other.
        """
        self._asked += 1
        if self._asked % ASKS != 1:
            return False
        state, found, detector = tuple(old[3:6]), tuple(old.found), self._detector
        direction, rooms = old.opening.d if old.opening else NOTHING, (found, found, found)
        given = self._arrays, detector.searches, state, found, state, rooms, old.next_key, direction, self._work
        self._ready = is_ready(_quiet.quiet, self._asked > 1, *given, 0, False, detector.asks)
        return self._ready

    def _looked(self, floats: Array, code: int, n: int) -> tuple[Array, Array, Array]:
        """Where contacts are looked for, (x, R, reach) of all bodies."""
        columns = self._work[0][_col.LOOKED_THERE * n :]
        if code == _quiet.LOOK_AHEAD:
            columns = floats[_col.RESULTS + _col.LOOKED * n :]
        return columns[: 3 * n].reshape(n, 3), columns[3 * n : 12 * n].reshape(n, 3, 3), columns[12 * n : 13 * n]

    def _solve(self, met: Found, floats: Array, nc: int) -> bool:
        """Solve the problem of a step where the kernel does not; whether that is an answer."""
        own, a = self._work[0][_col.BODY_WORK * self._size :], floats[_col.RESULTS + _col.BODY * self._size :]
        b = a[_col.FREE * nc : _col.U_END * nc]
        blocks, norm = met.blocks(self._dynamics), float(floats[_col.NORM])
        problem = FC3D.prepared(blocks, b, met.scalars[1], met.scales, norm)
        solution = self._solver(problem, own[(_col.LOCAL + 12) * nc : (_col.LOCAL + 15) * nc])
        if not solution.accepted:
            return False
        a[_col.IMPULSE * nc : _col.U * nc], a[_col.U * nc : _col.FREE * nc] = solution.r, solution.u
        floats[_col.ERROR : _col.CERTIFIED] = solution[3:7]
        return True


def _room(n: int, nc: int) -> tuple[Array, Index, Bools]:
    """What the kernel needs to work with so many bodies and contacts."""
    floats = np.empty(_col.BODY_WORK * n + _col.CONTACT_WORK * nc)
    return floats, np.empty(_col.HEAD + nc, np.int64), np.empty((_col.FLAGS, nc), np.bool_)
