"""The problem files beside this script, from steps of named scenes: `python tests/data/make.py` writes them anew.

Global files have the factors M and H, local ones W alone; `rod` is planar.
"""

from pathlib import Path

import numpy as np

import nsdyn as nd

HERE = Path(__file__).parent


def problem(name: str, steps: int, **parameters: float) -> nd.FC3D:
    """Problem of a step of a named scene."""
    setup = nd.scenes.setup(name, **parameters)
    stepper = nd.Stepper(setup.scene, **setup.options())
    for _ in range(steps):
        step = stepper.step()
    return step.problem


def alone(factors: nd.FC3D) -> nd.FC3D:
    """The same, given by W alone."""
    return nd.FC3D(factors.W, factors.q, factors.mu)


def rod() -> nd.FC3D:
    """A rod of 1 kg and 1 m that falls on its two ends and slides: two contacts in a plane."""
    H = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, 0.1], [1.0, 0.0, 0.5], [0.0, 1.0, 0.1]])  # (N, T) of each end
    W = np.zeros((6, 6))
    planar = np.array([0, 1, 3, 4])
    W[np.ix_(planar, planar)] = H @ np.diag([1.0, 1.0, 12.0]) @ H.T
    W[2, 2] = W[5, 5] = 1.0
    return nd.FC3D(W, [-1.0, 0.5, 0.0, -0.8, 0.5, 0.0], [0.3, 0.3])


def main() -> None:
    """Write all files."""
    note = "Written by tests/data/make.py of nsdyn, from its scene of that name."
    files = {
        "stack": problem("stack", 5, height=4),
        "arch": problem("arch", 3),
        "pile": problem("pile", 120),
        "quadruped": problem("quadruped", 60),
        "capstan": alone(problem("capstan", 10)),
        "rod": rod(),
    }
    for name, made in files.items():
        dimension = 2 if name == "rod" else 3
        path = HERE / f"{name}.hdf5"
        nd.fclib.write(path, made, nd.solve(made), spacedim=dimension, description=note, overwrite=True)
        print(f"{path.name}: {made.nc} contacts")


if __name__ == "__main__":
    main()
