"""One articulated tree as a linkage: poses of its links, their Jacobian, and the constraints on them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Self

import numpy as np
import pinocchio as pin

from nsdyn.collision.distances import pose_views
from nsdyn.dynamics.loops import Closures, admissible, factored, supports
from nsdyn.dynamics.values import Constraints, Links
from nsdyn.scene.articulations import BALL, PLANAR, Articulation
from nsdyn.scene.gears import Gear, GearGaps, joint_at
from nsdyn.scene.prescribed import Motion
from nsdyn.tools.arrays import Array, Bools, Index

HELD = 1e-12
"""Velocity that counts as zero, for a motion with a kinetic energy of ½ J: it is round-off, or the velocity of a ball
of 1e24 kg."""


class Linkage:
    """One articulated tree with Pinocchio's scratch data.

    Parameters
    ----------
    articulation : Articulation
    gravity : ndarray, shape (3,)
    joints : list of int
        Joints that carry geometry, one frame each.
    driven : mapping of int to Motion
        Coordinates whose velocity is prescribed.

    Attributes
    ----------
    coordinates, frames : slice
        Its coordinates and frames within those of the scene, as set by `at`.
    columns : slice
        Its coordinates within those of all trees.
    held : ndarray of bool, shape (nv,)
        Coordinates that only prescribed motion moves: driven ones, and those without freedom because of loops and gears
        with driven ones.
    driven_at : ndarray of int
        The driven coordinates.
    bodies : dict of str to int
        Frames of the model's moving bodies and joints, by name.
    planes, balls : frozenset of int
        First coordinates of planar joints, of sliding, and of ball joints; both slip together with the next coordinate.
    held_links : ndarray of bool, shape (k,)
        The links of `joints` that only prescribed motion moves.
    """

    def __init__(
        self, articulation: Articulation, gravity: Array, joints: list[int], driven: dict[int, Motion]
    ) -> None:
        a = self.articulation = articulation
        self.name = a.name
        self.model = a.model.copy()
        self.model.name = a.name
        self.model.gravity = pin.Motion(gravity, np.zeros(3))
        self.model.armature = a.armature
        self.data = self.model.createData()
        nv = self.model.nv
        self.coordinates = self.columns = slice(0, nv)
        self.joints, self.frames = joints, slice(0, len(joints))
        self.support = supports(self.model)[joints]
        self.radius = _radii(a, joints)
        self._carriers = np.array(joints, dtype=np.int64)
        # Views of Pinocchio's own memory: each evaluation changes them. An array with nv = 1 comes without its last
        # axis.
        self._J: Array = self.data.J.reshape(6, nv, order="A")
        self._R, self._x = pose_views(self.data.oMi, self.model.njoints)
        self._linear, self._linear_q, self._turning = self._scalar_coordinates()
        self._round = np.zeros(nv, dtype=bool)
        self._round[[j for j, _ in self._turning]] = True
        self.scalar = self._round.copy()
        self.scalar[self._linear] = True
        self.driven = tuple(driven.values())
        self.driven_at = np.array(list(driven), dtype=np.int64)
        self._driven_rows = np.eye(nv)[self.driven_at]
        looped = a.loops or a.gears
        self.closures = Closures(self.model, a.loops, a.gears, self._driven_rows) if looped else None
        self.constrained = bool(driven) or self.closures is not None
        kinds = pin.FrameType.JOINT, pin.FrameType.BODY  # a body overrides a joint of the same name
        self.bodies = {
            f.name: k for kind in kinds for k, f in enumerate(self.model.frames) if f.type == kind and f.parentJoint > 0
        }
        self.planes, self.balls = (
            frozenset(j.idx_v for j in self.model.joints[1:] if j.shortname() == kind) for kind in (PLANAR, BALL)
        )
        self.held, self.held_links = self._held(a.q, a.gears)

    def at(self, start: int, column: int, first: int) -> Self:
        """Return the tree at its place in a scene: first coordinate, first among those of trees, first frame."""
        out = copy(self)
        out.coordinates, out.columns = (slice(k, k + self.model.nv) for k in (start, column))
        out.frames = slice(first, first + len(self.joints))
        return out

    def _scalar_coordinates(self) -> tuple[Index | slice, Index | slice, list[tuple[int, int]]]:
        """Coordinates whose rate is the velocity, their places in q, and (v, q) places of joints given by cos, sin."""
        v: list[int] = []
        q: list[int] = []
        turning = []
        for joint in self.model.joints[1:]:
            if joint.nq == joint.nv:
                v += range(joint.idx_v, joint.idx_v + joint.nv)
                q += range(joint.idx_q, joint.idx_q + joint.nq)
            elif joint.nv == 1:
                turning.append((joint.idx_v, joint.idx_q))
        return _run(v), _run(q), turning

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of the joint coordinates, (nv,) each, infinite for coordinates without limits."""
        return self.articulation.bounds()

    def joint_of(self, coordinate: int) -> str:
        """Name of the joint that a coordinate belongs to."""
        return str(self.model.names[joint_at(self.model, coordinate)])

    def angle(self, q: Array) -> Array:
        """Joint coordinates in rad or m, shape (nv,); 0 for joints without a scalar coordinate (free, spherical)."""
        out = np.zeros(self.model.nv)
        out[self._linear] = q[self._linear_q]
        for j, k in self._turning:
            out[j] = np.arctan2(q[k + 1], q[k])
        return out

    def _held(self, q: Array, gears: Sequence[Gear]) -> tuple[Bools, Bools]:
        """Find the coordinates (nv,) and the links (k,) that at q only prescribed motion moves, or that cannot move."""
        nv = self.model.nv
        if not (self.driven or gears):
            return np.zeros(nv, np.bool_), np.zeros(len(self.joints), np.bool_)
        q = self.close(q)
        F = factored(self.model, self.data, q)[1]
        # Without driven joints loops leave a freedom that a singular configuration at q may hide. Gears are the same at
        # any q.
        Z = self._restrict(q, F).Z if self.driven else admissible(GearGaps(self.model, gears).rows, F)[0]
        J = self.links(q).J
        fields = np.einsum("ij,kj,jy->kiy", J, self.support, Z)
        # The columns of Z have unit kinetic energy. No body is so heavy that its velocity would then be as small as
        # `HELD`.
        return np.array((np.abs(Z) <= HELD).all(axis=1)), np.array((np.abs(fields) <= HELD).all(axis=(1, 2)))

    def start(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Initial configuration and velocity, with closed loops and with driven joints at their prescribed speed.

        In a tree with loops or gears the velocity is the closest admissible one in the kinetic metric.
        """
        v, q = v.copy(), self.close(q)
        v[self.driven_at] = rates = [motion.rate(0.0) for motion in self.driven]
        if self.closures is not None:
            M, F, _ = factored(self.model, self.data, q)
            B, P, Z = self._restrict(q, F)
            v = Z @ (Z.T @ (M @ v)) + P @ np.concatenate((np.zeros(len(B) - len(rates)), rates))
        return q, v

    def speeding(self, v: Array, rates: Array) -> Array:
        """Changes of v that bring the driven joints to their rates, shape (nv,), rad/s or m/s; 0 for all others."""
        out = np.zeros(v.size)
        out[self.driven_at] = rates - v[self.driven_at]
        return out

    def links(self, q: Array) -> Links:
        """Compute the poses and the Jacobian of the links at q."""
        pin.computeJointJacobians(self.model, self.data, q)
        return self._links(q)

    def _links(self, q: Array) -> Links:
        """Copy the poses and the Jacobian that Pinocchio computed last, at q."""
        x, R = self._x.take(self._carriers, axis=0), self._R.take(self._carriers, axis=0)
        return Links(x, R, self._J.copy(order="F"), self.angle(q))

    def close(self, q: Array) -> Array:
        """Return the closest configuration with closed loops; q itself if its loops are closed."""
        return q if self.closures is None else self.closures.close(q)

    def pushed(self, q: Array, body: str, force: Array, torque: Array) -> tuple[Array, Array]:
        """Joint forces of a force [N] at the origin of a body's frame and a torque [N m], at q; world axes.

        Returns Jᵀ (force, torque), shape (nv,), and the same wrench as in `TreeLoads.wrenches`, shape (njoints - 1, 6).
        """
        frame, wrenches = self.bodies[body], np.zeros((self.model.njoints - 1, 6))
        J = pin.computeFrameJacobian(self.model, self.data, q, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1, order="A")
        pin.framesForwardKinematics(self.model, self.data, q)
        moment = torque + np.cross(self.data.oMf[frame].translation, force)
        wrenches[self.model.frames[frame].parentJoint - 1] = *force, *moment
        return J.T @ np.concatenate((force, torque)), wrenches

    def _restrict(self, q: Array, F: Array) -> Constraints:
        """Constraints at q, where M⁻¹ = Fᵀ F."""
        loops, threes = np.empty((0, self.model.nv)), 0
        if self.closures is not None:
            loops, threes = self.closures.at(q)[1], self.closures.of_loops
        B = np.concatenate((loops, self._driven_rows))
        Z, P = admissible(B, F, threes)
        return Constraints(B, P, Z)


def _run(indices: list[int]) -> Index | slice:
    """Indices as a slice if they are consecutive, since a slice is read several times as fast."""
    out = np.array(indices, dtype=np.int64)
    return slice(indices[0], indices[0] + len(indices)) if indices and (np.diff(out) == 1).all() else out


def _radii(articulation: Articulation, joints: list[int]) -> Array:
    """Radius about the frame of each joint that contains the shapes it carries, (len(joints),), m."""
    out = np.zeros(len(joints))
    for link in articulation.links:
        if link.joint in joints:
            k = joints.index(link.joint)
            out[k] = max(out[k], float(np.linalg.norm(link.placement.translation)) + link.shape.bounding_radius)
    return out
