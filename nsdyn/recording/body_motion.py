"""Motion of the bodies of a recording: poses, velocities and energies of free bodies, links and driven bodies."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from nsdyn.recording import link_names
from nsdyn.recording.series import BodyMotion, rotate
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import unknown

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory


class Carried(NamedTuple):
    """Mass, kg, of all that a frame carries, its centre of mass, m, and inertia about it, kg m², in frame axes."""

    mass: float
    centre: Array
    inertia: Array


def moving(trajectory: Trajectory) -> list[str]:
    """Return the names of all moving bodies: free bodies, links (joints of models without links), driven bodies."""
    scene = trajectory.scene
    frames, free, joints = scene["frames"], scene["free"], set(link_names.joints(scene))
    links = [link["name"] for link in scene["links"] if link["frame"] >= 0]
    others = [name for name in frames[free:] if not links or name not in joints]
    return [*frames[:free], *links, *others]


def first_carried(scene: Mapping[str, Any]) -> dict[str, int]:
    """Return the index of the frame by the name of its body; of several links of one joint, by the first."""
    frames, out = scene["frames"], {link["frame"]: link["name"] for link in reversed(scene["links"])}
    return {out.get(k, name): k for k, name in enumerate(frames)}


def body(trajectory: Trajectory, name: str) -> BodyMotion:
    """Return the motion of a body, a link or a joint; see `nsdyn.Trajectory.body`."""
    scene, columns = trajectory.scene, trajectory.columns
    if not isinstance(name, str):
        raise ValueError(f"name must be that of a moving body, got {name!r}")
    frames, links = scene["frames"], {link["name"]: link for link in scene["links"]}
    if name in frames:
        return of_frame(trajectory, frames.index(name))
    if name in links:
        frame, placement = links[name]["frame"], np.array(links[name]["placement"])
        turn, one = Rotation.from_matrix(placement[:3, :3]), np.ones((trajectory.t.size, 1))
        if frame < 0:
            still = np.zeros((trajectory.t.size, 3))
            return BodyMotion(name, one * placement[:3, 3], one * turn.as_quat(), partial(tuple, (still, still)))
        carrier = columns["frames/quat"][:, frame]
        position = columns["frames/x"][:, frame] + rotate(carrier, placement[:3, 3])
        quaternion = (Rotation.from_quat(carrier) * turn).as_quat()
        return BodyMotion(name, position, quaternion, partial(_velocities, trajectory, frame, position, quaternion))
    raise ValueError(unknown(name, [*frames, *links], "moving body"))


def of_frame(trajectory: Trajectory, k: int) -> BodyMotion:
    """Return the motion of a moving frame by its number, without a search for its name."""
    scene, columns = trajectory.scene, trajectory.columns
    if k < scene["free"]:
        pose, twist = trajectory.q[:, 7 * k : 7 * k + 7], trajectory.v[:, 6 * k : 6 * k + 6]
        return BodyMotion(scene["frames"][k], pose[:, :3], pose[:, 3:], partial(_turned, pose[:, 3:], twist))
    position, quaternion = columns["frames/x"][:, k], columns["frames/quat"][:, k]
    velocities = partial(_velocities, trajectory, k, position, quaternion)
    return BodyMotion(scene["frames"][k], position, quaternion, velocities)


def _turned(quaternion: Array, twist: Array) -> tuple[Array, Array]:
    """Return linear and angular velocity in world axes from those in body axes."""
    return rotate(quaternion, twist[:, :3]), rotate(quaternion, twist[:, 3:])


def _velocities(trajectory: Trajectory, frame: int, position: Array, quaternion: Array) -> tuple[Array, Array]:
    """Return linear and angular velocity of a pose on a frame, from its joints' velocities or else as slope of it."""
    twist = trajectory.twists.get(frame)
    if twist is not None:
        return twist[:, :3] + np.cross(twist[:, 3:], position), twist[:, 3:]
    turn = Rotation.from_quat(quaternion)
    turned = np.cumsum((turn[1:] * turn[:-1].inv()).as_rotvec(), axis=0)
    ways = np.stack([position, np.concatenate([np.zeros((1, 3)), turned])])
    if trajectory.steps == 0:
        return np.full_like(ways[0], np.nan), np.full_like(ways[1], np.nan)
    slope = np.gradient(ways, trajectory.t, axis=1, edge_order=1 if trajectory.steps == 1 else 2)
    return slope[0], slope[1]


def carried(scene: Mapping[str, Any]) -> dict[int, Carried]:
    """Return the mass that each frame carries: a free body, or all links of a joint."""
    out = {
        k: Carried(mass, np.zeros(3), np.array(inertia))
        for k, (mass, inertia) in enumerate(zip(scene["masses"], scene["inertias"], strict=True))
    }
    told = [joint for a in scene["articulations"] for joint in a["model"]["joints"]]
    links = dict(zip(link_names.joints(scene), told, strict=True))
    for k, name in enumerate(scene["frames"]):
        if k >= scene["free"] and (joint := links.get(name)):
            out[k] = Carried(joint["mass"], np.array(joint["com"]), np.array(joint["inertia"]))
    return out


def energies(trajectory: Trajectory, rows: Index, turned: Mapping[int, Array]) -> dict[int, tuple[Array, Array]]:
    """Return speed of the centre of mass, m/s, and kinetic energy, J, of the mass on each frame, in some states.

    `turned` are the `twists` in these states. The energies of rotors (armature) belong to no link and are left out.
    """
    scene, out = trajectory.scene, {}
    for k, (mass, centre, inertia) in carried(scene).items():
        if k < scene["free"]:
            v, omega = np.split(trajectory.v[rows, 6 * k : 6 * k + 6], 2, axis=1)
        elif k in turned:
            quaternion = trajectory.columns["frames/quat"][rows, k]
            place = trajectory.columns["frames/x"][rows, k] + rotate(quaternion, centre)
            v = turned[k][:, :3] + np.cross(turned[k][:, 3:], place)
            omega = rotate(quaternion * (-1.0, -1.0, -1.0, 1.0), turned[k][:, 3:])
        else:
            continue
        square = (v**2).sum(axis=1)
        out[k] = np.sqrt(square), 0.5 * (mass * square + np.einsum("ni,ij,nj->n", omega, inertia, omega))
    return out


def twists(trajectory: Trajectory, rows: Index) -> dict[int, Array]:
    """Return velocity at the world's origin and angular velocity, (states, 6), of the frames of links.

    The twists follow from q and v. Empty where the articulations cannot be built.
    """
    if not trajectory.scene["articulations"]:
        return {}
    from nsdyn.recording.retrace import trees  # loads Pinocchio, not needed to read a recording

    found = trees(trajectory)
    if isinstance(found, str):
        return {}
    by_tree = [m.twists(*found.state(i, rows)) for i, m in enumerate(found.mechanisms)]
    return {frame: by_tree[tree][:, joint - 1] for frame, (tree, joint) in found.links.items()}
