"""`nsdyn scenes`, `nsdyn new` and `nsdyn run`."""

from __future__ import annotations

import argparse
import inspect
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from nsdyn.cli.output import check_files, ledger, one_line, report
from nsdyn.tools.naming import counted

COARSEST = 1.0
"""Largest tolerance, m/s: a larger one probably comes from an exponent without its sign."""


def add_set(parser: argparse.ArgumentParser, values: str = "VALUE", what: str = "parameter of the scene") -> None:
    """Add the option for the parameters of a scene."""
    told = f"{what}; may be repeated"
    parser.add_argument("--set", metavar=f"NAME={values}", action="append", default=[], help=told)


def add_scene(parser: argparse.ArgumentParser, *values: str) -> None:
    """Add the scene of a command, and its parameters."""
    known = "a name that 'nsdyn scenes' lists, or a file of your own, which 'nsdyn new' begins"
    parser.add_argument("scene", metavar="SCENE", help=known)
    add_set(parser, *values)


def add_simulation(parser: argparse.ArgumentParser, *on_fail: str) -> None:
    """Add the options of a simulation: its duration, its time step, and those of `add_solver`."""
    parser.add_argument("--time", type=float, metavar="T", help="simulated time in s (default: the scene's own)")
    parser.add_argument("--dt", type=float, metavar="H", help="time step in s (default: the scene's own)")
    parser.add_argument(
        "--polish",
        action="store_true",
        help="certify every step through polished answers: bounds of the order of the error, for about another solve",
    )
    add_solver(parser, *on_fail)


def add_solver(parser: argparse.ArgumentParser, *on_fail: str) -> None:
    """Add the options of scheme and solver of a simulation; `on_fail` are its choices besides a warning."""
    written = ", write its problem" if "dump" in on_fail else ""
    parser.add_argument("--theta", type=float, default=0.5, help="theta of the scheme, 0.5 to 1 (default: %(default)s)")
    parser.add_argument("--solver", default="auto", metavar="S", help="solver by name (default: %(default)s)")
    parser.add_argument("--tol", type=float, default=1e-8, metavar="E", help="its tolerance (default: %(default)s)")
    parser.add_argument(
        "--loose",
        type=float,
        metavar="E",
        help="of solver auto: what is accepted where its tolerance costs too much (default: 1e-4)",
    )
    parser.add_argument(
        "--on-fail",
        choices=("warn", *on_fail),
        default="warn",
        help=f"what to do where a step misses its tolerance: go on with the best answer, and say so{written} or be "
        "silent, or stop (default: %(default)s)",
    )


def list_scenes(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn scenes``; return its exit code."""
    from nsdyn.scene import named as scenes
    from nsdyn.scene import settings

    found: dict[str, Any] = {}
    for name in scenes.names():
        summary = (inspect.getdoc(scenes.module(name)) or "").partition("\n")[0]
        found[name] = {"summary": summary, "parameters": settings.parameters(name)}
    lines = []
    for name, scene in found.items():
        shown = ", ".join(f"{key}={settings.as_text(value)}" for key, value in scene["parameters"].items())
        lines.append(f"{name}: {scene['summary']}\n    {shown}")
    report(arguments, found, "\n".join(lines))
    return 0


def begin_scene(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn new``; return its exit code."""
    from nsdyn.scene import named as scenes
    from nsdyn.tools import files

    path = arguments.file
    if path.suffix != ".py":
        raise ValueError(f"a scene file must end in .py, got {path}")
    if path.exists():
        raise ValueError(f"{path} exists, and may be your work: give another name")
    with files.writing(path, files.SCENE) as part:
        part.write_text(scenes.template(), encoding="utf-8")
    print(f"{path}: edit it, then nsdyn run {path} --html {path.stem}.html")
    return 0


def chosen_solver(arguments: argparse.Namespace) -> Any:
    """Return the solver of a simulation, with a loose tolerance if it has one."""
    import nsdyn

    for option in ("tol", "loose"):
        given = getattr(arguments, option)
        if given is not None and given > COARSEST:
            meant = f"did you mean {1.0 / given:g}?"
            raise ValueError(f"{meant} --{option} must be at most {COARSEST:g} m/s, got {given:g}")
    solver = nsdyn.solvers.by_name(arguments.solver, arguments.tol)
    if not isinstance(solver, nsdyn.solvers.Auto):
        if arguments.loose is not None:
            raise ValueError(f"--loose is for the solver 'auto', got {arguments.solver!r}")
        return solver
    loose = type(solver).loose if arguments.loose is None else arguments.loose
    if not loose > 0.0:
        raise ValueError(f"loose must be positive, got {loose}")
    return replace(solver, loose=max(loose, solver.tol))


def chosen_steps(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return keywords for `nsdyn.simulate`: the scene's own duration and dt unless the command gives others."""
    from nsdyn.scene.named import seconds

    return {
        "duration": seconds(arguments.scene, "DURATION") if arguments.time is None else arguments.time,
        "dt": seconds(arguments.scene, "DT") if arguments.dt is None else arguments.dt,
        "theta": arguments.theta,
        "on_fail": arguments.on_fail,
        "polish": arguments.polish,
    }


def _met(trajectory: Any, solver: Any) -> str:
    """Say how many steps, or groups of steps recorded as one, met which tolerance."""
    import numpy as np

    from nsdyn import Status

    count = Counter(trajectory.solver.status.tolist())
    met = count.pop(Status.CONVERGED, 0)
    steps = counted(met, "step") if trajectory.every == 1 else f"{met} times {trajectory.every} steps"
    parts = [f"{steps} to {solver.tol:g}"]
    if loose := count.pop(Status.LOOSE, 0):
        parts.append(f"{loose} to {solver.loose:g}")
    if several := count.pop(Status.SEVERAL, 0):
        parts.append(f"{several} whose motion is not determined by Coulomb's law")
    if jams := count.pop(Status.JAM, 0):
        parts.append(f"{jams} in which bodies jam")
    if squeezed := count.pop(Status.OVERLAP, 0):
        parts.append(f"{squeezed} with an overlap that nothing removed")
    if missed := count.total():
        error = np.where(np.isin(trajectory.solver.status, list(count)), trajectory.solver.error, -1.0)
        worst = int(np.argmax(error))
        parts.append(
            f"{missed} missed their tolerance (largest error {error[worst]:.1e}, at t = {trajectory.t[worst + 1]:g} s)"
        )
    return ", ".join(parts)


def run_scene(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn run``; return its exit code."""
    import nsdyn
    from nsdyn.scene import settings
    from nsdyn.tools import files

    name = arguments.scene
    parameters = settings.values(name, arguments.set)
    solver = chosen_solver(arguments)
    check_files(arguments)
    if arguments.dump_on_fail:
        files.check_folder(arguments.dump_on_fail)
    steps = chosen_steps(arguments)
    setup = nsdyn.scenes.setup(name, **parameters)
    recording = arguments.output or arguments.resume
    old = _file(arguments.output)
    start = time.perf_counter()
    try:
        trajectory = _simulated(arguments, setup, **steps, solver=solver)
    except nsdyn.NotConverged as failure:
        kept = f"; the steps before it are in {recording}" if recording else ""
        print(f"nsdyn: not converged: {one_line(failure)}{kept}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        if recording is None or (arguments.output and _file(arguments.output) == old):  # not begun
            raise
        raise KeyboardInterrupt(f"the steps before it are in {recording}; --resume {recording} goes on") from None
    took = _times(trajectory, time.perf_counter() - start, bool(arguments.resume))
    if arguments.html:
        trajectory.to_html(arguments.html)
    audit = nsdyn.check(trajectory) if arguments.check else None
    figures = {
        "scene": name,
        "parameters": settings.parameters(name) | parameters,
        "dt": trajectory.dt,
        "steps": trajectory.steps * trajectory.every,
        "every": trajectory.every,
        **took,
        "contacts": _contacts(trajectory),
        **ledger(trajectory),
        "recording": recording,
        "html": arguments.html,
    }
    words = [trajectory.energy_table(), _summary(trajectory, solver, took)]
    if audit is not None:
        figures, words = figures | {"audit": audit.as_dict()}, [*words, repr(audit)]
    report(arguments, figures, "\n".join(words))
    return 0 if audit is None or audit.passed else 1


def _file(path: Path | None) -> int | None:
    """Return the number of the file at a path, which is another once it has been replaced; None without one."""
    return path.stat().st_ino if path is not None and path.exists() else None


def _simulated(arguments: argparse.Namespace, setup: Any, **options: Any) -> Any:
    """Simulate the scene of the command; its recording contains the command."""
    import nsdyn
    from nsdyn.stepping.simulation import command

    outside = command.set(arguments.typed)
    try:
        return nsdyn.simulate(
            setup.scene,
            **setup.options(**options),
            record=arguments.output,
            progress=True,
            dump_on_fail=arguments.dump_on_fail,
            every=arguments.every,
            contacts=not arguments.no_contacts,
            resume=arguments.resume,
        )
    finally:
        command.reset(outside)


def _times(trajectory: Any, wall: float, resumed: bool) -> dict[str, float | None]:
    """Return the total, start-up and median step time of a run, s; the start-up time of a resumed run is not known."""
    import numpy as np

    median = float(np.median(trajectory.wall_time / trajectory.every))
    # The first step still loads or compiles kernels: its time beyond the median counts as start-up.
    start = wall - float(trajectory.wall_time.sum()) + max(0.0, float(trajectory.wall_time[0]) - median)
    return {"wall_time": wall, "start_up_time": None if resumed else start, "median_step_time": median}


def _contacts(trajectory: Any) -> float | None:
    """Return the mean number of contacts in a step; None if contacts are not recorded."""
    return len(trajectory.columns["contacts/gap"]) / trajectory.steps if trajectory.has_contacts else None


def _summary(trajectory: Any, solver: Any, took: dict[str, float | None]) -> str:
    """Return a summary of a run in words."""
    worst, start, wall, median = trajectory.worst(), took["start_up_time"], took["wall_time"], took["median_step_time"]
    after = "since it was resumed" if start is None else f"after {start:.2f} s of start-up"
    contacts, penetration = "contacts not recorded", ""
    if trajectory.has_contacts:
        contacts = f"{_contacts(trajectory):.1f} contacts on average"
        penetration = f", penetration {worst['penetration']:.1e} m"
    return (
        f"{_met(trajectory, solver)}; {(wall or 0.0) - (start or 0.0):.2f} s "
        f"(median step {1e3 * (median or 0.0):.2f} ms) {after}, {contacts}; "
        f"worst residual {worst['residual']:.1e} m/s, Gauss bound {worst['gauss_bound']:.1e} √J, "
        f"defect {worst['defect']:.1e} J{penetration}"
    )
