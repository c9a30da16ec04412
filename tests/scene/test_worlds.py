"""The world of an MJCF file: shapes that are fixed bodies of the scene, on which robots stand whatever they exclude."""

import numpy as np
import pytest
from robot_texts import scene_of

import nsdyn as nd
from nsdyn.scene import pairs, shapes

LEG = """<body name="{0}_thigh" pos="{1} {2} 0"><joint name="{0}_hip" axis="0 1 0" range="-2 2"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.8"/>
<body name="{0}_calf" pos="0 0 -0.2"><joint name="{0}_knee" axis="0 1 0" range="-2.7 -0.2"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.012" mass="0.2"/>
<geom name="{0}_foot" type="sphere" size="0.02" pos="0 0 -0.2" mass="0.05"/></body></body>"""
LEGS = [
    LEG.format(f"{end}{side}", x, y)
    for end, x in (("F", 0.18), ("R", -0.18))
    for side, y in (("L", 0.12), ("R", -0.12))
]
STANCE = 4 * (0.7, -1.4)
QUAD = f"""<mujoco model="quad"><compiler angle="radian"/> <option timestep="0.002"/>
<default><geom friction="0.8 0.005 0.0001"/><joint damping="0.1" armature="0.01"/></default>
<worldbody><geom name="floor" type="plane" size="5 5 0.1"/>
<body name="trunk" pos="0 0 0.34"><freejoint/><geom name="trunk" type="box" size="0.18 0.1 0.05" mass="6"/>
{"".join(LEGS)}</body></worldbody>
<keyframe><key name="low" qpos="0 0 0.30 1 0 0 0 {" ".join(map(str, STANCE))}"/>
<key name="stand" qpos="0 0 0.33 1 0 0 0 {" ".join(map(str, STANCE))}"/></keyframe></mujoco>"""
WEIGHT = 9.81 * (6.0 + 4 * 1.05)

EVERY = pytest.mark.parametrize("self_collisions", [True, False, "apart"])


@pytest.mark.parametrize(
    "self_collisions", [True, *(pytest.param(k, marks=pytest.mark.slow) for k in (False, "apart"))]
)
def test_a_robot_stands_on_the_floor_of_its_own_file(tmp_path, self_collisions):
    scene = scene_of(tmp_path, QUAD, "m", keyframe="stand", self_collisions=self_collisions)
    none = np.zeros(6)
    gains = {"kp": np.r_[none, np.full(8, 60.0)], "kd": np.r_[none, np.full(8, 2.0)]}
    control = nd.PD(**gains, target=np.r_[none, STANCE])
    trajectory = nd.simulate(scene, 1.0, dt=4e-3, controller=lambda t, q, v: {"m": control})
    # 0.4 m of leg at 0.7 rad and a foot of 0.02 m, less 8 mm by which the knees give way.
    assert trajectory.q[-1, 2] == pytest.approx(0.4 * np.cos(0.7) + 0.02 - 0.008, abs=1e-3)
    assert trajectory.force("m")[-1, 2] == pytest.approx(WEIGHT, rel=1e-3)
    np.testing.assert_array_equal(trajectory.force("m/floor"), -trajectory.force("m"))
    np.testing.assert_array_equal(trajectory.pair("m/floor", "m").force, trajectory.force("m"))
    table = trajectory.contacts(-1)
    assert {*table.body1, *table.body2} == {"m/floor", *(f"m/{leg}_calf" for leg in ("FL", "FR", "RL", "RR"))}
    assert nd.check(trajectory).passed


@EVERY
def test_feet_in_the_floor_are_told(tmp_path, self_collisions):
    scene = scene_of(tmp_path, QUAD, "m", keyframe="low", self_collisions=self_collisions)
    told = r"^'m/floor' and 'm/.._foot' overlap at the start by 0\.0259 m, more than [^;]*\)$"
    with pytest.raises(ValueError, match=told):  # and nothing that would keep them apart
        nd.Stepper(scene)


KITCHEN = """<mujoco><worldbody>
<geom name="wall" type="plane" size="1 1 1" pos="1 0 0.5" zaxis="-1 0 1"/>
<geom name="jar" type="box" size=".1 .1 .1" pos="0 5 .1"/>
<body name="table" pos="0 0 0.4"><geom type="box" size=".5 .5 .05"/><geom type="sphere" size=".05" pos="-.4 0 .1"/>
<body name="stand" pos="0 0 0.05"><geom name="stand" type="box" size=".05 .05 .05" pos=".3 .3 .05"/></body></body>
<body name="base" pos="0 0 0.55"><geom type="box" size=".1 .1 .1"/>
<body name="arm"><joint name="jar" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 .05 .3 0 .05" size=".03"/></body></body>
<body name="ball" pos=".3 0 {height}"><freejoint/><geom size=".03"/></body></worldbody></mujoco>"""


def kitchen(tmp_path, height="0.6601", **keywords):
    return scene_of(tmp_path, KITCHEN.format(height=height), "m", **keywords)


def names(scene):
    """Geoms of a scene by their names."""
    return {g.name: k for k, g in enumerate(scene.geoms())}


def test_what_no_joint_moves_are_fixed_bodies(tmp_path):
    """All but the base of an arm, which is a link; a geom that has the name of a joint goes by its number."""
    scene = kitchen(tmp_path, position=(0, 0, 1), quaternion=(0, 0, np.sqrt(0.5), np.sqrt(0.5)))
    assert list(scene.bodies) == ["m/wall", "m/world_1", "m/table_0", "m/table_1", "m/stand"]
    assert all(body.fixed for body in scene.bodies.values())
    assert [link.name for link in scene.articulations["m"].links] == ["base_0", "arm_0", "ball_0"]
    np.testing.assert_allclose(scene.bodies["m/table_1"].position, (0, -0.4, 1.5), rtol=0, atol=1e-15)
    wall = scene.geoms()[0]
    assert wall.shape.kind == shapes.HALFSPACE and wall.body == wall.link == "m/wall"
    # In axes of the world, as the page draws it: -x + z ≥ -0.5, turned and lifted.
    np.testing.assert_allclose(wall.shape.size, np.array((0, -1, 1)) * np.sqrt(0.5), rtol=0, atol=1e-15)
    assert wall.shape.offset == pytest.approx(0.5 * np.sqrt(0.5), rel=1e-14)
    np.testing.assert_array_equal(np.c_[wall.placement_R, wall.placement_t], np.eye(3, 4))


def test_trees_of_one_file_touch_each_other(tmp_path):
    """Without collisions of its own an arm does not touch its base, but a ball lies on it."""
    scene = kitchen(tmp_path, self_collisions=False)
    own = {frozenset(pair) for pair in scene.articulations["m"].excluded}
    assert own == {frozenset((0, 1))}, "base and arm"
    trajectory = nd.simulate(scene, 0.1, dt=1e-3)
    assert trajectory.force("m/ball")[-1, 2] == pytest.approx(9.81 * 1000 * 4 / 3 * np.pi * 0.03**3, rel=1e-6)
    with pytest.raises(ValueError, match="'m/arm_0' and 'm/ball_0' overlap"):
        nd.Stepper(kitchen(tmp_path, height="0.61", self_collisions=False))


def test_apart_names_what_it_leaves_out(tmp_path):
    """Of one tree: an arm in its base, which MuJoCo lets touch each other, but not a ball in the arm."""
    told = r"^'m' leaves out: contact of 'base_0' and 'arm_0' \(0\.08 m deep\), which overlap at the start$"
    with pytest.warns(UserWarning, match=told):
        scene = kitchen(tmp_path, height="0.61", self_collisions="apart")
    with pytest.raises(ValueError, match="'m/arm_0' and 'm/ball_0' overlap"):
        nd.Stepper(scene)


@pytest.mark.parametrize(
    ("old", "new", "apart"),
    [
        ("", "", set()),
        ('name="floor"', 'name="floor" contype="2" conaffinity="4"', {"trunk", "FL_foot", "RR_foot", "RL_calf_0"}),
        ("<keyframe>", '<contact><exclude body1="world" body2="trunk"/></contact><keyframe>', {"trunk"}),
        (
            "<keyframe>",
            '<contact><exclude body1="FL_calf" body2="world"/></contact><keyframe>',
            {"FL_foot", "FL_calf_0"},
        ),
    ],
)
def test_masks_and_exclusions_hold_between_the_world_and_links(tmp_path, old, new, apart):
    scene = scene_of(tmp_path, QUAD.replace(old, new, 1), "m", keyframe="stand")
    at, excluded = names(scene), pairs.excluded(scene, scene.geoms())
    kept = {name for name, k in at.items() if {(k, at["m/floor"]), (at["m/floor"], k)} & excluded}
    assert kept >= {f"m/{name}" for name in apart} and (apart or not kept)
    assert len(kept) == {0: 0, 1: 1, 2: 2, 4: 13}[len(apart)]


def test_masks_let_a_ball_through_the_floor_of_its_file(tmp_path):
    floor = '<geom name="floor" type="plane" size="0 0 1" {}/>'
    text = f'<mujoco><worldbody>{floor}<body pos="0 0 0.05"><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    masked = scene_of(tmp_path, text.format('contype="2" conaffinity="4"'), "m")
    assert not nd.simulate(masked, 0.01, dt=1e-3).contacts(-1).gap.size
    with pytest.raises(ValueError, match=r"'m/floor' and 'm/body0_0' overlap at the start by 0\.05 m"):
        nd.Stepper(scene_of(tmp_path, text.format(""), "m"))


def test_fixed_bodies_of_a_file_are_like_any_other(tmp_path):
    """Their material, coefficients of a pair and shapes are the user's."""
    given = {"keyframe": "stand", "material": {"world": nd.Material(0.1, 0.0), "trunk": nd.Material(0.4, 0.0)}}
    scene = scene_of(tmp_path, QUAD, "m", **given)
    assert scene.bodies["m/floor"].material.mu == 0.1
    scene.set_pair("m/floor", "m", mu=0.7)
    scene.set_pair("m/floor", "m/FL_calf", mu=0.3)
    at, mu = names(scene), pairs.pair_material(scene, scene.geoms())
    floor = np.array([at["m/floor"]])
    assert [mu(floor, np.array([at[f"m/{leg}_foot"]]))[0][0] for leg in ("FL", "FR")] == [0.3, 0.7]
    for collisions in (False, {"world": []}):
        assert not scene_of(tmp_path, QUAD, "m", keyframe="stand", collisions=collisions).bodies
    with pytest.raises(ValueError, match=r"did you mean 'm/floor'\? body must be one of .*; got 'm/flor'"):
        scene.set_pair("m/flor", "m", mu=0.1)


def test_files_with_a_world_alone_are_scenery(tmp_path):
    text = '<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/></worldbody></mujoco>'
    scene = scene_of(tmp_path, text, "m")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1))
    scene.set_motion("m/floor", surface_velocity=(1.0, 0, 0))
    trajectory = nd.simulate(scene, 0.05, dt=1e-2)
    np.testing.assert_allclose(trajectory.force("ball"), np.tile((0.5 * 9.81, 0, 9.81), (5, 1)), rtol=1e-9, atol=1e-9)
