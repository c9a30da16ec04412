"""One articulated tree: Pinocchio's terms, the forces of its joints, and its motion without contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn._kernels.dynamics import links as _links
from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.collision.distances import pose_views
from nsdyn.dynamics.loops import Closures, admissible, factored, indefinite, supports
from nsdyn.dynamics.runge_kutta import TOLERANCE, Rate, fastest, move
from nsdyn.dynamics.sliding import slide
from nsdyn.dynamics.tree_values import Constraints, Flow, FreeMotion, Halfway, Links, TreeEnd, TreeLoads, TreeWorks
from nsdyn.scene.articulations import Articulation
from nsdyn.scene.control import PD
from nsdyn.scene.prescribed import Motion
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import meant

__all__ = ["Tree"]

SETTLING = 5
"""Passes in which a control may also leave its limit, so that their number is bounded; two are usual."""

Control = tuple[Array, Array, Array, Array, Array]
"""(kp, kd, target, constant, limit) of a control."""

DIFFERENCE = 1e-5
"""Step of central differences of smooth functions, rad, m or s: truncation and round-off are both of 1e-10."""


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
        self.model.name = a.name
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
        self._weightless = self.model.copy()
        self._weightless.gravity = pin.Motion.Zero()
        # Views of Pinocchio's own memory, in which each evaluation shows; one with nv = 1 comes without its last axis.
        self._J: Array = self.data.J.reshape(6, nv, order="A")
        self._R, self._x = pose_views(self.data.oMi, self.model.njoints)
        self._carriers = np.array(joints, dtype=np.int64)
        self.damping, self.stiffness, self.rest, self.effort = a.damping, a.stiffness, a.rest, a.effort
        self._linear, self._linear_q, self._turning = self._scalar_coordinates()
        scalar = np.zeros(nv, dtype=bool)
        scalar[self._linear], scalar[[j for j, _ in self._turning]] = True, True
        self.scalar = scalar
        self._springs = bool(a.stiffness.any())
        self._implicit = self._springs or bool(a.damping.any())
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
        self._zero = np.zeros(nv)  # not read-only, for which all kernels would be compiled once more
        self._no_control = self._zero, self._zero, self._zero, self._zero, np.full(nv, np.inf)
        self._round = np.zeros(nv, dtype=bool)
        self._round[[j for j, _ in self._turning]] = True
        pin.computeJointJacobians(self.model, self.data, pin.neutral(self.model))
        self._turns = self._J[3:].any(axis=0)

    def _scalar_coordinates(self) -> tuple[Index, Index, list[tuple[int, int]]]:
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
        return np.array(v, dtype=np.int64), np.array(q, dtype=np.int64), turning

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

    def links(self, q: Array) -> Links:
        """Poses and Jacobian of the links at q."""
        pin.computeJointJacobians(self.model, self.data, q)
        return self._links(q)

    def _links(self, q: Array) -> Links:
        """Copies of what Pinocchio computed last, at q."""
        k = self._carriers.size
        x, R, angle = np.empty((k, 3)), np.empty((k, 3, 3)), self._zero.copy()
        _links.gather(self._x, self._R, self._carriers, q, self._linear, self._linear_q, x, R, angle)
        for j, i in self._turning:
            angle[j] = np.arctan2(q[i + 1], q[i])
        return Links(x, R, self._J.copy(order="F"), angle)

    def twists(self, links: Links, v: Array) -> tuple[Array, Array]:
        """Velocities of the links' frames at v (nv,): linear at the origin, m/s, and angular, rad/s; world axes."""
        linear, angular = np.empty_like(links.x), np.empty_like(links.x)
        _links.twists(links.x, self.support, links.J, v, linear, angular)
        return linear, angular

    def close(self, q: Array) -> Array:
        """The closest configuration whose loops are closed; q itself when they are."""
        return q if self._closures is None else self._closures.close(q, self._driven_rows)

    def _control(self, given: Any) -> Control:
        """(kp, kd, target, constant, limit) of what a controller returned; ValueError if unfit."""
        if given is None:
            return self._no_control
        if isinstance(given, PD):
            if given is not self._controlled[0]:
                parts = given.on(self.name, self.scalar, self.effort)
                kp, kd, target, rate, feedforward, limit = map(np.array, parts)  # which can be written, as all others
                self._controlled = given, (kp, kd, target, feedforward + kd * rate, limit)
            control: Control = self._controlled[1]
            return control
        zero, _, _, _, unlimited = self._no_control
        try:
            tau = np.array(given, dtype=float)
        except (TypeError, ValueError):
            tau = np.array(np.nan)
        if tau.shape != zero.shape or not np.isfinite(tau).all():
            raise ValueError(f"controller must give {zero.size} finite joint forces for {self.name!r}, got {given!r}")
        return zero, zero, zero, tau, unlimited

    def joint_forces(self, q: Array, body: str, force: Array, torque: Array) -> Array:
        """Jᵀ (force, torque), shape (nv,), of a force [N] at the origin of a body's frame and a torque [N m] at q.

        World axes.
        """
        if body not in self._bodies:
            known = list(self._bodies)
            raise ValueError(
                f"external_force: {self.name!r} has no moving body {body!r}; it has {known}{meant(body, known)}"
            )
        at = self._bodies[body], pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(self.model, self.data, q, *at).reshape(6, -1, order="A")
        out: Array = J.T @ np.concatenate((force, torque))
        return out

    def flow(self, q: Array, v: Array, h: float) -> Flow:
        """Motion for h without forces, on loops and driven joints if there are any, which keep their speed.

        Of a tree without loops by `move`, to fourth order; with loops to second order, by `slide`. What turns by less
        than `TOLERANCE` goes straight on.
        """
        speed, turn = _trees.fastest(v, self._turns)
        if h * turn <= TOLERANCE:
            return Flow(q if speed == 0.0 else self.close(pin.integrate(self.model, q, h * v)), v, v, 0.0)
        if not speed < np.inf:
            raise ArithmeticError(f"in {self.name!r} {fastest(self.model, v)}")
        if self._closures is not None:
            return slide(self._weightless, self.data, self._closures, self._driven_rows, q, v, h)
        still = 0.0 * self._driven_rows[:, 0]
        return move(self.model, self._rate(self._weightless, self._zero, still), q, v, h, turn)

    def _rate(self, model: pin.Model, tau: Array, driven: Array) -> Rate:
        """Accelerations of a tree without loops under joint forces, whose driven joints accelerate as said."""
        data, rows = self.data, self._driven_rows
        if not self.driven:
            return lambda q, v: (pin.aba(model, data, q, v, tau), 0.0)

        def rate(q: Array, v: Array) -> tuple[Array, float]:
            a = pin.forwardDynamics(model, data, q, v, tau, rows, -driven)
            return a, float(data.lambda_c @ (rows @ v))

        return rate

    def _restrict(self, q: Array, F: Array) -> tuple[Array, Array, Array]:
        """(B, P, Z) of `Constraints` at q, where M⁻¹ = Fᵀ F."""
        loops = np.empty((0, self.model.nv)) if self._closures is None else self._closures.at(q)[1]
        B = np.concatenate((loops, self._driven_rows))
        Z, P = admissible(B, F)
        return B, P, Z

    def constraint_acceleration(self, q: Array, v: Array, t: float) -> Array:
        """b of B v̇ = b, shape (m,): -Ġ v of the loops, then the accelerations of the driven joints at time t.

        Central differences, Ġ v along the motion with v held and loops closed.
        """
        loops, fastest = np.empty(0), float(np.abs(v).max(initial=0.0))
        if self._closures is not None:
            loops = np.zeros(self._closures.size)
            if fastest > 0.0:
                step = DIFFERENCE / fastest
                ahead, behind = (
                    self._closures.at(self.close(pin.integrate(self.model, q, s * v)))[1] for s in (step, -step)
                )
                loops = -(ahead - behind) @ v / (2.0 * step)
        rates = [(m.rate(t + DIFFERENCE) - m.rate(t - DIFFERENCE)) / (2.0 * DIFFERENCE) for m in self.driven]
        return np.concatenate((loops, rates))

    def halfway(self, q: Array, v: Array, h: float, theta: float) -> Halfway:
        """Where the forces of a step of h from (q, v) act: after (1 - θ) h of motion without forces."""
        middle, v0, _, work = self.flow(q, v, (1.0 - theta) * h)
        M = np.array(pin.crba(self.model, self.data, middle, pin.Convention.WORLD)).reshape(v.size, v.size)
        return Halfway(q, v, middle, v0, work, M, self._links(middle), h, theta)

    def free_motion(self, halfway: Halfway, t: float, given: Any, applied: Array | None) -> FreeMotion:
        """Velocity after the forces of a step without contacts and joint rows.

        M̃ (v' - v0) = h (f - g): gravity terms g at the midpoint, and f the joint forces, in which the forces linear
        in v' make the effective mass matrix M̃ = M + h θ D + h² θ² K + h kd + h² kp. Damping -D v_θ and springs act at
        the θ-point of the step, v_θ = θ v' + (1 - θ) v0, PD control at its end. For θ = ½ a spring neither gains nor
        loses energy, and any stiffness is stable as long as its vibrations turn nothing by a radian in a step; θ > ½
        damps them, at first order in h. PD control is stable with any gains. θ says nothing of the motion without
        forces but how it is parted, (1 - θ) h before them and θ h after. Of a tree with loops or driven joints
        B v' = b holds too.

        Parameters
        ----------
        halfway : Halfway
        t : float
            Time at the end of the step, s.
        given : array or PD or None
            What the controller returned.
        applied : ndarray, shape (nv,), optional
            Joint forces of external wrenches.

        Raises
        ------
        ValueError
            For joint forces that do not fit, and where a joint moves no mass.
        """
        angle, v0, h, theta = halfway.links.angle, halfway.v, halfway.h, halfway.theta
        kp, kd, _, _, limit = control = self._control(given)
        own = np.empty_like(v0)
        _trees.command(control, angle, self._round, own)
        tau, push = (own, self._zero) if applied is None else (own + applied, applied)
        stretch = self._deviation(angle, self.rest) if self._springs else self._zero
        weight = pin.computeGeneralizedGravity(self.model, self.data, halfway.q)
        loads = TreeLoads(tau, push, kp, kd, stretch, weight, self._implicit or isinstance(given, PD))
        out, beyond = self._respond(halfway, t, loads, control, own)
        if not beyond:
            return out
        side = np.zeros(v0.size)  # of its limit at which a control is
        for k in range(SETTLING + v0.size + 1):
            # To end, what has been at its limit stays there after some passes.
            if not _trees.saturated(control, own, v0, out.v, h, theta, k >= SETTLING, side):
                break
            free = side == 0.0
            held = np.where(free, own, side * np.where(free, 0.0, limit))
            loads = loads._replace(tau=held + push, kp=kp * free, kd=kd * free)
            out, _ = self._respond(halfway, t, loads, control, own)
        return out

    def _respond(
        self, halfway: Halfway, t: float, loads: TreeLoads, control: Control, own: Array
    ) -> tuple[FreeMotion, bool]:
        """What loads do in a step; whether their control, of which tau has its `own`, may be beyond its limit.

        ValueError where a joint moves no mass.
        """
        v0, M, h, theta = halfway.v, halfway.M, halfway.h, halfway.theta
        n = v0.size
        matrices, v = np.empty((3, n, n)), np.empty(n)
        laws = self.damping, self.stiffness, loads.kp, loads.kd, loads.tau, loads.stretch
        if self.constrained:
            factor, m, force, beyond = matrices[0], matrices[1], np.empty(n), True
            fine = _trees.implicit(M, *laws, v0, h, theta, *matrices, force)
        else:
            fine, beyond = _trees.loaded(M, laws, loads.weight, control, own, v0, h, theta, matrices, v)
        if not fine:
            raise indefinite(self.model, M)
        if not self.constrained:
            return FreeMotion(v, loads, matrices[1], matrices[2], None), beyond
        B, P, Z = self._restrict(halfway.q, factor)
        minv, b = Z @ Z.T, np.zeros(len(B))
        b[b.size - len(self.driven) :] = [motion.rate(t) for motion in self.driven]
        start, v = minv @ (m @ v0) + P @ b, v0.copy()
        _trees.respond(start, minv, force, loads.weight, h, v)
        return FreeMotion(v, loads, m, minv, Constraints(B, P, Z)), beyond

    def inertia(self, q: Array, v: Array) -> FreeMotion:
        """What nothing does at a configuration: the mass matrix that impacts meet, on loops and driven joints."""
        M, factor, minv = factored(self.model, self.data, q)
        loads = TreeLoads(*6 * (self._zero,), False)
        if not self.constrained:
            return FreeMotion(v, loads, M, minv, None)
        B, P, Z = self._restrict(q, factor)
        return FreeMotion(v, loads, M, Z @ Z.T, Constraints(B, P, Z))

    def end(self, halfway: Halfway, free: FreeMotion, v: Array, pushed: bool) -> TreeEnd:
        """Where a step ends whose forces leave the velocity v.

        It goes on without forces for θ h. But a tree without constraints that nothing has `pushed`, no contact and
        no joint row, and on which only gravity and given joint forces act, ends where a fourth-order motion from the
        beginning does: the same but for O(h³). At rest, where v and the velocity before it are 0, nothing moves.
        """
        h, theta, loads, begin_v = halfway.h, halfway.theta, free.loads, halfway.begin_v
        if not (pushed or loads.implicit or self._closures is not None):
            begin_speed, begin_turn = _trees.fastest(begin_v, self._turns)
            speed, turn = _trees.fastest(v, self._turns)
            if h * max(speed, begin_speed) > TOLERANCE:
                rate = self._rate(self.model, loads.tau, self._driven_rows @ (v - begin_v) / h)
                return TreeEnd(*move(self.model, rate, halfway.begin, begin_v, h, max(turn, begin_turn)), True)
        q, v1, _, work = self.flow(halfway.q, v, theta * h)
        return TreeEnd(q, v1, 0.5 * (halfway.v + v), halfway.work + work, False)

    def forces(self, halfway: Halfway, free: FreeMotion, v: Array) -> Array:
        """Actuation, damping and springs of a step whose forces leave the velocity v, shape (3, nv), N m or N."""
        out, loads = np.empty((3, v.size)), free.loads
        laws = self.damping, self.stiffness, loads.kp, loads.kd, loads.tau, loads.stretch
        _trees.forces(*laws, halfway.v, v, halfway.h, halfway.theta, out)
        return out

    def works(
        self,
        halfway: Halfway,
        free: FreeMotion,
        v: Array,
        end: TreeEnd,
        lifted: Array,
        impulse: Array,
        before: tuple[float, float],
    ) -> TreeWorks:
        """The tree's part in the ledger of a step.

        Parameters
        ----------
        halfway : Halfway
        free : FreeMotion
        v : ndarray, shape (nv,)
            Velocity that the forces leave.
        end : TreeEnd
        lifted : ndarray, shape (nq,)
            Configuration after the position projection, end.q itself without.
        impulse : ndarray, shape (nv,)
            H r of contacts and joint rows.
        before : (float, float)
            Kinetic and potential energy at its beginning, J.
        """
        h, loads, joints = halfway.h, free.loads, np.empty_like(v)
        laws = self.damping, self.stiffness, loads.kp, loads.kd, loads.tau, loads.stretch
        velocities = halfway.v, v
        actuation, damping, pushed = _trees.works(
            laws, velocities, end.mean, loads.push, impulse, h, halfway.theta, joints
        )
        constraint = 0.0
        if free.constraints is not None:
            # Bᵀ λ is what the constraints and nothing else explain.
            B, P, _ = free.constraints
            constraint = end.work
            if not end.whole:
                force = self.forces(halfway, free, v).sum(axis=0) - loads.weight
                reaction = P.T @ (halfway.M @ (v - halfway.v) - h * force - impulse)
                constraint += float((B @ end.mean) @ reaction)
        after = self.energies(end.q, end.v)
        kinetic, potential = after if lifted is end.q else self.energies(lifted, end.v)
        # In the order of the ledger, whose round-off then is that of the changes, not of the energies.
        projection = (kinetic - after[0]) + (potential - after[1])
        change = (kinetic - before[0]) + (potential - before[1])
        integration = (after[0] - before[0]) + (after[1] - before[1]) - actuation - damping - constraint - pushed
        return TreeWorks(kinetic, potential, change, actuation, damping, constraint, integration, projection, joints)

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """(kinetic, potential) energy in J, potential of gravity and of joint springs."""
        pin.computeMechanicalEnergy(self.model, self.data, q, v)
        kinetic, potential = float(self.data.kinetic_energy), float(self.data.potential_energy)
        if self._springs:
            deviation = self._deviation(self.angle(q), self.rest)
            potential += 0.5 * float(deviation @ (self.stiffness * deviation))
        return kinetic, potential

    def bias(self, q: Array, v: Array) -> Array:
        """Coriolis, centrifugal and gravity terms, shape (nv,), N m or N."""
        return np.array(pin.nonLinearEffects(self.model, self.data, q, v))
