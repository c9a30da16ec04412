"""Audit of works: of every contact and of every column of the ledger; check that nothing creates energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nsdyn.audit.findings import CREEP, TOLERANCES, Finding, at_play, not_audited, worst_among, worst_of
from nsdyn.audit.flight import Flight, least, spins
from nsdyn.audit.poses import Poses
from nsdyn.audit.pushes import together
from nsdyn.audit.retraced import Retraced
from nsdyn.audit.touching import apart, bouncing, by_fremond
from nsdyn.recording.columns import JAM, SLIP
from nsdyn.recording.tables import left_out
from nsdyn.tools.arrays import Array, Bools, Index

ROUND_OFF = 1e-12
"""Fraction of the energy at play below which a work is zero."""

PARADOXICAL = "newton", "poisson"
"""Laws of impact that create energy in some impacts; their runs record it."""


def works(poses: Poses, found: Retraced | str, flight: Flight | None) -> Iterator[Finding]:
    """Findings on works. `found` may be the reason why no articulation was retraced."""
    t = poses.trajectory
    yield from _dissipation(poses)
    yield _numerics(poses)
    if flight is None or isinstance(found, str):
        yield from (not_audited(name, left_out(t) or str(found)) for name in ("contact_works", "works", "drives"))
        return
    yield _of_contacts(poses, found, flight)
    yield from _columns(poses, found, flight)


def _dissipation(poses: Poses) -> Iterator[Finding]:
    """Impacts, friction and limits must take energy, except for the recorded energy that a law of impact creates."""
    t, e, scale = poses.trajectory, poses.trajectory.energy, at_play(poses)
    steps = np.arange(1, t.steps + 1)
    if any(geom["restitution"] for geom in t.scene["geoms"]) and (reason := left_out(t)):
        yield not_audited("dissipation", reason)
    else:
        work = e.normal + e.friction - _falls(poses) - np.maximum(e.created, 0.0)
        yield worst_of("dissipation", work / scale, work, steps)
    lawful = str(t.meta.get("impact", "")).partition("(")[0].lower() in PARADOXICAL
    off = np.where(e.created >= 0.0, e.created * (not lawful), np.abs(e.created))
    yield worst_of("created", off / scale, off, steps)


def _numerics(poses: Poses) -> Finding:
    """Energy that numerics gave or took up to each step; it is small if the steps resolve the motion."""
    t, e = poses.trajectory, poses.trajectory.energy
    if poses.theta > 0.5:
        return not_audited("numerics", "theta of more than 1/2 damps by itself")
    so_far = np.abs(np.cumsum(e.integration + e.projection))
    return worst_of("numerics", so_far / at_play(poses), so_far, np.arange(1, t.steps + 1))


def _falls(poses: Poses) -> Array:
    """Upper bound of gravity's work in each step beyond its potential, J, (n,): h |g| Σ ‖r‖ over contacts that rebound.

    When impacts are captured, velocities jump at mid-step. The displacement of a weight then differs from that at the
    mean of the velocities before and after, by at most half a step times the jump. The jump is r over the mass of each
    of the two bodies. The contacts return this energy to the rebounding bodies, which fall throughout the step.
    """
    c = poses.contacts
    size = np.linalg.norm(c["impulse"], axis=1) * (c["restitution"] > 0.0)
    so_far = np.concatenate([[0.0], np.cumsum(size)])[c["offset"]]
    return poses.trajectory.dt * poses.weight * np.diff(so_far)


def _of_contacts(poses: Poses, found: Retraced, flight: Flight) -> Finding:
    """Finding on works of contacts: r·½ (u⁻ + u⁺), and couples times the mean relative angular velocity.

    A rebounding contact may strike several times in one instant. Each impact has its own work, and only their sum is
    known. With links or external forces, which act in the same piece, not even the sum is known.
    """
    t = poses.trajectory
    c, step, r, u = poses.contacts, poses.step, poses.contacts["impulse"], flight.met.mean
    turned = (c["couple"] * np.nan_to_num(flight.met.spin)).sum(axis=1)
    pressed, rubbed = r[:, 0] * u[:, 0] + turned, (r[:, 1:] * u[:, 1:]).sum(axis=1)
    jams = c["status"] == JAM  # all their work is normal work
    normal = c["work_normal"] - np.where(jams, pressed + rubbed, pressed)
    friction = c["work_friction"] - np.where(jams, 0.0, rubbed)
    size = np.linalg.norm(r, axis=1)
    # The uncertainty of a rotation is at most that of the body's surface, over its least distance.
    lever = np.linalg.norm(c["couple"], axis=1) / poses.size(*poses.pair)
    doubt = (size + 2.0 * lever) * flight.unsure + found.met_doubt
    # If anything rebounds in a move, all approaching contacts strike before the impulses of the rest of the move act.
    strikes = bouncing(poses) & (r[:, 0] > 0.0) & ~(flight.met.before[:, 0] >= 0.0)
    several = poses.beside(strikes) | by_fremond(poses)
    frames = poses.frame[poses.pair]
    own = poses.is_free(frames)
    pushes = own[0] | own[1]
    # Also contacts that strike alternately with limits; for contacts of links alone the uncertainty is known.
    several |= poses.beside(flight.parted & pushes)
    given, hidden = pushes & bool(t.meta["external_force"]), np.isnan(u).any(axis=1)
    blind = poses.beside(hidden | given | (frames >= poses.free).any(axis=0))
    single, joint = ~several & ~hidden, several & ~blind
    # Weights move bodies on after the impacts of a move. How impulses split is unknown: all may work on that motion.
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


def _columns(poses: Poses, found: Retraced, flight: Flight) -> Iterator[Finding]:
    """Compare columns of the ledger with the works of contacts and trees at their velocities."""
    t, e, c = poses.trajectory, poses.trajectory.energy, poses.contacts
    nothing, scale = np.zeros(t.steps), at_play(poses)
    of_trees = {name: work.sum(axis=1) for name, work in found.works.items()}
    doubt, parted, resting = (x.sum(axis=1) for x in (found.doubt, found.parted, found.resting))
    step = poses.step
    stays, left = _stays(poses, flight), dict[str, Array]()
    sticks = stays & ~_slid(poses, step)
    twice = _twice(poses, flight) + found.met_twice
    rest, slack = nothing, nothing
    turns = poses.beside(flight.parted & flight.instant)
    # The total work of contacts that strike alternately follows from the velocities before and after.
    told = np.where(turns, (c["impulse"] * flight.met.mean).sum(axis=1), 0.0)
    for name, lasts, limits in (("normal", stays, resting), ("friction", sticks, nothing)):
        work = c[f"work_{name}"]
        off = getattr(e, name) - of_trees[name] - np.bincount(step[~lasts], work[~lasts], t.steps)
        # Without contacts NumPy's bincount returns integers.
        most = limits + np.bincount(step, np.where(lasts, np.abs(work), 0.0) + twice, t.steps)
        left[name] = np.abs(off) - most - parted
        rest, slack, told = rest + off, slack + most, told - np.where(turns & ~lasts, work, 0.0)
    # On moving surfaces that total is unknown.
    slack = slack + np.bincount(
        step, np.where(turns, np.linalg.norm(c["impulse"], axis=1) * flight.unsure, 0.0), t.steps
    )
    left["impacts"] = np.nan_to_num(np.abs(rest - np.bincount(step, told, t.steps)) - slack, nan=0.0)
    left["damping"] = np.abs(e.damping - of_trees["damping"])
    if not (poses.free and t.meta["external_force"]):
        left["external"] = np.abs(e.external - of_trees["external"])
    spin = np.linalg.norm(spins(poses), axis=2)
    spin = np.maximum(spin[1:], spin[:-1]) + flight.levers
    unknown = (flight.turn * spin * spin) @ (1.0 / least(poses))
    left["projection"] = np.abs(e.projection - flight.lifted - found.energy) - unknown
    names = list(left)
    off = np.array([np.nan_to_num(left[name], nan=np.inf) for name in names]) - doubt
    yield worst_among("works", off.T, scale, names)
    if any(kind != "joint" for kind in t.scene["motions"].values()):
        yield not_audited("drives", "velocities of driven bodies and of surfaces are not recorded")
        return
    off = np.abs(e.constraint - of_trees["constraint"]) - doubt
    yield worst_of("drives", off / scale, off, np.arange(1, t.steps + 1), lambda _: ["constraint"])


def _twice(poses: Poses, flight: Flight) -> Array:
    """Upper bound of the work of rebound impulses in a move outside its impacts, booked as numerics, J."""
    c, met = poses.contacts, flight.met
    r, speed = np.abs(c["impulse"]), np.abs([met.before, met.after]).max(axis=0)
    some = ~flight.instant & (c["restitution"] > 0.0)
    # On moving surfaces only the works show how fast the bodies met.
    done = np.abs(c["work_normal"]) + np.abs(c["work_friction"])
    told = (r * np.abs(c["u"])).sum(axis=1) + 2.0 * done
    most = np.where(np.isnan(speed).any(axis=1), told, (r * speed).sum(axis=1))
    return np.where(some, np.nan_to_num(most), 0.0)


def _stays(poses: Poses, flight: Flight) -> Bools:
    """Contacts of shapes that touch at the start of the step or met earlier in it; their work may count as numerics.

    Only in moves: works of instantaneous impacts are booked as they are. With theta = 1 a move acts at the time of the
    impacts before it.
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
    """Contacts that slipped in the previous step; their work in this step is friction. None if a step was cut."""
    c = poses.contacts
    pair, key = poses.code, c["key"]
    order, out = np.lexsort((c["time"], step, key, pair)), np.zeros(step.size, np.bool_)
    before, now = order[:-1], order[1:]
    again = (pair[before] == pair[now]) & (key[before] == key[now]) & (step[now] - step[before] == 1)
    late = (1.0 - poses.theta) * poses.trajectory.dt
    whole = np.abs(c["time"] - late) <= 1e-9 * poses.trajectory.dt
    out[now] = again & whole[before] & whole[now] & (c["status"][before] == SLIP)
    return out
