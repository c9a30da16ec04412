"""Pictures and films of pages, taken by a headless Chromium."""

import io
import stat
import sys

import numpy as np
import pytest
import recordings

import nsdyn as nd
from nsdyn.view import browser, pictures, viewer

needs_chromium = pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")


@pytest.fixture(scope="module")
def falling():
    return recordings.falling()


@pytest.mark.slow
@needs_chromium
def test_picture_shows_the_bodies_where_they_are(falling, tmp_path, window):
    from PIL import Image

    viewer.write_html(falling, tmp_path / "page.html", at=0.0)
    window.open((tmp_path / "page.html").as_uri() + "#picture", (640, 360))
    before = window.picture()
    viewer.write_html(falling, tmp_path / "page.html", at=1.0)
    pictures.screenshot(tmp_path / "page.html", tmp_path / "page.png", size=(640, 360))
    shown = (io.BytesIO(before), tmp_path / "page.png")
    taken = [np.asarray(Image.open(picture).convert("RGB"), dtype=float) for picture in shown]
    assert taken[0].shape == (360, 640, 3)
    blue = [((p[:, :, 2] - p[:, :, 0]) > 60).nonzero()[0] for p in taken]  # first colour of the palette
    assert min(b.size for b in blue) > 100
    assert blue[0].mean() < 120 < blue[1].mean() - 60  # it fell from the upper third by a good part of the picture
    # The clock, dark in the upper right corner, says something else.
    corners = [p[:50, 480:].sum(axis=2) < 200 for p in taken]
    assert corners[0].sum() > 50 and (corners[0] != corners[1]).sum() > 20
    assert sorted(p.name for p in tmp_path.iterdir()) == ["page.html", "page.png"]


@needs_chromium
def test_a_tower_is_below_the_heading_of_its_picture(tmp_path, window):
    tower = nd.simulate(nd.scenes.load("heavy_on_light")(below=9), 0.02, dt=0.01)
    viewer.write_html(tower, tmp_path / "page.html", at=0.02)
    window.open((tmp_path / "page.html").as_uri() + "#picture", (640, 400))
    heading = "document.querySelector('.heading').getBoundingClientRect().bottom"
    top, heading = window.run(f"[nsdyn.panes[0].stage.project([0, 0, 2.0])[1], {heading}]")
    assert 20 < heading < top < 100  # and is no smaller than need be


def test_missing_browser_is_told(falling, tmp_path, monkeypatch):
    viewer.write_html(falling, tmp_path / "page.html", at=0.0)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="apt-get install chromium"):
        pictures.screenshot(tmp_path / "page.html", tmp_path / "page.png")
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]


def stand_in(tmp_path, monkeypatch, script):
    """An ffmpeg that is a script in Python."""
    path = tmp_path / "bin" / "ffmpeg"
    path.parent.mkdir()
    path.write_text(f"#!{sys.executable}\nimport sys\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(path.parent), prepend=":")


@pytest.mark.slow
@needs_chromium
def test_film_has_a_picture_for_each_moment(falling, tmp_path, monkeypatch):
    stand_in(tmp_path, monkeypatch, "open(sys.argv[-1], 'wb').write(sys.stdin.buffer.read())")
    viewer.write_html(falling, tmp_path / "page.html")
    pictures.film(tmp_path / "page.html", tmp_path / "film.mp4", pictures.FilmLook(fps=4, size=(320, 180)))
    begin = b"\xff\xd8\xff\xe0"  # a JPEG
    shown = (tmp_path / "film.mp4").read_bytes().split(begin)[1:]
    assert len(shown) == len(set(shown)) == 5  # of 1 s, both ends; no two alike


@pytest.mark.slow
@needs_chromium
def test_films_are_drawn_as_pages_are(falling, tmp_path, window):
    """The ground of a film is drawn once, behind the bodies: the picture is that of the page, shadows too."""
    from PIL import Image

    viewer.write_html(falling, tmp_path / "page.html")
    shown = []
    for more in ("", "&film"):
        window.open((tmp_path / "page.html").as_uri() + "#picture" + more, (640, 360))
        window.run("nsdyn.show(0.5)")
        shown.append(np.asarray(Image.open(io.BytesIO(window.picture())).convert("RGB")).astype(int))
    apart = np.abs(shown[0] - shown[1]).max(axis=2)
    # Edges of shadows, of which a film has a map with fewer points, and lines of the ground in them.
    assert (apart > 12).mean() < 0.005
    assert (apart > 0).mean() < 0.2
    # A film draws anew only what has moved.
    window.run(
        "(viewer => { const {render} = viewer; window.count = 0;"
        " viewer.render = () => { window.count++; render(); }; })(nsdyn.panes[0].stage.viewer)"
    )
    first = window.picture()
    window.run("nsdyn.show(0.5)")
    assert window.picture() == first and window.run("count") == 0
    window.run("nsdyn.show(0.6)")
    assert window.picture() != first and window.run("count") == 1


@pytest.mark.slow
@needs_chromium
def test_film_that_fails_is_told(falling, tmp_path, monkeypatch):
    stand_in(tmp_path, monkeypatch, "sys.exit('no such encoder')")
    viewer.write_html(falling, tmp_path / "page.html")
    with pytest.raises(ValueError, match=r"cannot write .*film\.mp4: ffmpeg fails: no such encoder"):
        pictures.film(tmp_path / "page.html", tmp_path / "film.mp4", pictures.FilmLook(size=(320, 180)))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="films need ffmpeg on the PATH"):
        pictures.film(tmp_path / "page.html", tmp_path / "film.mp4")
    assert not (tmp_path / "film.mp4").exists()


@needs_chromium
def test_picture_of_two_recordings_of_which_one_has_ended(falling, tmp_path, window):
    scene = recordings.nd.Scene(name="short")
    scene.add_sphere("ball", 0.1, 1.0)
    short = recordings.recording(scene, np.tile([0, 0, 0, 0, 0, 0, 1.0], (3, 1)))
    viewer.write_html(falling, tmp_path / "page.html", at=1.0, beside=short)
    window.open((tmp_path / "page.html").as_uri(), (640, 360))
    assert window.run("nsdyn.recordings.map(r => r.t[0])") == [1.0, 0.02]
    assert window.run("document.querySelector('#clock').textContent").startswith("1.00 s")
