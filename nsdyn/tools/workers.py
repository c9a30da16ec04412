"""Processes in which solvers and engines are timed: one thread each, with a time limit; a crash counts as a result."""

from __future__ import annotations

import json
import os
import select
import subprocess
import time
from typing import Any

LOADING = 300.0
"""Time limit in s for all work that is not timed: imports, reading, building."""


class Worker:
    """Process of a script of nsdyn, started at the first request and again after it had to be ended.

    A request is a line of JSON. The script prints ``{"event": "start"}`` before the timed part (``"warm"`` if it may
    compile) and ``{"event": "end"}`` after it. The reply is the first line without an event.

    Parameters
    ----------
    command : list of str
    grace : float
        Total time in s by which first calls may exceed their limits, for compilation.
    """

    def __init__(self, command: list[str], grace: float) -> None:
        self._command, self._grace = command, grace
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""

    def ask(self, request: dict[str, Any], limit: float) -> dict[str, Any]:
        """Return the reply to a request, or the reason why there is none."""
        if self._process is None:
            ones = "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NSDYN_COMPILE_PROCESSES"
            environment = os.environ | dict.fromkeys(ones, "1")
            pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
            self._process, self._buffer = subprocess.Popen(self._command, env=environment, **pipes), b""
        process = self._process
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            allowed, event = LOADING, ""
            while True:
                begin = time.monotonic()
                reply = self._line(begin + allowed)
                if event == "warm":
                    self._grace -= max(0.0, time.monotonic() - begin - limit)
                if reply is None:
                    self.close()
                    return {"failure": f"no answer within {allowed:g} s"}
                event = reply.get("event", "")
                if not event:
                    return reply
                allowed = {"warm": limit + max(0.0, self._grace), "start": limit, "end": LOADING}[event]
        except (BrokenPipeError, EOFError):
            code = process.wait()
            self.close()
            return {"failure": f"the process died with exit code {code}"}

    def _line(self, deadline: float) -> dict[str, Any] | None:
        """Return the next line of the process, None after the deadline; EOFError if the process has ended."""
        assert self._process is not None and self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        while b"\n" not in self._buffer:
            # The system has a largest time to wait.
            if not select.select([pipe], [], [], min(max(0.0, deadline - time.monotonic()), 1e6))[0]:
                return None
            got = os.read(pipe, 4096)
            if not got:
                raise EOFError
            self._buffer += got
        line, _, self._buffer = self._buffer.partition(b"\n")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
