"""Is a recording a motion of rigid bodies with contact and friction? An audit from the recording alone.

Everything is found anew from what is recorded (shapes, masses, q, v, impulses, works) by code that shares nothing with
the stepper: overlaps by `nsdyn.recording.overlap`, balances of every step from the two states it joins. With contact
points p, impulses r on body 2 (-r on body 1), centres of mass x and angular momenta L of free bodies, and their
positions x̃ in the middle of the step, the first half of which is free:

    m (v⁺ - v⁻) = Σ r + h m g          L⁺ - L⁻ = Σ (p - x̃) × r          Δ(T + V) = Σ works

Each finding is a number without unit: a violation over what it is measured by, so that scale does not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.recording.overlap import Solid, separation
from nsdyn.recording.poses import MIDDLE, Poses, turned
from nsdyn.recording.series import rotate
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import choice

__all__ = ["Audit", "Finding", "TOLERANCES", "check", "deepest", "separations"]

TOLERANCES = {
    "overlap": 1e-7,
    "distance": 1e-3,
    "normal": 1e-3,
    "cone": 1e-8,
    "friction": 1e-5,
    "slip": 1e-3,  # friction is against the mean slip of a step, whose direction differs from that at its end by O(h)
    "dissipation": 1e-4,
    "motion": 0.1,
    "momentum": 1e-9,
    "spin": 1e-3,
    "energy": 1e-9,
    "works": 1e-9,
    "balance": 1e-9,
}
"""Largest figure of each finding that passes."""

_MEANING = {
    "overlap": "true overlap of two bodies / smallest extent of the smaller one",
    "distance": "distance over which an impulse acts, beyond what the bodies move in the step / smallest extent",
    "normal": "overlap along the normal of a contact with an impulse, beyond the true one / smallest extent",
    "cone": "how far an impulse is outside its friction cone / largest impulse of the step",
    "friction": "work of friction at a contact at the velocity at the end of the step / energy at play",
    "slip": "mu r_N |u_T| + r_T·u_T of a contact, 0 where it sticks or rubs against its slip / energy at play",
    "dissipation": "work of all contacts in a step / energy at play",
    "motion": "displacement of a free body - what its velocities make, left to the projection / its smallest extent",
    "momentum": "m Δv - Σ r - h m g of a free body / momenta and impulses of which this is the sum",
    "spin": "ΔL - Σ (p - x) × r of a free body / angular momenta and impulses times the radius",
    "energy": "energy as recorded - energy of q and v / energy at play",
    "works": "work of contacts as the ledger has it - sum of those of the contacts / energy at play",
    "balance": "change of energy - sum of the works of the ledger / energy at play",
}

STATES = 200_000
"""Most poses of shapes that are looked at together."""


@dataclass(frozen=True)
class Finding:
    """The worst figure of one item of an audit.

    Attributes
    ----------
    name, meaning : str
    worst, tol : float
        Largest violation found, without unit, and the largest that passes. NaN if `reason` says why there is none.
    amount, unit : float, str
        The same violation as a quantity.
    step : int
        Step that ends in, or has, the worst figure; 0 is the initial state; -1 if there was nothing to look at.
    bodies : tuple of str
        Whose.
    looked_at : int
        Pairs, contacts, bodies or steps that were looked at.
    reason : str
        Why this was not audited.
    """

    name: str
    meaning: str
    worst: float
    tol: float
    amount: float
    unit: str
    step: int
    bodies: tuple[str, ...]
    looked_at: int
    reason: str = ""

    @property
    def passed(self) -> bool:
        """Whether the figure is within its tolerance, or not audited."""
        return bool(self.reason) or self.worst <= self.tol


@dataclass(frozen=True)
class Audit:
    """What `check` found.

    Attributes
    ----------
    findings : tuple of Finding
    name : str
        Of the scene.
    """

    findings: tuple[Finding, ...]
    name: str

    @property
    def passed(self) -> bool:
        """Whether all findings passed; what could not be audited does not fail."""
        return all(finding.passed for finding in self.findings)

    def __getitem__(self, name: str) -> Finding:
        """Finding by name."""
        return next(finding for finding in self.findings if finding.name == name)

    def as_dict(self) -> dict[str, Any]:
        """The findings by their names as JSON values, and ``passed``."""
        findings = {f.name: asdict(f) | {"passed": f.passed} for f in self.findings}
        return {"scene": self.name, "passed": self.passed, "findings": findings}

    def __repr__(self) -> str:
        lines = [f"{'audit':12} {'worst':>9} {'tolerance':>9}  {'':6} {'amount':>15}  where"]
        for f in self.findings:
            if f.reason:
                lines.append(f"{f.name:12} {'-':>9} {f.tol:9.0e}  not audited: {f.reason}")
                continue
            where = f"step {f.step}, {' and '.join(f.bodies)}" if f.bodies else f"step {f.step}"
            lines.append(
                f"{f.name:12} {f.worst:9.1e} {f.tol:9.0e}  {'passed' if f.passed else 'FAILED'} "
                f"{f.amount:9.2e} {f.unit:5}  {where if f.worst > 0.0 else ''}".rstrip()
            )
        lines.append(f"{self.name}: {'passed' if self.passed else 'FAILED'}")
        return "\n".join(lines)


def check(trajectory: Trajectory, **tolerances: float) -> Audit:
    """Audit a recording: true overlaps, contacts, balances of momentum and energy, each with its worst figure.

    Parameters
    ----------
    trajectory : Trajectory
    **tolerances : float
        In place of those in `TOLERANCES`, by their names.

    Returns
    -------
    Audit

    Raises
    ------
    ValueError
        For an unknown tolerance.

    Notes
    -----
    Not audited: links of articulations beyond their overlaps and contacts (their velocities and the reactions of their
    joints are not recorded), and the momenta of free bodies where external forces act. Where only every N-th step is
    recorded there are no balances of momentum, nor of the works of contacts one by one, nor is it known where those of
    the last step were in its middle; the ledger is audited, being of all steps. Where contacts are not recorded,
    nothing is audited that they do. In recordings before format 3 it is not known whether external forces acted, nor
    which links may overlap, so links of one articulation are not compared.

    Examples
    --------
    >>> import nsdyn as nd
    >>> audit = nd.check(nd.simulate(nd.scenes.load("slide")(), 0.1, dt=0.01))
    >>> audit.passed
    True
    """
    unknown = sorted(set(tolerances) - set(TOLERANCES))
    if unknown:
        choice(unknown[0], TOLERANCES, "tolerance")
    tol = TOLERANCES | tolerances
    poses = Poses(trajectory)
    findings = [*_overlaps(poses), *_contacts(poses), *_momenta(poses), *_energies(poses)]
    return Audit(tuple(finding(tol[name]) for name, finding in findings), str(trajectory.meta["scene_name"]))


def deepest(scene: Mapping[str, Any], q: Array) -> float:
    """Largest true overlap in m in poses q (n, 7 bodies) of a scene of free bodies that `Scene.describe` described."""
    columns = {"t": np.zeros(len(q)), "q": q, "v": np.zeros((len(q), 6 * scene["free"]))}
    ((_, finding),) = _overlaps(Poses(Trajectory({}, dict(scene), columns)), by_size=False)
    return finding(0.0).amount


_Found = tuple[str, Callable[[float], Finding]]


def _worst(name: str, figure: Array, amount: Array, unit: str, step: Index, bodies: Callable[[int], Any]) -> _Found:
    """The largest of some figures; NaN is the largest."""
    if not figure.size:
        return name, lambda tol: Finding(name, _MEANING[name], 0.0, tol, 0.0, unit, -1, (), 0)
    k = int(np.argmax(np.where(np.isnan(figure), np.inf, figure)))
    found = max(0.0, float(figure[k])), max(0.0, float(amount[k])), int(step[k]), tuple(bodies(k)), figure.size
    worst, size, at, who, count = found if not np.isnan(figure[k]) else (np.nan, np.nan, *found[2:])
    return name, lambda tol: Finding(name, _MEANING[name], worst, tol, size, unit, at, who, count)


def _left_out(t: Trajectory) -> str:
    """What contacts are not recorded, in words; empty where all are."""
    if not t.has_contacts:
        return "contacts are not recorded"
    return "" if t.every == 1 else f"of every {t.every} steps one is recorded"


def _unknown(name: str, unit: str, reason: str) -> _Found:
    return name, lambda tol: Finding(name, _MEANING[name], np.nan, tol, np.nan, unit, -1, (), 0, reason)


def separations(poses: Poses) -> tuple[Array, Index, Index, Index]:
    """True overlap [m], both shapes and state of every pair of shapes that may not overlap and whose boxes meet."""
    count, states = len(poses.names), poses.trajectory.steps + 1
    pairs = _tested(poses)
    found: list[tuple[Array, Index, Index, Index]] = []
    block = max(1, STATES // max(1, count))
    for begin in range(0, states, block):
        rows = np.arange(begin, min(begin + block, states))
        first, second, state = _close(poses, pairs, rows)
        depth = np.empty(first.size)
        for a, b, some in poses.by_kind(first, second):
            there = (*poses.of(first[some], state[some]), b, *poses.of(second[some], state[some]))
            depth[some] = -separation(a, *there)
        found.append((depth, first, second, state))
    depth, first, second, state = (np.concatenate(items) for items in zip(*found, strict=True))
    return depth, first, second, state


def _overlaps(poses: Poses, by_size: bool = True) -> Iterator[_Found]:
    """True overlaps in all states, the worst by size or in m."""
    depth, first, second, state = separations(poses)

    def names(k: int) -> tuple[str, str]:
        return poses.names[first[k]], poses.names[second[k]]

    figure = depth / poses.size(first, second) if by_size else depth
    yield _worst("overlap", figure, depth, "m", state, names)


def _tested(poses: Poses) -> NDArray[np.bool_]:
    """Pairs of shapes that must not overlap, each once, shape (shapes, shapes)."""
    frame, scene = poses.frame, poses.scene
    out = (frame[:, None] != frame) & ((frame[:, None] >= 0) | (frame >= 0))
    if "excluded" in scene:
        for i, j in scene["excluded"]:
            out[i, j] = out[j, i] = False
    else:  # of older recordings: what may overlap in an articulation is not known
        names = {a["name"] for a in scene["articulations"]}
        body = np.array([geom["body"] if geom["body"] in names else "" for geom in scene["geoms"]])
        out &= (body[:, None] != body) | (body == "")
    return np.triu(out, 1)


def _close(poses: Poses, pairs: NDArray[np.bool_], rows: Index) -> tuple[Index, Index, Index]:
    """Pairs of shapes whose boxes along the world's axes meet: (first, second, state)."""
    count = len(poses.names)
    low, high = np.empty((2, count, rows.size, 3))
    flat = np.zeros(count, np.bool_)
    for k in range(count):
        solid = poses.solids[poses.kind[k]]
        R, x = poses.of(np.full(rows.size, k), rows)
        flat[k] = solid.kind == "halfspace"
        if not flat[k]:
            high[k] = x + solid.support(np.swapaxes(R, 1, 2).swapaxes(1, 2))
            low[k] = x - solid.support(-R)
    first, second, state = [], [], []
    for i in range(count):
        others = np.flatnonzero(pairs[i])
        solid = others[~flat[others]] if not flat[i] else others[:0]
        near = ((low[i] <= high[solid]) & (low[solid] <= high[i])).all(axis=2)
        some = [(solid[near.nonzero()[0]], near.nonzero()[1])]
        plane = np.setdiff1d(others, solid)
        some.append((np.repeat(plane, rows.size), np.tile(np.arange(rows.size), plane.size)))
        for other, at in some:
            first.append(np.full(other.size, i))
            second.append(other)
            state.append(rows[at])
    empty = np.empty(0, np.int64)
    return tuple(np.concatenate([empty, *items]) for items in (first, second, state))  # type: ignore[return-value]


def _contacts(poses: Poses) -> Iterator[_Found]:
    """Where impulses act, in which cones they are, and what friction does."""
    t = poses.trajectory
    units = {"distance": "m", "normal": "m", "cone": "N·s", "friction": "J", "slip": "J"}
    missing = list(units) if not t.has_contacts else ["distance", "normal"] if t.every > 1 else []
    yield from (_unknown(name, units[name], _left_out(t)) for name in missing)
    if not t.has_contacts:
        return
    c = {name.removeprefix("contacts/"): values for name, values in t.columns.items() if name.startswith("contacts/")}
    step = np.repeat(np.arange(1, t.steps + 1), np.diff(c["offset"]))
    first, second = c["geom1"].astype(np.int64), c["geom2"].astype(np.int64)
    r, mu = c["impulse"], c["mu"]
    drag = np.linalg.norm(r[:, 1:], axis=1)

    def names(k: int) -> tuple[str, str]:
        return poses.names[first[k]], poses.names[second[k]]

    largest = np.zeros(t.steps + 1)
    np.maximum.at(largest, step, np.linalg.norm(r, axis=1))

    if not missing:
        yield from _where(poses, c, step, largest)
    outside = np.maximum(-r[:, 0], drag - mu * np.maximum(r[:, 0], 0.0))
    scale = np.maximum(largest[step], 1e-300)
    yield _worst("cone", outside / scale, outside, "N·s", step, names)
    power = (r[:, 1:] * c["u"][:, 1:]).sum(axis=1)
    yield _worst("friction", power / _at_play(poses), power, "J", step, names)
    most = np.abs(mu * np.maximum(r[:, 0], 0.0) * np.linalg.norm(c["u"][:, 1:], axis=1) + power)
    yield _worst("slip", most / _at_play(poses), most, "J", step, names)


def _where(poses: Poses, c: Mapping[str, Any], step: Index, largest: Array) -> Iterator[_Found]:
    """Where pairs are that push each other: along the normal, from a step before to a step after."""
    t, r = poses.trajectory, c["impulse"]
    push = np.flatnonzero(r[:, 0] > 1e-9 * largest[step])
    i, j, k, n = c["geom1"][push].astype(np.int64), c["geom2"][push].astype(np.int64), step[push], c["normal"][push]
    n = n / np.linalg.norm(n, axis=1)[:, None]
    moments = [(k - 2).clip(0), k - 1, k - 1, k, (k + 1).clip(None, t.steps)]
    along, free = np.empty((2, len(moments), push.size))
    for a, b, some in poses.by_kind(i, j):
        for moment, row in enumerate(moments):
            pose1 = poses.of(i[some], row[some], middle=moment == MIDDLE)
            pose2 = poses.of(j[some], row[some], middle=moment == MIDDLE)
            along[moment, some] = _along(a, *pose1, b, *pose2, n[some])
            free[moment, some] = separation(a, *pose1, b, *pose2)
    size = poses.size(i, j)
    travel = np.abs(np.diff(along, axis=0)).sum(axis=0)
    # A contact and its normal are those of some time within the step.
    apart, skew = along[1:4].min(axis=0) - travel, (np.minimum(free, 0.0) - along)[1:4].min(axis=0) - travel

    def pushing(row: int) -> tuple[str, str]:
        return poses.names[i[row]], poses.names[j[row]]

    yield _worst("distance", apart / size, apart, "m", k, pushing)
    yield _worst("normal", skew / size, skew, "m", k, pushing)


def _along(a: Solid, R1: Array, x1: Array, b: Solid, R2: Array, x2: Array, n: Array) -> Array:
    """Separation along given normals from a to b, shape (m,)."""
    if a.kind == "halfspace":
        return _along(b, R2, x2, a, R1, x1, -n)
    if b.kind == "halfspace":  # along any other normal it would be infinitely deep: the other shape's tilt will do
        out: Array = separation(a, R1, x1, b, R2, x2) - a.reach * np.linalg.norm(n + R2 @ b.size, axis=1)
        return out
    out = (n * (x2 - x1)).sum(axis=1) - a.support((n[:, None] @ R1)[:, 0]) - b.support(-(n[:, None] @ R2)[:, 0])
    return out


def _momenta(poses: Poses) -> Iterator[_Found]:
    """Momentum and angular momentum of free bodies in every step."""
    t, free = poses.trajectory, poses.free
    yield _motion(poses) if t.every == 1 else _unknown("motion", "m", f"of every {t.every} steps one is recorded")
    reason = _left_out(t)
    if t.meta.get("external_force", True):
        known = "external_force" in t.meta
        reason = "external forces act" if known else "whether external forces act is not recorded"
    if reason:
        yield _unknown("momentum", "N·s", reason)
        yield _unknown("spin", "N·m·s", reason)
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
    yield _of_bodies(poses, "momentum", np.linalg.norm(left, axis=2), scale, "N·s")
    turning, moved = np.linalg.norm(spin, axis=2), np.diff(poses.x[:, :free], axis=0)
    orbit = np.cross(moved, mass[:, None] * (velocity[1:] - 0.5 * t.dt * gravity))
    left = np.linalg.norm(np.diff(spin, axis=0) + orbit - torque, axis=2)
    size = np.linalg.norm(moved, axis=2) * mass * speed[1:]
    yield _of_bodies(poses, "spin", left, reach + size + turning[:-1] + turning[1:], "N·m·s")


def _motion(poses: Poses) -> _Found:
    """How free bodies move with their velocities: of points of them, m."""
    t, free, theta = poses.trajectory, poses.free, float(poses.trajectory.meta["theta"])
    x, q = poses.x[:, :free], poses.quaternion[:, :free]
    before, after = (1.0 - theta) * t.dt * poses.v[:-1], theta * t.dt * poses.v[1:]
    # Half a turn with either angular velocity, each in the axes of its own end.
    there, back = turned(q[:-1], before[..., 3:]), turned(q[1:], -after[..., 3:])
    angle = 2.0 * np.linalg.norm(there - np.where((there * back).sum(-1, keepdims=True) < 0.0, -back, back), axis=-1)
    left = np.diff(x, axis=0) - rotate(q[:-1], before[..., :3]) - rotate(q[1:], after[..., :3])
    reach, extent = np.zeros(free), np.full(free, np.inf)
    for k in np.flatnonzero((poses.frame >= 0) & (poses.frame < free)):
        body, solid = poses.frame[k], poses.solids[poses.kind[k]]
        reach[body] = max(reach[body], solid.reach)
        extent[body] = min(extent[body], solid.extent)
    # Where an impact changed the velocities, when it did is not recorded.
    change = np.diff(rotate(q, poses.v[..., :3]), axis=0), np.diff(rotate(q, poses.v[..., 3:]), axis=0)
    late, later = (max(theta, 1.0 - theta) * t.dt * np.linalg.norm(part, axis=2) for part in change)
    amount = np.maximum(np.linalg.norm(left, axis=2) - late, (angle - later) * reach)
    return _of_bodies(poses, "motion", amount, np.broadcast_to(extent, amount.shape), "m")


def _of_bodies(poses: Poses, name: str, amount: Array, scale: Array, unit: str) -> _Found:
    """The worst of free bodies and steps, from arrays (n, bodies)."""
    steps, bodies = np.indices(amount.shape)
    figure = (amount / np.maximum(scale, 1e-300)).ravel()
    return _worst(
        name, figure, amount.ravel(), unit, steps.ravel() + 1, lambda k: [poses.scene["frames"][bodies.ravel()[k]]]
    )


def _at_play(poses: Poses) -> float:
    """Energy at play, J; where next to nothing moves, what lifts the free bodies by their size."""
    t, scene = poses.trajectory, poses.scene
    lift = 0.0
    for k in np.flatnonzero((poses.frame >= 0) & (poses.frame < poses.free)):
        lift += scene["masses"][poses.frame[k]] * float(np.linalg.norm(scene["gravity"])) * float(poses.extent[k])
    return max(t.at_play, lift, 1e-9 * float(np.abs(t.energy.potential).max()), 1e-300)


def _falls(t: Trajectory) -> Array:
    """The most that gravity may do in each step beyond its potential, J, (n,): h |g| Σ ‖r‖ of what rebounds.

    Where impacts are caught within a step velocities jump at its middle, and weights move otherwise than on the mean of
    before and after: by at most half a step of the jump, which is r over the mass of each of two bodies.
    """
    size = np.linalg.norm(t.columns["contacts/impulse"], axis=1) * (t.columns["contacts/restitution"] > 0.0)
    so_far = np.concatenate([[0.0], np.cumsum(size)])[t.columns["contacts/offset"]]
    out: Array = t.dt * float(np.linalg.norm(t.scene["gravity"])) * np.diff(so_far)
    return out


def _energies(poses: Poses) -> Iterator[_Found]:
    """Energies anew, works of contacts summed anew, and the balance of every step."""
    t = poses.trajectory
    e, free = t.energy, poses.free
    trees, scale = bool(t.scene["articulations"]), _at_play(poses)
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
        yield _worst("dissipation", gain / scale, gain, "J", steps[1:], nobody)
    else:
        yield _unknown("dissipation", "J", _left_out(t))
    total = e.total
    if trees:
        yield _unknown("energy", "J", "masses of articulations are not recorded")
        yield _unknown("works", "J", "works of joints are not recorded one by one")
    else:
        pose, twist = t.q.reshape(t.steps + 1, free, 7), t.v.reshape(t.steps + 1, free, 6)
        mass, inertia = np.array(t.scene["masses"]), np.array(t.scene["inertias"]).reshape(-1, 3, 3)
        turning = np.einsum("nbi,bij,nbj->n", twist[..., 3:], inertia, twist[..., 3:])
        kinetic = 0.5 * ((twist[..., :3] ** 2).sum(axis=2) @ mass + turning)
        potential = -(pose[..., :3] @ np.array(t.scene["gravity"])) @ mass
        off = np.maximum(np.abs(kinetic - e.kinetic), np.abs(potential - e.potential))
        yield _worst("energy", off / (scale + np.abs(potential)), off, "J", steps, nobody)
        total = kinetic + potential
        if reason := _left_out(t):
            yield _unknown("works", "J", reason)
        elif float(t.meta["theta"]) != 0.5:
            yield _unknown("works", "J", "with theta above 0.5 the scheme does work of its own")
        else:
            # What contacts do that stay closed and stick is booked as numerics.
            off = np.abs(gain - e.normal - e.friction - e.integration)
            off = np.maximum(off - _falls(t), 0.0)
            yield _worst("works", off / scale, off, "J", steps[1:], nobody)
    works: Mapping[str, Array] = {name: getattr(e, name) for name in e.names[2:] if name != "defect"}
    off = np.abs(np.diff(total) - sum(works.values()))
    yield _worst("balance", off / (scale + np.abs(e.potential[1:])), off, "J", steps[1:], nobody)
