"""Impacts of a scene: of contacts closed at an instant, and of contacts that a move captures at its midpoint."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import ContactSet, among, ordered, take
from nsdyn.dynamics.values import Forces, MidpointState, Placement
from nsdyn.stepping.active_set import normal_velocities
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.impacts import Round
from nsdyn.stepping.impulses import Impulses, book
from nsdyn.stepping.midpoint import SILENT, Midpoint
from nsdyn.stepping.persistence import NO_COUPLE
from nsdyn.stepping.rounds import Impact, strike
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.tools.arrays import NONE, Array, Bools, Index


class Captured(NamedTuple):
    """Impacts in no time at the midpoint of a move, before its forces.

    Attributes
    ----------
    impact : Impact
    kick : ndarray, shape (n,)
        Change of v by the impacts.
    forces : Forces
        The forces of the move, which see the velocity after the impacts.
    unbooked : float
        Work of the impacts beyond that of `impact`, J: they act before the forces, half of which they have met.
    """

    impact: Impact
    kick: Array
    forces: Forces
    unbooked: float


def captured_impacts(
    s: System, kin: ContactKinematics, mid: Midpoint, there: Placement
) -> tuple[ContactKinematics, Captured | None]:
    """Apply impacts in no time, at the midpoint, of contacts that close within the move; their frames are `there`.

    On average an impact happens in the middle of the move: it meets the velocity that half of the forces leave. So an
    elastic ball keeps its energy, though it falls on a floor, or from a roof that it has struck, for the whole move.

    Return the kinematics for the other impulses, and the impacts, if there are any.
    """
    struck = striking(s, kin, mid)
    if struck is None:
        return kin, None
    closed, d, rows = kin.end_gap <= s.gap_tol, s.dynamics, kin.rows
    if any(free.loads.implicit for free in mid.forces.trees):
        # Damping, springs and controls take time: they add no mass to what strikes.
        rows, _ = d.rows(kin.contacts, there, d.inertia(mid.state.position, mid.state.v), kin.joints)
    middle = mid.state
    given = mid.forces.v - middle.v - d.drag(middle, mid.forces, middle.v)
    half = 0.5 * rows.full.relative_velocity(given)
    # Resting contacts carry their load: the forces do not drive them.
    met = np.where(np.repeat(struck | ~closed, 3), half, 0.0)
    slow = _striking_speeds(s, kin, mid, struck, closed, half[0::3])
    impact = _strike(s, kin._replace(rows=rows), kin.u + met, closed, slow, slow)
    if impact.solved is None:
        return kin, None
    kick = rows.velocity_change(impact.r)
    forces = d.struck(middle, mid.forces, kick)
    after = kin.changed(kick, forces.v - mid.forces.v, struck | (~closed & (impact.r[0::3] > 0.0)))
    return after, Captured(impact, kick, forces, -float(met @ impact.r))


def _striking_speeds(
    s: System, kin: ContactKinematics, mid: Midpoint, struck: Bools, closed: Bools, half: Array
) -> Array:
    """Return the speeds of approach above which rows strike in a captured move, (rows,), m/s.

    Rows that are `closed` strike if they do not rest; the drift of those that turn with their bodies is no approach.
    Open rows that may rebound strike if they close within the move: the rows `struck`, and others that impacts drive.

    Parameters
    ----------
    s : System
    kin : ContactKinematics
    mid : Midpoint
    struck, closed : ndarray of bool, shape (rows,)
    half : ndarray, shape (rows,)
        Change of the normal velocities by half of the forces, which impacts have met, m/s; the other half follows.
    """
    resting, drift = s.resting(kin, mid.state, mid.rate, mid.surface_acceleration), kin.jacobian_drift[0::3]
    turns = np.where(struck, 0.0, 2.0 * np.abs(drift))
    ahead = (kin.u_free - kin.u)[0::3] - half + np.where(struck, drift, 0.0)
    closing = np.maximum(resting - np.where(struck, 0.0, half), kin.end_gap / (s.theta * mid.h) + ahead)
    return np.where(closed, resting + turns, np.where(kin.restitution > 0.0, closing, np.inf))


def striking(s: System, kin: ContactKinematics, mid: Midpoint) -> Bools | None:
    """Mark the rows that strike within a move, for `captured_impacts`; None if none does."""
    if not s.elastic or not kin.mu.size:
        return None
    u_begin, u, drift = kin.begun[0, 0::3], kin.u[0::3], kin.jacobian_drift[0::3]
    resting = s.resting(kin, mid.state, mid.rate, mid.surface_acceleration)
    closes = kin.end_gap + s.theta * mid.h * (kin.u_free[0::3] + drift) <= 0.0
    struck: Bools = (kin.restitution > 0.0) & (u_begin < -resting) & (u < 0.0) & closes
    return struck if struck.any() else None


def collide(s: System, at: SceneState, t: float, h: float, rate: Array) -> tuple[SceneState, Impulses] | None:
    """Apply impacts in no time of contacts closed at an instant; return the state after them and the impulses, or None.

    None means that no contact strikes. A resting contact that closes so fast that it would become deep in the move of
    h s from the time t strikes without restitution. `rate` (n,) is the free acceleration at the instant.
    """
    d, c = s.dynamics, at.contacts
    limit = s.least_strike(c, h)
    if not (d.surfaces.count or limits_struck(s, at, h).size) and s.striking_speed(at) >= -limit:
        return None
    forces, twist = d.inertia(at.position, at.v), d.surfaces.twists(t)
    contacts, joints = take(c, c.gap <= s.gap_tol), d.limit_rows(at.placement, at.v)
    contacts = take(contacts, ~_passing(s, at, contacts, twist, limit))
    mid = Midpoint(
        s, 0.0, t, MidpointState(at.position, at.v, at.placement, ()), forces, at.v, (twist, twist, twist), SILENT
    )
    kin = ContactKinematics.of(mid, at.placement, contacts, joints, at._replace(contacts=contacts))
    contacts, joints = kin.contacts, kin.joints
    resting = s.resting(kin, mid.state, rate, (d.surfaces.twists(t + h) - twist) / h)
    slow, nc, depth = resting, contacts.gap.size, np.full(resting.size, s.depth * OPTIONS.joint)
    depth[:nc] = s.penetration_tol(contacts)
    if s.depth >= OPTIONS.depth_located:
        # A contact that pressed before turns with its bodies: it closes a little without striking. But a contact that
        # has just closed its gap still approaches, and where that gains energy it is stopped first.
        depth[:nc][s.last_status(contacts, at.warm) > 0] = np.inf
        if joints is not None:
            depth[nc:][at.warm.joints[joints.slot, 0] > 0.0] = np.inf
    slow = np.where(kin.restitution > 0.0, np.minimum(slow, depth / h), depth / h)
    closed = kin.end_gap <= s.gap_tol
    impact = _strike(s, kin, kin.u, closed, resting, np.where(closed, slow, np.inf))
    if impact.solved is None:
        return None
    v = at.v + kin.rows.velocity_change(impact.r)
    impulses, _ = book(s, kin, (at.v, v, v), impact.solved, 0.0, impact, NO_COUPLE, d.mass)
    if any(free.constraints is not None for free in forces.trees):
        push, works = kin.rows.full.momentum(impact.r), impulses.works
        for tree, free in zip(d.trees, forces.trees, strict=True):
            k = tree.coordinates
            reaction = free.m @ (v[k] - at.v[k]) - push[k]
            works = works._replace(constraint=works.constraint + 0.5 * float(reaction @ (v[k] + at.v[k])))
        impulses = impulses._replace(works=works)
    # The load of a struck contact has changed: from its last impulses a solver may find an asymmetric solution.
    struck = among(at.warm.key, contacts.key[impulses.r[:, 0] > 0.0])
    warm = at.warm._replace(force=np.where(struck[:, None], 0.0, at.warm.force))
    after = at._replace(v=v, twists=d.twists(at.placement, v), warm=warm, energies=d.tree_energies(at.position, v))
    return after, impulses


def _passing(s: System, at: SceneState, closed: ContactSet, surfaces: Array, limit: float) -> Bools:
    """Mark closed contacts (nc,) that approach, but not along the normal of some face that separates their bodies.

    Where edges or corners meet, every normal between those of their faces separates the bodies. A body that slides
    along one of these faces does not strike the other body: for example from one plate onto the next.
    """
    d, out = s.dynamics, np.zeros(closed.gap.size, np.bool_)
    approach = np.flatnonzero(normal_velocities(d, closed, at, surfaces) < -limit)
    if approach.size:
        which, normal = s.detector.ways(ordered(closed, approach), at.placement, s.gap_tol)
        along = ordered(closed, approach[which])
        along.points[1] = normal
        out[approach[which[normal_velocities(d, along, at, surfaces) >= -limit]]] = True
    return out


def _strike(s: System, kin: ContactKinematics, before: Array, closed: Bools, resting: Array, slow: Array) -> Impact:
    """Compute the impacts of the closed contacts and joint limits, with the velocities `before` them."""
    at = Round(kin.rows.blocks, before, kin.mu, kin.restitution, closed, s.solver)
    return strike(s.impact, at, resting, slow)


def limits_struck(s: System, at: SceneState, h: float) -> Index:
    """Return slots of joint limits that a joint has reached and may strike, given a move of h s to come."""
    if not _reductions.any_below(at.limits, s.gap_tol):
        return NONE
    joints, slots = s.dynamics.joints, s.dynamics.joints.limits
    limit = np.where(joints.restitution[slots] > 0.0, s.solver.tol, s.depth * OPTIONS.joint / h)
    if s.depth >= OPTIONS.depth_located:
        limit[(joints.restitution[slots] == 0.0) & (at.warm.joints[slots, 0] > 0.0)] = np.inf
    return slots[(at.limits <= s.gap_tol) & (joints.rates(slots, at.v) < -limit)]
