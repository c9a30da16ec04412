"""The energy ledger of a step: where every joule went.

With one mass matrix M̃ over the step, any r and v̄ = (v_k + v_{k+1})/2, the kinetic change is v̄·(h f̃ + H r) exactly,
so the works below add up to the change of kinetic plus potential energy, whatever the accuracy of the solve:

    ΔT + ΔV = external + normal + friction + damping + constraint + integration + projection + defect.

The defect is round-off. A ledger that does not close is a bug.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nsdyn._kernels import motion as _motion
from nsdyn.dynamics import Dynamics, Loads, Position
from nsdyn.problem import Array
from nsdyn.trees import Tree, TreeLoads

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
    integration: float
    """Of the time discretisation: of gyroscopic and Coriolis terms and of gravity beyond its potential, of the
    difference between the velocity that moved the system and the mean one, of the change of mass matrices."""
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
    impulse: Array | None,
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
    impulse : ndarray, shape (n,), optional
        H r of contacts and joint rows; needed where loops or driven joints restrict a tree.
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
        configurations = begin.trees[k], moved.trees[k], end.trees[k]
        own = _tree_works(t, h, theta, loads.trees[k], configurations, velocities, impulse)
        sums = tuple(a + b for a, b in zip(sums, own, strict=True))
    kinetic, potential, d_kinetic, d_potential, external, damping, constraint, gyroscopic, slip, mass, projection = sums
    total = external + normal + friction + damping + constraint + gyroscopic + slip + mass + projection
    return Ledger(
        kinetic, potential, external, normal, friction, damping, constraint, gyroscopic + slip + mass, projection,
        d_kinetic + d_potential - total,
    )  # fmt: skip


def _tree_works(
    t: Tree,
    h: float,
    theta: float,
    load: TreeLoads,
    configurations: tuple[Array, Array, Array],
    velocities: tuple[Array, Array, Array],
    impulse: Array | None,
) -> tuple[float, ...]:
    """(T, V, ΔT, ΔV, external, damping, constraint, gyroscopic, theta, mass, projection) of one tree, J."""
    begin, moved, end = configurations
    v0, v1, v_theta = (v[t.coordinates] for v in velocities)
    step = load, v0, v1, v_theta, h, theta
    kinetic, actuation, damping, springs, bias = t.works(*step)
    T0, V0 = load.energies
    T1, V1 = t.energies(end, velocities[1])
    V_moved = V1 if end is moved else t.energies(moved, velocities[1])[1]
    S0, S1 = t.spring_energy(begin), t.spring_energy(end)
    S_moved = S1 if end is moved else t.spring_energy(moved)
    gyroscopic, slip = V_moved - V0 - bias, 0.0
    if theta != 0.5:
        drop = -h * float((0.5 * (v0 + v1) - v_theta) @ load.weight)
        gyroscopic, slip = gyroscopic - drop, drop + springs + S_moved - S0
    constraint = 0.0
    if t.constrained:
        assert impulse is not None
        constraint = t.constraint_work(*step, impulse[t.coordinates])
    return (
        T1, V1 + S1, T1 - T0, V1 - V0 + S1 - S0, actuation, damping, constraint, gyroscopic, slip,
        T1 - T0 - kinetic, V1 - V_moved + S1 - S_moved,
    )  # fmt: skip
