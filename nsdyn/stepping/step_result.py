"""The result of a move: its end without overlap, its works, and the energies of trees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nsdyn._kernels.stepping.law import OPEN
from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.values import Energies, Flow, Forces, Placement, Position
from nsdyn.stepping.attempt import Attempt
from nsdyn.stepping.collisions import Captured
from nsdyn.stepping.impulses import Impulses, book
from nsdyn.stepping.midpoint import Midpoint
from nsdyn.stepping.projection import project
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.displacements import displacement


class StepResult(NamedTuple):
    """The result of a move, or of moves and impacts one after the other.

    Attributes
    ----------
    end : SceneState
    rate : ndarray, shape (n,)
        Last free acceleration, m/s² and rad/s².
    done : list of Impulses
    path : sequence of Placement
        Placements of the frames on their way. Between two of them bodies move straight and turn at constant rates.
    strays : sequence of bool
        For each tree, whether numerics add too much energy to its move, as in `Tree.strays`.
    """

    end: SceneState
    rate: Array
    done: list[Impulses]
    path: Sequence[Placement] = ()
    strays: Sequence[bool] = ()


def finish(s: System, begin: SceneState, a: Attempt, left: Bools | None = None) -> StepResult:
    """Project the end of a move to a position without overlap, and book the move; only the nodes `left`, if given."""
    d, mid = s.dynamics, a.mid
    end = project(s, a.moved, mid.forces)
    v = mid.state.v
    impact, struck = (None, v) if a.captured is None else (a.captured.impact, v + a.captured.kick)
    velocities = v, struck, a.v
    mass = d.mass if left is None else np.where(left[: d.free], d.mass, 0.0)
    impulses, warm = book(s, a.kin, velocities, (a.problem, a.solution), mid.h, impact, a.couple, mass)
    impulses, own = impulses._replace(wrench=mid.wrench(left)), mid.booked(impulses.works, *velocities[1:], left)
    # A contact that has just closed its gap approaches. If it would become deep in the next move, it strikes first.
    sinks = s.dt / mid.ahead * a.kin.end_gap[: warm.status.size] > s.penetration_tol(a.kin.contacts)
    arrived = sinks & ~a.kin.stays[: sinks.size]
    if arrived.any():
        warm = warm._replace(status=np.where(arrived, np.int8(OPEN), warm.status))
    works: list[Works] = []
    if end is not a.moved:
        v_end, lifted = d.lift(a.moved.position, end.position, end.v)
        works.append(Works(projection=lifted))
        impulses = impulses._replace(lift=d.shifted(a.moved.position, end.position))
        for t, q, there in zip(d.trees, a.moved.position.trees, end.position.trees, strict=True):
            impulses.joints[4, t.columns] = displacement(t.model, q, there)
        end = end._replace(v=v_end, twists=d.twists(end.placement, v_end))
    energies: Energies = ()
    strays: Sequence[bool] = ()
    if d.trees:
        beyond = None if a.captured is None else _beyond(s, a, a.captured)
        trees = begin.energies, mid, a.forces, a.v, a.trees, a.impulse, (end.position, end.v)
        of_trees, energies, strays = tree_works(s, *trees, (impulses.joints, impulses.links), beyond, left)
        own = Works.total([own, *of_trees])
    if a.captured is not None:
        works.append(Works(integration=a.captured.unbooked))
    end = end._replace(warm=warm, energies=energies)
    done = [impulses._replace(works=Works.total([own, *works]))]
    return StepResult(end, mid.rate, done, strays=strays)


def tree_works(
    s: System,
    before: Energies,
    mid: Midpoint,
    forces: Forces,
    v: Array,
    ends: tuple[Flow, ...],
    impulse: Array,
    lifted: tuple[Position, Array],
    acted: tuple[Array, Array],
    beyond: list[float] | None = None,
    left: Bools | None = None,
) -> tuple[list[Works], Energies, tuple[bool, ...]]:
    """Return works of trees and their energies after the projection, J, and whether numerics add too much of it.

    Parameters
    ----------
    s : System
    before : tuple of (float, float)
        Energies of the trees where the move begins.
    mid : Midpoint
    forces : Forces
        The forces of the move, after captured impacts.
    v : ndarray, shape (n,)
        Velocity after the forces and the impulses.
    ends : tuple of Flow
    impulse : ndarray, shape (n,)
        H r of contacts and joint rows.
    lifted : (Position, ndarray)
        Position and velocity (n,) after the projection.
    acted : (ndarray, ndarray)
        (joints, links), as in `Impulses`. The impulses of actuation, of external wrenches and the most that actuators
        may give go into rows 0, 3 and 5 of the joints, the change of velocity of driven joints into row 6, that by
        captured impacts which forces see into row 7, the wrenches into the links.
    beyond : list of float, optional
        As `_beyond` returns it, where impacts act before the other impulses.
    left : ndarray of bool, optional
        Nodes to book; trees that are not among them are passed over.
    """
    works, energies, strays, (joints, links), link = [], [], [], acted, 0
    of_trees = zip(s.dynamics.trees, mid.state.trees, forces.trees, ends, lifted[0].trees, before, strict=True)
    for node, (t, there, free, end, q, energy) in enumerate(of_trees, start=s.dynamics.free):
        k, first = t.coordinates, link
        link += t.model.njoints - 1
        if left is not None and not left[node]:
            energies.append(energy)
            strays.append(False)
            continue
        work, after = t.works(there, free, v[k], end, (q, lifted[1][k]), impulse[k], energy, joints)
        if free.loads.wrenches is not None:
            links[first:link] = mid.h * free.loads.wrenches
        if t.driven:
            joints[6, t.columns] = t.speeding(there.begin_v, free.loads.rates)
        if beyond is not None:
            work = work._replace(integration=work.integration + beyond[node - s.dynamics.free])
            joints[7, t.columns] = free.before - there.v
        strays.append(t.strays(there, free, v[k], end, energy, work.integration))
        energies.append(after)
        works.append(work)
    return works, tuple(energies), tuple(strays)


def _beyond(s: System, a: Attempt, captured: Captured) -> list[float]:
    """Return the work of rows on each tree beyond the booked works, if impacts act before other impulses, J.

    The two parts are booked at two mean velocities, not at the mean velocity of the forces.
    """
    full, v, struck = a.kin.rows.full, a.mid.state.v, a.mid.state.v + captured.kick
    first, second = full.momentum(captured.impact.r), full.momentum(a.solution.r)
    booked = 0.5 * (first * (v + struck) + second * (struck + a.v))
    own = zip((t.coordinates for t in s.dynamics.trees), a.trees, strict=True)
    return [float(a.impulse[k] @ end.mean - booked[k].sum()) for k, end in own]
