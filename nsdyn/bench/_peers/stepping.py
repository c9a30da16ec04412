"""The loop of a worker that steps scenes: requests on stdin, one JSON object a line; replies on what was stdout.

Plain Python and NumPy, for any interpreter. A scene is what `nsdyn.bench.cases.describe` makes of it.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

MOST, ENOUGH = 5, 0.2  # runs of one request: at most so many, none more after so many seconds


class Simulation(Protocol):
    """A scene in an engine."""

    def advance(self, steps: int) -> None:
        """Take steps in the fastest way the engine has; this alone is timed."""

    def poses(self) -> Any:
        """Centres of mass [m] and quaternions xyzw of the free bodies, shape (bodies, 7)."""


def serve(variants: Callable[[dict[str, Any]], list[str]], build: Callable[..., Simulation]) -> None:
    """Answer requests until stdin ends.

    Parameters
    ----------
    variants : callable
        ``variants(scene)`` returns the names of the settings that can do the scene.
    build : callable
        ``build(scene, variant, dt)`` returns a new `Simulation` at its start.

    Notes
    -----
    A request with a `variant` is run from the start several times; the reply is the median of their times, and the
    poses at every sample are saved. One without is answered by the variants. With one thread the processor time that is
    measured is the wall time on an idle machine, and on a busy one it stays so.
    """
    replies = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # engines that print must not garble the replies

    def say(**reply: Any) -> None:
        os.write(replies, (json.dumps(reply) + "\n").encode())

    def run(simulation: Simulation, steps: int, samples: int) -> tuple[float, list[Any]]:
        seconds, poses = 0.0, []
        for _ in range(samples):
            begin = time.process_time()
            simulation.advance(steps)
            seconds += time.process_time() - begin
            poses.append(np.array(simulation.poses(), dtype=float))
        return seconds, poses

    for line in sys.stdin:
        request = json.loads(line)
        scene = request["scene"]
        try:
            if "variant" not in request:
                say(variants=variants(scene))
                continue
            times: list[float] = []
            while len(times) < MOST and sum(times) < ENOUGH:
                simulation = build(scene, request["variant"], request["dt"])
                say(event="start")
                seconds, poses = run(simulation, request["steps"], request["samples"])
                say(event="end")
                times.append(seconds)
            np.save(request["answer"], poses)
            say(seconds=statistics.median(times))
        except Exception as failure:  # whatever an engine raises is its result
            say(failure=f"{type(failure).__name__}: {failure}")
