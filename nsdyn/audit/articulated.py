"""Audit of articulations: links on their joints, loops, limits, dry friction, loads, momenta, motion and works."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from nsdyn.audit import joint_rows
from nsdyn.audit.findings import TOLERANCES, Found, at_play, not_audited, worst_of
from nsdyn.audit.flight import Flight
from nsdyn.audit.overlap import separation
from nsdyn.audit.poses import Poses, matrix
from nsdyn.audit.retraced import Retraced
from nsdyn.recording.columns import ON_JOINTS
from nsdyn.recording.retrace import Trees, trees
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["joints"]

UNITS = {
    "links": "m",
    "loops": "m",
    "limits": "rad",
    "pieces": "-",
    **joint_rows.UNITS,
    "lift": "√J·s",
    "joint_momentum": "√J",
    "joint_motion": "√J·s",
    "contact_works": "J",
    "joint_works": "J",
    "drives": "J",
}
"""Of the amounts; of coordinates that are lengths, m and N·s."""


def joints(poses: Poses, found: Retraced | str, flight: Flight | None) -> Iterator[Found]:
    """All findings of articulations; of a scene without any, none."""
    t = poses.trajectory
    if not t.scene["articulations"]:
        return
    built = trees(t) if isinstance(found, str) else found.trees
    if isinstance(built, str):
        yield from (not_audited(name, unit, built) for name, unit in UNITS.items())
        return
    yield from _places(poses, built)
    if isinstance(found, str):
        places = ("links", "loops", "limits")
        yield from (not_audited(name, unit, found) for name, unit in UNITS.items() if name not in places)
        return
    yield _pieces(found.trees)
    yield from joint_rows.on_joints(found)
    names = [m.name for m in built.mechanisms]
    for name, (amount, scale) in (
        ("lift", found.lift),
        ("joint_momentum", found.momentum),
        ("joint_motion", found.motion),
    ):
        steps, which = np.indices(amount.shape)
        figure = (amount / np.maximum(scale, 1e-300)).ravel()
        yield worst_of(name, figure, amount.ravel(), UNITS[name], steps.ravel() + 1, _who(names, which.ravel()))
    yield _contact_works(poses, found, flight)
    yield from _works(poses, found)


def _who(names: list[str], which: Index) -> Callable[[int], list[str]]:
    return lambda k: [names[which[k]]]


def _places(poses: Poses, found: Trees) -> Iterator[Found]:
    """Frames of bodies and links, gaps of loops and limits, in all states."""
    t, frames, free = poses.trajectory, poses.scene["frames"], poses.free
    states, off, far = range(t.steps + 1), *np.zeros((2, t.steps + 1, len(frames)))
    radius = np.zeros(len(frames))
    moving = poses.frame >= 0
    np.maximum.at(radius, poses.frame[moving], poses.bounding_radius[moving])
    if free and "frames/x" in t.columns:
        off[:, :free] = np.linalg.norm(t.columns["frames/x"][:, :free] - poses.x[:, :free], axis=2)
        turned = np.linalg.norm(t.columns["frames/quat"][:, :free] - poses.quaternion[:, :free], axis=2)
        off[:, :free] += radius[:free] * turned
        far[:, :free] = np.linalg.norm(poses.x[:, :free], axis=2)
    gaps, beyond, scales, ranges, labels = [], [], [], [], []
    for i, m in enumerate(found.mechanisms):
        own = [(frame, joint) for frame, (tree, joint) in found.links.items() if tree == i]
        length = sum(float(np.linalg.norm(p.translation)) for p in m.model.jointPlacements) or 1.0
        width = np.where(np.isfinite(m.upper - m.lower), m.upper - m.lower, 1.0)
        for k in states:
            q = found.state(i, k)[0]
            m.place(q)
            for frame, joint in own:
                pose = m.pose(joint)
                turn = matrix(poses.quaternion[k, frame]) - pose.rotation
                norm = abs(float(np.linalg.norm(poses.quaternion[k, frame])) - 1.0)
                off[k, frame] = np.linalg.norm(poses.x[k, frame] - pose.translation) + radius[frame] * (
                    np.linalg.norm(turn) + norm
                )
                far[k, frame] = np.linalg.norm(pose.translation)
            angle = m.angle(q)
            beyond.append(np.maximum(m.lower - angle, angle - m.upper) / np.where(width > 0.0, width, 1.0))
            gaps.append(np.abs(m.constraints(q)[0]).max(initial=0.0))
            scales.append(length)
            ranges.append(width)
            labels.append((k, i))
    steps, which = np.indices(off.shape)
    figure = (off / (radius + far + 1e-300)).ravel()
    yield worst_of("links", figure, off.ravel(), "m", steps.ravel(), _who(frames, which.ravel()))
    k, i = np.array(labels).T
    trees_ = [m.name for m in found.mechanisms]
    looped = np.array([found.mechanisms[tree].loops > 0 for tree in i])
    gap = np.array(gaps)[looped]
    yield worst_of("loops", gap / np.array(scales)[looped], gap, "m", k[looped], _who(trees_, i[looped]))
    most = np.array([b.max(initial=-np.inf) for b in beyond])
    limited = most > -np.inf
    wide = np.array([r[b.argmax()] if b.size else 1.0 for r, b in zip(ranges, beyond, strict=True)])
    yield worst_of("limits", most[limited], (most * wide)[limited], "rad", k[limited], _who(trees_, i[limited]))


def _pieces(found: Trees) -> Found:
    """Durations, contacts and impulses of pieces, which make up those of their steps."""
    t, c = found.trajectory, found.trajectory.columns
    counts = np.diff(c["pieces/offset"])
    each = np.repeat(np.arange(t.steps), counts)

    def off(name: str, of_step: Array) -> Array:
        parts, of_step = (np.where(np.isfinite(x), x, 0.0) for x in (c[f"pieces/{name}"], of_step))  # without a limit
        sums = np.zeros((t.steps, *parts.shape[1:]))
        np.add.at(sums, each, parts)
        left = np.abs(sums - of_step).reshape(t.steps, -1).max(axis=1, initial=0.0)
        out: Array = left / max(float(np.abs(of_step).max(initial=0.0)), 1e-300)
        return out

    whole = {"contacts": np.diff(c["contacts/offset"])} | {name: c[f"joints/{name}"] for name in ON_JOINTS}
    worst = np.max([off(name, of_step) for name, of_step in whole.items()], axis=0) * (counts > 0)
    # Of every coordinate the pieces follow each other, and last the step.
    begun, duration, ahead = c["pieces/begin"], c["pieces/duration"], 1.0 - float(t.meta["theta"])
    first, last = c["pieces/offset"][:-1], c["pieces/offset"][1:]
    for moves in c["pieces/moves"].T:
        so_far = np.concatenate([[0.0], np.cumsum(duration * moves)])
        gaps = moves * np.abs(begun - (so_far[:-1] - so_far[first][each]))
        np.maximum.at(worst, each, gaps / t.dt)
        worst = np.maximum(worst, np.abs(so_far[last] - so_far[first] - t.dt) / t.dt * (counts > 0))
    np.maximum.at(worst, each, (begun + duration - t.dt) / t.dt)
    # Impulses act (1 - θ) of a piece after its beginning, those of a step that was not cut of the step's.
    step = np.repeat(np.arange(t.steps), np.diff(c["contacts/offset"]))
    acts = np.full(step.size, ahead * t.dt)
    own = counts[step] > 0
    times = np.repeat(begun + ahead * duration, np.maximum(c["pieces/contacts"], 0))
    if times.size != np.count_nonzero(own):
        times = np.full(np.count_nonzero(own), np.inf)
    acts[own] = times
    np.maximum.at(worst, step, np.abs(c["contacts/time"] - acts) / t.dt)
    return worst_of("pieces", worst, worst, UNITS["pieces"], np.arange(t.steps) + 1, lambda _: ())


def _contact_works(poses: Poses, found: Retraced, flight: Flight | None) -> Found:
    """Works of contacts on links, against their impulses at the mean velocities there."""
    t, c = poses.trajectory, poses.trajectory.columns
    if flight is None or not flight.timed:
        return not_audited("contact_works", UNITS["contact_works"], "when impulses acted is not recorded")
    steps = np.repeat(np.arange(t.steps), np.diff(c["contacts/offset"]))
    # What rebounds may do so several times, each with works of its own.
    rebounds = (c["contacts/restitution"] > 0.0) & (c["contacts/impulse"][:, 0] > 0.0)
    plain = np.bincount(steps, rebounds, t.steps)[steps] == 0.0
    known = plain & ~np.isnan(found.met_v[:, :, 0]).all(axis=1) & ~np.isnan(flight.met_u).any(axis=1)
    r, u = c["contacts/impulse"][known], flight.met_u[known]
    off = np.abs(c["contacts/work_normal"][known] - r[:, 0] * u[:, 0])
    off += np.abs(c["contacts/work_friction"][known] - (r[:, 1:] * u[:, 1:]).sum(axis=1))
    off -= found.met_doubt[known]
    geoms = [c[f"contacts/geom{k}"][known] for k in "12"]
    return worst_of(
        "contact_works",
        off / at_play(poses),
        off,
        "J",
        steps[known] + 1,
        lambda k: [poses.names[geom[k]] for geom in geoms],
    )


def _works(poses: Poses, found: Retraced) -> Iterator[Found]:
    """Columns of the ledger that trees work in, against what acts in them at the velocities there."""
    t, e = poses.trajectory, poses.trajectory.energy
    c, works = t.columns, {name: work.sum(axis=1) for name, work in found.works.items()}
    sums, open_to = {}, {}
    steps = np.repeat(np.arange(t.steps), np.diff(c["contacts/offset"]))
    stays = _stays(poses, steps)
    for name in ("normal", "friction"):
        work = c[f"contacts/work_{name}"]
        sums[name] = np.bincount(steps[~stays], work[~stays], t.steps)
        # Of no contacts NumPy counts whole numbers.
        open_to[name] = sum(
            np.bincount(s, w, t.steps) for s, w in ((steps[stays], np.abs(work[stays])), (steps, found.met_twice))
        )
    doubt, scale = found.doubt.sum(axis=1), at_play(poses)
    left = {
        "normal": np.abs(e.normal - works["normal"] - sums["normal"]) - open_to["normal"],
        "friction": np.abs(e.friction - works["friction"] - sums["friction"]) - open_to["friction"],
        "damping": np.abs(e.damping - works["damping"]),
    }
    if not (poses.free and t.meta.get("external_force", True)):
        left["external"] = np.abs(e.external - works["external"])
    if not poses.free:
        left["projection"] = np.abs(e.projection - found.energy)
    names = list(left)
    off = np.array([np.nan_to_num(left[name], nan=np.inf) for name in names]) - doubt
    which, step = np.indices(off.shape)
    yield worst_of("joint_works", off.ravel() / scale, off.ravel(), "J", step.ravel() + 1, _who(names, which.ravel()))
    if any(kind != "joint" for kind in t.scene["motions"].values()):
        yield not_audited("drives", "J", "velocities of driven bodies and of surfaces are not recorded")
        return
    off = np.abs(e.constraint - works["constraint"]) - doubt
    yield worst_of("drives", off / scale, off, "J", np.arange(1, t.steps + 1), lambda _: ["constraint"])


def _stays(poses: Poses, step: Index) -> Bools:
    """Contacts closed before, in this step, the last or at the start: what they do may be booked as numerics."""
    c = poses.trajectory.columns
    i, j = (c[f"contacts/geom{k}"].astype(np.int64) for k in "12")
    key, on, least = c["contacts/key"], c["contacts/status"] > 0, TOLERANCES["overlap"] * poses.size(i, j)
    ends, out = on | (c["contacts/gap"] <= least), np.empty(step.size, np.bool_)
    begin = np.searchsorted(step, np.arange(int(step.max(initial=-1)) + 2))
    first, start, before = np.arange(np.count_nonzero(step == 0)), np.zeros(step.size, np.int64), set[int]()
    for a, b, some in poses.by_kind(i[first], j[first]):
        gap = separation(a, *poses.of(i[some], start[some]), b, *poses.of(j[some], start[some]))
        before |= {int(x) for x in key[some][gap <= least[some]]}
    for k in range(len(begin) - 1):
        now = set(before)
        for row in range(begin[k], begin[k + 1]):
            out[row] = int(key[row]) in now
            if on[row]:
                now.add(int(key[row]))
        own = slice(begin[k], begin[k + 1])
        before = {int(x) for x in key[own][ends[own]]}
    return out
