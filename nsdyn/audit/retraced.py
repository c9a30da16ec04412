"""Follow all articulations of a recording through all steps anew: deviations of the motion, and works of joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from nsdyn.audit.meetings import Side
from nsdyn.audit.poses import Poses
from nsdyn.dynamics.ledger import PHYSICS
from nsdyn.recording.courses import close
from nsdyn.recording.mechanism import Mechanism
from nsdyn.recording.retrace import Kick, Trees, Way, trees
from nsdyn.recording.tables import left_out
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.displacements import displacement

COARSE = 1e-3
"""Largest error of the fourth-order flow of a step, as a fraction of the motion; larger: no motion of this tree."""

SMALL = 1e-6
"""Displacement, rad or m, of which round-off is a fraction of 1e-9."""

ON = 1e-8
"""rad or m: many times the gap of a limit on which a joint rests."""


@dataclass(frozen=True, eq=False)
class Retraced:
    """Retraced motion: all steps of all articulations, followed anew; arrays (n, trees) unless stated.

    Attributes
    ----------
    trees : Trees
    momentum, motion, lift : ndarray, shape (2, n, trees)
        Distance of recorded velocities and configurations from those to which the impulses lead, and displacement by
        projections, in the norm of the mass matrix; then the reference of each.
    works : dict of str to ndarray
        Works by columns of the ledger, J.
    doubt, parted : ndarray
        Uncertainty of works, J: of each and of their sum (`doubt`), and of the split of the sum where limits and
        contacts strike alternately in one instant, an unrecorded number of times (`parted`).
    resting : ndarray
        Largest work, J, of limits on which joints rest where a move begins: it may count as numerics.
    energy : ndarray, shape (n,)
        Change of energy by projections, J.
    met : (Side, Side)
        Links at contacts with an impulse, as first and as second bodies; NaN for other bodies.
    met_doubt : ndarray, shape (contacts,)
        Uncertainty of the works of contacts, J.
    met_unsure : ndarray, shape (contacts,)
        Uncertainty of the velocities of links at contacts with an impulse, m/s.
    met_parted : ndarray of bool, shape (contacts,)
        Contacts that strike alternately with limits, in an instant or in a move, or strike before the forces of a move
        that damp their rebound.
    met_twice : ndarray, shape (contacts,)
        Upper bound of the work of rebound impulses within moves, J; 0 for other contacts. Other impulses within these
        moves are booked as numerics.
    ways : list of list of Way
        Course of every tree in every step.
    """

    trees: Trees
    momentum: Array
    motion: Array
    lift: Array
    works: dict[str, Array]
    doubt: Array
    parted: Array
    resting: Array
    energy: Array
    met: tuple[Side, Side]
    met_doubt: Array
    met_unsure: Array
    met_parted: Bools
    met_twice: Array
    ways: list[list[Way]]


def retraced(poses: Poses) -> Retraced | str:
    """Follow all articulations through all steps; return the reason if that is not possible."""
    found, t = trees(poses.trajectory), poses.trajectory
    if isinstance(found, str) or (reason := left_out(t)):
        return found if isinstance(found, str) else reason
    n, count, rows = t.steps, len(found.mechanisms), len(t.columns["contacts/geom1"])
    momentum, motion, lift = np.zeros((3, 2, n, count))
    doubt, parted, resting = np.zeros((3, n, count))
    works = {name: np.zeros((n, count)) for name in PHYSICS}
    of_trees = found, momentum, motion, lift, works, doubt, parted, resting, np.zeros(n)
    met, met_parted = (Side.nowhere(rows), Side.nowhere(rows)), np.zeros(rows, np.bool_)
    met_doubt, met_unsure, met_twice = np.zeros((3, rows))
    out = Retraced(*of_trees, met, met_doubt, met_unsure, met_parted, met_twice, [[] for _ in range(count)])
    for i, m in enumerate(found.mechanisms):
        for k in range(n):
            try:
                way = found.way(i, k)
                _compare(out, i, m, k, way)
                begin = found.state(i, k)
                for kick, doubted, last in zip(way.kicks, _book(out, i, m, k, way), way.flows[1::2], strict=True):
                    _meet(out, m, kick, doubted, begin)
                    begin = m.lifted(last.q, last.v, kick.shift)
            except (np.linalg.LinAlgError, ValueError):  # values that are no numbers, or masses that no body can have
                way, out.momentum[0][k, i] = Way([], [], *found.state(i, k + 1)), np.nan
            out.ways[i].append(way)
    return out


def _compare(out: Retraced, i: int, m: Mechanism, k: int, way: Way) -> None:
    """Compare the recorded end of a step with the retraced one."""
    (_, v0), (q, v) = out.trees.state(i, k), out.trees.state(i, k + 1)
    h, M = out.trees.trajectory.dt, m.mass(q)
    L = np.linalg.cholesky(M)

    def size(x: Array) -> float:
        return float(np.linalg.norm(L.T @ x))

    def effect(p: Array) -> float:
        return float(np.linalg.norm(np.linalg.solve(L, p)))

    speed = size(v0) + size(way.v)
    speed += sum(
        effect(part)
        for kick in way.kicks
        for part in (*kick.given, kick.pushed, *kick.stiff, kick.h * m.weight(kick.q))
    )
    doubt = np.array([[size(row) for row in course.doubted] for course in way.flows]).sum(axis=0)
    doubt = doubt if m.loops else np.minimum(doubt, COARSE * speed * np.array([h, 1.0]))
    # If the weights of a hanging body cancel, the round-off of each remains.
    rounded = 4.0 * np.finfo(float).eps * h * m.falling
    span = h * speed + SMALL * float(np.sqrt(np.trace(M)))
    # Remaining gaps of loops have a finding of their own. What rests keeps the gaps that it has.
    off = size(displacement(m.model, close(m, way.q), close(m, q)))
    for pair, amount, scale in (
        (out.momentum, size(way.v - v) - doubt[1] - rounded, speed),
        (out.motion, off - doubt[0] - h * doubt[1], span),
        (out.lift, sum(size(kick.shift) for kick in way.kicks), span),
    ):
        pair[:, k, i] = amount, scale


def _book(out: Retraced, i: int, m: Mechanism, k: int, way: Way) -> list[Array]:
    """Book the works of a step by columns of the ledger, with uncertainty; return that of velocities at each kick."""
    works, doubt, late, astray = dict.fromkeys(out.works, 0.0), 0.0, np.zeros(m.nv), np.full(m.nv, ON)
    each: list[Array] = []
    begun, end, alone = out.trees.state(i, k)[0], out.trees.state(i, k + 1)[0], len(way.kicks) == 1
    for kick, first, last in zip(way.kicks, way.flows[::2], way.flows[1::2], strict=True):
        mean = along = 0.5 * (kick.before + kick.after)
        damped = 0.5 * (kick.struck + kick.after)
        late = late + first.doubted[1]
        each.append(late)
        doubted = late
        if kick.mean is not None:
            # In a step of one piece, constant forces act along the recorded displacement, which includes their effect.
            along = kick.mean + (displacement(m.model, way.q, end) / kick.h if alone else 0.0)
            doubted = late if alone else late + last.doubted[0] / kick.h
        works["external"] += float((kick.given[0] + kick.given[3]) @ along)
        works["normal"] += float(kick.given[1] @ mean)
        works["friction"] += float(kick.given[2] @ mean)
        works["damping"] += float(kick.stiff[0] @ damped)
        works["constraint"] += first.work + last.work
        if m.driven.size:  # the work of drives in a flow is its change of energy, as uncertain as its velocities
            doubt += sum(float(np.abs(m.mass(flow.q) @ flow.v) @ flow.doubted[1]) for flow in (first, last))
        if kick.mean is None:
            works["constraint"] += float(kick.reaction @ mean)
        change = np.abs(kick.struck - kick.before) + np.abs(kick.after - kick.struck)
        # Rebounds in a piece, or several in one instant, have parts of work that are not recorded. If only limits
        # strike in an instant, their parts form one work.
        on_joints = np.abs(kick.given[1]) + np.abs(kick.given[2])
        if kick.h == 0.0 and _parted(out.trees, m, kick):
            out.parted[k, i] += 2.0 * float(on_joints @ _fastest(m, kick, np.eye(m.nv)))
        elif (kick.h > 0.0 or kick.given[2].any()) and (m.restitution > 0.0 or _rebounds(out.trees, kick)):
            doubt += 0.5 * float(on_joints @ change)
        acted = np.abs(kick.given[:4]).sum(axis=0) + 2.0 * np.abs(kick.stiff[0]) + np.abs(kick.reaction)
        doubt += float(acted @ doubted)  # for dampers twice: impulse and displacement are as uncertain as velocities
        late = late + last.doubted[1]
        lifted = m.lifted(last.q, last.v, kick.shift) if kick.shift.any() else (last.q, last.v)
        if kick.shift.any():
            out.energy[k] += sum(m.energies(*lifted)) - sum(m.energies(last.q, last.v))
        if kick.h > 0.0:
            bound = np.where(kick.given[1] > 0.0, m.lower, m.upper)
            rests = np.abs(m.angle(begun) - bound) <= astray
            out.resting[k, i] += float(np.abs(kick.given[1] * mean) @ rests)
        begun, astray = lifted[0], astray + first.doubted[0] + last.doubted[0] + kick.h * late
    for name, work in works.items():
        out.works[name][k, i] = work
    out.doubt[k, i] = doubt
    return each


def _rebounds(found: Trees, kick: Kick) -> bool:
    restitution = found.trajectory.columns["contacts/restitution"]
    return any(restitution[row] > 0.0 for row, _, _ in kick.touches)


def _parted(found: Trees, m: Mechanism, kick: Kick) -> bool:
    """Whether limits and contacts strike alternately, and some of them rebound."""
    return bool(kick.touches and kick.given[1:3].any()) and (m.restitution > 0.0 or _rebounds(found, kick))


def _fastest(m: Mechanism, kick: Kick, rows: Array) -> Array:
    """Largest speeds along rows (k, nv) between impacts, as if from all kinetic energy before or after."""
    M = m.mass(kick.q)
    most = max(float(v @ M @ v) for v in (kick.before, kick.after))
    return np.sqrt(most * (rows.T * np.linalg.solve(M, rows.T)).sum(axis=0))


def _meet(out: Retraced, m: Mechanism, kick: Kick, doubted: Array, begin: tuple[Array, Array]) -> None:
    """Store poses and velocities of links at contacts with an impulse; velocities (nv,) are uncertain by `doubted`.

    The piece begins in the state (q, v) = `begin`.
    """
    if not kick.touches:
        return
    c = out.trees.trajectory.columns
    point, restitution = c["contacts/point"], c["contacts/restitution"]
    struck = bool((kick.struck != kick.before).any())
    m.place(begin[0])
    first = {joint: m.pose(joint) for _, _, joint in kick.touches}
    m.place(kick.q)
    poses, parted = {joint: m.pose(joint) for joint in first}, _parted(out.trees, m, kick)
    for row, side, joint in kick.touches:
        pose, met = poses[joint], out.met[side]
        met.x[row], met.quaternion[row] = pose.translation, Rotation.from_matrix(pose.rotation).as_quat()
        met.back[row] = Rotation.from_matrix(first[joint].rotation @ pose.rotation.T).as_quat()
        for k, v in enumerate((kick.before, kick.after)):
            met.v[k + 1, row], met.spin[k, row] = m.carried(joint, point[row], v)
        push = m.push(joint, point[row], out.trees.impulses[row])
        out.met_doubt[row] += float(np.abs(push) @ doubted)
        if parted or doubted.any():
            rows = np.array([m.push(joint, point[row], axis) for axis in np.eye(3)])
            out.met_unsure[row] += float(np.linalg.norm(np.abs(rows) @ doubted))
        if parted:
            speed, rubs = float(np.linalg.norm(_fastest(m, kick, rows))), 1.0 + c["contacts/mu"][row]
            out.met_parted[row] = True
            out.met_doubt[row] += 2.0 * rubs * speed * float(np.linalg.norm(out.trees.impulses[row]))
        out.met_parted[row] |= struck
        if kick.h and (restitution[row] > 0.0 or parted):
            out.met_twice[row] += max(abs(float(push @ v)) for v in (kick.before, kick.struck, kick.after))
    m.place(begin[0])
    for row, side, joint in kick.touches:
        there = first[joint].act(poses[joint].actInv(point[row]))
        out.met[side].v[0, row] = m.carried(joint, there, begin[1])[0]
