"""Motion of an articulated tree without closed loops, to fourth order, in parts chosen by its error estimate."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.dynamics.values import Flow
from nsdyn.scene.gears import joint_at
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import integrate

TOLERANCE = 1e-9
"""Allowed error of the velocity in one part of a motion: this fraction of the velocity of the fastest joint, plus the
velocity that moves this fraction of a rad or of a metre in the time of the whole motion. A tree that turns by less in a
motion has negligible Coriolis terms."""

ROUNDED = 1e-13
"""rad or m: an error of the velocity is negligible if it moves a coordinate by less in the whole motion. It is hundreds
of roundings of an angle."""

TURN = 0.1
"""rad: no part turns by more. In longer parts, errors of slow joints would be negligible beside the velocity of a fast
one."""

SLOW = 1e-7
"""rad or m, and fraction of the velocity: if a tree moves by less in a part, and its velocity changes by less, a
constant acceleration gives the velocity to 1e-14."""

COARSER = 10.0
"""Factor by which each half of a step may err more if the forces of the step act at its middle. Such a step is of
second order: if a half errs by that much, the whole step errs by thousands of times as much."""

FINEST = 1e-5
"""Least part of a motion, as a fraction of it, so that the effort is bounded."""

Rate = Callable[[Array, Array], tuple[Array, float]]
"""(acceleration, power of driven joints in W) at a configuration and a velocity."""


def move(model: pin.Model, rate: Rate, q: Array, v: Array, h: float, turn: float, coarser: float = 1.0) -> Flow:
    """Motion for h s in parts by `runge_kutta`, each with an error below `TOLERANCE`, or `coarser` times that.

    The fastest joint turns at about the rate `turn`, rad/s. Raises ArithmeticError, which names the fastest joint, if
    no part is short enough for that error.
    """
    left = h
    part = longest = h / math.ceil(min(max(h * turn / TURN, 1.0), 1.0 / FINEST))
    mean, work = np.zeros(v.size), 0.0
    first = rate(q, v)
    while True:
        if part < FINEST * h:
            raise ArithmeticError(
                f"in {model.name!r} {fastest(model, v)}, too wildly to follow in {1 / FINEST:.0f} parts"
            )
        new, error = runge_kutta(model, rate, q, v, first, part, h)
        error /= coarser
        if error <= 1.0:
            if part == h:
                return new
            q, v, left = new.q, new.v, left - part
            mean += part / h * new.mean
            work += new.work
            if left <= 0.0:
                return Flow(q, v, mean, work)
            first = rate(q, v)
        part *= min(4.0, max(0.1, 0.9 * error**-0.2)) if 0.0 < error < np.inf else 0.1 if error else 4.0
        # Divide the rest into equal parts, so that no last part is much smaller than the others.
        part = left / math.ceil(left / min(part, longest) - 1e-9)


def fastest(model: pin.Model, v: Array) -> str:
    """Name of the fastest joint, or of the first whose velocity is not finite, and its speed."""
    j = int(np.abs(v).argmax())
    return f"joint {model.names[joint_at(model, j)]!r} moves at {abs(v[j]):.3g} rad/s or m/s"


def runge_kutta(
    model: pin.Model, rate: Rate, q: Array, v: Array, first: tuple[Array, float], h: float, whole: float
) -> tuple[Flow, float]:
    """One step of h s of the classical fourth-order Runge–Kutta method, and its error; first = rate(q, v).

    The last combination consists of two displacements, one after the other. The step is therefore of fourth order for
    free and spherical joints too. It changes energy and momentum by O(h⁵). The error is returned as a fraction of the
    error that `TOLERANCE` allows a part of a motion of `whole` seconds.

    The error is estimated from the same four stages. They contain the midpoint rule. For a vibration that turns by z in
    h, the midpoint rule differs from the step by z³/6, as a fraction of the velocity, while the step errs by z⁵/120.

    Shorter ways are taken where they suffice. If the first two stages show that even first order is exact enough, also
    for the work of driven joints, the midpoint rule is the step. For motions that are `SLOW`, the first-order step is.

    References
    ----------
    E. Celledoni, A. Marthinsen, B. Owren, Commutator-free Lie group methods, Future Generation Computer Systems 19,
    2003.
    """
    (a1, p1), x = first, np.empty((7, v.size))
    if _trees.outset(v, a1, h, SLOW, x):
        return Flow(integrate(model, q, x[3]), x[5], x[6], h * p1), 0.0
    q2 = integrate(model, q, x[3])
    a2, p2 = rate(q2, x[0])
    if p1 == p2 and _trees.midpoint(v, a1, a2, h, TOLERANCE, ROUNDED / whole, x):
        return Flow(integrate(model, q, x[3]), x[5], x[0], h * p2), 0.0
    _trees.stage(3, v, a2, h, x)
    a3, p3 = rate(integrate(model, q, x[3]), x[1])
    _trees.stage(4, v, a3, h, x)
    a4, p4 = rate(integrate(model, q2, x[3]), x[2])
    error = _trees.combine(v, (a1, a2, a3, a4), h, TOLERANCE, TOLERANCE / whole, x)
    work = h / 6.0 * (p1 + 2.0 * (p2 + p3) + p4)
    return Flow(integrate(model, integrate(model, q, x[3]), x[4]), x[5], x[6], work), error
