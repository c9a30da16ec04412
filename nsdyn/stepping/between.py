"""What Python does between the calls of the kernel of steps: the motion of trees, and the forces of the user."""

from __future__ import annotations

import numpy as np

from nsdyn._kernels import reductions as _few
from nsdyn._kernels.stepping import columns as _col
from nsdyn.dynamics.tree_values import TreeEnd
from nsdyn.dynamics.values import Placement, Position
from nsdyn.stepping.booking import tree_works
from nsdyn.stepping.energy import Works
from nsdyn.stepping.flat import Acting
from nsdyn.stepping.half import STILL_SURFACES, Callbacks, Half, corrected
from nsdyn.stepping.instant import Instant, System
from nsdyn.tools.arrays import Array

__all__ = ["Motion"]


class Motion:
    """The motion of one step, or of one move, of a scene with trees or under forces of the user.

    Parameters
    ----------
    s : System
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
    impulse : ndarray, shape (n,)
    ends : tuple of TreeEnd
        Where the last `end` was, and what led there.
    """

    def __init__(self, s: System, begin: Instant, half: Half) -> None:
        self._s, self._begin, self.half = s, begin, half
        self.begun = begin.placement.links
        self._v = self.impulse = np.empty(0)
        self.ends: tuple[TreeEnd, ...] = ()
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

        None where actuators are brought beyond their limits.
        """
        d, half = self._s.dynamics, self.half
        if d.within_limits(half.middle, half.forces, v) is not half.forces:
            return None
        self._v, self.impulse = v, impulse
        position, v_end, place, self.ends = d.end(half.middle, half.forces, v, impulse, half.ahead, STILL_SURFACES[2])
        self.position, self.placement = position, place
        return position, v_end, place, d.twists(place, v_end)

    def corrected(self, v: Array, callbacks: Callbacks) -> Motion | None:
        """The motion with what callbacks say at the mean velocity of this one, v⁺ = v; None where that is the same."""
        again = corrected(self._s, self._begin, self.half, v, callbacks)
        return None if again is self.half else Motion(self._s, self._begin, again)

    def told(self, results: Array) -> tuple[Instant, Acting] | None:
        """The trees at the end, and what acted on them; their works and energies are added to its results (RESULTS,).

        None where joints are beyond their limits.
        """
        s, d, half, begin = self._s, self._s.dynamics, self.half, self._begin
        if not d.trees:
            return begin, Acting((half.forces.m, half.forces.minv), d.no_impulses[1], d.no_push)
        limits = d.limits(self.placement)
        if _few.least(limits) < -s.closed:
            return None
        slots, joints = d.joints.impulses(None, np.empty((0, 3)), d.n)
        links, position, ends = np.zeros((d.links, 6)), self.position, self.ends
        external, numerics = float(results[_col.EXTERNAL]), float(results[_col.NUMERICS])
        own = Works(external=external, integration=numerics)
        own, energies = tree_works(s, begin, half, self._v, ends, self.impulse, position, (joints, links), own)
        results[_col.EXTERNAL], results[_col.DAMPING], results[_col.NUMERICS] = (
            own.external,
            own.damping,
            own.integration,
        )
        for kinetic, potential in energies:
            results[_col.KINETIC] += kinetic
            results[_col.POTENTIAL] += potential
        warm = begin.warm if begin.warm.joints is slots else begin.warm._replace(joints=slots)
        found = begin.contacts, limits, begin.memory, begin.looked
        like = Instant(position, begin.v, self.placement, *found, warm, begin.twists, energies)
        return like, Acting((half.forces.m, half.forces.minv), joints, links)
