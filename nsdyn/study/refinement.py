"""Refinement in time: one scene at several steps, errors against the finest, orders, times."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Unpack

import numpy as np
from scipy.optimize import brentq

from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import named as scenes
from nsdyn.scene.scene import Scene
from nsdyn.stepping.simulation import RunOptions, simulate
from nsdyn.stepping.system import check_seconds
from nsdyn.study.comparison import differences
from nsdyn.tools import notebook
from nsdyn.tools.arrays import numbers
from nsdyn.tools.naming import check_known

__all__ = ["Refinement", "Row", "order", "refine"]

ERRORS = {"position": "m", "rotation": "rad", "velocity": "m/s, rad/s", "energy": "J"}
"""What is compared, by `nsdyn.study.comparison.differences`, and its unit."""

ROUND_OFF = 1e-11
"""Errors that are smaller, in their units, have no order."""

LARGEST_ORDER = 16.0
"""Of those looked for."""


@dataclass(frozen=True)
class Row:
    """One run of a refinement.

    Attributes
    ----------
    dt : float
        s.
    steps : int
    position, rotation, velocity, energy : float
        Largest differences from the finest run at the times that both have, of any body or joint; m, rad, m/s or
        rad/s, J. 0 of the finest itself.
    orders : dict of str to float
        Order of each error from this run to the next finer one; NaN where they do not tell.
    time : float
        Wall time of the steps, s, start-up apart.
    """

    dt: float
    steps: int
    position: float
    rotation: float
    velocity: float
    energy: float
    orders: dict[str, float]
    time: float


@dataclass(frozen=True)
class Refinement:
    """Runs of a scene at several steps.

    Attributes
    ----------
    name : str
        Of the scene.
    rows : tuple of Row
        The coarsest step first.
    """

    name: str
    rows: tuple[Row, ...]

    def as_dict(self) -> dict[str, Any]:
        """The rows as JSON values."""
        return {"scene": self.name, "units": ERRORS, "runs": [asdict(row) for row in self.rows]}

    def __repr__(self) -> str:
        lines = self._lines()
        widths = [max(map(len, column)) + (column[0] != "order") for column in zip(*lines, strict=True)]
        return "\n".join([*(" ".join(map(str.rjust, line, widths)) for line in lines), self._title])

    def _repr_html_(self) -> str:
        headers, *cells = self._lines()
        return notebook.table(self._title, headers, cells)

    @property
    def _title(self) -> str:
        return f"{self.name}: largest differences from the run at dt = {self.rows[-1].dt:g} s"

    def _lines(self) -> list[list[str]]:
        """Headers and rows."""
        out = [
            [
                "dt [s]",
                "steps",
                *(h for name, unit in ERRORS.items() for h in (f"{name} [{unit}]", "order")),
                "time [s]",
            ]
        ]
        for row in self.rows:
            out.append([f"{row.dt:.3g}", str(row.steps)])
            for name in ERRORS:
                p = row.orders.get(name, math.nan)
                out[-1] += [f"{getattr(row, name):.2e}", "-" if math.isnan(p) else f"{p:.2f}"]
            out[-1].append(f"{row.time:.3g}")
        return out


def refine(
    scene: str | Callable[[], Scene],
    dts: Sequence[float],
    duration: float,
    parameters: dict[str, Any] | None = None,
    progress: bool = False,
    **options: Unpack[RunOptions],
) -> Refinement:
    """Simulate a scene at several steps and compare with the finest.

    Parameters
    ----------
    scene : str or callable
        Name or file of a scene, which is run with what drives it, or a function that returns a Scene.
    dts : sequence of float
        At least two, s; the duration must be a whole number of each.
    duration : float
        s.
    parameters : dict, optional
        Of the scene.
    progress : bool
        Show progress bars on stderr when it is a terminal.
    **options
        For `nsdyn.simulate`, but its dt and files: theta, solver, ...

    Returns
    -------
    Refinement

    Raises
    ------
    ValueError
        For fewer than two steps, or steps that do not divide the duration; what `simulate` refuses.

    Notes
    -----
    With errors e = C (h^p - h_0^p) against a run at h_0, the order p of two of them solves
    e_1/e_2 = (h_1^p - h_0^p)/(h_2^p - h_0^p). Where motion depends on its past without bound, as after many impacts,
    there is no order to be found.

    Examples
    --------
    A mechanism with closed loops, to second order:

    >>> import nsdyn as nd
    >>> found = nd.refine("four_bar", [8e-3, 4e-3, 2e-3], 0.2)
    >>> round(found.rows[0].orders["position"], 1)
    2.0
    """
    check_known(options, RunOptions.__optional_keys__)
    check_seconds(duration=duration)
    if not isinstance(parameters, Mapping | None):
        raise ValueError(f"parameters must be a mapping of names to values, got {parameters!r}")
    given = numbers(dts, words := "at least two different positive numbers of seconds", "dts")
    chosen = sorted(set(given.ravel().tolist()), reverse=True)
    if len(chosen) < 2 or not chosen[-1] > 0.0 or not math.isfinite(chosen[0]):
        raise ValueError(f"dts must be {words}, got {dts!r}")
    for dt in chosen:
        if abs(duration / dt - round(duration / dt)) > 1e-9 * duration / dt or duration < 0.5 * dt:
            raise ValueError(f"duration must be a whole number of every dt, got {duration:g} s and dt = {dt:g} s")
    runs = [_run(scene, dt, duration, parameters or {}, progress, options) for dt in chosen]
    finest = runs[-1]
    errors = [_errors(run, finest) for run in runs]
    rows = []
    for k, (dt, run) in enumerate(zip(chosen, runs, strict=True)):
        orders = {}
        if k + 2 < len(runs):
            next_ = {name: error if error > ROUND_OFF else 0.0 for name, error in errors[k + 1].items()}
            orders = {name: order(errors[k][name], next_[name], dt, chosen[k + 1], chosen[-1]) for name in ERRORS}
        # The first step loads or compiles what it needs.
        time = float(run.wall_time[1:].sum() + np.median(run.wall_time))
        rows.append(Row(dt, run.steps, **errors[k], orders=orders, time=time))
    return Refinement(str(finest.meta["scene_name"]), tuple(rows))


def order(e1: float, e2: float, h1: float, h2: float, h0: float) -> float:
    """Order p with e1/e2 = (h1^p - h0^p)/(h2^p - h0^p) for h1 > h2 > h0; NaN where no order explains the errors."""
    if not (e1 > 0.0 and e2 > 0.0):
        return math.nan

    def off(p: float) -> float:
        # Logarithms of 1 - (h0/h)^p, which stay accurate for small p.
        part1, part2 = (math.log(-math.expm1(p * math.log(h0 / h))) for h in (h1, h2))
        return p * math.log(h1 / h2) + part1 - part2 - math.log(e1 / e2)

    least, most = off(1e-6), off(LARGEST_ORDER)
    return float(brentq(off, 1e-6, LARGEST_ORDER)) if least < 0.0 < most else math.nan


def _run(
    scene: str | Callable[[], Scene],
    dt: float,
    duration: float,
    parameters: dict[str, Any],
    progress: bool,
    options: RunOptions,
) -> Trajectory:
    if isinstance(scene, str):
        setup = scenes.setup(scene, **parameters)
        return simulate(setup.scene, duration, **setup.options(**options | {"dt": dt, "progress": progress}))
    return simulate(scenes.made(scene, **parameters), duration, dt=dt, progress=progress, **options)


def _errors(run: Trajectory, finest: Trajectory) -> dict[str, float]:
    """Largest differences of a run from the finest at the times that both have."""
    found = differences(run, finest)
    return {name: float(getattr(found, name).max()) for name in ERRORS}
