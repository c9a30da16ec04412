"""Moves and steps of the compiled kernel have the bits of the general ones, which ask what else might happen."""

import anything
import audits
import numpy as np
import pytest
from mechanisms import add, four_bars

import nsdyn as nd
from nsdyn.stepping import eventless, move_kernel

KERNEL = (eventless.EventlessSteps, "step"), (move_kernel.MoveKernel, "respond")


def made(scene, duration, options, monkeypatch, least=21):
    """Whether the kernel makes at least so many steps and moves, and all columns are those of the general ones."""
    went = []

    def counted(lane):
        def call(*arguments):
            went.append(lane(*arguments))
            return went[-1]

        return call

    with monkeypatch.context() as patch:
        for owner, name in KERNEL:
            patch.setattr(owner, name, counted(getattr(owner, name)))
        straight = nd.simulate(scene, duration, **options)
        assert sum(moves is not None for moves in went) >= least
        for owner, name in KERNEL:
            patch.setattr(owner, name, lambda *_: None)
        general = nd.simulate(scene, duration, **options)
    for column in straight.columns.keys() - {"wall_time", "solver/time"}:
        assert straight.columns[column].tobytes() == general.columns[column].tobytes(), column


@pytest.mark.parametrize(
    ("name", "parameters", "options"),
    [
        ("slide", {}, {"dt": 5e-3}),
        ("slide", {}, {"dt": 5e-3, "solver": "newton"}),
        ("slide", {}, {"dt": 5e-3, "polish": True}),
        ("stack", {"height": 3}, {"dt": 5e-3}),
        ("rolling", {"balls": 2}, {"dt": 2e-3}),
        ("tumble", {}, {"dt": 5e-3}),
        ("bounce", {}, {"dt": 1e-2}),
    ],
)
def test_eventless_steps_are_the_general_ones(name, parameters, options, monkeypatch):
    """What one kernel does in a call ends with the bits of the way that asks what else might happen."""
    made(nd.scenes.load(name)(**parameters), 120 * options["dt"], options, monkeypatch)


@pytest.mark.parametrize(("name", "steps"), [("domino", 60), ("rattleback", 60), ("pile", 30), ("euler_disk", 60)])
def test_moves_of_the_kernel_are_the_general_ones(name, steps, monkeypatch):
    """The same of what rolls, turns on what it lies on, leans on others, is struck, and of islands by themselves."""
    setup = nd.scenes.setup(name)
    made(setup.scene, steps * setup.dt, setup.options(), monkeypatch)


@pytest.mark.parametrize(
    "name",
    [pytest.param("quadruped", marks=pytest.mark.slow), "arm_pushes_box", "double_pendulum", "bricard", "four_bar"],
)
def test_eventless_steps_of_trees_are_the_general_ones(name, monkeypatch):
    """The same of robots under control, in contact and not, beside free bodies and alone, and of closed loops."""
    setup = nd.scenes.setup(name)
    made(setup.scene, (300 if name == "quadruped" else 120) * setup.dt, setup.options(), monkeypatch)


@pytest.mark.parametrize("beside", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_eventless_steps_of_driven_joints_are_the_general_ones(beside, monkeypatch):
    """Two windows of four bars, whose first rod turns as prescribed, alone and beside a box that slides."""
    model, loops, v = four_bars(2)
    scene = nd.scenes.load("slide")() if beside else nd.Scene()
    add(scene, "bars", model, loops=loops, v=v)
    scene.set_motion("bars/v0", velocity=lambda t: 1.0 + np.sin(3.0 * t))
    # With contacts anywhere the steps are the general ones: problems have the coordinates that loops leave.
    made(scene, 120 * 2e-3, {"dt": 2e-3}, monkeypatch, least=0 if beside else 100)


def test_eventless_steps_under_forces_of_the_velocity_are_the_general_ones(monkeypatch):
    """Drag on a standing robot and on boxes that slide and rest beside it, every fourth step recorded."""
    module = nd.scenes.module("quadruped")
    scene = module.scene(count=2)
    for k, speed in enumerate((0.0, 2.0)):
        place = {"position": (0.0, 2.0 + k, 0.1), "linear_velocity": (speed, 0, 0)}
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, material=nd.Material(mu=0.4), **place)
    first = next(iter(scene.articulations))
    body = next(iter(nd.Stepper(scene).dynamics.trees[0].bodies))

    def drag(t, q, v):
        return {"box0": (0.1, 0, 0), "box1": -0.3 * v[6:9], f"{first}/{body}": (0.0, 5.0 * np.sin(20.0 * t), 0.0)}

    options = {"dt": 5e-3, "controller": module.controller(scene, walk=False), "external_force": drag, "every": 4}
    made(scene, 120 * options["dt"], options, monkeypatch)


@pytest.mark.parametrize(
    ("name", "parameters", "dt"),
    [("slide", {}, 5e-3), ("rolling", {"balls": 2}, 2e-3), ("bounce", {}, 1e-2), ("tumble", {}, 5e-3)],
)
def test_eventless_steps_of_bodies_that_are_pushed_are_the_general_ones(name, parameters, dt, monkeypatch):
    """A wind that turns with the time, drag of the velocity, and a torque of the spin, on bodies that touch and fly."""
    scene = nd.scenes.load(name)(**parameters)

    def wind(t, q, v):
        push = {}
        for k, body in enumerate(scene.free_bodies):
            own = v[6 * k : 6 * k + 6]
            push[body.name] = np.array([(0.5 * np.sin(9.0 * t), 0.3, 0.0) - 0.1 * own[:3], -1e-3 * own[3:]])
        return push

    made(scene, 120 * dt, {"dt": dt, "external_force": wind}, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(700, 740))
def test_random_robots_are_made_alike(seed, monkeypatch):
    """Limits, dry friction, gears, loops, drives, controllers and pushes: what the kernel leaves and what it makes."""
    scene, options = audits.random_robot(seed)
    made(scene, 0.15, options, monkeypatch, least=0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(9000, 9009), *range(9010, 9040)])  # the arm of 9009 begins in the ground
def test_random_scenes_are_made_alike(seed, monkeypatch, tmp_path):
    """Bodies of any shapes, masses and laws of impact that meet, with an arm beside some, pushed and not."""
    scene, options, _ = anything.random_scene(seed, tmp_path)
    if seed % 2:
        weights = {body.name: 1e-2 * body.mass for body in scene.free_bodies}

        def push(t, q, v):
            return {name: (w * np.sin(t / options["dt"] / 7), w, 0.0) for name, w in weights.items()}

        options["external_force"] = push
    made(scene, 40 * options["dt"], options, monkeypatch, least=0)
