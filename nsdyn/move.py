"""One move of a scene: half a free flow, all forces and impulses at one configuration, half a free flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn import encounter, impacts
from nsdyn._kernels import law as _law
from nsdyn._kernels import motion as _motion
from nsdyn.contacts import ContactMemory, ContactSet, Detector
from nsdyn.dynamics import Dynamics, Forces, Placement, Position
from nsdyn.encounter import Encounter, Warm
from nsdyn.energy import Works
from nsdyn.problem import FC3D, Array, Solution
from nsdyn.projection import Placed, place, project
from nsdyn.solvers import Solver

__all__ = ["Impulses", "Instant", "Move", "System", "move", "strike"]

Bools = NDArray[np.bool_]
Callbacks = Callable[[Position, Array], tuple[Mapping[str, Any] | None, Mapping[str, Any] | None]]


class System(NamedTuple):
    """What does not change from move to move.

    Attributes
    ----------
    dynamics : Dynamics
    detector : Detector
    solver : Solver
    theta : float
        Fraction of the move after the impulses.
    dt : float
        The step of which moves are parts, s: what rests is slower than what forces do in two of them.
    closed : float
        Largest gap that counts as closed, m.
    impact : str
        Law of impact.
    """

    dynamics: Dynamics
    detector: Detector
    solver: Solver
    theta: float
    dt: float
    closed: float
    impact: str


class Instant(NamedTuple):
    """A state of the scene with all that a move begins with.

    Attributes
    ----------
    position : Position
    v : ndarray, shape (n,)
    placement : Placement
    contacts : ContactSet
        Found there, with the true gaps of the shapes.
    memory : ContactMemory
    warm : Warm
    """

    position: Position
    v: Array
    placement: Placement
    contacts: ContactSet
    memory: ContactMemory
    warm: Warm


class Impulses(NamedTuple):
    """What acted at one configuration.

    Attributes
    ----------
    contacts : ContactSet
    frame : ndarray, shape (nc, 3, 3)
    u, r : ndarray, shape (nc, 3)
        Relative velocities afterwards [m/s], and impulses on body 2 [N·s], normal first.
    status : ndarray of int8, shape (nc,)
        0 open, 1 stick, 2 slip.
    normal, friction : ndarray, shape (nc,)
        Works, J.
    joints : ndarray, shape (n,)
        Impulses of joint limits and dry joint friction on the coordinates, N m s or N s.
    created : float
        Energy that impacts created, J.
    """

    contacts: ContactSet
    frame: Array
    u: Array
    r: Array
    status: NDArray[np.int8]
    normal: Array
    friction: Array
    joints: Array
    created: float


class Move(NamedTuple):
    """A move and its end.

    Attributes
    ----------
    end : Instant
    impulses : Impulses
    works : Works
    problem : FC3D
    solution : Solution
    clear : bool
        Whether the end is without overlap.
    late : bool
        Whether a contact was struck where the move begins: impacts come first.
    hits : ndarray of bool, shape (nc of the end,)
        Contacts with restitution that the move ran into; they had no impulse.
    resting : ndarray, shape (rows,)
        Speeds of approach below which the contacts of `impulses` rest, m/s.
    """

    end: Instant
    impulses: Impulses
    works: Works
    problem: FC3D
    solution: Solution
    clear: bool
    hits: Bools


def take(contacts: ContactSet, kept: Bools) -> ContactSet:
    """Some of the contacts."""
    return ContactSet(*(column[kept] for column in contacts))


def move(s: System, begin: Instant, t: float, h: float, callbacks: Callbacks, located: bool) -> Move:
    """Move for h seconds from the time t.

    With the state (q_k, v_k) and the free flow Φ:

        q~, v⁻ = Φ(q_k, v_k, (1 - θ) h)     v⁺ = v⁻ + M̃⁻¹ (h f̃ + H r)     q_{k+1}, v_{k+1} = Φ(q~, v⁺, θ h)

    and the contact law of `encounter`; then positions without overlap.

    Parameters
    ----------
    s : System
    begin : Instant
    t, h : float
        s.
    callbacks : callable
        (wrenches, joint forces) at a position and a velocity.
    located : bool
        Whether contacts with restitution that are open where the move begins are left alone, to be found as `hits`.
    """
    d, before, after = s.dynamics, (1.0 - s.theta) * h, s.theta * h
    begun, ended = d.surfaces.twists(t), d.surfaces.twists(t + h)

    middle, v = d.flow(begin.position, begin.v, before, begun)
    placement = d.place(middle)
    forces = d.forces(begin.position, middle, v, t + h, h, s.theta, *callbacks(middle, begin.v))

    reach = d.reach(placement, forces.v, after, h, ended)
    contacts, memory = s.detector.find(placement.x, placement.R, reach, begin.memory)
    if located:
        contacts = take(contacts, _admitted(contacts, begin.contacts, s.closed))
    joints = d.joint_rows(middle, v, forces.v, h)
    drags = d.surfaces.drags(contacts, placement, d.surfaces.mean(begun, ended), ended)
    start = begin.contacts, begin.placement, d.twists(begin.placement, begin.v), begin.warm
    met = encounter.meet(d, contacts, joints, forces, v, placement, start, d.reach(begin.placement, begin.v, h, h, begun), drags, after)
    struck = _struck(s, met, h, after)
    impact = None
    if struck.any():
        impact, met, forces, v = _caught(s, met, forces, v, struck)

    problem, solution = encounter.solve(met, s.solver, after, s.closed)
    change = met.rows.velocity_change(solution.r)
    v_plus = forces.v + change

    end, v_end = d.flow(middle, v_plus, after, ended)
    moved = place(d, s.detector, end, memory)
    placed = project(d, s.detector, moved, forces, s.closed)

    impulses, works, warm = _account(s, met, forces, v, v_plus, solution.r, h, struck, drags[0])
    if impact is not None:
        impulses, works = _with_impact(impulses, works, impact, met)
    if placed is not moved:
        lift = d.energies(placed.position, v_end)
        works += Works(projection=sum(lift) - sum(d.energies(moved.position, v_end)))
    instant = Instant(placed.position, v_end, placed.place, placed.contacts, placed.memory, warm)
    hits = _hits(s, met, moved) if located else np.zeros(0, np.bool_)
    return Move(instant, impulses, works, problem, solution, placed.clear, hits)


def _admitted(contacts: ContactSet, begin: ContactSet, closed: float) -> Bools:
    """Contacts without restitution, and those that are closed where the move begins."""
    held = begin.key[begin.gap <= closed]
    out: Bools = (contacts.restitution == 0.0) | np.isin(contacts.key, held)
    return out


def _hits(s: System, met: Encounter, moved: Placed) -> Bools:
    """Which contacts where the motion ends are overlaps of shapes whose restitution was left alone."""
    found = moved.contacts
    out: Bools = (found.restitution > 0.0) & (found.gap < -s.closed) & ~np.isin(found.key, met.contacts.key)
    return out


def _struck(s: System, met: Encounter, h: float, after: float) -> Bools:
    """Contacts and joint limits that have an impact within the move: closing, and faster than what rests."""
    if not met.restitution.any():
        return np.zeros(met.restitution.size, np.bool_)
    resting = _resting(met, s.dt / h)
    approach, rate = met.u_begin[0::3], met.u[0::3]
    closes = met.end_gap + after * (met.u_free + met.turn)[0::3] <= 0.0
    out: Bools = (met.restitution > 0.0) & (approach < -resting) & (rate < 0.0) & closes
    return out


def _resting(met: Encounter, ratio: float) -> Array:
    """Speeds of approach below which contacts rest: what their own free acceleration does in two steps, m/s."""
    out: Array = 2.0 * ratio * np.abs((met.u_free - met.u)[0::3])
    return out


def _caught(
    s: System, met: Encounter, forces: Forces, v: Array, struck: Bools
) -> tuple[impacts.Impact, Encounter, Forces, Array]:
    """Impacts in no time where the other impulses act, and what they change."""
    closed = struck | (met.end_gap <= s.closed)
    resting = np.where(struck, 0.0, np.inf)
    impact = impacts.strike(s.impact, s.solver, met.rows.blocks, met.u, met.mu, met.restitution, closed, resting)
    dv = met.rows.velocity_change(impact.r)
    return impact, met.changed(dv), forces._replace(v=forces.v + dv), v + dv


def _account(
    s: System, met: Encounter, forces: Forces, v: Array, v_plus: Array, r: Array, h: float, struck: Bools, drag: Array
) -> tuple[Impulses, Works, Warm]:
    """What the impulses did, their works, and what they leave to the next move."""
    d, nc = s.dynamics, met.frame.shape[0]
    nr = met.mu.size
    u_plus = met.rows.full.relative_velocity(v_plus)
    if drag.size:
        u_plus += drag
    status, world = np.empty(nc, np.int8), np.empty((nc, 3))
    normal, friction, u_end = np.empty(nr), np.empty(nr), np.empty(3 * nr)
    sums = _law.outcome(
        r, met.mu, met.place, _law_status(met), struck, met.u, u_plus, met.turn, met.frame, status, normal, friction,
        u_end, world,
    )  # fmt: skip
    external, beyond = _motion.free_works(d.mass, d.gravity, forces.force, forces.torque, h, s.theta, v, v_plus)
    driving = -float(drag @ r) if drag.size else 0.0
    works = Works(external, sums[0], sums[1], 0.0, driving, sums[2] + beyond, 0.0)
    slots, on_joints = d.joints.impulses(met.joints, r.reshape(-1, 3)[nc:], d.n)
    impulses = Impulses(
        met.contacts, met.frame, u_end.reshape(-1, 3)[:nc], r.reshape(-1, 3)[:nc], status, normal[:nc], friction[:nc],
        on_joints, 0.0,
    )  # fmt: skip
    return impulses, works, Warm(met.contacts.key, world, status, slots)
