"""nsdyn: rigid multibody dynamics with hard contact and exact Coulomb friction, every step certified."""

from nsdyn import fclib, scenes, solvers
from nsdyn.problem import FC3D, NotConverged, Solution, Status
from nsdyn.scene import Material, Scene
from nsdyn.solvers import solve
from nsdyn.stepper import State, Step, Stepper, simulate
from nsdyn.trajectory import Trajectory

__version__ = "0.1.0"

__all__ = [
    "FC3D",
    "Material",
    "NotConverged",
    "Scene",
    "Solution",
    "State",
    "Status",
    "Step",
    "Stepper",
    "Trajectory",
    "fclib",
    "scenes",
    "simulate",
    "solve",
    "solvers",
]
