"""Pictures of what a recording shows besides its motion, each drawn on matplotlib axes that it returns.

``nsdyn plot RUN.h5`` draws them side by side. `Trajectory.plot_energy` draws the ledger.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from nsdyn.recording.tables import contact_rows, impulses, pair_rows
from nsdyn.tools.naming import choice

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["QUANTITIES", "certificate", "dissipation", "friction", "pair", "penetration"]

QUANTITIES = {"gap": "smallest gap [m]", "u_N": "normal velocity there [m/s]", "r_N": "normal impulse, sum [N·s]"}
"""What `pair` draws, and what its axis says."""

NOTHING = 1e-9
"""Work of a step that is round-off or the solver's tolerance, over the largest energy: drawn as nothing."""

SHOWN = 8
"""Pairs with the largest works that are drawn one by one."""


def dissipation(trajectory: Trajectory, ax: Any = None) -> Any:
    """Draw what the contacts of each pair of bodies dissipate in each step, stacked, J.

    The largest of them have colours of their own. ValueError as of `Trajectory.pair_works`.
    """
    ax = _axes(ax)
    works = [(f"{a} | {b}", -normal - drag) for (a, b), (normal, drag) in trajectory.pair_works().items()]
    if others := works[SHOWN:]:
        works = [*works[:SHOWN], (f"{len(others)} other pairs", np.sum([work for _, work in others], axis=0))]
    for sign in (1.0, -1.0):  # what gains in a step is drawn downwards
        layers = [np.maximum(sign * work, 0.0) * sign for _, work in works]
        if layers:
            colours = [f"C{k}" for k in range(len(layers))]
            ax.stackplot(trajectory.t_steps, layers, labels=[n for n, _ in works] if sign > 0 else [], colors=colours)
    ax.set(xlabel="t [s]", ylabel="dissipated in a step [J]", title="dissipation")
    ax.margins(x=0)
    low, high = ax.get_ylim()
    least = NOTHING * trajectory.largest_energy or 1.0
    if high - low < least:
        ax.set_ylim(-0.1 * least, 0.9 * least)
        ax.text(0.5, 0.5, "nothing is dissipated", transform=ax.transAxes, ha="center", va="center", size="x-large")
    if works:
        ax.legend(loc="best", frameon=False, fontsize="small")
    return ax


def pair(trajectory: Trajectory, a: str, b: str, quantity: str = "gap", ax: Any = None) -> Any:
    """Draw a quantity of the contacts of two bodies over time.

    Parameters
    ----------
    trajectory : Trajectory
    a, b : str
        Bodies, "articulation/body" or whole articulations.
    quantity : {"gap", "u_N", "r_N"}
        Smallest gap at the end of a step, normal velocity of that contact after it, sum of the normal impulses.
    ax : matplotlib Axes, optional
        A new one by default.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    ValueError
        For unknown names, and where contacts were not recorded.
    """
    choice(quantity, QUANTITIES, "quantity")
    ax, t, c = _axes(ax), trajectory.t_steps, trajectory.columns
    if quantity == "gap":
        gap = trajectory.pair(a, b).gap
        values = np.where(np.isfinite(gap), gap, np.nan)
    else:
        row, step, _ = pair_rows(trajectory, a, b)
        values = np.zeros(t.size)
        if quantity == "r_N":
            np.add.at(values, step - 1, impulses(trajectory, row)[:, 0])
        else:
            values[:] = np.nan
            order = np.argsort(-c["contacts/gap"][row], kind="stable")  # the smallest comes last and stays
            values[step[order] - 1] = c["contacts/u"][row[order], 0]
    ax.plot(t, values, ".-", ms=3, lw=0.8)
    ax.axhline(0.0, color="k", lw=0.5)
    ax.set(xlabel="t [s]", ylabel=QUANTITIES[quantity], title=f"{a} | {b}")
    ax.margins(x=0)
    return ax


def friction(trajectory: Trajectory, ax: Any = None) -> Any:
    """Draw the tangential impulse of every contact that pushes against mu r_N: on the line it slips, below it sticks.

    Of redundant contacts they are those of least norm, as everywhere (`nsdyn.recording.shares`).
    ValueError where contacts were not recorded.
    """
    ax, c = _axes(ax), trajectory.columns
    row, _ = contact_rows(trajectory)
    r, state = impulses(trajectory, row), c["contacts/status"][row]
    most, drag = c["contacts/mu"][row] * r[:, 0], np.hypot(r[:, 1], r[:, 2])
    for value, name, colour in ((1, "stick", "C0"), (2, "slip", "C3")):
        some = (state == value) & (most > 0.0)
        ax.plot(most[some], drag[some], ".", ms=3, color=colour, label=f"{name} ({some.sum()})", rasterized=True)
    top = float(most.max(initial=0.0)) or 1.0
    ax.plot([0.0, top], [0.0, top], "k", lw=0.8)
    ax.set(xlabel="μ r_N [N·s]", ylabel="|r_T| [N·s]", title="friction cones")
    ax.legend(loc="upper left", frameon=False)
    return ax


def certificate(trajectory: Trajectory, ax: Any = None) -> Any:
    """Draw the residual of the solver and Gauss's bound of every step, on a logarithmic axis."""
    ax, t = _axes(ax), trajectory.t_steps
    curves = (("Gauss bound [√J]", trajectory.gauss.bound), ("residual [m/s]", trajectory.solver.residual))
    for label, values in curves:
        ax.plot(t, np.where(values > 0.0, values, np.nan), ".-", ms=3, lw=0.6, label=label)
    return _logarithmic(ax, [values for _, values in curves], "error of the step", "certificate and residual")


def penetration(trajectory: Trajectory, ax: Any = None) -> Any:
    """Draw the deepest recorded gap below 0 of every step on a logarithmic axis; ValueError without contacts.

    Those are of the contacts: `nsdyn.check` looks at the shapes themselves.
    """
    ax = _axes(ax)
    row, step = contact_rows(trajectory)
    depth = np.zeros(trajectory.steps)
    np.maximum.at(depth, step - 1, -trajectory.columns["contacts/gap"][row])
    ax.plot(trajectory.t_steps, np.where(depth > 0.0, depth, np.nan), ".-", ms=3, lw=0.6, label="deepest gap [m]")
    return _logarithmic(ax, [depth], "depth [m]", "penetration")


def _logarithmic(ax: Any, curves: list[Any], ylabel: str, title: str) -> Any:
    if any((values > 0.0).any() for values in curves):
        ax.set_yscale("log")
        ax.legend(loc="best", frameon=False)
    else:
        ax.text(0.5, 0.5, "0 throughout", transform=ax.transAxes, ha="center", va="center")
    ax.set(xlabel="t [s]", ylabel=ylabel, title=title)
    ax.margins(x=0)
    return ax


def _axes(ax: Any) -> Any:
    """The axes given, or new ones."""
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    return ax
