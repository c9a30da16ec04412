"""What a tolerance costs at rest, in smooth motion and in a collision: solvers on problems from steps of scenes.

    python demos/bench/regimes.py FOLDER [--solver auto newton ...] [--limit 2] [--peer siconos] [--bodies 1000]
                                     [--plot regimes.png]

Writes the contact problems of three regimes, as FCLIB files, into three folders below FOLDER, unless they are there:
walls, pyramids and towers of rising size that stand; the same that slide on the ground, and rollers; walls that a ball
hits, piles and lattices that fall. Every solver then starts from nothing on each, at 1e-4, 1e-6 and 1e-8. Prints for
each regime and tolerance the performance profile, the iterations, and what remains unsolved and why; the figure shows
the profiles at 1e-8 and the time of `auto` against the number of contacts.
"""

import argparse
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import nsdyn as nd
from nsdyn.bench.profiles import Profile, measure

TOLERANCES = (1e-4, 1e-6, 1e-8)
SOLVERS = ("auto", "newton", "interior", "impulse_newton", "admm", "pgs")
DT = 5e-3

Source = tuple[str, nd.Scene, float, tuple[int, ...]]
"""Name, scene, speed along x that all its bodies get, and the steps whose problems are kept."""


def standing() -> Iterator[tuple[str, nd.Scene]]:
    """Walls, pyramids and towers of 4 to 200 bodies."""
    for n in (2, 4, 7, 10, 14):
        yield f"wall{n * n:03}", nd.scenes.load("wall")(rows=n, columns=n)
    for base in (3, 6, 10, 15):
        yield f"pyramid{base:02}", nd.scenes.load("pyramid")(base=base)
    for floors in (2, 6, 12):
        yield f"tower{floors:02}", nd.scenes.load("kapla")(floors=floors)


def rest() -> Iterator[Source]:
    """What stands."""
    for name, scene in standing():
        yield name, scene, 0.0, (3,)


def smooth() -> Iterator[Source]:
    """What slides and rolls."""
    for name, scene in standing():
        yield name, scene, 1.0, (3, 10)
    yield "logs", nd.scenes.load("logs")(), 0.0, (10, 30)
    yield "rolling", nd.scenes.load("rolling")(balls=20), 0.5, (10, 30)


def collision() -> Iterator[Source]:
    """What is hit and falls."""
    for n in (3, 5, 7, 10):
        scene = nd.scenes.load("wall")(rows=n, columns=n)
        scene.add_sphere(
            "ball",
            0.15,
            16.0,
            position=(0.107 * n, -0.3, 0.05 * n),
            linear_velocity=(0, 15, 0),
            material=nd.Material(mu=0.6),
        )
        yield f"wall{n * n:03}", scene, 0.0, (4, 8, 16, 32)
    for bodies in (10, 20, 40):
        yield f"pile{2 * bodies}", nd.scenes.load("pile")(boxes=bodies, spheres=bodies), 0.0, (80, 120, 160)
    for side in (3, 5):
        yield f"lattice{side**3:03}", nd.scenes.load("six_cubed")(side=side), 0.0, (100, 120, 160)


REGIMES: dict[str, Callable[[], Iterator[Source]]] = {"rest": rest, "smooth": smooth, "collision": collision}


def write(folder: Path, sources: Iterator[Source], bodies: int) -> None:
    """Write the problems of a regime, of scenes with so many bodies at most."""
    folder.mkdir(parents=True)
    for name, scene, speed, kept in sources:
        if len(scene.free_bodies) > bodies:
            continue
        stepper = nd.Stepper(scene, DT, on_fail="ignore")
        state = stepper.get_state()
        v = state.instant.v.copy()
        v[0::6] += speed
        twists = stepper.dynamics.twists(state.instant.placement, v)
        stepper.set_state(state._replace(instant=state.instant._replace(v=v, twists=twists)))
        for count in range(1, max(kept) + 1):
            problem = stepper.step().problem
            if count in kept and problem.nc:
                nd.fclib.write(folder / f"{name}-{count:03}.hdf5", problem)


def unsolved(p: Profile, limit: float) -> Iterator[str]:
    """A line for each solver that left problems: how many, how close it came, and whether time was the reason."""
    for name in p.solvers:
        left = [run for run in p.runs if run.solver == name and not run.solved]
        if left:
            late = sum(run.seconds > limit for run in left)
            errors = [run.error for run in left if np.isfinite(run.error)]
            near = f"error {min(errors):.1e} to {max(errors):.1e}" if errors else "no answer"
            sizes = f"{min(run.contacts for run in left)} to {max(run.contacts for run in left)} contacts"
            yield f"  {name} leaves {len(left)} ({sizes}): {late} out of time, {near}"


def work(p: Profile) -> Iterator[str]:
    """Median and largest number of iterations of each solver where it solves."""
    for name in p.solvers:
        counts = [run.iterations for run in p.runs if run.solver == name and run.solved]
        if counts:
            yield f"  {name}: {statistics.median(counts):g} iterations in the median, {max(counts)} at most"


def draw(profiles: dict[tuple[str, float], Profile], path: Path) -> None:
    """Profiles at the last tolerance above, times of `auto` against contacts below, a column a regime."""
    figure, axes = plt.subplots(2, len(REGIMES), figsize=(12, 7), layout="constrained")
    for (upper, lower), regime in zip(axes.T, REGIMES, strict=True):
        profiles[regime, TOLERANCES[-1]].plot(upper, legend=regime == list(REGIMES)[-1])
        upper.set_title(f"{regime}, {TOLERANCES[-1]:g}")
        for tol, marker in zip(TOLERANCES, "o^s", strict=True):
            runs = [run for run in profiles[regime, tol].runs if run.solver == "auto" and run.solved]
            lower.loglog([r.contacts for r in runs], [1e3 * r.seconds for r in runs], marker, ms=4, label=f"{tol:g}")
        lower.set(xlabel="contacts", ylabel="time of auto [ms]")
        lower.xaxis.set_minor_formatter("")  # which would be labels on top of each other
        lower.legend(title="tol", fontsize="x-small")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--solver", nargs="+", default=SOLVERS)
    parser.add_argument("--limit", type=float, default=2.0)
    parser.add_argument("--peer", action="append", default=[])
    parser.add_argument("--bodies", type=int, default=1000, help="larger scenes are left out")
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    profiles = {}
    for regime, sources in REGIMES.items():
        folder = arguments.folder / regime
        if not folder.is_dir():
            write(folder, sources(), arguments.bodies)
        for tol in TOLERANCES:
            p = measure(folder, arguments.solver, tol, arguments.limit, arguments.peer, progress=True)
            profiles[regime, tol] = p
            print(f"\n{regime}, {tol:g}\n{p.table()}", *work(p), *unsolved(p, arguments.limit), sep="\n", flush=True)
    if arguments.plot:
        draw(profiles, arguments.plot)


if __name__ == "__main__":
    main()
