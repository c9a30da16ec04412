"""Pictures and films of a page, taken by a headless Chromium."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path

from nsdyn.recording.browser import browsing
from nsdyn.tools import files

__all__ = ["check_film", "film", "screenshot"]


def screenshot(page: str | Path, picture: str | Path, size: tuple[int, int] = (1280, 720)) -> None:
    """Save a picture of a page as a headless Chromium shows it: the scene, its name, its legend, the clock.

    Parameters
    ----------
    page : path
        A page of this package, best one made with `at`.
    picture : path
        PNG file to write.
    size : (int, int)
        Width and height in pixels.

    Raises
    ------
    ValueError
        If there is no Chromium, or no picture came of it.
    """
    with browsing() as browser, files.writing(picture, files.FRAME) as part:
        browser.open(_as_picture(page), size)
        part.write_bytes(browser.picture())


def check_film() -> None:
    """Raise a ValueError if there is no ffmpeg to make films with."""
    if shutil.which("ffmpeg") is None:
        raise ValueError("films need ffmpeg on the PATH, as from 'apt-get install ffmpeg'")


def film(page: str | Path, target: str | Path, fps: float = 30.0, size: tuple[int, int] = (1280, 720)) -> None:
    """Save a film, H.264 in MP4, of a page as it plays at speed 1.

    Parameters
    ----------
    page : path
        A page of this package.
    target : path
        MP4 file to write.
    fps : float
        Pictures a second.
    size : (int, int)
        Width and height in pixels, even numbers.

    Raises
    ------
    ValueError
        If there is no Chromium or no ffmpeg, or it fails.
    """
    check_film()
    with browsing() as browser, files.writing(target, files.FILM) as part:
        browser.open(_as_picture(page), size)
        begin, end = browser.run("[nsdyn.clock.begin, nsdyn.clock.end]")
        command = [
            "ffmpeg", "-y", "-loglevel", "error",
            "-f", "image2pipe", "-framerate", f"{fps:g}", "-c:v", "png", "-i", "-",
            "-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", str(part),
        ]  # fmt: skip
        ffmpeg = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
        assert ffmpeg.stdin is not None
        try:
            for k in range(math.floor((end - begin) * fps * (1.0 + 1e-12)) + 1):
                browser.run(f"nsdyn.show({begin + k / fps!r})")
                ffmpeg.stdin.write(browser.picture())
        except BrokenPipeError:  # it tells why below
            pass
        message = ffmpeg.communicate()[1].decode(errors="replace")
        if ffmpeg.returncode:
            raise ValueError(f"cannot write {target}: ffmpeg fails: {message.strip()[-500:]}")


def _as_picture(page: str | Path) -> str:
    return Path(page).resolve().as_uri() + "#picture"
