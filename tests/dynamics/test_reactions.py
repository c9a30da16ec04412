"""Reactions in joints and loops against closed forms, statics and the balance of momentum of each link."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, four_bars, hang, limit, lump, pendulum, rod

import nsdyn as nd
from nsdyn.recording import retrace
from nsdyn.scene import shapes
from nsdyn.scene.articulations import Loop

G = 9.81


def middle(values):
    return 0.5 * (values[1:] + values[:-1])


PLAIN = {"every": 1, "contacts": True}
"""How every step is recorded, with its contacts."""


@pytest.mark.parametrize("rows", [PLAIN, {"every": 5}, {"contacts": False}], ids=str)
@pytest.mark.parametrize("push", [pytest.param((0.0, 0.0, 0.0), marks=pytest.mark.slow), (1.0, 3.0, 0.0)], ids=str)
def test_pendulum(push, rows):
    """Along the rod m g cos θ + m l θ̇² less what pulls its end, across it nothing; second order in what is recorded.

    A push across the plane moves nothing: the hinge takes it, and its moment.
    """
    length, mass, push, every = 0.7, 1.3, np.array(push), rows.get("every", 1)

    def error(dt):
        model = pin.Model()
        point = pin.Inertia(mass, np.array([0, 0, -length]), 1e-12 * np.eye(3))
        joint = hang(model, 0, "hinge", pin.JointModelRY(), point)
        model.addBodyFrame("end", joint, at((0, 0, -length)), 0)
        scene = nd.Scene()
        add(scene, "p", model, q=[1.0], v=[0.5])
        t = nd.simulate(scene, 1.0, dt / every, external_force=lambda *_: {"p/end": push}, **rows)
        joint = t.joint("p/hinge")
        assert joint.reaction_force.shape == (round(1.0 / dt), 3) and np.abs(joint.reaction_force).max() > 15.0
        up = np.column_stack([np.sin(joint.position), 0.0 * joint.position, np.cos(joint.position)])
        tension = mass * G * np.cos(joint.position) + mass * length * joint.velocity**2 - up @ push
        across = push * [0, 1, 0]
        force, torque = tension[:, None] * up - across, np.cross(length * up, across)
        return [
            np.abs(found - middle(known)).max()
            for found, known in ((joint.reaction_force, force), (joint.reaction_torque, torque))
        ]

    coarse, fine = np.array(error(1e-2)), np.array(error(5e-3))
    assert (coarse < (1e-2, 4e-3)).all(), coarse
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.02)


def test_an_arm_that_is_held():
    """Joint k carries the weight of all beyond, at its lever; what holds it is part of the reaction."""
    model = pendulum(3)
    scene = nd.Scene()
    add(scene, "arm", model, q=[np.pi / 2, 0.0, 0.0])
    weight = pin.computeGeneralizedGravity(model, model.createData(), np.array([np.pi / 2, 0.0, 0.0]))
    t = nd.simulate(scene, 0.05, 5e-3, controller=lambda t, q, v: {"arm": weight})
    for k in range(3):
        joint, beyond = t.joint(f"arm/j{k}"), 3 - k
        np.testing.assert_allclose(joint.reaction_force, np.tile([0, 0, beyond * G], (10, 1)), rtol=0, atol=1e-9)
        # Horizontal rods along -x: the weights' moment about the joint is G Σ lever about -y, held by its opposite.
        lever = beyond**2 / 2.0
        np.testing.assert_allclose(joint.reaction_torque, np.tile([0, lever * G, 0], (10, 1)), rtol=0, atol=1e-9)


def test_an_arm_that_is_held_and_pushed():
    """A wrench on the middle rod, of which the motors hold what moves: it acts up to there, its moment at its lever."""
    model, q = pendulum(3), np.array([np.pi / 2, 0.0, 0.0])
    scene = nd.Scene()
    add(scene, "arm", model, q=q)
    push, turn = np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.7, 0.9])
    held = pin.computeGeneralizedGravity(model, model.createData(), q)
    held[:2] -= turn[1] + np.array([push[2], 0.0])  # about y, at (-1, 0, 0) and at the origin of the first two joints
    t = nd.simulate(
        scene, 0.05, 5e-3, controller=lambda *_: {"arm": held}, external_force=lambda *_: {"arm/j1": (push, turn)}
    )
    for k in range(3):
        joint, beyond, on = t.joint(f"arm/j{k}"), 3 - k, k < 2
        force = np.array([0, 0, beyond * G]) - on * push
        moment = np.array([0, beyond**2 / 2.0 * G, 0]) - on * (turn + np.cross([k - 1.0, 0, 0], push))
        np.testing.assert_allclose(joint.reaction_force, np.tile(force, (10, 1)), rtol=0, atol=1e-9)
        np.testing.assert_allclose(joint.reaction_torque, np.tile(moment, (10, 1)), rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 3])
def test_slider_crank(every):
    """Forces in both pins and the loop at the slider, by Newton and Euler for crank and rod by hand."""

    def error(dt):
        model = pin.Model()
        crank = hang(model, 0, "crank", pin.JointModelRY(), rod((0.3, 0, 0), 0.5))
        link = hang(model, crank, "rod", pin.JointModelRY(), rod((0.8, 0, 0), 1.0), (0.3, 0, 0))
        slider = hang(model, 0, "slider", pin.JointModelPX(), lump(2.0, 0.01))
        turn = 0.6
        tilt = -np.arcsin(0.3 * np.sin(turn) / 0.8) - turn
        reach = 0.3 * np.cos(turn) + 0.8 * np.cos(turn + tilt)
        pinned = [Loop("pin", slider, at((0, 0, 0)), link, at((0.8, 0, 0)))]
        scene = nd.Scene()
        add(scene, "m", limit(model), pinned, q=[turn, tilt, reach], v=[0.0, 0.0, 0.0])
        scene.set_motion("m/crank", velocity=5.0)
        t = nd.simulate(scene, 0.4, dt / every, every=every)
        a, b = t.q[:, 0], t.q[:, 0] + t.q[:, 1]

        def along(angle, length):
            return length * np.column_stack([np.cos(angle), 0.0 * angle, -np.sin(angle)])

        def rate(x):
            return np.diff(x, axis=0) / dt

        def spin(angle, w, length):
            return length * np.column_stack([-w * np.sin(angle), 0.0 * angle, -w * np.cos(angle)])

        wa, wb = t.v[:, 0], t.v[:, 0] + t.v[:, 1]
        down = np.array([0, 0, -G])
        slide = 2.0 * rate(t.v[:, 2])
        of_rod = 1.0 * (rate(spin(a, wa, 0.3) + spin(b, wb, 0.4)) - down)
        of_crank = 0.5 * (rate(spin(a, wa, 0.15)) - down)
        pushed, pin_force = t.loop("m/pin").reaction_force, t.joint("m/rod").reaction_force
        used = slice(2, None)  # the drive sets in
        errors = [
            pushed[used, 0] - slide[used],  # the slider's mass times its acceleration
            (pin_force - pushed - of_rod)[used],  # of the rod: its pin, and the slider's opposite
            (t.joint("m/crank").reaction_force - pin_force - of_crank)[used],
            # Euler for the rod about its pin at the crank: the loop's force at its end, weight at its middle.
            (np.cross(middle(along(b, 0.8)), -pushed) + np.cross(middle(along(b, 0.4)), down - rate(spin(a, wa, 0.3))))[
                used, 1
            ]
            - 1.0 / 3.0 * 0.8**2 * rate(wb)[used],
        ]
        size = np.abs(pin_force).max()
        assert np.abs(t.loop("m/pin").reaction_torque).max() < 1e-9 * size and size > 10.0
        return np.array([np.abs(e).max() for e in errors]) / size

    coarse, fine = error(4e-3), error(2e-3)
    assert (coarse < 5e-3).all() and (fine < 0.3 * coarse + 1e-9).all(), (coarse, fine)


@pytest.mark.parametrize("rows", [PLAIN, {"every": 4}, {"contacts": False}], ids=str)
def test_a_box_on_a_platform_that_is_driven(rows):
    """The platform's joint carries both, m (g + a); the box is pushed by its own share."""
    model = pin.Model()
    lift = hang(model, 0, "lift", pin.JointModelPZ(), lump(3.0, 1.0))
    model.addJointFrame(lift)
    scene = nd.Scene()
    scene.add_model("p", model, collisions={"lift": [shapes.box((1, 1, 0.1))]})
    scene.add_box("box", (0.2, 0.2, 0.2), 2.0, position=(0.3, 0, 0.15))
    scene.set_motion("p/lift", velocity=lambda t: 0.5 * t)
    t = nd.simulate(scene, 0.2, 5e-3, **rows)
    joint = t.joint("p/lift")
    carried = np.tile([0, 0, 5.0 * (G + 0.5)], (t.steps - 2, 1))
    np.testing.assert_allclose(joint.reaction_force[2:], carried, rtol=0, atol=1e-6)
    np.testing.assert_allclose(joint.reaction_torque[2:, 1], -0.3 * 2.0 * (G + 0.5), rtol=0, atol=1e-6)


def test_reactions_balance_the_momentum_of_a_robot():
    """A floating robot: what all legs do to the trunk and gravity make its momentum."""
    build = nd.scenes.load("quadruped")
    scene = build()
    t = nd.simulate(scene, 0.4, 5e-3)
    a = scene.articulations["quadruped"]
    model = a.model
    base = np.diff(
        [
            pin.XYZQUATToSE3(q[:7]).rotation @ (v[:3] + np.cross(v[3:6], model.inertias[1].lever))
            for q, v in zip(t.q, t.v, strict=True)
        ],
        axis=0,
    )
    of_trunk = model.inertias[1].mass * (base / t.dt + [0, 0, G])
    hips = [model.names[k] for k in range(1, model.njoints) if model.parents[k] == 1]
    contacts = t.force("quadruped/trunk") if "quadruped/trunk" in t.scene["frames"] else 0.0
    legs = sum(t.joint(f"quadruped/{hip}").reaction_force for hip in hips)
    off = np.abs(of_trunk + legs - contacts).max(axis=1)
    assert np.abs(legs).max() > 50.0
    assert np.median(off) < 1e-2 * np.abs(legs).max()


def test_motion_of_links_in_many_states_is_that_of_pinocchio(rng):
    """Momenta, twists and weights about the world's origin, against its spatial algebra link by link."""
    scene = nd.scenes.load("quadruped")()
    run = nd.simulate(scene, 0.002, dt=1e-3)
    found = retrace.trees(run)
    m = found.mechanisms[0]
    q = np.array([pin.integrate(m.model, found.state(0, 0)[0], rng.normal(size=m.nv)) for _ in range(3)])
    v = rng.normal(size=(3, m.nv))
    momenta, twists, (weights, origins) = m.momenta(q, v), m.twists(q, v), m.weights(q)
    gravity, data = pin.Motion(m.model.gravity.linear, np.zeros(3)), m.model.createData()
    for k in range(3):
        pin.forwardKinematics(m.model, data, q[k], v[k])
        for link, (place, body, twist) in enumerate(zip(data.oMi, m.model.inertias, data.v, strict=True)):
            if not link:
                continue
            for got, known in (
                (momenta[k, link - 1], place.act(body * twist).vector),
                (twists[k, link - 1], place.act(twist).vector),
                (weights[k, link - 1], (place.act(body) * gravity).vector),
                (origins[k, link - 1], place.translation),
            ):
                np.testing.assert_allclose(got, known, rtol=0, atol=1e-13 * max(1.0, np.abs(known).max()))
    assert m.momenta(q[:0], v[:0]).shape == (0, len(m.joints), 6)


def test_redundant_loops_carry_the_weight():
    """All that holds two windows of bars in the ground is their weight and what moves them."""
    model, loops, _ = four_bars(2)
    scene = nd.Scene()
    add(scene, "bars", model, loops=loops)
    t = nd.simulate(scene, 0.02, 2e-3, controller=lambda *_: {"bars": np.zeros(5)})
    feet = t.joint("bars/v0").reaction_force - sum(t.loop(f"bars/foot{k}").reaction_force for k in (1, 2))
    moved = np.diff(t.v[:, 0]) / t.dt  # straight up at rest: nothing moves
    np.testing.assert_allclose(moved, 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(feet, np.tile([0, 0, 5 * G], (10, 1)), rtol=0, atol=1e-9)


def test_forces_of_several_steps_are_their_mean():
    """A quadruped that is pushed from the side while it stands, recorded in every step and every fifth."""
    setup = nd.scenes.setup("quadruped")
    options = setup.options() | {"external_force": lambda t, q, v: {"quadruped/FL_knee": (0.0, 30.0 * (t > 0.05), 0.0)}}
    one = nd.simulate(setup.scene, 0.2, **options)
    five = nd.simulate(setup.scene, 0.2, every=5, **options)
    for name in ("FL_abduction", "FL_knee", "HR_hip"):
        each, mean = (t.joint(f"quadruped/{name}") for t in (one, five))
        known = each.reaction_force.reshape(-1, 5, 3).mean(axis=1)
        # Differences of momenta: round-off of them, and what projections of 1e-8 m do to them over dt.
        np.testing.assert_allclose(mean.reaction_force, known, rtol=0, atol=1e-7)
        known = each.reaction_torque.reshape(-1, 5, 3).mean(axis=1)
        # Its point moves by millimetres at levers of 0.1 m while the forces set in.
        np.testing.assert_allclose(mean.reaction_torque, known, rtol=0, atol=5e-3 * np.abs(known).max())
    pushed = one.columns["links/impulse"][:, 3, :3] / one.dt
    np.testing.assert_allclose(pushed[:, 1], 30.0 * (one.t[1:] > 0.05 + one.dt / 2), rtol=1e-14)


@pytest.mark.slow
def test_wrenches_of_steps_in_pieces(tmp_path):
    """What is recorded of a constant force is the whole of it in every step, of several moves too."""
    push = np.array([1.0, 2.0, 3.0])
    scene = nd.scenes.load("arm_pushes_box")()
    link = "arm/" + scene.articulations["arm"].model.names[2]
    t = nd.simulate(scene, 0.5, 2e-3, external_force=lambda *_: {link: push}, record=tmp_path / "run.h5")
    assert (np.diff(t.columns["pieces/offset"]) > 1).any()
    found = t.columns["links/impulse"]
    assert found.shape == (250, 2, 6) and not found[:, 0].any()
    np.testing.assert_allclose(found[:, 1, :3], np.tile(2e-3 * push, (250, 1)), rtol=1e-12)
    assert np.isfinite(t.joint(link).reaction_force).all()


def test_the_table_of_joints():
    """Rows are states and coordinates of joints, then loops, with the numbers of each."""
    model, loops, _ = four_bars(2)
    scene = nd.Scene()
    add(scene, "bars", model, loops=loops)
    add(scene, "p", pendulum(), q=[1.0])
    t = nd.simulate(scene, 0.02, 2e-3, controller=lambda *_: {"p": np.array([0.3])})
    table = t.table("joints")
    names = [f"bars/{name}" for name in ("v0", "h0", "v1", "h1", "v2")] + ["p/j0", "bars/foot1", "bars/foot2"]
    assert list(table["joint"]) == 11 * names
    assert list(table["step"]) == [k for k in range(11) for _ in names]
    np.testing.assert_array_equal(table["t"], t.t[table["step"]])
    for name in names:
        rows, loop = table[table["joint"] == name], "foot" in name
        one = t.loop(name) if loop else t.joint(name)
        for what in ("force", "torque"):
            found = np.column_stack([rows[f"reaction_{what}_{axis}"] for axis in "xyz"])
            np.testing.assert_array_equal(found, np.vstack([np.full(3, np.nan), getattr(one, f"reaction_{what}")]))
        for what in ("position", "velocity", "torque", "friction", "external", "shift"):
            known = np.full(11, np.nan) if loop else getattr(one, what)
            np.testing.assert_array_equal(rows[what], known if len(known) == 11 else [np.nan, *known])
        if not loop:
            np.testing.assert_array_equal(rows["limit"][1:], one.limit_impulse / 2e-3)
        assert set(rows["unit"]) == {"" if loop else "rad"}
    assert set(t.table("joints", "p/*")["joint"]) == {"p/j0"}
    assert set(t.table("joints", "*foot2")["joint"]) == {"bars/foot2"}
    with pytest.raises(ValueError, match=r"did you mean 'p/j0'\? joints must be one of bars/v0, .*; got 'p/j'"):
        t.table("joints", "p/j")
    robot = nd.simulate(nd.scenes.load("quadruped")(), 0.01, 5e-3)
    table, first = robot.table("joints", "*root_joint"), robot.joint("quadruped/root_joint")
    assert (
        list(table["coordinate"]) == 3 * ["x", "y", "z", "rx", "ry", "rz", "rw"]
        and list(table["unit"][:7]) == ["m"] * 3 + [""] * 4
    )
    np.testing.assert_array_equal(table["position"].reshape(3, 7), first.position)
    np.testing.assert_array_equal(table["velocity"].reshape(3, 7)[:, :6], first.velocity)
    assert np.isnan(table["velocity"].reshape(3, 7)[:, 6]).all()  # seven coordinates have six velocities


def test_what_is_not_recorded_is_nan():
    scene = nd.Scene()
    add(scene, "p", pendulum())
    pushed = nd.simulate(scene, 0.02, 1e-3, external_force=lambda t, q, v: {"p/j0": (1.0, 0, 0)})
    assert np.isfinite(pushed.joint("p/j0").reaction_torque).all()
    with pytest.raises(ValueError, match="loop must be one of none; got 'p/none'"):
        pushed.loop("p/none")
