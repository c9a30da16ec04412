"""Slater points: whether all contacts can open, by a direction found, by the linear program, and where it gives up."""

import numpy as np
import pytest
from test_problem import one_block
from test_solvers import CASES

import nsdyn as nd
from nsdyn.problem import gauss, slater
from nsdyn.problem.slater import has_slater_point

H = np.array([[1.0, 0, 0, -1.0, 0, 0], [0, 1.0, 0, 0, 1.0, 0], [0, 0, 1.0, 0, 0, -1.0]])


def between_walls(speed, mu=0.5):
    """A point of 1 kg between two walls that leave it at that speed in m/s; they squeeze it for speed < 0."""
    return nd.FC3D(H.T @ H, np.array([speed, 0, 0, speed, 0, 0]), np.full(2, mu))


def test_slater_point():
    """A box on the floor can be lifted; one jammed between two approaching walls cannot leave both."""
    assert all(has_slater_point(problem) for problem in CASES.values())
    jammed, receding = between_walls(-1.0), between_walls(1.0)
    assert has_slater_point(jammed) is False and has_slater_point(receding) is True
    assert has_slater_point(nd.FC3D(np.zeros((0, 0)), np.zeros(0), np.zeros(0)))


@pytest.mark.parametrize("speed", [-1.0, 1.0])
def test_slater_point_by_factors(speed):
    """The velocities of the bodies and the range of W are the same question."""
    given = between_walls(speed)
    problem = nd.FC3D.from_blocks(one_block(H), given.q, given.mu)
    assert has_slater_point(problem) is has_slater_point(given)


def test_slater_point_of_the_program(monkeypatch):
    """Where no direction is looked for the linear program says the same."""
    monkeypatch.setattr(gauss, "STEPS", 0)
    assert all(has_slater_point(problem) for problem in CASES.values())
    assert has_slater_point(between_walls(1.0)) is True


def test_slater_point_unknown(monkeypatch):
    monkeypatch.setattr(slater, "SIMPLEX", 0)
    assert has_slater_point(between_walls(-1.0)) is None
