"""The energy ledger of a step: where every joule went.

With one mass matrix M̃ over the step, any r and v̄ = (v_k + v_{k+1})/2, the kinetic change is v̄·(h f̃ + H r) exactly,
so the works below add up to the change of kinetic plus potential energy, whatever the accuracy of the solve:

    ΔT + ΔV = external + normal + friction + gyroscopic + theta + mass + projection + defect.

The defect is round-off. A ledger that does not close is a bug.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn._kernels import motion as _motion
from nsdyn.dynamics import Dynamics, Loads, Position
from nsdyn.problem import Array

__all__ = ["Ledger", "contact_works", "ledger"]


class Ledger(NamedTuple):
    """Energies at the end of a step and works during it, in J."""

    kinetic: float
    """½ vᵀ M v."""
    potential: float
    """Of gravity, 0 at the world's origin."""
    external: float
    """Of external forces and joint actuation."""
    normal: float
    """Of normal contact impulses, Σ ½(u_N⁺ + u_N⁻) r_N."""
    friction: float
    """Of tangential contact impulses, Σ ½(u_T⁺ + u_T⁻)·r_T."""
    gyroscopic: float
    """Of gyroscopic and Coriolis terms: 0 on a free motion, the contacts' share elsewhere."""
    theta: float
    """Of the difference between the velocity that moved the system and the mean one; 0 for θ = ½ in uniform gravity."""
    mass: float
    """Of the change of the mass matrix of articulated trees over the step."""
    projection: float
    """Of the position projection."""
    defect: float
    """What is left: round-off."""


def contact_works(u_before: Array, u_after: Array, r: Array) -> tuple[Array, Array]:
    """(normal, friction) work of every contact, each of shape (nc,), in J."""
    nc = r.size // 3
    normal, friction = np.empty(nc), np.empty(nc)
    _motion.contact_works(u_before, u_after, r, normal, friction)
    return normal, friction


def ledger(
    dynamics: Dynamics,
    h: float,
    loads: Loads,
    positions: tuple[Position, Position, Position],
    velocities: tuple[Array, Array, Array],
    normal: float,
    friction: float,
) -> Ledger:
    """Ledger of a step.

    Parameters
    ----------
    dynamics : Dynamics
        Evaluated at the midpoint.
    h : float
        Step, s.
    loads : Loads
    positions : (begin, moved, end)
        Before the step, after it, after the position projection.
    velocities : (begin, end, theta)
        v_k, v_{k+1} and v_{k+θ}.
    normal, friction : float
        Sums of the contact works, J.
    """
    begin, moved, end = positions
    v0, v1, v_theta = velocities
    works = np.empty(5)
    d = dynamics
    body = d.mass, d.J, d.gravity, loads.force, loads.torque
    _motion.free_works(*body, loads.gyroscopic, h, v0, v1, v_theta, begin.x, moved.x, works)
    d_kinetic, d_potential, external, gyroscopic, theta = (float(w) for w in works)
    kinetic, potential = _motion.free_energies(d.mass, d.J, d.gravity, end.x, v1)
    projection = 0.0
    if end is not moved:
        projection = -float(d.mass @ ((end.x - moved.x) @ d.gravity))
        d_potential += projection
    mass = 0.0
    for k, t in enumerate(d.trees):
        c = t.coordinates
        mean, change = 0.5 * (v0[c] + v1[c]), v1[c] - v0[c]
        at = d.m_start[d.free + k]
        M = d.m[at : at + change.size**2].reshape(change.size, -1)
        T0, V0 = t.energies(begin.trees[k], v0[c])
        V_moved = t.energies(moved.trees[k], v1[c])[1]
        T1, V1 = t.energies(end.trees[k], v1[c])
        gravity_work = -h * float(mean @ loads.weight[k])
        kinetic, potential = kinetic + T1, potential + V1
        d_kinetic, d_potential = d_kinetic + T1 - T0, d_potential + V1 - V0
        external += h * float(mean @ loads.tau[k])
        gyroscopic += -h * float(mean @ loads.bias[k]) - gravity_work
        theta += gravity_work + V_moved - V0
        mass += (T1 - T0) - float(mean @ (M @ change))
        projection += V1 - V_moved
    total = external + normal + friction + gyroscopic + theta + mass + projection
    defect = d_kinetic + d_potential - total
    return Ledger(kinetic, potential, external, normal, friction, gyroscopic, theta, mass, projection, defect)
