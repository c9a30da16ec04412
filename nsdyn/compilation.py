"""Compilation, ahead of use, of the kernels that named scenes call."""

import warnings

from nsdyn._kernels.compiled import answer, asked
from nsdyn.scene import named as scenes
from nsdyn.stepping.stepper import Stepper

SCENES = """arm_pushes_box billiard bricard cradle domino gripper peg
pyramid quadruped rattleback rocking six_cubed woodpecker""".split()
STEPS = 3, 300
"""Scenes, and how many steps of each are run. The last steps call all kernels that the named scenes call. In the first
ones, before which nothing is compiled, no body meets another: the interpreter would take minutes for that."""


def run(steps: int) -> None:
    """Run some steps of each scene."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in SCENES:
            setup = scenes.setup(name)
            stepper = Stepper(setup.scene, **setup.options(on_fail="ignore"))
            for _ in range(steps):
                stepper.step()


def compile_all() -> None:
    """Compile the kernels that these steps call: here from the first on, while another process begins with the last."""
    from tqdm import tqdm

    for steps in STEPS:
        run(steps)
        for file in tqdm(asked(), unit="kernel", disable=None):
            answer(file)
