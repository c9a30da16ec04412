"""How pages look: one axis of time, light and dark, size of text, parallel views, what is hidden, and without WebGL."""

import io
import re
import time
from functools import partial

import numpy as np
import pytest
from pages import RESTED
from test_viewer import contents

import nsdyn as nd
from nsdyn.view import browser, viewer

pytestmark = pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")

SIZE = (1280, 720)


@pytest.fixture(scope="module")
def sliding():
    return nd.simulate(nd.scenes.load("slide")(), 0.3, dt=1e-3)


@pytest.fixture
def opened(opened):
    """Function that opens the page of a recording at 0.1 s."""
    return partial(opened, size=SIZE, at="#t=0.1")


def reloaded(page):
    """Open it again in the same tab, with the same settings of the browser."""
    page.run("window.old = true")
    page.call("Page.reload")
    end = time.monotonic() + 60.0
    while not page.run("!window.old && (window.ready || String(window.failure ?? ''))"):
        assert time.monotonic() < end
    assert page.run("window.ready")


def press(page, name):
    page.run(f"document.querySelector('.tools .{name}').click()")


def brightness(page):
    """Mean over a picture, of 255."""
    from PIL import Image

    page.run("nsdyn.show(0.1)")
    page.run(RESTED)
    return float(np.asarray(Image.open(io.BytesIO(page.picture())).convert("L")).mean())


@pytest.mark.slow
def test_curves_and_scrubber_have_one_axis(opened, sliding):
    page = opened(sliding)
    for size in (SIZE, (1920, 1080), (390, 844)):
        page.resize(size)
        page.run(RESTED)
        for t in (0.0, 0.1, 0.3):
            places = page.run(
                f"(({{chart, timeline}}) => [chart.back.getBoundingClientRect().left + chart.x({t}),"
                f" timeline.canvas.getBoundingClientRect().left + timeline.x({t})])(nsdyn.panes[0])"
            )
            assert places[0] == places[1], size
        page.run("nsdyn.panes[0].inspector.body(1)")  # which takes room of the curves, or all of it
        assert page.run("nsdyn.panes[0].timeline.canvas.checkVisibility()"), size
        page.run("nsdyn.panes[0].inspector.clear()")


@pytest.mark.slow
def test_text_grows_with_the_window(opened, sliding):
    page = opened(sliding)
    sizes = []
    for size in ((390, 844), SIZE, (1920, 1080), (3840, 2160)):
        page.resize(size)
        page.run(RESTED)
        sizes.append(page.run("[parseFloat(getComputedStyle(document.body).fontSize), 13 * theme.unit]"))
    assert np.ravel(sizes) == pytest.approx(np.repeat([13, 13, 16.25, 26], 2), abs=0.1)


@pytest.mark.slow
def test_the_grid_is_seen_by_day_and_at_night(opened, sliding):
    from PIL import Image

    page = opened(sliding)
    for dark in (False, True):
        page.run(f"theme.set({str(dark).lower()})")
        brightness(page)  # drawn at rest
        picture = np.asarray(Image.open(io.BytesIO(page.picture())).convert("L"), dtype=float)
        ground = picture[330:450, 20:400]  # without bodies and shadows
        ink = np.percentile(ground, 0.5 if not dark else 99.5) - np.median(ground)
        assert abs(ink) > 8.0 and (ink > 0.0) == dark, dark  # levels of 255


def test_front_side_and_top_are_parallel(opened, sliding):
    """Edges along the view are points, to a pixel; from the first place they are not."""
    page = opened(sliding)
    centre = np.array(page.run("nsdyn.recordings[0].view.centre"))
    along = {"front": 1, "side": 0, "top": 2, "home": 1}
    for preset, axis in along.items():
        press(page, preset)
        page.run("nsdyn.show(0.1)")
        ends = np.tile(centre + np.array([0.3, 0.1, 0.2]), (2, 1))
        ends[1, axis] += 0.2
        x = page.run(f"{ends.tolist()}.map(p => nsdyn.panes[0].stage.project(p).slice(0, 2))")
        apart = float(np.linalg.norm(np.subtract(*x)))
        assert apart > 20 if preset == "home" else apart < 1.5, preset


def test_dots_behind_bodies_fade(opened, sliding):
    """Of the four corners of a box the one at the back is hidden; from above none is behind more than an edge."""
    page = opened(sliding)
    hidden = "nsdyn.panes[0].overlay.placed.map(({contact, hidden}) => [contact.point[0], contact.point[1], hidden])"
    page.run("nsdyn.show(0.1)")
    corners = page.run(hidden)
    eye = page.run("nsdyn.panes[0].stage.camera.position.toArray()")
    away = [np.hypot(x - eye[0], y + eye[2]) for x, y, _ in corners]
    assert [bool(h) for *_, h in corners] == [d == max(away) for d in away]
    press(page, "top")
    page.run("nsdyn.show(0.1)")
    assert [h for *_, h in page.run(hidden)] == [False] * 4


@pytest.mark.slow
def test_every_step_can_be_stepped_through(opened, sliding):
    """What friction takes in each step, of which a page of 30 states a second knows ten."""
    page = opened(sliding)
    assert page.run("nsdyn.dock.states.length") == 301
    press(page, "power")
    for k in (1, 2, 77):
        page.run(f"nsdyn.clock.seek({k - 1} * 1e-3)")
        page.run("nsdyn.dock.step(1, false)")
        taken = page.run("nsdyn.panes[0].plot.values('power', nsdyn.clock.t).find(row => row[0] === 'friction')[2]")
        # Differences of sums so far in single precision, of 2 J over 1 ms.
        assert taken == pytest.approx(-sliding.energy.friction[k - 1] / sliding.dt, rel=1e-3)
    assert contents(viewer.html(sliding, fps=30))[1]["t"].size == 10


def test_round_off_is_nothing(opened, sliding):
    page = opened(sliding)
    page.run("nsdyn.show(0.2)")
    assert 0.0 < abs(page.run("nsdyn.panes[0].plot.values('energy', 0.2).pop()[2]")) < 1e-12
    assert "by numerics 0 J" in page.run("document.querySelector('.values').textContent")
    shown = page.run(
        "[withUnit(2.8e-14, 'J', 2), withUnit(2.8e-7, 'J', 2), withUnit(-3e-14, 'J'), onAxis(1e-7, 1e-7),"
        " onAxis(-0.5, 0.5)]"
    )
    assert shown == ["0 J", "280.0 nJ", "−3·10⁻¹⁴ J", "10⁻⁷".replace("10", "1·10"), "−0.5"]


def test_angles_have_no_prefix(opened, sliding):
    """Radians, as the axes and tables have them, with all digits where they are small."""
    page = opened(sliding)
    shown = page.run(
        "[withUnit(3.788e-4, 'rad'), withUnit(-0.01234, 'rad/s'), withUnit(2e-5, 'rad'), withUnit(2e-5, 'm')]"
    )
    assert shown == ["3.788·10⁻⁴ rad", "−0.01234 rad/s", "2·10⁻⁵ rad", "20.00 µm"]


def test_motion_of_bodies(opened, sliding):
    page = opened(sliding)
    press(page, "motion")
    rows = page.run("nsdyn.panes[0].plot.values('motion', 0.1)")
    speed = float(np.linalg.norm(sliding.body("box").linear_velocity[100]))
    assert [row[0] for row in rows] == ["box speed", "box height"]
    assert [row[2] for row in rows] == pytest.approx([speed, 0.1], rel=1e-4)  # 15 bits
    low, high = page.run("nsdyn.panes[0].chart.lanes.map(({low, high}) => [low, high])[1]")
    assert low == 0.0 and 0.1 < high < 0.11  # it stays at its height, of which round-off is no picture


@pytest.mark.slow
def test_speeds_of_round_off_are_nothing_beside_others(opened):
    """The first body rests on the ground, the other falls: what is at play is its speed."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (0.2, 0.3, 0.1), 1.0, position=(0, 0, 0.05))
    scene.add_sphere("ball", 0.1, 1.0, position=(1, 0, 9))
    page = opened(nd.simulate(scene, 0.2, dt=5e-3))
    press(page, "motion")
    plays = page.run("nsdyn.panes[0].plot.values('motion', 0.1).filter(row => row[3] === 'm/s').map(row => row[4])")
    assert plays == pytest.approx([9.81 * 0.2] * 2, rel=1e-3)


@pytest.mark.slow
def test_the_clock_of_a_film_hides_no_legend(sliding, tmp_path, window):
    """Beside each other in a narrow window, where names and legends take two rows; nor where they take one."""
    sliding.to_html(tmp_path / "page.html", beside=sliding)
    for size in ((640, 360), (960, 540), (1280, 720)):
        window.open((tmp_path / "page.html").as_uri() + "#picture&film&curves=energy", size)
        top, bottom = window.run(
            "[document.getElementById('clock').getBoundingClientRect().top,"
            " Math.max(...[...document.querySelectorAll('.head')].map(head => head.getBoundingClientRect().bottom))]"
        )
        assert top >= bottom, size


@pytest.mark.slow
def test_scenes_without_visuals_have_no_choice(opened, sliding):
    assert opened(sliding).run("document.querySelector('.tools .collision')") is None


def test_without_webgl_the_curves_show(opened, sliding):
    broken = (
        "(get => { HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        " return kind.includes('webgl') ? null : get.call(this, kind, ...more); }; })"
        "(HTMLCanvasElement.prototype.getContext)"
    )
    page = opened(sliding)
    script = page.call("Page.addScriptToEvaluateOnNewDocument", source=broken)["identifier"]
    reloaded(page)
    page.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
    assert "draws no 3D picture" in page.run("document.querySelector('.view').textContent")
    page.run("nsdyn.show(0.2)")
    plot = page.run("document.querySelector('.curves .plot').getBoundingClientRect().height")
    assert plot > 0.4 * SIZE[1] and "friction took 1.4" in page.run("document.querySelector('.values').textContent")
    for button in ("power", "motion", "checks", "front", "contacts", "forces", "cones", "tree", "dark"):
        press(page, button)
    assert page.run("window.failure") is None


@pytest.mark.slow
def test_dark_as_the_system_is_or_as_one_asks(opened, sliding):
    page = opened(sliding, size=(640, 360))
    light = brightness(page)
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    try:
        dark = brightness(page)
        assert light > 190 and dark < 80
        page.call("Input.dispatchKeyEvent", type="keyDown", key="d")
        assert brightness(page) == pytest.approx(light, abs=0.5)
        press(page, "dark")
        assert brightness(page) == pytest.approx(dark, abs=0.5)
        assert page.run("document.querySelector('.tools .dark').getAttribute('aria-pressed')") == "true"
        reloaded(page)  # dark from the beginning
        assert brightness(page) == pytest.approx(dark, abs=0.5)
        page.run("history.replaceState = () => {}; location.hash = '#picture'")  # the page writes its time there
        reloaded(page)  # but pictures are for papers
        assert brightness(page) > 190
    finally:
        page.call("Emulation.setEmulatedMedia", features=[])


@pytest.mark.slow
def test_open_contacts_are_shown_if_one_asks(opened):
    page = opened(nd.simulate(nd.scenes.load("bounce")(), 0.48, dt=1e-3))
    page.run("nsdyn.show(nsdyn.dock.impacts[0].t + 0.002)")
    count = "[nsdyn.panes[0].overlay.counts[0], nsdyn.panes[0].overlay.placed.length]"
    contacts, dots = page.run(count)
    assert dots == page.run("nsdyn.panes[0].overlay.contacts.length") - contacts
    press(page, "open")
    page.run("nsdyn.show(nsdyn.clock.t)")
    assert page.run("nsdyn.panes[0].overlay.placed.length") == dots + contacts


@pytest.mark.slow
def test_motion_of_joints(opened):
    drive = {"cart_pole": np.array([3.0, 0.1])}
    run = nd.simulate(nd.scenes.load("cart_pole")(), 0.2, dt=1e-2, controller=lambda t, q, v: drive)
    page = opened(run)
    press(page, "motion")
    rows = {row[0]: row[2] for row in page.run("nsdyn.panes[0].plot.values('motion', 0.1)")}
    assert rows["pole angle"] == pytest.approx(run.joint("cart_pole/pole").position[10], rel=1e-4)
    assert {"cart position", "cart force", "pole torque"} <= rows.keys()
    units = page.run("nsdyn.panes[0].chart.lanes.map(lane => lane.unit)")
    assert {"angle [rad]", "torque [N·m]", "position [m]", "force [N]"} == set(units)
    page.run("nsdyn.panes[0].inspector.body(nsdyn.recordings[0].bodies.findIndex(b => b.joint?.name === 'pole'))")
    assert [row[0] for row in page.run("nsdyn.panes[0].plot.values('motion', 0.1)")] == ["pole angle", "pole torque"]


@pytest.mark.slow
def test_many_plots_have_more_room(opened):
    setup = nd.scenes.setup("gripper")
    page = opened(nd.simulate(setup.scene, 0.1, **setup.options(dt=1e-2)))
    height = "nsdyn.panes[0].chart.place.clientHeight"
    one = page.run(height)
    for kind in ("motion", "checks"):
        press(page, kind)
        assert page.run("nsdyn.panes[0].chart.lanes.length") == 3 and page.run(height) > 1.3 * one, kind
    press(page, "energy")
    assert page.run(height) == one


@pytest.fixture(scope="module")
def falling_row():
    return nd.simulate(nd.scenes.load("domino")(), 0.3, dt=2e-3)


@pytest.mark.slow
def test_of_many_bodies_those_that_move_most_have_names(opened, falling_row):
    page = opened(falling_row)
    press(page, "motion")
    rows = page.run("nsdyn.panes[0].plot.values('motion', 0.1).map(row => row.slice(0, 2))")
    names = {name for name, _ in rows[:6]}
    assert names > {f"domino{k}" for k in range(5)}  # that fall so far; the sixth moves by round-off, as 14 others do
    assert len(rows) == 7 and rows[6][0] == "and 14 others"
    for lane in page.run("nsdyn.panes[0].chart.lanes.map(lane => lane.lines.map(line => line.colour))"):
        light = [colour == rows[6][1] for colour in lane]
        assert light == sorted(light, reverse=True) and set(lane) <= {colour for _, colour in rows}  # behind the others
    assert page.run("document.querySelector('.values').textContent").endswith("and 14 others ")
    page.run("nsdyn.panes[0].inspector.body(15)")  # one of the others has its colour once it is picked
    assert [row[0] for row in page.run("nsdyn.panes[0].plot.values('motion', 0.1)")] == ["domino14 speed"]
    assert rows[6][1] not in page.run("nsdyn.panes[0].chart.lanes[0].lines[19].colour")


TWO_LINKS = """<robot name="r">
  <link name="base"/>
  <link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="hand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
  <joint name="weld" type="fixed"><parent link="arm"/><child link="hand"/><origin xyz="0.5 0 0"/></joint>
</robot>"""


@pytest.mark.slow
def test_a_joint_that_carries_several_links_has_one_curve(opened, tmp_path):
    (tmp_path / "r.urdf").write_text(TWO_LINKS)
    scene = nd.Scene()
    scene.add_urdf("r", tmp_path / "r.urdf")
    page = opened(nd.simulate(scene, 0.2, dt=1e-2))
    press(page, "motion")
    one = ["shoulder angle"]
    assert [row[0] for row in page.run("nsdyn.panes[0].plot.values('motion', 0.1)")] == one
    assert page.run("nsdyn.panes[0].chart.lanes.map(lane => lane.unit)") == ["angle [rad]"]  # nothing drives it
    page.run("nsdyn.panes[0].inspector.body(nsdyn.recordings[0].bodies.findIndex(b => b.name === 'r/hand'))")
    assert [row[0] for row in page.run("nsdyn.panes[0].plot.values('motion', 0.1)")] == one


@pytest.mark.slow
def test_nothing_is_written_over_the_curves(opened, falling_row):
    page = opened(falling_row)
    words = (
        "(kind => { const seen = [], draw = CanvasRenderingContext2D.prototype.fillText;"
        " CanvasRenderingContext2D.prototype.fillText = function (text) { seen.push(text); };"
        " nsdyn.panes[0].show(kind); CanvasRenderingContext2D.prototype.fillText = draw; return seen; })"
    )
    for kind in ("power", "checks", "motion"):
        said = [text for text in page.run(f"{words}('{kind}')") if re.search("[a-z]{4}", text)]
        assert all("[" in text or "round-off" in text for text in said), said  # on axes, and where there is no curve
    page.run("nsdyn.panes[0].show('checks')")
    entries = "Array.from(document.querySelectorAll('.values span'), s => [s.textContent.split(' ')[0], s.title])"
    assert dict(page.run(entries)) == {
        "residual": "of the contact problem",
        "certificate": "bound of the velocity's error",
        "penetration": "of shapes, by their gaps",
    }


@pytest.mark.slow
def test_a_lone_number_on_an_axis_is_that_of_its_line(opened, falling_row):
    page = opened(falling_row)
    words = (
        "(() => { const seen = [], draw = CanvasRenderingContext2D.prototype.fillText;"
        " CanvasRenderingContext2D.prototype.fillText = function (text) { seen.push(text); };"
        " const {chart} = nsdyn.panes[0], lanes = [{unit: 'm', low: 0.016, high: 0.025, lines: []}];"
        " chart.height = 40; chart.lanes = lanes; chart.drawLane(contextOf(chart.back), lanes[0]);"
        " CanvasRenderingContext2D.prototype.fillText = draw; return seen; })()"
    )
    assert "0.020" in page.run(words) or "0.02" in page.run(words)


@pytest.mark.slow
def test_more_than_two_recordings(opened):
    one, *others = [nd.simulate(nd.scenes.load("slide")(mu=mu), 0.1, dt=1e-2) for mu in (0.2, 0.35, 0.5)]
    page = opened(one, beside=others)
    names = page.run("Array.from(document.querySelectorAll('.heading'), h => h.firstChild.textContent)")
    assert names == ["mu=0.2", "mu=0.35", "mu=0.5"]
    boxes = page.run("nsdyn.panes.map(({root}) => root.getBoundingClientRect()).map(b => [b.left, b.right])")
    assert [round(x) for box in boxes for x in box] == [0, 425, 427, 853, 855, 1280]  # 2 px between them
    place = np.array(page.run("nsdyn.panes.map(p => p.stage.camera.position.toArray())"))
    assert np.ptp(place, axis=0).max() <= 1e-12  # each pane's controls write theirs anew, to round-off
    press(page, "overlay")
    dotted = "nsdyn.panes.map(p => p.chart.lanes[0].lines.filter(line => line.rim).length)"
    assert page.run(dotted) == [6, 6, 6]  # of two others each: kinetic, potential, friction


def test_a_film_has_curves_contacts_and_a_clock(opened, sliding):
    page = opened(sliding, size=(640, 360), at="#picture&film&curves=power")
    shown = "['.plot', '.values', '.scrubber', '.legend', '#clock', '.tools', '#transport', '#notes']"
    seen = page.run(f"{shown}.map(s => document.querySelector(s).checkVisibility())")
    assert seen == [True] * 5 + [False] * 3 and page.run("nsdyn.panes[0].kind") == "power"
    box = "(s => (b => [b.left, b.top, b.right, b.bottom])(document.querySelector(s).getBoundingClientRect()))"
    clock, view = page.run(f"['#clock', '.view'].map({box})")
    assert view[0] < clock[0] and view[1] < clock[1] and clock[2] <= view[2] and clock[3] <= view[3]
