"""Joint control that the step solves implicitly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from nsdyn._kernels import reductions as _reductions
from nsdyn.tools.arrays import Array, Bools, floats
from nsdyn.tools.naming import choice


class Axes(NamedTuple):
    """The coordinates of an articulation on which a control acts.

    Attributes
    ----------
    owner : str
        Name of the articulation.
    joints : tuple of str
        Its revolute and prismatic joints; a joint with several axes appears as "joint:0", "joint:1", ...
    scalar : ndarray of bool, shape (nv,)
        True for the coordinates of `joints`.
    """

    owner: str
    joints: tuple[str, ...]
    scalar: Bools

    @classmethod
    def of(cls, owner: str, model: Any, scalar: Bools) -> Axes:
        """Return the axes of an articulation with a pinocchio.Model."""
        places = zip(model.names, model.idx_vs, model.nvs, strict=True)
        rows = [(f"{name}:{k}" if n > 1 else name, start + k) for name, start, n in places for k in range(n)]
        return cls(owner, tuple(name for name, place in rows if scalar[place]), scalar)

    def spread(self, given: Any, rest: float | Array, what: str) -> Array:
        """Expand values to all coordinates, shape (nv,); ValueError naming the joints, or how many values are expected.

        Parameters
        ----------
        given : float, mapping of str to float, or array
            One number for all joints, numbers for some joints by name, one for each joint, or one for each coordinate.
        rest : float or ndarray, shape (nv,)
            Values of coordinates that are not given.
        what : str
            Name of the values in errors.
        """
        nv, count = self.scalar.size, len(self.joints)
        out = np.empty(nv)
        out[:] = rest
        if isinstance(given, Mapping):
            places = dict(zip(self.joints, np.flatnonzero(self.scalar), strict=True))
            for name, value in given.items():
                out[places[choice(name, places, f"name in {what} of {self.owner!r}")]] = value
            return out
        values = np.asarray(given, dtype=float)
        if values.shape == (nv,):
            return values
        if values.shape not in ((), (count,)):
            raise ValueError(f"{what} of {self.owner!r} must be {self.wanted()}, got shape {values.shape}")
        out[self.scalar] = values
        return out

    def wanted(self) -> str:
        """Return the accepted forms of values, in words."""
        nv, count = self.scalar.size, len(self.joints)
        more = f" or {nv} numbers, one for each coordinate," if nv > count else ""
        return f"{{joint: number}}, or {count} numbers, one for each revolute and prismatic joint,{more}".rstrip(",")


@dataclass(frozen=True, eq=False)
class PD:
    """Joint control τ = kp (target - q) + kd (target_velocity - v) + feedforward, at most `limit` of either sign.

    The control is implicit like the joint springs and dampers of `Scene.add_model`: of second order in the step h for
    θ = ½, and without numerical damping. The law uses q~, the velocity v⁻ before the forces of the step act at q~, and
    the velocity v⁺ after them:

        q = q~ + h (α² v⁺ - (1 - α)² v⁻),  v = β v⁺ + (1 - β) v⁻,      α = β = θ, that of the step,

    so that it is stable with any gains. α and β are larger where a joint moves so little inertia m, 1/m = (M⁻¹)_jj,
    that it would oscillate: β = 1 - 3/δ where δ = h kd/m > 3/(1 - θ), and α = 1 - 3/σ where
    σ = h² kp/(m + h kd/2) > 3/(1 - θ), which is 6 for θ = ½. A motion that `kd` stops then overshoots in a step by at
    most a half in a single joint, and by three quarters in chains of light links. Oscillations faster than 2.4/h decay.
    In such joints the control is of first order: it acts as if the joint had the additional inertia
    h kd (β - ½) + h² kp (α - ½)² and the additional damping 2 h kp (α - ½).

    Each parameter is one number for all revolute and prismatic joints, an array of one number for each of them in the
    order of the model, or a mapping for some of them, {joint: number}. A joint that a mapping leaves out has no gain
    and no feedforward; a joint that a mapping of targets leaves out is not controlled. Arrays of nv numbers, one for
    each coordinate, are accepted too: their gains must be 0 on free, ball and planar joints, but feedforward may act
    there. Parameters are copied: make a new control to change them, and return the same object while they stay the
    same.

    Parameters
    ----------
    kp, kd : float, mapping or array
        Gains ≥ 0, N m/rad and N m s/rad, or N/m and N s/m.
    target, target_velocity : float, mapping or array
        rad and rad/s, or m and m/s.
    feedforward : float, mapping or array
        N m or N.
    limit : float, mapping or array, optional
        Greatest |τ| of each joint, N m or N; infinite for no limit. Default: the efforts of the robot's file. The limit
        is never exceeded, with any gains and steps, pressed against a contact or not: a control at its limit is a row
        of the contact problem, like dry joint friction.

    Raises
    ------
    ValueError
        For values that are not finite numbers, arrays of more than one dimension, negative gains, or limits that are
        not positive.

    References
    ----------
    J. Tan, K. Liu, G. Turk, Stable proportional-derivative controllers, IEEE CG&A 31, 2011.

    Examples
    --------
    >>> import nsdyn as nd
    >>> hold = nd.PD(kp=50.0, kd=2.0, target=[0.3, -0.1])
    >>> hold.target.tolist()
    [0.3, -0.1]
    >>> bend = nd.PD(kp=50.0, kd=2.0, target={"knee": 0.3})  # leaves the other joints alone
    """

    kp: ArrayLike | Mapping[str, float]
    kd: ArrayLike | Mapping[str, float]
    target: ArrayLike | Mapping[str, float]
    target_velocity: ArrayLike | Mapping[str, float] = 0.0
    feedforward: ArrayLike | Mapping[str, float] = 0.0
    limit: ArrayLike | Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        for name in PARAMETERS:
            given = getattr(self, name)
            if name == "limit" and given is None:
                continue
            named = isinstance(given, Mapping)
            value = floats(list(given.values()) if named else given)
            flat = value.reshape(-1)
            unlimited = name == "limit" and bool((value > 0.0).all())
            if value.ndim > 1 or not (unlimited or _reductions.largest(flat) < np.inf):
                wanted = "a finite number, one for each joint, or {joint: number}"
                raise ValueError(f"{name} of a PD control must be {wanted}, got {given!r}")
            if name in ("kp", "kd") and _reductions.least(flat) < 0.0:
                raise ValueError(f"{name} of a PD control must not be negative, got {given!r}")
            if name == "limit" and not unlimited:
                raise ValueError(f"limit of a PD control must be positive, got {given!r}")
            value.flags.writeable = False
            self.__dict__[name] = dict(zip(given, value.tolist(), strict=True)) if named else value

    def on(self, axes: Axes, effort: Array) -> Array:
        """Return kp, kd, target, target_velocity, feedforward and limit of an articulation, shape (6, nv).

        The limits are those of `effort` (nv,) if `limit` is not given.
        """
        out = np.empty((6, axes.scalar.size))
        for row, name in zip(out, PARAMETERS, strict=True):
            given, what = getattr(self, name), f"{name} of the PD control"
            row[:] = effort if given is None else axes.spread(given, np.inf if name == "limit" else 0.0, what)
        if len(axes.joints) < axes.scalar.size and (others := out[:2, ~axes.scalar].any(axis=1)).any():
            what = f"{PARAMETERS[int(others.argmax())]} of the PD control of {axes.owner!r}"
            raise ValueError(f"{what} must be 0 on free, ball and planar joints")
        if isinstance(self.target, Mapping):
            out[:2, axes.spread(dict.fromkeys(self.target, 1.0), 0.0, "target of the PD control") == 0.0] = 0.0
        return out


PARAMETERS = tuple(field.name for field in fields(PD))
