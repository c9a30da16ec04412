"""Quadruped that stands for 10 s: time of a step and slip of its feet, for 1 to 20 robots and beside MuJoCo.

    python demos/bench/quadruped.py [--time 10] [--robots 1 5 10 20]

Slip is the path of the points of contact on the ground, the largest of the feet. Time is processor time of a step: the
median, and beside it the lower quartile and the least, which a busy machine disturbs less. MuJoCo (extra `peers`) runs
the same URDF in the same run, at its defaults and with elliptic cones and impratio 10, at the same step and at a fifth
of it: with these gains its robot shakes at 5 ms and stands still from 2 ms on.
"""

import argparse
import time
from collections.abc import Callable
from itertools import product

import numpy as np

import nsdyn as nd

DT = 5e-3
MODULE = nd.scenes.module("quadruped")
STANCE, (KP, KD) = np.array(MODULE.STANCE["quadruped"]), MODULE.GAINS["quadruped"]


def measure(step: Callable[[], float], dt: float, duration: float) -> tuple[np.ndarray, float]:
    """(least, quartile and median processor time of a step in s, slip in m); `step` returns the fastest slip in m/s."""
    times, slip = [], 0.0
    for _ in range(round(duration / dt)):
        start = time.process_time()
        speed = step()
        times.append(time.process_time() - start)
        slip += dt * speed
    return np.quantile(times, (0.0, 0.25, 0.5)), slip


def ours(count: int, duration: float) -> tuple[np.ndarray, float]:
    """`measure` of nsdyn with so many robots."""
    scene = MODULE.scene(count=count)
    stepper = nd.Stepper(scene, dt=DT, controller=MODULE.controller(scene, walk=False))

    def step() -> float:
        u = stepper.step().u
        return float(np.hypot(u[:, 1], u[:, 2]).max(initial=0.0))

    stepper.step()  # compiles
    return measure(step, DT, duration)


def mujoco(stiff: bool, dt: float, duration: float) -> tuple[np.ndarray, float]:
    """`measure` of MuJoCo with the same robot, stance and gains."""
    import mujoco as mj

    # Without this its reader of URDF makes the trunk a part of the world.
    keep = '<robot name="quadruped"><mujoco><compiler fusestatic="false"/></mujoco>'
    text = (nd.scenes.folder() / "quadruped.urdf").read_text().replace('<robot name="quadruped">', keep)
    spec = mj.MjSpec.from_string(text)
    spec.worldbody.first_body().add_freejoint()
    spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    spec.option.timestep, spec.option.integrator = dt, mj.mjtIntegrator.mjINT_IMPLICITFAST
    if stiff:
        spec.option.cone, spec.option.impratio = mj.mjtCone.mjCONE_ELLIPTIC, 10.0
    for geom in spec.geoms:
        geom.friction[0], geom.condim = 0.8, 3
    for joint in [j for j in spec.joints if j.type == mj.mjtJoint.mjJNT_HINGE]:
        servo = spec.add_actuator(target=joint.name, trntype=mj.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(KP, kv=KD)
    model = spec.compile()
    data = mj.MjData(model)
    height = nd.scenes.load("quadruped")().articulations["quadruped"].q[2]
    data.qpos[:], data.ctrl[:] = np.r_[0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, STANCE], STANCE
    velocity = np.zeros(6)

    def slipping() -> float:
        fastest = 0.0
        for k in range(data.ncon):
            contact = data.contact[k]
            foot = max(contact.geom)
            mj.mj_objectVelocity(model, data, mj.mjtObj.mjOBJ_GEOM, foot, velocity, 0)
            at_point = velocity[3:] + np.cross(velocity[:3], contact.pos - data.geom_xpos[foot])
            fastest = max(fastest, float(np.hypot(*at_point[:2])))
        return fastest

    seconds, _ = measure(lambda: mj.mj_step(model, data) or 0.0, dt, duration)
    mj.mj_resetData(model, data)
    data.qpos[:], data.ctrl[:] = np.r_[0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0, STANCE], STANCE
    return seconds, measure(lambda: mj.mj_step(model, data) or slipping(), dt, duration)[1]


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--time", type=float, default=10.0, help="simulated seconds (default: 10)")
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 5, 10, 20], help="numbers of robots")
    arguments = parser.parse_args()
    print(f"{'':34} {'µs per step':^23} {'slip in':>8}")
    print(f"{'engine':>18} {'dt [s]':>7} {'robots':>7} {'least':>7} {'quarter':>7} {'median':>7} {'all [m]':>8}")

    def row(engine: str, dt: float, count: int, seconds: np.ndarray, slip: float) -> None:
        times = " ".join(f"{1e6 * s:7.0f}" for s in seconds)
        print(f"{engine:>18} {dt:7} {count:7} {times} {slip:8.1e}", flush=True)

    for count in arguments.robots:
        row("nsdyn", DT, count, *ours(count, arguments.time))
    try:
        for name, dt in product(("MuJoCo", "MuJoCo elliptic"), (DT, DT / 5)):
            row(name, dt, 1, *mujoco(name != "MuJoCo", dt, arguments.time))
    except ImportError:
        print("MuJoCo is not installed: pip install 'nsdyn[peers]'")


if __name__ == "__main__":
    main()
