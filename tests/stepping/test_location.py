"""Impacts are located in few moves: where other contacts press, and where the solver leaves noise."""

import numpy as np
import pytest

import nsdyn as nd
from nsdyn._kernels.stepping import active_set as _active_set
from nsdyn.stepping import substepping

FAR, NEAR = 0.45, 0.01
"""m: from the middle of a plank to where it is about to touch, and to where it rests."""


def plank(speed, gap):
    """A plank that rests on an edge near its middle and turns towards another, `gap` m below."""
    scene, turn = nd.Scene(), speed / (FAR + NEAR)
    scene.add_box("edge", (0.02, 0.2, 0.1), fixed=True, position=(NEAR + 0.01, 0, -0.05))
    scene.add_box("other", (0.02, 0.2, 0.1), fixed=True, position=(-FAR - 0.01, 0, -0.05 - gap))
    at_rest = NEAR, 0, -0.025
    scene.add_box(
        "plank",
        (1.0, 0.1, 0.05),
        1.0,
        position=(0, 0, 0.025),
        angular_velocity=(0, -turn, 0),
        linear_velocity=-np.cross((0, -turn, 0), at_rest),
    )
    return scene


def moves(stepper, monkeypatch):
    """Moves that are tried in a step."""
    tried, count = substepping.try_move, 0

    def counted(*arguments):
        nonlocal count
        count += 1
        return tried(*arguments)

    monkeypatch.setattr(substepping, "try_move", counted)
    stepper.step()
    return count


@pytest.mark.parametrize(("speed", "gap"), [(2e-3, 5e-9), (2e-3, 1e-7), (2e-2, 5e-9)])
def test_a_touch_is_found_at_once_where_something_else_presses(speed, gap, monkeypatch):
    """What falls about an edge accelerates otherwise than freely. It took 12 to 14 moves by gravity alone."""
    stepper = nd.Stepper(plank(speed, gap), dt=1e-2)
    # One over the step, two of Newton's method, one for the rest of it, and one to spare.
    assert moves(stepper, monkeypatch) <= 5


def test_what_comes_to_rest_on_a_shaking_plate_is_located_no_more(monkeypatch):
    """Its speed is that on the plate: by its own it would strike all the time, and took 400 moves a step."""
    scene, grip = nd.Scene(), nd.Material(0.5, 0.3)
    scene.add_box("plate", (4, 4, 0.2), fixed=True, position=(0, 0, -0.1), material=grip)
    scene.set_motion("plate", lambda t: ((0.1 * np.cos(7 * t), 0, 0.5 * np.cos(30 * t)), (0, 0, 0.2 * np.sin(5 * t))))
    scene.add_sphere("ball", 0.1, 1.0, position=(1, 1, 0.1), material=grip)
    stepper = nd.Stepper(scene, dt=5e-3)
    tried = []
    for _ in range(60):
        with monkeypatch.context() as patched:
            tried.append(moves(stepper, patched))
    assert sum(tried) < 400  # of 60 steps, among them those in which it hops and bounces
    assert max(tried[41:50]) <= 2  # where it rests


def test_what_slides_fast_along_its_guide_is_located_once(monkeypatch):
    """The block of a slider-crank strikes with 1 m/s along a clearance of a micrometre: it took 61 moves in a step.

    Its features are on the same sides where a move begins and ends, so that it has not passed through the guide.
    """
    stepper = nd.Stepper(nd.scenes.load("slider_crank")(), dt=1e-3)
    tried = []
    for _ in range(280):
        with monkeypatch.context() as patched:
            tried.append(moves(stepper, patched))
    assert max(tried) <= 20 and sum(tried) <= 900


@pytest.mark.parametrize("share", [-0.36, 0.3, -1.9])
def test_newtons_method_that_nears_by_a_constant_share_is_not_followed(share):
    """Its next two steps tell where it would end."""
    root, begin = 0.25, 1.0
    aims = [(t, root + share * (t - root)) for t in (begin, root + share * (begin - root))]
    assert substepping._next(aims) == pytest.approx(root, rel=1e-14, abs=0.0)  # but for round-off


def test_newtons_method_that_doubles_its_digits_is_followed():
    aims = [(t, 0.25 + 0.1 * (t - 0.25) ** 2) for t in (0.35, 0.251)]
    assert substepping._next(aims) == aims[1][1]
    assert substepping._next(aims[:1]) == aims[0][1]
    assert substepping._next([(0.35, np.inf), aims[1]]) == aims[1][1]
    # Neither tells a root: what is aimed at runs away as fast as one follows.
    assert substepping._next([(0.2, 0.5), (0.3, 0.6)]) == 0.6


@pytest.mark.parametrize(
    ("status", "beside", "parts", "met"),
    [(1, 0, 1e-6, True), (2, 0, -2e-5, True), (1, 0, -1e-4, False), (0, 0, 1e-6, False), (0, 1, 1e-6, True)],
)
def test_what_pressed_is_met_as_it_stands_where_the_move_begins(status, beside, parts, met):
    """A motion without contacts brings it 3e-8 m into the other body half a move later, as its bodies turn.

    Deep are 4e-8 m. At the speed of the beginning, with the rows that it has there, it opens, or closes 2e-8 m in 1 ms.
    So is what stands `beside` a contact that pressed.
    """
    names, points, still = np.array([[0], [0], [-1], [0], [7]]), np.zeros((4, 1, 3)), np.zeros((1, 3))
    points[1, 0, 2] = 1.0
    sinks = np.array([[0.0, 0.0, -6e-5]]), still
    out = np.empty(1, np.bool_)
    _active_set.captured(
        (names, points, np.array([[-3e-8], [0.0], [0.0]])),
        still,
        (np.array([4e-8]), 1.0),
        np.zeros(1),
        (sinks, sinks, (still, still)),
        (names[4], np.array([1e-9]), np.array([parts]), 1e-11),
        (np.array([7, 8]), np.array([0, 0]), np.array([status, beside], np.int8)),
        (5e-4, 1e-3, 1e-8, (0.0, 1e-3)),
        np.empty(0, np.int64),
        out,
    )
    assert out[0] == met


@pytest.mark.parametrize(("rows", "speed", "first"), [(2, 2e-3, True), (6, 2e-3, False), (6, 0.2, True)])
def test_what_strikes_slowly_where_no_event_is_located_is_caught_in_the_move(rows, speed, first):
    """A wall all of whose bricks begin to fall: they strike first where they would be deep in each other else.

    That is by 1e-3 of their inscribed radius of 5 cm in a large island, 1 cm/s at 5 ms, by 1e-5 in a small one.
    """
    stepper = nd.Stepper(nd.scenes.load("wall")(rows=rows, columns=rows), dt=5e-3)
    v = np.zeros_like(stepper.start().v)
    v[2::6] = -speed
    stepper.reset(v=v)
    step = stepper.step()
    assert bool((step.contact_duration == 0.0).any()) is first
    assert np.abs(step.v).max() <= 1e-4  # m/s: the loose tolerance
    assert step.ledger.kinetic <= 1e-8 and abs(step.ledger.defect) <= 1e-9  # J


def test_a_contact_that_only_a_motion_without_others_closes_is_not_caught():
    """An edge of a plate rolls on a drum; what would close within the step strikes nothing, for the edge bears it."""
    scene, material = nd.Scene(), nd.Material(mu=0.1, restitution=0.3)
    scene.add_cylinder("drum", 0.4, 5, fixed=True, quaternion=(0.5**0.5, 0, 0, 0.5**0.5), material=material)
    turn = np.array([0.077254, 0.084991, -0.868736, -0.481773])
    how = {
        "position": (-0.022781, 0.170481, 0.697455),
        "quaternion": turn / np.linalg.norm(turn),
        "linear_velocity": (-0.677587, 0.261889, -0.649182),
        "angular_velocity": (-0.557802, 4.123004, -1.087073),
    }
    moments = np.diag([0.12, 0.083614, 0.05715])
    scene.add_box("plate", (1, 0.7, 0.5), 1.0, inertia=moments, material=material, **how)
    run = nd.simulate(scene, 0.016, dt=8e-3)
    assert -1e-4 < run.energy.normal[-1] <= 0.0  # J: what strikes takes a thousandth
    assert nd.check(run).passed, nd.check(run)


def test_a_move_that_is_halved_leaves_what_was_located_before_it(monkeypatch):
    """A ball bounces within a step, of which the flight afterwards is said to be too coarse, but not its half."""

    def bounced():
        scene = nd.Scene()
        scene.add_halfspace("floor", material=nd.Material(0.3, 0.8))
        drop = 0.1 + 0.3 * 2e-2 + 0.5 * 9.81 * (0.3 * 2e-2) ** 2
        scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, drop), linear_velocity=(0.1, 0, -1))
        return nd.Stepper(scene, dt=2e-2).step()

    whole, rest = bounced(), 0.7 * 2e-2
    lengths = []

    def strains(s, begin, move, tried):
        lengths.append(tried.mid.h)
        return len(lengths) == 2

    monkeypatch.setattr(substepping, "_gains_energy", strains)
    halved = bounced()
    # To the impact; what is left, which is halved; its halves.
    np.testing.assert_allclose(lengths, [6e-3, rest, rest / 2, rest / 2], rtol=0, atol=1e-4)
    struck = whole.contact_status > 0
    assert struck.sum() == 1
    np.testing.assert_array_equal(halved.contact_time[halved.contact_status > 0], whole.contact_time[struck])
    np.testing.assert_array_equal(halved.r[halved.contact_status > 0], whole.r[struck])
    np.testing.assert_allclose(halved.q, whole.q, rtol=0, atol=1e-14)  # flight is exact, whatever it is made of


@pytest.mark.parametrize("spin", [(-4.9, 4.7, -11.8), (-5.3, 4.7, -11.4), (-4.7, 4.8, -12.1)])
def test_moves_to_many_events_leave_the_rest_of_a_step_to_be_halved(spin):
    """A coin that lands almost flat: its contact sweeps around the rim in microseconds, in moves that are halved."""
    scene, material = nd.Scene(), nd.Material(mu=0.1)
    scene.add_halfspace("table", material=material)
    turn, way = np.array([-0.2431, 0.9650, 0.0704, 0.0690]), {"linear_velocity": (0, 0, -0.93), "material": material}
    turn /= np.linalg.norm(turn)
    scene.add_cylinder(
        "coin", 0.0142, 0.002, 5e-3, position=(0, 0, 0.0057), quaternion=turn, angular_velocity=spin, **way
    )
    run = nd.simulate(scene, 0.02, dt=5e-3)
    lifts = np.linalg.norm(run.columns["lifts/shift"][:, :3], axis=1)
    assert lifts.max(initial=0.0) <= 2e-6  # m: a thousandth of its thickness, of 4e-5 and more without halves
    assert nd.check(run).passed
