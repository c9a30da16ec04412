"""Speed against error: cases with known answers, over a range of time steps, in nsdyn's stepper and in other engines.

All engines get the same scene: shapes, masses, inertias, velocities, gravity, friction, restitution. Each engine runs
in a process of its own with one thread. This module compares the poses of a run with the answer, by the same code for
all engines. Only stepping is timed, in the fastest way an engine has; building, compiling and reading poses are not.
Times are processor times of the one thread, which are wall times on an idle machine.

A run counts for an error only if the runs of the same engine and settings at every smaller dt meet the error too: a run
that is right by cancellation is not reliable.
"""

from __future__ import annotations

import importlib.util
import math
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, astuple, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from nsdyn.bench.cases import CASES, Case, describe
from nsdyn.tools import files
from nsdyn.tools.naming import choice
from nsdyn.tools.workers import Worker

ERRORS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""Bounds on the error that the table shows."""

SMALL = 0.01
"""dt in s at and below which a smaller dt takes longer, so that a run that takes too long ends its series. Above it, a
run may take too long because its large steps make the contact problems hard."""

_SCRIPTS = Path(__file__).with_name("_peers")


@dataclass(frozen=True)
class Run:
    """One engine on one case at one dt.

    Attributes
    ----------
    case, engine, variant : str
        `variant` is the name of the settings of the engine.
    dt : float
        s.
    error : float
        inf if the run failed, nan if it was stopped at the time limit.
    seconds : float
        Time per simulated second, nan without an answer.
    note : str
        Reason for a missing answer.
    """

    case: str
    engine: str
    variant: str
    dt: float
    error: float
    seconds: float
    note: str


@dataclass(frozen=True, eq=False)
class Bench:
    """Runs of several engines on several cases.

    Attributes
    ----------
    runs : tuple of Run
    """

    runs: tuple[Run, ...]

    @property
    def cases(self) -> list[str]:
        """Names of the cases."""
        return list(dict.fromkeys(run.case for run in self.runs))

    @property
    def engines(self) -> list[str]:
        """Names of the engines, nsdyn's first."""
        return list(dict.fromkeys(run.engine for run in self.runs))

    def within(self, case: str, engine: str, error: float) -> Run | None:
        """Return an engine's fastest run that meets the error at its dt and every smaller dt, None without one."""
        best = None
        broken = set()
        for run in self._finished.get((case, engine), []):
            if run.error > error:
                broken.add(run.variant)
            elif run.variant not in broken and (best is None or run.seconds < best.seconds):
                best = run
        return best

    @cached_property
    def _finished(self) -> dict[tuple[str, str], list[Run]]:
        """Runs of every case and engine that were not stopped, smallest dt first."""
        out: dict[tuple[str, str], list[Run]] = {}
        for run in sorted(self.runs, key=lambda run: run.dt):
            if not math.isnan(run.error):
                out.setdefault((run.case, run.engine), []).append(run)
        return out

    def summary(self) -> list[dict[str, Any]]:
        """Return for every case and bound of `ERRORS` the run by which each engine reaches it, and a ratio of times.

        The ratio is nsdyn's time over the best peer's: inf if only a peer reaches the bound, None if no peer does.
        """
        out = []
        for case in self.cases:
            for error in ERRORS:
                runs = {engine: self.within(case, engine, error) for engine in self.engines}
                ours, *peers = (math.inf if run is None else run.seconds for run in runs.values())
                best = min(peers, default=math.inf)
                out.append(
                    {
                        "case": case,
                        "error": error,
                        "reached": {engine: None if run is None else asdict(run) for engine, run in runs.items()},
                        "ratio": ours / best if best < math.inf else None,
                    }
                )
        return out

    def table(self) -> str:
        """Return a table of the time in ms per simulated second to reach an error, and nsdyn's over the best peer's."""
        width = max(len(engine) for engine in [*self.engines, "ours/best peer"])
        lines = ["processor time in ms per simulated second to reach an error of"]
        lines.append(" " * (10 + width) + "".join(f"{error:9.0e}" for error in ERRORS))
        summary = self.summary()
        for case in self.cases:
            rows = [row for row in summary if row["case"] == case]
            for k, engine in enumerate(self.engines):
                cells = (row["reached"][engine] for row in rows)
                texts = ("-" if cell is None else f"{1e3 * cell['seconds']:.3g}" for cell in cells)
                lines.append(f"{case if k == 0 else '':10}{engine:{width}}" + "".join(f"{text:>9}" for text in texts))
            if len(self.engines) > 1:
                texts = ("" if row["ratio"] is None else f"{row['ratio']:.2g}" for row in rows)
                lines.append(f"{'':10}{'ours/best peer':{width}}" + "".join(f"{text:>9}" for text in texts))
        return "\n".join(lines)

    def write_csv(self, path: str | Path) -> None:
        """Write all runs, one per line; missing numbers are empty."""
        rows = ((None if x in (-math.inf, math.inf) else x for x in astuple(run)) for run in self.runs)
        files.write_csv(path, [field.name for field in fields(Run)], rows)

    def plot(self, figure: Any) -> None:
        """Draw time per simulated second against error on a matplotlib figure, a panel for each case.

        A line is the time in which an engine reaches an error, as in the table; dots are its runs.
        """
        columns = min(4, len(self.cases))
        panels = figure.subplots(math.ceil(len(self.cases) / columns), columns, squeeze=False).ravel()
        bounds = np.logspace(-10.0, 0.0, 201)
        for axes, case in zip(panels, self.cases, strict=False):
            for k, engine in enumerate(self.engines):
                runs = [run for run in self._finished.get((case, engine), []) if math.isfinite(run.error)]
                error = [max(run.error, bounds[0]) for run in runs]
                axes.plot(error, [1e3 * run.seconds for run in runs], ".", color=f"C{k}", ms=3.0, alpha=0.4)
                reached = [self.within(case, engine, bound) for bound in bounds]
                seconds = [math.nan if run is None else 1e3 * run.seconds for run in reached]
                axes.plot(bounds, seconds, color=f"C{k}", lw=2.0 if k == 0 else 1.2, label=engine)
            if not any(math.isfinite(y) for line in axes.lines for y in line.get_ydata()):
                axes.set(ylim=(1.0, 10.0))  # no data to choose the limits by
                axes.text(0.5, 0.5, "no run ended within the limit", ha="center", transform=axes.transAxes)
            axes.set(xscale="log", yscale="log", xlim=(bounds[0], bounds[-1]))
            axes.set(title=CASES[case].title, xlabel=CASES[case].what, ylabel="ms per simulated second")
        for axes in panels[len(self.cases) :]:
            axes.axis("off")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(self.engines))


@dataclass(frozen=True)
class _Engine:
    """An engine: its script, the Python it needs, and the command that installs it."""

    script: str
    module: str
    install: str
    python: tuple[str, ...] = (sys.executable,)

    @property
    def command(self) -> list[str]:
        """Command that starts the worker."""
        return [*self.python, str(_SCRIPTS / self.script)]

    @property
    def installed(self) -> bool:
        """Whether the engine's Python has the engine's module."""
        if self.python == (sys.executable,):
            return importlib.util.find_spec(self.module) is not None
        try:
            return subprocess.run([*self.python, "-c", f"import {self.module}"], capture_output=True).returncode == 0
        except OSError:
            return False


PEERS = {
    "mujoco": _Engine("bench_mujoco.py", "mujoco", "pip install 'nsdyn[peers]'"),
    "drake": _Engine("bench_drake.py", "pydrake", "pip install 'nsdyn[peers]'"),
    "dart": _Engine("bench_dart.py", "dartpy", "pip install dartpy"),
    "bullet": _Engine("bench_bullet.py", "pybullet", "pip install pybullet"),
    "siconos": _Engine(
        # Debian's packages work in Debian's Python only, and paths for this Python would break it.
        "bench_siconos.py",
        "siconos.mechanics.collision.bullet",
        "apt-get install python3-siconos python3-scipy",
        ("/usr/bin/python3", "-E"),
    ),
}
"""Other engines by name."""


def measure(cases: Sequence[str] = (), peers: Sequence[str] = (), limit: float = 30.0, progress: bool = False) -> Bench:
    """Run cases in nsdyn's stepper and in peers, at every dt from the largest down until a run takes too long.

    Parameters
    ----------
    cases : sequence of str
        Names of `CASES`; default all.
    peers : sequence of str
        Names of `PEERS`; all settings of each are run.
    limit : float
        Longest stepping of a run, s; if a run takes longer, smaller dt are not tried.
    progress : bool
        Show a progress bar on stderr when it is a terminal.

    Raises
    ------
    ValueError
        For unknown names, a limit that is not positive, or a peer that is not installed.
    """
    for name in cases:
        choice(name, CASES, "case")
    for name in peers:
        if not PEERS[choice(name, PEERS, "peer")].installed:
            raise ValueError(f"peer {name} is not installed: {PEERS[name].install}")
    if not (math.isfinite(limit) and limit > 0.0):
        raise ValueError(f"limit must be a positive number of seconds, got {limit}")
    engines = {"nsdyn": _Engine("bench_nsdyn.py", "nsdyn", ""), **{name: PEERS[name] for name in peers}}
    chosen = [CASES[name] for name in cases] if cases else list(CASES.values())
    runs: list[Run] = []
    with (
        ExitStack() as ended,
        tempfile.TemporaryDirectory(prefix="nsdyn-") as scratch,
        tqdm(total=len(chosen) * len(engines), unit="case", disable=None if progress else True) as bar,
    ):
        workers = {name: ended.enter_context(closing(Worker(engine.command, 0.0))) for name, engine in engines.items()}
        for case in chosen:
            for name, worker in workers.items():
                runs += _play(case, name, worker, limit, Path(scratch) / "poses.npy")
                bar.update()
    return Bench(tuple(runs))


def _play(case: Case, engine: str, worker: Worker, limit: float, answer: Path) -> list[Run]:
    """Run an engine on a case with all its settings."""
    scene = describe(case.scene) | {"model": case.model, "parameters": case.parameters}
    reply = worker.ask({"scene": scene}, limit)
    if "failure" in reply:
        return [Run(case.name, engine, "", math.nan, math.inf, math.nan, reply["failure"])]
    t = np.linspace(case.every, case.duration, case.samples)
    runs = []
    for variant in reply["variants"]:
        for dt in case.steps:
            steps = round(case.every / dt)
            request = {"scene": scene, "variant": variant, "dt": dt, "steps": steps, "samples": case.samples}
            reply = worker.ask(request | {"answer": str(answer)}, limit)
            failure = reply.get("failure", "")
            too_slow = failure.startswith("no answer")
            error, seconds = math.nan if too_slow else math.inf, math.nan
            if not failure:
                poses, seconds = np.load(answer), reply["seconds"] / case.duration
                error = case.measure(case.scene, t, poses) if np.isfinite(poses).all() else math.inf
            runs.append(Run(case.name, engine, variant, dt, error, seconds, failure))
            if too_slow and dt <= SMALL:
                break
    return runs
