"""Poses of all shapes of a recording, at its states and within its steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nsdyn.audit.true_shapes import Solid
from nsdyn.recording.series import rotate
from nsdyn.recording.tables import contact_columns
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools.arrays import Array, Bools, Index, cross

CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
"""Factors that turn a quaternion xyzw into that of the inverse rotation."""


def matrix(quaternion: Array) -> Array:
    """Rotation matrices of unit quaternions (..., 4) xyzw, shape (..., 3, 3)."""
    return np.swapaxes(rotate(quaternion[..., None, :], np.eye(3)), -1, -2)


def turned(quaternion: Array, angle: Array) -> Array:
    """Rotate quaternions (..., 4) by rotation vectors (..., 3) given in their own axes."""
    size = np.linalg.norm(angle, axis=-1, keepdims=True)
    return product(quaternion, np.concatenate([0.5 * np.sinc(0.5 * size / np.pi) * angle, np.cos(0.5 * size)], axis=-1))


def product(one: Array, other: Array) -> Array:
    """Product of quaternions (..., 4): the rotation by the second, then by the first."""
    v, s, w, r = one[..., :3], one[..., 3:], other[..., :3], other[..., 3:]
    return np.concatenate([s * w + r * v + cross(v, w), s * r - (v * w).sum(-1, keepdims=True)], axis=-1)


class Poses:
    """Shapes of a recording and their poses in every state."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory, self.scene = trajectory, trajectory.scene
        t, n = trajectory, trajectory.steps
        self.free: int = self.scene["free"]
        pose = t.q[:, : 7 * self.free].reshape(n + 1, -1, 7)
        self.x, self.quaternion = pose[..., :3], pose[..., 3:]
        if "frames/x" in t.columns:
            links = t.columns["frames/x"][:, self.free :], t.columns["frames/quat"][:, self.free :]
            self.x, self.quaternion = np.hstack([self.x, links[0]]), np.hstack([self.quaternion, links[1]])
        self.v = t.v[:, : 6 * self.free].reshape(n + 1, -1, 6)
        self.mass = np.array(self.scene["masses"], dtype=float)  # of free bodies, kg
        self.inertia = np.array(self.scene["inertias"], dtype=float).reshape(-1, 3, 3)  # in their axes, kg m²
        self.gravity = np.array(self.scene["gravity"], dtype=float)  # m/s²
        self.weight = float(np.linalg.norm(self.gravity))
        geoms = self.scene["geoms"]
        self.names = [geom["name"] for geom in geoms]
        self.frame = np.array([geom["frame"] for geom in geoms], dtype=np.int64)
        self.placement = np.array([geom["placement"] for geom in geoms], dtype=float).reshape(-1, 4, 4)
        kinds: dict[str, int] = {}
        self.solids: list[Solid] = []
        self.kind = np.empty(len(geoms), np.int64)
        for k, geom in enumerate(geoms):
            key = repr([geom[name] for name in ("shape", "size", "offset", "vertices") if name in geom])
            if key not in kinds:
                kinds[key] = len(kinds)
                self.solids.append(Solid.described(geom))
            self.kind[k] = kinds[key]
        lengths = [(solid.extent, solid.rounding, solid.bounding_radius) for solid in self.solids]
        self.extent: Array
        self.extent, self.rounding, radius = np.array(lengths).reshape(-1, 3)[self.kind].T
        # Largest distance of a point of each shape from the origin of its frame, m.
        self.bounding_radius = radius + np.linalg.norm(self.placement[:, :3, 3], axis=1)

    @cached_property
    def theta(self) -> float:
        """θ of the time-stepping scheme."""
        return float(self.trajectory.meta["theta"])

    def is_free(self, frame: Index) -> Bools:
        """Mask of the frames that belong to free bodies."""
        return (frame >= 0) & (frame < self.free)

    @cached_property
    def contacts(self) -> dict[str, Any]:
        """Columns of contacts by their names, without the prefix of the group."""
        return contact_columns(self.trajectory)

    @cached_property
    def step(self) -> Index:
        """Index of the step of every contact, from 0."""
        return np.repeat(np.arange(self.trajectory.steps), np.diff(self.contacts["offset"]))

    @cached_property
    def pair(self) -> Index:
        """Shapes of every contact, (2, contacts)."""
        return np.stack([self.contacts[f"geom{k}"] for k in "12"]).astype(np.int64)

    @cached_property
    def code(self) -> Index:
        """Number that identifies the pair of shapes of every contact."""
        return self.pair[0] * len(self.names) + self.pair[1]

    @cached_property
    def instant(self) -> Index:
        """Number of the instant and of the island of each contact; islands are moving bodies in contact then.

        The links of an articulation count as one body. With θ = 1 a move acts at the time of the impacts before it, but
        forms an instant of its own.
        """
        c, moving = self.contacts, self.frame[self.pair] >= 0
        when = np.stack([self.step, c["time"], c["duration"] == 0.0])
        _, at = np.unique(when, axis=1, return_inverse=True)
        body = np.unique([g["body"] for g in self.scene["geoms"]], return_inverse=True)[1]
        nodes, node = np.unique(at.ravel() * len(self.names) + body[self.pair], return_inverse=True)
        (first, second), both = node.reshape(2, -1), moving.all(axis=0)
        graph = coo_matrix((np.ones(both.sum()), (first[both], second[both])), (nodes.size, nodes.size))
        return connected_components(graph, directed=False)[1][np.where(moving[0], first, second)]

    def beside(self, which: Bools) -> Bools:
        """Contacts at the same instants and on the same islands as the given ones, including these."""
        return np.isin(self.instant, self.instant[which])

    @cached_property
    def normal(self) -> Array:
        """Unit normals of contacts, (contacts, 3)."""
        n = self.contacts["normal"]
        return n / np.linalg.norm(n, axis=1)[:, None]

    @cached_property
    def reach(self) -> Array:
        """Largest distance of a point of the shapes on each frame from its origin, (frames,), m."""
        own, out = self.frame >= 0, np.zeros(len(self.scene["frames"]))
        np.maximum.at(out, self.frame[own], self.bounding_radius[own])
        return out

    @cached_property
    def rounded(self) -> float:
        """Round-off of the farthest place of a body, m, of the step and of the audit; no length is known better."""
        return 32.0 * float(np.finfo(float).eps * np.abs(self.x).max(initial=0.0))

    @cached_property
    def smallest(self) -> Array:
        """Smallest extent of each free body, (free,), m."""
        own, out = np.flatnonzero(self.is_free(self.frame)), np.full(self.free, np.inf)
        np.minimum.at(out, self.frame[own], self.extent[own])
        return out

    @cached_property
    def uncertain(self) -> tuple[Array, Array]:
        """Displacement and rotation within a step that its ends do not show, (n, frames) each: m and rad.

        Impacts change the velocities of free bodies at an unknown time within the step. Driven bodies quicken: at half
        a step they are up to a quarter of the change of their way beside its middle. For links the result is 0: nothing
        is known.
        """
        t, theta = self.trajectory, self.theta
        out = np.zeros((2, t.steps, self.x.shape[1]))
        for k, part in enumerate((self.v[..., :3], self.v[..., 3:])):
            change = np.diff(rotate(self.quaternion[:, : self.free], part), axis=0)
            out[k, :, : self.free] = max(theta, 1.0 - theta) * t.dt * np.linalg.norm(change, axis=2)
        for frame in np.flatnonzero([name in self.scene["motions"] for name in self.scene["frames"]]):
            R = matrix(self.quaternion[:, frame])
            turn = (R[1:] @ R[:-1].swapaxes(1, 2)).reshape(-1, 9) / np.sqrt(2.0)  # changes of it are angles
            for k, way in enumerate((np.diff(self.x[:, frame], axis=0), turn)):
                change = 0.25 * np.linalg.norm(np.diff(way, axis=0), axis=1)
                out[k, :-1, frame] = change
                out[k, 1:, frame] = np.maximum(out[k, 1:, frame], change)
        return out[0], out[1]

    def of(self, geom: Index, row: Index) -> tuple[Array, Array]:
        """World poses (R, x) of shapes, one by one, in the given rows of the states."""
        return self.placed(geom, *self.frames(geom, row, self.x, self.quaternion))

    def during(self, geom: Index, step: Index, time: Array) -> tuple[Array, Array]:
        """Poses (m, 3), (m, 4) of the frames of shapes at times within steps, (m,), s; 0 if there is none.

        Free bodies move there with their initial velocities; other frames go evenly from one state to the next.
        """
        (x, begin), (ahead, end) = (self.frames(geom, step + k, self.x, self.quaternion) for k in (0, 1))
        share = (time / self.trajectory.dt)[:, None]
        x += share * (ahead - x)
        turn = begin + share * (np.where((begin * end).sum(-1, keepdims=True) < 0.0, -end, end) - begin)
        turn /= np.maximum(np.linalg.norm(turn, axis=-1, keepdims=True), 1e-300)
        free = np.flatnonzero(self.is_free(self.frame[geom]))
        row, body, time = step[free], self.frame[geom[free]], time[free, None]
        twist, before = self.v[row, body], begin[free]
        x[free] = self.x[row, body] + time * rotate(before, twist[:, :3])
        turn[free] = turned(before, time * twist[:, 3:])
        return x, turn

    def frames(self, geom: Index, row: Index, x: Array, quaternion: Array) -> tuple[Array, Array]:
        """Poses (m, 3), (m, 4) of the frames of shapes, from arrays (rows, frames, ...); 0 if there is none."""
        frame, at, turn = self.frame[geom], np.zeros((geom.size, 3)), np.zeros((geom.size, 4))
        moving = frame >= 0
        at[moving], turn[moving] = x[row[moving], frame[moving]], quaternion[row[moving], frame[moving]]
        return at, turn

    def placed(self, geom: Index, x: Array, quaternion: Array) -> tuple[Array, Array]:
        """World poses (R, x) of shapes, one by one, from frame positions x (m, 3) and quaternions (m, 4)."""
        R: Array = self.placement[geom, :3, :3].copy()
        t: Array = self.placement[geom, :3, 3].copy()
        moving = self.frame[geom] >= 0
        turn = quaternion[moving]
        R[moving], t[moving] = matrix(turn) @ R[moving], x[moving] + rotate(turn, t[moving])
        return R, t

    def by_kind(self, first: Index, second: Index) -> Iterator[tuple[Solid, Solid, Index]]:
        """Group pairs of shapes by their two solids: yield both solids and the indices of the pairs."""
        code = self.kind[first] * len(self.solids) + self.kind[second]
        order = np.argsort(code, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(code[order])) + 1):
            if rows.size:
                yield self.solids[self.kind[first[rows[0]]]], self.solids[self.kind[second[rows[0]]]], rows

    def named(self, first: Index, second: Index) -> Callable[[int], tuple[str, str]]:
        """Return the function that gives the names of both shapes of pair k."""
        return lambda k: (self.names[first[k]], self.names[second[k]])

    def size(self, first: Index, second: Index) -> Array:
        """Extent of the smaller shape of each pair, m."""
        return np.minimum(self.extent[first], self.extent[second])
