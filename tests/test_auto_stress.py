"""The portfolio where solvers fail: mass ratios, redundant contacts, extreme friction, problems without a solution."""

import numpy as np
import pytest
from test_auto import given, kicked_stack

import nsdyn as nd
from nsdyn.problem import Blocks


def squeezed_box(speed=-1.0, mu=0.5):
    """Box of 1 kg, side 2, four contacts on each of two walls that both leave it at that speed in m/s, by its factors.

    Walls that approach it ask for a velocity of its centre above 1 and below -1 m/s at once.
    """
    M = np.diag([1.0, 1.0, 1.0, 2 / 3, 2 / 3, 2 / 3])
    h = []
    for side in (-1.0, 1.0):
        axes = np.array([[-side, 0, 0], [0, 1, 0], [0, 0, -side]])
        for y, z in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            h += [np.concatenate((d, np.cross((side, y, z), d))) for d in axes]
    block, start = np.array([[0, -1]] * 8), np.array([[18 * c, 0] for c in range(8)])
    blocks = Blocks(np.array([0, 6]), block, start, np.ravel(h), np.array([0]), M.ravel(), np.linalg.inv(M).ravel())
    return nd.FC3D.from_blocks(blocks, np.tile([speed, 0.0, 0.0], 8), np.full(8, mu))


@pytest.mark.parametrize("form", [lambda p: p, given], ids=["factors", "matrix"])
@pytest.mark.parametrize("mu", [0.0, 0.5, 10.0])
def test_inconsistent_walls_are_reported(form, mu):
    solution = nd.solve(form(squeezed_box(mu=mu)))
    assert solution.status is nd.Status.NO_SLATER_POINT and not solution.converged
    assert "no velocity opens every contact" in solution.status.message
    assert nd.solve(form(squeezed_box(speed=0.1, mu=mu))).converged


def test_what_is_only_not_solved_is_not_called_unsolvable():
    """No solver reaches 1e-300 once something moves, but a stack on the floor can be lifted."""
    assert nd.solve(kicked_stack(height=2), tol=1e-300).status is nd.Status.MAX_ITERATIONS


def test_jammed_step_is_reported_and_recorded():
    """A box in a slot, pushed against one wall: no velocity leaves both, as is said when tol is out of reach."""
    scene = nd.Scene(gravity=(9.81, 0, 0))
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, linear_velocity=(0, 0.3, 0.1))
    for side in (-1, 1):
        scene.add_box(f"wall{side}", (0.2, 2.0, 2.0), 1.0, position=(0.2 * side, 0, 0), fixed=True)
    hopeless = nd.solvers.Auto(tol=1e-300)
    with pytest.raises(nd.NotConverged, match="no velocity opens every contact") as caught:
        nd.simulate(scene, duration=0.01, dt=0.01, solver=hopeless)
    assert caught.value.solution.status is nd.Status.NO_SLATER_POINT
    trajectory = nd.simulate(scene, duration=0.02, dt=0.01, solver=hopeless, on_fail="ignore")
    assert trajectory.solver.status_names == ["NO_SLATER_POINT"] * 2
