"""The loop of a worker: requests on stdin, one JSON object a line; replies on what was stdout.

Plain Python and NumPy, for any interpreter.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

Call = Callable[[], tuple[Any, int]]


def serve(prepare: Callable[..., Callable[[], Call]], warm: bool) -> None:
    """Answer requests until stdin ends.

    Parameters
    ----------
    prepare : callable
        ``prepare(problem, solver, tol)`` returns a function that builds everything afresh and returns the call to be
        timed, which returns the impulse and the iterations.
    warm : bool
        Whether the first call of a request is not counted: it may compile.

    Notes
    -----
    A call is timed three times and the best counts, once if it takes more than a second. Before and after each call a
    line says so, for whoever watches the clock.
    """
    replies = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # solvers that print must not garble the replies

    def say(**reply: Any) -> None:
        os.write(replies, (json.dumps(reply) + "\n").encode())

    for line in sys.stdin:
        request = json.loads(line)
        try:
            fresh = prepare(request["problem"], request["solver"], request["tol"])
            best, count = np.inf, -1 if warm else 0
            while count < 3:
                call = fresh()
                say(event="warm" if count < 0 else "start")
                begin = time.perf_counter()
                r, iterations = call()
                seconds = time.perf_counter() - begin
                say(event="end")
                if count >= 0:
                    best = min(best, seconds)
                    if seconds > 1.0:
                        break
                count += 1
            np.save(request["answer"], r)
            say(seconds=best, iterations=int(iterations))
        except Exception as failure:  # whatever a peer raises is its result
            say(failure=f"{type(failure).__name__}: {failure}")
