"""Motion of an articulation between impulses, by methods independent of the step, with its error estimate.

The audit compares a recorded motion with this one. `doubted` bounds the difference that the time integration of the
step may explain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import root

from nsdyn.recording.mechanism import RANK, Mechanism
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import displacement, integrate

TURN, PARTS = 0.1, 64
"""Largest angle by which a joint turns in a part of a motion, rad, and largest initial number of parts."""

ROUNDING = 1e-9
"""Tolerance for round-off of a number of parts."""

FINE, DOUBLINGS, HALVINGS = 1e-11, 7, 12
"""Error by step doubling at which a motion is fine enough, as a fraction of the velocity, or of the velocity that joint
forces alone would cause (if they carry a weight, the velocity itself is round-off); largest number of doublings; and
how often a motion that needs more doublings is halved, since light links may be fast for a short time."""

CONSTANTS = 10.0
"""Factor by which the error of one rule may exceed that of another rule of the same order."""

TURNED = 0.04
"""Largest angle of a vibration in a part of a step, rad; the error, TURNED⁵/120, is then 1e-9."""

SLOW = 1e-10
"""Displacement, rad or m, during which v changes so little that it may be taken as constant."""

PASSES = 50
"""Largest number of fixed-point passes for a motion on loops; a pass contracts the error by the angle of the step."""

RESOLVED = 1e-4
"""Error, as a fraction of the velocity, up to which the step certainly makes a motion on loops in one part."""

CLOSED = 1e-12
"""Gap to which the step closes loops, m and rad."""

ROUND_OFF = 1e-14
"""Change in a pass, as a fraction of the velocity, below which only round-off remains."""


class Course(NamedTuple):
    """A motion without impulses.

    Attributes
    ----------
    q, v : ndarray, shapes (nq,), (nv,)
        Configuration and velocity at the end.
    mean : ndarray, shape (nv,)
        Mean velocity.
    doubted : ndarray, shape (2, nv)
        By how much the displacement and v of the step's own integration rule may differ from this motion.
    work : float
        Work of driven joints, J.
    """

    q: Array
    v: Array
    mean: Array
    doubted: Array
    work: float


def move(m: Mechanism, q: Array, v: Array, h: float, tau: Array | None = None, drive: Array | float = 0.0) -> Course:
    """Return the motion for h seconds without forces, or under gravity and constant joint forces tau.

    Loops stay closed. Driven joints have the acceleration `drive`; in a mechanism with loops they keep their speed.
    """
    if tau is None and h * np.abs(v).max(initial=0.0) <= SLOW:
        return Course(np.array(integrate(m.model, q, h * v)), v, v, np.zeros((2, m.nv)), 0.0)
    if m.loops:
        return _slide(m, q, v, h)
    return _fly(m, q, v, h, tau, drive, HALVINGS)


def _fly(m: Mechanism, q: Array, v: Array, h: float, tau: Array | None, drive: Array | float, halvings: int) -> Course:
    """Return the motion of a mechanism without loops.

    The number of parts is doubled until the motion is fine enough. If `DOUBLINGS` would not suffice, the motion is
    computed in two halves.
    """
    # At most as many parts as the step may take: with more, the doubt would be less than the error of the step. Driven
    # joints often turn by exactly `TURN`.
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
    """Return the next row of Richardson's table, for a rule with errors of powers 4, 5, ... and parts half as long."""
    out = [last]
    for power, coarse in enumerate(row, 4):
        out.append(out[-1] + (out[-1] - coarse) / (2.0**power - 1.0))
    return out


def _doubt(apart: Array, speed: float, parts: int) -> Array:
    """Return the possible error of a rule of fourth order, from the error `apart` of the midpoint rule in some parts.

    For a vibration that turns by z in a part, the two rules err by z⁵/120 and z³/6 of it. Errors of links that are
    carried round are tens of times as large. The difference of two rules of fourth order says almost nothing about a
    third one. The estimate therefore only uses that the rule is two orders better than the midpoint rule. Parts that
    would turn by more than `TURNED` are made of several.
    """
    z = np.cbrt(6.0 * float(apart[1].max(initial=0.0)) / (parts * max(speed, 1e-300)))
    return CONSTANTS * min(z, TURNED) ** 2 * min(1.0, TURNED / max(z, TURNED)) ** 2 * apart


def _in_parts(
    m: Mechanism, q: Array, v: Array, h: float, tau: Array | None, drive: Array | float, parts: int
) -> tuple[Array, Array, Array, float, Array]:
    """Return (q, v, mean velocity, work of driven joints, errors of the midpoint rule) by the classical Runge-Kutta.

    The method integrates the displacement in each part, v and the work. The errors, (2, nv), are the differences
    between the midpoint rule and this method in displacement and v, summed over the parts.
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
    """Return the rate of a displacement at velocity v; NaN after a whole turn, where the rate does not exist."""
    try:
        return np.asarray(np.linalg.solve(turned, v), dtype=float)
    except np.linalg.LinAlgError:
        return np.full(v.size, np.nan)


def _slide(m: Mechanism, q: Array, v: Array, h: float) -> Course:
    """Return the motion of a mechanism with loops or gears: one midpoint step, which defines this motion.

    Driven joints keep their speed. The doubt is what the gaps of loops leave open. The difference from two steps of
    half the length is added if the step might have made the motion in parts or if joints are winding
    (`Mechanism.winding`).
    """
    end, new, mean, work = _midpoint(m, q, v, h)
    there, half, _, _ = _midpoint(m, q, v, 0.5 * h)
    fine, last, _, _ = _midpoint(m, there, half, 0.5 * h)
    doubted = CONSTANTS * np.abs([displacement(m.model, end, fine), new - last])
    if not m.winding and doubted[1].max() <= CONSTANTS * RESOLVED * np.abs(v).max():
        doubted[:] = 0.0
    doubted[1] += CONSTANTS * _loose(m, end, new)
    if m.floats:  # a shift and a twist of the base alone put its centre of mass and its momenta right
        way = pin.centerOfMass(m.model, m.data, q, v).copy() + h * m.data.vcom[0]
        way -= pin.centerOfMass(m.model, m.data, end)
        end = end.copy()
        end[:3] += m.model.jointPlacements[1].rotation.T @ way
        new = m.kept(q, v, end, new)
    return Course(end, new, mean, doubted, work)


def _loose(m: Mechanism, q: Array, v: Array) -> Array:
    """Return by how much v may change where loops are open by `CLOSED`: much near singular configurations."""
    B, F = m.constraints(q)[1], np.linalg.inv(np.linalg.cholesky(m.mass(q)))
    _, s, Vt = np.linalg.svd(B @ F.T)
    k = int((s**2 > RANK * s[0] ** 2).sum()) - 1
    away = m.constraints(integrate(m.model, q, CLOSED / s[k] * Vt[k] @ F))[1]
    return np.asarray(np.abs(respond(m.mass(q), m.zero, B, (B - away) @ v)))


def _midpoint(m: Mechanism, q: Array, v: Array, h: float) -> tuple[Array, Array, Array, float]:
    """Solve the implicit midpoint rule, M (v' - v) + h c = Bᵀ λ at the middle and B v' = b - (B' - B) v₁.

    B' is B at the end of the motion. This end, and the velocity v₁, come from a first solve of the same rule, linear
    about v, which uses the end of a motion at constant v. c is of second degree: c(v + d) - c(d) is linear in d.
    Return (q, v', mean velocity, work of driven joints).
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

        def again(new: Array, linear: bool = linear, goal: Array = goal) -> Array:
            change = 0.5 * (new - v)
            c = bias(v + change) - (bias(change) if linear else 0.0)
            return respond(M, M @ v - h * c, B, goal)

        begun, moved = new, np.inf
        for _ in range(PASSES):
            new, last, before = again(new), new, moved
            moved = np.abs(new - last).max()
            if moved <= ROUND_OFF * np.abs(v).max():
                break
            if not moved <= before:  # passes do not contract where light links are fast
                new = root(lambda x: again(x) - x, begun, tol=ROUND_OFF).x
                break
    mean = 0.5 * (v + new)
    react = np.linalg.lstsq(B.T, M @ (new - v) + h * bias(mean), rcond=RANK)[0]
    work = float(react[len(B) - m.driven.size :] @ mean[m.driven])
    return close(m, integrate(m.model, q, h * mean)), new, mean, work


def respond(M: Array, momentum: Array, B: Array, goal: Array) -> Array:
    """Return v with M v = momentum + Bᵀ λ and B v = goal."""
    free, react = np.linalg.solve(M, momentum), np.linalg.solve(M, B.T)
    return np.asarray(free + react @ np.linalg.lstsq(B @ react, goal - B @ free, rcond=RANK)[0], dtype=float)


def close(m: Mechanism, q: Array) -> Array:
    """Return the closest configuration to q, in the kinetic metric, with closed loops, by Newton's method."""
    for _ in range(PASSES if m.loops else 0):
        gap, B = m.constraints(q)
        react = np.linalg.solve(m.mass(q), B.T)
        miss = np.concatenate((gap, np.zeros(m.driven.size)))
        q = np.array(integrate(m.model, q, -react @ np.linalg.lstsq(B @ react, miss, rcond=RANK)[0]))
        if np.abs(gap).max() <= 1e-13:  # the step just made leaves round-off, even beside what moves by 1e-6 of a rad
            break
    return q
