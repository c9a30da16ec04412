"""What a scene or a robot file is made of, and what is wrong with it, before anything is simulated."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.recording.findings import TOLERANCES
from nsdyn.recording.poses import Poses
from nsdyn.recording.touching import separations
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene.articulations import Articulation
from nsdyn.scene.scene import Scene

__all__ = ["ROBOTS", "Inspection", "Joint", "Mass", "inspect_robot", "inspect_scene"]

ROBOTS = (".urdf", ".sdf", ".xml", ".mjcf")
"""Endings of the names of robot files."""

SHOWN = 40
"""Rows of a table that are printed."""


@dataclass(frozen=True)
class Mass:
    """A moving body, or what a joint carries: its mass [kg] and principal moments of inertia [kg m²], ascending."""

    name: str
    mass: float
    moments: tuple[float, float, float]


@dataclass(frozen=True)
class Joint:
    """A joint coordinate: where it is and its range [rad or m], effort and dry friction [N m or N], damping [per s]."""

    name: str
    at: float
    lower: float
    upper: float
    effort: float
    friction: float
    damping: float


@dataclass(frozen=True)
class Inspection:
    """What `inspect_scene` found.

    Attributes
    ----------
    name : str
    shapes : int
        Collision shapes.
    masses : tuple of Mass
    joints : tuple of Joint
    overlaps : tuple of (str, str, float)
        Shapes that overlap at the start by more than 1e-7 of the smaller one, and how deep [m], the deepest first.
    outside : tuple of str
        Joints that start outside their limits.
    unused : tuple of str
        What files contain that is not used, and inertias that no body can have.
    """

    name: str
    shapes: int
    masses: tuple[Mass, ...]
    joints: tuple[Joint, ...]
    overlaps: tuple[tuple[str, str, float], ...]
    outside: tuple[str, ...]
    unused: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing overlaps and no joint starts outside its limits."""
        return not (self.overlaps or self.outside)

    def as_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self) | {"passed": self.passed}

    def __repr__(self) -> str:
        masses = [body.mass for body in self.masses if body.mass > 0.0]
        total = f"{sum(masses):.6g} kg in all"
        if masses:
            total += f", from {min(masses):.3g} to {max(masses):.3g} kg"
        counts = f"{len(self.masses)} masses, {len(self.joints)} joint coordinates, {self.shapes} shapes"
        lines = [f"{self.name}: {counts}, {total}"]
        width = max([10, *(len(body.name) for body in self.masses), *(len(joint.name) for joint in self.joints)])
        if self.masses:
            lines.append(f"{'':{width}} {'mass [kg]':>10} {'principal moments [kg m²]':>32}")
            for body in self.masses[:SHOWN]:
                moments = "".join(f"{moment:11.3g}" for moment in body.moments)
                lines.append(f"{body.name:{width}} {body.mass:10.4g}{moments}")
            lines += _more(self.masses)
        if self.joints:
            head = "at", "lower", "upper", "effort", "friction", "damping"
            lines.append(f"{'joint':{width}}" + "".join(f"{word:>10}" for word in head))
            for joint in self.joints[:SHOWN]:
                values = (getattr(joint, word) for word in head)
                lines.append(f"{joint.name:{width}}" + "".join(f"{value:10.4g}" for value in values))
            lines += _more(self.joints)
        for what, items in (
            ("overlaps at the start", [f"{a} and {b} by {depth:.3g} m" for a, b, depth in self.overlaps]),
            ("outside its limits", list(self.outside)),
            ("not used", list(self.unused)),
        ):
            lines += [f"{what}: {item}" for item in items[:SHOWN]] + _more(items) if items else [f"{what}: nothing"]
        lines.append(f"{self.name}: {'passed' if self.passed else 'FAILED'}")
        return "\n".join(lines)


def _more(rows: Sequence[Any]) -> list[str]:
    return [f"... {len(rows) - SHOWN} more"] if len(rows) > SHOWN else []


def inspect_scene(scene: Scene, name: str | None = None) -> Inspection:
    """Masses, joints, overlaps at the start, and what its files contain that is not used.

    Overlaps are those of the audit, `nsdyn.recording.overlap`, which shares nothing with the detection of contacts;
    shapes that may overlap, as those of links that a joint joins, are left out.

    Parameters
    ----------
    scene : Scene
    name : str, optional
        Default: that of the scene.
    """
    masses = [Mass(body.name, body.mass, _moments(body.inertia)) for body in scene.free_bodies]
    joints: list[Joint] = []
    unused: list[str] = []
    for a in scene.articulations.values():
        model = a.model
        for joint in range(1, model.njoints):
            inertia = model.inertias[joint]
            masses.append(Mass(f"{a.name}/{model.names[joint]}", float(inertia.mass), _moments(inertia.inertia)))
        joints += _joints(a)
        unused += [f"{a.name}: {note}" for note in a.report]
    outside = tuple(
        f"{joint.name} at {joint.at:.6g}, from {joint.lower:.6g} to {joint.upper:.6g}"
        for joint in joints
        if not joint.lower - 1e-9 <= joint.at <= joint.upper + 1e-9  # the rounding of a user's own numbers
    )
    title = scene.name if name is None else name
    found = _overlaps(scene)
    return Inspection(title, len(scene.geoms()), tuple(masses), tuple(joints), found, outside, tuple(unused))


def inspect_robot(path: str | Path, package_dirs: Sequence[str | Path] = ()) -> Inspection:
    """Inspect a URDF, SDF or MJCF file, alone, in the configuration that it starts from; see `inspect_scene`.

    Raises
    ------
    ValueError
        For what cannot be read or simulated at all, naming it.
    """
    path, scene = Path(path), Scene()
    keywords: dict[str, Any] = {"inertias": "trust", "limits": False}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is left out is in the report
        if path.suffix == ".urdf":
            scene.add_urdf("robot", path, package_dirs=package_dirs, **keywords)
        elif path.suffix == ".sdf":
            scene.add_sdf("robot", path, package_dirs=package_dirs, **keywords)
        else:
            scene.add_mjcf("robot", path, **keywords)
    return inspect_scene(scene, path.name)


def _moments(inertia: Any) -> tuple[float, float, float]:
    low, mid, high = np.linalg.eigvalsh(np.asarray(inertia)).tolist()
    return low, mid, high


def _joints(a: Articulation) -> list[Joint]:
    """The coordinates of revolute and prismatic joints, whose q are angles and lengths."""
    model, out = a.model, []
    for joint in range(1, model.njoints):
        if model.nqs[joint] != 1:
            continue
        at, row = model.idx_qs[joint], model.idx_vs[joint]
        values = a.q[at], model.lowerPositionLimit[at], model.upperPositionLimit[at], a.effort[row]
        out.append(Joint(f"{a.name}/{model.names[joint]}", *map(float, (*values, a.friction[row], a.damping[row]))))
    return out


def _overlaps(scene: Scene) -> tuple[tuple[str, str, float], ...]:
    """Pairs of shapes that overlap where the scene starts, deepest first."""
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
