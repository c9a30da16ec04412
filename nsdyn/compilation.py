"""What is compiled before it is needed: nothing tells what a simulation calls, and for which types, but simulating.

Small examples run with the kernels as plain Python, which takes a second or two, and what they call is noted.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from nsdyn._kernels.ahead import helpers
from nsdyn._kernels.cache import reached
from nsdyn._kernels.compiled import Kernel, Notes
from nsdyn._kernels.problem import cones
from nsdyn.scene import named as scenes
from nsdyn.stepping.impacts import LAWS
from nsdyn.stepping.quiet import ASKS
from nsdyn.stepping.stepper import Stepper

__all__ = ["EXAMPLES", "compile_examples", "noted", "work"]

SCENES = (
    *("arm_pushes_box", "bounce", "bricard", "bullet", "euler_disk", "gripper", "quadruped"),
    *("rattleback", "rocking", "rolling", "slider_crank", "woodpecker"),
)
"""Named scenes whose first steps call what others do."""


def _steps(name: str, count: int, impact: str = "dissipative") -> None:
    """Some steps of a named scene."""
    setup = scenes.setup(name)
    stepper = Stepper(setup.scene, **setup.options(on_fail="ignore", impact=impact))
    for _ in range(count):
        stepper.step()


def _step() -> None:
    """What most simulations of free bodies call."""
    _steps("slide", 3)
    _steps("stack", 1)


def _quiet() -> None:
    """What they call when they have not waited for the kernel of quiet steps."""
    _steps("slide", ASKS + 2)


def _all() -> None:
    """What the named scenes call."""
    _step()
    _quiet()
    for name in SCENES:
        _steps(name, 3)
    for impact in LAWS:
        _steps("woodpecker", 1, impact)


def _contact() -> None:
    """One contact: little, for tests."""
    cones.solve_one(np.eye(3), np.array([-1.0, 2.0, 0.0]), 0.5, np.zeros(3))


EXAMPLES: dict[str, Callable[[], None]] = {"step": _step, "quiet": _quiet, "all": _all, "contact": _contact}


def noted(group: str) -> list[tuple[Kernel, Any]]:
    """Kernels that Python calls in a group of examples, with the types of arguments.

    First what reaches most: it takes longest.
    """
    Kernel.notes = notes = Notes()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            EXAMPLES[group]()
    finally:
        Kernel.notes = None
    return sorted(notes.calls, key=lambda call: -len(reached(call[0].py_func.__module__)))


def compile_examples(group: str) -> None:
    """Compile what a group of examples needs, with a progress bar on terminals."""
    from tqdm import tqdm

    others = helpers(group)
    try:
        left = noted(group)
        with tqdm(total=len(left), unit="kernel", disable=None) as bar:
            for wait in (False, True):
                left = [(kernel, types) for kernel, types in left if kernel.compile(types, wait) is None]
                bar.update(bar.total - len(left) - bar.n)
    finally:
        for other in others:
            other.kill()


def work(*groups: str) -> None:
    """Compile what groups of examples need and nobody else does, the later groups after what others have to do."""
    for group in groups:
        for kernel, types in noted(group):
            kernel.compile(types, wait=False)
        os.nice(10)
