"""Reactions in joints and loops against closed forms, statics and the balance of momentum of each link."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, at, four_bars, limit, pendulum, rod

import nsdyn as nd
from nsdyn.scene import shapes
from nsdyn.scene.articulations import Loop

G = 9.81


def middle(values):
    return 0.5 * (values[1:] + values[:-1])


def test_pendulum():
    """Along the rod m g cos θ + m l θ̇², across it m g sin θ + m l θ̈; second order in dt."""
    length, mass = 0.7, 1.3

    def error(dt):
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelRY(), at((0, 0, 0)), "hinge")
        point = pin.Inertia(mass, np.array([0, 0, -length]), 1e-12 * np.eye(3))
        model.appendBodyToJoint(joint, point, at((0, 0, 0)))
        scene = nd.Scene()
        add(scene, "p", model, q=[1.0], v=[0.5])
        t = nd.simulate(scene, 1.0, dt)
        joint = t.joint("p/hinge")
        up = np.column_stack([np.sin(joint.position), 0.0 * joint.position, np.cos(joint.position)])
        tension = mass * G * np.cos(joint.position) + mass * length * joint.velocity**2
        assert np.abs(joint.reaction_force).max() > 20.0 and joint.reaction_force.shape == (t.steps, 3)
        free = np.abs(joint.reaction_torque).max()  # a hinge carries none about its axis, nor does a point across
        return np.abs(joint.reaction_force - middle(tension[:, None] * up)).max(), free

    (coarse, turn), (fine, less) = error(1e-2), error(5e-3)
    assert coarse < 1e-2 and turn < 2e-3
    assert coarse / fine == pytest.approx(4.0, rel=0.02) and turn / less == pytest.approx(4.0, rel=0.02)


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


def test_slider_crank():
    """Forces in both pins and the loop at the slider, by Newton and Euler for crank and rod by hand."""

    def error(dt):
        model = pin.Model()
        crank = model.addJoint(0, pin.JointModelRY(), at((0, 0, 0)), "crank")
        model.appendBodyToJoint(crank, rod((0.3, 0, 0), 0.5), at((0, 0, 0)))
        link = model.addJoint(crank, pin.JointModelRY(), at((0.3, 0, 0)), "rod")
        model.appendBodyToJoint(link, rod((0.8, 0, 0), 1.0), at((0, 0, 0)))
        slider = model.addJoint(0, pin.JointModelPX(), at((0, 0, 0)), "slider")
        model.appendBodyToJoint(slider, pin.Inertia(2.0, np.zeros(3), 0.01 * np.eye(3)), at((0, 0, 0)))
        turn = 0.6
        tilt = -np.arcsin(0.3 * np.sin(turn) / 0.8) - turn
        reach = 0.3 * np.cos(turn) + 0.8 * np.cos(turn + tilt)
        pinned = [Loop("pin", slider, at((0, 0, 0)), link, at((0.8, 0, 0)))]
        scene = nd.Scene()
        add(scene, "m", limit(model), pinned, q=[turn, tilt, reach], v=[0.0, 0.0, 0.0])
        scene.set_motion("m/crank", velocity=5.0)
        t = nd.simulate(scene, 0.4, dt)
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


def test_a_box_on_a_platform_that_is_driven():
    """The platform's joint carries both, m (g + a); the box is pushed by its own share."""
    model = pin.Model()
    lift = model.addJoint(0, pin.JointModelPZ(), at((0, 0, 0)), "lift")
    model.addJointFrame(lift)
    model.appendBodyToJoint(lift, pin.Inertia(3.0, np.zeros(3), np.eye(3)), at((0, 0, 0)))
    scene = nd.Scene()
    scene.add_model("p", model, collisions={"lift": [shapes.box((1, 1, 0.1))]})
    scene.add_box("box", (0.2, 0.2, 0.2), 2.0, position=(0.3, 0, 0.15))
    scene.set_motion("p/lift", velocity=lambda t: 0.5 * t)
    t = nd.simulate(scene, 0.2, 5e-3)
    joint = t.joint("p/lift")
    np.testing.assert_allclose(joint.reaction_force[2:], np.tile([0, 0, 5.0 * (G + 0.5)], (38, 1)), rtol=0, atol=1e-6)
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


def test_what_is_not_recorded_is_nan():
    scene = nd.Scene()
    add(scene, "p", pendulum())
    t = nd.simulate(scene, 0.02, 1e-3, every=2)
    assert np.isnan(t.joint("p/j0").reaction_force).all()
    pushed = nd.simulate(scene, 0.02, 1e-3, external_force=lambda t, q, v: {"p/j0": (1.0, 0, 0)})
    assert np.isnan(pushed.joint("p/j0").reaction_torque).all()
    with pytest.raises(ValueError, match="loop must be one of none; got 'p/none'"):
        pushed.loop("p/none")
