"""Scenes that try to prove the step wrong: overlaps, energy, momentum, ghosts and tunnels, each figure beside its bar.

    python demos/bench/truth.py [BAR]... [--quick] [--verbose]

Every bar is a function of its seeds and steps that returns figures measured from recorded states alone: overlaps by
`nsdyn.audit.overlap`, which shares no code with the detection of contacts, energies and momenta from positions and
velocities computed anew. A figure in brackets has no bar and is only told. `--quick` runs the few cases that
`tests/bench/test_truth.py` runs by default; `at_rest.py` compares what a step costs where nothing happens.
"""

import argparse
import functools
import itertools
import math
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn.audit import overlap as independent
from nsdyn.scene import pairs

INFORM = math.inf
"""Bar of a figure that is only told."""

Figures = dict[str, float]
Case = dict[str, Any]


class Bar(NamedTuple):
    """A claim and what tries to refute it.

    Attributes
    ----------
    title : str
    limits : dict
        The most that each figure may be.
    measure : callable
        ``measure(**case)`` returns figures.
    full, quick : list of dict
        Cases: all, and those of a test that takes seconds; times are no test.
    """

    title: str
    limits: Figures
    measure: Callable[..., Figures]
    full: list[Case]
    quick: list[Case]

    def figures(self, case: Case) -> Figures:
        """Figures of a case; ``raised`` is 1 if it did not come to its end."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return {"raised": 0.0} | self.measure(**case)
        except Exception as failure:
            print(f"{case}: {type(failure).__name__}: {failure}", file=sys.stderr)
            return {"raised": 1.0}


BARS: dict[str, Bar] = {}
"""By name, in the order of their definition."""


def bar(title: str, limits: Figures, full: Iterable[Case], quick: Iterable[Case]) -> Callable[..., Any]:
    """Register a measure under its own name."""

    def register(measure: Callable[..., Figures]) -> Callable[..., Figures]:
        BARS[measure.__name__] = Bar(title, {"raised": 0.0} | limits, measure, list(full), list(quick))
        return measure

    return register


def product(**values: Iterable[Any]) -> list[Case]:
    """Cases of all combinations."""
    return [dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())]


# -- what is measured of a trajectory ------------------------------------------------------------------------------


def overlap(scene: nd.Scene, trajectory: nd.Trajectory) -> float:
    """Deepest true overlap of all recorded states over the smallest extent of the smaller of the two bodies."""
    geoms = scene.geoms()
    shapes, placed = [g.shape.describe() for g in geoms], poses(scene, trajectory)
    x = placed[..., :3, 3]
    reach = np.array([g.shape.bounding_radius for g in geoms])
    extent = np.array([2.0 * g.shape.inscribed_radius for g in geoms])
    apart, deepest = pairs.excluded(scene, geoms), 0.0
    for i, j in itertools.combinations(range(len(geoms)), 2):
        if (i, j) in apart or (geoms[i].frame < 0 and geoms[j].frame < 0):
            continue
        near = np.linalg.norm(x[:, i] - x[:, j], axis=1) <= reach[i] + reach[j]
        if near.any():
            depths = independent.overlap(shapes[i], placed[near, i], shapes[j], placed[near, j])
            deepest = max(deepest, float(np.max(depths)) / min(extent[i], extent[j]))
    return deepest


def poses(scene: nd.Scene, trajectory: nd.Trajectory) -> np.ndarray:
    """Homogeneous transforms of all shapes to the world in every state, shape (states, shapes, 4, 4)."""
    frames = [trajectory.body(name) for name in trajectory.scene["frames"]]
    turns = [Rotation.from_quat(frame.quaternion).as_matrix() for frame in frames]
    out = np.zeros((trajectory.t.size, len(scene.geoms()), 4, 4))
    out[...] = np.eye(4)
    for k, geom in enumerate(scene.geoms()):
        out[:, k, :3, :3], out[:, k, :3, 3] = geom.placement_R, geom.placement_t
        if geom.frame >= 0:
            out[:, k, :3, :3] = turns[geom.frame] @ geom.placement_R
            out[:, k, :3, 3] = frames[geom.frame].position + turns[geom.frame] @ geom.placement_t
    return out


def energies(scene: nd.Scene, trajectory: nd.Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic and potential energy of the free bodies in every state, J, from positions and velocities alone."""
    kinetic = potential = np.zeros(trajectory.t.size)
    for body, twist in zip(scene.free_bodies, np.split(trajectory.v, trajectory.v.shape[1] // 6, axis=1), strict=True):
        v, w = twist[:, :3], twist[:, 3:]
        kinetic = kinetic + 0.5 * (body.mass * (v * v).sum(axis=1) + ((w @ body.inertia) * w).sum(axis=1))
        potential = potential - body.mass * (trajectory.body(body.name).position @ scene.gravity)
    return kinetic, potential


def created(scene: nd.Scene, trajectory: nd.Trajectory) -> float:
    """Most by which the energy of a state exceeds that of an earlier one, over the energy that is in play."""
    kinetic, potential = energies(scene, trajectory)
    total = kinetic + potential
    scale = kinetic.max() + np.ptp(potential)
    return float((total - np.minimum.accumulate(total)).max() / scale) if scale > 0.0 else 0.0


def changed(values: np.ndarray) -> float:
    """Largest departure from the first row, relative to its size."""
    return float(np.linalg.norm(values - values[0], axis=-1).max() / np.linalg.norm(values[0]))


def turned(rng: np.random.Generator) -> np.ndarray:
    """Random orientation."""
    quaternion = rng.normal(size=4)
    return quaternion / np.linalg.norm(quaternion)


def along(rng: np.random.Generator) -> np.ndarray:
    """Random direction."""
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


# -- overlap -------------------------------------------------------------------------------------------------------

STEPS = (1e-2, 5e-3, 1e-3)


@bar(
    "three cubes dropped on each other",
    {"overlap": 1e-6},
    product(dt=STEPS, seed=range(12)),
    product(dt=(1e-2,), seed=range(3)),
)
def cubes(seed: int, dt: float) -> Figures:
    """Edges of 0.1 m, any orientation, 1 s."""
    rng = np.random.default_rng(seed)
    scene = nd.Scene()
    scene.add_halfspace("ground")
    for k in range(3):
        at = (*rng.uniform(-0.02, 0.02, 2), 0.12 + 0.18 * k)
        scene.add_box(f"cube{k}", (0.1, 0.1, 0.1), 1.0, position=at, quaternion=turned(rng))
    return {"overlap": overlap(scene, nd.simulate(scene, 1.0, dt))}


def wall(rows: int, speed: float) -> nd.Scene:
    """A wall, `rows` bricks of 4 kg high and wide, and a ball as heavy as four of them that is about to hit it."""
    scene = nd.scenes.load("wall")(rows=rows, columns=rows)
    at = 0.1 * rows + 0.013, -0.6, 0.05 * rows + 0.007
    scene.add_sphere("ball", 0.15, 16.0, position=at, linear_velocity=(0, speed, 0), material=nd.Material(mu=0.6))
    return scene


@bar(
    "a ball breaks a wall of 5 x 5 bricks",
    {"overlap": 1e-6},
    product(speed=(10.0, 15.0, 20.0), duration=(1.0,)),
    product(speed=(15.0,), duration=(0.15,)),
)
def ball_on_wall(speed: float, duration: float) -> Figures:
    """dt 5e-3."""
    scene = wall(5, speed)
    return {"overlap": overlap(scene, nd.simulate(scene, duration, 5e-3))}


def timed(step: Callable[[], Any], steps: int) -> tuple[float, float]:
    """Mean and longest processor time of a step, ms."""
    times = []
    for _ in range(steps):
        start = time.process_time()
        step()
        times.append(1e3 * (time.process_time() - start))
    return statistics.mean(times), max(times)


@bar(
    "cost of breaking a wall of 10 x 10 bricks, 1e-4",
    {"mean ms": INFORM, "longest ms": INFORM, "MuJoCo's mean ms": INFORM, "MuJoCo's longest ms": INFORM},
    [{"duration": 1.0}],
    [],
)
def wall_cost(duration: float) -> Figures:
    """dt 5e-3; MuJoCo at its defaults, where it is installed."""
    from nsdyn.bench import engines

    scene, dt = wall(10, 15.0), 5e-3
    steps = round(duration / dt)
    stepper = nd.Stepper(scene, dt, solver=nd.solvers.Auto(tol=1e-4))
    start = stepper.get_state()
    timed(stepper.step, steps)  # loads the kernels
    stepper.set_state(start)
    out = dict(zip(("mean ms", "longest ms"), timed(stepper.step, steps), strict=True))
    try:
        from nsdyn.bench._peers.bench_mujoco import Simulation
    except ImportError:
        return out
    peer = Simulation(engines.describe(scene), "default", dt)
    theirs = timed(lambda: peer.advance(1), steps)
    return out | dict(zip(("MuJoCo's mean ms", "MuJoCo's longest ms"), theirs, strict=True))


THIN_ARCH = 0.98 * 0.10491
"""2 % below the limit of eleven voussoirs, m."""


@bar(
    "models that fall over",
    {"overlap": 1e-6},
    [
        {"name": "pile"},
        {"name": "arch", "thickness": THIN_ARCH},
        {"name": "domino"},
        {"name": "cards"},
        {"name": "cards", "mu": 0.15},
    ],
    [{"name": "arch", "share": 0.1, "thickness": THIN_ARCH}, {"name": "cards", "share": 0.1, "mu": 0.15}],
)
def models(name: str, share: float = 1.0, **given: float) -> Figures:
    """At their own dt, for a `share` of their own time; the arch is too thin to stand, smooth cards slip."""
    setup = nd.scenes.setup(name, **given)
    return {"overlap": overlap(setup.scene, nd.simulate(setup.scene, share * setup.duration, **setup.options()))}


# -- anything ------------------------------------------------------------------------------------------------------

CREATED = 1e-8
"""Energy out of nothing, relative; the default tolerance of the solver is 1e-8."""


def add_any(scene: nd.Scene, name: str, size: float, rng: np.random.Generator, **keywords: Any) -> None:
    """Add a body of any kind whose extents lie between `size` and twice that."""
    a, b, c = size * rng.uniform(1.0, 2.0, 3)
    kind = rng.choice(["box", "sphere", "capsule", "cylinder", "ellipsoid", "hull"])
    if kind == "box":
        scene.add_box(name, (a, b, c), **keywords)
    elif kind == "sphere":
        scene.add_sphere(name, a / 2, **keywords)
    elif kind == "capsule":
        scene.add_capsule(name, size / 2, b - 0.5 * size, **keywords)
    elif kind == "cylinder":
        scene.add_cylinder(name, a / 2, b, **keywords)
    elif kind == "ellipsoid":
        scene.add_ellipsoid(name, (a / 2, b / 2, c / 2), **keywords)
    else:  # points on an ellipsoid about an octahedron, so that no hull is flat
        points = np.array([*np.eye(3), *-np.eye(3), *(along(rng) for _ in range(rng.integers(0, 10)))])
        scene.add_convex(name, points * (a / 2, b / 2, c / 2), **keywords)


def clear(scene: nd.Scene) -> bool:
    """Whether the body added last overlaps none of the others."""
    *others, last = scene.geoms()

    def pose(geom: Any) -> np.ndarray:
        out = np.eye(4)
        if geom.body != "ground":  # whose plane is in the world
            body = scene.bodies[geom.body]
            out[:3, :3], out[:3, 3] = Rotation.from_quat(body.quaternion).as_matrix(), body.position
        return out

    mine = last.shape.describe(), pose(last)
    return all(independent.overlap(other.shape.describe(), pose(other), *mine) == 0.0 for other in others)


def anything(seed: int) -> tuple[nd.Scene, dict[str, Any]]:
    """A random scene that overlaps nowhere, and how to simulate it.

    The law of impact is one that promises not to create energy there: Poisson's with one coefficient for all, the
    default and Frémond's always. One scene in ten has friction and restitutions with which Newton's would create some.
    """
    rng = np.random.default_rng([20261121, seed])
    kind = rng.choice(["plastic", "smooth", "poisson", "fremond", "kane"], p=[0.5, 0.15, 0.125, 0.125, 0.1])
    one = 0.0 if kind == "plastic" else rng.choice([1.0, rng.uniform()])

    def material() -> nd.Material:
        mu = 0.0 if kind == "smooth" or rng.uniform() < 0.2 else rng.uniform()
        return nd.Material(mu, rng.uniform() if kind in ("fremond", "kane") else one)

    gravity = 9.81 * (rng.uniform() < 0.8) * along(rng)
    scene = nd.Scene(gravity=gravity)
    base, count = 10.0 ** rng.uniform(-2.0, 0.7), int(rng.integers(2, 14))
    sizes = np.clip(base * 10.0 ** rng.uniform(-0.5, 0.5, count), 1e-2, 5.0)
    if rng.uniform() < 0.2:  # all sizes in one scene
        sizes = 10.0 ** rng.uniform(-2.0, 0.7, count)
    side = 2.0 * np.cbrt((sizes**3).sum())
    if rng.uniform() < 0.6:
        normal = along(rng) - 0.3 * gravity
        scene.add_halfspace("ground", normal / np.linalg.norm(normal), -0.9 * side, material=material())
    speed = 10.0 ** rng.uniform(-1.0, 1.0)
    for k, size in enumerate(sorted(sizes, reverse=True)):
        keywords: dict[str, Any] = {"fixed": True}
        if k == 0 or rng.uniform() < 0.85:
            keywords = {"mass": 10.0 ** rng.uniform(-2.0, 2.0)}
        for _ in range(50):
            at = side * rng.uniform(-0.5, 0.5, 3) * (k > 0)  # the largest always has a place
            if "mass" in keywords:
                aim = along(rng) - 2.0 * at / side
                keywords |= {"linear_velocity": speed * rng.uniform() * aim}
                keywords |= {"angular_velocity": rng.uniform() * speed / size * along(rng)}
            add_any(scene, f"body{k}", size, rng, position=at, quaternion=turned(rng), material=material(), **keywords)
            if clear(scene):
                break
            del scene.bodies[f"body{k}"]
    law = kind if kind in ("poisson", "fremond") else "dissipative"
    return scene, {"dt": float(rng.choice(STEPS)), "impact": law}


@bar(
    "400 random scenes, 60 steps",
    {"overlap": 1e-5, "created": CREATED},
    product(seed=range(400)),
    product(seed=range(12)),
)
def random_scenes(seed: int) -> Figures:
    """Up to 13 bodies of 1e-2 to 10 m and 1e-2 to 1e2 kg, any gravity, friction and restitution."""
    scene, how = anything(seed)
    trajectory = nd.simulate(scene, 60 * how["dt"], how["dt"], impact=how["impact"])
    return {"overlap": overlap(scene, trajectory), "created": created(scene, trajectory)}


# -- ghosts and tunnels --------------------------------------------------------------------------------------------

SPEEDS = tuple(np.geomspace(5.0, 100.0, 22).round(3).tolist())
FEW = 5.0, 20.0, 50.0, 100.0
CLEAR, THIN = 0.01, 0.01
"""How far [m] apart they pass, and how thick what they meet is."""
UNTOUCHED = 1e-12


@bar(
    "balls that pass 1 cm clear",
    {"ghost": UNTOUCHED},
    product(speed=SPEEDS, phase=range(8)),
    product(speed=FEW, phase=(0, 3)),
)
def passing_balls(speed: float, phase: int, dt: float = 1e-2) -> Figures:
    """Past a box, a sphere and a cylinder, `phase` eighths of a step later or earlier."""
    ghost = 0.0
    for add, size in (("add_box", ((0.2, 0.2, 0.2),)), ("add_sphere", (0.1,)), ("add_cylinder", (0.1, 0.2))):
        scene = nd.Scene(gravity=(0, 0, 0))
        getattr(scene, add)("obstacle", *size, fixed=True)
        start = -1.0 - phase / 8 * speed * dt
        scene.add_sphere("ball", 0.05, 1.0, position=(start, 0.15 + CLEAR, 0), linear_velocity=(speed, 0, 0))
        ghost = max(ghost, changed(nd.simulate(scene, 2.5 / speed + 2 * dt, dt).v))
    return {"ghost": ghost}


@bar(
    "balls against a wall of 1 cm",
    {"through": 0.0, "early": 1e-9, "overlap": 1e-6},
    product(speed=SPEEDS, phase=range(8)),
    product(speed=FEW, phase=(0, 3)),
)
def stopped_balls(speed: float, phase: int, dt: float = 1e-2) -> Figures:
    """Straight at it, e = 0."""
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("wall", (THIN, 2, 2), fixed=True)
    scene.add_sphere("ball", 0.02, 1.0, position=(-1 - phase / 8 * speed * dt, 0, 0), linear_velocity=(speed, 0, 0))
    trajectory = nd.simulate(scene, 2.0 / speed + 3 * dt, dt)
    x = trajectory.body("ball").position[:, 0]
    return {
        "through": float(x.max() > 0.0),
        "early": max(0.0, -0.02 - THIN / 2 - x[-1]),
        "overlap": overlap(scene, trajectory),
    }


ANGLE = 1.2
"""Where on its circle [rad] a tip meets or passes something."""
PENDULUM = """<robot name="pendulum"><link name="base"/><link name="rod">
<inertial><origin xyz="0.5 0 0"/><mass value="1"/>
<inertia ixx="1e-4" iyy="0.0834" izz="0.0834" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.02 0.02"/></geometry></collision></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 0 1"/></joint></robot>"""
TIP = math.hypot(1.0, 0.01)
"""m from the axis to the corners of a rod or a blade, the outermost of them."""


def add_post(scene: nd.Scene, inner: float, depth: float) -> None:
    """Add a fixed box, 1 cm thick, that begins `inner` m from the z axis and is `depth` m deep."""
    at = (inner + depth / 2) * np.array([math.cos(ANGLE), math.sin(ANGLE), 0.0])
    quaternion = Rotation.from_rotvec([0, 0, ANGLE]).as_quat()
    scene.add_box("post", (depth, THIN, 4.0), fixed=True, position=at, quaternion=quaternion)


@functools.cache
def touch(inner: float, depth: float) -> float:
    """Angle of a rod or a blade that touches the post, rad, by bisection."""
    scene = nd.Scene()
    add_post(scene, inner, depth)
    scene.add_box("blade", (2, 0.02, 0.02), 1.0)
    post, blade = scene.geoms()
    fixed, moving = np.eye(4), np.eye(4)
    fixed[:3, :3], fixed[:3, 3] = post.placement_R, post.placement_t
    apart, inside = ANGLE - 0.2, ANGLE
    while inside - apart > 1e-12:
        angle = 0.5 * (apart + inside)
        moving[:3, :3] = Rotation.from_rotvec([0, 0, angle]).as_matrix()
        depth = independent.overlap(post.shape.describe(), fixed, blade.shape.describe(), moving)
        apart, inside = (apart, angle) if depth > 0.0 else (angle, inside)
    return inside


def early(spin: np.ndarray, t: np.ndarray, start: float, angle: float) -> float:
    """By how much [rad] less than to `angle` it would have turned freely when its spin first differs from the first."""
    struck = np.flatnonzero(np.abs(spin - spin[0]) > 1e-6 * spin[0])
    return max(0.0, angle - start - spin[0] * t[struck[0]]) if struck.size else 0.0


TURNING = (
    {"ghost": UNTOUCHED, "early": 1e-6, "through": 0.0, "overlap": 1e-6},
    product(speed=(*FEW, 10.0, 75.0), phase=range(8), hits=(True, False)),
    product(speed=FEW, phase=(0, 3), hits=(True, False)),
)
"""Bars and cases of what turns, and strikes a post or passes it."""


@bar("the tip of a link", *TURNING)
def link_tips(speed: float, phase: int, hits: bool, dt: float = 1e-2) -> Figures:
    """A rod of 1 m on a hinge: a wall of 1 cm stops its tip, and one 1 cm beyond its tip does nothing to it."""
    scene = nd.Scene(gravity=(0, 0, 0))
    post = (0.9 if hits else TIP + CLEAR), 0.5
    add_post(scene, *post)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pendulum.urdf"
        path.write_text(PENDULUM)
        start = -phase / 8 * speed * dt
        scene.add_urdf("arm", path, q=(math.cos(start), math.sin(start)), v=(speed,))
    trajectory = nd.simulate(scene, (ANGLE + 2.0) / speed + 3 * dt, dt)
    if not hits:
        return {"ghost": changed(trajectory.v)}
    angle = np.unwrap(np.arctan2(trajectory.q[:, 1], trajectory.q[:, 0]))
    return {
        "early": early(trajectory.v[:, 0], trajectory.t, start, touch(*post)),
        "through": float(angle.max() > ANGLE),
        "overlap": overlap(scene, trajectory),
    }


@bar("the tip of a spinning blade", *TURNING)
def blades(speed: float, phase: int, hits: bool, dt: float = 1e-2) -> Figures:
    """A blade of 2 m that flies and spins: a thin post slows its spin and throws it back, one beyond does nothing."""
    scene = nd.Scene(gravity=(0, 0, 0))
    post = (0.94 if hits else TIP + CLEAR), THIN
    add_post(scene, *post)
    start = -phase / 8 * speed * dt
    turn = Rotation.from_rotvec([0, 0, start]).as_quat()
    scene.add_box(
        "blade",
        (2, 0.02, 0.02),
        1.0,
        quaternion=turn,
        linear_velocity=(0, 0, 1),
        angular_velocity=(0, 0, speed),
        material=nd.Material(mu=0.0),
    )
    trajectory = nd.simulate(scene, (ANGLE + 2.0) / speed + 3 * dt, dt)
    blade = trajectory.body("blade")
    if not hits:
        return {"ghost": max(changed(blade.linear_velocity), changed(blade.angular_velocity))}
    spin = blade.angular_velocity[:, 2]
    struck = np.flatnonzero(np.abs(spin - speed) > 1e-6 * speed)
    back = blade.linear_velocity[struck[0]] @ (-math.sin(ANGLE), math.cos(ANGLE), 0) if struck.size else 0.0
    held = struck.size and spin[struck[0]] < speed and back < 0.0
    return {
        "early": early(spin, trajectory.t, start, touch(*post)),
        "through": float(not held),
        "overlap": overlap(scene, trajectory),
    }


# -- what is conserved ---------------------------------------------------------------------------------------------


def mixed(scene: nd.Scene, places: Iterable[Any], speed: float, seed: int, towards: float = 0.0) -> None:
    """Add smooth elastic bodies of all kinds at the places, thrown anywhere or at the origin."""
    rng = np.random.default_rng(seed)
    material = nd.Material(mu=0.0, restitution=1.0)
    for k, at in enumerate(places):
        aim = along(rng) - towards * np.array(at)
        add_any(
            scene,
            f"body{k}",
            0.1,
            rng,
            mass=rng.uniform(0.5, 2.0),
            position=at,
            quaternion=turned(rng),
            linear_velocity=speed * aim,
            angular_velocity=2.0 * along(rng),
            material=material,
        )


def corners(side: float) -> list[tuple[float, float, float]]:
    """Of a cube about the origin."""
    return list(itertools.product((-side / 2, side / 2), repeat=3))


@bar(
    "smooth elastic bodies in a box, 1000 impacts",
    {"energy": 1e-10, "overlap": 1e-6, "too few impacts": 0.0},
    product(gravity=(0.0, 9.81), seed=range(3), impacts=(1000,)),
    product(gravity=(0.0, 9.81), seed=(0,), impacts=(50,)),
)
def elastic_box(gravity: float, seed: int, impacts: int, dt: float = 5e-3) -> Figures:
    """Eight bodies of all kinds, e = 1, mu = 0."""
    scene = nd.Scene(gravity=(0, 0, -gravity))
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        scene.add_halfspace(f"wall{axis}{sign}", sign * np.eye(3)[axis], -0.5)
    mixed(scene, corners(0.5), 2.0, seed)
    trajectory = nd.simulate(scene, impacts / 25.0, dt)
    counted = sum(int((trajectory.contacts(k).impulse[:, 0] > 0.0).sum()) for k in range(1, trajectory.steps + 1))
    kinetic, potential = energies(scene, trajectory)
    total = kinetic + potential
    scale = kinetic.max() + np.ptp(potential)
    return {
        "energy": float(np.abs(total - total[0]).max() / scale),
        "overlap": overlap(scene, trajectory),
        "too few impacts": float(counted < impacts),
    }


@bar(
    "free elastic bodies that collide",
    {"momentum": 1e-12, "spin": 1e-12, "energy": 1e-10, "impacts missing": 0.0},
    product(seed=range(8)),
    product(seed=(0,)),
)
def free_cluster(seed: int) -> Figures:
    """Eight that meet at the origin, mu = 0, e = 1: momentum, angular momentum about the origin, and energy."""
    scene = nd.Scene(gravity=(0, 0, 0))
    mixed(scene, corners(0.6), 1.0, seed, towards=6.0)
    trajectory = nd.simulate(scene, 1.5, 5e-3)
    momentum = spin = np.zeros((trajectory.t.size, 3))
    size = turn = 0.0
    for k, body in enumerate(scene.free_bodies):
        motion = trajectory.body(body.name)
        p = body.mass * motion.linear_velocity
        own = Rotation.from_quat(motion.quaternion).apply(trajectory.v[:, 6 * k + 3 : 6 * k + 6] @ body.inertia)
        momentum, spin = momentum + p, spin + own + np.cross(motion.position, p)
        size, turn = size + np.linalg.norm(p[0]), turn + np.linalg.norm(np.cross(motion.position[0], p[0]) + own[0])
    kinetic, _ = energies(scene, trajectory)
    met = any((trajectory.contacts(k).impulse[:, 0] > 0.0).any() for k in range(1, trajectory.steps + 1))
    return {
        "momentum": float(np.abs(momentum - momentum[0]).max() / size),
        "spin": float(np.abs(spin - spin[0]).max() / turn),
        "energy": float(np.abs(kinetic / kinetic[0] - 1.0).max()),
        "impacts missing": float(not met),
    }


# -- slow impacts and rest -----------------------------------------------------------------------------------------


@bar("a slow ball rebounds from a wall", {"speed": 1e-9}, product(dt=STEPS), product(dt=(1e-2,)))
def slow_ball(dt: float, speed: float = 0.15) -> Figures:
    """e = 1, under gravity on smooth ground, slower than gravity makes it in two steps of 1e-2."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_halfspace("wall", normal=(-1, 0, 0), offset=-0.2)
    scene.add_sphere("ball", 0.1, 1.0, position=(0.0, 0, 0.1), linear_velocity=(speed, 0, 0))
    scene.set_pair("ball", "ground", mu=0.0, restitution=0.0)
    scene.set_pair("ball", "wall", mu=0.0, restitution=1.0)
    v = nd.simulate(scene, 1.5, dt).body("ball").linear_velocity[-1]
    return {"speed": float(np.linalg.norm(v - (-speed, 0, 0)))}


PRESSED = [
    {"mu": 0.5, "tilt": 0.0, "impact": "dissipative"},
    *product(mu=(0.0,), tilt=(5.0, 20.0), impact=("dissipative",)),
    *product(mu=(0.5,), tilt=(5.0, 20.0), impact=("dissipative", "fremond", "poisson")),
]


@bar(
    "a box pressed down comes to rest",
    {"speed": 1e-6, "overlap": 1e-6, "created": CREATED},
    [{"dt": dt, **case} for dt in STEPS for case in PRESSED],
    [{"dt": 1e-2, **case} for case in PRESSED[:4]],
)
def pressed_box(dt: float, mu: float, tilt: float, impact: str) -> Figures:
    """e = 0.8, 100 N down: flat, and `tilt` degrees out of it; the force is a part of the energy."""
    scene = nd.Scene()
    material = nd.Material(mu=mu, restitution=0.8)
    scene.add_halfspace("ground", material=material)
    quaternion = Rotation.from_euler("xy", (tilt, tilt / 2), degrees=True).as_quat()
    scene.add_box("box", (0.2, 0.3, 0.1), 1.0, position=(0, 0, 0.2), quaternion=quaternion, material=material)
    push = np.array([0.0, 0.0, -100.0])
    trajectory = nd.simulate(scene, 4.0, dt, external_force=lambda t, q, v: {"box": push}, impact=impact)
    heavy = nd.Scene(gravity=scene.gravity + push)  # of 1 kg
    heavy.bodies.update(scene.bodies)
    return {
        "speed": float(np.abs(trajectory.v[trajectory.t > 3.5]).max()),
        "overlap": overlap(scene, trajectory),
        "created": created(heavy, trajectory),
    }


# -- neighbours that have nothing to do with it --------------------------------------------------------------------


def egg(beside: str) -> nd.Scene:
    """An ellipsoid that rolls on the ground, and what is beside it."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=1.0))
    w = np.array([1.0, 2.0, 0.5])
    scene.add_ellipsoid(
        "egg",
        (0.12, 0.08, 0.1),
        1.0,
        position=(0, 0, 0.1),
        material=nd.Material(mu=1.0),
        angular_velocity=w,
        linear_velocity=np.cross(w, (0, 0, 0.1)),
    )
    if beside == "bullet":
        scene.add_sphere("bullet", 0.005, 0.01, position=(1000, 0, 50), linear_velocity=(0, 900, 0))
    elif beside == "coin":
        scene.add_cylinder("coin", 0.01, 1e-4, 1e-3, position=(5, 0, 5e-5))
    return scene


@functools.cache
def rolled(beside: str, dt: float) -> np.ndarray:
    """Where the egg is after half a second, and how it is turned."""
    motion = nd.simulate(egg(beside), 0.5, dt, solver=nd.solvers.Auto(tol=1e-10)).body("egg")
    return np.r_[motion.position[-1], motion.quaternion[-1]]


@bar(
    "an egg rolls as if it were alone",
    {"order lost": 0.15, "error grown": 0.01},
    product(beside=("nothing", "bullet", "coin")),
    product(beside=("bullet", "coin")),
)
def rolling_egg(beside: str, dt: float = 2.5e-3) -> Figures:
    """Beside a bullet 1 km away or a thin coin at rest: second order, and the error that it has alone."""
    exact = rolled("nothing", dt / 16)

    def error(beside: str, dt: float) -> float:
        return float(np.abs(rolled(beside, dt) - exact).max())

    coarse, fine = error(beside, dt), error(beside, dt / 2)
    return {
        "order lost": 2.0 - math.log2(coarse / fine),
        "error grown": max(coarse / error("nothing", dt), fine / error("nothing", dt / 2)) - 1.0,
    }


# -- cost ----------------------------------------------------------------------------------------------------------


@bar(
    "time to an error, ms per simulated second",
    {"bounce to 1e-6": 5.0, "tumble to 1e-4": INFORM, "tumble, MuJoCo's": INFORM},
    [{"limit": 2.0}],
    [],
)
def time_to_error(limit: float) -> Figures:
    """Of `nsdyn bench`: the bouncing ball, and free rotation beside MuJoCo's best."""
    from nsdyn.bench import engines

    peers = [name for name in ("mujoco",) if engines.PEERS[name].installed]
    found = engines.measure(["bounce", "tumble"], peers, limit)

    def ms(case: str, engine: str, error: float) -> float:
        run = found.within(case, engine, error)
        return math.inf if run is None else 1e3 * run.seconds

    out = {"bounce to 1e-6": ms("bounce", "nsdyn", 1e-6), "tumble to 1e-4": ms("tumble", "nsdyn", 1e-4)}
    if peers:
        out["tumble, MuJoCo's"] = ms("tumble", "mujoco", 1e-4)
    return out


# -- values that are handed out ------------------------------------------------------------------------------------


def arrays(value: Any, path: str = "step", seen: set[int] | None = None) -> Iterator[tuple[str, bytes]]:
    """All arrays that can be reached from a value, by their path."""
    seen = set() if seen is None else seen
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        yield path, value.tobytes()
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from arrays(item, f"{path}[{key!r}]", seen)
    elif isinstance(value, (list, tuple)):
        for name, item in zip(getattr(value, "_fields", range(len(value))), value, strict=True):
            yield from arrays(item, f"{path}.{name}", seen)
    elif hasattr(value, "__dict__") and not callable(value):
        yield from arrays(vars(value), path, seen)


@bar(
    "what a step handed out is the same 100 steps later",
    {"changed arrays": 0.0},
    product(robots=(1, 2)),
    product(robots=(1,)),
)
def values_stay(robots: int) -> Figures:
    """Problem, solution and contacts of a quadruped that walks, byte by byte."""
    setup = nd.scenes.setup("quadruped", count=robots)
    stepper = nd.Stepper(setup.scene, **setup.options(dt=5e-3))
    for _ in range(20):
        step = stepper.step()
    assert step.q.size and step.u.size and step.problem.nc  # what it did is looked up when it is asked for
    told = {name: value for name, value in vars(step).items() if name != "untold"}
    before = dict(arrays(told))
    for _ in range(100):
        stepper.step()
    after = dict(arrays(told))
    return {"changed arrays": float(sum(after[path] != content for path, content in before.items()))}


# -- laws of impact ------------------------------------------------------------------------------------------------


def touching(rng: np.random.Generator, one: float | None) -> nd.Scene:
    """Two to five bodies that touch each other or the ground, at random velocities; `one` restitution, or any."""

    def material() -> nd.Material:
        return nd.Material(rng.uniform(0.0, 1.5), rng.uniform() if one is None else one)

    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_halfspace("ground", material=material())

    def add(kind: str, name: str, size: Any, at: Any, **keywords: Any) -> None:
        getattr(scene, f"add_{kind}")(
            name,
            size,
            10.0 ** rng.uniform(-1.0, 1.0),
            position=at,
            linear_velocity=rng.normal(size=3),
            angular_velocity=3.0 * rng.normal(size=3),
            material=material(),
            **keywords,
        )

    kind = rng.choice(["stack", "heap", "edge", "ball on box"])
    if kind == "stack":
        top = 0.0
        for k in range(rng.integers(2, 4)):
            size = rng.uniform(0.1, 0.3, 3)
            add("box", f"box{k}", size, (*rng.uniform(-0.05, 0.05, 2), top + size[2] / 2))
            top += size[2]
    elif kind == "heap":  # each touches an earlier one, at rest on the ground the first
        balls = [(np.array([0, 0, 0.1]), 0.1)]
        for _ in range(100):
            centre, radius = balls[rng.integers(len(balls))]
            other = rng.uniform(0.05, 0.15)
            at = centre + (radius + other) * along(rng)
            if at[2] >= other and all(np.linalg.norm(at - c) >= (r + other) * (1 - 1e-12) for c, r in balls):
                balls.append((at, other))
            if len(balls) == 5:
                break
        for k, (at, radius) in enumerate(balls):
            add("sphere", f"ball{k}", radius, at)
    elif kind == "edge":  # on an edge, a corner or any of its points
        size, turn = rng.uniform(0.1, 0.3, 3), Rotation.from_quat(turned(rng))
        if rng.uniform() < 0.5:
            turn = Rotation.from_euler("x", rng.uniform(0.1, 1.4))
        low = -np.abs(turn.as_matrix()[2]) @ size / 2
        add("box", "box", size, (0, 0, -low), quaternion=turn.as_quat())
    else:
        add("box", "box", (0.3, 0.3, 0.2), (0, 0, 0.1))
        for k, x in enumerate((-0.08, 0.08)):
            add("sphere", f"ball{k}", 0.08, (x, 0, 0.28))
    return scene


@bar(
    "1500 impacts of bodies that touch",
    {"created": CREATED},
    product(law=("dissipative", "fremond", "poisson"), seed=range(1500)),
    product(law=("dissipative", "fremond", "poisson"), seed=range(60)),
)
def impacts(law: str, seed: int) -> Figures:
    """One step, and two more: the default and Frémond's law with any restitutions, Poisson's with one."""
    rng = np.random.default_rng([12, seed])
    scene = touching(rng, None if law != "poisson" else float(rng.choice([0.0, 1.0, rng.uniform()])))
    return {"created": created(scene, nd.simulate(scene, 3e-3, 1e-3, impact=law))}


# -- the ledger ----------------------------------------------------------------------------------------------------

LEDGERS = ("pile", "rattleback", "quadruped", "rolling", "bounce", "gripper", "woodpecker")


@bar(
    "the ledger closes",
    {"defect": 1e-12, "states": 1e-12},
    product(name=LEDGERS, steps=(200,)),
    product(name=("bounce", "rattleback"), steps=(50,)),
)
def ledger(name: str, steps: int) -> Figures:
    """Works add up to the change of kinetic and potential energy, and those are what the states say."""
    setup = nd.scenes.setup(name)
    scene = setup.scene
    trajectory = nd.simulate(scene, steps * setup.dt, **setup.options())
    energy = trajectory.energy
    works = sum(getattr(energy, term) for term in energy.names if term not in ("kinetic", "potential", "defect"))
    scale = energy.kinetic.max() + np.ptp(energy.potential)
    out = {"defect": float(np.abs(np.diff(energy.kinetic + energy.potential) - works).max() / scale)}
    if not scene.articulations:
        anew = np.array(energies(scene, trajectory))
        out["states"] = float(np.abs(anew - (energy.kinetic, energy.potential)).max() / scale)
    return out


@bar(
    "a rattleback that sticks loses nothing",
    {"friction": 1e-6, "energy": INFORM, "slipping contacts": 0.0},
    product(dt=(1e-3, 5e-4), duration=(1.0,)),
    product(dt=(1e-3,), duration=(0.1,)),
)
def sticking_rattleback(dt: float, duration: float) -> Figures:
    """Relative to its kinetic energy: what friction took, and what it has lost in all."""
    scene = nd.scenes.load("rattleback")(mu=10.0)
    trajectory = nd.simulate(scene, duration, dt)
    kinetic, potential = energies(scene, trajectory)
    status = np.concatenate([trajectory.contacts(k).status for k in range(1, trajectory.steps + 1)])
    return {
        "friction": float(np.abs(np.cumsum(trajectory.energy.friction)).max() / kinetic[0]),
        "energy": float(np.abs(kinetic + potential - kinetic[0] - potential[0]).max() / kinetic[0]),
        "slipping contacts": float((status == 2).sum()),
    }


# -- table ---------------------------------------------------------------------------------------------------------


def rows(name: str, limits: Figures, found: list[tuple[Case, Figures]]) -> Iterator[str]:
    """A line of the table for each figure of a bar: the worst, its bar, how many miss it, and where it is worst."""
    for figure, limit in limits.items():
        measured = [(figures[figure], case) for case, figures in found if figure in figures]
        if not measured or (figure == "raised" and not any(value for value, _ in measured)):
            continue
        worst, case = max(measured, key=lambda pair: pair[0])
        missed = sum(not value <= limit for value, _ in measured)
        verdict = "" if limit == INFORM else "ok" if not missed else f"FAILS {missed} of {len(measured)}"
        wanted = "" if limit == INFORM else f"{limit:.0e}"
        shown = f"[{worst:.3g}]" if limit == INFORM else f"{worst:.2e}"
        where = ", ".join(f"{key}={value}" for key, value in case.items() if len(found) > 1)
        yield f"{name:20} {figure:28} {shown:>10} {wanted:>7}  {verdict:16} {where}"


def main() -> None:
    """Run and print."""
    titles = "\n".join(f"  {name:20} {claim.title}" for name, claim in BARS.items())
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=f"bars:\n{titles}", formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bars", nargs="*", metavar="BAR", help="names (default: all)")
    parser.add_argument("--quick", action="store_true", help="few cases")
    parser.add_argument("--verbose", action="store_true", help="print every case")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.bars) - set(BARS))
    if unknown:
        parser.error(f"unknown bar {unknown[0]!r}; known are {', '.join(BARS)}")
    print(f"{'bar':20} {'figure':28} {'worst':>10} {'bar':>7}")
    for name in arguments.bars or BARS:
        claim, found = BARS[name], []
        for case in claim.quick if arguments.quick else claim.full:
            found.append((case, claim.figures(case)))
            if arguments.verbose:
                print(f"  {name} {case} {found[-1][1]}", flush=True)
        for row in rows(name, claim.limits, found):
            print(row, flush=True)


if __name__ == "__main__":
    main()
