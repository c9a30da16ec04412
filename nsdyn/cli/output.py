"""What all commands print and write: text or JSON, and checks of what is to be written."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.arrays import Array

__all__ = [
    "OUTPUTS",
    "PLOTS",
    "add_json",
    "check_outputs",
    "check_picture",
    "ledger",
    "one_line",
    "picture",
    "plain",
    "plot_to",
    "say",
    "say_found",
    "say_json",
    "table",
    "write_columns",
    "write_rows",
]


def one_line(message: object) -> str:
    """A message without its line breaks."""
    return " ".join(str(message).split())


OUTPUTS = (
    "Output files that exist are overwritten once the new ones are complete. Links are followed, what is no regular "
    "file (a FIFO, a device) is written through, and - is stdout; the figures then go to stderr."
)


def add_json(parser: argparse.ArgumentParser) -> None:
    """The option ``--json``."""
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def say(arguments: argparse.Namespace, text: object) -> None:
    """Print figures; where an output takes stdout they go to stderr."""
    from nsdyn.tools import files

    taken = files.STDOUT in vars(arguments).values()
    print(text, file=sys.stderr if taken else sys.stdout)


def say_json(arguments: argparse.Namespace, figures: Any) -> None:
    """Print figures as JSON."""
    say(arguments, json.dumps(plain(figures), indent=2))


def say_found(arguments: argparse.Namespace, found: Any) -> None:
    """Print what a study found, as JSON where that is asked for."""
    if arguments.json:
        say_json(arguments, found.as_dict())
    else:
        say(arguments, found)


def plain(value: Any) -> Any:
    """Value in JSON's terms: lists for arrays, text for paths, null for what is not finite."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def check_outputs(source: Path | None, *paths: Path | None) -> None:
    """Refuse paths that cannot all be written beside the `source` that is read, before any work is done."""
    from nsdyn.tools import files

    outputs = [path for path in paths if path]
    for path in outputs:
        files.check_writable(path)
    named = [files.resolved(path) for path in outputs if path == files.STDOUT or not files.is_special(path)]
    if source is not None and (where := files.resolved(source)) in named:
        raise ValueError(f"cannot write {outputs[named.index(where)]}: it is read")
    if len(set(named)) < len(named):
        raise ValueError(f"cannot write {outputs[-1]}: it is named twice")


PLOTS = "png", "pdf", "svg"


def check_picture(path: Path | None, *kinds: str, what: str = "picture") -> None:
    """Refuse the name of a picture, or what it is, of another kind."""
    if path and path.suffix and path.suffix[1:].lower() not in kinds:
        raise ValueError(f"cannot write {path}: a {what} must be {' or '.join(kinds)}, got {path.suffix}")


def plot_to(path: Path, *draw: Callable[[Any], Any]) -> None:
    """Picture of what each `draw` draws on matplotlib axes, side by side."""

    def panels(figure: Any) -> None:
        for axes, panel in zip(figure.subplots(1, len(draw), squeeze=False)[0], draw, strict=True):
            panel(axes)

    picture(path, panels, (3 + 5 * len(draw), 5), 150)


def write_columns(trajectory: Trajectory, series: Mapping[str, Array], path: Path) -> None:
    """Write energies (n + 1,) and works (n,) of a recording, step by step, as a table."""
    import numpy as np

    columns = {"t [s]": trajectory.t}
    for name, values in series.items():
        # A work belongs to the step that ends at t; none ends at the first time.
        columns[f"{name} [J]"] = values if values.size == trajectory.t.size else np.concatenate([[0.0], values])
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=",".join(columns), comments="")


def ledger(trajectory: Trajectory) -> dict[str, Any]:
    """The energy ledger of a recording and its worst figures, as JSON has them."""
    shares = {
        name: {"total": total, "most": most, "share": most / trajectory.at_play if most else 0.0}
        for name, (total, most) in trajectory.shares().items()
    }
    return {
        "ledger": trajectory.ledger(),
        "at_play": trajectory.at_play,
        "shares": shares,
        "worst": trajectory.worst(),
    }


def write_rows(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], path: Path) -> None:
    """Write rows as a CSV file; what a row lacks is empty."""
    import csv

    from nsdyn.tools.files import writing

    with writing(path) as part, open(part, "w", newline="") as file:
        sink = csv.DictWriter(file, columns)
        sink.writeheader()
        sink.writerows(rows)


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Text table of some columns; what a row lacks is a dash."""
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    return "\n".join("  ".join(map(str.rjust, line, widths)) for line in [columns, *cells])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    from nsdyn.scene.settings import as_text

    return f"{value:.6g}" if isinstance(value, float) else as_text(value)


def picture(path: Path, draw: Callable[[Any], Any], size: tuple[float, float], dpi: int) -> None:
    """Picture of what `draw` draws on a matplotlib figure of `size` in inches."""
    from matplotlib.figure import Figure  # needs no display, unlike pyplot

    from nsdyn.tools.files import writing

    figure = Figure(figsize=size, layout="constrained")
    draw(figure)
    with writing(path) as part:
        figure.savefig(part, format=path.suffix.removeprefix(".") or "png", dpi=dpi)
