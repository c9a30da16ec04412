"""Paradoxes of Coulomb's law: velocities that are not unique, and impulses that are no force.

Where friction presses a contact on faster than its normal impulse opens it, W_NN < μ‖W_NT‖, the law of one contact
may have several solutions: it opens, sticks and slips, all at once (Painlevé). Of these a solver returns one. `others`
shows another velocity that obeys the law as well, which proves that the answer is one of several; where it finds none,
nothing is proved. It takes each such contact through all solutions of its own law, the impulses of others given, and
solves on from there.

Where a contact slides, and only normal impulses that no force gives would hold it, the impulse does not fall with the
step although nothing collides: a jam, which stops the slip at once. `jams` takes the loads on the normals away but for
a thousandth: forces fall by as much, and a jam stays.

References
----------
P. Painlevé, Sur les lois du frottement de glissement, C. R. Acad. Sci. Paris 121, 1895. F. Génot, B. Brogliato, New
results on Painlevé paradoxes, Eur. J. Mech. A/Solids 18, 1999.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.problem import paradox as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array, Index

__all__ = ["all_of_one", "ambiguous", "jams", "others"]

Solve = Callable[[FC3D, Array], Solution]

APART = 1e-6
"""Distance of two velocities, over the change that the larger impulse makes, from which on they are two."""

EXACT = 1e-9
"""Larger of both measures of a solution of one contact, in the unit of its velocity: those of a root of a quartic."""

FALL, ODD = 1e-3, 10.0
"""Of the loads on the normals, what is left of them; and the change of slip over those, from which on there may be a
jam: where friction is a force it is at most of the order of μ."""


def ambiguous(problem: FC3D, u: Array, r: Array) -> Index:
    """Contacts whose own law admits several solutions, the impulses r (3 nc,) of others given."""
    if problem.blocks is None:
        W = problem.W.toarray()
        n = np.arange(0, 3 * problem.nc, 3)
        return np.flatnonzero(W[n, n] < problem.mu * np.hypot(W[n, n + 1], W[n, n + 2]))
    out = np.empty(problem.nc, np.int64)
    return out[: _kernels.ambiguous(problem.blocks.arrays, problem.mu, u, r, out)]


def all_of_one(W: Array, q: Array, mu: float) -> list[Array]:
    """All impulses (3,) that solve u = W r + q, K* ∋ u + μ‖u_T‖ e_N ⟂ r ∈ K of one contact, W (3, 3) of full rank.

    It opens where q_N ≥ 0; sticks where -W⁻¹ q is in K; and slips with u_T = -α r_T, α > 0, where the impulse that
    leaves u_N = 0 is on the edge of K. By Cramer's rule its r_N det and r_T det are polynomials in α of degrees 2 and
    1: four roots at most.
    """
    found, eye = [np.zeros(3)] if q[0] >= 0.0 else [], np.diag([0.0, 1.0, 1.0])

    def impulse(alpha: float) -> Array:
        return np.asarray(-np.linalg.solve(W + alpha * eye, q), dtype=float)

    stick = impulse(0.0)
    if stick[0] > 0.0 and np.hypot(*stick[1:]) <= mu * stick[0]:
        found.append(stick)
    # Polynomials through their values, in the unit of W_TT.
    unit = 0.5 * float(W[1, 1] + W[2, 2])
    at = unit * np.arange(5.0)
    values = []
    for alpha in at:
        r = impulse(alpha) * np.linalg.det(W + alpha * eye)
        values.append(r[1] ** 2 + r[2] ** 2 - (mu * r[0]) ** 2)
    roots = np.roots(np.polyfit(np.arange(5.0), np.array(values) / max(np.abs(values).max(), 1e-300), 4))
    real = roots[np.abs(roots.imag) <= 1e-6 * (1.0 + np.abs(roots))].real
    problem = FC3D(W / unit, q / (np.abs(q).max() or 1.0), [mu])
    for alpha in unit * real[real > 0.0]:
        r = impulse(alpha)
        size = np.hypot(*r[1:])
        if r[0] > 0.0 and size > 0.0:
            r[1:] *= mu * r[0] / size
            if problem.solved(r * unit / (np.abs(q).max() or 1.0), EXACT)[0]:
                found.append(r)
    return found


def others(problem: FC3D, r: Array, solve: Solve, u: Array | None = None) -> Array | None:
    """Another impulse (3 nc,) that solves the problem as r does, with another velocity; None if none is found.

    Parameters
    ----------
    problem : FC3D
        With symmetric W.
    r : ndarray, shape (3 nc,)
        A solution, N·s.
    solve : callable
        A solver.
    u : ndarray, shape (3 nc,), optional
        Its velocity, where it is known, m/s.
    """
    u = problem.velocity(r) if u is None else u
    for c in ambiguous(problem, u, r):
        for guess in _instead(problem, r, u, int(c)):
            solution = Solution.judge(problem, guess, 1e-8, 0, 0.0)  # m/s, and of q
            if not solution.converged:
                solution = solve(problem, guess)
            if solution.converged and _apart(problem, r, solution.r):
                return solution.r
    return None


def _instead(problem: FC3D, r: Array, u: Array, c: int) -> Iterator[Array]:
    """Impulses with that of contact c replaced by all others that its own law admits."""
    rows, one = slice(3 * c, 3 * c + 3), np.zeros_like(r)
    W = np.empty((3, 3))
    for k in range(3):
        one[3 * c + k] = 1.0
        W[:, k] = (problem.velocity(one) - problem.q)[rows]
        one[3 * c + k] = 0.0
    W = 0.5 * (W + W.T)
    if np.linalg.cond(W) > 1e12:  # moves in a plane only
        return
    for own in all_of_one(W, u[rows] - W @ r[rows], float(problem.mu[c])):
        out = r.copy()
        out[rows] = own
        yield out


def _apart(problem: FC3D, r: Array, other: Array) -> bool:
    """Whether two impulses give two velocities."""

    def size(x: Array) -> float:
        return math.sqrt(max(0.0, float(x @ (problem.velocity(x) - problem.q))))

    return size(r - other) > APART * max(size(r), size(other))


def jams(problem: FC3D, solution: Solution, contacts: int, fall: float, solve: Solve) -> NDArray[np.bool_]:
    """Which contacts of a solution stop by an impulse that no force gives, shape (contacts,).

    Parameters
    ----------
    problem : FC3D
    solution : Solution
    contacts : int
        Rows of the problem that are contacts, the first; others are of joints.
    fall : float
        Velocity that free accelerations give in the step, m/s.
    solve : callable
        A solver.
    """
    q, u, r = (x.reshape(-1, 3)[:contacts] for x in (problem.q, solution.u, solution.r))
    pressed = r[:, 0] > 0.0
    load = max(float(np.abs(q[pressed, 0]).max(initial=0.0)), fall)
    odd: NDArray[np.bool_] = pressed & (np.hypot(u[:, 1] - q[:, 1], u[:, 2] - q[:, 2]) > ODD * load)
    if not odd.any():
        return odd
    less = problem.q.copy()
    less[0 : 3 * contacts : 3][pressed] *= FALL
    again = solve(problem.with_velocity(less), solution.r)
    return odd & (again.r[0 : 3 * contacts : 3] > 0.5 * r[:, 0]) & again.accepted
