"""Audit of motion: momenta of free bodies, their displacements, energies, and the works of the ledger."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from nsdyn.audit.findings import Finding, at_play, named, not_audited, worst_among, worst_of
from nsdyn.audit.flight import Flight, angles, spins
from nsdyn.audit.poses import Poses, turned
from nsdyn.audit.pushes import LIFT, Pushes, velocities
from nsdyn.recording.retrace import trees as articulations
from nsdyn.recording.series import rotate
from nsdyn.recording.tables import left_out
from nsdyn.tools.arrays import Array

PARALLEL = 1e-8
"""Square of the angle, rad², below which two normals count as parallel."""


def momenta(poses: Poses, flight: Flight | None) -> Iterator[Finding]:
    """Findings on momenta and motion of free bodies in every step; `flight` is None if not all steps are recorded."""
    t = poses.trajectory
    missing = not_audited("motion", f"of every {t.every} steps one is recorded")
    yield _motion(poses, flight) if t.every == 1 else missing
    if flight is None:
        yield from (not_audited(name, left_out(t)) for name in ("sideways", "lifts", "momentum", "spin"))
        return
    yield from _lifts(poses, flight)
    mass, weight = poses.mass, t.dt * poses.gravity
    velocity = velocities(poses)
    left = mass[:, None] * (np.diff(velocity, axis=0) - weight) - flight.impulse
    speed = np.linalg.norm(velocity, axis=2)
    scale = flight.size + mass * (speed[:-1] + speed[1:] + np.linalg.norm(weight))
    yield worst_among("momentum", np.linalg.norm(left, axis=2), scale, poses.scene["frames"])
    spin = spins(poses)
    rest = np.diff(spin, axis=0) - flight.torque
    elsewhere = flight.astray + flight.unknown + poses.rounded + flight.kept
    left = np.maximum(np.linalg.norm(rest, axis=2) - flight.size * elsewhere, 0.0)
    turning = np.linalg.norm(spin, axis=2)
    yield worst_among("spin", left, flight.levers + turning[:-1] + turning[1:], poses.scene["frames"])


def plain(poses: Poses) -> Iterator[Finding]:
    """Findings on times of steps, norms of quaternions, frames of free bodies, and rows that are no numbers."""
    t, frames = poses.trajectory, poses.scene["frames"]
    odd = {name: float(np.isnan(x).any()) for name, x in t.columns.items() if x.dtype.kind == "f"}
    odd["gauss/coulomb"] *= t.meta["polish"]  # not certified otherwise
    figure = np.array(list(odd.values()))
    yield worst_of("numbers", figure, figure, np.zeros(len(odd), np.int64), named(list(odd), np.arange(len(odd))))
    h = t.dt * t.every
    # Large times are rounded.
    late = np.maximum(np.abs(np.diff(t.t) - h) - 4.0 * np.finfo(float).eps * np.abs(t.t[1:]), 0.0)
    late = np.maximum(late, _outside(poses))
    yield worst_of("times", late / h, late, np.arange(1, t.steps + 1))
    off = np.abs(np.linalg.norm(poses.quaternion, axis=2) - 1.0)
    yield worst_among("turns", off, 1.0, frames, 0)
    if "frames/x" in t.columns:
        apart = np.linalg.norm(t.columns["frames/x"] - poses.x, axis=2)
        apart += np.linalg.norm(t.columns["frames/quat"] - poses.quaternion, axis=2)
        yield worst_among("frames", apart, 1.0, frames, 0)


def _outside(poses: Poses) -> Array:
    """Time by which moves of contacts extend beyond their step, or into each other on a free body, (n,), s."""
    t, out = poses.trajectory, np.zeros(poses.trajectory.steps)
    if left_out(t):
        return out
    pushes, c = Pushes.of(poses, np.zeros((poses.step.size, 3))), poses.contacts
    for step, time, length in ((poses.step, c["time"], c["duration"]), (pushes.step, pushes.time, pushes.length)):
        begin = time - (1.0 - poses.theta) * length
        end = begin + length
        np.maximum.at(out, step, np.max([-begin, end - t.dt, begin - end], axis=0))
    order = np.lexsort((begin + end, pushes.body, pushes.step))
    one, other = order[:-1], order[1:]
    next_ = (pushes.body[one] == pushes.body[other]) & (pushes.step[one] == pushes.step[other])
    same = (begin[one] == begin[other]) & (end[one] == end[other])
    np.maximum.at(out, pushes.step[other], np.where(next_ & ~same, end[one] - begin[other], 0.0))
    return out


def _motion(poses: Poses, flight: Flight | None) -> Finding:
    """Finding on displacements of free bodies beyond those of their velocities and lifts, over all their points, m.

    The reference is the size of the body for a single lift, and for all lifts of a step in which the body moves less
    than its size. Otherwise the reference is the displacement of the body.
    """
    t, free, theta = poses.trajectory, poses.free, poses.theta
    q, radius = poses.quaternion[:, :free], poses.reach[:free]
    size = np.broadcast_to(poses.smallest, (t.steps, free))
    if flight is not None:
        far = np.linalg.norm(flight.pushes.shift.reshape(-1, 2, 3), axis=2)
        lifts = np.stack([np.zeros((t.steps, free, 2)), flight.pushes.summed((t.steps, free), far)])
        np.maximum.at(lifts[0], (flight.pushes.step, flight.pushes.body), far)
        moved, turned_by = flight.astray + lifts[..., 0] - flight.unknown, flight.turn - flight.flow + lifts[..., 1]
        one, amount = np.maximum(moved, turned_by * radius)  # for the largest lift of a step, and for all its lifts
        speed = np.linalg.norm(poses.v[..., :3], axis=2) + radius * np.linalg.norm(poses.v[..., 3:], axis=2)
        scale = np.maximum(size, t.dt * np.maximum(speed[:-1], speed[1:]))
        alone = one * scale > amount * size
        return worst_among("motion", np.where(alone, one, amount), np.where(alone, size, scale), poses.scene["frames"])
    before, after = (1.0 - theta) * t.dt * poses.v[:-1], theta * t.dt * poses.v[1:]
    moved = rotate(q[:-1], before[..., :3]) + rotate(q[1:], after[..., :3])
    left = np.linalg.norm(np.diff(poses.x[:, :free], axis=0) - moved, axis=2) - poses.uncertain[0][:, :free]
    # Half the rotation with either angular velocity, each in the axes at its own end.
    turn = angles(turned(q[:-1], before[..., 3:]), turned(q[1:], -after[..., 3:]))
    amount = np.maximum(left, (turn - poses.uncertain[1][:, :free]) * radius)
    return worst_among("motion", amount, size, poses.scene["frames"])


def _lifts(poses: Poses, flight: Flight) -> Iterator[Finding]:
    """Findings on lifts: whether free bodies end where flight and lifts bring them, and whether contacts cause lifts.

    Contacts lift along their normals. Normals turn as bodies roll, so in the middle of a step the part across them may
    be as large as the part along them. A body squeezed between other bodies moves across almost parallel normals, by
    their angle times its displacement. It also passes on the lifts of others, across normals that turn as far as lifts
    turn bodies. A contact that closes only at the end of a step is among those of the next step.
    """
    t, free = poses.trajectory, poses.free
    normal, lines = t.columns["contacts/normal"], np.zeros((t.steps, free, 3, 3))
    for body in poses.frame[poses.pair]:
        own = (body >= 0) & (body < free)
        np.add.at(lines, (poses.step[own], body[own]), normal[own, :, None] * normal[own, None])
    lines[:-1] += lines[1:]
    lifts = flight.pushes.row == LIFT
    step, body, shift = flight.pushes.step[lifts], flight.pushes.body[lifts], flight.pushes.shift[lifts, :3]
    sizes, axes = np.linalg.eigh(np.nan_to_num(lines))  # the finding `axes` covers normals that are no numbers
    tilt = np.sqrt(np.clip(sizes / np.maximum(sizes[..., -1:], 1.0), 0.0, 1.0))[step, body]
    speed = np.linalg.norm(velocities(poses), axis=2)
    moved = t.dt * (speed[:-1] + speed[1:] + t.dt * poses.weight)
    size, turn = np.linalg.norm(flight.pushes.shift[lifts].reshape(-1, 2, 3), axis=2).T
    passed, bent = np.bincount(step, poses.mass[body] * size, t.steps), np.bincount(step, turn, t.steps)
    parts, open_to = np.abs(np.einsum("lij,li->lj", axes[step, body], shift)), tilt**2 > PARALLEL
    along = np.linalg.norm(np.where(open_to, parts, 0.0), axis=1)
    free_to = tilt * moved[step, body, None] + (bent * passed)[step, None] / poses.mass[body, None]
    across = np.linalg.norm(np.where(open_to, 0.0, np.maximum(parts - free_to, 0.0)), axis=1)
    off = np.zeros(moved.shape)
    np.maximum.at(off, (step, body), across - along - poses.rounded)
    yield worst_among("sideways", off, moved, poses.scene["frames"])
    off = np.maximum(flight.astray - flight.unknown - poses.rounded, (flight.turn - flight.flow) * poses.reach[:free])
    yield worst_among("lifts", off, np.broadcast_to(poses.smallest, off.shape), poses.scene["frames"])


def energies(poses: Poses) -> Iterator[Finding]:
    """Compute the energies anew, and the energy balance of every step."""
    t = poses.trajectory
    e = t.energy
    scale = at_play(poses)
    steps = np.arange(t.steps + 1)

    total, built = e.total, articulations(t)
    if isinstance(built, str):
        yield not_audited("energy", built)
    else:
        turning = np.einsum("nbi,bij,nbj->n", poses.v[..., 3:], poses.inertia, poses.v[..., 3:])
        kinetic = 0.5 * ((poses.v[..., :3] ** 2).sum(axis=2) @ poses.mass + turning)
        potential = -(poses.x[:, : poses.free] @ poses.gravity) @ poses.mass
        for i, m in enumerate(built.mechanisms):
            each = np.array([m.energies(*built.state(i, k)) for k in range(t.steps + 1)])
            kinetic, potential = kinetic + each[:, 0], potential + each[:, 1]
        off = np.maximum(np.abs(kinetic - e.kinetic), np.abs(potential - e.potential))
        yield worst_of("energy", off / (scale + np.abs(potential)), off, steps)
        total = kinetic + potential
    works: Mapping[str, Array] = {name: getattr(e, name) for name in e.names[2:] if name != "defect"}
    off = np.maximum(np.abs(np.diff(total) - sum(works.values())), np.abs(e.defect))
    yield worst_of("balance", off / (scale + np.abs(e.potential[1:])), off, steps[1:])
