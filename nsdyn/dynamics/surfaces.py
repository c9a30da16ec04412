"""Kinematic (prescribed) bodies and sliding surfaces, and their velocities at the contacts."""

from __future__ import annotations

from copy import copy

import numpy as np

from nsdyn._kernels.dynamics import motion as _motion
from nsdyn.collision.contacts import ContactSet
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import Array, Index

NONE, NO_TRANSPORT, NO_VELOCITIES = np.empty((0, 2, 3)), np.empty((2, 0)), np.empty((0, 3))


class Surfaces:
    """The kinematic bodies of a scene, then its sliding surfaces: velocities at the contacts, poses of the bodies."""

    def __init__(self, scene: Scene) -> None:
        names = [b.name for b in scene.driven_bodies]
        names += [name for name, m in scene.motions.items() if m.kind == "surface"]
        self.count = len(names)
        self._step: tuple[float, float, Array, Array] | None = None
        self._begun = np.empty((0, 3)), np.empty((0, 4))
        self._motions = [scene.motions[name] for name in names]
        self._driven = len(scene.driven_bodies)
        self._slides = np.array([m.kind == "surface" for m in self._motions], dtype=bool)
        self._origin = np.array([scene.bodies[name].position for name in names]).reshape(-1, 3)
        place = {name: k for k, name in enumerate(names)}
        self._motion_of_geom = np.array([place.get(g.body, -1) for g in scene.geoms()], dtype=np.int64)

    def only(self, geoms: Index) -> Surfaces:
        """Return the surfaces for the contacts of some shapes, `geoms`, ascending, which are renumbered."""
        out = copy(self)
        out._motion_of_geom = self._motion_of_geom[geoms]
        return out

    def during(self, t: float, h: float, x: Array, quaternion: Array) -> Surfaces:
        """Return the surfaces in a step of h s from t on that begins with these poses, (nd, 3), (nd, 4), of the bodies.

        In the step their velocities change linearly.
        """
        out = copy(self)
        out._step, out._begun = (t, h, self.twists(t), self.twists(t + h)), (x, quaternion)
        return out

    def twists(self, t: float) -> Array:
        """(linear, angular) velocities at time t, shape (surfaces, 2, 3), m/s and rad/s, world axes."""
        if not self.count:
            return NONE
        if self._step is None:
            return np.array([m.twist(t) for m in self._motions])
        begin, h, begun, ended = self._step
        part = (t - begin) / h
        return (1.0 - part) * begun + part * ended

    def mean(self, begun: Array, ended: Array, theta: float) -> Array:
        """(1 - θ) begun + θ ended."""
        return (1.0 - theta) * begun + theta * ended if self.count else begun

    def advance(self, x: Array, quaternion: Array, step: Array) -> tuple[Array, Array]:
        """Poses of the kinematic bodies after small displacements (surfaces, 2, 3) in world axes."""
        if not self._driven:
            return x, quaternion
        step = step[: self._driven]
        x_out, quaternion_out, R = np.empty_like(x), np.empty_like(quaternion), np.empty((self._driven, 3, 3))
        _motion.rotations(quaternion, R)
        local = np.concatenate((step[:, 0], np.einsum("kji,kj->ki", R, step[:, 1])), axis=1)
        _motion.integrate(x, quaternion, local.ravel(), x_out, quaternion_out)
        return x_out, quaternion_out

    def poses(self, t: float, theta: float) -> tuple[Array, Array]:
        """Poses of the kinematic bodies at a time t within the step of `during`: the end of one move up to t.

        The poses are therefore functions of the time alone, and a step made in substeps finds the bodies at the same
        places as a step in one move.
        """
        if not self._driven or self._step is None:
            return self._begun
        begin, _, begun, _ = self._step
        h = t - begin
        return self.advance(*self.advance(*self._begun, (1.0 - theta) * h * begun), theta * h * self.twists(t))

    def reach(self, step: Array, radii: Array, out: Array) -> None:
        """Bound on the way of any point of the kinematic bodies, the last of all frames, into `out` (frames,), m."""
        if self._driven:
            length = np.linalg.norm(step[: self._driven], axis=2)
            out[-self._driven :] = length[:, 0] + length[:, 1] * radii[-self._driven :]

    def surface_velocity(
        self, contacts: ContactSet, frame: Array, driven_x: Array, rows: int, begun: Array, ended: Array
    ) -> Array:
        """Contribution of the surfaces to the relative velocities of contacts at the beginning and end of a step.

        Shape (2, 3 rows), 0 in the rows after the contacts, m/s; empty in a scene without surfaces. `frame` (nc, 3, 3)
        has the contact frames, `driven_x` (nd, 3) the positions of the kinematic bodies, m, and `begun` and `ended`
        (surfaces, 2, 3) the twists of the surfaces.
        """
        if not self.count:
            return NO_TRANSPORT
        out = np.zeros((2, rows, 3))
        for k, twist in enumerate((begun, ended)):
            w = self.velocities(contacts, driven_x, twist)[:, None]
            # The sum is written out, so that the value of one contact does not depend on the number of contacts.
            out[k, : len(frame)] = frame[:, :, 0] * w[..., 0] + frame[:, :, 1] * w[..., 1] + frame[:, :, 2] * w[..., 2]
        return out.reshape(2, -1)

    def velocities(self, contacts: ContactSet, driven_x: Array, twist: Array) -> Array:
        """Contribution of the surfaces to the relative velocities, world axes, (nc, 3); (0, 3) without surfaces."""
        if not self.count:
            return NO_VELOCITIES
        w, origin = np.zeros((contacts.gap.size, 3)), self._origin.copy()
        origin[: self._driven] = driven_x
        surfaces = self._motion_of_geom, origin, twist[:, 0].copy(), twist[:, 1].copy(), self._slides
        _motion.surface_velocities(contacts[:3], surfaces, w)
        return w
