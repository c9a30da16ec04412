"""`nsdyn plot`: pictures with matplotlib."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from nsdyn.cli.output import add_input, add_made, check_files, picture, say, sides
from nsdyn.tools.files import PICTURE

KINDS = "position speed force slip gap joint phase energy power friction certificate penetration".split()
"""Kinds of plots of `nsdyn.view.plots`, repeated here so that the help does not load that module."""

LEAST = 40.0
"""Smallest side of a picture, mm: smaller pictures have room for labels only."""

SMALL = 89.0
"""Width of a column of a journal, mm. If the smaller side of a plot is at most this, letters have 8 points, not 10."""


def add_plot(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``nsdyn plot``."""
    add_input(parser, "recording", metavar="RUN.h5")
    add_made(parser, PICTURE, "png", "picture, png, pdf or svg")
    parser.add_argument(
        "--kind",
        action="append",
        choices=KINDS,
        help="what to draw; may be repeated (default: energy, speed, force and joint, as far as there are such)",
    )
    parser.add_argument(
        "--name", metavar="PATTERN", default="*", help="bodies, pairs or joints by name, or as 'robot/*' (default: all)"
    )
    parser.add_argument(
        "--size", metavar="WxH", help="of the picture in mm, such as 85x60 (default: 140x90 of each kind)"
    )
    parser.add_argument(
        "--style", metavar="STYLE", help="of matplotlib: a name, such as grayscale, or a .mplstyle file"
    )


def draw(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn plot``; return its exit code."""
    from matplotlib import style

    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.view import plots

    path = arguments.output = arguments.output or Path(f"{arguments.recording.stem}.png")
    size = sides(arguments.size, float, "mm, such as 85x60") if arguments.size else None
    if size and not all(LEAST <= side <= 2000.0 for side in size):
        raise ValueError(f"--size must be two lengths of {LEAST:g} to 2000 mm, got {arguments.size}")
    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    kinds = arguments.kind or plots.usual(trajectory)
    columns = math.ceil(math.sqrt(len(kinds)))
    rows = [kinds[first : first + columns] for first in range(0, len(kinds), columns)]

    def fill(figure: Any) -> None:
        for part, row in zip(figure.subfigures(len(rows), 1, squeeze=False)[:, 0], rows, strict=True):
            for cell, kind in zip(part.subfigures(1, len(row), squeeze=False)[0], row, strict=True):
                plots.draw(trajectory, kind, arguments.name, cell)

    size = size or (140.0 * columns, 90.0 * len(rows))
    letters = 10.0 if min(size[0] / columns, size[1] / len(rows)) > SMALL else 8.0
    try:
        with style.context(["default", {"font.size": letters}, arguments.style or {}]):
            picture(path, fill, (size[0] / 25.4, size[1] / 25.4))
    except OSError as failure:
        if arguments.style and arguments.style in str(failure):
            raise ValueError(f"--style must be a style of matplotlib or a file of one, got {arguments.style}") from None
        raise
    say(arguments, path)
    return 0
