"""Pictures of studies: errors over dt, and figures of a sweep over its parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nsdyn.view import panels
from nsdyn.view.panels import Curve, Panel, look

if TYPE_CHECKING:
    from nsdyn.study.refinement import Refinement
    from nsdyn.study.sweep import Member

FOUND = {
    "displacement": "displacement [m]",
    "kinetic": "kinetic at the end [J]",
    "friction": "work of friction [J]",
    "normal": "work of impacts [J]",
}
"""Entries of `nsdyn.study.sweep.figures` that are drawn, with their labels."""


def draw_refinement(found: Refinement, figure: Any) -> Any:
    """Draw the errors of a refinement over dt on a matplotlib figure; labels give the last known order of each."""
    rows, curves = found.rows[:-1], []
    for k, (name, unit) in enumerate(found.as_dict()["units"].items()):
        orders = [p for row in rows if not math.isnan(p := row.orders.get(name, math.nan))]
        y = np.array([getattr(row, name) for row in rows])
        told = orders and y.max() > panels.LOST
        label = f"{name} [{unit}]" + (f", order {orders[-1]:.1f}" if told else "")
        curves.append(Curve(label, np.array([row.dt for row in rows]), y, {**look(k), "marker": "o", "ms": 4}))
    return panels.draw(figure, [Panel("difference from the finest", curves, log="xy", xlabel="dt [s]")])


def varied(parameters: Mapping[str, Sequence[Any]]) -> str:
    """Return the numeric parameter with the most values; ValueError if no numeric parameter has two."""
    numbers = {
        name: len(values)
        for name, values in parameters.items()
        if all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in values)
    }
    most = max(numbers, key=lambda name: numbers[name], default="")
    if numbers.get(most, 0) < 2:
        raise ValueError(f"a plot of a sweep needs a parameter with two numbers or more, got {dict(parameters)}")
    return most


def draw_sweep(parameters: Mapping[str, Sequence[Any]], members: Sequence[Member], figure: Any) -> Any:
    """Draw figures of runs over the parameter with the most values, with a curve per combination of the others."""
    along = varied(parameters)
    groups: dict[str, list[Member]] = {}
    for member in members:
        others = [f"{name}={value}" for name, value in member.parameters.items() if name != along]
        groups.setdefault(", ".join(others), []).append(member)
    out = []
    for what, label in FOUND.items():
        curves = []
        for k, (name, some) in enumerate(groups.items()):
            order = sorted(some, key=lambda member: float(member.parameters[along]))
            x = np.array([float(member.parameters[along]) for member in order])
            y = np.array([math.nan if member.result is None else float(member.result[what]) for member in order])
            curves.append(Curve(name, x, y, {**look(k), "marker": "o", "ms": 3}))
        out.append(Panel(label, curves, xlabel=along))
    energy = max(abs(x) for panel in out[1:] for x in panel.range())
    return panels.draw(figure, [out[0], *(Panel(p.ylabel, p.curves, energy, xlabel=along) for p in out[1:])])
