"""Impulses that acted at one configuration, their works, and the warm start that they leave to the next move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nsdyn._kernels.stepping import law as _law
from nsdyn.collision.contacts import ContactSet, joined
from nsdyn.dynamics.ledger import Works
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.persistence import Couple
from nsdyn.stepping.rounds import Impact
from nsdyn.stepping.scene_state import System, WarmStart
from nsdyn.tools.arrays import NOTHING, Array, Bools


class Impulses(NamedTuple):
    """Impulses that acted at one configuration.

    Attributes
    ----------
    contacts, frame, u, r, status, couple, work_normal, work_friction, joints, links, created
        As in `Step`, whose `contact_status` is `status`.
    begin, duration : float
        When the move begins, s after the beginning of the step, and how long it is, s; 0 for impacts in no time. The
        impulses of a move act (1 - θ) of it after its beginning.
    solved : (FC3D, Solution)
        Problem and solution of the move; of several impacts the worst.
    works : Works
    moves : ndarray of bool, shape (nv,), or None
        Marks, among these coordinates of trees, those of the island that moved; None for all.
    wrench : ndarray, shape (free, 6), or None
        Impulses of external wrenches on the free bodies: force and moment about the centre of mass, world axes, N·s and
        N·m·s; None where there are none.
    lift : ndarray, shape (free, 6), or None
        Displacements of the free bodies by the projection at the end of the move: of the centre of mass, m, and
        rotation vector, rad, world axes; None where there are none.
    lasting : (ndarray, ndarray of bool, ndarray of bool), or None
        Normal works of the move [J], the contacts whose normal work is booked as numerics, and the contacts whose
        friction work is booked as numerics where they stick; None for impacts in no time.
    """

    contacts: ContactSet
    frame: Array
    u: Array
    r: Array
    status: NDArray[np.int8]
    couple: Array
    work_normal: Array
    work_friction: Array
    joints: Array
    links: Array
    created: float
    begin: float
    duration: float
    solved: tuple[FC3D, Solution]
    works: Works
    moves: Bools | None = None
    wrench: Array | None = None
    lift: Array | None = None
    lasting: tuple[Array, Bools, Bools] | None = None

    @staticmethod
    def joined(done: list[Impulses]) -> Impulses:
        """Join the contacts of all impulses of a step, one after the other, and add up what acted on coordinates."""
        contacts, *columns = zip(*done, strict=True)
        of_contacts, summed = map(np.concatenate, columns[:7]), (np.sum(parts, axis=0) for parts in columns[7:9])
        return Impulses._make((joined(contacts), *of_contacts, *summed, sum(columns[9]), *done[-1][11:]))


def book(
    s: System,
    kin: ContactKinematics,
    velocities: tuple[Array, Array, Array],
    solved: tuple[FC3D, Solution],
    h: float,
    impact: Impact | None,
    couple: Couple,
    mass: Array,
) -> tuple[Impulses, WarmStart]:
    """Book the impulses of a move of h s and its impacts, or with h = 0 impacts alone; return also the warm start.

    The impulses of the solution in `solved` act on the rows `kin`. `velocities` (n,) are those before the impacts,
    after the impacts, and after all impulses. Gravity acts on free bodies of the masses `mass` (free,), kg.
    """
    d, c, nc, nr = s.dynamics, kin.contacts, kin.frame.shape[0], kin.mu.size
    actuation = beyond = normal_work = friction_work = rest = created = 0.0
    struck, last = NOTHING if impact is None else impact.r[0::3], None
    if h > 0.0:
        status, normal, friction = np.empty(nc, np.int8), np.empty(nr), np.empty(nr)
        u_end, world = np.empty(3 * nr), np.empty((nc, 3))
        out = status, normal, friction, u_end, world
        rows = kin.rows.full.arrays, kin.surface_velocity[0], kin.mu, kin.local, kin.frame
        lasting = kin.stays, kin.sticks, couple.work, struck
        beyond, normal_work, friction_work, rest = _law.contact_works(
            (mass, d.gravity), (h, s.theta), velocities, rows, solved[1].r, lasting, s.solver.tol, out
        )
        total = solved[1].r
        last = normal, kin.stays if impact is None else kin.stays | (struck > 0.0), kin.sticks
    else:
        status, normal, friction, world = np.empty(nc, np.int8), np.zeros(nr), np.zeros(nr), np.zeros((nc, 3))
        total, u_end = np.zeros(3 * nr), kin.u
    if impact is not None:
        total, u_end = total + impact.r, u_end if h > 0.0 else impact.u
        normal, friction, created = normal + impact.work_normal, friction + impact.work_friction, impact.created
        normal_work += float(impact.work_normal.sum())
        friction_work += float(impact.work_friction.sum())
        _law.states(total, kin.mu, status)
    if kin.joints is not None:
        actuation = float(friction[nc:][kin.joints.actuated].sum())
        friction_work -= actuation
    constraint = -float(kin.surface_velocity[0] @ total) if kin.surface_velocity.size else 0.0
    works = Works(actuation, normal_work, friction_work, 0.0, constraint, beyond + rest, 0.0)
    u, impulse = u_end.reshape(-1, 3), total.reshape(-1, 3)
    first = 6 * d.free
    slots, on_joints = d.joints.impulses(kin.joints, impulse[nc:], d.n - first) if d.trees else d.no_impulses
    if kin.joints is not None and h > 0.0:
        slots = slots / h
        # All actuators, also those at their limits, act throughout the move, at its overall mean velocity.
        along = 0.5 * float(on_joints[0] @ (velocities[0] - velocities[1])[first:])
        works = works._replace(external=works.external + along, integration=works.integration - along)
    if nr > nc:
        u, impulse, normal, friction = u[:nc], impulse[:nc], normal[:nc], friction[:nc]
    links, turned = np.zeros((d.links, 6)), couple.impulse if couple.impulse.size else np.zeros((nc, 3))
    of_contacts = c, kin.frame, u, impulse, status, turned, normal, friction
    impulses = Impulses(*of_contacts, on_joints, links, created, 0.0, h, solved, works, lasting=last)
    return impulses, WarmStart(c.key, s.detector.codes(c), world, status, slots)
