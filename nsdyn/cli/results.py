"""`nsdyn energy`, `nsdyn contacts`, `nsdyn joints` and `nsdyn view`: what recordings show."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from nsdyn.cli.output import check_files, ledger, plot_to, say, say_json, table, write_columns, write_table

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.arrays import Array

__all__ = ["show_contacts", "show_energy", "show_joints", "write_page"]


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
    trajectory = _at_a_step(arguments)
    if arguments.csv:
        write_table(trajectory.contact_table(), arguments.csv)
    say(arguments, trajectory.contacts(arguments.step))
    return 0


def show_joints(arguments: argparse.Namespace) -> int:
    """Exit code of ``nsdyn joints``."""
    import numpy as np

    from nsdyn.recording.joints import heading, joint_table

    trajectory = _at_a_step(arguments)
    k = arguments.step if arguments.step > 0 else trajectory.steps + 1 + arguments.step
    found = joint_table(trajectory, arguments.joint, np.array([k]))
    if arguments.csv:
        write_table(trajectory.joint_table(arguments.joint), arguments.csv, heading)
    shown = {name: name for name in ("joint", "position", "velocity", "torque", "friction")}
    shown |= {f"reaction_{what}_{axis}": f"{what[0]}_{axis}" for what in ("force", "torque") for axis in "xyz"}
    rows = zip(*(found[name].tolist() for name in shown), strict=True)
    cells = [[None if x != x else x for x in row] for row in rows]  # NaN, as the position of a loop
    say(arguments, table([dict(zip(shown.values(), row, strict=True)) for row in cells], list(shown.values())))
    say(arguments, _JOINTS.format(step=k, t=trajectory.t[k]))
    return 0


_JOINTS = (
    "step {step}, which ends at t = {t:g} s; rad or m, N m or N; reactions f [N] and t [N m]: mean of the step, on the "
    "child\nabout the joint's origin, world axes. Of several coordinates the first is shown, --csv has all"
)


def _at_a_step(arguments: argparse.Namespace) -> Trajectory:
    """The recording of which a step is to be printed; ValueError where it has no such step."""
    from nsdyn.recording.trajectory import Trajectory

    check_files(arguments)
    trajectory = Trajectory.load(arguments.recording)
    if not 1 <= abs(arguments.step) <= trajectory.steps:
        raise ValueError(f"--step must be one of 1 to {trajectory.steps}, or -1 back, got {arguments.step}")
    return trajectory


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
