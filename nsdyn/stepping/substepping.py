"""The step of an island: moves and impacts one after the other, in pieces where bodies would sink into each other."""

from __future__ import annotations

import math

import numpy as np

from nsdyn._kernels.collision.keys import NEAR
from nsdyn._kernels.stepping import active_set as _active_set
from nsdyn._kernels.stepping import touching as _touching
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import among, take
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.active_set import missed_impacts, normal_velocities, surface_normal_velocities
from nsdyn.stepping.attempt import Attempt, Known
from nsdyn.stepping.collisions import collide
from nsdyn.stepping.impulses import Impulses
from nsdyn.stepping.midpoint import Loads
from nsdyn.stepping.move import touch_time, try_move
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.stepping.slip_end import first_end
from nsdyn.stepping.state import State
from nsdyn.stepping.step_result import StepResult, finish
from nsdyn.tools.arrays import NONE, NOTHING, Array, Index

SOON, AGAIN = 1e-6, 1e-3
"""Shares at the beginning of a move in which an end of slip is not located. The first, of the move, is round-off, also
at its end. The second, of the step, holds after a move that ended at an end of slip: to second order that is known."""

LOOKS = 30
"""Most moves for locating one impact."""

LINEAR = 0.1
"""Newton's method converges quadratically if its step is at most this share of the last; else the secant is used."""

JUMP = 1e-9
"""Share of a move within which a gap that changes sign is a jump: another feature is the first to touch there."""

GROWTH = 1.25
"""How much longer a move may be than the last one in which a contact swept."""

LEAST = 1e-12
"""Share of a step that counts as no time."""


class Budget:
    """The effort that an island may still spend in a step, counted in contacts of moves.

    Attributes
    ----------
    longest : float
        How long the next move may be, s. Moves in which a contact sweeps are halved, and the next ones grow again;
        those that are then rejected were too long for the sweep as well.
    """

    def __init__(self) -> None:
        self.left, self.longest = OPTIONS.work, math.inf

    def affords(self, begin: SceneState) -> bool:
        """Return whether the island may try the moves from an instant that locating one event takes."""
        return OPTIONS.event * _contacts(begin) <= self.left

    def spend(self, begin: SceneState) -> None:
        """Subtract the cost of one move from an instant."""
        self.left -= _contacts(begin)


def _contacts(begin: SceneState) -> int:
    """Return the cost of a move from an instant: its number of contacts, at least 1."""
    return max(1, begin.contacts.gap.size)


def integrate(system: System, state: State, loads: Loads, begun: Known = None, meets: bool = False) -> StepResult:
    """Take a step in moves and impacts: each move ends at the first event, or at the end of the step.

    A move that is rejected is repeated in halves. `loads` gives the callbacks for a time [s], as in
    `nsdyn.stepping.midpoint`. `begun` is the known part of the step as one move; `meets` says whether the step as one
    move is known to meet an event.
    """
    now, rate, at, cut = state.instant, state.rate, 0.0, False
    s = system.during(state.next_t - state.dt, state.dt, now.position)
    budget, pieces = Budget(), [(s.dt, 0)]
    done: list[Impulses] = []
    path = [now.placement]
    while pieces:
        end, halvings = pieces[-1]
        # In halves, bodies are stopped at a smaller penetration.
        own = s._replace(depth=OPTIONS.depth_located * OPTIONS.refine**halvings)
        span = state.next_t - (s.dt - at), min(end - at, budget.longest)
        move, length, rejected = _substep(own, loads, now, span, rate, budget, cut, begun, meets)
        begun, meets = None, False
        if rejected and _contacts(now) << halvings <= OPTIONS.work:
            if budget.longest < math.inf:
                budget.longest = 0.5 * length
            # A short move that ended at an event leaves the rest of its piece as it was.
            whole = end - at - length <= LEAST * s.dt
            rest, until = ([], end) if whole else (pieces[-1:], at + length)
            pieces[-1:] = [*rest, (until, halvings + 1), (at + 0.5 * length, halvings + 1)]
            continue
        done += [acted._replace(begin=at + acted.begin) for acted in move.done]
        path += move.path
        now, rate, at = move.end, move.rate, at + length
        budget.longest *= GROWTH
        cut = end - at > LEAST * s.dt
        if not cut:
            pieces.pop()
    return StepResult(now, rate, done, path)


def _substep(
    s: System,
    loads: Loads,
    begin: SceneState,
    span: tuple[float, float],
    rate: Array,
    budget: Budget,
    cut: bool,
    begun: Known,
    meets: bool,
) -> tuple[StepResult, float, bool]:
    """Apply the impacts at the beginning, then move to the first event.

    Return the result, the length of the move, s, and whether the move is rejected. Where no event is located, a contact
    strikes at the beginning only if it would otherwise penetrate deeper than a move captures.

    Parameters
    ----------
    s : System
    loads : callable
    begin : SceneState
    span : (float, float)
        When the move begins and how long it lasts at most, s.
    rate : ndarray, shape (n,)
        Free acceleration at the beginning, m/s² and rad/s².
    budget : Budget
    cut : bool
        Whether the previous move ended before its piece: at an event, or where a contact sweeps.
    begun : Midpoint or Attempt, optional
        As in `integrate`, for a move over the whole span.
    meets : bool
        As in `integrate`.
    """
    (t, h), locates, now, done = span, budget.affords(begin), begin, []
    meets = meets or (not locates and s.striking_speed(begin) < -s.least_penetration / h)
    if (struck := collide(s if locates else s.capturing, begin, t, h, rate)) is not None:
        now, begun, done = struck[0], None, [struck[1]]
    soon = AGAIN * s.dt if cut and struck is None else SOON * h
    length, tried = _to_event(s, loads, now, t, h, soon, budget, begun, meets or struck is not None)
    m, moved = finish(s, now, tried), tried.moved
    path = [tried.mid.state.placement, moved.placement, m.end.placement]
    m = m._replace(done=done + m.done, path=path)
    rejected = s.sunk(moved.contacts) or s.shifted(moved.position, m.end.position) or any(m.strays)
    if length > LEAST * s.dt and not any(_jammed(acted.solved[1]) for acted in m.done):
        return m, length, rejected or _gains_energy(s, begin, m, tried)
    return m, length, False


def _gains_energy(s: System, begin: SceneState, m: StepResult, tried: Attempt) -> bool:
    """Return whether a move adds energy, or contacts turn far in it.

    The energy is that of persistent contacts, of the projection, and of contacts that could only take energy. What is
    lifted after a captured impact fell too deep before it: the impact took that energy, too.
    """
    d, mid, works = s.dynamics, tried.mid, [a.works for a in m.done]
    if tried.turns_far.any():
        return True
    least = 0.0 if Budget().affords(begin) else -math.inf
    most = 0.0 if any((a.contacts.restitution > 0.0).any() for a in m.done) else math.inf  # rebounds may give energy
    contacts = [min(max(w.normal + w.friction, least), most) for w in works]
    gained = sum(w.integration + max(0.0, w.projection + own) for w, own in zip(works, contacts, strict=True))
    if gained <= 0.0:
        return False
    # For bodies at rest, the scale is the energy that gravity gives in a move.
    scale = max(d.energies(begin.position, v, ())[0] for v in (begin.v, mid.h * m.rate))
    return gained > (OPTIONS.stray if d.trees else OPTIONS.gain) * (scale + sum(mid.at_play(begin.energies)))


def _sweeps(s: System, begin: SceneState, m: Attempt, hits: Index) -> bool:
    """Return whether a closed round contact sweeps over its body in a move in which its pair strikes elsewhere.

    The contact of a coin that falls flat sweeps around the rim, the faster the flatter, and the rest of the rim never
    strikes (M. Srinivasan, A. Ruina, Rocking and rolling: a can that appears to rock might actually roll, Physical
    Review E 78, 2008). In a longer move it seems to strike, as `hits` says, which would take the energy of the fall.
    """
    c, radii = begin.contacts, np.append(s.dynamics.radii, np.inf)
    round_ = np.isfinite(np.minimum(s.rounding[c.geom1], s.rounding[c.geom2]))
    if not (closed := round_ & (c.gap <= s.gap_tol) & among(s.detector.codes(c), hits)).any():
        return False
    c, where = take(c, closed), np.empty(np.count_nonzero(closed), np.int64)
    near = NEAR * np.minimum(radii[c.frame1], radii[c.frame2])
    for there in (m.kin.contacts, m.moved.contacts):
        _touching.places(there.key, c.key, where)
        if (where < 0).any():
            return True
        if (np.linalg.norm(there.points[2:, where] - c.points[2:], axis=2).min(axis=0) > near).any():
            return True
    return False


def _jammed(solution: Solution) -> bool:
    """Return whether no velocity opens the contacts: locating events more closely then gains nothing."""
    return solution.status is Status.NO_SLATER_POINT


def _to_event(
    s: System,
    loads: Loads,
    begin: SceneState,
    t: float,
    h: float,
    soon: float,
    budget: Budget,
    begun: Known = None,
    meets: bool = False,
    cut: float = math.inf,
) -> tuple[float, Attempt]:
    """Move to the first impact or end of slip, for at most h seconds; return the length and the move.

    If locating the event would take more moves than the budget allows, the move goes all the way and captures the
    event.

    Parameters
    ----------
    s : System
    loads : callable
    begin : SceneState
    t, h : float
        When the move begins and how long it lasts at most, s.
    soon : float
        Ends of slip before this time, s, are not located.
    budget : Budget
    begun : Midpoint or Attempt, optional
        Known part of the move of h seconds.
    meets : bool
        Whether the move is known to meet an event, or an impact has just occurred, which may be one of a row.
    cut : float
        By how much the move has been shortened to where slip was to end, s; infinite if it has not been.
    """

    def capture(begun: Known) -> tuple[float, Attempt]:
        return h, try_move(s.capturing, loads, begin, t, h, None, begun)

    # The first move is tried however many contacts it has: most first moves meet no event.
    if not (affords := budget.affords(begin)) and (meets or budget.left < OPTIONS.work):
        return capture(begun)
    budget.spend(begin)
    m = try_move(s, loads, begin, t, h, NONE, begun)
    begun, (hits, limit), touch = m.mid, missed_impacts(s, m), touch_time(s, begin, m)
    if _jammed(m.solution) or (not affords and (hits.size or touch < h or not m.solution.accepted)):
        return capture(begun)
    if touch < h:
        return _to_event(s, loads, begin, t, touch, soon, budget)
    if affords and hits.size and h > LEAST * s.dt and _sweeps(s, begin, m, hits):
        budget.longest = 0.5 * h
        return _to_event(s, loads, begin, t, budget.longest, soon, budget)
    turned = h * first_end(m.kin, s.solver, m.problem, m.solution, soon / h, cut < math.inf) if affords else h
    # Slip that is as large however short the move is, as where contacts hold the joints, has no time of its end.
    if SOON * h < h - turned <= 0.5 * cut:
        return _to_event(s, loads, begin, t, turned, soon, budget, cut=h - turned)
    if not hits.size:
        return h, m
    located = np.unique(hits)
    if (found := _locate(s, loads, begin, t, {h: m}, located, limit, budget)) is not None:
        return found
    # A contact captured in this move may have driven the bodies into those they hit.
    budget.spend(begin)
    m = try_move(s, loads, begin, t, h, located, begun)
    return capture(begun) if begun.fast or missed_impacts(s, m)[0].size else (h, m)


def _locate(
    s: System,
    loads: Loads,
    begin: SceneState,
    t: float,
    moves: dict[float, Attempt],
    located: Index,
    limit: float,
    budget: Budget,
) -> tuple[float, Attempt] | None:
    """Return the length of the move that ends at the first touch of a located contact, and the move; None if not found.

    The move begins at the time t, s. `moves` holds one move by its length, s. That move has run into the contacts and
    joint limits `located`, given by codes as in `missed_impacts`. Their penetration may be `limit`, m.
    """
    (h,) = moves
    far = s.dynamics.reach(begin.placement, begin.v, h, h, s.dynamics.surfaces.twists(t))
    wide = float(far.max(initial=s.gap_tol))
    aims: dict[float, float] = {}
    gaps: dict[float, float] = {}
    # Contacts that rebound are located more closely: their energy depends on where they strike.
    none = (1e-3 if limit <= s.gap_tol else 0.5) * s.gap_tol

    def gap(time: float) -> float:
        if time not in moves:
            budget.spend(begin)
            moves[time] = try_move(s, loads, begin, t, time, located)
        if time not in aims:
            aims[time], gaps[time] = _first_touch(s, begin, moves[time], located, wide)
        return gaps[time]

    low, high, length, last, misses, gains = 0.0, h, h, h, 0, True
    nearest = abs(gap(h))
    for _ in range(LOOKS):
        # Newton's method, exact in free flight, as long as it gains; bisection otherwise.
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
        # Below the solver's error in velocities nothing is gained. A gap that jumps, where another feature is the first
        # to touch, has no root.
        if nearest <= none or high - low <= JUMP * h or (misses > 1 and -limit <= gap(length) <= s.gap_tol):
            break
    return (length, moves[length]) if -limit <= gap(length) <= s.gap_tol else None


def _foreseen(s: System, begin: SceneState, located: Index, t: float) -> float:
    """Return how long located contacts take to close at their velocities at the time t, where the move begins, s."""
    c, d = begin.contacts, s.dynamics
    u = normal_velocities(d, c, begin, d.surfaces.twists(t))
    approach = among(s.detector.codes(c), located) & (c.gap > s.gap_tol) & (u < 0.0)
    return float((c.gap[approach] / -u[approach]).min(initial=math.inf))


def _next(aims: list[tuple[float, float]]) -> float:
    """Return the next time to try, from one or two pairs (time tried, time at which Newton's method aims).

    Newton's method uses the slopes of free motion. Where impulses change with the time, each of its steps comes nearer
    to the root only by a constant ratio. There the secant of aim - time gives the root.
    """
    (before, last), (time, aim) = aims[0], aims[-1]
    far = aim - time
    if time == before or not (abs(far) > LINEAR * abs(time - before) and math.isfinite(last + aim)):
        return aim
    slope = (aim - last) / (time - before)
    return time + far / (1.0 - slope) if slope < 1.0 else aim


def _first_touch(s: System, begin: SceneState, m: Attempt, located: Index, wide: float) -> tuple[float, float]:
    """Return when a move first touches a located contact, s, and the least gap of located contacts (or `wide`).

    The gap is `wide` if no located contact is near. The time follows from parabolas through the gaps at the end of the
    move. A gap accelerates as it did on the way, whatever other contacts pressed. A contact not found at the beginning
    accelerates under the free forces. The time may lie past the end of the move; it is infinite where no gap gives one.
    A closed contact that does not approach, as one that has just begun to separate, does not touch.
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
