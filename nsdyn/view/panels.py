"""Panels of a figure: their contents and how they are drawn.

Legends are outside the panels, and round-off is not drawn at full scale. Panels with nothing but round-off are left out
if another panel has more to show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np

from nsdyn.dynamics.ledger import LAYERS
from nsdyn.tools.arrays import Array
from nsdyn.tools.units import with_unit
from nsdyn.view.solids import PALETTE

LEDGER = {name: colour for name, (_, colour, _) in LAYERS.items()}
"""Colours of energies and works."""

OTHERS = "#b9c2cb"
"""Colour of curves without their own colour."""

GREYS = {colour: grey for _, colour, grey in LAYERS.values()} | {OTHERS: "0.8"}
"""Greys in place of colours, for styles of matplotlib without colours."""

DASHES = "-", "--", ":", "-."
"""Line styles of curves of one colour, one after the other."""

TURN = 4.0
"""Length of a dash over its width, for curves that lie on each other."""

SAME, MOST = 5e-3, 0.9
"""Curves lie on each other if they differ by at most SAME of a panel's range for more than MOST of their time."""

NOISE = 1e-6
"""Fraction of a panel's scale below which a range is round-off or the solver's tolerance."""

FLOOR, LOST = 1e-12, 1e-11
"""Lowest value at which logarithmic axes begin, and value below which curves are left out, in the unit of the axis."""

ROWS, PILED, LETTER = 3, 6, 0.55
"""Most rows of a legend above its panels, most rows and panels together, and width of a letter over its font size."""

CROWD = 3
"""Number of panels above which the labels of axes are smaller."""

APART = 1.5
"""Smallest factor between ticks of a logarithmic axis whose ticks are at the values."""

PEAK, USUAL = 5.0, 0.9
"""Peaks of impacts, which a short step makes arbitrarily high, are cut at PEAK times the quantile USUAL."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve and its name in the legend, which curves may share; `look` has the keywords of `Axes.plot`."""

    label: str
    x: Array
    y: Array
    look: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Panel:
    """Contents of one pair of axes.

    Attributes
    ----------
    ylabel : str
        Label with a unit.
    curves : sequence of Curve
    scale : float
        Typical size of the quantity, in the unit of the curves; 0 to take it from the curves.
    zero : bool
        Whether the axis begins at, or includes, 0; values below `NOISE` of the scale then count as 0.
    cut : bool
        Whether peaks are cut.
    log : {"", "y", "xy"}
        Logarithmic axes.
    areas : sequence of Curve
        Curves drawn as stacked areas below `curves`.
    xlabel : str
    """

    ylabel: str
    curves: Sequence[Curve]
    scale: float = 0.0
    zero: bool = True
    cut: bool = False
    log: str = ""
    areas: Sequence[Curve] = ()
    xlabel: str = "t [s]"
    note: str = ""

    def range(self) -> tuple[float, float]:
        """Return the least and largest value, (0, 0) without values."""
        heights: Any = np.cumsum([c.y for c in self.areas], axis=0) if self.areas else []
        drawn = [c.y for c in self.curves if not self._lost(c)]
        values = np.concatenate([[0.0] if self.zero else [], *drawn, *heights])
        values = values[np.isfinite(values) & ((values > 0.0) | (not self.log))]
        return (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)

    def _lost(self, curve: Curve) -> bool:
        """Whether a logarithmic axis leaves out a curve."""
        return bool(self.log) and not (curve.y > LOST).any()

    @property
    def quiet(self) -> bool:
        """Whether the panel shows nothing but round-off."""
        low, high = self.range()
        return high == 0.0 if self.log else high - low <= self._noise

    @property
    def _noise(self) -> float:
        """Largest value that counts as round-off."""
        return LOST if self.log else NOISE * max(self.scale, *map(abs, self.range()))

    @property
    def _unit(self) -> str:
        return self.ylabel.partition("[")[2].rstrip("]")

    def draw(self, ax: Any) -> None:
        """Draw the panel on matplotlib axes."""
        if self.areas:
            colours = [_shade(c.look["color"]) for c in self.areas]
            ax.stackplot(
                self.areas[0].x,
                [c.y for c in self.areas],
                labels=[c.label for c in self.areas],
                colors=colours,
                edgecolor=colours,
                lw=0.6,
            )
        for c in self.curves:
            lost = self._lost(c)
            ax.plot(
                [] if lost else c.x,
                [] if lost else c.y,
                **_lone(c),
                label=f"{c.label}, below {LOST:g}" if lost else c.label,
            )
        ax.set_ylabel(self.ylabel)
        self._set_x(ax)
        if self.log and not self.quiet:
            ax.set(yscale="log")
        else:
            ax.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4), useMathText=True)
        ax.set_ylim(*self._limits())
        if self.quiet:
            self._say_quiet(ax)

    def take_turns(self, ax: Any) -> None:
        """Dash solid curves that lie on another nearly all the time in which they are not 0, so that all are seen."""
        if any(c.look.get("ls", "-") != "-" for c in self.curves):  # with many curves, dashes identify curves
            return
        low, high = self.range()
        near, piles = SAME * (min(high, self.top) - low), list[list[int]]()
        for k, c in ((k, c) for k, c in enumerate(self.curves) if "ls" in c.look):
            on = (pile for pile in piles if _lies_on(c, self.curves[pile[0]], near))
            if pile := next(on, None):
                pile.append(k)
            else:
                piles.append([k])
        for pile in piles:
            for turn, k in enumerate(pile[1:], 1):
                ax.lines[k].set_linestyle((TURN * (len(pile) - turn), (TURN, TURN * (len(pile) - 1))))

    def _set_x(self, ax: Any) -> None:
        if self.log == "xy":
            places = sorted({float(x) for c in self.curves for x in c.x})
            kept = [x for k, x in enumerate(places) if k == 0 or x > APART * places[k - 1]]
            ax.set(xscale="log", xlim=(places[0] / 1.1, 1.1 * places[-1]))
            ax.set_xticks([], minor=True)
            ax.set_xticks(kept, [f"{x:g}" for x in kept])
            return
        ax.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4), useMathText=True)
        if self.xlabel == "t [s]":
            ax.margins(x=0)
            ax.set_xlim(0.0, max((c.x[-1] for c in (*self.curves, *self.areas) if c.x.size), default=0.0) or 1.0)

    def _say_quiet(self, ax: Any) -> None:
        """Write that only round-off is seen, and keep only the tick 0, because other ticks would show round-off."""
        if self.zero:
            ax.set_yticks([0.0], ["0"])
        low, high = self.range()
        most = ""
        if self.log:
            most = f",\nless than {LOST:g} {self._unit}".rstrip()
        elif high > low:
            most = f",\nat most {with_unit(high - low, self._unit)}"
        words = self.note or (f"nothing but round-off{most}" if self.curves or self.areas else "nothing touches")
        ax.text(0.5, 0.7, words, transform=ax.transAxes, ha="center", va="center")

    def _limits(self) -> tuple[float, float]:
        """Return the limits of the axis: whole decades, the range with a margin, or the smallest range above noise."""
        low, high = self.range()
        if self.quiet and self.zero:
            return -0.1 * (self._noise or 1.0), self._noise or 1.0
        if self.log:
            low, high = max(low, FLOOR), max(high, 10 * FLOOR)
            return 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high))
        if self.quiet:
            room = 0.05 * (self._noise / NOISE or 1.0)
            return low - room, high + room
        if self.peak:
            high = self.top
        return low - 0.05 * (high - low) * (low < 0.0 or not self.areas), high + 0.05 * (high - low)

    @cached_property
    def top(self) -> float:
        """Value at which peaks are cut; infinite if they are not cut."""
        values = np.concatenate(
            [c.y for c in self.curves] or [np.atleast_1d(np.sum([c.y for c in self.areas], axis=0))]
        )
        values = values[values > NOISE * self.range()[1]]
        return PEAK * float(np.quantile(values, USUAL)) if self.cut and values.size else np.inf

    @property
    def peak(self) -> str:
        """Text about peaks that are cut, empty if none is cut."""
        most = self.range()[1]
        return f"peaks reach {with_unit(most, self._unit)}" if most > self.top and not self.quiet else ""


def _lies_on(curve: Curve, other: Curve, near: float) -> bool:
    """Whether two curves with the same times differ by at most `near` at nearly all times at which one is not 0."""
    if not np.array_equal(curve.x, other.x):
        return False
    some = np.maximum(np.abs(curve.y), np.abs(other.y)) > near
    return bool(some.any()) and bool(np.mean(np.abs(curve.y - other.y)[some] <= near) > MOST)


def _lone(curve: Curve) -> dict[str, Any]:
    """Return the look of a curve, with dots at single values between unknown ones, where a line shows nothing."""
    known = np.pad(np.isfinite(curve.y), 1)
    alone = np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:])
    shown = "marker" in curve.look or not alone.size
    own = curve.look | ({"color": _shade(curve.look["color"])} if "color" in curve.look else {})
    return own if shown else {"marker": ".", "markevery": alone, **own}


def _cycle() -> list[Any]:
    """Return the colours of curves: the page's colours of bodies, or the colours of a changed matplotlib style."""
    import matplotlib

    cycles = [params["axes.prop_cycle"] for params in (matplotlib.rcParams, matplotlib.rcParamsDefault)]
    own = cycles[0].by_key().get("color", []) if cycles[0] != cycles[1] else []
    return own or [tuple(part / 255 for part in colour) for colour in PALETTE]


def _shade(colour: Any) -> Any:
    """Return a colour, or its grey in grey styles; for black the text colour, as styles may have a dark background."""
    from matplotlib import rcParams
    from matplotlib.colors import to_rgb

    if colour == "k":
        return rcParams["text.color"]
    grey = all(len(set(to_rgb(one))) == 1 for one in _cycle())
    return GREYS.get(colour, colour) if grey else colour


def look(k: int) -> dict[str, Any]:
    """Return colour and dashes of the k-th curve: the page's colours of bodies, dashed from the seventh curve on."""
    colours = _cycle()
    return {"color": colours[k % len(colours)], "ls": DASHES[k // len(colours) % len(DASHES)]}


def looks(numbers: Mapping[str, int]) -> dict[str, dict[str, Any]]:
    """Return looks of curves by name, all different while possible: the look of its number, or the next free one.

    The numbers are those of the page's colours, so that a body keeps its colour from the page if possible.
    """
    own = dict[int, str]()
    for name, k in sorted(numbers.items(), key=lambda item: item[1]):
        own.setdefault(k % len(PALETTE), name)
    first, free = {name: k for k, name in own.items()}, (k for k in count() if k not in own)
    return {name: look(first[name] if name in first else next(free)) for name in numbers}


def draw(figure: Any, panels: Sequence[Panel]) -> Any:
    """Draw panels in a column on a matplotlib figure, with one legend beside them; return their axes."""
    shown = [panel for panel in panels if not panel.quiet] or panels[:1]
    same = len({panel.xlabel for panel in shown}) == 1
    axes = figure.subplots(len(shown), 1, sharex=same, squeeze=False)[:, 0]
    handles: dict[str, Any] = {}
    for ax, panel in zip(axes, shown, strict=True):
        panel.draw(ax)
        handles |= dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
        ax.set_title(panel.peak, loc="right", fontsize="small")
        if ax is axes[-1] or not same:
            ax.set_xlabel(panel.xlabel)
        if len(shown) > 1:
            ax.set_ylabel(panel.ylabel.replace(" [", "\n["), fontsize="small" if len(shown) > CROWD else None)
    figure.align_ylabels(axes)
    if len(handles) > 1 or any(panel.peak for panel in shown):
        _legend(figure, handles, min(ROWS, PILED - len(shown)))
    elif handles:
        axes[0].set_title(next(iter(handles)), loc="left", fontsize="small")
    for ax, panel in zip(axes, shown, strict=True):  # after the legend, which shows solid lines
        panel.take_turns(ax)
    return axes


def _legend(figure: Any, handles: Mapping[str, Any], rows: int) -> None:
    """Put the legend above the panels in at most `rows` rows, else to their right if there is room."""
    from matplotlib import font_manager  # slow import, needed for pictures only

    size = font_manager.FontProperties(size="small").get_size_in_points() / 72.0
    entries = [(4.0 + LETTER * len(label)) * size for label in handles]
    width, count = figure.bbox.width / figure.dpi, len(entries)
    columns = next(n for n in range(count, 0, -1) if n == 1 or sum(map(max, np.array_split(entries, n))) <= width)
    above = -(-count // columns) <= rows or max(entries) > 0.4 * width
    where = {"loc": "outside upper left", "ncols": columns} if above else {"loc": "outside right upper"}
    figure.legend(
        handles.values(), handles, frameon=False, fontsize="small", handlelength=1.6, columnspacing=1.4, **where
    )
