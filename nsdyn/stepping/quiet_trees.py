"""A move of a scene with trees that meets nothing new: its stages in a row.

Where anything else shows, `nsdyn.stepping.move` begins again, which asks at every stage what else might happen: in
small scenes that takes half of a step.
"""

from __future__ import annotations

import numpy as np

from nsdyn._kernels import reductions as _few
from nsdyn._kernels.stepping import touching as _touching
from nsdyn.collision.contacts import ContactMemory, ContactSet, Looked
from nsdyn.stepping.booking import Passage, tree_works
from nsdyn.stepping.encounter import Encounter, foresee
from nsdyn.stepping.half import STILL_SURFACES, Callbacks, Half, corrected
from nsdyn.stepping.impulses import account
from nsdyn.stepping.instant import NOTHING, Instant, System
from nsdyn.stepping.persistence import NO_COUPLE, unfinished
from nsdyn.stepping.reversal import reversal
from nsdyn.stepping.sight import approach
from nsdyn.stepping.solving import Way, solve
from nsdyn.tools.arrays import Array

__all__ = ["quiet_trees"]


def quiet_trees(s: System, begin: Instant, half: Half, callbacks: Callbacks) -> Passage | None:
    """`quiet` in scenes with trees, under whatever forces, from the first half of a move, which callbacks correct.

    No joint is near its limits, none has dry friction, and no actuator is at its limit.
    """
    d, old, memory, looked, h = s.dynamics, begin.contacts, begin.memory, begin.looked, half.h
    middle, forces, reach, still = half.middle, half.forces, half.reach, STILL_SURFACES[1:]
    there, v = middle.placement, middle.v
    if d.surfaces.count or half.fast or _few.any_below(begin.limits, s.closed):
        return None
    if s.elastic and _bounces(s, begin, (forces.foreseen - begin.v) / h):
        return None
    if not (_few.most(old.gap) <= s.closed and s.striking_speed(begin) >= -s.slow / h):
        return None
    if d.with_actuators(d.joint_rows(there, v, forces.v, h), forces) is not None:
        return None
    seen = (old, memory, looked) if half.same else _looked(s, looked, (there.x, there.R, reach), old, memory, s.closed)
    if seen is None:
        return None
    contacts, memory, begun = seen
    looked = begun
    closing = s.closing(h, False)
    start = old, begin.position.driven_x, begin.placement, begin.twists, begin.v, begin.warm
    met = Encounter.of(d, contacts, None, middle.seen(looked), forces, start, reach, still, h, half.ahead, closing)
    met = met.lasting(s.detector.codes(contacts), begin.warm, (old, NOTHING), s.closed, h, False)
    slides = foresee(met)
    met, problem, solution, otherwise = solve(met, s.solver, None, slides, Way(closing, False, 0))
    if otherwise or reversal(met, s.solver, problem, solution) < 1.0:
        return None
    r = solution.r
    impulse, v_plus = met.rows.response(r, forces.v)
    if d.within_limits(middle, forces, v_plus) is not forces:
        return None
    if (again := corrected(s, begin, half, v_plus, callbacks)) is not half:
        return quiet_trees(s, begin, again, None)
    position, v_end, place, ends = d.end(middle, forces, v_plus, impulse, half.ahead, still[1])
    limits, same = d.limits(place), s.unmoved(looked, place, d.nowhere)
    now = place.x, place.R, d.nowhere
    seen = (contacts, memory, looked) if same else _looked(s, looked, now, contacts, memory, np.inf)
    if seen is None or _few.least(seen[0].gap) < -s.closed or _few.least(limits) < -s.closed:
        return None
    found, memory, looked = seen
    if unfinished(s, met, begun, looked, found, there.R, h, 0.5 * (v + v_plus), r, slides) is not None:
        return None
    impulses, own, warm = account(s, met, forces, (v, v, v_plus), r, h, None, NO_COUPLE, d.mass)
    works, energies = tree_works(s, begin, half, v_plus, ends, impulse, position, impulses, own)
    twists = d.twists(place, v_end)
    end = Instant(position, v_end, place, found, limits, memory, looked, warm, twists, energies)
    return Passage(end, half.rate, True, [impulses], [(problem, solution)], [works])


def _bounces(s: System, begin: Instant, rate: Array) -> bool:
    """Whether anything that may rebound strikes or parts faster than what rests at a free acceleration `rate` (n,)."""
    c = begin.contacts
    if _few.most(c.restitution) == 0.0:
        return False
    u, e = approach(s.dynamics, c, begin.placement, begin.v), c.restitution
    rests, resting = (of(c, None, e, begin.placement, rate) for of in (s.rests, s.resting))
    return bool(((e > 0.0) & ((u > s.solver.tol + rests) | (u < -resting))).any())


def _looked(
    s: System, last: Looked, now: tuple[Array, Array, Array], known: ContactSet, memory: ContactMemory, most: float
) -> tuple[ContactSet, ContactMemory, Looked] | None:
    """What is found at a placement; None if that is more than the contacts known with gaps of at most `most`."""
    looked = s.look(last, *now)
    found, memory = s.detector.find(*looked, memory)
    if not _touching.all_known(found.key, known.key, known.gap, most):
        return None
    return found, memory, looked
