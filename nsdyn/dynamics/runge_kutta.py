"""Motion of an articulated tree without constraints, to fourth order."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.dynamics.tree_values import Flow
from nsdyn.tools.arrays import Array

__all__ = ["runge_kutta", "unconstrained"]

TURN, PARTS = 0.1, 100
"""Angle in rad that a part of a step turns at most, which leaves 1e-7 of the motion, and the most parts."""


def unconstrained(model: pin.Model, data: pin.Data, q: Array, v: Array, h: float, tau: Array, turn: float) -> Flow:
    """Motion for h seconds under constant joint forces tau and the gravity of the model, at rates up to `turn` rad/s.

    Parts of `runge_kutta`, so many that each turns by little.
    """
    parts = min(1 + int(h * turn / TURN), PARTS)
    if parts == 1:
        return runge_kutta(model, data, q, v, h, tau)
    mean = np.zeros_like(v)
    for _ in range(parts):
        q, v, part, _ = runge_kutta(model, data, q, v, h / parts, tau)
        mean += part / parts
    return Flow(q, v, mean, 0.0)


def runge_kutta(model: pin.Model, data: pin.Data, q: Array, v: Array, h: float, tau: Array) -> Flow:
    """One step of the classical Runge–Kutta method of fourth order, of h seconds.

    Its last combination is made of two displacements one after the other, so that it is of that order for free and
    spherical joints too. What it changes of energy and momentum is O(h⁵).

    References
    ----------
    E. Celledoni, A. Marthinsen, B. Owren, Commutator-free Lie group methods, Future Generation Computer Systems 19,
    2003.
    """
    half = 0.5 * h
    a1 = pin.aba(model, data, q, v, tau)
    v2, q2 = v + half * a1, pin.integrate(model, q, half * v)
    a2 = pin.aba(model, data, q2, v2, tau)
    v3, q3 = v + half * a2, pin.integrate(model, q, half * v2)
    a3 = pin.aba(model, data, q3, v3, tau)
    v4, q4 = v + h * a3, pin.integrate(model, q2, h * v3 - half * v)
    a4 = pin.aba(model, data, q4, v4, tau)
    out = np.empty((4, v.size))
    _trees.combine(v, v2, v3, v4, a1, a2, a3, a4, h, out)
    return Flow(pin.integrate(model, pin.integrate(model, q, out[0]), out[1]), out[2], out[3], 0.0)
