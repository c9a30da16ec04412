"""Worker of nsdyn's solvers, run as a script."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from serve import serve

from nsdyn.problem import operators
from nsdyn.problem.fc3d import FC3D
from nsdyn.recording import fclib
from nsdyn.solvers import by_name

read = lru_cache(maxsize=1)(fclib.read)


def prepare(path: str, name: str, tol: float) -> Callable[[], Callable[[], tuple[Any, int]]]:
    """Return a function that gives every call a new problem without computed data, and forgets contact graphs."""
    given, solver = read(path), by_name(name, tol)

    def fresh() -> Callable[[], tuple[Any, int]]:
        operators.forget()
        if given.blocks is None:
            problem = FC3D(given.W, given.q, given.mu)
        else:
            problem = FC3D.from_blocks(given.blocks, given.q, given.mu)

        def call() -> tuple[Any, int]:
            solution = solver(problem)
            return solution.r, solution.iterations

        return call

    return fresh


serve(prepare, warm=True)
