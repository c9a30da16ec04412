"""What robots look like: visual shapes of URDF, MJCF and SDF, their meshes, colours and what a recording keeps."""

import fuzz
import numpy as np
import pytest

import nsdyn as nd
from nsdyn.recording import schema
from nsdyn.scene import meshes, simplified, visuals
from nsdyn.scene.visuals import MeshFile
from nsdyn.tools.array_text import from_text, to_text

URDF = """<robot name="r"><material name="dark"><color rgba="0.1 0.2 0.3 1"/></material>
<link name="base"><visual><origin xyz="0 0 1"/><geometry><box size="1 2 3"/></geometry><material name="dark"/></visual>
  <visual><geometry><mesh filename="lost.stl"/></geometry></visual>
  <visual><geometry><mesh filename="box.glb"/></geometry></visual></link>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><origin xyz="0 0.5 0" rpy="0 0 1"/><geometry><mesh filename="box.stl" scale="1 -2 1"/></geometry></visual>
  <visual><geometry><mesh filename="box.stl"/></geometry><material><color rgba="1 0 0 .5"/></material></visual></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
  <limit lower="-1" upper="1" effort="0" velocity="0"/></joint></robot>"""

MJCF = """<mujoco><compiler angle="radian" meshdir="."/><default><default class="seen">
<geom group="2" contype="0" conaffinity="0" type="mesh" mesh="box" mass="0"/></default></default>
<asset><mesh name="box" file="box.stl" scale="1 2 1"/><material name="red" rgba="1 0 0 1"/></asset>
<worldbody><geom name="floor" type="plane" size="1 1 1" rgba="0 1 0 1"/><geom name="sign" class="seen"/>
<body name="b" pos="0 0 1"><freejoint/><geom name="body" type="box" size=".1 .1 .1" group="3" mass="2"/>
  <geom class="seen" pos="0 0 .5" euler="0 0 1.5707963267948966" material="red"/>
  <geom type="sphere" size=".1" rgba="1 1 1 0" contype="0" conaffinity="0" mass="0"/></body></worldbody></mujoco>"""

SDF = """<sdf version="1.9"><model name="m"><link name="b"><visual name="v"><pose>0 0 1 0 0 0</pose>
<geometry><mesh><uri>box.stl</uri><scale>1 2 1</scale></mesh></geometry>
<material><diffuse>0.5 0.25 0 1</diffuse></material></visual>
<visual name="w"><geometry><sphere><radius>0.1</radius></sphere></geometry></visual></link></model></sdf>"""

PAINTED = (
    '<library_effects><effect id="e"><profile_COMMON><technique><phong><diffuse><color>0 0.5 1 1</color></diffuse>'
    "</phong></technique></profile_COMMON></effect></library_effects><library_materials>"
    '<material id="m"><instance_effect url="#e"/></material></library_materials><library_visual_scenes>'
)
BOUND = (
    '<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="s" target="#m"/>'
    "</technique_common></bind_material></instance_geometry>"
)


@pytest.fixture
def folder(tmp_path):
    """Robots and the mesh that they show."""
    (tmp_path / "box.stl").write_bytes(fuzz.binary_stl())
    (tmp_path / "box.glb").write_bytes(b"glTF")
    for name, text in (("r.urdf", URDF), ("r.xml", MJCF), ("r.sdf", SDF)):
        (tmp_path / name).write_text(text)
    return tmp_path


def robot(folder):
    scene = nd.Scene()
    scene.add_urdf("r", folder / "r.urdf", position=(0, 0, 10))
    return scene


def corners(described, k):
    """Corners of a visual mesh in the frame of its joint."""
    visual = described["visuals"][k]
    x = from_text(described["meshes"][visual["mesh"]]["vertices"], "<f4", 3)
    return x @ np.array(visual["placement"])[:3, :3].T + np.array(visual["placement"])[:3, 3]


def test_visuals_of_urdf(folder):
    a = robot(folder).articulations["r"]
    box, mirrored, plain = a.visuals
    assert (box.body, box.joint, box.shape.name, box.colour) == ("base", 0, "box", (0.1, 0.2, 0.3, 1.0))
    np.testing.assert_array_equal(box.placement.translation, (0, 0, 11))  # the world's has moved with the robot
    assert mirrored.shape == MeshFile(folder / "box.stl", (1.0, -2.0, 1.0)) and mirrored.colour is None
    np.testing.assert_array_equal(mirrored.placement.translation, (0, 0.5, 0))
    assert plain.joint == 1 and plain.colour == (1.0, 0.0, 0.0, 0.5)
    lost, other = a.unused
    assert lost.startswith("visual of link 'base': mesh 'lost.stl' was not found in")
    assert other == "visual of link 'base': box.glb is not in one of .stl, .obj, .ply, .dae"


def test_a_recording_has_meshes_once_and_in_place(folder):
    described = robot(folder).describe()
    assert described["frames"] == ["r/j"]  # a link without a collision shape moves too
    base, first, second = described["visuals"]
    assert (base["frame"], first["frame"], base["link"], first["link"]) == (-1, 0, "r/base", "r/arm")
    assert first["mesh"] == second["mesh"] == 0 and len(described["meshes"]) == 1
    exact = meshes.read(folder / "box.stl").vertices
    c, s = np.cos(1.0), np.sin(1.0)
    turned = exact * (1, -2, 1) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + (0, 0.5, 0)
    for k, places in ((1, turned), (2, exact)):
        # Corners are rounded to less than 2^-14 of the size.
        assert np.abs(corners(described, k)[:, None] - places[None]).sum(axis=2).min(axis=1).max() < 1e-4
        assert np.abs(corners(described, k)[:, None] - places[None]).sum(axis=2).min(axis=0).max() < 1e-4
    np.testing.assert_allclose(first["size"], np.abs(exact * (1, -2, 1)).max(axis=0), rtol=0, atol=1e-4)
    triangles = from_text(described["meshes"][0]["triangles"], "<u4", 3)
    assert len(triangles) == 12 and len(np.unique(triangles)) == 8  # an STL has 36


def test_visuals_of_mjcf(folder):
    """As MuJoCo shows them: groups 0 to 2, colours of materials; a visual mesh has no mass."""
    scene = nd.Scene()
    scene.add_mjcf("r", folder / "r.xml")
    a = scene.articulations["r"]
    assert [link.name for link in a.links] == ["body"]
    assert a.model.inertias[1].mass == pytest.approx(2.0, rel=1e-15)
    sign, seen = a.visuals
    assert (sign.body, sign.joint, sign.colour) == ("world", 0, None)
    assert (seen.body, seen.joint, seen.colour) == ("b", 1, (1.0, 0.0, 0.0, 1.0))
    assert seen.shape == sign.shape == MeshFile(folder / "box.stl", (1.0, 2.0, 1.0))
    np.testing.assert_allclose(seen.placement.rotation @ (1, 0, 0), (0, 1, 0), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(seen.placement.translation, (0, 0, 0.5))
    assert scene.bodies["r/floor"].colour == (0.0, 1.0, 0.0, 1.0)
    assert a.report == ()


def test_shapes_alone_are_no_visuals(folder):
    """A file of collision shapes without colours is shown as before, each link in a colour."""
    text = '<mujoco><worldbody><body name="b"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    for given, count in ((text, 0), (text.replace("size", 'rgba="1 0 0 1" size'), 1)):
        (folder / "s.xml").write_text(given)
        scene = nd.Scene()
        scene.add_mjcf("r", folder / "s.xml")
        assert len(scene.articulations["r"].visuals) == count
        assert ("visuals" in scene.describe()) == bool(count)


def test_visuals_of_sdf(folder):
    scene = nd.Scene()
    scene.add_sdf("r", folder / "r.sdf")
    mesh, ball = scene.articulations["r"].visuals
    assert mesh.shape == MeshFile(folder / "box.stl", (1.0, 2.0, 1.0)) and mesh.colour == (0.5, 0.25, 0.0, 1.0)
    np.testing.assert_array_equal(mesh.placement.translation, (0, 0, 1))
    assert (ball.shape.name, ball.colour) == ("sphere", None)


def test_colours_of_collada(folder):
    """Those of its materials, unless the robot's file has another."""
    text = (
        fuzz.dae().decode().replace("<library_visual_scenes>", PAINTED).replace("<triangles", '<triangles material="s"')
    )
    (folder / "box.dae").write_text(text.replace('<instance_geometry url="#g"/>', BOUND))
    (folder / "r.urdf").write_text(URDF.replace("box.stl", "box.dae"))
    colours = [visual["colour"] for visual in robot(folder).describe()["visuals"]]
    assert colours == [[0.1, 0.2, 0.3, 1.0], [0.0, 0.5, 1.0, 1.0], [1.0, 0.0, 0.0, 0.5]]
    assert np.isnan(meshes.read(folder / "box.dae").colours).sum() == 0


def test_what_cannot_be_read_is_named(folder, monkeypatch):
    scene = robot(folder)
    (folder / "box.stl").write_bytes(b"solid none")
    with pytest.warns(UserWarning, match=r"a visual mesh is not shown: path: .*box\.stl could not be read"):
        assert len(scene.describe()["visuals"]) == 1
    (folder / "box.stl").write_bytes(fuzz.binary_stl() + bytes(1))
    monkeypatch.setattr(visuals, "LARGEST", 500)
    with pytest.warns(UserWarning, match=r"a visual mesh is not shown: .*box\.stl has 0 MB, more than 0: simplify it"):
        scene.describe()


def ball(n):
    """Sphere of 2 n² triangles that share no corners."""
    u, v = (x.ravel() for x in np.meshgrid(np.arange(n), np.arange(n)))
    square = np.stack([(u, v), (u + 1, v), (u + 1, v + 1), (u, v), (u + 1, v + 1), (u, v + 1)]).transpose(2, 0, 1)
    theta, phi = np.pi * square[..., 0] / n, 2 * np.pi * square[..., 1] / n
    x = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1).reshape(-1, 3)
    return meshes.Surface(x, np.arange(len(x)).reshape(-1, 3))


def test_surfaces_are_simplified_together():
    """Two spheres of 20 000 triangles, in mm and in m, to 3000: still spheres, with cells of one size."""
    sphere = ball(100)
    small = meshes.Surface(300.0 * sphere.vertices, sphere.triangles)  # mm
    large, little = simplified.simpler([(1.0, sphere), (1e-3, small)], 3000)
    assert len(large.triangles) + len(little.triangles) <= 3000
    assert len(large.triangles) > 5 * len(little.triangles) > 500  # areas are as 11 to 1
    # The middle of corners in a cell lies inside; cells are sqrt(13.7/3000) = 0.07 to 0.13 m wide.
    assert 0.97 < np.linalg.norm(large.vertices, axis=1).min() <= np.linalg.norm(large.vertices, axis=1).max() <= 1.001
    assert large.volume == pytest.approx(4.0 / 3.0 * np.pi, rel=0.03)


def test_arrays_as_text():
    values = np.random.default_rng(0).normal(size=(5, 3)).astype("<f4")
    np.testing.assert_array_equal(from_text(to_text(values, "<f4"), "<f4", 3), values)
    assert from_text(to_text(np.empty((0, 3)), "<u4"), "<u4", 3).shape == (0, 3)
    for text in ("?", "AAAA", to_text(np.arange(4), "<u4")):
        with pytest.raises(ValueError, match="is no text of numbers"):
            from_text(text, "<u4", 3)


def test_a_recording_keeps_them(folder):
    """Through a file, which is resumed where the pictures have changed, and refused where they are damaged."""
    path = folder / "run.h5"
    scene = robot(folder)
    run = nd.simulate(scene, 0.02, dt=0.01, record=path)
    loaded = nd.Trajectory.load(path)
    assert loaded.scene["meshes"] == run.scene["meshes"] and loaded.scene["visuals"] == run.scene["visuals"]
    assert loaded.body("r/arm").position.shape == (3, 3)
    (folder / "box.stl").write_bytes(fuzz.text_stl())
    assert nd.simulate(robot(folder), 0.03, dt=0.01, resume=path).steps == 3
    went_on = nd.Trajectory.load(path)
    assert went_on.scene["meshes"] == run.scene["meshes"] and went_on.scene["visuals"] == run.scene["visuals"]
    for where, value, words in (
        ("vertices", "?", r"meshes\[0\] is no text of numbers"),
        ("vertices", to_text(np.zeros((1, 3)), "<f4"), r"meshes\[0\] has triangles whose corners it does not have"),
    ):
        damaged = {**run.scene, "meshes": [run.scene["meshes"][0] | {where: value}]}
        with pytest.raises(ValueError, match=words):
            schema._check_meshes(damaged)
    with pytest.raises(ValueError, match="has visual meshes that it does not have"):
        schema._check_meshes({**run.scene, "meshes": []})


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:'r")
def test_robots_of_example_robot_data_are_seen(share):
    """Their files are read and simplified: nothing is left out, with no more triangles than a page may have."""
    for name, count in (
        ("panda_description/urdf/panda.urdf", 20),
        ("anymal_b_simple_description/robots/anymal.urdf", 18),
    ):
        scene = nd.Scene()
        scene.add_urdf(
            "r", share / "example-robot-data/robots" / name, package_dirs=[share], clip=True, inertias="trust"
        )
        described = scene.describe()
        assert len(described["visuals"]) >= count
        triangles = [len(from_text(mesh["triangles"], "<u4", 3)) for mesh in described["meshes"]]
        assert 20_000 < sum(triangles) <= visuals.TRIANGLES
