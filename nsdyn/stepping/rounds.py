"""Rounds of impacts: one provokes the next, at one configuration and in no time, until no contact strikes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.impacts import Dissipative, Law, Round, answer, takes_part
from nsdyn.tools.arrays import Array, Bools, Index

ROUNDS = 60
"""Most rounds of impacts at one instant. The last round takes all closed contacts at once, by `Dissipative`; after it
no contact approaches."""


class Impact(NamedTuple):
    """The result of a series of impacts.

    Attributes
    ----------
    r : ndarray, shape (3 rows,)
        Sum of the impulses, N·s.
    u : ndarray, shape (3 rows,)
        Relative velocities after the impacts, m/s.
    work_normal, work_friction : ndarray, shape (rows,)
        Works of the impulses, J. On islands where no contact rebounds they are those of the summed impulses, at the
        mean of the first u and the last.
    created : float
        Energy created, J: the sum over rounds and islands of contacts whose impulses together did positive work, beyond
        the error of their solution.
    solved : (FC3D, Solution) or None
        Of the problems solved the worst; None where no contact struck.
    """

    r: Array
    u: Array
    work_normal: Array
    work_friction: Array
    created: float
    solved: tuple[FC3D, Solution] | None


def strike(law: Law, at: Round, resting: Array, slow: Array) -> Impact:
    """Apply impacts at one configuration until no contact strikes.

    Parameters
    ----------
    law : Law
    at : Round
        State of all contacts, with their restitutions e; `hit` are those that are closed and may carry impulses. Others
        strike, and are then closed, where no closed contact strikes.
    resting : ndarray, shape (rows,)
        Speeds of approach [m/s] below which a contact rests: a slower impact does not rebound.
    slow : ndarray, shape (rows,)
        Speeds of approach below which a contact does not strike at all; infinite for one that stays open.
    """
    blocks, u, _, restitution, closed, solver = at
    label = _islands(at, closed)
    total, works, bounced = np.zeros_like(u), np.zeros_like(u), np.zeros(closed.size, np.bool_)
    created, worst = 0.0, None
    for k in range(ROUNDS):
        hit = u[0::3] < -slow
        if not hit.any():
            break
        if (hit & closed).any():
            hit &= closed
        else:
            closed = closed | hit
            label = _islands(at, closed)
        # An island without an impact takes no part.
        struck = np.zeros(label.size + 1, np.bool_)
        struck[label[hit]] = True
        part = closed & struck[label]
        e = np.where(hit & (u[0::3] < -resting), restitution, 0.0)
        if k < ROUNDS - 1:
            # Without rebounds an island comes to rest in one round: one by one, contacts would strike in many rounds.
            rebounds = np.zeros(label.size + 1, np.bool_)
            rebounds[label[e > 0.0]] = True
            part &= takes_part(law, hit, restitution) | ~rebounds[label]
        else:
            law = Dissipative()
        impact = at._replace(before=u, e=e, hit=hit).of(part)
        own, solved = answer(law, impact)
        r = np.zeros_like(u)
        r[np.repeat(part, 3)] = own
        after = u + blocks.product(r)
        works += 0.5 * (u + after) * r
        bounced |= np.isin(label, label[e > 0.0])
        left = max(solver.tol, *(solution.residual for _, solution in solved))
        created += float(impact.created(own, impact.islands(), left).sum())
        total += r
        u = after
        for problem, solution in solved:
            if worst is None or solution.error > worst[1].error:
                worst = problem, solution
        if not all(solution.accepted for _, solution in solved):  # later rounds have no solution then
            break
    # A loose solution leaves velocities that may strike again. Without rebound, take the work of the summed impulses.
    works = np.where(np.repeat(bounced, 3), works, 0.5 * (at.before + u) * total)
    return Impact(total, u, works[0::3], works[1::3] + works[2::3], created, worst)


def _islands(at: Round, closed: Bools) -> Index:
    """Return the island of each closed contact, numbered from 0, and -1 for the others, (rows,)."""
    label = np.full(closed.size, -1)
    label[closed] = at.of(closed).islands()
    return label
