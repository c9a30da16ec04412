"""Audit of motion: momenta of free bodies, how they move, energies and the works of the ledger."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from nsdyn.recording.findings import Found, at_play, left_out, not_audited, of_bodies, worst_of
from nsdyn.recording.poses import Poses, turned
from nsdyn.recording.series import rotate
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools.arrays import Array

__all__ = ["energies", "momenta"]


def momenta(poses: Poses) -> Iterator[Found]:
    """Momentum and angular momentum of free bodies in every step."""
    t, free = poses.trajectory, poses.free
    yield _motion(poses) if t.every == 1 else not_audited("motion", "m", f"of every {t.every} steps one is recorded")
    reason = left_out(t)
    if t.meta.get("external_force", True):
        known = "external_force" in t.meta
        reason = "external forces act" if known else "whether external forces act is not recorded"
    if reason:
        yield not_audited("momentum", "N·s", reason)
        yield not_audited("spin", "N·m·s", reason)
        return
    mass, inertia = np.array(poses.scene["masses"]), np.array(poses.scene["inertias"]).reshape(-1, 3, 3)
    gravity = np.array(poses.scene["gravity"])
    q, twist = poses.quaternion[:, :free], poses.v
    velocity, rate = rotate(q, twist[..., :3]), twist[..., 3:]
    spin = rotate(q, np.einsum("bij,nbj->nbi", inertia, rate))
    c = t.columns
    step = np.repeat(np.arange(t.steps), np.diff(c["contacts/offset"]))
    n, t1, r = c["contacts/normal"], c["contacts/tangent"], c["contacts/impulse"]
    impulse = r[:, :1] * n + r[:, 1:2] * t1 + r[:, 2:] * np.cross(n, t1)
    size = np.linalg.norm(impulse, axis=1)
    total, sizes, reach = np.zeros((t.steps, free, 3)), np.zeros((t.steps, free)), np.zeros((t.steps, free))
    # About the place where the body is at the beginning, so that it does not matter when within the step they acted.
    torque, place = np.zeros((t.steps, free, 3)), poses.x[:-1, :free]
    for side, sign in (("geom1", -1.0), ("geom2", 1.0)):
        body = poses.frame[c[f"contacts/{side}"]]
        on = np.flatnonzero((body >= 0) & (body < free))
        k, b = step[on], body[on]
        np.add.at(total, (k, b), sign * impulse[on])
        np.add.at(sizes, (k, b), size[on])
        arm = c["contacts/point"][on] - place[k, b]
        np.add.at(torque, (k, b), sign * np.cross(arm, impulse[on]))
        np.add.at(reach, (k, b), size[on] * np.linalg.norm(arm, axis=1))
    left = mass[:, None] * np.diff(velocity, axis=0) - total - t.dt * mass[:, None] * gravity
    speed = np.linalg.norm(velocity, axis=2)
    scale = sizes + mass * (speed[:-1] + speed[1:] + t.dt * np.linalg.norm(gravity))
    yield of_bodies(poses, "momentum", np.linalg.norm(left, axis=2), scale, "N·s")
    turning, moved = np.linalg.norm(spin, axis=2), np.diff(poses.x[:, :free], axis=0)
    orbit = np.cross(moved, mass[:, None] * (velocity[1:] - 0.5 * t.dt * gravity))
    # What the projection lifts goes round that place with its momentum, though no torque acts; and where impacts have
    # the body on its way is not recorded, so that of its weight's lever no more is known.
    weight = t.dt * np.linalg.norm(gravity)
    blurred = (
        np.linalg.norm(moved - _moved(poses), axis=2) * (speed[1:] + weight) + poses.uncertain[0][:, :free] * weight
    )
    left = np.maximum(np.linalg.norm(np.diff(spin, axis=0) + orbit - torque, axis=2) - mass * blurred, 0.0)
    size = np.linalg.norm(moved, axis=2) * mass * speed[1:]
    yield of_bodies(poses, "spin", left, reach + size + turning[:-1] + turning[1:], "N·m·s")


def _moved(poses: Poses) -> Array:
    """Displacements (n, free, 3) that the velocities of free bodies make, m: (1 - θ) h v⁻ + θ h v⁺."""
    t, theta, q = poses.trajectory, float(poses.trajectory.meta["theta"]), poses.quaternion[:, : poses.free]
    before, after = (1.0 - theta) * t.dt * poses.v[:-1, :, :3], theta * t.dt * poses.v[1:, :, :3]
    out: Array = rotate(q[:-1], before) + rotate(q[1:], after)
    return out


def _motion(poses: Poses) -> Found:
    """How free bodies move with their velocities: of points of them, m."""
    t, free, theta = poses.trajectory, poses.free, float(poses.trajectory.meta["theta"])
    x, q = poses.x[:, :free], poses.quaternion[:, :free]
    before, after = (1.0 - theta) * t.dt * poses.v[:-1], theta * t.dt * poses.v[1:]
    # Half a turn with either angular velocity, each in the axes of its own end.
    there, back = turned(q[:-1], before[..., 3:]), turned(q[1:], -after[..., 3:])
    angle = 2.0 * np.linalg.norm(there - np.where((there * back).sum(-1, keepdims=True) < 0.0, -back, back), axis=-1)
    left = np.diff(x, axis=0) - _moved(poses)
    reach, extent = np.zeros(free), np.full(free, np.inf)
    for k in np.flatnonzero((poses.frame >= 0) & (poses.frame < free)):
        body, solid = poses.frame[k], poses.solids[poses.kind[k]]
        reach[body] = max(reach[body], solid.reach)
        extent[body] = min(extent[body], solid.extent)
    late, later = (part[:, :free] for part in poses.uncertain)
    amount = np.maximum(np.linalg.norm(left, axis=2) - late, (angle - later) * reach)
    return of_bodies(poses, "motion", amount, np.broadcast_to(extent, amount.shape), "m")


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
    """Energies anew, works of contacts summed anew, and the balance of every step."""
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
        # Rolling resistance, by which contacts lose what their impulses gave, is booked with the projection.
        work = gain + np.minimum(e.projection, 0.0) - _falls(t)
        yield worst_of("dissipation", work / scale, work, "J", steps[1:], nobody)
    else:
        yield not_audited("dissipation", "J", left_out(t))
    total = e.total
    if trees:
        yield not_audited("energy", "J", "masses of articulations are not recorded")
        yield not_audited("works", "J", "works of joints are not recorded one by one")
    else:
        pose, twist = t.q.reshape(t.steps + 1, free, 7), t.v.reshape(t.steps + 1, free, 6)
        mass, inertia = np.array(t.scene["masses"]), np.array(t.scene["inertias"]).reshape(-1, 3, 3)
        turning = np.einsum("nbi,bij,nbj->n", twist[..., 3:], inertia, twist[..., 3:])
        kinetic = 0.5 * ((twist[..., :3] ** 2).sum(axis=2) @ mass + turning)
        potential = -(pose[..., :3] @ np.array(t.scene["gravity"])) @ mass
        off = np.maximum(np.abs(kinetic - e.kinetic), np.abs(potential - e.potential))
        yield worst_of("energy", off / (scale + np.abs(potential)), off, "J", steps, nobody)
        total = kinetic + potential
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
    off = np.abs(np.diff(total) - sum(works.values()))
    yield worst_of("balance", off / (scale + np.abs(e.potential[1:])), off, "J", steps[1:], nobody)
