"""Motion of one articulated tree: forces of its joints, their effect in a step, and its free flow."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from nsdyn._kernels.dynamics import trees as _trees
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.dynamics.actuators import Control, left_to_rows
from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.linkages import Linkage
from nsdyn.dynamics.loops import factored, indefinite
from nsdyn.dynamics.runge_kutta import COARSER, TOLERANCE, Rate, fastest, move
from nsdyn.dynamics.sliding import slide
from nsdyn.dynamics.values import Flow, FreeMotion, TreeLoads, TreeMidpoint
from nsdyn.scene.articulations import Articulation
from nsdyn.scene.exclusions import FREE
from nsdyn.scene.prescribed import Motion
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.displacements import integrate

ROUND_OFF = 1e-12
"""Of potential energy, as a share of it."""


class Tree(Linkage):
    """Motion of one articulated tree under its loads; the parameters are those of `Linkage`.

    Attributes
    ----------
    turns : ndarray of bool, shape (nv,)
        Coordinates about which links turn; along all others links only shift.
    floats : bool
        Whether nothing but a free joint connects the tree with the world: no internal force changes its momenta.
    """

    def __init__(
        self, articulation: Articulation, gravity: Array, joints: list[int], driven: dict[int, Motion]
    ) -> None:
        super().__init__(articulation, gravity, joints, driven)
        a, nv = articulation, self.model.nv
        self._weightless = self.model.copy()
        self._weightless.gravity = pin.Motion.Zero()
        # Pinocchio's kinetic energy leaves out the armature of joints whose axes are not along a coordinate axis.
        self._bare, self._armature = self.model.copy(), a.armature
        self._bare.armature = np.zeros(nv)
        self._fall: float = 0.5 * pin.computeTotalMass(self.model) * float(gravity @ gravity)  # J/s²
        self._laws = np.array((a.stiffness, a.damping, a.rest))
        self._springs = bool(a.stiffness.any())
        self._implicit = self._springs or bool(a.damping.any())
        self._no_control, self._no_impulses = Control.none(nv), np.zeros((nv, 3))
        self._steady = np.zeros(len(driven))
        self._zero = np.zeros(nv)  # not read-only: for a read-only array all kernels would be compiled once more
        pin.computeJointJacobians(self.model, self.data, pin.neutral(self.model))
        self.turns: Bools = (self._J[3:] != 0.0).any(axis=0)
        base = min(1, self.model.njoints - 1)  # a file may have no joint
        self._placement = self.model.jointPlacements[base].rotation.copy()
        self.floats = (
            base == 1
            and self.model.joints[1].shortname() == FREE
            and list(self.model.parents).count(0) == 2  # the world counts itself
            and all(loop.joint1 and loop.joint2 for loop in a.loops)
            and not (self.driven_at < 6).any()
        )

    def flow(self, q: Array, v: Array, h: float) -> Flow:
        """Motion for h s without forces; loops stay closed, and driven joints keep their speed.

        A tree without loops is moved by `move`, to fourth order; a tree with loops by `slide`, to second order. If the
        tree turns by less than `TOLERANCE`, its joints move at constant velocity.
        """
        speed, turn = _trees.fastest(v, self.turns)
        if h * turn <= TOLERANCE:
            there = q if speed == 0.0 else self.close(integrate(self.model, q, h * v))
            # Slow motion changes momenta by no more than round-off.
            return Flow(there, self.lift(q, there, v) if h * speed > TOLERANCE else v, v, 0.0)
        if not speed < np.inf:
            raise ArithmeticError(f"in {self.name!r} {fastest(self.model, v)}")
        if self.closures is not None:
            out = slide(self._weightless, self.data, self.closures, q, v, h)
        else:
            out = move(self.model, self._rate(self._weightless, self._zero, self._steady), q, v, h, turn, COARSER)
        return self._with_momenta(q, v, h, out) if self.floats else out

    def _with_momenta(self, q: Array, v: Array, h: float, end: Flow, fallen: Array | float = 0.0) -> Flow:
        """Return the end of a motion of h s with the momenta, and the centre of mass, of motion under gravity alone.

        Errors of the motion change them a little. The whole tree gets the differences as one rigid body: only its base
        moves otherwise.

        Parameters
        ----------
        q, v : ndarray, shapes (nq,), (nv,)
            Where the motion begins.
        h : float
            s.
        end : Flow
            Where it ends, but for its errors.
        fallen : ndarray, shape (3,), optional
            Velocity that gravity adds to the centre of mass, m/s.
        """
        momenta, data = pin.computeCentroidalMomentum(self.model, self.data, q, v).vector, self.data
        centre = data.com[0] + h * (momenta[:3] / data.mass[0] + 0.5 * fallen)
        momenta[:3] += data.mass[0] * fallen
        q1, v1 = self._carried(end.q, end.v, momenta, centre)
        return end._replace(q=q1, v=v1)

    def _carried(self, q: Array, v: Array, momenta: Array, centre: Array | None = None) -> tuple[Array, Array]:
        """Return a state with `momenta` (6,) about the centre of mass, which is brought to `centre`."""
        data, q, v = self.data, q.copy(), v.copy()
        pin.ccrba(self.model, data, q, v)
        way = np.zeros(3) if centre is None else centre - data.com[0]
        whole = data.Ig.inertia, data.mass[0], data.com[0]
        _trees.carry(momenta - data.hg.vector, way, whole, (self._x, self._R, self._placement), q, v)
        return q, v

    def lift(self, q: Array, lifted: Array, v: Array) -> Array:
        """Velocity after a small displacement from q to `lifted`: v, but what floats keeps its momenta."""
        if not self.floats or np.array_equal(q, lifted):
            return v
        return self._carried(lifted, v, pin.computeCentroidalMomentum(self.model, self.data, q, v).vector)[1]

    def _rate(self, model: pin.Model, tau: Array, driven: Array) -> Rate:
        """Accelerations of a tree without loops under the joint forces tau; `driven` has those of its driven joints."""
        data, rows = self.data, self._driven_rows
        if not self.driven:
            return lambda q, v: (pin.aba(model, data, q, v, tau), 0.0)

        def rate(q: Array, v: Array) -> tuple[Array, float]:
            a = pin.forwardDynamics(model, data, q, v, tau, rows, -driven)
            return a, float(data.lambda_c @ (rows @ v))

        return rate

    def halfway(self, q: Array, v: Array, h: float, theta: float) -> TreeMidpoint:
        """Midpoint of a step of h s from (q, v), where its forces act: after (1 - θ) h of motion without forces."""
        middle, v0, _, work, _ = self.flow(q, v, (1.0 - theta) * h)
        M = np.array(pin.crba(self.model, self.data, middle, pin.Convention.WORLD), ndmin=2)
        return TreeMidpoint(q, v, middle, v0, work, M, self._links(middle), h, theta)

    def free_motion(
        self,
        halfway: TreeMidpoint,
        t: float,
        control: Control | None,
        applied: tuple[Array, Array] | None,
        last: Array | None = None,
    ) -> FreeMotion:
        """Velocity after the forces of a step without contacts and joint rows; ValueError if a joint moves no mass.

        M̃ (v' - v0) = h (f - g), with the gravity terms g at the midpoint, and the joint forces f for v' = v0. Damping,
        springs and PD control are linear in v'; `nsdyn.PD` defines their α and β. They make the effective mass matrix
        M̃ = M + h β D + h² α² K.

        For α = ½ a spring neither gains nor loses energy. Any stiffness is then stable, as long as its vibrations turn
        nothing by a radian in a step. α = ½ + Δ and β = ½ + Γ act like additional inertia h D Γ + h² K Δ² and
        additional damping 2 h K Δ. They are therefore stable too, and damp, at first order in h. On the motion without
        forces, θ has one effect only: it is divided into (1 - θ) h before the forces and θ h after them.

        In a tree with loops or driven joints B v' = b holds too. Actuators beyond their limits have rows, see
        `within_limits`.

        Parameters
        ----------
        halfway : TreeMidpoint
        t : float
            Time at the end of the step, s.
        control : Control, optional
            As `Actuators.controls` makes it.
        applied : (ndarray, ndarray), optional
            `push` and `wrenches` of `TreeLoads`.
        last : ndarray, shape (nv, 3), optional
            Last impulses of the rows of actuators: an actuator that was at its limit gets its row again.
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
        return self.within_limits(halfway, free, halfway.v, free.v, last)

    def within_limits(
        self, halfway: TreeMidpoint, free: FreeMotion, before: Array, v: Array, last: Array | None = None
    ) -> FreeMotion:
        """Return the motion with rows for actuators that the velocity v after the forces brings beyond their limits.

        `before` (nv,) is the velocity before the forces, after impacts captured at the midpoint. Actuators at their
        limits in the `last` impulses of their rows, (nv, 3), have rows too. Return `free` itself if no actuator needs a
        row.
        """
        limit = free.loads.limit
        if limit is None:
            return free
        over, last = np.empty(v.size, np.bool_), self._no_impulses if last is None else last
        if not _trees.strained(free.loads.laws, limit, last, before, v, halfway.h, over):
            return free
        loads = left_to_rows(halfway.h, free, before, v, over)
        out = self._respond(halfway, loads)
        return out._replace(foreseen=out.v + halfway.h * (out.minv @ loads.held))

    def _respond(self, halfway: TreeMidpoint, loads: TreeLoads) -> FreeMotion:
        """Motion under the loads of a step without contacts and joint rows; ValueError if a joint moves no mass."""
        v0, h, acting, constraints = halfway.v, halfway.h, (loads.laws, loads.push, loads.weight), None
        n = v0.size
        factor, m, minv, v = np.empty((n, n)), np.empty((n, n)), np.empty((n, n)), np.empty(n)
        if not _trees.move_free(halfway.M, acting, v0, h, factor, m, minv, v):
            raise indefinite(self.model, halfway.M)
        if self.constrained:
            constraints = B, P, Z = self._restrict(halfway.q, factor)
            minv, b = Z @ Z.T, np.zeros(len(B))
            b[b.size - len(self.driven) :] = loads.rates
            _trees.respond(minv @ (m @ v0) + P @ b, minv, acting, v0, h, v)
        return FreeMotion(v, v, loads, v0, m, minv, constraints)

    def drag(self, halfway: TreeMidpoint, free: FreeMotion, v: Array) -> Array:
        """Part of the change of velocity by the forces that is due to the velocity v (nv,) before them."""
        h = halfway.h
        k, d, alpha, _, _ = free.loads.laws.swapaxes(0, 1)
        return -h * free.minv @ ((d + h * (2.0 * alpha - 1.0) * k).sum(axis=0) * v)

    def inertia(self, q: Array, v: Array) -> FreeMotion:
        """Motion without loads, for impacts: mass matrix at a configuration, with its loops and driven joints."""
        M, factor, minv = factored(self.model, self.data, q)
        zero, constraints = self._zero, self._restrict(q, factor) if self.constrained else None
        if constraints is not None:
            minv = constraints.Z @ constraints.Z.T
        rates = np.zeros(len(self.driven))
        loads = TreeLoads(np.zeros((2, 5, v.size)), zero, None, zero, rates, None, None, zero, False)
        return FreeMotion(v, v, loads, v, M, minv, constraints)

    def end(self, halfway: TreeMidpoint, free: FreeMotion, v: Array, pushed: bool) -> Flow:
        """End of a step whose forces leave the velocity v.

        The tree moves on without forces for θ h. There is one exception: a tree without loops that nothing has
        `pushed`, no contact and no joint row, and on which only gravity and given joint forces act. It ends at the end
        of a fourth-order motion from the beginning of the step, which is the same to O(h³). A tree at rest, with v and
        the velocity before it 0, does not move.
        """
        h, theta, loads, begin_v = halfway.h, halfway.theta, free.loads, halfway.begin_v
        if not (pushed or loads.implicit or self.closures is not None):
            begin_speed, begin_turn = _trees.fastest(begin_v, self.turns)
            speed, turn = _trees.fastest(v, self.turns)
            if h * max(speed, begin_speed) > TOLERANCE:
                tau = loads.laws[1, 4] + loads.push
                driven = self._driven_rows @ (v - begin_v) / h if self.driven else self._steady
                rate = self._rate(self.model, tau, driven)
                out = move(self.model, rate, halfway.begin, begin_v, h, max(turn, begin_turn))._replace(whole=True)
                if self.floats and not tau[:6].any():
                    fallen = h * self.model.gravity.linear
                    out = self._with_momenta(halfway.begin, begin_v, h, out, fallen)
                return out
        q, v1, _, work, _ = self.flow(halfway.q, v, theta * h)
        return Flow(q, v1, 0.5 * (halfway.v + v), halfway.work + work)

    def forces(self, halfway: TreeMidpoint, free: FreeMotion, v: Array) -> Array:
        """Actuation, damping and springs of a step whose forces leave the velocity v, shape (3, nv), N m or N."""
        out = np.empty((3, v.size))
        _trees.forces(free.loads.laws, free.loads.push, free.before, v, halfway.h, out)
        return out

    def works(
        self,
        halfway: TreeMidpoint,
        free: FreeMotion,
        v: Array,
        end: Flow,
        lifted: tuple[Array, Array],
        impulse: Array,
        before: tuple[float, float],
        joints: Array,
    ) -> tuple[Works, tuple[float, float]]:
        """The tree's part in the ledger of a step, and its (kinetic, potential) energy at the end, J.

        Parameters
        ----------
        halfway : TreeMidpoint
        free : FreeMotion
        v : ndarray, shape (nv,)
            Velocity after the forces.
        end : Flow
        lifted : (ndarray, ndarray)
            State (q, v) after the position projection, with end.q itself without one.
        impulse : ndarray, shape (nv,)
            H r of contacts and joint rows.
        before : (float, float)
            Energies at the beginning, J.
        joints : ndarray, shape (8, coordinates of all trees)
            Impulses on all joints of the scene, N m s or N s. Those of actuation are written into row 0, those of
            external wrenches into row 3, and the largest that the actuators may give into row 5.
        """
        h, loads = halfway.h, free.loads
        limit = self._no_control.law[-1] if loads.limit is None else loads.limit
        acting, velocities, start = (loads.laws, loads.push, limit), (free.before, v), self.columns.start
        actuation, damping, pushed = _trees.works(acting, velocities, end.mean, impulse, h, start, joints)
        constraint = 0.0
        if free.constraints is not None:
            # Bᵀ λ is the part of the impulse that only the constraints can explain.
            B, P, _ = free.constraints
            constraint = end.work
            if not end.whole:
                force = self.forces(halfway, free, v).sum(axis=0) - loads.weight
                reaction = P.T @ (halfway.M @ (v - halfway.v) - h * force - impulse)
                constraint += float((B @ end.mean) @ reaction)
        after = self.energies(end.q, end.v)
        last = after if lifted[0] is end.q else self.energies(*lifted)
        # The changes are added in the order of the ledger. Its round-off is then that of the changes, not of the
        # energies.
        projection = (last[0] - after[0]) + (last[1] - after[1])
        integration = (after[0] - before[0]) + (after[1] - before[1]) - actuation - damping - constraint - pushed
        return Works(actuation, 0.0, 0.0, damping, constraint, integration, projection), last

    def strays(
        self,
        halfway: TreeMidpoint,
        free: FreeMotion,
        v: Array,
        end: Flow,
        before: tuple[float, float],
        integration: float,
    ) -> bool:
        """Return whether numerics add more energy to a move, or take more, than `Options.stray` allows.

        Springs count as forces, like those of a control. With θ > ½ losses are wanted and do not count.

        Parameters
        ----------
        halfway : TreeMidpoint
        free : FreeMotion
        v : ndarray, shape (nv,)
            Velocity after the forces and impulses, rad/s and m/s.
        end : Flow
            Where the move ends.
        before : (float, float)
            Kinetic and potential energy where it begins, J.
        integration : float
            Energy that numerics add, J.
        """
        if self._springs:
            begun, ended = (_trees.strain(self.angle(q), self._laws, self._round) for q in (halfway.begin, end.q))
            integration -= ended - begun + halfway.h * float(self.forces(halfway, free, v)[2] @ end.mean)
        added = integration if halfway.theta > 0.5 else abs(integration)
        # Mostly the first comparison decides.
        least = max(before[0], self._fall * halfway.h**2)
        return added > OPTIONS.stray * least and added > OPTIONS.stray * self.at_play(halfway, free, before)

    def at_play(self, halfway: TreeMidpoint, free: FreeMotion, before: tuple[float, float]) -> float:
        """Return the kinetic energy with which an error of energy in a move compares, J.

        It is the largest of those at the beginning, of a fall as long as the move, and of what the forces give from
        rest; or round-off of the potential energy. `before` has the (kinetic, potential) energy at the beginning.
        """
        (kinetic, potential), given = before, self.energies(halfway.begin, free.foreseen - halfway.v)[0]
        return max(kinetic, given, self._fall * halfway.h**2) + ROUND_OFF / OPTIONS.stray * abs(potential)

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """(kinetic, potential) energy in J; potential energy of gravity and of joint springs."""
        pin.computeMechanicalEnergy(self._bare, self.data, q, v)
        kinetic, potential = float(self.data.kinetic_energy), float(self.data.potential_energy)
        kinetic += 0.5 * float(v @ (self._armature * v))
        if self._springs:
            potential += _trees.strain(self.angle(q), self._laws, self._round)
        return kinetic, potential

    def bias(self, q: Array, v: Array) -> Array:
        """Coriolis, centrifugal and gravity terms, shape (nv,), N m or N."""
        return np.array(pin.nonLinearEffects(self.model, self.data, q, v))
