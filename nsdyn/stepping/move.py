"""One move of a scene: half a free flow, all forces and impulses at the midpoint, half a free flow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from nsdyn._kernels.stepping import touching as _touching
from nsdyn._kernels.stepping.solving import PASSES
from nsdyn.collision.contacts import ContactSet, DetectionPose, among, take, united
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.values import Flow, Forces, Placement
from nsdyn.stepping.active_set import (
    captured,
    captured_limits,
    continuous_contacts,
    missed_contacts,
    normal_velocities,
    overrun_contacts,
    time_of_impact,
    update_active_set,
)
from nsdyn.stepping.attempt import Attempt, Known, parted
from nsdyn.stepping.collisions import Captured, captured_impacts
from nsdyn.stepping.contact_kinematics import ContactKinematics, predict_sliding
from nsdyn.stepping.midpoint import Loads, Midpoint, corrected, midpoint
from nsdyn.stepping.persistence import NO_COUPLE, turned, worked
from nsdyn.stepping.projection import found as found_at
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.stepping.solving import residuals, solve, update_sliding
from nsdyn.tools.arrays import NONE, NOTHING, Array, Bools, Index

Needs = tuple[ContactSet, JointRows | None]
"""Contacts and joint rows that the second half of a move may need."""

UPDATES = 4
"""Most updates of the active set of a captured move."""

EFFORT = 8.0
"""Effort of the first solve of a collision, as a multiple of that for a rough solution. Mostly the motion then shows no
other contacts, and this solution is final. Without the contacts that the motion shows the problem may be far harder."""


def try_move(
    s: System,
    loads: Loads,
    begin: SceneState,
    t: float,
    h: float,
    located: Index | None,
    begun: Known = None,
    skip: Bools | None = None,
) -> Attempt:
    """Move for h seconds from the time t.

    With the state (q_k, v_k) and the free flow Φ:

        q~, v⁻ = Φ(q_k, v_k, (1 - θ) h)     v⁺ = v⁻ + M̃⁻¹ (h f̃ + H r)     q_{k+1}, v_{k+1} = Φ(q~, v⁺, θ h)

    and the contact law of `contact_kinematics`, for the active set that agrees with the motion. Where callbacks return
    another f̃ at the mean velocity ½ (v⁻ + v⁺), the motion is computed once more, with that f̃.

    Parameters
    ----------
    s : System
    loads : callable
        The callbacks for a time, s.
    begin : SceneState
    t, h : float
        When the move begins and how long it lasts, s.
    located : ndarray of int or None
        Codes, as in `missed_impacts`, of contacts and joint limits whose impacts are to be located. The move leaves
        these out while they are open, and also all contacts that would become deep or strike: `missed_impacts` tells
        which contacts the move runs into. With None, all contacts are captured.
    begun : Midpoint or Attempt, optional
        The known part of the move.
    skip : ndarray of bool, shape (nodes,), optional
        All islands move at once, and none changes because of another; bodies that pass others unseen are left to the
        caller. The result does not tell the motion of these nodes, whose contacts are left out.
    """
    (mid, made), callbacks = parted(begun), loads(t + (1.0 - s.theta) * h)
    if mid is None and (s.dynamics.trees or callbacks is not None):
        mid = midpoint(s, begin, t, h, callbacks)
    if located is None or (skip is not None and skip.any()):
        made = None
    elif made is None and s.mover is not None:
        made = s.mover.respond(s, begin, t, h, located, mid)
    if made is None:
        made = _by_stages(s, begin, mid or midpoint(s, begin, t, h, callbacks), located, skip)
    if located is not None:
        made = _updated(s, begin, made, located, skip is None)
    if (again := corrected(s, begin, made.mid, made.v, callbacks)) is not made.mid:
        return try_move(s, lambda _: None, begin, t, h, located, again, skip)
    return made


def _by_stages(s: System, begin: SceneState, mid: Midpoint, located: Index | None, skip: Bools | None) -> Attempt:
    """Compute the move from its first half, in stages; update the active set where all contacts are captured."""
    there, needs = _detect_at_midpoint(s, begin, mid, located)
    if skip is not None and skip.any():
        needs = take(needs[0], ~skip[s.nodes(needs[0])]), needs[1]
    m = _response(s, begin, mid, there, needs, located, None, skip is None)
    kept = NONE
    for update in range(1, UPDATES if located is None else 0):
        mid, r = m.mid, m.solution.r if m.captured is None else m.solution.r + m.captured.impact.r
        real, memory, kept = update_active_set(s, m.kin, r, m.moved, there.memory, mid, kept)
        if real is m.kin.contacts and (m.solution.accepted or update > 1):
            break
        there, needs = there._replace(memory=memory), (real, needs[1])
        m = _response(s, begin, mid, there, needs, located, m)
    return m


def _updated(s: System, begin: SceneState, m: Attempt, located: Index, single: bool) -> Attempt:
    """Return the move with the active set that its motion shows: missed contacts added, those left behind dropped.

    The added contacts stay among those found as long as nothing moves.
    """
    there: SceneState | None = None
    for _ in range(UPDATES):
        active, middle = m.kin.contacts, m.mid.state.placement
        late = missed_contacts(s, m.kin, m.normal_impulses, m.moved, begin.placement, middle)
        left = overrun_contacts(s, m.kin, m.normal_impulses, m.mid, m.moved)
        if late is None and left is None:
            break
        if there is None:
            there, (_, joints) = _detect_at_midpoint(s, begin, m.mid, located)
        if left is not None:
            active = take(active, ~left)
        if late is not None:
            active = united((active, late))
            apart = take(there.contacts, ~among(there.contacts.key, late.key))  # a late one may be found already
            memory = there.memory.joined(m.moved.memory, late.key)
            there = there._replace(contacts=united((apart, late)), memory=memory)
        m = _response(s, begin, m.mid, there, (active, joints), located, m, single)
    return m


def touch_time(s: System, begin: SceneState, m: Attempt) -> float:
    """Return a time just after a pair that is open where a move begins touches on the way unseen, s; else its length.

    Only bodies that are so fast pass others unseen.
    """
    mid, moved = m.mid, m.moved
    if not mid.fast:
        return mid.h
    contacts = begin.contacts, take(m.kin.contacts, m.normal_impulses > 0.0), moved.contacts
    places = begin.placement, mid.state.placement, moved.placement
    own = contacts, places, mid.turns(begin, moved), moved.memory
    return time_of_impact(s, *own, mid.h, mid.reach / mid.ahead)


def _detect_at_midpoint(s: System, begin: SceneState, mid: Midpoint, located: Index | None) -> tuple[SceneState, Needs]:
    """Return the beginning of a move with the contacts found at its midpoint, and the contacts and rows it needs.

    The second half needs all contacts and joint rows but those that the move leaves out.
    """
    middle, v, there = mid.state, mid.forces.foreseen, begin
    if (detected_at := s.detection_pose(begin.detected_at, middle.placement, mid.reach)) is not None:
        found = s.detector.find(*detected_at, begin.memory)
        there = begin._replace(contacts=found, memory=found, detected_at=detected_at)
    contacts, joints = there.contacts, mid.joints
    if located is None:
        if mid.fast:
            contacts, memory = continuous_contacts(s, contacts, begin, middle.placement, there.memory)
            there = there._replace(memory=memory)
        return there, (contacts, joints)
    contacts = captured(s, contacts, begin, mid, located)
    if joints is not None:
        joints = captured_limits(s, joints, begin, v, mid.ahead, located)
    return there, (contacts, joints)


def _response(
    s: System,
    begin: SceneState,
    mid: Midpoint,
    there: SceneState,
    needs: Needs,
    located: Index | None,
    last: Attempt | None,
    single: bool = True,
) -> Attempt:
    """Solve for the impulses of a move and compute its second half, starting from the last attempt if there is one.

    The second half has rows for all actuators that the impulses bring to their limits, each of which may take another
    solve. Actuators are not checked where all islands move at once: none may change because of another, and
    the caller checks the actuators.

    Parameters
    ----------
    s : System
    begin : SceneState
        Where the move begins.
    mid : Midpoint
        First half of the move.
    there : SceneState
        The beginning, with the contacts found where the impulses act.
    needs : Needs
        Contacts and joint rows that the second half needs.
    located : ndarray of int, optional
        As in `try_move`.
    last : Attempt, optional
        The last attempt, with other contacts or a rough solution.
    single : bool
        Whether a single island moves, not all at once.
    """
    d = s.dynamics
    kin, captured = _kinematics(s, begin, mid, there.detected_at, needs, single)
    forces, kick = (mid.forces, None) if captured is None else (captured.forces, captured.kick)
    sliding = predict_sliding(kin, begin.warm)
    if last is not None:
        _start_from(kin, sliding, last)
    gap_rule = s.gap_rule(mid.h, located is None)
    known = None if last is None else last.solution
    near = 2.0 * mid.reach if located is not None and located.size else d.nowhere
    effort = EFFORT if located is None else math.inf
    alone, couple, passes, back = kin, NO_COUPLE, PASSES, located is None or last is not None
    lasts, left = bool(kin.stays.any()), np.full(kin.contacts.gap.size, np.inf)
    off: Bools | None = None
    while True:
        kin, problem, solution = solve(kin, s.solver, known, sliding, gap_rule, effort, single, off)
        v = forces.v + couple.dv if couple.dv.size else forces.v
        impulse, v = kin.rows.response(solution.r, v)
        if single and (limited := d.within_limits(mid.state, mid.forces, v, kick)) is not mid.forces:
            return _response(s, begin, replace(mid, forces=limited), there, needs, located, last)
        if captured is not None:
            impulse = kin.rows.full.momentum(solution.r + captured.impact.r)
        passes = passes if solution.accepted else 0
        slips = np.zeros(sliding.size, np.bool_)
        if passes:
            slips = update_sliding(kin, problem, solution, sliding, back, off)
        errors = residuals(kin, problem, solution) if passes and lasts else NOTHING
        turn = turned(kin, mid, solution, errors, v, sliding, couple, left) if passes and lasts else None
        off = np.zeros(alone.end_gap.size, np.bool_)
        if located is not None or not passes or (turn is None and not slips.any()):
            trees, moved = _second_half(s, mid, forces, there, v, impulse, near)
            if passes and lasts and located is not None:
                alone, off = _end_gaps(s, mid, alone, solution.r, errors, moved)
        if turn is not None:
            couple, other = turn
            slips[: other.size] |= other
        left[off[: left.size]] = np.inf
        off[: slips.size] |= slips
        if not (passes and off.any()):
            break
        kin, known, passes, back = alone.turned(couple.dv, solution.r), solution, passes - 1, True
    couple = worked(s, kin, mid, v, couple)
    solved = sliding, problem, solution, couple
    return Attempt(mid, kin, captured, *solved, v, impulse, trees, moved)


def _second_half(
    s: System, mid: Midpoint, forces: Forces, at: SceneState, v: Array, impulse: Array, near: Array
) -> tuple[tuple[Flow, ...], SceneState]:
    """Compute the second half of a move: the flows of the trees, and the end with the contacts found there.

    The `forces` and the impulses H r (n,) lead to the velocity v (n,). Detection goes on from the state `at`, and
    searches as far as `near` (frames,) from each frame, m.
    """
    d = s.dynamics
    position, v_end, there, trees = d.end(mid.state, forces, v, impulse, mid.ahead, mid.driven)
    moved = at._replace(
        position=position, v=v_end, placement=there, limits=NOTHING, twists=d.twists(there, v_end), energies=()
    )
    if (detected_at := s.detection_pose(at.detected_at, there, near)) is None:
        return trees, moved._replace(limits=d.limits(there))
    return trees, found_at(s, moved, detected_at)


def _kinematics(
    s: System, begin: SceneState, mid: Midpoint, detected_at: DetectionPose, needs: Needs, single: bool
) -> tuple[ContactKinematics, Captured | None]:
    """Return the contacts and joint rows of the second half of a move, and the impacts captured at its midpoint."""
    d, (contacts, joints) = s.dynamics, needs
    there = mid.state.placement._replace(x=detected_at.x, R=detected_at.R)
    kin = ContactKinematics.of(mid, there, contacts, d.with_actuators(joints, mid.forces), begin)
    captured: Captured | None = None
    if single:
        kin, captured = captured_impacts(s, kin, mid, there)
    limits = _limits(s, kin.joints, begin.placement)
    return kin.lasting(s, begin, limits, mid.h, captured is not None), captured


def _end_gaps(
    s: System, mid: Midpoint, kin: ContactKinematics, r: Array, errors: Array, moved: SceneState
) -> tuple[ContactKinematics, Bools]:
    """Return the rows with their gaps at the end of the move, and mark rows that end otherwise than predicted.

    `errors` (rows,) are those of the velocities of the impulses r, m/s.
    """
    d, there, joints = s.dynamics, moved.placement, kin.joints
    gap = s.detector.gaps(kin.contacts, moved.contacts, there)
    if joints is not None:
        gap = np.concatenate((gap, _limits(s, joints, there)))
    closed = np.maximum(s.gap_tol, errors * mid.h)
    if not (off := kin.off(gap, r, closed)).any():
        return kin, off
    parts = normal_velocities(d, moved.contacts, moved, mid.surfaces[2])
    rates = NOTHING if joints is None else d.joints.rates(joints.slot, moved.v)
    return kin.corrected(gap, off, closed, mid.ahead, (moved.contacts.key, parts, rates)), off


def _limits(s: System, joints: JointRows | None, there: Placement) -> Array:
    """Return the gaps of joint rows at a placement, rad or m; infinite for friction and actuators."""
    if joints is None:
        return NOTHING
    gaps = s.dynamics.joints.gaps(joints.slot, s.dynamics.angles(there))
    return np.where(joints.mu > 0.0, np.inf, gaps)


def _start_from(kin: ContactKinematics, sliding: Bools, last: Attempt) -> None:
    """Start from the last attempt: impulses and slip of contacts that are still active, and of joint rows."""
    key, r, rows = last.kin.contacts.key, last.solution.r.reshape(-1, 3), last.kin.joints
    nc = kin.contacts.gap.size
    where = np.empty(nc, np.int64)
    _touching.places(key, kin.contacts.key, where)
    known, guess = where >= 0, kin.r_last.reshape(-1, 3)
    guess[:nc][known] = r[where[known]]
    sliding[:nc][known] = last.sliding[where[known]]
    if kin.joints is not None and rows is not None:  # some may be new: those of actuators
        same = among(kin.joints.slot, rows.slot)
        guess[nc:][same], sliding[nc:][same] = r[key.size :], last.sliding[key.size :]
