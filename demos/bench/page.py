"""How soon a page of a recording opens in Chromium, with OpenGL in software, and how it follows the scrubber.

    python demos/bench/page.py [SCENE] [--time 10] [--size 1280 800] [--frames 150]

The pointer is drawn over the scrubber from one end to the other, a bit further at each of so many pictures of the
browser. Counted are the pictures a second: all of them, and those after the first ten, in which the page finds out how
much it can draw. Other processes slow it down: the load of the machine is printed too.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import nsdyn as nd
from nsdyn.recording.browser import browsing

DRAG = """new Promise(done => {
    const scrubber = document.getElementById("scrubber"), times = [];
    const box = scrubber.getBoundingClientRect();
    const send = (kind, part) => scrubber.dispatchEvent(new PointerEvent(kind, {
        buttons: 1, clientX: box.left + 8 + part * (box.width - 16), clientY: box.top + box.height / 2 }));
    scrubber.setPointerCapture = () => {};  // there is no such pointer
    send("pointerdown", 0);
    const next = () => {
        times.push(performance.now());
        if (times.length > FRAMES) return done(times);
        send("pointermove", times.length / FRAMES);
        requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
})"""


def main() -> None:
    """Simulate, write the page, open it, scrub."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="stacks")
    parser.add_argument("--time", type=float, default=10.0, help="simulated, s")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 800), help="of the window, pixels")
    parser.add_argument("--frames", type=int, default=150)
    arguments = parser.parse_args()
    setup = nd.scenes.setup(arguments.scene)
    trajectory = nd.simulate(setup.scene, arguments.time, **setup.options())
    with tempfile.TemporaryDirectory() as folder, browsing() as browser:
        page = Path(folder) / "page.html"
        start = time.perf_counter()
        trajectory.to_html(page)
        print(f"{arguments.scene}: {page.stat().st_size / 1e6:.1f} MB, made in {time.perf_counter() - start:.1f} s")
        browser.open(page.as_uri() + "#t=0", tuple(arguments.size))
        print(f"opens in {browser.run('performance.now()') / 1e3:.2f} s")
        times = browser.run(DRAG.replace("FRAMES", str(arguments.frames)))
        rates = [(len(times) - 1 - k) / (times[-1] - times[k]) * 1e3 for k in (0, 10)]
        print(f"scrubs at {rates[0]:.0f} pictures a second, {rates[1]:.0f} after the first ten")
    print(f"load of the machine: {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
