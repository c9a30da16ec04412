"""Blocks on a slope of 25 degrees: which stay, slide, tip, or do both, over friction and slenderness.

Look at the borders: they are straight cuts through the picture, where the analytic ones are. A block of height/base s
stays if mu and 1/s are at least tan(a); it slides without tipping if mu is less than tan(a) and than 1/s; it tips about
its lower edge without slipping if friction can hold the edge, T <= mu N as its centre starts to turn,

    theta'' = 3 g (sin(a) h - cos(a) b) / (2 (b² + h²)),
    N = m (g cos(a) + theta'' b/2),   T = m (g sin(a) - theta'' h/2),

and tips and slides otherwise. Nothing creeps: what stays does so to 1e-9 m, so that each block's fate shows at once.
"""

import math
import os
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import nsdyn as nd

ANGLE, DURATION, DT = 25.0, 0.1, 5e-3
MU = np.linspace(0.05, 1.0, 20)
SLENDERNESS = np.linspace(0.6, 4.4, 20)
FATES = "stays", "slides", "tips", "tips and slides"
SEEN = 1e-6
"""What counts as motion, m and rad: far above what stays moves, far below what the least steep fall makes in 0.1 s."""


def expected(mu: float, slenderness: float) -> int:
    """Which of `FATES` mechanics has for a block that starts at rest."""
    a = math.radians(ANGLE)
    b, h = 1.0, slenderness
    turning = 1.5 * (math.sin(a) * h - math.cos(a) * b) / (b * b + h * h)  # theta''/g
    normal, tangential = math.cos(a) + turning * b / 2, math.sin(a) - turning * h / 2
    if turning <= 0.0:
        return 0 if mu >= math.tan(a) else 1
    if tangential <= mu * normal:
        return 2
    return 3 if mu > b / h else 1


def fate(trajectory: nd.Trajectory) -> int:
    """Which of `FATES` a block had: whether it turned, and whether its lower edge moved along the slope."""
    box = trajectory.body("box")
    a = math.radians(ANGLE)
    downhill = np.array((math.cos(a), 0.0, -math.sin(a)))
    size = trajectory.scene["geoms"][1]["size"]
    edge = np.array((0.5 * size[0], 0.0, -0.5 * size[2]))
    ends = Rotation.from_quat(box.quaternion[[0, -1]])
    turned = (ends[1] * ends[0].inv()).magnitude() > SEEN
    start, end = box.position[[0, -1]] + ends.apply(edge)
    return 2 * int(turned) + int(abs((end - start) @ downhill) > SEEN)


def run(mu: np.ndarray = MU, slenderness: np.ndarray = SLENDERNESS, **options: object) -> np.ndarray:
    """Fates over slenderness (rows) and friction (columns); `options` are those of `nsdyn.sweep`."""
    parameters = {"angle": [ANGLE], "slenderness": slenderness.tolist(), "mu": mu.tolist()}
    members = nd.sweep("incline", parameters, DURATION, keep=fate, dt=DT, **options)
    return np.array([member.result for member in members]).reshape(len(slenderness), len(mu))


def draw(fates: np.ndarray, ax: object) -> None:
    """Fates as points over the analytic borders."""
    mu, s = np.meshgrid(np.linspace(0.0, 1.05, 400), np.linspace(0.4, 4.6, 400))
    exact = np.vectorize(expected)(mu, s)
    colours = ["#4c78a8", "#f2b447", "#59a14f", "#d1495b"]
    ax.contourf(mu, s, exact, levels=[-0.5, 0.5, 1.5, 2.5, 3.5], colors=colours, alpha=0.3)
    for k, name in enumerate(FATES):
        rows, columns = np.nonzero(fates == k)
        ax.plot(MU[columns], SLENDERNESS[rows], "o", ms=4, color=colours[k], label=name)
    ax.set(
        xlabel="friction mu", ylabel="height / base", title=f"Blocks on a slope of {ANGLE:g}°: simulated, over exact"
    )
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def main() -> None:
    """Sweep, compare with the borders, and draw."""
    from matplotlib.figure import Figure

    fates = run(executor=os.cpu_count(), progress=True, store="tipping.jsonl")
    exact = np.array([[expected(mu, s) for mu in MU] for s in SLENDERNESS])
    for k, name in enumerate(FATES):
        print(f"{name:16} {np.sum(fates == k):4d} simulated, {np.sum(exact == k):4d} expected")
    print(f"{np.sum(fates != exact)} of {fates.size} differ")
    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    draw(fates, figure.subplots())
    figure.savefig("tipping.png", dpi=100)
    Path("tipping.jsonl").unlink()
    print("tipping.png")


if __name__ == "__main__":
    main()
