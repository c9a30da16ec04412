"""nsdyn: rigid multibody dynamics with hard contact and exact Coulomb friction, every step certified."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nsdyn import solvers
    from nsdyn.problem import fclib
    from nsdyn.problem.fc3d import FC3D
    from nsdyn.problem.solution import NotConverged, Solution, Status
    from nsdyn.recording.audit import Audit, check
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.scene import named as scenes
    from nsdyn.scene.control import PD
    from nsdyn.scene.materials import Material
    from nsdyn.scene.scene import Scene
    from nsdyn.solvers import solve
    from nsdyn.stepping.simulation import simulate
    from nsdyn.stepping.state import State, Step
    from nsdyn.stepping.stepper import Stepper
    from nsdyn.study.sweep import sweep

__version__ = "0.1.0"

__all__ = [
    "Audit",
    "FC3D",
    "PD",
    "Material",
    "NotConverged",
    "Scene",
    "Solution",
    "State",
    "Status",
    "Step",
    "Stepper",
    "Trajectory",
    "check",
    "fclib",
    "scenes",
    "simulate",
    "solve",
    "solvers",
    "sweep",
]

_HOME = {
    "problem.fc3d": ("FC3D",),
    "problem.solution": ("NotConverged", "Solution", "Status"),
    "recording.audit": ("Audit", "check"),
    "recording.trajectory": ("Trajectory",),
    "scene.control": ("PD",),
    "scene.materials": ("Material",),
    "scene.scene": ("Scene",),
    "solvers": ("solve",),
    "stepping.simulation": ("simulate",),
    "stepping.state": ("State", "Step"),
    "stepping.stepper": ("Stepper",),
    "study.sweep": ("sweep",),
}
_MODULES = {"fclib": "problem.fclib", "scenes": "scene.named", "solvers": "solvers"}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use: ``nsdyn --help`` need not wait 0.7 s for numba and Pinocchio."""
    if name in _MODULES:
        return import_module(f"nsdyn.{_MODULES[name]}")
    for module, names in _HOME.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"nsdyn.{module}"), name)
            return value
    raise AttributeError(f"module 'nsdyn' has no attribute {name!r}")
