"""Contents of a page: the names and arrays of a recording, as one text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import umsgpack
from numpy.typing import NDArray

from nsdyn.dynamics.ledger import LAYERS, NUMERICS
from nsdyn.recording import body_motion, link_names
from nsdyn.recording.columns import ENERGIES
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import counted
from nsdyn.view import arrows, contact_points, curves, keyframes, marks, paths, payload, titles
from nsdyn.view.commands import Json, as_hex
from nsdyn.view.looks import mesh_arrays, veiled, visual_commands
from nsdyn.view.solids import body_path, colour, shape_commands, shape_path
from nsdyn.view.stage import BACKGROUND, FIELD_OF_VIEW, View, stage_commands

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

MAX_CONTACTS = 150_000
"""Most contacts in all frames of a page, up to 10 MB; with more, only every second, third, ... frame has contacts."""

MAX_IMPACTS = 200
"""Most impacts that are marked on the time axis, the strongest first."""

FPS = 30.0
"""States per second in the page, if not all states of the recording are kept."""

CHEAP = 1_000_000
"""Most characters by which a page with all states may exceed a page with FPS states per second."""

UNPACKED = 8e6
"""Bytes of bodies and contacts above which a page with all states is not tried: browsers would be slow to open it."""

Arrays = dict[str, NDArray[Any]]


def packed(
    trajectory: Trajectory,
    fps: float | None,
    forces: bool | str,
    max_frames: int,
    at: float | None,
    label: str = "",
    view: View | None = None,
) -> str:
    """Return the contents as text of `nsdyn.view.payload`; parameters and errors as in `nsdyn.view.viewer.html`.

    A recording shown beside another has a `label` and the common `view`.
    """
    t = trajectory.t
    finite = np.isfinite(trajectory.q).all(axis=1)
    if not finite.all():
        raise ValueError(f"the state is not finite from t = {t[np.argmin(finite)]:g} s on")
    hits = marks.find(trajectory)
    strongest = np.argsort(-hits.impulse * hits.speed, kind="stable")[:MAX_IMPACTS]
    # Keep the states before and after each impact: interpolation between other states would lower the speeds.
    around = [row for step in hits.step[strongest].tolist() for row in (step, step - 1)]
    rows = _chosen(t, FPS if fps is None else fps, max_frames, at, around)
    view = view or View([trajectory])
    values, outline = _scene(trajectory, view)
    drawn = mesh_arrays(trajectory.scene) | _commands(trajectory, view, int(rows[0]))
    ticks = np.sort(strongest)
    impacts = {
        "impacts/t": t[hits.step[ticks]],
        "impacts/speed": hits.speed[ticks].astype("<f4"),
        "impacts/impulse": hits.impulse[ticks].astype("<f4"),
        "impacts/geoms": hits.geoms[ticks].astype("<u4"),
    }

    def made(rows: Index) -> str:
        arrays = {**outline, "t": t[rows], **drawn, **_states(trajectory, rows, view.radius), **impacts}
        notes = _notes(trajectory, rows.size, arrays["ledger/t"].size, int(hits.step.size))
        shown: Json = {}
        if trajectory.has_contacts:
            more, shown, told = _contacts_of(trajectory, rows, forces, view)
            arrays, notes = arrays | more, notes + told
        still = {"label": label or values["name"], "picture": at is not None, "notes": [] if at is not None else notes}
        return payload.pack(values | shown | still, arrays)

    usual = made(rows)
    contacts = int(trajectory.columns["contacts/offset"][-1]) if trajectory.has_contacts else 0
    size = 28 * t.size * len(trajectory.scene["frames"]) + 57 * contacts
    if fps is not None or at is not None or rows.size == t.size or size > UNPACKED:
        return usual
    whole = made(np.arange(t.size))
    return whole if len(whole) - len(usual) < CHEAP else usual


def _commands(trajectory: Trajectory, view: View, row: int) -> Arrays:
    """Return the commands that build the scene, with the bodies as in a row of the recording."""
    commands = stage_commands(view) + shape_commands(trajectory.scene, view) + visual_commands(trajectory.scene)
    parts = [umsgpack.packb(command) for command in commands + paths.start_commands(trajectory, row)]
    ends = np.cumsum([len(part) for part in parts], dtype=np.uint32)
    return {"commands": np.frombuffer(b"".join(parts), np.uint8), "command_ends": ends}


def _states(trajectory: Trajectory, rows: Index, radius: float) -> Arrays:
    """Return curves, and the motion of bodies and joints, at the states `rows`."""
    ledger = curves.ledger(trajectory, rows if rows.size == trajectory.t.size else None)
    motion = paths.keys(trajectory, rows, radius)
    out = {f"ledger/{name}": x.astype("<f8" if name == "t" else "<f4") for name, x in ledger.items()}
    out |= {f"motion/{name}": x.astype("<f4" if x.ndim > 1 else "<u4") for name, x in motion.items()}
    out |= {f"bodies/{name}": payload.rounded(x) for name, x in curves.bodies(trajectory, rows).items()}
    if _joints(trajectory.scene):
        out |= {f"joints/{name}": payload.rounded(x) for name, x in curves.joints(trajectory, rows).items()}
    return out


def _contacts_of(trajectory: Trajectory, rows: Index, forces: bool | str, view: View) -> tuple[Arrays, Json, list[str]]:
    """Return contacts and forces of the states shown, values for showing them, and notes on omissions."""
    notes: list[str] = []
    stride = max(1, -(-int(contact_points.counts(trajectory, rows).sum()) // MAX_CONTACTS))
    if stride > 1:
        notes.append(f"contacts of one in {stride} of them")
    found = contact_points.at(trajectory, rows[::stride])
    arrays = {"contacts/t": trajectory.t[rows[::stride]]} | _contacts(found)
    pushes, usual, left = _forces(trajectory, rows[::stride], "point" if forces == "point" else "pair")
    if left:
        notes.append(f"the {MAX_CONTACTS} largest of {left + MAX_CONTACTS} forces")
    units = {"forces": usual, "cones": _usual(found["r"][:, 0] / trajectory.dt)}
    lengths = {"forces": view.radius / 5, "cones": min(view.radius / 5, view.body_radius)}
    return arrays | pushes, {"forces": bool(forces), "units": units, "lengths": lengths}, notes


def _chosen(t: Array, fps: float, most: int, at: float | None, needed: list[int]) -> Index:
    """Return the states shown: `fps` per second and those `needed`, all for infinite `fps`, or the one at time `at`."""
    rows = np.arange(t.size) if math.isinf(fps) and fps > 0 else keyframes.choose(t, fps, most, needed)
    if at is None:
        return rows
    if not t[0] <= at <= t[-1]:
        raise ValueError(f"at must lie between {t[0]:g} and {t[-1]:g} s, got {at}")
    return keyframes.nearest(t, np.array([at]))


def _scene(trajectory: Trajectory, view: View) -> tuple[Json, Arrays]:
    """Return names, masses and frames of the bodies shown, as JSON values and arrays."""
    scene = trajectory.scene
    labels = [geom["link"] for geom in scene["geoms"]]
    looks = scene.get("visuals", [])
    drawn = [*scene["geoms"], *looks]
    carriers = [*labels, *(look["link"] for look in looks)]
    firsts: dict[str, Json] = {}
    for name, geom in zip(carriers, drawn, strict=True):
        firsts.setdefault(name, geom)
    number = {name: k for k, name in enumerate(firsts)}
    bodies, joints, carried = [], _joints(scene), body_motion.carried(scene)
    for name, geom in firsts.items():
        frame = geom["frame"]
        mass, centre, _ = carried.get(frame, (None, np.zeros(3), None))
        joint = joints.get(scene["frames"][frame]) if frame >= scene["free"] else None
        shown = f"#{as_hex(colour(geom)):06x}"
        bodies.append({"name": name, "frame": frame, "joint": joint, "colour": shown})
        bodies[-1] |= {"mass": mass, "centre": centre.tolist()}
    values = {
        "name": trajectory.meta["scene_name"],
        "begin": float(trajectory.t[0]),
        "end": float(trajectory.t[-1]),
        "dt": trajectory.dt,
        "words": titles.words(trajectory),
        "made": _made(trajectory),
        "contacts": trajectory.has_contacts,
        "gravity": scene["gravity"],
        "largest": trajectory.largest_energy,
        "at_rest": trajectory.at_rest,
        "layers": [
            {"name": name, "label": words, "colour": colour, "sign": 1 if name in ENERGIES else -1}
            for name, (words, colour, _) in LAYERS.items()
        ],
        "numerics": NUMERICS,
        "bodies": bodies,
        "frames": [body_path(name) for name in scene["frames"]],
        "geoms": [
            {
                "path": shape_path(scene, geom, geom["name"]),
                "body": number[label],
                "solid": geom["shape"] != "halfspace",
                "veiled": behind,
            }
            for geom, label, behind in zip(scene["geoms"], labels, veiled(scene), strict=True)
        ],
        "looks": [
            {"path": shape_path(scene, look, f"look {k}"), "body": number[look["link"]], "mesh": look.get("mesh")}
            for k, look in enumerate(looks)
        ],
        "view": {
            "centre": view.centre.tolist(),
            "radius": view.radius,
            "back": ((view.eye - view.centre) / np.linalg.norm(view.eye - view.centre)).tolist(),
            "field": FIELD_OF_VIEW,
            "background": BACKGROUND,
            "planes": [[*normal.tolist(), offset] for normal, offset in view.planes],
        },
    }
    return values, {"outline": view.outline.astype("<f4")}


def _joints(scene: Mapping[str, Any]) -> dict[str, Json]:
    """Return joints by name: short name, index among all joints, units of coordinate and force."""
    told = [joint["kind"] for a in scene["articulations"] for joint in a["model"]["joints"]]
    units = [["m", "N"] if kind.startswith("JointModelP") else ["rad", "N·m"] for kind in told]
    names = link_names.joints(scene)
    return {name: {"name": name.partition("/")[2], "column": k, "units": units[k]} for k, name in enumerate(names)}


def _made(trajectory: Trajectory) -> dict[str, str]:
    """Return how to make the recording again, as far as the recording has it."""
    meta = trajectory.meta
    out = {
        "parameters": titles.parameters(trajectory),
        "step": f"{trajectory.dt:g} s",
        "solver": str(meta.get("solver", "")),
        "command": meta.get("command", ""),
        "nsdyn": str(meta.get("nsdyn_version", "")),
    }
    return {name: text for name, text in out.items() if text}


def _contacts(found: Arrays) -> Arrays:
    """Return contacts with the digits that are shown."""
    whole = {"offset": "<u4", "id": "<u4", "state": "u1", "geoms": "<u4"}
    return {
        f"contacts/{name}": x.astype(whole[name]) if name in whole else payload.rounded(x) for name, x in found.items()
    }


def _forces(trajectory: Trajectory, rows: Index, by: str) -> tuple[Arrays, float, int]:
    """Return mean forces since the previous state, their usual size, N, and the number of omitted forces."""
    since = rows if rows.size > 1 else np.array([max(0, rows[0] - 1), rows[0]])
    found = arrows.between(trajectory, since, by)
    size = np.linalg.norm(found.force, axis=1)
    pushing = int((size > 0.0).sum())
    order = np.sort(np.argsort(-size, kind="stable")[: min(MAX_CONTACTS, pushing)])  # stay sorted by keyframe
    frame = found.keyframe[order] - (since.size - rows.size)
    arrays: Arrays = {
        "forces/offset": np.searchsorted(frame, np.arange(rows.size + 1)).astype("<u4"),
        "forces/frame": found.frame[order].astype("<u4"),
        "forces/point": payload.rounded(found.point[order]),
        "forces/force": payload.rounded(found.force[order]),
    }
    return arrays, _usual(size), pushing - order.size


def _usual(size: Array) -> float:
    """Return the 90 % quantile of the positive sizes, 0 if none is positive."""
    return float(np.quantile(size[size > 0.0], 0.9)) if (size > 0.0).any() else 0.0


def _notes(trajectory: Trajectory, frames: int, points: int, hits: int) -> list[str]:
    """Return notes for the reader of the page on data that the page leaves out."""
    states = trajectory.t.size
    recorded = counted(states, "recorded state")
    notes = [f"{frames} of {recorded}" if frames < states else f"all {recorded}" if states > 1 else recorded]
    if points < states:
        notes.append(f"curves of {points} of them, figures of checks the largest in between")
    if trajectory.every > 1:
        notes.append(
            f"one step in {trajectory.every} is recorded: works are sums of {trajectory.every} steps, "
            "contacts those of the last; impacts are not marked"
        )
    if not trajectory.has_contacts:
        notes.append("recorded without contacts: no points, forces, impacts and penetrations")
    if hits > MAX_IMPACTS:
        notes.append(f"the {MAX_IMPACTS} strongest of {hits} steps with impacts are marked")
    return notes
