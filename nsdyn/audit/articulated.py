"""Audit of articulations: links on their joints, loops, limits, dry friction, loads, momenta and motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from nsdyn.audit import joint_rows
from nsdyn.audit.findings import Finding, named, not_audited, worst_among, worst_of
from nsdyn.audit.poses import Poses, matrix
from nsdyn.audit.retraced import Retraced
from nsdyn.recording.columns import ON_JOINTS
from nsdyn.recording.retrace import Trees, trees
from nsdyn.tools.arrays import Array

PLACES = "links", "loops", "limits"

FINDINGS = *PLACES, "pieces", *joint_rows.FINDINGS, "lift", "joint_momentum", "joint_motion"


def joints(poses: Poses, found: Retraced | str) -> Iterator[Finding]:
    """All findings on articulations; none for a scene without any."""
    if not poses.scene["articulations"]:
        return
    built = trees(poses.trajectory) if isinstance(found, str) else found.trees
    if isinstance(built, str):
        yield from (not_audited(name, built) for name in FINDINGS)
        return
    yield from _places(poses, built)
    if isinstance(found, str):
        yield from (not_audited(name, found) for name in FINDINGS if name not in PLACES)
        return
    yield _pieces(found.trees)
    yield from joint_rows.on_joints(found)
    names = [m.name for m in built.mechanisms]
    for name, (amount, scale) in (
        ("lift", found.lift),
        ("joint_momentum", found.momentum),
        ("joint_motion", found.motion),
    ):
        yield worst_among(name, amount, scale, names)


def _places(poses: Poses, found: Trees) -> Iterator[Finding]:
    """Findings on frames of links, gaps of loops and joint limits, in all states."""
    t, frames = poses.trajectory, poses.scene["frames"]
    off, far = np.zeros((2, t.steps + 1, len(frames)))
    R, x = np.zeros((t.steps + 1, len(frames), 3, 3)), np.zeros((t.steps + 1, len(frames), 3))
    links = list(found.links)
    gaps, beyond, scales, ranges, labels = [], [], [], [], []
    for i, m in enumerate(found.mechanisms):
        own = [(frame, joint) for frame, (tree, joint) in found.links.items() if tree == i]
        length = sum(float(np.linalg.norm(p.translation)) for p in m.model.jointPlacements) or 1.0
        width = np.where(np.isfinite(m.upper - m.lower), m.upper - m.lower, 1.0)
        for k in range(t.steps + 1):
            q = found.state(i, k)[0]
            m.place(q)
            for frame, joint in own:
                pose = m.pose(joint)
                R[k, frame], x[k, frame] = pose.rotation, pose.translation
            angle = m.angle(q)
            beyond.append(np.maximum(m.lower - angle, angle - m.upper) / np.where(width > 0.0, width, 1.0))
            gaps.append(np.abs(m.constraints(q)[0]).max(initial=0.0))
            scales.append(length)
            ranges.append(width)
            labels.append((k, i))
    quaternion = poses.quaternion[:, links]
    turn = np.linalg.norm(matrix(quaternion) - R[:, links], axis=(2, 3))
    turn += np.abs(np.linalg.norm(quaternion, axis=2) - 1.0)
    off[:, links] = np.linalg.norm(poses.x[:, links] - x[:, links], axis=2) + poses.reach[links] * turn
    far[:, links] = np.linalg.norm(x[:, links], axis=2)
    yield worst_among("links", off, poses.reach + far, frames, 0)
    k, i = np.array(labels).T
    trees_ = [m.name for m in found.mechanisms]
    looped = np.array([found.mechanisms[tree].loops > 0 for tree in i])
    gap = np.array(gaps)[looped]
    yield worst_of("loops", gap / np.array(scales)[looped], gap, k[looped], named(trees_, i[looped]))
    most = np.array([b.max(initial=-np.inf) for b in beyond])
    limited = most > -np.inf
    wide = np.array([r[b.argmax()] if b.size else 1.0 for r, b in zip(ranges, beyond, strict=True)])
    yield worst_of("limits", most[limited], (most * wide)[limited], k[limited], named(trees_, i[limited]))


def _pieces(found: Trees) -> Finding:
    """Finding on durations, contacts and impulses of pieces, which must add up to those of their steps."""
    t, c = found.trajectory, found.trajectory.columns
    counts = np.diff(c["pieces/offset"])
    each = np.repeat(np.arange(t.steps), counts)

    def off(name: str, of_step: Array) -> Array:
        parts, of_step = (np.where(np.isfinite(x), x, 0.0) for x in (c[f"pieces/{name}"], of_step))  # inf: no limit
        sums = np.zeros((t.steps, *parts.shape[1:]))
        np.add.at(sums, each, parts)
        left = np.abs(sums - of_step).reshape(t.steps, -1).max(axis=1, initial=0.0)
        return left / max(float(np.abs(of_step).max(initial=0.0)), 1e-300)

    whole = {"contacts": np.diff(c["contacts/offset"])} | {name: c[f"joints/{name}"] for name in ON_JOINTS}
    worst = np.max([off(name, of_step) for name, of_step in whole.items()], axis=0) * (counts > 0)
    # For every coordinate, pieces must follow each other without gaps and fill the step.
    begun, duration, ahead = c["pieces/begin"], c["pieces/duration"], 1.0 - float(t.meta["theta"])
    first, last = c["pieces/offset"][:-1], c["pieces/offset"][1:]
    for moves in c["pieces/moves"].T:
        so_far = np.concatenate([[0.0], np.cumsum(duration * moves)])
        gaps = moves * np.abs(begun - (so_far[:-1] - so_far[first][each]))
        np.maximum.at(worst, each, gaps / t.dt)
        worst = np.maximum(worst, np.abs(so_far[last] - so_far[first] - t.dt) / t.dt * (counts > 0))
    np.maximum.at(worst, each, (begun + duration - t.dt) / t.dt)
    # Impulses act at the fraction 1 - θ of their piece; in a step that was not cut, at this fraction of the step.
    step = np.repeat(np.arange(t.steps), np.diff(c["contacts/offset"]))
    acts = np.tile([[ahead * t.dt], [t.dt]], step.size)
    own = counts[step] > 0
    times = np.repeat([begun + ahead * duration, duration], np.maximum(c["pieces/contacts"], 0), axis=1)
    acts[:, own] = times if times.shape[1] == np.count_nonzero(own) else np.inf
    for name, told in zip(("time", "duration"), acts, strict=True):
        np.maximum.at(worst, step, np.nan_to_num(np.abs(c[f"contacts/{name}"] - told)) / t.dt)
    return worst_of("pieces", worst, worst, np.arange(t.steps) + 1)
