"""`nsdyn sweep`: a scene over lists of parameters."""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from nsdyn.cli.output import PICTURE_SIZE, add_output, check_files, header, one_line, picture, report, table
from nsdyn.cli.run import add_scene, add_simulation, chosen_solver, chosen_steps
from nsdyn.tools.files import PICTURE, STORE, TABLE, write_csv

if TYPE_CHECKING:
    from concurrent.futures import Executor

ROUND_OFF = 1e-12
"""Fraction of the largest energy below which an energy is round-off."""


def add_sweep(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``nsdyn sweep``."""
    add_scene(parser, "VALUE,...", "values of a parameter of the scene, with commas between")
    add_simulation(parser, "raise", "ignore")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="processes to use (default: as many as cores)")
    where.add_argument("--dask", metavar="ADDRESS", help="scheduler of a dask cluster whose workers have nsdyn")
    add_output(
        parser,
        "--store",
        kind=STORE,
        metavar="S.jsonl",
        help="file to which every run is added when it is done; what it already has is not run again",
    )
    add_output(parser, "--csv", kind=TABLE, metavar="F.csv", help="the table")
    add_output(
        parser,
        "--plot",
        kind=PICTURE,
        metavar="F.png",
        help="picture of displacement, energy and works over the parameter with the most values (png, pdf or svg)",
    )


def sweep_scene(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn sweep``; return its exit code."""
    from nsdyn.scene import settings
    from nsdyn.study import drawings
    from nsdyn.study import sweep as ensemble

    name = arguments.scene
    parameters = settings.lists(name, arguments.set)
    solver = chosen_solver(arguments)
    check_files(arguments)
    if arguments.plot:
        drawings.varied(parameters)
    with _executor(arguments) as executor:
        members = ensemble.sweep(
            name,
            parameters,
            **chosen_steps(arguments),
            executor=executor,
            keep=ensemble.figures,
            progress=True,
            store=arguments.store,
            solver=solver,
        )
    rows = [{**m.parameters, "failure": m.failure, **(m.result or {})} for m in members]
    # A failed run has no figures.
    columns = {name: header(name, ensemble.UNITS) for name in dict.fromkeys(name for row in rows for name in row)}
    if arguments.csv:
        write_csv(arguments.csv, list(columns.values()), (map(row.get, columns) for row in rows))
    if arguments.plot:
        size = PICTURE_SIZE[0], 2.0 * PICTURE_SIZE[1]
        picture(arguments.plot, lambda figure: drawings.draw_sweep(parameters, members, figure), size)
    shown = [{columns[name]: value for name, value in _quiet(row, ensemble.UNITS).items()} for row in rows]
    words = table(shown, [header for name, header in columns.items() if name != "failure"])
    report(arguments, {"scene": name, "runs": rows}, words)
    for m in members:
        if m.failure:
            which = f"{m.parameters}: " if m.parameters else ""
            print(f"nsdyn: failed: {which}{one_line(m.failure)}", file=sys.stderr)
    return 1 if any(m.failure for m in members) else 0


def _quiet(row: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    """Return the figures of a run with 0 for energies that are round-off of the largest, except for the defect.

    The defect is round-off by its nature and stays.
    """
    energies = [name for name in row if units.get(name) == "J" and name != "defect"]
    least = ROUND_OFF * max((abs(row[name]) for name in energies), default=0.0)
    return {name: 0.0 if name in energies and abs(value) < least else value for name, value in row.items()}


@contextmanager
def _executor(arguments: argparse.Namespace) -> Iterator[Executor | int | None]:
    """Yield the executor of the simulations."""
    if arguments.dask is not None:
        if importlib.util.find_spec("distributed") is None:
            raise ValueError("--dask needs the extra `cluster`: pip install 'nsdyn[cluster]'")
        from distributed import Client

        try:
            client = Client(arguments.dask, timeout="10s")
        except (OSError, ValueError, TimeoutError) as error:
            raise ValueError(f"no dask scheduler at {arguments.dask}: {one_line(error)}") from None
        with client, client.get_executor() as executor:
            yield executor
        return
    workers = len(os.sched_getaffinity(0)) if arguments.workers is None else arguments.workers
    if workers < 1:
        raise ValueError(f"--workers must be at least 1, got {workers}")
    yield None if workers == 1 else workers
