"""One move of a scene: half a free flow, all forces and impulses at one configuration, half a free flow."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from nsdyn._kernels import reductions as _few
from nsdyn._kernels.stepping import law as _law
from nsdyn.collision.contacts import ContactMemory, ContactSet, Poses
from nsdyn.dynamics.dynamics import Controls, Wrenches
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.tree_values import TreeEnd
from nsdyn.dynamics.values import Energies, Forces, Middle, Placement, Position
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping import free as _free
from nsdyn.stepping.collisions import caught_impacts
from nsdyn.stepping.encounter import SOLVES, Encounter, foresee
from nsdyn.stepping.energy import Works
from nsdyn.stepping.impacts import Impact
from nsdyn.stepping.instant import FAST, Impulses, Instant, Looked, System, account
from nsdyn.stepping.persistence import NO_COUPLE, Couple, solve_workless
from nsdyn.stepping.projection import Placed, place, project
from nsdyn.stepping.sight import Unmet, caught, caught_limits, others, reached, shown, touched
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["STILL_SURFACES", "Callbacks", "Half", "Move", "Trial", "finish", "first_half", "tree_works", "trial"]

NOTHING, NO_SLOTS = np.empty(0), np.empty(0, np.int64)
STILL_SURFACES = (np.empty((0, 2, 3)),) * 3

GAPS = 3
"""Most times that the gaps which persistent contacts are found to end with are closed."""

LOOKS = 4
"""Most times that the impulses of a move are looked for, with the contacts that its motion has shown."""

Callbacks = Callable[[Position, Array], tuple[Wrenches | None, Controls]] | None


class Move(NamedTuple):
    """A move and its end.

    Attributes
    ----------
    end : Instant
    impulses : Impulses
    works : list of Works
        Of its parts.
    problem : FC3D
    solution : Solution
        Of the last problem solved.
    clear : bool
        Whether the end is without overlap.
    rate : ndarray, shape (n,)
        Free acceleration M̃⁻¹ f̃, m/s² and rad/s².
    """

    end: Instant
    impulses: Impulses
    works: list[Works]
    problem: FC3D
    solution: Solution
    clear: bool
    rate: Array


class Seen(NamedTuple):
    """What was found where the impulses of a move act.

    Attributes
    ----------
    contacts : ContactSet
    memory : ContactMemory
    looked : Looked
    """

    contacts: ContactSet
    memory: ContactMemory
    looked: Looked


class Half(NamedTuple):
    """The first half of a move.

    Attributes
    ----------
    h, ahead : float
        The move and its second half, s.
    middle : Middle
        Where the forces and impulses act.
    forces : Forces
    rate : ndarray, shape (n,)
        Free acceleration M̃⁻¹ f̃, m/s² and rad/s².
    reach : ndarray, shape (frames,)
        How far points of the frames may move in the second half, m.
    fast : bool
        Whether that is so far that it might go unseen.
    same : bool
        Whether the contacts found where the move begins are those of there.
    surfaces : three ndarrays of shape (surfaces, 2, 3)
        Twists of what moves as prescribed: at the beginning, when the impulses act, at the end.
    """

    h: float
    ahead: float
    middle: Middle
    forces: Forces
    rate: Array
    reach: Array
    fast: bool
    same: bool
    surfaces: tuple[Array, Array, Array]


class Response(NamedTuple):
    """What the contacts of a move do, and where it then ends.

    Attributes
    ----------
    met : Encounter
    impact : Impact or None
        Impacts that were caught, before the other impulses.
    kick : ndarray or 0
        Change of v by them.
    slides : ndarray of bool, shape (nc,)
        Contacts that slide through.
    problem : FC3D
    solution : Solution
    otherwise : bool
        Whether contacts slide otherwise than foreseen.
    couple : Couple
    v : ndarray, shape (n,)
        v⁺.
    impulse : ndarray, shape (n,), or None
        H r of all; None in scenes of free bodies alone.
    v_end : ndarray, shape (n,)
    trees : tuple of TreeEnd
    twists : two ndarrays of shape (frames, 3)
        Of the frames, where the motion ends.
    moved : Placed
        Where the motion ends, whatever overlaps there.
    """

    met: Encounter
    impact: Impact | None
    kick: Array | float
    slides: Bools
    problem: FC3D
    solution: Solution
    otherwise: bool
    couple: Couple
    v: Array
    impulse: Array | None
    v_end: Array
    trees: tuple[TreeEnd, ...]
    twists: tuple[Array, Array]
    moved: Placed


class Trial(NamedTuple):
    """A move whose end may still overlap, and what it ran into.

    Attributes
    ----------
    half : Half
    joints : JointRows or None
    seen : Seen
    response : Response
    unmet : Unmet, optional
        What the motion did not meet, where it ends; None where there is nothing or all was caught.
    touched : float
        Time just after a pair that is open where the move begins touches on its way, s; that of the move if none does,
        or if nothing is so fast that it might go unseen.
    """

    half: Half
    joints: JointRows | None
    seen: Seen
    response: Response
    unmet: Unmet | None
    touched: float


def trial(
    s: System, begin: Instant, t: float, h: float, callbacks: Callbacks, barred: Index | None, half: Half | None = None
) -> Trial:
    """Move for h seconds from the time t.

    With the state (q_k, v_k) and the free flow Φ:

        q~, v⁻ = Φ(q_k, v_k, (1 - θ) h)     v⁺ = v⁻ + M̃⁻¹ (h f̃ + H r)     q_{k+1}, v_{k+1} = Φ(q~, v⁺, θ h)

    and the contact law of `encounter`, with the contacts that the motion shows.

    Parameters
    ----------
    s : System
    begin : Instant
    t, h : float
        s.
    callbacks : callable, optional
        (wrenches, control) at a position and a velocity.
    barred : ndarray of int, optional
        Codes, as of `Unmet`, of what is left alone where it is open, as is all that would become deep, or strike: the
        move then says what it ran into. None: all is caught.
    half : Half, optional
        Where it is known.
    """
    half = half or first_half(s, begin, t, h, callbacks)
    contacts, joints, seen = _reachable(s, begin, half, barred)
    # What the motion shows is mostly more: until it shows no other contacts, collisions are solved roughly.
    rough = barred is None
    half, response = _respond(s, begin, half, contacts, joints, seen, barred, None, rough)
    missed = NO_SLOTS
    for left in reversed(range(LOOKS - 1 if barred is None else 0)):
        places = half.middle.placement, response.moved.placement
        found = response.moved.contacts
        real, memory, missed = shown(
            s, response.met, response.solution.r, found, seen.memory, places, half.fast, missed
        )  # fmt: skip
        seen = seen._replace(memory=memory)
        same = real is response.met.contacts and not response.otherwise
        if same and (response.solution.converged or not rough):
            break
        rough = not same and left > 0
        half, response = _respond(s, begin, half, real, joints, seen, barred, response, rough)
    unmet, until = None, h
    if barred is not None:
        moved = response.moved
        limits = moved.limits
        if limits.size and not barred.size and _few.least(limits) >= -s.closed:
            limits = NOTHING
        unmet = others(s, moved.contacts, response.met.contacts, limits, NO_SLOTS if joints is None else joints.slot)
        if half.fast:
            places = half.middle.placement, moved.placement
            until = touched(s, begin, places, seen.memory, h, half.reach / half.ahead)
    return Trial(half, joints, seen, response, unmet, until)


def first_half(s: System, begin: Instant, t: float, h: float, callbacks: Callbacks) -> Half:
    """Half a free flow, and the forces there."""
    d, ahead = s.dynamics, s.theta * h
    if d.alone and callbacks is None:
        x, quaternion, v, R, v_free, rate, reach, far, same = _free.half(s, begin, h)
        middle = Middle(begin.position.moved(x, quaternion), v, Placement(x, R, ()), ())
        fast = far > FAST * s.smallest
        return Half(h, ahead, middle, d.free_forces(v_free), rate, reach, fast, same, STILL_SURFACES)
    surfaces = STILL_SURFACES
    if d.surfaces.count:
        begun, ended = d.surfaces.twists(t), d.surfaces.twists(t + h)
        surfaces = begun, d.surfaces.mean(begun, ended, 0.5), ended
    middle = d.halfway(begin.position, begin.v, h, s.theta, surfaces[0])
    given = (None, {}) if callbacks is None else callbacks(middle.position, begin.v)
    forces = d.forces(middle, t + h, h, *given, begin.warm.joints)
    reach = d.reach(middle.placement, forces.foreseen, ahead, h, surfaces[2])
    fast = _few.most(reach) > FAST * s.smallest
    same = s.unmoved(begin.looked, middle.placement, reach)
    rate = forces.foreseen - middle.v
    rate /= h
    return Half(h, ahead, middle, forces, rate, reach, fast, same, surfaces)


def _reachable(
    s: System, begin: Instant, half: Half, barred: Index | None
) -> tuple[ContactSet, JointRows | None, Seen]:
    """Contacts and joint rows that the second half may need, but for what is to be left alone; all that was found."""
    middle, v = half.middle, half.forces.foreseen
    x, R, _ = middle.placement
    if half.same:
        seen = Seen(begin.contacts, begin.memory, begin.looked)
    else:
        seen = Seen(*s.detector.find(x, R, half.reach, begin.memory), Looked(x, R, half.reach))
    contacts, joints = seen.contacts, s.dynamics.joint_rows(middle.placement, middle.v, v, half.h)
    if barred is None:
        if half.fast:
            contacts, memory = reached(s, contacts, begin, middle.placement, seen.memory)
            seen = seen._replace(memory=memory)
        return contacts, joints, seen
    contacts = caught(s, contacts, begin, middle.placement, v, half.ahead, barred)
    if joints is not None:
        joints = caught_limits(s, joints, begin, v, half.ahead, barred)
    return contacts, joints, seen


def _respond(
    s: System, begin: Instant, half: Half, contacts: ContactSet, joints: JointRows | None, seen: Seen,
    barred: Index | None, last: Response | None, rough: bool,
) -> tuple[Half, Response]:  # fmt: skip
    """Impulses, and half a free flow; from what was found with other contacts or roughly, if anything was.

    The half has rows for all actuators that the impulses bring to their limits, each of which may take another solve.
    """
    d, middle, forces, closing = s.dynamics, half.middle, half.forces, s.closing(half.h, barred is None)
    if d.alone:
        where = middle.placement.x, middle.placement.R, middle.v, forces.v
        rows, frame, local, end_gap, place_of, slides, posed = _free.meet(
            s, contacts, *where, begin, half.reach, closing, half.h
        )
        met = Encounter(
            contacts, None, rows, frame, None, contacts.mu, contacts.restitution, place_of, begin.warm.status, local,
            end_gap, slides=slides, posed=posed,
        )  # fmt: skip
    else:
        start = begin.contacts, begin.position.driven_x, begin.placement, begin.twists, begin.v, begin.warm
        every, moving = d.with_actuators(joints, forces), half.surfaces[1:]
        met = Encounter.of(d, contacts, every, middle, forces, start, half.reach, moving, half.h, half.ahead, closing)
    met, impact, kick = caught_impacts(s, met, middle.placement, half.rate, half.h)
    met = met.lasting(s.last_status(contacts, begin.warm), begin.contacts, s.closed, half.h, impact is not None)
    slides = foresee(met)
    if last is not None:
        met = met.otherwise()
        _resume(met, slides, last)
    # What catches its impacts is of first order anyway: there only what stops is worth another solve.
    most, back = (0, True) if barred is None else (SOLVES, last is not None)
    before = None if last is None else last.solution
    near = 2.0 * half.reach if barred is not None and barred.size else d.nowhere
    impulse: Array | None = None
    trees: tuple[TreeEnd, ...] = ()
    alone, couple = met, NO_COUPLE
    for left in reversed(range(GAPS + 1 if barred is not None else 1)):
        met, problem, solution, otherwise, couple = solve_workless(
            s, alone, middle, forces, half.h, before, closing, slides, back, most, rough, couple
        )
        v = forces.v + couple.dv if couple.dv.size else forces.v
        v = v if impact is None else v + kick
        if d.alone:
            at = middle.position
            v, x, quaternion, v_end, R, twists, same = _free.end(
                s, at.x, at.quaternion, met.rows, solution.r, v, half.ahead, seen.looked, near
            )
            end, there = at.moved(x, quaternion), Placement(x, R, ())
        else:
            impulse, v = met.rows.response(solution.r, v)
            if (limited := d.within_limits(middle, forces, v)) is not forces:
                return _respond(s, begin, half._replace(forces=limited), contacts, joints, seen, barred, last, rough)
            if impact is not None:
                impulse = met.rows.full.momentum(solution.r + impact.r)
            end, v_end, there, trees = d.end(middle, forces, v, impulse, half.ahead, half.surfaces[2])
            twists, same = d.twists(there, v_end), s.unmoved(seen.looked, there, near)
        if same:
            moved = Placed(end, there, seen.contacts, d.limits(there), seen.memory, True)
        else:
            moved = place(d, s.detector, end, there, seen.memory, near)
        if not left or not met.stays.any():
            break
        gap = s.detector.gaps(contacts, moved.contacts, Poses(there.x, there.R))
        corrected = alone.corrected(gap, solution.r, s.near(contacts), s.closed)
        if corrected is None:
            break
        alone, before = corrected, solution
    return half, Response(
        met, impact, kick, slides, problem, solution, otherwise, couple, v, impulse, v_end, trees, twists, moved
    )


def _resume(met: Encounter, slides: Bools, last: Response) -> None:
    """Start from what the last look has left: impulses and slip of contacts that are still there, and joint rows."""
    key, r, rows = last.met.contacts.key, last.solution.r.reshape(-1, 3), last.met.joints
    nc = met.contacts.gap.size
    where = np.empty(nc, np.int64)
    _law.places(key, met.contacts.key, where)
    known, guess = where >= 0, met.local[4].reshape(-1, 3)
    guess[:nc][known] = r[where[known]]
    slides[known] = last.slides[where[known]]
    if met.joints is not None and rows is not None:  # of which some may be new, those of actuators
        guess[nc:][np.isin(met.joints.slot, rows.slot)] = r[key.size :]


def finish(s: System, begin: Instant, tried: Trial) -> Move:
    """The move to a position without overlap, and what was done on its way."""
    d, half, seen, a = s.dynamics, tried.half, tried.seen, tried.response
    placed = project(d, s.detector, a.moved, half.forces, s.closed)
    v = half.middle.v
    velocities = v, v if a.impact is None else v + a.kick, a.v
    impulses, own, warm = account(
        s, a.met, half.forces, velocities, a.solution.r, half.h, a.impact, a.problem, a.couple
    )
    works = []
    v_end, twists = a.v_end, a.twists
    if placed is not a.moved:
        v_end, lifted = d.lift(a.moved.position, placed.position, v_end)
        twists = d.twists(placed.placement, v_end)
        works.append(Works(projection=lifted))
        for t, q, there in zip(d.trees, a.moved.position.trees, placed.position.trees, strict=True):
            impulses.joints[4, t.coordinates] = pin.difference(t.model, q, there)
    energies: Energies = ()
    if a.impulse is not None:
        own, energies = tree_works(s, begin, half, a.v, a.trees, a.impulse, placed.position, impulses.joints, own)
        if a.impact is not None:
            works.append(_struck(s, half, a, a.impact, a.impulse))
    looked = seen.looked
    if placed.contacts is not seen.contacts:
        looked = Looked(placed.placement.x, placed.placement.R, d.nowhere)
    end = Instant(
        placed.position, v_end, placed.placement, placed.contacts, placed.limits, placed.memory, looked, warm,
        twists, energies,
    )  # fmt: skip
    return Move(end, impulses, [own, *works], a.problem, a.solution, placed.clear, half.rate)


def tree_works(
    s: System, begin: Instant, half: Half, v: Array, ends: tuple[TreeEnd, ...], impulse: Array, lifted: Position,
    joints: Array, own: Works,
) -> tuple[Works, Energies]:  # fmt: skip
    """Works of the trees and `own` ones, of contacts and joint rows, and their energies where they are lifted to, J.

    The forces leave v, with the impulses H r of contacts and joint rows; those of actuation, of external wrenches and
    the most that actuators may give go into rows 0, 3 and 5 of joints (6, n).
    """
    external, normal, friction, damping, constraint, integration, projection = own
    energies = []
    for t, before, free, end, q, energy in zip(
        s.dynamics.trees, half.middle.trees, half.forces.trees, ends, lifted.trees, begin.energies, strict=True
    ):
        k = t.coordinates
        w = t.works(before, free, v[k], end, q, impulse[k], energy)
        joints[0, k] += w.joints
        joints[3, k] = half.h * free.loads.push
        joints[5, k] = math.inf if free.loads.limit is None else half.h * free.loads.limit
        energies.append((w.kinetic, w.potential))
        external, damping, constraint = external + w.actuation, damping + w.damping, constraint + w.constraint
        integration, projection = integration + w.integration, projection + w.projection
    return Works(external, normal, friction, damping, constraint, integration, projection), tuple(energies)


def _struck(s: System, half: Half, a: Response, impact: Impact, impulse: Array) -> Works:
    """What the rows that work on the trees in two parts do, at two mean velocities, and not at that of the forces."""
    full, v, struck = a.met.rows.full, half.middle.v, half.middle.v + a.kick
    first, second = full.momentum(impact.r), full.momentum(a.solution.r)
    booked = 0.5 * (first * (v + struck) + second * (struck + a.v))
    own = zip((t.coordinates for t in s.dynamics.trees), a.trees, strict=True)
    return Works(integration=sum(float(impulse[k] @ end.mean - booked[k].sum()) for k, end in own))
