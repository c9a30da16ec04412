"""Pages on telephones and in small or magnified windows: nothing lies on the scene or on another control."""

import io

import numpy as np
import pytest
from pages import RESTED

import nsdyn as nd
from nsdyn.view import browser

pytestmark = pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")

PHONE, ZOOMED, LYING = (390, 844), (640, 360), (844, 390)

# All that is seen: [name, left, top, right, bottom, whether it is what the pointer meets in its middle, names of those
# around it]. What scrolls counts as far as it is seen.
SEEN = """
(() => {
  const parts = ".heading, .legend > span, .view, .sheet, .values, .curves .plot, button, .scrubber, #clock, #speed *";
  const shown = e => e.checkVisibility() && !e.closest("dialog");
  const elements = Array.from(document.querySelectorAll(parts)).filter(shown);
  const name = e => e.id || e.className || e.tagName;
  return elements.map(e => {
    const box = e.getBoundingClientRect(), frame = e.parentElement.closest(".sheet")?.getBoundingClientRect();
    const top = Math.max(box.top, frame?.top ?? -Infinity), bottom = Math.min(box.bottom, frame?.bottom ?? Infinity);
    const met = document.elementFromPoint((box.left + box.right) / 2, (top + bottom) / 2);
    const around = elements.filter(other => other !== e && other.contains(e)).map(other => elements.indexOf(other));
    return [name(e), box.left, top, box.right, bottom, e.contains(met), around, e.matches("button, input, .scrubber")];
  }).filter(([, left, top, right, bottom]) => right > left && bottom > top);
})()
"""


@pytest.fixture(scope="module")
def runs():
    return [nd.simulate(nd.scenes.load("slide")(mu=mu), 0.3, dt=2e-3) for mu in (0.2, 0.5)]


@pytest.fixture(scope="module", params=[pytest.param(1, marks=pytest.mark.slow), 2])
def count(request):
    """How many recordings the page has."""
    return request.param


@pytest.fixture
def page(opened, runs, count):
    """A page that was opened on a telephone."""
    yield opened(runs[0], PHONE, "#t=0.1", **({"beside": runs[1]} if count == 2 else {}))
    opened.window.call("Emulation.setTouchEmulationEnabled", enabled=False)


def blue(picture, box):
    """How many pixels in a box of a picture have the colours of the body."""
    from PIL import Image

    pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB"), dtype=int)
    left, top, right, bottom = (round(x) for x in box)
    part = pixels[top:bottom, left:right]
    return int(((part[:, :, 2] - part[:, :, 0]) > 40).sum())


def check(page, size, count, name, folder):
    """The geometry of what is seen, and a picture of it, which goes to a folder."""
    page.run("nsdyn.show(0.1)")
    page.run(RESTED)
    seen = page.run(SEEN)
    width, height = size
    for k, (what, left, top, right, bottom, met, around, control) in enumerate(seen):
        assert left >= 0 and top >= 0 and right <= width and bottom <= height, f"{what} is not in the window"
        assert met, f"something lies on {what}"
        if control:
            scrolls = any(seen[j][0] == "sheet" for j in around)
            assert right - left >= 32 and (bottom - top >= 32 or scrolls), f"{what} is small"
        for j, (other, *box, _, _, _) in enumerate(seen[:k]):
            if j not in around and k not in seen[j][6]:
                # Buttons of a group share a border, 1 px wide.
                apart = right <= box[0] + 1 or left >= box[2] - 1 or bottom <= box[1] + 1 or top >= box[3] - 1
                assert apart, f"{what} and {other} overlap"
    assert page.run("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [width, height]
    views = [row[1:5] for row in seen if row[0] == "view"]
    shares = [(bottom - top) / height for _, top, _, bottom in views]
    picture = page.picture()
    (folder / f"{count} {name} {width}x{height}.png").write_bytes(picture)
    assert all(bottom - top >= 30 for what, _, top, _, bottom, *_ in seen if what == "plot"), "a plot is flat"
    assert len(views) == count and len({(right - left, round(bottom - top)) for left, top, right, bottom in views}) == 1
    assert all(blue(picture, box) > 200 for box in views)
    return min(shares)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sizes",
    [
        pytest.param({1: (PHONE, LYING), 2: (PHONE, ZOOMED)}, id="some"),
        pytest.param({1: (ZOOMED,), 2: (LYING,)}, id="others", marks=pytest.mark.slow),
    ],
)
def test_nothing_lies_on_the_scene_or_on_a_control(page, sizes, count, tmp_path):
    page.call("Emulation.setTouchEmulationEnabled", enabled=True)
    for size in sizes[count]:
        page.resize(size)
        page.run(RESTED)
        check_all(page, size, count, tmp_path)


def check_all(page, size, count, tmp_path):
    """That nothing lies on anything, whatever is shown, which is put away again."""
    press = "document.querySelector('.tools .{}').click()".format
    pick = "nsdyn.panes[0].inspector.{}".format
    stacked = count == 2 and size == PHONE
    least = 1 / 6 if stacked else 1 / 3
    assert check(page, size, count, "plain", tmp_path) >= least
    if count == 2:
        page.run(press("overlay"))
    page.run(press("forces"))
    check(page, size, count, "forces", tmp_path)
    page.run(press("cones"))
    check(page, size, count, "cones", tmp_path)
    for name in ("forces", "cones"):
        page.run(press(name))
    for name, panel in (("body", "body(1)"), ("contact", "contact(nsdyn.panes[0].overlay.contacts[0])")):
        page.run(pick(panel))
        assert check(page, size, count, name, tmp_path) >= least
        # The body is where it can be seen, and the pointer finds it there.
        assert page.run(
            "(({stage}) => { const box = stage.viewer.dom_element.getBoundingClientRect();"
            " const [x, y] = stage.project(stage.origin(0));"
            " const met = document.elementFromPoint(box.left + x, box.top + y);"
            " return met.closest('.view') !== null && stage.pick(x, y) !== null; })(nsdyn.panes[0])"
        )
        assert page.run("document.querySelector('.inspector h2').checkVisibility()")
    page.run("nsdyn.panes[0].inspector.clear()")
    page.run(press("tree"))
    assert check(page, size, count, "tree", tmp_path) >= least
    assert page.run("document.querySelector('.gui li').checkVisibility()")
    page.run(press("tree"))
    if count == 2:
        page.run(press("overlay"))


@pytest.mark.slow
@pytest.mark.parametrize("size", [ZOOMED, LYING])
def test_two_legends_are_seen_whole(opened, runs, size):
    page = opened(runs[0], size, "#t=0.1", beside=runs[1])
    page.run("nsdyn.show(0.1)")
    page.run(RESTED)
    seen = page.run(
        "Array.from(document.querySelectorAll('.values')).map(legend => { const box = legend.getBoundingClientRect();"
        " return Array.from(legend.children).map(e => [e.textContent, e.getBoundingClientRect()])"
        ".filter(([, {width}]) => width > 0).map(([text, {right, bottom}]) => ["
        "text, right <= box.right + 1 && bottom <= box.bottom + 1]); })"
    )
    assert len(seen) == 2
    for legend in seen:
        assert any("sum" in text for text, _ in legend) and all(inside for _, inside in legend), legend


@pytest.mark.parametrize("dark", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_controls_are_as_bright_as_the_page(opened, runs, dark):
    from PIL import Image

    page = opened(runs[0], (1280, 800), "#t=0.1")
    page.run(f"theme.set({str(dark).lower()}); document.querySelector('.tools .tree').click()")
    box = "(box => [box.left, box.top, box.right, box.bottom])(document.querySelector('.gui').getBoundingClientRect())"
    picture = Image.open(io.BytesIO(page.picture())).convert("L").crop(page.run(box))
    assert (np.asarray(picture).mean() < 100) == dark


@pytest.mark.slow
def test_targets_are_large_under_fingers_in_any_window(page):
    page.resize((1280, 800))
    page.run(RESTED)
    least = (
        "Math.min(...Array.from(document.querySelectorAll('button, #speed input'))"
        ".filter(e => e.checkVisibility()).map(e => e.getBoundingClientRect()).map(b => Math.min(b.width, b.height)))"
    )
    assert page.run(least) < 32
    page.call("Emulation.setTouchEmulationEnabled", enabled=True)
    assert page.run(least) >= 32


def test_the_speed_has_no_row_of_its_own_on_a_telephone(page):
    place = "(box => [box.left, box.top, box.right, box.bottom])(document.querySelector('{}').getBoundingClientRect())"
    clock, slider, told = (page.run(place.format(what)) for what in ("#clock", "#speed input", "#speed output"))
    assert (
        slider[1] + slider[3] == pytest.approx(clock[1] + clock[3], abs=4.0)
        and clock[2] < slider[0]
        and told[2] <= PHONE[0]
    )
    assert slider[2] - slider[0] > 60
