"""What is compiled before it is needed: nothing tells what a simulation calls, and for which types, but simulating.

Steps of small scenes run with the kernels as plain Python, which takes a second or two, and what they call is noted.
"""

import gc
import warnings
from typing import Any

import numpy as np

from nsdyn._kernels.compiled import Kernel, helpers
from nsdyn.scene import named as scenes
from nsdyn.stepping.impacts import LAWS
from nsdyn.stepping.stepper import Stepper

__all__ = ["compile_all", "noted", "run", "work"]

FEW: tuple[tuple[str, dict[str, Any], dict[str, Any]], ...] = ("stack", {}, {}), ("slide", {"speed": 0.01}, {})
"""Named scenes, parameters and options; they call what most simulations of free bodies do, the last as it stops."""

MORE = "arm_pushes_box bounce bricard bullet euler_disk gripper quadruped rattleback rocking rolling slider_crank"

ALL = *FEW, *((s, {}, {}) for s in MORE.split()), *(("woodpecker", {}, {"impact": law}) for law in LAWS)
"""Those that call what all do."""


def run(few: bool) -> None:
    """Three steps of each scene."""
    for name, parameters, options in FEW if few else ALL:
        setup = scenes.setup(name, **parameters)
        stepper = Stepper(setup.scene, **setup.options(on_fail="ignore", **options))
        for _ in range(3):
            stepper.step()


def noted(few: bool) -> list[tuple[Kernel, Any]]:
    """Kernels that Python calls in these steps, with the types of arguments, in their order."""
    notes: dict[tuple[Kernel, Any], None] = {}
    Kernel.notes = notes
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            run(few)
    finally:
        Kernel.notes = None
    return list(notes)


def compile_all() -> None:
    """Compile what the named scenes call, with a progress bar on terminals."""
    from tqdm import tqdm

    helpers(few=False)
    gc.disable()
    for kernel, types in tqdm(noted(few=False), unit="kernel", disable=None):
        kernel.compile(types)


def work(few: bool, k: int, count: int) -> None:
    """Compile all this, as one of so many processes, the last first: the process that waits begins with the first."""
    gc.disable()
    for kernel, types in noted(few)[::-1][k::count]:
        if not kernel.file(types).exists():
            kernel.compile(types)
