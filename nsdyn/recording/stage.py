"""What a page shows besides the bodies: camera, lights, ground and the planes of half-spaces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.recording.commands import Json, as_buffer, as_three, by_columns, set_object, set_property, shaded, uuid_of
from nsdyn.tools.arrays import Array

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["BACKGROUND", "BEHIND_LINES", "FIELD_OF_VIEW", "GROUND", "View", "halfspace_object", "stage_commands"]

BACKGROUND = (0.945, 0.955, 0.965)

GROUND = (0.83, 0.845, 0.86)

FIELD_OF_VIEW = 32.0  # degrees

OUTLINE = 200
"""Directions in which the outline of a scene is taken."""

BEHIND_LINES = {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 1.0}
"""Moves a surface back in depth, so that lines on it stay whole."""


class View:
    """Where scenes are: a ball around fixed bodies and all that moving ones ever reach; camera and sun."""

    def __init__(self, trajectories: Sequence[Trajectory]) -> None:
        points: list[Array] = []
        reach: list[Array] = []
        sizes: list[float] = []
        planes: dict[tuple[float, ...], None] = {}
        for trajectory in trajectories:
            every = 1 + trajectory.steps // 1000  # enough to see where a body goes
            positions = [trajectory.body(name).position[::every] for name in trajectory.scene["frames"]]
            for geom in trajectory.scene["geoms"]:
                if geom["shape"] == "halfspace":
                    planes[(*geom["size"], float(geom["offset"]))] = None
                    continue
                placement = np.array(geom["placement"])
                moves = geom["frame"] >= 0
                points.append(positions[geom["frame"]] if moves else placement[None, :3, 3])
                ball = _radius(geom) + (float(np.linalg.norm(placement[:3, 3])) if moves else 0.0)
                reach.append(np.full(len(points[-1]), ball))
                sizes += [_radius(geom)] * moves
        self.planes = [(np.array(normal), offset) for *normal, offset in planes]
        # Where there is nothing, the unit ball.
        x, r = np.concatenate(points or [np.zeros((1, 3))]), np.concatenate(reach or [np.ones(1)])[:, None]
        lower, upper = (x - r).min(axis=0), (x + r).max(axis=0)
        self.centre = 0.5 * (lower + upper)
        self.radius = 0.5 * float(np.linalg.norm(upper - lower))
        self.body_radius = float(np.median(sizes)) if sizes else self.radius
        self.outline = _outline(x, r)
        # From the front right, unless that is behind a half-space, which would be seen from its back.
        azimuths = np.radians([35.0, -35.0, 215.0, 145.0])
        cameras = [self._camera(a, x - self.centre, r[:, 0]) for a in azimuths]
        outside = [min([0.0, *(float(n @ eye) - d for n, d in self.planes)]) for eye in cameras]
        best = int(np.argmax(outside))
        self.eye = cameras[best]
        self.sun = self.centre + 4.0 * self.radius * _direction(azimuths[best] - 1.1, 0.9)

    def _camera(self, azimuth: float, x: Array, r: Array) -> Array:
        """Position from which all balls are in the picture, also in one a third wider than high."""
        back = _direction(azimuth, 0.3)
        right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        up = np.cross(back, right)
        slope = math.tan(math.radians(FIELD_OF_VIEW / 2))
        high, wide = (np.abs(x @ up) + r) / slope, (np.abs(x @ right) + r) / (slope * 4 / 3)
        out: Array = self.centre + 1.05 * float((x @ back + np.maximum(high, wide)).max()) * back
        return out


def _outline(x: Array, r: Array) -> Array:
    """Centres and radii (., 4) of the balls that reach farthest in some of many directions."""
    k = np.arange(OUTLINE) + 0.5  # on a spiral, evenly on the sphere
    z, turn = 1.0 - 2.0 * k / OUTLINE, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    directions = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    farthest = np.unique([int(np.argmax(x @ d + r[:, 0])) for d in directions])
    out: Array = np.column_stack([x, r])[farthest]
    return out


def _direction(azimuth: float, elevation: float) -> Array:
    """Return the unit vector at two angles; azimuth 0 is -y, the front."""
    flat = math.cos(elevation)
    return np.array([flat * math.sin(azimuth), -flat * math.cos(azimuth), math.sin(elevation)])


def _radius(geom: Json) -> float:
    """Radius of a ball about the shape's origin that contains it."""
    size = geom["size"]
    if "vertices" in geom:
        return float(np.linalg.norm(geom["vertices"], axis=1).max())
    if geom["shape"] == "cylinder":
        return math.hypot(size[0], size[1])
    return float(size[0] + size[1]) if geom["shape"] == "capsule" else float(max(size))


def stage_commands(view: View) -> list[Json]:
    """Background, camera and lights, in proportion to the scene."""
    R, camera = view.radius, "/Cameras/default/rotated/<object>"
    shadow = {
        "bias": -0.0002,
        "normalBias": 0.001 * R,
        "mapSize": [2048, 2048],
        "camera": {
            "type": "OrthographicCamera", "uuid": uuid_of("shadow camera"), "near": 0.1 * R, "far": 8 * R,
            "left": -1.6 * R, "right": 1.6 * R, "top": 1.6 * R, "bottom": -1.6 * R,
        },
    }  # fmt: skip
    sun = {"type": "DirectionalLight", "color": 0xFFFFFF, "intensity": 0.58, "shadow": shadow}
    commands = [
        set_property("/Background", "top_color", list(BACKGROUND)),
        set_property("/Background", "bottom_color", list(BACKGROUND)),
        set_property(camera, "fov", FIELD_OF_VIEW),
        set_property(camera, "near", 0.01 * R),
        set_property(camera, "far", 100 * R),
        set_property(camera, "position", as_three(view.eye)),
        set_object("/Lights/Sun", sun),
        set_property("/Lights/Sun/<object>", "position", view.sun.tolist()),
        set_property("/Lights/AmbientLight/<object>", "intensity", 0.6),
        set_property("/Lights/FillLight/<object>", "intensity", 0.12),
    ]
    hidden = ["/Grid", "/Axes", "/Lights/PointLightNegativeX", "/Lights/PointLightPositiveX"]
    return commands + [set_property(path, "visible", False) for path in hidden]


def halfspace_object(normal: Array, offset: float, colour: Iterable[float], view: View) -> Json:
    """Disc with a grid that fades into the background, seen from outside only; it receives shadows."""
    R = view.radius
    foot = view.centre - (normal @ view.centre - offset) * normal
    t1 = np.cross([0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [0.0, 0.0, 1.0], normal)
    t1 /= np.linalg.norm(t1)
    frame = np.array([t1, np.cross(normal, t1), normal])

    def faded(points: Array, base: Iterable[float], to: ArrayLike, reach: float) -> Array:
        s = np.clip(np.linalg.norm(points[:, :2], axis=1) / reach, 0.0, 1.0)[:, None]
        s = s * s * (3.0 - 2.0 * s)
        out: Array = (1.0 - s) * np.array(list(base)[:3]) + s * np.asarray(to)
        return out

    rings, turns = np.array([0.0, 1.0, 2.5, 4.5, 7.0, 10.0]) * R, np.linspace(0.0, 2.0 * np.pi, 33)
    triangles = []
    for inner, outer in pairwise(rings):
        for a, b in pairwise(turns):
            p, q, r, s = ((d * np.cos(x), d * np.sin(x), 0.0) for d in (inner, outer) for x in (a, b))
            triangles += [p, r, s, p, s, q] if inner else [p, r, s]
    disc = np.array(triangles)
    floor = {
        "type": "Mesh",
        "geometry": as_buffer(position=disc, color=faded(disc, colour, BACKGROUND, rings[-1])),
        "material": {"type": "MeshBasicMaterial", "vertexColors": True, **BEHIND_LINES},
    }
    shadow = {
        "type": "Mesh",
        # As far as shadows reach: the sun's camera sees 1.6 R around the centre, which is at most R above.
        "geometry": {"type": "CircleGeometry", "radius": 3.5 * R, "segments": 32},
        "material": {
            "type": "ShadowMaterial",
            "color": 0,
            "opacity": 0.28,
            "transparent": True,
            "depthWrite": False,
        },
        "receiveShadow": True,
    }
    parts = [floor, shadow]
    if normal[2] > 0.3:  # no grid on walls: lines, unlike surfaces, would be seen from behind too
        reach = 6.0 * R
        grid = _grid(-(frame[:2] @ foot), _round_number(R / 2.5), reach)
        ground = faded(grid, colour, BACKGROUND, rings[-1])
        lines = as_buffer(position=grid, color=faded(grid, shaded(colour, 0.9), ground, reach))
        material = {"type": "LineBasicMaterial", "vertexColors": True}
        parts.append({"type": "LineSegments", "geometry": lines, "material": material})
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.T, foot
    return {"type": "Group", "matrix": by_columns(matrix), "children": parts}


def _grid(origin: Array, step: float, reach: float) -> Array:
    """Return the ends of lines x or y = origin + k step in a disc, cut into pieces that fade one by one."""
    lines = []
    for axis in (0, 1):
        first, last = math.ceil((-reach - origin[axis]) / step), math.floor((reach - origin[axis]) / step)
        for c in origin[axis] + step * np.arange(first, last + 1):
            half = math.sqrt(max(reach**2 - c**2, 0.0))
            ticks = np.linspace(-half, half, 11)
            ends = np.column_stack([ticks[:-1], ticks[1:]]).ravel()
            line = np.zeros((ends.size, 3))
            line[:, axis], line[:, 1 - axis] = c, ends
            lines.append(line)
    return np.concatenate(lines)


def _round_number(x: float) -> float:
    """Largest of 1, 2, 5 times a power of ten that is not above x."""
    power = 10.0 ** math.floor(math.log10(x))
    return power * max(k for k in (1.0, 2.0, 5.0) if k * power <= x * (1 + 1e-12))
