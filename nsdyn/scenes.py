"""Named scenes: one Python file each in `models`, found from the source tree and after an installation alike."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from nsdyn.naming import choice
from nsdyn.scene import Scene

__all__ = ["controller", "folder", "load", "module", "name_of", "names"]

_PREFIX = "nsdyn_models_"


def folder() -> Path:
    """Folder of the named scenes: inside the package when installed, beside it in a source tree."""
    here = Path(__file__).resolve().parent
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


def controller(name: str, scene: Scene) -> Callable[..., Any] | None:
    """What drives the articulations of a named scene, ``controller(t, q, v)``; None for a scene without."""
    make = getattr(module(name), "controller", None)
    return None if make is None else make(scene)


def external_force(name: str, scene: Scene) -> Callable[..., Any] | None:
    """What pushes the bodies of a named scene, ``external_force(t, q, v)``; None for a scene without."""
    make = getattr(module(name), "external_force", None)
    return None if make is None else make(scene)
