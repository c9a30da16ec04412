"""What Python does between the calls of the kernel of steps: the motion of trees, and the forces of the user."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from nsdyn._kernels import reductions as _few
from nsdyn.collision.contacts import Looked
from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.values import Energies, Flow, Placement, Position
from nsdyn.stepping.booking import tree_works
from nsdyn.stepping.half import Callbacks, Half, corrected
from nsdyn.stepping.instant import Instant
from nsdyn.tools.arrays import Array

__all__ = ["Motion"]


class Motion:
    """The motion of one step, or of one move, of a scene with trees or under forces of the user.

    Parameters
    ----------
    begin : Instant
        As of `Flat.begin`.
    half : Half
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

    def __init__(self, begin: Instant, half: Half) -> None:
        self._s, self._begin, self.half = half.s, begin, half
        self.begun = begin.placement.links
        self.v = self.impulse = np.empty(0)
        self.ends: tuple[Flow, ...] = ()
        self.position, self.placement = begin.position, begin.placement

    def meets_nothing(self) -> bool:
        """Whether no joint is near its limits, none has dry friction, and no actuator is at its limit."""
        return not (_few.any_below(self._begin.limits, self._s.closed) or self.has_rows())

    def has_rows(self) -> bool:
        """Whether any joint has a row, by its limits, its friction or its actuator."""
        d, half = self._s.dynamics, self.half
        joints = d.joint_rows(half.middle.placement, half.middle.v, half.forces.v, half.h)
        return d.with_actuators(joints, half.forces) is not None

    def end(self, v: Array, impulse: Array) -> tuple[Position, Array, Placement, tuple[Array, Array]] | None:
        """Where the step ends whose forces leave v (n,), with the impulses H r (n,): (position, v, frames, twists).

        None where actuators are brought beyond their limits, and where numbers are.
        """
        d, half = self._s.dynamics, self.half
        if d.within_limits(half.middle, half.forces, v) is not half.forces:
            return None
        self.impulse = impulse
        position, v_end, place, self.ends = d.end(half.middle, half.forces, v, impulse, half.ahead, half.driven)
        speed = _few.largest(v_end)
        if not speed * speed < math.inf:
            return None
        self.position, self.placement = position, place
        return position, v_end, place, d.twists(place, v_end)

    def corrected(self, callbacks: Callbacks) -> Motion | None:
        """The motion with what callbacks say at the mean velocity of this one, v⁺ = v; None where that is the same."""
        again = corrected(self._s, self._begin, self.half, self.v, callbacks)
        return None if again is self.half else Motion(self._begin, again)

    def ended(self, v: Array, where: Looked) -> Instant | None:
        """The trees at the end, of velocity v (n,), and where contacts are looked for; None beyond limits of joints."""
        d, begin = self._s.dynamics, self._begin
        if not d.trees:
            return begin
        limits = d.limits(self.placement)
        if limits.size and _few.least(limits) < -self._s.closed:
            return None
        warm = begin.warm
        if warm.joints is not d.joints.no_impulses:
            warm = warm._replace(joints=d.joints.no_impulses)
        found = begin.contacts, limits, begin.memory, where
        return Instant(self.position, v, self.placement, *found, warm, begin.twists, ())

    def told(self, before: Energies, own: Works) -> tuple[Works, Array, Array]:
        """Works of the trees, of loads and `own` ones, J, and `joints` and `links` as of `Impulses`.

        From the energies of the trees where it begins.
        """
        s, d, own = self._s, self._s.dynamics, self.half.booked(own, self.half.middle.v, self.v)
        if not d.trees:
            return own, d.no_impulses[1], d.no_push
        joints, links = np.zeros((7, d.n - 6 * d.free)), np.zeros((d.links, 6))
        acted = self.v, self.ends, self.impulse
        own, self.energies = tree_works(s, before, self.half, *acted, self.position, (joints, links), own)
        return own, joints, links

    @cached_property
    def energies(self) -> Energies:
        """Energies of the trees at the end, J."""
        at = zip(self._s.dynamics.trees, self.ends, strict=True)
        return tuple([t.energies(end.q, end.v) for t, end in at])
