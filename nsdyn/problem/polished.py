"""First-order error of a solution: its distance from a polished one, and its defect in Coulomb's law.

With the shift s = μ‖u_T‖ of a solution r frozen, `gauss` bounds its distance from the velocity v* of least constraint
by √η where r is right up to η. But for any other r' in K

    ‖v(r) - v*‖_M ≤ ‖v(r) - v(r')‖_M + bound(r').

If r' solves the frozen problem to round-off, the first term is the error itself. The last term is then 1e-8 of the root
of the energy at play, the root of round-off. The frozen problem is convex, and `frozen.Least` solves it from r in a few
Newton steps.

v* is not a solution of Coulomb's problem: its slip differs from that of v, so that it has another shift s'. The
distance of v*(s') from v*(s) is the defect in Coulomb's law. It is 0 at solutions of Coulomb's problem, where
v*(s) = v. It does not bound the distance to a solution, which need not be unique, or exist.
"""

from __future__ import annotations

import math

import numpy as np

from nsdyn._kernels.problem import gauss as _kernels
from nsdyn._kernels.problem.cones import ROUNDING, into_cones
from nsdyn.problem import gauss
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.frozen import Least
from nsdyn.tools.arrays import Array

PENALTY, LEAST = 1e3, 50.0
"""Penalty times λ_max(W_cc) of the first multiplier step, and the least; the largest is that of `gauss`. Where contacts
are redundant, all impulses may change with the choice of the contacts that carry, while the velocity hardly changes.
The penalty grows by factors of ten until these contacts are found, as long as Newton's method settles. Round-off grows
with the penalty, so that it falls again once they are found."""

STEPS = 30
"""Most multiplier steps of a polished solution, and Newton steps of each."""

PART = 0.1
"""Newton's method is exact to this fraction of a multiplier step. A multiplier step of at most this fraction of the
last one shows that the contacts that carry are found."""

ROUND_OFF = _kernels.UNITS * ROUNDING

SHARP, FLOOR = 0.01, 1.5
"""Bounds of a polished solution that are sharp enough: as a fraction of the distance from it, and as a multiple of the
bound that round-off alone gives."""


def certify(
    problem: FC3D, r: Array, u: Array | None = None, slater: gauss.SlaterDirection | None = None
) -> tuple[gauss.Certificate, gauss.SlaterDirection | None]:
    """Return the certificate of an impulse, with a sharper bound, and the direction for the next certificate.

    The bound is linear in the error where this is tighter than that of `gauss.certify`, and the defect in Coulomb's law
    is included. Parameters and results are those of `gauss.certify`. Two convex problems take some Newton steps each,
    about as long as the solve. Round-off of velocities is counted, unless nothing opens every contact: the bound is
    then that of `gauss.certify`.
    """
    r = problem.impulse(r)
    certificate, slater = gauss.certify(problem, r, u, slater)
    if not math.isfinite(certificate.gap + certificate.shift):
        return certificate, slater
    impulse = np.empty_like(problem.q)
    if into_cones(r, problem.mu, impulse) or u is None:
        u = problem.velocity(impulse)
    d = slater.d if slater is not None and (slater.d.size or slater.wedged) else gauss.of_all(problem)
    shift = _shift(problem, u)
    first, bound = _polished(problem, shift, impulse, d)
    # The bound of the certificate does not count round-off, which between wedged contacts leaves no bound at all.
    bound = min(_bound(problem, shift, impulse, d), _distance(problem, impulse, first) + bound)
    bound = bound if bound < math.inf else certificate.bound
    second, _ = _polished(problem, _shift(problem, problem.velocity(first)), first, d)
    return certificate._replace(bound=bound, coulomb=_distance(problem, first, second)), slater


def polished(problem: FC3D, r: Array) -> Array:
    """Return the best solution found of the problem with the shift of r (3 nc,) in K frozen."""
    return _polished(problem, _shift(problem, problem.velocity(r)), r, gauss.of_all(problem))[0]


def _shift(problem: FC3D, u: Array) -> Array:
    """Return s = μ‖u_T‖ (nc,), m/s."""
    return problem.mu * np.sqrt(u[1::3] * u[1::3] + u[2::3] * u[2::3])


def _polished(problem: FC3D, s: Array, r: Array, d: Array) -> tuple[Array, float]:
    """Return the best r' found for the problem with the shift s (nc,) frozen, from r in K, and its bound, √J.

    A direction d, a `gauss.SlaterDirection.d`, may open the contacts.
    """
    b = -problem.q
    b[0::3] -= s
    least, x, best, bound = Least(problem, b, r), r, r, _bound(problem, s, r, d)
    least_bound = FLOOR * math.sqrt(_of_rounding(r, _rounding(problem, r, s)))
    if bound <= least_bound:
        return r, bound
    penalty, largest, last = PENALTY, gauss.LARGEST, 0.0
    for _ in range(STEPS):
        settled, size = _settled(problem, least, x, penalty)
        found = _bound(problem, s, least.estimate, d)
        if found < bound or bound == math.inf:
            best, bound = least.estimate.copy(), found
        if found <= max(SHARP * _distance(problem, r, best), least_bound) or penalty < LEAST:
            break
        if penalty <= PENALTY and size <= _round_off(least, penalty):
            break
        if not settled:  # penalty too large
            least.restart(x)
            penalty = largest = 0.1 * penalty
            continue
        x = least.estimate.copy()
        penalty, last = 0.1 * penalty if size <= PART * last else min(10.0 * penalty, largest), size
    return best, bound


def _settled(problem: FC3D, least: Least, x: Array, penalty: float) -> tuple[bool, float]:
    """Take Newton steps at an estimate x until they settle.

    Returns whether they do, and the size √λ_max(W_cc) |Δr| of the multiplier step that follows.
    """
    for _ in range(STEPS):
        fraction, defect = least.step(x, penalty)
        step = (least.estimate - x).reshape(-1, 3)
        size = math.sqrt(float(problem.scales @ (step * step).sum(axis=1)))
        if not fraction or defect * math.sqrt(penalty) <= max(PART * size, _round_off(least, penalty)):
            return fraction > 0.0, size
    return False, size


def _round_off(least: Least, penalty: float) -> float:
    """Return the size of multiplier steps that are mere round-off."""
    return ROUND_OFF * math.sqrt(penalty**3 * abs(least.square))


def _bound(problem: FC3D, s: Array, r: Array, d: Array) -> float:
    """Return the bound of an impulse r in K to the problem with the shift s (nc,) frozen, round-off counted, √J."""
    mu, u, error = problem.mu, problem.velocity(r), _rounding(problem, r, s)
    margin = u[0::3] + s - mu * np.hypot(u[1::3], u[2::3]) - (1.0 + mu) * error
    speed = max(0.0, -float(margin.min(initial=0.0)))
    for own in (False, True):
        if own:
            hat = u.copy()
            hat[0::3] += s - (1.0 + mu) * error
            d = gauss.of_own(problem, hat, speed)
        o, square = gauss.along(problem, d)
        step, total = _kernels.frozen(u, s, margin, r, o, mu, speed)
        if step < math.inf:
            half = 0.5 * float(step) * math.sqrt(square)
            return half + math.sqrt(half * half + float(total) + _of_rounding(r, error))
    return math.inf


def _of_rounding(r: Array, error: Array) -> float:
    """Return the amount that round-off of velocities (nc,) adds to Σ r·û of an impulse, J."""
    return 2.0 * float(np.abs(r.reshape(-1, 3)).sum(axis=1) @ error)


def _rounding(problem: FC3D, r: Array, s: Array) -> Array:
    """Return the round-off of the velocities of the contacts of an impulse, shape (nc,), m/s."""
    scale = np.sqrt(problem.scales)
    push = scale * np.linalg.norm(r.reshape(-1, 3), axis=1)
    if problem.blocks is None:
        indptr, indices, _ = problem.csr
        near = np.add.reduceat(push[indices], indptr[:-1])
    else:
        block = problem.blocks.block
        total = np.zeros(problem.blocks.offset.size)  # the last entry stands for no block
        np.add.at(total, block, push[:, None])
        total[-1] = 0.0
        near = total[block].sum(axis=1)
    return ROUND_OFF * (scale * near + np.abs(problem.q).reshape(-1, 3).max(axis=1) + s)


def _distance(problem: FC3D, r: Array, other: Array) -> float:
    """Return ‖v(r) - v(r')‖_M with its round-off, √J."""
    change = r - other
    size = ROUND_OFF * float(np.sqrt(problem.scales) @ np.linalg.norm(change.reshape(-1, 3), axis=1))
    if problem.blocks is not None:
        p = problem.blocks.momentum(change)
        return math.sqrt(max(0.0, float(p @ problem.blocks.velocity_change(change)))) + size
    # Cancellation in W r leaves the root of its round-off.
    square = float(change @ problem.product(change))
    return math.sqrt(max(0.0, square) + size * size / (ROUND_OFF))
