"""A standing quadruped, twelve joints under PD control: time per step and slip of its feet, and MuJoCo's, in one run.

    python demos/bench/quadruped.py [--dt 5e-3] [--time 10] [--count 20]

MuJoCo (extra `peers`) gets the same URDF, gains and feedforward torques, elliptic cones and its implicit integrator.
Times are processor times, medians over the second half of the run; slip is the largest way of a foot in it. The last
line is our time for `count` robots in one scene.
"""

import argparse
import time

import numpy as np

import nsdyn as nd


def ours(dt: float, duration: float, count: int = 1) -> tuple[float, float]:
    """(median seconds of a step, slip of a foot in m) of `count` robots."""
    module = nd.scenes.module("quadruped")
    scene = module.scene(count=count)
    stepper = nd.Stepper(scene, dt, controller=module.controller(scene, walk=False))
    times, start, slip = [], None, 0.0
    for k in range(round(duration / dt)):
        t = time.process_time()
        step = stepper.step()
        if 2 * k >= duration / dt:
            times.append(time.process_time() - t)
            start = step.contacts.point if start is None else start
            slip = max(slip, float(np.abs(step.contacts.point - start)[:, :2].max()))
    return float(np.median(times)), slip


def mujoco_model(dt: float) -> tuple[object, object]:
    """(model, data) of the same robot with its control, standing as ours does at the start."""
    import mujoco

    module = nd.scenes.module("quadruped")
    scene = module.scene()
    (robot,) = scene.articulations.values()
    control = module.controller(scene, walk=False)(0.0, robot.q, robot.v)[robot.name]
    spec = mujoco.MjSpec.from_file(str(nd.scenes.folder() / "quadruped.urdf"))
    spec.compiler.fusestatic = False
    spec.option.timestep = dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    joints = list(spec.joints)
    spec.body("trunk").add_freejoint()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=[0.8, 0, 0])
    for joint, kp, kd in zip(joints, control.kp[6:], control.kd[6:], strict=True):
        motor = spec.add_actuator(target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        motor.gainprm[0], motor.biasprm[1], motor.biasprm[2] = kp, -kp, -kd
    model = spec.compile()
    data = mujoco.MjData(model)
    # MuJoCo's quaternions begin with w.
    data.qpos[:] = np.concatenate((robot.q[:3], robot.q[[6, 3, 4, 5]], robot.q[7:]))
    data.ctrl[:], data.qfrc_applied[6:] = control.target[6:], control.feedforward[6:]
    return model, data


def peer(dt: float, duration: float) -> tuple[float, float]:
    """(median seconds of MuJoCo's step, slip of a foot in m)."""
    import mujoco

    model, data = mujoco_model(dt)
    feet = [k for k in range(model.nbody) if model.body(k).name.endswith("foot")]
    times, start, slip = [], None, 0.0
    for k in range(round(duration / dt)):
        t = time.process_time()
        mujoco.mj_step(model, data)
        if 2 * k >= duration / dt:
            times.append(time.process_time() - t)
            start = data.xpos[feet].copy() if start is None else start
            slip = max(slip, float(np.abs(data.xpos[feet] - start)[:, :2].max()))
    return float(np.median(times)), slip


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dt", type=float, default=5e-3)
    parser.add_argument("--time", type=float, default=10.0)
    parser.add_argument("--count", type=int, default=20)
    arguments = parser.parse_args()
    seconds, slip = ours(arguments.dt, arguments.time)
    print(f"nsdyn:  {1e6 * seconds:6.0f} us per step   slip {slip:.1e} m")
    try:
        import mujoco
    except ImportError:
        print("MuJoCo is not installed: pip install 'nsdyn[peers]'")
    else:
        theirs, far = peer(arguments.dt, arguments.time)
        print(f"MuJoCo {mujoco.__version__}: {1e6 * theirs:6.0f} us per step   slip {far:.1e} m")
    many, slip = ours(arguments.dt, min(arguments.time, 100 * arguments.dt), arguments.count)
    print(f"nsdyn, {arguments.count} robots: {1e6 * many:6.0f} us per step, {1e6 * many / arguments.count:.0f} us each")


if __name__ == "__main__":
    main()
