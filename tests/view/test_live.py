"""A window that follows a stepper: what a browser that opens its address shows is where the bodies are."""

import re

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.view import browser

PLACES = """
["ball", "arm.shoulder", "arm.elbow"].map(name => viewer.scene_tree.find(["nsdyn", "bodies", name]).object)
  .map(o => [...o.position.toArray(), ...o.quaternion.toArray()])
"""
SOON = """
new Promise(done => {
  const look = () => typeof viewer !== "undefined" && (CONDITION) ? done() : setTimeout(look, 20);
  look();
})
"""


@pytest.fixture
def stepper():
    """Of a ball that turns in the air and a robot that moves."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0.5, 1, 2), angular_velocity=(0, 0, 2))
    scene.add_urdf("arm", nd.scenes.folder() / "arm.urdf", q=(-0.6, 0.3), v=(2.0, 0.0))
    return nd.Stepper(scene, dt=1e-2)


@pytest.mark.slow
@pytest.mark.skipif(browser.chromium() is None, reason="no Chromium on the PATH")
def test_a_window_follows_a_stepper(stepper, window, tmp_path):
    live = nd.Live(stepper, fps=1e-3)
    try:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/static/", live.url) and live.url in live._repr_html_()
        (tmp_path / "empty.html").write_text("<script>window.ready = true</script>")
        window.open(tmp_path / "empty.html", (800, 500))
        window.call("Page.navigate", url=live.url)
        window.run(SOON.replace("CONDITION", f"{PLACES.strip()}[0][2] === 2"))  # m, where the ball begins
        start = window.run(PLACES)
        for _ in range(10):
            step = stepper.step()
        live.show(step)
        assert window.run(PLACES) == start  # the last picture is not over yet
        live._next = 0.0
        live.show(step)
        moved = f"{PLACES.strip()}.every((place, k) => place.join() !== {start}[k].join())"
        window.run(SOON.replace("CONDITION", moved))
        poses = np.column_stack([step.frames_x, step.frames_quat])
        np.testing.assert_allclose(window.run(PLACES), poses, rtol=0, atol=1e-9)
        assert np.abs(poses - start).max(axis=1).min() > 1e-2  # all of them moved
    finally:
        live.close()


def test_free_bodies_alone_have_no_frames_of_links():
    stepper = nd.Stepper(nd.scenes.load("slide")(), dt=1e-2)
    live = nd.Live(stepper)
    live.show(stepper.step())
    live.close()
    assert live._window.server_proc.poll() is not None


def test_bad_arguments(stepper):
    with pytest.raises(ValueError, match=r"stepper must be a nsdyn.Stepper, got 5"):
        nd.Live(5)
    for fps in (0, -1.0, np.nan, "fast"):
        with pytest.raises(ValueError, match=f"fps must be a positive number, got {fps!r}"):
            nd.Live(stepper, fps)
