"""What a person is told who waits for kernels to be compiled: that, once, and on a terminal how many there are."""

import logging
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import Any

from numba.core import event

from nsdyn._kernels.cache import folder

PATIENCE = 2.0
"""s of compiling in a process about which nothing is said."""

_log = logging.getLogger("nsdyn")


@lru_cache(maxsize=1)
def announce() -> None:
    """Tell, once in a process, that kernels are compiled; the first time on a machine that it is but once."""
    from tqdm import tqdm

    words = "compiling more kernels"
    with suppress(AttributeError, OSError):  # there is no folder, or another process has told it
        os.close(os.open(folder() / "told", os.O_CREAT | os.O_EXCL, 0o600))
        words = "compiling the kernels, once on this machine: a minute or two"
    with tqdm.external_write_mode(sys.stderr):
        _log.warning(words)


class Waiting(event.Listener):
    """Tells whoever has waited for `PATIENCE`, once in a process, and counts the kernels in a bar on a terminal."""

    def __init__(self) -> None:
        self._spent, self._begin, self._count = 0.0, 0.0, 0
        self._bar: Any = None
        self._timer = threading.Timer(0.0, self._tell)

    def on_start(self, event: event.Event) -> None:
        """Before a kernel is compiled."""
        self._begin = time.perf_counter()
        if _is_ours(event):
            self._in(PATIENCE - self._spent, self._tell)

    def on_end(self, event: event.Event) -> None:
        """After it."""
        if _is_ours(event):
            self._spent += time.perf_counter() - self._begin
            self._count += 1
            if self._bar is not None:
                self._bar.update()
            self._in(PATIENCE, self._close)

    def _in(self, delay: float, what: Callable[[], None]) -> None:
        """Do something after a while, unless there is something else to do before."""
        self._timer.cancel()
        self._timer = threading.Timer(max(0.0, delay), what)
        self._timer.daemon = True
        self._timer.start()

    def _tell(self) -> None:
        from tqdm import tqdm

        if self._bar is None and _log.isEnabledFor(logging.WARNING) and multiprocessing.parent_process() is None:
            announce()
            self._bar = tqdm(initial=self._count, unit="kernel", mininterval=0.0, leave=False, disable=None)

    def _close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def _is_ours(event: event.Event) -> bool:
    """Whether what is compiled is a kernel, and no function of the user's."""
    return str(event.data["dispatcher"].py_func.__module__).startswith(__package__)
