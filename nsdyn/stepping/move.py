"""One move of a scene: half a free flow, all forces and impulses at one configuration, half a free flow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nsdyn._kernels import reductions as _few
from nsdyn._kernels.stepping import touching as _touching
from nsdyn._kernels.stepping.solving import PASSES
from nsdyn.collision.contacts import ContactSet, Looked, take, united
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.values import Flow, Placement
from nsdyn.problem.solution import Solution
from nsdyn.stepping.collisions import caught_impacts
from nsdyn.stepping.encounter import Encounter, foresee
from nsdyn.stepping.half import Callbacks, Half, Loads, corrected, first_half
from nsdyn.stepping.instant import Instant, System, among
from nsdyn.stepping.persistence import NO_COUPLE, turned, worked
from nsdyn.stepping.projection import found as found_at
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.sight import caught, caught_limits, missed, others, parting, reached, shown, touched
from nsdyn.stepping.solving import slips_otherwise, solve
from nsdyn.stepping.trial import Known, Trial, parted
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["attempt", "trial"]

NOTHING, NO_SLOTS = np.empty(0), np.empty(0, np.int64)


Needs = tuple[ContactSet, JointRows | None]
"""Contacts and joint rows that the second half of a move may need."""

LOOKS = 4
"""Most times that the impulses of a move are looked for, with the contacts that its motion has shown."""

EFFORT = 8.0
"""What the first look at a collision may cost beyond a rough solution, as a multiple: mostly its motion shows no
other contacts, and that is all. Without those that it shows else the problem may be far harder."""


def trial(
    s: System,
    loads: Loads,
    begin: Instant,
    t: float,
    h: float,
    barred: Index | None,
    begun: Known = None,
) -> Trial:
    """Move for h seconds from the time t.

    With the state (q_k, v_k) and the free flow Φ:

        q~, v⁻ = Φ(q_k, v_k, (1 - θ) h)     v⁺ = v⁻ + M̃⁻¹ (h f̃ + H r)     q_{k+1}, v_{k+1} = Φ(q~, v⁺, θ h)

    and the contact law of `encounter`, with the contacts that the motion shows. Where the callbacks, which `loads`
    gives at a time [s], say another f̃ at the mean velocity ½ (v⁻ + v⁺) the motion is found once more, with that.

    `barred` are codes, as of `others`, of what is left alone where it is open, as is all that would become deep, or
    strike: the move then says what it ran into. None: all is caught. `begun` is what is known of it.
    """
    (half, made), callbacks = parted(begun), loads(t + (1.0 - s.theta) * h)
    if half is None and (s.dynamics.trees or callbacks is not None):
        half = first_half(s, begin, t, h, callbacks)
    if barred is None:
        made = None
    elif made is None and s.mover is not None:
        made = s.mover.respond(s, begin, t, h, barred, half)
    if made is None:
        made = _moved(s, begin, half or first_half(s, begin, t, h, callbacks), barred)
    if barred is not None:
        made = _whole(s, begin, made, barred)
    if (again := corrected(s, begin, made.half, made.v, callbacks)) is not made.half:
        return trial(s, lambda _: None, begin, t, h, barred, again)
    return _met(s, begin, made, barred)


def _moved(s: System, begin: Instant, half: Half, barred: Index | None) -> Trial:
    """The move from its first half, stage by stage; where all is caught, with the contacts that its motion shows."""
    there, needs = _reachable(s, begin, half, barred)
    m = _respond(s, begin, half, there, needs, barred, None)
    kept = NO_SLOTS
    for look in range(1, LOOKS if barred is None else 0):
        half, r = m.half, m.solution.r
        real, memory, kept = shown(s, m.met, r, m.moved, there.memory, half.middle.placement, half.fast, kept)
        if real is m.met.contacts and (m.solution.accepted or look > 1):
            break
        there, needs = there._replace(memory=memory), (real, needs[1])
        m = _respond(s, begin, half, there, needs, barred, m)
    return m


def _whole(s: System, begin: Instant, m: Trial, barred: Index, label: Index | None = None) -> Trial:
    """The move with the contacts that its motion shows to be `missed`; they stay as long as nothing moves."""
    there: Instant | None = None
    for _ in range(LOOKS):
        late = missed(s, m.met, m.normal, m.moved, begin.placement, m.half.middle.placement)
        if late is None:
            break
        if there is None:
            there, (_, joints) = _reachable(s, begin, m.half, barred)
        apart = take(there.contacts, ~among(there.contacts.key, late.key))  # of which it may have been left alone
        contacts, memory = united((apart, late)), there.memory.joined(m.moved.memory, late.key)
        there, met = there._replace(contacts=contacts, memory=memory), united((m.met.contacts, late))
        m = _respond(s, begin, m.half, there, (met, joints), barred, m, label=label)
    return m


def _met(s: System, begin: Instant, m: Trial, barred: Index | None) -> Trial:
    """The move with what it runs into."""
    if barred is None:
        return m
    half, moved = m.half, m.moved
    limits = moved.limits
    if limits.size and not barred.size and _few.least(limits) >= -s.closed:
        limits = NOTHING
    m = _run_into(s, m, limits)
    if not half.fast or barred.size:
        return m
    contacts = begin.contacts, take(m.met.contacts, m.normal > 0.0), moved.contacts
    places = begin.placement, half.middle.placement, moved.placement
    own = contacts, places, half.turns(begin, moved), moved.memory
    return m._replace(touched=touched(s, *own, half.h, half.reach / half.ahead))


def _run_into(s: System, m: Trial, limits: Array) -> Trial:
    """The move with what strikes where it ends, of contacts and such gaps of joint limits."""
    slots = NO_SLOTS if m.met.joints is None else m.met.joints.slot
    hits, limit = others(s, m.moved.contacts, m.met.contacts, m.normal, limits, slots)
    return m._replace(hits=hits, limit=limit)


def attempt(
    s: System,
    begin: Instant,
    half: Half,
    callbacks: Callbacks,
    label: Index,
    skip: Bools,
    made: Trial | None = None,
    rough: bool = False,
) -> Trial:
    """A move of all islands that leaves alone what may strike, as a `trial` with nothing barred.

    Nodes have the label of their island (nodes,), none of which changes because of another. It is no motion of the
    nodes `skip`, whose contacts are passed over. One that is `made` serves where nothing is. A `rough` one is only to
    show what is met: its persistent contacts do some work.
    """
    if skip.any():
        made = None
    elif made is None and s.mover is not None and not rough:
        made = s.mover.respond(s, begin, half.end - half.h, half.h, NO_SLOTS, half)
    if made is None:
        there, (contacts, joints) = _reachable(s, begin, half, NO_SLOTS)
        if skip.any():
            contacts = take(contacts, ~skip[s.nodes(contacts)])
        made = _respond(s, begin, half, there, (contacts, joints), NO_SLOTS, None, rough, label)
    if not rough:
        made = _whole(s, begin, made, NO_SLOTS, label)
    if (again := corrected(s, begin, made.half, made.v, callbacks)) is not made.half:
        return attempt(s, begin, again, None, label, skip, None, rough)
    return _run_into(s, made, made.moved.limits)


def _reachable(s: System, begin: Instant, half: Half, barred: Index | None) -> tuple[Instant, Needs]:
    """Where a move begins with what is found where its impulses act, and what it needs, unless that is left alone."""
    middle, v, there = half.middle, half.forces.foreseen, begin
    if (looked := s.look(begin.looked, middle.placement, half.reach)) is not None:
        found = s.detector.find(*looked, begin.memory)
        there = begin._replace(contacts=found, memory=found, looked=looked)
    contacts, joints = there.contacts, s.dynamics.joint_rows(middle.placement, middle.v, v, half.h)
    if barred is None:
        if half.fast:
            contacts, memory = reached(s, contacts, begin, middle.placement, there.memory)
            there = there._replace(memory=memory)
        return there, (contacts, joints)
    contacts = caught(s, contacts, begin, half, barred)
    if joints is not None:
        joints = caught_limits(s, joints, begin, v, half.ahead, barred)
    return there, (contacts, joints)


def _respond(
    s: System,
    begin: Instant,
    half: Half,
    there: Instant,
    needs: Needs,
    barred: Index | None,
    last: Trial | None,
    rough: bool = False,
    label: Index | None = None,
) -> Trial:
    """Impulses, and half a free flow; from what was found with other contacts or roughly, if anything was.

    The half has rows for all actuators that the impulses bring to their limits, each of which may take another solve:
    not where nodes have a label, that of their island. Then nothing is done to an island because of another, and that
    is left to see who asks.

    Parameters
    ----------
    s : System
    begin : Instant
        Where the move begins.
    half : Half
        Its first half.
    there : Instant
        What was found where the impulses act.
    needs : Needs
        Of that, what the second half needs.
    barred : ndarray of int, optional
        As of `trial`.
    last : Trial, optional
        What was found before.
    rough : bool
        Whether a rough solution is enough where it is of a collision.
    label : ndarray of int, shape (nodes,), optional
    """
    d, forces = s.dynamics, half.forces
    met, impact = _encounter(s, begin, half, there.looked, needs, label)
    kick = None if impact is None else met.rows.velocity_change(impact.r)
    slides = foresee(met, begin.warm)
    if last is not None:
        _resume(met, slides, last)
    closing = s.closing(half.h, barred is None)
    known = None if last is None else last.solution
    near = 2.0 * half.reach if barred is not None and barred.size else d.nowhere
    effort = 0.0 if rough else EFFORT if barred is None else math.inf
    alone, couple, passes, back = met, NO_COUPLE, 0 if rough else PASSES, barred is None or last is not None
    lasts, left = bool(met.stays.any()), np.full(slides.size, np.inf)
    off: Bools | None = None
    while True:
        met, problem, solution = solve(met, s.solver, known, slides, closing, effort, label is None, off)
        v = forces.v + couple.dv if couple.dv.size else forces.v
        v = v if kick is None else v + kick
        impulse, v = met.rows.response(solution.r, v)
        if label is None and (limited := d.within_limits(half.middle, forces, v)) is not forces:
            return _respond(s, begin, replace(half, forces=limited), there, needs, barred, last, rough)
        if impact is not None:
            impulse = met.rows.full.momentum(solution.r + impact.r)
        passes = passes if solution.accepted else 0
        slips = np.zeros(slides.size, np.bool_)
        if passes:
            slips = slips_otherwise(met, problem, solution, slides, back, off)
        turn = turned(s, met, half, solution, v, slides, couple, left) if passes and lasts else None
        off = np.zeros(alone.end_gap.size, np.bool_)
        if barred is not None or not passes or (turn is None and not slips.any()):
            trees, moved = _arrive(s, half, there, v, impulse, near)
            if passes and lasts and barred is not None:
                alone, off = _ending(s, half, alone, solution, moved)
        if turn is not None:
            couple, other = turn
            slips |= other
        left[off[: left.size]] = np.inf
        off[: slips.size] |= slips
        if not (passes and off.any()):
            break
        met, known, passes, back = alone.turned(couple.dv, solution.r), solution, passes - 1, True
    couple = worked(s, met, half, v, couple)
    solved = slides, problem, solution, couple
    return Trial(half, met, impact, *solved, v, impulse, trees, moved)


def _arrive(
    s: System, half: Half, at: Instant, v: Array, impulse: Array, near: Array
) -> tuple[tuple[Flow, ...], Instant]:
    """The second half of a move: what trees do in it, and where it ends, with what is found there.

    It goes on from what is found `at` the impulses H r (n,) that leave the velocity v (n,), and contacts are sought as
    far as `near` (frames,) from each frame, m.
    """
    d = s.dynamics
    position, v_end, there, trees = d.end(half.middle, half.forces, v, impulse, half.ahead, half.driven)
    moved = at._replace(
        position=position, v=v_end, placement=there, limits=NOTHING, twists=d.twists(there, v_end), energies=()
    )
    if (looked := s.look(at.looked, there, near)) is None:
        return trees, moved._replace(limits=d.limits(there))
    return trees, found_at(s, moved, looked)


def _encounter(
    s: System, begin: Instant, half: Half, looked: Looked, needs: Needs, label: Index | None
) -> tuple[Encounter, Impact | None]:
    """What the second half meets, with impacts that it catches."""
    d, (contacts, joints) = s.dynamics, needs
    there, every = half.middle.placement, d.with_actuators(joints, half.forces)
    met = Encounter.of(half, there._replace(x=looked.x, R=looked.R), contacts, every, begin)
    impact: Impact | None = None
    if label is None:
        met, impact = caught_impacts(s, met, there, half.rate, half.h)
    limits = _limits(s, met.joints, begin.placement)
    return met.lasting(s, begin, limits, half.h, impact is not None), impact


def _ending(s: System, half: Half, met: Encounter, solution: Solution, moved: Instant) -> tuple[Encounter, Bools]:
    """What is met with the gaps that rows end with, and which rows end otherwise than the solution tells."""
    d, there, joints = s.dynamics, moved.placement, met.joints
    gap = s.detector.gaps(met.contacts, moved.contacts, there)
    if joints is not None:
        gap = np.concatenate((gap, _limits(s, joints, there)))
    closed = max(s.closed, solution.residual * half.h)
    if not (off := met.off(gap, solution.r, closed)).any():
        return met, off
    parts = parting(d, moved.contacts, there, moved.v, moved.position.driven_x, half.surfaces[2])
    rates = NOTHING if joints is None else d.joints.rates(joints.slot, moved.v)
    return met.corrected(gap, off, closed, half.ahead, (moved.contacts.key, parts, rates)), off


def _limits(s: System, joints: JointRows | None, there: Placement) -> Array:
    """The gaps of joint rows somewhere, rad or m; infinite for friction and actuators."""
    if joints is None:
        return NOTHING
    gaps = s.dynamics.joints.gaps(joints.slot, s.dynamics.angles(there))
    return np.where(joints.mu > 0.0, np.inf, gaps)


def _resume(met: Encounter, slides: Bools, last: Trial) -> None:
    """Start from what the last look has left: impulses and slip of contacts that are still there, and joint rows."""
    key, r, rows = last.met.contacts.key, last.solution.r.reshape(-1, 3), last.met.joints
    nc = met.contacts.gap.size
    where = np.empty(nc, np.int64)
    _touching.places(key, met.contacts.key, where)
    known, guess = where >= 0, met.local[4].reshape(-1, 3)
    guess[:nc][known] = r[where[known]]
    slides[known] = last.slides[where[known]]
    if met.joints is not None and rows is not None:  # of which some may be new, those of actuators
        guess[nc:][among(met.joints.slot, rows.slot)] = r[key.size :]
