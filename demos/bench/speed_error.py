"""Speed against error: a cube that slides to a stop, along the contact frame and at 30 degrees to it.

    python demos/bench/speed_error.py

Error is the distance from the exact stopping point v0²/(2 mu g); time is wall time per simulated second, the median of
five runs, recording included for nsdyn. MuJoCo (extra `peers`) runs in the same run, at its defaults and stiff.
"""

import math
import statistics
import time

import numpy as np
from step_time import mujoco_model

import nsdyn as nd

MU, SPEED, DURATION = 0.5, 2.0, 0.5
STOP = SPEED**2 / (2 * MU * 9.81)


def median_time(run, repeats: int = 5) -> float:
    """Median wall time in s of calling `run`, after one call that warms up."""
    run()
    times = []
    for _ in range(repeats):
        t = time.perf_counter()
        run()
        times.append(time.perf_counter() - t)
    return statistics.median(times)


def ours(heading: float, dt: float) -> tuple[float, float]:
    """(error in m, wall time per simulated second) of nsdyn."""
    scene = nd.scenes.load("slide")(mu=MU, speed=SPEED, heading=heading)
    end = nd.simulate(scene, DURATION, dt=dt).body("box").position[-1]
    return error(end, heading), median_time(lambda: nd.simulate(scene, DURATION, dt=dt)) / DURATION


def error(end: np.ndarray, heading: float) -> float:
    """Distance in the plane from the exact stopping point, m."""
    a = math.radians(heading)
    return math.dist(end[:2], (STOP * math.cos(a), STOP * math.sin(a)))


def mujoco(heading: float, dt: float, stiff: bool) -> tuple[float, float]:
    """The same for MuJoCo."""
    import mujoco as mj

    scene = nd.scenes.load("slide")(mu=MU, speed=SPEED, heading=heading)
    model = mj.MjModel.from_xml_string(mujoco_model(scene, dt, stiff))

    def run() -> np.ndarray:
        data = mj.MjData(model)
        data.qvel[:3] = scene.bodies["box"].linear_velocity
        for _ in range(round(DURATION / dt)):
            mj.mj_step(model, data)
        return data.qpos.copy()

    return error(run(), heading), median_time(run) / DURATION


def main() -> None:
    """Run and print."""
    print(f"{'heading':>8} {'engine':>16} {'dt [s]':>8} {'error [m]':>10} {'ms per s':>9}")
    engines = {"nsdyn": ours}
    try:
        import mujoco as mj  # noqa: F401

        engines["MuJoCo default"] = lambda heading, dt: mujoco(heading, dt, False)
        engines["MuJoCo stiff"] = lambda heading, dt: mujoco(heading, dt, True)
    except ImportError:
        print("MuJoCo is not installed: pip install 'nsdyn[peers]'")
    for heading in (0.0, 30.0):
        for name, engine in engines.items():
            for dt in (1e-2, 1e-3, 1e-4):
                if name == "nsdyn" and dt < 1e-3:
                    continue
                wrong, seconds = engine(heading, dt)
                print(f"{heading:7.0f}° {name:>16} {dt:8.0e} {wrong:10.1e} {1e3 * seconds:9.1f}")


if __name__ == "__main__":
    main()
