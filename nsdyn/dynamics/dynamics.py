"""Equations of motion of a scene: forces, mass matrices, rows of contacts and joints, energies.

All are functions of their arguments and keep no state.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import add, is_
from typing import Any

import numpy as np

from nsdyn._kernels.dynamics import links as _links
from nsdyn._kernels.dynamics import motion as _motion
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.actuators import Control
from nsdyn.dynamics.joints import NO_CLUTCHES, ContactJacobian, JointRows
from nsdyn.dynamics.kinematics import Kinematics
from nsdyn.dynamics.values import Energies, Forces, FreeMotion, MidpointState, Placement, Position
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.scene.checks import rotation
from nsdyn.tools.arrays import NOTHING, Array, floats
from nsdyn.tools.displacements import turns
from nsdyn.tools.naming import choice, unknown

EMPTY: Mapping[Any, Any] = {}
Wrenches = tuple[Mapping[str, Array], Mapping[int, tuple[Array, Array]]]
"""External wrenches as two mappings. The first has loads (2, nf, 3) on the free bodies, as in `Forces`, by the column
of the ledger that books their work. The second has the loads of trees by the index of the tree, as `Tree.pushed`
returns them."""
Controls = Mapping[int, Control]


def _mapping(given: Any, what: str) -> Mapping[str, Any]:
    """Return the mapping that a callback returned; ValueError if it is none."""
    if not isinstance(given, (dict, Mapping)):  # a plain dict is recognised fastest
        raise ValueError(f"{what} must return a mapping of names, got {given!r}")
    return given


class Dynamics(Kinematics):
    """Equations of motion of a scene between contacts."""

    # -- forces -----------------------------------------------------------------------------------------------------

    def forces(
        self,
        middle: MidpointState,
        t: float,
        h: float,
        wrenches: Wrenches | None = None,
        control: Controls = EMPTY,
        last: Array | None = None,
    ) -> Forces:
        """Forces of a step of h s that ends at the time t, s: M̃ (v_f - v⁻) = h f̃.

        `wrenches` and `control` come from the functions of the user, see `Dynamics.wrenches` and `Dynamics.controls`.
        `last` has the last impulses of the joint rows, (slots, 3).
        """
        loads, applied = wrenches or (EMPTY, EMPTY)
        load = reduce(add, loads.values()) if loads else self.no_load
        out = np.empty(self.n)
        if self.free:
            _motion.accelerate(self._inverse_mass, self.inverse_J, self.gravity, *load, h, middle.v, out)
        if not self.trees:
            return Forces(out, out, load, self._m, self._minv, ())
        motions = []
        for k, tree in enumerate(self.trees):
            before = None if last is None else last[self._slots[k]]
            motions.append(tree.free_motion(middle.trees[k], t, control.get(k), applied.get(k), before))
        return self._with_trees(out, load, motions)

    def within_limits(self, middle: MidpointState, forces: Forces, v: Array, kick: Array | None = None) -> Forces:
        """Return the forces with rows for actuators that the velocity v (n,) after the forces brings beyond limits.

        Impacts at the midpoint change the velocity before the forces by `kick` (n,). Return `forces` itself if no
        actuator is beyond its limit.
        """
        before = middle.v if kick is None else middle.v + kick
        motions = [
            free
            if free.loads.limit is None
            else tree.within_limits(half, free, before[tree.coordinates], v[tree.coordinates])
            for tree, half, free in zip(self.trees, middle.trees, forces.trees, strict=True)
        ]
        if all(map(is_, motions, forces.trees)):
            return forces
        return self._with_trees(forces.v.copy(), forces.load, motions)

    def drag(self, middle: MidpointState, forces: Forces, v: Array) -> Array:
        """Part of the change of v (n,) by damping, springs and control that is due to the velocity v before them, (n,).

        In m/s and rad/s; linear in v.
        """
        out = np.zeros(self.n)
        for tree, half, free in zip(self.trees, middle.trees, forces.trees, strict=True):
            if free.loads.implicit:
                out[tree.coordinates] = tree.drag(half, free, v[tree.coordinates])
        return out

    def struck(self, middle: MidpointState, forces: Forces, kick: Array) -> Forces:
        """Return the forces of a step after impacts at the midpoint that change v by `kick` (n,).

        Impacts take no time: damping, springs and control give no impulse in them, and see the velocity that they
        leave.
        """
        before, motions = middle.v + kick, []
        for tree, free in zip(self.trees, forces.trees, strict=True):
            motions.append(free._replace(before=before[tree.coordinates]) if free.loads.implicit else free)
        return forces._replace(v=forces.v + kick + self.drag(middle, forces, kick), trees=tuple(motions))

    def inertia(self, position: Position, v: Array) -> Forces:
        """Mass matrices at a position where no forces act, as the law of impact needs them."""
        motions = [t.inertia(q, v[t.coordinates]) for t, q in zip(self.trees, position.trees, strict=True)]
        return self._with_trees(v.copy(), self.no_load, motions)

    def _with_trees(self, v: Array, load: Array, motions: list[FreeMotion]) -> Forces:
        """Join the forces of trees and the load on the free bodies; write the velocities of the trees into v (n,)."""
        if self._lone:
            only = motions[0]
            return Forces(only.v, only.foreseen, load, only.m.ravel(), only.minv.ravel(), (only,))
        for tree, motion in zip(self.trees, motions, strict=True):
            v[tree.coordinates] = motion.v
        foreseen = v
        if any(motion.foreseen is not motion.v for motion in motions):
            foreseen = v.copy()
            for tree, motion in zip(self.trees, motions, strict=True):
                foreseen[tree.coordinates] = motion.foreseen
        m = np.concatenate([self._m, *[motion.m.ravel() for motion in motions]])
        minv = np.concatenate([self._minv, *[motion.minv.ravel() for motion in motions]])
        return Forces(v, foreseen, load, m, minv, tuple(motions))

    def wrenches(self, middle: Position, given: Mapping[str, Any]) -> Wrenches:
        """Convert external wrenches into loads.

        A wrench is given by the name of a free body, as a force (3,) at its centre of mass [N], or as (force, torque [N
        m]); world axes. On a body of an articulation, named "articulation/body", the force acts at the origin of the
        body's frame.
        """
        force, torque = load = np.zeros((2, self.free, 3))
        applied: dict[int, tuple[Array, Array]] = {}
        for name, wrench in _mapping(given, "external_force").items():
            parts = floats(wrench)
            if parts.shape not in ((3,), (2, 3)) or not np.isfinite(parts).all():
                raise ValueError(f"external_force on {name!r} must be finite with shape (3,) or (2, 3), got {wrench!r}")
            pull, turn = parts if parts.ndim == 2 else (parts, np.zeros(3))
            if name in self.names:
                k = self.names[name]
                force[k], torque[k] = pull, rotation(middle.quaternion[k]).T @ turn
            elif name in self._bodies:
                k, body = self._bodies[name], name.partition("/")[2]
                push, wrenches = self.trees[k].pushed(middle.trees[k], body, pull, turn)
                before = applied.get(k, (0.0, 0.0))
                applied[k] = before[0] + push, before[1] + wrenches
            else:
                raise ValueError(unknown(name, [*self.names, *self._bodies], "body of external_force"))
        return {"external": load}, applied

    def controls(self, given: Mapping[str, Any]) -> Controls:
        """Control laws by the index of the tree, from the values that a controller gives to articulations by name."""
        out: dict[int, Control] = {}
        for name, value in _mapping(given, "controller").items():
            first, actuators = self._forests[choice(name, self._forests, "articulation of controller")]
            for k, control in enumerate(actuators.controls(value), first):
                out[k] = control
        return out

    # -- rows -------------------------------------------------------------------------------------------------------

    def joint_rows(self, place: Placement, v: Array, v_free: Array, h: float) -> JointRows | None:
        """Rows of joint limits and joint friction of a step; None when the step has no joint rows."""
        return self.joints.rows(self.angles(place), v, v_free, h) if self.joints.passive else None

    def limit_rows(self, place: Placement, v: Array) -> JointRows | None:
        """Rows of joint limits alone, for impacts, which take no time: friction of joints has no impulse then."""
        joints = self.joint_rows(place, v, v, 0.0)
        return None if joints is None else joints.take(joints.mu == 0.0)

    def with_actuators(self, joints: JointRows | None, forces: Forces) -> JointRows | None:
        """Joint rows followed by the rows of actuators at their limits; None when there are no rows."""
        for tree, free in zip(self.trees, forces.trees, strict=True):
            if (clutch := free.loads.clutch) is not None:
                joints = self.joints.with_actuators(joints, tree.coordinates, clutch)
        return joints

    def limits(self, place: Placement) -> Array:
        """Distances to all joint limits, in the order of `JointLaws.limits`, rad or m."""
        return self.joints.gaps(self.joints.limits, self.angles(place)) if self.joints.limits.size else NOTHING

    def rows(
        self, contacts: ContactSet, place: Placement, forces: Forces, joints: JointRows | None
    ) -> tuple[ContactJacobian, Array]:
        """Factors of contacts and joint rows at a placement; and the contact frames (nc, 3, 3), rows (n, t1, t2)."""
        nc = contacts.gap.size
        frame, block, start = np.empty((nc, 3, 3)), np.empty((nc, 2), np.int64), np.empty((nc, 2), np.int64)
        found = contacts[:3]
        size = _motion.contact_layout(found, self.node, self.offset, frame, block, start)
        H = np.zeros(size)
        if self.free:
            _motion.free_rows(found, frame, place.x, place.R, self.free, start, H)
        if self.trees:
            _links.rows((*self.linkages, place.fields), found, frame, start, H)
        full = DelassusFactors(self.offset, block, start, H, self.m_start, forces.m, forces.minv)
        bases = EMPTY
        if self.constrained:
            bases = {self.free + k: f.constraints.Z for k, f in enumerate(forces.trees) if f.constraints is not None}
        if joints is None:
            return ContactJacobian(full, bases, *NO_CLUTCHES), frame
        pressed = np.flatnonzero(joints.clutch[0])
        slots = joints.slot[pressed]
        clutches = nc + pressed, joints.clutch[:, pressed], self.joints.other[slots] >= 0, self.joints.ball[slots]
        return ContactJacobian(self.joints.append(joints, full), bases, *clutches), frame

    # -- energies ---------------------------------------------------------------------------------------------------

    def energies(self, position: Position, v: Array, trees: Energies) -> tuple[float, float]:
        """(kinetic, potential) energy, J, with `trees` of `tree_energies`; potential energy 0 at the world's origin."""
        kinetic = potential = 0.0
        if self.free:
            kinetic, potential = _motion.free_energies(self.mass, self.J, self.gravity, position.x, v)
        for more in trees:
            kinetic, potential = kinetic + more[0], potential + more[1]
        return kinetic, potential

    def tree_energies(self, position: Position, v: Array) -> Energies:
        """(kinetic, potential) energy of every tree, J, as `Tree.energies` computes it."""
        at = zip(self.trees, position.trees, strict=True)
        return tuple([t.energies(q, v[t.coordinates]) for t, q in at])

    def shifted(self, before: Position, after: Position) -> Array:
        """Displacements of the free bodies between two positions, (free, 6): m, and rotation vectors, world axes."""
        return np.concatenate((after.x - before.x, turns(before.quaternion, after.quaternion)), axis=1)

    def lift(self, before: Position, after: Position, v: Array) -> tuple[Array, float]:
        """Velocity with unchanged momenta after a position projection, and the change of energy of free bodies, J.

        The angular momentum in space is kept, of free bodies and of trees that float. Therefore ω in body axes changes
        with the rotation, and kinetic energy slightly.
        """
        out = np.empty(self.n)
        _motion.keep_spin(self.J, self.inverse_J, before.quaternion, after.quaternion, v, out)
        bodies = self.mass, self.J, self.gravity
        for t, q, lifted in zip(self.trees, before.trees, after.trees, strict=True):
            out[t.coordinates] = t.lift(q, lifted, v[t.coordinates])
        now, then = _motion.free_energies(*bodies, after.x, out), _motion.free_energies(*bodies, before.x, v)
        return out, (now[0] - then[0]) + (now[1] - then[1])
