"""Warnings, files and errors for steps that miss their tolerance or whose law of impact creates energy."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from nsdyn.collision.contacts import ContactSet, take
from nsdyn.problem import cones
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import NotConverged, Solution, Status
from nsdyn.recording import fclib
from nsdyn.stepping.impulses import Impulses
from nsdyn.stepping.state import State
from nsdyn.tools.arrays import Array
from nsdyn.tools.files import as_path, check_folder
from nsdyn.tools.naming import choice

ON_FAIL = "warn", "raise", "dump", "ignore"
DUMPS = "failed-steps"
"""Folder of the problems of failing steps where none is given."""

NAMED = 3
"""Most pairs of bodies named in a message."""


class Failures:
    """Failing steps of a run, treated by `on_fail` as described in `nsdyn.Stepper`; `names` are those of the shapes.

    Problems of failing steps are written into the `folder`; None writes none, unless `on_fail` is "dump". ValueError
    if `on_fail` is none of the choices, or if the folder cannot be written.
    """

    def __init__(self, on_fail: str, folder: str | Path | None, names: list[str]) -> None:
        choice(on_fail, ON_FAIL, "on_fail")
        if folder is None and on_fail == "dump":
            folder = DUMPS
        self.on_fail, self.names = on_fail, names
        self.folder = None if folder is None else as_path(folder, "dump_on_fail")
        if self.folder is not None:
            try:
                check_folder(self.folder)
            except ValueError as refused:
                raise ValueError(f"dump_on_fail must be a folder that can be written: {refused}") from None
        self.count, self.created = 0, False

    def tell(self, problem: FC3D, solution: Solution, contacts: ContactSet, state: State, tol: float) -> None:
        """Warn of the step from `state` that missed its tolerance, write its problem, or raise `NotConverged`."""
        step = state.count + 1
        message = (
            f"step {step} from t = {state.t:.6g} s did not converge: error {solution.error:.2e}, residual "
            f"{solution.residual:.2e} m/s, tolerance {tol:.1e} ({solution.status.message})"
            f"{self._culprits(problem, solution, contacts)}"
        )
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            path = self.folder / f"step-{step:06d}.hdf5"
            guesses = [solution.r] if np.isfinite(solution.r).all() else []
            fclib.write(path, problem, guesses=guesses, description=message, overwrite=True)
            message += f"; its problem is in {path}"
        # Of very heavy bodies the error is round-off, whatever the answer: it changes with the unit of mass.
        reached = max(solution.error, solution.residual) <= problem.round_off(solution.r)
        none = not (solution.usable or reached)
        if self.on_fail == "raise" or (self.on_fail in ("warn", "dump") and none):
            if none and solution.status is not Status.NO_SLATER_POINT:  # whose message says what to look for
                message += "; no answer is near: try a smaller dt"
            raise NotConverged(message, problem, solution, state, step)
        if self.on_fail != "ignore" and not self.count:
            warnings.warn(message + "; further such steps are recorded without a warning", stacklevel=4)
        self.count += 1

    def tell_created(self, law: str, acted: Impulses, t: float) -> None:
        """Warn, the first time only, of the energy that the law of impact created at the time t, s."""
        if self.created:
            return
        self.created = True
        work = acted.work_normal + acted.work_friction
        gains = work > 0.0
        where = "at limits of joints"
        if gains.any():
            where = f"between {self._pairs(take(acted.contacts, gains), work[gains])}"
        warnings.warn(
            f"the law of impact {law} created {acted.created:.3g} J at t = {t:.6g} s {where}; Step.created has how "
            "much it creates from now on, impact='dissipative' creates none",
            stacklevel=4,
        )

    def _culprits(self, problem: FC3D, solution: Solution, contacts: ContactSet) -> str:
        """Name the pairs of bodies whose contacts have the largest errors of the solution, as part of a message."""
        u, r = solution.u.reshape(-1, 3), solution.r.reshape(-1, 3)
        wrong = r - cones.project(r - cones.saxce(u, problem.mu) / problem.scales[:, None], problem.mu)
        size = problem.scales * np.linalg.norm(wrong, axis=1)
        if problem.nc < contacts.gap.size:  # an impact of some of the contacts
            size = np.ones(contacts.gap.size)
        pairs = self._pairs(contacts, size[: contacts.gap.size])
        return f"; worst between {pairs}" if pairs else ""

    def _pairs(self, contacts: ContactSet, size: Array) -> str:
        """Name the pairs of bodies of the contacts with the largest `size` (nc,), largest first."""
        names = [(self.names[i], self.names[j]) for i, j in zip(contacts.geom1, contacts.geom2, strict=True)]
        order = [names[k] for k in np.argsort(-size, kind="stable")]
        return ", ".join(f"{a!r} and {b!r}" for a, b in list(dict.fromkeys(order))[:NAMED])


def worst(solved: list[tuple[FC3D, Solution]]) -> int:
    """Index of the problem that represents a step: the last, or the furthest from its tolerance if any missed it."""

    def badness(k: int) -> tuple[bool, bool, float]:
        solution = solved[k][1]
        return not solution.accepted, not solution.usable, solution.error

    if len(solved) == 1:
        return 0
    missed = [k for k, (_, solution) in enumerate(solved) if not solution.converged]
    return max(missed, key=badness) if missed else len(solved) - 1
