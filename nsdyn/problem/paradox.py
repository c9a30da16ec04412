"""Paradoxes of Coulomb's law: velocities that are not unique, and impulses that no force gives.

If W_NN < μ‖W_NT‖, friction presses a contact on faster than its normal impulse opens it. The law of this one contact
may then have several solutions: opening, sticking and slipping, all at once (Painlevé). A solver returns one of them.
`others` shows another velocity that obeys the law as well. This proves that the answer is one of several; if none is
found, nothing is proved. For each such contact `others` tries all other solutions of its own law, with the impulses of
the other contacts given, and solves from there. A result that comes back to the answer does not count, however far the
errors of both are apart.

Where a contact slides, and only a normal impulse that no force gives can hold it, the impulse does not fall with the
step although nothing collides. This is a jam, which stops the slip at once. `jams` reduces the loads on the normals to
a thousandth: forces fall by as much, but a jam stays.

References
----------
P. Painlevé, Sur les lois du frottement de glissement, C. R. Acad. Sci. Paris 121, 1895. F. Génot, B. Brogliato, New
results on Painlevé paradoxes, Eur. J. Mech. A/Solids 18, 1999.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from nsdyn._kernels.problem import paradox as _kernels
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array, Bools, Index

Solve = Callable[[FC3D, Array], Solution]

APART = 1e-6
"""Least distance of two different velocities, as a fraction of the velocity change by the larger impulse."""

FALL = 1e-3
"""Fraction of the loads on the normals that `jams` leaves."""


def ambiguous(problem: FC3D, u: Array, r: Array) -> Index:
    """Return the contacts whose own law admits several solutions, with the impulses r (3 nc,) of others given."""
    if problem.blocks is None:
        W = problem.W.toarray()
        n = np.arange(0, 3 * problem.nc, 3)
        return np.flatnonzero(W[n, n] < problem.mu * np.hypot(W[n, n + 1], W[n, n + 2]))
    out = np.empty(problem.nc, np.int64)
    return out[: _kernels.ambiguous(problem.blocks.arrays, problem.mu, u, r, out)]


def all_of_one(W: Array, q: Array, mu: float) -> Array:
    """Return all impulses that solve the law of one contact, u = W r + q with W (3, 3) symmetric, shape (k, 3)."""
    out = np.empty((_kernels.MOST, 3))
    return out[: _kernels.solutions(W, q, mu, out)]


def others(problem: FC3D, r: Array, solve: Solve, u: Array | None = None) -> Array | None:
    """Return another impulse (3 nc,) that solves the problem, with another velocity than r; None if none is found.

    W is symmetric, r (3 nc,) a solution, N·s, and u its velocity, m/s, if it is known.
    """
    u = problem.velocity(r) if u is None else u
    for c in ambiguous(problem, u, r):
        for guess in _instead(problem, r, u, int(c)):
            solution = Solution.judge(problem, guess, 1e-8, 0, 0.0)  # tolerance in m/s, and as a fraction of ‖q‖
            if not solution.converged:
                solution = solve(problem, guess)
            if solution.converged and _nearer(solution.r, guess, r, int(c)) and _apart(problem, r, solution.r):
                return solution.r
    return None


def _instead(problem: FC3D, r: Array, u: Array, c: int) -> Iterator[Array]:
    """Yield r with the impulse of contact c replaced by each other solution of its own law.

    The solution nearest to r is left out: it is that of r, up to its error.
    """
    rows, one = slice(3 * c, 3 * c + 3), np.zeros_like(r)
    W = np.empty((3, 3))
    for k in range(3):
        one[3 * c + k] = 1.0
        W[:, k] = problem.product(one)[rows]
        one[3 * c + k] = 0.0
    W = 0.5 * (W + W.T)
    if np.linalg.cond(W) > 1e12:  # the contact point moves in a plane only
        return
    admitted = all_of_one(W, u[rows] - W @ r[rows], float(problem.mu[c]))
    for k in np.argsort(np.linalg.norm(admitted - r[rows], axis=1))[1:]:
        out = r.copy()
        out[rows] = admitted[k]
        yield out


def _nearer(x: Array, guess: Array, r: Array, c: int) -> bool:
    """Whether the impulse of contact c is nearer to the guess than to r; else x may be r, up to the errors of both."""
    rows = slice(3 * c, 3 * c + 3)
    return bool(np.linalg.norm(x[rows] - guess[rows]) < np.linalg.norm(x[rows] - r[rows]))


def _apart(problem: FC3D, r: Array, other: Array) -> bool:
    """Whether two impulses give two different velocities."""

    def size(x: Array) -> float:
        return math.sqrt(max(0.0, float(x @ problem.product(x))))

    return size(r - other) > APART * max(size(r), size(other))


def jams(problem: FC3D, solution: Solution, contacts: int, fall: float, solve: Solve) -> Bools:
    """Return which of the first `contacts` contacts stop by an impulse that no force gives, shape (contacts,).

    Free accelerations give a velocity `fall` in the step, m/s.
    """
    q, u, r = (x.reshape(-1, 3)[:contacts] for x in (problem.q, solution.u, solution.r))
    pressed = r[:, 0] > 0.0
    load = max(float(np.abs(q[pressed, 0]).max(initial=0.0)), fall)
    odd: Bools = pressed & (np.hypot(u[:, 1] - q[:, 1], u[:, 2] - q[:, 2]) > _kernels.ODD * load)
    if not odd.any():
        return odd
    less = problem.q.copy()
    less[0 : 3 * contacts : 3][pressed] *= FALL
    again = solve(problem.with_velocity(less), solution.r)
    return odd & (again.r[0 : 3 * contacts : 3] > 0.5 * r[:, 0]) & again.accepted
