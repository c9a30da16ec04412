"""What named scenes call, compiled before it is needed."""

import warnings

from nsdyn._kernels.compiled import answer, asked
from nsdyn.scene import named as scenes
from nsdyn.stepping.impacts import LAWS
from nsdyn.stepping.stepper import Stepper

__all__ = ["compile_all", "run"]

NAMES = "stack slide arm_pushes_box bounce bricard bullet euler_disk gripper quadruped rattleback rocking rolling"
SCENES = *((name, {}) for name in (*NAMES.split(), "slider_crank")), *(("woodpecker", {"impact": law}) for law in LAWS)
"""Scenes, and options: they call what all do."""


def run() -> None:
    """Three steps of each."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, options in SCENES:
            setup = scenes.setup(name)
            stepper = Stepper(setup.scene, **setup.options(on_fail="ignore", **options))
            for _ in range(3):
                stepper.step()


def compile_all() -> None:
    """Compile what these steps call, the first first beside the process that does the last."""
    from tqdm import tqdm

    run()
    for file in tqdm(asked(), unit="kernel", disable=None):
        answer(file)
