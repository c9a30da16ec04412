"""Gauss's principle at the level of accelerations: the extended least constraint and its dual.

Consider a state without impact. Contacts that are closed and do not separate either slide (u_T ≠ 0) or stick. Their
relative accelerations are a = Hᵀ v̇ + p, p = Ḣᵀ v. With frozen bounds k on the normal forces (Tresca's friction) the
motion minimises

    ½ v̇ᵀ M v̇ - fᵀ v̇ + Σ_slide μ k a_T·u_T/‖u_T‖ + Σ_stick μ k ‖a_T‖   under a_N ≥ 0,

kinetic constraint plus the rate of change of the dissipation. Its dual is a quadratic program in the contact forces γ,

    min ½ γᵀ G γ + κᵀ γ   over γ_N ≥ 0, ‖γ_T‖ ≤ μ k of sticking contacts,   G = Hᵀ M⁻¹ H,

and Coulomb's law requires k = γ_N. Unlike a step, this may have no solution: Painlevé's rod.

Any convex dissipation potential Φ(v) adds the rate dΦ/dt along the motion. A smooth potential, as of viscous joints,
gives a term linear in v̇: the force -∇Φ among the applied ones. Dry joint friction τ_c|v_j| gives τ_c sign(v_j) v̇_j
for a moving joint and τ_c |v̇_j| for one at rest, with constant bounds. A joint at its limit gives ±v̇_j ≥ 0. Loops and
driven joints give B v̇ = b, so v̇ = v̇_p + Z y with ZᵀMZ = I. The programs are then in y, and in the forces with Z Zᵀ in
place of M⁻¹.

References
----------
K. Yunt, On the relation of the principle of maximum dissipation to the principle of Gauss, equations 58 and 70. G. K.
Pozharitskii, Extension of the principle of Gauss to systems with dry friction, PMM 25, 1961.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from nsdyn.collision.contacts import ContactSet
from nsdyn.tools.arrays import Array

PASSES = 100
"""Largest number of updates of the bounds k."""


class Existence(IntEnum):
    """Whether Coulomb's law has a solution; `message` says it in words."""

    SOLVED = 0
    NO_SOLUTION = 1
    NOT_FOUND = 2

    @property
    def message(self) -> str:
        """One sentence that explains the value."""
        return {
            Existence.SOLVED: "forces and accelerations satisfy Coulomb's law",
            Existence.NO_SOLUTION: "no contact forces keep the bodies apart: an impact without collision (Painlevé)",
            Existence.NOT_FOUND: "the normal forces did not settle",
        }[self]


@dataclass(frozen=True, eq=False)
class JointTerms:
    """Limits and dry friction of joints at the level of accelerations.

    The acceleration away from a limit that is reached and not being left must be ≥ 0.
    """

    limits: Array  # column ±e_j of every such limit, (n, nl)
    friction: Array  # column e_j of every joint with dry friction, (n, nf)
    bound: Array  # τ_c, N m or N, (nf,)
    slip: Array  # sign of the joint's velocity, 0 for a joint at rest, (nf,)

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Mask of joints with friction that move, shape (nf,)."""
        return self.slip != 0.0


@dataclass(frozen=True, eq=False)
class LeastConstraint:
    """Extended least-constraint problem of a state.

    Attributes
    ----------
    contacts : ContactSet
        The closed contacts.
    frame : ndarray, shape (nc, 3, 3)
        Contact frames, rows (n, t1, t2), world axes.
    M : ndarray, shape (n, n)
    f : ndarray, shape (n,)
        Applied, gyroscopic and Coriolis forces.
    H : ndarray, shape (n, 3 nc)
    p : ndarray, shape (3 nc,)
        Ḣᵀ v, m/s².
    slip : ndarray, shape (nc, 2)
        Direction of u_T of sliding contacts, 0 for sticking ones.
    Z : ndarray, shape (n, ny)
        Basis of the accelerations that loops and driven joints leave free, ZᵀMZ = I.
    given : ndarray, shape (n,)
        v̇_p, the acceleration prescribed by loops and driven joints: all admissible accelerations are v̇_p + Z y.
    joints : JointTerms
    """

    contacts: ContactSet
    frame: Array
    M: Array
    f: Array
    H: Array
    p: Array
    slip: Array
    Z: Array
    given: Array
    joints: JointTerms

    @property
    def sliding(self) -> NDArray[np.bool_]:
        """Mask of sliding contacts, shape (nc,)."""
        return np.asarray(self.slip.any(axis=1))

    def relative(self, a: Array) -> Array:
        """Return the relative accelerations Hᵀ v̇ + p, shape (nc, 3)."""
        return (self.H.T @ a + self.p).reshape(-1, 3)

    def functional(self, a: Array, k: Array) -> float:
        """Return the functional that the motion minimises, at an admissible acceleration v̇, for frozen bounds k [N]."""
        a_T, joints = self.relative(a)[:, 1:], self.joints
        change = np.where(self.sliding, (a_T * self.slip).sum(axis=1), np.linalg.norm(a_T, axis=1))
        a_j = joints.friction.T @ a
        turn = np.where(joints.turning, joints.slip * a_j, np.abs(a_j))
        return float(0.5 * a @ self.M @ a - self.f @ a + (self.contacts.mu * k) @ change + joints.bound @ turn)

    def primal(self, k: Array) -> Array:
        """Return the acceleration v̇ (n,) that minimises `functional` for bounds k [N]: the primal program, equation 58.

        It is a cone program in y and in bounds s for sticking contacts and resting joints, ‖a_T‖ ≤ s and |v̇_j| ≤ s.
        ValueError if no acceleration is admissible: contacts and driven joints contradict each other.
        """
        mu, nc, joints, ny = self.contacts.mu, self.p.size // 3, self.joints, self.Z.shape[1]
        stick, still = np.flatnonzero(~self.sliding), np.flatnonzero(~joints.turning)
        n = ny + stick.size + still.size
        H, a0 = self.Z.T @ self.H, self.H.T @ self.given + self.p  # a = Hᵀ y + a0
        E, e0 = self.Z.T @ joints.friction, joints.friction.T @ self.given
        linear = self.Z.T @ (self.M @ self.given - self.f) + E @ (joints.bound * joints.slip)
        for i in (0, 1):
            linear = linear + H[:, 1 + i :: 3] @ (mu * k * self.slip[:, i])
        cost = np.concatenate((linear, (mu * k)[stick], joints.bound[still]))
        P = np.zeros((n, n))
        P[np.arange(ny), np.arange(ny)] = 1.0

        def pad(rows: Array, column: Array | None = None) -> Array:
            out = np.zeros((rows.shape[0], n))
            out[:, :ny] = rows
            if column is not None:
                out[np.arange(rows.shape[0]), column] = 1.0
            return out

        s = ny + stick.size + np.arange(still.size)
        inequalities = np.vstack(
            (pad(H[:, 0::3].T), pad((self.Z.T @ joints.limits).T), pad(E[:, still].T, s), pad(-E[:, still].T, s))
        )
        bound = np.concatenate((a0[0::3], joints.limits.T @ self.given, e0[still], -e0[still]))
        cones = np.zeros((stick.size, 3, n))
        cones[np.arange(stick.size), 0, ny + np.arange(stick.size)] = 1.0
        for i in (1, 2):
            cones[:, i, :ny] = H[:, i::3].T[stick]
        offset = np.column_stack((np.zeros(stick.size), a0.reshape(-1, 3)[stick, 1:]))
        A = -np.vstack((inequalities, cones.reshape(-1, n)))
        y = _cone_program(P, cost, A, np.concatenate((bound, offset.ravel())), stick.size)
        if y is None:
            raise ValueError(f"scene must have an admissible acceleration: its {nc} contacts contradict its joints")
        return self.given + self.Z @ y[:ny]

    def dual(self, k: Array) -> Array:
        """Return the dual program's forces for bounds k [N], shape (3 nc + nl + nf,): contacts, limits, joint friction.

        The bounds give the friction of sliding contacts and moving joints.
        """
        B, given, A, b = self._laws(k)
        if not B.shape[1]:
            return given
        G, kappa = self._delassus()
        x = _cone_program(B.T @ G @ B, B.T @ (kappa + G @ given), A, b, int((~self.sliding).sum()))
        assert x is not None, "0 is feasible"
        return given + B @ x

    def acceleration(self, forces: Array) -> Array:
        """Return v̇ (n,) under the forces of `dual`."""
        pushed = self.f + self._columns() @ forces - self.M @ self.given
        return self.given + self.Z @ (self.Z.T @ pushed)

    def impossible(self) -> bool:
        """Whether no forces of the laws satisfy contacts and limits, with friction opposing any existing slip."""
        (B, given, A, b), (G, kappa) = self._laws(None), self._delassus()
        first, nl = self.p.size, self.joints.limits.shape[1]
        apart = np.r_[0:first:3, first : first + nl]
        A, b = np.vstack((-(G @ B)[apart], A)), np.concatenate(((kappa + G @ given)[apart], b))
        nothing = np.zeros(B.shape[1])
        return _cone_program(np.diag(nothing), nothing, A, b, int((~self.sliding).sum())) is None

    def _laws(self, k: Array | None) -> tuple[Array, Array, Array, Array]:
        """Return (B, γ_0, A, b): the laws allow forces γ = B x + γ_0, with b - A x ≥ 0 and, last, in cones.

        x has normal forces, friction of sticking contacts, limits, and friction of resting joints. The bounds of
        friction are μ k; without k they are μ times the normal forces in x.
        """
        mu, nc, joints = self.contacts.mu, self.p.size // 3, self.joints
        stick, still, last = np.flatnonzero(~self.sliding), np.flatnonzero(~joints.turning), joints.limits.shape[1]
        ends = np.cumsum([nc, 2 * stick.size, last, still.size])
        normal, tangent, limit, rest = np.split(np.eye(ends[-1]), ends[:-1])
        last += 3 * nc
        B, given = np.zeros((last + joints.bound.size, ends[-1])), np.zeros(last + joints.bound.size)
        B[0 : 3 * nc : 3], B[3 * nc : last], B[last + still] = normal, limit, rest
        given[last:] = -joints.bound * joints.slip
        cone, b = np.zeros((stick.size, 3, ends[-1])), np.zeros((stick.size, 3))
        cone[:, 1:] = tangent.reshape(stick.size, 2, ends[-1])
        for i in (1, 2):
            B[3 * stick + i] = cone[:, i]
            if k is None:
                B[i : 3 * nc : 3] -= (mu * self.slip[:, i - 1])[:, None] * normal
            else:
                given[i : 3 * nc : 3] = -mu * k * self.slip[:, i - 1]
        if k is None:
            cone[:, 0] = mu[stick, None] * normal[stick]
        else:
            b[:, 0] = (mu * k)[stick]
        bound, held = np.zeros(nc + limit.shape[0]), joints.bound[still]
        A = -np.vstack((normal, limit, rest, -rest, cone.reshape(3 * stick.size, ends[-1])))
        return B, given, A, np.concatenate((bound, held, held, b.ravel()))

    def _columns(self) -> Array:
        """Directions of all forces, shape (n, 3 nc + nl + nf)."""
        return np.hstack((self.H, self.joints.limits, self.joints.friction))

    def _delassus(self) -> tuple[Array, Array]:
        """Return (G, κ) over all forces: accelerations along their directions are G γ + κ."""
        C = self._columns()
        U = self.Z.T @ C
        free = self.given + self.Z @ (self.Z.T @ (self.f - self.M @ self.given))
        drift = np.concatenate((self.p, np.zeros(C.shape[1] - self.p.size)))
        return U.T @ U, C.T @ free + drift


@dataclass(frozen=True, eq=False)
class Acceleration:
    """Accelerations and contact forces of a state.

    Attributes
    ----------
    existence : Existence
        If it is not SOLVED, the arrays hold the result for the last bounds.
    a : ndarray, shape (n,)
        v̇ in the coordinates of `Dynamics`.
    force : ndarray, shape (nc, 3)
        Contact forces γ on body 2, normal first, N.
    relative : ndarray, shape (nc, 3)
        Relative accelerations of the contacts, m/s²: ‖a_T‖ > 0 at a sticking contact means that it starts to slip.
    limit, friction : ndarray, shapes (nl,), (nf,)
        Forces of joint limits and of dry joint friction, in the order of `JointTerms`, N m or N.
    problem : LeastConstraint
    """

    existence: Existence
    a: Array
    force: Array
    relative: Array
    limit: Array
    friction: Array
    problem: LeastConstraint


def _cone_program(P: Array, q: Array, A: Array, b: Array, cones: int) -> Array | None:
    """Minimise ½ xᵀ P x + qᵀ x under b - A x ≥ 0, for the last 3 `cones` rows in those cones; None if infeasible."""
    try:
        import clarabel
    except ImportError as error:
        raise ImportError("accelerations need the solver clarabel: pip install 'nsdyn[acceleration]'") from error

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    # Scale to units in which the matrix and the right side are 1.
    size = np.abs(P).max(initial=0.0) or 1.0
    load = max(np.abs(q).max(initial=0.0), np.abs(b).max(initial=0.0)) or 1.0
    unit = load / size if q.any() else load
    spaces = [clarabel.NonnegativeConeT(b.size - 3 * cones)] + [clarabel.SecondOrderConeT(3)] * cones
    upper = sp.triu(sp.csc_matrix(P / size), format="csc")
    solution = clarabel.DefaultSolver(upper, q / load, sp.csc_matrix(A), b / unit, spaces, settings).solve()
    status = clarabel.SolverStatus
    if solution.status in (status.PrimalInfeasible, status.AlmostPrimalInfeasible):
        return None
    # At a tolerance of round-off the method may stop a digit or two short of it.
    if solution.status not in (status.Solved, status.AlmostSolved, status.InsufficientProgress):
        raise RuntimeError(f"the quadratic program was not solved: {solution.status}")
    return unit * np.array(solution.x)


def accelerations(problem: LeastConstraint, tol: float = 1e-9) -> Acceleration:
    """Compute accelerations under Coulomb's law: k = γ_N by fixed-point iteration with Aitken's relaxation.

    It ends at a relative change `tol` of the normal forces.
    """
    nc = problem.p.size // 3
    k, omega = np.zeros(nc), 1.0
    last, settled = np.zeros(nc), False
    for _ in range(PASSES):
        forces = problem.dual(k)
        force = forces[: 3 * nc].reshape(nc, 3)
        change = force[:, 0] - k
        if np.abs(change).max(initial=0.0) <= tol * np.abs(force[:, 0]).max(initial=0.0):
            settled = True
            break
        difference = change - last
        if last.any() and difference.any():
            omega *= -float(last @ difference) / float(difference @ difference)
        last = change
        k = np.maximum(k + omega * change, 0.0)
    a, others = problem.acceleration(forces), forces[3 * nc :]
    split = problem.joints.limits.shape[1]
    existence = Existence.SOLVED
    if not settled:
        existence = Existence.NO_SOLUTION if problem.impossible() else Existence.NOT_FOUND
    return Acceleration(existence, a, force, problem.relative(a), others[:split], others[split:], problem)
