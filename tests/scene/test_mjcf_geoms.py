"""Geoms of MJCF: as many sizes as MuJoCo takes, its poses between two points, and one line for everything else."""

import fuzz
import numpy as np
import pytest
from robot_texts import robot_of, scene_of

import nsdyn as nd
from nsdyn import cli
from nsdyn.scene import shapes

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
