"""Random scenes of everything: each within its bars, or refused with the reason; nothing wrong in silence.

    python demos/bench/anything.py [--count N] [--seed S] [--begin K] [--bad]

Bodies of every shape in random poses, so far apart that their bounding spheres do not touch, are thrown at each other
so that they meet within the steps simulated: with friction, restitution, a law of impact, fixed and driven bodies,
surfaces that slide, arms, gravity in any direction. With `--bad` sizes, masses, speeds and places are extreme, bodies
are needles and sheets, and start in each other or in vices. Of each scene:

- `nd.check` audits the recording: true overlaps, cones, momenta, energies, works (its bars are below);
- energies are computed anew and must not grow, where the law of impact promises it;
- every problem solved is measured anew, by code of its own, and must be what the solver says it is;
- a step that misses its tolerance must be warned of, and what raises must say why;
- a run stops only where no velocity opens all contacts, so that a solution need not exist.
"""

import argparse
import collections
import dataclasses
import math
import signal
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn as nd
from nsdyn.audit.findings import TOLERANCES
from nsdyn.audit.poses import Poses
from nsdyn.audit.touching import separations
from nsdyn.problem.solution import ACCEPTED

sys.path.insert(0, str(Path(__file__).resolve().parent))
import truth

SECONDS = 120
"""That a scene may take."""

BARS = TOLERANCES | {"created": 1e-7, "misreported": 1e-9}
"""Most of each figure: those of `nd.check`, energy out of nothing over that in play, and what a solver says of its
answer - what it is. The step keeps energies to its tolerance of 1e-8, `loose` answers to a thousandth of their 1e-4."""

BAD = "distance normal cone motion momentum energy works spin lifts balance dissipation created misreported".split()
BAD_BARS = {name: BARS[name] for name in BAD} | {"overlap": 1e-5}
"""Those of `--bad` scenes."""

Rng = np.random.Generator

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 {half}"/><mass value="{mass}"/>
<inertia ixx="{big}" iyy="{big}" izz="{small}" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 {half}"/><geometry><capsule radius="{radius}" length="{half}"/></geometry></collision>
</link>
<link name="lower"><inertial><origin xyz="0 0 {half}"/><mass value="{mass}"/>
<inertia ixx="{big}" iyy="{big}" izz="{small}" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 {half}"/><geometry><box size="{radius} {radius} {half}"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="0" velocity="0"/><dynamics friction="{friction}" damping="{damping}"/></joint>
<joint name="elbow" type="revolute">
<limit lower="-3" upper="3" effort="0" velocity="0"/><parent link="upper"/><child link="lower"/>
<origin xyz="0 0 {length}"/>
<axis xyz="1 0 0"/></joint></robot>"""


@dataclasses.dataclass(frozen=True)
class Measured(nd.solvers.Auto):
    """The default solver, whose answers are measured anew: the largest difference is kept in `worst`."""

    worst: list[float] = dataclasses.field(default_factory=lambda: [0.0], compare=False)

    def __call__(self, problem: nd.FC3D, r0: np.ndarray | None = None) -> Any:
        """As of `Auto`."""
        solution = super().__call__(problem, r0)
        if problem.nc and np.isfinite(solution.r).all():
            r, mu = solution.r.reshape(-1, 3), problem.mu
            u = (problem.W @ solution.r + problem.q).reshape(-1, 3)
            z = r - u
            z[:, 0] -= mu * np.hypot(u[:, 1], u[:, 2])
            error = float(np.linalg.norm(r - projected(z, mu))) / (float(np.linalg.norm(problem.q)) or 1.0)
            # Round-off of W r + q, of the size of what cancels in it.
            cancels = np.finfo(float).eps * float(np.linalg.norm(abs(problem.W) @ np.abs(solution.r)))
            slack = cancels / (float(np.linalg.norm(problem.q)) or 1.0)
            self.worst[0] = max(self.worst[0], abs(error - solution.error) - slack - 1e-3 * error)
        return solution


def projected(z: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """The closest points of Coulomb's cones, by cases."""
    out = np.zeros_like(z)
    for k, (n, x, y) in enumerate(z):
        t, m = math.hypot(x, y), mu[k]
        if n >= 0.0 and t <= m * n:
            out[k] = n, x, y
        elif m * t > -n:
            height = (n + m * t) / (1.0 + m * m)
            out[k, 0] = height
            out[k, 1:] = (m * height / t * np.array([x, y])) if t > 0.0 else 0.0
    return out


def add_shape(scene: nd.Scene, name: str, a: float, b: float, c: float, rng: Rng, **keywords: Any) -> float:
    """Add a body of any kind with about these extents; returns the radius of its bounding sphere."""
    match rng.integers(6):
        case 0:
            scene.add_box(name, (a, b, c), **keywords)
        case 1:
            scene.add_sphere(name, a / 2, **keywords)
        case 2:
            scene.add_capsule(name, a / 2, b, **keywords)
        case 3:
            scene.add_cylinder(name, a / 2, b, **keywords)
        case 4:
            scene.add_ellipsoid(name, (a / 2, b / 2, c / 2), **keywords)
        case 5:  # with corners as sharp as an octahedron's
            points = [*np.eye(3), *-np.eye(3), *(truth.along(rng) for _ in range(rng.integers(0, 10)))]
            scene.add_convex(name, np.array(points) * (a / 2, b / 2, c / 2), **keywords)
    return float(scene.bodies[name].shape.bounding_radius)


def random_scene(seed: int, folder: Path) -> tuple[nd.Scene, dict[str, Any], bool]:
    """A random scene, how to simulate it, and whether its energy must not grow."""
    rng = np.random.default_rng([20261122, seed])
    kind = rng.choice(["plastic", "smooth", "poisson", "fremond", "kane"], p=[0.5, 0.15, 0.125, 0.125, 0.1])
    one = 0.0 if kind == "plastic" else rng.choice([1.0, rng.uniform()])
    dt = float(rng.choice([1e-2, 5e-3, 1e-3, 10.0 ** rng.uniform(-4, -2)]))

    def material() -> nd.Material:
        mu = 0.0 if kind == "smooth" or rng.uniform() < 0.2 else rng.uniform(0.0, rng.choice([1.0, 3.0]))
        return nd.Material(mu, rng.uniform() if kind in ("fremond", "kane") else one)

    base = 10.0 ** rng.uniform(-2.0, 0.7)
    gravity = rng.choice([0.0, 1.0, 1.0, 10.0]) * min(9.81, 0.1 * base / dt**2) * truth.along(rng)
    scene = nd.Scene(gravity=gravity, friction_rule=str(rng.choice(["geometric_mean", "min", "max"])))
    spread = rng.choice([0.1, 0.5])
    count, cell = int(rng.integers(2, 8)), 2.2 * base * 10.0**spread
    speed = cell / (dt * rng.uniform(2.0, 40.0))
    free = True
    for k, at in enumerate(rng.permutation(list(np.ndindex(2, 2, 2)))[:count] - 0.5):
        a, b, c = 0.9 * base * 10.0 ** rng.uniform(-spread, spread, 3)
        common = {"quaternion": truth.turned(rng), "material": material()}
        if k == 0 or rng.uniform() < 0.8:
            aim = truth.along(rng) - 2.0 * at
            common |= {
                "mass": 10.0 ** rng.uniform(-2.0, 2.0),
                "linear_velocity": speed * rng.uniform() * aim,
                "angular_velocity": rng.choice([0.0, 0.3]) * rng.uniform() / dt * truth.along(rng),
            }
        else:
            common["fixed"] = True
        radius = add_shape(scene, f"body{k}", a, b, c, rng, position=(0, 0, 0), **common)
        shrink = min(1.0, 0.49 * cell / radius)
        if shrink < 1.0:
            del scene.bodies[f"body{k}"]
            add_shape(scene, f"body{k}", *(0.4 * base * np.ones(3)), rng, position=(0, 0, 0), **common)
        jitter = 0.5 * cell - scene.bodies[f"body{k}"].shape.bounding_radius
        place = cell * at + max(0.0, jitter) * rng.uniform(-0.5, 0.5, 3)
        scene.bodies[f"body{k}"] = dataclasses.replace(scene.bodies[f"body{k}"], position=place)
        if "fixed" in common and rng.uniform() < 0.5:
            free = False
            if rng.uniform() < 0.6:
                turn = 0.1 * rng.choice([0.0, 1.0]) / dt * truth.along(rng)
                scene.set_motion(f"body{k}", velocity=(0.3 * speed * truth.along(rng), turn))
            else:
                scene.set_motion(f"body{k}", surface_velocity=0.3 * speed * truth.along(rng))
    if rng.uniform() < 0.5:
        normal = truth.along(rng) - 0.1 * gravity
        normal /= np.linalg.norm(normal)
        scene.add_halfspace("ground", normal, -1.01 * cell * np.abs(normal).sum(), material=material())
    if rng.uniform() < 0.15:
        free = False
        add_arm(scene, folder, base, cell, dt, rng)
    names = list(scene.bodies)
    if rng.uniform() < 0.3:
        a, b = rng.choice(names, 2, replace=False) if len(names) > 1 else (names[0], names[0])
        if a != b:
            scene.set_pair(str(a), str(b), mu=float(rng.uniform(0.0, 1.0)) if kind != "smooth" else 0.0)
    law = str(kind) if kind in ("poisson", "fremond") else "dissipative"
    theta = float(rng.choice([0.5, 0.5, 0.5, rng.uniform(0.5, 1.0)]))
    return scene, {"dt": dt, "impact": law, "theta": theta}, free and theta == 0.5


def add_arm(scene: nd.Scene, folder: Path, base: float, cell: float, dt: float, rng: Rng) -> None:
    """An arm of two links beside the others, which moves."""
    length, mass = base, 10.0 ** rng.uniform(-1.0, 1.0)
    path = folder / "arm.urdf"
    path.write_text(
        ARM.format(
            half=length / 2,
            length=length,
            mass=mass,
            radius=0.1 * length,
            big=mass * length**2 / 12,
            small=mass * length**2 / 600,
            friction=rng.choice([0.0, 0.1]) * mass,
            damping=rng.choice([0.0, 0.1]) * mass,
        )
    )
    velocity = 0.05 / dt * rng.uniform(-1.0, 1.0, 2)
    scene.add_urdf(
        "arm",
        path,
        position=(2.5 * cell, 0, 0),
        v=velocity,
        q=rng.uniform(-0.9, 0.9, 2),
        restitution=float(rng.choice([0.0, 0.5])),
    )


def bad_scene(seed: int, folder: Path) -> tuple[nd.Scene, dict[str, Any], bool]:
    """A scene that no one should ask for: extreme sizes, masses, speeds, places, shapes, and starts."""
    rng = np.random.default_rng([20261123, seed])
    scale = 10.0 ** rng.uniform(-5.0, 4.0)
    dt = float(10.0 ** rng.uniform(-4.0, -2.0))
    where = rng.choice([0.0, 0.0, 1e6]) * truth.along(rng)
    kind = rng.choice(["masses", "sizes", "needles", "same place", "deep", "vice", "fast", "vertex"])
    scene = nd.Scene(gravity=(0, 0, -float(rng.choice([0.0, 9.81, min(9.81, 1e-2 * scale / dt**2)]))))
    material = nd.Material(float(rng.choice([0.0, 0.5, 1.0])))
    scene.add_halfspace("ground", offset=float(where[2]), material=material)
    size = np.full(3, scale)
    for k in range(3):
        mass = 10.0 ** rng.uniform(-6, 6) if kind == "masses" else 1.0
        if kind == "sizes":
            size = scale * 10.0 ** rng.uniform(-2.0, 0.0) * np.ones(3)
        if kind == "needles":
            size = scale * rng.permutation([1.0, rng.choice([1.0, 1e-3]), 1e-3])
        at = np.array([0.0, 0.0, (0.9 + 2.0 * k) * scale])
        if kind == "same place":
            at = np.array([0.0, 0.0, scale])
        if kind == "deep":
            at = np.array([0.0, 0.0, (0.5 + (1.0 - 10.0 ** rng.uniform(-9, 0)) * k) * scale])
        speed = 10.0 ** rng.uniform(-3.0, 4.0) if kind == "fast" else scale / dt * rng.choice([0.0, 0.01, 0.2])
        quaternion = np.array([0.0, 0.0, 0.0, 1.0]) if kind in ("deep", "vice") else truth.turned(rng)
        common: dict[str, Any] = {
            "mass": mass,
            "material": material,
            "position": where + at,
            "quaternion": quaternion,
            "linear_velocity": speed * truth.along(rng),
            "angular_velocity": rng.choice([0.0, 0.1]) / dt * truth.along(rng),
        }
        if kind == "vertex":
            corners = np.array([[0, 0, -1], [1, 0, 0.1], [-1, 1, 0.1], [-1, -1, 0.1]])
            scene.add_convex(f"body{k}", scale * corners, **common)
        elif kind in ("deep", "vice"):
            scene.add_box(f"body{k}", size, **common)
        else:
            add_shape(scene, f"body{k}", *(0.5 * size), rng, **common)
    if kind == "vice":  # a wall comes down on what cannot go anywhere
        scene.add_box("wall", (10 * scale, 10 * scale, scale), fixed=True, position=where + np.array([0, 0, 8 * scale]))
        scene.set_motion("wall", velocity=(0, 0, -0.5 * scale / dt))
    return scene, {"dt": dt, "impact": "dissipative", "theta": 0.5}, kind != "vice"


REFUSED = ("overlap at the start", "must", "is not possible", "in each other")


def outcome(
    scene: nd.Scene, how: dict[str, Any], conserves: bool, steps: int, bars: dict[str, float] = BARS
) -> tuple[str, dict[str, float]]:
    """What came of a scene in a word or a sentence, and its figures."""
    solver = Measured()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            trajectory = nd.simulate(scene, steps * how["dt"], solver=solver, **how)
        except ValueError as refused:
            return f"refused: {refused}", {}
        except nd.NotConverged as stopped:
            excused = stopped.solution.status is nd.Status.NO_SLATER_POINT
            return f"{'stopped' if excused else 'stopped although a solution exists'}: {stopped}", {}
        warned = [str(w.message) for w in told]
        audit = nd.check(trajectory)
    fine = (*ACCEPTED, nd.Status.OVERLAP)
    missed = int((~np.isin(trajectory.solver.status, fine)).sum())
    squeezed = int((trajectory.solver.status == nd.Status.OVERLAP).sum())
    if missed and not any("did not converge" in text for text in warned):
        return "silent: a step missed its tolerance without a warning", {}
    figures = {f.name: f.worst for f in audit.findings if not f.reason} | {"misreported": solver.worst[0]}
    if conserves:
        figures["created"] = truth.created(scene, trajectory)
    else:
        figures.pop("dissipation", None)
    if squeezed:
        figures.pop("overlap", None)
    elif any("overlap at the start" in text for text in warned):
        figures["overlap"] = later_overlap(trajectory)
    if not (np.isfinite(trajectory.q).all() and np.isfinite(trajectory.v).all()):
        return "silent: the state is not finite", figures
    rounded = round_off(scene, trajectory)
    worse = [
        f"{name} {figures[name]:.2e}"
        for name, bar in bars.items()
        if not figures.get(name, 0.0) <= bar + rounded.get(name, 0.0)
    ]
    if worse:
        return f"above the bar: {', '.join(worse)}", figures
    return "missed, warned of" if missed else "squeezed, told" if squeezed else "passed", figures


def round_off(scene: nd.Scene, trajectory: nd.Trajectory) -> dict[str, float]:
    """What numbers of 53 bits leave of figures that are about places, far from the origin; next to nothing near it.

    Overlaps are differences of two places, rounded to half of eps |x| where they are stored, and in each of the
    turns and sums that gaps are found by, twice: by the step and by the audit. Every step rounds places once more, and
    with them potential energies by eps |V| / 2 a body.
    """
    free, eps = len(scene.free_bodies), np.finfo(float).eps
    x = np.linalg.norm(trajectory.q[:, : 7 * free].reshape(-1, 7)[:, :3], axis=1).max(initial=0.0)
    size = min((2.0 * body.shape.inscribed_radius for body in scene.free_bodies), default=1.0)
    energy = trajectory.energy
    play = float(energy.kinetic.max() + np.ptp(energy.potential)) or 1.0
    return {
        "overlap": float(8.0 * eps * x / size),
        "created": float(trajectory.steps * eps * free * np.abs(energy.potential).max() / play),
    }


def later_overlap(trajectory: nd.Trajectory) -> float:
    """Largest overlap by size after the start, where a warning says that bodies start in each other."""
    poses = Poses(trajectory)
    depth, first, second, state = separations(poses)
    return float((depth / poses.size(first, second))[state > 0].max(initial=0.0))


def parsed(given: list[str] | None = None) -> argparse.Namespace:
    """Arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100, help="scenes (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="added to the number of each scene times 10 million")
    parser.add_argument("--begin", type=int, default=0, help="first scene (default: %(default)s)")
    parser.add_argument("--steps", type=int, default=25, help="of each (default: %(default)s)")
    parser.add_argument("--bad", action="store_true", help="scenes that no one should ask for")
    return parser.parse_args(given)


def main() -> int:
    """Exit code: 0 if every scene passed or was refused with a reason."""
    tally, worst, failures = campaign(parsed())
    print(f"{sum(tally.values())} scenes: {dict(tally)}")
    print("worst figures: " + ", ".join(f"{name} {value:.1e} (scene {k})" for name, (value, k) in worst.items()))
    return 1 if failures else 0


def campaign(arguments: argparse.Namespace) -> tuple[collections.Counter[str], dict[str, tuple[float, int]], int]:
    """Counts of outcomes, worst figures with their scenes, and the number of failures, which are told on stderr."""
    tally, worst, failures = collections.Counter[str](), {}, 0

    def late(*_: object) -> None:
        raise TimeoutError(f"more than {SECONDS} s")

    signal.signal(signal.SIGALRM, late)
    make, bars = (bad_scene, BAD_BARS) if arguments.bad else (random_scene, BARS)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(arguments.begin, arguments.begin + arguments.count):
            start = time.process_time()
            signal.alarm(SECONDS)
            try:
                found, figures = outcome(*make(10_000_000 * arguments.seed + k, Path(folder)), arguments.steps, bars)
            except ValueError as refused:  # by the scene itself
                found, figures = f"refused: {refused}", {}
            except Exception as other:  # whatever it is, it is the finding
                place = traceback.extract_tb(other.__traceback__)[-1]
                found, figures = f"{type(other).__name__}: {other} ({Path(place.filename).name}:{place.lineno})", {}
            finally:
                signal.alarm(0)
            what, _, reason = found.partition(":")
            if what == "refused" and not any(word in reason for word in REFUSED):
                what = "refused for no reason"
            tally[what] += 1
            for name, value in figures.items():
                if value > worst.get(name, (0.0, 0))[0]:
                    worst[name] = value, k
            if what not in ("passed", "refused", "stopped", "missed, warned of", "squeezed, told"):
                failures += 1
                print(f"{k}: {found[:300]}", file=sys.stderr, flush=True)
            elif what in ("stopped",) or time.process_time() - start > 20.0:
                print(f"{k}: {found[:300]} ({time.process_time() - start:.1f} s)", file=sys.stderr, flush=True)
    return tally, worst, failures


if __name__ == "__main__":
    sys.exit(main())
