"""Result of a solver, and the status in which a solve ends."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any, NamedTuple

from nsdyn.problem.fc3d import FC3D
from nsdyn.tools import notebook
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import counted


class Status(IntEnum):
    """Status in which a solve ended; `message` explains it."""

    CONVERGED = 0
    MAX_ITERATIONS = 1
    STALLED = 2
    NOT_FINITE = 3
    NO_SLATER_POINT = 4
    OVERLAP = 5
    LOOSE = 6
    SEVERAL = 7
    JAM = 8

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        return format(self.name, spec)

    @property
    def message(self) -> str:
        """One sentence for the user, with the remedy."""
        return {
            Status.CONVERGED: "converged",
            Status.MAX_ITERATIONS: "the iteration limit was reached; allow more, loosen tol or use solver='auto'",
            Status.STALLED: "the residual no longer falls; loosen tol or use another solver",
            Status.NOT_FINITE: "the iterates are not finite; check W, q and mu",
            Status.NO_SLATER_POINT: "no velocity opens every contact, so that a solution need not exist; "
            "look for walls or prescribed motions that contradict each other",
            Status.OVERLAP: "converged, but no position without overlap was found where the step ends; look for bodies "
            "that are squeezed",
            Status.LOOSE: "within the loose tolerance, where the other costs too much; accepted",
            Status.SEVERAL: "converged, and another velocity obeys Coulomb's law as well: the motion is not determined",
            Status.JAM: "converged, and bodies jam: an impulse that does not fall with dt stops them though nothing "
            "collides",
        }[self]


TOLD = Status.CONVERGED, Status.SEVERAL, Status.JAM
"""Statuses that meet the tolerance. The last two are findings of a simulation about such a step."""

ACCEPTED = *TOLD, Status.LOOSE

WORST = 1e-3
"""Error above which the result of a solve is not used."""


class Solution(NamedTuple):
    """Result of a solver, measured by the problem itself.

    Attributes
    ----------
    r : ndarray, shape (3 nc,)
        Impulses, N·s; not unique when contacts are redundant.
    u : ndarray, shape (3 nc,)
        u = W r + q, m/s.
    status : Status
    error : float
        `FC3D.error` of r.
    residual : float
        `FC3D.residual` of r, m/s.
    iterations : int
        Sweeps, factorisations or iterations, in the unit of the solver.
    time : float
        Wall time of the solve, s.
    """

    r: Array
    u: Array
    status: Status
    error: float
    residual: float
    iterations: int
    time: float

    def __repr__(self) -> str:
        return (
            f"<Solution, nc = {self.r.size // 3}: {self.status}, error {self.error:.2e}, "
            f"residual {self.residual:.2e} m/s, {counted(self.iterations, 'iteration')}>"
        )

    def _repr_html_(self) -> str:
        names = (
            f"{letter}_{axis} [{unit}]" for letter, unit in (("r", "N·s"), ("u", "m/s")) for axis in ("N", "T1", "T2")
        )
        rows = zip(*(x.reshape(-1, 3)[:, k].tolist() for x in (self.r, self.u) for k in range(3)), strict=True)
        return notebook.table(repr(self).strip("<>"), list(names), list(rows))

    @property
    def converged(self) -> bool:
        """Whether both measures met the tolerance."""
        return self.status in TOLD

    @property
    def accepted(self) -> bool:
        """Whether a simulation continues with it: converged, or within a loose tolerance where one was given."""
        return self.status in ACCEPTED

    @property
    def usable(self) -> bool:
        """Whether a simulation can continue with it at all: a solution exists, and the error is at most `WORST`."""
        return self.status is not Status.NO_SLATER_POINT and self.error <= WORST

    @staticmethod
    def judge(
        problem: FC3D, r: Array, tol: float, iterations: int, time: float, otherwise: Status = Status.STALLED
    ) -> Solution:
        """Return the solution of an impulse; it is converged only if the measures of the problem say so.

        Parameters
        ----------
        problem : FC3D
        r : ndarray, shape (3 nc,)
            N·s.
        tol : float
            On `FC3D.error` [-] and `FC3D.residual` [m/s] alike.
        iterations : int
        time : float
            s.
        otherwise : Status
            Status if the measures are finite and have not converged.
        """
        _, error, residual, u = problem.solved(r, tol)
        return Solution.measured(r, u, error, residual, tol, iterations, time, otherwise)

    @staticmethod
    def measured(
        r: Array, u: Array, error: float, residual: float, tol: float, iterations: int, time: float, otherwise: Status
    ) -> Solution:
        """Return the solution of an impulse with its velocity and measures already computed by the problem.

        Parameters are those of `judge`, and the velocity u (3 nc,) [m/s], error [-] and residual [m/s].
        """
        if error <= tol and residual <= tol:
            status = Status.CONVERGED
        else:
            status = otherwise if math.isfinite(error) and math.isfinite(residual) else Status.NOT_FINITE
        return Solution(r, u, status, error, residual, iterations, time)


class NotConverged(RuntimeError):
    """Error raised when a solve misses its tolerance.

    Attributes
    ----------
    problem : FC3D
    solution : Solution
        The best solution found.
    state : nsdyn.stepping.state.State or None
        State at the beginning of the failed step, for `Stepper.set_state`; None outside a simulation.
    step : int or None
        Number of the step, 1 for the first.
    """

    def __init__(
        self, message: str, problem: FC3D, solution: Solution, state: Any = None, step: int | None = None
    ) -> None:
        super().__init__(message)
        self.problem, self.solution, self.state, self.step = problem, solution, state, step

    def __reduce__(self) -> tuple[Any, ...]:
        """Return all arguments, so that the exception can be passed between processes."""
        return type(self), (str(self), self.problem, self.solution, self.state, self.step)
