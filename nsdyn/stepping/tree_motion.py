"""What Python does between the calls of the kernel of steps: the motion of trees, and the forces of the user."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn.collision.contacts import DetectionPose
from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.values import Energies, Flow, Placement, Position
from nsdyn.stepping.midpoint import Callbacks, Midpoint, corrected
from nsdyn.stepping.scene_state import SceneState
from nsdyn.stepping.step_result import tree_works
from nsdyn.tools.arrays import Array

__all__ = ["TreeMotion"]


class TreeMotion:
    """The motion of one step, or of one move, of a scene with trees or under forces of the user.

    Parameters
    ----------
    begin : SceneState
        As of `FlatState.begin`.
    mid : Midpoint
        The first half of the step.

    Attributes
    ----------
    begun : tuple of Links
        Where it begins.
    position : Position
    placement : Placement
    v, impulse : ndarray, shape (n,)
        What the forces leave, with the impulses, and H r of these.
    ends : tuple of Flow
        Where the last `end` was, and what led there.
    """

    def __init__(self, begin: SceneState, mid: Midpoint) -> None:
        self._s, self._begin, self.mid = mid.s, begin, mid
        self.begun = begin.placement.links
        self.v = self.impulse = np.empty(0)
        self.ends: tuple[Flow, ...] = ()
        self.position, self.placement = begin.position, begin.placement

    def meets_nothing(self) -> bool:
        """Whether no joint is near its limits, none has dry friction, and no actuator is at its limit."""
        return not (_reductions.any_below(self._begin.limits, self._s.gap_tol) or self.has_rows())

    def has_rows(self) -> bool:
        """Whether any joint has a row, by its limits, its friction or its actuator."""
        d, mid = self._s.dynamics, self.mid
        joints = d.joint_rows(mid.state.placement, mid.state.v, mid.forces.v, mid.h)
        return d.with_actuators(joints, mid.forces) is not None

    def end(self, v: Array, impulse: Array) -> tuple[Position, Array, Placement, tuple[Array, Array]] | None:
        """Where the step ends whose forces leave v (n,), with the impulses H r (n,): (position, v, frames, twists).

        None where actuators are brought beyond their limits, and where numbers are.
        """
        d, mid = self._s.dynamics, self.mid
        if d.within_limits(mid.state, mid.forces, v) is not mid.forces:
            return None
        self.impulse = impulse
        position, v_end, place, self.ends = d.end(mid.state, mid.forces, v, impulse, mid.ahead, mid.driven)
        speed = _reductions.largest(v_end)
        if not speed * speed < math.inf:
            return None
        self.position, self.placement = position, place
        return position, v_end, place, d.twists(place, v_end)

    def corrected(self, callbacks: Callbacks) -> TreeMotion | None:
        """The motion with what callbacks say at the mean velocity of this one, v⁺ = v; None where that is the same."""
        again = corrected(self._s, self._begin, self.mid, self.v, callbacks)
        return None if again is self.mid else TreeMotion(self._begin, again)

    def ended(self, v: Array, where: DetectionPose) -> SceneState | None:
        """The trees at the end, of velocity v (n,), and where contacts are looked for; None beyond limits of joints."""
        d, begin = self._s.dynamics, self._begin
        if not d.trees:
            return begin
        limits = d.limits(self.placement)
        if limits.size and _reductions.least(limits) < -self._s.gap_tol:
            return None
        warm = begin.warm
        if warm.joints is not d.joints.no_impulses:
            warm = warm._replace(joints=d.joints.no_impulses)
        found = begin.contacts, limits, begin.memory, where
        return SceneState(self.position, v, self.placement, *found, warm, begin.twists, ())

    def told(self, before: Energies, own: Works) -> tuple[Works, Array, Array]:
        """Works of the trees, of loads and `own` ones, J, and `joints` and `links` as of `Impulses`.

        From the energies of the trees where it begins.
        """
        s, d, own = self._s, self._s.dynamics, self.mid.booked(own, self.mid.state.v, self.v)
        if not d.trees:
            return own, d.no_impulses[1], d.no_push
        joints, links = np.zeros((7, d.n - 6 * d.free)), np.zeros((d.links, 6))
        acted = self.v, self.ends, self.impulse
        own, self.energies = tree_works(s, before, self.mid, *acted, self.position, (joints, links), own)
        return own, joints, links

    @cached_property
    def energies(self) -> Energies:
        """Energies of the trees at the end, J."""
        at = zip(self._s.dynamics.trees, self.ends, strict=True)
        return tuple([t.energies(end.q, end.v) for t, end in at])
