"""Control of the joints of trees: read the return value of a controller, and handle actuators at their limits."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn.dynamics.values import FreeMotion, TreeLoads
from nsdyn.scene.actuation import Actuation, Actuator
from nsdyn.scene.control import PD, Axes
from nsdyn.tools.arrays import Array, Bools, floats


class Control(NamedTuple):
    """Control law of the joints of one tree, made from the return value of a controller.

    Attributes
    ----------
    law : ndarray, shape (5, nv)
        Rows kp, kd, target, constant and limit. The constant is the feedforward plus kd times the target's velocity.
    limited : bool
        True if any coordinate has a finite limit.
    implicit : bool
        True if the control depends on the motion of the step, that is, if any gain is positive.
    """

    law: Array
    limited: bool
    implicit: bool

    @classmethod
    def none(cls, nv: int) -> Control:
        """Return the control law of a tree that is not controlled."""
        law = np.zeros((5, nv))
        law[4] = np.inf
        return cls(law, False, False)


LARGEST = np.finfo(float).max

UNMOVED = 1e-9
"""Threshold on the implicit damping of a control times the mobility of its joint. Below it the motion of the step
changes the control by no more than this fraction of what moves the joint, so that a control at its limit is taken as a
constant force."""


class Actuators:
    """Actuators of an articulation, as its file defines them; they turn the return value of a controller into laws.

    A `PD` gives at most the `effort` (nv,), N m or N, unless it sets its own limit. Each of the `trees` has a slice of
    the coordinates.
    """

    def __init__(self, axes: Axes, effort: Array, trees: Sequence[slice], actuators: Sequence[Actuator] = ()) -> None:
        self._axes, self._effort, self._trees, self._actuators = axes, effort, trees, actuators
        self._told = False
        self._none = Control.none(axes.scalar.size).law
        self._last: tuple[PD | Actuation | None, tuple[Control, ...]] = None, ()

    def controls(self, given: Any) -> tuple[Control, ...]:
        """Return the control law of each tree from the return value of a controller; ValueError if it does not fit."""
        if isinstance(given, (PD, Actuation)):  # building a union type would cost time in each step
            if given is not self._last[0]:
                self._last = given, self._parts(self._law(given))
            return self._last[1]
        law = self._none.copy()
        named, what = isinstance(given, Mapping), "joint forces of controller"
        tau = floats(list(given.values()) if named else given)
        if tau.ndim != 1 or not np.isfinite(tau).all():
            wanted = self._axes.wanted()
            raise ValueError(f"{what} of {self._axes.owner!r} must be finite: {wanted}, got {given!r}")
        law[3] = self._axes.spread(dict(zip(given, tau, strict=True)) if named else tau, 0.0, what)
        return self._parts(law)

    def _law(self, given: PD | Actuation) -> Array:
        """Law of a `PD` or `Actuation`, shape (5, nv); warn once about actuators that the controller does not name."""
        owner = self._axes.owner
        if isinstance(given, PD):
            kp, kd, target, rate, feedforward, limit = given.on(self._axes, self._effort)
            return np.array((kp, kd, target, feedforward + kd * rate, limit))
        law, named = given.on(owner, self._actuators, self._effort), given.by_name(owner, self._actuators)
        off = [a.name for a in self._actuators if a.name not in named]
        if off and not self._told:
            self._told = True
            warnings.warn(f"actuators of {owner!r} that controller does not name are off: {off}", stacklevel=2)
        return law

    def _parts(self, law: Array) -> tuple[Control, ...]:
        laws = [law] if len(self._trees) == 1 else [law[:, v].copy() for v in self._trees]
        gains = [own[:2].reshape(-1) for own in laws]
        return tuple(
            [
                Control(x, _reductions.any_below(x[4], LARGEST), _reductions.most(g) > 0.0)
                for x, g in zip(laws, gains, strict=True)
            ]
        )


def left_to_rows(h: float, free: FreeMotion, v0: Array, v: Array, over: Bools) -> TreeLoads:
    """Return the loads of a motion without the control of the actuators `over` (nv,) their limits, which rows replace.

    The law τ = clip(τ₀ - b v', ±L) is the law of a clutch that slips at L, between the joint and a rotor. The rotor has
    the mass h b and turns at τ₀/b without the clutch. The row of the clutch is in `nsdyn.dynamics.joints`. If b is
    negligible beside the mobility of the joint, 1/mass (see `UNMOVED`), the actuator gets no row. Then τ is a constant:
    its value at v, the velocity after the forces by which the limits L (nv,), N m or N, are exceeded. v0 is that before
    the forces.
    """
    loads, mobility = free.loads, np.diag(free.minv)
    limit = np.full(v.size, np.inf) if loads.limit is None else loads.limit
    kp, kd, alpha, beta, force = loads.laws[1]
    slope = beta * kd + h * alpha**2 * kp
    start = force - ((1.0 - beta) * kd - h * (1.0 - alpha) ** 2 * kp) * v0
    held = np.where(over, np.clip(start - slope * v, -limit, limit), 0.0)
    row = over & (h * slope * mobility > UNMOVED)
    laws = loads.laws.copy()
    laws[1, :2, over], laws[1, 4, over] = 0.0, np.where(row, 0.0, held)[over]
    clutch = np.zeros((3, v0.size)) if loads.clutch is None else loads.clutch.copy()
    clutch[:, row] = h * limit[row], start[row] / slope[row], 1.0 / (h * slope[row])
    return loads._replace(laws=laws, clutch=clutch, held=np.where(row, held, loads.held))
