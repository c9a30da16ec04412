"""Friction that holds: the capstan, the nip, the groove and the squeezed peg."""

import math

import numpy as np
import pytest
from conftest import drift

import nsdyn as nd

g = 9.81


# -- case 40: the capstan ----------------------------------------------------------------------------------------------


def capstan_limit(blocks, mu, weight=10.0, block_mass=1e-2):
    """Largest ratio of the weights, block after block from the left.

    With δ half the angle of a block, C and C' the thrust before and after it, its weight (n, t) outwards and onwards:

        N = (C + C') sin δ + n,   C' cos δ = C cos δ + mu N + t.
    """
    delta, thrust = np.pi / (2 * blocks), weight * g
    s, c = math.sin(delta), math.cos(delta)
    for k in range(blocks):
        middle = math.pi + (2 * k + 1) * delta
        n, t = -block_mass * g * math.sin(middle), -block_mass * g * math.cos(middle)
        thrust = (thrust * (c + mu * s) + mu * n + t) / (c - mu * s)
    return thrust / (weight * g)


@pytest.mark.case(40)
def test_capstan_formula():
    assert capstan_limit(8, 0.3, block_mass=0.0) == pytest.approx(2.60105, abs=5e-6)
    assert capstan_limit(32, 0.3, block_mass=0.0) == pytest.approx(2.56845, abs=5e-6)
    assert capstan_limit(10_000, 0.3, block_mass=0.0) == pytest.approx(math.exp(0.3 * math.pi), abs=1e-6)


@pytest.mark.case(40)
@pytest.mark.parametrize(("blocks", "mu"), [(8, 0.3), pytest.param(32, 0.3, marks=pytest.mark.slow), (8, 0.8)])
def test_capstan_holds_up_to_its_ratio(blocks, mu):
    """Bracketed to a millionth; beyond it the surplus accelerates both weights."""
    limit = capstan_limit(blocks, mu)
    scene = nd.scenes.load("capstan")
    holds = nd.simulate(scene(blocks=blocks, mu=mu, ratio=limit * (1 - 1e-6)), 0.2, dt=5e-3)
    assert drift(holds) <= 1e-9
    slips = nd.simulate(scene(blocks=blocks, mu=mu, ratio=limit * (1 + 1e-6)), 0.2, dt=5e-3)
    assert slips.body("right").linear_velocity[-1, 2] < -1e-7
    assert slips.body("left").linear_velocity[-1, 2] > 1e-8


# -- case 41: the nip and the groove -----------------------------------------------------------------------------------


@pytest.mark.case(41)
@pytest.mark.parametrize("half_angle", [5.0, 15.0, 35.0])
def test_nip_grips_or_spits_out(half_angle):
    """Self-locking iff mu >= tan b, with the weight of the roller; bracketed to a millionth."""
    b, W, w = math.radians(half_angle), 10.0, 0.1
    limit = math.tan(b) * (1 + w / (2 * math.cos(b) ** 2 * (W - 0.5 * w * math.tan(b) ** 2)))
    scene = nd.scenes.load("nip")
    grips = nd.simulate(scene(half_angle=half_angle, mu=limit * (1 + 1e-6)), 0.2, dt=2e-3)
    assert drift(grips) <= 1e-12
    spits = nd.simulate(scene(half_angle=half_angle, mu=limit * (1 - 1e-6)), 0.2, dt=2e-3)
    assert spits.body("roller").linear_velocity[-1, 0] > 1e-6
    light = limit / math.tan(b) - 1
    assert 0 < light < 0.01, "a light roller hardly changes tan b"


@pytest.mark.case(41)
@pytest.mark.parametrize("half_angle", [20.0, 45.0, 80.0])
def test_ball_rolls_in_a_groove(half_angle):
    trajectory = nd.simulate(nd.scenes.load("groove")(half_angle=half_angle, mu=0.8), 1.0, dt=1e-2)
    a = g * math.sin(math.radians(10.0)) / (1 + 2 / (5 * math.sin(math.radians(half_angle)) ** 2))
    ball, t = trajectory.body("ball"), trajectory.t
    np.testing.assert_allclose(ball.linear_velocity[:, 0], a * t, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ball.position[:, 0], a * t**2 / 2, rtol=0, atol=1e-12)
    assert np.abs(ball.position[:, 1:] - ball.position[0, 1:]).max() <= 1e-12


@pytest.mark.case(41)
@pytest.mark.parametrize("half_angle", [20.0, 45.0, 80.0])
def test_ball_slides_in_a_groove(half_angle):
    """Both sides together slow it down as one with mu/sin(half_angle)."""
    s = math.sin(math.radians(half_angle))
    scene = nd.scenes.load("groove")(half_angle=half_angle, slope=0.0, speed=2.0, mu=0.2)
    trajectory = nd.simulate(scene, 1.0, dt=1e-3)
    v, t = trajectory.body("ball").linear_velocity[:, 0], trajectory.t
    rolls = 2.0 / (0.2 * g * (1 / s + 2.5 * s))
    sliding = t < rolls
    np.testing.assert_allclose(v[sliding], 2.0 - 0.2 * g / s * t[sliding], rtol=0, atol=1e-11)
    np.testing.assert_allclose(v[t > rolls + 1e-3], 2.0 / (1 + 2 / (5 * s * s)), rtol=0, atol=1e-12)


# -- case 50: squeezed peg ---------------------------------------------------------------------------------------------


@pytest.mark.case(50)
@pytest.mark.parametrize(
    ("squeeze", "dt", "duration"),
    [(1e-6, 1e-2, 0.2), *(pytest.param(1e-4, 1e-3, duration, marks=pytest.mark.slow) for duration in (0.03, 0.2))],
)
def test_squeezed_peg_does_not_explode(squeeze, dt, duration):
    """It may hold or fall; it gains no energy but its weight's, and is not thrown about by the position projection.

    Its walls leave it no place without overlap, and every step says so.
    """
    with pytest.warns(UserWarning, match="overlap at the start"):
        trajectory = nd.simulate(nd.scenes.load("peg")(squeeze=squeeze), duration, dt=dt)
    peg, energy = trajectory.body("peg"), trajectory.energy
    assert (trajectory.solver.status == nd.Status.OVERLAP).all()
    assert np.abs(energy.defect).max() <= 1e-13
    assert (energy.kinetic <= 0.5 * (g * trajectory.t) ** 2 + 1e-12).all()
    assert np.abs(energy.projection).max() <= 1.0 * g * squeeze
    assert np.abs(peg.position[:, :2]).max() <= 2 * squeeze
    assert np.abs(peg.linear_velocity[:, :2]).max() <= 1e-12


@pytest.mark.case(50)
def test_squeezed_peg_stays_without_gravity():
    scene = nd.scenes.load("peg")(squeeze=1e-6)
    scene.gravity[:] = 0.0
    with pytest.warns(UserWarning, match="overlap at the start"):
        trajectory = nd.simulate(scene, 0.1, dt=1e-2)
    assert drift(trajectory) <= 1e-6
    assert np.abs(trajectory.v).max() <= 1e-12
