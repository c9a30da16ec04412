"""Refinement in time: one scene with several time steps; differences from the finest run, orders, wall times."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Unpack

import numpy as np
from scipy.optimize import brentq

from nsdyn.scene.scene import Scene
from nsdyn.stepping.simulation import RunOptions
from nsdyn.stepping.system import check_seconds
from nsdyn.study.comparison import UNITS, differences
from nsdyn.study.sweep import simulated
from nsdyn.tools import notebook
from nsdyn.tools.arrays import numbers
from nsdyn.tools.naming import check_known

ROUND_OFF = 1e-11
"""Smallest error, in its unit, for which an order is computed."""

LARGEST_ORDER = 16.0
"""Upper end of the interval in which an order is searched."""


@dataclass(frozen=True)
class Row:
    """One run of a refinement.

    Attributes
    ----------
    dt : float
        Time step, s.
    steps : int
    position, rotation, velocity, energy : float
        Largest differences from the finest run at the common times, over all bodies and joints; m, rad, m/s or rad/s,
        J. 0 for the finest run itself.
    orders : dict of str to float
        Order of each error from this run to the next finer one; NaN if the errors show no order.
    time : float
        Wall time of the steps without start-up, s.
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
    """Runs of a scene with several time steps.

    Attributes
    ----------
    name : str
        Name of the scene.
    rows : tuple of Row
        Runs, from the coarsest time step to the finest.
    """

    name: str
    rows: tuple[Row, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the rows as JSON values."""
        return {"scene": self.name, "units": UNITS, "runs": [asdict(row) for row in self.rows]}

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
        """Return the texts of headers and rows."""
        out = [
            [
                "dt [s]",
                "steps",
                *(h for name, unit in UNITS.items() for h in (f"{name} [{unit}]", "order")),
                "time [s]",
            ]
        ]
        for row in self.rows:
            out.append([f"{row.dt:.3g}", str(row.steps)])
            for name in UNITS:
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
    """Simulate a scene with several time steps and compare the runs with the finest one.

    Parameters
    ----------
    scene : str or callable
        Name or file of a scene, which is run with its controller and external forces, or a function that returns a
        Scene.
    dts : sequence of float
        At least two time steps, s; the duration must be a whole multiple of each.
    duration : float
        Simulated time, s.
    parameters : dict, optional
        Parameters of the scene.
    progress : bool
        Show progress bars on stderr when it is a terminal.
    **options
        Options of `nsdyn.simulate` except dt and files: theta, solver, ...

    Returns
    -------
    Refinement

    Raises
    ------
    ValueError
        For fewer than two time steps, time steps that do not divide the duration, and all errors of `simulate`.

    Notes
    -----
    With errors e = C (h^p - h_0^p) relative to a run at h_0, the order p of two errors solves
    e_1/e_2 = (h_1^p - h_0^p)/(h_2^p - h_0^p). Where small differences of the motion grow without bound, as after many
    impacts, no order can be found.

    Examples
    --------
    A mechanism with closed loops, of second order:

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
    runs = [simulated(scene, parameters or {}, duration, {**options, "dt": dt, "progress": progress}) for dt in chosen]
    finest = runs[-1]
    errors = [differences(run, finest).largest for run in runs]
    rows = []
    for k, (dt, run) in enumerate(zip(chosen, runs, strict=True)):
        orders = {}
        if k + 2 < len(runs):
            next_ = {name: error if error > ROUND_OFF else 0.0 for name, error in errors[k + 1].items()}
            orders = {name: order(errors[k][name], next_[name], dt, chosen[k + 1], chosen[-1]) for name in UNITS}
        # The first step includes loading and compiling of kernels: the median replaces its time.
        time = float(run.wall_time[1:].sum() + np.median(run.wall_time))
        rows.append(Row(dt, run.steps, **errors[k], orders=orders, time=time))
    return Refinement(str(finest.meta["scene_name"]), tuple(rows))


def order(e1: float, e2: float, h1: float, h2: float, h0: float) -> float:
    """Return p with e1/e2 = (h1^p - h0^p)/(h2^p - h0^p) for h1 > h2 > h0; NaN if no order explains the errors."""
    if not (e1 > 0.0 and e2 > 0.0):
        return math.nan

    def off(p: float) -> float:
        # Logarithms of 1 - (h0/h)^p, computed so that they stay accurate for small p.
        part1, part2 = (math.log(-math.expm1(p * math.log(h0 / h))) for h in (h1, h2))
        return p * math.log(h1 / h2) + part1 - part2 - math.log(e1 / e2)

    least, most = off(1e-6), off(LARGEST_ORDER)
    return float(brentq(off, 1e-6, LARGEST_ORDER)) if least < 0.0 < most else math.nan
