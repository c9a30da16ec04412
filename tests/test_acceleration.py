"""Gauss's principle at the level of accelerations, against closed forms, against steps, and literally."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_convergence import FINE, ROUGH, arm, ellipsoid
from test_properties import scenes

import nsdyn as nd
from nsdyn.stepping.acceleration import Existence, accelerations, least_constraint

pytest.importorskip("clarabel", reason="the extra 'acceleration' is not installed")

g = 9.81


@pytest.mark.parametrize("mu", [0.35, 0.37])
def test_block_on_an_incline(mu):
    """On either side of tan 20° = 0.364, from rest: the jump from stick to slip is predicted."""
    angle = math.radians(20.0)
    a = max(0.0, g * (math.sin(angle) - mu * math.cos(angle)))
    found = accelerations(least_constraint(nd.scenes.load("incline")(angle=20.0, mu=mu)))
    assert found.existence is Existence.SOLVED and not found.problem.sliding.any()
    # Twice the tolerance of the quadratic program.
    assert np.linalg.norm(found.a[:3]) == pytest.approx(a, abs=1e-8)
    assert found.force[:, 0].sum() == pytest.approx(g * math.cos(angle), rel=1e-8)
    assert np.linalg.norm(found.relative[:, 1:], axis=1).max() == pytest.approx(a, abs=1e-8)


@pytest.mark.parametrize("excess", [-1e-4, 1e-4])
def test_stick_to_slip_where_the_step_says_so(excess):
    """A block at rest, pulled by a hair less and more than friction holds."""
    pull = 0.5 * g * (1 + excess)
    scene = nd.scenes.load("slide")(speed=0.0)
    found = accelerations(least_constraint(scene, wrenches={"box": (pull, 0, 0)}))
    # The interior point stays 1e-7 away where the friction is so near its bound.
    assert found.a[0] == pytest.approx(max(0.0, 0.5 * g * excess), abs=1e-7)
    stepper = nd.Stepper(scene, dt=1e-3, external_force=lambda t, q, v: {"box": (pull, 0, 0)}, solver=FINE)
    step = stepper.step()
    assert stepper.get_state().instant.v[0] / 1e-3 == pytest.approx(found.a[0], abs=1e-7)
    assert (step.contact_status == 2).any() == (found.relative[:, 1:].any() and excess > 0)


SMOOTH = {
    "rolling": lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2.0), 2.0),
    "sliding in a curve": lambda _: ellipsoid(Rotation.from_euler("yx", (0.6, 0.3)), (0.5, 0.5, 2.0), 0.15),
    "arm with a sliding tip": lambda folder: arm(folder, 0.1),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_differences_of_velocity_converge_to_it(name, tmp_path):
    """First order ahead, second order across."""
    ahead, across = [], []
    for steps in (50, 200):
        dt = 0.05 / steps
        stepper = nd.Stepper(SMOOTH[name](tmp_path), dt=dt, solver=nd.solvers.Auto(tol=1e-12), on_fail="ignore")
        states = []
        for _ in range(steps + 1):
            stepper.step()
            states.append(stepper.get_state())
        before, now, after = (state.instant for state in states[-3:])
        # Gaps and normal velocities of the run are of second order in dt.
        problem = least_constraint(stepper.scene, states[-2], closed=1e-4, still=1e-2)
        found = accelerations(problem)
        assert found.existence is Existence.SOLVED
        ahead.append(np.abs((after.v - now.v) / dt - found.a).max())
        across.append(np.abs((after.v - before.v) / (2 * dt) - found.a).max())
    assert math.log(ahead[0] / ahead[1], 4) == pytest.approx(1.0, abs=0.1)
    assert math.log(across[0] / across[1], 4) == pytest.approx(2.0, abs=0.3)


def rod(mu, speed):
    """A thin rod whose lower end slides on the ground."""
    half, radius, angle = 0.5, 1e-4, math.atan(2.0)
    scene = nd.Scene()
    material = nd.Material(mu)
    scene.add_halfspace("ground", material=material)
    scene.add_capsule(
        "rod", radius, 2 * half, 1.0, position=(half * math.cos(angle), 0, half * math.sin(angle) + radius),
        quaternion=Rotation.from_euler("y", math.pi / 2 - angle).as_quat(),
        inertia=np.diag([half**2 / 3, half**2 / 3, 1e-6]), linear_velocity=(speed, 0, 0), material=material,
    )  # fmt: skip
    return scene


@pytest.mark.parametrize(("excess", "exists"), [(-1e-3, True), (1e-3, False)])
def test_painleve(excess, exists):
    """μ = 4/3 at tan θ = 2: beyond, friction presses the end of the rod into the ground faster than it lifts it."""
    mu = 4 / 3 * (1 + excess)
    scene = rod(mu, -1.0)
    found = accelerations(least_constraint(scene))
    assert found.existence is (Existence.SOLVED if exists else Existence.NO_SOLUTION)
    steps = [nd.Stepper(scene, dt=dt).step() for dt in (1e-4, 1e-5)]
    impulses = [step.r[0, 0] for step in steps]
    assert all(step.solution.converged for step in steps)
    if exists:
        # A force: the impulse falls with dt, as far as the thickness of the rod allows.
        assert found.force[0, 0] == pytest.approx(impulses[1] / 1e-5, rel=0.05)
    else:
        # An impact without collision: an impulse whatever the dt.
        assert impulses[1] == pytest.approx(impulses[0], rel=0.01) and impulses[1] > 0.1
    # In the other direction nothing is odd.
    assert accelerations(least_constraint(rod(mu, 1.0))).existence is Existence.SOLVED


def test_impacts_have_no_acceleration():
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1), linear_velocity=(0, 0, -1), material=ROUGH)
    with pytest.raises(ValueError, match="'ground' and 'ball' approach at 1 m/s"):
        least_constraint(scene)


@settings(max_examples=20, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(scenes(), st.integers(20, 120), st.integers(0, 2**32 - 1))
def test_principles_on_random_scenes(scene, count, seed):
    """No admissible virtual acceleration lowers the functional; friction dissipates the most it can."""
    stepper = nd.Stepper(scene, dt=5e-3, on_fail="ignore")
    for _ in range(count):
        stepper.step()
    state = stepper.get_state()
    try:
        # After contact, bodies approach by what the turning of the rows makes of a step.
        problem = least_constraint(scene, state, closed=1e-5, still=1e-2)
    except ValueError:
        return
    found = accelerations(problem)
    if found.existence is not Existence.SOLVED:
        return
    mu, force, a = problem.contacts.mu, found.force, found.relative
    weight = 1.0 + np.abs(force).max(initial=0.0)
    # Signorini and Coulomb to the tolerance of the quadratic program.
    assert (force[:, 0] >= -1e-8 * weight).all() and (a[:, 0] >= -1e-6 * weight).all()
    assert np.abs(force[:, 0] * a[:, 0]).max(initial=0.0) <= 1e-6 * weight**2
    sliding = problem.sliding
    rate = np.where(sliding, (a[:, 1:] * problem.slip).sum(axis=1), np.linalg.norm(a[:, 1:], axis=1))
    np.testing.assert_allclose(
        -(force[:, 1:] * a[:, 1:]).sum(axis=1), mu * force[:, 0] * rate, rtol=0, atol=1e-6 * weight**2
    )  # fmt: skip
    # Literally: M's metric makes light coordinates move more.
    rng = np.random.default_rng(seed)
    least = problem.functional(found.a, force[:, 0])
    root = np.linalg.cholesky(np.linalg.inv(problem.M))
    for _ in range(100):
        other = found.a + 10.0 ** rng.uniform(-4, 2) * root @ rng.normal(size=found.a.size)
        if (problem.relative(other)[:, 0] >= np.minimum(a[:, 0], 0.0)).all():
            assert problem.functional(other, force[:, 0]) >= least - 1e-6 * weight**2
