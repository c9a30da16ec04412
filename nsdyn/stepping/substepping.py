"""The way of an island through a step: moves and impacts one after the other, in pieces where bodies would sink."""

from __future__ import annotations

import math

import numpy as np

from nsdyn._kernels.stepping import active_set as _active_set
from nsdyn._kernels.stepping import touching as _touching
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.active_set import normal_velocities, surface_normal_velocities
from nsdyn.stepping.attempt import Attempt, Known
from nsdyn.stepping.collisions import collide
from nsdyn.stepping.impulses import Impulses
from nsdyn.stepping.midpoint import Loads
from nsdyn.stepping.move import try_move
from nsdyn.stepping.scene_state import SceneState, System, among
from nsdyn.stepping.slip_reversal import reversal
from nsdyn.stepping.state import State
from nsdyn.stepping.step_result import StepResult, finish
from nsdyn.tools.arrays import Array, Bools, Index

__all__ = ["integrate", "turns_far"]

SOON, AGAIN = 1e-6, 0.1
"""Fractions of a move in which slip that turns round is not located: where it begins and ends, as nothing but
round-off, and where slip has just been cut, which is located to second order, what is left of it."""

LOOKS = 30
"""Most moves by which an impact is located."""

LINEAR = 0.1
"""Share of its last step that the next one of Newton's method has at most where it doubles its digits."""

JUMP = 1e-9
"""Fraction of a move in which a gap changes its sign so abruptly that it jumps."""

LEAST = 1e-12
"""Fraction of a step that is no time."""

NONE, NOTHING = np.empty(0, np.int64), np.empty(0)


class Budget:
    """What an island may still spend in a step, in contacts of moves."""

    def __init__(self) -> None:
        self.left = OPTIONS.work

    def affords(self, begin: SceneState, moves: int) -> bool:
        """Whether it may try so many moves from an instant."""
        return moves * _contacts(begin) <= self.left

    def spend(self, begin: SceneState) -> None:
        """Try a move from an instant."""
        self.left -= _contacts(begin)


def _contacts(begin: SceneState) -> int:
    """What a move from an instant costs."""
    return max(1, begin.contacts.gap.size)


def integrate(system: System, state: State, loads: Loads, begun: Known = None, meets: bool = False) -> StepResult:
    """Moves and impacts of a step: every move to its end or the first event, in halves where that is too rejected.

    What the user has to say at a time [s] is asked of `loads` as `nsdyn.stepping.midpoint` does. `begun` is what is known
    of the step in one move, `meets` whether that is known to meet an event.
    """
    now, rate, clear, at, cut = state.instant, state.rate, True, 0.0, False
    s = system.during(state.next_t - state.dt, state.dt, now.position)
    effort, pieces = Budget(), [(s.dt, 0)]
    done: list[Impulses] = []
    path = [now.placement]
    while pieces:
        end, halvings = pieces[-1]
        # In halves bodies run less far into each other before they are stopped.
        own, span = (
            s._replace(depth=OPTIONS.depth_located * OPTIONS.refine**halvings),
            (state.next_t - (s.dt - at), end - at),
        )
        move, length, rejected = _substep(own, loads, now, span, rate, effort, cut, begun, meets)
        begun, meets = None, False
        if rejected and _contacts(now) << halvings <= OPTIONS.work:
            pieces[-1:] = [(end, halvings + 1), (at + 0.5 * length, halvings + 1)]
            continue
        done += [_later(acted, at) for acted in move.done]
        path += move.path
        now, rate, clear, at = move.end, move.rate, move.clear, at + length
        cut = end - at > LEAST * s.dt
        if not cut:
            pieces.pop()
    return StepResult(now, rate, clear, done, path)


def _substep(
    s: System,
    loads: Loads,
    begin: SceneState,
    span: tuple[float, float],
    rate: Array,
    effort: Budget,
    cut: bool,
    begun: Known,
    meets: bool,
) -> tuple[StepResult, float, bool]:
    """What strikes at once, and a move to the first event on its way; its length, s, and whether it is too rejected.

    What strikes where no event is located is struck first only if it would become deeper than what a move catches.

    Parameters
    ----------
    s : System
    loads : callable
    begin : SceneState
    span : (float, float)
        When it begins and how long it lasts at most, s.
    rate : ndarray, shape (n,)
        Free acceleration at the beginning, m/s² and rad/s².
    effort : Budget
    cut : bool
        Whether the move before ended at an event.
    begun : Midpoint or Attempt, optional
        As of `integrate`, of a move all the way.
    meets : bool
        As of `integrate`.
    """
    (t, h), locates, now, done = span, effort.affords(begin, OPTIONS.event), begin, []
    meets = meets or (not locates and s.striking_speed(begin) < -s.least_penetration / h)
    if (struck := collide(s if locates else s.capturing, begin, t, h, rate)) is not None:
        now, begun, done = struck[0], None, [struck[1]]
    soon = h * (AGAIN if cut and struck is None else SOON)
    length, tried = _to_event(s, loads, now, t, h, soon, effort, begun, meets or struck is not None)
    m, moved = finish(s, now, tried), tried.moved
    path = [tried.mid.state.placement, moved.placement, m.end.placement]
    m = m._replace(done=done + m.done, path=path)
    rejected = s.sunk(moved.contacts) or s.shifted(moved.position, m.end.position)
    if length > LEAST * s.dt and not any(_jammed(acted.solved[1]) for acted in m.done):
        return m, length, rejected or _gains_energy(s, begin, m, length)
    return m, length, False


def _gains_energy(s: System, begin: SceneState, m: StepResult, h: float) -> bool:
    """Whether bodies that touch turn far in a move of h s, or what persists in it, or is lifted, adds energy."""
    d, works = s.dynamics, [a.works for a in m.done]
    if any(turns_far(s, h, a, begin, m.end).any() for a in m.done):
        return True
    gained = sum(w.integration for w in works)
    if not any(d.surfaces.carry(a.contacts).any() for a in m.done):  # of what is driven the work is its own
        gained += sum(w.projection for w in works)
        if not any((a.contacts.restitution > 0.0).any() for a in m.done):  # contacts then only take energy
            gained += sum(max(0.0, w.normal + w.friction) for w in works)
    if gained <= 0.0 or d.trees:  # which keep their own errors small
        return False
    # Where all is at rest, what gravity gives in a move is the scale.
    return gained > OPTIONS.gain * max(d.energies(begin.position, v, ())[0] for v in (begin.v, h * m.rate))


def turns_far(s: System, h: float, acted: Impulses, begin: SceneState, end: SceneState) -> Bools:
    """Contacts (nc,) that touch, of bodies that turn so far in half a move of h s that its law does not foresee it."""
    c, out = acted.contacts, np.empty(acted.status.size, np.bool_)
    spins = begin.twists[1], end.twists[1]
    _touching.turns_far(c[:3], acted.status, s.gap_tol, spins, OPTIONS.turn / (s.theta * h), out)
    return out


def _jammed(solution: Solution) -> bool:
    """Whether bodies are where no velocity opens their contacts: there nothing is gained by looking closer."""
    return solution.status is Status.NO_SLATER_POINT


def _later(acted: Impulses, begun: float) -> Impulses:
    """What acted in a part that began so many seconds after the whole."""
    return acted._replace(begin=begun + acted.begin) if begun > 0.0 else acted


def _to_event(
    s: System,
    loads: Loads,
    begin: SceneState,
    t: float,
    h: float,
    soon: float,
    effort: Budget,
    begun: Known = None,
    meets: bool = False,
    cut: bool = False,
) -> tuple[float, Attempt]:
    """A move of at most h seconds to the first impact on its way, and its length; all the way if that takes too long.

    Or to where a slip turns round. Too long take so many moves as would be too much to try.

    Parameters
    ----------
    s : System
    loads : callable
    begin : SceneState
    t, h : float
        Where it begins and how long it lasts at most, s.
    soon : float
        Before this, s, slip that turns round is not located.
    effort : Budget
    begun : Midpoint or Attempt, optional
        Of the move of h seconds.
    meets : bool
        Whether it is known to meet an event, or anything has just struck, and may be in a row of impacts.
    cut : bool
        Whether it ends where slip was to turn round.
    """

    def capture(begun: Known) -> tuple[float, Attempt]:
        return h, try_move(s.capturing, loads, begin, t, h, None, begun)

    # The first move is tried however many contacts it has: most meet no event.
    if not (affords := effort.affords(begin, OPTIONS.event)) and (meets or effort.left < OPTIONS.work):
        return capture(begun)
    effort.spend(begin)
    m = try_move(s, loads, begin, t, h, NONE, begun)
    begun, kin = m.mid, bool(m.hits.size)
    if _jammed(m.solution) or (not affords and (kin or m.touch_time < h or not m.solution.accepted)):
        return capture(begun)
    if m.touch_time < h:
        return _to_event(s, loads, begin, t, m.touch_time, soon, effort)
    turned = h * reversal(m.kin, s.solver, m.problem, m.solution, cut) if affords else h
    if soon < turned < (1.0 - SOON) * h:
        return _to_event(s, loads, begin, t, turned, soon, effort, cut=True)
    if not kin:
        return h, m
    located = np.unique(m.hits)
    if (found := _locate(s, loads, begin, t, {h: m}, located, m.limit, effort)) is not None:
        return found
    # What this move caught on its way may have driven it into what it hit.
    effort.spend(begin)
    m = try_move(s, loads, begin, t, h, located, begun)
    return capture(begun) if m.hits.size or begun.fast else (h, m)


def _locate(
    s: System,
    loads: Loads,
    begin: SceneState,
    t: float,
    moves: dict[float, Attempt],
    located: Index,
    limit: float,
    effort: Budget,
) -> tuple[float, Attempt] | None:
    """The move that ends where it first touches what is barred, and its length; None if none is found.

    It begins at the time t, s. One of the `moves`, by its length, s, has run into what is `located`, codes as of
    `Attempt`, which may run into each other by `limit`, m.
    """
    (h,) = moves
    far = s.dynamics.reach(begin.placement, begin.v, h, h, s.dynamics.surfaces.twists(t))
    wide = float(far.max(initial=s.gap_tol))
    aims: dict[float, float] = {}
    gaps: dict[float, float] = {}
    # Of what rebounds the energy tells where it struck.
    none = (1e-3 if limit <= s.gap_tol else 0.5) * s.gap_tol

    def gap(time: float) -> float:
        if time not in moves:
            effort.spend(begin)
            moves[time] = try_move(s, loads, begin, t, time, located)
        if time not in aims:
            aims[time], gaps[time] = _first_touch(s, begin, moves[time], located, wide)
        return gaps[time]

    low, high, length, last, misses, gains = 0.0, h, h, h, 0, True
    nearest = abs(gap(h))
    for _ in range(LOOKS):
        # Newton's method as long as it gains, else halves: in free flight it is exact.
        time = _next([*aims.items()][-2:])
        if len(aims) == 1 and not low < time < high:
            time = _foreseen(s, begin, located, t)
        aimed = gains and low < time < high
        time = time if aimed else 0.5 * (low + high)
        found = gap(time)
        gains = not aimed or abs(found) <= 0.5 * abs(gap(last))
        low, high = (time, high) if found > 0.0 else (low, time)
        misses = 0 if abs(found) <= 0.5 * nearest else misses + 1
        if abs(found) <= nearest:
            length, nearest = time, abs(found)
        last = time
        # Beyond what the solver leaves of velocities nothing is gained. A gap that jumps, where another feature is the
        # first to touch, has no root.
        if nearest <= none or high - low <= JUMP * h or (misses > 1 and -limit <= gap(length) <= s.gap_tol):
            break
    return (length, moves[length]) if -limit <= gap(length) <= s.gap_tol else None


def _foreseen(s: System, begin: SceneState, located: Index, t: float) -> float:
    """When contacts that are barred close at the speeds that they have at the time t, where a move begins, s."""
    c, d = begin.contacts, s.dynamics
    u = normal_velocities(d, c, begin.placement, begin.v, begin.position.driven_x, d.surfaces.twists(t))
    approach = among(s.detector.codes(c), located) & (c.gap > s.gap_tol) & (u < 0.0)
    return float((c.gap[approach] / -u[approach]).min(initial=math.inf))


def _next(aims: list[tuple[float, float]]) -> float:
    """Where to look after one or two times at which Newton's method aims at others.

    It aims by slopes of free motion. Where impulses change with the time it only comes nearer by a constant share a
    step: there the secant of aim - time tells the root.
    """
    (before, last), (time, aim) = aims[0], aims[-1]
    far = aim - time
    if time == before or not (abs(far) > LINEAR * abs(time - before) and math.isfinite(last + aim)):
        return aim
    slope = (aim - last) / (time - before)
    return time + far / (1.0 - slope) if slope < 1.0 else aim


def _first_touch(s: System, begin: SceneState, m: Attempt, located: Index, wide: float) -> tuple[float, float]:
    """When a move first touches what is barred, s, and its least gap there, `wide` where nothing of it is near.

    By parabolas of gaps that end as it does. They accelerate as they did on the way, whatever else pressed there; under
    the free forces where they were not seen at the beginning. The time may be past the end of the move; infinite where
    nothing tells. What is closed without approaching, as where it has just begun to part, does not touch.
    """
    d, moved, c, before = s.dynamics, m.moved, m.moved.contacts, begin.contacts
    there, joints, surfaces = moved.placement, d.joints, m.mid.surfaces
    rates, limits = d.twists(there, m.mid.rate), (NOTHING, NOTHING, NOTHING)
    slots = joints.limits[-1 - located[located < 0]]
    if slots.size:
        limits = joints.gaps(slots, d.angles(there)), joints.rates(slots, moved.v), joints.rates(slots, begin.v)
    carried = (
        surface_normal_velocities(d, c, moved.position.driven_x, surfaces[2]),
        surface_normal_velocities(d, before, begin.position.driven_x, surfaces[0]),
    )
    time, least = _active_set.first_touch(
        (c[:3], there.x, moved.twists, carried[0], rates),
        (before[:3], begin.placement.x, begin.twists, carried[1]),
        (m.kin.contacts.key, m.normal_impulses),
        limits,
        located,
        (s.gap_tol, s.solver.tol, s.theta, m.mid.h),
        wide,
        s.inscribed.size,
    )
    return float(time), float(least)
