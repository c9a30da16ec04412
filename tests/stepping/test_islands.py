"""What an island does depends on nothing that it does not touch: the same bits alone and beside anything else."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import hang, lump

import nsdyn as nd
from nsdyn._kernels.solvers.start import widest
from nsdyn.solvers.newton import DENSE
from nsdyn.stepping import islands
from nsdyn.stepping.active_set import normal_velocities
from nsdyn.stepping.islands import Islands

E = 0.8
FAR = 1000.0


def ball(scene):
    """A ball that bounces."""
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 1.1), material=nd.Material(mu=0.5, restitution=E))


def cubes(scene, count=6, at=(0.0, 0.0), name="cube", seed=0):
    """Cubes that tumble on each other, and come to rest."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        q = rng.normal(size=4)
        x = (at[0] + rng.uniform(-0.15, 0.15), at[1] + rng.uniform(-0.15, 0.15), 0.25 + 0.3 * k)
        spin = rng.normal(size=3)
        scene.add_box(
            f"{name} {k}", (0.2, 0.2, 0.2), 1.0, position=x, quaternion=q / np.linalg.norm(q), angular_velocity=spin
        )


def slider(scene):
    """A box that slides to rest."""
    scene.add_box("slider", (0.2, 0.2, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(0.5, 0.1, 0))


def robot(scene):
    """A robot of four legs that lands."""
    quadruped = nd.scenes.load("quadruped")()
    scene.articulations.update(quadruped.articulations)


def rest(scene, count):
    """Boxes at rest."""
    for k in range(count):
        scene.add_box(f"box {k}", (0.2, 0.2, 0.2), 1.0, position=(FAR + 0.5 * (k % 40), 0.5 * (k // 40), 0.1))
        scene.set_pair(f"box {k}", "ground", mu=0.5, restitution=0.0)


def world(restitution=0.0):
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=0.5, restitution=restitution))
    return scene


def states(scene, steps, dt, bodies=(), robot=None, **options):
    """Positions and velocities of some bodies, or of a robot's joints, after each step, as bytes."""
    stepper, out = nd.Stepper(scene, dt, **options), []
    names = [b.name for b in scene.free_bodies]
    rows = [names.index(name) for name in bodies]
    for _ in range(steps):
        stepper.step()
        i = stepper.get_state().instant
        own = [i.position.x[rows], i.position.quaternion[rows], i.v[: 6 * len(names)].reshape(-1, 6)[rows]]
        if robot is not None:
            own += [i.position.trees[robot], i.v[stepper.dynamics.trees[robot].coordinates]]
        out.append(b"".join(part.tobytes() for part in own))
    return out


@pytest.mark.parametrize("boxes", [1, 12, 13, pytest.param(300, marks=pytest.mark.slow)])
def test_a_ball_bounces_as_it_does_alone(boxes):
    """On sixty contacts and more, too, among which others come near each other."""
    alone, beside = world(E), world(E)
    for scene in (alone, beside):
        ball(scene)
    rest(beside, boxes)
    cubes(beside, 2, at=(FAR / 2, 0.0), name="falling")
    for k in range(2):
        beside.set_pair(f"falling {k}", "ground", mu=0.5, restitution=0.0)
    assert states(alone, 60, 1e-2, ["ball"]) == states(beside, 60, 1e-2, ["ball"])


@pytest.mark.parametrize("steps", [100, pytest.param(200, marks=pytest.mark.slow)])
def test_cubes_tumble_and_rest_as_they_do_alone(steps):
    alone, beside = world(), world()
    for scene in (alone, beside):
        cubes(scene)
    cubes(beside, 4, at=(FAR, 0.0), name="other", seed=1)
    own = [f"cube {k}" for k in range(6)]
    assert states(alone, steps, 5e-3, own) == states(beside, steps, 5e-3, own)


def test_what_rests_and_slides_does_so_beside_what_falls():
    alone, beside = world(), world()
    for scene in (alone, beside):
        slider(scene)
        rest(scene, 3)
    cubes(beside, 4, at=(-FAR, 0.0))
    own = ["slider", "box 0", "box 2"]
    assert states(alone, 100, 1e-2, own) == states(beside, 100, 1e-2, own)


@pytest.mark.parametrize("controlled", [False, True])
def test_a_robot_walks_as_it_does_alone(controlled):
    """Controllers are asked for the whole scene: what they say of a robot is what they would say of it alone."""
    alone, beside = world(), world()
    for scene in (alone, beside):
        robot(scene)
    cubes(beside, 5, at=(FAR, 0.0))
    name = next(iter(alone.articulations))
    options = {}
    if controlled:
        start = alone.articulations[name].v.size
        options["controller"] = lambda t, q, v: {name: np.r_[np.zeros(6), -0.5 * v[-start:][6:]]}
    runs = [states(scene, 60, 4e-3, robot=0, **options) for scene in (alone, beside)]
    assert runs[0] == runs[1]


def belt(scene):
    """A conveyor that stands still, of which the watch over gained energy once took the works for its own."""
    scene.add_box("belt", (1, 1, 0.1), fixed=True, position=(FAR, 0, 0.5))
    scene.set_motion("belt", surface_velocity=(0, 0, 0))


def elastic(scene):
    scene.add_sphere("elastic", 0.1, 1.0, position=(FAR, 0, 0.15), material=nd.Material(restitution=0.5))
    scene.add_box("floor", (1, 1, 0.1), fixed=True, position=(FAR, 0, 0), material=nd.Material(restitution=0.5))


def pendulum(scene):
    model = pin.Model()
    hang(model, 0, "pivot", pin.JointModelRY(), lump(1.0, 1 / 50, (0, 0, -0.2)), (FAR, 0, 5.0))
    scene.add_model("pendulum", model, q=[1.0])


@pytest.mark.parametrize("far", [belt, elastic, pendulum, robot])
@pytest.mark.parametrize("dt", [pytest.param(1e-2, marks=pytest.mark.slow), 4e-3])
def test_a_stack_that_leans_does_so_beside_anything(far, dt):
    """Its contacts add energy in whole steps, so that it takes them in pieces; whether they do is asked of it alone.

    What counts as closed is a length of the scene, by its smallest body, which is one of the robot's feet.
    """
    alone, beside = world(), world()
    for scene in (alone, beside):
        scene.add_sphere("grain", 0.02, 1.0, position=(-FAR, 0, 0.02))
        for k in range(4):
            push = (float(k == 1), 0, 0)
            scene.add_box(f"{k}", (0.2, 0.2, 0.2), 1.0, position=(9 + 0.02 * k, 0, 0.1 + 0.2 * k), linear_velocity=push)
    far(beside)
    own = [f"{k}" for k in range(4)]
    assert states(alone, 40, dt, own) == states(beside, 40, dt, own)


@pytest.mark.parametrize("far", [*(pytest.param(far, marks=pytest.mark.slow) for far in (belt, elastic)), pendulum])
def test_a_disk_keeps_its_energy_beside_anything(far):
    alone, beside = nd.scenes.load("euler_disk")(), nd.scenes.load("euler_disk")()
    far(beside)
    name = alone.free_bodies[0].name
    assert states(alone, 20, 1e-2, [name]) == states(beside, 20, 1e-2, [name])


def test_what_rolls_does_not_feel_how_exactly_others_are_solved():
    """Beside bricks that slide together, whose impulses are less exact: couples go by the error of their own island."""

    def rolling(bricks):
        scene = world()
        axes, spin = (0.1, 0.13, 0.16), (0.1, 2.0, 0.3)
        scene.add_ellipsoid("egg", axes, 1.0, position=(5, 5, 0.16), linear_velocity=(0.3, 0, 0), angular_velocity=spin)
        scene.add_sphere("least", 0.05, 1.0, position=(-5, -5, 3.0))
        for k in range(bricks):
            j, i = (k, 0) if k < 4 else (k - 4, 1) if k < 7 else (k - 7, 2)
            x = (0.31 * j + 0.155 * i, 0.0, 0.1 + 0.2 * i)
            scene.add_box(f"brick {k}", (0.3, 0.2, 0.2), 1.0, position=x, linear_velocity=(0, 0.8, 0))
        return states(scene, 12, 1e-2, ["egg"])

    assert rolling(0) == rolling(9)


@pytest.mark.parametrize(("v", "duration"), [((1.0, 2.0, 0.3), 0.35), ((0.5, 3.0, 1.0), 0.25)], ids=["part", "whole"])
def test_a_swivel_rubs_as_it_does_alone(v, duration):
    """A part of its friction sticks where its spin passes 0: it is split anew only when its island is solved again.

    Whether it slides where the step begins is told by its impulses then, not by those of a first solve.
    """
    model = pin.Model()
    rod = pin.Inertia(1.0, np.array([0.0, 0.0, -0.2]), np.diag([0.02, 0.02, 5e-4]))
    hang(model, 0, "swivel", pin.JointModelSpherical(), rod)
    angles = []
    for eggs in range(2):
        scene = nd.Scene()
        scene.add_halfspace("ground", offset=-1.0)
        scene.add_model("rod", model, q=(0.0, 0.2, 0.0, 0.96**0.5), v=v, friction=[0.05] * 3)
        for _ in range(eggs):
            moves = {"linear_velocity": (0.3, 0, 0), "angular_velocity": (1, 0, 2)}
            scene.add_ellipsoid("egg", (0.3, 0.2, 0.15), 1.0, position=(2, 0, -0.85), **moves)
        angles.append(nd.simulate(scene, duration, dt=5e-3).q[:, -4:])
    np.testing.assert_array_equal(*angles)


@pytest.mark.slow
def test_a_plate_that_shakes_couples_nothing():
    """Bodies on one driven plate, that hop off it and land, are islands of their own; and no shapes overlap."""

    def shake(t):
        return (0.1 * np.cos(7 * t), 0, 0.5 * np.cos(30 * t)), (0, 0, 0.2 * np.sin(5 * t))

    def shaken(others):
        scene = nd.Scene()
        scene.add_box("plate", (4, 4, 0.2), fixed=True, position=(0, 0, -0.1), material=nd.Material(0.5, 0.3))
        scene.set_motion("plate", shake)
        scene.add_sphere("ball", 0.1, 1.0, position=(1, 1, 0.1), material=nd.Material(0.5, 0.3))
        for k in range(others):
            scene.add_box(f"box {k}", (0.2, 0.2, 0.2), 1.0, position=(-1, 0.5 * k - 1, 0.1 + 0.1 * k))
        return scene

    # Two periods of the plate.
    alone, beside = (nd.simulate(shaken(k), 0.42, 5e-3) for k in (0, 2))
    for name in ("position", "quaternion", "linear_velocity", "angular_velocity"):
        one, other = (getattr(t.body("ball"), name).tobytes() for t in (alone, beside))
        assert one == other, name
    assert nd.check(beside).passed


@pytest.mark.slow
@pytest.mark.parametrize("rpm", [600.0, 7200.0])
def test_what_a_fast_blade_hits_flies_as_it_does_alone(rpm):
    """The blade is of no island: what it passes through in a step is hit beside anything else, too."""
    flown = []
    for others in range(3):
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_box("blade", (1.0, 0.05, 0.05), fixed=True)
        scene.set_motion("blade", lambda t: ((0, 0, 0), (0, 0, rpm * 2 * np.pi / 60)))
        scene.add_sphere("ball", 0.05, 0.1, position=(0, 0.4, 0))
        for k in range(others):
            scene.add_sphere(f"other {k}", 0.05, 0.1, position=(5, 5, k))
        flown.append(nd.simulate(scene, 2 / 60, dt=1 / 60).body("ball").linear_velocity)
    # Of the tip 31 m/s or more.
    assert np.abs(flown[0][-1]).max() > 30.0
    np.testing.assert_array_equal(flown[1], flown[0])
    np.testing.assert_array_equal(flown[2], flown[0])


def test_a_belt_carries_what_is_on_it_wherever_it_stands_among_the_bodies():
    """Boxes that come before it and are of other islands: of the ball's own island it is another shape."""

    def carried(before):
        scene = world()
        cubes(scene, before, at=(FAR, 0.0))
        scene.add_box("belt", (4, 1, 0.2), fixed=True, position=(0, 0, 0.1), material=nd.Material(0.5, 0.5))
        scene.set_motion("belt", surface_velocity=(1.0, 0, 0))
        scene.add_sphere("ball", 0.1, 1.0, position=(-1.5, 0, 0.6), material=nd.Material(0.5, 0.5))
        scene.add_sphere("other", 0.1, 1.0, position=(-0.5, 0, 0.5), material=nd.Material(0.5, 0.5))
        return scene

    own = ["ball", "other"]
    alone, beside = (states(carried(count), 120, 5e-3, own) for count in (0, 3))
    assert alone == beside
    trajectory = nd.simulate(carried(3), 0.6, 5e-3)
    assert nd.check(trajectory).passed, nd.check(trajectory)
    assert trajectory.body("ball").linear_velocity[-1, 0] > 0.1  # the belt has taken it along


def test_islands_that_meet_within_a_step_are_made_together():
    """Two balls that fly at each other from far: the one that was struck before, a third, flies on with its speed."""
    scene, m = nd.Scene(gravity=(0, 0, 0)), nd.Material(mu=0.0, restitution=1.0)
    for k, (x, v) in enumerate([(-1.0, 100.0), (0.0, 0.0), (0.25, 0.0), (2.0, -100.0)]):
        scene.add_sphere(f"b{k}", 0.1, 1.0, position=(x, 0, 0), linear_velocity=(v, 0, 0), material=m)
    stepper = nd.Stepper(scene, 5e-2)
    step = stepper.step()
    v = step.v.reshape(-1, 6)[:, 0]
    # 0 strikes 1, which strikes 2, which meets 3: speeds are handed on, and back
    np.testing.assert_allclose(np.sort(v), [-100, 0, 0, 100], rtol=0, atol=1e-9)
    assert step.ledger.kinetic == pytest.approx(1e4, rel=1e-12)
    x = step.q.reshape(-1, 7)[:, 0]
    assert (np.diff(x) >= 0.2 - 1e-9).all()


def test_what_pressed_before_strikes_nothing(monkeypatch):
    """Dominoes that fall over each other turn: their contacts approach a little where a step begins."""
    scene = nd.scenes.setup("domino")
    stepper, approaches, struck = nd.Stepper(scene.scene, **scene.options()), [], []
    found = Islands._striking_nodes

    def seen(self, begin, mid):
        s, c = self.whole, begin.contacts
        u = normal_velocities(s.dynamics, c, begin, mid.surfaces[0])
        fast = (c.gap <= s.gap_tol) & (u < -s.least_penetration / mid.h)
        approaches.append(fast.any())
        pressed = s.last_status(c, begin.warm) > 0
        nodes = found(self, begin, mid)
        struck.append((set(nodes.tolist()), (fast & ~pressed).any()))
        return nodes

    monkeypatch.setattr(Islands, "_striking_nodes", seen)
    monkeypatch.setattr(stepper, "_eventless", None)  # which would make most of the steps
    for _ in range(100):
        stepper.step()
    assert sum(approaches) > 10
    assert all(bool(nodes) == new for nodes, new in struck)


class Counting(nd.solvers.Auto):
    """Counts the solves of large islands to the tolerance."""

    full = 0

    def balanced(self, problem, r0, before):
        """Count, and solve."""
        Counting.full += widest(problem.blocks.arrays, np.empty(problem.nc, np.int64))[0] > DENSE
        return super().balanced(problem, r0, before)


def test_what_strikes_and_is_not_located_is_not_tried_in_full():
    """Where a ball hits a wall of 36 bricks their velocities show that they will meet something: few full solves."""
    scene = nd.scenes.load("wall")(rows=6, columns=6)
    material = nd.Material(mu=0.6)
    scene.add_sphere("ball", 0.15, 16.0, position=(0.64, -0.3, 0.3), linear_velocity=(0, 15, 0), material=material)
    stepper = nd.Stepper(scene, dt=5e-3, solver=Counting(), on_fail="ignore")
    Counting.full = 0
    for _ in range(60):
        stepper.step()
    assert Counting.full <= 10


def test_many_balls_are_not_moved_in_halves():
    """An island of balls too large to locate its impacts takes each step in one move; lifts had made it four."""
    scene, rng, material = nd.Scene(), np.random.default_rng(1), nd.Material(mu=0.5)
    scene.add_halfspace("floor", material=material)
    for k in range(64):
        i, j, level = np.unravel_index(k, (4, 4, 4))
        x = np.array([0.225 * i, 0.225 * j, 0.1 + 0.201 * level]) + np.append(rng.uniform(-0.01, 0.01, 2), 0.0)
        scene.add_sphere(f"ball {k}", 0.1, 4.0, position=x, material=material)
    stepper = nd.Stepper(scene, dt=5e-3, on_fail="ignore")
    for k in range(60):
        duration = stepper.step().contact_duration
        if k >= 40:  # all that stand have collapsed into one island
            assert (duration > 0.0).sum() > 50
            assert ((duration == stepper.dt) | (duration == 0.0)).all()  # 0: impacts


def test_subsystems_that_are_kept_are_bounded_by_their_nodes(monkeypatch):
    """What islands of ever other bodies leave behind takes bounded memory, and changes no bit of the motion."""
    scene = world()
    cubes(scene, count=12, seed=1)
    made, seen = states(scene, 100, 5e-3, [b.name for b in scene.free_bodies]), set()
    stepper = nd.Stepper(scene, 5e-3)
    monkeypatch.setattr(islands, "KEPT", 6)
    part = stepper._islands._part

    def kept(name, nodes):
        out, parts = part(name, nodes), stepper._islands._parts
        seen.add(name)
        assert sum(map(len, parts)) <= max(6, nodes.size)
        assert parts[name] is out is part(name, nodes)
        return out

    monkeypatch.setattr(stepper._islands, "_part", kept)
    for before in made:
        stepper.step()
        i = stepper.get_state().instant
        assert before == b"".join(x.tobytes() for x in (i.position.x, i.position.quaternion, i.v))
    assert sum(map(len, seen)) > 3 * 6
