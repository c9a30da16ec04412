"""Prescribed motion: the velocity of a fixed body, of its surface, or of a joint as a function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.tools.arrays import Array, floats
from nsdyn.tools.callbacks import called

Velocity = ArrayLike | Callable[[float], ArrayLike]


@dataclass(frozen=True, eq=False)
class Motion:
    """A prescribed velocity.

    Attributes
    ----------
    name : str
        Name of a body, or articulation/joint.
    velocity : array or callable
        Constant, or a function of the time in s. For a body: linear (3,) [m/s] of its centre, or (linear, angular
        [rad/s]), world axes. For a joint: one number, rad/s or m/s.
    kind : {"body", "surface", "joint"}
        A "surface" moves while its body stays at rest: a conveyor.
    """

    name: str
    velocity: Velocity
    kind: str

    def twist(self, t: float) -> Array:
        """Return the (linear, angular) velocity of a body or surface at time t, shape (2, 3); ValueError if no fit."""
        value = self._value(t, ((3,), (2, 3)), "finite with shape (3,) or (2, 3)")
        return value if value.ndim == 2 else np.array((value, np.zeros(3)))

    def rate(self, t: float) -> float:
        """Return the velocity of a joint at time t; ValueError if it is not one finite number."""
        return float(self._value(t, ((),), "one finite number"))

    def _value(self, t: float, shapes: tuple[tuple[int, ...], ...], words: str) -> Array:
        def fit(given: ArrayLike) -> Array:
            value = floats(given)
            if value.shape not in shapes or not np.isfinite(value).all():
                raise ValueError(f"velocity of {self.name!r} must be {words}, got {given!r} at t = {t:g}")
            return value

        velocity = self.velocity
        return called(velocity, f"the velocity of {self.name!r}", fit, t) if callable(velocity) else fit(velocity)
