"""Pictures of a page, taken by a headless Chromium."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from nsdyn.tools import files

__all__ = ["chromium", "screenshot"]


def chromium() -> str | None:
    """Path of Chromium or Chrome, if there is one."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def screenshot(page: str | Path, picture: str | Path, size: tuple[int, int] = (1280, 720)) -> None:
    """Save a picture of a page as a headless Chromium shows it.

    Parameters
    ----------
    page : path
        A page of this module, best one made with `at`.
    picture : path
        PNG file to write.
    size : (int, int)
        Width and height in pixels.

    Raises
    ------
    ValueError
        If there is no Chromium, or no picture came of it.
    """
    browser = chromium()
    if browser is None:
        raise ValueError("pictures need Chromium or Chrome on the PATH, as from 'apt-get install chromium'")
    with (
        files.writing(picture) as part,
        tempfile.TemporaryDirectory(prefix="nsdyn-", ignore_cleanup_errors=True) as folder,
    ):
        shot = Path(folder) / "shot.png"
        flags = [
            "--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", "--hide-scrollbars", "--disable-quic", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--virtual-time-budget=2000", "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder}/profile", f"--screenshot={shot}", f"--window-size={size[0]},{size[1]}",
        ]  # fmt: skip
        url = Path(page).resolve().as_uri() + "#picture"
        environment = os.environ | {"HOME": folder}
        try:
            done = subprocess.run([browser, *flags, url], capture_output=True, timeout=120, env=environment)
        except subprocess.TimeoutExpired:
            raise ValueError(f"{browser} took more than two minutes over {page}") from None
        if not shot.is_file():
            raise ValueError(f"{browser} made no picture of {page}: {done.stderr.decode(errors='replace')[-500:]}")
        shutil.copyfile(shot, part)
