"""Check a motion, a scene, a file of either, or a robot file with one function."""

from __future__ import annotations

from pathlib import Path
from typing import Any, overload

from nsdyn.audit import audit
from nsdyn.audit.audit import Audit
from nsdyn.audit.inspection import ROBOTS, Inspection, inspect_robot, inspect_scene
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import named
from nsdyn.scene.scene import Scene
from nsdyn.tools.files import as_path

RECORDINGS = (".h5", ".hdf5")
"""Extensions of recordings."""


@overload
def check(what: Trajectory, **options: float) -> Audit: ...
@overload
def check(what: Scene) -> Inspection: ...
@overload
def check(what: str | Path, **options: Any) -> Audit | Inspection: ...
def check(what: Trajectory | Scene | str | Path, **options: Any) -> Audit | Inspection:
    """Audit a motion, or inspect a scene or a robot file before anything moves; ``nsdyn check`` prints the same.

    Parameters
    ----------
    what : Trajectory, Scene, str or Path
        A motion or the path of its recording (.h5, .hdf5); a scene, its name or the path of its file (.py); the path
        of a robot file (.urdf, .sdf, .xml, .mjcf).
    **options
        For a motion or recording: tolerances that replace those in `nsdyn.audit.findings.TOLERANCES`, by name. For a
        named scene or its file: its parameters. For a robot file: options of ``Scene.add_urdf``, ``add_sdf`` or
        ``add_mjcf``, for instance ``base="free"``, ``keyframe="home"`` or ``q``. For a scene: none.

    Returns
    -------
    Audit
        For a motion or recording: the findings of `nsdyn.audit.audit.check` (true overlaps, friction cones and
        balances), each with its worst figure.
    Inspection
        Otherwise: masses, joints, overlaps at the start, and content of files that is not used.

    Both print as a table, and have ``passed`` and ``as_dict()`` for JSON.

    Raises
    ------
    ValueError
        If a file cannot be read (the message names it), or if options do not fit.

    Examples
    --------
    >>> import nsdyn as nd
    >>> scene = nd.scenes.load("slide")()
    >>> nd.check(scene).passed, nd.check(nd.simulate(scene, 0.1, dt=0.01)).passed
    (True, True)
    """
    if isinstance(what, Trajectory):
        return audit.check(what, **options)
    if isinstance(what, Scene):
        if options:
            raise ValueError(f"check of a scene takes no options, got {', '.join(options)}")
        return inspect_scene(what)
    path = as_path(what, "what to check, if it is no Trajectory and no Scene,")
    ending = path.suffix.lower()
    if ending in RECORDINGS:
        return audit.check(Trajectory.load(path), **options)
    if ending in ROBOTS:
        return inspect_robot(path, **options)
    if ending not in ("", ".py"):
        kinds = f"robot file ({', '.join(ROBOTS)}), scene (.py) or recording ({', '.join(RECORDINGS)})"
        raise ValueError(f"{what} is no {kinds}")
    return inspect_scene(named.setup(str(what), **options).scene, str(what))
