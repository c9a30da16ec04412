"""The same input gives the same bytes: in threads, in processes with other settings, whatever else runs."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import nsdyn as nd

SCENES = {"pile": {"boxes": 3, "spheres": 3}, "quadruped": {}, "arm_pushes_box": {}, "rolling": {"balls": 2}}


def run(name, record=None, steps=50):
    setup = nd.scenes.setup(name, **SCENES[name])
    return nd.simulate(setup.scene, steps * setup.dt, **setup.options(), on_fail="ignore", record=record)


def assert_same(one, other):
    for name in one.columns.keys() - {"wall_time", "solver/time"}:
        assert one.columns[name].tobytes() == other.columns[name].tobytes(), name


@pytest.mark.parametrize("steps", [15, pytest.param(50, marks=pytest.mark.slow)])
def test_threads_give_the_bits_of_one(steps, tmp_path):
    """Steppers of several scenes at once, two of the same, all recording."""
    names = [*SCENES, "pile"]
    alone, found = {name: run(name, steps=steps) for name in SCENES}, {}

    def work(k):
        found[k] = run(names[k], tmp_path / f"{k}.h5", steps)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(len(names))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for k, name in enumerate(names):
        assert_same(alone[name], found[k])
        assert_same(alone[name], nd.Trajectory.load(tmp_path / f"{k}.h5"))


def solve(target):
    """Impulses of a problem of two contacts, saved."""
    W = np.diag([2.0, 1.0, 1.0, 3.0, 1.5, 1.0]) + 0.1
    np.save(target, nd.solve(nd.FC3D(W, [-1.0, 3.0, 0.2, -2.0, 0.1, 0.3], [0.5, 0.8]), "pgs", tol=1e-12).r)


def beside(script, targets, settings):
    """Run a script of this module for each target at once, in processes with these settings."""
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(nd.__file__).parents[1])])
    running = []
    for target, more in zip(targets, settings, strict=True):
        command = [sys.executable, "-c", f"from test_bits import run, solve; {script % repr(str(target))}"]
        running.append(subprocess.Popen(command, env=os.environ | {"PYTHONPATH": paths, "PYTHONHASHSEED": "1"} | more))
    assert [process.wait() for process in running] == [0] * len(running)


@pytest.mark.slow
def test_processes_give_the_bits_of_one(tmp_path):
    """Two at once, with other numbers of threads and other hashes."""
    files = [tmp_path / f"{k}.h5" for k in range(2)]
    beside("run('pile', %s)", files, [{}, {"OMP_NUM_THREADS": "4", "PYTHONHASHSEED": "7"}])
    whole = run("pile")
    for file in files:
        assert_same(whole, nd.Trajectory.load(file))


@pytest.mark.slow
def test_processes_share_a_new_cache(tmp_path):
    """Both compile the same kernels at once."""
    files = [tmp_path / f"{k}.npy" for k in range(3)]
    beside("solve(%s)", files[:2], [{"NSDYN_CACHE_DIR": str(tmp_path / "cache")}] * 2)
    solve(files[2])
    assert len({np.load(file).tobytes() for file in files}) == 1
    assert list((tmp_path / "cache").glob("*.nbc")), "kernels are kept there"
    assert not list((tmp_path / "cache").glob("tmp*")), "no file of the cache is half written"


def drop(order):
    """Six bodies of all shapes that fall on the ground and on each other, added in some order."""
    scene, material = nd.Scene(), nd.Material(0.4, 0.3)
    scene.add_halfspace("ground", material=material)
    adders = [
        lambda **k: scene.add_box("box", (0.2, 0.24, 0.28), 1.0, **k),
        lambda **k: scene.add_sphere("sphere", 0.12, 2.0, **k),
        lambda **k: scene.add_cylinder("cylinder", 0.1, 0.2, 1.5, **k),
        lambda **k: scene.add_capsule("capsule", 0.08, 0.2, 0.5, **k),
        lambda **k: scene.add_ellipsoid("ellipsoid", (0.1, 0.12, 0.14), 1.2, **k),
        lambda **k: scene.add_box("fixed", (0.3, 0.3, 0.1), fixed=True, **k),
    ]
    quaternions = np.random.default_rng(5).normal(size=(6, 4))
    for k in order:
        at = (0.02 * k, -0.03 * k, 0.45 + 0.35 * k) if k < 5 else (0.0, 0.0, 0.06)
        adders[k](position=at, quaternion=quaternions[k] / np.linalg.norm(quaternions[k]), material=material)
    return scene


@pytest.mark.parametrize("order", [pytest.param([5, 3, 0, 4, 2, 1], marks=pytest.mark.slow), [4, 5, 1, 2, 0, 3]])
def test_the_order_of_bodies_changes_nothing_but_round_off(order):
    """Through the first impacts, which double round-off a few times each."""
    one = nd.simulate(drop(range(6)), 0.3, dt=5e-3)
    other = nd.simulate(drop(order), 0.3, dt=5e-3)
    assert one.energy.normal.min() < -0.1, "bodies collide"
    for name in ("box", "sphere", "cylinder", "capsule", "ellipsoid"):
        np.testing.assert_allclose(one.body(name).position, other.body(name).position, rtol=0.0, atol=1e-9)
