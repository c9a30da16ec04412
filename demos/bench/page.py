"""How soon a page of a recording opens in Chromium, with OpenGL in software, and how it follows the scrubber.

    python demos/bench/page.py [SCENE] [--time 10] [--size 1280x800] [--frames 150] [--png PAGE.png --at 0.5]

The pointer is drawn over the scrubber from one end to the other, a bit further at each of so many pictures of the
browser. Counted are the pictures a second: all of them, and those after the first ten, in which the page finds out how
much it can draw. Other programs slow it down, but the processor time of a picture, of two processes that work at once,
stays the same. The picture is of the page. A film has 30 pictures a second, of 1280 x 720 pixels with curves.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import nsdyn as nd
from nsdyn.cli.output import sides
from nsdyn.view.browser import Browser, browsing
from nsdyn.view.pictures import FRAME, FilmLook

PICTURES = 60
"""Of the film, over the whole recording."""

DRAG = """new Promise(done => {
    const scrubber = document.querySelector(".scrubber"), times = [];
    const box = scrubber.getBoundingClientRect();
    const send = (kind, part) => scrubber.dispatchEvent(new PointerEvent(kind, {
        buttons: 1, clientX: box.left + 58 + part * (box.width - 72), clientY: box.top + box.height / 2 }));
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


def processor_time(browser: Browser) -> dict[str, float]:
    """Of the browser's processes so far, by kind, s."""
    out = dict.fromkeys(("GPU", "renderer"), 0.0)
    for process in browser.call("SystemInfo.getProcessInfo")["processInfo"]:
        out[process["type"]] = out.get(process["type"], 0.0) + process["cpuTime"]
    return out


def main() -> None:
    """Simulate, write the page, open it, scrub."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scene", nargs="?", default="stacks")
    parser.add_argument("--time", type=float, default=10.0, help="simulated, s")
    parser.add_argument("--size", default="1280x800", help="of the window, pixels")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--png", type=Path, help="picture of the page")
    parser.add_argument("--at", type=float, default=0.0, help="time of the picture, s")
    arguments = parser.parse_args()
    setup = nd.scenes.setup(arguments.scene)
    trajectory = nd.simulate(setup.scene, arguments.time, **setup.options())
    with tempfile.TemporaryDirectory() as folder, browsing() as browser:
        page = Path(folder) / "page.html"
        start = time.perf_counter()
        trajectory.to_html(page)
        print(f"{arguments.scene}: {page.stat().st_size / 1e6:.1f} MB, made in {time.perf_counter() - start:.1f} s")
        browser.open(page.as_uri() + "#t=0", sides(arguments.size, int, "pixels"))
        print(f"opens in {browser.run('performance.now()') / 1e3:.2f} s")
        before = processor_time(browser)
        times = browser.run(DRAG.replace("FRAMES", str(arguments.frames)))
        spent = {kind: 1e3 * (t - before[kind]) / len(times) for kind, t in processor_time(browser).items()}
        rates = [(len(times) - 1 - k) / (times[-1] - times[k]) * 1e3 for k in (0, 10)]
        print(f"scrubs at {rates[0]:.0f} pictures a second, {rates[1]:.0f} after the first ten")
        print(f"processor time of a picture: {spent['GPU']:.0f} ms to draw it, {spent['renderer']:.0f} ms in the page")
        if arguments.png:
            browser.run(f"nsdyn.show({arguments.at})")
            arguments.png.write_bytes(browser.picture())
        browser.open(page.as_uri() + "#picture&film&curves=energy", FilmLook().size)
        begun, before = sum(processor_time(browser).values()), time.process_time()
        for k in range(PICTURES):
            browser.run(f"nsdyn.show({k * arguments.time / PICTURES})")
            browser.picture(**FRAME)
        spent_in_all = sum(processor_time(browser).values()) - begun + time.process_time() - before
        print(f"film: {30.0 * spent_in_all / PICTURES:.1f} s of processor time a second, and what ffmpeg takes")
    print(f"load of the machine: {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
