"""Compiled kernels: functions of arrays and scalars, the only place where numba is imported.

They are in folders like those of the package, whose modules call them. Each gives the same numbers as plain Python,
with ``NUMBA_DISABLE_JIT=1``. The first use on a machine compiles them and keeps the machine code in a folder of the
user, as `nsdyn._kernels.cache` tells; the logger "nsdyn" says so, at INFO also which.
"""

import logging

from numba.core import event

from nsdyn._kernels import ahead

_log = logging.getLogger("nsdyn")


class _Announce(event.Listener):  # type: ignore[misc]  # numba is not typed
    """Tells a person who waits that kernels are being compiled, and which."""

    def __init__(self) -> None:
        self.seen: set[str] = set()

    def on_start(self, event: event.Event) -> None:
        """Once in a process, and once for every module of kernels."""
        module = event.data["dispatcher"].py_func.__module__ or ""
        if not module.startswith(__name__) or module in self.seen:
            return
        ahead.announce()
        self.seen.add(module)
        _log.info("compiling %s", module.removeprefix(__name__ + "."))

    def on_end(self, event: event.Event) -> None:
        """Nothing to tell."""


event.register("numba:compile", _Announce())
