"""One articulated tree: Pinocchio's terms, the forces of its joints, and its motion without contacts."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import pinocchio as pin

from nsdyn._kernels.dynamics import links as _links
from nsdyn._kernels.dynamics import trees as _trees
from nsdyn.collision.distances import pose_views
from nsdyn.dynamics.actuators import Control, left_to_rows
from nsdyn.dynamics.loops import Closures, admissible, factored, indefinite, supports
from nsdyn.dynamics.runge_kutta import COARSER, TOLERANCE, Rate, fastest, move
from nsdyn.dynamics.sliding import slide
from nsdyn.dynamics.tree_values import Constraints, Flow, FreeMotion, Halfway, Links, TreeEnd, TreeLoads, TreeWorks
from nsdyn.scene.articulations import BALL, PLANAR, Articulation
from nsdyn.scene.gears import Gear, GearGaps, joint_at
from nsdyn.scene.prescribed import Motion
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["Tree"]

HELD = 1e-12
"""Velocity, per root of a kinetic energy of ½ J, that is round-off of 0: of a ball of 1e24 kg."""

DIFFERENCE = 1e-5
"""Step of central differences of smooth functions, rad, m or s: truncation and round-off are both of 1e-10."""


class Tree:
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
        In the scene's velocity and frames, as `at` has it.
    held : ndarray of bool, shape (nv,)
        Coordinates that nothing but prescribed motion moves: driven ones, and those that loops and gears then leave no
        freedom.
    bodies : dict of str to int
        Frames of the model's moving bodies and joints, by name.
    planes, balls : frozenset of int
        First coordinates of planar joints, of sliding, and of ball joints; both slip together with the next.
    held_links : ndarray of bool, shape (k,)
        The links of `joints` that nothing else moves.
    """

    def __init__(
        self,
        articulation: Articulation,
        gravity: Array,
        joints: list[int],
        driven: dict[int, Motion],
    ) -> None:
        a = self.articulation = articulation
        self.name = a.name
        self.model = a.model.copy()
        self.model.name = a.name
        self.model.gravity = pin.Motion(gravity, np.zeros(3))
        self.model.armature = a.armature
        self.data = self.model.createData()
        nv = self.model.nv
        self.coordinates, self.joints, self.frames = slice(0, nv), joints, slice(0, len(joints))
        self.support = supports(self.model)[joints]
        self.radius = _radii(a, joints)
        self._weightless = self.model.copy()
        self._weightless.gravity = pin.Motion.Zero()
        # Pinocchio's kinetic energy leaves out the armature of joints about axes that are none of the coordinates'.
        self._bare, self._armature = self.model.copy(), a.armature
        self._bare.armature, self._armoured = np.zeros(nv), bool(a.armature.any())
        # Views of Pinocchio's own memory, in which each evaluation shows; one with nv = 1 comes without its last axis.
        self._J: Array = self.data.J.reshape(6, nv, order="A")
        self._R, self._x = pose_views(self.data.oMi, self.model.njoints)
        self._carriers = np.array(joints, dtype=np.int64)
        self.stiffness, self.rest = a.stiffness, a.rest
        self._laws = np.array((a.stiffness, a.damping, a.rest))
        self._linear, self._linear_q, self._turning = self._scalar_coordinates()
        scalar = np.zeros(nv, dtype=bool)
        scalar[self._linear], scalar[[j for j, _ in self._turning]] = True, True
        self.scalar, self._no_control = scalar, Control.none(nv)
        self._springs = bool(a.stiffness.any())
        self._implicit = self._springs or bool(a.damping.any())
        self._limited = a.limits
        self.driven = tuple(driven.values())
        self._driven_rows = np.zeros((len(driven), nv))
        self._driven_rows[np.arange(len(driven)), list(driven)] = 1.0
        self._steady = np.zeros(len(driven))
        self._closures = Closures(self.model, a.loops, a.gears) if a.loops or a.gears else None
        self.constrained = bool(driven) or self._closures is not None
        kinds = pin.FrameType.JOINT, pin.FrameType.BODY  # a body before a joint of the same name
        self.bodies = {
            f.name: k for kind in kinds for k, f in enumerate(self.model.frames) if f.type == kind and f.parentJoint > 0
        }
        self._zero = np.zeros(nv)  # not read-only, for which all kernels would be compiled once more
        self._no_impulses = np.zeros((nv, 3))
        self.planes, self.balls = (
            frozenset(j.idx_v for j in self.model.joints[1:] if j.shortname() == kind) for kind in (PLANAR, BALL)
        )
        self._round = np.zeros(nv, dtype=bool)
        self._round[[j for j, _ in self._turning]] = True
        pin.computeJointJacobians(self.model, self.data, pin.neutral(self.model))
        self._turns = self._J[3:].any(axis=0)
        self.held, self.held_links = self._held(a.q, a.gears)

    def at(self, start: int, first: int) -> Tree:
        """The same tree, whose first coordinate and frame are those in a scene."""
        out = copy(self)
        out.coordinates = slice(start, start + self.model.nv)
        out.frames = slice(first, first + len(self.joints))
        return out

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
        if self._limited:
            lower[self._linear] = self.model.lowerPositionLimit[self._linear_q]
            upper[self._linear] = self.model.upperPositionLimit[self._linear_q]
        return lower, upper

    def joint_of(self, coordinate: int) -> str:
        """Name of the joint that a coordinate belongs to."""
        return str(self.model.names[joint_at(self.model, coordinate)])

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

    def _held(self, q: Array, gears: Sequence[Gear]) -> tuple[Bools, Bools]:
        """Which coordinates (nv,) and which links (k,) nothing but prescribed motion moves at q, or nothing at all."""
        nv = self.model.nv
        if not (self.driven or gears):
            return np.zeros(nv, np.bool_), np.zeros(len(self.joints), np.bool_)
        q = self.close(q)
        F = factored(self.model, self.data, q)[1]
        # Without driven joints loops leave a freedom that a dead centre at q may hide; gears are the same everywhere.
        Z = self._restrict(q, F).Z if self.driven else admissible(GearGaps(self.model, gears).rows, F)[0]
        J = self.links(q).J
        fields = np.einsum("ij,kj,jy->kiy", J, self.support, Z)
        # Of what constraints leave free a velocity of 1 is that of unit kinetic energy: no mass is so large.
        return np.array((np.abs(Z) <= HELD).all(axis=1)), np.array((np.abs(fields) <= HELD).all(axis=(1, 2)))

    def start(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Initial configuration and velocity with closed loops and driven joints at their speed."""
        v = v.copy()
        for row, motion in zip(self._driven_rows, self.driven, strict=True):
            v[row > 0.0] = motion.rate(0.0)
        return self.close(q), v

    def speeding(self, v: Array, rates: Array) -> Array:
        """Changes of v that bring the driven joints to their rates, shape (nv,), rad/s or m/s; 0 of others."""
        return np.asarray(self._driven_rows.T @ (rates - self._driven_rows @ v), dtype=float)

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
        linear, angular = np.empty(links.x.shape), np.empty(links.x.shape)
        _links.twists(links.x, self.support, links.J, v, linear, angular)
        return linear, angular

    def close(self, q: Array) -> Array:
        """The closest configuration whose loops are closed; q itself when they are."""
        return q if self._closures is None else self._closures.close(q, self._driven_rows)

    def pushed(self, q: Array, body: str, force: Array, torque: Array) -> tuple[Array, Array]:
        """What a force [N] at the origin of a body's frame and a torque [N m] do at q; world axes.

        Jᵀ (force, torque), shape (nv,), and what of `TreeLoads.wrenches` they are, shape (njoints - 1, 6).
        """
        frame, wrenches = self.bodies[body], np.zeros((self.model.njoints - 1, 6))
        J = pin.computeFrameJacobian(self.model, self.data, q, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1, order="A")
        pin.framesForwardKinematics(self.model, self.data, q)
        moment = torque + np.cross(self.data.oMf[frame].translation, force)
        wrenches[self.model.frames[frame].parentJoint - 1] = *force, *moment
        return J.T @ np.concatenate((force, torque)), wrenches

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
        return move(self.model, self._rate(self._weightless, self._zero, self._steady), q, v, h, turn, COARSER)

    def _rate(self, model: pin.Model, tau: Array, driven: Array) -> Rate:
        """Accelerations of a tree without loops under joint forces, whose driven joints accelerate as said."""
        data, rows = self.data, self._driven_rows
        if not self.driven:
            return lambda q, v: (pin.aba(model, data, q, v, tau), 0.0)

        def rate(q: Array, v: Array) -> tuple[Array, float]:
            a = pin.forwardDynamics(model, data, q, v, tau, rows, -driven)
            return a, float(data.lambda_c @ (rows @ v))

        return rate

    def _restrict(self, q: Array, F: Array) -> Constraints:
        """The constraints at q, where M⁻¹ = Fᵀ F."""
        loops = np.empty((0, self.model.nv)) if self._closures is None else self._closures.at(q)[1]
        B = np.concatenate((loops, self._driven_rows))
        Z, P = admissible(B, F)
        return Constraints(B, P, Z)

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
        M = np.array(pin.crba(self.model, self.data, middle, pin.Convention.WORLD), ndmin=2)
        return Halfway(q, v, middle, v0, work, M, self._links(middle), h, theta)

    def free_motion(
        self,
        halfway: Halfway,
        t: float,
        control: Control | None,
        applied: tuple[Array, Array] | None,
        last: Array | None = None,
    ) -> FreeMotion:
        """Velocity after the forces of a step without contacts and joint rows.

        M̃ (v' - v0) = h (f - g): gravity terms g at the midpoint, and f the joint forces for v' = v0. Damping, springs
        and PD control are linear in v', as `nsdyn.PD` has it with α and β, and make the effective mass matrix
        M̃ = M + h β D + h² α² K. For α = ½ a spring neither gains nor loses energy, and any stiffness is stable as long
        as its vibrations turn nothing by a radian in a step; α = ½ + Δ and β = ½ + Γ are the same with the inertia
        h D Γ + h² K Δ² and the damping 2 h K Δ more, so that they are stable too, and damp, at first order in h. θ says
        nothing of the motion without forces but how it is parted, (1 - θ) h before them and θ h after. Of a tree with
        loops or driven joints B v' = b holds too. Actuators beyond their limits have rows, see `within_limits`.

        Parameters
        ----------
        halfway : Halfway
        t : float
            Time at the end of the step, s.
        control : Control, optional
            As `Actuators.controls` makes it.
        applied : (ndarray, ndarray), optional
            `push` and `wrenches` of `TreeLoads`.
        last : ndarray, shape (nv, 3), optional
            Last impulses of the rows of actuators: what was at its limit is left to its row again.

        Raises
        ------
        ValueError
            Where a joint moves no mass.
        """
        (law, limited, implicit), n = control or self._no_control, halfway.v.size
        laws = np.empty((2, 5, n))
        step = halfway.links.angle, self._round, halfway.h, halfway.theta
        _trees.linear_laws(halfway.M, self._laws, law, *step, laws)
        push, wrenches = applied or (self._zero, None)
        weight = pin.computeGeneralizedGravity(self.model, self.data, halfway.q)
        rates = np.array([motion.rate(t) for motion in self.driven]) if self.driven else self._zero[:0]
        limit = law[-1] if limited else None
        loads = TreeLoads(laws, push, wrenches, weight, rates, limit, None, self._zero, implicit or self._implicit)
        free = self._respond(halfway, loads)
        return self.within_limits(halfway, free, free.v, last)

    def within_limits(self, halfway: Halfway, free: FreeMotion, v: Array, last: Array | None = None) -> FreeMotion:
        """The same with rows for actuators that the velocity v after the forces brings beyond their limits.

        And for those that were at their limits in the `last` impulses of their rows, (nv, 3). `free` itself if none.
        """
        limit = free.loads.limit
        if limit is None:
            return free
        over, last = np.empty(v.size, np.bool_), self._no_impulses if last is None else last
        if not _trees.strained(free.loads.laws, limit, last, halfway.v, v, halfway.h, over):
            return free
        loads = left_to_rows(halfway, free.loads, limit, np.diag(free.minv), v, over)
        out = self._respond(halfway, loads)
        return out._replace(foreseen=out.v + halfway.h * (out.minv @ loads.held))

    def _respond(self, halfway: Halfway, loads: TreeLoads) -> FreeMotion:
        """What loads do in a step; ValueError where a joint moves no mass."""
        v0, M, h = halfway.v, halfway.M, halfway.h
        n = v0.size
        factor, m, minv, v = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty(n)
        if not _trees.implicit(M, loads.laws, h, factor, m, minv):
            raise indefinite(self.model, M)
        start, constraints = v0, None
        if self.constrained:
            constraints = B, P, Z = self._restrict(halfway.q, factor)
            minv, b = Z @ Z.T, np.zeros(len(B))
            b[b.size - len(self.driven) :] = loads.rates
            start = minv @ (m @ v0) + P @ b
        _trees.respond(start, minv, loads.laws, loads.push, loads.weight, v0, h, v)
        return FreeMotion(v, v, loads, m, minv, constraints)

    def inertia(self, q: Array, v: Array) -> FreeMotion:
        """What nothing does at a configuration: the mass matrix that impacts meet, on loops and driven joints."""
        M, factor, minv = factored(self.model, self.data, q)
        zero = self._zero
        rates = np.zeros(len(self.driven))
        loads = TreeLoads(np.zeros((2, 5, v.size)), zero, None, zero, rates, None, None, zero, False)
        if not self.constrained:
            return FreeMotion(v, v, loads, M, minv, None)
        constraints = self._restrict(q, factor)
        return FreeMotion(v, v, loads, M, constraints.Z @ constraints.Z.T, constraints)

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
                tau = loads.laws[1, 4] + loads.push
                driven = self._driven_rows @ (v - begin_v) / h if self.driven else self._steady
                rate = self._rate(self.model, tau, driven)
                return TreeEnd(*move(self.model, rate, halfway.begin, begin_v, h, max(turn, begin_turn)), True)
        q, v1, _, work = self.flow(halfway.q, v, theta * h)
        return TreeEnd(q, v1, 0.5 * (halfway.v + v), halfway.work + work, False)

    def forces(self, halfway: Halfway, free: FreeMotion, v: Array) -> Array:
        """Actuation, damping and springs of a step whose forces leave the velocity v, shape (3, nv), N m or N."""
        out = np.empty((3, v.size))
        _trees.forces(free.loads.laws, free.loads.push, halfway.v, v, halfway.h, out)
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
        joints: Array,
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
        joints : ndarray, shape (6, n)
            Of the scene, where rows 0, 3 and 5 are for impulses of actuation, of external wrenches, and the most that
            actuators may give, N m s or N s.
        """
        h, loads = halfway.h, free.loads
        limit = self._no_control.law[-1] if loads.limit is None else loads.limit
        velocities, start = (halfway.v, v), self.coordinates.start
        actuation, damping, pushed = _trees.works(
            loads.laws, loads.push, limit, velocities, end.mean, impulse, h, start, joints
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
        return TreeWorks(kinetic, potential, change, actuation, damping, constraint, integration, projection)

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """(kinetic, potential) energy in J, potential of gravity and of joint springs."""
        pin.computeMechanicalEnergy(self._bare, self.data, q, v)
        kinetic, potential = float(self.data.kinetic_energy), float(self.data.potential_energy)
        if self._armoured:
            kinetic += 0.5 * float(v @ (self._armature * v))
        if self._springs:
            deviation = self._deviation(self.angle(q), self.rest)
            potential += 0.5 * float(deviation @ (self.stiffness * deviation))
        return kinetic, potential

    def bias(self, q: Array, v: Array) -> Array:
        """Coriolis, centrifugal and gravity terms, shape (nv,), N m or N."""
        return np.array(pin.nonLinearEffects(self.model, self.data, q, v))


def _radii(articulation: Articulation, joints: list[int]) -> Array:
    """Radius about the frame of each joint that holds the shapes it carries, (len(joints),), m."""
    out = np.zeros(len(joints))
    for _, joint, placement, shape in articulation.links:
        if joint in joints:
            k = joints.index(joint)
            out[k] = max(out[k], float(np.linalg.norm(placement.translation)) + shape.bounding_radius)
    return out
