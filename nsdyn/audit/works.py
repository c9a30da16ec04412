"""Audit of works: of every contact, of every column of the ledger, and that nothing creates energy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from nsdyn.audit.findings import CREEP, TOLERANCES, Found, at_play, not_audited, worst_among, worst_of
from nsdyn.audit.flight import Flight, least, spins
from nsdyn.audit.poses import Poses
from nsdyn.audit.pushes import GIVEN, UNTIMED, together
from nsdyn.audit.retraced import Retraced
from nsdyn.audit.told import JAM, SLIP
from nsdyn.audit.touching import apart, bouncing, by_fremond
from nsdyn.recording.tables import left_out
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["works"]

ROUND_OFF = 1e-12
"""Of the energy at play, below which a work is nothing."""

PARADOXICAL = "newton", "poisson"
"""Laws of impact that create energy in some impacts, which their runs tell."""


def works(poses: Poses, found: Retraced | str | None, flight: Flight | None) -> Iterator[Found]:
    """Findings of works; of scenes without articulations nothing was retraced, and of others why it was not."""
    t = poses.trajectory
    yield from _dissipation(poses)
    yield _numerics(poses)
    reason = left_out(t) if flight is None else "" if flight.timed else UNTIMED
    if isinstance(found, str):
        reason = reason or found
    if reason or flight is None:
        yield from (not_audited(name, reason) for name in ("contact_works", "works", "drives"))
        return
    retraced = None if isinstance(found, str) else found
    yield _of_contacts(poses, retraced, flight)
    yield from _columns(poses, retraced, flight)


def _dissipation(poses: Poses) -> Iterator[Found]:
    """Impacts, friction and limits take energy, but for what a law of impact is known to create, and tells."""
    t, e, scale = poses.trajectory, poses.trajectory.energy, at_play(poses)
    steps, told = np.arange(1, t.steps + 1), np.nan_to_num(e.created)
    if any(geom.get("restitution", 0.0) for geom in t.scene["geoms"]) and (reason := left_out(t)):
        yield not_audited("dissipation", reason)
    else:
        work = e.normal + e.friction - _falls(poses) - np.maximum(told, 0.0)
        yield worst_of("dissipation", work / scale, work, steps)
    lawful = str(t.meta.get("impact", "")).partition("(")[0].lower() in PARADOXICAL
    off = np.where(np.isnan(e.created) | (e.created >= 0.0), told * (not lawful), np.abs(told))
    yield worst_of("created", off / scale, off, steps)


def _numerics(poses: Poses) -> Found:
    """What numerics have given or taken until each step: of a motion that is resolved, little."""
    t, e = poses.trajectory, poses.trajectory.energy
    if poses.theta > 0.5:
        return not_audited("numerics", "theta of more than 1/2 damps by itself")
    so_far = np.abs(np.cumsum(e.integration + e.projection))
    return worst_of("numerics", so_far / at_play(poses), so_far, np.arange(1, t.steps + 1))


def _falls(poses: Poses) -> Array:
    """The most that gravity may do in each step beyond its potential, J, (n,): h |g| Σ ‖r‖ of what rebounds.

    Where impacts are caught within a step velocities jump at its middle, and weights move otherwise than on the mean of
    before and after: by at most half a step of the jump, which is r over the mass of each of two bodies. The contacts
    give it back to what rebounds, which falls through all of the step.
    """
    c = poses.contacts
    size = np.linalg.norm(c["impulse"], axis=1) * (c["restitution"] > 0.0)
    so_far = np.concatenate([[0.0], np.cumsum(size)])[c["offset"]]
    out: Array = poses.trajectory.dt * poses.weight * np.diff(so_far)
    return out


def _of_contacts(poses: Poses, found: Retraced | None, flight: Flight) -> Found:
    """Works of contacts, r·½ (u⁻ + u⁺) and of couples along the mean turning.

    What rebounds may do so several times in one instant, each with works of its own, which make up that of all. With
    links or external forces, which act in the same piece, even that is not so.
    """
    t = poses.trajectory
    c, step, r, u = poses.contacts, poses.step, poses.contacts["impulse"], flight.met.mean
    turned = (np.nan_to_num(c["couple"]) * np.nan_to_num(flight.met.spin)).sum(axis=1)
    pressed, rubbed = r[:, 0] * u[:, 0] + turned, (r[:, 1:] * u[:, 1:]).sum(axis=1)
    jams = c["status"] == JAM  # all that they do is normal work
    normal = c["work_normal"] - np.where(jams, pressed + rubbed, pressed)
    friction = c["work_friction"] - np.where(jams, 0.0, rubbed)
    size = np.linalg.norm(r, axis=1)
    # Nothing that turns is in more doubt than its surface, at the least distance, is.
    lever = np.linalg.norm(np.nan_to_num(c["couple"]), axis=1) / poses.size(*poses.pair)
    doubt = (size + 2.0 * lever) * flight.unsure
    if found is not None:
        doubt = doubt + found.met_doubt
    # Where anything rebounds in a move, all that approaches strikes before the rest of the move pushes.
    strikes = bouncing(poses) & (r[:, 0] > 0.0) & ~(flight.met.before[:, 0] >= 0.0)
    several = poses.beside(strikes) | by_fremond(poses)
    frames = poses.frame[poses.pair]
    own = poses.is_free(frames)
    pushes = own[0] | own[1]
    parted = np.zeros(r[:, 0].size, np.bool_) if found is None else found.met_parted
    # In turn with limits, too: of links alone it is known how much.
    several |= poses.beside(parted & pushes)
    given = pushes & bool(t.meta.get("external_force", True))
    hidden = np.isnan(u).any(axis=1) | (given & (GIVEN not in t.columns))
    blind = poses.beside(hidden | given | (frames >= poses.free).any(axis=0))
    single, joint = ~several & ~hidden, several & ~blind
    # Weights move bodies on after the impacts of a move, whose impulses, of unknown parts, are taken to work on that.
    fell = 0.5 * c["duration"] * poses.weight * np.hypot(1.0, c["mu"]) * r[:, 0]
    fell[own.all(axis=0)] = 0.0
    speed = np.linalg.norm([flight.met.before, flight.met.after], axis=2).max(axis=0)
    scale = np.maximum(size * np.maximum(speed, CREEP), ROUND_OFF * at_play(poses))
    _, first, which = np.unique(poses.instant[joint], return_index=True, return_inverse=True)
    whole = [np.bincount(which, x[joint], first.size) for x in (normal + friction, doubt + fell, scale)]
    rows = np.concatenate([np.flatnonzero(single), np.flatnonzero(joint)[first]])
    off = np.concatenate([(np.abs(normal) + np.abs(friction) - doubt)[single], np.abs(whole[0]) - whole[1]])
    off -= 4.0 * np.finfo(float).eps * at_play(poses)
    if step.size and not rows.size:
        return not_audited("contact_works", "how what touches moves is not recorded")
    pair, scale = [c[f"geom{k}"][rows] for k in "12"], np.concatenate([scale[single], whole[2]])
    return worst_of("contact_works", off / scale, off, step[rows] + 1, poses.named(*pair))


def _columns(poses: Poses, found: Retraced | None, flight: Flight) -> Iterator[Found]:
    """Columns of the ledger, against what acts in contacts and trees at the velocities there."""
    t, e, c = poses.trajectory, poses.trajectory.energy, poses.contacts
    nothing, scale = np.zeros(t.steps), at_play(poses)
    of_trees: Mapping[str, Array] = {} if found is None else {k: work.sum(axis=1) for k, work in found.works.items()}
    doubt, parted = (nothing, nothing) if found is None else (x.sum(axis=1) for x in (found.doubt, found.parted))
    step = poses.step
    stays, left = _stays(poses, flight), dict[str, Array]()
    sticks = stays & ~_slid(poses, step)
    twice = _twice(poses, flight) + (0.0 if found is None else found.met_twice)
    rest, slack = nothing, nothing
    turns = np.zeros(step.size, np.bool_) if found is None else found.met_parted & flight.instant
    turns = poses.beside(turns)
    # What strikes in turn does in all what the velocities before and after tell.
    told = np.where(turns, (c["impulse"] * flight.met.mean).sum(axis=1), 0.0)
    for name, lasts in (("normal", stays), ("friction", sticks)):
        work = c[f"work_{name}"]
        off = getattr(e, name) - of_trees.get(name, nothing) - np.bincount(step[~lasts], work[~lasts], t.steps)
        # Of no contacts NumPy counts whole numbers.
        most = np.bincount(step, np.where(lasts, np.abs(work), 0.0) + twice, t.steps)
        left[name] = np.abs(off) - most - parted
        rest, slack, told = rest + off, slack + most, told - np.where(turns & ~lasts, work, 0.0)
    # Where surfaces move it is not known.
    slack = slack + np.bincount(
        step, np.where(turns, np.linalg.norm(c["impulse"], axis=1) * flight.unsure, 0.0), t.steps
    )
    left["impacts"] = np.nan_to_num(np.abs(rest - np.bincount(step, told, t.steps)) - slack, nan=0.0)
    left["damping"] = np.abs(e.damping - of_trees.get("damping", nothing))
    if not (poses.free and t.meta.get("external_force", True)):
        left["external"] = np.abs(e.external - of_trees.get("external", nothing))
    spin = np.linalg.norm(spins(poses), axis=2)
    spin = np.maximum(spin[1:], spin[:-1]) + flight.levers
    unknown = (flight.turn * spin * spin) @ (1.0 / least(poses))
    left["projection"] = np.abs(e.projection - flight.lifted - (nothing if found is None else found.energy)) - unknown
    names = list(left)
    off = np.array([np.nan_to_num(left[name], nan=np.inf) for name in names]) - doubt
    yield worst_among("works", off.T, scale, names)
    if any(kind != "joint" for kind in t.scene.get("motions", {}).values()):
        yield not_audited("drives", "velocities of driven bodies and of surfaces are not recorded")
        return
    off = np.abs(e.constraint - of_trees.get("constraint", nothing)) - doubt
    yield worst_of("drives", off / scale, off, np.arange(1, t.steps + 1), lambda _: ["constraint"])


def _twice(poses: Poses, flight: Flight) -> Array:
    """Most that impulses of rebounds may have done in a move besides its impacts, which is booked as numerics, J."""
    c, met = poses.contacts, flight.met
    r, speed = np.abs(c["impulse"]), np.abs([met.before, met.after]).max(axis=0)
    some = ~flight.instant & (c["restitution"] > 0.0)
    # Where surfaces move nothing but the works tells how fast they met.
    done = np.abs(c["work_normal"]) + np.abs(c["work_friction"])
    told = (r * np.abs(c["u"])).sum(axis=1) + 2.0 * done
    most = np.where(np.isnan(speed).any(axis=1), told, (r * speed).sum(axis=1))
    out: Array = np.where(some, np.nan_to_num(most), 0.0)
    return out


def _stays(poses: Poses, flight: Flight) -> Bools:
    """Contacts of shapes that touch where their step begins, or met before: what they do may be booked as numerics.

    In moves: impacts in no time are booked as they are. With theta = 1 a move acts when the impacts before it do.
    """
    c = poses.contacts
    (i, j), step, moves = poses.pair, poses.step, ~flight.instant
    out = apart(poses, i, j, step) <= TOLERANCES["overlap"] * poses.size(i, j)
    when: Array = c["time"]
    order = np.lexsort((moves, when, j, i, step))
    begin, group = together(step[order], i[order], j[order])
    for late in (when[order], moves[order]):
        out[order] |= late > late[begin][group] if begin.size else False
    pairs = len(poses.names) ** 2
    last = np.isin((step - 1) * pairs + poses.code, (step * pairs + poses.code)[c["status"] > 0])
    return np.asarray((out | last) & moves)


def _slid(poses: Poses, step: Index) -> Bools:
    """Contacts that slipped in the last step, whose work in this is booked as friction; none of steps that are cut."""
    c = poses.contacts
    pair, key = poses.code, c["key"]
    order, out = np.lexsort((c["time"], step, key, pair)), np.zeros(step.size, np.bool_)
    before, now = order[:-1], order[1:]
    again = (pair[before] == pair[now]) & (key[before] == key[now]) & (step[now] - step[before] == 1)
    late = (1.0 - poses.theta) * poses.trajectory.dt
    whole = np.abs(c["time"] - late) <= 1e-9 * poses.trajectory.dt
    out[now] = again & whole[before] & whole[now] & (c["status"][before] == SLIP)
    return out
