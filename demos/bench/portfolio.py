"""What `auto` solves and costs, on problems from files and on a wall that a ball hits.

    python demos/bench/portfolio.py [--tol 1e-8] [--steps 200] [--set warm_steps=4] [--ablation] [FOLDER ...]

Processor time. For every folder of FCLIB files: problems solved, the geometric mean, the mean and the longest solve
from nothing, by their factors if the file has them and by W alone. For the wall: the mean and longest time of a step
with the solver, at defaults, and how many solves ended within the loose tolerance only or failed. `--set` gives a
constant of `nsdyn.solvers.auto.Tuning` another value. `--ablation` prints instead what is lost without each means, and
with half and twice each constant of `Tuning`: problems solved of those that take under a second, and
the geometric mean of their times over those of `auto` as it is, solved in turns with it.
"""

import argparse
import ast
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import nsdyn as nd
from nsdyn.solvers import auto
from nsdyn.tools.arrays import Array


class Timed:
    """A solver that notes what it costs."""

    def __init__(self, solver: nd.solvers.Auto) -> None:
        self.solver, self.tol, self.spent = solver, solver.tol, 0.0
        self.status: Counter[str] = Counter()

    def __call__(self, problem: nd.FC3D, r0: Array | None = None) -> nd.Solution:
        """Solve the problem."""
        return self._counted(self._timed(self.solver, problem, r0))

    def balanced(self, problem: nd.FC3D, r0: Array, before: Array) -> nd.Solution:
        """Solve it from a start that is to be balanced."""
        return self._counted(self._timed(self.solver.balanced, problem, r0, before))

    def loosely(self, problem: nd.FC3D, r0: Array) -> nd.Solution:
        """Solve it to the loose tolerance."""
        return self._counted(self._timed(self.solver.loosely, problem, r0))

    def roughly(self, problem: nd.FC3D, r0: Array, effort: float) -> nd.Solution | None:
        """Solve it to what is posed anew, which is none of the solves that end in some way."""
        solution: nd.Solution | None = self._timed(self.solver.roughly, problem, r0, effort)
        return solution

    def _timed(self, solve: Callable[..., Any], *given: Any) -> Any:
        start = time.process_time()
        solution = solve(*given)
        self.spent += time.process_time() - start
        return solution

    def _counted(self, solution: nd.Solution) -> nd.Solution:
        self.status[solution.status.name] += 1
        return solution


def summary(times: list[float]) -> str:
    """Geometric mean, mean and longest of some seconds."""
    of = statistics.geometric_mean(times), statistics.mean(times), max(times)
    return "geometric mean {:.2f} ms, mean {:.1f} ms, longest {:.0f} ms".format(*(1e3 * t for t in of))


def files(folder: Path, tol: float) -> None:
    """Print what the problems of a folder cost."""
    problems = [nd.fclib.read(path) for path in sorted(folder.glob("*.hdf5"))]
    if not problems:
        print(f"{folder}: skipped, no FCLIB files there")
        return
    for form, given in (("as in the file", problems), ("W alone", [nd.FC3D(p.W, p.q, p.mu) for p in problems])):
        solver = Timed(nd.solvers.Auto(tol=tol, loose=tol))
        times = []
        for problem in [given[0], *given]:  # the first twice: it loads the kernels
            before = solver.spent
            solver(problem)
            times.append(solver.spent - before)
        solved = solver.status["CONVERGED"] - int(solver.solver(given[0]).converged)
        print(f"{folder.name}, {form}, {tol:.0e}: {solved} of {len(given)}, {summary(times[1:])}")


def others() -> Iterator[tuple[str, list[tuple[Any, str, Any]]]]:
    """Name of a change, and what it gives which other value."""
    newton = auto.Search.newton

    def polishing(search: auto.Search, most: float, tol: float) -> None:
        if most == auto.TUNING.warm_steps:
            newton(search, most, tol)

    yield "without sweeps", [(auto.Search, "sweep", lambda *_: None)]
    yield "without Newton's rounds", [(auto.Search, "newton", polishing)]
    yield "without the path", [(auto.Search, "follow", lambda *_: None)]
    yield "without the kernel of small islands", [(auto, "LIMITS", (0, *auto.LIMITS[1:]))]
    for field in fields(auto.TUNING):
        given = getattr(auto.TUNING, field.name)
        values = given if isinstance(given, tuple) else (given,)
        for k in range(len(values)):
            for factor in (0.5, 2.0):
                new = tuple(type(v)(factor * v) if i == k else v for i, v in enumerate(values))
                tuning = replace(auto.TUNING, **{field.name: new if isinstance(given, tuple) else new[0]})
                changes = [(auto, "TUNING", tuning), (auto, "LIMITS", (auto.DENSE, *tuning.small))]
                yield f"{field.name}{[k] if len(values) > 1 else ''} x {factor}", changes


def ablation(folders: list[Path], tol: float) -> None:
    """Print what each change costs, a line for each."""
    solver, problems = nd.solvers.Auto(tol=tol, loose=tol), []

    def timed(problem: nd.FC3D) -> tuple[float, bool]:
        start = time.process_time()
        solved = solver(problem).converged
        return time.process_time() - start, solved

    for path in sorted(path for folder in folders for path in folder.glob("*.hdf5")):
        problem = nd.fclib.read(path)
        solver(problem)  # loads the kernels
        if timed(problem)[0] < 1.0:
            problems.append(problem)
    print(f"{tol:.0e}, {len(problems)} problems: solved, time")
    for name, changes in others():
        old = [(owner, what, getattr(owner, what)) for owner, what, _ in changes]
        ratios, solved = [], 0
        for problem in problems:
            runs = []
            for values in (old, changes) * 3:
                for owner, what, value in values:
                    setattr(owner, what, value)
                runs.append(timed(problem))
                if len(runs) == 2 and runs[0][0] > 0.05:
                    break
            for owner, what, value in old:
                setattr(owner, what, value)
            solved += runs[1][1]
            if runs[0][1] and runs[1][1]:
                ratios.append(min(t for t, _ in runs[1::2]) / min(t for t, _ in runs[::2]))
        print(f"  {name}: {solved}, {statistics.geometric_mean(ratios):.2f} ({max(ratios):.1f} at most)", flush=True)


def wall(steps: int) -> None:
    """Print what the steps of a wall of 100 bricks cost that a ball hits at 15 m/s."""
    scene = nd.scenes.load("wall")()
    scene.add_sphere(
        "ball", 0.15, 16.0, position=(1.013, -0.6, 0.507), linear_velocity=(0, 15, 0), material=nd.Material(mu=0.6)
    )
    solver = Timed(nd.solvers.Auto())
    stepper = nd.Stepper(scene, dt=5e-3, solver=solver, on_fail="ignore")
    begin = stepper.get_state()
    stepper.step()  # loads the kernels
    stepper.set_state(begin)
    solver.status.clear()
    times = []
    for _ in range(steps):
        before = solver.spent
        stepper.step()
        times.append(solver.spent - before)
    print(f"wall hit by a ball, {steps} steps: {summary(times)}; solves {dict(solver.status)}")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--tol", type=float, default=1e-8)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--ablation", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    arguments = parser.parse_args()
    values = dict(given.split("=") for given in arguments.set)
    auto.TUNING = replace(auto.TUNING, **{name: ast.literal_eval(value) for name, value in values.items()})
    if arguments.ablation:
        ablation(arguments.folders, arguments.tol)
        return
    for folder in arguments.folders:
        files(folder, arguments.tol)
    if arguments.steps:
        wall(arguments.steps)


if __name__ == "__main__":
    main()
