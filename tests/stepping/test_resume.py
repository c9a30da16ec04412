"""Runs that were killed or ended go on as if they had never stopped; recordings of fewer steps, without contacts."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import nsdyn as nd
from nsdyn.recording import file as recording
from nsdyn.recording import slots
from nsdyn.scene.named import Setup
from nsdyn.stepping import checkpoint

TIMES = ["wall_time", "solver/time"]  # of a machine, not of a motion

RUNS = {
    "stack": ({"height": 4}, 120, {}),
    "pile": ({"boxes": 3, "spheres": 3}, 100, {}),  # falls, collides and comes to rest
    "quadruped": ({}, 120, {}),  # with its controller
    "rolling": ({"balls": 2}, 120, {"every": 3}),
    "woodpecker": ({}, 90, {"contacts": False}),
}

# A run that writes after every row, and is killed at some moment after a given step.
DYING = """
import os, signal, sys, threading
import nsdyn as nd
from nsdyn.recording import recorder
recorder._FLUSH_SECONDS = 0.0
append, count, last, delay = recorder.Recorder.append, 0, int(sys.argv[4]), float(sys.argv[5])
def dying(self, *given):
    global count
    append(self, *given)
    count += 1
    if count == last:
        threading.Timer(delay, os.kill, (os.getpid(), signal.SIGKILL)).start()
recorder.Recorder.append = dying
from test_resume import run
run(sys.argv[1], **{sys.argv[2]: sys.argv[3]})
"""


def setup(name) -> Setup:
    return nd.scenes.setup(name, **RUNS[name][0])


def run(name, **where):
    s, (_, steps, options) = setup(name), RUNS[name]
    return nd.simulate(s.scene, steps * s.dt, **s.options(dt=s.dt), on_fail="ignore", **options, **where)


def killed(name, how, path, last, delay):
    paths = [str(Path(__file__).parent), str(Path(nd.__file__).parents[1])]
    command = [sys.executable, "-c", DYING, name, how, str(path), str(last), str(delay)]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)}, check=False)
    assert done.returncode == -signal.SIGKILL


def assert_same(a, b):
    """To the last bit, the state at the end included."""
    one, other = (recording.read_state(path) for path in (a, b))
    assert one[0] == other[0] and one[1] == other[1]
    (row, arrays), (other_row, others) = one[3], other[3]
    assert row == other_row == len(one[2]["t"]) - 1
    for left, right in ((one[2], other[2]), (arrays, others)):
        assert left.keys() == right.keys()
        for name in left.keys() - set(TIMES):
            assert left[name].dtype == right[name].dtype and left[name].shape == right[name].shape, name
            assert left[name].tobytes() == right[name].tobytes(), name
    assert all(one[2][name].shape == other[2][name].shape for name in TIMES)


@pytest.mark.parametrize(
    ("name", "kills"),
    [("rolling", ["record"]), *(pytest.param(n, ["record", "resume"], marks=pytest.mark.slow) for n in RUNS)],
)
def test_killed_run_goes_on_bit_for_bit(name, kills, tmp_path):
    """Killed in the run, and again in the one that goes on with it, in or between writes as it happens."""
    whole, part = tmp_path / "whole.h5", tmp_path / "part.h5"
    run(name, record=whole)
    rng = np.random.default_rng()
    steps = RUNS[name][1]
    for how in kills:
        last, delay = int(rng.integers(1, steps // 3)), float(rng.uniform(0.0, 0.02))
        print(f"killed {delay:.4f} s after step {last}")  # shown where the test fails
        killed(name, how, part, last, delay)
    assert len(recording.read(part)[2]["t"]) < len(recording.read(whole)[2]["t"])
    trajectory = run(name, resume=part)
    assert_same(whole, part)
    assert nd.check(trajectory).passed


def test_a_state_is_in_the_file_before_its_head(tmp_path, monkeypatch):
    """A kill between the two leaves the state before; a head of what is not there would make the file unreadable."""
    path, copy, seen = tmp_path / "run.h5", tmp_path / "copy.h5", []
    nd.simulate(sliding(), 0.05, dt=0.01, record=path)
    meta, scene, columns, (row, arrays) = recording.read_state(path)
    recording.create(path, (meta, scene, columns), grow=True, state=(row - 1, arrays))
    write = h5py.Dataset.__setitem__

    def watched(dataset, where, values):
        if dataset.name.endswith("/head"):
            shutil.copy(path, copy)
            with h5py.File(copy, "r", libver="latest", swmr=True, locking=False) as file:
                seen.append([len(file[dataset.parent.name][part]) for part in slots.PARTS] == list(values[2:]))
            assert recording.read_state(copy)[3][0] == row - 1
        write(dataset, where, values)

    with h5py.File(path, "r+", libver="latest", locking=False) as file:
        file.swmr_mode = True
        monkeypatch.setattr(h5py.Dataset, "__setitem__", watched)
        slots.write(file, row, arrays)
    assert seen == [True] and recording.read_state(path)[3][0] == row


def test_run_that_ended_goes_on(tmp_path):
    whole, part = tmp_path / "whole.h5", tmp_path / "part.h5"
    s = setup("stack")
    nd.simulate(s.scene, 0.5, dt=0.01, record=whole)
    nd.simulate(s.scene, 0.2, dt=0.01, record=part)
    assert nd.simulate(s.scene, 0.2, dt=0.01, resume=part).steps == 20
    assert nd.simulate(s.scene, 0.5, dt=0.01, resume=part).steps == 50
    assert_same(whole, part)


def test_a_state_of_an_older_version_is_refused_and_stays(tmp_path):
    """Which has other arrays: nothing goes on from it, and the file keeps all of its rows."""
    path, s = tmp_path / "run.h5", setup("stack")
    nd.simulate(s.scene, 0.1, dt=0.01, record=path)
    meta, scene, columns, (row, arrays) = recording.read_state(path)
    del arrays["state.instant.contacts.names"]
    recording.create(path, (meta, scene, columns), grow=False, state=(row, arrays))
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"its state has no state\.instant\.contacts\.names, being of an older nsdyn"):
        nd.simulate(s.scene, 0.2, dt=0.01, resume=path)
    assert path.read_bytes() == before


def test_what_rests_goes_on_bit_for_bit():
    """Rows are those of where contacts were looked for, which a state tells: made anew they are equal."""
    s = setup("stack")
    stepper, fresh = nd.Stepper(s.scene, dt=s.dt), nd.Stepper(s.scene, dt=s.dt)
    for _ in range(10):
        stepper.step()
    fresh.set_state(checkpoint.unpack(checkpoint.pack(stepper.get_state()), fresh.get_state(), fresh.dynamics))
    for _ in range(3):
        assert stepper.step().v.tobytes() == fresh.step().v.tobytes()


PILE = {"boxes": 2, "spheres": 2}


@pytest.fixture(scope="module")
def fallen(tmp_path_factory):
    """The recording of a small pile, which nothing may change."""
    path = tmp_path_factory.mktemp("fallen") / "run.h5"
    nd.simulate(nd.scenes.load("pile")(**PILE), 0.05, dt=0.01, record=path)
    return path, path.read_bytes()


@pytest.mark.parametrize(
    ("scene", "options", "words"),
    [
        ({"boxes": 4}, {}, "its scene .* is a list of"),
        ({"mu": 0.3}, {}, r"its scene geoms\[0\] mu is 0.4, not 0.3"),
        ({}, {"dt": 0.02}, "its option dt is 0.01, not 0.02"),
        ({}, {"theta": 0.6}, "its option theta is 0.5, not 0.6"),
        ({}, {"solver": "pgs"}, "its option solver is 'Auto"),
        ({}, {"every": 2}, "its option every is 1, not 2"),
        ({}, {"contacts": False}, "its option contacts is True, not False"),
        ({}, {"max_points": 4}, "its option max_points is 8, not 4"),
        ({}, {"impact": "poisson"}, r"its option impact is 'Dissipative\(\)', not 'Poisson\(\)'"),
        ({}, {"external_force": lambda t, q, v: {}}, "its option external_force is False, not True"),
        ({}, {"duration": 0.02}, "duration must be at least the 0.05 s"),
        ({}, {"record": "other.h5"}, "record must be None where resume"),
    ],
)
def test_another_run_is_refused(fallen, scene, options, words):
    path, before = fallen
    arguments = {"duration": 0.1, "dt": 0.01} | options
    with pytest.raises(ValueError, match=words):
        nd.simulate(nd.scenes.load("pile")(**PILE | scene), resume=path, **arguments)
    assert path.read_bytes() == before


def sliding(speed=1.0, mu=None, belt=0.0):
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), linear_velocity=(speed, 0, 0))
    if mu is not None:
        scene.set_pair("box", "ground", mu=mu)
    if belt:
        scene.set_motion("ground", surface_velocity=(belt, 0, 0))
    return scene


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"speed": 2.0}, "its initial v is another"),
        ({"mu": 0.1}, "its pairs with coefficients of their own differ"),
        ({"belt": 0.1}, "its prescribed motions differ"),
    ],
)
def test_another_scene_of_the_same_shapes_is_refused(change, words, tmp_path):
    nd.simulate(sliding(), 0.05, dt=0.01, record=tmp_path / "run.h5")
    with pytest.raises(ValueError, match=words):
        nd.simulate(sliding(**change), 0.1, dt=0.01, resume=tmp_path / "run.h5")


def test_another_robot_of_the_same_shapes_is_refused(tmp_path):
    s = setup("quadruped")
    nd.simulate(s.scene, 0.01, **s.options(dt=s.dt), record=tmp_path / "run.h5")
    a = s.scene.articulations["quadruped"]
    s.scene.articulations["quadruped"] = type(a)(**{**vars(a), "damping": a.damping + 1.0})
    with pytest.raises(ValueError, match="its articulation 'quadruped' differ"):
        nd.simulate(s.scene, 0.02, **s.options(dt=s.dt), resume=tmp_path / "run.h5")


def test_recording_without_a_state_is_refused(tmp_path):
    path = tmp_path / "run.h5"
    with pytest.raises(FileNotFoundError, match="no such recording"):
        nd.simulate(sliding(), 0.1, resume=path)
    nd.simulate(sliding(), 0.05, dt=0.01).save(path)
    with pytest.raises(ValueError, match="holds no state of its run"):
        nd.simulate(sliding(), 0.1, dt=0.01, resume=path)


def test_recording_of_an_older_nsdyn_is_refused(tmp_path):
    path = tmp_path / "run.h5"
    nd.simulate(sliding(), 0.05, dt=0.01, record=path)
    with h5py.File(path, "r+") as file:
        file["meta"].attrs["format_version"] = 10
    before = path.read_bytes()
    with pytest.raises(ValueError, match="has format_version 10, this nsdyn reads 12"):
        nd.simulate(sliding(), 0.1, dt=0.01, resume=path)
    assert path.read_bytes() == before


def test_other_versions_are_warned_of(tmp_path):
    path = tmp_path / "run.h5"
    nd.simulate(sliding(), 0.05, dt=0.01, record=path)
    with h5py.File(path, "r+") as file:
        file["meta"].attrs["numpy_version"] = "1.0"
    with pytest.warns(UserWarning, match="begun with numpy_version 1.0, this is .*: last bits may differ"):
        nd.simulate(sliding(), 0.06, dt=0.01, resume=path)


def test_torn_state_is_passed_over(tmp_path):
    """Of two slots the older one serves where the newer was not written to its end, or its row was not."""
    first, second = {"a": np.arange(3.0), "b": np.array(7)}, {"a": np.ones((2, 2)), "c": np.array([1, 2])}
    with h5py.File(tmp_path / "state.h5", "w", libver="latest") as file:
        slots.create(file, 0, first)
        slots.write(file, 5, second)
        row, arrays = slots.read(file, 6)
        assert row == 5 and arrays["a"].tolist() == [[1.0, 1.0], [1.0, 1.0]] and arrays["c"].tolist() == [1, 2]
        assert slots.read(file, 5)[0] == 0
        file["state/1/numbers"][2] = 0.5
        row, arrays = slots.read(file, 6)
        assert row == 0 and arrays["a"].tolist() == [0.0, 1.0, 2.0] and arrays["b"] == 7
        assert json.loads(file["state/0/layout"][()].tobytes()) == {"a": ["f", [3]], "b": ["i", []]}


def test_every_nth_step_keeps_the_ledger_closed(tmp_path):
    full, few = (nd.simulate(sliding(), 0.3, dt=0.01, every=every) for every in (1, 4))
    assert few.steps == 8 and full.steps == 30  # rounded up to 32 steps
    full = nd.simulate(sliding(), 0.32, dt=0.01)
    assert few.every == 4 and few.dt == 0.01
    np.testing.assert_array_equal(few.q, full.q[::4])
    for name in ("friction", "normal", "integration"):
        summed = getattr(full.energy, name).reshape(-1, 4).sum(axis=1)
        # Sums of four numbers of at most half a joule, in whatever order.
        np.testing.assert_allclose(getattr(few.energy, name), summed, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(few.gauss.bound, full.gauss.bound.reshape(-1, 4).max(axis=1))
    np.testing.assert_array_equal(few.solver.iterations, full.solver.iterations.reshape(-1, 4).sum(axis=1))
    np.testing.assert_array_equal(few.contacts(3).impulse, full.contacts(12).impulse)
    np.testing.assert_array_equal(few.force("box"), full.force("box")[3::4])
    audit = nd.check(few)
    assert audit.passed and audit["balance"].looked_at == 8 and not audit["overlap"].reason
    left_out = {f.name for f in audit.findings if f.reason}
    of_motion = {"distance", "motion", "sideways", "momentum", "spin", "works", "contact_works", "drives", "lifts"}
    of_contacts = {"normal", "points", "gaps", "velocities", "partings", "bounces", "states"}
    assert left_out == of_motion | of_contacts | {"certificates", "provenance"}


def test_recording_without_contacts(tmp_path):
    full, bare = (nd.simulate(sliding(), 0.3, dt=0.01, contacts=contacts) for contacts in (True, False))
    np.testing.assert_array_equal(bare.q, full.q)
    np.testing.assert_array_equal(bare.energy.friction, full.energy.friction)
    assert not len(bare.columns["contacts/gap"]) and np.isnan(bare.worst()["penetration"])
    audit = nd.check(bare)
    assert audit.passed and audit["momentum"].reason == "contacts are not recorded" and audit["balance"].looked_at == 30
    for ask in (
        lambda: bare.contacts(1),
        lambda: bare.table("contacts"),
        lambda: bare.force("box"),
        lambda: bare.pair("box", "ground"),
    ):
        with pytest.raises(ValueError, match="the recording has no contacts"):
            ask()


@pytest.mark.parametrize("every", [0, -1, 2.0, True, "3", 10**30])
def test_every_is_a_whole_number(every):
    with pytest.raises(ValueError, match="every must be a whole number of steps"):
        nd.simulate(sliding(), 0.1, every=every)


def test_complete_recordings_are_compressed(tmp_path):
    """A stack at rest repeats itself; what grows is not compressed, as its last chunks are written again and again."""
    path = tmp_path / "run.h5"
    trajectory = nd.simulate(nd.scenes.load("stack")(), 1.0, dt=0.01, record=path)
    held = sum(values.nbytes for values in trajectory.columns.values())
    assert path.stat().st_size < 0.6 * held
    with h5py.File(path) as file:
        assert file["contacts/normal"].compression == "gzip" and file["contacts/normal"].shuffle
