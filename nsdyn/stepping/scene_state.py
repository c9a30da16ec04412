"""Values that all moves of a scene share: the system, and the state of the scene at an instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.stepping import touching as _touching
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import ContactSet, DetectionPose, Poses, Touches
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.values import Energies, MidpointState, Placement, Position
from nsdyn.solvers import Solver
from nsdyn.stepping.contact_kinematics import ContactKinematics, GapRule
from nsdyn.stepping.impacts import Law
from nsdyn.tools.arrays import Array, Index

if TYPE_CHECKING:
    from nsdyn.stepping.move_kernel import MoveKernel


STILL = 0.5
"""Share of the gap tolerance by which frames may have moved since the last detection if its contacts are to be used
again."""


class System(NamedTuple):
    """The properties of a scene that do not change from move to move.

    Attributes
    ----------
    dynamics : Dynamics
    detector : Detector
    solver : Solver
    theta : float
        Fraction of the move after the impulses.
    dt : float
        Length of the step of which moves are parts, s: a contact that would bounce on for less than dt rests.
    gap_tol : float
        Gap tolerance: largest gap that counts as closed, m.
    inscribed : ndarray, shape (geoms,)
        Inscribed radii of the shapes, m; infinite for shapes that never move.
    rounding : ndarray, shape (geoms,)
        Inscribed radii of curved shapes, m; infinite for shapes of flat faces.
    smallest : float
        Least inscribed radius, m.
    impact : Law
        Law of impact.
    elastic : bool
        Whether any contact or joint limit has restitution.
    depth : float
        Largest penetration within a move, as a fraction of the inscribed radius of the smaller shape.
    mover : MoveKernel, optional
        Kernel of moves, where no surfaces move.
    """

    dynamics: Dynamics
    detector: Detector
    solver: Solver
    theta: float
    dt: float
    gap_tol: float
    inscribed: Array
    rounding: Array
    smallest: float
    impact: Law
    elastic: bool
    depth: float = OPTIONS.depth_located
    mover: MoveKernel | None = None

    @property
    def least_penetration(self) -> float:
        """Least penetration, m, that counts as deep."""
        return self.depth * self.smallest

    @property
    def capturing(self) -> System:
        """The system of a move that captures the contacts it meets, and impacts as slow where it begins."""
        return self._replace(depth=max(self.depth, OPTIONS.depth_captured))

    def during(self, t: float, h: float, begin: Position) -> System:
        """Return the system in a step of h s from the time t on that begins at a position."""
        return self._replace(dynamics=self.dynamics.during(t, h, begin)) if self.dynamics.surfaces.count else self

    def gap_rule(self, h: float, captured: bool) -> GapRule:
        """Return how gaps close in a move of h s: it captures all impacts, or locates them and ends where bodies touch.

        The next move is no longer than the step. Gaps that gravity closes from rest in a step may stay open until the
        next impulses: they are of second order, and not deep. Contacts that cross wider gaps strike. No gap stays open
        so where impacts are located.
        """
        shallow = (
            min(OPTIONS.depth_captured * min(self.smallest, OPTIONS.joint), self.dynamics.weight * self.dt**2)
            if captured
            else 0.0
        )
        return self.gap_tol, shallow, self.theta * h, self.theta * h + (1.0 - self.theta) * self.dt

    def touches(
        self,
        begin: Poses,
        end: Poses,
        memory: ContactSet,
        known: Callable[[], ContactSet] | None,
        together: ContactSet | None = None,
        foreseen: Array | None = None,
    ) -> Touches:
        """`Detector.touches` of pairs so fast (`Options.unseen`) that their end does not tell which sides met."""
        return self.detector.touches(begin, end, memory, known, OPTIONS.unseen * self.inscribed, together, foreseen)

    def detection_pose(self, last: DetectionPose, now: Poses, reach: Array) -> DetectionPose | None:
        """Return where to search for contacts: each frame at its last pose if that still holds, else at its present.

        None if all last poses hold: the contacts found are then those of now, up to the gaps that `reach` (frames,)
        allows.
        """
        out = DetectionPose(np.empty_like(now.x), np.empty_like(now.R), np.empty_like(reach))
        there, radii = (now.x, now.R, reach), self.dynamics.radii
        return None if _touching.detection_pose(tuple(last), there, radii, STILL * self.gap_tol, tuple(out)) else out

    def penetration_tol(self, contacts: ContactSet) -> Array:
        """Return the penetrations, m, that a move may capture: deeper contacts are impacts to be located.

        For joint limits, `Options.joint` takes the place of the inscribed radius.
        """
        return self.depth * np.minimum(self.inscribed[contacts.geom1], self.inscribed[contacts.geom2])

    def nodes(self, contacts: ContactSet) -> Index:
        """Return the node that moves each contact, `Layout.node_of`."""
        return self.dynamics.node_of(contacts.frame1, contacts.frame2)

    def last_status(self, contacts: ContactSet, warm: WarmStart) -> NDArray[np.int8]:
        """Return the status of the contacts in the last move, shape (nc,): 0 open, 1 stick, 2 slip."""
        out = np.empty(contacts.gap.size, np.int8)
        _touching.last_status(contacts.names, self.inscribed.size, (warm.key, warm.pair, warm.status), out)
        return out

    def least_strike(self, contacts: ContactSet, h: float) -> float:
        """Return the speed of approach, m/s, from which closed contacts may strike before a move of h s."""
        elastic = self.elastic and _reductions.most(contacts.restitution) > 0.0
        return self.solver.tol if elastic else self.least_penetration / h

    def striking_speed(self, at: SceneState) -> float:
        """Return the least normal velocity of contacts that may strike at an instant, m/s, 0 if none is negative.

        These are closed contacts. Those that pressed in the last move and do not rebound are left out: they turn with
        their bodies, and close a little.
        """
        c, w = at.contacts, at.warm
        warm = w.key, w.pair, w.status
        # But where a contact has just closed its gap and that gains energy, the contact is stopped first.
        if self.depth < OPTIONS.depth_located:
            warm = w.key, w.pair, np.zeros_like(w.status)
        least: float = _touching.striking_speed(
            c[:3], at.placement.x, at.twists, warm, self.inscribed.size, self.gap_tol
        )
        return least

    @property
    def bounces(self) -> tuple[float, float]:
        """Half a step, s, and the least 1 - e that counts in it, for `resting`."""
        return 0.5 * self.dt, 1.0 / OPTIONS.bounces

    def resting(self, kin: ContactKinematics, at: MidpointState, rate: Array, surface_acceleration: Array) -> Array:
        """Return speeds of approach, m/s, up to which contacts rest after an impact, at the free acceleration `rate`.

        The shape of `rate` is (n,), that of `surface_acceleration`, the acceleration of kinematic bodies and moving
        surfaces, (surfaces, 2, 3). After an impact that leaves u the flight takes 2 u/a_n, where a_n adds up the free
        accelerations of both bodies along the normal. The next flights take e, e², ... times as long. Where u ≤ ½ a_n
        dt max(1 - e, 1/N), all flights end within a step, or the N = `Options.bounces` flights do that count as
        infinitely many. An approach within the solver's tolerance is none.
        """
        d, c, e = self.dynamics, kin.contacts, kin.restitution
        weight = np.empty(c.gap.size)
        _touching.weights(c[:3], at.placement.x, d.twists(at.placement, rate), weight)
        if d.surfaces.count:
            pushed = d.surfaces.velocities(c, at.position.driven_x, surface_acceleration)
            weight += np.abs((c.normal * pushed).sum(axis=1))
        if kin.joints is not None:
            weight = np.concatenate((weight, np.abs(d.joints.rates(kin.joints.slot, rate))))
        least_time, least = self.bounces
        parting = least_time * weight * np.maximum(1.0 - e, least)
        return self.solver.tol + parting / np.where(e > 0.0, e, 1.0)

    def sunk(self, contacts: ContactSet) -> bool:
        """Return whether bodies penetrate by more than `Options.unseen` of the smaller shape's inscribed radius."""
        if _reductions.least(contacts.gap) >= -OPTIONS.unseen * self.smallest:
            return False
        radius = np.minimum(self.inscribed[contacts.geom1], self.inscribed[contacts.geom2])
        return bool((contacts.gap < -OPTIONS.unseen * radius).any())

    def shifted(self, before: Position, after: Position) -> bool:
        """Return whether a projection moved points of a free body by more than `Options.unseen` of `smallest`."""
        free = before.x.shape[0]
        if after is before or not free:
            return False
        # A small turn changes the quaternion by half its angle.
        turn = 2.0 * np.linalg.norm(after.quaternion - before.quaternion, axis=1)
        moved = np.linalg.norm(after.x - before.x, axis=1) + self.dynamics.radii[:free] * turn
        return float(moved.max()) > OPTIONS.unseen * self.smallest


class WarmStart(NamedTuple):
    """The data that a step leaves to the next besides its end: a start for the solver, and the status of the contacts.

    Attributes
    ----------
    key, pair : ndarray of int, shape (nc,)
        Keys of the contacts, and codes of their pairs of shapes.
    force : ndarray, shape (nc, 3)
        World axes, N: impulses over the length of their move.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    joints : ndarray, shape (slots, 3)
        Of joint limits, joint friction and actuators, by the slots of `nsdyn.dynamics.joints.JointLaws`, N m or N.
    """

    key: Index
    pair: Index
    force: Array
    status: NDArray[np.int8]
    joints: Array


class SceneState(NamedTuple):
    """The state of a scene at an instant, with all data from which a move begins.

    Attributes
    ----------
    position : Position
    v : ndarray, shape (n,)
    placement : Placement
    contacts : ContactSet
        Contacts found there, with the true gaps of the shapes.
    limits : ndarray
        Gaps of all joint limits, rad or m.
    memory : ContactSet
        Contacts whose keys the next detection goes on with.
    detected_at : DetectionPose
        Where the contacts were found; not quite at `placement` if frames have hardly moved since.
    warm : WarmStart
    twists : two ndarrays of shape (frames, 3)
        Linear and angular velocities of the frames, world axes, m/s and rad/s.
    energies : tuple of (float, float)
        Kinetic and potential energy of every tree, J.
    """

    position: Position
    v: Array
    placement: Placement
    contacts: ContactSet
    limits: Array
    memory: ContactSet
    detected_at: DetectionPose
    warm: WarmStart
    twists: tuple[Array, Array]
    energies: Energies

    @property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the arrays that have the same in all states of a scene."""
        p = self.position
        each = *p.trees, p.x, p.driven_x, self.v, self.placement.x, self.limits, self.warm.joints
        return tuple([len(x) for x in each])
