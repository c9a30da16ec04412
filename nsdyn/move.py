"""One move of a scene: half a free flow, all forces and impulses at one configuration, half a free flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels import law as _law
from nsdyn._kernels import motion as _motion
from nsdyn.contacts import ContactMemory, ContactSet, Detector, Poses, Touches, carry
from nsdyn.dynamics import Dynamics, Forces, Middle, Placement, Position
from nsdyn.encounter import SOLVES, Encounter, Warm, foresee, meet, solve
from nsdyn.energy import Works
from nsdyn.impacts import Impact, strike
from nsdyn.joints import JointRows
from nsdyn.problem import FC3D, Array, Index, Solution
from nsdyn.projection import place, project
from nsdyn.solvers import Solver
from nsdyn.trees import TreeEnd

__all__ = ["Impulses", "Instant", "Move", "System", "Unmet", "collide", "move", "others", "take"]

NOTHING, NO_SLOTS = np.empty(0), np.empty(0, np.int64)

LOOKS = 4
"""Most times that the impulses of a move are looked for, with the contacts that its motion has shown."""

FAST = 0.1
"""Fraction of the inscribed radius of the smallest shape beyond which bodies may get so far into each other in half a
move that only the way there tells which sides met."""

DEEP = 1e-3
"""Fraction of the inscribed radius of the smaller shape up to which bodies may run into each other within a step. What
falls so far is lifted again at the end, and the energy of that is numerical."""

JOINT = 0.1
"""What counts for joint limits as the inscribed radius of a shape does, rad or m."""

Bools = NDArray[np.bool_]
Callbacks = Callable[[Position, Array], tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]]


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
        The step of which moves are parts, s: what rests is slower than what forces do in two of them.
    closed : float
        Largest gap that counts as closed, m.
    inscribed : ndarray, shape (geoms,)
        Radii of balls inside the shapes, m.
    impact : str
        Law of impact.
    """

    dynamics: Dynamics
    detector: Detector
    solver: Solver
    theta: float
    dt: float
    closed: float
    inscribed: Array
    impact: str

    @property
    def slow(self) -> float:
        """The least of what is `deep`."""
        return DEEP * float(self.inscribed.min(initial=np.inf))

    def touches(self, begin: Poses, end: Poses, memory: ContactMemory, known: ContactSet) -> Touches:
        """Contacts of `Detector.touches` of pairs so `FAST` that where they end does not tell which sides met."""
        return self.detector.touches(begin, end, memory, known, FAST * self.inscribed)

    def deep(self, contacts: ContactSet) -> Array:
        """Overlaps, m, that a step may catch: deeper ones are impacts to be located; of joint limits DEEP JOINT."""
        out: Array = DEEP * np.minimum(self.inscribed[contacts.geom1], self.inscribed[contacts.geom2])
        return out


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
    warm : Warm
    twists : two ndarrays of shape (frames, 3)
        Of the frames, world axes, m/s and rad/s.
    """

    position: Position
    v: Array
    placement: Placement
    contacts: ContactSet
    limits: Array
    memory: ContactMemory
    warm: Warm
    twists: tuple[Array, Array]


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
    normal, friction : ndarray, shape (nc,)
        Works, J.
    joints : ndarray, shape (n,)
        Impulses of joint limits and dry joint friction on the coordinates, N m s or N s.
    created : float
        Energy that impacts created, J.
    """

    contacts: ContactSet
    frame: Array
    u: Array
    r: Array
    status: NDArray[np.int8]
    normal: Array
    friction: Array
    joints: Array
    created: float


class Unmet(NamedTuple):
    """Contacts and joint limits that a move leaves alone, at one instant.

    Attributes
    ----------
    code : ndarray of int, shape (k,)
        Of the pair of shapes, -1 - i of joint limit i.
    gap, limit : ndarray, shape (k,)
        m or rad; overlaps of more than `limit` are impacts to be located.
    """

    code: Index
    gap: Array
    limit: Array


class Move(NamedTuple):
    """A move and its end.

    Attributes
    ----------
    end : Instant
    impulses : Impulses
    works : Works
    problem : FC3D
    solution : Solution
        Of the last problem solved.
    clear : bool
        Whether the end is without overlap.
    unmet : Unmet, optional
        What the motion did not meet, where it ends; None where there is nothing or all was caught.
    touched : float
        Time until a pair that is open where the move begins touches on its way, s; that of the move if none does, or
        if nothing is so fast that it might go unseen.
    rate : ndarray, shape (n,)
        Free acceleration M̃⁻¹ f̃, m/s² and rad/s².
    """

    end: Instant
    impulses: Impulses
    works: Works
    problem: FC3D
    solution: Solution
    clear: bool
    unmet: Unmet | None
    touched: float
    rate: Array


def take(contacts: ContactSet, kept: Bools) -> ContactSet:
    """Some of the contacts."""
    return contacts if kept.all() else ContactSet(*(column[kept] for column in contacts))


def move(s: System, begin: Instant, t: float, h: float, callbacks: Callbacks, barred: Index | None) -> Move:
    """Move for h seconds from the time t.

    With the state (q_k, v_k) and the free flow Φ:

        q~, v⁻ = Φ(q_k, v_k, (1 - θ) h)     v⁺ = v⁻ + M̃⁻¹ (h f̃ + H r)     q_{k+1}, v_{k+1} = Φ(q~, v⁺, θ h)

    and the contact law of `encounter`; then positions without overlap.

    Parameters
    ----------
    s : System
    begin : Instant
    t, h : float
        s.
    callbacks : callable
        (wrenches, joint forces) at a position and a velocity.
    barred : ndarray of int, optional
        Codes, as of `Unmet`, of what is left alone where it is open, as is all that would become deep, or strike: the
        move then says what it ran into. None: all is caught.
    """
    d, after = s.dynamics, s.theta * h
    begun, ended = d.surfaces.twists(t), d.surfaces.twists(t + h)
    # Half a free flow, and the forces there.
    middle = d.halfway(begin.position, begin.v, h, s.theta, begun)
    forces = d.forces(middle, t + h, h, *callbacks(middle.position, begin.v))
    # What can touch until the end.
    reach = d.reach(middle.placement, forces.v, after, h, ended)
    contacts, memory = s.detector.find(middle.placement.x, middle.placement.R, reach, begin.memory)
    fast = float(reach.max(initial=0.0)) > FAST * float(s.inscribed.min(initial=np.inf))
    if barred is not None:
        contacts = _caught(s, contacts, begin, middle.placement, forces.v, after, barred)
    elif fast:
        contacts, memory = _reached(s, contacts, begin, middle.placement, memory)
    joints = d.joint_rows(middle.position, middle.v, forces.v, h)
    if barred is not None and joints is not None:
        joints = _caught_limits(s, joints, begin, forces.v, after, barred)
    start = begin.contacts, begin.position.driven_x, begin.placement, begin.twists, begin.v, begin.warm
    surfaces = d.surfaces.mean(begun, ended, 0.5), ended
    touched = np.empty(0, np.int64)
    for look in range(LOOKS):
        # Impulses, and half a free flow.
        met = meet(d, contacts, joints, middle, forces, start, reach, surfaces, after)
        met, impact, kick = _struck(s, met, h)
        slides = foresee(met)
        if look:
            _resume(met, slides, *last)
        most = 0 if barred is None else SOLVES
        problem, solution, otherwise = solve(met, s.solver, after, s.closed, slides, look > 0, most)
        v_plus = forces.v + kick + met.rows.velocity_change(solution.r)
        impulse = None
        if d.trees:
            impulse = met.rows.full.momentum(solution.r if impact is None else solution.r + impact.r)
        end, v_end, there, trees = d.end(middle, forces, v_plus, impulse, after, ended)
        moved = place(d, s.detector, end, there, memory, 2.0 * reach if barred is not None and barred.size else None)
        # A step is what its motion shows: no contact that it does not reach, none that it passes through.
        if barred is not None or look == LOOKS - 1:
            break
        real = ~_ghosts(s, met, solution.r, moved.contacts) | np.isin(contacts.key, touched)
        last = contacts.key, solution.r, slides
        if fast:
            missed = s.touches(Poses(*middle.placement[:2]), Poses(there.x, there.R), memory, contacts)
            if missed.fraction.size:
                late = carry(missed.contacts, Poses(there.x, there.R), Poses(*middle.placement[:2]))
                contacts, memory = _merged(take(contacts, real), late, s.detector), missed.memory
                touched = np.concatenate((touched, late.key))
                continue
        if real.all() and not (otherwise and look == 0):
            break
        contacts = take(contacts, real)
    placed = project(d, s.detector, moved, forces, s.closed)
    impulses, works, warm = _account(s, met, forces, (middle.v, middle.v + kick, v_plus), solution.r, h, impact)
    if placed is not moved:
        v_end, lifted = d.lift(moved.position, placed.position, v_end)
        works += Works(projection=lifted)
    if impulse is not None:
        works += _tree_works(s, middle, forces, v_plus, trees, placed.position, impulse, met, impact, solution.r, kick)
    instant = Instant(
        placed.position, v_end, placed.placement, placed.contacts, placed.limits, placed.memory, warm,
        d.twists(placed.placement, v_end),
    )  # fmt: skip
    unmet = None
    if barred is not None:
        limits = moved.limits if barred.size or (moved.limits < -s.closed).any() else NOTHING
        unmet = others(s, moved.contacts, met.contacts, limits, NO_SLOTS if joints is None else joints.slot)
    touched = h if barred is None or not fast else _touched(s, begin, middle.placement, there, memory, h)
    rate = (forces.v - middle.v) / h
    return Move(instant, impulses, works, problem, solution, placed.clear, unmet, touched, rate)


def _reached(
    s: System, contacts: ContactSet, begin: Instant, there: Placement, memory: ContactMemory
) -> tuple[ContactSet, ContactMemory]:
    """Contacts where the impulses act, of which pairs deep in each other have those with which they touched."""
    closed = take(begin.contacts, begin.contacts.gap <= s.closed)
    touches = s.touches(Poses(*begin.placement[:2]), Poses(*there[:2]), memory, closed)
    deep = touches.contacts.gap < -s.deep(touches.contacts) * FAST / DEEP
    if not deep.any():
        return contacts, memory
    first = take(touches.contacts, deep)
    codes = s.detector.codes
    others = take(contacts, ~np.isin(codes(contacts), codes(first)))
    return _merged(others, first, s.detector), touches.memory


def _merged(one: ContactSet, other: ContactSet, detector: Detector) -> ContactSet:
    """Contacts of both, sorted by their pairs."""
    both = ContactSet(*(np.concatenate(columns) for columns in zip(one, other, strict=True)))
    order = np.argsort(detector.codes(both), kind="stable")
    return ContactSet(*(column[order] for column in both))


def _resume(met: Encounter, slides: Bools, key: Index, r: Array, slid: Bools) -> None:
    """Start from what the last look has left: impulses and slip of the contacts of these names, and joint rows."""
    where, nc = _law.places(key, met.contacts.key), met.contacts.gap.size
    known, guess = where >= 0, met.guess.reshape(-1, 3)
    guess[:nc][known] = r.reshape(-1, 3)[where[known]]
    slides[known] = slid[where[known]]
    guess[nc:] = r.reshape(-1, 3)[key.size :]


def _ghosts(s: System, met: Encounter, r: Array, found: ContactSet) -> Bools:
    """Contacts that have an impulse but are open where the motion ends: bodies pass there."""
    nc = met.frame.shape[0]
    out: Bools = (r[0 : 3 * nc : 3] > 0.0) & (met.end_gap[:nc] > s.deep(met.contacts))
    if out.any():
        real = found.key[found.gap <= s.deep(found)]
        out &= ~np.isin(met.contacts.key, real)
    return out


def _touched(s: System, begin: Instant, middle: Placement, end: Placement, memory: ContactMemory, h: float) -> float:
    """Time until a pair that is open where a move begins touches on its way, h if none does, s."""
    closed = take(begin.contacts, begin.contacts.gap <= s.closed)
    poses, before = [Poses(*place[:2]) for place in (begin.placement, middle, end)], (1.0 - s.theta) * h
    first = s.touches(poses[0], poses[1], memory, closed).fraction
    if first.size:
        return before * float(first.min())
    second = s.touches(poses[1], poses[2], memory, closed).fraction
    return before + s.theta * h * float(second.min(initial=1.0))


def _tree_works(
    s: System, middle: Middle, forces: Forces, v_plus: Array, ends: tuple[TreeEnd, ...], lifted: Position,
    impulse: Array, met: Encounter, impact: Impact | None, r: Array, kick: Array | float,
) -> Works:  # fmt: skip
    """Works of the trees besides those of contacts and joint rows, J."""
    out = Works()
    if impact is not None:
        # The rows do their work in two parts, at two mean velocities.
        first, second = met.rows.full.momentum(impact.r), met.rows.full.momentum(r)
        struck = middle.v + kick
        booked = 0.5 * (first * (middle.v + struck) + second * (struck + v_plus))
    for t, half, free, end, q in zip(s.dynamics.trees, middle.trees, forces.trees, ends, lifted.trees, strict=True):
        own = t.coordinates
        w = t.works(half, free, v_plus[own], end, q, impulse[own])
        integration = w.integration
        if impact is not None:
            integration += float(impulse[own] @ end.mean - booked[own].sum())
        out += Works(w.actuation, 0.0, 0.0, w.damping, w.constraint, integration, w.projection)
    return out


def _caught(
    s: System, contacts: ContactSet, begin: Instant, placement: Placement, v: Array, ahead: float, barred: Index
) -> ContactSet:
    """Contacts that a move need not leave alone: closed where it begins, or neither barred, deep nor elastic."""
    held = np.empty(contacts.gap.size, np.bool_)
    if _law.known(contacts.key, begin.contacts.key, begin.contacts.gap, s.closed, held):
        return contacts
    shallow = contacts.gap + ahead * _approach(s.dynamics, contacts, placement, v) > -s.deep(contacts)
    shallow &= ~np.isin(s.detector.codes(contacts), barred)
    return take(contacts, held | (shallow & (contacts.restitution == 0.0)))


def _caught_limits(
    s: System, joints: JointRows, begin: Instant, v: Array, ahead: float, barred: Index
) -> JointRows | None:
    """Joint rows that a move need not leave alone, as `_caught` has it of contacts."""
    laws = s.dynamics.joints
    place = np.searchsorted(laws.limits, joints.slot)
    friction = joints.mu > 0.0
    held = begin.limits[np.where(friction, 0, place)] <= s.closed if begin.limits.size else friction
    shallow = joints.gap + ahead * laws.rates(joints.slot, v) > -DEEP * JOINT
    shallow &= ~np.isin(-1 - place, barred)
    return joints.take(friction | held | (shallow & (joints.restitution == 0.0)))


def others(s: System, found: ContactSet, met: ContactSet, limits: Array, slot: Index) -> Unmet | None:
    """Of the contacts found and the gaps of all joint limits, or of none, those not met; None where all are.

    Parameters
    ----------
    s : System
    found, met : ContactSet
    limits : ndarray
    slot : ndarray of int
        Joint rows that are met.
    """
    same = np.empty(found.gap.size, np.bool_)
    if _law.known(found.key, met.key, met.gap, np.inf, same) and not limits.size:
        return None
    left = take(found, ~same)
    code, gap, limit = s.detector.codes(left), left.gap, np.where(left.restitution > 0.0, s.closed, s.deep(left))
    if limits.size:
        laws = s.dynamics.joints
        k = np.flatnonzero(~np.isin(laws.limits, slot))
        depth = np.where(laws.restitution[laws.limits[k]] > 0.0, s.closed, DEEP * JOINT)
        code, gap = np.concatenate((code, -1 - k)), np.concatenate((gap, limits[k]))
        limit = np.concatenate((limit, depth))
    return Unmet(code, gap, limit)


def _approach(d: Dynamics, contacts: ContactSet, placement: Placement, v: Array) -> Array:
    """Normal velocities of contacts at a velocity v of the scene, shape (nc,), m/s; driven bodies at rest."""
    out = np.empty(contacts.gap.size)
    where = contacts.frame1, contacts.frame2, contacts.point, contacts.normal, placement.x
    _law.approach(*where, *d.twists(placement, v), out)
    return out


def _struck(s: System, met: Encounter, h: float) -> tuple[Encounter, Impact | None, Array | float]:
    """Impacts in no time where the other impulses act, of contacts that close within the move.

    What the others meet then, the impacts, and the change of v by them, 0 where there are none.
    """
    if not _law.any_positive(met.restitution):
        return met, None, 0.0
    fall = 2.0 * s.dt / h * np.abs((met.u_free - met.u)[0::3])
    closes = met.end_gap + s.theta * h * (met.u_free + met.turn)[0::3] <= 0.0
    struck = (met.restitution > 0.0) & (met.u_begin[0::3] < -fall) & (met.u[0::3] < 0.0) & closes
    if not struck.any():
        return met, None, 0.0
    # Rows that turn with their bodies are no approach.
    resting = np.where(struck, fall, fall + 2.0 * np.abs(met.turn[0::3]))
    closed = struck | (met.end_gap <= s.closed)
    impact = _strike(s, met, closed, resting, resting)
    kick = met.rows.velocity_change(impact.r)
    return met.changed(kick, struck), impact, kick


def _strike(s: System, met: Encounter, closed: Bools, resting: Array, slow: Array) -> Impact:
    """Impacts of the closed contacts and joint limits; dry friction of joints has no impulse in no time."""
    if met.rows.press.size:
        closed = closed & (met.rows.press[0::3] == 0.0)
    return strike(s.impact, s.solver, met.rows.blocks, met.u, met.mu, met.restitution, closed, resting, slow)


def collide(
    s: System, at: Instant, t: float, h: float, rate: Array
) -> tuple[Instant, Impulses, Works, tuple[FC3D, Solution]] | None:
    """Impacts in no time of what is closed at an instant; None where nothing strikes.

    What rests, but closes so fast that it would become deep in the move to come, strikes without restitution.

    Parameters
    ----------
    s : System
    at : Instant
    t, h : float
        Time, and length of the move to come, s.
    rate : ndarray, shape (n,)
        Free acceleration there, m/s² and rad/s².
    """
    d, c = s.dynamics, at.contacts
    joints = d.joint_rows(at.position, at.v, at.v, 0.0)
    if not (d.surfaces.count or (joints is not None and _hits(s, joints, at.v, h))):
        where = c.frame1, c.frame2, c.point, c.normal, at.placement.x
        limit = s.solver.tol if _law.any_positive(c.restitution) else s.slow / h
        if _law.fastest(c.gap, s.closed, *where, *at.twists) >= -limit:
            return None
    contacts = take(c, c.gap <= s.closed)
    forces, twist = d.inertia(at.position, at.v), d.surfaces.twists(t)
    here = Middle(at.position, at.v, at.placement, ())
    start = contacts, at.position.driven_x, at.placement, at.twists, at.v, at.warm
    met = meet(d, contacts, joints, here, forces, start, np.zeros(d.frames), (twist, twist), 0.0)
    # What the solver's tolerance leaves of a velocity is no approach.
    resting = s.solver.tol + 2.0 * s.dt * np.abs(met.rows.full.relative_velocity(rate)[0::3])
    # What was pressed before turns with its bodies: it closes a little without striking.
    slow, nc, depth = resting, contacts.gap.size, np.full(resting.size, DEEP * JOINT)
    depth[:nc] = np.where(np.isin(contacts.key, at.warm.key[at.warm.status > 0]), np.inf, s.deep(contacts))
    slow = np.where(met.restitution > 0.0, np.minimum(slow, depth / h), depth / h)
    impact = _strike(s, met, met.end_gap <= s.closed, resting, slow)
    if impact.problem is None or impact.solution is None:
        return None
    v = at.v + met.rows.velocity_change(impact.r)
    impulses, works, _ = _account(s, met, forces, (at.v, v, v), NOTHING, 0.0, impact)
    return at._replace(v=v, twists=d.twists(at.placement, v)), impulses, works, (impact.problem, impact.solution)


def _hits(s: System, joints: JointRows, v: Array, h: float) -> bool:
    """Whether a joint at a limit may strike it, at a velocity v and with a move of h s to come."""
    limit = np.where(joints.restitution > 0.0, s.solver.tol, DEEP * JOINT / h)
    return bool(((joints.gap <= s.closed) & (s.dynamics.joints.rates(joints.slot, v) < -limit)).any())


def _account(
    s: System, met: Encounter, forces: Forces, velocities: tuple[Array, Array, Array], r: Array, h: float,
    impact: Impact | None,
) -> tuple[Impulses, Works, Warm]:  # fmt: skip
    """What the impulses r of a move, empty for none, and its impacts did, their works, and what they leave.

    The velocities are those before the impacts, after them, and after r.
    """
    d, nc, nr = s.dynamics, met.frame.shape[0], met.mu.size
    normal, friction, total, u_end = np.zeros(nr), np.zeros(nr), r, met.u if impact is None else impact.u
    status, world, works, created = np.zeros(nc, np.int8), np.zeros((nc, 3)), Works(), 0.0
    if h > 0.0:
        external, beyond = _motion.free_works(d.mass, d.gravity, forces.force, forces.torque, h, s.theta, *velocities)
        works = Works(external, integration=beyond)
    if r.size:
        struck, u_end = NOTHING if impact is None else impact.r[0::3], np.empty(3 * nr)
        full = met.rows.full
        done = _law.outcome(
            full.offset, full.block, full.start, full.h, velocities[2], met.drag, r, met.mu, met.place, met.status,
            struck, met.u, met.u_free, met.turn, met.frame, status, normal, friction, u_end, world,
        )  # fmt: skip
        works += Works(0.0, *done[:2], integration=done[2])
    if impact is not None:
        total = total + impact.r if r.size else impact.r
        normal, friction, created = normal + impact.normal, friction + impact.friction, impact.created
        works += Works(normal=float(impact.normal.sum()), friction=float(impact.friction.sum()))
        _law.states(total, met.mu, status)
    if met.drag.size:
        works += Works(constraint=-float(met.drag @ total))
    slots, on_joints = d.joints.impulses(met.joints, total.reshape(-1, 3)[nc:], d.n)
    impulses = Impulses(
        met.contacts, met.frame, u_end.reshape(-1, 3)[:nc], total.reshape(-1, 3)[:nc], status, normal[:nc],
        friction[:nc], on_joints, created,
    )  # fmt: skip
    return impulses, works, Warm(met.contacts.key, world, status, slots)
