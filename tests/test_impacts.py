"""Laws of impact: where they agree, what each does to energy, chains, Zeno's ball and rest."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn.stepping.impacts import LAWS

g = 9.81


@pytest.mark.parametrize("law", LAWS)
def test_one_frictionless_contact_obeys_newton(law):
    """A ball against a ball, off centre: the normal velocity turns round times e, the rest is left alone."""
    material = nd.Material(0.0, 0.6)
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_sphere("a", 0.1, 1.0, linear_velocity=(3, 0, 0), material=material)
    scene.add_sphere("b", 0.1, 2.5, position=(0.16, 0.12, 0), material=material)
    stepper = nd.Stepper(scene, dt=1e-4, impact=law)
    step = stepper.step()
    approach = 3 * step.contacts.normal[0, 0]
    assert step.u[0, 0] == pytest.approx(0.6 * approach, rel=1e-9)
    np.testing.assert_allclose(step.r[0], (1.6 * approach / (1 + 1 / 2.5), 0, 0), rtol=1e-9, atol=1e-15)
    assert step.created == 0.0


def thrown_rod(seed):
    """A rod that meets the ground with one end, as in Kane and Levinson's paradox."""
    rng = np.random.default_rng(seed)
    half, radius, angle = 0.5, 0.01, rng.uniform(0.2, 1.3)
    axis = np.array([math.cos(angle), 0, math.sin(angle)])
    scene = nd.Scene(gravity=(0, 0, 0))
    material = nd.Material(1.0, 0.9)
    scene.add_halfspace("ground", material=material)
    scene.add_capsule(
        "rod", radius, 2 * half, 1.0, position=half * axis + (0, 0, radius), material=material,
        quaternion=Rotation.from_euler("y", math.pi / 2 - angle).as_quat(),
        linear_velocity=(*rng.uniform(-2, 2, 2), rng.uniform(-2.5, -0.5)), angular_velocity=rng.uniform(-3, 3, 3),
    )  # fmt: skip
    return scene


def created(scene, law, dt=1e-4):
    """Energy the first impact creates, as a fraction of the kinetic energy before."""
    stepper = nd.Stepper(scene, dt=dt, impact=law)
    before = stepper.start().energy["kinetic"]
    step = stepper.step()
    assert step.created == pytest.approx(max(0.0, (step.work_normal + step.work_friction).sum()), rel=1e-12, abs=1e-18)
    # Besides, the gyroscopic torque belongs to the motion that was foreseen.
    assert step.energy["kinetic"] - before == pytest.approx(
        (step.work_normal + step.work_friction).sum(), abs=1e-3 * before
    )
    return step.created / before


def test_newton_with_friction_creates_energy_and_the_ledger_says_so():
    gains = np.array([created(thrown_rod(seed), "newton") for seed in range(60)])
    assert (gains > 0.01).sum() >= 3 and gains.max() < 1.0


@pytest.mark.parametrize("law", ["poisson", "fremond"])
def test_the_dissipative_laws_never_do(law):
    # 1e-8 for the tolerance of the solver.
    assert max(created(thrown_rod(seed), law) for seed in range(60)) <= 1e-8


def test_poisson_in_a_crowd():
    """Boxes and balls thrown together, one restitution for all, many contacts at once."""
    rng = np.random.default_rng(5)
    scene = nd.Scene()
    material = nd.Material(0.8, 0.9)
    scene.add_halfspace("ground", material=material)
    for k in range(8):
        place = (0.25 * (k % 2), 0.25 * (k // 2 % 2), 0.2 + 0.3 * (k // 4))
        common = {"position": place, "linear_velocity": rng.uniform(-2, 2, 3), "material": material}
        if k % 2:
            scene.add_sphere(f"s{k}", 0.1, 1.0 + k, angular_velocity=rng.uniform(-9, 9, 3), **common)
        else:
            scene.add_box(f"b{k}", (0.2, 0.15, 0.1), 1.0 + k, angular_velocity=rng.uniform(-9, 9, 3), **common)
    stepper = nd.Stepper(scene, dt=1e-3, impact="poisson")
    kinetic = stepper.start().energy["kinetic"]
    impacts = 0
    for _ in range(600):
        step = stepper.step()
        impacts += step.energy["normal"] < -1e-3
        assert step.created <= 1e-6 * kinetic
    assert impacts > 20


def cradle(gap, count=5):
    material = nd.Material(0.0, 1.0)
    scene = nd.Scene(gravity=(0, 0, 0))
    for k in range(count):
        speed = 1.0 if k == 0 else 0.0
        place = (k * (0.2 + gap) - (0.05 if k == 0 else 0.0), 0, 0)
        scene.add_sphere(f"b{k}", 0.1, 1.0, position=place, linear_velocity=(speed, 0, 0), material=material)
    return scene


def speeds(scene, law, count=5):
    trajectory = nd.simulate(scene, 0.4, dt=1e-3, impact=law)
    energy = trajectory.energy.kinetic
    return np.array([trajectory.body(f"b{k}").linear_velocity[-1, 0] for k in range(count)]), energy[-1] / energy[0]


@pytest.mark.parametrize("law", LAWS)
def test_cradle_with_gaps_hands_the_speed_on(law):
    v, energy = speeds(cradle(0.01), law)
    np.testing.assert_allclose(v, (0, 0, 0, 0, 1), rtol=0, atol=1e-12)
    assert energy == pytest.approx(1.0, abs=1e-12)


def test_touching_cradle_of_newton():
    """Contacts that rest follow in rounds of their own: the speed is handed on as with gaps."""
    v, energy = speeds(cradle(0.0), "newton")
    np.testing.assert_allclose(v, (0, 0, 0, 0, 1), rtol=0, atol=1e-13)
    assert energy == pytest.approx(1.0, abs=1e-13)


def test_touching_cradle_of_fremond():
    """All contacts at once: the first ball comes back, the others leave together; energy is kept."""
    v, energy = speeds(cradle(0.0), "fremond")
    np.testing.assert_allclose(v, (-3 / 5, 2 / 5, 2 / 5, 2 / 5, 2 / 5), rtol=0, atol=1e-9)
    assert energy == pytest.approx(1.0, abs=1e-9)


def test_touching_cradle_of_poisson():
    """Compression makes all balls equally fast, 1/5, with impulses 4/5 ... 1/5; expansion gives them again."""
    v, energy = speeds(cradle(0.0), "poisson")
    assert v.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(v, (-3 / 5, 2 / 5, 2 / 5, 2 / 5, 2 / 5), rtol=0, atol=1e-9)
    assert energy <= 1.0 + 1e-12


@pytest.mark.parametrize("law", LAWS)
def test_bounces_end_when_zeno_says(law):
    """After √(2H/g) (1 + e)/(1 - e), less the bounces slower than 2 g dt, 4 dt at most."""
    height, e = 0.2, 0.5
    end = math.sqrt(2 * height / g) * (1 + e) / (1 - e)
    for dt in (4e-3, 1e-3):
        ball = nd.simulate(nd.scenes.load("bounce")(height=height, restitution=e), 0.8, dt=dt, impact=law).body("ball")
        moving = np.flatnonzero(np.abs(ball.linear_velocity[:, 2]) > 1e-9)[-1]
        assert -4 * dt <= (moving + 1) * dt - end <= dt
        assert ball.position[-1, 2] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_what_rests_does_not_chatter(law):
    scene = nd.Scene()
    material = nd.Material(0.5, 0.8)
    scene.add_halfspace("ground", material=material)
    for k in range(4):
        scene.add_box(f"b{k}", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1 + 0.2 * k), material=material)
    trajectory = nd.simulate(scene, 0.5, dt=1e-2, impact=law)
    assert np.abs(trajectory.v[1:]).max() < 1e-8
    np.testing.assert_allclose(trajectory.contacts(-1).impulse[:, 0].sum(), 10 * g * 1e-2, rtol=1e-6)


def test_unknown_law_is_refused():
    with pytest.raises(ValueError, match="impact must be one of"):
        nd.Stepper(nd.scenes.load("bounce")(), impact="hooke")
