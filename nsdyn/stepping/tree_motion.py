"""Motion of trees and forces of the user: the parts of a step that Python computes between calls of its kernel."""

from __future__ import annotations

import math

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn.collision.contacts import DetectionPose
from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.values import Energies, Flow, Placement, Position
from nsdyn.stepping.midpoint import Callbacks, Midpoint, corrected
from nsdyn.stepping.scene_state import SceneState
from nsdyn.stepping.step_result import tree_works
from nsdyn.tools.arrays import Array


class TreeMotion:
    """Motion of one step, or of one move, of a scene with trees or under forces of the user.

    Parameters
    ----------
    begin : SceneState
        As in `FlatState.begin`.
    mid : Midpoint
        The first half of the step.

    Attributes
    ----------
    begun : tuple of Links
        Links at the beginning.
    position : Position
    placement : Placement
    v, impulse : ndarray, shape (n,)
        Velocity after forces and impulses at the midpoint, and H r of the impulses.
    ends : tuple of Flow
        Motion of the trees to the state of the last `end`.
    energies : tuple of (float, float)
        Energies of the trees at the end, J, once `ended`.
    """

    def __init__(self, begin: SceneState, mid: Midpoint) -> None:
        self._s, self._begin, self.mid = mid.s, begin, mid
        self.begun = begin.placement.links
        self.v = self.impulse = np.empty(0)
        self.ends: tuple[Flow, ...] = ()
        self.position, self.placement = begin.position, begin.placement
        d = self._s.dynamics
        self.energies: Energies = ()
        self._works: list[Works] = []
        self._joints, self._links = np.zeros((8, d.n - 6 * d.free)), np.zeros((d.links, 6))

    def meets_nothing(self) -> bool:
        """Whether no joint is at its limits or has dry friction, and no actuator is at its limit."""
        return not (_reductions.any_below(self._begin.limits, self._s.gap_tol) or self.has_rows())

    def has_rows(self) -> bool:
        """Whether any joint has a row of the contact problem, for its limits, dry friction or actuator."""
        return self._s.dynamics.with_actuators(self.mid.joints, self.mid.forces) is not None

    def end(self, v: Array, impulse: Array) -> tuple[Position, Array, Placement, tuple[Array, Array]] | None:
        """Return the end of the step: (position, v, placements of the frames, twists).

        v (n,) is the velocity after forces and impulses at the midpoint, with H r (n,) = `impulse`. None if an actuator
        exceeds its limit, or if the velocity leaves the range of numbers.
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
        """Return the motion with the callbacks' values at its mean velocity, v⁺ = v; None if they have not changed."""
        again = corrected(self._s, self._begin, self.mid, self.v, callbacks)
        return None if again is self.mid else TreeMotion(self._begin, again)

    def ended(self, v: Array, where: DetectionPose, before: Energies) -> SceneState | None:
        """Return the state of the trees at the end with velocity v (n,).

        None if a joint is beyond its limits, or if numerics add too much energy. `where` are the poses at which
        contacts were detected, `before` the energies of the trees at the beginning.
        """
        d, begin = self._s.dynamics, self._begin
        if not d.trees:
            return begin
        limits = d.limits(self.placement)
        if limits.size and _reductions.least(limits) < -self._s.gap_tol:
            return None
        acted = self.mid.forces, self.v, self.ends, self.impulse, (self.position, v)
        self._works, self.energies, strays = tree_works(self._s, before, self.mid, *acted, (self._joints, self._links))
        if any(strays):
            return None
        warm = begin.warm
        if warm.joints is not d.joints.no_impulses:
            warm = warm._replace(joints=d.joints.no_impulses)
        found = begin.contacts, limits, begin.memory, where
        return SceneState(self.position, v, self.placement, *found, warm, begin.twists, ())

    def told(self, own: Works) -> tuple[Works, Array, Array]:
        """Return the works of the trees, of the loads and `own`, J, and `joints` and `links` as in `Impulses`."""
        own = self.mid.booked(own, self.mid.state.v, self.v)
        return Works.total([own, *self._works]), self._joints, self._links
