"""Gauss's principle at the level of accelerations: the extended least constraint and its dual.

At a state without impact, contacts that are closed and do not move apart either slide (u_T ≠ 0) or stick, with
relative accelerations a = Hᵀ v̇ + p, p = Ḣᵀ v. With bounds k on the normal forces frozen (Tresca's friction) the motion
minimises

    ½ v̇ᵀ M v̇ - fᵀ v̇ + Σ_slide μ k a_T·u_T/‖u_T‖ + Σ_stick μ k ‖a_T‖   under a_N ≥ 0,

kinetic constraint plus the rate at which dissipation changes. Its dual is a quadratic program in the contact forces γ,

    min ½ γᵀ G γ + κᵀ γ   over γ_N ≥ 0, ‖γ_T‖ ≤ μ k where it sticks,   G = Hᵀ M⁻¹ H,

and Coulomb's law asks for k = γ_N. Unlike a step, this may have no solution: Painlevé's rod.

References
----------
K. Yunt, On the relation of the principle of maximum dissipation to the principle of Gauss, equations 58 and 70. G. K.
Pozharitskii, Extension of the principle of Gauss to systems with dry friction, PMM 25, 1961.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nsdyn.collision.contacts import ContactMemory, ContactSet
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics, Forces, Position
from nsdyn.scene import pairs
from nsdyn.scene.scene import Scene
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array

__all__ = ["Acceleration", "Existence", "LeastConstraint", "accelerations", "least_constraint"]

REACH = 1e-5
"""Ḣᵀ v is a central difference over a motion of this fraction of the smallest body."""

PASSES = 100
"""Most updates of the bounds k."""


class Existence(IntEnum):
    """Whether Coulomb's law has an answer; `message` says it in words."""

    SOLVED = 0
    NO_SOLUTION = 1
    NOT_FOUND = 2

    @property
    def message(self) -> str:
        """One sentence for a person."""
        return {
            Existence.SOLVED: "forces and accelerations satisfy Coulomb's law",
            Existence.NO_SOLUTION: "no contact forces keep the bodies apart: an impact without collision (Painlevé)",
            Existence.NOT_FOUND: "the normal forces did not settle",
        }[self]


@dataclass(frozen=True, eq=False)
class LeastConstraint:
    """Extended least-constraint problem of a state.

    Attributes
    ----------
    contacts : ContactSet
        The closed ones.
    frame : ndarray, shape (nc, 3, 3)
        Contact frames, rows (n, t1, t2), world axes.
    M : ndarray, shape (n, n)
    f : ndarray, shape (n,)
        Applied, gyroscopic and Coriolis forces.
    H : ndarray, shape (n, 3 nc)
    p : ndarray, shape (3 nc,)
        Ḣᵀ v, m/s².
    slip : ndarray, shape (nc, 2)
        Direction of u_T where the contact slides, 0 where it sticks.
    """

    contacts: ContactSet
    frame: Array
    M: Array
    f: Array
    H: Array
    p: Array
    slip: Array

    @property
    def sliding(self) -> NDArray[np.bool_]:
        """Which contacts slide, shape (nc,)."""
        return np.asarray(self.slip.any(axis=1))

    def relative(self, a: Array) -> Array:
        """Relative accelerations Hᵀ v̇ + p, shape (nc, 3)."""
        return (self.H.T @ a + self.p).reshape(-1, 3)

    def functional(self, a: Array, k: Array) -> float:
        """The functional that the motion minimises, at an acceleration v̇ with a_N ≥ 0, for frozen bounds k [N]."""
        a_T = self.relative(a)[:, 1:]
        change = np.where(self.sliding, (a_T * self.slip).sum(axis=1), np.linalg.norm(a_T, axis=1))
        return float(0.5 * a @ self.M @ a - self.f @ a + (self.contacts.mu * k) @ change)

    def dual(self, k: Array) -> Array:
        """Forces (nc, 3) of the dual program for bounds k [N]: frictional ones of sliding contacts are given by k."""
        mu, nc = self.contacts.mu, self.p.size // 3
        given = np.zeros((nc, 3))
        given[:, 1:] = -(mu * k)[:, None] * self.slip
        known = np.column_stack((np.zeros(nc, bool), self.sliding, self.sliding)).ravel()
        G, kappa = self._delassus()
        kappa = (kappa + G @ given.ravel())[~known]
        G = G[np.ix_(~known, ~known)]
        # γ_N ≥ 0 first, then (μ k, γ_T) in the second-order cone for each sticking contact.
        place = np.cumsum(~known) - 1
        normal, stick = place[0::3], np.flatnonzero(~self.sliding)
        rows = [sp.csc_matrix((-np.ones(nc), (np.arange(nc), normal)), shape=(nc, kappa.size))]
        bound = [np.zeros(nc)]
        for c in stick:
            tangents = (-np.ones(2), ([1, 2], place[3 * c + 1 : 3 * c + 3]))
            rows.append(sp.csc_matrix(tangents, shape=(3, kappa.size)))
            bound.append(np.array([mu[c] * k[c], 0.0, 0.0]))
        gamma = _cone_program(G, kappa, sp.vstack(rows, format="csc"), np.concatenate(bound), nc, stick.size)
        assert gamma is not None, "0 is feasible"
        out: Array = given.ravel()
        out[~known] = gamma
        return out.reshape(nc, 3)

    def impossible(self) -> bool:
        """Whether no forces of Coulomb's cone, opposing the slip where there is any, give a_N ≥ 0 everywhere."""
        mu, nc = self.contacts.mu, self.p.size // 3
        G, kappa = self._delassus()
        stick = np.flatnonzero(~self.sliding)
        cone = np.zeros((3 * nc, nc + 2 * stick.size))  # γ of the unknowns: normal forces, then sticking friction
        cone[np.arange(0, 3 * nc, 3), np.arange(nc)] = 1.0
        for i in (0, 1):
            cone[np.arange(1 + i, 3 * nc, 3), np.arange(nc)] = -mu * self.slip[:, i]
            cone[3 * stick + 1 + i, nc + 2 * np.arange(stick.size) + i] = 1.0
        apart = (G @ cone)[0::3]
        disk = np.zeros((3 * stick.size, cone.shape[1]))
        disk[0::3] = np.eye(cone.shape[1])[stick] * mu[stick, None]
        disk[1::3], disk[2::3] = np.eye(cone.shape[1])[nc::2], np.eye(cone.shape[1])[nc + 1 :: 2]
        rows = sp.csc_matrix(-np.vstack((apart, np.eye(nc, cone.shape[1]), disk)))
        bound = np.concatenate((kappa[0::3], np.zeros(nc + 3 * stick.size)))
        nothing = np.zeros((cone.shape[1], cone.shape[1]))
        return _cone_program(nothing, np.zeros(cone.shape[1]), rows, bound, 2 * nc, stick.size) is None

    def _delassus(self) -> tuple[Array, Array]:
        """(G, κ) over all contacts."""
        solved = np.linalg.solve(self.M, np.column_stack((self.H, self.f)))
        return self.H.T @ solved[:, :-1], self.H.T @ solved[:, -1] + self.p


@dataclass(frozen=True, eq=False)
class Acceleration:
    """Accelerations and contact forces of a state.

    Attributes
    ----------
    existence : Existence
        Unless it is SOLVED, the numbers below are the last bounds' answer.
    a : ndarray, shape (n,)
        v̇ in the coordinates of `Dynamics`.
    force : ndarray, shape (nc, 3)
        Contact forces γ on body 2, normal first, N.
    relative : ndarray, shape (nc, 3)
        Relative accelerations of the contacts, m/s²: ‖a_T‖ > 0 at a contact that sticks means that it starts to slip.
    problem : LeastConstraint
    """

    existence: Existence
    a: Array
    force: Array
    relative: Array
    problem: LeastConstraint


def _cone_program(P: Array, q: Array, A: Any, b: Array, linear: int, cones: int) -> Array | None:
    """min ½ xᵀ P x + qᵀ x under b - A x ≥ 0 for `linear` rows, then in second-order cones; None if infeasible."""
    try:
        import clarabel
    except ImportError as error:
        raise ImportError("accelerations need the solver clarabel: pip install 'nsdyn[acceleration]'") from error

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    # In units in which the matrix and the right side are 1.
    size = np.abs(P).max(initial=0.0) or 1.0
    load = max(np.abs(q).max(initial=0.0), np.abs(b).max(initial=0.0)) or 1.0
    unit = load / size if q.any() else load
    spaces = [clarabel.NonnegativeConeT(linear)] + [clarabel.SecondOrderConeT(3)] * cones
    upper = sp.triu(sp.csc_matrix(P / size), format="csc")
    solution = clarabel.DefaultSolver(upper, q / load, A, b / unit, spaces, settings).solve()
    status = clarabel.SolverStatus
    if solution.status in (status.PrimalInfeasible, status.AlmostPrimalInfeasible):
        return None
    # With a tolerance of round-off the method may stop a digit or two before it.
    if solution.status not in (status.Solved, status.AlmostSolved, status.InsufficientProgress):
        raise RuntimeError(f"the quadratic program was not solved: {solution.status}")
    return unit * np.array(solution.x)


def least_constraint(
    scene: Scene,
    state: State | None = None,
    wrenches: Mapping[str, Any] | None = None,
    tau: Mapping[str, Any] | None = None,
    closed: float = 1e-6,
    still: float = 1e-4,
) -> LeastConstraint:
    """Extended least-constraint problem of a scene in a given state.

    Parameters
    ----------
    scene : Scene
    state : State, optional
        Of a stepper of the scene; default its initial state.
    wrenches, tau : mapping, optional
        Forces on free bodies and in joints, as the callbacks of `Stepper` give them.
    closed : float
        Gap up to which a contact counts as closed, m.
    still : float
        Relative speed up to which a contact counts as neither opening nor sliding, m/s.

    Raises
    ------
    ValueError
        If a closed contact approaches faster than `still`: an impact, at which there is no acceleration. For scenes
        with dry joint friction, closed loops or prescribed motions, and joints at their limits: not in the problem.
    """
    d = Dynamics(scene)
    if d.surfaces.count or any(tree.constrained for tree in d.trees):
        raise ValueError("scene must have no closed loops or prescribed motions")
    geoms = scene.geoms()
    detector = Detector(geoms, pairs.pair_material(scene, geoms), pairs.excluded(scene, geoms))
    position, v = d.start() if state is None else (state.instant.position, state.instant.v)
    t = 0.0 if state is None else state.t
    twists = d.surfaces.twists(t)
    middle = d.halfway(position, v, 0.0, 0.5, twists)
    forces = d.forces(middle, t, 0.0, wrenches, tau)
    joints = d.joint_rows(position, v, v, 0.0)
    if joints is not None and (joints.mu.any() or joints.gap.min() <= closed):
        raise ValueError("scene must have no dry joint friction, and no joint at its limit")
    reach = np.full(d.frames, closed)
    found, memory = detector.find(*middle.placement[:2], reach, ContactMemory.empty())
    rows, frame = d.rows(found, middle.placement, forces, None)
    blocks = rows.full
    u = blocks.relative_velocity(v).reshape(-1, 3)
    touching = found.gap <= closed
    if (touching & (u[:, 0] < -still)).any():
        c = int(np.flatnonzero(touching)[u[touching, 0].argmin()])
        names = geoms[found.geom1[c]].name, geoms[found.geom2[c]].name
        raise ValueError(f"{names[0]!r} and {names[1]!r} approach at {-u[c, 0]:.3g} m/s: an impact, no acceleration")
    keep = np.flatnonzero(touching & (u[:, 0] <= still))
    M, H = blocks.dense()
    omega = v[: 6 * d.free].reshape(-1, 6)[:, 3:]
    torque = forces.torque - np.cross(omega, np.einsum("bij,bj->bi", d.J, omega))
    parts = [np.hstack((forces.force + d.mass[:, None] * d.gravity, torque)).ravel()]
    for tree, half, free in zip(d.trees, middle.trees, forces.trees, strict=True):
        parts.append(tree.forces(half, free, half.v).sum(axis=0) - tree.bias(half.q, half.v))
    f = np.concatenate(parts)

    # Relative velocities along the motion with v held, of the same contacts, in world axes and along their normals.
    size = min((g.shape.bounding_radius for g in geoms if g.frame >= 0), default=1.0)
    rate = float((d.reach(middle.placement, v, 1e-9, 0.0, twists) / 1e-9).max(initial=0.0))
    p = np.zeros((found.key.size, 3))
    if rate > 0.0 and v.any():
        step = REACH * size / rate
        ahead, behind = (
            _along(d, detector, position, v, s, forces, reach + 10 * REACH * size, found, memory) for s in (step, -step)
        )
        if not np.isfinite(ahead[keep] - behind[keep]).all():
            raise ValueError("a closed contact ends or begins at this very state: its acceleration is not defined")
        change = (ahead - behind) / (2.0 * step)
        p[:, 0] = change[:, 3]
        p[:, 1:] = np.einsum("cij,cj->ci", frame[:, 1:], change[:, :3])
    slip = np.where(np.linalg.norm(u[:, 1:], axis=1, keepdims=True) > still, u[:, 1:], 0.0)
    slip /= np.linalg.norm(slip, axis=1, keepdims=True) + (slip == 0.0).all(axis=1, keepdims=True)
    columns = (3 * keep[:, None] + np.arange(3)).ravel()
    chosen = ContactSet(*(getattr(found, name)[keep] for name in ContactSet._fields))
    return LeastConstraint(chosen, frame[keep], M, f, H[:, columns], p[keep].ravel(), slip[keep])


def _along(
    d: Dynamics,
    detector: Detector,
    position: Position,
    v: Array,
    s: float,
    forces: Forces,
    reach: Array,
    found: ContactSet,
    memory: ContactMemory,
) -> Array:
    """Relative velocities (nc, 4) of the found contacts at position ⊕ s v: world axes, then normal; NaN if gone."""
    place = d.place(d.shift(position, s * v))
    there, _ = detector.find(*place[:2], reach, memory)
    rows, frame = d.rows(there, place, forces, None)
    u = rows.full.relative_velocity(v).reshape(-1, 3)
    out = np.full((found.key.size, 4), np.nan)
    _, here, others = np.intersect1d(found.key, there.key, return_indices=True)
    out[here, :3] = np.einsum("cij,ci->cj", frame[others], u[others])
    out[here, 3] = u[others, 0]
    return out


def accelerations(problem: LeastConstraint, tol: float = 1e-9) -> Acceleration:
    """Accelerations under Coulomb's law: bounds k = γ_N by fixed point with Aitken's relaxation.

    Parameters
    ----------
    problem : LeastConstraint
    tol : float
        Relative change of the normal forces at which they have settled.
    """
    nc = problem.p.size // 3
    k, omega = np.zeros(nc), 1.0
    force, last, settled = np.zeros((nc, 3)), np.zeros(nc), nc == 0
    for _ in range(PASSES if nc else 0):
        force = problem.dual(k)
        change = force[:, 0] - k
        if np.abs(change).max() <= tol * np.abs(force[:, 0]).max():
            settled = True
            break
        difference = change - last
        if last.any() and difference.any():
            omega *= -float(last @ difference) / float(difference @ difference)
        last = change
        k = np.maximum(k + omega * change, 0.0)
    a: Array = np.linalg.solve(problem.M, problem.f + problem.H @ force.ravel()).astype(float)
    existence = Existence.SOLVED
    if not settled:
        existence = Existence.NO_SOLUTION if problem.impossible() else Existence.NOT_FOUND
    return Acceleration(existence, a, force, problem.relative(a), problem)
