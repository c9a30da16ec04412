"""`nsdyn energy`, `nsdyn contacts` and `nsdyn view`: what recordings show."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from nsdyn.cli.output import PLOTS, check_outputs, check_picture, ledger, plot_to, say, say_json, write_columns

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.arrays import Array

__all__ = ["show_contacts", "show_energy", "write_page"]


def show_energy(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn energy``."""
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.files import writing

    check_outputs(arguments.recording, arguments.plot, arguments.csv)
    check_picture(arguments.plot, *PLOTS)
    trajectory = Trajectory.load(arguments.recording)
    if arguments.plot:
        plot_to(arguments.plot, trajectory.plot_energy)
    if arguments.by:
        return _energy_by(arguments, trajectory)
    if arguments.csv:
        energy = trajectory.energy
        with writing(arguments.csv) as part:
            write_columns(trajectory, {name: getattr(energy, name) for name in energy.names}, part)
    if arguments.json:
        say_json(arguments, ledger(trajectory))
    else:
        say(arguments, trajectory.energy_table())
    return 0


def _energy_by(arguments: argparse.Namespace, trajectory: Trajectory) -> int:
    """Works by pair of bodies, or energies by body."""
    from nsdyn.recording import breakdown
    from nsdyn.tools.files import writing

    pairs = arguments.by == "pair"
    series: dict[str, tuple[Array, Array]] = (
        {" | ".join(pair): works for pair, works in trajectory.pair_works().items()}
        if pairs
        else trajectory.body_energies()
    )
    words = ("normal", "friction") if pairs else ("kinetic", "potential")
    if arguments.csv:
        columns = {f"{name} {word}": v for name, both in series.items() for word, v in zip(words, both, strict=True)}
        with writing(arguments.csv) as part:
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
    from nsdyn.tools.files import writing

    check_outputs(arguments.recording, arguments.csv)
    trajectory = Trajectory.load(arguments.recording)
    if not 1 <= abs(arguments.step) <= trajectory.steps:
        raise ValueError(f"--step must be one of 1 to {trajectory.steps}, or -1 back, got {arguments.step}")
    if arguments.csv:
        table = trajectory.contact_table()
        with writing(arguments.csv) as part, open(part, "w", newline="") as file:
            sink = csv.writer(file)
            sink.writerow(table)
            sink.writerows(zip(*(table[name].tolist() for name in table), strict=True))
    say(arguments, trajectory.contacts(arguments.step))
    return 0


def write_page(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn view``."""
    from nsdyn.recording import pictures, viewer
    from nsdyn.recording.trajectory import Trajectory

    if not (arguments.output or arguments.png or arguments.mp4):
        raise ValueError("nothing to make: give -o RUN.html, --png FRAME.png or --mp4 RUN.mp4")
    if arguments.at is not None and not arguments.png:
        raise ValueError("--at is the time of the picture: give --png FRAME.png too")
    for recording in filter(None, (arguments.recording, arguments.beside)):
        check_outputs(recording, arguments.output, arguments.png, arguments.mp4)
    check_picture(arguments.png, "png")
    check_picture(arguments.mp4, "mp4", what="film")
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
    return 0
