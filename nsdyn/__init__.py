"""nsdyn: rigid multibody dynamics with hard contact and exact Coulomb friction, every step certified.

    import nsdyn as nd

    nd.Scene, nd.Material, nd.scenes            describe a scene, or load a named one
    nd.simulate, nd.Stepper, nd.impacts         run a scene, at once or step by step, with a law of impact
    nd.PD, nd.Actuation                         control joints, and the actuators of MJCF files
    nd.Trajectory, nd.Table                     the recording: states, energies, contacts, forces, certificates, pages
    nd.Live                                     a window that follows a stepper
    nd.check, nd.compare, nd.plots              audit a motion or a model, compare two runs, draw a recording
    nd.sweep, nd.refine                         run a scene with many parameters, or with several time steps
    nd.FC3D, nd.solve, nd.solvers, nd.fclib     contact problems without a scene

Each name has its own help, with an example. ``nsdyn --help`` lists the commands. SI units, world axes, quaternions
xyzw.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nsdyn import solvers
    from nsdyn.audit.audit import Audit
    from nsdyn.audit.checking import check
    from nsdyn.audit.inspection import Inspection
    from nsdyn.problem.fc3d import FC3D
    from nsdyn.problem.solution import NotConverged, Solution, Status
    from nsdyn.recording import fclib
    from nsdyn.recording.trajectory import Trajectory
    from nsdyn.scene import named as scenes
    from nsdyn.scene.actuation import Actuation
    from nsdyn.scene.control import PD
    from nsdyn.scene.materials import Material
    from nsdyn.scene.scene import Scene
    from nsdyn.solvers import solve
    from nsdyn.stepping import impacts
    from nsdyn.stepping.simulation import simulate
    from nsdyn.stepping.state import State, Step
    from nsdyn.stepping.stepper import Stepper
    from nsdyn.study.comparison import Comparison, compare
    from nsdyn.study.refinement import Refinement, refine
    from nsdyn.study.sweep import sweep
    from nsdyn.tools.table import Table
    from nsdyn.view import plots
    from nsdyn.view.live import Live

__version__ = "0.1.0"

__all__ = [
    "Actuation",
    "Audit",
    "Comparison",
    "FC3D",
    "Inspection",
    "Live",
    "PD",
    "Material",
    "NotConverged",
    "Refinement",
    "Scene",
    "Solution",
    "State",
    "Status",
    "Step",
    "Stepper",
    "Table",
    "Trajectory",
    "check",
    "compare",
    "fclib",
    "impacts",
    "plots",
    "refine",
    "scenes",
    "simulate",
    "solve",
    "solvers",
    "sweep",
]

_HOME = {
    "problem.fc3d": ("FC3D",),
    "problem.solution": ("NotConverged", "Solution", "Status"),
    "audit.audit": ("Audit",),
    "study.comparison": ("Comparison", "compare"),
    "recording.trajectory": ("Trajectory",),
    "scene.actuation": ("Actuation",),
    "scene.control": ("PD",),
    "scene.materials": ("Material",),
    "scene.scene": ("Scene",),
    "solvers": ("solve",),
    "stepping.simulation": ("simulate",),
    "stepping.state": ("State", "Step"),
    "stepping.stepper": ("Stepper",),
    "audit.checking": ("check",),
    "audit.inspection": ("Inspection",),
    "study.refinement": ("Refinement", "refine"),
    "study.sweep": ("sweep",),
    "tools.table": ("Table",),
    "view.live": ("Live",),
}
_MODULES = {
    "fclib": "recording.fclib",
    "impacts": "stepping.impacts",
    "plots": "view.plots",
    "scenes": "scene.named",
    "solvers": "solvers",
}


def __getattr__(name: str) -> Any:
    """Import a public name at its first use, so that ``nsdyn --help`` does not wait 0.7 s for numba and Pinocchio."""
    if name in _MODULES:
        return import_module(f"nsdyn.{_MODULES[name]}")
    for module, names in _HOME.items():
        if name in names:
            value = globals()[name] = getattr(import_module(f"nsdyn.{module}"), name)
            return value
    raise AttributeError(f"module 'nsdyn' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names, so that `dir` and completion show them before they are imported."""
    return sorted([*__all__, "__version__", "__doc__"])
