"""Runs that are killed at random moments, resumed, and compared with one that was not: no step lost, the same bits.

    python demos/bench/kills.py [--count N] [--seed S] [--scene NAME]... [--full]

Each run is killed by SIGKILL after a random time, also within writes, and goes on until it comes to its end: every file
that a kill leaves must open, with the rows of a run that was never stopped and never fewer than before. At the end all
that was recorded but times must be that of the other run, to the last bit. `--full` records on a small file system that
fills up.
"""

import argparse
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn as nd
from nsdyn.recording import file as recording
from nsdyn.recording import recorder

TIMES = ["wall_time", "solver/time"]
"""Columns of a machine, not of a motion."""

RUNS: dict[str, tuple[dict[str, Any], int, dict[str, Any]]] = {
    "pile": ({"boxes": 3, "spheres": 3}, 600, {}),
    "stack": ({"height": 3}, 1500, {}),
    "quadruped": ({}, 800, {}),
    "rolling": ({"balls": 2}, 900, {"every": 3}),
    "woodpecker": ({}, 600, {"contacts": False}),
}
"""Named scenes: parameters, steps, options of the recording."""


def run(name: str, how: str, path: Path, flush: float) -> None:
    """Simulate, flushing every so many seconds."""
    parameters, steps, options = RUNS[name]
    recorder._FLUSH_SECONDS = flush
    setup = nd.scenes.setup(name, **parameters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        nd.simulate(setup.scene, steps * setup.dt, **setup.options(), **options, **{how: path})


def contents(path: Path) -> recording.Columns:
    """Columns of a recording but times."""
    columns = recording.read(path)[2]
    return {name: values for name, values in columns.items() if name not in TIMES}


def differs(part: recording.Columns, whole: recording.Columns) -> str:
    """Where the rows of a part are not those of the whole to the last bit; empty if all are."""
    for name, values in part.items():
        if values.tobytes() != whole[name][: len(values)].tobytes():
            return f"{name} differs"
    return ""


def killed_run(name: str, whole: recording.Columns, took: float, folder: Path, rng: np.random.Generator) -> list[str]:
    """What went wrong in a run that is killed again and again, and how many kills it took, as its last word."""
    path, how, kills, wrong, known = folder / "run.h5", "record", 0, [], 0
    path.unlink(missing_ok=True)
    flush = float(rng.choice([0.0, 0.02, 0.5]))  # after every row, often, as it is
    while True:
        process = multiprocessing.get_context("fork").Process(target=run, args=(name, how, path, flush))
        process.start()
        # Longer after each kill, so that the run comes to its end however seldom it flushes and slow the machine is.
        process.join(float(rng.uniform(0.0, 0.5) * took * 1.1**kills))
        if not process.is_alive():
            if process.exitcode:
                wrong.append(f"exit code {process.exitcode}")
            break
        process.kill()
        process.join()
        kills += 1
        if not path.exists():  # killed before its first write: nothing was recorded
            continue
        try:
            part = contents(path)
        except (ValueError, OSError) as failure:
            wrong.append(f"after {kills} kills: {failure}")
            break
        rows = len(part["t"])
        if problem := differs(part, whole):
            wrong.append(f"after {rows} rows: {problem}")
        if rows < known:
            wrong.append(f"{known - rows} rows of the file before are gone")
        known, how = rows, "resume"
    if not wrong and (problem := differs(whole, contents(path))):
        wrong.append(f"at the end: {problem}")
    return [*wrong, str(kills)]


def full(folder: Path) -> None:
    """Record on a file system of 3 MB: the run ends with one line, and the file opens with what fitted."""
    with tempfile.TemporaryDirectory() as place:
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", place], check=True)
        try:
            command = [sys.executable, "-m", "nsdyn", "run", "pile", "--time", "8", "-o", f"{place}/run.h5"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            left = len(nd.Trajectory.load(f"{place}/run.h5").t)
            print(f"full disk: exit code {done.returncode}, {left} rows, {os.listdir(place)}: {done.stderr}")
        finally:
            subprocess.run(["umount", place], check=True)


def main() -> int:
    """Exit code: 0 if nothing was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20, help="kills (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", action="append", choices=list(RUNS), help="may be repeated (default: all)")
    parser.add_argument("--full", action="store_true", help="fill a small file system instead (as root)")
    arguments = parser.parse_args()
    kills = failures = runs = 0
    rng = np.random.default_rng(arguments.seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if arguments.full:
            full(folder)
            return 0
        wholes = {}
        names = arguments.scene or list(RUNS)
        for name in names:
            run(name, "record", folder / f"{name}.h5", 0.5)  # loads the kernels
            begin = time.monotonic()
            run(name, "record", folder / f"{name}.h5", 0.5)
            wholes[name] = contents(folder / f"{name}.h5"), time.monotonic() - begin
        while kills < arguments.count:
            name = names[runs % len(names)]
            *wrong, number = killed_run(name, *wholes[name], folder, rng)
            kills, runs, failures = kills + int(number), runs + 1, failures + len(wrong)
            for text in wrong:
                print(f"{name}: {text}", file=sys.stderr, flush=True)
                shutil.copy(folder / "run.h5", Path(tempfile.gettempdir()) / f"killed-{name}-{runs}.h5")
            print(f"{kills} kills in {runs} runs, {failures} failures", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
