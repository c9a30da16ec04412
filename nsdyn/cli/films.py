"""`nsdyn film`: a film of recordings, beside each other, with their curves."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from nsdyn.cli.output import add_input, add_made, check_files, say, sides
from nsdyn.tools.files import FILM

CURVES = ("energy", "power", "motion", "checks", "none")
"""Curves of the HTML page, repeated here so that the help does not load its module."""


def add_film(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``nsdyn film``."""
    add_input(parser, "recording", metavar="RUN.h5")
    add_input(parser, "beside", metavar="OTHER.h5", nargs="*", help="shown beside it, on the same clock")
    add_made(parser, FILM, "mp4", "the film")
    parser.add_argument("--size", default="1280x720", metavar="WxH", help="in pixels (default: %(default)s)")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="S",
        help="simulated seconds in one of the film (default: %(default)g)",
    )
    parser.add_argument("--fps", type=float, default=30.0, metavar="N", help="pictures a second (default: %(default)g)")
    parser.add_argument(
        "--curves", choices=CURVES, default="energy", help="drawn below the bodies (default: %(default)s)"
    )
    parser.add_argument("--forces", nargs="?", const="pair", default=False, metavar="BY", help="as of nsdyn view")


def make_film(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn film``; return its exit code."""
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.view import pictures, viewer

    named, arguments.output = arguments.output, arguments.output or Path(f"{arguments.recording.stem}.mp4")
    check_files(arguments)
    look = pictures.FilmLook(
        fps=arguments.fps,
        size=sides(arguments.size, int, "pixels, such as 1280x720"),
        speed=arguments.speed,
        curves=None if arguments.curves == "none" else arguments.curves,
    )
    pictures.check_film()
    first, *beside = (Trajectory.load(path) for path in (arguments.recording, *arguments.beside))
    with tempfile.TemporaryDirectory(prefix="nsdyn-") as folder:
        page = Path(folder) / "page.html"
        viewer.write_html(first, page, forces=arguments.forces, beside=beside)
        pictures.film(page, arguments.output, look)
    if not named:
        say(arguments, arguments.output)
    return 0
