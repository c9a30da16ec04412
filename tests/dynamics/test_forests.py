"""Several robots in one file move as the same robots in files of their own."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import nsdyn as nd

ARM = """<body name="arm{k}" pos="{x} 0 1"><joint name="shoulder{k}" axis="0 1 0" range="-1.2 1.4" limited="true"
 frictionloss="0.05"/><geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1"/>
 <body name="hand{k}" pos="0 0 -.4"><joint name="elbow{k}" axis="0 1 0" stiffness="4" damping="0.1" armature="0.01"/>
 <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03" mass=".5"/></body></body>"""

WALKER = """<body name="trunk{k}" pos="{x} 0 0.5"><freejoint name="base{k}"/>
 <geom type="box" size=".2 .1 .05" mass="4"/>
 <body name="leg{k}" pos=".1 0 -.05"><joint name="knee{k}" axis="0 1 0"/>
 <geom type="capsule" fromto="0 0 -.05 0 0 -.3" size=".03" mass=".5"/></body></body>"""

BODIES = [robot.format(k=k, x=2.0 * k) for k, robot in enumerate((ARM, WALKER, ARM, WALKER))]


def written(path, bodies, more=""):
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="9 9 .1"/>{"".join(bodies)}</worldbody>'
        f"{more}</mujoco>"
    )
    return path


def simulated(files, duration, controller, external_force):
    scene = nd.Scene()
    for name, path in files.items():
        scene.add_mjcf(name, path, material=nd.Material(mu=0.6))
    driven = next(f"{name}/elbow2" for name, a in scene.articulations.items() if a.model.existJointName("elbow2"))
    scene.set_motion(driven, lambda t: np.sin(5.0 * t))
    return nd.simulate(scene, duration, 5e-3, controller=controller, external_force=external_force)


@pytest.mark.parametrize("duration", [0.3, pytest.param(0.6, marks=pytest.mark.slow)])
def test_a_file_of_four_robots_moves_as_four_files(duration, tmp_path):
    gains = nd.PD(20.0, 1.0, 0.3)
    push = {"arm0": (3.0, 0.0, 1.0), "leg1": ((0.0, 2.0, 0.0), (0.1, 0.0, 0.0))}
    one = simulated(
        {"all": written(tmp_path / "all.xml", BODIES)},
        duration,
        lambda t, q, v: {"all": gains},
        lambda t, q, v: {f"all/{body}": wrench for body, wrench in push.items()},
    )
    each = simulated(
        {f"r{k}": written(tmp_path / f"r{k}.xml", [body]) for k, body in enumerate(BODIES)},
        duration,
        lambda t, q, v: {f"r{k}": gains for k in range(4)},
        lambda t, q, v: {f"r{body[-1]}/{body}": wrench for body, wrench in push.items()},
    )
    # Of the same problems; only the order of floors differs.
    np.testing.assert_allclose(one.q, each.q, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(one.v, each.v, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(one.energy.total, each.energy.total, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(one.joint("all/knee3").torque, each.joint("r3/knee3").torque, rtol=0.0, atol=1e-9)
    assert nd.check(one).passed


def test_a_forest_is_controlled_as_a_whole(tmp_path):
    scene = nd.Scene()
    scene.add_mjcf("all", written(tmp_path / "all.xml", BODIES))
    nv = scene.articulations["all"].model.nv
    assert nv == 2 + 7 + 2 + 7
    forces = np.arange(nv) - 3.0
    free = nd.Stepper(scene, dt=1e-4).step()
    pushed = nd.Stepper(scene, dt=1e-4, controller=lambda t, q, v: {"all": forces}).step()
    model, walkers = scene.articulations["all"].model, np.r_[2:9, 11:18]
    M = pin.crba(model, model.createData(), scene.articulations["all"].q)
    # To first order in dt.
    np.testing.assert_allclose((M @ (pushed.v - free.v))[walkers], 1e-4 * forces[walkers], rtol=1e-3, atol=1e-8)
    for wrong, words in (
        (
            lambda t, q, v: {"all": np.zeros(3)},
            r"joint forces of controller of 'all' must be .* or 6 numbers, .* or 18 numbers",
        ),
        (lambda t, q, v: {"all": nd.PD(1.0, 0.0, np.zeros(17))}, r"target .* of 'all' must be .* or 6 numbers"),
    ):
        with pytest.raises(ValueError, match=words):
            nd.Stepper(scene, controller=wrong).step()
    with pytest.raises(
        ValueError, match=r"did you mean 'all/hand\d'\? body of external_force must be one of .* and 10 others; "
    ):
        nd.Stepper(scene, external_force=lambda t, q, v: {"all/hand7": (0, 0, 1)}).step()


def test_trees_that_a_loop_joins_stay_together(tmp_path):
    """Two hands hold each other; the walker between their arms in the file is counted to them, the last one is not."""
    bodies = [ARM.format(k=0, x=0.0), WALKER.format(k=1, x=2.0), ARM.format(k=2, x=0.3), WALKER.format(k=3, x=4.0)]
    hold = '<equality><connect body1="hand0" body2="hand2" anchor="0 0 -.2"/></equality>'
    scene = nd.Scene()
    scene.add_mjcf("all", written(tmp_path / "all.xml", bodies, hold))
    stepper = nd.Stepper(scene, dt=2e-3)
    assert [tree.model.nv for tree in stepper.dynamics.trees] == [11, 7]
    run = nd.simulate(scene, 0.4, 2e-3)
    one, two = (run.body(f"all/hand{k}") for k in (0, 2))
    point = one.position + Rotation.from_quat(one.quaternion).apply((0, 0, -0.2))
    held = Rotation.from_quat(two.quaternion).inv().apply(point - two.position)
    np.testing.assert_allclose(held, np.broadcast_to(held[0], held.shape), rtol=0.0, atol=1e-9)
