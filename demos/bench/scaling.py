"""How the cost of a step grows: with bodies, with contacts, with the tolerance, and with features a scene uses.

    python demos/bench/scaling.py [--largest 10000]

Medians of whole steps after settling, and the peak memory of a process that does nothing else; the exponent is the
slope between the smallest and the largest scene, in logarithms. Piles settle by a bounded number of sweeps a step until
their kinetic energy would lift the bodies by no more than 1e-8 of their radius, or 1e-5 for spheres, some of which roll
on; then `auto` takes over, at the tolerance of the benchmark. The largest take ten to twenty minutes.
"""

import argparse
import json
import math
import resource
import statistics
import subprocess
import sys
import time

import numpy as np

import nsdyn as nd

DT = 5e-3


def flying(bodies: int) -> nd.Scene:
    """Spheres that touch nothing: free flight."""
    scene = nd.Scene()
    side = math.ceil(bodies ** (1 / 3))
    for k in range(bodies):
        at = 0.5 * (k % side), 0.5 * (k // side % side), 10.0 + 0.5 * (k // side**2)
        scene.add_sphere(f"ball{k}", 0.1, 1.0, position=at)
    return scene


def on_the_ground(bodies: int) -> tuple[nd.Scene, list[tuple[float, float, float]]]:
    """(scene with a ground, places 0.4 m apart on a square grid, 0.1 m above it)."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    side = math.ceil(math.sqrt(bodies))
    return scene, [(0.4 * (k % side), 0.4 * (k // side), 0.1) for k in range(bodies)]


def resting(bodies: int) -> nd.Scene:
    """Boxes that stand apart on the ground, four contacts each."""
    scene, places = on_the_ground(bodies)
    for k, at in enumerate(places):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=at)
    return scene


def rolling(bodies: int) -> nd.Scene:
    """Spheres that roll apart on the ground: every contact is solved in every step."""
    scene, places = on_the_ground(bodies)
    for k, at in enumerate(places):
        scene.add_sphere(f"ball{k}", 0.1, 1.0, position=at, linear_velocity=(1, 0, 0))
    return scene


def container(side: float) -> nd.Scene:
    """An open square container, `side` m wide, mu = 0.5."""
    scene = nd.Scene()
    material = nd.Material(mu=0.5)
    scene.add_halfspace("ground", material=material)
    for k, normal in enumerate([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]):
        scene.add_halfspace(f"wall{k}", normal=normal, offset=-side / 2, material=material)
    return scene


def cells(bodies: int, pitch: float) -> tuple[float, np.ndarray]:
    """(width, centres (bodies, 3)) of a heap about twice as high as wide, a little out of line so that it collapses."""
    side = max(2, round((bodies / 2) ** (1 / 3)))
    k = np.arange(bodies)
    grid = np.stack([k % side - 0.5 * (side - 1), k // side % side - 0.5 * (side - 1), k // side**2 + 0.55], axis=1)
    grid[:, :2] += np.random.default_rng(0).uniform(-0.02, 0.02, (bodies, 2))
    return pitch * (side + 0.1), pitch * grid


def spheres(bodies: int, arrangement: int = 0) -> nd.Scene:
    """Spheres dropped into a container; from arrangement to arrangement they stand up to 4 mm elsewhere."""
    side, centres = cells(bodies, 0.18)
    if arrangement:
        centres = centres + np.random.default_rng(arrangement).uniform(-0.004, 0.004, centres.shape)
    scene = container(side)
    for k, at in enumerate(centres):
        scene.add_sphere(f"ball{k}", 0.08, 1.0, position=at, material=nd.Material(mu=0.5))
    return scene


def boxes(bodies: int) -> nd.Scene:
    """Boxes dropped into a container, every one turned."""
    side, centres = cells(bodies, 0.18)
    scene = container(side)
    turns = np.random.default_rng(1).normal(size=(bodies, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    for k, (at, turn) in enumerate(zip(centres, turns, strict=True)):
        scene.add_box(f"box{k}", (0.1, 0.1, 0.1), 1.0, position=at, quaternion=turn, material=nd.Material(mu=0.5))
    return scene


SCENES = {
    "flying": (flying, 1e-6, 10_000, None),
    "resting": (resting, 1e-6, 10_000, None),
    "rolling": (rolling, 1e-6, 10_000, None),
    "spheres": (spheres, 1e-3, 10_000, 1e-5),
    "boxes": (boxes, 1e-4, 1000, 1e-8),
}
"""By name: scene, tolerance, the most bodies, and how high in radii its energy may lift a pile that has settled."""


def settled(scene: nd.Scene, tol: float, lift: float) -> nd.Stepper:
    """Stepper of a pile that has come down."""
    bodies = scene.free_bodies
    still = lift * sum(9.81 * b.mass * b.shape.bounding_radius for b in bodies)
    hasty = nd.Stepper(scene, dt=DT, solver=nd.solvers.Nesterov(tol=0.1 * tol, max_iter=200), on_fail="ignore")
    most = 128 * max(2, round((len(bodies) / 2) ** (1 / 3)))
    for k in range(most):
        kinetic = hasty.step().energy["kinetic"]
        if k > most // 4 and kinetic < still:
            break
    stepper = nd.Stepper(scene, dt=DT, solver=nd.solvers.Auto(tol=tol))
    stepper.set_state(hasty.get_state())
    return stepper


def median_step(stepper: nd.Stepper, settle: int = 5, steps: int = 15) -> float:
    """Median seconds of a step."""
    times = []
    for k in range(settle + steps):
        start = time.perf_counter()
        stepper.step()
        if k >= settle:
            times.append(time.perf_counter() - start)
    return statistics.median(times)


def alone(kind: str, bodies: int) -> dict[str, float]:
    """Step time and peak memory [MB] of one scene in a process of its own."""
    command = [sys.executable, __file__, "--only", kind, str(bodies)]
    out: dict[str, float] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return out


def growth(largest: int) -> None:
    """Print step time and memory against the number of bodies."""
    print("scene, step time and memory at 100, 1000, ... bodies, exponents of time and memory")
    for kind, (_, _, most, _) in SCENES.items():
        numbers = [n for n in (100, 1000, 10_000) if n <= min(largest, most)]
        found = [alone(kind, n) for n in numbers]
        base = alone(kind, 1)["memory"]  # the interpreter and its libraries
        cells = "".join(f"{1e3 * f['time']:>12.3f} ms {f['memory']:>8.0f} MB" for f in found)
        span = math.log(numbers[-1] / numbers[0])
        slope = math.log(found[-1]["time"] / found[0]["time"]) / span
        room = math.log((found[-1]["memory"] - base) / max(found[0]["memory"] - base, 1.0)) / span
        print(f"{kind:<10}{cells}   {slope:.2f}, {room:.2f}")


def tolerances() -> None:
    """Print the cost of a step of a resting wall against the tolerance."""
    scene, times = nd.scenes.load("wall")(), {}
    for tol in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10):
        times[tol] = median_step(nd.Stepper(scene, dt=DT, solver=nd.solvers.Auto(tol=tol)), settle=20, steps=40)
    print("wall, by tolerance: " + ", ".join(f"{tol:.0e} {1e3 * t:.2f} ms" for tol, t in times.items()))
    print(f"1e-10 costs {times[1e-10] / times[1e-4]:.2f} times 1e-4")


def features() -> None:
    """Print what a feature costs a stack that has it and one that does not."""

    def stack(mu: float = 0.5, restitution: float = 0.0) -> nd.Scene:
        scene = nd.Scene()
        scene.add_halfspace("ground", material=nd.Material(mu=mu, restitution=restitution))
        for k in range(10):
            at = 0, 0, 0.1 + 0.2 * k
            scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=at, material=nd.Material(mu=mu))
        return scene

    def cost(scene: nd.Scene) -> float:
        return median_step(nd.Stepper(scene, dt=DT, solver=nd.solvers.Auto(tol=1e-6)), 50, 200)

    plain = cost(stack())
    print(f"stack of 10: {1e6 * plain:.0f} us; with restitution x {cost(stack(restitution=0.5)) / plain:.2f}")
    beside = stack()
    beside.add_sphere("bird", 0.1, 1.0, position=(5, 0, 100))
    flight, smooth = cost(beside) / plain, cost(stack(mu=0.0)) / plain
    print(f"with a body that touches nothing x {flight:.2f}; without friction x {smooth:.2f}")
    problem = settled(spheres(200), 1e-4, 1e-5).step().problem
    sweeps = []
    for given in (problem, problem.with_velocity(problem.q, np.zeros(problem.nc))):
        start = time.perf_counter()
        found = nd.solvers.Nesterov(tol=1e-14, max_iter=2000)(given)
        sweeps.append((time.perf_counter() - start) / found.iterations)
    print(
        f"a sweep over a pile of 200 spheres: {1e6 * sweeps[0]:.0f} us; without friction x {sweeps[1] / sweeps[0]:.2f}"
    )


def main() -> None:
    """Run everything, or one scene for `alone`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=10_000, help="bodies of the largest scene (default: 10000)")
    parser.add_argument("--only", nargs=2, metavar=("SCENE", "BODIES"), help="one scene, printed as JSON")
    arguments = parser.parse_args()
    if arguments.only:
        kind, bodies = arguments.only
        make, tol, _, lift = SCENES[kind]
        scene = make(int(bodies))
        moving = lift is None or int(bodies) == 1
        stepper = nd.Stepper(scene, dt=DT, solver=nd.solvers.Auto(tol=tol)) if moving else settled(scene, tol, lift)
        found = {"time": median_step(stepper)}
        found["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps(found))
        return
    growth(arguments.largest)
    tolerances()
    features()


if __name__ == "__main__":
    main()
