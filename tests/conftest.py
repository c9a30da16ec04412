"""Shared fixtures: seeded randomness, the solvers, a step of a small mixed scene."""

import numpy as np
import pytest

import nsdyn as nd

SOLVERS = {name: nd.solvers.by_name(name, 1e-8) for name in nd.solvers.SOLVERS}


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


@pytest.fixture(params=sorted(SOLVERS))
def solver(request: pytest.FixtureRequest) -> nd.solvers.Solver:
    return SOLVERS[request.param]


def drift(trajectory: nd.Trajectory) -> float:
    """Largest displacement in m of any free body from its start."""
    free = trajectory.q.shape[1] // 7
    x = trajectory.q[:, : 7 * free].reshape(len(trajectory.t), free, 7)[..., :3]
    return float(np.abs(x - x[0]).max())


def penetration(trajectory: nd.Trajectory) -> float:
    """Deepest gap in m over all contacts of all steps."""
    return float(-min(trajectory.contacts(k).gap.min(initial=0.0) for k in range(1, len(trajectory.t))))
