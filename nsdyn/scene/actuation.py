"""Actuators of a robot file, and the controls that a controller gives them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.tools.arrays import Array, floats
from nsdyn.tools.naming import choice


class Actuator(NamedTuple):
    """A motor or servo on a revolute or prismatic joint: τ = g clip(k u + b0 + b1 g q + b2 g v) with the control u.

    Attributes
    ----------
    name, joint : str
    coordinate : int
        Index of the joint's coordinate in v.
    gear, gain : float
        g and k.
    bias : (float, float, float)
        b0, b1 ≤ 0 and b2 ≤ 0; b1 multiplies the joint's angle q [rad] or length [m], b2 its velocity v.
    control_range, force_range : (float, float)
        Least and greatest u, and k u + b0 + b1 g q + b2 g v; infinite without a range.
    control : float, optional
        u in the keyframe that the file was read with.
    """

    name: str
    joint: str
    coordinate: int
    gear: float
    gain: float
    bias: tuple[float, float, float]
    control_range: tuple[float, float]
    force_range: tuple[float, float]
    control: float | None = None

    @property
    def servo(self) -> bool:
        """Whether the force depends on position or velocity of the joint, not on the control alone."""
        return self.bias[1] != 0.0 or self.bias[2] != 0.0

    @property
    def acts(self) -> bool:
        """Whether the actuator acts as the file has it: it is a servo, or a keyframe gives it a control."""
        return self.servo or bool(self.control)


@dataclass(frozen=True, eq=False)
class Actuation:
    """Controls of the actuators of an MJCF file, in the units that MuJoCo gives them; actuators without one are off.

    The actuators are the motors, the position and velocity servos and the general actuators without internal state of
    the file, with their gears, gains and ranges. Servos are implicit like `nsdyn.PD`: of second order in the step and
    stable with any gain.

    Parameters
    ----------
    controls : mapping of str to float, or array, optional
        By the names of the actuators, or of their joints for actuators without a name; or one for each actuator in the
        order of the file, as MuJoCo's ``ctrl``. Default: the ``ctrl`` of the keyframe given to `add_mjcf`.

    Raises
    ------
    ValueError
        For controls that are not finite numbers. When the control is applied to an articulation: for names or a number
        of values that do not fit, and for default controls without a keyframe.

    Examples
    --------
    >>> import nsdyn as nd
    >>> nd.Actuation({"knee_servo": 0.3}).controls
    {'knee_servo': 0.3}
    >>> nd.Actuation([0.3, -0.1]).controls
    (0.3, -0.1)
    """

    controls: Mapping[str, float] | ArrayLike | None = None

    def __post_init__(self) -> None:
        given: Any = self.controls
        if given is None:
            return
        named = isinstance(given, Mapping)
        values = floats(list(given.values()) if named else given)
        if values.ndim != 1 or not np.isfinite(values).all():
            wanted = "{actuator: finite number}, or one number for each actuator"
            raise ValueError(f"controls of an Actuation must be {wanted}, got {given!r}")
        kept = tuple(values.tolist())
        object.__setattr__(self, "controls", dict(zip(given, kept, strict=True)) if named else kept)

    def by_name(self, owner: str, actuators: Sequence[Actuator]) -> dict[str, float]:
        """Return the controls of the actuators of the articulation `owner` by name; ValueError if they do not fit."""
        given: Any = self.controls
        names = [a.name for a in actuators]
        if given is None:
            held = {a.name: a.control for a in actuators if a.control is not None}
            if not held:
                raise ValueError(
                    f"controls of an Actuation must be given: {owner!r} was read without a keyframe's ctrl"
                )
            return held
        if isinstance(given, Mapping):
            return {choice(name, names, f"actuator of {owner!r}"): value for name, value in given.items()}
        if len(given) != len(names):
            raise ValueError(
                f"controls of an Actuation must be one for each of the {len(names)} actuators of {owner!r}: "
                f"{', '.join(names)}; got {len(given)}"
            )
        return dict(zip(names, given, strict=True))

    def on(self, owner: str, actuators: Sequence[Actuator], effort: Array) -> Array:
        """Return kp, kd, target, constant and limit of the joint forces of the articulation `owner`, shape (5, nv).

        `effort` (nv,) is the greatest of each joint, N m or N.
        """
        known = {a.name: a for a in actuators}
        out = np.zeros((5, effort.size))
        out[4] = effort
        for name, given in self.by_name(owner, actuators).items():
            a = known[name]
            force, j = a.gain * float(np.clip(given, *a.control_range)) + a.bias[0], a.coordinate
            if a.servo:
                out[:2, j] -= a.gear**2 * np.array(a.bias[1:])
                out[4, j] = min(out[4, j], abs(a.gear) * a.force_range[1])
            else:
                force = float(np.clip(force, *a.force_range))
            out[3, j] += a.gear * force
        return out
