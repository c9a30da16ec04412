"""The active set of contacts of a move: all contacts that agree with the motion of the move, and no others.

Impacts are located as long as the effort allows. Contacts that are open where a move begins, and would strike or become
deep, are then left out of the move and found where they are hit. Otherwise all contacts are captured within the move,
and the active set is checked after it. Pairs that penetrated deeply get the features with which they first touched.
Spurious contacts, which the motion does not reach or leaves behind, are dropped. Missed contacts are added: those of
pairs that would pass through each other, and those that end deep.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.stepping import active_set as _active_set
from nsdyn._kernels.stepping import touching as _touching
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import ContactSet, Poses, among, carry, take, united
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.joints import JointRows
from nsdyn.dynamics.values import Placement
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.midpoint import Midpoint
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.tools.arrays import NONE, Array, Bools, Index

if TYPE_CHECKING:
    from nsdyn.stepping.attempt import Attempt


PAST = 0.05
"""Penetration, over the smaller inscribed radius, at which a fast move is shortened, if it would become more than twice
that: in a shorter move the bodies touch at another time."""

TURN = 1.0
"""Largest turn in half a move, rad, of a body that turns by more than half a revolution: it is followed at a constant
rate."""


def captured(s: System, contacts: ContactSet, begin: SceneState, mid: Midpoint, located: Index) -> ContactSet:
    """Return the contacts that a move includes: closed where it begins, or not deep, soon at rest and not located.

    A contact that separates at the beginning after a rebound is left out: where bodies turn, it may strike again within
    the move. A contact that pressed in the last move carries its load again, though its gap may slightly exceed the gap
    tolerance. The velocity and the geometry at the beginning decide whether a pressing contact becomes deep. The free
    velocity, which no contact has changed, does not: where bodies turn, a motion without contact impulses makes them
    penetrate. The same holds for all contacts of the pair, which the pressing contacts may carry.
    """
    d, c, before, (there, v) = s.dynamics, contacts, begin.contacts, (mid.state.placement, mid.forces.foreseen)
    gap, rate = before.gap, (v - begin.v) / mid.h
    if s.elastic and _reductions.any_below(gap, s.gap_tol) and _reductions.most(before.restitution) > 0.0:
        gap, motion = np.empty(gap.size), (begin.twists, d.twists(begin.placement, rate))
        carried = surface_normal_velocities(d, before, begin.position.driven_x, mid.surfaces[0])
        _active_set.parting(before[:3], begin.placement.x, carried, motion, (s.gap_tol, s.solver.tol, s.bounces), gap)
    out, warm = np.empty(c.gap.size, np.bool_), begin.warm
    if _touching.known(c.key, before.key, gap, s.gap_tol, out):
        return contacts
    parts = normal_velocities(d, before, begin, mid.surfaces[0])
    _active_set.captured(
        c[:3],
        there.x,
        (s.inscribed, s.depth),
        surface_normal_velocities(d, c, mid.state.position.driven_x, mid.surfaces[1]),
        tuple([d.twists(there, w) for w in (begin.v, v, rate)]),
        (before.key, gap, parts, s.gap_tol),
        (warm.key, warm.pair, warm.status),
        (mid.ahead, mid.h, s.solver.tol, s.bounces),
        located,
        out,
    )
    return take(contacts, out)


def captured_limits(
    s: System, joints: JointRows, begin: SceneState, v: Array, ahead: float, located: Index
) -> JointRows | None:
    """Return the joint rows that a move includes, by the rule of `captured`; None if there are none."""
    laws = s.dynamics.joints
    place = np.searchsorted(laws.limits, joints.slot)
    friction = joints.mu > 0.0
    held = begin.limits[np.where(friction, 0, place)] <= s.gap_tol if begin.limits.size else friction
    pressed = begin.warm.joints[joints.slot, 0] > 0.0
    rate = np.where(pressed, laws.rates(joints.slot, begin.v), laws.rates(joints.slot, v))
    shallow = joints.gap + ahead * rate > -s.depth * OPTIONS.joint
    shallow &= ~among(-1 - place, located)
    return joints.take(friction | held | (shallow & (joints.restitution == 0.0)))


def missed_impacts(s: System, m: Attempt) -> tuple[Index, float]:
    """Return codes of contacts and joint limits that a move runs into: not active, and where it ends too deep.

    Return also the penetration allowed to them, m or rad, infinite where nothing strikes. The code of a contact is that
    of its pair of shapes, that of joint limit i is -1 - i. An active contact without impulse counts as not active:
    where bodies turn it may open, and strike again when it closes.
    """
    found, active, limits, r = m.moved.contacts, m.kin.contacts, m.moved.limits, m.normal_impulses
    strikes = limits.size > 0 and _reductions.least(limits) < -s.gap_tol
    if found is active and not strikes:
        return NONE, np.inf
    pressed, known = np.empty(found.gap.size, np.bool_), np.empty(found.gap.size, np.bool_)
    if _touching.known(found.key, active.key, -r, -_touching.LEAST, pressed) and not strikes:
        return NONE, np.inf
    _touching.known(found.key, active.key, -r, np.inf, known)
    left, rests = take(found, ~pressed), known[~pressed]
    code, gap = s.detector.codes(left), left.gap
    limit = np.where((left.restitution > 0.0) & ~rests, s.gap_tol, s.penetration_tol(left))
    if strikes:
        # Impacts of joint limits are few: they are located sharply, with restitution or without.
        slots = NONE if m.kin.joints is None else m.kin.joints.slot
        k = np.flatnonzero(~among(s.dynamics.joints.limits, slots))
        code, gap = np.concatenate((code, -1 - k)), np.concatenate((gap, limits[k]))
        limit = np.concatenate((limit, np.full(k.size, s.gap_tol)))
    hit = gap < -limit
    return code[hit], float(limit[hit].min(initial=np.inf))


def normal_velocities(d: Dynamics, contacts: ContactSet, at: SceneState, surfaces: Array) -> Array:
    """Return the normal velocities of contacts at an instant, shape (nc,), m/s.

    Driven bodies and surfaces have the twists `surfaces` (surfaces, 2, 3).
    """
    out = np.empty(contacts.gap.size)
    _touching.approach(contacts[:3], at.placement.x, at.twists, out)
    return out + surface_normal_velocities(d, contacts, at.position.driven_x, surfaces)


def surface_normal_velocities(d: Dynamics, contacts: ContactSet, driven_x: Array, surfaces: Array) -> Array:
    """Return the part of normal velocities due to moving surfaces and driven bodies, shape (nc,), m/s."""
    if not d.surfaces.count:
        return np.zeros(contacts.gap.size)
    return (contacts.normal * d.surfaces.velocities(contacts, driven_x, surfaces)).sum(axis=1)


def continuous_contacts(
    s: System, contacts: ContactSet, begin: SceneState, there: Placement, memory: ContactSet
) -> tuple[ContactSet, ContactSet]:
    """Return the contacts at the midpoint, for deeply penetrating pairs those of their first touch, and the memory."""
    closed = take(begin.contacts, begin.contacts.gap <= s.gap_tol)
    c, joined = s.detector.carried(s.touches(begin.placement, there, memory, None, closed), there, memory)
    deep = c.gap < -OPTIONS.unseen * np.minimum(s.inscribed[c.geom1], s.inscribed[c.geom2])
    if not deep.any():
        return contacts, memory
    first, codes = take(c, deep), s.detector.codes
    return united((take(contacts, ~among(codes(contacts), codes(first))), first)), joined


def tracked(s: System, begin: ContactSet, end: ContactSet) -> ContactSet:
    """Return the contacts where a move begins of pairs that do not pass through each other unseen.

    Such a contact is found again at the end of the move, with the same features on the same sides.
    """
    c = begin
    where = np.empty(c.gap.size, np.int64)
    _touching.places(end.key, c.key, where)
    same = where >= 0
    same[same] = (c.normal[same] * end.normal[where[same]]).sum(axis=1) > 0.0
    return take(c, same)


def time_of_impact(
    s: System,
    contacts: tuple[ContactSet, ContactSet, ContactSet],
    places: tuple[Poses, Poses, Poses],
    turns: tuple[Array, Array],
    memory: ContactSet,
    h: float,
    speed: Array,
) -> float:
    """Return a time just after an open pair touches unseen in a move of h s, s; h if none does.

    If a body of a pair that may touch turns by half a turn, return instead the length of a move in which bodies of this
    kind turn by no more than `TURN` in either half. The time is only a little after the touch, so that the body that is
    hit is seen from the side where it is: the frames move with `speed` (frames,). `places` are the poses where the move
    begins, where its impulses act and where it ends. `contacts` are those at the beginning, those that press and those
    at the end. Pairs that touch at the beginning, and pairs that press, which the second half brings together, are
    found where they touch once more.
    """
    (begin, pressed, end), closed = contacts, take(contacts[0], contacts[0].gap <= s.gap_tol)
    length, before = (1.0 - s.theta) * h, 0.0
    for one, other, together, turn in zip(places, places[1:], (closed, pressed), turns, strict=False):
        touches = s.touches(one, other, memory, partial(tracked, s, begin, end), together, turn)
        if touches.fraction.size or touches.far.size:
            break
        length, before = s.theta * h, length
    if touches.far.size:
        frames = s.detector.frame[np.unique(np.divmod(touches.far, s.detector.frame.size))]
        most = float(np.linalg.norm(turn[frames[frames >= 0]], axis=1).max())
        return h / math.ceil(most / TURN)
    if not touches.fraction.size:
        return h
    k = int(touches.fraction.argmin())
    geoms = list(divmod(int(touches.codes[k]), s.inscribed.size))
    fast = sum(float(speed[f]) for f in s.detector.frame[geoms] if f >= 0)
    size = float(s.inscribed[geoms].min())
    at, past = before + length * float(touches.fraction[k]), PAST * size / fast
    return at + past if at + 2.0 * past < h else h


def update_active_set(
    s: System,
    kin: ContactKinematics,
    r: Array,
    moved: SceneState,
    memory: ContactSet,
    mid: Midpoint,
    kept: Index,
) -> tuple[ContactSet, ContactSet, Index]:
    """Update the active set to the motion of a move: drop spurious contacts, add missed ones.

    The active contacts `kin` had impulses r, and the move ends in the state `moved`. Return the contacts, the memory,
    and the keys of contacts to keep. A contact that ends deep with features that were not active is added as it was at
    the midpoint `mid`, where the impulses act: the position projection would remove the penetration but not the
    velocity. `kept` are the keys of contacts that were missed before: these stay.
    """
    c, begin, found = kin.contacts, mid.state.placement, moved.contacts
    left, real = overrun_contacts(s, kin, r[: 3 * c.gap.size : 3], mid, moved), ~_spurious(s, kin, r, found)
    contacts = take(c, (real if left is None else real & ~left) | among(c.key, kept))
    if not mid.fast and _reductions.least(found.gap) >= -s.least_penetration:
        return contacts, memory, kept
    end = moved.placement
    missed = take(found, (found.gap < -s.penetration_tol(found)) & ~among(found.key, contacts.key))
    if missed.gap.size:
        missed, memory = _separating(s, missed, c, end, begin), memory.joined(moved.memory, missed.key)
    if mid.fast:
        touches, codes = s.touches(begin, end, memory, lambda: c), s.detector.codes
        passed, memory = s.detector.carried(touches, end, memory)
        passed = carry(passed, end, begin)
        missed = united((take(missed, ~among(codes(missed), codes(passed))), passed))
    if not missed.gap.size:
        return contacts, memory, kept
    return united((contacts, missed)), memory, np.concatenate((kept, missed.key))


def missed_contacts(
    s: System, kin: ContactKinematics, r: Array, moved: SceneState, begin: Placement, middle: Placement
) -> ContactSet | None:
    """Return the contacts that a move misses, as they are in the `middle`; None if there are none.

    The active contacts have normal impulses r (nc,). A patch has active contacts at a few of its points. If none of
    them can carry the pressure, as on a rim between two points, the bodies turn about these two. Another point of the
    patch, which touched where the move begins, then ends inside the other body.
    """
    found, codes = moved.contacts, s.detector.codes
    if found is kin.contacts or _reductions.least(found.gap) >= -s.gap_tol:
        return None
    deep = (found.gap < -s.gap_tol) & ~among(found.key, kin.contacts.key)
    deep &= among(codes(found), codes(take(kin.contacts, r > 0.0)))
    if not deep.any():
        return None
    missed, end = take(found, deep), moved.placement
    before, there = (s.detector.carry(missed, end, placement)[0] for placement in (begin, middle))
    touched = np.abs(before.gap) <= s.gap_tol
    return take(there, touched) if touched.any() else None


def overrun_contacts(s: System, kin: ContactKinematics, r: Array, mid: Midpoint, moved: SceneState) -> Bools | None:
    """Mark the contacts that press although their normals do not separate their bodies; None if there are none.

    The active contacts are those of `kin`, found at the midpoint `mid`, with normal impulses r (nc,). They press as if
    their features reached farther: a corner that is about to land on a face slips off its edge before it does.
    """
    c, there, end, warm = kin.contacts, mid.state.placement, moved.placement, moved.warm
    ends = ((there.x, there.R), c[:3]), ((end.x, end.R), moved.contacts[:3])
    given = s.detector.searches[0], c[:3], there.R, ends, (warm.key, warm.status), r > 0.0
    out = np.empty(c.gap.size, np.bool_)
    return out if _active_set.overrun(*given, (s.inscribed, OPTIONS.depth_captured), out) else None


def _separating(s: System, missed: ContactSet, kin: ContactSet, end: Poses, middle: Poses) -> ContactSet:
    """Return the contacts found at the end whose normals separate the bodies in the middle, as they are in the middle.

    A contact with any other normal, as that of a face that meets the other body only after both have turned, would push
    sideways a body that touches elsewhere. The contacts left out strike when they touch.
    """
    missed, apart = s.detector.carry(missed, end, middle)
    same = s.detector.codes(missed)[:, None] == s.detector.codes(kin)
    touching = np.where(same, kin.gap, 0.0).min(axis=1, initial=0.0)
    return take(missed, apart >= touching - s.penetration_tol(missed))


def _spurious(s: System, kin: ContactKinematics, r: Array, found: ContactSet) -> Bools:
    """Mark contacts that have an impulse but are open where the motion ends: the bodies pass each other."""
    nc = kin.frame.shape[0]
    out: Bools = (r[0 : 3 * nc : 3] > 0.0) & (kin.end_gap[:nc] > s.penetration_tol(kin.contacts))
    if out.any():
        real = found.key[found.gap <= s.penetration_tol(found)]
        out &= ~among(kin.contacts.key, real)
    return out
