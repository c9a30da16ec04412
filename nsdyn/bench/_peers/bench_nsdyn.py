"""Worker of nsdyn's stepper, run as a script; a variant is a tolerance of the default solver."""

from __future__ import annotations

import json
import time
from functools import lru_cache
from typing import Any

import numpy as np
from stepping import serve

import nsdyn as nd
from nsdyn.tools.arrays import Array

TOLERANCES = ["tol 1e-4", "tol 1e-8"]
WARMING = 10.0  # most s of simulation before a scene is timed


class Simulation:
    """A stepper of nsdyn on a scene."""

    def __init__(self, scene: nd.Scene, dt: float, tol: float) -> None:
        self.stepper = nd.Stepper(scene, dt=dt, solver=nd.solvers.Auto(tol=tol))

    def advance(self, steps: int) -> None:
        """Take complete steps, each with its ledger and its certificate."""
        for _ in range(steps):
            self.stepper.step()

    def poses(self) -> Array:
        """Return the poses of the free bodies."""
        return self.stepper.start().q.reshape(-1, 7)


@lru_cache(maxsize=1)
def load(model: str, parameters: str, gravity: tuple[float, float, float]) -> nd.Scene:
    """Return the named scene after a first simulation, so that nothing is compiled later."""
    setup = nd.scenes.setup(model, **json.loads(parameters))
    setup.scene.gravity = np.array(gravity)
    simulation, end = Simulation(setup.scene, setup.dt, 1e-8), time.monotonic() + WARMING
    while simulation.stepper.t < setup.duration and time.monotonic() < end:
        simulation.advance(1)
    return setup.scene


def build(scene: dict[str, Any], variant: str, dt: float) -> Simulation:
    """Build a simulation of a scene of nsdyn, given by name."""
    loaded = load(scene["model"], json.dumps(scene["parameters"]), tuple(scene["gravity"]))
    return Simulation(loaded, dt, float(variant.removeprefix("tol ")))


serve(lambda scene: TOLERANCES, build)
