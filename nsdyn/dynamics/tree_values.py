"""What a tree's motion is made of, as values: links, flows, loads, the free motion and the works of a step."""

from __future__ import annotations

from typing import NamedTuple

from nsdyn.tools.arrays import Array

__all__ = ["Constraints", "Flow", "FreeMotion", "Halfway", "Links", "TreeLoads"]


class Links(NamedTuple):
    """The k joints of a tree that carry geometry, at one configuration; world axes. And the angles of all joints.

    Attributes
    ----------
    x : ndarray, shape (k, 3)
        Origins of their frames, m.
    R : ndarray, shape (k, 3, 3)
        Their orientations.
    J : ndarray, shape (6, nv)
        Velocity field of every coordinate, linear at the world's origin, then angular; it moves the links that
        `Tree.support` says.
    angle : ndarray, shape (nv,)
        Joint coordinates in rad or m; 0 where a joint has none of its own (free, spherical).
    """

    x: Array
    R: Array
    J: Array
    angle: Array


class Flow(NamedTuple):
    """A motion of a tree between contacts, or the end of its step.

    Attributes
    ----------
    q, v : ndarray, shapes (nq,), (nv,)
        Configuration and velocity at its end.
    mean : ndarray, shape (nv,)
        Mean velocity; of a step that on which its forces worked.
    work : float
        Of driven joints, J; but for their reactions in the forces of a step that is not whole.
    whole : bool
        Whether it is one motion from the beginning of the step under all forces.
    """

    q: Array
    v: Array
    mean: Array
    work: float
    whole: bool = False


class Halfway(NamedTuple):
    """Where the forces of a step act, after (1 - θ) h of motion without forces.

    Attributes
    ----------
    begin, begin_v : ndarray, shapes (nq,), (nv,)
        Configuration and velocity at the beginning of the step.
    q, v : ndarray, shapes (nq,), (nv,)
        Configuration, and velocity before the forces.
    work : float
        Of driven joints until then, J.
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
    """What acts on a tree during a step besides contacts, joint limits and joint friction.

    Attributes
    ----------
    laws : ndarray, shape (2, 5, nv)
        Joint springs, and the control: what is linear in the velocity that the step leaves, as of
        `nsdyn._kernels.dynamics.trees.linear_laws`.
    push : ndarray, shape (nv,)
        Joint forces of external wrenches.
    wrenches : ndarray, shape (njoints - 1, 6), or None
        These on the links, force and moment about the world's origin, N and N m; None without any.
    weight : ndarray, shape (nv,)
        Gravity terms at the midpoint.
    rates : ndarray
        Velocities of the driven joints at the end of the step.
    limit : ndarray, shape (nv,), or None
        Most |τ| of the control; None where nothing is limited.
    clutch : ndarray, shape (3, nv), or None
        Of actuators that have rows, and no law above: impulse at the limit, speed of the rotor, and its mobility
        (1/mass); 0 of others.
    held : ndarray, shape (nv,)
        Their forces as far as they are foreseen; 0 of others.
    implicit : bool
        Whether there are damping, springs or a PD control, which act as the velocity after them says.
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
    """What the forces of a step without contacts and joint rows do.

    Attributes
    ----------
    v : ndarray, shape (nv,)
        Velocity after them.
    foreseen : ndarray, shape (nv,)
        The same with actuators that have rows at their limits.
    loads : TreeLoads
    m, minv : ndarray, shape (nv, nv)
        Effective mass matrix M̃ and its inverse, Z Zᵀ of a constrained tree.
    constraints : Constraints or None
    """

    v: Array
    foreseen: Array
    loads: TreeLoads
    m: Array
    minv: Array
    constraints: Constraints | None
