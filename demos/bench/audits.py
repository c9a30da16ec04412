"""True recordings of articulations, named and random ones: the audit passes them all.

    python demos/bench/audits.py [--count N] [--begin K]

Named scenes with articulations at several steps, then random robots: chains and trees of every kind of joint, fixed or
floating, with limits, dry friction, springs, damping, armature, closed loops, gears, driven joints, controllers,
external forces, contacts with and without restitution. Each recording must pass `nsdyn.check`; what it says it did not
look at is counted. The falsified ones, none of which may pass, are in `tests/audit/test_audit_articulated.py`.
"""

import argparse
import collections
import sys
import warnings
from typing import Any

import numpy as np
import pinocchio as pin

import nsdyn as nd
from nsdyn.scene import shapes

Rng = np.random.Generator

NAMED = {
    "arm_pushes_box": (1.0, (1e-2, 2e-3)),
    "bricard": (0.5, (5e-3, 2e-3)),
    "cart_pole": (1.5, (1e-2, 2e-3)),
    "chain": (0.1, (1e-3,)),
    "double_pendulum": (0.5, (1e-2, 1e-3)),
    "four_bar": (0.5, (1e-2, 2e-3)),
    "gripper": (0.8, (5e-3, 2e-3)),
    "quadruped": (1.4, (1e-2, 5e-3)),
    "slider_crank": (0.01, (5e-5, 1e-5)),
    "woodpecker": (0.1, (1e-3, 1e-4)),
}
"""Scenes by name: seconds, and steps."""


def named(name: str, seconds: float, dt: float) -> nd.Trajectory:
    """A named scene under its own controller."""
    setup = nd.scenes.setup(name)
    return nd.simulate(setup.scene, seconds, **setup.options(dt=dt))


def kind(rng: Rng) -> Any:
    """A joint."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    kinds = (
        pin.JointModelRX,
        pin.JointModelRY,
        pin.JointModelPZ,
        pin.JointModelRUBY,
        pin.JointModelSpherical,
        pin.JointModelSphericalZYX,
        pin.JointModelTranslation,
        lambda: pin.JointModelRevoluteUnaligned(axis),
        lambda: pin.JointModelPrismaticUnaligned(axis),
        lambda: pin.JointModelHX(0.1),
        pin.JointModelPlanar,
        pin.JointModelRZ,
        pin.JointModelRY,
    )
    return kinds[rng.integers(len(kinds))]()


def robot(rng: Rng, floating: bool) -> Any:
    """A tree of two to six links of about 0.2 m and 1 kg."""
    model, chain = pin.Model(), [0]
    for k in range(int(rng.integers(2, 7))):
        # Joints of a branch follow each other, as Pinocchio wants it.
        chain = chain[: max(2, int(rng.integers(len(chain) - 1, len(chain) + 1)))]
        parent = chain[-1]
        joint = pin.JointModelFreeFlyer() if floating and k == 0 else kind(rng)
        turn = pin.rpy.rpyToMatrix(*rng.uniform(-0.5, 0.5, 3))
        at = pin.SE3(turn, np.array([0.0, 0.0, -0.2 if k else 0.0]) + 0.05 * rng.normal(size=3))
        number = model.addJoint(parent, joint, at, f"j{k}")
        mass = 10.0 ** rng.uniform(-0.5, 0.5)
        inertia = mass * np.diag(rng.uniform(0.003, 0.005, 3))
        model.appendBodyToJoint(number, pin.Inertia(mass, np.array([0, 0, -0.1]), inertia), pin.SE3.Identity())
        model.addJointFrame(number)
        chain.append(number)
    return model


def random_run(seed: int) -> nd.Trajectory:
    """A random robot for some dozens of steps."""
    scene, options = random_robot(seed)
    return nd.simulate(scene, 0.15, **options)


def random_robot(seed: int) -> tuple[nd.Scene, dict[str, Any]]:
    """A random robot, and how to simulate it."""
    rng = np.random.default_rng([20261123, seed])
    floating = bool(rng.uniform() < 0.4)
    model = robot(rng, floating)
    scalar = np.zeros(model.nv)
    bound = np.full(model.nq, np.inf)
    for joint in list(model.joints)[1:]:
        if joint.nq == joint.nv == 1:
            scalar[joint.idx_v], bound[joint.idx_q] = 1.0, rng.choice([np.inf, 0.2, 0.6])
    model.lowerPositionLimit, model.upperPositionLimit = -bound, bound

    def some(most: float, chance: float = 0.5) -> np.ndarray:
        return scalar * most * rng.uniform(size=model.nv) * (rng.uniform() < chance)

    def together(friction: np.ndarray) -> np.ndarray:
        """With dry friction of joints whose coordinates slip as one."""
        own = np.random.default_rng([20261125, seed])
        for joint in list(model.joints)[1:]:
            count = {"JointModelSpherical": 3, "JointModelPlanar": 2}.get(joint.shortname(), 0)
            friction[joint.idx_v : joint.idx_v + count] = own.choice([0.0, 0.3 * own.uniform()])
        return friction

    e = float(rng.choice([0.0, 0.0, 0.5, 1.0]))
    material = nd.Material(float(rng.choice([0.0, 0.5])), float(rng.choice([0.0, e])))
    touching = rng.uniform() < 0.6
    ball = (shapes.sphere(0.04), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.15])))
    scene = nd.Scene(gravity=(0, 0, float(rng.choice([0.0, -9.81, -9.81]))))
    if touching:
        scene.add_halfspace("ground", offset=-0.2 * model.njoints - 0.4, material=material)
        scene.add_box("box", (0.3, 0.3, 0.3), 1.0, position=(0, 0.5, -0.2 * model.njoints - 0.25), material=material)
    velocity = rng.choice([0.3, 3.0]) * rng.normal(size=model.nv)
    looped = not floating and rng.uniform() < 0.2
    scene.add_model(
        "robot",
        model,
        v=0.0 * velocity if looped else velocity,
        restitution=e,
        material=material,
        collisions={f"j{k}": [ball] for k in range(model.njoints - 1)},
        self_collisions=False,
        friction=together(some(0.3)),
        damping=some(0.5),
        stiffness=some(20.0),
        armature=some(0.05),
    )
    free = [name for name in list(model.names)[1:] if scalar[model.joints[model.getJointId(name)].idx_v]]
    if free and rng.uniform() < 0.2:
        rate = 0.5 * rng.normal()
        name = str(rng.choice(free))
        k = model.joints[model.getJointId(name)].idx_q
        if np.isinf(bound[k]):
            scene.set_motion(f"robot/{name}", rate if rng.uniform() < 0.5 else lambda t: rate * np.cos(5.0 * t))
    elif looped:  # from rest, which loops let be
        scene.add_loop("robot", "loop", f"j{model.njoints - 2}", position=(0, 0, -0.1))
    control = push = None
    choice = rng.uniform()
    if choice < 0.3:
        law = nd.PD(50.0 * scalar, scalar, 0.1 * scalar, limit=float(rng.choice([1.0, 100.0])))
        control = lambda t, q, v: {"robot": law}  # noqa: E731
    elif choice < 0.5:
        control = lambda t, q, v: {"robot": scalar * np.sin(20.0 * t)}  # noqa: E731
    if rng.uniform() < 0.2:
        push = lambda t, q, v: {"robot/j1": (1.0, 2.0, 0.0)}  # noqa: E731
    theta, dt = float(rng.choice([0.5, 0.5, 0.5, 0.7, 1.0])), float(rng.choice([5e-3, 2e-3, 1e-3]))
    wheels = [name for name in free if np.isinf(bound[model.joints[model.getJointId(name)].idx_q])]
    if len(wheels) > 1 and rng.uniform() < 0.5:
        scene.add_gear("robot", *map(str, rng.choice(wheels, 2, replace=False)), float(rng.choice([-1.0, 0.5, 2.0])))
    return scene, {"dt": dt, "theta": theta, "controller": control, "external_force": push}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=180, help="of random robots")
    parser.add_argument("--begin", type=int, default=0, help="first of them")
    arguments = parser.parse_args()
    runs = [(f"{n} at {dt:g}", named, (n, seconds, dt)) for n, (seconds, steps) in NAMED.items() for dt in steps]
    runs = [] if arguments.begin else runs
    runs += [(f"robot {s}", random_run, (s,)) for s in range(arguments.begin, arguments.begin + arguments.count)]
    outcomes: collections.Counter[str] = collections.Counter()
    for label, run, given in runs:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                audit = nd.check(run(*given))
            except (ValueError, nd.NotConverged) as refused:
                outcomes["refused"] += 1
                print(f"{label}: refused: {str(refused)[:150]}")
                continue
        if not audit.passed:
            print(f"{label}:\n" + "\n".join(line for line in repr(audit).splitlines() if "FAILED" in line))
        outcomes[audit.verdict if audit.passed else "FAILED"] += 1
    for verdict, times in outcomes.most_common():
        print(f"{times:5}  {verdict}")
    return int(outcomes["FAILED"] > 0)


if __name__ == "__main__":
    sys.exit(main())
