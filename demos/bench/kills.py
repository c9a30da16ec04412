"""Runs that are killed at random moments, resumed, and compared with one that was not: no step lost, the same bits.

    python demos/bench/kills.py [--count N] [--seed S] [--full]

Each of the N runs is killed by SIGKILL after a random time, also within writes, until it ends: every file that a kill
leaves must open, with every step before the last flush and nothing else, and `nsdyn run --resume` goes on with it. At
the end all that was recorded but times must be that of a run that was never stopped, to the last bit. `--full` records
on a small file system that fills up.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import nsdyn as nd
from nsdyn.recording import file as recording

TIMES = ["wall_time", "solver/time"]
"""Columns of a machine, not of a motion."""

RUNS = {
    "pile": ["--set", "boxes=3", "--set", "spheres=3", "--time", "8", "--dt", "0.01"],
    "stack": ["--set", "height=3", "--time", "15", "--dt", "0.01"],
    "quadruped": ["--time", "1"],
    "rolling": ["--set", "balls=2", "--time", "3", "--every", "3"],
}
"""Scenes and options of `nsdyn run`, some seconds each."""


def started(name: str, how: str, path: Path) -> subprocess.Popen[bytes]:
    """The command, running."""
    command = [sys.executable, "-m", "nsdyn", "run", name, *RUNS[name], how, str(path)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


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
    path, how, kills, wrong, known = folder / "run.h5", "-o", 0, [], 0
    path.unlink(missing_ok=True)
    while True:
        process = started(name, how, path)
        try:
            _, told = process.communicate(timeout=float(rng.uniform(0.3, 1.0) * took))
            if process.returncode:
                wrong.append(f"exit code {process.returncode}: {told.decode()[-200:]}")
            break
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.communicate()
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
        known, how = rows, "--resume"
    if not wrong and (problem := differs(whole, contents(path))):
        wrong.append(f"at the end: {problem}")
    return [*wrong, str(kills)]


def full(folder: Path) -> None:
    """Record on a file system of 3 MB: the run ends with one line, and the file opens with what fitted."""
    with tempfile.TemporaryDirectory() as place:
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", place], check=True)
        try:
            process = started("pile", "-o", Path(place) / "run.h5")
            _, told = process.communicate()
            left = len(nd.Trajectory.load(Path(place) / "run.h5").t)
            print(
                f"full disk: exit code {process.returncode}, {left} rows, others {os.listdir(place)}: {told.decode()}"
            )
        finally:
            subprocess.run(["umount", place], check=True)


def main() -> int:
    """Exit code: 0 if nothing was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=20, help="kills (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
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
        for name in RUNS:
            begin = time.monotonic()
            process = started(name, "-o", folder / f"{name}.h5")
            process.communicate()
            wholes[name] = contents(folder / f"{name}.h5"), time.monotonic() - begin
        while kills < arguments.count:
            name = list(RUNS)[runs % len(RUNS)]
            *wrong, number = killed_run(name, *wholes[name], folder, rng)
            kills, runs, failures = kills + int(number), runs + 1, failures + len(wrong)
            for text in wrong:
                print(f"{name}: {text}", file=sys.stderr, flush=True)
                shutil.copy(folder / "run.h5", Path(tempfile.gettempdir()) / f"killed-{name}-{runs}.h5")
            print(f"{kills} kills in {runs} runs, {failures} failures", flush=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
