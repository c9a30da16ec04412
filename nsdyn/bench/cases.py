"""Cases with known answers: a scene, the times of its samples, and a function that measures the error of poses.

To add a case, write a scene in `models/` that all engines can simulate, a function of (scene, t, poses) that returns
the error from an independently known answer, and a `Case` in `CASES`. Then `nsdyn bench NAME` runs it, and
`tests/bench/test_bench.py` includes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from nsdyn.audit.audit import deepest
from nsdyn.audit.flight import tumbled
from nsdyn.scene import named as scenes
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import Array

STEPS = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
"""Time steps dt in s; a case uses the steps that divide the time between its samples."""

Measure = Callable[[Scene, Array, Array], float]


def _off(distance: Callable[[Array], Array], direction: Sequence[float], free: Sequence[float] = (0, 0, 0)) -> Measure:
    """Return a measure: the largest distance of a body from the point `distance`(t) away from its start, m.

    The component along `free` is ignored; for sliding bodies `free` is the unit normal of the ground.
    """

    def error(scene: Scene, t: Array, poses: Array) -> float:
        starts = np.array([body.position for body in scene.free_bodies])
        d = poses[..., :3] - starts - distance(t)[:, None, None] * np.array(direction)
        d -= (d @ free)[..., None] * np.array(free)
        return float(np.linalg.norm(d, axis=-1).max())

    return error


_displacement = _off(np.zeros_like, (0, 0, 0))


def _attitude(scene: Scene, t: Array, poses: Array) -> float:
    """Return the largest angle of the only body from the solution of Euler's equations, rad.

    The error of this solution, by a method of order 8, is below 1e-11.
    """
    body = scene.free_bodies[0]
    # Body and world axes agree at the start.
    start, spin, inertia = (
        np.tile(x, (t.size, *[1] * np.ndim(x))) for x in (body.quaternion, body.angular_velocity, body.inertia)
    )
    left = Rotation.from_quat(tumbled(start, spin, inertia, t)[0]).inv() * Rotation.from_quat(poses[:, 0, 3:])
    return float(left.magnitude().max())


def _penetration(scene: Scene, t: Array, poses: Array) -> float:
    """Return the deepest true overlap of two bodies, m."""
    return deepest(scene.describe(), poses.reshape(len(t), -1))


def _slide(speed: float, mu: float, slower: float) -> Callable[[Array], Array]:
    """Return the distance, as a function of t, of a body that slides until it is `slower`: it rests then, or rolls."""

    def distance(t: Array) -> Array:
        s = np.minimum(t, (speed - slower) / (mu * G))
        return speed * s - 0.5 * mu * G * s**2 + slower * (t - s)

    return distance


def _bounce(height: float, restitution: float) -> Callable[[Array], Array]:
    """Return the height over the start of a ball dropped from `height`: flights of 2 v/g, v = eᵏ √(2 g height)."""

    def distance(t: Array) -> Array:
        speed = math.sqrt(2.0 * G * height)
        landing = speed / G
        out = -0.5 * G * np.minimum(t, landing) ** 2
        while landing < t.max():
            speed *= restitution
            flight = np.clip(t - landing, 0.0, 2.0 * speed / G)
            out += speed * flight - 0.5 * G * flight**2
            landing += 2.0 * speed / G
        return out

    return distance


G = 9.81


@dataclass(frozen=True, eq=False)
class Case:
    """A scene with a known answer.

    Attributes
    ----------
    name, title : str
    model : str
        Name of the scene.
    parameters : dict
        Parameters of the scene.
    every : float
        Time between samples, s.
    samples : int
        Number of samples: at every, 2 every, ..., the last at the end.
    measure : callable
        ``measure(scene, t, poses)`` returns the error of the poses (samples, bodies, 7) at times t.
    what : str
        Name and unit of the error.
    slope : float
        Angle in rad by which gravity is turned towards x: a slope becomes a level ground, which suits all engines best.
    """

    name: str
    title: str
    model: str
    parameters: dict[str, Any]
    every: float
    samples: int
    measure: Measure
    what: str = "error of position [m]"
    slope: float = 0.0

    @property
    def duration(self) -> float:
        """Simulated time in s."""
        return self.every * self.samples

    @property
    def steps(self) -> list[float]:
        """Time steps in s, the largest first."""
        ratios = ((dt, self.every / dt) for dt in STEPS)
        return [dt for dt, ratio in ratios if ratio > 0.5 and abs(ratio - round(ratio)) < 1e-9]

    @cached_property
    def scene(self) -> Scene:
        """The scene of the case, with gravity turned by `slope`."""
        out = scenes.load(self.model)(**self.parameters)
        if self.slope:
            out.gravity = G * np.array([math.sin(self.slope), 0.0, -math.cos(self.slope)])
        return out


def _cases() -> dict[str, Case]:
    heading, slope, up = math.radians(30.0), math.radians(20.0), (0.0, 0.0, 1.0)
    downhill = G * (math.sin(slope) - 0.2 * math.cos(slope))
    stop, roll = _slide(2.0, 0.5, 0.0), _slide(2.0, 0.3, 5.0 / 7.0 * 2.0)  # a ball thrown without spin rolls at 5/7 v0
    cases = [
        Case("slide", "sliding cube", "slide", {}, 1.0, 1, _off(stop, (1, 0, 0), up)),
        Case(
            "slide30",
            "sliding cube, 30° to the contact frame",
            "slide",
            {"heading": 30.0},
            1.0,
            1,
            _off(stop, (math.cos(heading), math.sin(heading), 0), up),
        ),
        Case(
            "stick",
            "cube at rest on a slope of 20°",
            "slide",
            {"mu": 0.37, "speed": 0.0},
            0.5,
            4,
            _displacement,
            slope=slope,
        ),
        Case(
            "slip",
            "cube sliding down a slope of 20°",
            "slide",
            {"mu": 0.2, "speed": 0.0},
            1.0,
            1,
            _off(lambda t: 0.5 * downhill * t**2, (1, 0, 0), up),
            slope=slope,
        ),
        Case("bounce", "bouncing ball, e = 0.8", "bounce", {}, 0.1, 20, _off(_bounce(1.0, 0.8), up)),
        Case("roll", "ball, slide to roll", "roll", {}, 1.0, 1, _off(roll, (1, 0, 0), up)),
        Case("stack", "stack of 10 cubes", "stack", {}, 0.5, 4, _displacement),
        Case("heavy", "1000 kg on 9 cubes of 1 kg", "heavy_on_light", {"below": 9}, 0.5, 4, _displacement),
        Case("stacks", "ten stacks of 10 cubes", "stacks", {}, 0.1, 20, _displacement),
        Case("wall", "wall of 105 bricks", "wall", {}, 0.1, 20, _displacement),
        Case(
            "pile",
            "200 spheres dropped into a box",
            "pile",
            {"boxes": 0, "spheres": 200, "side": 0.8},
            0.05,
            20,
            _penetration,
            "largest penetration [m]",
        ),
        Case("tumble", "free rotation", "tumble", {}, 0.5, 20, _attitude, "error of attitude [rad]"),
    ]
    return {case.name: case for case in cases}


CASES = _cases()
"""Cases by name."""


def describe(scene: Scene) -> dict[str, Any]:
    """Return the data of a scene of boxes, spheres and half-spaces of one material as JSON values, for any engine."""
    geoms = scene.geoms()
    (material,) = {(geom.material.mu, geom.material.restitution) for geom in geoms}
    return {
        "gravity": scene.gravity.tolist(),
        "mu": material[0],
        "restitution": material[1],
        "grounds": [
            {"normal": geom.shape.size.tolist(), "offset": geom.shape.offset} for geom in geoms if geom.frame < 0
        ],
        "bodies": [
            {
                "shape": body.shape.describe()["shape"],
                "size": body.shape.size.tolist(),
                "mass": body.mass,
                "inertia": np.diag(body.inertia).tolist(),
                "position": body.position.tolist(),
                "quaternion": body.quaternion.tolist(),
                "linear_velocity": body.linear_velocity.tolist(),
                "angular_velocity": body.angular_velocity.tolist(),
            }
            for body in scene.free_bodies
        ],
    }
