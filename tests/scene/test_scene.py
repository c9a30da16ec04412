"""What a scene accepts, and the words with which it refuses the rest."""

import copy
import math
import pickle

import numpy as np
import pytest

import nsdyn as nd

GOOD = {"size": (0.2, 0.2, 0.2), "mass": 1.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mass": -1.0}, "mass of 'b' must be positive"),
        ({"mass": 0.0}, "mass of 'b' must be positive"),
        ({"mass": float("nan")}, "mass of 'b' must be finite"),
        ({"mass": "heavy"}, "mass of 'b' must be a number"),
        ({"mass": True}, "mass of 'b' must be a number, got True"),
        ({"mass": None}, "mass of 'b' is needed"),
        ({"size": (0.2, -0.2, 0.2)}, "size"),
        ({"size": (0.2, float("nan"), 0.2)}, "size"),
        ({"size": (0.2, 0.2)}, "size"),
        ({"position": (0, 0)}, "position of 'b' must be 3 numbers"),
        ({"position": (0, 0, float("inf"))}, "position of 'b' must be finite"),
        ({"quaternion": (1, 0, 0, 1)}, "quaternion of 'b' must be a unit quaternion x y z w"),
        ({"quaternion": (0, 0, 0, 1.00001)}, "unit quaternion"),
        ({"linear_velocity": (1, 2)}, "linear_velocity of 'b'"),
        ({"material": 0.5}, "material of 'b' must be a nsdyn.Material"),
        ({"inertia": np.diag([1.0, 1.0, 3.0])}, "triangle inequality"),
        ({"inertia": np.diag([1.0, 1.0, -1.0])}, "positive definite"),
        ({"inertia": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, "symmetric"),
        ({"inertia": {"xx": 1.0}}, r"inertia of 'b' must be a finite 3 x 3 matrix, got \{'xx': 1.0\}"),
        ({"fixed": "no"}, "fixed of 'b' must be True or False, got 'no'"),
        ({"fixed": True, "linear_velocity": (1, 0, 0)}, "'b' is fixed"),
        ({"colour": (2, 0, 0)}, "colour of 'b'"),
        ({"colour": "red"}, r"colour of 'b' must be 3 or 4 numbers in \[0, 1\], got 'red'"),
        ({"friction": 0.5}, "keyword must be one of .*; got 'friction'"),
    ],
)
def test_bad_box(change, words):
    scene = nd.Scene()
    with pytest.raises(ValueError, match=words):
        scene.add_box("b", **GOOD | change)
    assert not scene.bodies, "a refused body leaves the scene as it was"


def test_a_shape_is_one():
    with pytest.raises(ValueError, match=r"shape of 'b' must be one of nsdyn.scene.shapes, got 0.1"):
        nd.Scene().add_shape("b", 0.1, 1.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"mu": -0.1}, "mu must not be negative"),
        ({"mu": float("nan")}, "mu must be finite"),
        ({"restitution": 1.1}, r"restitution must lie in \[0, 1\]"),
        ({"restitution": -0.1}, r"restitution must lie in \[0, 1\]"),
    ],
)
def test_bad_material(arguments, words):
    with pytest.raises(ValueError, match=words):
        nd.Material(**arguments)


def test_numbers_are_no_text():
    with pytest.raises(ValueError, match=r"mu must be a number, got '0\.5'"):
        nd.Material(mu="0.5")
    with pytest.raises(ValueError, match="restitution must be a number, got '1'"):
        nd.Material(restitution="1")


def test_arguments_say_what_was_meant():
    with pytest.raises(
        ValueError, match=r"did you mean 'position'\? keyword must be one of angular_velocity, .*; got 'postion'"
    ):
        nd.Scene().add_box("a", (1, 1, 1), 1.0, postion=(0, 0, 0))


def test_bad_scene():
    with pytest.raises(ValueError, match="gravity must be 3 numbers"):
        nd.Scene(gravity=(0, 9.81))
    scene = nd.Scene()
    for wrong in ((0, 9.81), (0, 0, np.nan), "down"):
        with pytest.raises(ValueError, match="gravity must be"):
            scene.gravity = wrong
    scene.gravity = (0, 0, -1)
    assert scene.describe()["gravity"] == [0, 0, -1]
    with pytest.raises(ValueError, match="friction_rule must be one of"):
        nd.Scene(friction_rule="product")
    for name in (3, "a\0b", "\ud800"):  # which no recording can be saved with, and loaded
        with pytest.raises(ValueError, match="name must be a text of Unicode without NUL"):
            nd.Scene(name=name)
        with pytest.raises(ValueError, match="name must be a text of Unicode without NUL"):
            nd.Scene().add_sphere(name, 0.1, 1.0)
    scene = nd.Scene()
    scene.add_box("b", **GOOD)
    with pytest.raises(ValueError, match="name must be unique"):
        scene.add_sphere("b", 0.1, 1.0)
    with pytest.raises(ValueError, match="body must be one of b; got 'c'"):
        scene.set_pair("b", "c", mu=0.1)
    with pytest.raises(ValueError, match="mu must not be negative"):
        scene.set_pair("b", "b", mu=-0.1)
    with pytest.raises(ValueError, match="'b' and itself never touches"):
        scene.set_pair("b", "b", mu=0.1)
    with pytest.raises(ValueError, match="the pair of 'b' and 'b' needs mu or restitution"):
        scene.set_pair("b", "b")
    assert not scene.pairs
    with pytest.raises(ValueError, match="name must be a text of Unicode without NUL, got None"):
        scene.set_motion(None, velocity=(0, 0, 1))
    with pytest.raises(ValueError, match=r"path must be a path, got 'a\\x00b'"):
        scene.add_mesh("m", "a\0b", 1.0)
    with pytest.raises(ValueError, match="path must be a path, got 3"):
        scene.add_mesh("m", 3, 1.0)
    with pytest.raises(ValueError, match="must be a file in URDF"):
        scene.add_urdf("arm", "nowhere.urdf")


def test_unknown_named_scene():
    with pytest.raises(ValueError, match=r"did you mean 'stack'\? scene must be one of stack, .*; got 'stak'"):
        nd.scenes.load("stak")
    with pytest.raises(
        ValueError, match=r"did you mean 'height'\? parameter of scene stack must be one of .*; got 'heigt'"
    ):
        nd.scenes.setup("stack", heigt=3)


@pytest.mark.parametrize("spin", [-2.0, 0.0, 3.0])
def test_the_end_of_the_rod_moves_as_it_is_told(spin):
    """And its upper end, the tip, as a length of 2 m that turns by `spin` from the ground has it."""
    angle, slip, fall = 0.8, -1.5, 0.25
    rod = nd.scenes.load("rod")(angle=math.degrees(angle), slip=slip, fall=fall, spin=spin, length=2.0).bodies["rod"]
    along = np.array([math.cos(angle), 0.0, math.sin(angle)])
    end, tip = (rod.linear_velocity + np.cross(rod.angular_velocity, side * along) for side in (-1.0, 1.0))
    np.testing.assert_allclose(end, (slip, 0.0, -fall), rtol=0.0, atol=1e-15)
    turned = 2.0 * spin * np.array([-math.sin(angle), 0.0, math.cos(angle)])
    np.testing.assert_allclose(tip - end, turned, rtol=0.0, atol=1e-14)


def test_close_quaternion_is_normalised():
    scene = nd.Scene()
    scene.add_box("b", **GOOD, quaternion=(0, 0, 0, 1 + 5e-7))
    assert np.linalg.norm(scene.bodies["b"].quaternion) == 1.0


@pytest.mark.parametrize(
    ("rule", "mu"),
    [
        ("geometric_mean", 0.4),
        ("average", 0.5),
        ("min", 0.2),
        ("max", 0.8),
        ("multiply", 0.16),
        ("harmonic_mean", 0.32),
    ],
)
def test_combination_rules(rule, mu):
    scene = nd.Scene(friction_rule=rule)
    scene.add_halfspace("ground", material=nd.Material(0.2, 0.1))
    scene.add_box("a", **GOOD, position=(0, 0, 0.1), material=nd.Material(0.8, 0.3))
    contacts = nd.Stepper(scene).step().contacts
    np.testing.assert_allclose(contacts.mu, mu, rtol=1e-15)
    np.testing.assert_allclose(contacts.restitution, 0.3)


def test_a_pair_beats_the_rule():
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(0.2))
    scene.add_box("a", **GOOD, position=(0, 0, 0.1))
    scene.add_box("b", **GOOD, position=(1, 0, 0.1))
    scene.set_pair("ground", "b", mu=0.07)
    contacts = nd.simulate(scene, 1e-3).contacts(1)
    mu = {name: m for name, m in zip(contacts.body2, contacts.mu, strict=True)}
    assert mu["b"] == 0.07 and mu["a"] == pytest.approx(np.sqrt(0.2 * 0.5))


def test_convex_stays_where_its_vertices_are():
    corners = np.array([(x, y, z) for x in (1, 1.2) for y in (2, 2.2) for z in (0, 0.2)])
    scene = nd.Scene()
    scene.add_convex("c", corners, mass=1.0)
    np.testing.assert_allclose(scene.bodies["c"].position, (1.1, 2.1, 0.1), rtol=0, atol=1e-15)
    # The inertia of a cube, m a²/6.
    np.testing.assert_allclose(scene.bodies["c"].inertia, np.eye(3) * 0.04 / 6, rtol=0, atol=1e-15)


def test_overlap_at_the_start():
    def scene(depth):
        out = nd.Scene()
        out.add_halfspace("ground")
        out.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1 - depth))
        return out

    with pytest.raises(ValueError, match=r"'ground' and 'box' overlap at the start by 0\.05 m"):
        nd.Stepper(scene(0.05))
    with pytest.warns(UserWarning, match=r"'ground' and 'box' overlap at the start by 0\.0005 m"):
        stepper = nd.Stepper(scene(0.0005))
    step = stepper.step()
    # Moved out at once, without any velocity.
    assert stepper.get_state().instant.position.x[0, 2] == pytest.approx(0.1, abs=1e-9)
    assert np.abs(step.v).max() < 1e-9
    nd.Stepper(scene(1e-10))


def stacked(depth):
    """Two boxes of 0.2 m, each so deep in what is below it."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    for k in range(2):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1 + 0.2 * k - (k + 1) * depth))
    return scene


def test_how_deep_a_scene_may_start():
    with pytest.raises(ValueError, match=r"more than 1% of the smaller one's radius \(0\.1 m\)"):
        nd.Stepper(stacked(2e-3), 1e-2)
    with pytest.warns(UserWarning, match="the first step moves them apart"):
        nd.Stepper(stacked(2e-3), 1e-2, overlap=0.05)
    with pytest.raises(ValueError, match="more than 0% of the smaller"):
        nd.Stepper(stacked(1e-6), 1e-2, overlap=0.0)
    for wrong in (-0.1, 1.5, float("nan"), True, "much"):
        with pytest.raises(ValueError, match="overlap must be a fraction"):
            nd.Stepper(stacked(0.0), 1e-2, overlap=wrong)
    with pytest.raises(ValueError, match="lift must be True or False"):
        nd.Stepper(stacked(0.0), 1e-2, lift="yes")


def test_what_overlaps_at_the_start_is_lifted(recwarn):
    """Both boxes rise to where they touch, and neither gains any speed by it."""
    trajectory = nd.simulate(stacked(5e-4), 0.1, dt=1e-2, lift=True)
    np.testing.assert_allclose(trajectory.body("box0").position[0], (0, 0, 0.1), rtol=0, atol=1e-9)
    np.testing.assert_allclose(trajectory.body("box1").position[0], (0, 0, 0.3), rtol=0, atol=1e-9)
    assert not recwarn.list and not trajectory.v[0].any()
    assert abs(trajectory.energy.projection).max() < 1e-12
    assert nd.check(trajectory).passed
    squeezed = stacked(5e-4)
    squeezed.add_box("lid", (1, 1, 0.1), fixed=True, position=(0, 0, 0.45 - 2e-3))
    with pytest.raises(ValueError, match=r"overlap at the start by .*nothing moves them apart: they are squeezed"):
        nd.Stepper(squeezed, 1e-2, overlap=0.05, lift=True)


def test_centre_of_mass_elsewhere_than_the_centroid():
    """A ball with a low centre of mass stands up; its contact is one radius below its centre, wherever that is."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    J = 0.4 * 0.1**2 * np.eye(3)
    tilt = np.array([np.sin(0.2), 0, 0, np.cos(0.2)])  # 0.4 rad about x
    low = np.array([0, 0.02 * np.sin(0.4), -0.02 * np.cos(0.4)])
    scene.add_sphere("b", 0.1, 1.0, com=(0, 0, -0.02), inertia=J, position=low + np.array([0, 0, 0.1]), quaternion=tilt)
    stepper = nd.Stepper(scene)
    step = stepper.step()
    np.testing.assert_allclose(step.contacts.point[0], (0, 0, 0), rtol=0, atol=1e-9)
    # M at the contact is J + m r²: w' = -m g d sin(tilt) / M about x, with r from the contact to the centre of mass.
    r = np.array([0, 0, 0.1]) + low
    expected = -9.81 * 0.02 * np.sin(0.4) / (J[0, 0] + r @ r) * 1e-3
    assert step.v[3] == pytest.approx(expected, rel=1e-4)
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    scene.add_convex("c", corners, 1.0, com=(0.1, 0, 0), inertia=np.eye(3), quaternion=(0, 0, 1, 0))
    np.testing.assert_allclose(scene.bodies["c"].position, (-0.6, -0.5, 0.5), rtol=0, atol=1e-15)


def test_bad_centre_of_mass():
    scene = nd.Scene()
    with pytest.raises(ValueError, match="com of 'b' must be 3 numbers"):
        scene.add_sphere("b", 0.1, 1.0, com=(0, 0))
    with pytest.raises(ValueError, match="inertia of 'b' is needed"):
        scene.add_sphere("b", 0.1, 1.0, com=(0, 0, 0.01))
    with pytest.raises(ValueError, match="'b' is fixed, so its com has no meaning"):
        scene.add_sphere("b", 0.1, fixed=True, com=(0, 0, 0.01))
    with pytest.raises(ValueError, match=r"'b' is fixed, so its mass has no meaning, got 1\.0"):
        scene.add_sphere("b", 0.1, 1.0, fixed=True)


@pytest.mark.parametrize("ground", [False, True])
def test_a_scene_in_which_nothing_moves_says_so(ground):
    scene = nd.Scene()
    if ground:
        scene.add_halfspace("ground")
    with pytest.warns(UserWarning, match="the scene has nothing that moves"):
        nd.Stepper(scene)


def test_penetration_is_no_negative_zero():
    """Of contacts that are closed exactly."""
    run = nd.simulate(nd.scenes.load("slide")(), 0.02, dt=0.01)
    run.columns["contacts/gap"][:] = 0.0
    assert str(run.worst()["penetration"]) == "0.0"


def test_a_scene_can_be_copied_after_a_run():
    """Coal does not read half-spaces back once it knows their infinite boxes."""
    scene = nd.scenes.load("slide")()
    run = nd.simulate(scene, 0.05, dt=1e-2)
    for made in (copy.deepcopy(scene), pickle.loads(pickle.dumps(scene))):
        np.testing.assert_array_equal(nd.simulate(made, 0.05, dt=1e-2).q, run.q)
