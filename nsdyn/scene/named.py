"""Named scenes: one Python file each in `models`, found from the source tree and after an installation alike.

The path of your own scene file, ending in ``.py``, can be given wherever a name can; ``nsdyn new my.py`` makes a first
one. To add a scene to those that come with nsdyn, write:

1. ``models/NAME.py``, whose docstring says in one line what the scene shows: ``nsdyn scenes`` prints this line;
2. ``scene(...) -> Scene`` with numbers as defaults: ``--set`` changes these parameters;
3. `DURATION` and `DT`, s;
4. for a driven scene, ``controller(scene)`` or ``external_force(scene)`` that return functions of (t, q, v);
5. a test of the law that the scene shows; `tests/stepping/test_stepper.py` runs every named scene and checks that its
   ledger closes.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial, wraps
from pathlib import Path
from types import ModuleType
from typing import Any

from nsdyn.scene.scene import Scene
from nsdyn.tools.callbacks import called
from nsdyn.tools.files import is_file
from nsdyn.tools.naming import choice, unknown

__all__ = ["Setup", "folder", "load", "made", "module", "name_of", "names", "seconds", "setup", "template"]

_PREFIX, _OWN = "nsdyn_models_", "nsdyn_own_"


def folder() -> Path:
    """Return the folder of the named scenes: inside the package when installed, beside it in a source tree."""
    here = Path(__file__).resolve().parents[1]
    installed = here / "models"
    return installed if installed.is_dir() else here.parent / "models"


def names() -> list[str]:
    """Return the names of the scenes, sorted."""
    return sorted(p.stem for p in folder().glob("*.py") if not p.stem.startswith("_"))


def template() -> str:
    """Return the text of a first scene file: it has comments and runs."""
    return (folder() / "_template.py").read_text(encoding="utf-8")


def module(name: str) -> ModuleType:
    """Return the module of a scene: its function `scene`, perhaps DURATION and DT [s], `controller`, `external_force`.

    Parameters
    ----------
    name : str
        One of `names`, or the path of your own file, which ends in ``.py``.

    Raises
    ------
    ValueError
        For an unknown name, naming the known ones; for a file that cannot be run or is incomplete, naming the line or
        the missing part.
    """
    if isinstance(name, str) and name.endswith(".py"):
        return _own(Path(name).resolve())
    if isinstance(name, str) and name not in names() and (Path(name).suffix or is_file(name)):
        raise ValueError(
            f"{name} is no scene: give a name that 'nsdyn scenes' lists, or a scene file, which ends in .py"
        )
    if not isinstance(name, str) or name not in names():
        raise ValueError(f"{unknown(name, names(), 'scene')}; 'nsdyn scenes' lists them all")
    return _named(name)


@cache
def _named(name: str) -> ModuleType:
    return _knowing(_executed(_PREFIX + name, folder() / f"{name}.py"))


@cache
def _own(path: Path) -> ModuleType:
    if not is_file(path):
        raise ValueError(f"no such scene file: {path}")
    try:
        out = _executed(_OWN + str(path), path)
    except SyntaxError as error:
        raise ValueError(f"{path.name}, line {error.lineno}: {error.msg}") from error
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == str(path)]
        where = f", line {lines[-1]}" if lines else ""
        raise ValueError(f"{path.name}{where}: {type(error).__name__}: {error}") from error
    if not callable(getattr(out, "scene", None)):
        raise ValueError(f"{path.name} must define a function scene(...) that returns a Scene; see 'nsdyn new'")
    for p in inspect.signature(out.scene).parameters.values():
        if p.default is p.empty:
            raise ValueError(f"parameter {p.name} of scene in {path.name} must have a default; see 'nsdyn new'")
    return _knowing(out)


def _knowing(source: ModuleType) -> ModuleType:
    """Return the module of a scene with its function wrapped, so that each scene records its parameters."""
    function = source.scene

    @wraps(function)
    def scene(*arguments: Any, **parameters: Any) -> Scene:
        return made(function, *arguments, **parameters)

    source.scene = scene  # type: ignore[attr-defined]
    return source


def made(function: Callable[..., Scene], *arguments: Any, **parameters: Any) -> Scene:
    """Return the scene that a function makes, and record all its parameters in the scene, including the defaults.

    A scene from a file that sets no name gets the name of the file.
    """
    source = getattr(function, "__module__", "")
    if source.startswith(_PREFIX):
        out = function(*arguments, **parameters)  # errors from parameters of nsdyn's own scenes are raised unchanged
    else:
        out = called(function, "scene", _scene, *arguments, **parameters)
    if source.startswith(_OWN) and out.name == Scene.name:
        out.name = Path(source).stem
    known = inspect.signature(function)
    defaults = {p.name: p.default for p in known.parameters.values() if p.default is not p.empty}
    out.parameters = defaults | known.bind_partial(*arguments).arguments | parameters | out.parameters
    return out


def _scene(given: Any) -> Scene:
    if not isinstance(given, Scene):
        raise ValueError(f"scene must return a nsdyn.Scene, got {given!r}")
    return given


def _executed(name: str, path: Path) -> ModuleType:
    """Run a file as a module, registered under its name for code that looks up its own module, as dataclasses do."""
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    out = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(out)
    except BaseException:
        del sys.modules[name]
        raise
    return out


def seconds(name: str, what: str) -> float:
    """Return `DURATION` or `DT` of a named scene or of a file; ValueError where the file has none."""
    given = getattr(module(name), what, None)
    if not isinstance(given, (int, float)):
        unit, option = {"DURATION": ("how long to simulate", "--time"), "DT": ("the time step", "--dt")}[what]
        raise ValueError(f"{Path(name).name} must define {what}, {unit} in s, or {option} give it; see 'nsdyn new'")
    return given


def load(name: str) -> Callable[..., Scene]:
    """Return the function ``scene(**parameters) -> Scene`` of a named scene, or of a file."""
    return module(name).scene


def name_of(function: Callable[..., Scene]) -> str | None:
    """Return the name, or the path of the file, of the scene whose function is given; None for any other function."""
    source = getattr(function, "__module__", "")
    if source.startswith(_OWN):
        name = source.removeprefix(_OWN)
        return name if function is load(name) else None
    name = source.removeprefix(_PREFIX)
    return name if name in names() and function is load(name) else None


@dataclass(frozen=True, eq=False)
class Setup:
    """A named scene with everything needed to simulate it.

    Attributes
    ----------
    name : str
    scene : Scene
    controller, external_force : callable, optional
        Functions that drive the articulations and push the bodies, as `nsdyn.simulate` takes them.
    """

    name: str
    scene: Scene
    controller: Callable[..., Any] | None
    external_force: Callable[..., Any] | None

    @property
    def duration(self) -> float:
        """Recommended duration of a simulation, s; ValueError where the file of the scene gives none."""
        return seconds(self.name, "DURATION")

    @property
    def dt(self) -> float:
        """Recommended time step, s; ValueError where the file of the scene gives none."""
        return seconds(self.name, "DT")

    def options(self, **others: Any) -> dict[str, Any]:
        """Return keywords for `nsdyn.simulate` or `nsdyn.Stepper`: dt, controller, external_force, and `others`.

        Keywords given in `others` replace those of the scene.
        """
        own = {} if "dt" in others else {"dt": self.dt}
        return own | {"controller": self.controller, "external_force": self.external_force} | others


def setup(name: str, **parameters: Any) -> Setup:
    """Make a named scene with the given parameters, and the functions that drive it.

    Raise ValueError for parameters that the scene does not have.

    Examples
    --------
    >>> import nsdyn as nd
    >>> s = nd.scenes.setup("rolling", balls=3)
    >>> trajectory = nd.simulate(s.scene, 0.1, **s.options(dt=0.01))
    >>> trajectory.steps
    10
    """
    source = module(name)
    known = inspect.signature(source.scene).parameters
    if not any(p.kind is p.VAR_KEYWORD for p in known.values()):
        for parameter in parameters:
            choice(parameter, known, f"parameter of scene {name}")
    scene = source.scene(**parameters)
    drives = [
        called(make, what, partial(_function, what), scene) if (make := getattr(source, what, None)) else None
        for what in ("controller", "external_force")
    ]
    return Setup(name, scene, *drives)


def _function(what: str, given: Any) -> Callable[..., Any]:
    if not callable(given):
        raise ValueError(f"{what}(scene) must return a function of (t, q, v), got {given!r}")
    return given
