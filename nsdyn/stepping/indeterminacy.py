"""Indeterminacy of the contact law in a step: several possible velocities, and jams (impulses that are no force)."""

from __future__ import annotations

import math

import numpy as np

from nsdyn._kernels.problem import paradox as _kernels
from nsdyn._kernels.stepping.law import JAM, STICK
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.ledger import Works
from nsdyn.problem import paradox
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.solvers import Solver
from nsdyn.stepping.impulses import Impulses
from nsdyn.tools.arrays import Array, Bools

FEW = 8
"""Most contacts of a problem in which a second velocity is searched for, so that a step costs hardly more."""


class Paradoxes:
    """Find jams and further velocities in scenes where they are possible.

    A body of mass m, whose least moment of inertia is J and whose shapes reach b from its centre, has W_NN - μ‖W_NT‖ ≥
    1/m - μ² b²/4 J: friction turns it fast enough for a paradox only if μ > 2 (J/m)^½/b. For articulations no such
    bound is known in advance. The largest μ is `mu`.
    """

    def __init__(self, dynamics: Dynamics, solver: Solver, mu: float) -> None:
        self._solver, free = solver, dynamics.free
        radius = np.sqrt(np.linalg.eigvalsh(dynamics.J)[:, 0] / dynamics.mass) if free else np.empty(0)
        steep = 2.0 * radius / np.maximum(dynamics.radii[:free], 1e-300)
        self.possible = mu > 0.0 and bool(dynamics.trees or (mu > steep).any())

    def paradox(self, problem: FC3D, solution: Solution, dt: float, rate: Array) -> bool:
        """Whether a step of one move, with the contacts of this problem alone, has a paradox, as in `told`."""
        if not solution.accepted:
            return False
        jam = self._jam(problem, solution, problem.nc, dt, rate)
        return (jam is not None and bool(jam.any())) or self._several(problem, solution)

    def told(
        self, done: list[Impulses], works: Works, dt: float, rate: Array
    ) -> tuple[list[Impulses], Works, Status | None]:
        """Return impulses and works with jams booked as impacts, and the status of the step, None without a paradox.

        The free acceleration is `rate` (n,). Impacts, which act in no time, are not examined: they are collisions.
        """
        status: Status | None = None
        for k, acted in enumerate(done):
            (problem, solution), nc = acted.solved, acted.contacts.gap.size
            if not (nc and problem.nc >= nc and acted.duration and solution.accepted):
                continue
            jam = self._jam(problem, solution, nc, dt, rate)
            if jam is not None and jam.any():
                status = Status.JAM
                moved = np.where(jam, acted.work_friction, 0.0)
                states = np.where(jam, JAM, acted.status).astype(np.int8)
                normal, friction = acted.work_normal + moved, acted.work_friction - moved
                done[k] = acted._replace(status=states, work_normal=normal, work_friction=friction)
                # Work of persistent contacts is booked as numerics, but that of a jam as an impact.
                rest = rest_normal = 0.0
                if acted.lasting is not None:
                    pressed, stays, sticks = acted.lasting
                    rest_normal = math.fsum(pressed[:nc][jam & stays[:nc]])
                    rest = math.fsum(moved[sticks[:nc] & (acted.status == STICK)])
                total = math.fsum(moved)
                works = works._replace(
                    normal=works.normal + total + rest_normal,
                    friction=works.friction - (total - rest),
                    integration=works.integration - rest - rest_normal,
                )
            if status is None and self._several(problem, solution):
                status = Status.SEVERAL
        return done, works, status

    def _jam(self, problem: FC3D, solution: Solution, nc: int, dt: float, rate: Array) -> Bools | None:
        """Contacts that jam, of the first nc of a problem; None if no velocity change is large enough for a jam."""
        load, change = _kernels.stopped(problem.q, solution.u, solution.r, nc)
        if change <= _kernels.ODD * load:
            return None
        return paradox.jams(problem, solution, nc, dt * float(np.abs(rate).max(initial=0.0)), self._solver)

    def _several(self, problem: FC3D, solution: Solution) -> bool:
        """Whether another velocity also obeys the contact law."""
        return problem.nc <= FEW and paradox.others(problem, solution.r, self._solver, solution.u) is not None
