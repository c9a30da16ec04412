"""Regions solved by themselves, the impulses elsewhere frozen."""

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.problem import Blocks
from nsdyn.solvers import mending

TOL = 1e-8


@pytest.fixture(scope="module")
def wall() -> tuple[nd.FC3D, np.ndarray]:
    """The problem of a step of the resting wall and its impulses to 1e-12."""
    stepper = nd.Stepper(nd.scenes.load("wall")(), dt=5e-3, solver=nd.solvers.Auto(tol=1e-12))
    for _ in range(3):
        step = stepper.step()
    return step.problem, step.solution.r


def direct(blocks: Blocks, q: np.ndarray, mu: np.ndarray, scales: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, int]:
    solution = nd.solve(nd.FC3D.from_blocks(blocks, q, mu), tol=0.01 * TOL, r0=r)
    return solution.r, max(1, solution.iterations)


@pytest.mark.parametrize("contact", [5, 300, 700])
def test_a_disturbed_region_is_mended(wall, contact):
    problem, r = wall
    x = r.copy()
    x[3 * contact] += 1e-3  # N s
    before = problem.residual(x)
    away = np.ones(problem.nc, bool)
    assert before > 1e3 * TOL
    assert mending.mend(problem, x, TOL, direct) > 0
    # The rest of the wall stood still meanwhile, so that the whole is solved but for what the region's rim passes on.
    assert problem.residual(x) < 0.05 * before
    away[np.flatnonzero((x != r).reshape(-1, 3).any(axis=1))] = False
    assert 0 < np.count_nonzero(~away) <= mending.LARGEST


def test_nothing_is_done_where_nothing_is_wrong_or_nothing_is_gained(wall):
    problem, r = wall
    x = r.copy()
    assert mending.mend(problem, x, TOL, direct) == 0
    assert np.array_equal(x, r)
    pair = nd.Scene()
    pair.add_halfspace("ground")
    pair.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1))
    small = nd.Stepper(pair, dt=5e-3).step().problem
    zero = np.zeros(3 * small.nc)
    assert mending.mend(small, zero, TOL, direct) == 0
    assert not zero.any()


def test_a_region_grows_by_neighbours_around_the_worst(wall):
    problem, _ = wall
    residual = np.zeros(problem.nc)
    residual[300] = 1.0
    inside = mending._region(problem.blocks, residual)
    assert inside[300]
    bodies = set(problem.blocks.block[300]) - {-1}
    beside = [c for c in range(problem.nc) if bodies & set(problem.blocks.block[c])]
    assert inside[beside].all()
    assert len(beside) < np.count_nonzero(inside) <= mending.LARGEST
