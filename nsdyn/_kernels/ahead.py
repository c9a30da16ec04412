"""Kernels compiled by other processes, beside the one that needs them."""

import os
import subprocess
import sys
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path

from nsdyn._kernels.cache import alone, folder
from nsdyn._kernels.compiled import Kernel

PROCESSES = "NSDYN_COMPILE_PROCESSES"
"""Environment variable: how many processes compile; 1 for this one alone, by default one per core."""

_ONE_CORE = {PROCESSES: "1"} | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def processes() -> int:
    """How many processes compile."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return int(os.environ.get(PROCESSES) or cores or 1)


_only = ExitStack()


@cache
def helpers(*groups: str) -> "list[subprocess.Popen[bytes]]":
    """Other processes that compile what groups of the examples in `nsdyn.compilation` need; they outlive this one.

    None where another process of the user has some: of many that begin at once only one does.
    """
    out: list[subprocess.Popen[bytes]] = []
    options = {"env": os.environ | _ONE_CORE, "start_new_session": True}
    options |= dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    code = f"import sys; sys.path[:] = {sys.path}; from nsdyn.compilation import work; work(*{groups})"
    if folder() and _only.enter_context(alone(folder() / "helpers", wait=False)):
        with suppress(OSError):  # where no process can be started, this one compiles
            for _ in range(processes() - 1):
                out.append(subprocess.Popen([sys.executable, "-c", code], **options))
    return out


_RUNS = "step", "quiet"
"""What a simulation needs; last the kernel of quiet steps, without which runs go on."""


def _prepare() -> None:
    """Where a simulation compiles, others help."""
    if "nsdyn.stepping.stepper" in sys.modules:
        helpers(*_RUNS)


def _later(file: Path, begin: bool) -> bool:
    """Whether others compile what is kept in a file, or will."""
    if processes() == 1 or not begin:
        return processes() > 1
    with alone(file, wait=False) as free:
        return not free or any(helper.poll() is None for helper in helpers(*_RUNS))


Kernel.prepare, Kernel.later = _prepare, _later
