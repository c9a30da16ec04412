"""Accelerations of a scene in a state: its least-constraint problem, with joints, loops and driven joints.

The state is without impact. The problem contains the contacts that are closed and do not separate, the joints at their
limits and those with dry friction. `nsdyn.literature.least_constraint` has the problem and its laws.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from nsdyn.collision.contacts import ContactSet, ordered
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.linkages import Linkage
from nsdyn.dynamics.values import Forces, MidpointState, Position
from nsdyn.literature.least_constraint import Acceleration, Existence, JointTerms, LeastConstraint, accelerations
from nsdyn.scene import pairs
from nsdyn.scene.scene import Scene
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.displacements import integrate

__all__ = ["Acceleration", "Existence", "LeastConstraint", "accelerations", "least_constraint"]

REACH = 1e-5
"""Ḣᵀ v is a central difference over a motion of this fraction of the smallest body."""

DIFFERENCE = 1e-5
"""Step of central differences of smooth functions, rad, m or s: truncation and round-off are both of order 1e-10."""


def least_constraint(
    scene: Scene,
    state: State | None = None,
    wrenches: Mapping[str, Any] | None = None,
    tau: Mapping[str, Any] | None = None,
    closed: float = 1e-6,
    still: float = 1e-4,
) -> LeastConstraint:
    """Build the extended least-constraint problem of a scene in a given state, with joints, loops and driven joints.

    Parameters
    ----------
    scene : Scene
    state : State, optional
        State of a stepper of the scene; default its initial state.
    wrenches, tau : mapping, optional
        Forces on free bodies and in joints, as the callbacks of `Stepper` give them.
    closed : float
        Gap up to which a contact counts as closed, m.
    still : float
        Relative speed up to which a contact counts as neither opening nor sliding, m/s.

    Raises
    ------
    ValueError
        If a closed contact or a joint at its limit approaches faster than `still`: at an impact no acceleration exists.
        For scenes with driven bodies or sliding surfaces, which the problem does not cover.
    """
    d = Dynamics(scene)
    if d.surfaces.count:
        raise ValueError("scene must have no driven bodies and no sliding surfaces")
    geoms = scene.geoms()
    detector = Detector(geoms, pairs.pair_material(scene, geoms), pairs.excluded(scene, geoms))
    position, v = d.start() if state is None else (state.instant.position, state.instant.v)
    t = 0.0 if state is None else state.t
    twists = d.surfaces.twists(t)
    middle = d.halfway(position, v, 0.0, 0.5, twists)
    forces = d.forces(middle, t, 0.0, d.wrenches(middle.position, wrenches or {}), d.controls(tau or {}))
    joints = _joint_terms(d, position, v, closed, still)
    reach = np.full(d.frames, closed)
    found = detector.find(*middle.placement[:2], reach, ContactSet.empty())
    rows, frame = d.rows(found, middle.placement, forces, None)
    blocks = rows.full
    u = blocks.relative_velocity(v).reshape(-1, 3)
    touching = found.gap <= closed
    if (touching & (u[:, 0] < -still)).any():
        c = int(np.flatnonzero(touching)[u[touching, 0].argmin()])
        names = geoms[found.geom1[c]].name, geoms[found.geom2[c]].name
        raise ValueError(f"{names[0]!r} and {names[1]!r} approach at {-u[c, 0]:.3g} m/s: an impact, no acceleration")
    # A contact that no motion opens or closes, as that of a link on its own hinge, asks nothing of accelerations.
    keep = np.flatnonzero(touching & (u[:, 0] <= still) & rows.moved(closed, found.gap))
    M, H = blocks.dense()

    size = min((g.shape.bounding_radius for g in geoms if g.frame >= 0), default=1.0)
    rate = float((d.reach(middle.placement, v, 1e-9, 0.0, twists) / 1e-9).max(initial=0.0))

    def along(s: float) -> Array:
        """Relative velocities of the contacts after moving with constant v for the time s."""
        place = d.place(d.shift(position, s * v))
        there = detector.find(*place[:2], reach + 10 * REACH * size, found)
        rows, frame = d.rows(there, place, forces, None)
        return _of_same(found, there, rows.full.relative_velocity(v).reshape(-1, 3), frame)

    moves = rate > 0.0 and v.any()
    p = _drift(along, REACH * size / rate, frame, keep) if moves else np.zeros((keep.size, 3))
    slip = np.where(np.linalg.norm(u[:, 1:], axis=1, keepdims=True) > still, u[:, 1:], 0.0)
    slip /= np.linalg.norm(slip, axis=1, keepdims=True) + (slip == 0.0).all(axis=1, keepdims=True)
    columns = (3 * keep[:, None] + np.arange(3)).ravel()
    Z, given = _admissible(d, position, v, t, M, forces)
    f = _applied(d, middle, forces, v)
    return LeastConstraint(
        ordered(found, keep), frame[keep], M, f, H[:, columns], p.ravel(), slip[keep], Z, given, joints
    )


def _drift(along: Callable[[float], Array], step: float, frame: Array, keep: Index) -> Array:
    """Ḣᵀ v of the contacts `keep`, by a central difference of their velocities: (kept, 3) in their frames, m/s²."""
    ahead, behind = along(step)[keep], along(-step)[keep]
    if not np.isfinite(ahead - behind).all():
        raise ValueError("a closed contact ends or begins at this very state: its acceleration is not defined")
    change = (ahead - behind) / (2.0 * step)
    tangential = np.einsum("cij,cj->ci", frame[keep, 1:], change[:, :3])
    return np.column_stack([change[:, 3], tangential])


def _applied(d: Dynamics, middle: MidpointState, forces: Forces, v: Array) -> Array:
    """Forces on all coordinates, including gravity and gyroscopic terms, shape (n,)."""
    omega, (force, torque) = v[: 6 * d.free].reshape(-1, 6)[:, 3:], forces.load
    torque = torque - np.cross(omega, np.einsum("bij,bj->bi", d.J, omega))
    parts = [np.hstack((force + d.mass[:, None] * d.gravity, torque)).ravel()]
    for tree, half, free in zip(d.trees, middle.trees, forces.trees, strict=True):
        parts.append(tree.forces(half, free, half.v).sum(axis=0) - tree.bias(half.q, half.v))
    return np.concatenate(parts)


def _joint_terms(d: Dynamics, position: Position, v: Array, closed: float, still: float) -> JointTerms:
    """Limits that are reached, and joints with dry friction; ValueError for a joint that approaches its limit."""
    rows, e = d.joint_rows(d.place(position), v, v, 0.0), np.eye(d.n)
    if rows is None:
        return JointTerms(np.empty((d.n, 0)), np.empty((d.n, 0)), np.empty(0), np.empty(0))
    friction, rate = rows.mu > 0.0, d.joints.rates(rows.slot, v)
    reached = ~friction & (rows.gap <= closed)
    if (reached & (rate < -still)).any():
        fastest = float(rate[reached].min())
        raise ValueError(f"a joint runs into its limit at {-fastest:.3g} rad/s or m/s: an impact, no acceleration")
    at = rows.slot[reached & (rate <= still)]
    on = rows.slot[friction]
    if (d.joints.other[on] >= 0).any():
        raise ValueError("accelerations are not found with dry friction of a planar or ball joint: take it out")
    speed, coordinate = v[d.joints.coordinate[on]], d.joints.coordinate[at]
    slip = np.where(np.abs(speed) > still, np.sign(speed), 0.0)
    columns = e[:, coordinate] * d.joints.sign[at], e[:, d.joints.coordinate[on]]
    return JointTerms(*columns, d.joints.bound[on], slip)


def _admissible(d: Dynamics, position: Position, v: Array, t: float, M: Array, forces: Forces) -> tuple[Array, Array]:
    """Return (Z, v̇_p) of loops and driven joints; Z is the inverse root of M for parts without any."""
    given, Z, column = np.zeros(d.n), np.zeros((d.n, d.n)), 6 * d.free
    first = slice(0, column)
    Z[first, first] = np.linalg.inv(np.linalg.cholesky(M[first, first])).T
    for tree, q, free in zip(d.trees, position.trees, forces.trees, strict=True):
        rows = tree.coordinates
        if free.constraints is None:
            root = np.linalg.inv(np.linalg.cholesky(M[rows, rows])).T
        else:
            root = free.constraints.Z
            given[rows] = free.constraints.P @ constraint_acceleration(tree, q, v[rows], t)
        Z[rows, column : column + root.shape[1]] = root
        column += root.shape[1]
    return Z[:, :column], given


def constraint_acceleration(tree: Linkage, q: Array, v: Array, t: float) -> Array:
    """Return b of B v̇ = b, shape (m,): -Ġ v of the loops of a tree, then accelerations of its driven joints at time t.

    Both by central differences, Ġ v along a motion with constant v and closed loops.
    """
    loops, fastest = np.empty(0), float(np.abs(v).max(initial=0.0))
    if tree.closures is not None:
        loops = np.zeros(tree.closures.size)
        if fastest > 0.0:
            step = DIFFERENCE / fastest
            ends = (tree.close(integrate(tree.model, q, s * v)) for s in (step, -step))
            ahead, behind = (tree.closures.at(end)[1] for end in ends)
            loops = -(ahead - behind) @ v / (2.0 * step)
    rates = [(m.rate(t + DIFFERENCE) - m.rate(t - DIFFERENCE)) / (2.0 * DIFFERENCE) for m in tree.driven]
    return np.concatenate((loops, rates))


def _of_same(found: ContactSet, there: ContactSet, u: Array, frame: Array) -> Array:
    """Velocities u of contacts `there` as rows (nc, 4) of the same contacts in `found`: world axes, then normal.

    Rows of contacts that no longer exist are NaN.
    """
    out = np.full((found.key.size, 4), np.nan)
    _, here, others = np.intersect1d(found.key, there.key, return_indices=True)
    out[here, :3] = np.einsum("cij,ci->cj", frame[others], u[others])
    out[here, 3] = u[others, 0]
    return out
