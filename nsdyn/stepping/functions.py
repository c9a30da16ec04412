"""The user's functions of a run: a controller and external forces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from nsdyn.dynamics.dynamics import Controls, Dynamics, Wrenches
from nsdyn.dynamics.values import Position
from nsdyn.stepping.midpoint import Callbacks
from nsdyn.stepping.state import Step
from nsdyn.tools import callbacks
from nsdyn.tools.arrays import Array

Callback = (
    Callable[[float, Array, Array], Mapping[str, Any]] | Callable[[float, Array, Array, Step | None], Mapping[str, Any]]
)


class Functions:
    """The controller of the joints and the external forces on the bodies of a scene, as in `nsdyn.Stepper`.

    Attributes
    ----------
    take_last : bool
        Whether one of the functions takes the last step.
    """

    def __init__(self, controller: Callback | None, external_force: Callback | None, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self._given = {"controller": controller, "external_force": external_force}
        self._seeing = {
            what for what, given in self._given.items() if callable(given) and callbacks.takes(given, "last")
        }
        for what, given in self._given.items():
            if given is None:
                continue
            last = {"last": None} if what in self._seeing else {}
            own = callbacks.misfit(given, *"tqv", **last) if callable(given) else ""
            if own or not callable(given):
                where, came = (f"{callbacks.source_line(given)}: ", f"one of {own}") if own else ("", repr(given))
                returned = {"controller": '{"arm": nd.PD(...)}', "external_force": '{"box": (1, 0, 0)}'}[what]
                raise ValueError(
                    f"{where}{what} must be a function of (t, q, v), or of (t, q, v, last), or None, "
                    f"as `lambda t, q, v: {returned}`; got {came}"
                )
        self.take_last, self._some = bool(self._seeing), any(self._given.values())

    def __getitem__(self, what: str) -> Callback | None:
        return self._given[what]

    def at(self, t: float, last: Step | None) -> Callbacks:
        """Return the callbacks for the time t, given the last step; None without functions."""
        if not self._some:
            return None
        dynamics = self._dynamics

        def said(middle: Position, v: Array) -> tuple[Wrenches | None, Controls]:
            at = t, *dynamics.pinocchio_state(middle, v)
            wrenches = controls = None
            if self._given["external_force"] is not None:
                wrenches = self._said("external_force", partial(dynamics.wrenches, middle), at, last)
            if self._given["controller"] is not None:
                controls = self._said("controller", dynamics.controls, at, last)
            return wrenches, controls or {}

        return said

    def _said(self, what: str, fit: Callable[[Any], Any], at: tuple[Any, ...], last: Step | None) -> Any:
        more = {"last": last} if what in self._seeing else {}
        function: Any = self._given[what]
        return callbacks.called(function, what, fit, *at, **more)
