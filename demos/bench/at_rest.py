"""What a step costs where nothing happens, and over what it costs in another checkout, run in turns.

    python demos/bench/at_rest.py [SCENE]... [--baseline CHECKOUT] [--rounds 5]

Medians over a process, and over the rounds; each process has one thread. The baseline compiles its kernels first.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

from scaling import DT, median_step, resting

import nsdyn as nd

SCENES = {
    "slide": (nd.scenes.load("slide"), 2000),
    "stacks": (nd.scenes.load("stacks"), 300),
    "wall": (nd.scenes.load("wall"), 150),
    "boxes": (lambda: resting(1000), 60),
}
"""By name: scene and number of steps."""


def cost(name: str) -> float:
    """Median µs of a step at 1e-6."""
    make, steps = SCENES[name]
    return 1e6 * median_step(nd.Stepper(make(), dt=DT, solver=nd.solvers.Auto(tol=1e-6)), 50, steps)


def alone(checkout: Path, names: list[str]) -> dict[str, float]:
    """Costs of scenes with the package of a checkout, in a process of its own."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--only", *names]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    out: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return out


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)} (default: all)")
    parser.add_argument("--baseline", type=Path, help="folder of another checkout")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", action="store_true", help="this version alone, printed as JSON")
    arguments = parser.parse_args()
    names = arguments.scenes or list(SCENES)
    if arguments.only:
        print(json.dumps({name: cost(name) for name in names}))
        return
    sides = [Path(nd.__file__).parent.parent, *([arguments.baseline.resolve()] if arguments.baseline else [])]
    for side in sides[1:]:
        alone(side, names)
    rounds = [[alone(side, names) for side in sides] for _ in range(arguments.rounds)]
    print(f"{'scene':8} {'µs per step':>12}" + f" {'baseline':>9} {'ratio':>6}" * (len(sides) - 1))
    for name in names:
        ours, *other = (statistics.median(costs[k][name] for costs in rounds) for k in range(len(sides)))
        print(f"{name:8} {ours:12.1f}" + "".join(f" {theirs:9.1f} {ours / theirs:6.3f}" for theirs in other))


if __name__ == "__main__":
    main()
