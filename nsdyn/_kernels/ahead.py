"""Kernels compiled in other processes: before they are needed, or while a run goes on without them."""

import os
import pickle
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from nsdyn._kernels.cache import alone, folder
from nsdyn._kernels.compiled import Kernel, announce

PROCESSES = "NSDYN_COMPILE_PROCESSES"
"""Environment variable: how many processes compile; 1 for this one alone, by default one per core."""

_ONE_CORE = {PROCESSES: "1"} | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def processes() -> int:
    """How many processes compile before a run."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return int(os.environ.get(PROCESSES) or cores or 1)


def _start(code: str, **options: Any) -> "subprocess.Popen[bytes]":
    """Process with the caller's path that runs some code."""
    command = [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path}; {code}"]
    return subprocess.Popen(command, env=os.environ | _ONE_CORE, stdin=subprocess.DEVNULL, **options)


def _few_known() -> bool:
    """Whether few of the kernels loaded here are in the cache."""
    place = folder()
    if place is None:
        return False
    found = {name.rpartition("-")[0] for name in os.listdir(place)}
    return sum(kernel.kept.name in found for kernel in Kernel.known) < 0.25 * len(Kernel.known)


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

    out, into = os.pipe()
    workers = []
    try:
        with open(out) as lines, tqdm(unit="kernel", disable=None) as bar:
            for _ in range(processes()):
                workers.append(_start(f"from nsdyn.compilation import work; work({group!r})", stdout=into))
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


_LATER: dict[Path, "subprocess.Popen[bytes]"] = {}
"""The processes that compile meanwhile, by what they make. Nobody waits for them, and they outlive this one."""


def _later(kernel: Kernel, types: Any, file: Path, begin: bool) -> bool:
    """Begin to compile a kernel in another process, unless one does; False where it is this one that should."""
    if os.environ.get(PROCESSES) == "1" or (file in _LATER and _LATER[file].poll()):
        return False
    with alone(file, wait=False) as free:
        if free and begin and file not in _LATER:
            asked = pickle.dumps((kernel.py_func.__module__, kernel.py_func.__name__, types)).hex()
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
            try:
                _LATER[file] = _start(f"from nsdyn._kernels import ahead; ahead.compile_one({asked!r})", **quiet)
            except OSError:
                return False
    return True


def compile_one(asked: str) -> None:
    """Compile a kernel that `_later` names, after all that others have to do."""
    os.nice(10)
    module, name, types = pickle.loads(bytes.fromhex(asked))
    __import__(module)
    getattr(sys.modules[module], name).compile(types, wait=False)


Kernel.prepare, Kernel.later = _prepare, _later
