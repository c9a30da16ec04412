"""One articulated tree: Pinocchio's terms, the forces of its joints, and its motion without contacts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from nsdyn._kernels import trees as _trees
from nsdyn.articulations import Articulation
from nsdyn.contacts import pose_views
from nsdyn.control import PD
from nsdyn.loops import Closures, admissible, supports
from nsdyn.motions import Motion

Array = NDArray[np.float64]
Index = NDArray[np.int64]

__all__ = ["Tree", "TreeLoads"]

PASSES = 20
"""Most passes of the fixed point for the free motion; it contracts by O(h ω) a pass."""

SETTLED = 1e-12
"""Relative change of the velocity by the next pass, extrapolated from the last two, at which it stops."""


def _span(places: list[int]) -> Index | slice:
    """Ascending places as an index: a slice, which is quicker, where they follow each other."""
    if places and places[-1] - places[0] == len(places) - 1:
        return slice(places[0], places[-1] + 1)
    return np.array(places, dtype=np.int64)


class TreeLoads(NamedTuple):
    """What acts on a tree during a step besides contacts, joint limits and joint friction.

    Attributes
    ----------
    tau : ndarray, shape (nv,)
        Joint forces given or of external wrenches, and the part of a PD control that the motion does not change.
    kp, kd : ndarray, shape (nv,)
        Gains of the PD control, 0 where there is none.
    stretch : ndarray, shape (nv,)
        Of the joint springs at the beginning, q - rest, rad or m.
    bias : ndarray, shape (nv,)
        Coriolis, centrifugal and gravity terms of the step.
    weight : ndarray, shape (nv,)
        Gravity terms at the midpoint for θ ≠ ½; not needed else.
    energies : tuple
        Kinetic energy, and potential energy of gravity, at the beginning, J.
    """

    tau: Array
    kp: Array
    kd: Array
    stretch: Array
    bias: Array
    weight: Array
    energies: tuple[float, float]


class Tree:
    """One articulated tree with Pinocchio's scratch data.

    Parameters
    ----------
    articulation : Articulation
    gravity : ndarray, shape (3,)
    start : int
        Its first coordinate in the scene's velocity.
    joints : list of int
        Joints that carry geometry, one frame each.
    first : int
        Index of the first of these frames.
    driven : mapping of int to Motion
        Coordinates whose velocity is prescribed.
    """

    def __init__(
        self,
        articulation: Articulation,
        gravity: Array,
        start: int,
        joints: list[int],
        first: int,
        driven: dict[int, Motion],
    ) -> None:
        a = articulation
        self.name = a.name
        self.model = a.model.copy()
        self.model.gravity = pin.Motion(gravity, np.zeros(3))
        self.model.armature = a.armature
        self.data = self.model.createData()
        nv = self.model.nv
        self.coordinates = slice(start, start + nv)
        self.joints, self.frames = joints, slice(first, first + len(joints))
        self.support = supports(self.model)[joints]
        self.radius = np.zeros(len(joints))
        for _, joint, placement, shape in a.links:
            if joint in joints:
                k = joints.index(joint)
                far = float(np.linalg.norm(placement.translation)) + shape.bounding_radius
                self.radius[k] = max(self.radius[k], far)
        # Views of Pinocchio's own memory, in which each evaluation shows; one with nv = 1 comes without its last axis.
        self.M: Array = self.data.M.reshape(nv, nv, order="A")
        self.J: Array = self.data.J.reshape(6, nv, order="A")
        self._R, self._x = pose_views(self.data.oMi, self.model.njoints)
        self._carriers = np.array(joints, dtype=np.int64)
        self.damping, self.stiffness, self.rest = a.damping, a.stiffness, a.rest
        self._linear, self._linear_q, self._turning = self._scalar_coordinates()
        scalar = np.zeros(nv, dtype=bool)
        scalar[self._linear], scalar[[j for j, _ in self._turning]] = True, True
        self.scalar = scalar
        self._springs = bool(a.stiffness.any())
        self.driven = tuple(driven.values())
        self._driven_rows = np.zeros((len(driven), nv))
        self._driven_rows[np.arange(len(driven)), list(driven)] = 1.0
        self._closures = Closures(self.model, a.loops) if a.loops else None
        self.constrained = bool(driven) or self._closures is not None
        self._controlled: tuple[Any, Any] = (None, None)
        kinds = pin.FrameType.JOINT, pin.FrameType.BODY  # a body before a joint of the same name
        self._bodies = {
            f.name: k for kind in kinds for k, f in enumerate(self.model.frames) if f.type == kind and f.parentJoint > 0
        }
        self.B, self.P, self.Z = np.zeros((0, nv)), np.zeros((nv, 0)), np.eye(nv)
        self._known: tuple[Any, Any, tuple[float, float]] = (None, None, (0.0, 0.0))

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
        return _span(v), _span(q), turning

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of the joint coordinates, (nv,) each, infinite where there are none."""
        lower, upper = np.full(self.model.nv, -np.inf), np.full(self.model.nv, np.inf)
        lower[self._linear] = self.model.lowerPositionLimit[self._linear_q]
        upper[self._linear] = self.model.upperPositionLimit[self._linear_q]
        return lower, upper

    def angle(self, q: Array) -> Array:
        """Joint coordinates in rad or m, shape (nv,); 0 where a joint has none of its own (free, spherical)."""
        out = np.zeros(self.model.nv)
        out[self._linear] = q[self._linear_q]
        for j, k in self._turning:
            out[j] = np.arctan2(q[k + 1], q[k])
        return out

    def _deviation(self, angle: Array, target: Array) -> Array:
        """Angle - target, for joints given by cos and sin the short way round."""
        out: Array = angle - target
        for j, _ in self._turning:
            out[j] = np.remainder(out[j] + np.pi, 2.0 * np.pi) - np.pi
        return out

    def start(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Initial configuration and velocity with closed loops and driven joints at their speed."""
        v = v.copy()
        for row, motion in zip(self._driven_rows, self.driven, strict=True):
            v[row > 0.0] = motion.rate(0.0)
        return self.close(q), v

    def place(self, q: Array, x: Array, R: Array) -> None:
        """Poses of the links at q into x and R, and the Jacobian."""
        pin.computeJointJacobians(self.model, self.data, q)
        self._put_poses(x, R)

    def evaluate(self, q: Array, x: Array, R: Array) -> None:
        """Mass matrix M and what `place` does."""
        pin.crba(self.model, self.data, q, pin.Convention.WORLD)
        self._put_poses(x, R)

    def close(self, q: Array) -> Array:
        """The closest configuration whose loops are closed; q itself when they are."""
        return q if self._closures is None else self._closures.close(q, self._driven_rows)

    def _control(self, given: Any, begin: Array) -> tuple[Array, Array, Array]:
        """(tau, kp, kd) of what a controller returned, the forces at the velocity 0; ValueError if it does not fit."""
        if isinstance(given, PD):
            if given is not self._controlled[0]:
                kp, kd, target, rate, feedforward = given.on(self.name, self.scalar)
                self._controlled = given, (kp, kd, target, feedforward + kd * rate)
            kp, kd, target, constant = self._controlled[1]
            return constant - kp * self._deviation(self.angle(begin), target), kp, kd
        zero = np.zeros(self.model.nv)
        if given is None:
            return zero, zero, zero
        try:
            tau = np.array(given, dtype=float)
        except (TypeError, ValueError):
            tau = np.array(np.nan)
        if tau.shape != zero.shape or not np.isfinite(tau).all():
            raise ValueError(f"controller must give {zero.size} finite joint forces for {self.name!r}, got {given!r}")
        return tau, zero, zero

    def joint_forces(self, body: str, force: Array, torque: Array) -> Array:
        """Jᵀ (force, torque), shape (nv,), of a force [N] at the origin of a body's frame and a torque [N m].

        World axes; `evaluate` or `place` has been called.
        """
        if body not in self._bodies:
            raise ValueError(f"external_force: {self.name!r} has no moving body {body!r}; it has {list(self._bodies)}")
        at = self._bodies[body], pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        out: Array = pin.getFrameJacobian(self.model, self.data, *at).T @ np.concatenate((force, torque))
        return out

    def free_motion(
        self,
        begin: Array,
        middle: Array,
        velocity: Array,
        push: Array,
        h: float,
        theta: float,
        t: float,
        given: Any,
        applied: Array | None,
        m: Array,
        minv: Array,
    ) -> tuple[Array, TreeLoads]:
        """Velocity after a step without contacts, from the joint forces of the controller, and the loads.

        The forces linear in the end velocity v' make the effective mass matrix
        M + h θ D + h² θ² K + h kd + h² kp: damping -D v_θ and springs -K (q_k + θ h v_θ - rest) act at the θ-point,
        PD control at the end. The bias is Pinocchio's at ½ (v + v'), v' with the `push`; for θ = ½ a multiple of
        M (v + v') of order h² is added that makes its work on that motion the change of kinetic and gravity energy
        exactly.

        Parameters
        ----------
        begin, middle : ndarray, shape (nq,)
            Configurations; `evaluate` has been called at the middle.
        velocity : ndarray
            Of the scene, at the beginning.
        push : ndarray
            Change of it expected of contacts and joint rows.
        h, theta : float
        t : float
            Time at the end of the step, s.
        given : array or PD or None
            What the controller returned.
        applied : ndarray, shape (nv,), optional
            Joint forces of external wrenches.
        m, minv : ndarray, shape (nv, nv)
            The effective mass matrix and its inverse, Z Zᵀ of a constrained tree, written.

        References
        ----------
        O. Gonzalez, Time integration and discrete Hamiltonian systems, J. Nonlinear Sci. 6, 1996.
        """
        v, zero = velocity[self.coordinates], np.zeros(self.model.nv)
        tau, kp, kd = self._control(given, begin)
        if applied is not None:
            tau = tau + applied
        stretch = self._deviation(self.angle(begin), self.rest) if self._springs else zero
        force, factor = np.empty_like(v), np.empty_like(m)
        laws = self.damping, self.stiffness, kp, kd, tau, stretch
        if not _trees.implicit(self.M, *laws, v, h, theta, factor, m, minv, force):
            raise ValueError(
                f"mass matrix of {self.name!r} is not positive definite: a joint moves no mass; give it an armature"
            )
        start = rest = v
        if self.constrained:
            self._restrict(middle, factor)
            minv[:] = self.Z @ self.Z.T
            rest = minv @ (m @ v)
        energies = self.energies(begin, velocity)
        # Pushed, a motion mostly goes on as it was: at rest that guess is the answer, and one pass tells.
        kick, change, before = push[self.coordinates], SETTLED, sum(energies)
        new = v - kick
        for k in range(PASSES):
            after = new + kick
            mean = 0.5 * (v + after)
            bias = pin.nonLinearEffects(self.model, self.data, middle, mean)
            if k and theta == 0.5:
                end = pin.integrate(self.model, begin, h * mean)
                gain = pin.computeMechanicalEnergy(self.model, self.data, end, after) - before
                _trees.conserve(self.M, minv, v, after, gain, h, bias)
            if self.constrained and k < 2:
                # Later passes would diverge where a step is longer than the way to a singular configuration.
                start = rest + self.P @ self._rates(begin, v, after, h, theta, t)
            last, change = change, _trees.respond(start, minv, force, bias, h, new)
            if change * min(change, last) <= SETTLED * last and (
                k or theta != 0.5 or _trees.slow(self.M, minv, mean, bias, h)
            ):
                break
        weight = zero if theta == 0.5 else np.array(pin.computeGeneralizedGravity(self.model, self.data, middle))
        return new, TreeLoads(tau, kp, kd, stretch, bias, weight, energies)

    def _restrict(self, middle: Array, factor: Array) -> None:
        """Rows B of the bilateral constraints at the midpoint, and the velocities P b + Z y they admit."""
        loops = np.empty((0, self.model.nv)) if self._closures is None else self._closures.at(middle)[1]
        self.B = np.concatenate((loops, self._driven_rows))
        self.Z, self.P = admissible(self.B, factor)

    def _rates(self, begin: Array, v: Array, new: Array, h: float, theta: float, t: float) -> Array:
        """The b in B v' = b: of loops, G̃ v' where G v' = 0 at the end of the step to `new`; of driven joints at t."""
        b = np.zeros(len(self.B))
        if self._closures is not None:
            end = np.array(pin.integrate(self.model, begin, h * (theta * new + (1.0 - theta) * v)))
            loops = slice(self._closures.size)
            b[loops] = (self.B[loops] - self._closures.at(end)[1]) @ new
        b[b.size - len(self.driven) :] = [motion.rate(t) for motion in self.driven]
        return b

    def forces(self, loads: TreeLoads, v1: Array, v_theta: Array, h: float, theta: float) -> tuple[Array, ...]:
        """(actuation, damping, springs) of a step that ends with v1, (nv,) each."""
        actuation = loads.tau - (loads.kd + h * loads.kp) * v1
        return actuation, -self.damping * v_theta, -self.stiffness * (loads.stretch + theta * h * v_theta)

    def works(self, loads: TreeLoads, v0: Array, v1: Array, v_theta: Array, h: float, theta: float) -> list[float]:
        """Works on the mean velocity v̄, J: v̄·M Δv, then of actuation, damping, springs and bias."""
        out = np.empty(5)
        laws = self.damping, self.stiffness, loads.kp, loads.kd, loads.tau, loads.stretch, loads.bias
        _trees.works(self.M, *laws, v0, v1, v_theta, h, theta, out)
        works: list[float] = out.tolist()
        return works

    def constraint_work(
        self, loads: TreeLoads, v0: Array, v1: Array, v_theta: Array, h: float, theta: float, impulse: Array
    ) -> float:
        """Work ½ B (v0 + v1)·λ of loops and driven joints, with Bᵀ λ what they and nothing else explain, J.

        `impulse` (nv,) is that of contacts and joint rows.
        """
        force = sum(self.forces(loads, v1, v_theta, h, theta)) - loads.bias
        reaction = self.P.T @ (self.M @ (v1 - v0) - h * force - impulse)
        return 0.5 * float((self.B @ (v0 + v1)) @ reaction)

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """(kinetic, potential of gravity) energy in J, v being the velocity of the scene."""
        if self._known[0] is not q or self._known[1] is not v:
            pin.computeMechanicalEnergy(self.model, self.data, q, v[self.coordinates])
            self._known = q, v, (float(self.data.kinetic_energy), float(self.data.potential_energy))
        return self._known[2]

    def spring_energy(self, q: Array) -> float:
        """Potential energy of the joint springs, J."""
        if not self._springs:
            return 0.0
        deviation = self._deviation(self.angle(q), self.rest)
        return 0.5 * float(deviation @ (self.stiffness * deviation))

    def poses(self, q: Array, x: Array, R: Array) -> None:
        """Poses of the links at q into x and R."""
        pin.forwardKinematics(self.model, self.data, q)
        self._put_poses(x, R)

    def _put_poses(self, x: Array, R: Array) -> None:
        """Copy the poses that Pinocchio computed last."""
        _trees.gather(self._x, self._R, self._carriers, x[self.frames], R[self.frames])
