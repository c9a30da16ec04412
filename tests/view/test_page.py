"""Pages in a real browser: what they show, and that it is what the recording says."""

import math
import re

import numpy as np
import pytest
import recordings
from pages import RESTED, SIZE
from test_viewer import contents

import nsdyn as nd
from nsdyn.view import browser, marks, viewer

needs_chromium = pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
pytestmark = needs_chromium


@pytest.fixture(scope="module")
def falling():
    return recordings.falling()


@pytest.fixture(scope="module")
def sliding():
    """A box that slides to rest in 0.17 s and a ball that falls on the ground at 0.2 s and bounces."""
    scene = nd.Scene(name="sliding")
    scene.add_halfspace("ground", material=nd.Material(mu=0.6))
    scene.add_box("box", (0.2, 0.2, 0.2), 2.0, position=(0, 0, 0.1), linear_velocity=(1, 0, 0))
    scene.add_sphere(
        "ball", 0.1, 1.0, position=(-0.6, 0, 0.1 + 0.5 * 9.81 * 0.2**2), material=nd.Material(restitution=0.5)
    )
    scene.set_pair("ball", "ground", restitution=0.5)
    return nd.simulate(scene, 0.5, dt=1e-3)


def text(page, selector):
    return page.run(f"document.querySelector({selector!r}).textContent")


def table(page):
    """What the panel of the picked body or contact says."""
    rows = "document.querySelectorAll('.inspector tr')"
    return dict(page.run(f"Array.from({rows}, row => Array.from(row.children, cell => cell.textContent))"))


PREFIXES = {"": 1.0, "m": 1e-3, "µ": 1e-6, "n": 1e-9, "k": 1e3}


def number(shown, unit):
    """Value of "9.810 mN": in the unit, without its prefix."""
    value, prefixed = shown.replace("−", "-").split(" ")
    assert prefixed.endswith(unit)
    return float(value) * PREFIXES[prefixed.removesuffix(unit)]


def press(page, key, **more):
    page.call("Input.dispatchKeyEvent", type="keyDown", key=key, **more)
    page.call("Input.dispatchKeyEvent", type="keyUp", key=key, **more)


def click(page, x, y):
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def place(page, selector):
    """Left, top, width and height of an element in the window."""
    box = f"document.querySelector({selector!r}).getBoundingClientRect()"
    return page.run(f"(box => [box.left, box.top, box.width, box.height])({box})")


def click_on(page, selector):
    left, top, width, height = place(page, selector)
    click(page, left + width / 2, top + height / 2)


def show(page, t):
    page.run(f"nsdyn.show({float(t)!r})")


def now(page):
    return page.run("nsdyn.clock.t")


def test_buttons_and_keys_move_the_time(opened, falling):
    page = opened(falling)
    states = page.run("Array.from(nsdyn.recordings[0].t)")
    assert text(page, "#clock").startswith("0.00 s") and len(states) == 101  # all of them
    click_on(page, "#forward")
    assert now(page) == states[1]
    press(page, "ArrowRight")
    assert now(page) == states[2]
    press(page, "ArrowLeft")
    click_on(page, "#back")
    assert now(page) == 0.0
    press(page, "End")
    assert now(page) == 1.0 and text(page, "#clock").startswith("1.00 s")
    press(page, "Home")
    assert now(page) == 0.0
    click_on(page, "#last")
    assert now(page) == 1.0
    click_on(page, "#first")
    assert now(page) == 0.0


def test_plays_at_its_speed_and_stops_at_the_end(opened, falling):
    page = opened(falling)
    page.run("nsdyn.dock.setSpeed(1e-4)")
    assert page.run("nsdyn.clock.speed") == 0.001 and text(page, "#speed output") == "0.001 ×"
    page.run("nsdyn.dock.setSpeed(0.1)")
    press(page, " ")
    assert page.run("nsdyn.clock.playing")
    # Times of pictures, with which the clock goes.
    between = page.run(
        "new Promise(done => requestAnimationFrame(() => { const {t, last} = nsdyn.clock; const look = () =>"
        " nsdyn.clock.last > last + 100 ? done([nsdyn.clock.t - t, nsdyn.clock.last - last]) : setTimeout(look, 10);"
        " look(); }))"
    )
    assert between[0] == pytest.approx(0.1 * between[1] / 1000, rel=1e-9) and between[0] > 0.0
    press(page, " ")
    assert not page.run("nsdyn.clock.playing")
    page.run("nsdyn.dock.setSpeed(7)")
    assert page.run("nsdyn.clock.speed") == 2.0 and text(page, "#speed output") == "2 ×"
    page.run("(nsdyn.clock.seek(0.9), nsdyn.clock.play())")
    page.run("new Promise(done => { const look = () => nsdyn.clock.playing ? setTimeout(look, 10) : done(); look(); })")
    assert now(page) == 1.0
    page.run("nsdyn.dock.setSpeed(0.1)")
    click_on(page, "#play")  # from the beginning again
    assert page.run("nsdyn.clock.playing") and now(page) < 1.0


def test_bodies_are_where_the_cursor_is(opened, falling):
    page = opened(falling)
    for t in (0.25, 0.6, 1.0):
        show(page, t)
        z, turn = page.run(
            "[0, 2].map(k => nsdyn.panes[0].stage.frames[k]).map((f, k) => [f.position.z, f.quaternion.z][k])"
        )
        # Interpolated over at most 0.04 s between keys: off by at most g 0.04² / 8 = 2 mm.
        assert (z, turn) == pytest.approx((5 - 0.5 * 9.81 * t**2, math.sin(t)), abs=2e-3)
        assert page.run("(c => c.x(nsdyn.clock.t) === c.x(c.now))(nsdyn.panes[0].chart)")
    # The pointer in the plot and on the scrubber.
    left, top, _, height = place(page, ".curves .plot")
    middle = page.run("nsdyn.panes[0].chart.x(0.5)")
    click(page, left + middle, top + height / 2)
    assert now(page) == pytest.approx(0.5, abs=1e-3)
    left, top, _, height = place(page, ".scrubber")
    click(page, left + page.run("nsdyn.panes[0].timeline.x(0.25)"), top + height / 2)
    assert now(page) == pytest.approx(0.25, abs=1e-3)  # half a pixel
    assert page.run("nsdyn.panes[0].chart.now") == now(page)


@pytest.mark.slow
def test_camera_stays_above_the_ground(opened, falling):
    page = opened(falling)
    page.run("(s => { s.camera.position.set(3, -2, 3); nsdyn.show(0.5); })(nsdyn.panes[0].stage)")
    assert page.run("nsdyn.panes[0].stage.camera.position.y") > 0.0
    left, top, _, _ = place(page, ".view")
    drag = {"button": "left", "buttons": 1}
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=left + 500, y=top + 300, **drag)
    for y in range(280, 20, -20):
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=left + 500, y=top + y, **drag)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=left + 500, y=top + 20, button="left")
    show(page, 0.5)
    assert page.run("nsdyn.panes[0].stage.moved")
    assert page.run("nsdyn.panes[0].stage.camera.position.y") > 0.0


def test_names_are_text(opened, falling):
    page = opened(falling)
    page.run("nsdyn.panes[0].inspector.body(nsdyn.recordings[0].bodies.findIndex(b => b.name.includes('resting')))")
    assert text(page, ".inspector h2") == "<i>resting" and page.run("document.querySelector('i b, h2 i')") is None
    assert text(page, ".heading").startswith("<three> & more")


def pixels(page, condition):
    """How many pixels of the canvas over the 3D part have a colour, a condition on r, g, b, a in JavaScript."""
    return page.run(
        "(c => { const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;"
        f"for (let k = 0; k < d.length; k += 4) {{ const [r, g, b, a] = d.subarray(k, k + 4); if ({condition}) n++; }}"
        "return n; })(document.querySelector('.view > canvas'))"
    )


def test_camera_follows_and_bodies_leave_a_trail(opened, falling):
    page = opened(falling)
    page.run("nsdyn.panes[0].inspector.body(nsdyn.recordings[0].bodies.findIndex(b => b.name === 'falling'))")
    before = page.run("(s => [s.camera.position.y, s.project(s.origin(0)).slice(0, 2)])(nsdyn.panes[0].stage)")
    click_on(page, ".inspector .follow")
    click_on(page, ".inspector .trail")
    show(page, 0.6)
    after = page.run("(s => [s.camera.position.y, s.project(s.origin(0)).slice(0, 2)])(nsdyn.panes[0].stage)")
    assert after[0] - before[0] == pytest.approx(-0.5 * 9.81 * 0.36, abs=2e-3)  # as the body between keys
    assert after[1] == pytest.approx(before[1], abs=0.5)  # pixels
    purple = "Math.abs(r - 123) < 12 && Math.abs(g - 50) < 12 && Math.abs(b - 148) < 12 && a > 100"
    assert pixels(page, purple) > 20


@pytest.mark.slow
def test_all_that_moves_is_in_the_picture_of_every_window(opened, falling):
    page = opened(falling)
    ball = page.run("Array.from(nsdyn.recordings[0].arrays.outline)")
    points, r = np.split(np.reshape(ball, (-1, 4)), [3], axis=1)
    for size in (SIZE, (420, 900), (1600, 500)):
        page.resize(size)
        page.run(RESTED)
        for preset in ("home", "front", "side", "top"):
            page.run(f"(document.querySelector('.{preset}').click(), nsdyn.show(0))")
            width, height, slope, shown = page.run(
                f"(s => [s.width, s.height, s.slope, {points.tolist()}.map(p => s.project(p))])(nsdyn.panes[0].stage)"
            )
            assert width == size[0]
            x, y, depth = np.array(shown).T
            pixels = r[:, 0] * height / (2 * slope * depth)
            half = np.array([width, height]) / 2
            reach = (np.abs(np.column_stack([x, y]) - half) + pixels[:, None]) / half
            assert 0.8 < reach.max() < 1.0, (size, preset)  # all in it, and it is not empty


@pytest.mark.slow
def test_forces_at_the_edge_of_their_cone_are_red(opened, sliding):
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1))
    resting = nd.simulate(scene, 0.1, dt=1e-2)
    drawn = {}
    for trajectory in (resting, sliding):
        page = opened(trajectory)
        click_on(page, ".tools .cones")
        show(page, 0.1)
        drawn[trajectory] = [
            pixels(page, "r > 180 && g < 60 && b < 90 && a > 200"),  # red
            pixels(page, "r < 60 && g < 70 && b < 80 && a > 200"),  # dark
        ]
    assert drawn[sliding][0] > 20 and drawn[sliding][1] == 0
    assert drawn[resting][0] == 0 and drawn[resting][1] > 20


def test_energies_are_those_of_the_ledger_and_their_sum_is_flat(opened, sliding):
    page = opened(sliding)
    e, k = sliding.energy, 100
    show(page, sliding.t[k])
    cells = dict(page.run("nsdyn.panes[0].ledger.values('energy', nsdyn.clock.t).map(([name, , x]) => [name, x])"))
    expected = {
        "kinetic": e.kinetic[k],
        "potential": e.potential[k] - e.potential.min(),
        "friction took": -e.friction[:k].sum(),
    }
    for name, value in expected.items():
        assert cells[name] == pytest.approx(value, rel=1e-6)  # single precision
    assert number(re.search(r"friction took (\S+ m?J)", text(page, ".values"))[1], "J") == pytest.approx(
        expected["friction took"],
        rel=1e-3,  # four digits
    )
    top, start = page.run("(l => [Array.from(l.stack().pop()), l.expected()[0]])(nsdyn.panes[0].ledger)")
    numerics = np.concatenate([[0.0], np.cumsum(e.integration + e.projection + e.defect)])
    np.testing.assert_allclose(top - numerics, start, rtol=1e-6)  # single precision
    show(page, 0.5)
    lost = e.total[0] - e.total[-1]
    cells = dict(page.run("nsdyn.panes[0].ledger.values('energy', nsdyn.clock.t).map(([name, , x]) => [name, x])"))
    assert cells["friction took"] + cells["impacts took"] == pytest.approx(lost + numerics[-1], rel=1e-5)


def test_power_is_what_each_step_took(opened, sliding):
    page = opened(sliding)
    assert page.run("getComputedStyle(document.querySelector('.tools')).display") == "flex"
    click_on(page, ".power")
    k = 101
    show(page, sliding.t[k])
    cells = dict(page.run("nsdyn.panes[0].ledger.values('power', nsdyn.clock.t).map(([name, , x]) => [name, x])"))
    # The difference of sums so far in single precision, over 1 ms.
    assert cells["friction"] == pytest.approx(-sliding.energy.friction[k - 1] / sliding.dt, rel=1e-2)
    # The impact of the ball, of ½ m (1 - e²) v² = 1.47 J in a millisecond, is cut.
    assert "peaks up to 1.4" in text(page, ".values")


@pytest.mark.slow
def test_checks_are_those_of_the_steps(opened, sliding):
    page = opened(sliding)
    click_on(page, ".checks")
    k = 77
    show(page, sliding.t[k])
    cells = page.run("nsdyn.panes[0].ledger.values('checks', nsdyn.clock.t).map(row => row[2])")
    penetration = max(0.0, -sliding.contacts(k).gap.min())
    expected = (sliding.solver.residual[k - 1], sliding.gauss.bound[k - 1], penetration)
    assert cells == pytest.approx(expected, rel=1e-6, abs=0)
    assert page.run("nsdyn.panes[0].chart.lanes.map(lane => lane.log)") == [True] * 3
    assert "penetration" in text(page, ".curves .values")
    # What one step has and the next has not is no comb: all strokes are level, and at no value below the axis.
    page.run(
        "(window.strokes = [], window.pen = null, window.faked = {moveTo: (x, y) => { pen = y; },"
        " lineTo: (x, y) => strokes.push([pen, y])},"
        " nsdyn.panes[0].chart.trace(faked, nsdyn.panes[0].chart.lanes[1], nsdyn.panes[0].ledger.curve('bound')))"
    )
    strokes, low = np.array(page.run("strokes")), page.run("nsdyn.panes[0].chart.lanes[1].low")
    np.testing.assert_array_equal(strokes[:, 0], strokes[:, 1])
    assert len(strokes) == (sliding.gauss.bound.astype("f4") >= low).sum()


def test_impacts_are_marked_and_jumped_to(opened, sliding):
    found = marks.find(sliding)
    # The ball, at sqrt(2 g 0.196 m); the contact of the box, which is there from the beginning, is none.
    assert sliding.t[found.step] == pytest.approx([0.2, 0.4], abs=2e-3)
    assert found.speed == pytest.approx([1.962, 0.981], rel=1e-2)
    page = opened(sliding)
    press(page, "ArrowRight", modifiers=8)  # shift
    assert now(page) == sliding.t[found.step[0]]
    assert "ground – ball" in page.run("nsdyn.dock.impacts[0].text")
    assert page.run("nsdyn.recordings[0].t.includes(nsdyn.clock.t)")  # an impact is a state that is shown
    assert page.run("nsdyn.panes[0].overlay.contacts.length") == len(sliding.contacts(int(found.step[0])))
    show(page, 0)
    left, top, _, height = place(page, ".scrubber")
    click(page, left + page.run("nsdyn.panes[0].timeline.x(nsdyn.dock.impacts[1].t)") + 2, top + height / 2)
    assert now(page) == sliding.t[found.step[1]]


@pytest.mark.slow
def test_contacts_are_counted_and_where_they_are(opened, sliding):
    page = opened(sliding)
    for t in (0.1, 0.3):
        show(page, t)
        frame = page.run("(r => r.t[r.frame(nsdyn.clock.t)])(nsdyn.recordings[0])")
        contacts = sliding.contacts(round(frame / sliding.dt))
        click_on(page, ".tools .open")
        for name in ("stick", "slip", "open"):
            assert text(page, f".legend .{name}") == f"{contacts.status_names.count(name)} {name}"
    slip, stick = (sliding.contacts(k).status_names[:4] for k in (100, 300))
    assert slip == ["slip"] * 4 and stick == ["stick"] * 4
    shown = page.run("nsdyn.panes[0].overlay.contacts.map(c => Array.from(c.point))")
    np.testing.assert_allclose(np.sort(shown, axis=0), np.sort(contacts.point, axis=0), rtol=0, atol=1e-5)


def test_a_body_is_picked_where_it_is_seen(opened, sliding):
    page = opened(sliding)
    k = 100
    show(page, sliding.t[k])
    left, top, _, _ = place(page, ".view")
    x, y, _ = page.run("(s => s.project(s.origin(0)))(nsdyn.panes[0].stage)")
    click(page, left + x, top + y)
    assert text(page, ".inspector h2") == "box"
    shown = table(page)
    speed = np.linalg.norm(sliding.body("box").linear_velocity[k])
    assert shown["mass"] == "2 kg"
    assert number(shown["speed"], "m/s") == pytest.approx(speed, rel=1e-3)  # four digits
    assert number(shown["kinetic energy"], "J") == pytest.approx(speed**2, rel=1e-3)  # ½ m v², m = 2 kg
    assert number(shown["potential energy"], "J") == pytest.approx(2 * 9.81 * 0.1, rel=1e-3)
    force = np.linalg.norm(sliding.force("box")[k - 1])
    assert number(shown["contact force"], "N") == pytest.approx(force, rel=1e-3)
    assert shown["carried by"] == "4 contacts"
    labels = page.run("Array.from(document.querySelectorAll('.inspector .plot'), plot => plot.dataset.label)")
    assert labels == ["height", "speed", "normal", "friction"]
    speeds = page.run("(p => [p.times, p.values])(nsdyn.panes[0].inspector.plots[1])")
    rows = np.round(np.array(speeds[0]) / sliding.dt).astype(int)
    wanted = np.linalg.norm(sliding.body("box").linear_velocity[rows], axis=1)
    np.testing.assert_allclose(speeds[1], wanted, rtol=1e-4, atol=1e-9)  # 15 bits
    times, loads = page.run("(p => [p.times, p.values])(nsdyn.panes[0].inspector.plots[2])")
    rows = np.round(np.array(times) / sliding.dt).astype(int)
    assert times[0] > 0.0  # no step ends at the first state
    np.testing.assert_allclose(loads, [sliding.force("box")[r - 1, 2] for r in rows], rtol=1e-4)
    # It slides until v/(mu g) < 0.19 s, and stands without friction then, to the solver's 1e-8 m/s of 0.005.
    drags = np.array(page.run("(p => p.values)(nsdyn.panes[0].inspector.plots[3])"))
    drag, t = sliding.contacts(1).mu[0] * 2 * 9.81, rows * sliding.dt
    np.testing.assert_allclose(drags[t < 0.16], drag, rtol=1e-3)
    assert (t > 0.19).any() and (drags[t > 0.19] < 1e-5 * drag).all()
    show(page, 0.45)
    assert number(table(page)["speed"], "m/s") == pytest.approx(0.0, abs=1e-6)
    # The ground is fixed, the sky nothing.
    click(page, left + 60, top + place(page, ".view")[3] - 80)
    assert text(page, ".inspector h2") == "ground" and "fixed" in text(page, ".inspector p")
    click(page, left + 500, top + 4)
    assert not page.run("document.querySelector('.inspector').classList.contains('shown')")


def test_a_contact_is_picked_where_it_is_seen(opened, sliding):
    page = opened(sliding)
    k = 100
    show(page, sliding.t[k])
    left, top, _, _ = place(page, ".view")
    point, (x, y, _) = page.run("(p => [Array.from(p.contact.point), p.at])(nsdyn.panes[0].overlay.placed[0])")
    click(page, left + x, top + y)
    assert text(page, ".inspector h2") == "ground → box"
    contacts = sliding.contacts(k)
    j = int(np.argmin(np.linalg.norm(contacts.point - point, axis=1)))
    shown = table(page)
    assert shown["state"] == "slip, at the edge" and shown["friction / (μ normal)"] == "1.000"
    assert number(shown["r_N"], "N·s") == pytest.approx(contacts.impulse[j, 0], rel=1e-3)
    assert number(shown["|r_T|"], "N·s") == pytest.approx(np.hypot(*contacts.impulse[j, 1:]), rel=1e-3)
    for force, part in (("normal force", contacts.impulse[j, 0]), ("friction", np.hypot(*contacts.impulse[j, 1:]))):
        assert number(shown[force], "N") == pytest.approx(part / sliding.dt, rel=1e-3)
    assert (shown["gap"], shown["u_N"]) == ("0 m", "0 m/s")  # round-off, which is recorded: 1e-18 m
    assert number(shown["|u_T|"], "m/s") == pytest.approx(np.hypot(*contacts.u[j, 1:]), rel=1e-3)
    assert float(shown["μ"]) == pytest.approx(contacts.mu[j], rel=1e-3)
    before = [sliding.contacts(step) for step in range(1, k + 1)]
    taken = -sum(
        w
        for c in before
        for w, key, body in zip(c.work_friction + c.work_normal, c.key, c.body2, strict=True)
        if key == contacts.key[j] and body == "box"
    )
    assert number(shown["dissipated"], "J") == pytest.approx(taken, rel=1e-3)
    show(page, 0)  # no step ends here
    assert table(page)["state"] == "apart"


@pytest.mark.slow
def test_space_presses_the_button_that_has_the_focus(opened, sliding):
    page = opened(sliding)
    page.run("nsdyn.dock.setSpeed(0.001)")  # it is not at its end before it is asked, however slow the machine
    space = {"code": "Space", "windowsVirtualKeyCode": 32, "text": " "}
    forces = "document.querySelector('.tools .forces')"
    page.run(f"{forces}.focus()")
    press(page, " ", **space)
    assert page.run(f"{forces}.getAttribute('aria-pressed')") == "true" and not page.run("nsdyn.clock.playing")
    page.run("document.activeElement.blur()")
    for other in ("document.body", "document.querySelector('.scrubber')", "document.querySelector('#speed input')"):
        page.run(f"{other}.focus()")
        press(page, " ", **space)
        assert page.run("nsdyn.clock.playing"), other
        press(page, " ", **space)
        assert not page.run("nsdyn.clock.playing"), other
    # What the pointer presses does not take the focus: space goes on playing.
    page.run("document.activeElement.blur()")
    click_on(page, ".tools .forces")
    press(page, " ", **space)
    assert page.run("nsdyn.clock.playing") and page.run(f"{forces}.getAttribute('aria-pressed')") == "false"


@pytest.mark.slow
def test_keys_are_listed(opened, sliding):
    page = opened(sliding)
    shown = "document.getElementById('help').open"
    escape = {"code": "Escape", "windowsVirtualKeyCode": 27}
    press(page, "?")
    assert page.run(shown)
    for key in ("space", "←", "Shift", "Home", "?"):
        assert page.run(f"Array.from(document.querySelectorAll('#help kbd'), k => k.textContent).includes('{key}')")
    assert "Auto(tol=1e-08" in text(page, "#help") and "recorded states" in text(page, "#help")
    press(page, "End")  # not while it is read
    assert now(page) == 0.0
    press(page, "Escape", **escape)
    assert not page.run(shown)
    click_on(page, ".tools span:last-child button:last-child")
    assert page.run(shown)
    left, top, width, height = place(page, "#help")
    click(page, left + width / 2, top + height - 40)  # to mark what it says
    assert page.run(shown)
    click(page, left / 2, top + height / 2)
    assert not page.run(shown)
    press(page, "?")
    click_on(page, "#help .close")
    assert not page.run(shown)
    press(page, "?")
    press(page, "?")
    assert not page.run(shown)


def test_the_scrubber_is_a_slider(opened, sliding):
    page = opened(sliding)
    show(page, 0.2)
    names = ("role", "aria-label", "aria-valuemin", "aria-valuemax", "aria-valuenow", "aria-valuetext")
    values = page.run(f"{list(names)}.map(name => document.querySelector('.scrubber').getAttribute(name))")
    assert values == ["slider", "time", "0", "0.5", "0.2", "0.200 s of 0.5 s"]
    press(page, "End")
    assert page.run("document.querySelector('.scrubber').getAttribute('aria-valuetext')") == "0.500 s of 0.5 s"


def test_nothing_is_loaded_and_nothing_goes_wrong(opened, sliding, tmp_path):
    page = opened(sliding)

    def requests_and_exceptions():
        requests = [
            e["params"]["request"]["url"] for e in page.events if e.get("method") == "Network.requestWillBeSent"
        ]
        failed = [e for e in page.events if e.get("method") == "Runtime.exceptionThrown"]
        return [url for url in requests if not url.startswith(("file:", "blob:", "data:"))], failed

    for button in ("forces", "cones", "power", "checks", "top", "tree"):
        click_on(page, f".tools .{button}")
    show(page, 0.3)
    assert requests_and_exceptions() == ([], [])
    # The same look at a page that does load something, so that nothing means something.
    control = tmp_path / "control.html"
    control.write_text(
        "<img src='http://elsewhere.invalid/x.png'><script>window.ready = true; throw new Error('oops')</script>"
    )
    page.open(control, SIZE)
    page.run("new Promise(done => setTimeout(done, 300))")
    requests, failed = requests_and_exceptions()
    assert requests == ["http://elsewhere.invalid/x.png"] and len(failed) == 1


REST = "new Promise(done => setTimeout(done, 400))"


@pytest.mark.slow
def test_the_address_points_at_the_time_shown(opened, sliding, window):
    page = opened(sliding, at="")
    # It plays when it opens.
    page.run("new Promise(done => { const look = () => nsdyn.clock.t > 0 ? done() : setTimeout(look, 10); look(); })")
    page.run("nsdyn.clock.pause()")
    # Counts what is written to the address while it plays, is scrubbed and rests.
    page.run(
        "(() => { const write = history.replaceState; window.written = [];"
        " history.replaceState = function (...given) { written.push(given[2]); return write.apply(this, given); } })()"
    )
    page.run("nsdyn.clock.speed = 0.01, nsdyn.clock.play()")  # it is not at its end, however slow the machine
    page.run(REST)
    assert page.run("[nsdyn.clock.playing, written.length, location.hash]") == [True, 0, ""]
    page.run("for (let k = 0; k <= 100; k++) { nsdyn.clock.pause(); nsdyn.clock.seek(0.003 * k); }")
    page.run(REST)
    assert page.run("written.length") == 1 and page.run("location.hash") == "#t=0.3"
    press(page, "ArrowRight", modifiers=8)  # to an impact
    page.run(REST)
    address, t = page.run("[location.href, nsdyn.clock.t]")
    assert address.startswith("file:") and t == pytest.approx(0.4, abs=2e-3)
    window.open(address, SIZE)
    assert now(page) == pytest.approx(t, abs=1e-12) and not page.run("nsdyn.clock.playing")
    page.run("(location.hash = '#t=0.125', new Promise(done => setTimeout(done, 100)))")  # pasted into the address
    assert now(page) == 0.125


@pytest.mark.slow
def test_picture_has_a_clock_and_no_controls(sliding, opened):
    page = opened(sliding, at="#picture")
    hidden = page.run(
        "['.tools', '.below', '#transport', '#notes'].map(s => getComputedStyle(document.querySelector(s)).display)"
    )
    assert hidden == ["none"] * 4 and text(page, "#clock").startswith("0.000 s")
    assert not page.run("nsdyn.clock.playing")
    left, top, width, height = place(page, "#clock")
    assert left + width <= SIZE[0] and top + height <= SIZE[1] and height > 25
    # Nothing is written to its address.
    show(page, 0.25)
    page.run(REST)
    assert page.run("location.hash") == "#picture"


@pytest.mark.slow
def test_checks_that_are_round_off_are_told(opened):
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0)
    page = opened(nd.simulate(scene, 0.05, dt=1e-2))
    click_on(page, ".checks")
    lanes = "nsdyn.panes[0].chart.lanes.map(lane => [lane.note, lane.low])"
    assert page.run(lanes) == [["less than 10⁻¹¹: round-off", 1e-11]] * 3


@pytest.mark.slow
def test_scale_of_forces(opened, sliding):
    """The bar is as long as an arrow of its force across the middle of the picture."""
    page = opened(sliding, forces=True)
    page.run("document.querySelector('.front').click()")
    show(page, 0.45)
    width = place(page, ".scale.forces .bar")[2]
    force = number(text(page, ".scale.forces").removeprefix("forces ").removesuffix(", ↠ stronger"), "N")
    metres = force * page.run("nsdyn.panes[0].overlay.scale('forces')")
    x = page.run(
        "(s => { const c = s.recording.view.centre; "
        f"return [-0.5, 0.5].map(k => s.project([c[0] + k * {metres}, c[1], c[2]])[0]) }})(nsdyn.panes[0].stage)"
    )
    assert x[1] - x[0] == pytest.approx(width, rel=0.01) and 24 <= width <= 60
    # Of the box, on four points that carry a quarter of its weight each.
    forces = contents(viewer.html(sliding, forces="point"))[1]["forces/force"][-12:]
    np.testing.assert_allclose(np.reshape(forces, (4, 3)), np.tile((0, 0, 2 * 9.81 / 4), (4, 1)), rtol=0, atol=1e-2)


@pytest.mark.slow
def test_impacts_are_cut_and_marked(opened, sliding):
    """What carries a load is readable beside an impact of a hundred times as much, whose arrow has two heads."""
    page = opened(sliding, forces=True)
    page.run("(window.drawn = [], draw = arrow, arrow = (...all) => { drawn.push(all); draw(...all); })")
    heads = {}
    for t in (0.19, float(sliding.t[marks.find(sliding).step[0]])):
        page.run("drawn.length = 0")
        show(page, t)
        arrows = page.run("drawn.map(([_, from, to, , cut]) => [Math.hypot(to[0] - from[0], to[1] - from[1]), cut])")
        heads[t] = sorted(arrows[-1 if t == 0.19 else -2 :])
    (weight,), (same, impact) = heads.values()
    assert [weight[1], same[1], impact[1]] == [False, False, True]
    assert same[0] == pytest.approx(weight[0], rel=1e-3) and 1.2 * same[0] < impact[0] < 4.0 * same[0]
    assert text(page, ".scale.forces").endswith("N, ↠ stronger")


@pytest.mark.slow
def test_two_recordings_have_one_clock(opened, falling, sliding):
    page = opened(sliding, beside=falling)
    assert page.run("nsdyn.panes.length") == 2 and page.run("nsdyn.clock.end") == 1.0
    show(page, 0.4)
    ball, box = page.run("nsdyn.panes.map((pane, k) => pane.stage.frames[1 - k].position.toArray())")
    assert ball == pytest.approx(sliding.body("ball").position[400], abs=2e-3)
    assert box[2] == pytest.approx(5 - 0.5 * 9.81 * 0.4**2, abs=2e-3)  # as above, between keys
    press(page, "End")  # of the longer one; the other shows its own
    assert page.run("nsdyn.panes.map(pane => pane.overlay.t)") == [0.5, 1.0]
    boxes = page.run("nsdyn.panes.map(pane => pane.root.getBoundingClientRect().left)")
    assert boxes[1] > boxes[0] + 0.4 * SIZE[0]


def cameras(page):
    """Of every pane the place of the camera, where it looks, and how many pixels a metre there has."""
    return page.run(
        "nsdyn.panes.map(({stage: s}) => [...s.camera.position.toArray(), ...s.viewer.controls.target.toArray(),"
        " s.pixelsPerMetre])"
    )


@pytest.mark.slow
def test_two_recordings_are_seen_from_one_place(opened, falling, sliding):
    page = opened(sliding, beside=falling)
    one, other = cameras(page)
    # But for round-off: controls turn places into angles and back whenever a picture is drawn.
    assert one == pytest.approx(other, rel=1e-14, abs=1e-15)
    balls = page.run("nsdyn.recordings.map(r => Array.from(r.arrays.outline))")
    assert balls[0] == balls[1] and max(balls[0][2::4]) == pytest.approx(5.1)  # the upper corners of the box that falls
    left, top, width, height = place(page, ".pane + .pane .view")
    x, y = left + width / 2, top + height / 2
    page.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", buttons=1)
    for k in range(1, 6):
        page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x - 20 * k, y=y - 3 * k, button="left", buttons=1)
    page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x - 100, y=y - 15, button="left")
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-240)
    show(page, 0.1)
    turned = cameras(page)
    assert turned[0] == pytest.approx(turned[1], rel=1e-9)  # round-off of the angles that the controls keep
    assert math.dist(turned[0][:3], one[:3]) > 0.5 and turned[0][6] > 1.04 * one[6]  # turned, and nearer
    page.run("document.querySelector('.tools .front').click()")
    show(page, 0.2)
    assert cameras(page)[0] == cameras(page)[1] != turned[0]
    # A body of one pane takes both cameras along, and then one of the other does.
    for k, name in enumerate(("ball", "falling")):
        show(page, 0.05)
        page.run(
            f"(p => p.inspector.body(p.recording.bodies.findIndex(b => b.name === '{name}')))(nsdyn.panes[{k}]);"
            f"document.querySelectorAll('.pane')[{k}].querySelector('.follow').click()"
        )
        before = cameras(page)
        show(page, 0.15)
        after = cameras(page)
        # Each falls, between keys as above.
        assert after[0] == after[1] and before[0][1] - after[0][1] == pytest.approx(9.81 * 0.01, abs=4e-3)
    assert page.run("Array.from(document.querySelectorAll('.follow'), b => b.getAttribute('aria-pressed'))") == [
        "false",
        "true",
    ]


@pytest.fixture(scope="module")
def slow_slide():
    return nd.simulate(nd.scenes.load("slide")(mu=0.2), 0.02, dt=1e-2)


@pytest.fixture(scope="module")
def room():
    return nd.simulate(nd.scenes.load("pile")(boxes=1, spheres=1), 0.02, dt=1e-2)


HEADINGS = "Array.from(document.querySelectorAll('.heading'), h => h.firstChild.textContent)"


@pytest.fixture(scope="module")
def fast_slide():
    return nd.simulate(nd.scenes.load("slide")(mu=0.5), 0.02, dt=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("at", ["#t=0", "#picture"])  # the latter is what films show
def test_headings_tell_what_differs(opened, slow_slide, fast_slide, at):
    page = opened(slow_slide, beside=fast_slide, at=at)
    assert page.run("document.title") == "slide: mu=0.2 | mu=0.5 - nsdyn"
    assert page.run(HEADINGS) == ["mu=0.2", "mu=0.5"]
    boxes = page.run("Array.from(document.querySelectorAll('.heading'), h => h.getBoundingClientRect().toJSON())")
    assert 0 <= boxes[0]["left"] < boxes[0]["right"] <= SIZE[0] / 2 <= boxes[1]["left"] < boxes[1]["right"] <= SIZE[0]
    assert all(0 <= box["top"] and 15 < box["height"] < 40 for box in boxes)
    assert text(page, ".heading small") == "slide, steps of 10 ms, contacts solved to 1e-8 m/s by auto"


@pytest.mark.slow
def test_headings_of_several_scenes_name_them(opened, slow_slide, fast_slide, room):
    page = opened(slow_slide, beside=[fast_slide, room])
    assert text(page, ".heading").startswith("slide, mu=0.2steps of 10 ms")
    assert opened(room, beside=slow_slide).run(HEADINGS) == ["pile", "slide"]


@pytest.mark.slow
def test_a_room_is_drawn_where_it_is(opened, slow_slide, room):
    """The lines along which walls meet stand in the pane of their own recording."""
    page = opened(room, beside=slow_slide)
    has = "nsdyn.panes.map(pane => 'corners' in pane.stage.viewer.scene_tree.find(['nsdyn']).children)"
    assert page.run(has) == [True, False]
    shadows = "nsdyn.panes[0].stage.viewer.scene_tree.find(['nsdyn', 'corners']).object.castShadow"
    assert page.run(shadows) is False


@pytest.mark.slow
def test_forces_of_two_recordings_have_one_scale(opened, sliding):
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 0.1, position=(0, 0, 0.1))
    light = nd.simulate(scene, 0.1, dt=1e-2)
    own = contents(viewer.html(light, forces=True))[0]["units"]["forces"]
    assert own == pytest.approx(0.981, rel=1e-2)
    page = opened(light, beside=sliding, forces=True)
    assert page.run("nsdyn.panes[0].overlay.scale('forces') === nsdyn.panes[1].overlay.scale('forces')")
    assert page.run("nsdyn.recordings.map(r => r.units.forces)")[0] > 19.0  # of the box of 2 kg


@pytest.mark.slow
def test_curves_of_the_other_recording_are_laid_over(opened, sliding):
    faster = nd.Scene(name="sliding")
    faster.add_halfspace("ground", material=nd.Material(mu=0.3))
    faster.add_box("box", (0.2, 0.2, 0.2), 2.0, position=(0, 0, 0.1), linear_velocity=(2, 0, 0))
    faster.parameters["mu"] = 0.3
    other = nd.simulate(faster, 0.7, dt=1e-3)
    known = nd.Trajectory(sliding.meta | {"parameters": '{"mu": 0.6}'}, sliding.scene, sliding.columns)
    page = opened(known, beside=other)
    axes = "nsdyn.panes.map(pane => pane.chart.lanes.map(({low, high}) => [low, high]))"
    click_on(page, ".tools .motion")
    speeds = [lanes[0] for lanes in page.run(axes)]
    assert speeds[0] == speeds[1] and speeds[0][1] > 2.0  # m/s, of the faster
    click_on(page, ".tools .energy")
    lines = "nsdyn.panes.map(pane => pane.chart.lanes.map(lane => (lane.lines ?? []).filter(line => line.rim)))"
    assert page.run(lines) == [[[]], [[]]]
    lengths = lines.replace("line.rim)", "line.rim).map(line => [line.values.length, line.dash.join()])")
    click_on(page, ".tools .overlay")
    sizes = page.run("nsdyn.panes.map(pane => pane.ledger.t.length)")
    for kind, counts in (("energy", (3, 4)), ("power", (1, 2)), ("motion", (2, 4)), ("checks", (3, 3))):
        click_on(page, f".tools .{kind}")
        laid = [[line for lane in lanes for line in lane] for lanes in page.run(lengths)]
        assert [len(lines) for lines in laid] == list(counts), kind
        assert all(line == [sizes[1 - k], "0,5"] for k, lines in enumerate(laid) for line in lines)
    click_on(page, ".tools .energy")
    # What is drawn is what the other pane has, all of it within the axes.
    kinetic = page.run("nsdyn.panes[0].chart.lanes[0].lines.find(line => line.rim).values[0]")
    assert kinetic == pytest.approx(0.5 * 2.0 * 2.0**2)
    ranges = page.run("nsdyn.panes.map(pane => [pane.chart.lanes[0].low, pane.chart.lanes[0].high])")
    assert ranges[0] == ranges[1] and ranges[0][1] > 4.0
    legend = (
        "Array.from(nsdyn.panes[0].figures.querySelectorAll('.stroke'),"
        " i => i.parentElement.textContent + getComputedStyle(i).borderTopStyle)"
    )
    assert page.run(legend) == ["mu=0.6 solid", "mu=0.3 dotted"]
    click_on(page, ".tools .overlay")
    assert page.run(lines) == [[[]], [[]]] and page.run(legend) == []


@pytest.mark.slow
def test_curves_that_coincide_take_turns(opened):
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=0.3))
    for k, speed in enumerate((2.0, 2.0, 2.0, 1.0)):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(0, k, 0.1), linear_velocity=(speed, 0, 0))
    page = opened(nd.simulate(scene, 0.5, dt=1e-2))
    click_on(page, ".tools .motion")
    lines = page.run(
        "nsdyn.panes[0].chart.lanes[0].lines.map(({dash, shift, colour}) => [dash ?? null, shift ?? null])"
    )
    assert lines == [[None, None], [[8, 16], 16], [[8, 16], 8], [None, None]]
    # All four colours are on the canvas; what is whole below the others shows at the edges of these too.
    counts = page.run("""(() => {
        const {back, lanes} = nsdyn.panes[0].chart;
        const {data} = back.getContext("2d").getImageData(0, 0, back.width, back.height);
        return lanes[0].lines.map(({colour}) => {
            const rgb = [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16));
            let count = 0;
            for (let k = 0; k < data.length; k += 4) count += rgb.every((x, i) => Math.abs(data[k + i] - x) < 20);
            return count;
        });
    })()""")
    assert min(counts[:3]) > 0.3 * max(counts[:3]) > 50 and counts[3] > 50
    # The one that is picked is whole, in front of the others.
    page.run("nsdyn.panes[0].inspector.body(1)")
    assert page.run("nsdyn.panes[0].chart.lanes[0].lines.every(line => line.dash === undefined)")


@pytest.mark.slow
def test_what_is_not_recorded_is_told(opened, tmp_path):
    scene = nd.scenes.load("bounce")()
    page = opened(nd.simulate(scene, 0.6, dt=1e-3, every=10, contacts=False))
    notes = text(page, "#notes")
    assert "one step in 10 is recorded" in notes and "recorded without contacts" in notes
    assert page.run("document.querySelector('.tools .contacts, .tools .forces, .tools .cones')") is None
    assert page.run("getComputedStyle(document.querySelector('.legend')).display") == "none"
    assert page.run("nsdyn.dock.impacts.length") == 0
    click_on(page, ".checks")
    assert page.run("nsdyn.panes[0].chart.lanes.map(lane => lane.note)")[2] == "not recorded"
    page.run("nsdyn.panes[0].inspector.body(1)")
    assert set(table(page)) == {"mass", "speed", "kinetic energy", "potential energy"}


@pytest.mark.slow
def test_links_have_masses_and_energies(opened):
    """Of what their joint carries: those of all links and bodies add up to the ledger's."""
    t = nd.simulate(nd.scenes.load("arm_pushes_box")(), duration=0.02, dt=2e-3)
    page, kinetic, potential = opened(t), 0.0, 0.0
    page.run("nsdyn.show(0.02)")
    bodies = page.run("nsdyn.recordings[0].bodies")
    first = {body["frame"]: k for k, body in reversed(list(enumerate(bodies))) if body["frame"] >= 0}
    for k in first.values():
        page.run(f"nsdyn.panes[0].inspector.body({k})")
        shown = table(page)
        kinetic += number(shown["kinetic energy"], "J")
        potential += number(shown["potential energy"], "J")
        assert number(shown["mass"], "kg") > 0.0
        assert ("joint carries" in text(page, ".inspector")) == bool(bodies[k]["joint"])
    assert kinetic == pytest.approx(t.energy.kinetic[-1], rel=1e-3)
    assert potential == pytest.approx(t.energy.potential[-1], rel=1e-3)


@pytest.mark.slow
def test_a_link_shows_its_joint(opened):
    """A mass on a rail that a force pushes, and a hinge on it: what its panel says is what the recording does."""
    scene = nd.scenes.load("cart_pole")()
    t = nd.simulate(scene, 0.2, dt=1e-2, controller=lambda t, q, v: {"cart_pole": np.array([3.0, 0.0])})
    page = opened(t)
    for link, drive, unit in (("cart", "force", "N"), ("pole", "torque", "N·m")):
        page.run(
            f"nsdyn.panes[0].inspector.body(nsdyn.recordings[0].bodies.findIndex(b => b.joint?.name === '{link}'))"
        )
        page.run("nsdyn.show(0.1)")
        shown, joint = table(page), t.joint(f"cart_pole/{link}")
        assert shown["joint"] == link
        place = "position" if unit == "N" else "angle"
        for label, of, value in (
            (place, "m" if unit == "N" else "rad", joint.position[10]),
            ("velocity", "m/s" if unit == "N" else "rad/s", joint.velocity[10]),
            (drive, unit, joint.torque[9]),
            ("reaction", "N", np.linalg.norm(joint.reaction_force[9])),
            ("its moment", "N·m", np.linalg.norm(joint.reaction_torque[9])),
        ):
            assert number(shown[label], of) == pytest.approx(value, rel=1e-3), label  # four digits are shown
        curves = page.run("Array.from(document.querySelectorAll('.inspector .plot'), plot => plot.dataset.label)")
        assert ["speed", place, drive, "reaction"] == [label for label in curves if label in shown]
    times, forces = page.run(
        "(p => [p.times, p.values])(nsdyn.panes[0].inspector.plots.find(p => p.label === 'reaction'))"
    )
    known = np.linalg.norm(t.joint("cart_pole/pole").reaction_force, axis=1)
    # Of the steps that end at the states shown; the numbers of the page have 15 bits.
    np.testing.assert_allclose(forces, np.interp(times, t.t_steps, known), rtol=2**-15, atol=0)


@pytest.mark.slow
def test_rest_is_rest(opened):
    page = opened(nd.simulate(nd.scenes.load("stack")(height=2), 0.05, dt=1e-2))
    assert page.run("nsdyn.panes[0].chart.lanes[0].note") == "at rest: nothing of 3.924 J moves"
    # The axis has no numbers of noise.
    page.run(
        "(window.told = [], write = CanvasRenderingContext2D.prototype.fillText,"
        " CanvasRenderingContext2D.prototype.fillText = function (...all) {"
        "   told.push(all[0]); write.apply(this, all); },"
        " nsdyn.panes[0].chart.redraw(), CanvasRenderingContext2D.prototype.fillText = write)"
    )
    assert page.run("told") == ["0", "energy [J]", "at rest: nothing of 3.924 J moves"]
