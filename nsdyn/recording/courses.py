"""How an articulation moves between impulses, by methods of an audit's own, and how far that is in doubt."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from nsdyn.recording.mechanism import RANK, Mechanism
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import displacement, integrate

__all__ = ["Course", "close", "move", "respond"]

TURN, PARTS = 0.1, 64
"""Most that a part of a motion turns, rad, and most parts that it is begun with."""

ROUNDING = 1e-9
"""Of a number of parts."""

FINE, DOUBLINGS, HALVINGS = 1e-11, 7, 12
"""Error by step doubling at which a motion is fine enough, as a fraction of the velocity, or of what joint forces by
themselves make of it, for where they carry a weight the velocity is round-off; most doublings to get there; and how
often a motion that needs more of them is halved, as light links are fast for a short time."""

CONSTANTS = 10.0
"""How many times more a rule may err than another of its order."""

TURNED = 0.04
"""rad: the most that a vibration turns in a part of a step, whose error, this to the fifth over 120, is 1e-9."""

SLOW = 1e-10
"""Motion, rad or m, in which v changes by so small a fraction that it may be taken as constant."""

PASSES = 50
"""Most passes of the fixed point of a motion on loops; it contracts by the angle of the step a pass."""

RESOLVED = 1e-4
"""Error, as a fraction of the velocity, up to which a motion on loops is surely made in one step."""

ROUND_OFF = 1e-14
"""Change by a pass, as a fraction of the velocity, below which there is nothing left but roundings."""


class Course(NamedTuple):
    """A motion without impulses.

    Attributes
    ----------
    q, v : ndarray, shapes (nq,), (nv,)
        Where it ends.
    mean : ndarray, shape (nv,)
        Mean velocity.
    doubted : ndarray, shape (2, nv)
        How far the displacement and v may differ by the rule of the step.
    work : float
        Of driven joints, J.
    """

    q: Array
    v: Array
    mean: Array
    doubted: Array
    work: float


def move(m: Mechanism, q: Array, v: Array, h: float, tau: Array | None = None, drive: Array | float = 0.0) -> Course:
    """Motion for h seconds without forces, or under gravity and constant joint forces tau; loops stay closed.

    Driven joints accelerate by `drive`; beside loops they keep their speed.
    """
    if tau is None and h * np.abs(v).max(initial=0.0) <= SLOW:
        return Course(np.array(integrate(m.model, q, h * v)), v, v, np.zeros((2, m.nv)), 0.0)
    if m.loops:
        return _slide(m, q, v, h)
    return _fly(m, q, v, h, tau, drive, HALVINGS)


def _fly(m: Mechanism, q: Array, v: Array, h: float, tau: Array | None, drive: Array | float, halvings: int) -> Course:
    """Without loops: in parts that are doubled, in halves where that many would not do."""
    # No more than the step may take, or less were in doubt than it errs: what is driven often turns by `TURN` itself.
    parts = min(PARTS, max(1, math.ceil(h * float(np.max(np.abs(v) * (m.turns > 0.0))) / TURN - ROUNDING)))
    speed = np.abs([v, v if tau is None else h * np.linalg.solve(m.mass(q), tau)]).max()
    coarse = _in_parts(m, q, v, h, tau, drive, parts)
    doubted, there = _doubt(coarse[4], float(np.abs(v).max()), parts), coarse[0]
    row = [np.concatenate([m.zero, *coarse[1:3], [coarse[3]]])]
    for k in reversed(range(DOUBLINGS)):
        parts *= 2
        fine = _in_parts(m, q, v, h, tau, drive, parts)
        change = np.abs([displacement(m.model, coarse[0], fine[0]), coarse[1] - fine[1]])
        if k == DOUBLINGS - 1:
            doubted = np.maximum(doubted, CONSTANTS * change)
        last, coarse = row[-1], fine
        row = _extrapolated(row, np.concatenate([displacement(m.model, there, fine[0]), *fine[1:3], [fine[3]]]))
        enough = FINE * max(speed, np.abs(fine[1]).max())
        if np.abs(row[-1] - last)[m.nv : 2 * m.nv].max() <= enough:
            break
        if halvings and np.isfinite(v).all() and not change[1].max() <= 16.0**k * enough:
            one = _fly(m, q, v, 0.5 * h, tau, drive, halvings - 1)
            two = _fly(m, one.q, one.v, 0.5 * h, tau, drive, halvings - 1)
            mean, doubted = 0.5 * (one.mean + two.mean), one.doubted + two.doubted
            return Course(two.q, two.v, mean, doubted, one.work + two.work)
    gone, new, mean, work = np.split(row[-1], [m.nv, 2 * m.nv, 3 * m.nv])
    return Course(np.array(integrate(m.model, there, gone)), new, mean, doubted, float(work[0]))


def _extrapolated(row: list[Array], last: Array) -> list[Array]:
    """Richardson's next row: what a rule with errors of the powers 4, 5, ... of its parts leads to in half of them."""
    out = [last]
    for power, coarse in enumerate(row, 4):
        out.append(out[-1] + (out[-1] - coarse) / (2.0**power - 1.0))
    return out


def _doubt(apart: Array, speed: float, parts: int) -> Array:
    """How far a rule of fourth order may lead elsewhere, from how far the midpoint rule does so in some parts.

    For a vibration that turns by z in a part they err by z⁵/120 and z³/6 of it. What is carried round errs by tens of
    times as much, and how two rules of fourth order do, says next to nothing of a third: that it is two orders better
    than the midpoint rule says all. Parts that would turn by more than `TURNED` are made of several.
    """
    z = np.cbrt(6.0 * float(apart[1].max(initial=0.0)) / (parts * max(speed, 1e-300)))
    out: Array = CONSTANTS * min(z, TURNED) ** 2 * min(1.0, TURNED / max(z, TURNED)) ** 2 * apart
    return out


def _in_parts(
    m: Mechanism, q: Array, v: Array, h: float, tau: Array | None, drive: Array | float, parts: int
) -> tuple[Array, Array, Array, float, Array]:
    """The classical method of Runge and Kutta, on the displacement in each part, v and the work of driven joints.

    Last, (2, nv), how far the midpoint rule leads elsewhere with the displacements and with v, summed over the parts.
    """
    model, force = (m.light, m.zero) if tau is None else (m.model, tau)
    mean, work, h, apart = np.zeros(m.nv), 0.0, h / parts, np.zeros((2, m.nv))

    def rate(x: Array, v: Array) -> tuple[Array, Array, float]:
        there, power = integrate(model, q, x), 0.0
        if m.driven.size:
            M, left = m.mass(there), force - np.array(pin.nonLinearEffects(model, m.data, there, v))
            a, free = np.zeros(m.nv), np.setdiff1d(np.arange(m.nv), m.driven)
            a[m.driven] = drive
            a[free] = np.linalg.solve(M[np.ix_(free, free)], left[free] - M[np.ix_(free, m.driven)] @ a[m.driven])
            power = float((M @ a - left)[m.driven] @ v[m.driven])
        else:
            a = pin.aba(model, m.data, there, v, force)
        return (v if m.flat else _in_chart(pin.dIntegrate(model, q, x, pin.ARG1), v)), a, power

    for _ in range(parts):
        x1, a1, p1 = rate(m.zero, v)
        v2 = v + 0.5 * h * a1
        x2, a2, p2 = rate(0.5 * h * x1, v2)
        v3 = v + 0.5 * h * a2
        x3, a3, p3 = rate(0.5 * h * x2, v3)
        v4 = v + h * a3
        x4, a4, p4 = rate(h * x3, v4)
        x, a = (x1 + 2.0 * (x2 + x3) + x4) / 6.0, (a1 + 2.0 * (a2 + a3) + a4) / 6.0
        apart += h * np.abs([x2 - x, a2 - a])
        q = integrate(model, q, h * x)
        mean += (v + 2.0 * (v2 + v3) + v4) / (6.0 * parts)
        work += h / 6.0 * (p1 + 2.0 * (p2 + p3) + p4)
        v = v + h * a
    return q, v, mean, work, apart


def _in_chart(turned: Array, v: Array) -> Array:
    """Rate of a displacement that moves with v; NaN after a whole turn, where there is none."""
    try:
        return np.asarray(np.linalg.solve(turned, v), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(v.size, np.nan)


def _slide(m: Mechanism, q: Array, v: Array, h: float) -> Course:
    """On loops and gears, driven joints keeping their speed: one midpoint step, by which that motion is defined.

    Doubted by two of half where it might be made in parts, and where joints are winding.
    """
    end, new, mean, work = _midpoint(m, q, v, h)
    there, half, _, _ = _midpoint(m, q, v, 0.5 * h)
    fine, last, _, _ = _midpoint(m, there, half, 0.5 * h)
    doubted = CONSTANTS * np.abs([displacement(m.model, end, fine), new - last])
    if not m.winding and doubted[1].max() <= CONSTANTS * RESOLVED * np.abs(v).max():
        doubted[:] = 0.0
    return Course(end, new, mean, doubted, work)


def _midpoint(m: Mechanism, q: Array, v: Array, h: float) -> tuple[Array, Array, Array, float]:
    """The implicit midpoint rule: M (v' - v) + h c = Bᵀ λ in the middle, B v' = b - (B' - B) v₁ with B' at the end.

    The end is where the same rule leads that is linear about v, whose velocity is v₁, and whose own end is that of v.
    c is of second degree: c(v + d) - c(d) is linear in d.
    """
    middle = close(m, integrate(m.model, q, 0.5 * h * v))
    M, B = m.mass(middle), m.constraints(middle)[1]

    def bias(v: Array) -> Array:
        return np.array(pin.nonLinearEffects(m.light, m.data, middle, v))

    new: Array = v
    for linear in (True, False):
        at_end = m.constraints(integrate(m.model, q, 0.5 * h * (v + new)))[1]
        goal = (B - at_end) @ new
        goal[len(B) - m.driven.size :] = v[m.driven]
        for _ in range(PASSES):
            change = 0.5 * (new - v)
            c = bias(v + change) - (bias(change) if linear else 0.0)
            new, last = respond(M, M @ v - h * c, B, goal), new
            if np.abs(new - last).max() <= ROUND_OFF * np.abs(v).max():
                break
    mean = 0.5 * (v + new)
    react = np.linalg.lstsq(B.T, M @ (new - v) + h * bias(mean), rcond=RANK)[0]
    work = float(react[len(B) - m.driven.size :] @ mean[m.driven])
    return close(m, integrate(m.model, q, h * mean)), new, mean, work


def respond(M: Array, momentum: Array, B: Array, goal: Array) -> Array:
    """v with M v = momentum + Bᵀ λ and B v = goal."""
    free, react = np.linalg.solve(M, momentum), np.linalg.solve(M, B.T)
    return np.asarray(free + react @ np.linalg.lstsq(B @ react, goal - B @ free, rcond=RANK)[0], dtype=float)


def close(m: Mechanism, q: Array) -> Array:
    """A configuration next to q whose loops are closed: Newton's method, closest in the kinetic metric."""
    for _ in range(PASSES if m.loops else 0):
        gap, B = m.constraints(q)
        if np.abs(gap).max() <= 1e-13:
            break
        react = np.linalg.solve(m.mass(q), B.T)
        miss = np.concatenate((gap, np.zeros(m.driven.size)))
        q = np.array(integrate(m.model, q, -react @ np.linalg.lstsq(B @ react, miss, rcond=RANK)[0]))
    return q
