"""Output of all commands: printing of text or JSON, writing of tables and pictures, and checks of files beforehand."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.files import Kind


def one_line(message: object) -> str:
    """Return a message without its line breaks."""
    return " ".join(str(message).split())


Number = TypeVar("Number", int, float)

PICTURE_SIZE = 5.5, 3.5
"""Width and height of one picture, inches."""

OUTPUTS = (
    "Output files that exist are overwritten once the new ones are complete, but none of another kind. Links are "
    "followed, what is no regular file (a FIFO, a device) is written through, and - is stdout; the figures then go to "
    "stderr."
)


def say(arguments: argparse.Namespace, text: object) -> None:
    """Print results to stdout, or to stderr if an output file is stdout."""
    from nsdyn.tools import files

    taken = files.STDOUT in vars(arguments).values()
    print(text, file=sys.stderr if taken else sys.stdout)


def report(arguments: argparse.Namespace, figures: Any, words: object) -> None:
    """Print results in words, or with ``--json`` their figures as JSON."""
    say(arguments, json.dumps(plain(figures), indent=2) if arguments.json else words)


def seconds(time: float) -> str:
    """Return the text of a time given in s, in a suitable unit."""
    for factor, unit in ((1e6, "µs"), (1e3, "ms")):
        if factor * time < 999.5:
            return f"{factor * time:.3g} {unit}"
    return f"{time:.3g} s" if time < 999.5 else f"{time:.0f} s"


def plain(value: Any) -> Any:
    """Return a value as JSON has it: lists for arrays, text for paths, null for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def sides(size: str, number: type[Number], what: str) -> tuple[Number, Number]:
    """Return width and height of ``--size``, ``WIDTHxHEIGHT``; else a ValueError says that they must be `what`."""
    try:
        width, height = map(number, size.split("x"))
    except ValueError:
        raise ValueError(f"--size must be WIDTHxHEIGHT in {what}, got {size}") from None
    return width, height


def add_input(parser: argparse.ArgumentParser, name: str, **options: Any) -> None:
    """Add an argument for the path of a file to read."""
    read = parser.add_argument(name, type=Path, **options).dest
    parser.set_defaults(inputs=(*(parser.get_default("inputs") or ()), read))


def add_output(parser: argparse._ActionsContainer, *names: str, kind: Kind, **options: Any) -> None:
    """Add an option for the path of a file to write, of a given kind."""
    written = parser.add_argument(*names, type=Path, **options).dest
    parser.set_defaults(outputs={**(parser.get_default("outputs") or {}), written: kind})


def add_made(parser: argparse.ArgumentParser, kind: Kind, ending: str, what: str) -> None:
    """Add the option for the one file that a command makes of a recording."""
    told = f"{what} (default: named after the recording, in this folder)"
    add_output(parser, "-o", "--output", kind=kind, metavar=f"RUN.{ending}", help=told)


def check_files(arguments: argparse.Namespace) -> None:
    """Raise a ValueError, before any work, for missing files to read and for files that cannot all be written."""
    from nsdyn.tools import files

    given = vars(arguments)
    found = (given[name] for name in given.get("inputs", ()))
    read = [path for one in found if one for path in (one if isinstance(one, list) else [one])]
    for path in read:
        if not os.path.exists(path):
            raise ValueError(f"no such file: {path}")
        if os.path.isdir(path):
            raise ValueError(f"cannot read {path}: it is a folder")
    taken = {files.resolved(path): "it is read" for path in read}
    for name, kind in given.get("outputs", {}).items():
        if path := given[name]:
            if path == files.STDOUT or not files.is_special(path):
                if why := taken.get(where := files.resolved(path)):
                    raise ValueError(f"cannot write {path}: {why}")
                taken[where] = "it is named twice"
            files.check_writable(path, kind)


def plot_to(path: Path, *draw: Callable[[Any], Any]) -> None:
    """Write a picture of matplotlib axes side by side, on each of which one `draw` draws."""

    def panels(figure: Any) -> None:
        for axes, panel in zip(figure.subplots(1, len(draw), squeeze=False)[0], draw, strict=True):
            panel(axes)

    picture(path, panels, (3 + 5 * len(draw), 5))


def ledger(trajectory: Trajectory) -> dict[str, Any]:
    """Return the energy ledger of a recording and its worst figures as JSON values."""
    shares = {
        name: {"total": total, "most": most, "share": most / trajectory.at_play if most else 0.0}
        for name, (total, most) in trajectory.shares().items()
    }
    return {
        "ledger": trajectory.ledger(),
        "at_play": trajectory.at_play,
        "at_rest": trajectory.at_rest,
        "shares": shares,
        "worst": trajectory.worst(),
    }


def header(name: str, units: Mapping[str, str]) -> str:
    """Return the header of a column, with its unit if it has one."""
    return f"{name} [{units[name]}]" if name in units else name


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Return a text table of some columns; missing values are dashes."""
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    return "\n".join("  ".join(map(str.rjust, line, widths)) for line in [columns, *cells])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    from nsdyn.scene.settings import as_text

    return f"{value:.6g}" if isinstance(value, float) else as_text(value)


SMALLEST = 0.7
"""Smallest factor by which letters of a label may shrink to make room."""


def picture(path: Path, draw: Callable[[Any], Any], size: tuple[float, float], dpi: int = 200) -> None:
    """Write a picture that `draw` draws on a matplotlib figure of `size` in inches; ValueError if it lacks room."""
    from matplotlib.figure import Figure  # needs no display, unlike pyplot

    from nsdyn.tools import files

    figure = Figure(figsize=size, layout="constrained")
    draw(figure)
    room = "{} leave no room for curves in {:.0f} by {:.0f} mm: a larger picture, or fewer {}"
    with files.writing(path, files.PICTURE) as part, warnings.catch_warnings():
        warnings.filterwarnings("error", "constrained_layout not applied")
        try:
            figure.draw_without_rendering()
            if not all(map(_fit_label, figure.axes)):
                raise ValueError(room.format("labels", *(25.4 * side for side in size), "kinds"))
            figure.savefig(part, format=path.suffix.removeprefix(".") or "png", dpi=dpi)
        except UserWarning:
            raise ValueError(room.format("names", *(25.4 * side for side in size), "of them")) from None


def _fit_label(ax: Any) -> bool:
    """Shrink the letters of an axis label until it is no longer than the axis; return whether they stay legible."""
    label = ax.yaxis.label
    part = min(1.0, float(ax.bbox.height / (label.get_window_extent().height or 1.0)))
    label.set_fontsize(part * label.get_fontsize())
    return part > SMALLEST
