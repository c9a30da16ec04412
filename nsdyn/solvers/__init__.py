"""Solvers of the frictional contact problem: one protocol, one registry, one file per solver.

To add one:

1. a file here, or in `nsdyn.literature` for a method kept for comparison: a frozen dataclass of `Options`, with `tol`,
`max_iter` and the options of the method, each annotated with its admissible values (`nsdyn.tools.options`). Its
docstring has its equations, its source, and where it fails;
2. ``__call__(problem, r0=None)`` that returns ``Solution.judge(problem, r, tol, iterations, seconds)``: the measures
are those of the problem, not of the solver, and the status reports values that are not finite;
3. its class in `CLASSES`, for type checkers also among the imports above it;
4. `test_solvers.py` and `test_data.py` of `tests/solvers` and `tests/literature/test_reference_solvers.py` run all of
`SOLVERS`; they list the problems that the method cannot solve;
5. a line in `demos/guide/solvers.md`, and ``nsdyn profile DIR --solver NAME --solver auto`` to compare it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from nsdyn._kernels.compiled import loading, waiting
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution
from nsdyn.tools.arrays import Array
from nsdyn.tools.naming import choice

if TYPE_CHECKING:
    from nsdyn.literature.aclm import ACLM
    from nsdyn.literature.admm import ADMM
    from nsdyn.literature.bundle import Bundle
    from nsdyn.literature.extragradient import Extragradient
    from nsdyn.literature.fixed_point import FixedPoint
    from nsdyn.literature.gauss_seidel import GaussSeidel
    from nsdyn.literature.hybrid import Hybrid
    from nsdyn.literature.impulse_newton import ImpulseNewton
    from nsdyn.literature.interior import Interior
    from nsdyn.literature.interior_point import InteriorPoint
    from nsdyn.literature.panagiotopoulos import Panagiotopoulos
    from nsdyn.literature.pgs import PGS
    from nsdyn.literature.proximal import Proximal
    from nsdyn.literature.relaxation import relaxed
    from nsdyn.literature.tresca import Tresca
    from nsdyn.literature.uzawa import Uzawa
    from nsdyn.solvers.auto import Auto
    from nsdyn.solvers.continuation import Continuation
    from nsdyn.solvers.nesterov import Nesterov
    from nsdyn.solvers.newton import Newton

__all__ = [
    "ACLM",
    "ADMM",
    "PGS",
    "SOLVERS",
    "Auto",
    "Bundle",
    "Continuation",
    "Extragradient",
    "FixedPoint",
    "GaussSeidel",
    "Hybrid",
    "ImpulseNewton",
    "Interior",
    "InteriorPoint",
    "Nesterov",
    "Newton",
    "Panagiotopoulos",
    "Proximal",
    "Solver",
    "Tresca",
    "Uzawa",
    "as_solver",
    "by_name",
    "relaxed",
    "solve",
]


class Solver(Protocol):
    """Protocol of a solver: a frozen dataclass of its own options that is called on a problem."""

    @property
    def tol(self) -> float:
        """Tolerance on `FC3D.error` [-] and `FC3D.residual` [m/s] alike."""

    def __call__(self, problem: FC3D, r0: Array | None = None) -> Solution:
        """Solve the problem from the impulse r0 (default 0)."""


@runtime_checkable
class Graded(Solver, Protocol):
    """Protocol of a solver that can also solve a problem to more or less than its tolerance, as `Auto` can."""

    def balanced(self, problem: FC3D, r0: Array, before: Array) -> Solution:
        """Solve the problem from r0; do not accept r0 if it changes the velocity of contacts that hold."""

    def loosely(self, problem: FC3D, r0: Array) -> Solution:
        """Solve the problem, its expensive islands only to the loose tolerance."""

    def roughly(self, problem: FC3D, r0: Array, effort: float) -> Solution | None:
        """Solve roughly from r0, with up to `effort` times as much work for more; None if r0 is near the solution."""


QUICK = 0.1
"""Longest solve, s, that is repeated for its time if kernels had to be loaded or compiled for it."""

CLASSES = {
    "solvers": "Auto Continuation Newton",
    "literature": "ACLM ADMM Bundle Extragradient FixedPoint GaussSeidel Hybrid ImpulseNewton Interior InteriorPoint "
    "Panagiotopoulos PGS Proximal Tresca Uzawa",
}
"""Solver classes by folder. The solver `fixed_point` is the class `FixedPoint` of the module `fixed_point`."""

HOMES = {
    name: (f"{folder}.{name}", made)
    for folder, classes in CLASSES.items()
    for made in classes.split()
    for name in [re.sub("(?<=[a-z])(?=[A-Z])", "_", made).lower()]
}
"""Module and class of each solver, by its name."""

FUNCTIONS = {"Nesterov": "solvers.nesterov", "relaxed": "literature.relaxation"}
"""Modules of the classes and functions that have no name in `HOMES`."""


class Known(Mapping[str, type]):
    """Solver classes by name, each loaded at its first look-up; without `nsdyn.literature` those of this folder."""

    def __getitem__(self, name: str) -> type:
        home, made = HOMES[name]
        return getattr(import_module(f"nsdyn.{home}"), made)

    def __iter__(self) -> Iterator[str]:
        there = find_spec("nsdyn.literature") is not None
        return (name for name, (home, _) in sorted(HOMES.items()) if there or home.startswith("solvers."))

    def __len__(self) -> int:
        return sum(1 for _ in self)


SOLVERS = Known()


def __getattr__(name: str) -> Any:
    """Return a solver class or function of this module, loaded at its first use."""
    home = {made: home for home, made in HOMES.values()} | FUNCTIONS
    if name in home:
        return getattr(import_module(f"nsdyn.{home[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def by_name(name: str, tol: float = 1e-8) -> Solver:
    """Return the solver of that name at tolerance `tol`, and no looser; ValueError for a wrong name or tolerance."""
    made = SOLVERS[choice(name, SOLVERS, "solver")]
    return made(tol=tol, loose=tol) if name == "auto" else made(tol=tol)


def as_solver(given: str | Solver, tol: float = 1e-8) -> Solver:
    """Return the solver of a name as `by_name` does, or the given solver itself; ValueError for anything else."""
    if callable(given) and hasattr(given, "tol") and not isinstance(given, type):
        return given
    if isinstance(given, str):
        return by_name(given, tol)
    raise ValueError(f"solver must be one of {', '.join(SOLVERS)}, or an object of these; got {given!r}")


def solve(problem: FC3D, solver: str | Solver = "auto", tol: float = 1e-8, r0: Array | None = None) -> Solution:
    """Solve a frictional contact problem.

    Parameters
    ----------
    problem : FC3D
    solver : str or Solver
        A name of `SOLVERS`, or a solver object, which has its own tolerance.
    tol : float
        On `FC3D.error` [-] and `FC3D.residual` [m/s] alike, for a solver given by name.
    r0 : ndarray, shape (3 nc,), optional
        Initial impulse, N·s.

    Returns
    -------
    Solution
        With r, u, status, error, residual, iterations and time. The time excludes loading and compiling kernels. If
        kernels had to be loaded and the solve was quick, the problem is solved twice more, since the first use of code
        is slow.

    Raises
    ------
    ValueError
        If the problem, the solver or the tolerance is invalid, or r0 has another shape or values that are not finite.

    Examples
    --------
    A point of 1 kg that falls at 1 m/s and slides at 0.2 m/s, μ = 0.5, stops in one impulse:

    >>> import numpy as np, nsdyn as nd
    >>> problem = nd.FC3D(np.eye(3), [-1.0, 0.2, 0.0], [0.5])
    >>> solution = nd.solve(problem)
    >>> solution.status.name, solution.r[:2].round(6).tolist()
    ('CONVERGED', [1.0, -0.2])
    """
    if not isinstance(problem, FC3D):
        raise ValueError(f"problem must be a nsdyn.FC3D, got {type(problem).__name__}")
    if r0 is not None and not np.isfinite(problem.impulse(r0, "r0")).all():
        raise ValueError("r0 must be finite, got NaN or infinity")
    solver, before = as_solver(solver, tol), loading()
    waiting.append(problem)
    try:
        solution = solver(problem, r0)
        if loading() > before and solution.time < QUICK:
            for _ in range(2):
                solution = solver(problem, r0)
    finally:
        waiting.pop()
    return solution
