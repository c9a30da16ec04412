"""Mass matrices, free motion and contact Jacobians of a scene.

Free bodies are batched in arrays; each articulated tree has its own Pinocchio model. The velocity is one vector v
(n,) in blocks: 6 per free body (linear in world axes, angular in body axes), then nv per tree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from nsdyn._kernels import motion as _motion
from nsdyn.contacts import ContactSet
from nsdyn.problem import Blocks
from nsdyn.scene import Articulation, Scene

Array = NDArray[np.float64]

__all__ = ["Dynamics", "Loads", "Position"]


@dataclass(frozen=True, eq=False)
class Position:
    """Where everything is.

    Attributes
    ----------
    x : ndarray, shape (nf, 3)
        Centres of mass of the free bodies, m, world frame.
    quaternion : ndarray, shape (nf, 4)
        Their orientations, xyzw, body to world.
    trees : tuple of ndarray
        Pinocchio configuration of every articulated tree.
    """

    x: Array
    quaternion: Array
    trees: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class Loads:
    """What acts during a step besides contacts.

    Attributes
    ----------
    force, torque : ndarray, shape (nf, 3)
        On free bodies; force in world axes [N], torque about the centre of mass in the body axes of the beginning of
        the step [N m].
    gyroscopic : ndarray, shape (nf, 3)
        Mean gyroscopic torque of the step, J (ω_f - ω)/h - torque, body axes, N m.
    tau : tuple of ndarray
        Actuation of every tree, (nv,).
    bias : tuple of ndarray
        Coriolis, centrifugal and gravity terms of every tree at the midpoint, (nv,).
    weight : tuple of ndarray
        The gravity terms among them, (nv,).
    """

    force: Array
    torque: Array
    gyroscopic: Array
    tau: tuple[Array, ...]
    bias: tuple[Array, ...]
    weight: tuple[Array, ...]


class _Tree:
    """One articulated tree with its Pinocchio scratch data."""

    def __init__(self, articulation: Articulation, gravity: Array, start: int, joints: list[int], first: int) -> None:
        self.name = articulation.name
        self.model = articulation.model
        self.model.gravity = pin.Motion(gravity, np.zeros(3))
        self.data = self.model.createData()
        self.coordinates = slice(start, start + self.model.nv)
        self.joints = joints
        self.frames = slice(first, first + len(joints))

    def update(self, q: Array, x: Array, R: Array) -> tuple[Array, Array]:
        """(M, Jacobians of the link frames) at q; writes the poses of the links into x and R."""
        M = np.array(pin.crba(self.model, self.data, q))
        pin.computeJointJacobians(self.model, self.data, q)
        jacobians = np.empty((len(self.joints), 6, self.model.nv))
        for k, joint in enumerate(self.joints):
            jacobian = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)
            jacobians[k] = jacobian.reshape(6, -1)  # one joint alone comes as a vector
            x[self.frames.start + k] = self.data.oMi[joint].translation
            R[self.frames.start + k] = self.data.oMi[joint].rotation
        return M, jacobians

    def bias(self, q: Array, v: Array) -> Array:
        """Coriolis, centrifugal and gravity terms."""
        return np.array(pin.nonLinearEffects(self.model, self.data, q, v))

    def weight(self, q: Array) -> Array:
        """Gravity terms."""
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, q))

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """(kinetic, potential) energy in J."""
        kinetic = pin.computeKineticEnergy(self.model, self.data, q, v)
        return float(kinetic), float(pin.computePotentialEnergy(self.model, self.data, q))


def _rotation(quaternion: Array) -> Array:
    """Rotation matrix of a unit quaternion xyzw."""
    return np.array(pin.Quaternion(quaternion).toRotationMatrix())


class Dynamics:
    """Equations of motion of a scene between contacts.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        bodies, frames = scene.free_bodies, scene.link_frames()
        self.gravity: Array = np.array(scene.gravity)
        self.free = len(bodies)
        self.frames = self.free + len(frames)
        self.mass = np.array([b.mass for b in bodies])
        self.J = np.array([b.inertia for b in bodies]).reshape(-1, 3, 3)
        self.radius = np.array([b.shape.bounding_radius for b in bodies])
        self.inscribed = np.array([b.shape.inscribed_radius for b in bodies])
        self.names = {b.name: k for k, b in enumerate(bodies)}
        self.trees: list[_Tree] = []
        start, first = 6 * self.free, self.free
        for name, a in scene.articulations.items():
            joints = [joint for owner, joint in frames if owner == name]
            self.trees.append(_Tree(a, self.gravity, start, joints, first))
            start, first = start + a.model.nv, first + len(joints)
        sizes = [6] * self.free + [t.model.nv for t in self.trees]
        self.offset = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self.m_start = np.concatenate(([0], np.cumsum(np.square(sizes)))).astype(np.int64)[:-1]
        owner = [self.free + k for k, t in enumerate(self.trees) for _ in t.joints]
        self.block_of_frame = np.array([*range(self.free), *owner], dtype=np.int64)
        self.n = int(self.offset[-1])
        m, minv = np.zeros((self.free, 6, 6)), np.zeros((self.free, 6, 6))
        for k in range(self.free):
            m[k, :3, :3], m[k, 3:, 3:] = self.mass[k] * np.eye(3), self.J[k]
            inverse = np.linalg.inv(self.J[k])
            minv[k, :3, :3], minv[k, 3:, 3:] = np.eye(3) / self.mass[k], 0.5 * (inverse + inverse.T)
        tail = np.zeros(sum(s * s for s in sizes[self.free :]))
        self.m, self.minv = np.append(m.ravel(), tail), np.append(minv.ravel(), tail)
        self.x, self.R = np.zeros((self.frames, 3)), np.zeros((self.frames, 3, 3))
        self.jacobians: list[Array] = []
        self._start = (
            Position(
                np.array([b.position for b in bodies]).reshape(-1, 3),
                np.array([b.quaternion for b in bodies]).reshape(-1, 4),
                tuple(a.q.copy() for a in scene.articulations.values()),
            ),
            np.concatenate(
                [self._velocity(b) for b in bodies] + [a.v for a in scene.articulations.values()] + [np.empty(0)]
            ),
        )

    @staticmethod
    def _velocity(body: Any) -> Array:
        return np.concatenate((body.linear_velocity, _rotation(body.quaternion).T @ body.angular_velocity))

    def start(self) -> tuple[Position, Array]:
        """Initial position and velocity of the scene."""
        return self._start

    def advance(self, position: Position, v: Array, h: float) -> Position:
        """Q ⊕ h v: x + h v, R exp([h ω]x) for free bodies, Pinocchio's integrate for trees."""
        x, quaternion = np.empty_like(position.x), np.empty_like(position.quaternion)
        _motion.integrate(position.x, position.quaternion, v, h, x, quaternion)
        trees = tuple(
            np.array(pin.integrate(t.model, q, h * v[t.coordinates]))
            for t, q in zip(self.trees, position.trees, strict=True)
        )
        return Position(x, quaternion, trees)

    def evaluate(self, position: Position) -> None:
        """Put poses of all frames, mass matrices and Jacobians at `position` into x, R, m, minv, jacobians."""
        self.x[: self.free] = position.x
        _motion.rotations(position.quaternion, self.R)
        self.jacobians = []
        for k, (t, q) in enumerate(zip(self.trees, position.trees, strict=True)):
            M, jacobians = t.update(q, self.x, self.R)
            self.jacobians.append(jacobians)
            inverse = np.linalg.inv(M)
            at = slice(self.m_start[self.free + k], self.m_start[self.free + k] + M.size)
            self.m[at], self.minv[at] = (0.5 * (M + M.T)).ravel(), (0.5 * (inverse + inverse.T)).ravel()

    def free_velocity(
        self,
        begin: Position,
        middle: Position,
        v: Array,
        h: float,
        push: Array,
        wrenches: Mapping[str, Any] | None,
        tau: Mapping[str, Any] | None,
    ) -> tuple[Array, Loads]:
        """Velocity after a step without contact, M̃ (v_f - v) = h f̃, and the loads that made it.

        Parameters
        ----------
        begin, middle : Position
            Beginning of the step, and its midpoint, where `evaluate` has been called.
        v : ndarray, shape (n,)
            Velocity at the beginning of the step.
        h : float
            Step, s.
        push : ndarray, shape (n,)
            Change of velocity expected of the contacts: gyroscopic and Coriolis terms belong to the motion with it.
        wrenches : mapping, optional
            Free body name to its force (3,) at the centre of mass [N], or to (force, torque [N m]); world axes.
        tau : mapping, optional
            Articulation name to its joint forces (nv,).
        """
        force, torque = np.zeros((self.free, 3)), np.zeros((self.free, 3))
        for name, wrench in (wrenches or {}).items():
            if name not in self.names:
                raise ValueError(f"external_force names {name!r}, which is no free body; they are {list(self.names)}")
            parts = np.array(wrench, dtype=float)
            if parts.shape not in ((3,), (2, 3)) or not np.isfinite(parts).all():
                raise ValueError(f"external_force on {name!r} must be finite with shape (3,) or (2, 3), got {wrench!r}")
            k = self.names[name]
            force[k] = parts if parts.ndim == 1 else parts[0]
            if parts.ndim == 2:
                torque[k] = _rotation(begin.quaternion[k]).T @ parts[1]
        out, gyroscopic = np.empty(self.n), np.empty((self.free, 3))
        _motion.free_velocity(self.J, 1.0 / self.mass, self.gravity, force, torque, h, v, push, out, gyroscopic)
        actuation = self._actuation(tau)
        biases, weights = [], []
        for k, (t, q) in enumerate(zip(self.trees, middle.trees, strict=True)):
            at, size = self.m_start[self.free + k], t.model.nv
            inverse = self.minv[at : at + size * size].reshape(size, size)
            before = v[t.coordinates]
            after, bias = before, t.bias(q, before)
            for _ in range(20):  # the midpoint rule by fixed point; it contracts by O(h ω) a pass
                new = before + h * (inverse @ (actuation[k] - bias))
                bias = t.bias(q, 0.5 * (before + new + push[t.coordinates]))
                done = np.abs(new - after).max(initial=0.0) <= 1e-15 * np.abs(new).max(initial=0.0)
                after = new
                if done:
                    break
            out[t.coordinates] = before + h * (inverse @ (actuation[k] - bias))
            biases.append(bias)
            weights.append(t.weight(q))
        return out, Loads(force, torque, gyroscopic, actuation, tuple(biases), tuple(weights))

    def _actuation(self, tau: Mapping[str, Any] | None) -> tuple[Array, ...]:
        given = dict(tau or {})
        out = []
        for t in self.trees:
            value = np.array(given.pop(t.name, np.zeros(t.model.nv)), dtype=float)
            if value.shape != (t.model.nv,) or not np.isfinite(value).all():
                raise ValueError(f"controller must give {t.model.nv} finite joint forces for {t.name!r}, got {value}")
            out.append(value)
        if given:
            raise ValueError(
                f"controller names {next(iter(given))!r}; articulations are {[t.name for t in self.trees]}"
            )
        return tuple(out)

    def blocks(self, contacts: ContactSet) -> tuple[Blocks, Array]:
        """Factors (M, H) of the contacts at the evaluated position, and their frames (nc, 3, 3), rows (n, t1, t2)."""
        nc = contacts.gap.size
        frame = np.empty((nc, 3, 3))
        block, start = np.empty((nc, 2), np.int64), np.empty((nc, 2), np.int64)
        _motion.contact_frames(contacts.normal, frame)
        size = _motion.contact_layout(contacts.frame1, contacts.frame2, self.block_of_frame, self.offset, block, start)
        h = np.zeros(size)
        where = contacts.frame1, contacts.frame2, contacts.point, frame, self.x
        _motion.free_rows(*where, self.R, self.free, start, h)
        for t, jacobians in zip(self.trees, self.jacobians, strict=True):
            _motion.link_rows(*where, t.frames.start, jacobians, start, h, t.model.nv)
        return Blocks(self.offset, block, start, h, self.m_start, self.m, self.minv), frame

    def reach(self, v: Array, h: float) -> Array:
        """How far any point of each frame's shapes may move in a step of h, m, shape (frames,)."""
        out = np.empty(self.frames)
        _motion.reach(v, self.gravity, h, self.radius, out)
        fall = h * h * float(np.linalg.norm(self.gravity))
        for t, jacobians in zip(self.trees, self.jacobians, strict=True):
            twist = np.abs(jacobians @ v[t.coordinates])
            out[t.frames] = h * (twist[:, :3].sum(axis=1) + twist[:, 3:].sum(axis=1)) + fall
        return out

    def energies(self, position: Position, v: Array) -> tuple[float, float]:
        """(kinetic, potential) energy, J; potential energy is 0 at the world's origin."""
        kinetic, potential = _motion.free_energies(self.mass, self.J, self.gravity, position.x, v)
        for t, q in zip(self.trees, position.trees, strict=True):
            more = t.energies(q, v[t.coordinates])
            kinetic, potential = kinetic + more[0], potential + more[1]
        return kinetic, potential

    def pinocchio_state(self, position: Position, v: Array) -> tuple[Array, Array]:
        """(q, v) in Pinocchio's layout: per free body (x, quaternion) and velocity in body axes, then the trees."""
        q = np.concatenate((np.empty(7 * self.free), *position.trees))
        out, R = v.copy(), np.empty((self.free, 3, 3))
        _motion.rotations(position.quaternion, R)
        _motion.pinocchio_layout(position.quaternion, R, position.x, v, q, out)
        return q, out

    def link_poses(self, position: Position) -> tuple[Array, Array]:
        """Positions (frames, 3) and quaternions (frames, 4) of all frames, links included."""
        x, quaternion = np.empty((self.frames, 3)), np.empty((self.frames, 4))
        x[: self.free], quaternion[: self.free] = position.x, position.quaternion
        for t, q in zip(self.trees, position.trees, strict=True):
            pin.forwardKinematics(t.model, t.data, q)
            for k, joint in enumerate(t.joints, start=t.frames.start):
                pose = pin.SE3ToXYZQUAT(t.data.oMi[joint])
                x[k], quaternion[k] = pose[:3], pose[3:]
        return x, quaternion
