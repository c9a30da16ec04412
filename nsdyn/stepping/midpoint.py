"""The first half of a move: half a free flow, and the forces there; forces of callbacks are of second order.

Forces that depend on the velocity are evaluated at the mean velocity of the move, ½ (v⁻ + v⁺). This velocity is found
by prediction: the callbacks are called where the forces act, first with the velocity v⁻ before them, and once more with
½ (v⁻ + v⁺) of the motion so found. If they then return other forces, the motion is computed again, with those. Works of
forces are taken on the mean velocity, too: a force that is perpendicular to the velocity does work O(h⁴) in a step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.dynamics.dynamics import Controls, Wrenches
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.values import Energies, Forces, MidpointState, Position
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.tools.arrays import Array, Bools

STILL_SURFACES = (np.empty((0, 2, 3)),) * 3

Given = tuple[Wrenches | None, Controls]
"""Values of the user's callbacks: wrenches on bodies, and controls of articulations."""

SILENT: Given = None, {}

Callbacks = Callable[[Position, Array], Given] | None
"""Values of the callbacks as a function of position and velocity; None without callbacks, or after their last call."""

Loads = Callable[[float], Callbacks]
"""The callbacks at a time, s."""


@dataclass(frozen=True, eq=False)
class Midpoint:
    """The first half of a move.

    Attributes
    ----------
    s : System
    h : float
        Length of the move, s.
    end : float
        Time at the end of the move, s.
    state : MidpointState
        Where the forces and impulses act.
    forces : Forces
    foreseen : ndarray, shape (n,)
        First prediction of the velocity after the forces.
    surfaces : three ndarrays of shape (surfaces, 2, 3)
        Twists of driven bodies and moving surfaces: at the beginning, when the impulses act, at the end.
    given : (Wrenches or None, Controls)
        Values that the callbacks returned.
    """

    s: System
    h: float
    end: float
    state: MidpointState
    forces: Forces
    foreseen: Array
    surfaces: tuple[Array, Array, Array]
    given: Given

    @property
    def ahead(self) -> float:
        """Length of the second half, s."""
        return self.s.theta * self.h

    @cached_property
    def rate(self) -> Array:
        """Free acceleration M̃⁻¹ f̃, shape (n,), m/s² and rad/s²."""
        out = self.foreseen - self.state.v
        out /= self.h
        return out

    @property
    def surface_acceleration(self) -> Array:
        """Mean acceleration of what moves as prescribed, shape (surfaces, 2, 3), m/s² and rad/s²."""
        begun, _, ended = self.surfaces
        return (ended - begun) / self.h

    @cached_property
    def reach(self) -> Array:
        """How far points of the frames may move in the second half, shape (frames,), m."""
        return self.s.dynamics.reach(self.state.placement, self.foreseen, self.ahead, self.h, self.surfaces[2])

    @cached_property
    def fast(self) -> bool:
        """Whether some points may move so far in the second half that contacts go unseen."""
        fast: bool = _reductions.most(self.reach) > OPTIONS.unseen * self.s.smallest
        return fast

    @cached_property
    def joints(self) -> JointRows | None:
        """Rows of joint limits and dry joint friction that may act in the move; None if there are none."""
        return self.s.dynamics.joint_rows(self.state.placement, self.state.v, self.forces.foreseen, self.h)

    def turns(self, begin: SceneState, moved: SceneState) -> tuple[Array, Array]:
        """Return about how far frames turn in each half of a move to `moved`, as rotation vectors, (frames, 3) each."""
        d, ends = self.s.dynamics, (begin.twists[1], moved.twists[1])
        first, second = (d.spins(w, twist) for w, twist in zip(ends, self.surfaces[::2], strict=True))
        return (self.h - self.ahead) * first, self.ahead * second

    @property
    def driven(self) -> tuple[Array, Array]:
        """Poses of driven bodies at the end, shapes (nd, 3) and (nd, 4)."""
        return self.s.dynamics.surfaces.poses(self.end, self.s.theta)

    def at_play(self, before: Energies) -> list[float]:
        """Return the energy at play in each tree, J, as `Tree.at_play`; `before` has energies at the beginning."""
        trees = zip(self.s.dynamics.trees, self.state.trees, self.forces.trees, before, strict=True)
        return [t.at_play(there, free, energy) for t, there, free, energy in trees]

    def booked(self, own: Works, v0: Array, v1: Array, left: Bools | None = None) -> Works:
        """Return `own` works plus those of loads on free bodies at the mean of v0 and v1 (n,); `left` as `wrench`."""
        if self.given[0] is None:
            return own
        free = self.forces.load.shape[1]
        along = (0.5 * self.h * (v0 + v1))[: 6 * free].reshape(free, 2, 3).swapaxes(0, 1)
        if left is not None:
            along = left[:free, None] * along
        for name, load in self.given[0][0].items():
            own = own._replace(**{name: getattr(own, name) + float(np.vdot(load, along))})
        return own

    def wrench(self, left: Bools | None = None) -> Array | None:
        """Return the impulses of the loads on free bodies, as in `Impulses`; of the nodes `left`, if not of all."""
        load = self.forces.load if left is None else left[: self.forces.load.shape[1], None] * self.forces.load
        if not load.any():
            return None
        force, torque = load
        turn = np.einsum("bij,bj->bi", self.state.placement.R[: len(torque)], torque)
        return self.h * np.concatenate((force, turn), axis=1)


def midpoint(s: System, begin: SceneState, t: float, h: float, callbacks: Callbacks) -> Midpoint:
    """Compute half a free flow from the time t, and the forces there, with callbacks at the velocity v⁻."""
    d, surfaces = s.dynamics, STILL_SURFACES
    if d.surfaces.count:
        begun, ended = d.surfaces.twists(t), d.surfaces.twists(t + h)
        surfaces = begun, d.surfaces.mean(begun, ended, 0.5), ended
    middle = d.halfway(begin.position, begin.v, h, s.theta, surfaces[0])
    given = SILENT if callbacks is None else callbacks(middle.position, middle.v)
    return _under(s, begin, h, t + h, middle, surfaces, given)


def corrected(s: System, begin: SceneState, mid: Midpoint, v: Array, callbacks: Callbacks) -> Midpoint:
    """Return the first half with callbacks at the mean velocity for v⁺ = v; `mid` itself if they return the same."""
    if callbacks is None:
        return mid
    given = callbacks(mid.state.position, 0.5 * (mid.state.v + v))
    if _same(given, mid.given):
        return mid
    return _under(s, begin, mid.h, mid.end, mid.state, mid.surfaces, given)


def _under(
    s: System,
    begin: SceneState,
    h: float,
    end: float,
    state: MidpointState,
    surfaces: tuple[Array, Array, Array],
    given: Given,
) -> Midpoint:
    """Return the first half of a move of h s that ends at the time `end`, under the given forces."""
    forces = s.dynamics.forces(state, end, h, *given, begin.warm.joints)
    return Midpoint(s, h, end, state, forces, forces.foreseen, surfaces, given)


def _same(one: Any, other: Any) -> bool:
    """Return whether nested values are equal to the last bit."""
    if one is other:
        return True
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return all(map(_same, one, other))
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(_same(value, other[key]) for key, value in one.items())
    return bool(one == other)
