"""Mass matrices, free motion and contact Jacobians of a scene.

Free bodies are batched in arrays; each articulated tree has its own Pinocchio model. The velocity is one vector v
(n,) in blocks: 6 per free body (linear in world axes, angular in body axes), then nv per tree. Bodies that move as
prescribed have a frame, but no block.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from nsdyn._kernels import motion as _motion
from nsdyn._kernels import trees as _trees
from nsdyn.contacts import ContactSet
from nsdyn.joints import JointLaws, JointRows, Rows
from nsdyn.problem import Blocks
from nsdyn.scene import Scene
from nsdyn.shapes import CAPSULE, SPHERE
from nsdyn.surfaces import Surfaces
from nsdyn.trees import FreeMotion, Halfway, Links, Tree, TreeEnd

Array = NDArray[np.float64]

__all__ = ["Dynamics", "Loads", "Position"]

NOTHING: Mapping[Any, Any] = {}

NOT_PRESSED = np.empty(0, np.int64), np.empty(0)


class Position(NamedTuple):
    """Where everything is.

    Attributes
    ----------
    x : ndarray, shape (nf, 3)
        Centres of mass of the free bodies, m, world frame.
    quaternion : ndarray, shape (nf, 4)
        Their orientations, xyzw, body to world.
    trees : tuple of ndarray
        Pinocchio configuration of every articulated tree.
    driven_x, driven_quaternion : ndarray, shapes (nd, 3), (nd, 4)
        Poses of the bodies that move as prescribed.
    """

    x: Array
    quaternion: Array
    trees: tuple[Array, ...]
    driven_x: Array
    driven_quaternion: Array


class Loads(NamedTuple):
    """What acts during a step besides contacts.

    Attributes
    ----------
    force, torque : ndarray, shape (nf, 3)
        On free bodies; force in world axes [N], torque about the centre of mass in the body axes of the beginning of
        the step [N m].
    gyroscopic : ndarray, shape (nf, 3)
        Mean gyroscopic torque of the step, J (ω_f - ω)/h - torque, body axes, N m.
    halfway : tuple of Halfway
        Where the forces of the step act on the trees.
    trees : tuple of FreeMotion
    """

    force: Array
    torque: Array
    gyroscopic: Array
    halfway: tuple[Halfway, ...]
    trees: tuple[FreeMotion, ...]


def _rotation(quaternion: Array) -> Array:
    """Rotation matrix of a unit quaternion xyzw."""
    return np.array(pin.Quaternion(quaternion).toRotationMatrix())


def _mapping(given: Any, what: str) -> Mapping[str, Any]:
    """What a callback returned, checked."""
    if not isinstance(given, Mapping):
        raise ValueError(f"{what} must return a mapping of names or None, got {given!r}")
    return given


class Dynamics:
    """Equations of motion of a scene between contacts.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        bodies, frames, driven = scene.free_bodies, scene.link_frames(), scene.driven_bodies
        self.gravity: Array = np.array(scene.gravity)
        self.free = len(bodies)
        self.frames = self.free + len(frames) + len(driven)
        self.mass = np.array([b.mass for b in bodies])
        self._inverse_mass, self._no_load = 1.0 / self.mass, np.zeros((self.free, 3))
        self.J = np.array([b.inertia for b in bodies]).reshape(-1, 3, 3)
        self.radius = np.array([b.shape.bounding_radius + float(np.linalg.norm(b.com)) for b in bodies])
        self._inscribed = np.array([b.shape.inscribed_radius for b in bodies])
        self.names = {b.name: k for k, b in enumerate(bodies)}
        self.trees: list[Tree] = []
        start, first = 6 * self.free, self.free
        for name, a in scene.articulations.items():
            joints = [joint for owner, joint in frames if owner == name]
            motions = {
                a.model.joints[a.model.getJointId(joint)].idx_v: m
                for key, m in scene.motions.items()
                for owner, _, joint in [key.partition("/")]
                if owner == name
            }
            self.trees.append(Tree(a, self.gravity, start, joints, first, motions))
            start, first = start + a.model.nv, first + len(joints)
        sizes = [6] * self.free + [t.model.nv for t in self.trees]
        self.offset = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64)
        self.m_start = np.concatenate(([0], np.cumsum(np.square(sizes)))).astype(np.int64)[:-1]
        owner = [self.free + k for k, t in enumerate(self.trees) for _ in t.joints]
        self.block_of_frame = np.array([*range(self.free), *owner, *([-1] * len(driven))], dtype=np.int64)
        self.n = int(self.offset[-1])
        m, minv = np.zeros((self.free, 6, 6)), np.zeros((self.free, 6, 6))
        for k in range(self.free):
            m[k, :3, :3], m[k, 3:, 3:] = self.mass[k] * np.eye(3), self.J[k]
            inverse = np.linalg.inv(self.J[k])
            minv[k, :3, :3], minv[k, 3:, 3:] = np.eye(3) / self.mass[k], 0.5 * (inverse + inverse.T)
        self._m, self._minv = m.ravel(), minv.ravel()
        self.m, self.minv = self._m, self._minv
        self.links: list[Links] = []
        self.halfway: list[Halfway] = []
        self.bases: dict[int, Array] = {}
        self._tree_names = {t.name: k for k, t in enumerate(self.trees)}
        self._fall = float(np.linalg.norm(self.gravity))
        self.x, self.R = np.zeros((self.frames, 3)), np.zeros((self.frames, 3, 3))
        self.constrained = any(t.constrained for t in self.trees)
        # Links of trees with a fixed base; index -1 is the world's.
        self._held = np.zeros(self.frames + 1, dtype=bool)
        for t in self.trees:
            self._held[t.frames] = "JointModelFreeFlyer" not in [joint.shortname() for joint in t.model.joints]
        self._in_tree = self.block_of_frame >= self.free
        self._round = np.array([g.shape.size[0] if g.shape.kind in (SPHERE, CAPSULE) else 0.0 for g in scene.geoms()])
        self.joints = JointLaws(list(scene.articulations.values()), self.trees, self.free)
        self.surfaces = Surfaces(scene)
        starts = [t.start(a.q, a.v) for t, a in zip(self.trees, scene.articulations.values(), strict=True)]
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

    @staticmethod
    def _velocity(body: Any) -> Array:
        return np.concatenate((body.linear_velocity, _rotation(body.quaternion).T @ body.angular_velocity))

    def start(self) -> tuple[Position, Array]:
        """Initial position and velocity of the scene."""
        return self._start

    def advance(self, position: Position, v: Array, h: float, twist: Array | None = None) -> Position:
        """Q ⊕ h v: x + h v, R exp([h ω]x) for free bodies, Pinocchio's integrate for trees, loops closed.

        Driven bodies move with `twist` (surfaces, 2, 3), linear and angular velocities in world axes, or not at all.
        """
        x, quaternion = np.empty((self.free, 3)), np.empty((self.free, 4))
        _motion.integrate(position.x, position.quaternion, v, h, x, quaternion)
        return self._advanced(x, quaternion, position, v, h, twist)

    def _advanced(
        self, x: Array, quaternion: Array, position: Position, v: Array, h: float, twist: Array | None
    ) -> Position:
        """What `advance` gives, whose free bodies are at x and quaternion."""
        trees, driven = position.trees, (position.driven_x, position.driven_quaternion)
        if trees:
            moved = zip(self.trees, trees, strict=True)
            trees = tuple([t.close(pin.integrate(t.model, q, h * v[t.coordinates])) for t, q in moved])
        if twist is not None and driven[0].size:
            driven = self.surfaces.advance(*driven, h * twist)
        return Position(x, quaternion, trees, *driven)

    def place(self, position: Position) -> None:
        """Put the poses of all frames at `position` into x and R, and the Jacobians of the trees there."""
        _motion.place(position.x, position.quaternion, self.x, self.R)
        self._place_driven(position)
        self._put([t.links(q) for t, q in zip(self.trees, position.trees, strict=True)])

    def evaluate(self, position: Position) -> None:
        """Put what `place` does, and steps of no length of the trees at `position`."""
        self.place(position)

    def _put(self, links: list[Links]) -> None:
        """Put the poses of the links into x and R."""
        self.links = links
        for t, link in zip(self.trees, links, strict=True):
            self.x[t.frames], self.R[t.frames] = link.x, link.R

    def _place_driven(self, position: Position) -> None:
        if position.driven_x.size:
            nd = len(position.driven_x)
            _motion.place(position.driven_x, position.driven_quaternion, self.x[-nd:], self.R[-nd:])

    def free_velocity(
        self,
        begin: Position,
        middle: Position,
        v: Array,
        t: float,
        h: float,
        theta: float,
        push: Array,
        wrenches: Mapping[str, Any] | None,
        tau: Mapping[str, Any] | None,
    ) -> tuple[Array, Loads]:
        """Velocity after a step without contact, M̃ (v_f - v) = h f̃, and the loads that made it.

        Parameters
        ----------
        begin, middle : Position
            Where the step begins, and its midpoint, where `evaluate` has been called.
        v : ndarray, shape (n,)
            Velocity at the beginning of the step.
        t, h, theta : float
            Time at the end of the step, step [s], and θ.
        push : ndarray, shape (n,)
            Change of velocity expected of contacts and joint rows: gyroscopic and Coriolis terms belong to the motion
            with it.
        wrenches : mapping, optional
            Free body name to its force (3,) at the centre of mass [N], or to (force, torque [N m]); world axes. For a
            body of an articulation, "articulation/body", the force acts at the origin of its frame.
        tau : mapping, optional
            Articulation name to its joint forces (nv,), or to a `PD`.
        """
        force, torque, applied, given = self._no_load, self._no_load, NOTHING, NOTHING
        if wrenches is not None:
            force, torque, applied = self._applied(begin, middle, _mapping(wrenches, "external_force"))
        if tau is not None:
            given = _mapping(tau, "controller")
            if unknown := given.keys() - self._tree_names.keys():
                raise ValueError(f"controller names {min(unknown)!r}; articulations are {list(self._tree_names)}")
        out, gyroscopic = np.empty(self.n), np.empty((self.free, 3))
        _motion.free_velocity(self.J, self._inverse_mass, self.gravity, force, torque, h, v, push, out, gyroscopic)
        free = []
        self.bases = {}
        halfway = self.halfway
        if begin is middle:  # accelerations
            halfway = [t.halfway(q, v[t.coordinates], h, 1.0) for t, q in zip(self.trees, begin.trees, strict=True)]
        for k, tree in enumerate(self.trees):
            motion = tree.free_motion(halfway[k], t, given.get(tree.name), applied.get(k))
            free.append(motion)
            out[tree.coordinates] = motion.v
            if motion.constraints is not None:
                self.bases[self.free + k] = motion.constraints.Z
        if free:
            self.m = np.concatenate([self._m, *(f.m.ravel() for f in free)])
            self.minv = np.concatenate([self._minv, *(f.minv.ravel() for f in free)])
        return out, Loads(force, torque, gyroscopic, tuple(halfway), tuple(free))

    def end(
        self, position: Position, v: Array, h: float, twist: Array | None, loads: Loads, p: Array, v1: Array
    ) -> tuple[Position, Array, tuple[TreeEnd, ...]]:
        """`advance`, but for the trees, which end as `Tree.end` says; their velocities; p (n,) is H r."""
        x, quaternion = np.empty((self.free, 3)), np.empty((self.free, 4))
        _motion.integrate(position.x, position.quaternion, v, h, x, quaternion)
        driven = (position.driven_x, position.driven_quaternion)
        if twist is not None and driven[0].size:
            driven = self.surfaces.advance(*driven, h * twist)
        v1, ends = v1.copy(), []
        for t, half, free in zip(self.trees, loads.halfway, loads.trees, strict=True):
            ends.append(t.end(half, free, v1[t.coordinates], bool(p[t.coordinates].any())))
            v1[t.coordinates] = ends[-1].v
        return Position(x, quaternion, tuple(e.q for e in ends), *driven), v1, tuple(ends)

    def _applied(
        self, begin: Position, middle: Position, wrenches: Mapping[str, Any]
    ) -> tuple[Array, Array, dict[int, Array]]:
        """What external wrenches are: forces and torques on the free bodies, joint forces of trees by their index."""
        force, torque = np.zeros((self.free, 3)), np.zeros((self.free, 3))
        applied: dict[int, Array] = {}
        for name, wrench in wrenches.items():
            try:
                parts = np.array(wrench, dtype=float)
            except (TypeError, ValueError):
                parts = np.array(np.nan)
            if parts.shape not in ((3,), (2, 3)) or not np.isfinite(parts).all():
                raise ValueError(f"external_force on {name!r} must be finite with shape (3,) or (2, 3), got {wrench!r}")
            pull, turn = parts if parts.ndim == 2 else (parts, np.zeros(3))
            owner, _, body = name.partition("/")
            if name in self.names:
                k = self.names[name]
                force[k], torque[k] = pull, _rotation(begin.quaternion[k]).T @ turn
            elif body and owner in self._tree_names:
                k = self._tree_names[owner]
                applied[k] = applied.get(k, 0.0) + self.trees[k].joint_forces(middle.trees[k], body, pull, turn)
            else:
                raise ValueError(
                    f"external_force names {name!r}, which is no free body and no 'articulation/body'; free bodies are "
                    f"{list(self.names)}, articulations {list(self._tree_names)}"
                )
        return force, torque, applied

    def joint_rows(self, middle: Position, v: Array, v_free: Array, h: float) -> JointRows | None:
        """Rows of joint limits and joint friction of a step; None when there are none."""
        if not self.joints.size:
            return None
        return self.joints.rows(self.angles(middle), v, v_free, h)

    def angles(self, position: Position) -> Array:
        """Joint coordinates of all trees in rad or m, shape (n,); 0 elsewhere."""
        angle = np.zeros(self.n)
        for t, q in zip(self.trees, position.trees, strict=True):
            angle[t.coordinates] = t.angle(q)
        return angle

    def blocks(self, contacts: ContactSet) -> tuple[Blocks, Array]:
        """Factors (M, H) of the contacts at the placed position, and their frames (nc, 3, 3), rows (n, t1, t2)."""
        nc = contacts.gap.size
        frame, block, start = np.empty((nc, 3, 3)), np.empty((nc, 2), np.int64), np.empty((nc, 2), np.int64)
        hang, where = (contacts.frame1, contacts.frame2), (contacts.point, frame)
        size = _motion.contact_layout(contacts.normal, *hang, self.block_of_frame, self.offset, frame, block, start)
        h = np.zeros(size)
        _motion.free_rows(*hang, *where, self.x, self.R, self.free, start, h)
        for t, link in zip(self.trees, self.links, strict=True):
            _trees.link_rows(*hang, *where, t.frames.start, t.support, link.J, start, h)
        return Blocks(self.offset, block, start, h, self.m_start, self.m, self.minv), frame

    def carry_gaps(self, contacts: ContactSet, poses: tuple[Array, Array] | tuple[None, None], out: Array) -> None:
        """Gaps of the contacts of links with the world when the frames, now placed, are at `poses`, into `out`, m.

        The gap that a step leaves is linear in its motion; legs and rods turn fast enough for its square to matter.
        """
        x, quaternion = poses
        if x is None or quaternion is None:  # no links
            return
        c = contacts
        where = c.frame1, c.frame2, c.geom1, c.geom2, c.gap, c.point, c.normal, self._in_tree, self._round
        _trees.carry_gaps(*where, self.x, self.R, x, quaternion, out)

    def held(self, contacts: ContactSet) -> NDArray[np.bool_]:
        """Which contacts are between the world and a link of a tree that hangs on it, shape (nc,)."""
        one, two = contacts.frame1, contacts.frame2
        out: NDArray[np.bool_] = (self._held[one] & (two < 0)) | (self._held[two] & (one < 0))
        return out

    def rows(self, contacts: Blocks, joints: JointRows | None) -> Rows:
        """Contacts and joint rows, in v and in the coordinates that loops, driven joints and joint friction leave."""
        bases = self.bases
        if joints is None:
            return Rows(contacts, bases, *NOT_PRESSED)
        pressed = np.flatnonzero(joints.press)
        return Rows(self.joints.append(joints, contacts), bases, contacts.nc + pressed, joints.press[pressed])

    def reach(self, v: Array, h: float, begun: Array, ended: Array) -> tuple[Array, bool]:
        """How far any point of each frame's shapes may move in a step of h, m, shape (frames,); whether one is fast.

        A free body that moves farther than its inscribed radius may pass through another within half a step.

        Driven bodies have the velocities `begun` and `ended` (surfaces, 2, 3) at its beginning and its end.
        """
        out = np.zeros(self.frames)
        fast = _motion.reach(v, self.gravity, h, self.radius, self._inscribed, out)
        self._reach_others(v, h, begun, ended, out)
        return out, fast

    def _reach_others(self, v: Array, h: float, begun: Array, ended: Array, out: Array) -> None:
        """What `reach` gives besides free bodies, into `out`."""
        for t, link in zip(self.trees, self.links, strict=True):
            part = link.x, t.support, link.J, v[t.coordinates], h, t.radius, h * h * self._fall, out[t.frames]
            _trees.link_reach(*part)
        if self.surfaces.count:
            self.surfaces.reach(h * np.maximum(np.abs(begun), np.abs(ended)), out)

    def midpoint(
        self, position: Position, v: Array, h: float, theta: float, begun: Array, ended: Array
    ) -> tuple[Position, Array, bool]:
        """The position after (1 - θ) h, as `advance` gives it, where `evaluate` is called; what `reach` gives."""
        x, quaternion, out = np.empty((self.free, 3)), np.empty((self.free, 4)), np.zeros(self.frames)
        fast = _motion.midpoint(
            position.x, position.quaternion, v, self.gravity, self.radius, self._inscribed, h, theta, x, quaternion,
            self.x, self.R, out,
        )  # fmt: skip
        if not (self.trees or position.driven_x.size):
            return Position(x, quaternion, (), position.driven_x, position.driven_quaternion), out, fast
        trees = zip(self.trees, position.trees, strict=True)
        self.halfway = [t.halfway(q, v[t.coordinates], h, theta) for t, q in trees]
        self._put([half.links for half in self.halfway])
        driven = position.driven_x, position.driven_quaternion
        if driven[0].size:
            driven = self.surfaces.advance(*driven, (1.0 - theta) * h * begun)
        middle = Position(x, quaternion, tuple(half.q for half in self.halfway), *driven)
        self._place_driven(middle)
        self._reach_others(v, h, begun, ended, out)
        return middle, out, fast

    def energies(self, position: Position, v: Array) -> tuple[float, float]:
        """(kinetic, potential) energy, J; potential energy is 0 at the world's origin."""
        kinetic, potential = _motion.free_energies(self.mass, self.J, self.gravity, position.x, v)
        for t, q in zip(self.trees, position.trees, strict=True):
            more = t.energies(q, v[t.coordinates])
            kinetic, potential = kinetic + more[0], potential + more[1]
        return kinetic, potential

    def pinocchio_state(self, position: Position, v: Array) -> tuple[Array, Array]:
        """(q, v) in Pinocchio's layout: per free body (x, quaternion) and velocity in body axes, then the trees."""
        q, out = np.empty(7 * self.free), np.empty(self.n)
        _motion.pinocchio_layout(position.x, position.quaternion, v, q, out)
        return np.concatenate((q, *position.trees)) if position.trees else q, out

    def poses(self, position: Position) -> tuple[Array, Array] | tuple[None, None]:
        """Positions (frames, 3) and quaternions (frames, 4) of all frames; None where all are free bodies."""
        if self.frames == self.free:
            return None, None
        x, R = np.empty((self.frames, 3)), np.empty((self.frames, 3, 3))
        for t, q in zip(self.trees, position.trees, strict=True):
            x[t.frames], R[t.frames] = t.poses(q)
        quaternion = np.empty((self.frames, 4))
        links = slice(self.free, self.frames - len(position.driven_x))
        _trees.quaternions(R[links], quaternion[links])
        if self.free:
            x[: self.free], quaternion[: self.free] = position.x, position.quaternion
        if links.stop < self.frames:
            x[links.stop :], quaternion[links.stop :] = position.driven_x, position.driven_quaternion
        return x, quaternion
