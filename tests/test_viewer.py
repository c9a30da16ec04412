"""Pages: the commands they hold, and what a real browser makes of them."""

import base64
import html
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import umsgpack

import nsdyn as nd
from nsdyn.recording import pictures, solids, stage, viewer
from nsdyn.recording.trajectory import Trajectory

OCTAHEDRON = [(-1, 0, 0), (1, 0, 0), (0, -2, 0), (0, 2, 0), (0, 0, -3), (0, 0, 3)]
FLOATS = 0x17  # Float32Array in the viewer's MessagePack dialect


def commands(page):
    """Decode the commands of a page."""
    blobs = re.findall(r'^"([A-Za-z0-9+/=]+)",?$', page, flags=re.MULTILINE)
    return [umsgpack.unpackb(base64.b64decode(blob)) for blob in blobs]


def floats(ext, width):
    assert ext.type == FLOATS
    return np.frombuffer(ext.data, "<f4").reshape(-1, width)


def by_path(page, kind):
    return {c["path"]: c for c in commands(page) if c["type"] == kind}


def clips(page):
    (animation,) = [c for c in commands(page) if c["type"] == "set_animation"]
    return {a["path"]: a["clip"] for a in animation["animations"]}


def recording(scene, q, dt=0.01, contacts=None):
    """A trajectory of free bodies with given configurations, one step per row after the first."""
    q = np.asarray(q, dtype=float)
    n = len(q) - 1
    columns = {"t": dt * np.arange(n + 1), "q": q, "v": np.zeros((n + 1, 6 * len(q[0]) // 7))}
    columns["contacts/offset"] = np.zeros(n + 1, np.int64)
    columns |= contacts or {}
    return Trajectory({"dt": dt, "scene_name": scene.name}, scene.describe(), columns)


@pytest.fixture(scope="module")
def falling():
    """One second of a falling box, a box at rest and a turning sphere."""
    scene = nd.Scene(name="<three> & more")
    scene.add_halfspace("ground")
    for name, x in (("falling", 0.0), ("resting", 1.0)):
        scene.add_box(name, (0.2, 0.2, 0.2), 1.0, position=(x, 0, 0.1))
    scene.add_sphere("turning", 0.1, 1.0, position=(2, 0, 0.1))
    t = np.linspace(0.0, 1.0, 101)
    q = np.tile([0, 0, 5, 0, 0, 0, 1, 1, 0, 0.1, 0, 0, 0, 1, 2, 0, 0.1, 0, 0, 0, 1.0], (101, 1))
    q[:, 2] -= 0.5 * 9.81 * t**2
    q[:, 7] += 1e-9 * np.sin(50 * t)  # far below what can be seen
    q[:, 19], q[:, 20] = np.sin(t), np.cos(t)
    return recording(scene, q)


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
    moving = clips(viewer.html(falling))
    assert {path: [t["name"] for t in clip["tracks"]] for path, clip in moving.items()} == {
        "/nsdyn/bodies/falling": [".position"],
        "/nsdyn/bodies/turning": [".quaternion"],
    }
    # All go on together: the second plus half a second of rest.
    assert {clip["duration"] for clip in moving.values()} == {1.5}


def test_keyframes_are_the_recorded_states(falling):
    (track,) = clips(viewer.html(falling, fps=20))["/nsdyn/bodies/falling"]["tracks"]
    assert track["type"] == "vector3"
    t, x = floats(track["times"], 1)[:, 0], floats(track["values"], 3)
    assert len(t) == len(x) == 21
    rows = np.round(t / 0.01).astype(int)
    # float32
    np.testing.assert_allclose(t, falling.t[rows], rtol=0, atol=1e-7)
    np.testing.assert_allclose(x, falling.q[rows, :3], rtol=0, atol=5e-7)


def test_a_body_that_stops_needs_no_more_keys():
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0)
    q = np.tile([0, 0, 0, 0, 0, 0, 1.0], (100, 1))
    q[:, 0] = np.clip(np.arange(100), 40, 60)
    (track,) = clips(viewer.html(recording(scene, q), fps=100))["/nsdyn/bodies/ball"]["tracks"]
    # The first, and from where it leaves to where it stops.
    np.testing.assert_allclose(floats(track["times"], 1)[:, 0], [0.0, *np.arange(40, 61) / 100], rtol=1e-6)


def test_long_recordings_get_fewer_keyframes(falling):
    tracks = clips(viewer.html(falling, fps=1000, max_frames=7))["/nsdyn/bodies/falling"]["tracks"]
    times = floats(tracks[0]["times"], 1)[:, 0]
    assert len(times) == 7 and times[0] == 0.0 and times[-1] == 1.0
    assert len(viewer.html(falling, fps=1000)) > len(viewer.html(falling, fps=10))


def test_one_moment(falling):
    page = viewer.html(falling, at=0.5)
    assert not [c for c in commands(page) if c["type"] == "set_animation"]
    poses = {(c["path"], c["property"]): c["value"] for c in commands(page) if c["type"] == "set_property"}
    assert poses["/nsdyn/bodies/falling", "position"] == falling.q[50, :3].tolist()
    assert poses["/nsdyn/bodies/turning", "quaternion"] == falling.q[50, 17:].tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"fps": 0}, "fps must be positive"),
        ({"fps": math.nan}, "fps must be positive"),
        ({"max_frames": 1}, "max_frames must be at least 2"),
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
                turn = np.linspace(0, np.pi, geometry["segments"] + 1) + geometry["phiStart"]
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
)  # fmt: skip
def test_shapes_have_their_size(add, arguments, half):
    scene = nd.Scene()
    getattr(scene, f"add_{add}")("thing", mass=1.0, position=(1, 2, 3), **arguments)
    objects = by_path(viewer.html(recording(scene, np.tile([1, 2, 3, 0, 0, 0, 1.0], (3, 1)))), "set_object")
    lower, upper = extent(objects["/nsdyn/bodies/thing/thing"]["object"])
    # float32; radii of lathes are met at their 24 segments, which include the axes.
    np.testing.assert_allclose(upper, half, rtol=1e-6)
    np.testing.assert_allclose(lower, -np.array(half), rtol=1e-6)


def test_faces_look_outwards():
    scene = nd.Scene()
    scene.add_box("box", (1, 1, 1), 1.0)
    objects = by_path(viewer.html(recording(scene, [[0, 0, 0, 0, 0, 0, 1.0]] * 2)), "set_object")
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
    objects = by_path(viewer.html(recording(scene, [[0, 0, 2, 0, 0, 0, 1.0]] * 2)), "set_object")
    lower, upper = extent(objects["/nsdyn/fixed/step"]["object"])
    np.testing.assert_allclose((lower, upper), [(0.5, 1.5, 2.5), (1.5, 2.5, 3.5)], rtol=1e-6)  # float32
    matrix = np.array(objects["/nsdyn/fixed/slope"]["object"]["object"]["matrix"]).reshape(4, 4).T
    np.testing.assert_allclose(matrix[:3, 2], n, rtol=0, atol=1e-15)
    assert matrix[:3, 3] @ n == pytest.approx(0.5, abs=1e-14)
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1.0, abs=1e-14)


def test_given_colour_is_used():
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0, colour=(1.0, 0.5, 0.0, 0.4))
    objects = by_path(viewer.html(recording(scene, [[0, 0, 0, 0, 0, 0, 1.0]] * 2)), "set_object")
    material = objects["/nsdyn/bodies/ball/ball"]["object"]["materials"][0]
    assert material["color"] == 0xFF8000 and material["opacity"] == 0.4 and material["transparent"]


ARROW = "/nsdyn/bodies/ball/contact forces/0"


def pressed(body_first):
    """A ball that the ground carries for two steps; the contact impulse is (0, 0, 3) N s on it, then none."""
    scene = nd.Scene()
    if body_first:
        scene.add_sphere("ball", 0.1, 1.0)
    scene.add_halfspace("ground")
    if not body_first:
        scene.add_sphere("ball", 0.1, 1.0)
    up = -1.0 if body_first else 1.0
    contacts = {
        "offset": np.array([0, 1, 2, 2]), "geom1": np.array([0, 0]), "geom2": np.array([1, 1]),
        "point": np.array([[0.0, 0, 0], [0.5, 0, 0]]), "normal": np.array([[0, 0, up]] * 2),
        "tangent": np.array([[1.0, 0, 0]] * 2), "impulse": np.array([[3.0, 0, 0], [3.0, 1.0, 0]]),
        **{name: np.zeros(2) for name in ("gap", "mu", "restitution", "key", "work_normal", "work_friction")},
        "u": np.zeros((2, 3)), "status": np.ones(2, np.int8),
    }  # fmt: skip
    q = [[x, 0, 0.1, 0, 0, 0, 1.0] for x in (0, 0, 0.5, 0.5)]
    return recording(scene, q, contacts={f"contacts/{name}": values for name, values in contacts.items()})


@pytest.mark.parametrize("body_first", [False, True])
def test_forces_push_the_moving_body(body_first):
    page = viewer.html(pressed(body_first), fps=100, forces=True)
    assert [path for path in by_path(page, "set_object") if "forces" in path] == [ARROW]
    tracks = {t["name"]: t for t in clips(page)[ARROW]["tracks"]}
    assert {t["interpolation"] for t in tracks.values()} == {2300}  # jumps
    size = floats(tracks[".scale"]["values"], 3)[:, 0]
    assert size[0] == 0.0 and size[1] > 0.0 and size[-1] == 0.0
    assert size[2] / size[1] == pytest.approx(math.sqrt(10) / 3, rel=1e-6)  # float32
    x, y, z, w = floats(tracks[".quaternion"]["values"], 4)[1]
    direction = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    # The tangential part acts on body 2, so on the ball when it comes second.
    expected = np.array([-1.0 if body_first else 1.0, 0.0, 3.0]) / math.sqrt(10)
    np.testing.assert_allclose(direction, expected, rtol=0, atol=1e-6)
    # From the centre of the ball, which moves with it.
    np.testing.assert_allclose(floats(tracks[".position"]["values"], 3)[1], (0, 0, -0.1), rtol=0, atol=1e-7)


def test_arrows_point_anywhere():
    for d in np.array([(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, -0.8), (0, -1, 0.0)]):
        x, y, z, w = viewer._from_z(d)
        turned = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w + z * z - x * x - y * y])
        np.testing.assert_allclose(turned, d, rtol=0, atol=1e-15)


def test_camera_sees_everything_and_is_outside(falling):
    view = stage.View(falling)
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


def test_meshcat_itself_is_not_loaded():
    code = "import sys; from nsdyn.recording import viewer; viewer._meshcat_script(); print('meshcat' in sys.modules)"
    root = str(Path(nd.__file__).parents[1])
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_articulation_is_drawn_link_by_link():
    scene = nd.scenes.load("arm_pushes_box")()
    trajectory = nd.simulate(scene, duration=0.02, dt=2e-3)
    page = viewer.html(trajectory, fps=500)
    moving = clips(page)
    for frame in trajectory.scene["frames"]:
        assert solids.body_path(frame) in {p.rpartition("/")[0] for p in by_path(page, "set_object")}
    link = next(name for name in trajectory.scene["frames"] if name.startswith("arm/"))
    track = next(t for t in moving[solids.body_path(link)]["tracks"] if t["name"] == ".quaternion")
    np.testing.assert_allclose(floats(track["values"], 4)[-1], trajectory.body(link).quaternion[-1], rtol=0, atol=1e-7)


# -- in a browser --------------------------------------------------------------------------------------------

needs_chromium = pytest.mark.skipif(pictures.chromium() is None, reason="no Chromium on the PATH")


@needs_chromium
def test_picture_shows_the_bodies_where_they_are(falling, tmp_path):
    from PIL import Image

    taken = []
    for at in (0.0, 1.0):
        viewer.write_html(falling, tmp_path / "page.html", at=at)
        pictures.screenshot(tmp_path / "page.html", tmp_path / "page.png", size=(640, 360))
        taken.append(np.asarray(Image.open(tmp_path / "page.png").convert("RGB"), dtype=float))
    assert taken[0].shape == (360, 640, 3)
    blue = [((p[:, :, 2] - p[:, :, 0]) > 60).nonzero()[0] for p in taken]  # first colour of the palette
    assert min(b.size for b in blue) > 100
    assert blue[0].mean() < 120 < blue[1].mean() - 60  # it fell from the upper third by a good part of the picture
    assert sorted(p.name for p in tmp_path.iterdir()) == ["page.html", "page.png"]


def browse(page, *flags):
    """(document, messages) of a page as headless Chromium has it after a second."""
    flags = [
        "--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", "--no-first-run", "--disable-background-networking",
        "--disable-component-update", "--disable-sync", "--virtual-time-budget=1000", "--dump-dom",
        "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr",
        f"--user-data-dir={page.parent / 'profile'}", *flags,
    ]  # fmt: skip
    done = subprocess.run([pictures.chromium(), *flags, page.as_uri()], capture_output=True, timeout=60)
    return done.stdout.decode(), done.stderr.decode(errors="replace")


@needs_chromium
def test_browser_loads_nothing_and_complains_about_nothing(falling, tmp_path):
    def hosts_and_messages(page):
        log = tmp_path / "net.json"
        messages = browse(page, f"--log-net-log={log}")[1]
        events = json.loads(log.read_text())["events"]
        urls = [e["params"]["url"] for e in events if "url" in e.get("params", {})]
        hosts = {re.sub(r"^\w+://([^/:]+).*", r"\1", url) for url in urls}
        own = re.compile(r"(^|\.)(google|googleapis|gvt1)\.com$")  # what Chromium asks for on its own
        return {h for h in hosts if not own.search(h)}, messages

    viewer.write_html(falling, tmp_path / "page.html")
    hosts, messages = hosts_and_messages(tmp_path / "page.html")
    assert hosts == set()
    assert "Uncaught" not in messages
    # The same look at a page that does load something, so that an empty set means something.
    control = tmp_path / "control.html"
    control.write_text("<img src='http://elsewhere.invalid/x.png'><script>throw new Error('oops')</script>")
    hosts, messages = hosts_and_messages(control)
    assert hosts == {"elsewhere.invalid"} and "Uncaught" in messages


@needs_chromium
def test_page_plays(falling, tmp_path):
    probe = """<script>
    const animator = viewer.animator, found = {playing: animator.playing, duration: animator.duration};
    const body = name => viewer.scene_tree.find(["nsdyn", "bodies", name]).object;
    animator.pause();
    for (const t of [0.25, 1.0, 1.5]) {
        animator.seek(t);
        found[t] = [body("falling").position.z, body("turning").quaternion.z, body("resting").position.x];
    }
    document.body.dataset.found = JSON.stringify(found);
    </script></body>"""
    page = tmp_path / "page.html"
    page.write_text(viewer.html(falling).replace("</body>", probe))
    document, _ = browse(page)
    found = json.loads(html.unescape(re.search('data-found="([^"]*)"', document).group(1)))
    assert found["playing"] and found["duration"] == 1.5
    for t in (0.25, 1.0, 1.5):
        s = min(t, 1.0)
        # Interpolated over at most 0.04 s between keys (at most g 0.04^2 / 8 = 2 mm); the last state stays.
        assert found[f"{t:g}"] == pytest.approx([5 - 0.5 * 9.81 * s**2, math.sin(s), 1.0], abs=2e-3)


def test_missing_browser_is_told(falling, tmp_path, monkeypatch):
    viewer.write_html(falling, tmp_path / "page.html", at=0.0)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="apt-get install chromium"):
        pictures.screenshot(tmp_path / "page.html", tmp_path / "page.png")
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
