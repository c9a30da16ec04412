"""Pages: the commands they hold, and what a real browser makes of them."""

import base64
import json
import math
import re
import subprocess
import sys
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import recordings
import umsgpack

import nsdyn as nd
from nsdyn.recording.trajectory import Trajectory
from nsdyn.view import marks, payload, solids, stage, viewer
from nsdyn.view.commands import as_hex

OCTAHEDRON = [(-1, 0, 0), (1, 0, 0), (0, -2, 0), (0, 2, 0), (0, 0, -3), (0, 0, 3)]
FLOATS = 0x17  # Float32Array in the viewer's MessagePack dialect


def unpacked(text):
    """Undo `payload.pack`: return values and flat arrays."""
    data = zlib.decompress(base64.b64decode(text))
    start = payload.ALIGNMENT + int.from_bytes(data[: payload.ALIGNMENT], "little")
    head, out = json.loads(data[payload.ALIGNMENT : start]), {}
    for name, entry in head["arrays"].items():
        kind, at = np.dtype(entry["type"]), start + entry["at"]
        planes = np.frombuffer(data, np.uint8, entry["size"] * kind.itemsize, at).reshape(kind.itemsize, -1)
        out[name] = np.ascontiguousarray(planes.T).reshape(-1).view(kind)
    return head["values"], out


def contents(page):
    """Decode the values and arrays of a page."""
    (text,) = re.findall('class="recording">([^<]*)<', page)
    return unpacked(text)


def commands(page):
    """Decode the commands of a page."""
    arrays = contents(page)[1]
    parts = np.split(arrays["commands"], arrays["command_ends"][:-1])
    return [umsgpack.unpackb(part.tobytes()) for part in parts]


def floats(ext, width):
    assert ext.type == FLOATS
    return np.frombuffer(ext.data, "<f4").reshape(-1, width)


def by_path(page, kind):
    return {c["path"]: c for c in commands(page) if c["type"] == kind}


def keyframes(page):
    """Times, and by the name of a frame the places or quaternions of those that move or turn."""
    values, arrays = contents(page)
    t, out = arrays["t"], [arrays["t"]]
    for name, which, width in (("position", "moving", 3), ("quaternion", "turning", 4)):
        tracks = arrays[f"motion/{name}"].reshape(-1, t.size, width)
        paths = [values["frames"][k] for k in arrays[f"motion/{which}"]]
        out.append(dict(zip(paths, tracks, strict=True)))
    return out


@pytest.fixture(scope="module")
def falling():
    return recordings.falling(shaking=1e-9)  # far below what can be seen


def test_page_asks_for_nothing(falling):
    page = viewer.html(falling)
    own = page.replace(viewer._meshcat_script(), "")
    assert len(page) - len(own) > 500_000
    for word in ("http:", "https:", "src=", "href=", "connect(", "WebSocket", "fetch("):
        assert word not in own
    assert "<title>&lt;three&gt; &amp; more - nsdyn</title>" in own


def test_equal_recordings_give_equal_pages(falling):
    again = Trajectory(falling.meta, json.loads(json.dumps(falling.scene)), dict(falling.columns))
    assert viewer.html(falling) == viewer.html(again)


def test_only_what_moves_is_animated(falling):
    _, places, turns = keyframes(viewer.html(falling))
    assert list(places) == ["/nsdyn/bodies/falling"] and list(turns) == ["/nsdyn/bodies/turning"]


def test_keyframes_are_the_recorded_states(falling):
    t, places, turns = keyframes(viewer.html(falling, fps=20))
    rows = np.round(t / 0.01).astype(int)
    assert len(t) == 21 and (t == falling.t[rows]).all()
    # Half a millionth of the scene's radius of some 3 m, and of a unit quaternion.
    np.testing.assert_allclose(places["/nsdyn/bodies/falling"], falling.q[rows, :3], rtol=0, atol=2e-6)
    np.testing.assert_allclose(turns["/nsdyn/bodies/turning"], falling.q[rows, 17:], rtol=0, atol=6e-7)


def test_long_recordings_get_fewer_keyframes(falling):
    t = keyframes(viewer.html(falling, fps=1000, max_frames=7))[0]
    assert len(t) == 7 and t[0] == 0.0 and t[-1] == 1.0
    assert len(keyframes(viewer.html(falling, fps=1000))[0]) == len(falling.t)


def test_impacts_have_a_keyframe_before_and_after():
    bounce = nd.simulate(nd.scenes.load("bounce")(), 0.6, dt=1e-3)
    hits = marks.find(bounce).step
    shown = set(keyframes(viewer.html(bounce, fps=5))[0])
    assert hits.size and {*bounce.t[hits], *bounce.t[hits - 1]} <= shown


def test_one_moment(falling):
    page = viewer.html(falling, at=0.5)
    assert [len(part) for part in keyframes(page)] == [1, 0, 0]
    poses = {(c["path"], c["property"]): c["value"] for c in commands(page) if c["type"] == "set_property"}
    assert poses["/nsdyn/bodies/falling", "position"] == falling.q[50, :3].tolist()
    assert poses["/nsdyn/bodies/turning", "quaternion"] == falling.q[50, 17:].tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fsp": 20}, r"did you mean 'fps'\? keyword must be one of at, beside, .*; got 'fsp'"),
        ({"fps": 0}, "fps must be positive"),
        ({"fps": math.nan}, "fps must be positive"),
        ({"max_frames": 1}, "max_frames must be at least 2"),
        ({"max_frames": 10.5}, "max_frames must be a whole number"),
        ({"fps": "30"}, "fps must be a number"),
        ({"at": [0.1]}, "at must be a number"),
        ({"beside": "other.h5"}, "beside must be a Trajectory"),
        ({"at": 1.01}, r"at must lie between 0 and 1 s, got 1\.01"),
        ({"at": math.nan}, "at must lie between"),
    ],
)
def test_options_out_of_range(falling, options, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        viewer.write_html(falling, tmp_path / "page.html", **options)
    assert list(tmp_path.iterdir()) == []


def test_states_that_are_not_finite_are_named(falling):
    q = falling.q.copy()
    q[30:, 2] = np.nan
    with pytest.raises(ValueError, match=r"not finite from t = 0\.3 s on"):
        viewer.html(Trajectory(falling.meta, falling.scene, falling.columns | {"q": q}))


def test_large_pages_warn(falling, monkeypatch):
    monkeypatch.setattr(viewer, "LARGE_PAGE", 1e5)
    with pytest.warns(UserWarning, match=r"page has 1 MB.*lower fps"):
        viewer.html(falling)


def test_page_is_written_atomically(falling, tmp_path):
    viewer.write_html(falling, tmp_path / "page.html", fps=10)
    assert (tmp_path / "page.html").read_text() == viewer.html(falling, fps=10)
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(ValueError, match=r"cannot write .*missing"):
        viewer.write_html(falling, tmp_path / "missing" / "page.html")


def extent(object_):
    """Lower and upper corner of everything in a scene object, with all matrices applied."""
    geometries = {g["uuid"]: g for g in object_["geometries"]}
    points = []

    def walk(node, matrix):
        matrix = matrix @ np.array(node.get("matrix", np.eye(4).ravel())).reshape(4, 4).T
        if "geometry" in node:
            geometry = geometries[node["geometry"]]
            if geometry["type"] == "LatheGeometry":
                profile = np.array([(p["x"], p["y"]) for p in geometry["points"]])
                r, y = profile.T
                turn = np.linspace(0, geometry["phiLength"], geometry["segments"] + 1) + geometry["phiStart"]
                x, z = np.outer(np.sin(turn), r), np.outer(np.cos(turn), r)
                x = np.stack([x, np.broadcast_to(y, x.shape), z], axis=-1).reshape(-1, 3)
            else:
                x = floats(geometry["data"]["attributes"]["position"]["array"], 3)
            points.append(x @ matrix[:3, :3].T + matrix[:3, 3])
        for child in node["children"]:
            walk(child, matrix)

    walk(object_["object"], np.eye(4))
    points = np.concatenate(points)
    return points.min(axis=0), points.max(axis=0)


def test_a_coin_has_a_dark_sector_that_is_no_shadow():
    """Small, and darker than any shadow on it."""
    coin = {"shape": "cylinder", "size": (0.1, 0.01), "placement": np.eye(4)}
    rest, sector = solids.solid(coin, (0.3, 0.6, 0.9), 32)["children"]
    angles = [node["geometry"]["phiLength"] for node in (rest, sector)]
    assert sum(angles) == pytest.approx(2 * np.pi) and 0 < angles[1] < np.radians(15)
    assert sum(node["geometry"]["segments"] for node in (rest, sector)) == 64
    assert sector["material"]["color"] == as_hex(0.3 * np.array([0.3, 0.6, 0.9]))
    (plain,) = solids.solid(coin, (0.3, 0.6, 0.9), 32, marked=False)["children"]
    assert plain["geometry"]["phiLength"] == pytest.approx(2 * np.pi)


@pytest.mark.parametrize(
    ("add", "arguments", "half"),
    [
        ("box", {"size": (0.2, 0.4, 0.6)}, (0.1, 0.2, 0.3)),
        ("sphere", {"radius": 0.3}, (0.3, 0.3, 0.3)),
        ("capsule", {"radius": 0.1, "length": 0.4}, (0.1, 0.1, 0.3)),
        ("cylinder", {"radius": 0.1, "length": 0.4}, (0.1, 0.1, 0.2)),
        ("ellipsoid", {"radii": (0.1, 0.2, 0.3)}, (0.1, 0.2, 0.3)),
        ("convex", {"vertices": OCTAHEDRON}, (1, 2, 3)),
    ],
)
def test_shapes_have_their_size(add, arguments, half):
    scene = nd.Scene()
    getattr(scene, f"add_{add}")("thing", mass=1.0, position=(1, 2, 3), **arguments)
    objects = by_path(viewer.html(recordings.recording(scene, np.tile([1, 2, 3, 0, 0, 0, 1.0], (3, 1)))), "set_object")
    lower, upper = extent(objects["/nsdyn/bodies/thing/thing"]["object"])
    # float32; radii of lathes are met at their 32 segments, which include the axes.
    np.testing.assert_allclose(upper, half, rtol=1e-6)
    np.testing.assert_allclose(lower, -np.array(half), rtol=1e-6)


def test_faces_look_outwards():
    scene = nd.Scene()
    scene.add_box("box", (1, 1, 1), 1.0)
    objects = by_path(viewer.html(recordings.recording(scene, [[0, 0, 0, 0, 0, 0, 1.0]] * 2)), "set_object")
    object_ = objects["/nsdyn/bodies/box/box"]["object"]
    attributes = object_["geometries"][0]["data"]["attributes"]
    x, n = (floats(attributes[name]["array"], 3).reshape(-1, 3, 3) for name in ("position", "normal"))
    turn = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    assert len(x) == 12 and (np.einsum("fi,fi->f", turn, n[:, 0]) > 0).all()
    assert (np.einsum("fi,fi->f", x.mean(axis=1), n[:, 0]) > 0).all()


def test_fixed_bodies_and_halfspaces_stand_where_they_are():
    scene = nd.Scene()
    n = np.array([0.6, 0.0, 0.8])
    scene.add_halfspace("slope", normal=n, offset=0.5)
    scene.add_box("step", (1, 1, 1), position=(1, 2, 3), fixed=True)
    scene.add_sphere("ball", 0.1, 1.0)
    objects = by_path(viewer.html(recordings.recording(scene, [[0, 0, 2, 0, 0, 0, 1.0]] * 2)), "set_object")
    lower, upper = extent(objects["/nsdyn/fixed/step"]["object"])
    np.testing.assert_allclose((lower, upper), [(0.5, 1.5, 2.5), (1.5, 2.5, 3.5)], rtol=1e-6)  # float32
    matrix = np.array(objects["/nsdyn/fixed/slope"]["object"]["object"]["matrix"]).reshape(4, 4).T
    np.testing.assert_allclose(matrix[:3, 2], n, rtol=0, atol=1e-15)
    assert matrix[:3, 3] @ n == pytest.approx(0.5, abs=1e-14)
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0, abs=1e-14)


def test_given_colour_is_used():
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0, colour=(1.0, 0.5, 0.0, 0.4))
    objects = by_path(viewer.html(recordings.recording(scene, [[0, 0, 0, 0, 0, 0, 1.0]] * 2)), "set_object")
    material = objects["/nsdyn/bodies/ball/ball"]["object"]["materials"][0]
    assert material["color"] == 0xFF8000 and material["opacity"] == 0.4 and material["transparent"]


def test_camera_sees_everything_and_is_outside(falling):
    view = stage.View([falling])
    assert view.eye[2] > 0.0
    forward = view.centre - view.eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    x = np.concatenate([falling.body(name).position for name in falling.scene["frames"]]) - view.eye
    slope = math.tan(math.radians(stage.FIELD_OF_VIEW / 2))
    assert (np.abs(x @ up) < slope * (x @ forward)).all()
    assert (np.abs(x @ right) < 4 / 3 * slope * (x @ forward)).all()


def test_camera_is_as_near_as_the_shapes_are():
    """A shape far from the origin of its link is where it is, not anywhere around that."""
    scene = nd.scenes.load("gripper")()
    view = stage.View([nd.simulate(scene, 0.01, dt=5e-3)])
    assert view.radius < 0.15  # m; of the palm, 0.2 m wide, and the fingers below, 0.16 m high
    assert (view.centre[:2] == pytest.approx([0.0, 0.0], abs=0.01)) and 0.06 < view.centre[2] < 0.16


@pytest.mark.parametrize(
    ("kind", "size", "half"),
    [
        ("box", ((1.0, 0.1, 0.1),), (0.5, 0.05, 0.05)),
        ("cylinder", (0.5, 0.02), (0.5, 0.5, 0.01)),
        ("capsule", (0.02, 0.96), (0.02, 0.02, 0.5)),
        ("ellipsoid", ((0.5, 0.1, 0.05),), (0.5, 0.1, 0.05)),
    ],
)
def test_camera_is_near_to_what_is_flat_or_long(kind, size, half):
    """A shape is in the picture as large as it is, not as the ball around it."""
    scene = nd.Scene(gravity=(0, 0, 0))
    getattr(scene, f"add_{kind}")("body", *size, 1.0)
    view = stage.View([nd.simulate(scene, 0.01, dt=5e-3)])
    assert 0.95 < view.radius / np.linalg.norm(half) < 1.1


def test_camera_is_near_what_moves_along_a_large_fixed_body():
    """A ball of 10 mm beside a pole of 2 m is no speck; a fixed body of its own size is all in the picture."""
    for length, lower, upper in ((2.0, 0.03, 0.2), (0.04, 0.03, 0.06)):
        scene = nd.Scene(gravity=(0, 0, 0))
        scene.add_box("pole", (0.005, 0.02, length), fixed=True)
        scene.add_sphere("ball", 0.01, 1.0, position=(0.02, 0, 0.3 * length), linear_velocity=(0, 0, -1))
        view = stage.View([nd.simulate(scene, 0.02, dt=1e-3)])
        assert lower < view.radius < upper
        # The pole, as far as it is shown, is where the ball is.
        assert abs(view.centre[2] - (0.3 * length - 0.01)) < 0.1


@pytest.mark.parametrize(
    ("count", "states", "least", "most"), [(16, 3, 0.4, 0.7), (4, 3, 2.5, 3.0), (16, 12, 2.5, 3.0)]
)
def test_camera_is_near_a_heap(count, states, least, most):
    """Not where its bodies fell from for some states of 40; of few bodies, or for long, it shows all that they do."""
    scene = nd.Scene()
    for k in range(count):
        scene.add_sphere(f"ball{k}", 0.1, 1.0)
    at = np.zeros((40, count, 7))
    at[..., 6], at[..., 0], at[..., 1] = 1.0, 0.2 * (np.arange(count) % 4), 0.2 * (np.arange(count) // 4)
    at[:states, :, 2] = 5.0
    view = stage.View([recordings.recording(scene, at.reshape(40, -1))])
    assert least < view.radius < most


def test_meshcat_itself_is_not_loaded():
    code = "import sys; from nsdyn.view import viewer; viewer._meshcat_script(); print('meshcat' in sys.modules)"
    root = str(Path(nd.__file__).parents[1])
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_articulation_is_drawn_link_by_link():
    scene = nd.scenes.load("arm_pushes_box")()
    trajectory = nd.simulate(scene, duration=0.02, dt=2e-3)
    page = viewer.html(trajectory, fps=500)
    turns = keyframes(page)[2]
    for frame in trajectory.scene["frames"]:
        assert solids.body_path(frame) in {p.rpartition("/")[0] for p in by_path(page, "set_object")}
    link = next(name for name in trajectory.scene["frames"] if name.startswith("arm/"))
    # Half a millionth, as above.
    expected = trajectory.body(link).quaternion[-1]
    np.testing.assert_allclose(turns[solids.body_path(link)][-1], expected, rtol=0, atol=6e-7)


def test_lines_are_drawn_where_half_spaces_meet(monkeypatch):
    """Of a room with a slanted floor and two walls, those that the third half-space does not cover."""
    monkeypatch.setattr(stage, "as_buffer", lambda position: position)
    view = SimpleNamespace(centre=np.array([0.0, 0.0, 1.0]), radius=2.0)
    floor, left, behind = (np.array(n) for n in ((0.0, 0.6, 0.8), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    ends = stage.corner_object([(floor, 0.0), (left, -3.0), (behind, -4.0)], view)["geometry"].reshape(-1, 2, 3)
    planes = np.array([[*floor, 0.0], [*left, -3.0], [*behind, -4.0]])
    gaps = ends @ planes[:, :3].T - planes[:, 3]
    assert (gaps >= -1e-12).all()
    assert sorted(map(tuple, (np.abs(gaps) < 1e-12).all(axis=1).tolist())) == [
        (False, True, True),
        (True, False, True),
        (True, True, False),
    ]
    corner = (-3.0, -4.0, 3.0)
    assert all(np.isclose(line, corner).all(axis=1).any() for line in ends)
    assert stage.corner_object([(floor, 0.0), (floor, 1.0)], view) is None
