"""Pictures and films of a page, taken by a headless Chromium."""

from __future__ import annotations

import math
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from nsdyn.tools import files
from nsdyn.view.browser import browsing

FRAME = {"format": "jpeg", "quality": 97}
"""Format of the pictures of a film: PNG takes browser and ffmpeg twice the time, with no visible gain in H.264."""


def screenshot(page: str | Path, picture: str | Path, size: tuple[int, int] = (1280, 720)) -> None:
    """Save a picture of a page as a headless Chromium shows it: the scene, its name, its legend, the clock.

    ValueError if there is no Chromium, or it returned no picture.

    Parameters
    ----------
    page : path
        A page of this package, preferably made with `at`.
    picture : path
        PNG file to write.
    size : (int, int)
        Width and height in pixels.
    """
    with browsing() as browser, files.writing(picture, files.FRAME) as part:
        browser.open(_as_picture(page), size)
        part.write_bytes(browser.picture(optimizeForSpeed=False))


def check_film() -> None:
    """Raise a ValueError if there is no ffmpeg to make films with."""
    if shutil.which("ffmpeg") is None:
        raise ValueError("films need ffmpeg on the PATH, as from 'apt-get install ffmpeg'")


@dataclass(frozen=True)
class FilmLook:
    """Look of a film; ValueError for a value out of range.

    Attributes
    ----------
    fps : float
        Pictures per second.
    size : (int, int)
        Width and height in pixels, even numbers.
    speed : float
        Simulated seconds per second of the film.
    curves : str, optional
        Curves drawn below the bodies: "energy", "power", "motion" or "checks".
    """

    fps: float = 30.0
    size: tuple[int, int] = (1280, 720)
    speed: float = 1.0
    curves: str | None = None

    def __post_init__(self) -> None:
        for name, value in (("fps", self.fps), ("speed", self.speed)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value}")
        if any(side % 2 or not 100 <= side <= 8000 for side in self.size):
            raise ValueError(f"size must be two even numbers of pixels of 100 to 8000, got {self.size}")


def film(page: str | Path, target: str | Path, look: FilmLook | None = None) -> None:
    """Save a film of a page of this package as it plays, H.264 in MP4, in a file.

    ValueError if there is no Chromium or no ffmpeg, or one of them fails.
    """
    check_film()
    look = look or FilmLook()
    with browsing() as browser, files.writing(target, files.FILM) as part:
        browser.open(_as_picture(page) + "&film" + (f"&curves={look.curves}" if look.curves else ""), look.size)
        begin, end = browser.run("[nsdyn.clock.begin, nsdyn.clock.end]")
        step = look.speed / look.fps
        command = ["ffmpeg", "-y", "-loglevel", "error"]
        command += ["-f", "image2pipe", "-framerate", f"{look.fps:g}", "-c:v", "mjpeg", "-i", "-"]
        command += ["-c:v", "libx264", "-preset", "veryfast", "-crf", "18", "-pix_fmt", "yuv420p"]
        command += ["-movflags", "+faststart", "-f", "mp4", str(part)]
        ffmpeg = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
        assert ffmpeg.stdin is not None
        try:
            for k in range(math.floor((end - begin) / step * (1.0 + 1e-12)) + 1):
                browser.run(f"nsdyn.show({begin + k * step!r})")
                ffmpeg.stdin.write(browser.picture(**FRAME))
        except BrokenPipeError:  # its message is read below
            pass
        message = ffmpeg.communicate()[1].decode(errors="replace")
        if ffmpeg.returncode:
            raise ValueError(f"cannot write {target}: ffmpeg fails: {message.strip()[-500:]}")


def _as_picture(page: str | Path) -> str:
    return Path(page).resolve().as_uri() + "#picture"
