"""A recording as one self-contained web page: meshcat's viewer, the scene, its motion, energies, contacts; no network.

Everything is drawn from the collision shapes of the recording. The 3D part is a list of meshcat commands (set_object,
set_property, set_animation) in MessagePack, as in meshcat's `static_html`, but built without its server, with keyframes
as binary arrays, and with identifiers made from names instead of random ones: equal recordings give equal bytes. The
rest, in the folder `page`, is the page's own script, which reads the arrays made here.
"""

from __future__ import annotations

import html as _escape
import importlib.util
import warnings
from functools import lru_cache
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
import umsgpack
from numpy.typing import NDArray

from nsdyn.recording import arrows, bundle, contact_points, curves, impacts, keyframes
from nsdyn.recording.commands import Json
from nsdyn.recording.motion import motion_commands
from nsdyn.recording.solids import body_path, geom_path, shape_commands
from nsdyn.recording.stage import FIELD_OF_VIEW, View, stage_commands
from nsdyn.tools import files
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import choice

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

__all__ = ["html", "write_html"]

LARGE_PAGE = 50e6
"""Bytes; browsers get slow."""

MAX_CONTACTS = 200_000
"""Of all frames of a page, about 7 MB: of every other frame, every third and so on where there are more."""

MAX_IMPACTS = 200
"""Marks on the time axis, of the strongest."""

SCRIPTS = ("format", "recording", "clock", "stage", "overlay", "chart", "ledger", "inspector", "pane", "main")
"""Of the folder `page`, in the order of their use."""

Arrays = dict[str, NDArray[Any]]


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
    beside: Trajectory | None = None,
) -> str:
    """Self-contained page that plays a recording in any browser.

    Parameters
    ----------
    trajectory : Trajectory
    fps : float
        Keyframes per second of simulated time, to which every impact is added; the browser interpolates between them.
    forces : bool or {"pair", "point"}
        Whether the contact forces are drawn when the page opens, which a button changes. They are the mean since the
        keyframe before, on the moving body, on body 2 when both move: one for each pair of bodies (False, True,
        "pair"), or for each contact point. Their 90 % quantile is as long as a fifth of the scene's radius; arrows are
        cut at twice that.
    max_frames : int
        Most keyframes; long recordings get fewer per second.
    at : float, optional
        Show only the recorded state nearest to this time, s, for a picture: without controls.
    beside : Trajectory, optional
        A second recording, shown beside the first on the same clock.

    Raises
    ------
    ValueError
        If an option is out of range.

    Warns
    -----
    UserWarning
        If the page has over 50 MB.
    """
    if not isinstance(forces, bool):
        choice(forces, ("pair", "point"), "forces")
    shown = [trajectory] if beside is None else [trajectory, beside]
    page = Template(_part("page.html")).substitute(
        title=_escape.escape(" | ".join(t.meta["scene_name"] for t in shown) + " - nsdyn"),
        style=_part("page.css"),
        meshcat=_meshcat_script(),
        script="\n".join(_part(f"{name}.js") for name in SCRIPTS),
        recordings="\n".join(
            f'<script type="text/plain" class="recording">{_packed(t, fps, forces, max_frames, at)}</script>'
            for t in shown
        ),
    )
    if len(page) > LARGE_PAGE:
        warnings.warn(
            f"the page has {len(page) / 1e6:.0f} MB, which browsers open slowly; lower fps or max_frames",
            stacklevel=2,
        )
    return page


def _part(name: str) -> str:
    return (Path(__file__).parent / "page" / name).read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _meshcat_script() -> str:
    """JavaScript of meshcat's viewer; the package is not imported, for that would load its server."""
    spec = importlib.util.find_spec("meshcat")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("the page needs the viewer of the package meshcat: pip install meshcat")
    folder = Path(next(iter(spec.submodule_search_locations)))
    return (folder / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def _packed(trajectory: Trajectory, fps: float, forces: bool | str, max_frames: int, at: float | None) -> str:
    """What the page has to know of a recording."""
    t = trajectory.t
    finite = np.isfinite(trajectory.q).all(axis=1)
    if not finite.all():
        raise ValueError(f"the state is not finite from t = {t[np.argmin(finite)]:g} s on")
    hits = impacts.find(trajectory)
    strongest = np.argsort(-hits.impulse * hits.speed, kind="stable")[:MAX_IMPACTS]
    rows = keyframes.choose(t, fps, max_frames, hits.step[strongest].tolist())
    if at is not None:
        if not t[0] <= at <= t[-1]:
            raise ValueError(f"at must lie between {t[0]:g} and {t[-1]:g} s, got {at}")
        rows = keyframes.nearest(t, np.array([at]))
    view = View(trajectory)
    values, arrays = _scene(trajectory, view)
    values |= {"picture": at is not None, "impacts": int(hits.step.size)}
    arrays["t"] = t[rows]
    commands = stage_commands(view) + shape_commands(trajectory.scene, view)
    parts = [umsgpack.packb(command) for command in commands + motion_commands(trajectory, rows, view.radius)]
    arrays["commands"] = np.frombuffer(b"".join(parts), np.uint8)
    arrays["command_ends"] = np.cumsum([len(part) for part in parts], dtype=np.uint32)
    arrays |= {
        f"ledger/{name}": x.astype("<f8" if name == "t" else "<f4") for name, x in curves.ledger(trajectory).items()
    }
    arrays |= {f"bodies/{name}": bundle.rounded(x) for name, x in curves.bodies(trajectory, rows).items()}
    ticks = np.sort(strongest)
    arrays |= {
        "impacts/t": t[hits.step[ticks]],
        "impacts/speed": hits.speed[ticks].astype("<f4"),
        "impacts/impulse": hits.impulse[ticks].astype("<f4"),
        "impacts/geoms": hits.geoms[ticks].astype("<u4"),
    }
    stride = 1
    if trajectory.has_contacts:
        stride = max(1, -(-int(contact_points.counts(trajectory, rows).sum()) // MAX_CONTACTS))
        found, units = _touching(trajectory, rows[::stride], "point" if forces == "point" else "pair")
        arrays |= found
        values |= {"forces": bool(forces), "units": units, "length": view.radius / 5}
    values["notes"] = _notes(trajectory, rows.size, stride, int(hits.step.size), at)
    return bundle.pack(values, arrays)


def _scene(trajectory: Trajectory, view: View) -> tuple[Json, Arrays]:
    """Names, masses and places of what is shown."""
    scene = trajectory.scene
    labels = [geom.get("link", geom["name"]) for geom in scene["geoms"]]
    names = list(dict.fromkeys(labels))
    bodies = []
    for name in names:
        frame = scene["geoms"][labels.index(name)]["frame"]
        mass = scene["masses"][frame] if 0 <= frame < scene["free"] else None
        bodies.append({"name": name, "frame": frame, "mass": mass})
    values = {
        "name": trajectory.meta["scene_name"],
        "begin": float(trajectory.t[0]),
        "end": float(trajectory.t[-1]),
        "dt": trajectory.dt,
        "solver": str(trajectory.meta.get("solver", "")),
        "contacts": trajectory.has_contacts,
        "gravity": scene["gravity"],
        "largest": trajectory.largest_energy,
        "bodies": bodies,
        "frames": [body_path(name) for name in scene["frames"]],
        "geoms": [
            {"path": geom_path(scene, geom), "body": names.index(label)}
            for geom, label in zip(scene["geoms"], labels, strict=True)
        ],
        "view": {
            "centre": view.centre.tolist(),
            "radius": view.radius,
            "back": ((view.eye - view.centre) / np.linalg.norm(view.eye - view.centre)).tolist(),
            "slope": float(np.tan(np.radians(FIELD_OF_VIEW / 2))),
            "planes": [[*normal.tolist(), offset] for normal, offset in view.planes],
        },
    }
    return values, {"outline": view.outline.astype("<f4")}


def _touching(trajectory: Trajectory, rows: Index, by: str) -> tuple[Arrays, dict[str, float]]:
    """Contacts at some states, and the forces since the one before; 90 % quantiles, N, of forces and of cones."""
    found = contact_points.at(trajectory, rows)
    whole = {"offset": "<u4", "id": "<u4", "state": "u1", "geoms": "<u4"}
    arrays: Arrays = {
        f"contacts/{name}": x.astype(whole[name]) if name in whole else bundle.rounded(x) for name, x in found.items()
    }
    arrays["contacts/t"] = trajectory.t[rows]
    since = rows if rows.size > 1 else np.array([max(0, rows[0] - 1), rows[0]])
    pushes = arrows.between(trajectory, since, by)
    size = np.linalg.norm(pushes.force, axis=1)
    order = np.argsort(pushes.keyframe, kind="stable")
    order = order[size[order] > 0.0]
    frame = pushes.keyframe[order] - (since.size - rows.size)
    arrays |= {
        "forces/offset": np.searchsorted(frame, np.arange(rows.size + 1)).astype("<u4"),
        "forces/frame": pushes.frame[order].astype("<u4"),
        "forces/point": bundle.rounded(pushes.point[order]),
        "forces/force": bundle.rounded(pushes.force[order]),
    }
    return arrays, {"forces": _usual(size), "cones": _usual(found["r"][:, 0] / trajectory.dt)}


def _usual(size: Array) -> float:
    """90 % quantile of those that are positive, 0 if none is."""
    return float(np.quantile(size[size > 0.0], 0.9)) if (size > 0.0).any() else 0.0


def _notes(trajectory: Trajectory, frames: int, stride: int, hits: int, at: float | None) -> list[str]:
    """What a reader of the page has to know of what it leaves out."""
    states = trajectory.t.size
    if at is not None:
        return []
    notes = [f"{frames} of {states} recorded states" if frames < states else f"all {states} recorded states"]
    if states > curves.MAX_POINTS:
        notes.append(f"curves of {curves.MAX_POINTS} of them, figures of checks the largest in between")
    if trajectory.every > 1:
        notes.append(
            f"every {trajectory.every}th step is recorded: works are sums of {trajectory.every} steps, "
            "contacts those of the last; impacts are not marked"
        )
    if not trajectory.has_contacts:
        notes.append("recorded without contacts: no points, forces, impacts and overlaps")
    if stride > 1:
        notes.append(f"contacts of every {stride}th state shown")
    if hits > MAX_IMPACTS:
        notes.append(f"the {MAX_IMPACTS} strongest of {hits} steps with impacts are marked")
    if trajectory.scene["articulations"]:
        notes.append("masses and speeds of links are not recorded")
    return notes
