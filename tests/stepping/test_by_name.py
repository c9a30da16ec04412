"""What loops of one's own need: states to begin from, contacts and forces by name, callbacks that see the last step."""

import tracemalloc

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.stepping import checkpoint
from nsdyn.stepping.state import Names

MODULE = nd.scenes.module("quadruped")


@pytest.fixture(scope="module")
def standing():
    """A quadruped that stands, its stepper, the last step and a recording of the same steps."""
    scene = MODULE.scene()
    control = MODULE.controller(scene, walk=False)
    stepper = nd.Stepper(scene, 4e-3, controller=control)
    steps = [stepper.step() for _ in range(5)]
    return stepper, steps[-1], nd.simulate(scene, 0.02, dt=4e-3, controller=control)


def test_forces_and_contacts_are_those_of_the_recording(standing):
    _, step, run = standing
    for name in ("quadruped", "ground", "quadruped/FL_foot", "quadruped/trunk"):
        np.testing.assert_allclose(step.force(name), run.force(name)[-1], rtol=0, atol=1e-12)  # sums of 100 N
    touch, pair = step.between("ground", "quadruped/FL_foot"), run.pair("ground", "quadruped/FL_foot")
    np.testing.assert_allclose(touch.force.sum(axis=0), pair.force[-1], rtol=0, atol=1e-12)
    assert touch.gap.min() == pair.gap[-1] and touch.status.tolist() == [1] and touch.normal[0, 2] == 1.0
    back = step.between("quadruped/FL_foot", "ground")
    for name in ("normal", "velocity", "force"):
        np.testing.assert_array_equal(getattr(back, name), -getattr(touch, name))
    assert step.between("ground", "quadruped").gap.size == 4
    assert step.between("quadruped/trunk", "ground").force.shape == (0, 3)
    with pytest.raises(
        ValueError, match=r"did you mean 'quadruped/HR_foot'\? body must be one of ground, .*; got 'foot'"
    ):
        step.force("foot")
    with pytest.raises(ValueError, match=r"body must be one of ground, .*; got 'sky'"):
        step.between("ground", "sky")


def test_velocities_are_those_of_the_recording(standing):
    _, step, run = standing
    for name in ("quadruped/trunk", "quadruped/FL_foot"):
        for found, known in zip(step.velocity(name), ("linear_velocity", "angular_velocity"), strict=True):
            np.testing.assert_allclose(found, getattr(run.body(name), known)[-1], rtol=0, atol=1e-12)  # of 0.1 m/s
    scene = nd.Scene()
    scene.add_box(
        "box", (1, 1, 1), 1.0, linear_velocity=(1, 2, 3), angular_velocity=(0, 0, 2), quaternion=(0, 0.6, 0, 0.8)
    )
    linear, angular = nd.Stepper(scene, 1e-3).step().velocity("box")
    # It falls for 1 ms; a cube turns as it did.
    np.testing.assert_allclose(linear, (1, 2, 3 - 9.81e-3), rtol=0, atol=1e-14)
    np.testing.assert_allclose(angular, (0, 0, 2), rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="moving body must be one of box; got 'ground'"):
        nd.Stepper(scene).step().velocity("ground")


# -- states of one's own -----------------------------------------------------------------------------------------------


def thrown():
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 1), linear_velocity=(1, 0, 0))
    return scene


def test_a_run_begins_anew():
    """From the state of the scene, and from one of one's own, as a scene made so does."""
    stepper = nd.Stepper(thrown(), 1e-2)
    first = stepper.step()
    stepper.reset()
    assert stepper.t == 0.0 and stepper.step().q.tobytes() == first.q.tobytes()
    place, turn = (0.5, 0.0, 2.0), np.array((0.0, 0.0, 0.6, 0.8))
    stepper.reset(q=(*place, *turn), v=(1.0, 2.0, 0.0, 0.0, 0.0, 3.0))
    moved = stepper.step()
    made = nd.Scene()
    made.add_halfspace("ground")
    # Pinocchio's velocities are in the axes of the body: (1, 2) turned by an angle of cosine 0.28 and sine 0.96.
    made.add_box(
        "box",
        (0.2, 0.2, 0.2),
        1.0,
        position=place,
        quaternion=turn,
        linear_velocity=(0.28 - 2 * 0.96, 0.96 + 2 * 0.28, 0.0),
        angular_velocity=(0, 0, 3),
    )
    other = nd.Stepper(made, 1e-2).step()
    np.testing.assert_allclose(moved.q, other.q, rtol=0, atol=1e-14)
    np.testing.assert_allclose(moved.v, other.v, rtol=0, atol=1e-14)


def test_a_robot_begins_anew(standing):
    stepper, step, _ = standing
    q = np.array(step.q)
    q[2] += 0.1
    stepper.reset(q=q)
    begun = stepper.start()
    np.testing.assert_allclose(begun.q, q, rtol=0, atol=1e-15)
    assert repr(begun) == "<Step of nothing at t = 0 s>"
    assert begun.t == 0.0 and not begun.v.any() and stepper.step().force("quadruped")[2] == 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"q": np.zeros(18)}, r"q must be 19 numbers, got shape \(18,\)"),
        ({"v": np.zeros(12)}, r"v must be 18 numbers, got shape \(12,\)"),
        ({"v": np.full(18, np.nan)}, "v must be finite"),
        ({"q": np.r_[0, 0, 1, np.zeros(16)]}, "q of 'quadruped' must have unit quaternions"),
        (
            {"q": np.r_[0, 0, 1, 0, 0, 0, 1, 9.0, np.zeros(11)]},
            "q must respect the limits: joint 'quadruped/FL_abduction'",
        ),
        ({"q": np.r_[0, 0, -0.5, 0, 0, 0, 1, 4 * (0.0, 0.8, -1.6)]}, "overlap at the start by"),
    ],
)
def test_states_that_cannot_be_are_refused(standing, given, words):
    stepper, _, _ = standing
    state = checkpoint.pack(stepper.get_state())
    with pytest.raises(ValueError, match=words):
        stepper.reset(**given)
    now = checkpoint.pack(stepper.get_state())
    assert {name: values.tobytes() for name, values in now.items()} == {n: v.tobytes() for n, v in state.items()}


# -- callbacks that see the last step ----------------------------------------------------------------------------------


def test_callbacks_are_given_the_last_step(tmp_path):
    """None at first, then the step that ended where this one begins; states take it along."""
    seen = []

    def push(t, q, v, last):
        seen.append(last)
        return {} if last is None else {"box": (last.force("box")[2], 0.0, 0.0)}

    scene = nd.scenes.load("slide")()
    stepper = nd.Stepper(scene, 1e-2, external_force=push)
    first = stepper.step()
    assert set(seen) == {None} and stepper.external_force is push and stepper.controller is None
    state, done = stepper.get_state(), stepper.step()
    assert seen[-1] is first
    # Its weight, along the ground.
    assert done.ledger.external > 0.0
    stepper.set_state(state)
    assert stepper.step().q.tobytes() == done.q.tobytes()
    stepper.reset()
    stepper.step()
    assert seen[-1] is None
    with pytest.raises(AttributeError):
        stepper.external_force = None
    nd.simulate(scene, 0.02, dt=1e-2, external_force=push, record=tmp_path / "run.h5")
    with pytest.raises(ValueError, match="resume must be None where a function takes the last step"):
        nd.simulate(scene, 0.04, dt=1e-2, external_force=push, resume=tmp_path / "run.h5")


def test_names_of_many_bodies_take_little():
    """Linear in their number: a mask for each of 10 000 bodies would take 100 MB and 5 s in every simulation."""
    scene = nd.Scene()
    for k in range(2000):
        scene.add_sphere(f"ball{k}", 0.1, 1.0)
    geoms = scene.geoms()
    tracemalloc.start()
    names = Names(scene, geoms)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2_500_000  # bytes; 1.8e6 with lists, 5.8e6 with masks
    assert np.flatnonzero(names.members("ball7")).tolist() == [7]
