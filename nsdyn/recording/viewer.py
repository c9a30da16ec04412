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
import warnings
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import umsgpack
from numpy.typing import NDArray

from nsdyn.recording import arrows
from nsdyn.recording.commands import UPRIGHT, Json, as_hex, as_three, by_columns, float_list, set_object, set_property
from nsdyn.recording.solids import body_path, shape_commands
from nsdyn.recording.stage import View, stage_commands
from nsdyn.tools import files
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["html", "write_html"]

FORCE_COLOUR = (0.72, 0.07, 0.12)

LARGE_PAGE = 50e6  # bytes; browsers get slow

MAX_ARROWS = 300  # per frame, the largest forces


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
    view = View(trajectory)
    page = _PAGE.format(
        title=_escape.escape(f"{trajectory.meta['scene_name']} - nsdyn"),
        meshcat=_meshcat_script(),
        commands=",\n".join(
            f'"{base64.b64encode(umsgpack.packb(command)).decode()}"'
            for command in stage_commands(view)
            + shape_commands(trajectory.scene, view)
            + _motion(trajectory, rows, view, forces)
        ),
        target=as_three(view.centre),
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


def _motion(trajectory: Trajectory, rows: NDArray[np.int64], view: View, forces: bool | str) -> list[Json]:
    """Poses at the first of the rows, and the animation through all of them."""
    nodes = []
    for name in trajectory.scene["frames"]:
        motion = trajectory.body(name)
        tracks = {"position": motion.position[rows], "quaternion": motion.quaternion[rows]}
        nodes.append((body_path(name), tracks, False))
    commands = []
    if forces:
        for path, tracks in _arrows(trajectory, rows, view, "pair" if forces is True else forces):
            nodes.append((path, tracks, True))
            commands.append(set_object(path, _ARROW))
    t = trajectory.t[rows] - trajectory.t[0]
    clips = []
    for path, tracks, jumps in nodes:
        commands += [set_property(path, name, values[0].tolist()) for name, values in tracks.items()]
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
    return track | {"times": float_list(t[keep]), "values": float_list(values[keep])}


# An arrow of length 1 along z, drawn over everything else: a force begins inside the body it acts on.
_ARROW = {
    "type": "Group",
    "children": [
        {
            "type": "Mesh",
            "matrix": by_columns(UPRIGHT),
            "geometry": {
                "type": "LatheGeometry",
                "segments": 12,
                "points": [{"x": x, "y": y} for x, y in ((0, 0), (0.016, 0), (0.016, 0.8), (0.05, 0.8), (0, 1.0))],
            },
            "material": {
                "type": "MeshBasicMaterial",
                "color": as_hex(FORCE_COLOUR),
                "depthTest": False,
                "transparent": True,
            },
        }
    ],
}


def _arrows(
    trajectory: Trajectory, rows: NDArray[np.int64], view: View, by: str
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
        yield f"{body_path(trajectory.scene['frames'][frame])}/contact forces/{slot}", track


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
