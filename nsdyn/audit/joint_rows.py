"""Audit of loads on the joints of articulations: limits and their rebound, dry friction, actuators, given forces."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from nsdyn.audit.findings import CREEP, Finding, named, not_audited, worst_of
from nsdyn.audit.retraced import ON, Retraced
from nsdyn.recording.columns import ON_LINKS
from nsdyn.recording.mechanism import Mechanism
from nsdyn.recording.retrace import Kick
from nsdyn.tools.arrays import Array, Index

FINDINGS = "stops rebounds shared_rebounds joint_cone joint_slip loads wrenches pushes strength".split()

NOTHING = 1e-9
"""Fraction of the largest impulse or momentum of a step below which an impulse is zero."""

STICKS = 1e-5
"""rad/s or m/s: many times the slip of a sticking joint that solvers, and a motion computed anew, leave."""

SOLVED = 1e-6
"""rad/s or m/s: many times the residual velocity that solvers leave."""

Row = tuple[float, float, int, str]
"""(figure, amount, step, joint)."""


class Acted(NamedTuple):
    """A kick and the motion around it.

    Attributes
    ----------
    m : Mechanism
    step : int
    kick : Kick
    along : ndarray, shape (6, nv)
        Velocities: at the start of the piece, before and after the kick, at the end of the piece, and the two on which
        dry friction may act: the mean of before and after, and the predicted velocity at the end.
    end : ndarray, shape (nv,)
        Joint coordinates at the end of the piece, rad or m.
    rest : ndarray, shape (nv,)
        Speeds up to which joints rest at their limits: the change in two steps by the forces before the kick.
    most : float
        Largest impulse of the step, or momentum at its beginning, N·m·s.
    doubt : ndarray, shape (nv,)
        Uncertainty of the velocities before and after the kick.
    """

    m: Mechanism
    step: int
    kick: Kick
    along: Array
    end: Array
    rest: Array
    most: float
    doubt: Array


def on_joints(found: Retraced) -> Iterator[Finding]:
    """Findings on limits, dry friction, actuators and loads."""
    acted = list(_all(found))
    yield _worst("stops", [row for a in acted for row in _stops(a, found.trees.trajectory.dt)])
    yield from _rebounds(acted, found.trees.trajectory.columns["contacts/restitution"])
    rubs = [pair for a in acted for pair in _rubs(a, found.trees.trajectory.dt)]
    yield _worst("joint_cone", [bound for bound, _ in rubs])
    yield _worst("joint_slip", [slip for _, slip in rubs])
    yield from _loads(found)
    yield _pushes(found)
    yield _strength(found)


def _all(found: Retraced) -> Iterator[Acted]:
    for i, m in enumerate(found.trees.mechanisms):
        rest = np.full(m.nv, np.inf)  # at the start nothing has moved yet
        for k, way in enumerate(found.ways[i]):
            q, begin = found.trees.state(i, k)[:2]
            sizes = [m.mass(q) @ begin, *(kick.given[:4] for kick in way.kicks)]
            most = max(float(np.abs(size).max(initial=0.0)) for size in sizes)
            doubt = np.zeros(m.nv)
            for kick, first, last in zip(way.kicks, way.flows[::2], way.flows[1::2], strict=True):
                doubt = doubt + first.doubted[1]
                before, after = kick.before, kick.after
                along = np.array([begin, before, after, last.v, 0.5 * (before + after), after + before - begin])
                yield Acted(m, k + 1, kick, along, m.angle(last.q), rest, most, doubt)
                begin, doubt = last.v, doubt + last.doubted[1]
                if kick.h:
                    rest = SOLVED + 2.0 * found.trees.trajectory.dt * np.abs(kick.rate)


def _stops(a: Acted, dt: float) -> Iterator[Row]:
    """Distance of joints from the limits whose impulses act, beyond their motion; for impacts, on either side."""
    # A shallow gap closes by the next impulses, at most one step later.
    travel = 2.0 * dt * np.abs(a.along[:4]).max(axis=0)
    angle, m = a.m.angle(a.kick.q), a.m
    gaps = np.where(a.kick.given[1] > 0.0, angle - m.lower, m.upper - angle)
    width = np.where(np.isfinite(m.upper - m.lower), m.upper - m.lower, 1.0)
    for j in np.flatnonzero(np.abs(a.kick.given[1]) > NOTHING * a.most):
        away = gaps[j] - travel[j] if a.kick.h > 0.0 else abs(gaps[j])
        yield away / max(width[j], 1e-300), away, a.step, m.labels[j]


def _rebounds(acted: list[Acted], restitution: Array) -> Iterator[Finding]:
    """Check v⁺ = -e v⁻ for limits that strike alone and instantaneously.

    Other limits may strike several times, or together with unknown impulses. If nothing rebounds, the velocity that a
    limit gives back is at most the change by forces and turning constraint rows, unless the limit holds the joint.
    """
    rows: list[Row] = []
    shared = 0
    for a in acted:
        e, kick = a.m.restitution, a.kick
        struck = np.flatnonzero(np.abs(kick.given[1]) > NOTHING * a.most)
        plain = e == 0.0 and not any(restitution[row] > 0.0 for row, _, _ in kick.touches)
        if not plain and (kick.h or struck.size != 1 or kick.pushed.any()):
            shared += struck.size
            continue
        for j in struck:
            off = abs(kick.after[j] + e * kick.before[j])
            if kick.h:
                sign = np.sign(kick.given[1, j])
                off = sign * kick.after[j] - abs(kick.before[j] - a.along[0, j])
                # A joint on its limit at the end of the piece has not rebounded.
                parted = sign * (a.end[j] - (a.m.lower[j] if sign > 0.0 else a.m.upper[j]))
                off = min(off, max(parted - ON, 0.0) / kick.h)
            elif abs(kick.before[j]) <= a.rest[j]:
                off = min(off, abs(kick.after[j]))
            off -= (1.0 + e) * a.doubt[j]
            rows.append((off / max(float(np.abs(a.along[:4]).max()), CREEP), off, a.step, a.m.labels[j]))
    yield _worst("rebounds", rows)
    if shared:
        reason = f"{shared} limits rebound together, or in a move, as often as is not recorded"
        yield not_audited("shared_rebounds", reason)
    else:
        yield _worst("shared_rebounds", [])


def _rubs(a: Acted, dt: float) -> Iterator[tuple[Row, Row]]:
    """Excess of dry friction over its bound, and deficit of its opposition to the motion, relative to those of a step.

    A piece may be so short that all its friction is less than the residual of an impulse.
    """
    drag, most_drag = a.kick.given[2], a.kick.h * a.m.friction
    some = (a.m.friction > 0.0) | (drag != 0.0)
    for on in a.m.rubbing:
        if not some[on].any():
            continue
        j, pull, speeds = on[0], drag[on], a.along[:, on]
        least, most = most_drag[on].min(), most_drag[on].max()
        over = float(np.linalg.norm(pull)) - least
        bound = over / max(least, NOTHING * a.most, 1e-300), over, a.step, a.m.labels[j]
        # In a piece whose velocity changes sign, any friction may oppose the motion.
        speed = np.linalg.norm(speeds, axis=1)
        # A sticking joint may have any friction within the bound.
        wasted = float(np.where(speed > STICKS, most * speed + speeds @ pull, 0.0).min())
        # The drive of a joint takes up its friction, which then does not affect the motion.
        turns = j in a.m.driven or bool(((speeds.min(axis=0) <= 0.0) & (speeds.max(axis=0) >= 0.0)).all())
        largest = dt * a.m.friction[on].max() * (float(speed.max()) + CREEP)
        figure = 0.0 if turns else wasted / max(largest, 1e-300)
        yield bound, (figure, wasted, a.step, a.m.labels[j])


def _worst(name: str, rows: list[Row]) -> Finding:
    figure, amount, step = np.array([row[:3] for row in rows]).reshape(-1, 3).T
    return worst_of(name, figure, amount, step.astype(int), lambda k: [rows[k][3]])


def _acted(found: Retraced, name: str) -> tuple[Array, Index]:
    """Recorded values of all steps and all pieces, (rows, nv), and the step of each row."""
    t, c = found.trees.trajectory, found.trees.trajectory.columns
    step = np.concatenate([np.arange(t.steps), np.repeat(np.arange(t.steps), np.diff(c["pieces/offset"]))])
    return np.concatenate([c[f"joints/{name}"], c[f"pieces/{name}"]]), step + 1


def _pushes(found: Retraced) -> Finding:
    """Effect of external wrenches on the coordinates, for steps of one move; wrenches of pieces are not recorded."""
    c, rows, first = found.trees.trajectory.columns, list[Row](), 0
    for m, ways in zip(found.trees.mechanisms, found.ways, strict=True):
        links = m.model.njoints - 1
        for k, way in enumerate(ways if ON_LINKS in c else ()):
            if len(way.kicks) != 1:
                continue
            (kick,) = way.kicks
            m.place(kick.q)
            wrenches = c[ON_LINKS][k, first : first + links]
            scale = max(float(np.abs(kick.given[3]).max()), float(np.abs(wrenches).max()), 1e-300)
            # Levers are as uncertain as configurations.
            doubt = scale * sum(float(course.doubted[0].sum()) for course in way.flows)
            off = np.abs(m.pushed(wrenches) - kick.given[3]) - doubt
            j = int(off.argmax())
            rows.append((off[j] / scale, off[j], k + 1, m.labels[j]))
        first += links
    return _worst("pushes", rows)


def _strength(found: Retraced) -> Finding:
    """Check that no impulse of an actuator exceeds its limit times the time in which it acts."""
    (given, step), (most, _) = _acted(found, "actuation"), _acted(found, "strength")
    labels = [label for m in found.trees.mechanisms for label in m.labels]
    k, j = np.nonzero(~np.isinf(most))
    over = np.abs(given[k, j]) - most[k, j]
    figure = over / np.maximum(most[k, j], 1e-300)
    return worst_of("strength", figure, over, step[k], named(labels, j))


def _loads(found: Retraced) -> Iterator[Finding]:
    """Check for joint forces without a controller, and for external wrenches without a function that gives them."""
    labels = [label for m in found.trees.mechanisms for label in m.labels]
    for name, column, given, what in (
        ("loads", "actuation", "controller", "the controller's law and limits"),
        ("wrenches", "external", "external_force", "external forces"),
    ):
        if found.trees.trajectory.meta[given]:
            yield not_audited(name, f"{what} are not recorded")
            continue
        amount, step = _acted(found, column)
        largest = np.abs(amount).max(axis=1, initial=0.0)
        figure = largest / max(float(largest.max(initial=0.0)), 1e-300)
        who = np.abs(amount).argmax(axis=1) if amount.size else step
        yield worst_of(name, figure, largest, step, named(labels, who))
