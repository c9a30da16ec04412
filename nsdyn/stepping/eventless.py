"""Steps without an event: bodies in flight, and bodies that rest, slide or roll on each other.

One kernel replaces the stages of `nsdyn.stepping.move`. Python computes the motion of trees and calls the user's
functions (`nsdyn.stepping.tree_motion`). If a step meets an event, its computed part becomes the step's first move.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from nsdyn._kernels.stepping import columns as _col
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import take
from nsdyn.dynamics.values import Placement
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.gauss import Certificate, SlaterDirection
from nsdyn.stepping.active_set import time_of_impact
from nsdyn.stepping.attempt import Known
from nsdyn.stepping.flat_state import FlatState, Found, detected_at, matrices, vectors, velocity
from nsdyn.stepping.indeterminacy import FEW, Paradoxes
from nsdyn.stepping.kernel_result import KernelResult
from nsdyn.stepping.midpoint import Loads, midpoint
from nsdyn.stepping.move_kernel import MoveKernel
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.stepping.state import State
from nsdyn.stepping.tree_motion import TreeMotion
from nsdyn.tools.arrays import NONE, NOTHING, Array

NOTHING_TRIED = None, None, None

Certify = Callable[[FC3D, Array, Array, SlaterDirection | None], tuple[Certificate, SlaterDirection | None]]

PAUSE = 16
"""Most steps made by the stages in Python after steps with events, before the kernel is tried again."""

ASKS = 50
"""Steps between two checks whether the kernel of eventless steps has been compiled."""


class EventlessSteps:
    """Eventless steps by a kernel: steps without an impact, an overlap or an end of slip.

    With `polish` no certificate of the kernel is accepted. `loads` gives the user's callbacks at a time [s]. A step
    with one of the `paradoxes` is left to the general step.
    """

    def __init__(self, system: System, mover: MoveKernel, polish: bool, loads: Loads, paradoxes: Paradoxes) -> None:
        self._system, self._mover, self._moves, self._asked = system, mover, False, 0
        self._loads, self._paradoxes = loads, paradoxes
        mover.numbers[_col.FEWEST] = FEW if paradoxes.possible else -1.0
        self._length = system.dt, system.depth
        self._tried: tuple[FlatState | None, KernelResult | None, TreeMotion | None] = NOTHING_TRIED
        self._pause = self._left = 0
        if polish:
            mover.numbers[_col.WEAK] = math.nan

    def step(self, now: State | FlatState, certify: Certify) -> tuple[FlatState, FlatState] | None:
        """Return the state and the next one; None if the step may have an event, or a recent step had one."""
        self._tried = NOTHING_TRIED
        if self._left > 0:
            self._left -= 1
            return None
        old = now if isinstance(now, FlatState) else FlatState.of(now, self._mover.wide)
        if old is not None:
            if not (MoveKernel.ready or self._is_ready(old)):
                return None
            if (new := self._next(old, certify)) is not None:
                self._pause = 0
                return old, new
            # Larger scenes reuse little of the move.
            if self._tried[1] is not None and OPTIONS.event * old.found.nc <= OPTIONS.work:
                self._pause = 0
                return None
        self._left, self._pause = self._pause, min(2 * self._pause + 1, PAUSE)
        return None

    def begun(self, state: State) -> Known:
        """Return the part of the step from a state that the last attempt has already computed."""
        s, (old, made, motion) = self._system, self._tried
        if old is not None:
            self._mover.given = state.instant, ((old.floats, old.acted, old.status), old.found)
        if made is None:
            return None if motion is None else motion.mid
        return made.values(s, state.instant, state.next_t - s.dt, s.dt, motion)

    def _next(self, old: FlatState, certify: Certify) -> FlatState | None:
        """Return the next state; None if the step may have an event."""
        s = self._system
        t = old.origin + (old.count + 1) * old.dt - s.dt
        callbacks = self._loads(t + (1.0 - s.theta) * s.dt)
        if not s.dynamics.trees and callbacks is None:
            if (made := self._made(old, old.found, None)) is None:
                return None
            return self._told(old, made, old.like, None, certify)
        begin = old.begin()
        motion = TreeMotion(begin, midpoint(s, begin, t, s.dt, callbacks))
        self._tried = old, None, motion
        while True:
            # Contact Jacobians of trees change with every motion; a copy keeps those of the last step, read later.
            found = old.found.anew() if s.dynamics.trees else old.found
            if not motion.meets_nothing() or (made := self._made(old, found, motion)) is None:
                return None
            if (again := motion.corrected(callbacks)) is None:
                break
            motion, callbacks = again, None
        b, size = made.floats[_col.RESULTS :], (s.dynamics.frames, s.dynamics.n)
        where = detected_at(b, _col.DETECTED_AT, size[0])
        if (like := motion.ended(velocity(b, _col.V, size), where, old.of_trees)) is None:
            return None
        return self._told(old, made, like, motion, certify)

    def _made(self, old: FlatState, found: Found, motion: TreeMotion | None) -> KernelResult | None:
        """Return the step made by the kernel; None if it meets an event, whose computed part is then kept."""
        direction = old.slater.d if old.slater else NOTHING
        begun = old.floats, old.acted, old.status
        made = self._mover(begun, found, self._length, direction, NONE, True, self._moves, motion)
        if made is not None:
            some = made.floats[_col.WENT] or made.floats[_col.GOES] or made.head[_col.SOME]
            self._moves = bool(some)
            if not made.whole:
                if motion is self._tried[2]:  # not with the callbacks' values at the mean velocity
                    self._tried = old, made, motion
                return None
        return made

    def _told(
        self, old: FlatState, made: KernelResult, like: SceneState, motion: TreeMotion | None, certify: Certify
    ) -> FlatState | None:
        """Return the kernel's result as a state with its certificate; None if bodies pass through each other.

        None also for an energy that is not finite, and for a paradox.
        """
        floats = made.floats
        if not math.isfinite(floats[_col.KINETIC] + floats[_col.POTENTIAL]):
            return None
        state = floats, made.acted, made.status, made.active, made.end, old.slater, like, motion
        out = FlatState(old.origin, old.dt, old.count + 1, *state)
        if made.head[_col.FAST] and self._passes(old, out, made):
            return None
        if floats[_col.CERTIFIED] and not floats[_col.SUSPECT]:
            return out
        problem, solution = out.solved(self._system.dynamics, self._system.solver.tol)
        if floats[_col.SUSPECT] and self._paradoxes.paradox(problem, solution, out.dt, out.coordinate(_col.RATE)):
            return None
        if not floats[_col.CERTIFIED]:
            certificate, slater = certify(problem, solution.r, solution.u, old.slater)
            floats[_col.GAP : _col.WENT] = certificate
            out = out._replace(slater=slater)
        return out

    def _passes(self, old: FlatState, new: FlatState, made: KernelResult) -> bool:
        """Whether bodies touch within the step without a contact of the active set (a missed contact)."""
        s, n, w = self._system, self._system.dynamics.frames, made.work
        there = Placement(vectors(w, _col.X, n), matrices(w, _col.R, n), ())
        places, reach = (old.place, there, new.place), w[_col.REACH * n : _col.DETECTED_THERE * n]
        contacts = old.found.contacts(), take(new.active.contacts(), new.status > 0), new.found.contacts()
        turns = (1.0 - s.theta) * s.dt * old.twists[1], s.theta * s.dt * new.twists[1]
        return time_of_impact(s, contacts, places, turns, made.found.contacts(), s.dt, reach / (s.theta * s.dt)) < s.dt

    def _is_ready(self, old: FlatState) -> bool:
        """Whether the kernel is compiled. Compiling takes half a minute; general steps replace the kernel meanwhile."""
        self._asked += 1
        if self._asked % ASKS != 1:
            return False
        return self._mover.is_ready((old.floats, old.acted, old.status), old.found)
