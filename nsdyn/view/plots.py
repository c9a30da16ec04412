"""Plots of quantities of a recording over time: `draw` draws one of `KINDS`, ``nsdyn plot RUN.h5`` several."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nsdyn.dynamics.ledger import LAYERS
from nsdyn.recording.breakdown import NEGLIGIBLE
from nsdyn.recording.columns import ENERGIES
from nsdyn.recording.tabulated import tabulated
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene.checks import text
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice, counted
from nsdyn.tools.table import Table
from nsdyn.tools.units import with_unit
from nsdyn.view import panels
from nsdyn.view.curves import ledger
from nsdyn.view.panels import LEDGER, OTHERS, SAME, Curve, Panel
from nsdyn.view.solids import PALETTE

__all__ = ["KINDS", "draw", "usual"]

SHOWN = 12
"""Greatest number of curves at which all of them are named."""

NAMED = len(PALETTE)
"""Named curves if there are more than SHOWN: those that move or carry most, each in its own colour; the rest grey."""

SIDES = " | "
"""Separator between the names of two bodies."""

LONGEST = 2.0
"""Friction is drawn to scale up to this factor times its 90 % quantile, like the forces on the page."""

OF_JOINTS = "joint", "phase"
OF_CONTACTS = "force", "slip", "gap", "power", "friction", "penetration"
"""Kinds that need a recording with contacts."""

UNITS = {"rad": ("angle", "torque [N m]"), "m": ("position", "force [N]")}
"""Names of the coordinate of a joint and of the force along it, by the unit of the coordinate."""

Shown = dict[str, tuple[str, dict[str, Any]]]


def draw(trajectory: Trajectory, kind: str, name: str = "*", figure: Any = None) -> Any:
    """Draw motion, forces, energies or certificates over time.

    Parameters
    ----------
    trajectory : Trajectory
    kind : str
        position, speed : of bodies [m, m/s].
        force, slip, gap : of pairs that touch: normal force and net friction [N], largest slip [m/s], gap [m].
        joint, phase : angle or position, velocity and torque of joints; velocity over angle.
        energy, power : energies and the works that changed them, as on the page [J]; dissipation of each pair [W].
        friction : of every contact, over the greatest friction that Coulomb's law allows [N].
        certificate, penetration : error of each step and its bound; penetration of shapes, by the recorded gaps [m].
    name : str
        Selected bodies, pairs or joints, as in `nsdyn.Trajectory.table`.
    figure : matplotlib Figure or SubFigure, optional
        Default: a new figure of pyplot; in a notebook, a cell shows it if the cell ends with it. The layout of a given
        figure should be constrained.

    Returns
    -------
    matplotlib Figure

    Raises
    ------
    ValueError
        For an unknown kind or name, for data that were not recorded, and for a trajectory or figure of another type.

    Examples
    --------
    >>> import nsdyn as nd
    >>> run = nd.simulate(nd.scenes.load("slide")(), 0.5, dt=0.01)
    >>> nd.plots.draw(run, "speed", "box").savefig("speed.pdf")  # doctest: +SKIP
    """
    _check(trajectory)
    if figure is not None and not hasattr(figure, "subfigures"):
        raise ValueError(f"figure must be a Figure or SubFigure of matplotlib, got {figure!r}")
    choice(kind, KINDS, "kind")
    text(name, "name")
    missing = _missing(trajectory)
    for what, kinds in missing.items():
        if kind in kinds:
            told = ", ".join(k for k in KINDS if not any(k in without for without in missing.values()))
            raise ValueError(f"the recording has no {what} to draw {kind} of; what can be drawn: {told}")
    found = KINDS[kind](trajectory, name)
    if figure is None:
        import matplotlib.pyplot as plt

        figure = plt.figure(layout="constrained")
        if plt.get_backend().endswith("inline"):  # else a notebook shows it twice: as result and as open figure
            plt.close(figure)
    panels.draw(figure, found)
    return figure


def usual(trajectory: Trajectory) -> list[str]:
    """Return the kinds that are drawn by default."""
    _check(trajectory)
    return [
        "energy",
        "speed",
        *(["force"] if trajectory.columns["contacts/offset"][-1] > 0 else []),
        *([] if "joints" in _missing(trajectory) else ["joint"]),
    ]


def _check(trajectory: Any) -> None:
    """Raise a ValueError for what is no recording."""
    if not isinstance(trajectory, Trajectory):
        raise ValueError(f"trajectory must be a Trajectory, as of nsdyn.simulate or load, got {trajectory!r}")


def _missing(trajectory: Trajectory) -> dict[str, tuple[str, ...]]:
    """Return the names of data that a recording does not have, with the kinds that need them."""
    joints = any(a["sizes"] for a in trajectory.scene["articulations"])
    return ({} if joints else {"joints": OF_JOINTS}) | ({} if trajectory.has_contacts else {"contacts": OF_CONTACTS})


def _rows(table: Table, key: Any) -> dict[str, Table]:
    """Return the rows of the table for every name in `key`."""
    names, which = np.unique(np.asarray(key, dtype=str), return_inverse=True)
    parts = np.split(np.argsort(which, kind="stable"), np.cumsum(np.bincount(which)))
    return {name: table[part] for name, part in zip(names.tolist(), parts, strict=False)}


def _most(table: Table, key: Any, *columns: str, size: Callable[[Array], Any] = np.max) -> set[str]:
    """Return names in `key` with their own look: all, or of many those with the largest `size` of the columns."""
    rows = _rows(table.select(*columns), key)
    sizes = {n: max(float(size(np.nan_to_num(some[c]))) for c in columns) for n, some in rows.items()}
    return set(sorted(sizes, key=lambda n: -sizes[n])[: NAMED if len(sizes) > SHOWN else SHOWN])


def _shown(numbers: dict[str, int], most: set[str]) -> Shown:
    """Return label and look of every curve; curves without their own look are drawn below the others.

    If several names all begin with the same robot, the name of the robot is left out.
    """
    looks = panels.looks({n: k for n, k in numbers.items() if n in most})
    others = f"and {counted(len(numbers) - len(looks), 'other')}", {"color": OTHERS, "lw": 0.6, "zorder": 1}
    robots = {side.rpartition("/")[0] for n in numbers for side in n.split(SIDES)}
    common = f"{robots.pop()}/" if len(robots) == 1 < len(numbers) else ""
    named = {n: (n.replace(common, "") if common else n, {"lw": 1.2, **own}) for n, own in looks.items()}
    return named | {n: others for n in numbers if n not in named}


def _curves(table: Table, shown: Shown, key: Any, column: str) -> list[Curve]:
    """Return the curves of a column over time, one for every name in the table."""
    rows = _rows(table.select("t", column), key)
    return [Curve(label, rows[n]["t"], rows[n][column], own) for n, (label, own) in shown.items() if n in rows]


Named = tuple[Table, dict[str, int], Any]
"""A table, the number of each name in it, and the name in every row."""


def _columns(found: Named, shown: dict[str, str], scale: float, cut: bool = False) -> list[Panel]:
    """Return panels of columns by their labels; the names with the largest values of the first have their own look."""
    table, numbers, key = found
    looks = _shown(numbers, _most(table, key, next(iter(shown.values()))))
    return [Panel(label, _curves(table, looks, key, column), scale, cut=cut) for label, column in shown.items()]


def _bodies(trajectory: Trajectory, name: str) -> Named:
    """Return the table of some bodies, numbered by their frames, by which the page colours them."""
    table, frames = tabulated(trajectory, "bodies", name), trajectory.scene["frames"]
    links = {link["name"]: link["frame"] for link in trajectory.scene["links"]}
    names = dict.fromkeys(table["body"].tolist())
    return table, {body: links[body] if body in links else frames.index(body) for body in names}, table["body"]


def _position(trajectory: Trajectory, name: str) -> list[Panel]:
    table, numbers, key = _bodies(trajectory, name)
    shown = _shown(numbers, _most(table, key, *"xyz", size=np.ptp))
    moved = {axis: _curves(table, shown, key, axis) for axis in "xyz"}
    spans = {axis: max(float(np.ptp(c.y)) for c in curves) for axis, curves in moved.items()}
    scale = max(*spans.values(), _fallen(trajectory)[0])
    out = {axis: Panel(f"{axis} [m]", curves, scale, zero=False) for axis, curves in moved.items()}
    # If nothing moves, show the axis along which the bodies are farthest apart.
    apart = max(out, key=lambda axis: float(np.ptp(out[axis].range())))
    return [out[axis] for axis in "xyz" if spans[axis] > panels.NOISE * scale] or [out[apart]]


def _fallen(trajectory: Trajectory) -> tuple[float, float]:
    """Return distance and speed of a free fall over the recording, m, m/s: on this scale, round-off looks like 0."""
    g, t = float(np.linalg.norm(trajectory.scene["gravity"])), float(trajectory.t[-1])
    return 0.5 * g * t * t, g * t


def _speed(trajectory: Trajectory, name: str) -> list[Panel]:
    return _columns(_bodies(trajectory, name), {"speed [m/s]": "speed"}, _fallen(trajectory)[1])


def _pairs(trajectory: Trajectory, name: str) -> Named:
    """Return the table of some pairs, numbered in its order."""
    table = tabulated(trajectory, "pairs", name)
    key = np.array([f"{a}{SIDES}{b}" for a, b in zip(table["body1"], table["body2"], strict=True)], dtype=object)
    return table, _numbered(key), key


def _numbered(key: Any) -> dict[str, int]:
    """Number names by their first appearance."""
    return {n: k for k, n in enumerate(dict.fromkeys(key.tolist()))}


def _force(trajectory: Trajectory, name: str) -> list[Panel]:
    found, shown = _pairs(trajectory, name), {"normal force [N]": "normal_force", "friction [N]": "friction_force"}
    return _columns(found, shown, float(found[0]["normal_force"].max(initial=0.0)), cut=True)


def _slip(trajectory: Trajectory, name: str) -> list[Panel]:
    return _columns(_pairs(trajectory, name), {"slip [m/s]": "slip"}, _fallen(trajectory)[1])


def _gap(trajectory: Trajectory, name: str) -> list[Panel]:
    far = np.abs(trajectory.q[:, : 7 * trajectory.scene["free"]].reshape(-1, 7)[:, :3]).max(initial=0.0)
    return _columns(_pairs(trajectory, name), {"gap [m]": "gap"}, float(far))


def _joint(trajectory: Trajectory, name: str) -> list[Panel]:
    tables, shown = _joints(trajectory, name)
    out = []
    for unit, (table, key) in tables.items():
        place, rate, effort = (_curves(table, shown, key, c) for c in ("position", "velocity", "torque"))
        word, drive = UNITS[unit]
        far, fast = _fallen(trajectory) if unit == "m" else (1.0, 1.0)
        out += [
            Panel(f"{word} [{unit}]", place, far, zero=False),
            Panel(f"velocity [{unit}/s]", rate, fast),
            Panel(drive, effort),
        ]
    return out or [Panel("joints", [], note="no joint has an angle or a position")]


def _joints(trajectory: Trajectory, name: str) -> tuple[dict[str, tuple[Table, Any]], Shown]:
    """Return coordinates by unit, with the name in every row, and their looks: the colour of the carried body."""
    table = tabulated(trajectory, "joints", name)
    pairs = zip(table["joint"].tolist(), table["coordinate"].tolist(), strict=True)
    key = np.array([f"{joint} {axis}".rstrip() for joint, axis in pairs], dtype=object)
    tables = {unit: (table[own], key[own]) for unit in UNITS if (own := table["unit"] == unit).any()}
    most = {n for one in tables.values() for n in _most(*one, "position", size=np.ptp)}
    frames, carrier = trajectory.scene["frames"], dict(zip(key.tolist(), table["joint"].tolist(), strict=True))
    numbers = {
        n: frames.index(carrier[n]) if carrier[n] in frames else len(frames) + k
        for n, k in _numbered(key[np.isin(table["unit"], list(UNITS))]).items()
    }
    return tables, _shown(numbers, most)


def _phase(trajectory: Trajectory, name: str) -> list[Panel]:
    tables, shown = _joints(trajectory, name)
    out = []
    for unit, (table, key) in tables.items():
        places, rates = (_curves(table, shown, key, c) for c in ("position", "velocity"))
        curves = [Curve(rate.label, place.y, rate.y, rate.look) for place, rate in zip(places, rates, strict=True)]
        out.append(Panel(f"velocity [{unit}/s]", curves, xlabel=f"{UNITS[unit][0]} [{unit}]"))
    return out or [Panel("joints", [], note="no joint has an angle or a position")]


def _energy(trajectory: Trajectory, name: str) -> list[Panel]:
    t, least = trajectory.t, NEGLIGIBLE * trajectory.largest_energy
    found = ledger(trajectory, np.arange(t.size))
    areas = [
        Curve(
            words + (", from its least" if name == "potential" else ""),
            t,
            found[name] if name in ENERGIES else -found[name],
            {"color": colour},
        )
        for name, (words, colour, _) in LAYERS.items()
        if name == "kinetic" or np.abs(found[name]).max() > least
    ]
    total = np.sum([c.y for c in areas], axis=0)
    curves = [Curve("sum", t, total, {"color": "k", "lw": 1.2})]
    ought = total[0] + found["put_in"]
    if np.abs(total - ought).max() > SAME * max(total.max(), least):
        curves.append(Curve("sum, as it ought to be", t, ought, {"color": "k", "ls": "--", "lw": 0.8}))
    note = f"at rest: nothing of {with_unit(trajectory.largest_energy, 'J')} moves"
    return [Panel("energy [J]", curves, trajectory.largest_energy, areas=areas, note=note)]


def _power(trajectory: Trajectory, name: str) -> list[Panel]:
    table, numbers, key = _pairs(trajectory, name)
    taken = {n: -rows["work"] / trajectory.dt for n, rows in _rows(table.select("work"), key).items()}
    order = sorted(numbers, key=lambda n: -float(np.abs(taken[n]).sum()))
    looks = panels.looks({n: numbers[n] for n in order[:NAMED]})
    layers = [
        Curve(n, trajectory.t_steps, np.maximum(taken[n], 0.0), {"color": own["color"]}) for n, own in looks.items()
    ]
    if rest := order[NAMED:]:
        power = np.maximum(np.sum([taken[n] for n in rest], axis=0), 0.0)
        layers.append(Curve(f"and {counted(len(rest), 'other')}", trajectory.t_steps, power, {"color": OTHERS}))
    scale = trajectory.largest_energy / float(trajectory.t[-1] or 1.0)
    return [Panel("dissipated power [W]", [], scale, cut=True, areas=layers)]


def _friction(trajectory: Trajectory, name: str) -> list[Panel]:
    """Draw friction over its limit; impacts beyond the axes are marked where their ray from 0 leaves the panel.

    On the scale of impacts, contacts that carry a load would be a single dot.
    """
    table = tabulated(trajectory, "contacts", name)
    most, drag = (table["mu"] * table["impulse_N"] / trajectory.dt, table["impulse_T"] / trajectory.dt)
    pushes = most > 0.0
    largest = float(most.max(initial=0.0))
    top = min(largest, LONGEST * float(np.quantile(most[pushes], panels.USUAL))) if pushes.any() else 0.0
    beyond, curves = most > top, []
    for state, colour in (("stick", LEDGER["kinetic"]), ("slip", LEDGER["friction"])):
        some = (table["state"] == state) & pushes & ~beyond
        if some.any():
            look = {"color": colour, "ls": "", "marker": ".", "ms": 5, "mew": 0.0, "rasterized": True}
            curves.append(Curve(f"{state} ({some.sum()})", most[some], drag[some], look))
    if beyond.any():
        label = f"stronger ({beyond.sum()}), up to {with_unit(largest, 'N')}"
        look = {"color": LEDGER["normal"], "ls": "", "marker": ">", "ms": 4, "clip_on": False}
        part = top / most[beyond]
        curves.append(Curve(label, part * most[beyond], part * drag[beyond], look))
    edge = np.array([0.0, top])
    curves.append(Curve("Coulomb's limit", edge, edge, {"color": "k", "lw": 0.8}))
    return [Panel("friction [N]", curves, top, xlabel="μ × normal force [N]")]


def _certificate(trajectory: Trajectory, name: str) -> list[Panel]:
    found = (
        ("bound [√J]", trajectory.gauss.bound, "normal"),
        ("residual [m/s]", trajectory.solver.residual, "kinetic"),
    )
    return [Panel("error of the step", [_dots(trajectory, *one) for one in found], log="y")]


def _penetration(trajectory: Trajectory, name: str) -> list[Panel]:
    table, depth = tabulated(trajectory, "contacts", name), np.zeros(trajectory.steps)
    np.maximum.at(depth, table["step"] - 1, -table["gap"])
    return [Panel("penetration [m]", [_dots(trajectory, "deepest contact", depth, "damping")], log="y")]


def _dots(trajectory: Trajectory, label: str, values: Array, colour: str) -> Curve:
    """Return a curve of values per step as dots: values may vanish in the next step, and lines would look like a comb.

    Values below the axis are left out, so that they do not stretch it.
    """
    look = {"color": LEDGER[colour], "ls": "", "marker": ".", "ms": 3}
    return Curve(label, trajectory.t_steps, np.where(values > panels.FLOOR, values, np.nan), look)


KINDS: dict[str, Callable[[Trajectory, str], list[Panel]]] = {
    "position": _position,
    "speed": _speed,
    "force": _force,
    "slip": _slip,
    "gap": _gap,
    "joint": _joint,
    "phase": _phase,
    "energy": _energy,
    "power": _power,
    "friction": _friction,
    "certificate": _certificate,
    "penetration": _penetration,
}
"""Kinds that `draw` draws."""
