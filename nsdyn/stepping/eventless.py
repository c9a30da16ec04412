"""Steps that meet no event: what rests, slides and rolls on what it touches, and what flies.

A kernel in place of the stages of `nsdyn.stepping.move`. Python makes the motion of trees and asks the user's functions
(`nsdyn.stepping.tree_motion`). What has been made of a step that meets an event is the first move of that step.
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
from nsdyn.stepping.move_kernel import NO_PAIRS, MoveKernel
from nsdyn.stepping.scene_state import NOTHING, SceneState, System
from nsdyn.stepping.state import State
from nsdyn.stepping.tree_motion import TreeMotion
from nsdyn.tools.arrays import Array

__all__ = ["EventlessSteps"]

NOTHING_TRIED = None, None, None

Certify = Callable[[FC3D, Array, Array, SlaterDirection | None], tuple[Certificate, SlaterDirection | None]]

PAUSE = 16
"""Most steps that are made by stages after some that were not quiet, before the kernel is asked again."""

ASKS = 50
"""Steps after which it is asked again whether the kernel of quiet steps is compiled."""


class EventlessSteps:
    """Steps by a kernel as long as they meet no event: nothing strikes or overlaps, and no slip turns round.

    If certificates are to `polish`, none of the kernel is enough. `loads` is what the user has to say at a time [s]; of
    `paradoxes` there are none in such a step.
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
        """The state and the next one; None where more may happen, or is likely to, as it did in the steps before."""
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
            if (
                self._tried[1] is not None and OPTIONS.event * old.found.nc <= OPTIONS.work
            ):  # in larger scenes little of it serves
                self._pause = 0
                return None
        self._left, self._pause = self._pause, min(2 * self._pause + 1, PAUSE)
        return None

    def begun(self, state: State) -> Known:
        """What the last attempt at a step from a state has found of it."""
        s, (old, made, motion) = self._system, self._tried
        if old is not None:
            self._mover.given = state.instant, ((old.floats, old.acted, old.status), old.found)
        if made is None:
            return None if motion is None else motion.mid
        return made.values(s, state.instant, state.next_t - s.dt, s.dt, motion)

    def _next(self, old: FlatState, certify: Certify) -> FlatState | None:
        """The next state, None where more may happen."""
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
            # Rows of trees change whatever moves: those of the last step are still to be told.
            found = old.found.anew() if s.dynamics.trees else old.found
            if not motion.meets_nothing() or (made := self._made(old, found, motion)) is None:
                return None
            if (again := motion.corrected(callbacks)) is None:
                break
            motion, callbacks = again, None
        b, size = made.floats[_col.RESULTS :], (s.dynamics.frames, s.dynamics.n)
        if (like := motion.ended(velocity(b, _col.V, size), detected_at(b, _col.DETECTED_AT, size[0]))) is None:
            return None
        return self._told(old, made, like, motion, certify)

    def _made(self, old: FlatState, found: Found, motion: TreeMotion | None) -> KernelResult | None:
        """A step that the kernel has made; what it has made of one that meets an event is kept."""
        direction = old.slater.d if old.slater else NOTHING
        begun = old.floats, old.acted, old.status
        made = self._mover(begun, found, self._length, direction, NO_PAIRS, True, self._moves, motion)
        if made is not None:
            some = made.floats[_col.WENT] or made.floats[_col.GOES] or made.head[_col.SOME]
            self._moves = bool(some)
            if not made.whole:
                if motion is self._tried[2]:  # not with what callbacks say of the motion itself
                    self._tried = old, made, motion
                return None
        return made

    def _told(
        self,
        old: FlatState,
        made: KernelResult,
        like: SceneState,
        motion: TreeMotion | None,
        certify: Certify,
    ) -> FlatState | None:
        """What was made as a state, with its certificate; None where it passes through something."""
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
        """Whether anything touches on its way what it is not seen to meet."""
        s, n, w = self._system, self._system.dynamics.frames, made.work
        there = Placement(vectors(w, _col.X, n), matrices(w, _col.R_THERE, n), ())
        places, reach = (old.place, there, new.place), w[_col.REACH * n : _col.DETECTED_THERE * n]
        contacts = old.found.contacts(), take(new.active.contacts(), new.status > 0), new.found.contacts()
        turns = (1.0 - s.theta) * s.dt * old.twists[1], s.theta * s.dt * new.twists[1]
        return time_of_impact(s, contacts, places, turns, made.found.contacts(), s.dt, reach / (s.theta * s.dt)) < s.dt

    def _is_ready(self, old: FlatState) -> bool:
        """Whether the kernel is compiled: that takes half a minute, in which general steps do the same."""
        self._asked += 1
        if self._asked % ASKS != 1:
            return False
        return self._mover.is_ready((old.floats, old.acted, old.status), old.found)
