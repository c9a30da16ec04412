"""Motion of free bodies in each step from velocities and the recorded impulses and lifts, by independent code."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853

from nsdyn.audit.findings import CREEP, TOLERANCES
from nsdyn.audit.meetings import Meetings, Side
from nsdyn.audit.poses import CONJUGATE, Poses, matrix, product, turned
from nsdyn.audit.pushes import LIFT, Pushes, together, velocities
from nsdyn.audit.retraced import Retraced
from nsdyn.recording.series import rotate
from nsdyn.recording.shares import contact_axes
from nsdyn.recording.tables import impulses_world
from nsdyn.tools.arrays import Array, Bools, Index, cross

LEAP = 0.15
"""Largest rotation per step of the Runge-Kutta method, rad; its error is 4e-13 rad in a whole turn."""

FARTHEST = 1e4
"""Largest rotation that is followed, rad. A damaged recording may have any, and following it would not end."""

STAGES = (*(DOP853.A[k, :k] for k in range(DOP853.n_stages)), DOP853.B)
"""Stages and weights of the method, of eighth order, by J. R. Dormand and P. J. Prince."""

COARSE = 0.5, 1e-7
"""Rotation in one step of a method of sixth order, rad, and its largest error then, rad."""

NAMED = 0.1
"""Largest motion of a contact in half a step under the same name, as a fraction of the smaller body's radius: 0.05,
and the same again for the motion of the body."""

CLOSED = 1e-9
"""Gap that counts as closed, as a fraction of the radius of the smallest moving shape."""


@dataclass(frozen=True)
class Flight:
    """Positions of free bodies in each step at the times of the impulses on them.

    Let r_j be the impulses at the times t_j within a step, with those of external wrenches.
    Let δ_k be lifts by projections, and w the velocity change by other forces. Then

        x(τ) = x + τ v⁻ + Σ (τ - t_j)₊ r_j / m + Σ δ_k + displacement by w.

    At the end the displacement by w is θ h w, or h w / 2 if the step was cut into moves. Forces act with the impulses
    of each move. At the ends of moves the body is where a constant force would have brought it. Arrays have the shape
    (n, free, ...), those of contacts (contacts, ...).

    Attributes
    ----------
    impulse, torque : ndarray, shape (n, free, 3)
        Σ r, N·s, and Σ (p - x(t_j)) × r plus couples, about the positions at these times, N·m·s; with wrenches.
    size, levers : ndarray, shape (n, free)
        Σ ‖r‖, and Σ ‖p - x‖ ‖r‖, with the moments of external wrenches.
    pushes : Pushes
        All impulses, and the lifts.
    astray : ndarray, shape (n, free)
        Distance of the recorded end of a body from the x(τ) above, m.
    unknown : ndarray, shape (n, free)
        Uncertainty of the displacement by w if a step was cut at times that no impulse shows, m. For θ = ½ it is 0:
        falling bodies are at the ends of all moves where they would be in one move.
    turn : ndarray, shape (n, free)
        Deviation of the recorded orientation from that by angular momenta, impulses at their times, and lifts, rad.
    kept : ndarray, shape (n, free)
        Largest distance of a body from where its contacts were found, m.
    flow : ndarray, shape (n, free)
        Uncertainty of the orientation by a flow of sixth order, and by unknown levers, rad.
    lifted : ndarray, shape (n,)
        Change of energy by lifts, J.
    met : Meetings
        Relative motion at all contacts; unknown for prescribed bodies.
    unsure : ndarray, shape (contacts,)
        Uncertainty of velocities at contacts, m/s: of free bodies in steps that were cut, and of links.
    cut : ndarray of bool, shape (n, free)
        Whether the step was cut into moves, for that body.
    instant, parted : ndarray of bool, shape (contacts,)
        Whether an impulse is instantaneous, and whether it alternates with impacts of joint limits.
    """

    impulse: Array
    torque: Array
    size: Array
    levers: Array
    pushes: Pushes
    astray: Array
    unknown: Array
    turn: Array
    kept: Array
    flow: Array
    lifted: Array
    met: Meetings
    unsure: Array
    cut: Bools
    instant: Bools
    parted: Bools

    @classmethod
    def of(cls, poses: Poses, links: Retraced | str) -> Flight:
        """Follow the free bodies of a recording that has all steps and contacts, whose `links` were followed before."""
        t, free, theta = poses.trajectory, poses.free, poses.theta
        h, shape, point = t.dt, (t.steps, free), poses.contacts["point"]
        geoms, pushes = poses.pair.T, Pushes.of(poses, impulses_world(t.columns))
        row, _, step, body, time, length, push, couple, shift = pushes
        cut, met = pushes.cut(poses), row >= 0
        mass, impulse = poses.mass, pushes.summed(shape, push)
        moments, before = pushes.summed(shape, time[:, None] * push), velocities(poses)[:-1]
        forced = np.diff(velocities(poses), axis=0) - impulse / mass[:, None]
        share = np.where(cut, 0.5, theta)[:, :, None]
        path = h * before + (h * impulse - moments) / mass[:, None] + share * h * forced
        path += pushes.summed(shape, shift[:, :3])
        # Displacement of the body by earlier impulses and by forces, up to each impulse.
        begun = time - (1.0 - theta) * length
        way = time[:, None] * pushes.earlier(push) - pushes.earlier(time[:, None] * push)
        fall = (begun * (time - 0.5 * begun) / h)[:, None] * forced[step, body]
        at = poses.x[step, body] + time[:, None] * before[step, body] + way / mass[body, None] + fall
        at += pushes.earlier(shift[:, :3])
        arm, size = np.zeros(at.shape), np.linalg.norm(push, axis=1)
        arm[met] = point[row[met]] - at[met]
        moment = cross(arm, push) + couple
        ends, then, turning = _turned(poses, pushes, moment)
        if isinstance(links, str):
            nothing = np.zeros(len(point))
            sides, unsure, parted = (Side.nowhere(len(point)), Side.nowhere(len(point))), nothing, nothing > 0.0
        else:
            sides, unsure, parted = links.met, links.met_unsure, links.met_parted
        own = _sides(poses, pushes, (before, forced, begun / h), (at, arm, then, turning))
        _put(poses, sides, geoms, pushes, own)
        ways = np.diff(poses.x[:, :free], axis=0) - path, np.where(cut[:, :, None], (theta - 0.5) * h * forced, 0.0)
        astray, unknown = np.linalg.norm(ways, axis=3)
        turn = angles(ends, poses.quaternion[1:, :free])
        doubt = np.where(cut[step, body], _doubted(poses, pushes, ways, turn, (arm, then, turning)), 0.0)
        turns = np.where(met, size * np.linalg.norm(arm, axis=1), np.linalg.norm(couple, axis=1))
        levers = pushes.summed(shape, turns)
        rests = cut | ((1.0 - theta) * h * np.linalg.norm(before, axis=2) <= (closed := _closed(poses)))
        kept = np.where(rests, closed, 0.0)
        fastest = (np.linalg.norm(spins(poses)[:-1], axis=2) + levers) / least(poses)
        far, lever = h * fastest / COARSE[0], unknown + kept + poses.rounded
        return cls(
            impulse,
            pushes.summed(shape, moment),
            pushes.summed(shape, size),
            levers,
            pushes,
            astray,
            unknown,
            turn,
            kept,
            COARSE[1] * far * np.minimum(far, 1.0) ** 6 + h * pushes.summed(shape, size) * lever / least(poses),
            _lifted(poses, pushes, then, turning),
            Meetings.of(sides, contact_axes(poses.contacts), point, poses.rounding[geoms].sum(axis=1), _wander(poses)),
            np.bincount(row[met], doubt[met], len(point)) + unsure,
            cut,
            poses.contacts["duration"] == 0.0,
            parted,
        )


def _sides(
    poses: Poses, pushes: Pushes, moved: tuple[Array, Array, Array], met: tuple[Array, Array, Array, Array]
) -> Side:
    """Free bodies at their contacts.

    `moved` holds v at the start, its change w by forces, and the share of w that acts before the moves of the contacts.
    `met` holds x, p - x, q and (ω⁻, ω⁺).
    """
    (before, forced, share), (at, arm, then, turning) = moved, met
    step, body = pushes.step, pushes.body
    # Forces act together with the impulses of a move.
    gone = [part[:, None] for part in (share, share + pushes.length / poses.trajectory.dt)]
    mass = poses.mass[body, None]
    linear = before[step, body] + np.stack(gone) * forced[step, body] + pushes.around(pushes.push) / mass
    back = product(poses.quaternion[step, body], then * CONJUGATE)
    spin = rotate(poses.quaternion[step, body], poses.v[step, body, 3:])
    begin = before[step, body] + cross(spin, rotate(back, arm))
    return Side(at, then, np.stack([begin, *(linear + cross(turning, arm))]), turning, back)


def _put(poses: Poses, sides: tuple[Side, Side], geoms: Index, pushes: Pushes, own: Side) -> None:
    """Enter free bodies, and fixed bodies whose surfaces do not move either, into the sides of contacts."""
    moved = poses.scene["motions"].keys()
    called = ((g["body"], g["link"]) for g in poses.scene["geoms"])
    still = np.array([moved.isdisjoint(names) for names in called], np.bool_) & (poses.frame < 0)
    for k, met in enumerate(sides):
        rows, pushed = np.flatnonzero(still[geoms[:, k]]), pushes.side == k
        met.put(rows, Side.still(rows.size))
        met.put(pushes.row[pushed], own.some(pushed))


def _wander(poses: Poses) -> Array:
    """Speed at which each contact comes from its last position or goes to its next one, (contacts,), m/s.

    Contacts are matched by key. If one contact is the only one of its pair with an impulse, it is also matched by pair:
    a contact that moves far, as around the rim of a coin, changes its key. If there are several, a new round contact
    comes from no farther than the distance over which names are kept, because contacts on rims are then redistributed,
    and a new one of corners and edges no faster than the bodies move.
    """
    c = poses.contacts
    when, out = poses.step * poses.trajectory.dt + c["time"], np.zeros(poses.step.size)
    pair, pushes = poses.code, c["impulse"][:, 0] > 0.0
    # With θ = 1 an impact and the move that follows it have the same time.
    group = np.unique(np.stack([pair, when, c["duration"] == 0.0]), axis=1, return_inverse=True)[1].ravel()
    alone = pushes & (np.bincount(group, pushes)[group] == 1.0)
    new = np.unique(c["key"], return_index=True)[1]
    far = NAMED * poses.bounding_radius[poses.pair].min(axis=0) / (0.5 * poses.trajectory.dt)
    fast = np.zeros(poses.step.size)
    for geom in poses.pair:
        free = np.flatnonzero(poses.is_free(poses.frame[geom]))
        body, radius, k = poses.frame[geom[free]], poses.bounding_radius[geom[free]], poses.step[free]
        speed, spin = (np.linalg.norm(part, axis=2) for part in (poses.v[..., :3], poses.v[..., 3:]))
        fast[free] += np.maximum(*(speed[row, body] + radius * spin[row, body] for row in (k, k + 1)))
    out[new] = np.where(poses.rounding[poses.pair].sum(axis=0) > 0.0, np.where(alone, 0.0, far), fast)[new]
    for name in (c["key"], np.where(alone, pair, -1 - np.arange(pair.size))):
        order = np.lexsort((when, name))
        begin, group = together(name[order], when[order])
        at, most = order[begin], np.maximum.reduceat(out[order], begin) if begin.size else out
        way, took = np.linalg.norm(np.diff(c["point"][at], axis=0), axis=1), np.diff(when[at])
        speed = np.where(np.diff(name[at]) == 0, way / np.where(took > 0.0, took, np.inf), 0.0)
        for near in (most[1:], most[:-1]):
            np.maximum(near, speed, out=near)
        out[order] = most[group]
    return out


def sunk(poses: Poses, size: Array) -> Array:
    """Penetration that a step may leave, m: round-off, or what the tolerance of solvers allows in size / `CREEP`."""
    t = poses.trajectory
    told = re.search(r"\btol=(\d+(?:\.\d*)?(?:e[+-]?\d+)?)", str(t.meta.get("solver", "")))
    tol = min(float(told[1]), TOLERANCES["velocities"]) if told else 0.0
    return np.maximum(tol * np.minimum(t.dt, size / CREEP), poses.rounded)


def _closed(poses: Poses) -> float:
    """Gap that counts as closed, m. Bodies that move by no more than it may keep their contacts."""
    radii = 0.5 * poses.extent[poses.frame >= 0]
    least = radii.min(initial=radii.max(initial=0.0))
    return float(max(CLOSED * least, sunk(poses, least)))


def _doubted(
    poses: Poses, pushes: Pushes, ways: tuple[Array, Array], turn: Array, met: tuple[Array, Array, Array]
) -> Array:
    """Uncertainty of velocities of points with an impulse, (m,), m/s, if bodies are displaced by `ways` and turned.

    Points then have other arms about their bodies, and the impulses up to that time turn the bodies differently.
    """
    at, (arm, then, turning) = (pushes.step, pushes.body), met
    axes, length = matrix(then), np.linalg.norm(arm, axis=1)
    inertia, swept = axes @ poses.inertia[pushes.body] @ np.swapaxes(axes, 1, 2), 2.0 * length * turn[at]
    levers = np.linalg.solve(inertia, cross(np.eye(3), pushes.push[:, None]).swapaxes(1, 2))
    off, spun = swept, np.linalg.norm(levers, axis=(1, 2)) * swept
    for way in ways:
        off = off + np.linalg.norm(way[at], axis=1)
        spun = spun + np.linalg.norm((levers @ way[at][:, :, None])[..., 0], axis=1)
    return np.linalg.norm(turning, axis=2).max(axis=0) * off + length * pushes.around(spun)[1]


def least(poses: Poses) -> Array:
    """Least moments of inertia of free bodies, (free,), kg m²."""
    return np.array(np.linalg.eigvalsh(poses.inertia)[:, 0])


def angles(one: Array, other: Array) -> Array:
    """Angles between orientations (..., 4), to second order, (...), rad."""
    near = np.where((one * other).sum(axis=-1, keepdims=True) < 0.0, -other, other)
    return 2.0 * np.linalg.norm(one - near, axis=-1)


def _lifted(poses: Poses, pushes: Pushes, then: Array, turning: Array) -> Array:
    """Change of energy by lifts in each step, (n,), J: potential energy, and ½ L·J⁻¹ L with L fixed in space."""
    lifts = pushes.row == LIFT
    step, body = pushes.step[lifts], pushes.body[lifts]
    weight = poses.mass[:, None] * poses.gravity
    work = -np.einsum("li,li->l", pushes.shift[lifts, :3], weight[body])
    after = turned(then[lifts], rotate(then[lifts] * CONJUGATE, pushes.shift[lifts, 3:]))
    for sign, attitude, spin in zip((-0.5, 0.5), (then[lifts], after), turning[:, lifts], strict=True):
        own = rotate(attitude * CONJUGATE, spin)
        work = work + sign * np.einsum("li,lij,lj->l", own, poses.inertia[body], own)
    return np.bincount(step, work, poses.trajectory.steps).astype(float)


def _turned(poses: Poses, pushes: Pushes, moment: Array) -> tuple[Array, Array, Array]:
    """Orientations of free bodies after each step, (n, free, 4), and before each impulse or lift, (m, 4).

    Also returns the angular velocities before and after each, world axes, (2, m, 3), rad/s.
    """
    t, free, time, length = poses.trajectory, poses.free, pushes.time, pushes.length
    row, lifts, shift = pushes.step * free + pushes.body, pushes.row == LIFT, pushes.shift
    q, w = poses.quaternion[:-1, :free].reshape(-1, 4).copy(), poses.v[:-1, :, 3:].reshape(-1, 3).copy()
    inertia, now = np.tile(poses.inertia, (t.steps, 1, 1)), np.zeros(t.steps * free)
    # Sum the moments that act on one body at once. With θ = 1 a move and the impacts before it at the same time are
    # separate, as are a move and the lift at its end. Then process the first of each body, the second, and so on.
    begin, group = together(row, time, length, lifts)
    if begin.size:
        row, moment, shift = row[begin], np.add.reduceat(moment, begin), shift[begin]
        time = time[begin] + poses.theta * np.where(lifts[begin], length[begin], 0.0)
    rank, met = np.arange(row.size) - np.searchsorted(row, row), np.empty((row.size, 10))
    for k in range(int(rank.max(initial=-1)) + 1):
        some = rank == k
        i = row[some]
        q[i], w[i] = tumbled(q[i], w[i], inertia[i], time[some] - now[i])
        # A lift leaves the angular momentum unchanged in space.
        spin = rotate(q[i], np.einsum("bij,bj->bi", inertia[i], w[i])) + moment[some]
        met[some, :4], met[some, 4:7] = q[i], rotate(q[i], w[i])
        q[i] = turned(q[i], rotate(q[i] * CONJUGATE, shift[some, 3:]))
        w[i] = np.linalg.solve(inertia[i], rotate(q[i] * CONJUGATE, spin)[..., None])[..., 0]
        met[some, 7:] = rotate(q[i], w[i])
        now[i] = time[some]
    end, _ = tumbled(q, w, inertia, t.dt - now)
    return end.reshape(t.steps, free, 4), met[group, :4], np.stack([met[group, 4:7], met[group, 7:]])


def spins(poses: Poses) -> Array:
    """Angular momenta of free bodies about their centres of mass in world axes, (n + 1, free, 3), N·m·s."""
    own = np.einsum("bij,nbj->nbi", poses.inertia, poses.v[..., 3:])
    return rotate(poses.quaternion[:, : poses.free], own)


def tumbled(quaternion: Array, turning: Array, inertia: Array, time: Array) -> tuple[Array, Array]:
    """Orientations (m, 4) and angular velocities (m, 3) of bodies after a free rotation.

    Integrates q' = ½ q ∘ ω and J ω' = J ω × ω. The spin of a needle about its own axis then depends on nothing else.
    With the angular momentum in space, an error of its tilt would be one of the spin, larger by the ratio of its
    inertias. In the body's axes ω turns no faster than the body, as no moment of inertia exceeds the sum of the other
    two.

    Parameters
    ----------
    quaternion : ndarray, shape (m, 4)
    turning : ndarray, shape (m, 3)
        ω in the axes of the bodies, rad/s.
    inertia : ndarray, shape (m, 3, 3)
        J in the axes of the bodies, kg m².
    time : ndarray, shape (m,)
        s.
    """
    out, left = quaternion.copy(), time.copy()
    w = np.where((time * np.linalg.norm(turning, axis=1) > FARTHEST)[:, None], np.nan, turning)  # fails every finding
    inverse = np.asarray(np.linalg.inv(inertia), dtype=float)
    while (some := np.flatnonzero(left > 0.0)).size:
        y = np.concatenate([out[some], w[some]], axis=1)
        speed = np.maximum(np.linalg.norm(w[some], axis=1), 1e-300)
        h = np.minimum(left[some], LEAP / speed)
        left[some] -= h
        y = _leapt(y, h, inertia[some], inverse[some])
        out[some], w[some] = y[:, :4] / np.linalg.norm(y[:, :4], axis=1)[:, None], y[:, 4:]
    return out, w


def _leapt(y: Array, h: Array, inertia: Array, inverse: Array) -> Array:
    """Advance y = (q, ω), shape (m, 7), by one step of h (m,), s, for `tumbled`."""
    rates = np.empty((len(STAGES) - 1, *y.shape))
    for k, shares in enumerate(STAGES):
        there = y + h[:, None] * np.tensordot(shares, rates[:k], 1) if k else y
        if k == len(rates):
            break
        q, w = there[:, :4], there[:, 4:]
        v, s = q[:, :3], q[:, 3:]
        rates[k, :, :3] = 0.5 * (s * w + cross(v, w))
        rates[k, :, 3] = -0.5 * (v * w).sum(axis=1)
        rates[k, :, 4:] = np.einsum("mij,mj->mi", inverse, cross(np.einsum("mij,mj->mi", inertia, w), w))
    return there
