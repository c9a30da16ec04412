"""Compilation, ahead of use, of the kernels that named scenes call."""

import warnings

from nsdyn._kernels.compiled import answer, asked
from nsdyn.scene import named as scenes
from nsdyn.stepping.impacts import LAWS
from nsdyn.stepping.stepper import Stepper

NAMES = "stack slide arm_pushes_box bounce bricard bullet euler_disk gripper quadruped rattleback rocking rolling"
SCENES = *((name, {}) for name in (*NAMES.split(), "slider_crank")), *(("woodpecker", {"impact": law}) for law in LAWS)
"""Scenes with options of the stepper. Together they call all kernels that the named scenes call."""


def run() -> None:
    """Run three steps of each scene."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, options in SCENES:
            setup = scenes.setup(name)
            stepper = Stepper(setup.scene, **setup.options(on_fail="ignore", **options))
            for _ in range(3):
                stepper.step()


def compile_all() -> None:
    """Compile the kernels that these steps call: here from the first on, while another process begins with the last."""
    from tqdm import tqdm

    run()
    for file in tqdm(asked(), unit="kernel", disable=None):
        answer(file)
