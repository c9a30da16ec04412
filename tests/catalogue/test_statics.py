"""Catalogue of hard and analytic cases: what stands and what falls, bracketed from both sides."""

import math

import numpy as np
import pytest

import nsdyn as nd

g = 9.81

EXACT = nd.solvers.Auto(tol=1e-12)
"""A millionth beyond its limit a body gains 1e-5 m/s in a second; the default leaves 1e-8 m/s a step."""


def run(name, duration, external_force=None, dt=1e-2, **parameters):
    scene = nd.scenes.load(name)(**parameters)
    return nd.simulate(scene, duration, dt=dt, solver=EXACT, external_force=external_force)


def speed(trajectory):
    """Largest velocity component of any body in any step, m/s and rad/s."""
    return float(np.abs(trajectory.v).max())


STILL = 1e-9
"""m/s and rad/s; fifty steps at the solver's 1e-12 m/s on redundant contacts, a hundredth of the slowest fall below."""


@pytest.mark.case(6)
@pytest.mark.parametrize("slenderness", [1.5, 2.0, 4.0])
def test_tall_block_tips_on_a_steep_slope(slenderness):
    """Case 6: with mu > b/h it tips iff tan(alpha) > b/h, ± 1e-6, about its lower edge at the right acceleration."""
    limit = math.degrees(math.atan(1 / slenderness))
    tall = {"slenderness": slenderness, "mu": 1.0}
    assert speed(run("incline", 0.5, angle=limit * (1 - 1e-6), **tall)) <= STILL
    beyond = run("incline", 0.5, angle=limit * (1 + 1e-6), **tall)
    half = math.hypot(0.1, 0.1 * slenderness)
    # An inverted pendulum let go at eps from the top: w = eps p sinh(p t), p² = m g R/J, J = 4/3 m R² about the edge.
    p = math.sqrt(3 * g / (4 * half))
    expected = 1e-6 * math.radians(limit) * p * math.sinh(0.5 * p)
    assert beyond.v[-1, 4] == pytest.approx(expected, rel=0.01)


@pytest.mark.case(6)
def test_steep_slope_tips_the_block_that_grips():
    """Case 6: on a slope steeper than b/h it slides upright if mu < b/h and tips if mu > b/h, ± 1e-6."""
    angle, slenderness = 45.0, 2.0
    for excess in (-1e-6, 1e-6):
        mu = (1 + excess) / slenderness
        trajectory = run("incline", 0.5, angle=angle, slenderness=slenderness, mu=mu)
        a = math.radians(angle)
        down = np.array([math.cos(a), 0.0, -math.sin(a)])
        assert trajectory.body("box").linear_velocity[-1] @ down == pytest.approx(
            0.5 * g * (math.sin(a) - mu * math.cos(a)), rel=1e-5
        )
        turning = np.abs(trajectory.body("box").angular_velocity).max()
        # Friction mu N on the arm h/2 against N on b/2: the excess of moment, 1e-6 m g cos b/2, over J at the centre.
        if excess < 0:
            assert turning <= STILL
        else:
            assert turning > 1e-6


def push(force, height, size=0.2):
    """Horizontal force at `height` above the ground on the cube of the scene "slide", at its centre plus a couple."""
    wrench = ((force, 0.0, 0.0), (0.0, force * (height - size / 2), 0.0))
    return lambda t, q, v: {"box": wrench}


@pytest.mark.case(7)
@pytest.mark.parametrize("height", [0.02, 0.1, 0.15])
def test_low_push_slides(height):
    """Case 7: below b/(2 mu) the block slides iff F > mu m g, ± 1e-6, and does not tip."""
    mu = 0.6
    assert height < 0.2 / (2 * mu)
    assert speed(run("slide", 0.5, push(mu * g * (1 - 1e-6), height), speed=0.0, mu=mu)) <= STILL
    slides = run("slide", 0.5, push(mu * g * (1 + 1e-6), height), speed=0.0, mu=mu)
    assert slides.body("box").linear_velocity[-1, 0] == pytest.approx(0.5 * 1e-6 * mu * g, rel=1e-4)
    assert np.abs(slides.body("box").angular_velocity).max() <= STILL


@pytest.mark.case(7)
@pytest.mark.parametrize("height", [0.17, 0.2])
def test_high_push_tips(height):
    """Case 7: above b/(2 mu) the block tips iff F > m g b/(2 y), ± 1e-6, before it slides."""
    mu = 0.6
    assert height > 0.2 / (2 * mu)
    limit = g * 0.2 / (2 * height)
    assert speed(run("slide", 0.3, push(limit * (1 - 1e-6), height), speed=0.0, mu=mu)) <= STILL
    tips = run("slide", 0.3, push(limit * (1 + 1e-6), height), speed=0.0, mu=mu)
    # About the lower edge, J = 2/3 m b², the moment is 1e-6 F y at first and grows by (F + m g) b/2 per radian.
    J = 2 / 3 * 0.2**2
    p = math.sqrt((limit + g) * 0.1 / J)
    expected = 1e-6 * limit * height / (J * p) * math.sinh(0.3 * p)
    assert tips.body("box").angular_velocity[-1, 1] == pytest.approx(expected, rel=0.01)


@pytest.mark.case(7)
@pytest.mark.parametrize("excess", [-1e-6, 1e-6])
def test_push_slides_or_tips_by_its_height(excess):
    """Case 7: F = mu m g (1 + 1e-9) slides the block upright just below b/(2 mu) and tips it just above."""
    mu = 0.6
    trajectory = run("slide", 0.3, push(mu * g * (1 + 1e-9), 0.1 / mu * (1 + excess)), speed=0.0, mu=mu)
    turning = np.abs(trajectory.body("box").angular_velocity).max()
    assert turning <= STILL if excess < 0 else turning > 1e-6


@pytest.mark.case(8)
@pytest.mark.parametrize("mu", [0.2, 0.35, 0.6])
def test_ladder_on_a_smooth_wall(mu):
    """Case 8: it stands iff tan(angle) >= 1/(2 mu), ± 1e-6."""
    limit = math.degrees(math.atan(1 / (2 * mu)))
    assert speed(run("ladder", 0.5, angle=limit * (1 + 1e-6), mu=mu)) <= STILL
    assert speed(run("ladder", 0.5, angle=limit * (1 - 1e-6), mu=mu)) > 1e-6


@pytest.mark.case(8)
@pytest.mark.parametrize(("mu", "mu_wall"), [(0.3, 0.3), (0.3, 0.5), (0.5, 0.2)])
def test_ladder_on_a_rough_wall(mu, mu_wall):
    """Case 8: it stands iff tan(angle) >= (1 - mu mu_wall)/(2 mu), ± 1e-6, its forces undetermined above."""
    limit = math.degrees(math.atan((1 - mu * mu_wall) / (2 * mu)))
    assert speed(run("ladder", 0.5, angle=limit * (1 + 1e-6), mu=mu, mu_wall=mu_wall)) <= STILL
    assert speed(run("ladder", 0.5, angle=limit * (1 - 1e-6), mu=mu, mu_wall=mu_wall)) > 1e-6


def frame_limit(lean, **size):
    """Least friction of one frame of cards: thrust of the ridge over weight, lines of action at their best.

    The thrust acts at the top of the faces that meet, the ground's force at the inner end of the cut foot.
    """
    scene = nd.scenes.load("cards")(levels=1, lean=lean, **size)
    card = scene.bodies["left0_0"]
    corners = card.shape.vertices + card.position
    foot = corners[corners[:, 2] < 1e-9, 0].max()
    return (card.position[0] - foot) / corners[:, 2].max()


@pytest.mark.case(9)
@pytest.mark.parametrize("lean", [10.0, 20.0, 35.0])
def test_frame_of_two_cards(lean):
    """Case 9: mu_min = tan(lean)/2 for thin cards; with their thickness as on paper, ± 1e-6."""
    limit = frame_limit(lean)
    thin = frame_limit(lean, thickness=1e-5)
    assert thin == pytest.approx(0.5 * math.tan(math.radians(lean)), rel=1e-3)
    assert speed(run("cards", 0.2, levels=1, lean=lean, mu=limit * (1 + 1e-6))) <= STILL
    assert speed(run("cards", 0.2, levels=1, lean=lean, mu=limit * (1 - 1e-6))) > 1e-7


@pytest.mark.case(10)
def test_pyramid_of_logs():
    """Case 10: it stands iff mu >= tan(15°) between the logs and tan(15°)/3 on the ground, ± 1e-6 each."""
    limit = math.tan(math.radians(15.0))
    enough, short = 1 + 1e-6, 1 - 1e-6
    assert speed(run("logs", 0.3, mu=limit * enough, mu_ground=limit / 3 * enough)) <= STILL
    assert speed(run("logs", 0.3, mu=limit * short, mu_ground=limit / 3 * enough)) > 1e-7
    assert speed(run("logs", 0.3, mu=limit * enough, mu_ground=limit / 3 * short)) > 1e-7
    # With much more on one side the other still decides.
    assert speed(run("logs", 0.3, mu=1.0, mu_ground=limit / 3 * short)) > 1e-7
    assert speed(run("logs", 0.3, mu=limit * short, mu_ground=1.0)) > 1e-7


def round_foot(kind, share, heading):
    """Greatest tilt in a second, and speed of turning after it, on a slope with tan α = share · radius/(height/2).

    Downhill is `heading` rad from the body's own x axis: there a rim has none of the eight points that stand for it.
    """
    radius, height, corners, grips = 0.1, 0.6, 16, nd.Material(mu=1.0)
    slope, turn = np.arctan(share * radius / (height / 2)), 2 * np.pi * np.arange(corners) / corners
    down = np.sin(slope) * np.cos(heading), np.sin(slope) * np.sin(heading), -np.cos(slope)
    scene = nd.Scene(gravity=g * np.array(down))
    scene.add_halfspace("ground", material=grips)
    if kind == "cylinder":
        scene.add_cylinder("foot", radius, height, 1.0, position=(0, 0, height / 2), material=grips)
    else:  # its sides are as far from the axis as a cylinder's
        rim = radius / np.cos(np.pi / corners) * np.array([np.cos(turn), np.sin(turn)]).T
        vertices = [(*xy, z) for xy in rim for z in (-height / 2, height / 2)]
        scene.add_convex("foot", vertices, 1.0, position=(0, 0, height / 2), material=grips)
    foot = nd.simulate(scene, 1.0, dt=1e-2).body("foot")
    tilt = 2 * np.arcsin(np.hypot(*foot.quaternion[:, :2].T))
    return tilt.max(), np.linalg.norm(foot.angular_velocity[-20:], axis=1).max()


@pytest.mark.case(6)
@pytest.mark.parametrize(("kind", "share"), [("cylinder", 0.95), ("cylinder", 0.99), ("prism", 0.95), ("prism", 0.999)])
@pytest.mark.parametrize("heading", [np.pi / 16, 0.3, np.pi / 8])
def test_a_round_foot_stands_where_its_rim_carries_it(kind, share, heading):
    """Case 6: it tips where tan α exceeds the way from the axis to the rim over half the height, whatever is downhill.

    A prism of 16 sides, where downhill is at the angle β from the middle of a side, has 1/cos β of that.
    """
    beta = heading % (np.pi / 8) - np.pi / 16 if kind == "prism" else 0.0
    limit = 1.0 / np.cos(beta)
    tilt, speed = round_foot(kind, share * limit, heading)
    assert tilt <= 1e-6  # rad: less is not seen of a rim's lowest point in a step
    assert speed <= 1e-9  # rad/s, of the solver's tolerance of 1e-8 m/s
    tilt, _ = round_foot(kind, 1.001 * limit, heading)
    assert tilt > 1e-4
