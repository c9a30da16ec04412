"""Writes `demos/README.md`: what nsdyn can do, with pictures and figures, by running it.

    python demos/gallery.py

Every scene is simulated as ``nsdyn run`` does, audited from its recording, and photographed by a headless Chromium.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn as nd
from nsdyn.view import pictures, viewer

HERE = Path(__file__).resolve().parent
G = 9.81
SIZE = 640, 400
"""Pixels of a picture."""


@dataclass(frozen=True)
class Exhibit:
    """A named scene and the law that it shows.

    Attributes
    ----------
    title, scene, law : str
    measure : callable
        What of a trajectory is compared with the law.
    unit : str
    exact : float
        What the law says.
    parameters : dict
    duration, at, dt : float, optional
        Of the run, by default the scene's own, of the picture, by default the end, and of a step; s.
    """

    title: str
    scene: str
    law: str
    measure: Callable[[nd.Trajectory], float]
    unit: str
    exact: float
    parameters: dict[str, Any] = field(default_factory=dict)
    duration: float | None = None
    at: float | None = None
    dt: float | None = None


def drift(trajectory: nd.Trajectory) -> float:
    """Largest distance of a free body from where it started, at the end, m."""
    x = trajectory.q[:, : 7 * trajectory.scene["free"]].reshape(len(trajectory.t), -1, 7)[..., :3]
    return float(np.linalg.norm(x[-1] - x[0], axis=1).max())


def _apex(trajectory: nd.Trajectory) -> float:
    fall = math.sqrt(2.0 / G)
    between = (trajectory.t > fall) & (trajectory.t < 2.6 * fall)
    return float(trajectory.body("ball").position[between, 2].max()) - 0.1


def _energy_drift(trajectory: nd.Trajectory) -> float:
    total = trajectory.energy.total
    return float(np.abs(total - total[0]).max() / trajectory.at_play)


EXHIBITS = (
    Exhibit(
        "Cube thrown along the ground",
        "slide",
        "Coulomb: it stops after v0²/(2 μ g), whatever its heading, since the friction cone is round.",
        lambda t: math.dist(*t.body("box").position[[0, -1]]),
        "m",
        2.0**2 / (2 * 0.5 * G),
        {"heading": 30.0},
        at=0.2,
    ),
    Exhibit(
        "A thousand kilograms on nine boxes of one",
        "heavy_on_light",
        "Statics: the ground carries all weights. The mass ratio that stalls relaxation does not matter to Newton's "
        "method in velocity space.",
        lambda t: float(t.force("heavy")[-1, 2]),
        "N",
        1000 * G,
        {"ratio": 1000.0, "below": 9},
        0.5,
    ),
    Exhibit(
        "Ball dropped on the ground",
        "bounce",
        "Newton's law of impact: the second apex is e² = 0.64 times the first. Impacts are located, so that this is "
        "exact at any dt.",
        _apex,
        "m",
        0.64,
        {},
        1.5,
        0.9,
    ),
    Exhibit(
        "Newton's cradle with gaps",
        "cradle",
        "Equal elastic balls hand on their velocity one by one: the last flies off with all of it.",
        lambda t: float(t.body("ball4").linear_velocity[-1, 0]),
        "m/s",
        1.0,
        {},
        0.5,
    ),
    Exhibit(
        "Ball in a V-groove",
        "groove",
        "Rolling on two sides: a = g sin α / (1 + 2/(5 sin² β)), on a smaller radius than its own.",
        lambda t: 2.0 * math.dist(*t.body("ball").position[[0, -1]]) / t.t[-1] ** 2,
        "m/s²",
        G * math.sin(math.radians(10)) / (1 + 2 / (5 * math.sin(math.radians(45)) ** 2)),
        at=0.7,
    ),
    Exhibit(
        "Books over the edge of a table",
        "overhang",
        "The harmonic series: a thousandth of a length inside the largest overhang they stand, and do not creep.",
        drift,
        "m",
        0.0,
        {},
        1.0,
    ),
    Exhibit(
        "Arch of eleven voussoirs",
        "arch",
        "Heyman: it stands if a thrust line lies within it, held by friction and one-sided contact alone.",
        drift,
        "m",
        0.0,
        {},
        1.0,
    ),
    Exhibit(
        "Wall of 105 bricks",
        "wall",
        "At rest is at rest: no drift, with redundant contacts whose impulses are not unique.",
        drift,
        "m",
        0.0,
        {},
        0.5,
    ),
    Exhibit(
        "Rattleback",
        "rattleback",
        "Spun the wrong way it rattles, stops and turns back. It rolls on one point, which sticks: friction does no "
        "work.",
        lambda t: abs(float(t.energy.friction.sum())) / t.at_play,
        "of the energy at play",
        0.0,
        {"spin": -5.0},
        2.0,
        dt=1e-4,
    ),
    Exhibit(
        "Bricard's mechanism",
        "bricard",
        "Six hinges on a closed loop, one freedom that no count sees: redundant constraints, energy kept.",
        _energy_drift,
        "of the energy at play",
        0.0,
        {},
        2.0,
        0.9,
    ),
    Exhibit(
        "Gripper",
        "gripper",
        "Friction holds what two fingers press with 20 N: the box comes up by 0.2 m, without sinking.",
        lambda t: float(np.ptp(t.body("box").position[[0, -1], 2])),
        "m",
        0.2,
    ),
    Exhibit(
        "Quadruped",
        "quadruped",
        "Twelve joints under implicit control, four feet: it stands and walks in place. While it stands the contact "
        "forces carry its weight.",
        lambda t: float(t.force("quadruped")[t.t_steps < 1.0][-1, 2]),
        "N",
        math.nan,
        {},
        2.0,
        1.2,
    ),
)


def command(exhibit: Exhibit) -> str:
    """The command that runs it."""
    settings = "".join(f" --set {name}={value}" for name, value in exhibit.parameters.items())
    time = "" if exhibit.duration is None else f" --time {exhibit.duration:g}"
    time += "" if exhibit.dt is None else f" --dt {exhibit.dt:g}"
    return f"nsdyn run {exhibit.scene}{settings}{time} --check --html {exhibit.scene}.html"


def run(exhibit: Exhibit) -> nd.Trajectory:
    """Its trajectory."""
    setup = nd.scenes.setup(exhibit.scene, **exhibit.parameters)
    return nd.simulate(setup.scene, exhibit.duration or setup.duration, **setup.options(dt=exhibit.dt or setup.dt))


def weight(scene: str) -> float:
    """Weight of the articulations of a scene, N."""
    setup = nd.scenes.setup(scene)
    return G * sum(sum(i.mass for i in a.model.inertias) for a in setup.scene.articulations.values())


def photograph(exhibit: Exhibit, trajectory: nd.Trajectory) -> str:
    """Make its picture and return its name."""
    name = f"gallery/{exhibit.scene}.png"
    page = HERE / "gallery.html"
    try:
        at = trajectory.t[-1] if exhibit.at is None else exhibit.at
        viewer.write_html(trajectory, page, at=at)
        pictures.screenshot(page, HERE / name, SIZE)
    finally:
        page.unlink(missing_ok=True)
    return name


def section(exhibit: Exhibit, trajectory: nd.Trajectory) -> str:
    """Its part of the page."""
    audit, worst = nd.check(trajectory), trajectory.worst()
    measured = exhibit.measure(trajectory)
    exact = weight(exhibit.scene) if math.isnan(exhibit.exact) else exhibit.exact
    contacts = len(trajectory.columns["contacts/gap"]) / trajectory.steps
    overlap = audit["overlap"]
    solver = trajectory.meta["solver"].partition("(")[0]
    play, potential = trajectory.at_play, float(np.abs(trajectory.energy.potential).max())
    energy = f"{play:.3g} J, numerics {trajectory.shares()['numerics'][1] / play:.0e} of it"
    if play <= 1e-6 * potential:
        energy = f"at rest ({play:.0e} J of {potential:.3g} J)"
    cells = (
        f"`{solver}`",
        f"{trajectory.dt:g} s",
        trajectory.steps,
        f"{contacts:.1f}",
        f"{worst['residual']:.0e} m/s",
        f"{max(overlap.amount, 0.0):.0e} m",
        energy,
        f"{np.median(trajectory.wall_time) * 1e3:.2f} ms",
        "passed" if audit.passed else "FAILED",
    )
    return f"""## {exhibit.title}

![{exhibit.title}]({photograph(exhibit, trajectory)})

{exhibit.law}

Measured **{measured:.6g}** {exhibit.unit}, exact {exact:.6g}.

```bash
{command(exhibit)}
```

| solver | dt | steps | contacts | worst residual | true overlap | energy at play | median step | audit |
|---|---|---|---|---|---|---|---|---|
| {" | ".join(map(str, cells))} |
"""


HEAD = """# Gallery

Written by `python demos/gallery.py`, which runs every scene below with the default solver and step, audits the motion
from its recording alone (`nd.check`: true overlaps, friction cones, balances of momentum and energy) and takes the
pictures. Times are of one busy machine. Coming from another engine? [Here is what differs](guide/coming_from.md).

Besides, scripts that print and draw more:

| script | what it shows |
|---|---|
| `sliding.py` | stopping distances in twelve directions |
| `stacking.py` | a thousand kilograms on nine boxes: the load under each |
| `tipping.py` | which blocks on a slope stay, slide, tip: the diagram below |
| `elastic_block.py` | an elastic block against a rigid plane: `nd.solve` alone, with scikit-fem |

## Which blocks on a slope stay, slide or tip

![Fates of 400 blocks over friction and slenderness](tipping.png)

400 short runs in a stored sweep, over the exact borders of rigid-body mechanics: none differs.
`python demos/tipping.py` draws it; these are three of its points:

```bash
nsdyn sweep incline --set angle=25 --set slenderness=3.8 --set mu=0.2,0.3,0.4 --time 0.1 --dt 5e-3 --store tipping.jsonl
```
"""


def main() -> None:
    """Run all, or those named, and write the page when all have run."""
    chosen = sys.argv[1:] or [exhibit.scene for exhibit in EXHIBITS]
    sections = []
    for exhibit in EXHIBITS:
        if exhibit.scene in chosen:
            print(exhibit.scene, flush=True)
            sections.append(section(exhibit, run(exhibit)))
    if len(sections) == len(EXHIBITS):
        (HERE / "README.md").write_text("\n".join([HEAD, *sections]))
        print("demos/README.md")
    else:
        print("\n".join(sections))


if __name__ == "__main__":
    main()
