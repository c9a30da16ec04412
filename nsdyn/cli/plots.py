"""`nsdyn plot`: pictures of a recording."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nsdyn.cli.output import add_input, add_output, check_files, picture, say
from nsdyn.tools.files import PICTURE

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["KINDS", "add_plot", "draw"]

KINDS = "energy", "dissipation", "friction", "certificate", "penetration"


def add_plot(parser: argparse.ArgumentParser) -> None:
    """The options of ``nsdyn plot``."""
    add_input(parser, "recording", metavar="RUN.h5")
    add_output(
        parser, "-o", "--output", kind=PICTURE, metavar="P.png",
        help="picture (png, pdf or svg; default: named after the recording, in this folder)",
    )  # fmt: skip
    parser.add_argument(
        "--kind", action="append", choices=KINDS, help="what to draw; may be repeated (default: all the recording has)"
    )
    parser.add_argument(
        "--pair", nargs=2, action="append", default=[], metavar=("A", "B"),
        help="draw gap, normal velocity and normal impulse of two bodies; may be repeated",
    )  # fmt: skip


def draw(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn plot``."""
    from nsdyn.recording.trajectory import Trajectory

    path = arguments.output = arguments.output or Path(f"{arguments.recording.stem}.png")
    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    panels = _panels(trajectory, arguments.kind, arguments.pair)
    columns = min(3, len(panels))
    rows = math.ceil(len(panels) / columns)

    def fill(figure: Any) -> None:
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, panel in zip(axes, panels, strict=False):
            panel(ax=ax)
        for ax in axes[len(panels) :]:
            ax.remove()

    picture(path, fill, (5.5 * columns, 4.0 * rows), 120)
    say(arguments, path)
    return 0


def _panels(trajectory: Trajectory, kinds: list[str] | None, pairs: list[list[str]]) -> list[Callable[..., Any]]:
    """What draws each panel."""
    from nsdyn.recording import plots

    drawn = {"energy": trajectory.plot_energy}
    drawn |= {name: partial(getattr(plots, name), trajectory) for name in KINDS[1:]}
    if kinds is None:
        kinds = list(KINDS) if not pairs else []
        if not trajectory.has_contacts or trajectory.every > 1:
            kinds = [kind for kind in kinds if kind != "dissipation"]
        if not trajectory.has_contacts:
            kinds = [kind for kind in kinds if kind not in ("friction", "penetration")]
    out = [drawn[kind] for kind in kinds]
    return out + [partial(plots.pair, trajectory, a, b, quantity) for a, b in pairs for quantity in plots.QUANTITIES]
