"""Steps of free bodies that meet nothing new: what rests, slides and rolls on what it touches, and what flies.

One call of a kernel in place of the stages of `nsdyn.stepping.move`, which begins again where anything else shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from nsdyn._kernels.compiled import is_ready
from nsdyn._kernels.packing import pack
from nsdyn._kernels.stepping import quiet as _quiet
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.gauss import WEAK, Certificate, Opening
from nsdyn.solvers.auto import LIMITS, Auto
from nsdyn.stepping.flat import Flat, Found
from nsdyn.stepping.instant import FAST, NOTHING, STILL, System
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Quiet"]

Certify = Callable[[FC3D, Array, Array, Opening | None], tuple[Certificate, Opening | None]]

PAUSE = 16
"""Most steps that are made by stages after some that were not quiet, before the kernel is asked again."""

ASKS = 50
"""Steps after which it is asked again whether the kernel of quiet steps is compiled."""


class Quiet:
    """Steps of free bodies under gravity alone, in one call of a kernel as long as nothing is met.

    Nothing strikes, opens, closes or overlaps, and what slides goes on to.

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
        floats += [d.nowhere, np.array(numbers, dtype=float)]
        self._arrays, self._solver, self._detector = (
            pack(floats, [block_of_frame, offset, m_start])[:2],
            solver,
            s.detector,
        )
        self._dynamics, self._size, self._moved, self._work = d, d.free, False, _room(d.free, 0)
        self._none, self._ready, self._asked = Found.room(0), False, 0
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
        n, nc, detector = self._size, old.found.nc, self._detector
        if self._work[1].size != 2 * nc + 2:
            self._work = _room(n, nc)
        floats = np.empty(_quiet.RESULTS + _quiet.BODY * n + _quiet.CONTACT * nc)
        new = floats, np.empty(2 * nc, np.int64), np.empty(nc, np.int8)
        middle = end = Found.room(nc) if self._moved else self._none
        if self._moved:
            end = Found.room(nc)
        before, direction = tuple(old[3:6]), old.opening.d if old.opening else NOTHING
        stage, ready, looks = 0, False, 0
        while True:
            code = _quiet.quiet(
                self._arrays,
                detector.searches,
                before,
                tuple(old.found),
                new,
                tuple(middle),
                tuple(end),
                old.next_key,
                direction,
                self._work,
                stage,
                ready,
                detector.asks,
            )
            if code in (_quiet.DONE, _quiet.OTHERWISE):
                break
            if code == _quiet.SOLVE:
                looks = 0
                if not self._solve(old, middle if floats[_quiet.WENT] else old.found, floats, n, nc):
                    return None
            else:
                looks = looks + 1 if code == stage else 1
                if middle is self._none:
                    middle, end = Found.room(nc), Found.room(nc)
                ready = detector.asks or looks > 1
                if ready:
                    detector.ask(*self._looked(floats, code, n))
            stage = code
        self._moved = bool(floats[_quiet.WENT] or floats[_quiet.GOES])
        if code == _quiet.OTHERWISE or not math.isfinite(floats[_quiet.KINETIC] + floats[_quiet.POTENTIAL]):
            return None
        met = middle if floats[_quiet.WENT] else old.found
        out = old._replace(
            count=old.count + 1,
            floats=floats,
            acted=new[1],
            status=new[2],
            met=met,
            found=end if floats[_quiet.GOES] else met,
        )
        if not floats[_quiet.CERTIFIED]:
            solution = out.solution(self._solver.tol)
            certificate, opening = certify(out.problem(self._dynamics), solution.r, solution.u, old.opening)
            floats[_quiet.GAP : _quiet.WENT] = certificate
            out = out._replace(opening=opening)
        return out

    def _is_ready(self, old: Flat) -> bool:
        """Whether the kernel is compiled: that takes half a minute, in which general steps do the same."""
        self._asked += 1
        if self._asked % ASKS != 1:
            return False
        state, found, detector = tuple(old[3:6]), tuple(old.found), self._detector
        direction = old.opening.d if old.opening else NOTHING
        given = self._arrays, detector.searches, state, found, state, found, found, old.next_key, direction, self._work
        self._ready = is_ready(_quiet.quiet, *given, 0, False, detector.asks)
        return self._ready

    def _looked(self, floats: Array, code: int, n: int) -> tuple[Array, Array, Array]:
        """Where contacts are looked for, (x, R, reach) of all bodies."""
        columns = self._work[0][_quiet.LOOKED_THERE * n :]
        if code == _quiet.LOOK_AHEAD:
            columns = floats[_quiet.RESULTS + _quiet.LOOKED * n :]
        return columns[: 3 * n].reshape(n, 3), columns[3 * n : 12 * n].reshape(n, 3, 3), columns[12 * n : 13 * n]

    def _solve(self, old: Flat, met: Found, floats: Array, n: int, nc: int) -> bool:
        """Solve the problem of a step where the kernel does not; whether that is an answer."""
        own, a = self._work[0][_quiet.BODY_WORK * n :], floats[_quiet.RESULTS + _quiet.BODY * n :]
        b = a[_quiet.FREE * nc : _quiet.U_END * nc]
        blocks, norm = met.blocks(self._dynamics), float(floats[_quiet.NORM])
        problem = FC3D.prepared(blocks, b, met.scalars[1], met.scales, norm)
        solution = self._solver(problem, own[(_quiet.LOCAL + 12) * nc : (_quiet.LOCAL + 15) * nc])
        if not solution.accepted:
            return False
        a[_quiet.IMPULSE * nc : _quiet.U * nc], a[_quiet.U * nc : _quiet.FREE * nc] = solution.r, solution.u
        floats[_quiet.ERROR : _quiet.CERTIFIED] = solution[3:7]
        return True


def _room(n: int, nc: int) -> tuple[Array, Index, Bools]:
    """What the kernel needs to work with so many bodies and contacts."""
    floats = np.empty(_quiet.BODY_WORK * n + _quiet.CONTACT_WORK * nc)
    return floats, np.empty(2 * nc + 2, np.int64), np.empty((4, nc), np.bool_)
