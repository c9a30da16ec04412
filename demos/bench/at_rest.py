"""What a step costs where nothing happens, and over what it costs in another checkout.

    python demos/bench/at_rest.py [SCENE]... [--baseline CHECKOUT] [--rounds 15]

Both versions run at once, each in a process of one thread, and take turns of some steps: a busy machine disturbs both
alike. Processor times: the lower quartile of the steps of a turn, of these the median over the rounds; the ratio
is the median of the ratios of the rounds.
"""

import argparse
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from scaling import DT, resting

import nsdyn as nd

SCENES = {
    "slide": (nd.scenes.load("slide"), 300),
    "stacks": (nd.scenes.load("stacks"), 60),
    "wall": (nd.scenes.load("wall"), 40),
    "boxes": (lambda: resting(1000), 20),
    "four_bar": (nd.scenes.load("four_bar"), 100),
}
"""By name: scene and steps of a turn."""


def serve() -> None:
    """For each name that is asked for, µs per step of a turn of that scene."""
    steppers = {}
    for line in sys.stdin:
        make, steps = SCENES[line.strip()]
        if line not in steppers:
            steppers[line] = nd.Stepper(make(), dt=DT, solver=nd.solvers.Auto(tol=1e-6))
        times = []
        for _ in range(steps):
            start = time.process_time()
            steppers[line].step()
            times.append(1e6 * (time.process_time() - start))
        print(np.quantile(times, 0.25), flush=True)


def start(checkout: Path) -> subprocess.Popen[str]:
    """A process that serves with the package of a checkout."""
    environment = (
        os.environ | {"PYTHONPATH": str(checkout)} | dict.fromkeys(("OMP_NUM_THREADS", "NSDYN_COMPILE_PROCESSES"), "1")
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    return subprocess.Popen([sys.executable, __file__, "--serve"], env=environment, **pipes)


def ask(process: subprocess.Popen[str], name: str) -> float:
    """µs per step of one turn."""
    print(name, file=process.stdin)
    return float(process.stdout.readline())


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)} (default: all)")
    parser.add_argument("--baseline", type=Path, help="folder of another checkout")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve()
        return
    sides = [Path(nd.__file__).parent.parent, *([arguments.baseline.resolve()] if arguments.baseline else [])]
    processes = [start(side) for side in sides]
    print(f"{'scene':8} {'µs per step':>12}" + f" {'baseline':>9} {'ratio':>6}" * (len(sides) - 1))
    for name in arguments.scenes or SCENES:
        for process in processes:  # the kernels are compiled and the bodies settle
            ask(process, name)
        turns = [[ask(process, name) for process in processes] for _ in range(arguments.rounds)]
        ours, *other = (statistics.median(side) for side in zip(*turns, strict=True))
        line = f"{name:8} {ours:12.1f}"
        for theirs in other:
            line += f" {theirs:9.1f} {statistics.median(a / b for a, b in turns):6.3f}"
        print(line, flush=True)
    for process in processes:
        process.stdin.close()
        process.wait()


if __name__ == "__main__":
    main()
