"""Coordinates, frames and masses of a scene: the layout that its motion and forces share.

Free bodies are batched in arrays; each articulated tree has its own Pinocchio model. The velocity is one vector v (n,)
in blocks: 6 per free body (linear in world axes, angular in body axes), then nv per tree. Kinematic bodies have a
frame, but no block.
"""

from __future__ import annotations

from copy import copy
from typing import Self

import numpy as np

from nsdyn._kernels.dynamics.rotation import principal
from nsdyn.dynamics.actuators import Actuators
from nsdyn.dynamics.forests import parts
from nsdyn.dynamics.joints import JointLaws
from nsdyn.dynamics.surfaces import Surfaces
from nsdyn.dynamics.trees import Tree
from nsdyn.dynamics.values import Position
from nsdyn.scene.checks import rotation
from nsdyn.scene.control import Axes
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import Array, Index

NO_VECTORS = np.empty((0, 3))


class Layout:
    """The moving objects of a scene, in the order of their coordinates and frames.

    Attributes
    ----------
    held : ndarray of bool, shape (frames,)
        Frames that only prescribed motion moves.
    prescribed : bool
        True if the scene has such frames, or joint coordinates that only prescribed motion moves.
    node : ndarray of int, shape (frames + 1,)
        Block of coordinates that moves each frame; -1 for frames without one, as for the world, which is the last
        entry.
    linkages : two ndarrays of int
        Table and support of the trees, as `nsdyn._kernels.dynamics.links.rows` takes them.
    radii : ndarray, shape (frames,)
        Radii of spheres about the origins of the frames, which contain their shapes, m.
    """

    def __init__(self, scene: Scene) -> None:
        bodies, driven = scene.free_bodies, scene.driven_bodies
        self.gravity: Array = np.array(scene.gravity)
        self.weight = float(np.linalg.norm(self.gravity))
        self.surfaces, self._driven = Surfaces(scene), len(driven)
        self._driven_radii = np.array([b.shape.bounding_radius for b in driven])
        self.names = {b.name: k for k, b in enumerate(bodies)}
        self._forests: dict[str, tuple[int, Actuators]] = {}
        trees = self._planted(scene)
        mass, J = np.array([b.mass for b in bodies]), np.array([b.inertia for b in bodies]).reshape(-1, 3, 3)
        radius = np.array([b.shape.bounding_radius + float(np.linalg.norm(b.com)) for b in bodies])
        m, minv = np.zeros((2, mass.size, 6, 6))
        of_mass, eye = mass[:, None, None], np.eye(3)
        inverse = np.linalg.inv(J)
        m[:, :3, :3], m[:, 3:, 3:] = of_mass * eye, J
        minv[:, :3, :3], minv[:, 3:, 3:] = eye / of_mass, 0.5 * (inverse + inverse.swapaxes(1, 2))
        self._compose((mass, J, radius, *principal(J), m, minv), trees)
        self._bodies = {f"{t.name}/{body}": k for k, t in enumerate(self.trees) for body in t.bodies}
        moves = [(b.linear_velocity, rotation(b.quaternion).T @ b.angular_velocity) for b in bodies]
        starts = [t.start(t.articulation.q, t.articulation.v) for t in self.trees]
        self._start = (
            Position(
                np.array([b.position for b in bodies]).reshape(-1, 3),
                np.array([b.quaternion for b in bodies]).reshape(-1, 4),
                tuple(q for q, _ in starts),
                np.array([b.position for b in driven]).reshape(-1, 3),
                np.array([b.quaternion for b in driven]).reshape(-1, 4),
            ),
            np.concatenate([np.ravel(moves), *(v for _, v in starts)]),
        )

    def _planted(self, scene: Scene) -> list[Tree]:
        """Trees of all articulations; store the first tree and the actuators of each articulation in `_forests`."""
        trees: list[Tree] = []
        for name, a in scene.articulations.items():
            carriers = [joint for owner, joint in scene.link_frames() if owner == name]
            driven = {
                a.model.getJointId(joint): m
                for key, m in scene.motions.items()
                for owner, _, joint in [key.partition("/")]
                if owner == name and m.kind == "joint"
            }
            planted, coordinates = len(trees), list[slice]()
            for part, within in parts(a):
                first = a.model.idx_vs[within.start] if within else 0
                joints = [joint - within.start + 1 for joint in carriers if joint in within]
                motions = {a.model.idx_vs[j] - first: m for j, m in driven.items() if j in within}
                trees.append(Tree(part, self.gravity, joints, motions))
                coordinates.append(slice(first, first + part.model.nv))
            scalar = np.concatenate([t.scalar for t in trees[planted:]])
            axes = Axes.of(name, a.model, scalar)
            self._forests[name] = planted, Actuators(axes, a.effort, coordinates, a.actuators)
        return trees

    def only(self, bodies: Index, trees: Index, geoms: Index) -> Self:
        """Return the layout of some free bodies and trees, and of the objects that only prescribed motion moves.

        The shapes of all of them are `geoms`, ascending, and are renumbered.
        """
        out = copy(self)
        out.surfaces = self.surfaces.only(geoms)
        out._compose(tuple([a[bodies] for a in self._own]), [self.trees[k] for k in trees.tolist()])
        return out

    def during(self, t: float, h: float, begin: Position) -> Self:
        """Return the layout for a step of h s that begins at time t and at a position, see `Surfaces.during`."""
        if not self.surfaces.count:
            return self
        out = copy(self)
        out.surfaces = self.surfaces.during(t, h, begin.driven_x, begin.driven_quaternion)
        return out

    def _compose(self, own: tuple[Array, ...], trees: list[Tree]) -> None:
        """Set up the layout of coordinates and frames, and all arrays that follow from it and from the free bodies.

        `own` has the masses, inertias, radii, principal moments and axes, M and its inverse of the free bodies.
        """
        self._own, (self.mass, self.J, radius, *self._principal, m, minv) = own, own
        mass, self.free, self.trees = self.mass, self.mass.size, []
        start, first = 6 * self.free, self.free
        for t in trees:
            self.trees.append(t.at(start, start - 6 * self.free, first))
            start, first = start + t.model.nv, first + len(t.joints)
        self.frames = first + self._driven
        self.nowhere = np.zeros(self.frames)
        self._inverse_mass, self.no_load = 1.0 / mass, np.zeros((2, self.free, 3))
        # The scene has one robot and, besides it, only sliding surfaces. The arrays of the robot are then those of the
        # scene. This saves a fifth of a step.
        self._lone = len(trees) == 1 and not self.free and not self._driven
        table = [(t.frames.start, len(t.joints), t.coordinates.start, t.model.nv) for t in self.trees]
        supports = [t.support.astype(np.int64).ravel() for t in self.trees]
        self.linkages = np.array(table, np.int64).ravel(), np.concatenate([np.empty(0, np.int64), *supports])
        self.radii = np.concatenate([radius, *(t.radius for t in self.trees), self._driven_radii])
        self.constrained = any(t.constrained for t in trees)
        sizes = [6] * self.free + [t.model.nv for t in trees]
        self.offset = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self.m_start = np.concatenate(([0], np.cumsum(np.square(sizes)))).astype(np.int64)[:-1]
        owner = [self.free + k for k, t in enumerate(trees) for _ in t.joints]
        self.node = np.array([*range(self.free), *owner, *([-1] * self._driven), -1], dtype=np.int64)
        self.n = int(self.offset[-1])
        self._m, self._minv = m.ravel(), minv.ravel()
        self.masses = self.node, self.offset, self.m_start, self._m, self._minv
        self.inverse_J = np.ascontiguousarray(minv[:, 3:, 3:])
        self.bodies = *self._principal, self._inverse_mass, self.inverse_J
        self.no_impulses = NO_VECTORS, np.zeros((8, self.n - 6 * self.free))
        self.links, self.no_push = sum(t.model.njoints - 1 for t in self.trees), np.zeros((0, 6))
        self.joints = JointLaws(self.trees, self.free)
        self._slots = [self.joints.actuators(t.coordinates) for t in self.trees]
        self.held = np.concatenate(
            [np.zeros(self.free, np.bool_), *(t.held_links for t in self.trees), np.ones(self._driven, np.bool_)]
        )
        self.prescribed = bool(self.held.any()) or any(bool(t.held.any()) for t in self.trees)

    def node_of(self, frame1: Index, frame2: Index) -> Index:
        """Block of coordinates that moves each contact of two frames, the first of two blocks; -1 for none."""
        first = self.node[frame1]
        return np.where(first >= 0, first, self.node[frame2])

    def start(self) -> tuple[Position, Array]:
        """Initial position and velocity of the scene."""
        return self._start
