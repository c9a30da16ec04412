"""The way through a step: moves and impacts one after the other, in pieces where bodies would sink."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.collisions import collide
from nsdyn.stepping.energy import Works
from nsdyn.stepping.instant import DEEP, EVENTS, SHALLOW, Impulses, Instant, System, take
from nsdyn.stepping.move import Callbacks, Half, Trial, finish, first_half, trial
from nsdyn.stepping.quiet import Moves, quiet, quiet_trees
from nsdyn.stepping.sight import Unmet, others
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array, Index

__all__ = ["Passage", "through"]

Loads = Callable[[float], Callbacks]

HITS, LOCATED = 16, 50
"""Most contacts that may be hit in a step, and most contacts in all, so that the effort is bounded; beyond, impacts are
caught within the step."""

HALVINGS, TRIES, SHALLOWER = 10, 64, 0.125
"""Most times that a step is halved in which bodies sank or were lifted far, most pieces tried in it, so that the effort
is bounded, and by what fraction bodies may then run less far into each other: impulses and projections
at more configurations err less."""

CLOSER = 50
"""Most times that a move is shortened so as not to go much farther than to what it touches; two or three are usual."""

NONE, NOTHING = np.empty(0, np.int64), np.empty(0)


class Passage(NamedTuple):
    """Moves and impacts one after the other.

    Attributes
    ----------
    end : Instant
    rate : ndarray, shape (n,)
        Last free acceleration, m/s² and rad/s².
    clear : bool
        Whether the end is without overlap.
    done : list of Impulses
    solved : list of (FC3D, Solution)
        Of all problems.
    works : list of Works
    """

    end: Instant
    rate: Array
    clear: bool
    done: list[Impulses]
    solved: list[tuple[FC3D, Solution]]
    works: list[Works]


def through(system: System, state: State, loads: Loads) -> Passage:
    """Moves and impacts of a step, in one piece, or in several where that is too coarse (`_pass`).

    Parameters
    ----------
    system : System
    state : State
        Where the step begins.
    loads : callable
        What the user has to say at a time [s], as `nsdyn.stepping.move.trial` takes it.
    """
    begin = state.instant
    whole, coarse = _pass(system, loads, begin, state.next_t, system.dt, state.rate)
    return _in_pieces(system, state, loads) if coarse and begin.contacts.gap.size <= LOCATED else whole


def _in_pieces(system: System, state: State, loads: Loads) -> Passage:
    """The way through a step that is too coarse in one piece."""
    now, rate, clear = state.instant, state.rate, True
    done: list[Impulses] = []
    solved: list[tuple[FC3D, Solution]] = []
    works: list[Works] = []
    left, pieces, tries = system.dt, [1, 1], 1
    while pieces:
        halvings, tries = pieces.pop(), tries + 1
        h = system.dt * 0.5**halvings
        # Here bodies run less far into each other before they are stopped.
        s = system._replace(depth=DEEP * SHALLOWER**halvings)
        p, coarse = _pass(s, loads, now, state.next_t - (left - h), h, rate)
        if coarse and halvings < HALVINGS and tries < TRIES and now.contacts.gap.size <= LOCATED:
            pieces += [halvings + 1, halvings + 1]
            continue
        begun = system.dt - left
        now, rate, clear, left = p.end, p.rate, p.clear, left - h
        done, solved, works = done + [_later(a, begun) for a in p.done], solved + p.solved, works + p.works
    return Passage(now, rate, clear, done, solved, works)


def _pass(s: System, loads: Loads, begin: Instant, end: float, h: float, rate: Array) -> tuple[Passage, bool]:
    """Moves and impacts of h seconds until the time `end`, and whether pieces would do better.

    They would where bodies sink into each other so far, or in such wedges, that the projection would move them visibly.
    """
    found, half, sunk = None, None, False
    if begin.contacts.gap.size > LOCATED:
        s = s._replace(depth=SHALLOW)
    else:
        if s.dynamics.trees:
            half = first_half(s, begin, end - h, h, loads(end - h + (1.0 - s.theta) * h))
            found = quiet_trees(s, begin, half)
        elif loads(end) is None:
            found = quiet(s, begin, h)
    if found is None:
        found, sunk = _moves(s, loads, begin, end, h, rate, half)
    now, rate, clear, done, solved, works = found
    return Passage(now, rate, clear, done, solved, works), sunk and not any(_jammed(x) for _, x in solved)


def _moves(
    s: System, loads: Loads, begin: Instant, end: float, h: float, rate: Array, half: Half | None
) -> tuple[Moves, bool]:
    """Moves and impacts of h seconds until the time `end`; whether bodies sank into each other.

    The first half of a move all the way without impacts before it may be known.
    """
    now, left, clear, sunk = begin, h, True, False
    done: list[Impulses] = []
    solved: list[tuple[FC3D, Solution]] = []
    works: list[Works] = []
    for cut in range(EVENTS + 1):
        t = end - left
        if (struck := collide(s, now, t, left, rate)) is not None:
            now, impulses, more, pair = struck
            half = None
            done.append(_later(impulses, h - left))
            solved.append(pair)
            works.append(more)
        length, tried = (
            _until_impact(s, loads, now, t, left, half) if cut < EVENTS else (left, _try(s, loads, now, t, left, None))
        )
        half = None
        m = finish(s, now, tried)
        done.append(_later(m.impulses, h - left))
        moved = tried.response.moved
        sunk = sunk or s.sunk(moved.contacts) or s.shifted(moved.position, m.end.position)
        now, rate, left, clear = m.end, m.rate, left - length, m.clear
        solved.append((m.problem, m.solution))
        works += m.works
        if left <= 1e-12 * h:
            break
    return (now, rate, clear, done, solved, works), sunk


def _jammed(solution: Solution) -> bool:
    """Whether bodies are where no velocity opens their contacts: there nothing is gained by looking closer."""
    return solution.status is Status.NO_SLATER_POINT


def _later(acted: Impulses, begun: float) -> Impulses:
    """What acted in a part that began so many seconds after the whole."""
    return acted._replace(time=begun + acted.time) if begun > 0.0 else acted


def _until_impact(
    s: System, loads: Loads, begin: Instant, t: float, h: float, half: Half | None = None, looks: int = CLOSER
) -> tuple[float, Trial]:
    """A move of at most h seconds to the first impact on its way, and its length; all the way if they are many.

    The first half of a move of h seconds may be known.
    """
    if begin.contacts.gap.size > LOCATED:
        return h, _try(s, loads, begin, t, h, None)
    m = _try(s, loads, begin, t, h, NONE, half)
    if _jammed(m.response.solution):
        return h, _try(s, loads, begin, t, h, None)
    if m.touched < h and looks:
        return _until_impact(s, loads, begin, t, m.touched, None, looks - 1)
    if m.unmet is None:
        return h, m
    hit = m.unmet.gap < -m.unmet.limit
    if not hit.any():
        return h, m
    if hit.sum() > HITS:
        return h, _try(s, loads, begin, t, h, None)
    barred, limit = np.unique(m.unmet.code[hit]), float(m.unmet.limit[hit].min())
    far = s.dynamics.reach(begin.placement, begin.v, h, h, s.dynamics.surfaces.twists(t))
    found, _ = s.detector.find(begin.placement.x, begin.placement.R, far, begin.memory)
    held = s.dynamics.joints.limits[begin.limits <= s.closed]
    before = others(s, found, take(begin.contacts, begin.contacts.gap <= s.closed), begin.limits, held)
    wide, moves = float(far.max(initial=s.closed)), {h: m}

    def least(left: Unmet | None) -> float:
        """Least gap of what is hit; 0 where the difference does not matter."""
        gaps = NOTHING if left is None else left.gap[np.isin(left.code, barred)]
        gap = float(gaps.min()) if gaps.size else wide
        return 0.0 if abs(gap) <= 1e-3 * s.closed else gap

    def gap(time: float) -> float:
        if time == 0.0:
            return max(least(before), s.closed)
        if time not in moves:
            moves[time] = _try(s, loads, begin, t, time, barred)
        return least(moves[time].unmet)

    brentq(gap, 0.0, h, xtol=1e-15 * h, rtol=1e-15, maxiter=30, disp=False)
    # Where another feature is the first to touch the gap jumps, and has no root.
    length = min(moves, key=lambda time: abs(gap(time)))
    best, located = moves[length], abs(gap(length)) <= limit
    # What `gap` holds lives until garbage is collected: SciPy wraps it in a function that refers to itself.
    moves.clear()
    return (length, best) if located else (h, _try(s, loads, begin, t, h, None))


def _try(
    s: System, loads: Loads, begin: Instant, t: float, h: float, barred: Index | None, half: Half | None = None
) -> Trial:
    """A move of h seconds, with what the user has to say where its impulses act, unless its first half is known."""
    return trial(s, begin, t, h, None if half else loads(t + (1.0 - s.theta) * h), barred, half)
