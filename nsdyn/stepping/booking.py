"""What a move did: where it ends without overlap, works, and energies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nsdyn.dynamics.ledger import Works
from nsdyn.dynamics.values import Energies, Flow, Placement, Position
from nsdyn.stepping.half import Half
from nsdyn.stepping.impulses import Impulses, account
from nsdyn.stepping.instant import Instant, System
from nsdyn.stepping.projection import project
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.trial import Trial
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.displacements import displacement

__all__ = ["Passage", "finish", "tree_works"]

OPEN = np.int8(0)


class Passage(NamedTuple):
    """A move, or moves and impacts one after the other.

    Attributes
    ----------
    end : Instant
    rate : ndarray, shape (n,)
        Last free acceleration, m/s² and rad/s².
    clear : bool
        Whether the end is without overlap.
    done : list of Impulses
    path : sequence of Placement
        Where the frames were on their way: between two of them bodies go straight, turning at constant rates.
    """

    end: Instant
    rate: Array
    clear: bool
    done: list[Impulses]
    path: Sequence[Placement] = ()


def finish(s: System, begin: Instant, a: Trial, left: Bools | None = None) -> Passage:
    """The move to a position without overlap, and what was done on its way; of the nodes `left`, if not of all."""
    d, half = s.dynamics, a.half
    end, clear = project(s, a.moved, half.forces)
    v = half.middle.v
    velocities = v, v if a.impact is None else v + a.kick, a.v
    mass = d.mass if left is None else np.where(left[: d.free], d.mass, 0.0)
    impulses, warm = account(s, a.met, velocities, (a.problem, a.solution), half.h, a.impact, a.couple, mass)
    impulses, own = impulses._replace(wrench=half.wrench(left)), half.booked(impulses.works, *velocities[1:], left)
    # What has just closed its gap approaches: where it would become deep in the next move it strikes before.
    sinks = s.dt / half.ahead * a.met.end_gap[: warm.status.size] > s.deep(a.met.contacts)
    arrived = sinks & ~a.met.stays[: sinks.size]
    if arrived.any():
        warm = warm._replace(status=np.where(arrived, OPEN, warm.status))
    works: list[Works] = []
    if end is not a.moved:
        v_end, lifted = d.lift(a.moved.position, end.position, end.v)
        works.append(Works(projection=lifted))
        impulses = impulses._replace(lift=d.shifted(a.moved.position, end.position))
        for t, q, there in zip(d.trees, a.moved.position.trees, end.position.trees, strict=True):
            impulses.joints[4, t.columns] = displacement(t.model, q, there)
        end = end._replace(v=v_end, twists=d.twists(end.placement, v_end))
    energies: Energies = ()
    if d.trees:
        acted = impulses.joints, impulses.links
        trees = begin.energies, half, a.v, a.trees, a.impulse, end.position
        own, energies = tree_works(s, *trees, acted, own, left)
        if a.impact is not None:
            works.append(_struck(s, a, a.impact))
    end = end._replace(warm=warm, energies=energies)
    return Passage(end, half.rate, clear, [impulses._replace(works=Works.total([own, *works]))])


def tree_works(
    s: System,
    before: Energies,
    half: Half,
    v: Array,
    ends: tuple[Flow, ...],
    impulse: Array,
    lifted: Position,
    acted: tuple[Array, Array],
    own: Works,
    left: Bools | None = None,
) -> tuple[Works, Energies]:
    """Works of the trees and `own` ones, of contacts and joint rows, and their energies where they are lifted to, J.

    Parameters
    ----------
    s : System
    before : tuple of (float, float)
        Their energies where the move begins.
    half : Half
    v : ndarray, shape (n,)
        What the forces leave, with the impulses.
    ends : tuple of Flow
    impulse : ndarray, shape (n,)
        H r of contacts and joint rows.
    lifted : Position
    acted : (ndarray, ndarray)
        (joints, links), as of `Impulses`. The impulses of actuation, of external wrenches and the most that actuators
        may give go into rows 0, 3 and 5 of the joints, the change of velocity of driven joints into row 6, the wrenches
        into the links.
    own : Works
    left : ndarray of bool, optional
        Nodes; trees that are not among them are passed over.
    """
    works, energies, (joints, links), link = [own], [], acted, 0
    of_trees = zip(s.dynamics.trees, half.middle.trees, half.forces.trees, ends, lifted.trees, before, strict=True)
    for node, (t, there, free, end, q, energy) in enumerate(of_trees, start=s.dynamics.free):
        k, first = t.coordinates, link
        link += t.model.njoints - 1
        if left is not None and not left[node]:
            energies.append(energy)
            continue
        work, energy = t.works(there, free, v[k], end, q, impulse[k], energy, joints)
        if free.loads.wrenches is not None:
            links[first:link] = half.h * free.loads.wrenches
        if t.driven:
            joints[6, t.columns] = t.speeding(there.begin_v, free.loads.rates)
        energies.append(energy)
        works.append(work)
    return Works.total(works), tuple(energies)


def _struck(s: System, a: Trial, impact: Impact) -> Works:
    """What the rows that work on the trees in two parts do, at two mean velocities, and not at that of the forces."""
    full, v, struck = a.met.rows.full, a.half.middle.v, a.half.middle.v + a.kick
    first, second = full.momentum(impact.r), full.momentum(a.solution.r)
    booked = 0.5 * (first * (v + struck) + second * (struck + a.v))
    own = zip((t.coordinates for t in s.dynamics.trees), a.trees, strict=True)
    return Works(integration=sum(float(a.impulse[k] @ end.mean - booked[k].sum()) for k, end in own))
