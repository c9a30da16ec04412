"""A recording as one self-contained web page: meshcat's viewer, the scene, its motion, energies, contacts; no network.

Everything is drawn from the collision shapes of the recording. The 3D part is a list of meshcat commands (set_object,
set_property) in MessagePack, as in meshcat's `static_html`. It is built without meshcat's server and with identifiers
made from names instead of random ones, so that equal recordings give equal bytes. The folder `page` has the page's own
script, which reads the arrays made in this package and turns the keyframes into an animation of meshcat.
"""

from __future__ import annotations

import html as _escape
import importlib.util
import warnings
from collections.abc import Sequence
from functools import lru_cache
from numbers import Integral, Real
from pathlib import Path
from string import Template
from typing import TypedDict, Unpack

import numpy as np

from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools import files
from nsdyn.tools.naming import check_known, choice
from nsdyn.view import titles
from nsdyn.view.contents import packed
from nsdyn.view.stage import View


class PageOptions(TypedDict, total=False):
    """Keywords of `html`."""

    fps: float | None
    forces: bool | str
    max_frames: int
    at: float | None
    beside: Trajectory | Sequence[Trajectory] | None


LARGE_PAGE = 50e6
"""Size of a page, bytes, above which a warning is given: browsers get slow."""

SCRIPTS = (
    "format theme recording clock timeline sight meshes backs coarse film stage blind overlay chart ledger motion"
    " inspector pane tools main"
).split()
"""Scripts of the folder `page`, in the order of their use."""


def write_html(trajectory: Trajectory, path: str | Path, **options: Unpack[PageOptions]) -> None:
    """Write the page of `html` to a file; an existing file is replaced once the new one is complete.

    ValueError for an option out of range, and for a file that cannot be written.
    """
    check_known(options, PageOptions.__optional_keys__)
    page = html(trajectory, **options).encode()
    with files.writing(path, files.PAGE) as part:
        part.write_bytes(page)


def html(
    trajectory: Trajectory,
    fps: float | None = None,
    forces: bool | str = False,
    max_frames: int = 3000,
    at: float | None = None,
    beside: Trajectory | Sequence[Trajectory] | None = None,
) -> str:
    """Return a self-contained page that plays a recording in any browser.

    Parameters
    ----------
    trajectory : Trajectory
    fps : float, optional
        Keyframes per second of simulated time, besides keyframes before and after every impact; the browser
        interpolates between keyframes. Default: all states, if the page is then at most 1 MB larger than with 30 per
        second, else 30.
    forces : bool or {"pair", "point"}
        Whether the contact forces are drawn when the page opens; a button changes it. Forces are means since the
        previous keyframe. They act on the moving body, or on body 2 if both move. There is one for each pair of bodies
        (False, True, "pair"), or one for each contact point. Their 90 % quantile is as long as a fifth of the scene's
        radius; arrows are cut at twice this length.
    max_frames : int
        Most keyframes; long recordings get fewer per second.
    at : float, optional
        Show only the recorded state nearest to this time, s, without controls, for a picture.
    beside : Trajectory or sequence of them, optional
        More recordings, shown beside the first with the same clock and the same camera.

    Raises
    ------
    ValueError
        If an option is out of range.

    Warns
    -----
    UserWarning
        If the page has more than 50 MB.
    """
    for what, number in {"fps": fps, "at": at}.items():
        if not isinstance(number, Real | None):
            raise ValueError(f"{what} must be a number, got {number!r}")
    if not isinstance(max_frames, Integral):
        raise ValueError(f"max_frames must be a whole number, got {max_frames!r}")
    if not isinstance(forces, bool):
        choice(forces, ("pair", "point"), "forces")
    shown = [(trajectory, at)]
    for other in beside if isinstance(beside, Sequence) else [beside] if beside is not None else []:
        if not isinstance(other, Trajectory):
            raise ValueError(f"beside must be a Trajectory, or a list of them, got {other!r}")
        # Before its begin and after its end, a recording shows its first or last state.
        shown.append((other, None if at is None else float(np.clip(at, other.t[0], other.t[-1]))))
    trajectories = [t for t, _ in shown]
    view, labels = View(trajectories), titles.labels(trajectories)
    page = Template(_part("page.html")).substitute(
        title=_escape.escape(titles.document(trajectories) + " - nsdyn"),
        style=_part("page.css"),
        meshcat=_meshcat_script(),
        script="\n".join(_part(f"{name}.js") for name in SCRIPTS),
        recordings="\n".join(
            '<script type="text/plain" class="recording">'
            f"{packed(t, fps, forces, max_frames, moment, label, view)}</script>"
            for (t, moment), label in zip(shown, labels, strict=True)
        ),
    )
    if len(page) > LARGE_PAGE:
        warnings.warn(
            f"the page has {len(page) / 1e6:.0f} MB, which browsers open slowly; lower fps or max_frames",
            stacklevel=2,
        )
    return page


def _part(name: str) -> str:
    return (Path(__file__).parent / "page" / name).read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _meshcat_script() -> str:
    """Return the JavaScript of meshcat's viewer; the package is not imported, because that would load its server."""
    spec = importlib.util.find_spec("meshcat")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("the page needs the viewer of the package meshcat: pip install meshcat")
    folder = Path(next(iter(spec.submodule_search_locations)))
    return (folder / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")
