"""Parts of a page besides the bodies: camera, lights, ground and the planes of half-spaces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.recording.body_motion import of_frame
from nsdyn.recording.series import rotate
from nsdyn.tools.array_text import from_text
from nsdyn.tools.arrays import Array, Bools
from nsdyn.view.commands import Json, as_buffer, as_hex, as_three, by_columns, set_object, set_property, shaded, uuid_of

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

BACKGROUND = (0.945, 0.955, 0.965)

GROUND = (0.83, 0.845, 0.86)

FIELD_OF_VIEW = 32.0  # degrees

LINES = {"color": 0.9, "night": 2.2}
"""Brightness of the lines of a ground over its own: darker by day, brighter at night, when it is nearly black."""

OUTLINE, SPANNED = 200, 40
"""Number of directions in which the outline of a scene, and of a shape, is computed."""

BESIDE = 2.0
"""Radius of the shown part of a larger fixed body, in radii of the moving bodies: of a pole that a toy goes down."""

MANY, RARE, SMALL = 12, 0.1, 0.7
"""With more than MANY moving shapes, the positions farthest out, where shapes are for less than RARE of all their time,
are left out of the picture if it then needs less than SMALL of the radius: bodies that fall onto a heap, but not the
corners of a wall."""

BEHIND_LINES = {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 20.0}
"""Shift of a surface backwards in depth, so that it does not hide lines on it."""


class View:
    """View of scenes: a ball around fixed bodies and the paths of moving ones (see `MANY`), camera and sun."""

    def __init__(self, trajectories: Sequence[Trajectory]) -> None:
        points: list[Array] = []
        reach: list[Array] = []
        sizes: list[float] = []
        fixed: list[Bools] = []
        for trajectory in trajectories:
            every = 1 + trajectory.steps // 1000  # enough to cover the path of a body
            motions = [of_frame(trajectory, k) for k in range(len(trajectory.scene["frames"]))]
            for geom in (*trajectory.scene["geoms"], *_visuals(trajectory.scene)):
                if geom["shape"] == "halfspace":
                    continue
                place, moves = np.array(geom["placement"]), geom["frame"] >= 0
                balls = _balls(geom) if moves else np.array([[0.0, 0.0, 0.0, _radius(geom)]])
                for ball in balls:
                    at = place[:3, :3] @ ball[:3] + place[:3, 3]
                    if moves:
                        motion = motions[geom["frame"]]
                        at = motion.position[::every] + rotate(motion.quaternion[::every], at)
                    points.append(np.atleast_2d(at))
                    reach.append(np.full(len(points[-1]), ball[3]))
                    fixed.append(np.full(len(points[-1]), not moves))
                sizes += [_radius(geom)] * moves
        self.planes = halfspaces(geom for trajectory in trajectories for geom in trajectory.scene["geoms"])
        # The unit ball for an empty scene.
        x, r = np.concatenate(points or [np.zeros((1, 3))]), np.concatenate(reach or [np.ones(1)])[:, None]
        held = np.concatenate(fixed or [np.zeros(1, dtype=bool)])[:, None]
        often = _often(x, r, held[:, 0]) if len(sizes) > MANY else slice(None)
        x, r = _cut(x[often], r[often], held[often])
        self.centre, self.radius = _ball(x, r)
        self.body_radius = float(np.median(sizes)) if sizes else self.radius
        self.outline = _outline(x, r)
        # View from the front right, unless the camera would be inside a half-space and see its back.
        azimuths = np.radians([35.0, -35.0, 215.0, 145.0])
        cameras = [self._camera(a, x - self.centre, r[:, 0]) for a in azimuths]
        outside = [min([0.0, *(float(n @ eye) - d for n, d in self.planes)]) for eye in cameras]
        best = int(np.argmax(outside))
        self.eye = cameras[best]
        self.sun = self.centre + 4.0 * self.radius * _direction(azimuths[best] - 1.1, 0.9)

    def _camera(self, azimuth: float, x: Array, r: Array) -> Array:
        """Return a camera position from which all balls are in a picture with width to height of 4/3 or more."""
        back = _direction(azimuth, 0.3)
        right = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        up = np.cross(back, right)
        slope = math.tan(math.radians(FIELD_OF_VIEW / 2))
        high, wide = (np.abs(x @ up) + r) / slope, (np.abs(x @ right) + r) / (slope * 4 / 3)
        return self.centre + 1.05 * float((x @ back + np.maximum(high, wide)).max()) * back


def _ball(x: Array, r: Array) -> tuple[Array, float]:
    """Return centre and radius of the ball around the bounding box of balls."""
    lower, upper = (x - r).min(axis=0), (x + r).max(axis=0)
    return 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))


def _often(x: Array, r: Array, fixed: Bools) -> Bools:
    """Return which balls must be in the picture: all fixed ones, and moving ones by the rule of `MANY`."""
    away = np.linalg.norm(x - np.median(x[~fixed], axis=0), axis=1)
    near = away <= np.quantile(away[~fixed], 1.0 - RARE)
    moving, most = ~fixed, ~fixed & near
    small = _ball(x[most], r[most])[1] < SMALL * _ball(x[moving], r[moving])[1]
    return fixed | near if small else np.ones(len(x), dtype=bool)


def _cut(x: Array, r: Array, fixed: Bools) -> tuple[Array, Array]:
    """Replace balls of large fixed bodies by smaller balls inside them, near the moving bodies (see `BESIDE`)."""
    moving = ~fixed[:, 0]
    if not moving.any():
        return x, r
    centre, radius = _ball(x[moving], r[moving])
    near = np.where(fixed, np.minimum(r, BESIDE * radius), r)
    way = centre - x
    far = np.linalg.norm(way, axis=1, keepdims=True)
    return x + way * np.minimum(1.0, (r - near) / np.maximum(far, 1e-300)), near


def halfspaces(geoms: Iterable[Json]) -> list[tuple[Array, float]]:
    """Return normals and offsets of the half-spaces among shapes, each once."""
    planes = {(*geom["size"], float(geom["offset"])): None for geom in geoms if geom["shape"] == "halfspace"}
    return [(np.array(normal), offset) for *normal, offset in planes]


def _outline(x: Array, r: Array, count: int = OUTLINE) -> Array:
    """Return centres and radii (., 4) of the balls that reach farthest in at least one of `count` directions."""
    farthest = np.unique([int(np.argmax(x @ d + r[:, 0])) for d in _directions(count)])
    return np.column_stack([x, r])[farthest]


def _directions(count: int) -> Array:
    """Return unit vectors on a spiral, evenly distributed on the sphere."""
    k = np.arange(count) + 0.5
    z, turn = 1.0 - 2.0 * k / count, np.pi * (1.0 + math.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def _direction(azimuth: float, elevation: float) -> Array:
    """Return the unit vector at two angles; azimuth 0 is -y, the front."""
    flat = math.cos(elevation)
    return np.array([flat * math.sin(azimuth), -flat * math.cos(azimuth), math.sin(elevation)])


def _visuals(scene: Json) -> list[Json]:
    """Return the visual shapes; meshes have only the corners that reach farthest."""
    corners = [from_text(mesh["vertices"], "<f4", 3).astype(float) for mesh in scene.get("meshes", ())]
    ends = [_outline(x, np.zeros((len(x), 1)), SPANNED)[:, :3] for x in corners]
    shapes = scene.get("visuals", ())
    return [shape | {"vertices": ends[shape["mesh"]]} if shape["shape"] == "mesh" else shape for shape in shapes]


def _radius(geom: Json) -> float:
    """Return the radius of a ball about the shape's origin that contains the shape."""
    size = geom["size"]
    if "vertices" in geom:
        return float(np.linalg.norm(geom["vertices"], axis=1).max())
    if geom["shape"] == "cylinder":
        return math.hypot(size[0], size[1])
    return float(size[0] + size[1]) if geom["shape"] == "capsule" else float(max(size))


def _balls(geom: Json) -> Array:
    """Return centres and radii (., 4), in the axes of a shape, of balls that span the shape."""
    size, kind = geom["size"], geom["shape"]
    if "vertices" in geom:
        corners = np.array(geom["vertices"])
        return _outline(corners, np.zeros((len(corners), 1)), SPANNED)
    if kind == "capsule":
        return np.array([[0.0, 0.0, end * size[1], size[0]] for end in (-1, 1)])
    if kind == "cylinder":  # an octagon around each end
        turns = np.pi / 4 * np.arange(8)
        rim = size[0] / math.cos(np.pi / 8) * np.column_stack([np.cos(turns), np.sin(turns)])
        return np.array([[x, y, end * size[1], 0.0] for end in (-1, 1) for x, y in rim])
    if kind == "ellipsoid":
        return np.column_stack([_directions(SPANNED) * size, np.zeros(SPANNED)])
    return np.array([[0.0, 0.0, 0.0, _radius(geom)]])


def stage_commands(view: View) -> list[Json]:
    """Return commands for background, camera and lights, in proportion to the scene."""
    R, camera = view.radius, "/Cameras/default/rotated/<object>"
    shadow = {
        "bias": -0.0002,
        "normalBias": 3.2 * R / 2048,  # 1 point of the map; with less, plates show dots of their own shadow
        "mapSize": [2048, 2048],
        "camera": {
            "type": "OrthographicCamera",
            "uuid": uuid_of("shadow camera"),
            "near": 0.1 * R,
            "far": 8 * R,
            "left": -1.6 * R,
            "right": 1.6 * R,
            "top": 1.6 * R,
            "bottom": -1.6 * R,
        },
    }
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
    """Return a disc with a grid that fades into the background, visible from outside only, with shadows on it."""
    R = view.radius
    foot = view.centre - (normal @ view.centre - offset) * normal
    t1 = np.cross([0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [0.0, 0.0, 1.0], normal)
    t1 /= np.linalg.norm(t1)
    frame = np.array([t1, np.cross(normal, t1), normal])

    def faded(points: Array, base: Iterable[float], to: ArrayLike, reach: float) -> Array:
        s = np.clip(np.linalg.norm(points[:, :2], axis=1) / reach, 0.0, 1.0)[:, None]
        s = s * s * (3.0 - 2.0 * s)
        return (1.0 - s) * np.array(list(base)[:3]) + s * np.asarray(to)

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
    parts, shadows = [floor], _shadow(normal, offset, view)
    if shadows is not None:
        parts.append(_receiver(frame @ (shadows[0] - foot), shadows[1]))
    if normal[2] > 0.3:  # no grid on walls: unlike surfaces, lines are visible from behind too
        reach = 6.0 * R
        grid = _grid(-(frame[:2] @ foot), _round_number(R / 2.5), reach)
        ground = faded(grid, colour, BACKGROUND, rings[-1])
        own = np.array(list(colour)[:3])
        tones = {name: faded(grid, tone * own, ground, reach) for name, tone in LINES.items()}
        lines = as_buffer(position=grid, **tones)
        material = {"type": "LineBasicMaterial", "vertexColors": True}
        parts.append({"type": "LineSegments", "geometry": lines, "material": material})
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.T, foot
    return {"type": "Group", "matrix": by_columns(matrix), "children": parts}


def _receiver(centre: Array, radius: float) -> Json:
    """Return a disc in the plane z = 0 that shows only shadows."""
    place = np.eye(4)
    place[:3, 3] = centre
    return {
        "type": "Mesh",
        "matrix": by_columns(place),
        "geometry": {"type": "CircleGeometry", "radius": radius, "segments": 32},
        "material": {"type": "ShadowMaterial", "color": 0, "opacity": 0.28, "transparent": True, "depthWrite": False},
        "receiveShadow": True,
    }


def _shadow(normal: Array, offset: float, view: View) -> tuple[Array, float] | None:
    """Return centre and radius of a disc on a half-space that holds all shadows; its whole area costs drawing time.

    Return None if the sun is behind the half-space.
    """
    R = view.radius
    rays = (view.centre - view.sun) / np.linalg.norm(view.sun - view.centre)
    steepness = -float(normal @ rays)
    if steepness <= 0.0:
        return None
    if steepness < 0.1:  # lit from the side
        return view.centre - (normal @ view.centre - offset) * normal, 3.5 * R
    x, r = view.outline[:, :3], view.outline[:, 3:]
    feet = x + ((x @ normal - offset) / steepness)[:, None] * rays
    lower, upper = (feet - r / steepness).min(axis=0), (feet + r / steepness).max(axis=0)
    centre: Array = 0.5 * (lower + upper)
    return centre - (normal @ centre - offset) * normal, min(3.5 * R, 0.5 * float(np.linalg.norm(upper - lower)))


def corner_object(planes: Sequence[tuple[Array, float]], view: View) -> Json | None:
    """Return the lines where half-spaces meet, so that a room stands out from its background; None without lines."""
    ends: list[Array] = []
    for k, (n1, d1) in enumerate(planes):
        for n2, d2 in planes[:k]:
            along = np.cross(n1, n2)
            if np.linalg.norm(along) < 1e-6:
                continue
            along /= np.linalg.norm(along)
            point = np.linalg.solve(np.array([n1, n2, along]), [d1, d2, float(along @ view.centre)])
            low, high = -6.0 * view.radius, 6.0 * view.radius
            for n, d in planes:  # the part that no other half-space covers
                rate, left = float(n @ along), float(n @ point) - d
                if abs(rate) > 1e-9:
                    low, high = (max(low, -left / rate), high) if rate > 0 else (low, min(high, -left / rate))
                elif left < -1e-9 * view.radius:
                    high = low
            if low < high:
                ends += [point + low * along, point + high * along]
    if not ends:
        return None
    material = {"type": "LineBasicMaterial", "color": as_hex(shaded(GROUND, 0.72))}
    return {"type": "LineSegments", "geometry": as_buffer(position=np.array(ends)), "material": material}


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
    """Return the largest of 1, 2, 5 times a power of ten that is not above x."""
    power = 10.0 ** math.floor(math.log10(x))
    return power * max(k for k in (1.0, 2.0, 5.0) if k * power <= x * (1 + 1e-12))
