"""Mass matrices, flows, forces and contact Jacobians of a scene: functions of values, which keep nothing.

Free bodies are batched in arrays; each articulated tree has its own Pinocchio model. The velocity is one vector v
(n,) in blocks: 6 per free body (linear in world axes, angular in body axes), then nv per tree. Bodies that move as
prescribed have a frame, but no block.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from operator import is_
from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn._kernels import reductions as _few
from nsdyn._kernels.dynamics import links as _links
from nsdyn._kernels.dynamics import motion as _motion
from nsdyn._kernels.dynamics.rotation import principal
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.actuators import Actuators, Control
from nsdyn.dynamics.forests import parts
from nsdyn.dynamics.joints import NO_CLUTCHES, JointLaws, JointRows, Rows
from nsdyn.dynamics.surfaces import Surfaces
from nsdyn.dynamics.tree_values import FreeMotion, Links, TreeEnd
from nsdyn.dynamics.trees import Tree
from nsdyn.dynamics.values import Energies, Forces, Middle, Placement, Position
from nsdyn.problem.blocks import Blocks
from nsdyn.scene.control import Axes
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import choice, unknown

__all__ = ["Controls", "Dynamics", "Wrenches"]

NOTHING: Mapping[Any, Any] = {}
Wrenches = tuple[Array, Array, Mapping[int, tuple[Array, Array]]]
Controls = Mapping[int, Control]
NONE, NO_VECTORS = np.empty(0), np.empty((0, 3))


def _rotation(quaternion: Array) -> Array:
    """Rotation matrix of a unit quaternion xyzw."""
    return np.array(pin.Quaternion(quaternion).toRotationMatrix())


def _mapping(given: Any, what: str) -> Mapping[str, Any]:
    """What a callback returned, checked."""
    if not isinstance(given, (dict, Mapping)):  # a dict is known at once
        raise ValueError(f"{what} must return a mapping of names, got {given!r}")
    return given


class Dynamics:
    """Equations of motion of a scene between contacts.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    held : ndarray of bool, shape (frames,)
        Frames that nothing but prescribed motion moves.
    prescribed : bool
        Whether there are such frames or joint coordinates.
    node : ndarray of int, shape (frames + 1,)
        Block of coordinates that moves each frame, -1 for none, as for the world, which is the last.
    """

    def __init__(self, scene: Scene) -> None:
        bodies, frames, driven = scene.free_bodies, scene.link_frames(), scene.driven_bodies
        self.gravity: Array = np.array(scene.gravity)
        self.weight = float(np.linalg.norm(self.gravity))
        self.surfaces, self._driven = Surfaces(scene), len(driven)
        self.names = {b.name: k for k, b in enumerate(bodies)}
        self._forests: dict[str, tuple[int, Actuators]] = {}
        trees: list[Tree] = []
        for name, a in scene.articulations.items():
            driven_joints = {
                a.model.getJointId(joint): m
                for key, m in scene.motions.items()
                for owner, _, joint in [key.partition("/")]
                if owner == name and m.kind == "joint"
            }
            forest, planted = parts(a), len(trees)
            for part in forest:
                before = part.joints.start - 1
                joints = [joint - before for owner, joint in frames if owner == name and joint in part.joints]
                motions = {
                    a.model.idx_vs[joint] - part.v.start: m
                    for joint, m in driven_joints.items()
                    if joint in part.joints
                }
                trees.append(Tree(part.articulation, self.gravity, joints, motions))
            scalar = np.concatenate([t.scalar for t in trees[planted:]])
            axes = Axes.of(name, a.model, scalar, a.coordinates)
            self._forests[name] = planted, Actuators(axes, a.effort, [part.v for part in forest], a.actuators)
        mass, J = np.array([b.mass for b in bodies]), np.array([b.inertia for b in bodies]).reshape(-1, 3, 3)
        radius = np.array([b.shape.bounding_radius + float(np.linalg.norm(b.com)) for b in bodies])
        m, minv = np.zeros((2, mass.size, 6, 6))
        of_mass, eye = mass[:, None, None], np.eye(3)
        inverse = np.linalg.inv(J)
        m[:, :3, :3], m[:, 3:, 3:] = of_mass * eye, J
        minv[:, :3, :3], minv[:, 3:, 3:] = eye / of_mass, 0.5 * (inverse + inverse.swapaxes(1, 2))
        self._compose((mass, J, radius, *principal(J), m, minv), trees)
        self._bodies = {f"{t.name}/{body}": k for k, t in enumerate(self.trees) for body in t.bodies}
        starts = [t.start(t.articulation.q, t.articulation.v) for t in self.trees]
        self._start = (
            Position(
                np.array([b.position for b in bodies]).reshape(-1, 3),
                np.array([b.quaternion for b in bodies]).reshape(-1, 4),
                tuple(q for q, _ in starts),
                np.array([b.position for b in driven]).reshape(-1, 3),
                np.array([b.quaternion for b in driven]).reshape(-1, 4),
            ),
            np.concatenate([self._velocity(b) for b in bodies] + [v for _, v in starts] + [np.empty(0)]),
        )

    def only(self, bodies: Index, trees: Index, geoms: Index) -> Dynamics:
        """Those of some free bodies and trees, and of what moves as prescribed, which nothing else moves.

        The shapes of all these are `geoms`, ascending, and counted anew.
        """
        out = copy(self)
        out.surfaces = self.surfaces.only(geoms)
        out._compose(tuple([a[bodies] for a in self._own]), [self.trees[k] for k in trees.tolist()])
        return out

    def during(self, t: float, h: float) -> Dynamics:
        """The same with surfaces whose velocities change linearly in the h s from t on."""
        if not self.surfaces.count:
            return self
        out = copy(self)
        out.surfaces = self.surfaces.during(t, h)
        return out

    def _compose(self, own: tuple[Array, ...], trees: list[Tree]) -> None:
        """The layout of coordinates and frames, and all that follows from it and what free bodies have of their `own`.

        That is their masses, inertias, radii, principal moments and axes, M and its inverse.
        """
        self._own, (self.mass, self.J, self.radius, *self._principal, m, minv) = own, own
        mass, self.free, self.trees = self.mass, self.mass.size, []
        start, first = 6 * self.free, self.free
        for t in trees:
            self.trees.append(t.at(start, first))
            start, first = start + t.model.nv, first + len(t.joints)
        self.frames = first + self._driven
        self.nowhere, self.no_works = np.zeros(self.frames), np.zeros(self.free)
        self._inverse_mass, self.no_load = 1.0 / mass, np.zeros((self.free, 3))
        # One robot, and nothing else that moves but surfaces in themselves: its arrays are those of the scene.
        self._lone = len(trees) == 1 and not self.free and not self._driven
        self._constrained = any(t.constrained for t in trees)
        sizes = [6] * self.free + [t.model.nv for t in trees]
        self.offset = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self.m_start = np.concatenate(([0], np.cumsum(np.square(sizes)))).astype(np.int64)[:-1]
        owner = [self.free + k for k, t in enumerate(trees) for _ in t.joints]
        self.block_of_frame = np.array([*range(self.free), *owner, *([-1] * self._driven)], dtype=np.int64)
        self.node = np.append(self.block_of_frame, -1)
        self.n = int(self.offset[-1])
        self._m, self._minv = m.ravel(), minv.ravel()
        self.masses = self.block_of_frame, self.offset, self.m_start, self._m, self._minv
        self.inverse_J = np.ascontiguousarray(minv[:, 3:, 3:])
        self.bodies = *self._principal, self._inverse_mass, self.inverse_J, self.radius
        self.no_impulses = NO_VECTORS, np.zeros((7, self.n))
        self.links, self.no_push = sum(t.model.njoints - 1 for t in self.trees), np.zeros((0, 6))
        self.joints = JointLaws(self.trees, self.free)
        self._slots = [self.joints.actuators(t.coordinates) for t in self.trees]
        self.held = np.concatenate(
            [np.zeros(self.free, np.bool_), *(t.held_links for t in self.trees), np.ones(self._driven, np.bool_)]
        )
        self.prescribed = bool(self.held.any()) or any(bool(t.held.any()) for t in self.trees)
        self.alone = self.frames == self.free and not self.trees and not self.surfaces.count

    @staticmethod
    def _velocity(body: Any) -> Array:
        return np.concatenate((body.linear_velocity, _rotation(body.quaternion).T @ body.angular_velocity))

    def start(self) -> tuple[Position, Array]:
        """Initial position and velocity of the scene."""
        return self._start

    # -- configurations ----------------------------------------------------------------------------------------

    def halfway(self, position: Position, v: Array, h: float, theta: float, twist: Array) -> Middle:
        """Where the forces of a step of h act: after (1 - θ) h of motion without any, Φ.

        Free bodies move on straight lines and rotate without torque, trees as `Tree.flow` has it, driven bodies with
        `twist` (surfaces, 2, 3), linear and angular velocities in world axes.
        """
        ahead = (1.0 - theta) * h
        if self._lone:
            only = self.trees[0].halfway(position.trees[0], v, h, theta)
            return Middle(position.bent(only.q), only.v, Placement.of(only.links), (only,))
        x, quaternion, after, X, R = self._flow(position, v, ahead)
        if self.frames == self.free and not self.trees:
            there = Position(x, quaternion, (), position.driven_x, position.driven_quaternion)
            return Middle(there, after, Placement(X, R, ()), ())
        halves = tuple(
            [t.halfway(q, v[t.coordinates], h, theta) for t, q in zip(self.trees, position.trees, strict=True)]
        )
        for t, half in zip(self.trees, halves, strict=True):
            after[t.coordinates] = half.v
        driven = self.surfaces.advance(position.driven_x, position.driven_quaternion, ahead * twist)
        there = Position(x, quaternion, tuple([half.q for half in halves]), *driven)
        return Middle(there, after, self._with_others(there, X, R, [half.links for half in halves]), halves)

    def end(
        self, middle: Middle, forces: Forces, v: Array, impulse: Array, h: float, twist: Array
    ) -> tuple[Position, Array, Placement, tuple[TreeEnd, ...]]:
        """(position, velocity, frames, trees) after h s without forces from the middle of a step, which left v there.

        The impulses H r (n,) of contacts and joint rows tell which trees are pushed.
        """
        position = middle.position
        if self._lone:
            free = forces.trees[0]
            pushed = free.loads.implicit or _few.largest(impulse) > 0.0
            only = self.trees[0].end(middle.trees[0], free, v, pushed)
            return position.bent(only.q), only.v, Placement.of(self.trees[0].links(only.q)), (only,)
        x, quaternion, after, X, R = self._flow(position, v, h)
        if self.frames == self.free and not self.trees:
            there = Position(x, quaternion, (), position.driven_x, position.driven_quaternion)
            return there, after, Placement(X, R, ()), ()
        ends = []
        for t, half, free in zip(self.trees, middle.trees, forces.trees, strict=True):
            pushed = free.loads.implicit or _few.largest(impulse[t.coordinates]) > 0.0
            ends.append(t.end(half, free, v[t.coordinates], pushed))
            after[t.coordinates] = ends[-1].v
        driven = self.surfaces.advance(position.driven_x, position.driven_quaternion, h * twist)
        there = Position(x, quaternion, tuple([e.q for e in ends]), *driven)
        links = [t.links(q) for t, q in zip(self.trees, there.trees, strict=True)]
        return there, after, self._with_others(there, X, R, links), tuple(ends)

    def _flow(self, position: Position, v: Array, h: float) -> tuple[Array, Array, Array, Array, Array]:
        """(x, quaternion, v) of free bodies after h s without forces, and all frames with theirs in place."""
        x, quaternion, after = np.empty((self.free, 3)), np.empty((self.free, 4)), v.copy()
        X, R = np.empty((self.frames, 3)), np.empty((self.frames, 3, 3))
        moments, axes = self._principal
        _motion.flow(moments, axes, position.x, position.quaternion, v, h, x, quaternion, after, X, R)
        return x, quaternion, after, X, R

    def shift(self, position: Position, step: Array) -> Position:
        """Position ⊕ a small displacement `step` (n,) in the coordinates of velocities, loops closed."""
        x, quaternion = np.empty((self.free, 3)), np.empty((self.free, 4))
        _motion.integrate(position.x, position.quaternion, step, 1.0, x, quaternion)
        moved = zip(self.trees, position.trees, strict=True)
        trees = tuple([t.close(pin.integrate(t.model, q, step[t.coordinates])) for t, q in moved])
        return Position(x, quaternion, trees, position.driven_x, position.driven_quaternion)

    def place(self, position: Position) -> Placement:
        """Frames and Jacobians at a position."""
        if self._lone:
            return Placement.of(self.trees[0].links(position.trees[0]))
        x, R = np.empty((self.frames, 3)), np.empty((self.frames, 3, 3))
        _motion.place(position.x, position.quaternion, x, R)
        links = [t.links(q) for t, q in zip(self.trees, position.trees, strict=True)]
        return self._with_others(position, x, R, links)

    def _with_others(self, position: Position, x: Array, R: Array, links: list[Links]) -> Placement:
        """The placement whose free bodies are in x and R."""
        if position.driven_x.size:
            nd = len(position.driven_x)
            _motion.place(position.driven_x, position.driven_quaternion, x[-nd:], R[-nd:])
        for t, at in zip(self.trees, links, strict=True):
            x[t.frames], R[t.frames] = at.x, at.R
        return Placement(x, R, tuple(links))

    def twists(self, place: Placement, v: Array) -> tuple[Array, Array]:
        """Velocities of the frames' origins and angular velocities, (frames, 3) each, world axes; 0 of driven ones."""
        if self._lone:
            return self.trees[0].twists(place.links[0], v)
        linear, angular = np.zeros((self.frames, 3)), np.zeros((self.frames, 3))
        if self.free:
            _motion.twists(place.R, v, self.free, linear, angular)
        for t, links in zip(self.trees, place.links, strict=True):
            own = linear[t.frames], angular[t.frames]
            _links.twists(links.x, t.support, links.J, v[t.coordinates], *own)
        return linear, angular

    def reach(self, place: Placement, v: Array, h: float, dt: float, twist: Array) -> Array:
        """How far any point of each frame's shapes moves in h seconds, m, shape (frames,); `dt` of them under gravity.

        Driven bodies move with `twist` (surfaces, 2, 3).
        """
        out = np.zeros(self.frames)
        fall = h * dt * self.weight
        if self.free:
            _motion.reach(v, h, fall, self.radius, out)
        for t, links in zip(self.trees, place.links, strict=True):
            at = links.x, t.support, links.J, v[t.coordinates], h, t.radius, fall
            _links.reach(*at, out[t.frames])
        if self.surfaces.count:
            self.surfaces.reach(h * np.abs(twist), out)
        return out

    # -- forces ------------------------------------------------------------------------------------------------

    def forces(
        self,
        middle: Middle,
        t: float,
        h: float,
        wrenches: Wrenches | None = None,
        control: Controls = NOTHING,
        last: Array | None = None,
    ) -> Forces:
        """What acts in a step: M̃ (v_f - v⁻) = h f̃.

        Parameters
        ----------
        middle : Middle
        t, h : float
            Time at the end of the step, and step, s.
        wrenches : (ndarray, ndarray, dict), optional
            As `wrenches` makes them.
        control : mapping
            As `controls` makes it.
        last : ndarray, shape (slots, 3), optional
            Last impulses of the joint rows.
        """
        force, torque, applied = wrenches or (self.no_load, self.no_load, NOTHING)
        out = np.empty(self.n)
        if self.free:
            _motion.accelerate(self._inverse_mass, self.inverse_J, self.gravity, force, torque, h, middle.v, out)
        if not self.trees:
            return Forces(out, out, force, torque, self._m, self._minv, ())
        motions = []
        for k, tree in enumerate(self.trees):
            before = None if last is None else last[self._slots[k]]
            motions.append(tree.free_motion(middle.trees[k], t, control.get(k), applied.get(k), before))
        return self._with_trees(out, force, torque, motions)

    def within_limits(self, middle: Middle, forces: Forces, v: Array) -> Forces:
        """The same where actuators that the velocity v (n,) after the forces brings beyond their limits have rows.

        The forces themselves where none is beyond.
        """
        motions = [
            tree.within_limits(half, free, v[tree.coordinates])
            for tree, half, free in zip(self.trees, middle.trees, forces.trees, strict=True)
        ]
        if all(map(is_, motions, forces.trees)):
            return forces
        return self._with_trees(forces.v.copy(), forces.force, forces.torque, motions)

    def inertia(self, position: Position, v: Array) -> Forces:
        """Mass matrices at a position, where no forces act: what impacts meet."""
        motions = [t.inertia(q, v[t.coordinates]) for t, q in zip(self.trees, position.trees, strict=True)]
        return self._with_trees(v.copy(), self.no_load, self.no_load, motions)

    def _with_trees(self, v: Array, force: Array, torque: Array, motions: list[FreeMotion]) -> Forces:
        """Forces of the trees, whose velocities go into v (n,), beside those on the free bodies."""
        if self._lone:
            only = motions[0]
            return Forces(only.v, only.foreseen, force, torque, only.m.ravel(), only.minv.ravel(), (only,))
        for tree, motion in zip(self.trees, motions, strict=True):
            v[tree.coordinates] = motion.v
        foreseen = v
        if any(motion.foreseen is not motion.v for motion in motions):
            foreseen = v.copy()
            for tree, motion in zip(self.trees, motions, strict=True):
                foreseen[tree.coordinates] = motion.foreseen
        m = np.concatenate([self._m, *[motion.m.ravel() for motion in motions]])
        minv = np.concatenate([self._minv, *[motion.minv.ravel() for motion in motions]])
        return Forces(v, foreseen, force, torque, m, minv, tuple(motions))

    def wrenches(self, middle: Position, given: Mapping[str, Any]) -> Wrenches:
        """What external wrenches are: forces and torques on the free bodies; of trees by their index as `Tree.pushed`.

        Parameters
        ----------
        middle : Position
        given : mapping
            Free body name to its force (3,) at the centre of mass [N], or to (force, torque [N m]); world axes. For a
            body of an articulation, "articulation/body", the force acts at the origin of its frame.
        """
        force, torque = np.zeros((self.free, 3)), np.zeros((self.free, 3))
        applied: dict[int, tuple[Array, Array]] = {}
        for name, wrench in _mapping(given, "external_force").items():
            try:
                parts = np.array(wrench, dtype=float)
            except (TypeError, ValueError):
                parts = np.array(np.nan)
            if parts.shape not in ((3,), (2, 3)) or not np.isfinite(parts).all():
                raise ValueError(f"external_force on {name!r} must be finite with shape (3,) or (2, 3), got {wrench!r}")
            pull, turn = parts if parts.ndim == 2 else (parts, np.zeros(3))
            if name in self.names:
                k = self.names[name]
                force[k], torque[k] = pull, _rotation(middle.quaternion[k]).T @ turn
            elif name in self._bodies:
                k, body = self._bodies[name], name.partition("/")[2]
                push, wrenches = self.trees[k].pushed(middle.trees[k], body, pull, turn)
                before = applied.get(k, (0.0, 0.0))
                applied[k] = before[0] + push, before[1] + wrenches
            else:
                self._refuse_body(name)
        return force, torque, applied

    def _refuse_body(self, name: str) -> None:
        """ValueError for a wrench on what does not move, naming what does."""
        raise ValueError(unknown(name, [*self.names, *self._bodies], "body of external_force"))

    def controls(self, given: Mapping[str, Any]) -> Controls:
        """Laws of the joints by the index of the tree, from what a controller gives to articulations.

        Parameters
        ----------
        given : mapping
            Articulation name to its joint forces (nv,), or to a `PD`.
        """
        out: dict[int, Control] = {}
        for name, value in _mapping(given, "controller").items():
            first, actuators = self._forests[choice(name, self._forests, "articulation of controller")]
            for k, control in enumerate(actuators.controls(value), first):
                out[k] = control
        return out

    # -- rows --------------------------------------------------------------------------------------------------

    def joint_rows(self, place: Placement, v: Array, v_free: Array, h: float) -> JointRows | None:
        """Rows of joint limits and joint friction of a step; None when there are none."""
        return self.joints.rows(self.angles(place), v, v_free, h) if self.joints.passive else None

    def limit_rows(self, place: Placement, v: Array) -> JointRows | None:
        """Rows of joint limits alone, for what happens in no time: friction has no impulse then."""
        joints = self.joint_rows(place, v, v, 0.0)
        return None if joints is None else joints.take(joints.mu == 0.0)

    def with_actuators(self, joints: JointRows | None, forces: Forces) -> JointRows | None:
        """Joint rows, and those of actuators at their limits; None when there are none."""
        for tree, free in zip(self.trees, forces.trees, strict=True):
            if (clutch := free.loads.clutch) is not None:
                joints = self.joints.with_actuators(joints, tree.coordinates, clutch)
        return joints

    def limits(self, place: Placement) -> Array:
        """Distances to all joint limits, in the order of `JointLaws.limits`, rad or m."""
        slots = self.joints.limits
        return self.joints.gaps(slots, self.angles(place)) if slots.size else NONE

    def angles(self, place: Placement) -> Array:
        """Joint coordinates, shape (n,), 0 where there are none."""
        if self._lone:
            return place.links[0].angle
        out = np.zeros(self.n)
        for t, links in zip(self.trees, place.links, strict=True):
            out[t.coordinates] = links.angle
        return out

    def rows(
        self, contacts: ContactSet, place: Placement, forces: Forces, joints: JointRows | None
    ) -> tuple[Rows, Array]:
        """Factors of contacts and joint rows where the frames are placed; frames (nc, 3, 3), rows (n, t1, t2)."""
        nc = contacts.gap.size
        frame, block, start = np.empty((nc, 3, 3)), np.empty((nc, 2), np.int64), np.empty((nc, 2), np.int64)
        hang, where = (contacts.frame1, contacts.frame2), (contacts.point, frame)
        size = _motion.contact_layout(contacts.normal, *hang, self.block_of_frame, self.offset, frame, block, start)
        H = np.zeros(size)
        if self.free:
            _motion.free_rows(*hang, *where, place.x, place.R, self.free, start, H)
        for t, links in zip(self.trees, place.links, strict=True):
            _links.rows(*hang, *where, t.frames.start, t.support, links.J, start, H)
        full = Blocks(self.offset, block, start, H, self.m_start, forces.m, forces.minv)
        bases = NOTHING
        if self._constrained:
            bases = {self.free + k: f.constraints.Z for k, f in enumerate(forces.trees) if f.constraints is not None}
        if joints is None:
            return Rows(full, bases, *NO_CLUTCHES), frame
        pressed = np.flatnonzero(joints.clutch[0])
        slots = joints.slot[pressed]
        clutches = nc + pressed, joints.clutch[:, pressed], self.joints.other[slots] >= 0, self.joints.ball[slots]
        return Rows(self.joints.append(joints, full), bases, *clutches), frame

    def free_rows(self, block: Index, start: Index, H: Array) -> Rows:
        """Factors of contacts of free bodies alone, as of `Blocks`."""
        return Rows(Blocks(self.offset, block, start, H, self.m_start, self._m, self._minv), NOTHING, *NO_CLUTCHES)

    # -- what is shown -----------------------------------------------------------------------------------------

    def energies(self, position: Position, v: Array, trees: Energies) -> tuple[float, float]:
        """(kinetic, potential) energy, J, with that of `tree_energies`; potential energy is 0 at the world's origin."""
        kinetic = potential = 0.0
        if self.free:
            kinetic, potential = _motion.free_energies(self.mass, self.J, self.gravity, position.x, v)
        for more in trees:
            kinetic, potential = kinetic + more[0], potential + more[1]
        return kinetic, potential

    def tree_energies(self, position: Position, v: Array) -> Energies:
        """(kinetic, potential) energy of every tree, J, as `Tree.energies` has it."""
        at = zip(self.trees, position.trees, strict=True)
        return tuple([t.energies(q, v[t.coordinates]) for t, q in at])

    def lift(self, before: Position, after: Position, v: Array) -> tuple[Array, float]:
        """Velocity with the same momentum where a projection brought the free bodies, and what it did to their energy.

        The angular momentum in space is kept, so that ω in body axes changes with the turn, and kinetic energy a bit.
        """
        out = np.empty(self.n)
        _motion.keep_spin(self.J, self.inverse_J, before.quaternion, after.quaternion, v, out)
        bodies = self.mass, self.J, self.gravity
        now, then = _motion.free_energies(*bodies, after.x, out), _motion.free_energies(*bodies, before.x, v)
        return out, (now[0] - then[0]) + (now[1] - then[1])

    def pinocchio_state(self, position: Position, v: Array) -> tuple[Array, Array]:
        """(q, v) in Pinocchio's layout: per free body (x, quaternion) and velocity in body axes, then the trees."""
        if self._lone:
            return position.trees[0].copy(), v.copy()
        q, out = np.empty(7 * len(position.x)), np.empty(v.size)
        _motion.pinocchio_layout(position.x, position.quaternion, v, q, out)
        return np.concatenate((q, *position.trees)) if position.trees else q, out

    def poses(self, position: Position, place: Placement) -> tuple[Array, Array] | tuple[None, None]:
        """Positions (frames, 3) and quaternions (frames, 4) of all frames; None where all are free bodies."""
        if self.frames == self.free:
            return None, None
        quaternion = np.empty((self.frames, 4))
        links = slice(self.free, self.frames - len(position.driven_x))
        _links.quaternions(place.R[links], quaternion[links])
        if self.free:
            quaternion[: self.free] = position.quaternion
        if links.stop < self.frames:
            quaternion[links.stop :] = position.driven_quaternion
        return place.x, quaternion
