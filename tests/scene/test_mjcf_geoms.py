"""Geoms of MJCF: as many sizes as MuJoCo takes, its poses between two points, and one line for everything else."""

import fuzz
import numpy as np
import pytest
from robot_texts import robot_of, scene_of

import nsdyn as nd
from nsdyn import cli
from nsdyn.scene import shapes
from nsdyn.scene.mesh_files import stl

TAKES = {"plane": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""Sizes that MuJoCo's reference gives each type; up to three may be written."""

BETWEEN = ("capsule", "cylinder", "ellipsoid", "box")
"""Types that take fromto, and then one size."""

SIZES = "0.11", "0.12", "0.13", "0.14"
ENDS = "0.1 0.2 0.3 -0.2 0.4 0.9"
WRITTEN = [(kind, count, ends) for kind in TAKES for count in range(5) for ends in (False, True)]


def mjcf(kind, count, ends=False, size=None, more=""):
    size = " ".join(SIZES[:count]) if size is None else size
    given = (f'size="{size}" ' if size else "") + (f'fromto="{ENDS}" ' if ends else "")
    ball = '<body pos="0 0 9"><freejoint/><geom size="0.1"/></body>'
    return f'<mujoco><worldbody>{ball}<geom name="g" type="{kind}" {given}{more}/></worldbody></mujoco>'


def fixed(tmp_path, text):
    """The geom g, as the scene has it; ValueError for one that is refused."""
    return scene_of(tmp_path, text, "m").geoms()[0]


def lengths(shape):
    """Sizes of a shape as MJCF writes them."""
    match shape.kind:
        case shapes.POLYTOPE:
            return shape.size / 2
        case shapes.HALFSPACE:
            return []
        case shapes.ELLIPSOID:
            return shape.size
        case kind:
            return shape.size[: 1 if kind == shapes.SPHERE else 2]


@pytest.mark.parametrize(("kind", "count", "ends"), WRITTEN)
def test_every_type_with_every_count_of_sizes(tmp_path, capsys, kind, count, ends):
    text, path = mjcf(kind, count, ends), tmp_path / "m.mjcf"
    fits = (1 if ends else TAKES[kind]) <= count <= 3 and (kind in BETWEEN or not ends)
    if fits:
        half = 0.5 * np.linalg.norm(np.diff(np.array(ENDS.split(), dtype=float).reshape(2, 3), axis=0))
        expected = [float(size) for size in SIZES[: TAKES[kind]]]
        if ends:
            expected = [0.11] * (TAKES[kind] - 1) + [half]
        found = lengths(fixed(tmp_path, text).shape)
        np.testing.assert_allclose(found, expected if kind != "plane" else [], rtol=1e-15)
    else:
        with pytest.raises(ValueError, match=rf"(size|fromto) of geom 'g'(, a {kind},)? must be .*, got") as refused:
            fixed(tmp_path, text)
        assert "\n" not in str(refused.value)
    assert cli.main(["check", str(path)]) == (0 if fits else 2)
    err = capsys.readouterr().err
    assert err == "" if fits else (err.count("\n") == 1 and "geom 'g'" in err)


@pytest.mark.parametrize(("kind", "count", "ends"), WRITTEN)
def test_sizes_are_those_of_mujoco(tmp_path, kind, count, ends):
    """What it refuses is refused, what it takes lies where it does."""
    mujoco = pytest.importorskip("mujoco", reason="the extra 'peers' is not installed")
    text = mjcf(kind, count, ends, more='euler="10 20 30"' + (' pos="0.3 0 0"' if not ends else ""))
    try:
        theirs = mujoco.MjModel.from_xml_string(text)
    except ValueError:
        with pytest.raises(ValueError, match="geom 'g'"):
            fixed(tmp_path, text)
        return
    data, ours = mujoco.MjData(theirs), fixed(tmp_path, text)
    mujoco.mj_forward(theirs, data)
    R, x = data.geom_xmat[0].reshape(3, 3), data.geom_xpos[0]
    if kind == "plane":
        np.testing.assert_allclose(ours.shape.size, R[:, 2], rtol=0, atol=1e-15)
        assert ours.shape.offset == pytest.approx(R[:, 2] @ x, abs=1e-15)
        return
    np.testing.assert_allclose(lengths(ours.shape), theirs.geom_size[0][: TAKES[kind]], rtol=1e-15)
    np.testing.assert_allclose(ours.placement_t, x, rtol=0, atol=1e-15)
    # Of two equal axes any turn about the third is the same, save of a box.
    axes = slice(None) if kind in ("box", "ellipsoid") else slice(2, 3)
    if kind != "sphere":
        np.testing.assert_allclose(ours.placement_R[:, axes], R[:, axes], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("geom", "words"),
    [
        ('type="blob" size=".1"', r"type of geom 'g' must be one of plane, .*, sdf; got 'blob'"),
        ('type="spere" size=".1"', r"did you mean 'sphere'\? type of geom 'g' "),
        ('type="box" size=".1 .1 0"', "size of geom 'g', a box, must be positive, got '.1 .1 0'"),
        ('size="-1"', "size of geom 'g', a sphere, must be positive, got '-1'"),
        ('type="plane" size="0 0 0"', "size of geom 'g', a plane, must be positive"),
        ('type="box" size=".1 .1 x"', "size of <geom> 'g' must be finite numbers, got '.1 .1 x'"),
        ('type="box" size=".1 .1 1e999"', "size of <geom> 'g' must be finite numbers"),
        ('type="capsule" size=".1" fromto="0 0 0 0 0 0"', "fromto of geom 'g' must be two points, got .* twice"),
        ('type="box" size=".1" fromto="0 0 0 0 0 1" pos="0 0 1"', "geom 'g' must have pos or fromto, got both"),
        ('type="capsule" size=".1" fromto="0 0 0 0 0"', "fromto of geom 'g' must be 6 numbers"),
        ('type="mesh"', r"mesh of geom 'g' must be one of bad, box, corners, gone; got ''"),
        ('type="mesh" mesh="bax"', r"did you mean 'box'\? mesh of geom 'g' must be one of .*; got 'bax'"),
        ('type="mesh" mesh="gone"', r"geom 'g': mesh 'gone\.stl' was not found in [^;]*$"),
        ('type="mesh" mesh="bad"', "geom 'g': mesh 'bad' has neither a file nor vertices"),
        ('type="mesh" mesh="box" size="1 1 1 1"', "size of geom 'g', a mesh, must be 0 to 3 numbers, got 4"),
        ('type="box" mesh="box" size=".1 .1 .1"', "geom 'g' must be of type mesh to name one, got 'box'"),
        ('size=".1" contype="1.5"', "contype of geom 'g' must be a whole number, got 1.5"),
        ('size=".1" contype="x"', "contype of geom 'g' must be a number, got 'x'"),
    ],
)
def test_bad_geoms_are_told_in_one_line(tmp_path, capsys, geom, words):
    (tmp_path / "box.stl").write_bytes(fuzz.binary_stl())
    corners = '<mesh name="corners" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
    assets = f'<asset><mesh file="box.stl"/><mesh file="gone.stl"/><mesh name="bad"/>{corners}</asset>'
    path = tmp_path / "r.xml"
    path.write_text(f'<mujoco>{assets}<worldbody><geom name="g" {geom}/></worldbody></mujoco>')
    with pytest.raises(ValueError, match=words) as refused:
        nd.Scene().add_mjcf("m", path)
    assert "\n" not in str(refused.value)
    assert cli.main(["check", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1


def test_meshes_that_are_only_seen_need_not_be_there(tmp_path):
    text = mjcf("mesh", 0, more='mesh="gone" contype="0" conaffinity="0"')
    text = text.replace("<worldbody>", '<asset><mesh file="gone.stl"/></asset><worldbody>')
    assert fixed(tmp_path, text).name == "m/body0_0"


def test_meshes_of_vertices(tmp_path):
    text = mjcf("mesh", 0, more='mesh="c"')
    corners = '<asset><mesh name="c" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
    assert fixed(tmp_path, text.replace("<worldbody>", f"{corners}<worldbody>")).shape.volume == pytest.approx(1 / 6)


def cubes():
    """Corners and triangles of two cubes of 1 m with the centres (-1.5, 0, 0) and (1.5, 0, 0)."""
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = np.array([corners for a, b, c, d in sides for corners in ((a, b, c), (a, c, d))])
    corners = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    shift = np.array([1.5, 0, 0])
    return np.vstack([corners - shift, corners + shift]), np.vstack([triangles, triangles + 8])


def weighed(tmp_path, mesh, geoms, top=""):
    """Inertia of a body of geoms, about its joint at the origin, without a warning."""
    text = f"<mujoco>{top}<asset><mesh name='m' {mesh}/></asset><worldbody><body><joint/>{geoms}</body></worldbody>"
    return robot_of(tmp_path, f"{text}</mujoco>", self_collisions=False).model.inertias[1]


@pytest.mark.parametrize("seen", [False, True])
@pytest.mark.parametrize("held", ["file", "text"])
@pytest.mark.parametrize("mass", ['density="3"', 'mass="7"'])
@pytest.mark.parametrize(
    ("law", "volume", "along", "across"),
    [
        ("exact", 2, 1 / 3, 1 / 3 + 2 * 1.5**2),
        ("convex", 4, 4 / 12 * 2, 4 / 12 * 17),  # a box of 4 m, 1 m, 1 m
        ("shell", 12, 10 / 3, 10 / 3 + 12 * 1.5**2),
        # Pyramids from the middle of both to all of their sides: 5/3 m³ for each cube.
        ("legacy", 10 / 3, 7 / 15, 82 / 15 + 7 / 30),
        (None, 10 / 3, 7 / 15, 82 / 15 + 7 / 30),
    ],
)
@pytest.mark.filterwarnings("ignore:.* is not convex")
def test_meshes_have_the_mass_of_mujoco(tmp_path, law, volume, along, across, mass, held, seen):
    """Of two cubes as one mesh, which the four laws weigh differently; mirrored, twice as large, in a pose."""
    corners, triangles = cubes()
    (tmp_path / "cubes.stl").write_bytes(stl.binary(corners, triangles))
    words = [" ".join(map(str, array.ravel())) for array in (corners, triangles)]
    mesh = 'file="cubes.stl"' if held == "file" else f'vertex="{words[0]}" face="{words[1]}"'
    mesh += ' scale="2 2 -2"' + (f' inertia="{law}"' if law else "")
    touches = 'contype="0" conaffinity="0"' if seen else ""
    found = weighed(tmp_path, mesh, f'<geom type="mesh" mesh="m" {mass} {touches} pos="1 2 3" euler="0 0 90"/>')
    size = volume * (4 if law == "shell" else 8)
    expected = 3 * size if "density" in mass else 7
    np.testing.assert_allclose(found.mass, expected, rtol=1e-14)
    np.testing.assert_allclose(found.lever, [1, 2, 3], rtol=1e-14)
    moments = np.diag([across, along, across]) * 4 / volume * expected
    np.testing.assert_allclose(found.inertia, moments, rtol=1e-13, atol=1e-13 * moments.max())


def test_a_mesh_beside_a_ball_and_a_mesh_without_faces(tmp_path):
    """A box of 0.2 x 0.3 x 0.5 m from its corners, with one at the origin, and a ball of 10 kg at its centre."""
    corners = " ".join(f"{x} {y} {z}" for x in (0, 0.2) for y in (0, 0.3) for z in (0, 0.5))
    ball = '<geom size=".1" pos=".1 .15 .25" mass="10"/>'
    found = weighed(tmp_path, f'vertex="{corners}"', f'<geom type="mesh" mesh="m"/>{ball}')
    assert found.mass == pytest.approx(40, rel=1e-14)
    np.testing.assert_allclose(found.lever, [0.1, 0.15, 0.25], rtol=1e-14)
    moments = np.diag([0.34, 0.29, 0.13]) * 30 / 12 + np.eye(3) * 0.4 * 10 * 0.1**2
    np.testing.assert_allclose(found.inertia, moments, rtol=1e-13, atol=1e-15)


def test_a_mesh_that_is_moved_as_a_whole(tmp_path):
    """By `refpos` and `refquat`, which say where the frame of the geom is in the frame of the mesh."""
    corners = " ".join(f"{x} {y} {z}" for x in (0, 0.2) for y in (0, 0.3) for z in (0, 0.5))
    mesh = f'vertex="{corners}" refpos=".1 .15 0" refquat="1 0 0 1"'
    found = weighed(tmp_path, mesh, '<geom type="mesh" mesh="m" contype="0" conaffinity="0"/>')
    np.testing.assert_allclose(found.lever, [0, 0, 0.25], rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.diag(found.inertia), np.array([0.29, 0.34, 0.13]) * 30 / 12, rtol=1e-13)


@pytest.mark.parametrize(
    ("compiler", "first", "second"),
    [
        ("", 5, 7),
        ('inertiagrouprange="0 1"', 5, 7),
        ('inertiagrouprange="1 2"', 4, 7),
        ('inertiafromgeom="true"', 5, 3),
        ('inertiafromgeom="auto"', 5, 7),
        ('inertiafromgeom="true" inertiagrouprange="0 1"', 5, 7),
    ],
)
def test_geoms_of_some_groups_give_the_mass(tmp_path, compiler, first, second):
    """Others none; an <inertial> is left to bodies whose geoms have no mass."""
    balls = '<geom size=".1" mass="1"/><geom size=".1" mass="4" group="1"/>'
    inertial = '<inertial pos="0 0 0" mass="7" diaginertia="1 1 1"/>'
    other = f'<body><joint/>{inertial}<geom size=".1" mass="3" group="2"/></body>'
    other += f'<body><joint/>{inertial}<geom size=".1" mass="0"/></body>'
    a = robot_of(
        tmp_path,
        f"<mujoco><compiler {compiler}/><worldbody><body><joint/>{balls}</body>{other}</worldbody></mujoco>",
        self_collisions=False,
    )
    assert [inertia.mass for inertia in a.model.inertias][1:] == [first, second, 7]


@pytest.mark.parametrize(
    "own", ["axisangle='0 0 1 90'", "xyaxes='0 1 0 -1 0 0'", "quat='1 0 0 1'", "euler='0 0 90'", ""]
)
def test_an_orientation_replaces_that_of_the_class(own, tmp_path):
    """In whatever form either is given, as in MuJoCo."""
    a = robot_of(
        tmp_path,
        "<mujoco><compiler angle='degree'/><default><geom euler='90 0 0'/></default><worldbody><body name='b'>"
        f"<joint name='j'/><geom name='g' type='box' size='.5 .1 .02' mass='1' {own}/></body></worldbody></mujoco>",
    )
    turned = [[0, -1, 0], [1, 0, 0], [0, 0, 1]] if own else [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    np.testing.assert_allclose(a.links[0].placement.rotation, turned, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("kind", "first"), [("capsule", ".3"), ("box", ".3 .2"), ("ellipsoid", ".3"), ("box", ".5 .6 .7")]
)
def test_first_sizes_leave_the_others_of_the_class(tmp_path, kind, first):
    """As in MuJoCo: the size of an element may be shorter than that of its class."""
    given = [float(size) for size in first.split()]
    expected = [*given, *[0.11, 0.12, 0.13][len(given) :]][: TAKES[kind]]
    default = f'<mujoco><default><geom size="0.11 0.12 0.13" type="{kind}"/></default>'
    text = mjcf("sphere", 0, size=first).replace("<mujoco>", default).replace(' type="sphere"', "")
    np.testing.assert_array_equal(lengths(fixed(tmp_path, text).shape), expected)
