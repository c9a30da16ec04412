"""What moves of a scene share: the system, its state at an instant, and what acted there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels import reductions as _few
from nsdyn._kernels import sorting as _sorting
from nsdyn._kernels.stepping import account as _account
from nsdyn._kernels.stepping import law as _law
from nsdyn._kernels.stepping import touching as _touching
from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked, Poses, Touches
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.values import Energies, Forces, Placement, Position
from nsdyn.problem.fc3d import FC3D
from nsdyn.solvers import Solver
from nsdyn.stepping.encounter import Closing, Encounter
from nsdyn.stepping.energy import Works
from nsdyn.stepping.impacts import Law
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.warm import Basis, Warm
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["DEEP", "EVENTS", "FAST", "JOINT", "SHALLOW", "Impulses", "Instant", "System", "account", "among", "take"]

NOTHING = np.empty(0)

FAST = 0.1
"""Fraction of the inscribed radius of the smallest shape beyond which bodies may get so far into each other in half a
move that only the way there tells which sides met."""

DEEP, SHALLOW = 1e-5, 1e-3
"""Fractions of the inscribed radius of the smaller shape up to which bodies may run into each other within a step, in
scenes whose impacts are located, and in those that catch them. What falls so far is lifted again at the end, and the
energy of that is numerical; what else carries the body when it lands is struck too late."""

JOINT = 0.1
"""What counts for joint limits as the inscribed radius of a shape does, rad or m."""

EVENTS = 16
"""Most impacts at which one step is cut, and bounces in a step that count as infinitely many."""

STILL = 0.5
"""Fraction of what counts as closed by which frames may have moved while the contacts that were found stay those."""


class System(NamedTuple):
    """What does not change from move to move.

    Attributes
    ----------
    dynamics : Dynamics
    detector : Detector
    solver : Solver
    theta : float
        Fraction of the move after the impulses.
    dt : float
        The step of which moves are parts, s: what bounces on for less than that rests.
    closed : float
        Largest gap that counts as closed, m.
    inscribed : ndarray, shape (geoms,)
        Radii of balls inside the shapes, m; infinite of those that never move.
    smallest : float
        The least of them, m.
    arm : ndarray, shape (frames,)
        How far shapes reach from the origins of their frames, m.
    impact : Law
        Of impact.
    elastic : bool
        Whether any contact or joint limit has restitution.
    depth : float
        Fraction of the inscribed radius of the smaller shape up to which bodies may run into each other within a move.
    """

    dynamics: Dynamics
    detector: Detector
    solver: Solver
    theta: float
    dt: float
    closed: float
    inscribed: Array
    smallest: float
    arm: Array
    impact: Law
    elastic: bool
    depth: float = DEEP

    @property
    def slow(self) -> float:
        """The least of what is `deep`."""
        return self.depth * self.smallest

    def during(self, t: float, h: float) -> System:
        """The same in a step of h s from t on."""
        return self._replace(dynamics=self.dynamics.during(t, h)) if self.dynamics.surfaces.count else self

    def closing(self, h: float, caught: bool) -> Closing:
        """How gaps close in a move of h s that catches all impacts or locates them: then it ends where bodies touch.

        The move after it is no longer than the step.
        """
        shallow = min(SHALLOW * min(self.smallest, JOINT), self.dynamics.weight * self.dt**2) if caught else 0.0
        return Closing(self.closed, shallow, self.theta * h, self.theta * h + (1.0 - self.theta) * self.dt)

    def touches(self, begin: Poses, end: Poses, memory: ContactMemory, known: ContactSet) -> Touches:
        """Contacts of `Detector.touches` of pairs so `FAST` that where they end does not tell which sides met."""
        return self.detector.touches(begin, end, memory, known, FAST * self.inscribed)

    def unmoved(self, looked: Looked, now: Placement, reach: Array) -> bool:
        """Whether the contacts found somewhere are those of now, up to the gaps that `reach` (frames,) allows, m."""
        same: bool = _touching.unmoved(tuple(looked), (now.x, now.R, reach), self.arm, STILL * self.closed)
        return same

    def look(self, looked: Looked, x: Array, R: Array, reach: Array) -> Looked:
        """Where to look for contacts now: where they were looked for, but for frames of which that is no longer so."""
        out = Looked(np.empty_like(x), np.empty_like(R), np.empty_like(reach))
        _touching.look(tuple(looked), (x, R, reach), self.arm, STILL * self.closed, tuple(out))
        return out

    def deep(self, contacts: ContactSet) -> Array:
        """Overlaps, m, that a move may catch: deeper ones are impacts to be located; of joint limits depth JOINT."""
        out: Array = self.depth * np.minimum(self.inscribed[contacts.geom1], self.inscribed[contacts.geom2])
        return out

    def nodes(self, contacts: ContactSet) -> Index:
        """The block of coordinates that moves each contact, of the two the first, shape (nc,); -1 for none."""
        node = self.dynamics.node
        first = node[contacts.frame1]
        out: Index = np.where(first >= 0, first, node[contacts.frame2])
        return out

    def last_status(self, contacts: ContactSet, warm: Warm) -> NDArray[np.int8]:
        """What the contacts were in the last move, shape (nc,): 0 open, 1 stick, 2 slip."""
        out = np.empty(contacts.gap.size, np.int8)
        _touching.last_status(contacts.key, self.detector.codes(contacts), warm.key, warm.pair, warm.status, out)
        return out

    def striking_speed(self, at: Instant) -> float:
        """The least normal velocity of what may strike in no time at an instant, m/s, 0 if none is negative.

        Of contacts that are closed; those that pressed in the last move turn with their bodies, and close a little.
        """
        c, w = at.contacts, at.warm
        warm = w.key, w.pair, w.status
        # But where such a contact has just closed its gap and that gains energy, it is stopped first.
        if self.depth < DEEP:
            warm = w.key, w.pair, np.zeros_like(w.status)
        contacts, where = (c.key, c.geom1, c.geom2, c.gap, c.restitution), (c.frame1, c.frame2, c.point, c.normal)
        least: float = _touching.striking_speed(
            contacts, (*where, at.placement.x), at.twists, warm, self.inscribed.size, self.closed
        )
        return least

    def weights(self, contacts: ContactSet, there: Placement, rate: Array) -> Array:
        """Free accelerations of both bodies of contacts along their normals, added up, shape (nc,), m/s²."""
        out = np.empty(contacts.gap.size)
        where = contacts.frame1, contacts.frame2, contacts.point, contacts.normal, there.x
        _touching.weights(where, self.dynamics.twists(there, rate), out)
        return out

    @property
    def bounces(self) -> tuple[float, float]:
        """Half a step, s, and the least 1 - e that counts in it, as of `rests`."""
        return 0.5 * self.dt, 1.0 / EVENTS

    def rests(
        self, contacts: ContactSet, joints: JointRows | None, restitution: Array, there: Placement, rate: Array
    ) -> Array:
        """Speeds of parting up to which contacts, and joint rows, rest at a free acceleration `rate` (n,), m/s.

        After an impact that leaves u the flight takes 2 u/a_n, and those that follow e, e², ... times as long: they are
        over within a step, or the `EVENTS` of it, where u ≤ ½ a_n dt max(1 - e, 1/EVENTS).
        """
        weight = self.weights(contacts, there, rate)
        if joints is not None:
            weight = np.concatenate((weight, np.abs(self.dynamics.joints.rates(joints.slot, rate))))
        half, least = self.bounces
        out: Array = half * weight * np.maximum(1.0 - restitution, least)
        return out

    def resting(
        self, contacts: ContactSet, joints: JointRows | None, restitution: Array, there: Placement, rate: Array
    ) -> Array:
        """Speeds of approach up to which what strikes `rests` afterwards, m/s.

        What the solver's tolerance leaves of a velocity is no approach.
        """
        parting = self.rests(contacts, joints, restitution, there, rate)
        out: Array = self.solver.tol + parting / np.where(restitution > 0.0, restitution, 1.0)
        return out

    def sunk(self, contacts: ContactSet) -> bool:
        """Whether bodies are in each other by more than `FAST` of the inscribed radius of the smaller shape."""
        if _few.least(contacts.gap) >= -FAST * self.smallest:
            return False
        radius = np.minimum(self.inscribed[contacts.geom1], self.inscribed[contacts.geom2])
        return bool((contacts.gap < -FAST * radius).any())

    def shifted(self, before: Position, after: Position) -> bool:
        """Whether a projection moved points of a free body by more than `FAST` of the least inscribed radius."""
        free = before.x.shape[0]
        if after is before or not free:
            return False
        # Of a small turn the quaternion changes by half.
        turn = 2.0 * np.linalg.norm(after.quaternion - before.quaternion, axis=1)
        moved = np.linalg.norm(after.x - before.x, axis=1) + self.arm[:free] * turn
        return float(moved.max()) > FAST * self.smallest


class Instant(NamedTuple):
    """A state of the scene with all that a move begins with.

    Attributes
    ----------
    position : Position
    v : ndarray, shape (n,)
    placement : Placement
    contacts : ContactSet
        Found there, with the true gaps of the shapes.
    limits : ndarray
        Gaps of all joint limits, rad or m.
    memory : ContactMemory
    looked : Looked
        Where the contacts were found; not quite here if nothing has moved since.
    warm : Warm
    twists : two ndarrays of shape (frames, 3)
        Of the frames, world axes, m/s and rad/s.
    energies : tuple of (float, float)
        Kinetic and potential, of every tree, J.
    """

    position: Position
    v: Array
    placement: Placement
    contacts: ContactSet
    limits: Array
    memory: ContactMemory
    looked: Looked
    warm: Warm
    twists: tuple[Array, Array]
    energies: Energies


class Impulses(NamedTuple):
    """What acted at one configuration.

    Attributes
    ----------
    contacts : ContactSet
    frame : ndarray, shape (nc, 3, 3)
    u, r : ndarray, shape (nc, 3)
        Relative velocities afterwards [m/s], and impulses on body 2 [N·s], normal first.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    couple : ndarray, shape (nc, 3)
        On body 2, world axes, N·m·s: `nsdyn.stepping.persistence`.
    normal, friction : ndarray, shape (nc,)
        Works, J; that of the couple with the normal one.
    joints : ndarray, shape (7, n)
        On the coordinates of trees: impulses of actuation, of joint limits, of dry joint friction and of external
        wrenches, N m s or N s; displacement by the position projection, rad or m; the most that actuators may give,
        N m s or N s, infinite where they have no limit; and the change of velocity of driven joints, rad/s or m/s.
    links : ndarray, shape (links, 6)
        Of external wrenches on the links of trees, one by joint: force and moment about the world's origin, N·s, N m s.
    created : float
        Energy that impacts created, J.
    time : ndarray, shape (nc,)
        When it acted, s after the beginning of the move, or of the step.
    duration : float
        Of the move, s; 0 of impacts in no time.
    begin : float
        When the move begins, s after the beginning of the step.
    moves : ndarray of bool, shape (n,), or None
        Coordinates of the island that it is of; None for all.
    """

    contacts: ContactSet
    frame: Array
    u: Array
    r: Array
    status: NDArray[np.int8]
    couple: Array
    normal: Array
    friction: Array
    joints: Array
    links: Array
    created: float
    time: Array
    duration: float
    begin: float = 0.0
    moves: Bools | None = None

    @staticmethod
    def joined(done: list[Impulses]) -> Impulses:
        """All that acted in a step, one after the other."""
        contacts = ContactSet._make(
            np.concatenate(columns) for columns in zip(*(a.contacts for a in done), strict=True)
        )
        columns = list(zip(*done, strict=True))[1:8]
        frame, u, r, status, couple, normal, friction = (np.concatenate(parts) for parts in columns)
        joints, links = (np.sum([getattr(a, name) for a in done], axis=0) for name in ("joints", "links"))
        time = np.concatenate([a.time for a in done])
        created, duration = (sum(getattr(a, name) for a in done) for name in ("created", "duration"))
        return Impulses(contacts, frame, u, r, status, couple, normal, friction, joints, links, created, time, duration)


def take(contacts: ContactSet, kept: Bools) -> ContactSet:
    """Some of the contacts."""
    return contacts if kept.all() else ContactSet._make(column[kept] for column in contacts)


def among(x: Index, some: Index) -> Bools:
    """Which of x (n,) are among some: in small arrays ten times as fast as NumPy."""
    out = np.empty(x.size, np.bool_)
    _sorting.among(x, some, out)
    return out


def account(
    s: System,
    met: Encounter,
    forces: Forces,
    velocities: tuple[Array, Array, Array],
    r: Array,
    h: float,
    impact: Impact | None,
    problem: FC3D | None,
    couple: Couple,
    mass: Array,
) -> tuple[Impulses, Works, Warm]:
    """What the impulses of a move and its impacts did, their works, and what they leave.

    Parameters
    ----------
    s : System
    met : Encounter
        What the impulses acted on.
    forces : Forces
    velocities : three ndarrays of shape (n,)
        Before the impacts, after them, and after the impulses.
    r : ndarray, shape (3 nr,)
        Impulses of contacts and joint rows, N·s; empty for none.
    h : float
        The move, s; 0 of impacts alone.
    impact : Impact, optional
    problem : FC3D, optional
        Which r solves.
    couple : Couple
    mass : ndarray, shape (free,)
        Of the free bodies, on which gravity works, kg.
    """
    d, c, nc, nr = s.dynamics, met.contacts, met.frame.shape[0], met.mu.size
    external = beyond = normal_work = friction_work = rest = created = 0.0
    struck = NOTHING if impact is None else impact.r[0::3]
    if h > 0.0:
        out = status, normal, friction, u_end, world = (
            np.empty(nc, np.int8),
            np.empty(nr),
            np.empty(nr),
            np.empty(3 * nr),
            np.empty((nc, 3)),
        )
        bodies = mass, d.gravity, forces.force, forces.torque
        rows, lasting = (
            (met.rows.full.arrays, met.transport, met.mu, met.local, met.frame),
            (met.stays, met.sticks, couple.work, struck),
        )
        external, beyond, normal_work, friction_work, rest = _account.account(
            bodies, (h, s.theta), velocities, rows, r, lasting, s.solver.tol, out
        )
        total = r
    else:
        status, normal, friction, world = np.empty(nc, np.int8), np.zeros(nr), np.zeros(nr), np.zeros((nc, 3))
        total, u_end = np.zeros(3 * nr), met.local[1]
    if impact is not None:
        total, u_end = total + impact.r, u_end if h > 0.0 else impact.u
        normal, friction, created = normal + impact.normal, friction + impact.friction, impact.created
        normal_work += float(impact.normal.sum())
        friction_work += float(impact.friction.sum())
        _law.states(total, met.mu, status)
    if met.joints is not None:
        actuation = float(friction[nc:][met.joints.actuated].sum())
        external, friction_work = external + actuation, friction_work - actuation
    constraint = -float(met.transport @ total) if met.transport.size else 0.0
    works = Works(external, normal_work, friction_work, 0.0, constraint, beyond + rest, 0.0)
    u, impulse = u_end.reshape(-1, 3), total.reshape(-1, 3)
    slots, on_joints = d.joints.impulses(met.joints, impulse[nc:], d.n) if d.trees else d.no_impulses
    if met.joints is not None and h > 0.0:
        slots = slots / h
    if nr > nc:
        u, impulse, normal, friction = u[:nc], impulse[:nc], normal[:nc], friction[:nc]
    basis = None if problem is None else Basis(met.contacts, met.rows, met.frame, problem)
    time = np.empty(nc)
    time.fill((1.0 - s.theta) * h)
    links, turned = np.zeros((d.links, 6)), couple.impulse if couple.impulse.size else np.zeros((nc, 3))
    impulses = Impulses(c, met.frame, u, impulse, status, turned, normal, friction, on_joints, links, created, time, h)
    return impulses, works, Warm(c.key, s.detector.codes(c), world, status, slots, basis)
