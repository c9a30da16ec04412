"""Named scenes: one Python file each in `models`, found from the source tree and after an installation alike."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from nsdyn.scene import Scene

__all__ = ["controller", "folder", "load", "module", "names"]


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
    """Module of a named scene: its function `scene`, DURATION [s], DT [s], perhaps a `controller`.

    ValueError naming the known ones.
    """
    if name not in names():
        raise ValueError(f"scene must be one of {', '.join(names())}; got {name!r}")
    spec = importlib.util.spec_from_file_location(f"nsdyn_models_{name}", folder() / f"{name}.py")
    assert spec is not None and spec.loader is not None
    out = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(out)
    return out


def load(name: str) -> Callable[..., Scene]:
    """Return the function ``scene(**parameters) -> Scene`` of a named scene."""
    function: Callable[..., Scene] = module(name).scene
    return function


def controller(name: str, scene: Scene) -> Callable[..., Any] | None:
    """What drives the articulations of a named scene, ``controller(t, q, v)``; None for a scene without."""
    make = getattr(module(name), "controller", None)
    return None if make is None else make(scene)
