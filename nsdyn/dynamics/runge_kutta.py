"""Motion of an articulated tree without closed loops, to fourth order, in parts as its own error asks for."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.dynamics.values import Flow
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import integrate

__all__ = ["COARSER", "TOLERANCE", "Rate", "fastest", "move", "runge_kutta"]

TOLERANCE = 1e-9
"""Error of one part of a motion: of the velocity, as a fraction of the fastest joint's, and as what moves that fraction
of a rad or of a metre in the time of the whole. What turns by less in it has no Coriolis terms to speak of."""

ROUNDED = 1e-13
"""rad or m: what an error of the velocity moves in the whole motion is lost then, hundreds of roundings of an angle."""

TURN = 0.1
"""rad: no part turns by more, since beside what spins fast the error of what moves slowly would count for nothing."""

SLOW = 1e-7
"""rad or m, and fraction of the velocity: of what moves and changes by less in a part, an acceleration that is constant
tells the velocity to 1e-14."""

COARSER = 10.0
"""How much more a half of a motion may err whose forces act in its middle: that is of second order, and where a half
errs by so much, the whole errs by thousands of times as much."""

FINEST = 1e-5
"""Least part of a motion, so that the effort is bounded."""

Rate = Callable[[Array, Array], tuple[Array, float]]
"""(acceleration, power of driven joints in W) at a configuration and a velocity."""


def move(model: pin.Model, rate: Rate, q: Array, v: Array, h: float, turn: float, coarser: float = 1.0) -> Flow:
    """Motion for h s in parts of `runge_kutta`, which err by less than `TOLERANCE`, or `coarser` times as much.

    The fastest joint turns at about the rate `turn`, rad/s. ArithmeticError, naming it, where no part is so exact.
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
        # What is left goes in equal parts, none much smaller than the others.
        part = left / math.ceil(left / min(part, longest) - 1e-9)


def fastest(model: pin.Model, v: Array) -> str:
    """The joint that is fastest, or first not finite, and its speed."""
    j = int(np.abs(v).argmax())
    name = next(n for n, joint in zip(model.names, model.joints, strict=True) if 0 <= j - joint.idx_v < joint.nv)
    return f"joint {name!r} moves at {abs(v[j]):.3g} rad/s or m/s"


def runge_kutta(
    model: pin.Model, rate: Rate, q: Array, v: Array, first: tuple[Array, float], h: float, whole: float
) -> tuple[Flow, float]:
    """One step of h s of the classical Runge–Kutta method of fourth order, and its error; first = rate(q, v).

    Its last combination is made of two displacements one after the other, so that it is of that order for free and
    spherical joints too. What it changes of energy and momentum is O(h⁵). The error is a fraction of what `TOLERANCE`
    allows a part of a motion of `whole` seconds. It is estimated from the same four stages: they hold the midpoint
    rule, whose difference from the step, as a fraction of the velocity, is z³/6 for a vibration that turns by z in h,
    where the step errs by z⁵/120. Where the first two stages say that even the first order would do, also for the work
    of driven joints, they are all, and the midpoint rule is the step; of what is `SLOW`, the first order is.

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
