"""Set-up of a stepper: checks of its options, and the `System` of a scene, constant from move to move."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.loops import ROUNDED
from nsdyn.scene.bodies import Geom
from nsdyn.scene.scene import Scene
from nsdyn.scene.shapes import HALFSPACE, POLYTOPE
from nsdyn.solvers import Solver
from nsdyn.stepping.impacts import Law
from nsdyn.stepping.move_kernel import MoveKernel
from nsdyn.stepping.scene_state import System
from nsdyn.tools.options import check_flags, is_number


def check_seconds(**given: Any) -> None:
    """ValueError for times that are not positive, finite numbers of seconds."""
    for name, value in given.items():
        if not (is_number(value) and 0.0 < value < math.inf):
            raise ValueError(f"{name} must be a positive number of seconds, got {value!r}")


def check_options(scene: Any, dt: Any, theta: Any, overlap: Any, lift: Any, polish: Any) -> None:
    """ValueError for invalid options of `nsdyn.Stepper`."""
    check_seconds(dt=dt)
    if not (is_number(theta) and 0.5 <= theta <= 1.0):
        raise ValueError(f"theta must lie in [0.5, 1], got {theta!r}")
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a nsdyn.Scene, got {scene!r}; nsdyn.scenes.load(name)() makes a named one")
    if not (is_number(overlap) and 0.0 <= overlap <= 1.0):
        raise ValueError(f"overlap must be a fraction in [0, 1], got {overlap!r}")
    check_flags(lift=lift, polish=polish)


def system_of(
    scene: Scene,
    geoms: list[Geom],
    dynamics: Dynamics,
    detector: Detector,
    solver: Solver,
    scheme: tuple[float, float],
    law: Law,
) -> System:
    """Return the `System` of a scene with these shapes; scheme = (θ, step [s]), `law` is the law of impact."""
    # Without shapes only joint limits can close, in rad or in lengths of the order of a metre.
    size = min((g.shape.inscribed_radius for g in geoms if g.frame >= 0), default=0.1)
    # Penetration that the solver's own tolerance allows in a step need not be removed. No gap is known better than the
    # places of its bodies.
    place = float(np.abs(dynamics.place(dynamics.start()[0]).x).max(initial=0.0))
    closed = max(OPTIONS.gap_tol * size, ROUNDED * place, solver.tol * min(scheme[1], size / OPTIONS.slow))
    flat = [g.shape.kind in (HALFSPACE, POLYTOPE) for g in geoms]
    rounding = np.where(flat, np.inf, [g.shape.inscribed_radius for g in geoms])
    inscribed = np.array([g.shape.inscribed_radius if g.frame >= 0 else np.inf for g in geoms])
    rebounds = [*(g.material.restitution for g in geoms), *(e for _, e in scene.pairs.values() if e is not None)]
    elastic = any(e > 0.0 for e in rebounds) or bool(dynamics.joints.restitution.any())
    smallest = float(inscribed.min(initial=np.inf))
    out = System(dynamics, detector, solver, *scheme, closed, inscribed, rounding, smallest, law, elastic)
    return out._replace(mover=MoveKernel(out)) if dynamics.n and not dynamics.surfaces.count else out
