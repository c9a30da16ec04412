"""The scenes of SimBenchmark, and energy over ten thousand elastic impacts."""

import math

import numpy as np
import pytest
from conftest import drift, penetration

import nsdyn as nd

WORKS = ("external", "normal", "friction", "integration", "projection")


# -- case 15: elastic impacts ------------------------------------------------------------------------------------------


class Account:
    """Energy of a run, step by step, with what the ledger says of it and the number of impacts."""

    def __init__(self, scene, steps, dt, tol):
        stepper = nd.Stepper(scene, dt=dt, solver=nd.solvers.Auto(tol=tol))
        start = stepper.start().energy
        self.energy, self.booked, self.impacts = [start["kinetic"] + start["potential"]], [0.0], 0
        for _ in range(steps):
            step = stepper.step()
            self.impacts += int((step.r[:, 0] > 0.0).sum())
            self.energy.append(step.energy["kinetic"] + step.energy["potential"])
            self.booked.append(sum(step.energy[name] for name in WORKS))
        self.energy = np.array(self.energy)
        self.change = self.energy / self.energy[0] - 1.0
        self.unexplained = np.abs(self.energy - self.energy[0] - np.cumsum(self.booked)).max() / self.energy[0]


@pytest.mark.slow
@pytest.mark.case(15)
@pytest.mark.parametrize("steps", [300, 6000])
def test_energy_over_ten_thousand_elastic_impacts(steps):
    """27 smooth balls in a closed box: of the change nothing is unexplained, and what is left is the solver's error.

    In 6000 steps; in 300 there are a twentieth of the impacts.
    """
    run = Account(nd.scenes.load("billiard")(balls=27, speed=5.0), steps, 2e-3, tol=1e-12)
    assert run.impacts >= steps / 0.6
    # 6000 sums of numbers as large as the energy.
    assert run.unexplained <= 1e-12
    assert np.abs(run.change).max() <= 1e-11
    # Not secular: both halves of the run change it by less than the bar.
    assert abs(run.energy[-1] - run.energy[steps // 2]) <= 1e-11 * run.energy[0]


@pytest.mark.slow
@pytest.mark.case(15)
@pytest.mark.parametrize("steps", [4000, 10_000])
def test_elastic_ball_under_gravity_keeps_its_energy(steps):
    """One ball between floor, walls and lid: every impact is exact, so only round-off of 10 000 steps is left."""
    run = Account(nd.scenes.load("billiard")(balls=1, speed=8.0, gravity=9.81), steps, 2e-3, tol=1e-12)
    assert run.impacts >= steps / 50
    assert run.unexplained <= 1e-12
    assert np.abs(run.change).max() <= 1e-12


# -- case 44: rolling --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.case(44)
@pytest.mark.parametrize("heading", [*(pytest.param(angle, marks=pytest.mark.slow) for angle in (0.0, 60.0)), 137.0])
def test_box_and_balls_pushed(heading):
    """M a + (2/7) n m a = F - mu (M + n m) g; SimBenchmark's error is the mean square of the velocities' errors."""
    module = nd.scenes.module("rolling")
    box = (module.FORCE - 0.4 * 35.0 * 9.81) / (10.0 + 2 / 7 * 25)
    assert (round(box, 12), round(2 / 7 * box, 12)) == (0.7385, 0.211)
    direction = np.array([math.cos(math.radians(heading)), math.sin(math.radians(heading)), 0.0])

    def push(t, q, v):
        return {"box": module.FORCE * direction}

    setup = nd.scenes.setup("rolling")
    given = {} if heading == module.HEADING else {"external_force": push}
    trajectory = nd.simulate(setup.scene, 4.0, **setup.options(dt=1e-2, **given))
    t = trajectory.t[:, None]
    squares = 0.0
    for name, a in [("box", box), *((f"ball{k}", 2 / 7 * box) for k in range(25))]:
        v = trajectory.body(name).linear_velocity
        np.testing.assert_allclose(v[1:] / t[1:], np.tile(a * direction, (400, 1)), rtol=0, atol=1e-9)
        squares = max(squares, np.square(v - a * direction * t).sum(axis=1).mean())
    # Best of the peers with an error at all: 4e-7 (RaiSim) and 6e-9 (Bullet) m²/s².
    assert squares <= 1e-20


# -- case 45: 666 and Kapla --------------------------------------------------------------------------------------------


@pytest.mark.case(45)
@pytest.mark.parametrize(
    ("side", "dt", "duration"), [(3, 5e-3, 0.6), pytest.param(6, 2e-3, 2.0, marks=pytest.mark.slow)]
)
def test_falling_balls_do_not_overlap(side, dt, duration):
    trajectory = nd.simulate(nd.scenes.load("six_cubed")(side=side), duration, dt=dt)
    assert np.isin(trajectory.solver.status, (nd.Status.CONVERGED, nd.Status.LOOSE)).all()
    assert len(trajectory.contacts(-1)) > side**2
    # The best mean square of the peers is 1.35e-4 m², at dt = 1e-3.
    assert penetration(trajectory) <= 1e-8


@pytest.mark.slow
@pytest.mark.case(45)
@pytest.mark.parametrize(("side", "duration"), [(3, 2.0), (6, 4.0)])
def test_elastic_balls_keep_their_energy(side, duration):
    """At dt = 1e-3; the least mean square error of the peers is 1.1e-3 J² (RaiSim), at dt = 1e-4."""
    run = Account(
        nd.scenes.load("six_cubed")(side=side, restitution=1.0, mu=0.0), round(duration / 1e-3), 1e-3, tol=1e-8
    )
    assert run.impacts > 5 * side**3
    assert run.unexplained <= 1e-12
    assert np.square(run.energy - run.energy[0]).mean() <= 1e-4


@pytest.mark.case(45)
@pytest.mark.parametrize("duration", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_kapla_stands(duration):
    """102 blocks, some 900 contacts."""
    scene = nd.scenes.load("kapla")()
    assert len(scene.free_bodies) == 102
    trajectory = nd.simulate(scene, duration, dt=1e-2)
    assert (trajectory.solver.status == nd.Status.CONVERGED).all()
    assert drift(trajectory) <= 1e-9
    assert penetration(trajectory) <= 1e-10
    contacts = trajectory.contacts(-1)
    ground = contacts.impulse[np.array(contacts.body1) == "ground", 0].sum() / 1e-2
    assert ground == pytest.approx(1020.0 * 9.81, rel=1e-9)
