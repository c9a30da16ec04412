"""What is compiled before it is needed: nothing tells what a simulation calls, and for which types, but simulating.

Each process runs small examples, the kernels as plain Python, which takes a second, and compiles what was called. All
go through the same list, and leave out what another has compiled or is compiling.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Callable

import numpy as np

from nsdyn._kernels.cache import reached
from nsdyn._kernels.compiled import Kernel, Notes
from nsdyn._kernels.problem import cones
from nsdyn.scene import named as scenes
from nsdyn.stepping.impacts import LAWS
from nsdyn.stepping.stepper import Stepper

__all__ = ["EXAMPLES", "noted", "work"]

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


def _all() -> None:
    """What the named scenes call."""
    _step()
    for name in SCENES:
        _steps(name, 3)
    for impact in LAWS:
        _steps("woodpecker", 1, impact)


def _contact() -> None:
    """One contact: little, for tests."""
    cones.solve_one(np.eye(3), np.array([-1.0, 2.0, 0.0]), 0.5, np.zeros(3))


EXAMPLES: dict[str, Callable[[], None]] = {"step": _step, "all": _all, "contact": _contact}


def noted(group: str) -> Notes:
    """Calls of kernels in a group of examples, which run as Python."""
    Kernel.notes = notes = Notes(patient=group != "step")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            EXAMPLES[group]()
    finally:
        Kernel.notes = None
    return notes


def work(group: str) -> None:
    """Compile what a group needs and nobody else does, and print the index of each and their number.

    First what reaches most: it takes longest.
    """
    logging.getLogger("nsdyn").setLevel(logging.ERROR)
    calls = sorted(noted(group).calls, key=lambda call: -len(reached(call[0].py_func.__module__)))
    for k, (kernel, types) in enumerate(calls):
        if kernel.compile(types, wait=False) is not None:
            os.write(1, f"{k} {len(calls)}\n".encode())
