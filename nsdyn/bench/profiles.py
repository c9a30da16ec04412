"""Performance profiles of solvers over a folder of FCLIB problems, nsdyn's and peers', judged by the same measure.

Every solver runs in a process of its own with one thread and a hard limit on the time of each call, so that a solver
that hangs or crashes loses only the current problem. A problem counts as solved if `FC3D.error` of the returned impulse
is within the tolerance; the solver's own claim is ignored. Only the solver's call on a newly built problem is timed,
after one call to compile: the best of all calls that fit in 50 ms, of at least three (of one if it takes more than a
second).

References
----------
E. Dolan, J. Moré, Benchmarking optimization software with performance profiles, Mathematical Programming 91, 2002.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from nsdyn.problem.fc3d import FC3D
from nsdyn.recording import fclib
from nsdyn.solvers import SOLVERS, by_name
from nsdyn.tools import files
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice
from nsdyn.tools.workers import Worker
from nsdyn.view import panels

FACTORS = (1.0, 2.0, 5.0, 47.0)
"""Ratios to the best time at which a table shows the profile."""

_SCRIPTS = Path(__file__).with_name("_peers")
_COMPILING = 120.0  # s that a solver of nsdyn may spend on compilation in all its first calls
_DENSE = 100  # contacts up to which a dense W is tried too, if a peer accepts both


@dataclass(frozen=True)
class Run:
    """One solver on one problem.

    Attributes
    ----------
    problem : str
    contacts : int
    solver : str
    solved : bool
        Whether `error` is within the tolerance.
    seconds : float
        Time of the solve, inf if there is no answer within the time limit.
    iterations : int
        In the unit of the solver.
    error, residual : float
        `FC3D.error` [-] and `FC3D.residual` [m/s] of the impulse.
    note : str
        Reason for a missing answer, or how a peer was called.
    """

    problem: str
    contacts: int
    solver: str
    solved: bool
    seconds: float
    iterations: int
    error: float
    residual: float
    note: str


@dataclass(frozen=True, eq=False)
class Profile:
    """Runs of several solvers on the same problems.

    Attributes
    ----------
    tol : float
        Tolerance of `FC3D.error`.
    limit : float
        Time limit, s per solve.
    runs : tuple of Run
        Runs of every solver on every problem.
    """

    tol: float
    limit: float
    runs: tuple[Run, ...]

    @property
    def problems(self) -> list[str]:
        """Names of the problems, the rows of `times`."""
        return list(dict.fromkeys(run.problem for run in self.runs))

    @property
    def solvers(self) -> list[str]:
        """Names of the solvers, the columns of `times`."""
        return list(dict.fromkeys(run.solver for run in self.runs))

    @cached_property
    def times(self) -> Array:
        """Seconds, shape (problems, solvers); inf where not solved."""
        seconds = {(run.problem, run.solver): run.seconds for run in self.runs if run.solved}
        return np.array([[seconds.get((p, s), math.inf) for s in self.solvers] for p in self.problems])

    @cached_property
    def ratios(self) -> Array:
        """Times over the best of each problem, shape (problems, solvers); inf where not solved."""
        out = np.full(self.times.shape, math.inf)
        np.divide(self.times, self.times.min(axis=1, keepdims=True), out=out, where=np.isfinite(self.times))
        return out

    def rho(self, factor: float) -> Array:
        """Return the fraction of problems that each solver solves within `factor` times the best time, (solvers,)."""
        return (self.ratios <= factor).mean(axis=0)

    def summary(self) -> list[dict[str, Any]]:
        """Return figures of each solver.

        The figures are the number of solved problems, ρ at `FACTORS`, and the geometric mean of the ratios over the
        solved problems. Against the best of each peer's solvers, they are the geometric mean and the largest ratio over
        the problems that both solve.
        """
        rho = [self.rho(factor) for factor in FACTORS]
        out = []
        for k, name in enumerate(self.solvers):
            figures: dict[str, Any] = {
                "solver": name,
                "solved": int(np.isfinite(self.times[:, k]).sum()),
                "problems": len(self.problems),
                "rho": {f"{factor:g}": float(values[k]) for factor, values in zip(FACTORS, rho, strict=True)},
                "mean_ratio": _geometric_mean(self.ratios[:, k]),
            }
            for peer in PEERS:
                columns = [j for j, other in enumerate(self.solvers) if other.startswith(peer)]
                if columns and not name.startswith(tuple(PEERS)):
                    best = self.times[:, columns].min(axis=1)
                    both = np.isfinite(self.times[:, k]) & np.isfinite(best)
                    ratios = self.times[both, k] / best[both]
                    figures[f"against_{peer}"] = {
                        "problems": ratios.size,
                        "mean_ratio": _geometric_mean(ratios),
                        "largest_ratio": float(ratios.max(initial=0.0)),
                    }
            out.append(figures)
        return out

    def table(self) -> str:
        """Return the summary as text."""
        width = max(map(len, self.solvers))
        columns = "".join(f"{f'ρ({factor:g})':>8}" for factor in FACTORS)
        lines = [f"{'solver':{width}}  solved{columns}  mean ratio"]
        notes = []
        for row in self.summary():
            values = "".join(f"{value:8.2f}" for value in row["rho"].values())
            lines.append(
                f"{row['solver']:{width}} {row['solved']:3}/{row['problems']:<3}{values}  {row['mean_ratio']:10.3g}"
            )
            for peer in PEERS:
                if against := row.get(f"against_{peer}"):
                    notes.append(
                        f"{row['solver']} against the best of {peer} on {against['problems']} problems: time ratio "
                        f"{against['mean_ratio']:.3g} in the geometric mean, {against['largest_ratio']:.3g} at most"
                    )
        return "\n".join(lines + notes)

    def plot(self, axes: Any, legend: bool = True) -> Any:
        """Draw ρ(τ) of every solver on matplotlib axes and return them."""
        end = 1.1 * float(self.ratios[np.isfinite(self.ratios)].max(initial=10.0))
        for k, name in enumerate(self.solvers):
            x = np.sort(self.ratios[:, k])
            x = x[np.isfinite(x)]
            y = np.arange(x.size + 1) / len(self.problems)
            look = panels.look(k) | {"lw": 1.0 if name.startswith(tuple(PEERS)) else 1.6}
            axes.step(np.r_[1.0, x, end], np.r_[y, y[-1]], where="post", label=name, **look)
        axes.set(xscale="log", xlim=(1.0, end), ylim=(0.0, 1.02), title=f"tol {self.tol:g}")
        axes.set(xlabel="τ: time over the best time", ylabel="ρ(τ): fraction of the problems")
        if legend:
            axes.legend(fontsize="small", frameon=False, handlelength=2.6, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return axes


def write_csv(path: str | Path, profiles: Sequence[Profile]) -> None:
    """Write all runs of some profiles, one per line after its tolerance; seconds are empty without an answer."""
    all_runs = ((profile.tol, *astuple(run)) for profile in profiles for run in profile.runs)
    rows = ((None if x in (-math.inf, math.inf) else x for x in run) for run in all_runs)
    files.write_csv(path, ["tol", *(field.name for field in fields(Run))], rows)


def _geometric_mean(x: Array) -> float:
    """Return the geometric mean of the finite entries, nan if there are none."""
    x = x[np.isfinite(x)]
    return math.exp(float(np.log(x).mean())) if x.size else math.nan


@dataclass(frozen=True)
class _Player:
    """A solver and how to call it.

    Attributes
    ----------
    label : str
        Name of the solver in the profile.
    solver : str
        Name of the solver in the script.
    script : tuple of str
        Python and script.
    own : bool
        Whether the solver is nsdyn's: it reads FCLIB files, while peers get W, q and mu.
    tightening : tuple of float
        Factors of the tolerance, tried until `FC3D.error` meets it: peers measure their errors differently.
    dense : bool
        Whether the solver also accepts W in dense storage.
    """

    label: str
    solver: str
    script: tuple[str, str]
    own: bool = False
    tightening: tuple[float, ...] = (1.0, 0.1, 0.01)
    dense: bool = False

    def play(self, worker: Worker, file: Path, problem: FC3D, tol: float, limit: float, scratch: Path) -> Run:
        """Return the solver's run on one problem: the fastest that is within the tolerance, else the closest."""
        runs = []
        for storage in ("", "/dense") if self.dense and problem.nc <= _DENSE else ("",):
            for factor in self.tightening:
                request = {
                    "problem": str(file.absolute() if self.own else _as_arrays(file, problem, scratch)),
                    "solver": self.solver + storage,
                    "tol": factor * tol,
                    "answer": str(scratch / "answer.npy"),
                }
                reply = worker.ask(request, limit)
                runs.append(self._judged(file, problem, tol, reply, request))
                if runs[-1].solved or "failure" in reply:
                    break
            if "failure" in reply:
                break
        return min(runs, key=lambda run: (not run.solved, run.seconds if run.solved else run.error))

    def _judged(self, file: Path, problem: FC3D, tol: float, reply: dict[str, Any], request: dict[str, Any]) -> Run:
        who = file.stem, problem.nc, self.label
        if "failure" in reply:
            return Run(*who, False, math.inf, 0, math.inf, math.inf, reply["failure"])
        r = np.load(request["answer"])
        error, residual = (x if math.isfinite(x) else math.inf for x in (problem.error(r), problem.residual(r)))
        note = "" if self.own else f"{request['solver']} at {request['tol']:g}"
        return Run(*who, error <= tol, reply["seconds"], reply["iterations"], error, residual, note)


def _as_arrays(file: Path, problem: FC3D, scratch: Path) -> Path:
    """Write W in 3 x 3 blocks, q and mu to a file; W has a block everywhere on its diagonal."""
    path = scratch / f"{file.stem}.npz"
    if not path.exists():
        W = problem.W
        np.savez(path, data=W.data, indices=W.indices, indptr=W.indptr, q=problem.q, mu=problem.mu)
    return path


def _own(name: str, tol: float) -> _Player:
    by_name(name, tol)  # raises for an unknown solver or a wrong tolerance
    return _Player(name, name, (sys.executable, str(_SCRIPTS / "nsdyn_worker.py")), own=True, tightening=(1.0,))


def _siconos() -> list[_Player]:
    script = "/usr/bin/python3", str(_SCRIPTS / "siconos_worker.py")  # Debian's packages work in Debian's Python only
    try:
        done = subprocess.run([*script, "--list"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        raise ValueError("peer siconos needs Debian's package: apt-get install python3-siconos python3-scipy") from None
    return [_Player(f"siconos {name}", name, script, dense=True) for name in json.loads(done.stdout)]


def _pinocchio() -> list[_Player]:
    script = sys.executable, str(_SCRIPTS / "pinocchio_worker.py")
    names = "ADMM-LINEAR", "ADMM-SPECTRAL", "ADMM-OSQP", "PGS"
    # Pinocchio's tolerances are absolute, of velocities and energies; `FC3D.error` is relative: both may differ much.
    return [_Player(f"pinocchio {name}", name, script, tightening=(1.0, 0.1, 0.01, 1e-4, 1e-6)) for name in names]


PEERS: dict[str, Callable[[], list[_Player]]] = {"siconos": _siconos, "pinocchio": _pinocchio}
"""Peers by name: functions that return their solvers, or raise ValueError saying what to install."""


def measure(
    folder: str | Path,
    solvers: Sequence[str] = ("auto",),
    tol: float = 1e-8,
    limit: float = 10.0,
    peers: Sequence[str] = (),
    min_contacts: int = 0,
    progress: bool = False,
) -> Profile:
    """Run solvers on all FCLIB problems (``*.hdf5``) of a folder.

    Parameters
    ----------
    folder : path
    solvers : sequence of str
        Names of `nsdyn.solvers.SOLVERS`, or "all" for every one of them.
    tol : float
        Tolerance of `FC3D.error`. A peer whose answer misses it is called again with a tenth and a hundredth of it.
    limit : float
        Time limit, s per solve.
    peers : sequence of str
        Names of `PEERS`; all solvers of each are run.
    min_contacts : int
        Problems with fewer contacts are left out.
    progress : bool
        Show a progress bar on stderr when it is a terminal.

    Raises
    ------
    ValueError
        For a folder without such problems, a file that cannot be read, unknown names, a limit or tolerance that is not
        positive, a negative number of contacts, or a peer that is not installed.
    """
    from tqdm import tqdm

    files = sorted(Path(folder).glob("*.hdf5"))
    if not files:
        raise ValueError(f"no *.hdf5 files in {folder}")
    if not (math.isfinite(limit) and limit > 0.0):
        raise ValueError(f"limit must be a positive number of seconds, got {limit}")
    if min_contacts < 0:
        raise ValueError(f"min_contacts must be a number of contacts, at least 0, got {min_contacts}")
    names = [name for given in solvers for name in (SOLVERS if given == "all" else (given,))]
    players = [_own(name, tol) for name in dict.fromkeys(names)]
    for peer in peers:
        players += PEERS[choice(peer, PEERS, "peer")]()
    problems = [(file, problem) for file in files if (problem := fclib.read(file)).nc >= min_contacts]
    if not problems:
        raise ValueError(f"no problem in {folder} has {min_contacts} contacts")
    runs = []
    with (
        tempfile.TemporaryDirectory(prefix="nsdyn-") as scratch,
        tqdm(total=len(problems) * len(players), unit="solve", disable=None if progress else True) as bar,
    ):
        for player in players:
            with closing(Worker(list(player.script), _COMPILING if player.own else 0.0)) as worker:
                for file, problem in problems:
                    runs.append(player.play(worker, file, problem, tol, limit, Path(scratch)))
                    bar.update()
    return Profile(tol, limit, tuple(runs))
