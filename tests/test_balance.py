"""No island of bodies gains energy: what a step made it gain is taken by rolling resistance, and given back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn._kernels.stepping import balance as kernels

ROLLING = {"linear_velocity": (1.0, 0.3, 0.0), "angular_velocity": (3.0, 9.0, 1.0)}


class Pair:
    """Two free bodies that touch, and a fixed one below both: inertias, turns, velocities."""

    def __init__(self, rng):
        J = np.array([np.diag(rng.uniform(1.0, 1.5, 3)) for _ in range(2)])
        self.J, self.inverse_J = J, np.linalg.inv(J)
        self.R = Rotation.random(2, random_state=3).as_matrix()
        self.v = rng.normal(size=12)
        self.frame1, self.frame2 = np.array([-1, 0]), np.array([0, 1])
        self.normal = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])

    def spins(self, v):
        """ω in world axes."""
        return np.einsum("bij,bj->bi", self.R, v.reshape(2, 6)[:, 3:])

    def energy(self, v):
        w = v.reshape(2, 6)[:, 3:]
        return 0.5 * np.einsum("bi,bij,bj->", w, self.J, w)

    def momentum(self, v):
        """Of the spins, world axes."""
        return np.einsum("bij,bjk,bk->bi", self.R, self.J, v.reshape(2, 6)[:, 3:])

    def resist(self, gain, spare=0.0, frame1=None, frame2=None, normal=None, owed=(0.0, 0.0)):
        """(velocity afterwards, what was lost, whether it gained still)."""
        v = self.v.copy()
        frames = (self.frame1, self.frame2) if frame1 is None else (np.array(frame1), np.array(frame2))
        normal = self.normal if normal is None else normal
        angular = np.vstack((self.spins(self.v), np.zeros(3)))  # that of a driven body last
        found, self.owed = np.zeros((4, 2)), np.array(owed)
        found[:2] = gain, np.full(2, 0.5 * self.energy(self.v))
        gained, more = kernels.resist(found, self.owed, spare, *frames, normal, angular, self.R, self.inverse_J, v)
        return v, -gained, more


def test_an_island_loses_what_it_gained(rng):
    pair = Pair(rng)
    v, lost, _ = pair.resist([0.02, -0.01])
    assert lost == pytest.approx(0.01, rel=1e-12)
    assert pair.owed.sum() == lost
    assert pair.energy(pair.v) - pair.energy(v) == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_array_equal(v.reshape(2, 2, 3)[:, 0], pair.v.reshape(2, 2, 3)[:, 0])


def test_a_free_island_keeps_its_angular_momentum_and_its_spin_about_the_normal(rng):
    pair = Pair(rng)
    v, lost, _ = pair.resist([0.01, 0.0], frame1=[0], frame2=[1], normal=pair.normal[1:])
    change = pair.momentum(v) - pair.momentum(pair.v)
    assert lost == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_allclose(change.sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(change @ pair.normal[1], 0.0, atol=1e-15)
    assert np.abs(change).max() > 1e-4


@pytest.mark.parametrize("loss, owed, given", [(0.01, 0.005, 0.005), (0.001, 0.005, 0.001), (1e3, 0.005, 0.0)])
def test_what_was_taken_is_given_back_where_a_smooth_motion_loses(rng, loss, owed, given):
    pair = Pair(rng)
    pair.v *= 10.0
    v, lost, _ = pair.resist([0.0, -loss], owed=(0.0, owed))
    assert -lost == pytest.approx(given, rel=1e-12)
    assert pair.energy(v) - pair.energy(pair.v) == pytest.approx(given, rel=1e-9)
    assert pair.owed.sum() == pytest.approx(owed - given, rel=1e-12, abs=1e-15)


def test_it_loses_no_more_than_rolling_has(rng):
    pair = Pair(rng)
    v, lost, _ = pair.resist([1e3, 0.0])
    assert 0.0 < lost < pair.energy(pair.v)
    assert pair.energy(pair.v) - pair.energy(v) == pytest.approx(lost, rel=1e-12)


def test_what_only_spins_about_its_normal_loses_that_spin(rng):
    """Rolling resistance has no torque about n."""
    pair = Pair(rng)
    pair.v.reshape(2, 6)[:, 3:] = 0.0
    pair.v[3:6] = pair.R[0].T @ [0.0, 0.0, 2.0]
    v, lost, _ = pair.resist([0.01, 0.0], frame1=[-1], frame2=[0], normal=np.array([[0.0, 0.0, 1.0]]))
    assert lost == pytest.approx(0.01, rel=1e-12)
    assert pair.energy(pair.v) - pair.energy(v) == pytest.approx(0.01, rel=1e-12)


@pytest.mark.parametrize(
    "gain, spare, frame1, frame2",
    [
        ([0.01, -0.02], 0.0, [-1, 0], [0, 1]),  # lost in all
        ([0.01, 0.0], 0.02, [-1, 0], [0, 1]),  # created by the law of impact
        ([0.01, 0.0], 0.0, [0, 0], [1, 2]),  # touches what is driven
        ([0.01, 0.0], 0.0, [-1, -1], [1, 1]),  # touches nothing
    ],
)
def test_others_are_left_alone(rng, gain, spare, frame1, frame2):
    pair = Pair(rng)
    v, lost, _ = pair.resist(gain, spare, frame1, frame2)
    assert lost == 0.0
    np.testing.assert_array_equal(v, pair.v)


def egg(mu):
    """An ellipsoid that tumbles on a plane."""
    scene = nd.Scene()
    material = nd.Material(mu=mu)
    scene.add_halfspace("ground", material=material)
    scene.add_ellipsoid("egg", (0.12, 0.08, 0.1), 2.0, position=(0, 0, 0.1), material=material, **ROLLING)
    return scene


@pytest.mark.parametrize("mu", [0.0, 0.3, 2.0])
def test_an_ellipsoid_that_tumbles_gains_nothing(mu):
    trajectory = nd.simulate(egg(mu), 1.0, 1e-2)
    energy = trajectory.energy
    assert np.diff(energy.total).max() <= 1e-13 * trajectory.at_play
    assert np.abs(energy.defect).max() <= 1e-13 * trajectory.at_play
    if mu == 0.0:  # nothing pushes it sideways
        velocity = trajectory.body("egg").linear_velocity
        np.testing.assert_allclose(velocity[:, :2], velocity[:1, :2].repeat(len(velocity), 0), atol=1e-12)


def test_what_works_on_a_body_may_give_it_energy():
    """A ball rolls under a force F at its centre: (7/5) m v' = F."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=1.0))
    scene.add_sphere("ball", 0.1, 2.0, position=(0, 0, 0.1), material=nd.Material(mu=1.0))
    push = np.array([3.0, 0.0, 0.0])
    trajectory = nd.simulate(scene, 0.5, 1e-2, external_force=lambda t, q, v: {"ball": push})
    speed = trajectory.body("ball").linear_velocity[-1, 0]
    assert speed == pytest.approx(3.0 * 0.5 / (1.4 * 2.0), rel=1e-9)
    assert trajectory.energy.external.sum() == pytest.approx(trajectory.energy.kinetic[-1], rel=1e-9)


def test_a_disc_that_spins_on_its_face_is_not_tipped(rng):
    """What was taken from its rolling is not given back to a hair of it, whose direction is round-off."""
    pair = Pair(rng)
    pair.v.reshape(2, 6)[:, 3:] = 0.0
    pair.v[3:6] = pair.R[0].T @ [1e-8, 0.0, 2.0]
    v, lost, _ = pair.resist([-1e-5, 0.0], frame1=[-1], frame2=[0], normal=pair.normal[:1], owed=(1e-3, 0.0))
    assert 0.0 < -lost < 1e-15
    np.testing.assert_allclose(v, pair.v, atol=1e-10)


def test_what_cannot_be_taken_is_told(rng):
    pair = Pair(rng)
    assert not pair.resist([0.01, 0.0])[2]
    assert pair.resist([1e3, 0.0])[2]
    pair.v.reshape(2, 6)[:, 3:] = 0.0
    assert pair.resist([0.01, 0.0])[2]
    assert not pair.resist([-0.01, 0.0])[2]


@pytest.mark.parametrize("tilt", [0.1, 0.3])
def test_a_box_that_falls_on_its_face_in_large_steps_gains_nothing(tilt):
    """What lies flat after the step in which it lands has no rolling left that could pay for its lift."""
    scene, mass, gravity, dt = nd.Scene(gravity=(0, 0, -98.1)), 1.0, 98.1, 2e-3
    scene.add_halfspace("ground", material=nd.Material(mu=0.5))
    turn = Rotation.from_euler("xy", [tilt, 0.3 * tilt])
    lowest = np.abs(turn.as_matrix()[2]) @ [0.01, 0.005, 0.0025]
    scene.add_box(
        "box", (0.02, 0.01, 0.005), mass, position=(0, 0, lowest), quaternion=turn.as_quat(),
        material=nd.Material(mu=0.5),
    )  # fmt: skip
    trajectory = nd.simulate(scene, 20 * dt, dt)
    total = trajectory.energy.total
    # A contact counts as closed that is open, or overlaps, by what the solver's tolerance of 1e-8 m/s makes in a step.
    assert (total - np.minimum.accumulate(total)).max() <= 2.0 * (1e-8 * dt) * mass * gravity
