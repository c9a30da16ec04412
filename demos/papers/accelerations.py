"""Extended least constraints of Yunt: primal against dual, and both against steps as dt goes to 0.

    python demos/papers/page.py accelerations

Needs clarabel (extra `acceleration`).

Reference: K. Yunt, On the relation of the principle of maximum dissipation to the principle of Gauss, equations 58, 70.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin

import nsdyn as nd
from nsdyn.literature.acceleration import accelerations, least_constraint

STEPS = 4e-4, 2e-4, 1e-4, 5e-5
"""dt in s."""


def pendulum(motion: bool, **keywords: object) -> nd.Scene:
    """Two rods of 1 m and 1 kg that turn about y, with dry friction and damping in their joints."""
    model, joint = pin.Model(), 0
    for k in range(2):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0 if k else 0.0]))
        joint = model.addJoint(joint, pin.JointModelRY(), place, f"j{k}")
        inertia = np.diag([1 / 12, 1 / 12, 1e-9])
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.0, 0.0, -0.5]), inertia), pin.SE3.Identity())
    model.lowerPositionLimit, model.upperPositionLimit = np.full(2, -0.4), np.full(2, 3.0)
    scene = nd.Scene()
    scene.add_model("pendulum", model, **keywords)
    if motion:
        scene.set_motion("pendulum/j0", velocity=lambda t: math.sin(1.0 + 3.0 * t))
    return scene


def scenes() -> dict[str, tuple[nd.Scene, float]]:
    """What is compared, by its name on the page: scenes, and the time of the state in s."""
    load, both = nd.scenes.load, np.array([0.3, 0.4])
    loose, speed, damping = np.array([0.4, 0.3]), np.array([1.0, -2.0]), np.array([0.1, 0.1])
    half, held = np.array([0.0, 0.3]), np.array([30.0, 0.5])
    return {
        "block slides down an incline": (load("incline")(angle=20.0, mu=0.3), 0.0),
        "four-bar mechanism (loop, redundant rows)": (load("four_bar")(), 0.3),
        "Bricard's mechanism (loop of rank 5)": (load("bricard")(), 0.3),
        "pendulum, dry friction and damping": (pendulum(False, q=both, v=speed, friction=loose, damping=damping), 0.0),
        "pendulum, first joint driven": (pendulum(True, q=both, friction=half, damping=damping), 0.3),
        "pendulum, first joint on its limit": (pendulum(False, q=np.array([-0.4, 0.8])), 0.0),
        "pendulum, first joint held by friction": (pendulum(False, q=np.array([0.02, 1.2]), friction=held), 0.0),
    }


def report(pictures: Path) -> str:
    """Compute, draw, and return the section of the page."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    ax = figure.subplots()
    lines = [
        "## Extended least constraints (Yunt)",
        "",
        "Accelerations from the primal program (58) and from its dual (70), and (v(dt) - v(0))/dt of one step.",
        "",
        "![Steps against the acceleration](../papers/accelerations.png)",
        "",
        f"| state | ‖a‖ | primal - dual | step - a at dt = {STEPS[0]:g} s | at {STEPS[-1]:g} s | order |",
        "|---|---|---|---|---|---|",
    ]
    for name, (scene, time) in scenes().items():
        exact_solver = nd.solvers.Auto(tol=1e-12)
        before = nd.Stepper(scene, dt=1e-3, solver=exact_solver)
        for _ in range(round(time / 1e-3)):
            before.step()
        state = before.get_state()
        found = accelerations(least_constraint(scene, state))
        size = float(np.abs(found.a).max())
        apart = float(np.abs(found.problem.primal(found.force[:, 0]) - found.a).max())
        errors = []
        for dt in STEPS:
            stepper = nd.Stepper(scene, dt=dt, solver=exact_solver, on_fail="ignore")
            stepper.set_state(state)
            stepper.step()
            errors.append(float(np.abs((stepper.get_state().instant.v - state.instant.v) / dt - found.a).max()))
        # Below what the cone programs leave, 1e-8 of the size, there is no order to see.
        exact = max(errors) <= 1e-7 * (1.0 + size)
        order = "exact" if exact else f"{math.log(errors[0] / errors[-1], STEPS[0] / STEPS[-1]):.2f}"
        lines.append(f"| {name} | {size:.3g} | {apart:.0e} | {errors[0]:.1e} | {errors[-1]:.1e} | {order} |")
        ax.loglog(STEPS, np.maximum(errors, 1e-10), "o-", label=name)
    ax.set(xlabel="dt [s]", ylabel="|Δv/dt - a|  [rad/s² or m/s²]")
    ax.set_xticks([], minor=True)
    ax.set_xticks(STEPS, [f"{dt:g}" for dt in STEPS])
    ax.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(pictures / "accelerations.png", dpi=80)
    lines += [
        "",
        "Smooth and dry dissipation of joints, limits, loops and driven joints change nothing of the principle: a "
        "smooth potential enters by its gradient, dry friction by its rate, a limit as a contact without friction, "
        "constraints by what they leave free. The steps converge to the accelerations at first order, from rest at "
        "second.",
    ]
    return "\n".join(lines)
