"""Other processes that compile kernels before this one needs them."""

import atexit
import os
import subprocess
import sys
from contextlib import suppress

from nsdyn._kernels.compiled import Kernel

PROCESSES = "NSDYN_COMPILE_PROCESSES"
"""Environment variable: how many processes compile; 1 for this one alone, by default one per core."""

_CODE = "import sys; sys.path[:] = {}; from nsdyn.compilation import work; work({!r})"
_helpers: list[subprocess.Popen[bytes]] = []


def help_with(group: str) -> None:
    """Start, once, processes on the other cores that compile what examples in `nsdyn.compilation` need."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    others = 0 if _helpers else int(os.environ.get(PROCESSES) or cores or 1) - 1
    environment = os.environ | {PROCESSES: "1"} | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    with suppress(OSError):  # where none can be started, this one compiles
        for _ in range(others):
            command, nothing = [sys.executable, "-c", _CODE.format(sys.path, group)], subprocess.DEVNULL
            _helpers.append(subprocess.Popen(command, env=environment, stdin=nothing, stdout=nothing, stderr=nothing))
            atexit.register(_helpers[-1].kill)


def _help_with_a_step() -> None:
    if "nsdyn.stepping.stepper" in sys.modules:
        help_with("step")


Kernel.new = staticmethod(_help_with_a_step)
