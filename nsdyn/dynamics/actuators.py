"""Control of the joints of a tree: what a controller gives, and actuators at their limits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nsdyn.dynamics.tree_values import Halfway, TreeLoads
from nsdyn.scene.control import PD
from nsdyn.tools.arrays import Array, Bools

__all__ = ["Actuators", "Control", "left_to_rows"]

Control = Array
"""(kp, kd, target, constant, limit) of a control, shape (5, nv): feedforward and kd times the target's velocity are
constant."""

UNMOVED = 1e-9
"""Of a control that gives way to the motion of a step by no more than this fraction of what moves it the motion tells
nothing: at its limit it is a constant."""


class Actuators:
    """The actuators of a tree, which read what a controller returns.

    Parameters
    ----------
    name : str
        Of the articulation.
    scalar : ndarray of bool, shape (nv,)
        Its revolute and prismatic coordinates.
    effort : ndarray, shape (nv,)
        Most that a `PD` gives unless it says otherwise, N m or N.
    """

    def __init__(self, name: str, scalar: NDArray[np.bool_], effort: Array) -> None:
        self._name, self._scalar, self._effort = name, scalar, effort
        self._none: Control = np.zeros((5, scalar.size))
        self._none[4] = np.inf
        self._last: tuple[PD | None, Control, bool] = None, self._none, False

    def control(self, given: Any) -> tuple[Control, bool]:
        """What a controller returned, and whether it is limited; ValueError if it does not fit."""
        if given is None:
            return self._none, False
        if isinstance(given, PD):
            if given is not self._last[0]:
                parts = given.on(self._name, self._scalar, self._effort)
                kp, kd, target, rate, feedforward, limit = parts
                control = np.array((kp, kd, target, feedforward + kd * rate, limit))
                self._last = given, control, bool(np.isfinite(limit).any())
            return self._last[1:]
        n = self._scalar.size
        try:
            tau = np.array(given, dtype=float)
        except (TypeError, ValueError):
            tau = np.array(np.nan)
        if tau.shape != (n,) or not np.isfinite(tau).all():
            raise ValueError(f"controller must give {n} finite joint forces for {self._name!r}, got {given!r}")
        control = self._none.copy()
        control[3] = tau
        return control, False


def left_to_rows(halfway: Halfway, loads: TreeLoads, limit: Array, mobility: Array, v: Array, over: Bools) -> TreeLoads:
    """The loads of a step without the control of the actuators `over` (nv,) their limits, which is left to rows.

    τ = clip(τ₀ - b v', ±L) is that of a clutch that slips at L, between the joint and a rotor of mass h b that turns at
    τ₀/b without it: its row is in `nsdyn.dynamics.joints`. Beside the `mobility` (nv,) of a joint a small b is nothing:
    then τ is what it is at v (nv,), the velocity after the forces by which the limits are exceeded.
    """
    kp, kd, alpha, beta, force = loads.laws[1]
    h, v0 = halfway.h, halfway.v
    slope = beta * kd + h * alpha**2 * kp
    start = force - ((1.0 - beta) * kd - h * (1.0 - alpha) ** 2 * kp) * v0
    held = np.where(over, np.clip(start - slope * v, -limit, limit), 0.0)
    row = over & (h * slope * mobility > UNMOVED)
    laws = loads.laws.copy()
    laws[1, :2, over], laws[1, 4, over] = 0.0, np.where(row, 0.0, held)[over]
    clutch = np.zeros((3, v0.size)) if loads.clutch is None else loads.clutch.copy()
    clutch[:, row] = h * limit[row], start[row] / slope[row], 1.0 / (h * slope[row])
    return loads._replace(laws=laws, clutch=clutch, held=np.where(row, held, loads.held))
