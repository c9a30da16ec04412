"""Joint control that the step treats implicitly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nsdyn.tools.arrays import Array

__all__ = ["PD"]


@dataclass(frozen=True, eq=False)
class PD:
    """Joint control τ = kp (target - q) + kd (target_velocity - v) + feedforward, at most `limit` of either sign.

    It acts as the joint springs and dampers of `Scene.add_model` do: of second order in the step h for θ = ½, and
    without damping of its own. With q~ and v⁻ where the forces of a step act, before them, and v⁺ after them,

        q = q~ + h (α² v⁺ - (1 - α)² v⁻),  v = β v⁺ + (1 - β) v⁻,      α = β = θ, that of the step,

    so that no gains let it blow up. Where a joint moves so little inertia m, 1/m = (M⁻¹)_jj, that it would ring, α and
    β are larger: β = 1 - 3/δ where δ = h kd/m > 3/(1 - θ), and α = 1 - 3/σ where σ = h² kp/(m + h kd/2) > 3/(1 - θ),
    which is 6 for θ = ½. So what `kd` stops in one joint overshoots by a half in a step at most, in chains of light
    links by three quarters, and swings faster than 2.4/h die down. There it is of first order: as if the joint had the
    inertia h kd (β - ½) + h² kp (α - ½)² and the damping 2 h kp (α - ½) more.

    One number serves all revolute and prismatic joints; arrays (nv,) must have no gain on other coordinates. The arrays
    are copied: make a new control to change them, and return the same one as long as it holds.

    Parameters
    ----------
    kp, kd : float or array, shape (nv,)
        Gains ≥ 0, N m/rad and N m s/rad, or N/m and N s/m.
    target, target_velocity : float or array, shape (nv,)
        rad and rad/s, or m and m/s.
    feedforward : float or array, shape (nv,)
        N m or N.
    limit : float or array, shape (nv,), optional
        Most |τ| of each joint, N m or N; infinite for none. Default: the efforts of the robot's file. It is never
        exceeded, whatever the gains and the step, pressed against a contact or not: a control at its limit is a row of
        the contact problem, like dry joint friction.

    Raises
    ------
    ValueError
        For values that are not finite numbers, more than one dimension, negative gains, or limits that are not
        positive.

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
    limit: ArrayLike | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            given = getattr(self, field.name)
            if field.name == "limit" and given is None:
                continue
            try:
                value = np.array(given, dtype=float)
            except (TypeError, ValueError):
                value = np.array(np.nan)
            unlimited = field.name == "limit" and (value > 0.0).all()
            if value.ndim > 1 or not (unlimited or np.isfinite(value).all()):
                raise ValueError(f"{field.name} of a PD control must be one or nv finite numbers, got {given!r}")
            if field.name in ("kp", "kd") and (value < 0.0).any():
                raise ValueError(f"{field.name} of a PD control must not be negative, got {given!r}")
            if field.name == "limit" and not unlimited:
                raise ValueError(f"limit of a PD control must be positive, got {given!r}")
            value.flags.writeable = False
            object.__setattr__(self, field.name, value)

    def on(
        self, name: str, scalar: NDArray[np.bool_], effort: Array
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """(kp, kd, target, target_velocity, feedforward, limit) as arrays (nv,) for an articulation.

        Parameters
        ----------
        name : str
        scalar : ndarray of bool, shape (nv,)
            Its revolute and prismatic coordinates.
        effort : ndarray, shape (nv,)
            The limit where none is given.
        """
        out = []
        for field in fields(self):
            given = getattr(self, field.name)
            value = effort if given is None else np.asarray(given)
            if value.shape not in ((), scalar.shape):
                raise ValueError(
                    f"{field.name} of the PD control of {name!r} must be one or {scalar.size} numbers, "
                    f"got shape {value.shape}"
                )
            out.append(value if value.ndim else np.where(scalar, value, np.inf if field.name == "limit" else 0.0))
            if field.name in ("kp", "kd") and out[-1][~scalar].any():
                raise ValueError(
                    f"{field.name} of the PD control of {name!r} must be 0 on free, ball and planar joints"
                )
        return out[0], out[1], out[2], out[3], out[4], out[5]
