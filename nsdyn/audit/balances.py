"""Audit of motion: momenta of free bodies, how they move, energies and the works of the ledger."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from nsdyn.audit.findings import Found, at_play, not_audited, of_bodies, worst_of
from nsdyn.audit.flight import Flight, angles, spins, velocities
from nsdyn.audit.poses import Poses, turned
from nsdyn.recording.retrace import trees as articulations
from nsdyn.recording.series import rotate
from nsdyn.recording.tables import left_out
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools.arrays import Array

__all__ = ["energies", "momenta", "plain"]

PARALLEL = 1e-6
"""Square of the angle between normals, rad², that count as one."""


def momenta(poses: Poses, flight: Flight | None) -> Iterator[Found]:
    """Momentum and angular momentum of free bodies in every step, and how they move; None as of `contacts`."""
    t, free = poses.trajectory, poses.free
    reason = left_out(t)
    missing = not_audited("motion", "m", f"of every {t.every} steps one is recorded")
    yield _motion(poses, flight) if t.every == 1 else missing
    if flight is None or not flight.timed:
        yield not_audited("sideways", "m", reason or "when impulses acted is not recorded")
    else:
        yield _sideways(poses, flight)
    if t.meta.get("external_force", True) and free:
        known = "external_force" in t.meta
        reason = "external forces act" if known else "whether external forces act is not recorded"
    if reason or flight is None:
        yield not_audited("momentum", "N·s", reason)
        yield not_audited("spin", "N·m·s", reason)
        return
    mass, weight = np.array(poses.scene["masses"]), t.dt * np.array(poses.scene["gravity"])
    velocity = velocities(poses)
    left = mass[:, None] * (np.diff(velocity, axis=0) - weight) - flight.impulse
    speed = np.linalg.norm(velocity, axis=2)
    scale = flight.size + mass * (speed[:-1] + speed[1:] + np.linalg.norm(weight))
    yield of_bodies(poses, "momentum", np.linalg.norm(left, axis=2), scale, "N·s")
    if not flight.timed:
        yield not_audited("spin", "N·m·s", "when impulses acted is not recorded")
        return
    if np.isnan(t.columns["contacts/couple"]).any():
        yield not_audited("spin", "N·m·s", "couples of contacts are not recorded")
        return
    spin = spins(poses)
    rest = np.diff(spin, axis=0) - flight.torque
    # Where on its way the projection lifts a body is not recorded.
    left = np.linalg.norm(rest, axis=2) - flight.size * (np.linalg.norm(flight.lift, axis=2) + flight.unknown)
    left = np.maximum(left, 0.0)
    turning = np.linalg.norm(spin, axis=2)
    yield of_bodies(poses, "spin", left, flight.levers + turning[:-1] + turning[1:], "N·m·s")


def plain(poses: Poses) -> Iterator[Found]:
    """Whether times are those of the steps, and quaternions of norm 1."""
    t, frames = poses.trajectory, poses.scene["frames"]
    h = t.dt * t.every
    # Times are rounded where they are large.
    late = np.maximum(np.abs(np.diff(t.t) - h) - 4.0 * np.finfo(float).eps * np.abs(t.t[1:]), 0.0)
    yield worst_of("times", late / h, late, "s", np.arange(1, t.steps + 1), lambda _: ())
    off = np.abs(np.linalg.norm(poses.quaternion, axis=2) - 1.0)
    state, which = np.indices(off.shape)
    yield worst_of("turns", off.ravel(), off.ravel(), "-", state.ravel(), lambda k: [frames[which.ravel()[k]]])


def _motion(poses: Poses, flight: Flight | None) -> Found:
    """How free bodies move with their velocities: of points of them, m."""
    t, free, theta = poses.trajectory, poses.free, float(poses.trajectory.meta["theta"])
    q = poses.quaternion[:, :free]
    if flight is not None and flight.timed:
        left, there, back = np.linalg.norm(flight.lift, axis=2) - flight.unknown, flight.quaternion, q[1:]
        # How far bodies were lifted in a step in pieces is not recorded.
        rest = np.linalg.norm(np.diff(spins(poses), axis=0) - flight.torque, axis=2)
        rest += flight.size * (np.linalg.norm(flight.lift, axis=2) + flight.unknown)
        least = np.linalg.eigvalsh(np.array(poses.scene["inertias"]).reshape(-1, 3, 3))[:, 0]
        later = np.where(flight.cut, t.dt * rest / least, 0.0)
    else:
        before, after = (1.0 - theta) * t.dt * poses.v[:-1], theta * t.dt * poses.v[1:]
        moved = rotate(q[:-1], before[..., :3]) + rotate(q[1:], after[..., :3])
        left = np.linalg.norm(np.diff(poses.x[:, :free], axis=0) - moved, axis=2) - poses.uncertain[0][:, :free]
        # Half a turn with either angular velocity, each in the axes of its own end.
        there, back = turned(q[:-1], before[..., 3:]), turned(q[1:], -after[..., 3:])
        later = poses.uncertain[1][:, :free]
    radius, extent = np.zeros(free), np.full(free, np.inf)
    for k in np.flatnonzero((poses.frame >= 0) & (poses.frame < free)):
        body, solid = poses.frame[k], poses.solids[poses.kind[k]]
        radius[body] = max(radius[body], solid.bounding_radius)
        extent[body] = min(extent[body], solid.extent)
    amount = np.maximum(left, (angles(there, back) - later) * radius)
    return of_bodies(poses, "motion", amount, np.broadcast_to(extent, amount.shape), "m")


def _sideways(poses: Poses, flight: Flight) -> Found:
    """How free bodies move otherwise than projections lift them, which is along normals of their contacts, m.

    These turn as bodies roll, so that what is across them in the middle of a step may be as much as what is along.
    """
    t, free, eps = poses.trajectory, poses.free, float(np.finfo(float).eps)
    normal, lines = t.columns["contacts/normal"], np.zeros((t.steps, free, 3, 3))
    step = np.repeat(np.arange(t.steps), np.diff(t.columns["contacts/offset"]))
    for geom in ("geom1", "geom2"):
        body = poses.frame[t.columns[f"contacts/{geom}"].astype(np.int64)]
        own = (body >= 0) & (body < free)
        np.add.at(lines, (step[own], body[own]), normal[own, :, None] * normal[own, None])
    sizes, axes = np.linalg.eigh(lines)
    open_to = sizes > PARALLEL * np.maximum(sizes[..., -1:], 1.0)
    parts = np.abs(np.einsum("nbij,nbi->nbj", axes, flight.lift))
    along, across = (np.linalg.norm(np.where(some, parts, 0.0), axis=2) for some in (open_to, ~open_to))
    speed = np.linalg.norm(velocities(poses), axis=2)
    moved = t.dt * (speed[:-1] + speed[1:] + t.dt * float(np.linalg.norm(poses.scene["gravity"])))
    rounded = 8.0 * eps * np.linalg.norm(poses.x[1:, :free], axis=2)
    return of_bodies(poses, "sideways", across - along - flight.unknown - rounded, moved, "m")


def _falls(t: Trajectory) -> Array:
    """The most that gravity may do in each step beyond its potential, J, (n,): h |g| Σ ‖r‖ of what rebounds.

    Where impacts are caught within a step velocities jump at its middle, and weights move otherwise than on the mean of
    before and after: by at most half a step of the jump, which is r over the mass of each of two bodies. The contacts
    give it back to what rebounds, which falls through all of the step.
    """
    size = np.linalg.norm(t.columns["contacts/impulse"], axis=1) * (t.columns["contacts/restitution"] > 0.0)
    so_far = np.concatenate([[0.0], np.cumsum(size)])[t.columns["contacts/offset"]]
    out: Array = t.dt * float(np.linalg.norm(t.scene["gravity"])) * np.diff(so_far)
    return out


def energies(poses: Poses) -> Iterator[Found]:
    """Energies anew, works of contacts summed anew, and the balance of every step.

    Works of scenes with articulations are audited with these.
    """
    t = poses.trajectory
    e, free = t.energy, poses.free
    trees, scale = bool(t.scene["articulations"]), at_play(poses)
    steps = np.arange(t.steps + 1)

    def nobody(_: int) -> tuple[str, ...]:
        return ()

    ends = t.columns["contacts/offset"]
    sums = {}
    for name in ("normal", "friction"):
        so_far = np.concatenate([[0.0], np.cumsum(t.columns[f"contacts/work_{name}"])])
        sums[name] = np.diff(so_far[ends])
    gain = sums["normal"] + sums["friction"]
    if t.has_contacts:
        work = gain - _falls(t)
        yield worst_of("dissipation", work / scale, work, "J", steps[1:], nobody)
    else:
        yield not_audited("dissipation", "J", left_out(t))
    total, built = e.total, articulations(t)
    if isinstance(built, str):
        yield not_audited("energy", "J", built)
    else:
        pose = t.q[:, : 7 * free].reshape(t.steps + 1, free, 7)
        twist = t.v[:, : 6 * free].reshape(t.steps + 1, free, 6)
        mass, inertia = np.array(t.scene["masses"]), np.array(t.scene["inertias"]).reshape(-1, 3, 3)
        turning = np.einsum("nbi,bij,nbj->n", twist[..., 3:], inertia, twist[..., 3:])
        kinetic = 0.5 * ((twist[..., :3] ** 2).sum(axis=2) @ mass + turning)
        potential = -(pose[..., :3] @ np.array(t.scene["gravity"])) @ mass
        for i, m in enumerate(built.mechanisms):
            each = np.array([m.energies(*built.state(i, k)) for k in range(t.steps + 1)])
            kinetic, potential = kinetic + each[:, 0], potential + each[:, 1]
        off = np.maximum(np.abs(kinetic - e.kinetic), np.abs(potential - e.potential))
        yield worst_of("energy", off / (scale + np.abs(potential)), off, "J", steps, nobody)
        total = kinetic + potential
    if not trees:
        if reason := left_out(t):
            yield not_audited("works", "J", reason)
        elif float(t.meta["theta"]) != 0.5:
            yield not_audited("works", "J", "with theta above 0.5 the scheme does work of its own")
        else:
            # What contacts do that stay closed and stick is booked as numerics.
            off = np.abs(gain - e.normal - e.friction - e.integration)
            off = np.maximum(off - _falls(t), 0.0)
            yield worst_of("works", off / scale, off, "J", steps[1:], nobody)
    works: Mapping[str, Array] = {name: getattr(e, name) for name in e.names[2:] if name != "defect"}
    off = np.maximum(np.abs(np.diff(total) - sum(works.values())), np.abs(e.defect))
    yield worst_of("balance", off / (scale + np.abs(e.potential[1:])), off, "J", steps[1:], nobody)
