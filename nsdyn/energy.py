"""The energy ledger of a step: where every joule went.

With one mass matrix M̃ over the step, any r and v̄ = (v_k + v_{k+1})/2, the kinetic change is v̄·(h f̃ + H r) exactly,
so the works below add up to the change of kinetic plus potential energy, whatever the accuracy of the solve:

    ΔT + ΔV = external + normal + friction + damping + constraint + gyroscopic + theta + mass + projection + defect.

The defect is round-off. A ledger that does not close is a bug.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn._kernels import motion as _motion
from nsdyn.dynamics import Dynamics, Loads, Position
from nsdyn.problem import Array
from nsdyn.trees import TreeEnd

__all__ = ["Ledger", "ledger"]


class Ledger(NamedTuple):
    """Energies at the end of a step and works during it, in J."""

    kinetic: float
    """½ vᵀ M v."""
    potential: float
    """Of gravity, 0 at the world's origin, and of joint springs."""
    external: float
    """Of external forces and joint actuation."""
    normal: float
    """Of normal contact impulses, Σ ½(u_N⁺ + u_N⁻) r_N, and of joint limits."""
    friction: float
    """Of tangential contact impulses, Σ ½(u_T⁺ + u_T⁻)·r_T, and of dry joint friction."""
    damping: float
    """Of viscous joint damping."""
    constraint: float
    """Of bilateral constraints: of what drives bodies, surfaces and joints, and of closed loops, O(h²) of a motion."""
    gyroscopic: float
    """Of gyroscopic terms, 0 on a free motion, the contacts' share elsewhere; of trees the error of integration."""
    theta: float
    """Of the difference between the velocity that moved the system and the mean one; 0 for θ = ½ in uniform gravity."""
    mass: float
    """Of the change of the mass matrix of articulated trees over the step."""
    projection: float
    """Of the position projection."""
    defect: float
    """What is left: round-off."""


def ledger(
    dynamics: Dynamics,
    h: float,
    theta: float,
    loads: Loads,
    positions: tuple[Position, Position, Position],
    velocities: tuple[Array, Array, Array],
    ends: tuple[TreeEnd, ...],
    impulse: Array,
    normal: float,
    friction: float,
    driving: float,
) -> Ledger:
    """Ledger of a step.

    Parameters
    ----------
    dynamics : Dynamics
        Evaluated at the midpoint.
    h, theta : float
        Step [s] and θ.
    loads : Loads
    positions : (begin, moved, end)
        Before the step, after it, after the position projection.
    velocities : (begin, end, theta)
        v_k, v_{k+1} and v_{k+θ}.
    ends : tuple of TreeEnd
    impulse : ndarray, shape (n,)
        H r of contacts and joint rows.
    normal, friction : float
        Sums of the works of contacts and joint rows, J.
    driving : float
        Work of prescribed surfaces, J.
    """
    begin, moved, end = positions
    v0, v1, v_theta = velocities
    d = dynamics
    kinetic = potential = d_kinetic = d_potential = external = gyroscopic = slip = projection = 0.0
    if d.free:
        works = np.empty(7)
        body = d.mass, d.J, d.gravity, loads.force, loads.torque
        _motion.free_works(*body, loads.gyroscopic, h, v0, v1, v_theta, begin.x, moved.x, end.x, works)
        d_kinetic, d_potential, external, gyroscopic, slip, kinetic, potential = works.tolist()
        if end is not moved:
            projection = -float(d.mass @ ((end.x - moved.x) @ d.gravity))
            d_potential += projection
    sums: tuple[float, ...] = (
        kinetic, potential, d_kinetic, d_potential, external, 0.0, driving, gyroscopic, slip, 0.0, projection,
    )  # fmt: skip
    for k, t in enumerate(d.trees):
        part = loads.halfway[k], loads.trees[k], v1[t.coordinates], ends[k]
        w = t.works(*part, end.trees[k], impulse[t.coordinates])
        own = (
            w.kinetic, w.potential, w.change, 0.0, w.actuation, w.damping, w.constraint, w.integration, 0.0, 0.0,
            w.projection,
        )  # fmt: skip
        sums = tuple(a + b for a, b in zip(sums, own, strict=True))
    kinetic, potential, d_kinetic, d_potential, external, damping, constraint, gyroscopic, slip, mass, projection = sums
    total = external + normal + friction + damping + constraint + gyroscopic + slip + mass + projection
    return Ledger(
        kinetic, potential, external, normal, friction, damping, constraint, gyroscopic, slip, mass, projection,
        d_kinetic + d_potential - total,
    )  # fmt: skip
