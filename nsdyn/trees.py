"""One articulated tree: Pinocchio's terms, the forces of its joints, and its motion without contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from nsdyn._kernels import trees as _trees
from nsdyn.articulations import Articulation
from nsdyn.contacts import pose_views
from nsdyn.loops import Closures, admissible, supports
from nsdyn.motions import Motion

Array = NDArray[np.float64]

__all__ = ["PD", "Tree", "TreeLoads"]

PASSES = 20
"""Most passes of the fixed point for the free motion; it contracts by O(h ω) a pass."""

UNLIMITED = 1e100
"""Pinocchio's own joints have limits of ±1.8e308, rad or m."""

SETTLED = 1e-10
"""Relative change of the velocity at which it stops: the next pass would change a hundredth of that or less."""


@dataclass(frozen=True, eq=False)
class PD:
    """Joint control τ = kp (target - q) + kd (target_velocity - v) + feedforward, with q and v of the end of the step.

    Implicit, so that any gains are stable: with h the step, q = q_k + h v_{k+1} and v = v_{k+1}. A number serves all
    revolute and prismatic joints; arrays (nv,) must have no gain on other coordinates.

    Parameters
    ----------
    kp, kd : float or array, shape (nv,)
        Gains ≥ 0, N m/rad and N m s/rad, or N/m and N s/m.
    target, target_velocity : float or array, shape (nv,)
        rad and rad/s, or m and m/s.
    feedforward : float or array, shape (nv,)
        N m or N.

    References
    ----------
    J. Tan, K. Liu, G. Turk, Stable proportional-derivative controllers, IEEE CG&A 31, 2011.
    """

    kp: ArrayLike
    kd: ArrayLike
    target: ArrayLike
    target_velocity: ArrayLike = 0.0
    feedforward: ArrayLike = 0.0


@dataclass(frozen=True, eq=False)
class TreeLoads:
    """What acts on a tree during a step besides contacts, joint limits and joint friction; all (nv,) but the last.

    Attributes
    ----------
    tau : ndarray
        Given joint forces and the part of a PD control that the motion does not change.
    kp, kd : ndarray
        Gains of the PD control, 0 where there is none.
    angle : ndarray
        Joint coordinates at the beginning, rad or m.
    bias : ndarray
        Coriolis, centrifugal and gravity terms of the step.
    weight : ndarray
        Gravity terms at the midpoint.
    energies : tuple
        Kinetic energy, and potential energy of gravity, at the beginning, J.
    """

    tau: Array
    kp: Array
    kd: Array
    angle: Array
    bias: Array
    weight: Array
    energies: tuple[float, float]


def _numbers(given: Any) -> Array | None:
    """Finite numbers as an array, else None."""
    try:
        out = np.array(given, dtype=float)
    except (TypeError, ValueError):
        return None
    return out if np.isfinite(out).all() else None


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
        self.damping, self.stiffness, self.rest = a.damping, a.stiffness, a.rest
        self._linear, self._linear_q, self._turning = self._scalar_coordinates()
        scalar = np.zeros(nv, dtype=bool)
        scalar[self._linear], scalar[[j for j, _ in self._turning]] = True, True
        if (a.stiffness[~scalar] != 0.0).any():
            raise ValueError(f"stiffness of {a.name!r} must be 0 on coordinates of free, spherical and planar joints")
        self.scalar = scalar
        self._springs = bool(a.stiffness.any())
        self._viscous = bool(a.damping.any())
        self.driven = tuple(driven.values())
        self._driven_rows = np.zeros((len(driven), nv))
        self._driven_rows[np.arange(len(driven)), list(driven)] = 1.0
        self._closures = Closures(self.model, a.loops) if a.loops else None
        self.constrained = bool(driven) or self._closures is not None
        self._F = np.zeros((nv, nv))
        self.B, self.P, self.Z = np.zeros((0, nv)), np.zeros((nv, 0)), np.eye(nv)
        self._known: tuple[Any, Any, tuple[float, float]] = (None, None, (0.0, 0.0))

    def _scalar_coordinates(self) -> tuple[list[int], list[int], list[tuple[int, int]]]:
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
        return v, q, turning

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of the joint coordinates, (nv,) each, infinite where there are none."""
        lower, upper = np.full(self.model.nv, -np.inf), np.full(self.model.nv, np.inf)
        lower[self._linear] = self.model.lowerPositionLimit[self._linear_q]
        upper[self._linear] = self.model.upperPositionLimit[self._linear_q]
        return np.where(lower < -UNLIMITED, -np.inf, lower), np.where(upper > UNLIMITED, np.inf, upper)

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
        if self._closures is None:
            return q, v
        pin.crba(self.model, self.data, q, pin.Convention.WORLD)
        self._factorise(np.zeros_like(v))
        return self._closures.close(q, self._F, self._driven_rows), v

    def place(self, q: Array, x: Array, R: Array) -> None:
        """Poses of the links at q into x and R, and the Jacobian."""
        pin.computeJointJacobians(self.model, self.data, q)
        x[self.frames], R[self.frames] = self._x[self.joints], self._R[self.joints]

    def evaluate(self, q: Array, x: Array, R: Array) -> None:
        """Mass matrix M and what `place` does."""
        pin.crba(self.model, self.data, q, pin.Convention.WORLD)
        x[self.frames], R[self.frames] = self._x[self.joints], self._R[self.joints]

    def close(self, q: Array) -> Array:
        """The closest configuration whose loops are closed; q itself when they are."""
        return q if self._closures is None else self._closures.close(q, self._F, self._driven_rows)

    def control(self, given: Any) -> tuple[Array, Array, Array, Array, Array]:
        """(tau, kp, kd, target, target velocity) of what a controller returned: an array (nv,) or a `PD`.

        Raises
        ------
        ValueError
            For wrong shapes, values that are not finite, negative gains, gains on free or spherical joints.
        """
        nv, zero = self.model.nv, np.zeros(self.model.nv)
        if not isinstance(given, PD):
            tau = _numbers(given)
            if tau is None or tau.shape != (nv,):
                raise ValueError(f"controller must give {nv} finite joint forces for {self.name!r}, got {given!r}")
            return tau, zero, zero, zero, zero
        parts = []
        for what in ("feedforward", "kp", "kd", "target", "target_velocity"):
            value = _numbers(getattr(given, what))
            if value is None or value.shape not in ((), (nv,)):
                raise ValueError(
                    f"{what} of the PD control of {self.name!r} must be one or {nv} finite numbers, "
                    f"got {getattr(given, what)!r}"
                )
            parts.append(value if value.ndim else value * self.scalar)
        for what, gain in (("kp", parts[1]), ("kd", parts[2])):
            if (gain < 0.0).any() or (gain[~self.scalar] != 0.0).any():
                raise ValueError(
                    f"{what} of the PD control of {self.name!r} must not be negative, and 0 on free or spherical joints"
                )
        return parts[0], parts[1], parts[2], parts[3], parts[4]

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
        m, minv : ndarray, shape (nv * nv,)
            The effective mass matrix and its inverse, Z Zᵀ of a constrained tree, written.

        References
        ----------
        O. Gonzalez, Time integration and discrete Hamiltonian systems, J. Nonlinear Sci. 6, 1996.
        """
        v = velocity[self.coordinates]
        nv = v.size
        tau = kp = kd = angle = zero = np.zeros(nv)
        if given is not None or self._springs:
            angle = self.angle(begin)
        if given is not None:
            tau, kp, kd, target, rate = self.control(given)
            if kp.any() or kd.any():
                tau = tau - kp * self._deviation(angle, target) + kd * rate
        loads = TreeLoads(tau, kp, kd, angle, zero, zero, self.energies(begin, velocity))
        extra = h * (theta * self.damping + h * theta * theta * self.stiffness + kd + h * kp)
        self._factorise(extra)
        _trees.blocks_of(self.M, extra, self._F, m, minv)
        effective, inverse = m.reshape(nv, nv), minv.reshape(nv, nv)
        force = self._explicit(loads, v, h, theta)
        if self.constrained:
            self.B = np.concatenate((self._closures.at(middle)[1], self._driven_rows)) if self._closures else (
                self._driven_rows
            )  # fmt: skip
            self.Z, self.P = admissible(self.B, self._F)
            inverse[:] = self.Z @ self.Z.T
            momentum = effective @ v
            drive = np.array([motion.rate(t) for motion in self.driven])
        bias, new, before = zero, v, v
        kick = push[self.coordinates]
        for k in range(PASSES):
            end = new + kick
            bias = np.array(pin.nonLinearEffects(self.model, self.data, middle, 0.5 * (v + end)))
            if theta == 0.5 and k:
                bias = self._conserving(bias, loads.energies, begin, v, end, h, inverse)
            before = new
            if self.constrained:
                if k < 2:  # later passes would diverge where a step is longer than the way to a singular configuration
                    fixed = self.P @ np.concatenate((self._loop_rates(begin, v, end, h, theta), drive))
                new = fixed + self.Z @ (self.Z.T @ (momentum + h * (force - bias)))
            else:
                new = v + h * (inverse @ (force - bias))
            if np.abs(new - before).max(initial=0.0) <= SETTLED * np.abs(new).max(initial=0.0):
                break
        weight = zero if theta == 0.5 else np.array(pin.computeGeneralizedGravity(self.model, self.data, middle))
        return new, TreeLoads(tau, kp, kd, angle, bias, weight, loads.energies)

    def _factorise(self, extra: Array) -> None:
        if not _trees.inverse_factor(self.M, extra, self._F):
            raise ValueError(
                f"mass matrix of {self.name!r} is not positive definite: a joint moves no mass; give it an armature"
            )

    def _explicit(self, loads: TreeLoads, v: Array, h: float, theta: float) -> Array:
        """Joint forces at the velocity of the beginning."""
        force = loads.tau - (self.damping + loads.kd + h * loads.kp) * v
        if self._springs:
            force -= self.stiffness * self._deviation(loads.angle + theta * h * v, self.rest)
        return force

    def _loop_rates(self, begin: Array, v: Array, new: Array, h: float, theta: float) -> Array:
        """Rates G̃ v' that loops ask of the end velocity v' for G v' = 0 where the step ends."""
        if self._closures is None:
            return np.empty(0)
        end = np.array(pin.integrate(self.model, begin, h * (theta * new + (1.0 - theta) * v)))
        out: Array = (self.B[: self._closures.size] - self._closures.at(end)[1]) @ new
        return out

    def _conserving(
        self, bias: Array, energies: tuple[float, float], begin: Array, v: Array, new: Array, h: float, inverse: Array
    ) -> Array:
        """Bias + s M v̄ with the s for which h v̄·bias = Δ(T + V) - v̄·M Δv on the motion to `new`.

        Motions slower than gravity makes them in a step keep the bias: s would be a quotient of round-off.
        """
        mean = 0.5 * (v + new)
        momentum = self.M @ mean
        twice = float(mean @ momentum)
        if twice <= h * h * float(bias @ (inverse @ bias)):
            return bias
        end = np.array(pin.integrate(self.model, begin, h * mean))
        change = pin.computeMechanicalEnergy(self.model, self.data, end, new) - sum(energies)
        s = (change - float(momentum @ (new - v)) - h * float(mean @ bias)) / (h * twice)
        out: Array = bias + s * momentum
        return out

    def forces(self, loads: TreeLoads, v1: Array, v_theta: Array, h: float, theta: float) -> tuple[Array, ...]:
        """(actuation, damping, springs) of a step that ends with v1, (nv,) each."""
        actuation = loads.tau - (loads.kd + h * loads.kp) * v1
        damping = -self.damping * v_theta
        springs = -self.stiffness * self._deviation(loads.angle + theta * h * v_theta, self.rest)
        return actuation, damping, springs

    def reactions(self, impulse: Array) -> Array:
        """Impulses λ of the bilateral constraints, Bᵀ λ = impulse on the coordinates, the smallest."""
        out: Array = self.P.T @ impulse
        return out

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
        x[self.frames], R[self.frames] = self._x[self.joints], self._R[self.joints]
