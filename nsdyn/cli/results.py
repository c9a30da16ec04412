"""`nsdyn energy`, `nsdyn contacts` and `nsdyn view`: what recordings show."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from nsdyn.cli.output import check_files, ledger, plot_to, say, say_json, write_columns

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.arrays import Array

__all__ = ["show_contacts", "show_energy", "write_page"]


def show_energy(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn energy``."""
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools import files

    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    if arguments.plot:
        plot_to(arguments.plot, trajectory.plot_energy)
    if arguments.by:
        return _energy_by(arguments, trajectory)
    if arguments.csv:
        energy = trajectory.energy
        with files.writing(arguments.csv, files.TABLE) as part:
            write_columns(trajectory, {name: getattr(energy, name) for name in energy.names}, part)
    if arguments.json:
        say_json(arguments, ledger(trajectory))
    else:
        say(arguments, trajectory.energy_table())
    return 0


def _energy_by(arguments: argparse.Namespace, trajectory: Trajectory) -> int:
    """Works by pair of bodies, or energies by body."""
    from nsdyn.recording import breakdown
    from nsdyn.tools import files

    pairs = arguments.by == "pair"
    series: dict[str, tuple[Array, Array]] = (
        {" | ".join(pair): works for pair, works in trajectory.pair_works().items()}
        if pairs
        else trajectory.body_energies()
    )
    words = ("normal", "friction") if pairs else ("kinetic", "potential")
    if arguments.csv:
        columns = {f"{name} {word}": v for name, both in series.items() for word, v in zip(words, both, strict=True)}
        with files.writing(arguments.csv, files.TABLE) as part:
            write_columns(trajectory, columns, part)
    if arguments.json:
        last = {name: dict(zip(words, both, strict=True)) for name, both in series.items()}
        say_json(arguments, {"by": arguments.by, "t": trajectory.t_steps if pairs else trajectory.t, "series": last})
    else:
        say(arguments, (breakdown.pair_table if pairs else breakdown.body_table)(trajectory))
    return 0


def show_contacts(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn contacts``."""
    import csv

    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools import files

    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    if not 1 <= abs(arguments.step) <= trajectory.steps:
        raise ValueError(f"--step must be one of 1 to {trajectory.steps}, or -1 back, got {arguments.step}")
    if arguments.csv:
        table = trajectory.contact_table()
        with files.writing(arguments.csv, files.TABLE) as part, open(part, "w", newline="") as file:
            sink = csv.writer(file)
            sink.writerow(table)
            sink.writerows(zip(*(table[name].tolist() for name in table), strict=True))
    say(arguments, trajectory.contacts(arguments.step))
    return 0


def write_page(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn view``."""
    from nsdyn.recording import pictures, viewer
    from nsdyn.recording.trajectory import Trajectory

    named = arguments.output or arguments.png or arguments.mp4
    if not named:
        arguments.output = Path(f"{arguments.recording.stem}.html")
    check_files(arguments)
    if arguments.at is not None and not arguments.png:
        raise ValueError("--at is the time of the picture: give --png FRAME.png too")
    if arguments.mp4:
        pictures.check_film()
    trajectory = Trajectory.load(arguments.recording)
    beside = Trajectory.load(arguments.beside) if arguments.beside else None
    options = {"fps": arguments.fps, "forces": arguments.forces, "beside": beside}
    with tempfile.TemporaryDirectory(prefix="nsdyn-") as folder:
        page = Path(folder) / "page.html"
        if arguments.png:
            at = trajectory.t[-1] if arguments.at is None else arguments.at
            viewer.write_html(trajectory, page, at=at, **options)
            pictures.screenshot(page, arguments.png)
        if arguments.mp4:
            viewer.write_html(trajectory, page, **options)
            pictures.film(page, arguments.mp4, arguments.fps)
    if arguments.output:
        viewer.write_html(trajectory, arguments.output, **options)
    if not named:
        say(arguments, arguments.output)
    return 0
