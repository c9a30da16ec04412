"""Spheres dropped into a container, from the drop to rest: the mean cost of a step, beside MuJoCo's.

    python demos/bench/drop.py [--spheres 200] [--arrangements 4] [--time 2] [--dt 5e-3] [--tol 1e-4]

MuJoCo (extra `peers`) runs at its defaults. The mean counts: piles are cheap in the air and at rest, and dear between.
"""

import argparse
import statistics
import time

import numpy as np
from scaling import spheres
from step_time import mujoco_steps

import nsdyn as nd
from nsdyn.audit import audit


def line(name: str, times: list[float], deepest: float, more: str = "") -> float:
    """Print a line of the table and return the mean in s."""
    mean = statistics.mean(times)
    print(
        f"{name:<16} mean {1e3 * mean:6.2f} ms  median {1e3 * statistics.median(times):6.2f}  "
        f"longest {1e3 * max(times):7.1f}  penetration {deepest:.1e} m{more}"
    )
    return mean


def ours(scene: nd.Scene, dt: float, tol: float, steps: int) -> float:
    """Mean seconds of a step."""
    stepper = nd.Stepper(scene, dt=dt, solver=nd.solvers.Auto(tol=tol), on_fail="ignore")
    times, poses, missed = [], [], 0
    stepper.step()  # loads the kernels
    for _ in range(steps):
        start = time.perf_counter()
        step = stepper.step()
        times.append(time.perf_counter() - start)
        poses.append(step.q)
        missed += not step.solution.converged
    deepest = audit.deepest(scene.describe(), np.array(poses))
    return line("nsdyn", times, deepest, f"  {missed} of {steps} steps missed {tol:g}")


def peer(scene: nd.Scene, dt: float, steps: int) -> float:
    """Mean seconds of MuJoCo's step."""
    import mujoco

    return line(f"MuJoCo {mujoco.__version__}", *mujoco_steps(scene, "default", dt, 0, steps))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spheres", type=int, default=200)
    parser.add_argument("--arrangements", type=int, default=4)
    parser.add_argument("--time", type=float, default=2.0)
    parser.add_argument("--dt", type=float, default=5e-3)
    parser.add_argument("--tol", type=float, default=1e-4)
    arguments = parser.parse_args()
    steps = round(arguments.time / arguments.dt)
    for arrangement in range(arguments.arrangements):
        scene = spheres(arguments.spheres, arrangement)
        mean = ours(scene, arguments.dt, arguments.tol, steps)
        try:
            print(f"nsdyn/MuJoCo {mean / peer(scene, arguments.dt, steps):.2f}")
        except ImportError:
            print("MuJoCo is not installed: pip install 'nsdyn[peers]'")


if __name__ == "__main__":
    main()
