"""Robots on pages as their files show them, or as their collision shapes."""

import io

import fuzz
import numpy as np
import pytest
from pages import RESTED

import nsdyn as nd
from nsdyn.scene.mesh_files import stl
from nsdyn.tools.array_text import from_text
from nsdyn.view import browser, looks, stage

# A red box of 0.1 x 0.2 x 0.3 m from a mesh file, in two places of which one mirrors it; a small ball collides.
URDF = """<robot name="r"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><mesh filename="box.stl"/></geometry><material><color rgba="1 0 0 1"/></material></visual>
<visual><geometry><mesh filename="box.stl" scale="-1 1 1"/></geometry><material><color rgba="1 0 0 1"/></material>
</visual><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<link name="tool"><visual><origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 0.1"/></geometry></visual></link>
<joint name="weld" type="fixed"><parent link="base"/><child link="tool"/></joint></robot>"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    (folder / "box.stl").write_bytes(fuzz.binary_stl())
    (folder / "r.urdf").write_text(URDF)
    scene = nd.Scene()
    scene.add_halfspace("ground", (0, 0, 1), -1.0)
    scene.add_urdf("r", folder / "r.urdf", base="free")
    return nd.simulate(scene, 0.1, dt=0.01)


def test_arrays_of_meshes_are_those_of_the_recording(run):
    arrays = looks.mesh_arrays(run.scene)
    (mesh,) = run.scene["meshes"]
    np.testing.assert_array_equal(arrays["meshes/position"], from_text(mesh["vertices"], "<f4", 3))
    assert arrays["meshes/position_ends"].tolist() == [24] and arrays["meshes/index_ends"].tolist() == [36]


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_a_window_shows_robots_as_a_page_does(tmp_path, window):
    (tmp_path / "box.stl").write_bytes(fuzz.binary_stl())
    (tmp_path / "r.urdf").write_text(URDF)
    scene = nd.Scene()
    scene.add_urdf("r", tmp_path / "r.urdf", base="free")
    live = nd.Live(nd.Stepper(scene, dt=0.01))
    try:
        (tmp_path / "empty.html").write_text("<script>window.ready = true</script>")
        window.open(tmp_path / "empty.html", (400, 300))
        window.call("Page.navigate", url=live.url)
        node = "viewer.scene_tree.find(['nsdyn', 'bodies', 'r.root_joint']).object"
        soon = f"typeof viewer !== 'undefined' && {node}.children.length === 4"
        window.run(f"new Promise(done => {{ const look = () => {soon} ? done() : setTimeout(look, 20); look(); }})")
        count = "let n = 0; o.traverse(x => { if (x.isMesh) n += x.geometry.attributes.position.count / 3; }); return n"
        shown = f"Array.from({node}.children).filter(o => o.visible).map(o => {{ {count}; }})"
        assert window.run(shown) == [12, 12, 12]  # triangles of a box each; the ball is hidden
    finally:
        live.close()


@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_visual_shapes_or_collision_shapes(run, opened):
    from PIL import Image

    page = opened(run, (1280, 720))

    def red():
        """Pixels as red as the box."""
        page.run("nsdyn.show(0)")
        rgb = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB")).astype(int)
        return int(((rgb[..., 0] > 90) & (rgb[..., 1] < 60) & (rgb[..., 2] < 60)).sum())

    assert red() > 3000
    # The corners of the box on the screen, from the middle of its mirrored half: what is clicked there is the link.
    middle = page.run("nsdyn.panes[0].stage.project([-0.05, 0.1, 0.15])")
    at = f"nsdyn.panes[0].stage.pick({middle[0]}, {middle[1]})"
    assert page.run(f"nsdyn.recordings[0].bodies[{at}].name") == "r/base"
    assert page.run("nsdyn.recordings[0].bodies.map(b => b.name)") == ["ground", "r/base", "r/tool"]
    normals = page.run(
        "(() => { let n; nsdyn.panes[0].stage.looks[0].traverse(o => { if (o.isMesh) "
        "n = Array.from(o.geometry.attributes.normal.array); }); return n; })()"
    )
    # Of a box each corner has the normal of its side: no edge is smoothed away.
    assert np.abs(np.reshape(normals, (-1, 3))).max(axis=1) == pytest.approx(1.0, abs=1e-6)
    button = "document.querySelector('.tools .collision')"
    assert page.run(f"{button}.getAttribute('aria-pressed')") == "false"
    page.run(f"{button}.click()")
    assert red() == 0
    page.run(f"{button}.click()")
    assert red() > 3000


@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_meshes_do_not_lie_in_their_own_shadows(run, opened):
    """Which would be stripes: what turns away from the light casts the shadows, as of all other bodies."""
    page = opened(run, (1280, 720))
    sides = page.run(
        "(() => { const out = []; nsdyn.panes[0].stage.looks[0].traverse(o => { if (o.isMesh && o.castShadow)"
        " out.push([o.material.side, o.material.shadowSide]); }); return out; })()"
    )
    assert sides == [page.run("[MeshCat.THREE.DoubleSide, MeshCat.THREE.BackSide]")]


def ball(share):
    """Corners and triangles of the upper share of a ball of 0.3 m, with many more triangles than pixels."""
    polar, round_ = np.meshgrid(np.linspace(0.0, share * np.pi, 90), np.linspace(0.0, 2.0 * np.pi, 181), indexing="ij")
    points = 0.3 * np.stack([np.sin(polar) * np.cos(round_), np.sin(polar) * np.sin(round_), np.cos(polar)], axis=2)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    size = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    corners = triangles[size > 1e-12].reshape(-1, 3)
    return corners, np.arange(len(corners)).reshape(-1, 3)


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
@pytest.mark.parametrize("share", [pytest.param(1.0, id="solid", marks=pytest.mark.slow), pytest.param(0.5, id="open")])
def test_films_show_meshes_as_fine_as_pixels(share, tmp_path, window):
    """With a fraction of the triangles the same picture; what is open is drawn from behind too."""
    from PIL import Image

    (tmp_path / "box.stl").write_bytes(stl.binary(*ball(share)))
    turned = '<visual><origin rpy="-2 0 0"/>'  # what is open shows its inside
    (tmp_path / "r.urdf").write_text(
        URDF.replace("<visual>", turned, 1).replace(' scale="-1 1 1"', ' scale="1e-3 1e-3 1e-3"')
    )
    scene = nd.Scene()
    scene.add_halfspace("ground", (0, 0, 1), -1.0)
    scene.add_urdf("r", tmp_path / "r.urdf", base="free")
    nd.simulate(scene, 0.02, dt=0.01).to_html(tmp_path / "page.html")
    pictures, counts = [], []
    for more in ("", "&film"):
        window.open((tmp_path / "page.html").as_uri() + "#picture" + more, (240, 136))
        window.run("nsdyn.show(0.01)")
        pictures.append(np.asarray(Image.open(io.BytesIO(window.picture())).convert("RGB")).astype(int))
        counts.append(window.run("nsdyn.panes[0].stage.meshes[0].geometry.attributes.position.count / 3"))
    assert counts[0] > 10_000 and 100 < counts[1] < 0.35 * counts[0]
    side = window.run("nsdyn.panes[0].stage.meshes[0].material.side")
    assert side == window.run(f"MeshCat.THREE.{'FrontSide' if share == 1.0 else 'DoubleSide'}")
    red = [p[..., 0] - p[..., 1] > 60 for p in pictures]
    inner = red[0].copy()
    for axis in (0, 1):
        inner &= np.roll(red[0], 1, axis) & np.roll(red[0], -1, axis)
    outline = red[0].sum() - inner.sum()
    assert red[0].sum() > 15 * outline > 1500 and (red[0] != red[1]).sum() < 0.35 * outline
    # Less than a pixel along outlines, of the ball and of its shadow; what is open has specks of its own shadow.
    least = 24 if share == 1.0 else 60
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > least).sum() < 0.75 * 2 * outline


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_films_leave_nothing_out(tmp_path, window):
    """Drawn is only the rectangle around bodies and their shadows, and the picture is that of the whole."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_halfspace("wall", (-1, 0, 0), -1.0)
    for k in range(3):
        place, size = (0.5 * k - 0.5, 0.1 * k, 1.0 + 0.3 * k), (0.1 + 0.1 * k, 0.1, 0.2)
        scene.add_box(f"box{k}", size, 1.0, position=place, linear_velocity=(1, 0.5, 0), angular_velocity=(2, 0, 3))
    nd.simulate(scene, 0.8, dt=0.01).to_html(tmp_path / "page.html")
    window.open((tmp_path / "page.html").as_uri() + "#picture&film", (640, 360))
    stage = "nsdyn.panes[0].stage"
    for t in (0.0, 0.3, 0.6, 0.8):
        pictures = []
        for cut in ("delete FILM.cut", "FILM.cut = () => FILM.stage.viewer.renderer.setScissorTest(false)"):
            window.run(cut.replace("FILM", f"{stage}.film") + f"; {stage}.places = null; nsdyn.show({t})")
            pictures.append(window.picture())
        assert pictures[0] == pictures[1]
    window.run(f"delete {stage}.film.cut; {stage}.places = null; nsdyn.show(0.6)")
    *_, wide, high = window.run(f"{stage}.viewer.renderer.getScissor(new MeshCat.THREE.Vector4()).toArray()")
    assert wide * high < 0.7 * 640 * 360


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_meshes_are_whole_where_nothing_moves(tmp_path, window):
    """Coarse while pictures are late, whole again with the first of a scene at rest."""
    (tmp_path / "box.stl").write_bytes(stl.binary(*ball(1.0)))
    (tmp_path / "r.urdf").write_text(URDF)
    scene = nd.Scene()
    scene.add_urdf("r", tmp_path / "r.urdf", base="free")
    nd.simulate(scene, 0.02, dt=0.01).to_html(tmp_path / "page.html")
    window.open((tmp_path / "page.html").as_uri() + "#t=0", (480, 270))
    shown = "[m.geometry.attributes.position.count / 3, m.material.side === MeshCat.THREE.DoubleSide]"
    (late, _), (later, _), (whole, both) = (
        window.run(f"({draw}, (m => {shown})(nsdyn.panes[0].stage.meshes[0]))")
        for draw in ("nsdyn.panes[0].stage.draw(1)", "nsdyn.panes[0].stage.draw(2)", "nsdyn.show(0.01)")
    )
    assert 100 < later < late < 0.5 * whole and whole > 10_000 and both


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_all_buttons_there_can_be_have_one_row(run, opened):
    page = opened(run, (1280, 720), beside=run)
    for size in ((1280, 720), (1280, 1024), (1920, 1080)):
        page.resize(size)
        page.run(RESTED)
        tops = page.run("Array.from(document.querySelectorAll('#tools button'), b => b.getBoundingClientRect().top)")
        assert len(tops) == 17 and max(tops) - min(tops) < 1, size
        assert page.run("document.getElementById('dock').clientHeight < 50 * innerWidth / 1280"), size


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_links_that_have_no_visual_shape_show_their_collision_shape(tmp_path, opened):
    arm = """<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
    <joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><origin xyz="1 0 0"/>
    </joint></robot>"""
    (tmp_path / "box.stl").write_bytes(fuzz.binary_stl())
    (tmp_path / "r.urdf").write_text(URDF.replace("</robot>", arm))
    scene = nd.Scene()
    scene.add_urdf("r", tmp_path / "r.urdf", base="free")
    page = opened(nd.simulate(scene, 0.02, dt=0.01), (640, 360))
    shown = "nsdyn.panes[0].stage.shapes.map(node => node.visible)"
    assert page.run(shown) == [False, True]  # of the base, which has a visual shape, and of the arm
    page.run("document.querySelector('.tools .collision').click()")
    assert page.run(shown) == [True, True]


def test_camera_is_near_to_a_mesh_that_is_far_from_its_origin(tmp_path):
    """A tetrahedron a metre away: what a box about its origin would hold is ten times as large."""
    corners = np.array([[1.0, 0, 0], [1.1, 0, 0], [1, 0.1, 0], [1, 0, 0.1]])
    lines = [*(f"v {x} {y} {z}" for x, y, z in corners), "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "t.obj").write_text("\n".join(lines))
    link = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    seen = '<visual><geometry><mesh filename="t.obj"/></geometry></visual>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="base">{link}{seen}</link></robot>')
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_urdf("r", tmp_path / "r.urdf", base="free")
    view = stage.View([nd.simulate(scene, 0.02, dt=0.01)])
    assert view.radius < 0.09
    np.testing.assert_allclose(view.centre, [1.05, 0.05, 0.05], atol=1e-6)
