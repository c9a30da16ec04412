"""An hour of simulated time: memory, drift and energy of boxes at rest, a driven linkage and a ball that bounces.

    python demos/bench/long.py [SCENE]... [--time T]

Nothing is recorded but the figures, ten times on the way: resident memory, how far boxes at rest have moved or how far
the loop of the linkage is open, how the energy has changed (of the linkage it goes up and down with the crank), the sum
of what numerics added to it, the sum of the magnitudes of the ledger's defects, how many steps had contacts, and how
many missed their tolerance.
"""

import argparse
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

import nsdyn as nd
from nsdyn.scene import shapes


class Case(NamedTuple):
    """A scene, its step in s, options of the stepper, and what a state and the first one tell of drift, m."""

    scene: nd.Scene
    dt: float
    options: dict[str, Any] = {}  # noqa: RUF012
    drift: Callable[[np.ndarray, np.ndarray], float] = lambda q, start: float("nan")


def boxes() -> Case:
    """Twenty boxes at rest, four stacks of five."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    for k in range(20):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(0.5 * (k // 5), 0, 0.1 + 0.2 * (k % 5)))
    return Case(scene, 1e-2, drift=lambda q, start: float(np.abs(q - start).max()))


def linkage() -> Case:
    """A four-bar linkage turned half a turn a second, singular twice a turn, that strikes a pendulum in every turn."""
    speed, length, reach = np.pi, 1.0, 0.5
    scene = nd.scenes.load("four_bar")(windows=1, speed=speed, length=length)
    pendulum, bob = pin.Model(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -reach]))
    pivot = pin.SE3(np.eye(3), np.array([-0.75, 0.0, -0.2]))  # the bob hangs where the rods come by
    hinge = pendulum.addJoint(0, pin.JointModelRY(), pivot, "pendulum")
    pendulum.appendBodyToJoint(hinge, pin.Inertia.FromSphere(0.1, 0.1), bob)
    pendulum.addJointFrame(hinge)
    scene.add_model("pendulum", pendulum, collisions={"pendulum": [(shapes.sphere(0.1), bob)]}, damping=[0.05])
    motor = nd.PD(kp=0.0, kd=[10.0, 0.0, 0.0], target=0.0, target_velocity=[speed, 0.0, 0.0])

    def opening(q: np.ndarray, start: np.ndarray) -> float:
        """Distance of the end of the top rod from that of the second upright, by the angles alone."""
        first, top, second = q[0], q[0] + q[1], q[2]
        gap = (np.sin(first) + np.cos(top) - 1.0 - np.sin(second), np.cos(first) - np.sin(top) - np.cos(second))
        return float(length * np.hypot(*gap))

    return Case(scene, 5e-3, {"controller": lambda t, q, v: {"linkage": motor}}, opening)


def ball() -> Case:
    """A ball that bounces for ever, with restitution 1."""
    scene = nd.Scene()
    material = nd.Material(0.0, 1.0)
    scene.add_halfspace("ground", material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 1.1), material=material)
    return Case(scene, 1e-2)


SCENES = {"boxes": boxes, "linkage": linkage, "ball": ball}


def memory() -> float:
    """Resident memory now, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def main() -> int:
    """Exit code 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="*", choices=[*SCENES, []], help="default: all")
    parser.add_argument("--time", type=float, default=3600.0, help="simulated s (default: %(default)s)")
    arguments = parser.parse_args()
    for name in arguments.scene or SCENES:
        case = SCENES[name]()
        stepper = nd.Stepper(case.scene, case.dt, **case.options)
        start, first = stepper.start(), stepper.step()
        energy = first.ledger.kinetic + first.ledger.potential
        steps, begin = round(arguments.time / case.dt), time.process_time()
        numerics, defects, touching, missed = 0.0, 0.0, 0, 0
        for k in range(1, steps):
            step = stepper.step()
            numerics += step.ledger.integration + step.ledger.projection
            defects += abs(step.ledger.defect)
            touching += step.gap.size > 0
            missed += not step.solution.accepted
            if (k + 1) % max(1, steps // 10) == 0:
                gained = step.ledger.kinetic + step.ledger.potential - energy
                print(
                    f"{name} t = {step.t:7.1f} s: {memory():.1f} MB, drift {case.drift(step.q, start.q):.1e} m, energy "
                    f"{gained:+.1e} J of {energy:.3g}, numerics {numerics:+.1e} J, defects {defects:.1e} J, "
                    f"{touching} touching, {missed} missed, {time.process_time() - begin:.0f} s",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
