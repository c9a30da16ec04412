"""Kernels compiled in several processes at once, before they are needed."""

import os
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache

from nsdyn._kernels.cache import alone, folder
from nsdyn._kernels.compiled import Kernel
from nsdyn._kernels.waiting import announce

PROCESSES = "NSDYN_COMPILE_PROCESSES"
"""Environment variable: how many processes compile; 1 for this one alone, by default one per core."""

_CODE = "import sys; sys.path[:] = {}; from nsdyn.compilation import work; work({})"


def processes() -> int:
    """How many processes compile."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return int(os.environ.get(PROCESSES) or cores or 1)


def _few_known() -> bool:
    """Whether few of the kernels loaded here are in the cache."""
    place = folder()
    if place is None:
        return False
    found = {name.rpartition("-")[0] for name in os.listdir(place)}
    return sum(kernel.name in found for kernel in Kernel.known) < 0.25 * len(Kernel.known)


@lru_cache(maxsize=1)
def _prepare() -> None:
    """Before the first compilation of a simulation: what all simulations need, unless most of it is there."""
    if "nsdyn.stepping.stepper" not in sys.modules or processes() == 1 or not _few_known():
        return
    # Where no process can be started, this one compiles
    with suppress(OSError), alone(folder() / "examples"):
        if _few_known():
            announce()
            compile_examples("step")


def compile_examples(group: str) -> None:
    """Compile what a group of the examples in `nsdyn.compilation` needs, with a progress bar on terminals."""
    from tqdm import tqdm

    count = processes()
    environment = os.environ | {PROCESSES: "1"} | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    out, into = os.pipe()
    workers = []
    try:
        with open(out) as lines, tqdm(unit="kernel", disable=None) as bar:
            for _ in range(count):
                command = [sys.executable, "-c", _CODE.format(sys.path, repr(group))]
                workers.append(subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, stdout=into))
            os.close(into)
            done = set()
            for line in lines:
                index, bar.total = map(int, line.split())
                done.add(index)
                bar.update(len(done) - bar.n)
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()


Kernel.prepare = _prepare
