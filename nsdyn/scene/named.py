"""Named scenes: one Python file each in `models`, found from the source tree and after an installation alike.

To add one:

1. ``models/NAME.py`` whose docstring says in one line what it shows: ``nsdyn scenes`` prints that;
2. ``scene(...) -> Scene`` with numbers as defaults: they are what ``--set`` changes;
3. `DURATION` and `DT`, s;
4. if it is driven, ``controller(scene)`` or ``external_force(scene)`` that return functions of (t, q, v);
5. a test of the law that it shows; `tests/test_stepper.py` runs every named scene and closes its ledger.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from nsdyn.scene.scene import Scene
from nsdyn.tools.naming import choice

__all__ = ["Setup", "folder", "load", "module", "name_of", "names", "setup"]

_PREFIX = "nsdyn_models_"


def folder() -> Path:
    """Folder of the named scenes: inside the package when installed, beside it in a source tree."""
    here = Path(__file__).resolve().parents[1]
    installed = here / "models"
    return installed if installed.is_dir() else here.parent / "models"


def names() -> list[str]:
    """Names of the scenes, sorted."""
    return sorted(p.stem for p in folder().glob("*.py") if not p.stem.startswith("_"))


@cache
def module(name: str) -> ModuleType:
    """Module of a named scene: its function `scene`, DURATION [s], DT [s], perhaps `controller`, `external_force`.

    ValueError naming the known ones.
    """
    choice(name, names(), "scene")
    spec = importlib.util.spec_from_file_location(_PREFIX + name, folder() / f"{name}.py")
    assert spec is not None and spec.loader is not None
    out = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(out)
    return out


def load(name: str) -> Callable[..., Scene]:
    """Return the function ``scene(**parameters) -> Scene`` of a named scene."""
    function: Callable[..., Scene] = module(name).scene
    return function


def name_of(function: Callable[..., Scene]) -> str | None:
    """Name of the scene whose function this is, None for any other."""
    name = getattr(function, "__module__", "").removeprefix(_PREFIX)
    return name if name in names() and function is load(name) else None


@dataclass(frozen=True, eq=False)
class Setup:
    """A named scene with all that its simulation needs.

    Attributes
    ----------
    name : str
    scene : Scene
    duration, dt : float
        How long it is worth looking at, and a step that serves, s.
    controller, external_force : callable, optional
        What drives its articulations and pushes its bodies, as `nsdyn.simulate` takes them.
    """

    name: str
    scene: Scene
    duration: float
    dt: float
    controller: Callable[..., Any] | None
    external_force: Callable[..., Any] | None

    def options(self, **others: Any) -> dict[str, Any]:
        """Keywords for `nsdyn.simulate` or `nsdyn.Stepper`: dt, controller and external_force, but for the `others`."""
        return {"dt": self.dt, "controller": self.controller, "external_force": self.external_force} | others


def setup(name: str, **parameters: Any) -> Setup:
    """A named scene with some of its parameters, and what drives it.

    Examples
    --------
    >>> import nsdyn as nd
    >>> s = nd.scenes.setup("rolling", balls=3)
    >>> trajectory = nd.simulate(s.scene, 0.1, **s.options(dt=0.01))
    >>> trajectory.steps
    10
    """
    source = module(name)
    scene = source.scene(**parameters)
    made = [getattr(source, what, lambda _: None)(scene) for what in ("controller", "external_force")]
    return Setup(name, scene, source.DURATION, source.DT, *made)
