"""The result of the move kernel, and its conversion to an `Attempt`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.stepping import columns as _col
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.joints import NO_CLUTCHES, ContactJacobian
from nsdyn.dynamics.values import Forces, MidpointState, Placement
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.attempt import Attempt
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.flat_state import Found, detected_at, local, matrices, solved, vectors, velocity
from nsdyn.stepping.midpoint import SILENT, STILL_SURFACES, Midpoint
from nsdyn.stepping.persistence import NO_COUPLE, Couple
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.stepping.tree_motion import TreeMotion
from nsdyn.tools.arrays import NOTHING, Array, Bools, Index


class KernelResult(NamedTuple):
    """A move, or a step, as the kernel has made it.

    Attributes
    ----------
    floats, acted, status : ndarray
        The state at the end, as in `FlatState`.
    work : ndarray
        Work array: columns of the bodies and of the contacts of the active set.
    head : ndarray of int
        The first integers of the work arrays.
    flags : ndarray of bool, shape (FLAGS, nc)
    found, active, end : Found
        Contacts found at the midpoint, the active set of these, and contacts found at the end.
    whole : bool
        Whether the request is complete. If False it is a move as long as the step that meets an event.
    """

    floats: Array
    acted: Index
    status: NDArray[np.int8]
    work: Array
    head: Index
    flags: Bools
    found: Found
    active: Found
    end: Found
    whole: bool

    def values(self, s: System, begin: SceneState, t: float, h: float, motion: TreeMotion | None) -> Attempt:
        """Return the move of h s from the time t as an `Attempt`; `motion` is given if Python computed the motion."""
        d, f, w, p = s.dynamics, self.floats, self.work, begin.position
        n, _ = size = d.frames, d.n
        b, went, goes = f[_col.RESULTS :], f[_col.WENT] > 0.0, f[_col.GOES] > 0.0
        found = self.found.contacts() if went else begin.contacts
        memory = found if went else begin.memory
        mid = self._half(s, begin, t, h) if motion is None else motion.mid
        where = detected_at(w, _col.DETECTED_THERE, n) if went else begin.detected_at
        active = self.active.contacts() if self.head[_col.SOME] else found
        end, position = Placement(vectors(b, _col.X, n), matrices(b, _col.R, n), ()), p
        if motion is None or not d.trees:
            position = p.moved(end.x, b[3 * n : 7 * n].reshape(n, 4))
        else:
            end, position = motion.placement, motion.position
        twists = vectors(b, _col.LINEAR, n), vectors(b, _col.ANGULAR, n)
        found_there = found, d.limits(end), memory, where
        moved = SceneState(position, velocity(b, _col.V, size), end, *found_there, begin.warm, twists, ())
        if goes:
            end_found = self.end.contacts()
            moved = moved._replace(
                contacts=end_found, memory=end_found, detected_at=detected_at(b, _col.DETECTED_AT, n)
            )
        impulse, ends = (NOTHING, ()) if motion is None else (motion.impulse, motion.ends)
        answer = self._answer(s, active, (mid.forces.m, mid.forces.minv))
        return Attempt(mid, *answer, velocity(w, _col.V_PLUS, size), impulse, ends, moved)

    def _answer(
        self, s: System, active: ContactSet, masses: tuple[Array, Array]
    ) -> tuple[ContactKinematics, None, Bools, FC3D, Solution, Couple]:
        """Return the active set, its contact problem and its impulses, in the order of the fields of `Attempt`."""
        n, nv = size = s.dynamics.frames, s.dynamics.n
        nc, f, w = self.status.size, self.floats, self.work
        a, own = f[_col.RESULTS + _col.FRAME * n + _col.COORDINATE * nv :], w[_col.FRAME_WORK * n :]
        own = own[_col.COORDINATE_WORK * nv :]
        rows = ContactJacobian(self.active.blocks(s.dynamics, masses), {}, *NO_CLUTCHES)
        sliding, stays, sticks, far = self.flags[:4, :nc]
        problem, solution = solved(f, a, self.active, rows.full, s.solver.tol)
        kinematics = ContactKinematics(
            active,
            None,
            rows,
            self.active.frame,
            active.mu,
            active.restitution,
            local(own, _col.LOCAL, nc),
            own[_col.FORESEEN * nc : _col.EXCESS_SPEED * nc],
            stays=stays,
            sticks=sticks,
            far=far,
            was=self.status,
            excess_speed=own[_col.EXCESS_SPEED * nc : _col.PROJECTED * nc],
        )
        couple = NO_COUPLE
        if self.head[_col.TURNED]:
            works, dv = own[_col.COUPLE_WORK * nc : _col.LEFT_OVER * nc], velocity(w, _col.TURN, size)
            couple = Couple(vectors(a, _col.COUPLE, nc), works, dv)
        return kinematics, None, sliding, problem, solution, couple

    def _half(self, s: System, begin: SceneState, t: float, h: float) -> Midpoint:
        """Return the first half of a move of free bodies, of h s from the time t."""
        d, w = s.dynamics, self.work
        n, _ = size = d.frames, d.n
        x, quaternion = vectors(w, _col.X, n), w[3 * n : 7 * n].reshape(n, 4)
        there = Placement(x, matrices(w, _col.R, n), ())
        middle = MidpointState(begin.position.moved(x, quaternion), velocity(w, _col.V_THERE, size), there, ())
        v_free = velocity(w, _col.V_FREE, size)
        forces = Forces(v_free, v_free, d.no_load, *d.masses[3:], ())
        return Midpoint(s, h, t + h, middle, forces, v_free, STILL_SURFACES, SILENT)
