"""`nsdyn energy`, `nsdyn view` and the commands that print tables of recordings."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from nsdyn.cli.output import PICTURE_SIZE, add_input, add_output, check_files, ledger, picture, report, say
from nsdyn.tools.files import PARQUET, TABLE

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.arrays import Array


def show_energy(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn energy``; return its exit code."""
    from nsdyn.recording.trajectory import Trajectory

    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    if arguments.plot:
        from nsdyn.view import plots

        picture(arguments.plot, lambda figure: plots.draw(trajectory, "energy", figure=figure), PICTURE_SIZE)
    if arguments.by:
        return _energy_by(arguments, trajectory)
    if arguments.csv:
        trajectory.table("energy").to_csv(arguments.csv)
    report(arguments, ledger(trajectory), trajectory.energy_table())
    return 0


def _energy_by(arguments: argparse.Namespace, trajectory: Trajectory) -> int:
    """Print works by pair of bodies, or energies by body; return the exit code."""
    import numpy as np

    from nsdyn.recording import breakdown
    from nsdyn.tools.table import Table

    pairs = arguments.by == "pair"
    series: dict[str, tuple[Array, Array]] = (
        {" | ".join(pair): works for pair, works in trajectory.pair_works().items()}
        if pairs
        else trajectory.body_energies()
    )
    words = ("normal", "friction") if pairs else ("kinetic", "potential")
    told = {name: dict(zip(words, both, strict=True)) for name, both in series.items()}
    if arguments.csv:
        first = [0.0] if pairs else []  # a work belongs to the step that ends at t; no step ends at the first time
        columns = {f"{name} {word}": np.append(first, v) for name, both in told.items() for word, v in both.items()}
        Table("energy", {"t": trajectory.t} | columns, dict.fromkeys(columns, "J") | {"t": "s"}).to_csv(arguments.csv)
    figures = {"by": arguments.by, "t": trajectory.t_steps if pairs else trajectory.t, "series": told}
    report(arguments, figures, (breakdown.pair_table if pairs else breakdown.body_table)(trajectory))
    return 0


SHOWN = {
    "bodies": "body x y z v_x v_y v_z speed force_x force_y force_z",
    "joints": "joint coordinate unit position velocity torque limit friction "
    "reaction_force_x reaction_force_y reaction_force_z",
    "pairs": "body1 body2 state gap slip normal_force friction_force",
    "contacts": "body1 body2 state gap u_N u_T impulse_N impulse_T mu",
}
"""Columns that are printed, by kind of table."""


def add_table(parser: argparse.ArgumentParser) -> None:
    """Add the options of the commands that show a table."""
    add_input(parser, "recording", metavar="RUN.h5")
    parser.add_argument(
        "--name", metavar="PATTERN", default="*", help="which, by name, or as 'robot/*knee*' (default: all)"
    )
    parser.add_argument("--step", type=int, default=-1, metavar="K", help="step to print (default: the last)")
    add_output(parser, "--csv", kind=TABLE, metavar="T.csv", help="all steps and all columns, for spreadsheets")
    add_output(parser, "--parquet", kind=PARQUET, metavar="T.parquet", help="the same for data frames")


def show_table(kind: str, arguments: argparse.Namespace) -> int:
    """Run ``nsdyn bodies``, ``joints``, ``pairs`` and ``contacts``; return its exit code."""
    from nsdyn.recording.tabulated import tabulated
    from nsdyn.recording.trajectory import Trajectory

    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    if not trajectory.steps:
        raise ValueError(f"{arguments.recording} has no steps")
    if not 1 <= abs(arguments.step) <= trajectory.steps:
        raise ValueError(f"--step must be one of 1 to {trajectory.steps}, or -1 back, got {arguments.step}")
    k = arguments.step if arguments.step > 0 else trajectory.steps + 1 + arguments.step
    found = tabulated(trajectory, kind, arguments.name, k)
    if arguments.csv or arguments.parquet:
        table = trajectory.table(kind, arguments.name)
        if arguments.csv:
            table.to_csv(arguments.csv)
        if arguments.parquet:
            table.to_parquet(arguments.parquet)
    say(arguments, found.select(*SHOWN[kind].split()).text())
    say(arguments, f"step {k}, which ends at t = {trajectory.t[k]:g} s; --csv and --parquet have all steps and columns")
    return 0


def write_page(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn view``; return its exit code."""
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.view import pictures, viewer

    named = arguments.output or arguments.png
    if not named:
        arguments.output = Path(f"{arguments.recording.stem}.html")
    check_files(arguments)
    if arguments.at is not None and not arguments.png:
        raise ValueError("--at is the time of the picture: give --png FRAME.png too")
    trajectory = Trajectory.load(arguments.recording)
    beside = [Trajectory.load(path) for path in arguments.beside]
    options = {"fps": arguments.fps, "forces": arguments.forces, "beside": beside}
    with tempfile.TemporaryDirectory(prefix="nsdyn-") as folder:
        page = Path(folder) / "page.html"
        if arguments.png:
            at = trajectory.t[-1] if arguments.at is None else arguments.at
            viewer.write_html(trajectory, page, at=at, **options)
            pictures.screenshot(page, arguments.png)
    if arguments.output:
        viewer.write_html(trajectory, arguments.output, **options)
    if not named:
        say(arguments, arguments.output)
    return 0
