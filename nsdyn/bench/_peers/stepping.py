"""The loop of a worker that steps scenes; plain Python and NumPy, for any interpreter.

A scene is the result of `nsdyn.bench.cases.describe`.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from serve import answer

WIDTH, THICKNESS = 20.0, 1.0  # m, of the box that replaces a half-space where a detector is weak on planes
MOST, ENOUGH = 5, 0.2  # most runs of one request, and seconds after which no further run begins


class Simulation(Protocol):
    """A simulation of a scene in an engine."""

    def advance(self, steps: int) -> None:
        """Take steps in the fastest way the engine has; only this method is timed."""

    def poses(self) -> Any:
        """Return centres of mass [m] and quaternions xyzw of the free bodies, shape (bodies, 7)."""


def serve(variants: Callable[[dict[str, Any]], list[str]], build: Callable[..., Simulation]) -> None:
    """Answer requests until stdin ends.

    Parameters
    ----------
    variants : callable
        ``variants(scene)`` returns the names of the settings that can simulate the scene.
    build : callable
        ``build(scene, variant, dt)`` returns a new `Simulation` at its start.

    Notes
    -----
    A request with a `variant` is run from the start several times; the reply is the median of the times, and the poses
    at every sample are saved. The reply to a request without a `variant` is the list of variants. The processor time is
    measured: with one thread it equals the wall time on an idle machine, and does not change on a busy one.
    """

    def run(simulation: Simulation, steps: int, samples: int) -> tuple[float, list[Any]]:
        seconds, poses = 0.0, []
        for _ in range(samples):
            begin = time.process_time()
            simulation.advance(steps)
            seconds += time.process_time() - begin
            poses.append(np.array(simulation.poses(), dtype=float))
        return seconds, poses

    def played(request: dict[str, Any], say: Callable[..., None]) -> dict[str, Any]:
        scene = request["scene"]
        if "variant" not in request:
            return {"variants": variants(scene)}
        times: list[float] = []
        while len(times) < MOST and sum(times) < ENOUGH:
            simulation = build(scene, request["variant"], request["dt"])
            say(event="start")
            seconds, poses = run(simulation, request["steps"], request["samples"])
            say(event="end")
            times.append(seconds)
        np.save(request["answer"], poses)
        return {"seconds": statistics.median(times)}

    answer(played)
