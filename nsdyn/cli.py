"""The `nsdyn` command.

Figures go to stdout, as text or with ``--json``; progress and messages go to stderr. The exit code is 0 for
success, 1 for a simulation that did not converge, a failed audit or self-check, 2 for bad input, which is told in
one line before anything is written.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import inspect
import json
import logging
import math
import os
import re
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from nsdyn.recording.trajectory import Trajectory

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    arguments = _parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="nsdyn: %(message)s", stream=sys.stderr)
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        try:
            return int(arguments.run(arguments))
        except BrokenPipeError:  # the reader of our output is gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        except (ValueError, OSError) as error:
            print(f"nsdyn: error: {_one_line(error)}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("nsdyn: interrupted", file=sys.stderr)
            return 130


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    print(f"nsdyn: warning: {_one_line(message)}", file=sys.stderr)


def _one_line(message: object) -> str:
    return " ".join(str(message).split())


class _Parser(argparse.ArgumentParser):
    """Tells a mistake in one line, as everything else here does."""

    def error(self, message: str) -> NoReturn:
        from nsdyn.tools.naming import meant

        choice = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        hint = meant(choice[1], re.findall(r"[\w-]+", choice[2])) if choice else ""
        self.exit(2, f"nsdyn: error: {message}{hint} (see {self.prog} --help)\n")


_OUTPUTS = (
    "Output files that exist are overwritten once the new ones are complete. Links are followed, what is no regular "
    "file (a FIFO, a device) is written through, and - is stdout; the figures then go to stderr."
)


def _parser() -> _Parser:
    parser = _Parser(prog="nsdyn", description="Rigid multibody dynamics with hard contact and exact Coulomb friction.")
    parser.add_argument("--version", action="version", version=f"nsdyn {_version('nsdyn')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(name: str, run: Callable[[argparse.Namespace], int], summary: str) -> argparse.ArgumentParser:
        out = commands.add_parser(
            name, help=summary, description=summary, epilog=None if run in (_scenes, _doctor) else _OUTPUTS
        )
        out.set_defaults(run=run)
        return out

    p = command("scenes", _scenes, "List the named scenes and their parameters.")
    _add_json(p)

    p = command("doctor", _doctor, "Show versions and places of what nsdyn depends on, and check that it works.")
    p.add_argument("--compile", action="store_true", help="first compile all kernels, in as many processes as cores")
    _add_json(p)

    p = command("run", _run, "Simulate a named scene and print its energy ledger.")
    p.add_argument("scene", metavar="SCENE", help="a name that 'nsdyn scenes' lists")
    p.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="parameter of the scene; may be repeated",
    )
    _add_simulation(p)
    where = p.add_mutually_exclusive_group()
    where.add_argument("-o", "--output", type=Path, metavar="RUN.h5", help="recording, written while it runs")
    where.add_argument(
        "--resume", type=Path, metavar="RUN.h5",
        help="recording of a run of the same arguments that ended or was killed: go on with it, bit for bit",
    )  # fmt: skip
    p.add_argument(
        "--every", type=int, default=1, metavar="N", help="record only every N-th step (default: %(default)s)"
    )
    p.add_argument("--no-contacts", action="store_true", help="leave the contacts out of the recording")
    p.add_argument("--html", type=Path, metavar="RUN.html", help="self-contained animated page")
    p.add_argument("--dump-on-fail", type=Path, metavar="DIR", help="folder for the problems of steps that fail")
    p.add_argument("--check", action="store_true", help="audit the motion; the exit code is 0 only if it passes")
    _add_json(p)

    p = command("sweep", _sweep, "Simulate a named scene for every combination of parameters and print a table.")
    p.add_argument("scene", metavar="SCENE", help="a name that 'nsdyn scenes' lists")
    p.add_argument(
        "--set",
        metavar="NAME=VALUE,...",
        action="append",
        default=[],
        help="values of a parameter of the scene, with commas between; may be repeated",
    )
    _add_simulation(p)
    where = p.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, metavar="N", help="processes to use (default: this one)")
    where.add_argument("--dask", metavar="ADDRESS", help="scheduler of a dask cluster whose workers have nsdyn")
    p.add_argument("--csv", type=Path, metavar="F.csv", help="the table")
    _add_json(p)

    p = command("solve", _solve, "Solve a frictional contact problem in an FCLIB file.")
    p.add_argument("problem", type=Path, metavar="PROBLEM.hdf5")
    p.add_argument("--solver", default="auto", metavar="S", help="solver by name (default: %(default)s)")
    p.add_argument("--tol", type=float, default=1e-8, metavar="E", help="its tolerance (default: %(default)s)")
    p.add_argument("-o", "--output", type=Path, metavar="SOLUTION.hdf5", help="the problem and its solution")
    _add_json(p)

    p = command("profile", _profile, "Compare solvers on a folder of FCLIB files: Dolan-Moré performance profiles.")
    p.add_argument("folder", type=Path, metavar="DIR")
    p.add_argument("--solver", action="append", metavar="S", help="name, or all; may be repeated (default: auto)")
    p.add_argument(
        "--tol", type=float, action="append", metavar="E", help="on the error measure; may be repeated (default: 1e-8)"
    )
    p.add_argument("--min-contacts", type=int, default=0, metavar="N", help="leave out smaller problems")
    p.add_argument(
        "--limit", type=float, default=10.0, metavar="SECONDS", help="time limit of each solve (default: %(default)s)"
    )
    p.add_argument("--peer", action="append", default=[], metavar="NAME", help="siconos or pinocchio: all its solvers")
    p.add_argument("--csv", type=Path, metavar="F.csv", help="all runs, one a line")
    p.add_argument("--plot", type=Path, metavar="F.png", help="picture of the profiles (png, pdf or svg)")
    _add_json(p)

    p = command("bench", _bench, "Speed against error: scenes with known answers, in nsdyn and in other engines.")
    p.add_argument("case", metavar="CASE", nargs="*", help="cases by name (default: all)")
    p.add_argument(
        "--peer",
        action="append",
        default=[],
        metavar="NAME",
        help="mujoco, drake, dart, bullet or siconos; may be repeated",
    )
    p.add_argument(
        "--limit", type=float, default=30.0, metavar="SECONDS", help="time limit of each run (default: %(default)s)"
    )
    p.add_argument("--csv", type=Path, metavar="F.csv", help="all runs, one a line")
    p.add_argument("--plot", type=Path, metavar="F.png", help="picture of time against error (png, pdf or svg)")
    _add_json(p)

    p = command("energy", _energy, "Print, plot or export the energy ledger of a recording.")
    p.add_argument("recording", type=Path, metavar="RUN.h5")
    p.add_argument("--plot", type=Path, metavar="E.png", help="picture of energies and works (png, pdf or svg)")
    p.add_argument("--csv", type=Path, metavar="E.csv", help="all times: energies, and the works of each step, in J")
    _add_json(p)

    p = command("contacts", _contacts, "Print or export the contacts of a recording.")
    p.add_argument("recording", type=Path, metavar="RUN.h5")
    p.add_argument("--step", type=int, default=-1, metavar="K", help="step to print (default: the last)")
    p.add_argument("--csv", type=Path, metavar="C.csv", help="all contacts of all steps, one a line")

    p = command("view", _view, "Make a web page or a picture of a recording.")
    p.add_argument("recording", type=Path, metavar="RUN.h5")
    p.add_argument("-o", "--output", type=Path, metavar="RUN.html", help="self-contained animated page")
    p.add_argument(
        "--forces", nargs="?", const="pair", default=False, metavar="BY",
        help="draw the contact forces, one for each pair of bodies (the default) or each contact point: pair, point",
    )  # fmt: skip
    p.add_argument("--fps", type=float, default=30.0, metavar="N", help="keyframes per second (default: %(default)s)")
    p.add_argument("--png", type=Path, metavar="FRAME.png", help="picture of one moment, made by a headless Chromium")
    p.add_argument("--at", type=float, metavar="T", help="time of the picture in s (default: the end)")
    return parser


def _add_simulation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--time", type=float, metavar="T", help="simulated time in s (default: the scene's own)")
    parser.add_argument("--dt", type=float, metavar="H", help="time step in s (default: the scene's own)")
    parser.add_argument("--theta", type=float, default=0.5, help="theta of the scheme, 0.5 to 1 (default: %(default)s)")
    parser.add_argument("--solver", default="auto", metavar="S", help="solver by name (default: %(default)s)")
    parser.add_argument("--tol", type=float, default=1e-8, metavar="E", help="its tolerance (default: %(default)s)")
    parser.add_argument(
        "--loose", type=float, metavar="E",
        help="of solver auto: what is accepted where its tolerance costs too much (default: 1e-4)",
    )  # fmt: skip
    parser.add_argument(
        "--on-fail", choices=("warn", "raise", "ignore"), default="warn",
        help="what to do where a step misses its tolerance: go on with the best answer, or stop (default: %(default)s)",
    )  # fmt: skip


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def _say(arguments: argparse.Namespace, text: object) -> None:
    """Print figures; where an output takes stdout they go to stderr."""
    from nsdyn.tools import files

    taken = files.STDOUT in vars(arguments).values()
    print(text, file=sys.stderr if taken else sys.stdout)


def _say_json(arguments: argparse.Namespace, figures: Any) -> None:
    _say(arguments, json.dumps(_plain(figures), indent=2))


def _plain(value: Any) -> Any:
    """Value in JSON's terms: lists for arrays, text for paths, null for what is not finite."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def _check_outputs(source: Path | None, *paths: Path | None) -> None:
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


_PLOTS = "png", "pdf", "svg"


def _check_picture(path: Path | None, *kinds: str) -> None:
    """Refuse the name of a picture of another kind."""
    if path and path.suffix and path.suffix[1:].lower() not in kinds:
        raise ValueError(f"cannot write {path}: a picture must be {' or '.join(kinds)}, got {path.suffix}")


# -- scenes and run ------------------------------------------------------------------------------------


def _scenes(arguments: argparse.Namespace) -> int:
    from nsdyn.scene import named as scenes
    from nsdyn.scene import settings

    found: dict[str, Any] = {}
    for name in scenes.names():
        summary = (inspect.getdoc(scenes.module(name)) or "").partition("\n")[0]
        found[name] = {"summary": summary, "parameters": settings.parameters(name)}
    if arguments.json:
        _say_json(arguments, found)
        return 0
    for name, scene in found.items():
        shown = ", ".join(f"{key}={settings.as_text(value)}" for key, value in scene["parameters"].items())
        print(f"{name}: {scene['summary']}\n    {shown}")
    return 0


def _solver(arguments: argparse.Namespace) -> Any:
    """The solver of a simulation, with a loose tolerance where it takes one."""
    import nsdyn

    solver = nsdyn.solvers.by_name(arguments.solver, arguments.tol)
    if not isinstance(solver, nsdyn.solvers.Auto):
        if arguments.loose is not None:
            raise ValueError(f"--loose is for the solver 'auto', got {arguments.solver!r}")
        return solver
    loose = type(solver).loose if arguments.loose is None else arguments.loose
    if not loose > 0.0:
        raise ValueError(f"loose must be positive, got {loose}")
    return replace(solver, loose=max(loose, solver.tol))


def _met(trajectory: Any, solver: Any) -> str:
    """How many steps, or groups of them that are recorded as one, met which tolerance, in words."""
    from nsdyn import Status

    count = Counter(trajectory.solver.status.tolist())
    what = "steps" if trajectory.every == 1 else f"times {trajectory.every} steps"
    parts = [f"{count.pop(Status.CONVERGED, 0)} {what} to {solver.tol:g}"]
    if loose := count.pop(Status.LOOSE, 0):
        parts.append(f"{loose} to {solver.loose:g}")
    if squeezed := count.pop(Status.OVERLAP, 0):
        parts.append(f"{squeezed} with an overlap that nothing removed")
    if missed := count.total():
        parts.append(f"{missed} missed their tolerance (largest error {trajectory.solver.error.max():.1e})")
    return ", ".join(parts)


def _run(arguments: argparse.Namespace) -> int:
    import numpy as np

    import nsdyn
    from nsdyn.scene import settings

    name = arguments.scene
    parameters = settings.values(name, arguments.set)
    solver = _solver(arguments)
    _check_outputs(None, arguments.output, arguments.resume, arguments.html)
    setup = nsdyn.scenes.setup(name, **parameters)
    recording = arguments.output or arguments.resume
    start = time.perf_counter()
    try:
        trajectory = nsdyn.simulate(
            setup.scene,
            setup.duration if arguments.time is None else arguments.time,
            **setup.options(dt=setup.dt if arguments.dt is None else arguments.dt),
            theta=arguments.theta,
            solver=solver,
            record=arguments.output,
            progress=True,
            on_fail=arguments.on_fail,
            dump_on_fail=arguments.dump_on_fail,
            every=arguments.every,
            contacts=not arguments.no_contacts,
            resume=arguments.resume,
        )
    except nsdyn.NotConverged as failure:
        kept = f"; the steps before it are in {recording}" if recording else ""
        print(f"nsdyn: not converged: {_one_line(failure)}{kept}", file=sys.stderr)
        return 1
    wall = time.perf_counter() - start
    # The first step loads or compiles what it needs, beyond what is done before it.
    each = trajectory.wall_time / trajectory.every
    median = float(np.median(each))
    start_up = None  # of a run that is resumed the recording has times of other processes
    if not arguments.resume:
        start_up = wall - float(trajectory.wall_time.sum()) + max(0.0, float(trajectory.wall_time[0]) - median)
    if arguments.html:
        trajectory.to_html(arguments.html)
    figures = {
        "scene": name,
        "parameters": settings.parameters(name) | parameters,
        "dt": trajectory.dt,
        "steps": trajectory.steps * trajectory.every,
        "every": trajectory.every,
        "wall_time": wall,
        "start_up_time": start_up,
        "median_step_time": median,
        "contacts": len(trajectory.columns["contacts/gap"]) / trajectory.steps if trajectory.has_contacts else None,
        "worst": trajectory.worst(),
        "recording": recording,
        "html": arguments.html,
    }
    audit = nsdyn.check(trajectory) if arguments.check else None
    code = 0 if audit is None or audit.passed else 1
    if arguments.json:
        _say_json(arguments, figures if audit is None else figures | {"audit": audit.as_dict()})
        return code
    _say(arguments, trajectory.energy_table())
    worst = trajectory.worst()
    after = "since it was resumed" if start_up is None else f"after {start_up:.2f} s of start-up"
    contacts, penetration = "contacts not recorded", ""
    if trajectory.has_contacts:
        contacts = f"{figures['contacts']:.1f} contacts on average"
        penetration = f", penetration {worst['penetration']:.1e} m"
    _say(
        arguments,
        f"{_met(trajectory, solver)}; {wall - (start_up or 0.0):.2f} s (median step {1e3 * median:.2f} ms) {after}, "
        f"{contacts}; worst residual {worst['residual']:.1e} m/s, "
        f"Gauss bound {worst['gauss_bound']:.1e} √J, defect {worst['defect']:.1e} J{penetration}",
    )
    if audit is not None:
        _say(arguments, audit)
    return code


# -- sweep ---------------------------------------------------------------------------------------------


def _sweep(arguments: argparse.Namespace) -> int:
    import nsdyn
    from nsdyn.scene import settings
    from nsdyn.study import sweep as ensemble
    from nsdyn.tools.files import writing

    name = arguments.scene
    module = nsdyn.scenes.module(name)
    parameters = settings.lists(name, arguments.set)
    solver = _solver(arguments)
    _check_outputs(None, arguments.csv)
    with _executor(arguments) as executor:
        members = ensemble.sweep(
            name,
            parameters,
            module.DURATION if arguments.time is None else arguments.time,
            on_fail=arguments.on_fail,
            executor=executor,
            keep=ensemble.figures,
            progress=True,
            dt=module.DT if arguments.dt is None else arguments.dt,
            theta=arguments.theta,
            solver=solver,
        )
    rows = [{**m.parameters, "failure": m.failure, **(m.result or {})} for m in members]
    columns = list(dict.fromkeys(column for row in rows for column in row))  # a failed run has no figures
    if arguments.csv:
        import csv

        with writing(arguments.csv) as part, open(part, "w", newline="") as file:
            sink = csv.DictWriter(file, columns)
            sink.writeheader()
            sink.writerows(rows)
    if arguments.json:
        _say_json(arguments, {"scene": name, "runs": rows})
    else:
        _say(arguments, _columns(rows, [column for column in columns if column != "failure"]))
    for m in members:
        if m.failure:
            print(f"nsdyn: not converged: {m.parameters}: {_one_line(m.failure)}", file=sys.stderr)
    return 1 if any(m.failure for m in members) else 0


def _executor(arguments: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """What runs the simulations, to be used in a with statement."""
    if arguments.workers is not None:
        from concurrent.futures import ProcessPoolExecutor
        from multiprocessing import get_context

        if arguments.workers < 1:
            raise ValueError(f"--workers must be at least 1, got {arguments.workers}")
        return ProcessPoolExecutor(arguments.workers, get_context("spawn"))
    if arguments.dask is not None:
        if importlib.util.find_spec("distributed") is None:
            raise ValueError("--dask needs the extra `cluster`: pip install 'nsdyn[cluster]'")
        from distributed import Client

        executor: AbstractContextManager[Executor] = Client(arguments.dask).get_executor()
        return executor
    return nullcontext()


def _columns(rows: list[dict[str, Any]], names: list[str]) -> str:
    """Text table of some columns; what a row lacks is a dash."""
    cells = [[_cell(row.get(name)) for name in names] for row in rows]
    widths = [max(map(len, column)) for column in zip(names, *cells, strict=True)]
    return "\n".join("  ".join(map(str.rjust, line, widths)) for line in [names, *cells])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    from nsdyn.scene.settings import as_text

    return f"{value:.6g}" if isinstance(value, float) else as_text(value)


# -- solve, profile and bench ---------------------------------------------------------------------------------


def _solve(arguments: argparse.Namespace) -> int:
    from nsdyn import solvers
    from nsdyn.problem import fclib

    solver = solvers.by_name(arguments.solver, arguments.tol)
    _check_outputs(arguments.problem, arguments.output)
    problem = fclib.read(arguments.problem)
    solution = solver(problem)
    if arguments.output:
        fclib.write_solution(arguments.output, arguments.problem, solution, overwrite=True)
    figures = {
        "problem": arguments.problem,
        "contacts": problem.nc,
        "solver": arguments.solver,
        "tol": arguments.tol,
        "converged": solution.converged,
        "status": solution.status.message,
        "error": solution.error,
        "residual": solution.residual,
        "iterations": solution.iterations,
        "time": solution.time,
        "solution": arguments.output,
    }
    if arguments.json:
        _say_json(arguments, figures)
    else:
        _say(
            arguments,
            f"{problem.nc} contacts, {arguments.solver}: {solution.status.message}; error {solution.error:.2e}, "
            f"residual {solution.residual:.2e} m/s, {solution.iterations} iterations in {1e3 * solution.time:.3g} ms",
        )
    return 0 if solution.converged else 1


def _profile(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict
    from functools import partial

    from nsdyn.study import profile

    _check_outputs(None, arguments.csv, arguments.plot)
    _check_picture(arguments.plot, *_PLOTS)
    solvers, smallest = arguments.solver or ["auto"], arguments.min_contacts
    found = [
        profile.measure(arguments.folder, solvers, tol, arguments.limit, arguments.peer, smallest, progress=True)
        for tol in arguments.tol or [1e-8]
    ]
    if arguments.csv:
        profile.write_csv(arguments.csv, found)
    if arguments.plot:
        _plot(arguments.plot, *(partial(one.plot, legend=one is found[-1]) for one in found))
    if arguments.json:
        _say_json(arguments, [
            {"tol": p.tol, "limit": p.limit, "summary": p.summary(), "runs": [asdict(run) for run in p.runs]}
            for p in found
        ])  # fmt: skip
    else:
        _say(arguments, "\n\n".join(f"tol {one.tol:g}\n{one.table()}" for one in found))
    return 0


def _bench(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict

    from nsdyn.study import bench

    _check_outputs(None, arguments.csv, arguments.plot)
    _check_picture(arguments.plot, *_PLOTS)
    found = bench.measure(arguments.case, arguments.peer, arguments.limit, progress=True)
    if arguments.csv:
        found.write_csv(arguments.csv)
    if arguments.plot:
        _picture(arguments.plot, found.plot, (13, 9.5), 80)
    if arguments.json:
        _say_json(arguments, {"summary": found.summary(), "runs": [asdict(run) for run in found.runs]})
    else:
        _say(arguments, found.table())
    return 0


def _plot(path: Path, *draw: Callable[[Any], Any]) -> None:
    """Picture of what each `draw` draws on matplotlib axes, side by side."""

    def panels(figure: Any) -> None:
        for axes, panel in zip(figure.subplots(1, len(draw), squeeze=False)[0], draw, strict=True):
            panel(axes)

    _picture(path, panels, (3 + 5 * len(draw), 5), 150)


def _picture(path: Path, draw: Callable[[Any], Any], size: tuple[float, float], dpi: int) -> None:
    """Picture of what `draw` draws on a matplotlib figure of `size` in inches."""
    from matplotlib.figure import Figure  # needs no display, unlike pyplot

    from nsdyn.tools.files import writing

    figure = Figure(figsize=size, layout="constrained")
    draw(figure)
    with writing(path) as part:
        figure.savefig(part, format=path.suffix.removeprefix(".") or "png", dpi=dpi)


# -- energy and view -----------------------------------------------------------------------------------


def _energy(arguments: argparse.Namespace) -> int:
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.files import writing

    _check_outputs(arguments.recording, arguments.plot, arguments.csv)
    _check_picture(arguments.plot, *_PLOTS)
    trajectory = Trajectory.load(arguments.recording)
    if arguments.plot:
        _plot(arguments.plot, trajectory.plot_energy)
    if arguments.csv:
        with writing(arguments.csv) as part:
            _write_csv(trajectory, part)
    if arguments.json:
        _say_json(arguments, _ledger(trajectory))
    else:
        _say(arguments, trajectory.energy_table())
    return 0


def _ledger(trajectory: Trajectory) -> dict[str, Any]:
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


def _write_csv(trajectory: Trajectory, path: Path) -> None:
    import numpy as np

    energy = trajectory.energy
    columns = {"t [s]": trajectory.t}
    for name in energy.names:
        values = getattr(energy, name)
        # A work belongs to the step that ends at t; none ends at the first time.
        columns[f"{name} [J]"] = values if values.size == trajectory.t.size else np.concatenate([[0.0], values])
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header=",".join(columns), comments="")


def _contacts(arguments: argparse.Namespace) -> int:
    import csv

    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.tools.files import writing

    _check_outputs(arguments.recording, arguments.csv)
    trajectory = Trajectory.load(arguments.recording)
    if not 1 <= abs(arguments.step) <= trajectory.steps:
        raise ValueError(f"--step must be one of 1 to {trajectory.steps}, or -1 back, got {arguments.step}")
    if arguments.csv:
        table = trajectory.contact_table()
        with writing(arguments.csv) as part, open(part, "w", newline="") as file:
            sink = csv.writer(file)
            sink.writerow(table)
            sink.writerows(zip(*(table[name].tolist() for name in table), strict=True))
    _say(arguments, trajectory.contacts(arguments.step))
    return 0


def _view(arguments: argparse.Namespace) -> int:
    from nsdyn.recording import viewer
    from nsdyn.recording.trajectory import Trajectory

    if not (arguments.output or arguments.png):
        raise ValueError("nothing to make: give -o RUN.html, --png FRAME.png, or both")
    if arguments.at is not None and not arguments.png:
        raise ValueError("--at is the time of the picture: give --png FRAME.png too")
    _check_outputs(arguments.recording, arguments.output, arguments.png)
    _check_picture(arguments.png, "png")
    trajectory = Trajectory.load(arguments.recording)
    options = {"fps": arguments.fps, "forces": arguments.forces}
    if arguments.png:
        at = trajectory.t[-1] if arguments.at is None else arguments.at
        with tempfile.TemporaryDirectory(prefix="nsdyn-") as folder:
            page = Path(folder) / "page.html"
            viewer.write_html(trajectory, page, at=at, **options)
            viewer.screenshot(page, arguments.png)
    if arguments.output:
        viewer.write_html(trajectory, arguments.output, **options)
    return 0


# -- doctor --------------------------------------------------------------------------------------------

# Distribution: module.
_PACKAGES = {
    "nsdyn": "nsdyn",
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "pin": "pinocchio",
    "coal": "coal",
    "qdldl": "qdldl",
    "h5py": "h5py",
    "meshcat": "meshcat",
}


def _version(distribution: str) -> str | None:
    """Version of an installed distribution; of nsdyn also in a source tree."""
    if distribution == "nsdyn":
        from nsdyn import __version__

        return __version__
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _doctor(arguments: argparse.Namespace) -> int:
    from nsdyn._kernels import ahead, compiled
    from nsdyn.recording import viewer

    if arguments.compile:
        ahead.compile_examples("all")
    packages: dict[str, Any] = {}
    for distribution, module in _PACKAGES.items():
        spec = importlib.util.find_spec(module)  # found, not imported: meshcat would load its server
        packages[distribution] = {"version": _version(distribution), "file": spec.origin if spec else None}
    cache = compiled.folder()
    checks = {name: _outcome(check) for name, check in _CHECKS.items()}
    sound = all(p["version"] and p["file"] for p in packages.values()) and all(c == "ok" for c in checks.values())
    figures: dict[str, Any] = {
        "python": {"version": sys.version.split()[0], "file": sys.executable},
        "packages": packages,
        "chromium": viewer.chromium(),
        "cache": cache,
        "checks": checks,
        "ok": sound,
    }
    if arguments.json:
        _say_json(arguments, figures)
        return 0 if sound else 1
    for name, found in {"python": figures["python"], **packages}.items():
        print(f"{name:12} {found['version'] or 'MISSING':12} {found['file'] or ''}")
    print(f"{'chromium':12} {figures['chromium'] or 'not found; only pictures (nsdyn view --png) need it'}")
    none = f"none can be written: every start compiles unless {compiled.FOLDER} names a folder"
    print(f"{'cache':12} {cache or none}")
    for name, outcome in checks.items():
        print(f"check        {name}: {outcome}")
    return 0 if sound else 1


def _outcome(check: Callable[[], bool]) -> str:
    try:
        return "ok" if check() else "WRONG RESULT"
    except Exception as error:  # whatever a broken installation raises is the finding
        return f"{type(error).__name__}: {_one_line(error)}"


def _check_coal() -> bool:
    import coal
    import numpy as np

    ball, there = coal.Sphere(1.0), coal.Transform3s()
    there.setTranslation(np.array([3.0, 0.0, 0.0]))
    result = coal.DistanceResult()
    distance = coal.distance(ball, coal.Transform3s(), ball, there, coal.DistanceRequest(), result)
    return bool(abs(distance - 1.0) < 1e-6)  # Coal's own tolerance of an iterative distance


def _check_qdldl() -> bool:
    import numpy as np
    import qdldl
    import scipy.sparse as sp

    x = qdldl.Solver(sp.csc_matrix([[4.0, 1.0], [1.0, 3.0]])).solve(np.array([1.0, 2.0]))
    return bool(np.allclose(x, [1 / 11, 7 / 11], rtol=1e-12, atol=0.0))


def _check_contact() -> bool:
    import numpy as np

    import nsdyn

    # One kilogram that slides: r_N stops it, friction is at its limit mu r_N.
    solution = nsdyn.solve(nsdyn.FC3D(np.eye(3), np.array([-1.0, 2.0, 0.0]), np.array([0.5])))
    return bool(np.allclose(solution.r, [1.0, -0.5, 0.0], rtol=0.0, atol=1e-7))


_CHECKS = {
    "coal distance": _check_coal,
    "qdldl solve": _check_qdldl,
    "sliding contact": _check_contact,
}
