"""A headless Chromium, driven over a pair of pipes by its DevTools protocol, without a server or a port.

`playwright` is not used: it is a wheel of 51 MB with its own Node, and this module needs 170 lines.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATIENCE = 120.0
"""Longest time of an answer, s: software rendering of a large page is slow."""

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=gl-egl",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-gpu-compositing",
    "--hide-scrollbars",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-pipe",
]

SOFTWARE = {"EGL_PLATFORM": "surfaceless", "LIBGL_ALWAYS_SOFTWARE": "1"}
"""Environment by which Mesa's llvmpipe draws: with many triangles it takes little more than half of SwiftShader's time.
Without llvmpipe, Chromium uses SwiftShader by default. Composing pages with llvmpipe too would cost the time gained."""

OF_THE_BROWSER = ("Target.", "SystemInfo.")
"""Prefixes of commands that go to the browser, not to a page."""

_WITH_PIPES = """
import os, sys
for there, here in enumerate(sys.argv[1:3], 3):
    os.dup2(int(here), there)
os.execv(sys.argv[3], sys.argv[3:])
"""
# Chromium reads requests from file descriptor 3 and writes answers to 4; only the child can connect them to the pipes.


def chromium() -> str | None:
    """Return the path of Chromium or Chrome, None without either."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """One page of a running browser.

    Attributes
    ----------
    events : list of dict
        Reports of the browser about the page besides answers, for instance requests and exceptions.
    """

    def __init__(self, requests: int, answers: int) -> None:
        self.events: list[dict[str, Any]] = []
        self._requests, self._answers = requests, answers
        self._target: str | None = None
        self._session: str | None = None
        self._count, self._rest = 0, b""

    def open(self, page: str | Path, size: tuple[int, int]) -> None:
        """Open a page of this package in a window of `size` pixels, close any page before, wait until it is ready."""
        if self._target:
            self.call("Target.closeTarget", targetId=self._target)
        self.events.clear()
        self._target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")
        self.resize(size)
        url = page if isinstance(page, str) else page.resolve().as_uri()
        self.call("Page.navigate", url=url)
        self.run(
            "new Promise((done, fail) => { const look = () => window.failure ? fail(window.failure)"
            " : window.ready ? done() : setTimeout(look, 10); look(); })"
        )

    def resize(self, size: tuple[int, int]) -> None:
        """Set the size of the window in pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False
        )

    def run(self, script: str) -> Any:
        """Evaluate a JavaScript expression in the page, and await a promise; ValueError if it throws."""
        done = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in done:
            details = done["exceptionDetails"]
            raise ValueError(details.get("exception", {}).get("description", details["text"]))
        return done["result"].get("value")

    def picture(self, **kind: Any) -> bytes:
        """Return a picture of the window: a PNG, or another format by parameters of ``Page.captureScreenshot``."""
        asked = {"format": "png", "optimizeForSpeed": True} | kind
        return base64.b64decode(self.call("Page.captureScreenshot", **asked)["data"])

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the protocol and return the browser's answer; ValueError with its message if it fails."""
        self._count += 1
        request = {"id": self._count, "method": method, "params": parameters}
        if not method.startswith(OF_THE_BROWSER):
            request["sessionId"] = self._session
        os.write(self._requests, json.dumps(request).encode() + b"\0")
        end = time.monotonic() + PATIENCE
        while True:
            message = self._message(end)
            if message.get("id") != self._count:
                self.events.append(message)
            elif "error" in message:
                raise ValueError(f"the browser refuses {method}: {message['error']['message']}")
            else:
                return message["result"]

    def _message(self, end: float) -> dict[str, Any]:
        """Return the next message; a zero byte ends a message."""
        while b"\0" not in self._rest:
            ready = select.select([self._answers], [], [], max(0.0, end - time.monotonic()))[0]
            if not ready:
                raise ValueError(f"the browser did not answer for {PATIENCE:g} s")
            data = os.read(self._answers, 1 << 20)
            if not data:
                raise ValueError("the browser ended")
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        return json.loads(message)


@contextmanager
def browsing() -> Iterator[Browser]:
    """Yield a headless browser without network access, and end it afterwards; ValueError if none is installed."""
    program = chromium()
    if program is None:
        raise ValueError("pictures need Chromium or Chrome on the PATH, as from 'apt-get install chromium'")
    with tempfile.TemporaryDirectory(prefix="nsdyn-", ignore_cleanup_errors=True) as folder:
        (theirs_in, ours_out), (ours_in, theirs_out) = os.pipe(), os.pipe()
        files = [str(theirs_in), str(theirs_out)]
        process = subprocess.Popen(
            [sys.executable, "-ISc", _WITH_PIPES, *files, program, *FLAGS, f"--user-data-dir={folder}/profile"],
            pass_fds=(theirs_in, theirs_out),
            env=os.environ | SOFTWARE | {"HOME": folder},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        try:
            yield Browser(ours_out, ours_in)
        finally:
            os.close(ours_out)  # the browser ends when the pipe closes
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            os.close(ours_in)
