"""Positions and motion of a scene without forces: flows, frames, velocities of frames, and the reach of shapes."""

from __future__ import annotations

import numpy as np

from nsdyn._kernels import reductions as _reductions
from nsdyn._kernels.dynamics import links as _links
from nsdyn._kernels.dynamics import motion as _motion
from nsdyn._kernels.dynamics.rotation import flow
from nsdyn.dynamics.layout import Layout
from nsdyn.dynamics.values import Flow, Forces, Links, MidpointState, Placement, Position
from nsdyn.tools.arrays import Array
from nsdyn.tools.displacements import integrate


class Kinematics(Layout):
    """Motion of a scene between the instants at which forces act."""

    def halfway(self, position: Position, v: Array, h: float, theta: float, twist: Array) -> MidpointState:
        """Midpoint of a step of h s, where its forces act: after (1 - θ) h of motion without forces, Φ.

        Free bodies move along straight lines and rotate without torque. Trees move by `Tree.flow`. Kinematic bodies
        move with a twist (surfaces, 2, 3), linear and angular, world axes.
        """
        ahead = (1.0 - theta) * h
        if self._lone:
            only = self.trees[0].halfway(position.trees[0], v, h, theta)
            return MidpointState(position.bent((only.q,)), only.v, Placement.of(only.links), (only,))
        x, quaternion, after, X, R = self._flow(position, v, ahead)
        halves = tuple(
            [t.halfway(q, v[t.coordinates], h, theta) for t, q in zip(self.trees, position.trees, strict=True)]
        )
        for t, half in zip(self.trees, halves, strict=True):
            after[t.coordinates] = half.v
        driven = self.surfaces.advance(position.driven_x, position.driven_quaternion, ahead * twist)
        there = Position(x, quaternion, tuple([half.q for half in halves]), *driven)
        return MidpointState(there, after, self._with_others(there, X, R, [half.links for half in halves]), halves)

    def end(
        self, middle: MidpointState, forces: Forces, v: Array, impulse: Array, h: float, driven: tuple[Array, Array]
    ) -> tuple[Position, Array, Placement, tuple[Flow, ...]]:
        """Second part of a step, h s without forces: return (position, velocity, frames, trees) at its end.

        The forces and impulses leave the velocity v (n,) at the midpoint. `impulse` is H r (n,), the impulse of
        contacts and joint rows on the coordinates; it tells which trees they act on. At the end, kinematic bodies have
        the poses `driven`, (nd, 3) and (nd, 4).
        """
        position = middle.position
        if self._lone:
            free = forces.trees[0]
            pushed = free.loads.implicit or _reductions.largest(impulse) > 0.0
            only = self.trees[0].end(middle.trees[0], free, v, pushed)
            there = position.bent((only.q,))
            return there, only.v, Placement.of(self.trees[0].links(only.q)), (only,)
        x, quaternion, after, X, R = self._flow(position, v, h)
        ends = []
        for t, half, free in zip(self.trees, middle.trees, forces.trees, strict=True):
            pushed = free.loads.implicit or _reductions.largest(impulse[t.coordinates]) > 0.0
            ends.append(t.end(half, free, v[t.coordinates], pushed))
            after[t.coordinates] = ends[-1].v
        there = Position(x, quaternion, tuple([e.q for e in ends]), *driven)
        links = [t.links(q) for t, q in zip(self.trees, there.trees, strict=True)]
        return there, after, self._with_others(there, X, R, links), tuple(ends)

    def _flow(self, position: Position, v: Array, h: float) -> tuple[Array, Array, Array, Array, Array]:
        """(x, quaternion, v) of free bodies after h s without forces, and the arrays of all frames, theirs filled."""
        x, quaternion, after = np.empty((self.free, 3)), np.empty((self.free, 4)), v.copy()
        X, R = np.empty((self.frames, 3)), np.empty((self.frames, 3, 3))
        flow(*self._principal, position.x, position.quaternion, v, h, x, quaternion, after)
        _motion.place(x, quaternion, X, R)
        return x, quaternion, after, X, R

    def shift(self, position: Position, step: Array) -> Position:
        """Position ⊕ a small displacement `step` (n,) in the coordinates of velocities, with loops closed."""
        x, quaternion = np.empty((self.free, 3)), np.empty((self.free, 4))
        _motion.integrate(position.x, position.quaternion, step, x, quaternion)
        moved = zip(self.trees, position.trees, strict=True)
        trees = tuple([t.close(integrate(t.model, q, step[t.coordinates])) for t, q in moved])
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
        """Complete a placement: add all other frames to `x` and `R`, which hold those of the free bodies."""
        if position.driven_x.size:
            nd = len(position.driven_x)
            _motion.place(position.driven_x, position.driven_quaternion, x[-nd:], R[-nd:])
        for t, at in zip(self.trees, links, strict=True):
            x[t.frames], R[t.frames] = at.x, at.R
        return Placement(x, R, tuple(links))

    def twists(self, place: Placement, v: Array) -> tuple[Array, Array]:
        """Velocities of frame origins and angular velocities, (frames, 3) each, world axes; 0 of kinematic bodies."""
        linear, angular = np.zeros((self.frames, 3)), np.zeros((self.frames, 3))
        if self.free:
            _motion.twists(place.R, v, self.free, linear, angular)
        if self.trees:
            _links.twists((*self.linkages, place.fields), place.x, v, linear, angular)
        return linear, angular

    def spins(self, angular: Array, twist: Array) -> Array:
        """Angular velocities of all frames, of `twists` and of kinematic bodies, (frames, 3), rad/s, world axes.

        `twist` (surfaces, 2, 3) is as in `reach`.
        """
        driven = self._driven
        return np.concatenate((angular[:-driven], twist[:driven, 1])) if driven else angular

    def reach(self, place: Placement, v: Array, h: float, dt: float, twist: Array) -> Array:
        """Bound on the way of any point of each frame's shapes in h s, m, shape (frames,).

        The bound holds at a velocity v (n,); kinematic bodies have the twist (surfaces, 2, 3), linear and angular,
        world axes. It includes the fall under gravity in h s at the speed gained in `dt`.
        """
        out = np.zeros(self.frames)
        fall = h * dt * self.weight
        if self.free:
            _motion.reach(v, h, fall, self.radii[: self.free], out)
        if self.trees:
            trees, links = (*self.linkages, place.fields), slice(self.free, self.frames - self._driven)
            _links.reach(trees, place.x[: links.stop], v, h, self.radii[links], fall, out[links])
        if self.surfaces.count:
            self.surfaces.reach(h * np.abs(twist), self.radii, out)
        return out

    def angles(self, place: Placement) -> Array:
        """Joint coordinates, shape (n,); 0 for coordinates that are none of a joint."""
        if self._lone:
            return place.links[0].angle
        out = np.zeros(self.n)
        for t, links in zip(self.trees, place.links, strict=True):
            out[t.coordinates] = links.angle
        return out

    def pinocchio_state(self, position: Position, v: Array) -> tuple[Array, Array]:
        """(q, v) in Pinocchio's layout: per free body (x, quaternion) and velocity in body axes, then the trees."""
        if self._lone:
            return position.trees[0].copy(), v.copy()
        q, out = np.empty(7 * len(position.x)), np.empty(v.size)
        _motion.pinocchio_layout(position.x, position.quaternion, v, q, out)
        return np.concatenate((q, *position.trees)) if position.trees else q, out

    def poses(self, position: Position, place: Placement) -> tuple[Array, Array] | tuple[None, None]:
        """Positions (frames, 3) and quaternions (frames, 4) of all frames; None if all frames are of free bodies."""
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
