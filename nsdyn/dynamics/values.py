"""Value types for the motion of a scene and of its trees: positions, frames, forces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.tools.arrays import Array

Energies = tuple[tuple[float, float], ...]
"""Kinetic and potential energy of every tree, J."""


class Links(NamedTuple):
    """The k joints of a tree that carry geometry, and the angles of all its joints, at one configuration; world axes.

    Attributes
    ----------
    x : ndarray, shape (k, 3)
        Origins of their frames, m.
    R : ndarray, shape (k, 3, 3)
        Their orientations.
    J : ndarray, shape (6, nv)
        Velocity field of every coordinate, linear at the world's origin, then angular. `Tree.support` tells which links
        a coordinate moves.
    angle : ndarray, shape (nv,)
        Joint coordinates in rad or m; 0 for joints without a scalar coordinate (free, spherical).
    """

    x: Array
    R: Array
    J: Array
    angle: Array


class Flow(NamedTuple):
    """A motion of a tree between contacts, or the second part of its step.

    Attributes
    ----------
    q, v : ndarray, shapes (nq,), (nv,)
        Configuration and velocity at its end.
    mean : ndarray, shape (nv,)
        Mean velocity; for the end of a step, the mean velocity with which the works of its forces are computed.
    work : float
        Work of driven joints, J. If `whole` is False, it lacks the work of their reactions to the forces of the step.
    whole : bool
        True if this is one motion from the beginning of the step, under all forces.
    """

    q: Array
    v: Array
    mean: Array
    work: float
    whole: bool = False


class TreeMidpoint(NamedTuple):
    """Midpoint of the step of a tree, where its forces act: after (1 - θ) h of motion without forces.

    Attributes
    ----------
    begin, begin_v : ndarray, shapes (nq,), (nv,)
        Configuration and velocity at the beginning of the step.
    q, v : ndarray, shapes (nq,), (nv,)
        Configuration, and velocity before the forces.
    work : float
        Work of driven joints until then, J.
    M : ndarray, shape (nv, nv)
        Mass matrix.
    links : Links
    h, theta : float
        Step, s, and θ.
    """

    begin: Array
    begin_v: Array
    q: Array
    v: Array
    work: float
    M: Array
    links: Links
    h: float
    theta: float


class TreeLoads(NamedTuple):
    """Loads on a tree during a step, without contacts, joint limits and joint friction.

    Attributes
    ----------
    laws : ndarray, shape (2, 5, nv)
        Joint springs, and the control: laws that are linear in the velocity at the end of the step, in the layout of
        `nsdyn._kernels.dynamics.trees.linear_laws`.
    push : ndarray, shape (nv,)
        Joint forces of external wrenches.
    wrenches : ndarray, shape (njoints - 1, 6), or None
        External wrenches on the links, force and moment about the world's origin, N and N m; None without any.
    weight : ndarray, shape (nv,)
        Gravity terms at the midpoint.
    rates : ndarray
        Velocities of the driven joints at the end of the step.
    limit : ndarray, shape (nv,), or None
        Most |τ| of the control; None if no control is limited.
    clutch : ndarray, shape (3, nv), or None
        For actuators with rows, which have no law above: impulse at the limit, speed of the rotor, and its mobility
        (1/mass); 0 for all others.
    held : ndarray, shape (nv,)
        Predicted forces of the actuators with rows; 0 for all others.
    implicit : bool
        True if damping, springs or a PD control act, whose forces depend on the velocity after them.
    """

    laws: Array
    push: Array
    wrenches: Array | None
    weight: Array
    rates: Array
    limit: Array | None
    clutch: Array | None
    held: Array
    implicit: bool


class Constraints(NamedTuple):
    """Loops and driven joints of a tree at the midpoint: v = P b + Z y are the velocities with B v = b.

    Attributes
    ----------
    B, P, Z : ndarray, shapes (m, nv), (nv, m), (nv, ny)
        Zᵀ M̃ Z = I.
    """

    B: Array
    P: Array
    Z: Array


class FreeMotion(NamedTuple):
    """Motion of a tree under the forces of a step, without contacts and joint rows.

    Attributes
    ----------
    v : ndarray, shape (nv,)
        Velocity after the forces.
    foreseen : ndarray, shape (nv,)
        The same, with the predicted forces of actuators that have rows.
    loads : TreeLoads
    before : ndarray, shape (nv,)
        Velocity before the forces, which they see: that of the midpoint, after impacts captured there.
    m, minv : ndarray, shape (nv, nv)
        Effective mass matrix M̃ and its inverse; the inverse is Z Zᵀ for a constrained tree.
    constraints : Constraints or None
    """

    v: Array
    foreseen: Array
    loads: TreeLoads
    before: Array
    m: Array
    minv: Array
    constraints: Constraints | None


class Position(NamedTuple):
    """Position of all bodies and trees of a scene.

    Attributes
    ----------
    x : ndarray, shape (nf, 3)
        Centres of mass of the free bodies, m, world frame.
    quaternion : ndarray, shape (nf, 4)
        Their orientations, xyzw, body to world.
    trees : tuple of ndarray
        Pinocchio configuration of every articulated tree.
    driven_x, driven_quaternion : ndarray, shapes (nd, 3), (nd, 4)
        Poses of the kinematic bodies.
    """

    x: Array
    quaternion: Array
    trees: tuple[Array, ...]
    driven_x: Array
    driven_quaternion: Array

    def moved(self, x: Array, quaternion: Array) -> Position:
        """Return the position with other poses of the free bodies."""
        return Position(x, quaternion, self.trees, self.driven_x, self.driven_quaternion)

    def bent(self, trees: tuple[Array, ...]) -> Position:
        """Return the position with other configurations of the trees."""
        return Position(self.x, self.quaternion, trees, self.driven_x, self.driven_quaternion)


class Placement(NamedTuple):
    """All frames at a position.

    Attributes
    ----------
    x, R : ndarray, shapes (frames, 3), (frames, 3, 3)
        Origins [m] and rotations to the world.
    links : tuple of Links
        The links of every tree, with its Jacobian.
    """

    x: Array
    R: Array
    links: tuple[Links, ...]

    @classmethod
    def of(cls, links: Links) -> Placement:
        """Return the placement of a scene whose frames are those of one tree."""
        return cls(links.x, links.R, (links,))

    @property
    def fields(self) -> Array:
        """Velocity fields of the coordinates of all trees, joined as `nsdyn._kernels.dynamics.links` takes them."""
        fields = [links.J.T.ravel() for links in self.links]
        return fields[0] if len(fields) == 1 else np.concatenate(fields)


class MidpointState(NamedTuple):
    """Midpoint of a step, where its forces and impulses act, after a part of the step without them.

    Attributes
    ----------
    position : Position
    v : ndarray, shape (n,)
        v⁻, the velocity before they act.
    placement : Placement
    trees : tuple of TreeMidpoint
    """

    position: Position
    v: Array
    placement: Placement
    trees: tuple[TreeMidpoint, ...]


class Forces(NamedTuple):
    """Forces of a step without contacts and joint rows, at the configuration of the impulses.

    Attributes
    ----------
    v : ndarray, shape (n,)
        Velocity after the step without impulses, v⁻ + M̃⁻¹ h f̃.
    foreseen : ndarray, shape (n,)
        The same, with the predicted forces of actuators that have rows.
    load : ndarray, shape (2, nf, 3)
        On free bodies: forces in world axes [N], torques about the centres of mass in body axes [N m].
    m, minv : ndarray
        M̃ and its inverse in the layout of `DelassusFactors`.
    trees : tuple of FreeMotion
    """

    v: Array
    foreseen: Array
    load: Array
    m: Array
    minv: Array
    trees: tuple[FreeMotion, ...]
