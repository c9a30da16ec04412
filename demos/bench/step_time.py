"""Time per step of ten stacks of ten boxes, its parts, and MuJoCo's step on the same scene in the same run.

    python demos/bench/step_time.py [--scene stacks] [--dt 5e-3] [--tol 1e-6] [--steps 200]

MuJoCo (extra `peers`) runs at its defaults and at settings stiff enough for comparable penetration. Prints medians.
"""

import argparse
import statistics
import time
from typing import Any

import numpy as np

import nsdyn as nd
from nsdyn.audit import audit
from nsdyn.bench import engines

PHASES = ("contacts", "solve", "the rest", "record")


class Timed:
    """A function, or a solver, and the seconds spent in it."""

    def __init__(self, function: Any) -> None:
        self.function, self.seconds = function, 0.0

    def __call__(self, *arguments: Any) -> Any:
        """Call it."""
        begin = time.perf_counter()
        out = self.function(*arguments)
        self.seconds += time.perf_counter() - begin
        return out

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def ours(scene: nd.Scene, dt: float, tol: float, steps: int) -> tuple[list[float], float, float]:
    """Median seconds of each phase, deepest overlap [m] and drift [m] after settling for a quarter of a second."""
    from nsdyn.recording.recorder import Recorder

    solve = Timed(nd.solvers.Auto(tol=tol))
    stepper = nd.Stepper(scene, dt=dt, solver=solve)
    find = stepper.detector.find = Timed(stepper.detector.find)  # type: ignore[method-assign]
    start = stepper.get_state().instant.position.x
    split, poses = [], []
    with Recorder(None, {"dt": dt, "theta": 0.5, "solver": ""}, scene.describe(), stepper.start()) as recorder:
        for k in range(steps + round(0.25 / dt)):
            solve.seconds = find.seconds = 0.0
            begin = time.perf_counter()
            step = stepper.step()
            end = time.perf_counter()
            recorder.append(step)
            if k >= 0.25 / dt:
                rest = end - begin - find.seconds - solve.seconds
                split.append([find.seconds, solve.seconds, rest, time.perf_counter() - end])
                poses.append(step.q)
    deepest = audit.deepest(scene.describe(), np.array(poses))
    drift = float(np.abs(stepper.get_state().instant.position.x - start).max())
    return [statistics.median(phase) for phase in zip(*split, strict=True)], deepest, drift


def mujoco_steps(scene: nd.Scene, variant: str, dt: float, settling: int, steps: int) -> tuple[list[float], float]:
    """Seconds of each of MuJoCo's steps and its deepest overlap [m], after steps that are not looked at."""
    from nsdyn.bench._peers.bench_mujoco import Simulation

    simulation = Simulation(engines.describe(scene), variant, dt)
    simulation.advance(settling)
    times, poses = [], []
    for _ in range(steps):
        begin = time.perf_counter()
        simulation.advance(1)
        times.append(time.perf_counter() - begin)
        poses.append(simulation.poses().ravel())
    return times, audit.deepest(scene.describe(), np.array(poses))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="stacks")
    parser.add_argument("--dt", type=float, default=5e-3)
    parser.add_argument("--tol", type=float, default=1e-6)
    parser.add_argument("--steps", type=int, default=200)
    arguments = parser.parse_args()
    scene = nd.scenes.load(arguments.scene)()
    split, deepest, drift = ours(scene, arguments.dt, arguments.tol, arguments.steps)
    total = sum(split)
    print(f"{arguments.scene}, dt {arguments.dt:g} s, medians over {arguments.steps} steps after 0.25 s of settling")
    print(f"nsdyn, tol {arguments.tol:g}: {1e6 * total:8.0f} us   penetration {deepest:.1e} m   drift {drift:.1e} m")
    for phase, seconds in zip(PHASES, split, strict=True):
        print(f"  {phase:22} {1e6 * seconds:8.0f} us  {seconds / total:4.0%}")
    try:
        import mujoco
    except ImportError:
        print("MuJoCo is not installed: pip install 'nsdyn[peers]'")
        return
    for name in ("default", "stiff"):
        times, sunk = mujoco_steps(scene, name, arguments.dt, round(0.25 / arguments.dt), arguments.steps)
        seconds = statistics.median(times)
        print(
            f"MuJoCo {mujoco.__version__} {name}: {1e6 * seconds:8.0f} us   penetration {sunk:.1e} m   "
            f"nsdyn/MuJoCo time {total / seconds:.2f}, penetration {deepest / sunk if sunk else float('nan'):.1e}"
        )


if __name__ == "__main__":
    main()
