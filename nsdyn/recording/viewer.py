"""A recording as one self-contained web page: meshcat's viewer, the scene, its motion; no server, no network.

Everything is drawn from the collision shapes of the recording. The page is a list of meshcat commands
(set_object, set_property, set_animation) in MessagePack, as in meshcat's `static_html`, but built without its
server, with keyframes as binary arrays, and with identifiers made from names instead of random ones: equal
recordings give equal bytes.
"""

from __future__ import annotations

import base64
import html as _escape
import importlib.util
import math
import os
import shutil
import subprocess
import tempfile
import uuid
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import umsgpack
from numpy.typing import ArrayLike, NDArray

from nsdyn.recording import arrows
from nsdyn.tools import files
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["chromium", "html", "screenshot", "write_html"]

Json = dict[str, Any]

# Paul Tol's "bright" scheme, which colour-blind readers can tell apart.
PALETTE = [(68, 119, 170), (238, 102, 119), (34, 136, 51), (204, 187, 68), (102, 204, 238), (170, 51, 119)]
FIXED_COLOUR = (0.62, 0.65, 0.68)
FORCE_COLOUR = (0.72, 0.07, 0.12)
BACKGROUND = (0.945, 0.955, 0.965)
GROUND = (0.83, 0.845, 0.86)

FIELD_OF_VIEW = 32.0  # degrees
LARGE_PAGE = 50e6  # bytes; browsers get slow
MAX_ARROWS = 300  # per frame, the largest forces

_UPRIGHT = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""Turns y, the axis of three.js, to z."""
_BEHIND_LINES = {"polygonOffset": True, "polygonOffsetFactor": 1.0, "polygonOffsetUnits": 1.0}
"""Moves a surface back in depth, so that lines on it stay whole."""


def write_html(trajectory: Trajectory, path: str | Path, **options: Any) -> None:
    """Write the page of `html` to a file, which replaces one of that name once complete.

    Raises
    ------
    ValueError
        If an option is out of range or the file cannot be written.
    """
    page = html(trajectory, **options).encode()
    with files.writing(path) as part:
        part.write_bytes(page)


def html(
    trajectory: Trajectory,
    fps: float = 30.0,
    forces: bool | str = False,
    max_frames: int = 3000,
    at: float | None = None,
) -> str:
    """Self-contained page that plays a recording in any browser.

    Parameters
    ----------
    trajectory : Trajectory
    fps : float
        Keyframes per second of simulated time; the browser interpolates between them.
    forces : bool or {"pair", "point"}
        Draw the contact forces, the mean since the keyframe before, on the moving body, on body 2 when both move: one
        for each pair of bodies (True, "pair"), or for each contact point. Their 90 % quantile is as long as a fifth of
        the scene's radius; arrows are cut at twice that.
    max_frames : int
        Most keyframes; long recordings get fewer per second.
    at : float, optional
        Show only the recorded state nearest to this time, s.

    Raises
    ------
    ValueError
        If an option is out of range.

    Warns
    -----
    UserWarning
        If the page has over 50 MB, or a frame more than 300 forces.
    """
    if not (math.isfinite(fps) and fps > 0):
        raise ValueError(f"fps must be positive, got {fps}")
    if not isinstance(forces, bool):
        choice(forces, ("pair", "point"), "forces")
    if max_frames < 2:
        raise ValueError(f"max_frames must be at least 2, got {max_frames}")
    t = trajectory.t
    finite = np.isfinite(trajectory.q).all(axis=1)
    if not finite.all():
        raise ValueError(f"the state is not finite from t = {t[np.argmin(finite)]:g} s on")
    if at is None:
        count = min(max_frames, max(2, math.ceil((t[-1] - t[0]) * fps) + 1))
        rows = _nearest(t, np.linspace(t[0], t[-1], count))
    elif t[0] <= at <= t[-1]:
        rows = _nearest(t, np.array([at]))
    else:
        raise ValueError(f"at must lie between {t[0]:g} and {t[-1]:g} s, got {at}")
    view = _View(trajectory)
    page = _PAGE.format(
        title=_escape.escape(f"{trajectory.meta['scene_name']} - nsdyn"),
        meshcat=_meshcat_script(),
        commands=",\n".join(
            f'"{base64.b64encode(umsgpack.packb(command)).decode()}"'
            for command in _stage(view) + _shapes(trajectory.scene, view) + _motion(trajectory, rows, view, forces)
        ),
        target=_three(view.centre),
    )
    if len(page) > LARGE_PAGE:
        warnings.warn(
            f"the page has {len(page) / 1e6:.0f} MB, which browsers open slowly; lower fps or max_frames",
            stacklevel=2,
        )
    return page


_PAGE = """<!DOCTYPE html>
<html>
<head><meta charset="utf-8"><title>{title}</title>
<style>body {{ margin: 0; }} #meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}</style></head>
<body><div id="meshcat-pane"></div>
<script>{meshcat}</script>
<script>
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
for (const command of [
{commands}
]) viewer.handle_command_bytearray(Uint8Array.from(atob(command), c => c.charCodeAt(0)));
const sun = viewer.scene_tree.find(["Lights", "Sun", "<object>"]).object;
sun.target.position.fromArray({target});
sun.target.updateMatrixWorld();
viewer.controls.target.fromArray({target});
if (location.hash == "#picture") viewer.gui.domElement.style.display = "none";
</script></body></html>
"""


@lru_cache(maxsize=1)
def _meshcat_script() -> str:
    """JavaScript of meshcat's viewer; the package is not imported, for that would load its server."""
    spec = importlib.util.find_spec("meshcat")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("the page needs the viewer of the package meshcat: pip install meshcat")
    folder = Path(next(iter(spec.submodule_search_locations)))
    return (folder / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


# -- commands ------------------------------------------------------------------------------------------


def _object(path: str, content: Json) -> Json:
    """Command that puts a three.js object, in its JSON format 4, at a path.

    `content` has a node tree whose ``geometry`` and ``material`` are themselves JSON; three.js wants them in
    lists and referred to by identifiers, which are made from the path here.
    """
    lists: dict[str, list[Json]] = {"geometries": [], "materials": []}

    def place(node: Json, name: str) -> Json:
        out = node | {"uuid": _uuid(name)}
        for key, field in (("geometry", "geometries"), ("material", "materials")):
            if key in node:
                out[key] = _uuid(f"{name}:{key}")
                lists[field].append(node[key] | {"uuid": out[key]})
        out["children"] = [place(child, f"{name}.{k}") for k, child in enumerate(node.get("children", ()))]
        return out

    root = place(content, path)
    data = {"metadata": {"version": 4.5, "type": "Object"}, "object": root, **lists}
    return {"type": "set_object", "path": path, "object": data}


def _property(path: str, name: str, value: Any) -> Json:
    return {"type": "set_property", "path": path, "property": name, "value": value}


def _uuid(name: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_URL, f"nsdyn:{name}"))


def _floats(values: ArrayLike) -> umsgpack.Ext:
    """Float32Array of the viewer's MessagePack dialect."""
    return umsgpack.Ext(0x17, np.ascontiguousarray(values, dtype="<f4").tobytes())


def _buffer(**attributes: Array) -> Json:
    """BufferGeometry with attributes of three components."""
    data = {
        name: {"itemSize": 3, "type": "Float32Array", "array": _floats(values), "normalized": False}
        for name, values in attributes.items()
    }
    return {"type": "BufferGeometry", "data": {"attributes": data}}


def _hex(colour: Iterable[float]) -> int:
    r, g, b = (round(255 * c) for c in list(colour)[:3])
    return r << 16 | g << 8 | b


def _shade(colour: Iterable[float], factor: float) -> tuple[float, ...]:
    """Colour darkened (factor < 1) or lightened towards white (> 1); alpha stays."""
    r, g, b, *alpha = colour
    mixed = [c * factor if factor <= 1 else 1 - (1 - c) / factor for c in (r, g, b)]
    return (*mixed, *alpha)


def _matrix(matrix: Array) -> list[float]:
    """Column by column, as three.js stores it."""
    out: list[float] = matrix.T.ravel().tolist()
    return out


def _three(vector: Array) -> list[float]:
    """World coordinates of the viewer, y up."""
    x, y, z = (float(c) for c in vector)
    return [x, z, -y]


# -- camera, lights, ground ----------------------------------------------------------------------------


class _View:
    """Where the scene is: a ball around fixed bodies and all that moving ones ever reach; camera and sun."""

    def __init__(self, trajectory: Trajectory) -> None:
        scene = trajectory.scene
        every = 1 + trajectory.steps // 1000  # enough to see where a body goes
        positions = [trajectory.body(name).position[::every] for name in scene["frames"]]
        self.planes = [(np.array(g["size"]), float(g["offset"])) for g in scene["geoms"] if g["shape"] == "halfspace"]
        points, reach = [np.zeros((1, 3))], [np.ones(1)]
        for geom in scene["geoms"]:
            if geom["shape"] != "halfspace":
                placement = np.array(geom["placement"])
                moves = geom["frame"] >= 0
                points.append(positions[geom["frame"]] if moves else placement[None, :3, 3])
                ball = _radius(geom) + (float(np.linalg.norm(placement[:3, 3])) if moves else 0.0)
                reach.append(np.full(len(points[-1]), ball))
        skip = 1 if len(points) > 1 else 0  # an empty scene shows the unit ball
        x, r = np.concatenate(points[skip:]), np.concatenate(reach[skip:])[:, None]
        lower, upper = (x - r).min(axis=0), (x + r).max(axis=0)
        self.centre = 0.5 * (lower + upper)
        self.radius = 0.5 * float(np.linalg.norm(upper - lower))
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


def _stage(view: _View) -> list[Json]:
    """Background, camera and lights, in proportion to the scene."""
    R, camera = view.radius, "/Cameras/default/rotated/<object>"
    shadow = {
        "bias": -0.0002,
        "normalBias": 0.001 * R,
        "mapSize": [2048, 2048],
        "camera": {
            "type": "OrthographicCamera", "uuid": _uuid("shadow camera"), "near": 0.1 * R, "far": 8 * R,
            "left": -1.6 * R, "right": 1.6 * R, "top": 1.6 * R, "bottom": -1.6 * R,
        },
    }  # fmt: skip
    sun = {"type": "DirectionalLight", "color": 0xFFFFFF, "intensity": 0.58, "shadow": shadow}
    commands = [
        _property("/Background", "top_color", list(BACKGROUND)),
        _property("/Background", "bottom_color", list(BACKGROUND)),
        _property(camera, "fov", FIELD_OF_VIEW),
        _property(camera, "near", 0.01 * R),
        _property(camera, "far", 100 * R),
        _property(camera, "position", _three(view.eye)),
        _object("/Lights/Sun", sun),
        _property("/Lights/Sun/<object>", "position", view.sun.tolist()),
        _property("/Lights/AmbientLight/<object>", "intensity", 0.6),
        _property("/Lights/FillLight/<object>", "intensity", 0.12),
    ]
    hidden = ["/Grid", "/Axes", "/Lights/PointLightNegativeX", "/Lights/PointLightPositiveX"]
    return commands + [_property(path, "visible", False) for path in hidden]


def _halfspace(normal: Array, offset: float, colour: Iterable[float], view: _View) -> Json:
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
        "geometry": _buffer(position=disc, color=faded(disc, colour, BACKGROUND, rings[-1])),
        "material": {"type": "MeshBasicMaterial", "vertexColors": True, **_BEHIND_LINES},
    }
    shadow = {
        "type": "Mesh",
        "geometry": {"type": "CircleGeometry", "radius": rings[-1], "segments": 32},
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
        lines = _buffer(position=grid, color=faded(grid, _shade(colour, 0.9), ground, reach))
        material = {"type": "LineBasicMaterial", "vertexColors": True}
        parts.append({"type": "LineSegments", "geometry": lines, "material": material})
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = frame.T, foot
    return {"type": "Group", "matrix": _matrix(matrix), "children": parts}


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


# -- motion --------------------------------------------------------------------------------------------


def _motion(trajectory: Trajectory, rows: NDArray[np.int64], view: _View, forces: bool | str) -> list[Json]:
    """Poses at the first of the rows, and the animation through all of them."""
    nodes = []
    for name in trajectory.scene["frames"]:
        motion = trajectory.body(name)
        tracks = {"position": motion.position[rows], "quaternion": motion.quaternion[rows]}
        nodes.append((_body_path(name), tracks, False))
    commands = []
    if forces:
        for path, tracks in _arrows(trajectory, rows, view, "pair" if forces is True else forces):
            nodes.append((path, tracks, True))
            commands.append(_object(path, _ARROW))
    t = trajectory.t[rows] - trajectory.t[0]
    clips = []
    for path, tracks, jumps in nodes:
        commands += [_property(path, name, values[0].tolist()) for name, values in tracks.items()]
        moving = [_track(name, t, values, view.radius, jumps) for name, values in tracks.items()]
        moving = [track for track in moving if track]
        if moving:  # each shows its last state for a moment before all begin again
            clip = {"fps": 1, "name": "default", "duration": float(t[-1]) + 0.5, "tracks": moving}
            clips.append({"path": path, "clip": clip})
    if clips:
        options = {"play": True, "repetitions": math.inf}
        commands.append({"type": "set_animation", "path": "", "animations": clips, "options": options})
    return commands


def _track(name: str, t: Array, values: Array, radius: float, jumps: bool) -> Json | None:
    """Keyframes of one property, none if it is constant, without those that change nothing."""
    # Differences below a millionth of the scene, or of a unit quaternion, are invisible.
    grid = np.round(values / (1e-6 * (1.0 if name == "quaternion" else radius)))
    changes = (grid[1:] != grid[:-1]).any(axis=1)
    if not changes.any():
        return None
    keep = np.concatenate([[True], changes])
    track: Json = {"name": f".{name}", "type": "quaternion" if name == "quaternion" else "vector3"}
    if jumps:
        track["interpolation"] = 2300  # THREE.InterpolateDiscrete
    else:  # a line that ends needs the key where it begins too
        keep[:-1] |= changes
    return track | {"times": _floats(t[keep]), "values": _floats(values[keep])}


# -- bodies --------------------------------------------------------------------------------------------


def _body_path(frame: str) -> str:
    return f"/nsdyn/bodies/{frame.replace('/', '.')}"


def _shapes(scene: Json, view: _View) -> list[Json]:
    """Objects of all collision shapes, those that move under the node of their frame."""
    commands = []
    for geom in scene["geoms"]:
        k, name = geom["frame"], geom["name"].replace("/", ".")
        path = f"{_body_path(scene['frames'][k])}/{name}" if k >= 0 else f"/nsdyn/fixed/{name}"
        if geom["shape"] == "halfspace":
            colour = geom["colour"] or GROUND
            commands.append(_object(path, _halfspace(np.array(geom["size"]), geom["offset"], colour, view)))
            continue
        if geom["colour"]:
            colour = geom["colour"]
        elif k < 0:
            colour = FIXED_COLOUR
        else:  # every further round through the palette is lighter
            colour = _shade(np.array(PALETTE[k % len(PALETTE)]) / 255, 1.0 + 0.35 * (k // len(PALETTE) % 4))
        solid = {
            "type": "Group",
            "matrix": _matrix(np.array(geom["placement"])),
            "children": _solid(geom, colour),
        }
        commands.append(_object(path, solid))
    return commands


def _solid(geom: Json, colour: Iterable[float]) -> list[Json]:
    """Nodes of a bounded shape: a polytope and its edges, or a round one in two tones that show rotation."""
    kind, size = geom["shape"], geom["size"]
    if "vertices" in geom:
        return _polytope(np.array(geom["vertices"]), geom["faces"], colour)
    quarter = np.linspace(-np.pi / 2, np.pi / 2, 25)
    arc = np.column_stack([np.cos(quarter), np.sin(quarter)])
    arc[[0, -1], 0] = 0.0
    scale = np.eye(4)
    if kind == "cylinder":
        r, h = size[0], size[1]
        profile = np.array([(0, -h), (r, -h), (r, -h), (r, h), (r, h), (0, h)])
    elif kind == "capsule":
        middle = len(arc) // 2
        lift = np.array([0.0, size[1]])
        profile = np.concatenate([arc[: middle + 1] * size[0] - lift, arc[middle:] * size[0] + lift])
    elif kind == "ellipsoid":
        profile, scale = arc, np.diag([*size, 1.0])
    else:
        profile = arc * size[0]
    nodes = []
    for half, factor in ((0.0, 1.0), (np.pi, 0.72)):
        points = [{"x": float(x), "y": float(y)} for x, y in profile]
        lathe = {
            "type": "LatheGeometry",
            "points": points,
            "segments": 24,
            "phiStart": half,
            "phiLength": np.pi,
        }
        nodes.append(_mesh(lathe, _shade(colour, factor)) | {"matrix": _matrix(scale @ _UPRIGHT)})
    return nodes


def _polytope(vertices: Array, faces: list[list[int]], colour: Iterable[float]) -> list[Json]:
    fans = [(face[0], face[i], face[i + 1]) for face in faces for i in range(1, len(face) - 1)]
    edges = sorted({(min(e), max(e)) for face in faces for e in zip(face, face[1:] + face[:1], strict=True)})
    lines = {
        "type": "LineSegments",
        "geometry": _buffer(position=vertices[np.array(edges).ravel()]),
        "material": {"type": "LineBasicMaterial", "color": _hex(_shade(colour, 0.55))},
    }
    corners = vertices[np.array(fans)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    surface = _buffer(position=corners.reshape(-1, 3), normal=np.repeat(normals, 3, axis=0))
    return [_mesh(surface, colour), lines]


def _mesh(geometry: Json, colour: Iterable[float]) -> Json:
    alpha = [*colour, 1.0][3]
    material = {
        "type": "MeshPhongMaterial",
        "color": _hex(colour),
        "specular": 0x222222,
        "shininess": 25,
        "opacity": alpha,
        "transparent": alpha < 1.0,
        **_BEHIND_LINES,
    }
    return {
        "type": "Mesh",
        "geometry": geometry,
        "material": material,
        "castShadow": True,
        "receiveShadow": True,
    }


# -- contact forces ------------------------------------------------------------------------------------

# An arrow of length 1 along z, drawn over everything else: a force begins inside the body it acts on.
_ARROW = {
    "type": "Group",
    "children": [
        {
            "type": "Mesh",
            "matrix": _matrix(_UPRIGHT),
            "geometry": {
                "type": "LatheGeometry",
                "segments": 12,
                "points": [{"x": x, "y": y} for x, y in ((0, 0), (0.016, 0), (0.016, 0.8), (0.05, 0.8), (0, 1.0))],
            },
            "material": {
                "type": "MeshBasicMaterial",
                "color": _hex(FORCE_COLOUR),
                "depthTest": False,
                "transparent": True,
            },
        }
    ],
}


def _arrows(
    trajectory: Trajectory, rows: NDArray[np.int64], view: _View, by: str
) -> Iterator[tuple[str, dict[str, Array]]]:
    """(path, tracks) of arrows under the bodies they push: as many as the frame with the most needs.

    Unused ones have scale 0.
    """
    since = rows if rows.size > 1 else np.array([max(0, rows[0] - 1), rows[0]])
    found = arrows.between(trajectory, since, by)
    size = np.linalg.norm(found.force, axis=1)
    if not size.any():
        return
    unit = float(np.quantile(size[size > 0], 0.9))
    order = np.lexsort((-size, found.frame, found.keyframe))
    counts: Counter[tuple[int, int]] = Counter()
    shown: Counter[int] = Counter()
    tracks: dict[tuple[int, int], dict[str, Array]] = {}
    largest = set(_largest_of_each(found.keyframe, size).tolist())
    for k in order[[k in largest for k in order]]:
        row, frame = int(found.keyframe[k]) - (since.size - rows.size), int(found.frame[k])
        slot, shown[row] = counts[row, frame], shown[row] + 1
        counts[row, frame] += 1
        track = tracks.setdefault((frame, slot), {
            "position": np.zeros((rows.size, 3)),
            "quaternion": np.tile([0.0, 0.0, 0.0, 1.0], (rows.size, 1)),
            "scale": np.zeros((rows.size, 3)),
        })  # fmt: skip
        track["position"][row], track["quaternion"][row] = found.point[k], _from_z(found.force[k] / size[k])
        track["scale"][row] = min(2.0, size[k] / unit) * view.radius / 5
    if left := int((size > 0).sum()) - shown.total():
        warnings.warn(f"{left} arrows are left out: a frame shows its {MAX_ARROWS} largest forces", stacklevel=4)
    for (frame, slot), track in sorted(tracks.items()):
        yield f"{_body_path(trajectory.scene['frames'][frame])}/contact forces/{slot}", track


def _largest_of_each(keyframe: NDArray[np.int64], size: Array) -> NDArray[np.int64]:
    """Which forces are among the largest of their keyframe, and not 0."""
    order = np.lexsort((-size, keyframe))
    first = np.searchsorted(keyframe[order], keyframe[order])
    return order[(np.arange(order.size) - first < MAX_ARROWS) & (size[order] > 0.0)]


def _from_z(direction: Array) -> Array:
    """Quaternion that turns the z axis to a unit vector."""
    x, y, z = direction
    if z < -1.0 + 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    out: Array = np.array([-y, x, 0.0, 1.0 + z])
    return out / np.linalg.norm(out)


def _nearest(t: Array, wanted: Array) -> NDArray[np.int64]:
    """Find the indices of the recorded times nearest to those wanted, each once."""
    right = np.clip(np.searchsorted(t, wanted), 1, max(1, t.size - 1))
    left = right - 1
    right = np.minimum(right, t.size - 1)
    return np.unique(np.where(wanted - t[left] <= t[right] - wanted, left, right))


# -- pictures ------------------------------------------------------------------------------------------


def chromium() -> str | None:
    """Path of Chromium or Chrome, if there is one."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def screenshot(page: str | Path, picture: str | Path, size: tuple[int, int] = (1280, 720)) -> None:
    """Save a picture of a page as a headless Chromium shows it.

    Parameters
    ----------
    page : path
        A page of this module, best one made with `at`.
    picture : path
        PNG file to write.
    size : (int, int)
        Width and height in pixels.

    Raises
    ------
    ValueError
        If there is no Chromium, or no picture came of it.
    """
    browser = chromium()
    if browser is None:
        raise ValueError("pictures need Chromium or Chrome on the PATH, as from 'apt-get install chromium'")
    with (
        files.writing(picture) as part,
        tempfile.TemporaryDirectory(prefix="nsdyn-", ignore_cleanup_errors=True) as folder,
    ):
        shot = Path(folder) / "shot.png"
        flags = [
            "--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", "--hide-scrollbars", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--virtual-time-budget=2000", "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder}/profile", f"--screenshot={shot}", f"--window-size={size[0]},{size[1]}",
        ]  # fmt: skip
        url = Path(page).resolve().as_uri() + "#picture"
        environment = os.environ | {"HOME": folder}
        try:
            done = subprocess.run([browser, *flags, url], capture_output=True, timeout=120, env=environment)
        except subprocess.TimeoutExpired:
            raise ValueError(f"{browser} took more than two minutes over {page}") from None
        if not shot.is_file():
            raise ValueError(f"{browser} made no picture of {page}: {done.stderr.decode(errors='replace')[-500:]}")
        shutil.copyfile(shot, part)
