"""A thousandfold mass at the end of a chain; rows of dominoes at several scales."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import nsdyn as nd

g = 9.81

# -- case 39: chain ----------------------------------------------------------------------------------------------------


def tips(model, q):
    """Positions of the end of the chain (0.1 m links), m."""
    data = model.createData()
    out = []
    for configuration in np.atleast_2d(q):
        pin.forwardKinematics(model, data, configuration)
        out.append(data.oMi[model.njoints - 1].act(np.array([0.0, 0.0, -0.1])))
    return np.array(out)


@pytest.mark.case(39)
@pytest.mark.parametrize("links", [10, 50])
def test_chain_hangs_still(links):
    trajectory = nd.simulate(nd.scenes.load("chain")(links=links, ratio=1000.0, angle=0.0), 0.2, dt=1e-2)
    assert np.abs(trajectory.q).max() == 0.0


@pytest.mark.case(39)
def test_chain_swings_as_exactly_at_any_step():
    """Against the same equations by a Runge-Kutta method of order 8; the stiff links vibrate at 600 rad/s and more.

    Steps go in parts that resolve that, however long they are.
    """
    links, duration = 8, 0.4
    scene = nd.scenes.load("chain")(links=links, ratio=1000.0)
    model = scene.articulations["chain"].model.copy()
    model.gravity = pin.Motion(np.array([0, 0, -g]), np.zeros(3))
    data, start = model.createData(), scene.articulations["chain"].q

    def rate(t, y):
        return np.concatenate((y[links:], pin.aba(model, data, y[:links], y[links:], np.zeros(links))))

    exact = solve_ivp(
        rate, (0, duration), np.concatenate((start, np.zeros(links))), method="DOP853", rtol=1e-9, atol=1e-10
    ).y[:links, -1]
    errors, drifts = [], []
    for dt in (1e-2, 2e-3, 1e-3):
        trajectory = nd.simulate(scene, duration, dt=dt)
        errors.append(np.linalg.norm(tips(model, trajectory.q[-1]) - tips(model, exact)))
        energy = trajectory.energy.kinetic + trajectory.energy.potential
        drifts.append(np.abs(energy - energy[0]).max() / np.ptp(trajectory.energy.potential))
    assert max(errors) <= 1e-9 and max(drifts) <= 1e-10


# -- case 42: dominoes -------------------------------------------------------------------------------------------------

DOMINO = {"thickness": 0.0075, "width": 0.022, "height": 0.044, "spacing": 0.022}


@cache
def dominoes(scale, count, duration, dt):
    """Positions (steps, count, 3) in units of `scale`, times in units of its square root."""
    sizes = {name: scale * value for name, value in DOMINO.items()}
    scene = nd.scenes.load("domino")(count=count, push=6.0 / np.sqrt(scale), **sizes)
    solver = nd.solvers.Auto(tol=1e-10)
    trajectory = nd.simulate(scene, duration * np.sqrt(scale), dt=dt * np.sqrt(scale), solver=solver)
    return np.stack([trajectory.body(f"domino{k}").position / scale for k in range(count)], axis=1)


@pytest.mark.slow
@pytest.mark.case(42)
@pytest.mark.parametrize("scale", [0.5, 3.0, 100.0])
def test_dominoes_scale_as_froude_says(scale):
    """Lengths by a factor, times by its root: the same fall of the same row, which stays in its plane."""
    x = dominoes(scale, 8, 0.3, 1e-3)
    np.testing.assert_allclose(x, dominoes(1.0, 8, 0.3, 1e-3), rtol=0, atol=1e-12)
    assert np.abs(x[:, :, 1]).max() <= 1e-10


@pytest.mark.slow
@pytest.mark.case(42)
def test_domino_wave():
    """It runs at a steady speed of one to two times sqrt(g H), and all fall (van Leeuwen, physics/0401018)."""
    count, height = 14, DOMINO["height"]
    x = dominoes(1.0, count, 0.7, 1e-3)
    drop = x[:, :, 2] < 0.45 * height  # the middle of a standing one is at H/2
    assert drop[-1, :-1].all()
    fallen = drop.argmax(axis=0) * 1e-3
    pitch = DOMINO["spacing"] + DOMINO["thickness"]
    first, second = (pitch * 5 / (fallen[k + 5] - fallen[k]) for k in (5, 8))
    assert first == pytest.approx(second, rel=0.05)
    assert 1.0 <= second / np.sqrt(g * height) <= 2.0
