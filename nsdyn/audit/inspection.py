"""List the parts of a scene or a robot file, and the errors in it, before anything is simulated."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn.audit.findings import TOLERANCES
from nsdyn.audit.poses import Poses
from nsdyn.audit.touching import separations
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene.articulations import Articulation
from nsdyn.scene.gears import joints_of
from nsdyn.scene.scene import Scene
from nsdyn.tools.files import as_path
from nsdyn.tools.naming import counted
from nsdyn.tools.table import SHOWN

ROBOTS = (".urdf", ".sdf", ".xml", ".mjcf")
"""Extensions of robot files."""

UNITS = {
    "at": "rad, m",
    "lower": "rad, m",
    "upper": "rad, m",
    "effort": "N m, N",
    "friction": "N m, N",
    "damping": "N m s, N s/m",
}
"""Units of the columns of the table of joints."""

ONLY = {"base": (".urdf",), "keyframe": (".xml", ".mjcf"), "package_dirs": (".urdf", ".sdf")}
"""Options that only some kinds of robot files take, with the extensions of these files."""


@dataclass(frozen=True)
class Mass:
    """A body with all that is welded to it, or a fixed base: mass [kg] and principal moments [kg m²], ascending."""

    name: str
    mass: float
    moments: tuple[float, float, float]
    fixed: bool = False


@dataclass(frozen=True)
class Joint:
    """A joint coordinate: its value, range and loads; units as in `UNITS`, for rotation or translation."""

    name: str
    at: float
    lower: float
    upper: float
    effort: float
    friction: float
    damping: float


@dataclass(frozen=True)
class Inspection:
    """Result of `inspect_scene` or `inspect_robot`.

    Attributes
    ----------
    name : str
    shapes : int
        Number of collision shapes.
    masses : tuple of Mass
    joints : tuple of Joint
    overlaps : tuple of (str, str, float)
        Pairs of shapes that overlap at the start by more than 1e-7 of the smaller one, with their penetration [m], the
        deepest first.
    outside : tuple of str
        Joints that start outside their limits.
    missing : tuple of str
        Unused content of files without which the mechanism is a different one: shapes, masses, constraints.
    dropped : tuple of str
        Other unused content that changes the motion; inertias that no body can have.
    unused : tuple of str
        Unused content that does not change the motion, for instance pictures.
    notes : tuple of str
        Further remarks.
    actuators : tuple of str
        Names of the actuators of MJCF files that `nsdyn.Actuation` controls.
    """

    name: str
    shapes: int
    masses: tuple[Mass, ...]
    joints: tuple[Joint, ...]
    overlaps: tuple[tuple[str, str, float], ...]
    outside: tuple[str, ...]
    missing: tuple[str, ...]
    dropped: tuple[str, ...]
    unused: tuple[str, ...]
    notes: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether no shapes overlap, no joint starts outside its limits, and nothing is missing."""
        return not (self.overlaps or self.outside or self.missing)

    def as_dict(self) -> dict[str, Any]:
        """Return the inspection as JSON values."""
        return asdict(self) | {"passed": self.passed}

    def __repr__(self) -> str:
        masses = counted(len(self.masses), "mass", "masses")
        joints = counted(len(self.joints), "joint coordinate")
        lines = [f"{self.name}: {masses}, {joints}, {counted(self.shapes, 'shape')}, {self._totals()}"]
        labels = [f"{body.name} (fixed)" if body.fixed else body.name for body in self.masses]
        width = max([10, *map(len, labels), *(len(joint.name) for joint in self.joints)])
        if self.masses:
            lines.append(f"{'':{width}} {'mass [kg]':>10} {'principal moments [kg m²]':>32}")
            moments = ("".join(f"{moment:11.3g}" for moment in body.moments) for body in self.masses)
            rows = zip(labels, self.masses, moments, strict=True)
            lines += _first(f"{label:{width}} {body.mass:10.4g}{of}" for label, body, of in rows)
        if self.joints:
            columns = {word: max(10, len(unit) + 3) for word, unit in UNITS.items()}
            lines.append(f"{'joint':{width}}" + "".join(f"{word:>{n}}" for word, n in columns.items()))
            lines.append(f"{'':{width}}" + "".join(f"{f'[{UNITS[word]}]':>{n}}" for word, n in columns.items()))
            values = ("".join(f"{getattr(j, word):{n}.4g}" for word, n in columns.items()) for j in self.joints)
            lines += _first(f"{j.name:{width}}{of}" for j, of in zip(self.joints, values, strict=True))
        if self.actuators:
            lines.append(f"actuators: {', '.join(_first(self.actuators))}")
        for what, items in (
            ("overlaps at the start", [f"{a} and {b} by {depth:.3g} m" for a, b, depth in self.overlaps]),
            ("outside its limits", self.outside),
            ("missing, not read", self.missing),
            ("left out, changes the motion", self.dropped),
            ("not used", self.unused),
        ):
            lines += _first(f"{what}: {item}" for item in items or ["nothing"])
        lines += _first(f"note: {note}" for note in self.notes)
        lines.append(f"{self.name}: {'passed' if self.passed else 'FAILED'}")
        return "\n".join(lines)

    def _totals(self) -> str:
        """Return the masses in one line."""
        fixed = sum(body.mass for body in self.masses if body.fixed)
        moving = [body.mass for body in self.masses if body.mass > 0.0 and not body.fixed]
        out = f"{sum(moving) + fixed:.6g} kg in all"
        if fixed:
            out += f", {fixed:.6g} kg of it fixed"
        return f"{out}, moving from {min(moving):.3g} to {max(moving):.3g} kg" if moving else out


def _first(lines: Iterable[str]) -> list[str]:
    """Return the first `SHOWN` lines, and how many more there are."""
    rows = list(lines)
    return rows[:SHOWN] + ([f"... {len(rows) - SHOWN} more"] if len(rows) > SHOWN else [])


def inspect_scene(scene: Scene, name: str | None = None) -> Inspection:
    """Inspect a scene: masses, joints, overlaps at the start, and content of its files that is not used.

    `nsdyn.audit.overlap` measures the overlaps, as in the audit; it shares no code with the detection of contacts.
    Pairs of shapes that may overlap, for instance links that a joint connects, are not tested. The default name is that
    of the scene.
    """
    masses = [Mass(body.name, body.mass, _moments(body.inertia)) for body in scene.free_bodies]
    joints: list[Joint] = []
    told: dict[str, list[str]] = {"missing": [], "dropped": [], "unused": []}
    for a in scene.articulations.values():
        bodies = {int(f.parentJoint): f.name for f in reversed(list(a.model.frames)) if f.type == pin.FrameType.BODY}
        for joint, inertia in enumerate(a.model.inertias):
            if inertia.mass > 0.0 or (joint and joint in bodies):
                name_ = f"{a.name}/{bodies.get(joint, a.model.names[joint])}" if joint else a.name
                masses.append(Mass(name_, float(inertia.mass), _moments(inertia.inertia), joint == 0))
        joints += _joints(a)
        for what, notes in told.items():
            notes += [f"{a.name}: {note}" for note in getattr(a, what)]
    outside = tuple(
        f"{joint.name} at {joint.at:.6g}, from {joint.lower:.6g} to {joint.upper:.6g}"
        for joint in joints
        if not joint.lower - 1e-9 <= joint.at <= joint.upper + 1e-9  # allows for the rounding of a user's numbers
    )
    title = scene.name if name is None else name
    listed = {what: tuple(notes) for what, notes in told.items()}
    driven = tuple(f"{a.name}/{one.name}" for a in scene.articulations.values() for one in a.actuators)
    return Inspection(
        title, len(scene.geoms()), tuple(masses), tuple(joints), _overlaps(scene), outside, **listed, actuators=driven
    )


def inspect_robot(path: str | Path, **options: Any) -> Inspection:
    """Inspect a URDF, SDF or MJCF file, alone, in its initial configuration; see `inspect_scene`.

    ValueError naming a file that cannot be read or simulated at all, or an option that is not for such a file.

    Parameters
    ----------
    path : path
    **options
        Of `nsdyn.Scene.add_urdf`, `add_sdf` or `add_mjcf`. Without `q` and `keyframe` a start outside limits, and
        overlaps there, are only notes: no motion can start there, but another start can be given.
    """
    path, scene = as_path(path), Scene()
    ending = path.suffix.lower()
    for option in options:
        if ending not in ONLY.get(option, ROBOTS):
            raise ValueError(f"{option} is for {' and '.join(ONLY[option])} files, which {path.name} is not")
    add: Any = {".urdf": scene.add_urdf, ".sdf": scene.add_sdf}.get(ending, scene.add_mjcf)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the report lists the content that is left out
        add("robot", path, **{"inertias": "trust", "limits": False} | options)
    found = inspect_scene(scene, path.name)
    if options.keys() & {"q", "keyframe"} or not found.outside:
        return found
    notes = [f"starts outside its limits unless q is given: {joint}" for joint in found.outside]
    notes += [f"overlaps there: {a} and {b} by {depth:.3g} m" for a, b, depth in found.overlaps]
    return replace(found, outside=(), overlaps=(), notes=tuple(notes))


def _moments(inertia: Any) -> tuple[float, float, float]:
    low, mid, high = np.linalg.eigvalsh(np.asarray(inertia)).tolist()
    return low, mid, high


def _joints(a: Articulation) -> list[Joint]:
    """Coordinates of joints whose q are angles and lengths, numbered if a joint has several."""
    m, out = a.model, []
    for joint in joints_of(m):
        if joint.plain:
            of_q = (x[joint.q].tolist() for x in (a.q, m.lowerPositionLimit, m.upperPositionLimit))
            of_v = (x[joint.v].tolist() for x in (a.effort, a.friction, a.damping))
            rows = list(zip(*of_q, *of_v, strict=True))
            numbers = [f" {k + 1}" for k in range(len(rows))] if len(rows) > 1 else [""]
            out += [Joint(f"{a.name}/{joint.name}{k}", *row) for k, row in zip(numbers, rows, strict=True)]
    return out


def _overlaps(scene: Scene) -> tuple[tuple[str, str, float], ...]:
    """Pairs of shapes that overlap at the start of the scene, deepest first."""
    dynamics = Dynamics(scene)
    position, v = dynamics.start()
    place = dynamics.place(position)
    q, u = dynamics.pinocchio_state(position, v)
    columns = {"t": np.zeros(1), "q": q[None], "v": u[None]}
    x, quaternion = dynamics.poses(position, place)
    if x is not None and quaternion is not None:
        columns |= {"frames/x": x[None], "frames/quat": quaternion[None]}
    poses = Poses(Trajectory({}, scene.describe(), columns))
    if not poses.names:
        return ()
    depth, first, second, _ = separations(poses)
    deep = np.flatnonzero(depth > TOLERANCES["overlap"] * poses.size(first, second))
    rows = [(poses.names[first[k]], poses.names[second[k]], float(depth[k])) for k in deep]
    return tuple(sorted(rows, key=lambda row: -row[2]))
