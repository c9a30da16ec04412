"""Model of an articulation, rebuilt from its description in a recording; it shares no code with the step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.displacements import integrate

RANK = 1e-10
"""Fraction of the largest singular value: smaller singular values are those of redundant rows."""


def _moved(place: Array, wrench: Array) -> Array:
    """Return wrenches about the world's origin, (..., 6), of forces and moments in axes of the poses (..., 4, 4)."""
    force, moment = (np.einsum("...ij,...j->...i", place[..., :3, :3], wrench[..., k : k + 3]) for k in (0, 3))
    return np.concatenate((force, moment + np.cross(place[..., :3, 3], force)), axis=-1)


def _pose(matrix: Any) -> Any:
    return pin.SE3(np.array(matrix, dtype=float))


def _joint(told: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return (joint, rotation of its axes) of a description; KeyError naming an unknown kind."""
    kind = str(told["kind"])
    if kind == "JointModelComposite":
        out = pin.JointModelComposite()
        for part, placement in zip(told["parts"], told["placements"], strict=True):
            joint, turn = _joint(part)
            if not turn.isIdentity():
                raise KeyError(f"{kind} of {part['kind']}")
            out.addJoint(joint, _pose(placement))
        return out, pin.SE3.Identity()
    axis = np.array(told.get("axis", (1.0, 0.0, 0.0)), dtype=float)
    if kind == "JointModelRevoluteUnboundedUnaligned":  # Python cannot make it: a rotated joint about x replaces it
        turn = pin.Quaternion.FromTwoVectors(np.array((1.0, 0.0, 0.0)), axis).toRotationMatrix()
        return pin.JointModelRUBX(), pin.SE3(turn, np.zeros(3))
    if kind not in KINDS:
        raise KeyError(kind)
    given = [told[name] for name in KINDS[kind]]
    return getattr(pin, kind)(*(np.array(g) if isinstance(g, list) else g for g in given)), pin.SE3.Identity()


KINDS: dict[str, tuple[str, ...]] = {
    **{f"JointModel{kind}{axis}": () for kind in ("R", "P", "RUB") for axis in "XYZ"},
    **{f"JointModelH{axis}": ("pitch",) for axis in "XYZ"},
    **{f"JointModel{kind}": () for kind in ("FreeFlyer", "Spherical", "SphericalZYX", "Planar", "Translation")},
    **{f"JointModel{kind}Unaligned": ("axis",) for kind in ("Revolute", "Prismatic")},
    "JointModelHelicalUnaligned": ("axis", "pitch"),
    "JointModelUniversal": ("axis1", "axis2"),
    "JointModelEllipsoid": ("radius_x", "radius_y", "radius_z"),
}
"""Pinocchio's joints by name, and the entries of the description from which each is made."""

LAWS = "armature", "friction", "damping", "stiffness", "rest"
"""Laws of the joints that have a value for every coordinate."""

WINDING = {f"JointModel{kind}" for kind in ("SphericalZYX", "Universal", "Ellipsoid", "Composite")}


class Mechanism:
    """Equations of motion of a recorded articulation.

    KeyError naming a kind of joint that is not known; ValueError for an invalid model.

    Parameters
    ----------
    name : str
    joints : sequence of str
        Names of the joints.
    told : mapping
        Return value of `nsdyn.scene.tree_description.describe_tree`.
    gravity : sequence of float

    Attributes
    ----------
    friction, damping, stiffness, rest, lower, upper : ndarray, shape (nv,)
        Laws of the joints; bounds are infinite for joints without limits.
    falling : float
        ‖g‖ √Σm, the largest rate at which weights change the velocity, in the norm of the mass matrix, √J/s.
    labels : list of str
        Name of articulation and joint of every coordinate.
    driven : ndarray of int
        Coordinates with prescribed motion.
    floats : bool
        Whether nothing but a free joint, the first, connects the articulation with the world.
    winding : bool
        Whether axes of a joint move with its own coordinates. Pinocchio's derivatives leave this motion out, and so
        does the first pass of a step on loops.
    rubbing : list of ndarray of int
        Groups of coordinates on which dry friction acts together: the two in which a planar joint slides, all three of
        a spherical joint, else single coordinates.
    """

    def __init__(self, name: str, joints: Sequence[str], told: Mapping[str, Any], gravity: Sequence[float]) -> None:
        self.name, self.joints = name, list(joints)
        self.model = pin.Model()
        self.turned = [pin.SE3.Identity()]  # frame of each recorded joint in the frame of its joint in this model
        for label, joint in zip(joints, told["joints"], strict=True):
            self._add(label, joint)
        laws = [np.array(told[law], dtype=float) for law in LAWS]
        self.armature, self.friction, self.damping, self.stiffness, self.rest = laws
        bounds = [np.array([np.nan if x is None else x for x in told[side]], float) for side in ("lower", "upper")]
        self.lower, self.upper = (np.where(np.isnan(b), s * np.inf, b) for b, s in zip(bounds, (-1, 1), strict=True))
        sizes = {x.shape for x in (*laws, *bounds)}
        if sizes != {(self.model.nv,)}:
            raise ValueError(f"its laws are of {sizes}, not of {self.model.nv} coordinates")
        self.restitution = float(told["restitution"])
        driven = told["driven"].items()
        self.speeds = {int(self.model.joints[self.model.getJointId(j)].idx_v): rate for j, rate in driven}
        self._loops = [self._loop(loop) for loop in told["loops"]]
        self.loop_names = [str(loop["name"]) for loop in told["loops"]]
        self._gears = [
            (int(gear["coordinate1"]), int(gear["coordinate2"]), float(gear["ratio"]), float(gear["offset"]))
            for gear in told["gears"]
        ]
        self.model.armature = self.armature
        self.model.gravity = pin.Motion(np.array(gravity, dtype=float), np.zeros(3))
        self.light = self.model.copy()
        self.light.gravity = pin.Motion.Zero()
        self.data = self.model.createData()
        bodies = self.model.inertias.tolist()[1:]
        self._bodies = (  # masses, centres of mass, and inertias about the centres
            np.array([body.mass for body in bodies])[:, None],
            np.array([body.lever for body in bodies]).reshape(-1, 3),
            np.array([body.inertia for body in bodies]).reshape(-1, 3, 3),
        )
        self.falling = float(np.linalg.norm(gravity) * np.sqrt(np.abs(self._bodies[0]).sum()))
        self.nv = self.model.nv
        self.driven: Index = np.array(sorted(self.speeds), dtype=np.int64)
        self.loops = len(self._loops) + len(self._gears)
        self.bound = bool(self.loops or self.driven.size)
        self.floats = (
            bool(told["joints"])
            and told["joints"][0]["kind"] == "JointModelFreeFlyer"
            and all(joint["parent"] > 0 for joint in told["joints"][1:])
            and all(min(loop["joints"]) > 0 for loop in told["loops"])
            and not (self.driven < 6).any()
        )
        self.zero, self.flat = np.zeros(self.nv), self.model.nq == self.nv
        joints = list(self.model.joints)[1:]
        self.labels = [f"{name}/{label}" for label, j in zip(self.joints, joints, strict=True) for _ in range(j.nv)]
        linear = [(j.idx_v + k, j.idx_q + k) for j in joints if j.nq == j.nv for k in range(j.nv)]
        self._linear = np.array(linear, np.int64).reshape(-1, 2).T
        self.winding = any(j.shortname() in WINDING for j in joints)
        together = {"JointModelPlanar": 2, "JointModelSpherical": 3}  # number of coordinates with joint dry friction
        self.rubbing: list[Index] = []
        for joint in joints:
            one, last = together.get(joint.shortname(), 1), joint.idx_v + joint.nv
            self.rubbing += [np.arange(joint.idx_v, joint.idx_v + one), *np.arange(joint.idx_v + one, last)[:, None]]
        self.round = [(j.idx_v, j.idx_q) for j in joints if (j.nq, j.nv) == (2, 1)]
        self.place(pin.neutral(self.model))
        self.turns = np.linalg.norm(self.data.J.reshape(6, -1, order="A")[3:], axis=0)

    def _add(self, label: str, told: Mapping[str, Any]) -> None:
        joint, turn = _joint(told)
        parent = int(told["parent"])
        if not 0 <= parent < self.model.njoints:
            raise ValueError(f"joint {label!r} has the parent {parent}, which is none before it")
        at = self.turned[parent] * _pose(told["placement"]) * turn
        k = self.model.addJoint(parent, joint, at, label)
        self.turned.append(turn.inverse())
        body = pin.Inertia.Zero()  # its constructor refuses inertias that no body has, as files may
        body.mass, body.lever = float(told["mass"]), np.array(told["com"], float)
        body.inertia = np.array(told["inertia"], float)
        self.model.appendBodyToJoint(k, body, self.turned[k])

    def _loop(self, told: Mapping[str, Any]) -> tuple[int, int, bool]:
        """Return the two frames of a loop, and whether their axes coincide too."""
        frames = []
        for joint, placement in zip(told["joints"], told["placements"], strict=True):
            frame = pin.Frame(f"loop{self.model.nframes}", joint, self.turned[joint] * _pose(placement), pin.OP_FRAME)
            frames.append(self.model.addFrame(frame, False))
        return frames[0], frames[1], told["kind"] == "frame"

    # -- at a configuration ------------------------------------------------------------------------------------

    def angle(self, q: Array) -> Array:
        """Return joint coordinates, rad or m, (nv,); 0 for joints without scalar coordinates."""
        out = np.zeros(self.nv)
        coordinates, places = self._linear
        out[coordinates] = q[places]
        for j, k in self.round:
            out[j] = np.arctan2(q[k + 1], q[k])
        return out

    def stretch(self, q: Array) -> Array:
        """Return the deflections of the joint springs, rad or m, the short way round for unbounded angles."""
        out: Array = self.angle(q) - self.rest
        for j, _ in self.round:
            out[j] = np.remainder(out[j] + np.pi, 2.0 * np.pi) - np.pi
        return out

    def mass(self, q: Array) -> Array:
        """Return the mass matrix."""
        upper = np.triu(np.array(pin.crba(self.model, self.data, q)).reshape(self.nv, self.nv))
        return upper + np.triu(upper, 1).T

    def weight(self, q: Array) -> Array:
        """Return the generalised forces g of gravity, N m or N."""
        return np.array(pin.computeGeneralizedGravity(self.model, self.data, q))

    def place(self, q: Array) -> None:
        """Compute frames and Jacobians at q for `pose`, `push`, `carried` and `along`."""
        pin.computeJointJacobians(self.model, self.data, q)

    def pose(self, joint: int) -> Any:
        """Return the frame of a joint at the configuration of the last `place`."""
        return self.data.oMi[joint] * self.turned[joint].inverse()

    def _jacobian(self, joint: int) -> Any:
        """Return the Jacobian of a link at the world's origin, (6, nv), at the configuration of `place`."""
        return pin.getJointJacobian(self.model, self.data, joint, pin.WORLD).reshape(6, -1, order="A")

    def push(self, joint: int, point: Array, impulse: Array) -> Array:
        """Return the generalised impulse of an impulse at a point of a link, at the configuration of `place`."""
        return self._jacobian(joint).T @ np.concatenate((impulse, np.cross(point, impulse)))

    def pushed(self, wrenches: Array) -> Array:
        """Return the generalised impulse of wrenches on the links about the world's origin (links, 6), as in `push`."""
        out: Array = np.zeros(self.nv)
        for joint in np.flatnonzero(wrenches.any(axis=1)).tolist():
            out += self._jacobian(joint + 1).T @ wrenches[joint]
        return out

    def carried(self, joint: int, point: Array, v: Array) -> tuple[Array, Array]:
        """Return velocity of a point of a link, m/s, and angular velocity, rad/s, at the configuration of `place`."""
        twist = self._jacobian(joint) @ v
        return twist[:3] + np.cross(twist[3:], point), twist[3:]

    def momenta(self, q: Array, v: Array) -> Array:
        """Return linear and angular momentum about the world's origin of every link, (n, links, 6), N·s and N·m·s.

        States have the shapes (n, nq) and (n, nv), as in `twists` and `weights`.
        """
        place, twist = self._links(q, v)
        mass, lever, inertia = self._bodies
        linear = mass * (twist[..., :3] + np.cross(twist[..., 3:], lever))
        spin = np.cross(lever, linear) + np.einsum("lij,nlj->nli", inertia, twist[..., 3:])
        return _moved(place, np.concatenate((linear, spin), axis=2))

    def kept(self, q: Array, v: Array, end: Array, new: Array) -> Array:
        """Return the velocity `new` at `end`, its first joint's part changed so that all momenta are those of (q, v).

        That joint is free. Its rows of M v are the momenta about its origin, in its axes.
        """

        def base(q: Array) -> Any:
            centre = pin.centerOfMass(self.model, self.data, q)
            return self.data.oMi[1].actInv(pin.SE3(np.eye(3), centre))

        momenta, M, out = base(q).actInv(pin.Force(self.mass(q)[:6] @ v)), self.mass(end), new.copy()
        out[:6] += np.linalg.solve(M[:6, :6], base(end).act(momenta).vector - M[:6] @ new)
        return out

    def lifted(self, q: Array, v: Array, shift: Array) -> tuple[Array, Array]:
        """Return configuration and velocity after a displacement by a projection; what floats keeps its momenta."""
        if not shift.any():
            return q, v
        end = np.array(integrate(self.model, q, shift))
        return end, self.kept(q, v, end, v) if self.floats else v

    def twists(self, q: Array, v: Array) -> Array:
        """Return linear velocity at the world's origin and angular velocity of each link, (n, links, 6), m/s, rad/s."""
        place, twist = self._links(q, v)
        return np.roll(_moved(place, np.roll(twist, 3, axis=2)), 3, axis=2)

    def weights(self, q: Array) -> tuple[Array, Array]:
        """Return gravity on every link, (n, links, 6), N and N·m about the world's origin; and origins of joints, m."""
        place, _ = self._links(q, np.zeros((len(q), self.nv)))
        mass, lever, _ = self._bodies
        origin = place[..., :3, 3]
        force = np.broadcast_to(mass * self.model.gravity.linear, origin.shape)
        centre = origin + np.einsum("nlij,lj->nli", place[..., :3, :3], lever)
        return np.concatenate((force, np.cross(centre, force)), axis=2), origin

    def _links(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return poses (n, links, 4, 4) and, in axes of the links, twists (n, links, 6) of all links."""
        places, twists = np.empty((len(q), len(self.joints), 4, 4)), np.empty((len(q), len(self.joints), 6))
        for k in range(len(q)):
            pin.forwardKinematics(self.model, self.data, q[k], v[k])
            places[k] = [place.homogeneous for place in self.data.oMi.tolist()[1:]]
            twists[k] = [twist.vector for twist in self.data.v.tolist()[1:]]
        return places, twists

    def passed(self, needs: Array) -> Array:
        """Return the impulse that each joint passes on to its child, from the impulses that the links need.

        Both have the shape (n, links, 6) and are about one point in each of the n states.
        """
        out = needs.copy()
        for k in reversed(range(out.shape[1])):
            if parent := int(self.model.parents[k + 1]):
                out[:, parent - 1] += out[:, k]
        return out

    def along(self, q: Array, passed: Array) -> Array:
        """Return the components along joint coordinates of the wrenches `passed` about the world's origin, N·m or N."""
        self.place(q)
        J, owner = self.data.J.reshape(6, -1, order="A"), np.repeat(range(len(passed)), self.model.nvs.tolist()[1:])
        return (J * passed[owner].T).sum(axis=0)

    def held(self, q: Array, tau: Array) -> list[list[tuple[int, Array]]]:
        """Return loop impulses equivalent to the generalised impulses tau: (joint, wrench) on both frames of each loop.

        Wrenches are about the world's origin. For redundant loops they have the least norm.
        """
        react = np.linalg.lstsq(self.constraints(q)[1].T, tau, rcond=RANK)[0]
        out, row = [], 0
        for first, second, turned in self._loops:
            force, row = react[row : row + 3], row + 3
            moment = react[row : row + 3] if turned else np.zeros(3)
            row += 3 * turned
            out.append(
                [
                    (
                        self.model.frames[frame].parentJoint,
                        sign * np.concatenate((force, moment + np.cross(self.data.oMf[frame].translation, force))),
                    )
                    for frame, sign in ((first, 1.0), (second, -1.0))
                ]
            )
        return out

    def closure(self, loop: int) -> Array:
        """Return the position of a loop's first frame at the configuration of the last `constraints`, m."""
        return np.array(self.data.oMf[self._loops[loop][0]].translation)

    def constraints(self, q: Array) -> tuple[Array, Array]:
        """Return the gaps of loops and gears, m and rad, and the rows B of loops, gears and driven joints at q."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        gaps, rows = [np.empty(0)], [np.empty((0, self.nv))]
        for first, second, turned in self._loops:
            a, b = self.data.oMf[first], self.data.oMf[second]
            Ja, Jb = (
                pin.getFrameJacobian(self.model, self.data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1, order="A")
                for frame in (first, second)
            )
            gaps.append(a.translation - b.translation)
            rows.append(Ja[:3] - Jb[:3])
            if turned:
                gaps.append(pin.log3(a.rotation @ b.rotation.T))
                rows.append(Ja[3:] - Jb[3:])
        coordinates, unit, round_ = self.angle(q), np.eye(self.nv), {j for j, _ in self.round}
        for first, second, ratio, offset in self._gears:
            # For wheels whose turns are not counted, only the ratio of velocities is constrained.
            apart = 0.0 if {first, second} & round_ else coordinates[second] - ratio * coordinates[first] - offset
            gaps.append(np.array([apart]))
            rows.append((unit[second] - ratio * unit[first])[None])
        rows.append(unit[self.driven])
        return np.concatenate(gaps), np.concatenate(rows)

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Return the kinetic energy, and the potential energy of gravity and springs, J."""
        bend = self.stretch(q)
        pin.forwardKinematics(self.model, self.data, q)
        fallen = sum(
            body.mass * float(self.model.gravity.linear @ self.data.oMi[k].act(body.lever))
            for k, body in enumerate(self.model.inertias)
            if k
        )
        return 0.5 * float(v @ self.mass(q) @ v), 0.5 * float(bend @ (self.stiffness * bend)) - fallen
