"""Audit of the recorded properties of contacts besides impulses: gaps, velocities, states and keys."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nsdyn.audit.findings import CREEP, TOLERANCES, Finding, not_audited, worst_of
from nsdyn.audit.flight import Flight
from nsdyn.audit.poses import Poses
from nsdyn.audit.touching import SLOW, along, apart, bouncing, from_surfaces, measured, pushing
from nsdyn.problem.solution import Status
from nsdyn.recording.columns import OPEN, SLIP, STICK
from nsdyn.recording.tables import left_out
from nsdyn.tools.arrays import Array, Bools, Index, cross

LAWS = "dissipative", "newton", "fremond"
"""Laws of impact by which a contact that strikes alone rebounds with its restitution."""

LEVEL = 0.1
"""Sine of the angle to the plane of contact below which edges may lie in it: detection sees bodies before they have
turned into contact."""


def told(poses: Poses, flight: Flight | None) -> Iterator[Finding]:
    """Findings on the recorded properties of contacts; `flight` is None if not all steps are recorded."""
    t = poses.trajectory
    if flight is None:
        yield from (not_audited(name, left_out(t)) for name in ("gaps", "velocities", "partings", "bounces", "states"))
        return
    step, pair = poses.step, poses.pair
    off = _gaps(poses, flight) - poses.rounded
    yield worst_of("gaps", off / poses.size(*pair), off, step + 1, poses.named(*pair))
    yield _velocities(poses, flight)
    yield _partings(poses, flight)
    yield _bounces(poses, flight)
    # With θ = 1 the move that follows an impact acts at the time of the impact.
    wrong = _states(poses, flight) | _keys(poses, 1 + (poses.theta == 1.0))
    yield worst_of("states", wrong.astype(float), wrong.astype(float), step + 1, poses.named(*pair))


def _gaps(poses: Poses, flight: Flight) -> Array:
    """Distance of recorded gaps from the range that the shapes allow at the end of the step, m.

    No point can be nearer than the shapes are. Along a normal other than the true one the shapes may seem nearer. If
    the point of a contact is not the nearest one, its gap is at most the distance over which both shapes carried it.
    """
    (i, j), step, c, gap = poses.pair, poses.step, poses.contacts, poses.contacts["gap"]
    nearest = apart(poses, i, j, step + 1, exact=True)
    lengthwise = measured(poses, along, i, j, (poses.of(i, step + 1), poses.of(j, step + 1)), poses.normal)
    out: Array = np.minimum(nearest, lengthwise) - gap
    # If the same shapes meet again later in the step, the gap may be the one at the end of the earlier piece.
    _, pair = np.unique(step * len(poses.names) ** 2 + poses.code, return_inverse=True)
    last = np.zeros(gap.size)
    np.fmax.at(last, pair, c["time"])
    met = np.flatnonzero((out > 0.0) & (c["time"] < last[pair]))
    out[met] -= _travel(poses, flight, met)
    above = np.flatnonzero(gap > nearest)
    # Round shapes have one contact, and its gap is the distance of the shapes.
    flat = np.array([len(solid.normals) + len(solid.edges) > 0 for solid in poses.solids], np.bool_)[poses.kind]
    several = flat[i[above]] | flat[j[above]]
    far = _travel(poses, flight, above)
    # The crossing of almost parallel edges slides far as they turn; bounded by the widest gap of the pair's contacts.
    widest = np.zeros(gap.size)
    np.fmax.at(widest, pair[above], far)
    far = np.where(c["impulse"][above, 0] > 0.0, far, widest[pair[above]])
    out[above] = np.maximum(out[above], gap[above] - nearest[above] - several * far)
    return out


def _travel(poses: Poses, flight: Flight, rows: Index) -> Array:
    """Upper bound of the gaps of some contacts at the end of the step, from points and motion of both shapes, m."""
    step, point = poses.step[rows], poses.contacts["point"][rows]
    out, gone = np.zeros(rows.size), np.zeros((rows.size, 3))
    for side, geom in enumerate(poses.pair[:, rows]):
        (R, x), (R1, x1) = pushing(poses, flight, rows, side), poses.of(geom, step + 1)
        own = np.einsum("mji,mj->mi", R, point - x)
        out += from_surfaces(poses, geom, own)
        gone += (2 * side - 1) * (np.einsum("mij,mj->mi", R1, own) + x1)
        # Features slide on a turning shape: at most by the turn times the reach of the shape.
        turned = np.linalg.norm(R1 - R, axis=(1, 2))
        reach = np.where(turned > 0.0, poses.bounding_radius[geom], 0.0)
        out += turned * reach
    out += np.linalg.norm(gone, axis=1)
    return out


def _velocities(poses: Poses, flight: Flight) -> Finding:
    """Compare velocities of contacts that have an impulse with those after it.

    In a move with a duration, the recorded velocity is the one predicted for the end of the move. The prediction
    repeats the change up to the impulse, at most as large as rotation can make it. Contacts without an impulse are
    left out: they may have a gap, and at its two ends the bodies move differently from the contact point.
    """
    t, met, c, step, u = poses.trajectory, flight.met, poses.contacts, poses.step, poses.contacts["u"]
    moves = ~np.isnan(met.after).any(axis=1)
    known = np.flatnonzero(moves & (c["impulse"][:, 0] > 0.0))
    if step.size and not moves.any():
        return not_audited("velocities", "how what touches moves is not recorded")
    off = np.linalg.norm(u - met.after, axis=1)
    for begin in met.begin:
        left = np.linalg.norm(u - (met.after + met.before - begin), axis=1)
        off = np.where(flight.instant, off, np.minimum(off, left))
    bent = max(poses.theta, 1.0 - poses.theta) * t.dt * met.bent
    off = off - 2.0 * flight.unsure - np.where(flight.instant, 0.0, bent)
    speed = np.maximum(np.linalg.norm(met.before, axis=1), np.linalg.norm(met.after, axis=1))
    edges = poses.rounding[poses.pair].sum(axis=0) == 0.0
    late = known[(edges & ~flight.instant & (off > 0.0))[known]]
    # Where edges cross, bodies that turn change the velocity as the crossing slides, and as its normal turns.
    off[late] -= 2.0 * np.linalg.norm(met.spin[late], axis=1) * _slides(poses, flight, late, speed[late])
    figure = off / np.maximum(speed, CREEP)
    return worst_of("velocities", figure[known], off[known], step[known] + 1, poses.named(*poses.pair[:, known]))


def _slides(poses: Poses, flight: Flight, rows: Index, speed: Array) -> Array:
    """Upper bound of how far crossings of edges slide in half a move of bodies with relative speeds, (rows,), m.

    Two edges at an angle φ that move past each other at a speed u cross at a point that moves at most at u / sin φ.
    Their normal turns at most at ω / sin φ if they turn at ω.
    """
    i, j = pair = poses.pair[:, rows]
    axes = [pushing(poses, flight, rows, side)[0] for side in (0, 1)]
    sine = np.empty(rows.size)
    for k, normal in enumerate(poses.normal[rows]):
        one, other = (poses.solids[poses.kind[g[k]]].edges @ R[k].T for g, R in zip(pair, axes, strict=True))
        one, other = (e[np.abs(e @ normal) < LEVEL] for e in (one, other))
        sine[k] = np.linalg.norm(cross(one[:, None], other), axis=2).min(initial=1.0)
    way = max(poses.theta, 1.0 - poses.theta) * poses.trajectory.dt * speed / np.maximum(sine, np.finfo(float).tiny)
    return np.minimum(way, 2.0 * np.minimum(poses.bounding_radius[i], poses.bounding_radius[j]))


def _partings(poses: Poses, flight: Flight) -> Finding:
    """Contacts with an impulse on free bodies must not separate if nothing rebounds at that instant."""
    t, met, c, step = poses.trajectory, flight.met, poses.contacts, poses.step
    pushes = c["impulse"][:, 0] > 0.0
    links = (poses.frame[poses.pair] >= poses.free).any(axis=0)
    some = np.flatnonzero(pushes & ~bouncing(poses) & ~links & ~np.isnan(met.after).any(axis=1))
    turning = max(poses.theta, 1.0 - poses.theta) * t.dt * met.bent + flight.unsure
    # An impulse that can change no velocity by that much is a residual of the solver.
    masses = np.append(1.0 / poses.mass, np.zeros(poses.x.shape[1] - poses.free + 1))
    slowed = c["impulse"][:, 0] * masses[poses.frame[poses.pair]].sum(axis=0)
    off = np.minimum(np.minimum(c["u"], met.after)[:, 0], slowed) - turning - SLOW
    figure = off / np.maximum(np.abs(met.before[:, 0]), CREEP)
    return worst_of("partings", figure[some], off[some], step[some] + 1, poses.named(*poses.pair[:, some]))


def _bounces(poses: Poses, flight: Flight) -> Finding:
    """A contact that strikes alone rebounds with e: not faster, and slower only where it rests or e would add energy.

    Impacts of several contacts at one instant act on each other. Where e would add energy, the default law lowers it
    until impulses do no work.
    """
    t, met, c, step = poses.trajectory, flight.met, poses.contacts, poses.step
    pushes, e = c["impulse"][:, 0] > 0.0, c["restitution"]
    _, instant = np.unique(np.stack([step, c["time"]]), axis=1, return_inverse=True)
    alone = pushes & (np.bincount(instant.ravel(), pushes)[instant.ravel()] == 1.0)
    links = (poses.frame[poses.pair] >= poses.free).any(axis=0)
    strikes = flight.instant & alone & (e > 0.0) & ~links & ~np.isnan(met.after).any(axis=1)
    if strikes.any() and not str(t.meta.get("impact", "")).lower().startswith(LAWS):
        return not_audited("bounces", "the restitution of this law of impact is not one of velocities")
    before, after = met.before[:, 0], met.after[:, 0]
    lowered = (c["impulse"] * (met.before + met.after)).sum(axis=1) > -CREEP * np.abs(c["impulse"][:, 0] * before)
    off = after + e * before
    off = np.where((after > SLOW) & ~lowered, np.abs(off), off) - 2.0 * flight.unsure
    off, some = np.where(strikes, off, 0.0), np.flatnonzero(pushes)
    figure = off / np.fmax(np.abs(before), CREEP)
    return worst_of("bounces", figure[some], off[some], step[some] + 1, poses.named(*poses.pair[:, some]))


def _states(poses: Poses, flight: Flight) -> Bools:
    """Contacts whose recorded state contradicts their impulse, or which have a couple that they cannot have."""
    c, step = poses.contacts, poses.step
    r, mu, state = c["impulse"], c["mu"], c["status"]
    pushes, drag, most = r[:, 0] > 0.0, np.linalg.norm(r[:, 1:], axis=1), mu * r[:, 0]
    carried = (poses.frame[poses.pair] >= poses.free).any(axis=0)
    # A joint that closes a gap at a contact moves that along its surface too.
    closing = np.where(carried, np.abs(c["u"][:, 0]), 0.0)
    slow = np.linalg.norm(c["u"][:, 1:], axis=1) <= np.maximum(SLOW, closing)
    # The status of a step that misses the tolerance, or overlaps, does not tell of its jams.
    jams = ~np.isin(poses.trajectory.solver.status, (Status.CONVERGED, Status.SEVERAL))
    fits = np.select(
        [state == OPEN, state == STICK, state == SLIP],
        [~pushes, pushes & ((drag < most) | slow), pushes & (drag >= most * (1.0 - TOLERANCES["cone"]))],
        pushes & jams[step],
    )
    # Couples cancel the work of contacts between moving free bodies; contacts of links and impacts have no couple.
    return ~fits.astype(np.bool_) | ((carried | flight.instant) & (c["couple"] != 0.0).any(axis=1))


def _keys(poses: Poses, instants: int) -> Bools:
    """Contacts whose key recurs at one time among contacts of the same shapes more often than there are `instants`."""
    c, out = poses.contacts, np.zeros(poses.step.size, np.bool_)
    order = np.lexsort((c["key"], c["time"], poses.code, poses.step))
    rows = np.stack([poses.step, poses.code, c["time"], c["key"]])[:, order]
    out[order[instants:]] = (rows[:, instants:] == rows[:, :-instants]).all(axis=0)
    return out
