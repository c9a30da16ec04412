"""The loop of a worker: it reads requests on stdin, one JSON object per line, and replies on the original stdout.

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

REPEAT, SHORT, TOGETHER = 0.05, 1e-3, 20
"""Seconds for which calls are repeated, seconds below which a call is short, and number of short calls in direct
succession, because the first few find the processor's caches empty."""


def answer(reply: Callable[[dict[str, Any], Callable[..., None]], dict[str, Any]]) -> None:
    """Answer requests until stdin ends by ``reply(request, say)``; ``say(event=...)`` writes a line before it."""
    replies = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # solvers and engines that print must not garble the replies

    def say(**line: Any) -> None:
        os.write(replies, (json.dumps(line) + "\n").encode())

    for line in sys.stdin:
        try:
            say(**reply(json.loads(line), say))
        except Exception as failure:  # any error of a peer is its result
            say(failure=f"{type(failure).__name__}: {failure}")


def serve(prepare: Callable[..., Callable[[], Call]], warm: bool) -> None:
    """Answer requests until stdin ends.

    Parameters
    ----------
    prepare : callable
        ``prepare(problem, solver, tol)`` returns a function that builds everything anew and returns the call to be
        timed. The call returns the impulse and the iterations.
    warm : bool
        Whether to ignore the first call of a request, which may compile.

    Notes
    -----
    A call is timed as often as `REPEAT` allows, at least three times, but only once if it takes more than a second. The
    best time counts. A line is written before and after each call, or group of short calls, so that the process that
    reads the replies can apply a time limit.
    """

    def solved(request: dict[str, Any], say: Callable[..., None]) -> dict[str, Any]:
        fresh = prepare(request["problem"], request["solver"], request["tol"])
        best, count, until = np.inf, -1 if warm else 0, np.inf
        while count < 3 or time.perf_counter() < until:
            calls = [fresh() for _ in range(TOGETHER if best < SHORT else 1)]
            say(event="warm" if count < 0 else "start")
            for call in calls:
                begin = time.perf_counter()
                r, iterations = call()
                seconds = time.perf_counter() - begin
                if count >= 0:
                    best, until = min(best, seconds), min(until, begin + REPEAT)
            say(event="end")
            count += 1
            if best > 1.0 and count > 0:
                break
        np.save(request["answer"], r)
        return {"seconds": best, "iterations": int(iterations)}

    answer(solved)
