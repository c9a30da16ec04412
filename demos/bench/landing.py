"""Chain of light links that falls on the ground and comes to rest there: time of a step, and the longest.

    python demos/bench/landing.py [--links 20] [--dt 2e-3] [--time 1]

Every link strikes by itself, and then lies on two contacts: up to twice as many contacts as links, whose impulses are
far from unique. Time is processor time of a step in the second of two runs, when all kernels are loaded. MuJoCo (extra
`peers`) runs the same file in the same run, at its defaults, and says what it warns of.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import nsdyn as nd


def mjcf(links: int) -> str:
    """The chain, inclined, 1 m above the ground: links of 0.1 m and 0.1 kg, whose hinges turn about y and x in turn."""
    text = ""
    for k in reversed(range(links + 1)):
        joint = f'<joint axis="{k % 2} {(k + 1) % 2} 0"/>' if k else "<freejoint/>"
        place = 'pos="0 0 -.1"' if k else 'pos="0 0 1" euler="0 68.75 0"'
        link = '<geom type="capsule" fromto="0 0 -.02 0 0 -.08" size=".02" contype="2" conaffinity="1"/>'
        mass = '<inertial pos="0 0 -.05" mass=".1" diaginertia="1e-4 1e-4 1e-4"/>'
        text = f'<body name="link{k}" {place}>{joint}{mass}{link}{text}</body>'
    floor = '<geom type="plane" size="5 5 .1"/>'
    return f'<mujoco><default><geom friction=".5"/></default><worldbody>{floor}{text}</worldbody></mujoco>'


def times(step: Callable[[], object], count: int) -> np.ndarray:
    """Processor times of so many steps, s."""
    out = []
    for _ in range(count):
        start = time.process_time()
        step()
        out.append(time.process_time() - start)
    return np.array(out)


def ours(path: Path, dt: float, count: int) -> tuple[np.ndarray, str]:
    """Times of nsdyn's steps, and how many its solver left above the tolerance."""
    scene = nd.Scene()
    scene.add_mjcf("chain", path)
    for _ in range(2):
        stepper, missed = nd.Stepper(scene, dt=dt), []
        seconds = times(lambda: missed.append(not stepper.step().solution.converged), count)  # noqa: B023 now
    return seconds, f"{sum(missed)} steps above the tolerance"


def mujoco(path: Path, dt: float, count: int) -> tuple[np.ndarray, str]:
    """Times of MuJoCo's steps, and its warnings."""
    import mujoco as mj

    model = mj.MjModel.from_xml_path(str(path))
    model.opt.timestep = dt
    data = mj.MjData(model)
    seconds = times(lambda: mj.mj_step(model, data), count)
    unstable = sum(int(w.number) for w in data.warning)
    return seconds, f"{unstable} warnings"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--links", type=int, default=20, help="links after the first (default: 20)")
    parser.add_argument("--dt", type=float, default=2e-3, help="step, s (default: 2e-3)")
    parser.add_argument("--time", type=float, default=1.0, help="simulated seconds (default: 1)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.xml"
        path.write_text(mjcf(arguments.links))
        print(f"{'engine':>8} {'median':>8} {'mean':>8} {'longest':>8}  [ms a step]")
        for name, run in (("nsdyn", ours), ("MuJoCo", mujoco)):
            try:
                seconds, said = run(path, arguments.dt, round(arguments.time / arguments.dt))
            except ImportError:
                print("MuJoCo is not installed: pip install 'nsdyn[peers]'")
                continue
            figures = " ".join(f"{1e3 * f(seconds):8.2f}" for f in (np.median, np.mean, np.max))
            print(f"{name:>8} {figures}  {said}", flush=True)


if __name__ == "__main__":
    main()
