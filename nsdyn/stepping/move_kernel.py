"""Moves in one call of the kernel `nsdyn._kernels.stepping.eventless`; motion of trees, user forces are in Python."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from nsdyn._kernels.compiled import is_ready
from nsdyn._kernels.packing import pack
from nsdyn._kernels.stepping import columns as _col
from nsdyn._kernels.stepping import eventless as _eventless
from nsdyn._kernels.stepping import eventless_contacts as _contacts
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.problem.gauss import WEAK
from nsdyn.problem.solution import Solution
from nsdyn.solvers.auto import LIMITS, Auto
from nsdyn.stepping.attempt import Attempt
from nsdyn.stepping.flat_state import Acted, Found, detected_at, local, packed, put, solved, velocity
from nsdyn.stepping.kernel_result import KernelResult
from nsdyn.stepping.midpoint import Midpoint
from nsdyn.stepping.scene_state import STILL, SceneState, System
from nsdyn.stepping.solving import again, grips
from nsdyn.stepping.tree_motion import TreeMotion
from nsdyn.tools.arrays import NONE, NOTHING, Array, Bools, Index

Rooms = tuple[tuple[Array, Index], tuple[Array, Index], tuple[Array, Index]]


class MoveKernel:
    """Moves of a system: free bodies under gravity alone, or with a `TreeMotion` trees and bodies under other forces.

    Parameters
    ----------
    s : System

    Attributes
    ----------
    given : (SceneState, (Acted, Found))
        The state where the last move began, and the same state in the kernel's layout.
    """

    ready: ClassVar[bool] = False
    """Whether the kernel is compiled. Compiling takes half a minute; general moves replace the kernel meanwhile."""

    def __init__(self, s: System) -> None:
        d, solver = s.dynamics, s.solver
        _, shallow, _, until = s.gap_rule(s.dt, False)
        node, offset, m_start, m, minv = d.masses
        self.wide = 6 * int(np.diff(offset).max())
        own, aims = (True, solver.aims) if isinstance(solver, Auto) else (False, (solver.tol, solver.tol))
        scheme = d.weight, s.dt, s.theta, s.gap_tol, shallow, until, s.depth
        lengths = OPTIONS.unseen * s.smallest, s.least_penetration, STILL * s.gap_tol
        solving = solver.tol, own, *aims, *LIMITS, WEAK
        numbers = *scheme, *lengths, s.elastic, *s.bounces, *solving, s.inscribed.size, self.wide, -1.0, 0.0
        full = int(np.square(np.diff(offset)).sum())
        floats = [*d.bodies, d.mass, d.J, np.empty(full), np.empty(full)]
        fields = np.empty((d.n - 6 * d.free, 6))
        floats += [d.gravity, d.no_load[0], d.radii, d.nowhere, s.inscribed, s.rounding, fields, fields]
        floats.append(np.array(numbers, dtype=float))
        *packed, views, _ = pack(floats, [node, offset, m_start, *d.linkages])
        self._arrays, self.numbers = tuple(packed), views[-1]
        self._views = views
        for view, given in zip(views[_col.M : _col.MINV + 1], (m, minv), strict=True):
            view[: given.size] = given
        self._dynamics, self._solver, self._detector, self._size = d, solver, s.detector, (d.frames, d.n)
        self._smallest, self._dt, self._length, self._most = s.smallest, s.dt, (s.dt, s.depth), 0
        n, nv = self._size
        self._acted = _col.RESULTS + _col.FRAME * n + _col.COORDINATE * nv
        self._own = _col.FRAME_WORK * n + _col.COORDINATE_WORK * nv
        self._work, self._none = self._for_work(0), (self._room(0),) * 3
        self._solution: Solution | None = None
        self.given: tuple[SceneState | None, tuple[Acted, Found] | None] = None, None

    def __call__(
        self,
        old: Acted,
        begun: Found,
        length: tuple[float, float],
        direction: Array = NOTHING,
        located: Index = NONE,
        step: bool = False,
        moves: bool = True,
        motion: TreeMotion | None = None,
    ) -> KernelResult | None:
        """Return a move from a state; None if the kernel cannot make it.

        Parameters
        ----------
        old : Acted
            The state.
        begun : Found
            The contacts there.
        length : (float, float)
            How long the move lasts, s, and `System.depth`.
        direction, located, step
            As in the kernel.
        moves : bool
            Whether frames probably move: memory for newly found contacts is then allocated at once.
        motion : TreeMotion, optional
            The motion of trees, or the motion under the user's forces.
        """
        detector, constrained = self._detector, self._dynamics.constrained
        if constrained and begun.nc:  # with closed loops problems use reduced coordinates
            return None
        self.numbers[_col.GIVEN] = motion is not None
        self._set(length)
        self._most = max(self._most, begun.nc)
        code, room = _contacts.MORE, moves
        while True:
            if code == _contacts.MORE:
                new, rooms, work = self._rooms(room, step)
                if motion is not None:
                    self._load(motion, work[0])
                stage, ready, head = _contacts.DONE, False, work[1]
            code = _eventless.eventless_step(
                self._arrays,
                detector.searches,
                old,
                begun[:2],
                new,
                rooms,
                begun.next_key,
                direction,
                located,
                work,
                (stage, ready, detector.asks, step),
            )
            if code in (_contacts.DONE, _contacts.EVENT):
                if code == _contacts.EVENT:  # the values of this move are views of the work arrays
                    self._work = self._for_work(0)
                if constrained and head[_col.ACTIVE]:
                    return None
                if motion is not None:
                    motion.v = velocity(work[0], _col.V_PLUS, self._size).copy()
                return self._made(new, rooms, work, begun, code == _contacts.DONE)
            if code == _contacts.MORE:
                self._most, room = max(self._most, int(head[_col.NEEDED])), True
                continue
            if code == _contacts.SOLVE:
                good = not constrained and self._solve(self._made(new, rooms, work, begun, False))
            else:
                good = self._go_on(code, motion, new[0], work[0])
            if not good:
                return None
            stage, ready = code, True

    def _go_on(self, code: int, motion: TreeMotion | None, floats: Array, work: Array) -> bool:
        """Do the work in Python that a return code of the kernel requests, except a solve; whether the move goes on."""
        if code == _contacts.OTHERWISE:
            return False
        if code == _contacts.MOVE:
            return motion is not None and self._move(motion, floats, work)
        ahead = code == _contacts.DETECT_AHEAD
        columns = floats[_col.RESULTS :] if ahead else work
        self._detector.ask(*detected_at(columns, _col.DETECTED_AT if ahead else _col.DETECTED_THERE, self._size[0]))
        return True

    def _load(self, motion: TreeMotion, work: Array) -> None:
        """Copy the midpoint of a motion into the kernel's arrays: positions, velocities, mass matrices, Jacobians."""
        mid, n, views = motion.mid, self._size[0], self._views
        (x, R, links), forces = mid.state.placement, mid.forces
        put(work, _col.X, n, x)
        put(work, _col.R, n, R)
        velocity(work, _col.V_THERE, self._size)[:] = mid.state.v
        velocity(work, _col.V_FREE, self._size)[:] = forces.v
        views[_col.M][:], views[_col.MINV][:] = forces.m, forces.minv
        if self._dynamics.free:
            put(work, _col.QUATERNION, n, mid.state.position.quaternion)
        first = 0
        for begun, there in zip(motion.begun, links, strict=True):
            last = first + there.J.shape[1]
            views[_col.BEGUN][first:last], views[_col.JACOBIAN][first:last] = begun.J.T, there.J.T
            first = last

    def _move(self, motion: TreeMotion, floats: Array, work: Array) -> bool:
        """Move the scene from the midpoint to the end of its step, into `floats`; whether this succeeds."""
        n, b = self._size[0], floats[_col.RESULTS :]
        found = motion.end(
            velocity(work, _col.V_PLUS, self._size).copy(), velocity(work, _col.PUSHED, self._size).copy()
        )
        if found is None:
            return False
        position, v, (x, R, _), (linear, angular) = found
        if self._dynamics.free:
            put(b, _col.QUATERNION, n, position.quaternion)
        for column, values in ((_col.X, x), (_col.R, R), (_col.LINEAR, linear), (_col.ANGULAR, angular)):
            put(b, column, n, values)
        velocity(b, _col.V, self._size)[:] = v
        return True

    def respond(
        self, s: System, begin: SceneState, t: float, h: float, located: Index, mid: Midpoint | None = None
    ) -> Attempt | None:
        """Return the move of h s from the time t, `located` as in `try_move`; None if the kernel cannot make it.

        With trees, or forces of the user, the first half `mid` is given.
        """
        if not MoveKernel.ready:
            return None
        motion = None if mid is None else TreeMotion(begin, mid)
        if motion is not None and motion.has_rows():
            return None
        if self.given[0] is not begin:
            self.given = begin, packed(begin, begin.v, self.wide)
        if (given := self.given[1]) is None:
            return None
        old, begun = given
        begun = begun.anew() if self._dynamics.trees else begun
        made = self(old, begun, (h, s.depth), located=located, motion=motion)
        return None if made is None else made.values(s, begin, t, h, motion)

    def _set(self, length: tuple[float, float]) -> None:
        """Set the length (h [s], depth) of the moves to come."""
        if length == self._length:
            return
        (h, depth), num, self._length = length, self.numbers, length
        num[_col.STEP], num[_col.DEPTH], num[_col.LEAST_PENETRATION] = h, depth, depth * self._smallest
        num[_col.UNTIL] = num[_col.THETA] * h + (1.0 - num[_col.THETA]) * self._dt

    def is_ready(self, old: Acted, begun: Found) -> bool:
        """Whether the kernel is compiled; if not, another process compiles it."""
        found, detector = begun[:2], self._detector
        given = self._arrays, detector.searches, old, found, old, (found, found, found), 0, NOTHING, NONE
        work = self._rooms(False, False)[2]
        MoveKernel.ready = is_ready(
            _eventless.eventless_step, *given, work, (_contacts.DONE, False, detector.asks, False)
        )
        return MoveKernel.ready

    def _rooms(self, moves: bool, step: bool) -> tuple[Acted, Rooms, tuple[Array, Index, Bools]]:
        """Allocate memory for a state, for the contacts found during the move if frames move, and for work arrays."""
        nc, work = self._most, self._work
        if not step or work[2].shape[1] != nc:  # a step keeps nothing of its work arrays
            work = self._for_work(nc)
        if step:
            self._work = work
        new = np.empty(self._acted + _col.CONTACT * nc), np.empty(2 * nc, np.int64), np.empty(nc, np.int8)
        return new, (self._room(nc), self._room(nc), self._room(nc)) if moves else self._none, work

    def _room(self, nc: int) -> tuple[Array, Index]:
        """Allocate memory for `nc` contacts of one detection."""
        return np.empty((_col.ROWS + self.wide) * nc), np.empty(_col.FOUND_NAMES * nc + 2, np.int64)

    def _for_work(self, nc: int) -> tuple[Array, Index, Bools]:
        """Allocate the work arrays for `nc` contacts."""
        own = np.empty(self._own + _col.CONTACT_WORK * nc)
        return own, np.empty(_col.HEAD + 2 * nc, np.int64), np.empty((_col.FLAGS, nc), np.bool_)

    def _made(
        self,
        new: Acted,
        rooms: Rooms,
        work: tuple[Array, Index, Bools],
        begun: Found,
        whole: bool,
    ) -> KernelResult:
        """Return the move as computed so far, its arrays cut to the number of contacts."""
        (floats, acted, status), (own, head, flags) = new, work
        nc, went, goes = int(head[_col.ACTIVE]), floats[_col.WENT] > 0.0, floats[_col.GOES] > 0.0
        found = Found(*rooms[0], int(head[_col.KEY_MIDDLE])).of(int(head[_col.MIDDLE])) if went else begun
        if nc != status.size:
            floats, acted, status = floats[: self._acted + _col.CONTACT * nc], acted[: 2 * nc], status[:nc]
        return KernelResult(
            floats,
            acted,
            status,
            own,
            head,
            flags,
            found,
            Found(*rooms[1], found.next_key).of(nc) if head[_col.SOME] else found,
            Found(*rooms[2], int(head[_col.KEY_END])).of(int(head[_col.END])) if goes else found,
            whole,
        )

    def _solve(self, made: KernelResult) -> bool:
        """Solve the contact problem of a step that the kernel leaves to Python; whether the solution is accepted."""
        nc, floats, active, masses = made.status.size, made.floats, made.active, self._views[_col.M : _col.MINV + 1]
        begun, *_, start = local(made.work[self._own :], _col.LOCAL, nc)
        a = floats[self._acted :]
        problem, _ = solved(floats, a, active, active.blocks(self._dynamics, (masses[0], masses[1])), self._solver.tol)
        last = self._solution if made.head[_col.SOLVED] else None
        solution = self._solution = again(self._solver, last, problem, start, begun, math.inf)
        if not solution.accepted or grips(problem, solution):
            return False
        made.head[_col.SOLVED] = 1
        a[_col.IMPULSE * nc : _col.U * nc], a[_col.U * nc : _col.FREE * nc] = solution.r, solution.u
        floats[_col.ERROR : _col.CERTIFIED] = solution[3:7]
        return True
