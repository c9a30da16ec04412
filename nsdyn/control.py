"""Joint control that the step treats implicitly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

__all__ = ["PD"]


@dataclass(frozen=True, eq=False)
class PD:
    """Joint control τ = kp (target - q) + kd (target_velocity - v) + feedforward, with q and v of the end of the step.

    Implicit, so that any gains are stable: with h the step, q = q_k + h v_{k+1} and v = v_{k+1}. One number serves all
    revolute and prismatic joints; arrays (nv,) must have no gain on other coordinates. The arrays are copied: make a
    new control to change them, and return the same one as long as it holds.

    Parameters
    ----------
    kp, kd : float or array, shape (nv,)
        Gains ≥ 0, N m/rad and N m s/rad, or N/m and N s/m.
    target, target_velocity : float or array, shape (nv,)
        rad and rad/s, or m and m/s.
    feedforward : float or array, shape (nv,)
        N m or N.

    Raises
    ------
    ValueError
        For values that are not finite numbers, more than one dimension, or negative gains.

    References
    ----------
    J. Tan, K. Liu, G. Turk, Stable proportional-derivative controllers, IEEE CG&A 31, 2011.

    Examples
    --------
    >>> import nsdyn as nd
    >>> hold = nd.PD(kp=50.0, kd=2.0, target=[0.3, -0.1])
    >>> hold.target.tolist()
    [0.3, -0.1]
    """

    kp: ArrayLike
    kd: ArrayLike
    target: ArrayLike
    target_velocity: ArrayLike = 0.0
    feedforward: ArrayLike = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            given = getattr(self, field.name)
            try:
                value = np.array(given, dtype=float)
            except (TypeError, ValueError):
                value = np.array(np.nan)
            if value.ndim > 1 or not np.isfinite(value).all():
                raise ValueError(f"{field.name} of a PD control must be one or nv finite numbers, got {given!r}")
            if field.name in ("kp", "kd") and (value < 0.0).any():
                raise ValueError(f"{field.name} of a PD control must not be negative, got {given!r}")
            value.flags.writeable = False
            object.__setattr__(self, field.name, value)

    def on(self, name: str, scalar: NDArray[np.bool_]) -> tuple[Array, Array, Array, Array, Array]:
        """(kp, kd, target, target_velocity, feedforward) as arrays (nv,) for an articulation.

        Parameters
        ----------
        name : str
        scalar : ndarray of bool, shape (nv,)
            Its revolute and prismatic coordinates.
        """
        out = []
        for field in fields(self):
            value = np.asarray(getattr(self, field.name))
            if value.shape not in ((), scalar.shape):
                raise ValueError(
                    f"{field.name} of the PD control of {name!r} must be one or {scalar.size} numbers, "
                    f"got shape {value.shape}"
                )
            out.append(value if value.ndim else value * scalar)
            if field.name in ("kp", "kd") and out[-1][~scalar].any():
                raise ValueError(f"{field.name} of the PD control of {name!r} must be 0 on free and spherical joints")
        return out[0], out[1], out[2], out[3], out[4]
