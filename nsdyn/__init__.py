"""nsdyn: rigid multibody dynamics with hard contact and exact Coulomb friction, every step certified."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nsdyn import fclib, scenes, solvers
    from nsdyn.audit import Audit, check
    from nsdyn.control import PD
    from nsdyn.ensemble import sweep
    from nsdyn.problem import FC3D, NotConverged, Solution, Status
    from nsdyn.scene import Material, Scene
    from nsdyn.solvers import solve
    from nsdyn.stepper import State, Step, Stepper, simulate
    from nsdyn.trajectory import Trajectory

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
    "audit": ("Audit", "check"),
    "control": ("PD",),
    "ensemble": ("sweep",),
    "problem": ("FC3D", "NotConverged", "Solution", "Status"),
    "scene": ("Material", "Scene"),
    "solvers": ("solve",),
    "stepper": ("State", "Step", "Stepper", "simulate"),
    "trajectory": ("Trajectory",),
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use: ``nsdyn --help`` need not wait 0.7 s for numba and Pinocchio."""
    if name in ("fclib", "scenes", "solvers"):
        return import_module(f"nsdyn.{name}")
    for module, names in _HOME.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"nsdyn.{module}"), name)
            return value
    raise AttributeError(f"module 'nsdyn' has no attribute {name!r}")
