"""An hour of simulated time: memory, drift and energy of boxes at rest, a driven mechanism and a ball that bounces.

    python demos/bench/long.py [SCENE]... [--time T]

Nothing is recorded but the figures, ten times on the way: resident memory, how far what rests has moved, how the energy
has changed (of the mechanism it goes up and down with the crank), and the largest defect of the ledger.
"""

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

import nsdyn as nd


def boxes() -> tuple[nd.Scene, float, dict[str, object]]:
    """Twenty boxes at rest, four stacks of five."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    for k in range(20):
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(0.5 * (k // 5), 0, 0.1 + 0.2 * (k % 5)))
    return scene, 1e-2, {}


def mechanism() -> tuple[nd.Scene, float, dict[str, object]]:
    """The four-bar linkage, whose crank is driven."""
    setup = nd.scenes.setup("four_bar")
    return setup.scene, 2e-3, {k: v for k, v in setup.options().items() if k != "dt"}


def ball() -> tuple[nd.Scene, float, dict[str, object]]:
    """A ball that bounces for ever, with restitution 1."""
    scene = nd.Scene()
    material = nd.Material(0.0, 1.0)
    scene.add_halfspace("ground", material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 1.1), material=material)
    return scene, 1e-2, {}


SCENES = {"boxes": boxes, "mechanism": mechanism, "ball": ball}


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
        scene, dt, options = SCENES[name]()
        stepper = nd.Stepper(scene, dt, **options)
        start, first = stepper.start(), stepper.step()
        energy = first.ledger.kinetic + first.ledger.potential
        steps, defect, begin, missed = round(arguments.time / dt), 0.0, time.process_time(), 0
        for k in range(1, steps):
            step = stepper.step()
            defect = max(defect, abs(step.ledger.defect))
            missed += not step.solution.accepted
            if (k + 1) % max(1, steps // 10) == 0:
                drift = float(np.abs(step.q - start.q).max()) if name == "boxes" else float("nan")
                gained = step.ledger.kinetic + step.ledger.potential - energy
                print(
                    f"{name} t = {step.t:7.1f} s: {memory():.1f} MB, drift {drift:.1e} m, energy {gained:+.1e} J of "
                    f"{energy:.3g}, defect {defect:.1e} J, {missed} missed, {time.process_time() - begin:.0f} s",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main())
