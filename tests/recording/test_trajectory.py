"""Recordings: what goes in comes out, in memory and as a file, also when the process is killed."""

import json
import os
import pickle
import signal
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pinocchio as pin
import pytest
from mechanisms import add, hang, lump
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn.recording import file as recording_file
from nsdyn.recording import recorder as module
from nsdyn.recording.columns import FORMAT_VERSION, STEP
from nsdyn.recording.recorder import Recorder
from nsdyn.recording.trajectory import Trajectory
from nsdyn.tools import unfinished

DT = 0.01
META = {"dt": DT, "theta": 0.5, "solver": "Auto(tol=1e-08)", "external_force": True}
WORKS = ["external", "normal", "friction", "damping", "constraint", "integration", "projection", "defect"]


def scene_dict(links: bool = False):
    scene = nd.Scene(name="two boxes")
    scene.add_halfspace("ground")
    for k, name in enumerate("ab"):
        scene.add_box(name, (0.2, 0.2, 0.2), 1.0, position=(k, 0, 0.1))
    if links:
        model = pin.Model()
        hang(model, 0, "elbow", pin.JointModelRX(), lump(1.0, 0.1))
        add(scene, "arm", model)
    return json.loads(json.dumps(scene.describe()))


def named_by_step(k):
    """What `STEP` reads of step k: a small real number, the step's number, or a status."""
    values = {"f8": 1e-9 * k, "i4": k, "i1": nd.Status.CONVERGED}
    out: dict = {}
    for column in STEP.values():
        place, _, name = column.path.rpartition(".")
        at = vars(out.setdefault(place, SimpleNamespace())) if place else out
        at[name] = values[column.kind]
    return out


def rows(n: int, links: bool = False, seed: int = 0):
    """An initial state and n steps of random numbers, with 0 to 3 contacts each."""
    rng = np.random.default_rng(seed)

    def state(k):
        quaternion = rng.normal(size=(2, 4))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
        q = np.column_stack([rng.normal(size=(2, 3)), quaternion]).ravel()
        poses = (rng.normal(size=(3, 3)), rng.normal(size=(3, 4))) if links else (None, None)
        joint = [0.5] if links else []
        works = dict(zip(WORKS, rng.normal(size=len(WORKS)), strict=True))
        return dict(
            t=k * DT,
            q=np.append(q, joint),
            v=np.append(rng.normal(size=12), joint),
            frames_x=poses[0],
            frames_quat=poses[1],
            energy={"kinetic": float(k), "potential": 2.0 * k, **works},
        )

    def step(k):
        nc = int(rng.integers(0, 4))
        frame = np.linalg.qr(rng.normal(size=(nc, 3, 3)))[0]
        contacts = SimpleNamespace(
            geom1=np.zeros(nc, np.int64),
            geom2=rng.integers(1, 3, nc),
            point=rng.normal(size=(nc, 3)),
            normal=frame[:, 0],
            mu=np.full(nc, 0.5),
            restitution=np.zeros(nc),
            key=rng.integers(0, 2**60, nc),
        )
        return SimpleNamespace(
            **state(k),
            **named_by_step(k),
            contacts=contacts,
            gap=rng.normal(size=nc),
            tangent=frame[:, 1],
            u=rng.normal(size=(nc, 3)),
            r=rng.normal(size=(nc, 3)),
            couple=rng.normal(size=(nc, 3)),
            contact_status=rng.integers(0, 3, nc).astype(np.int8),
            contact_time=rng.uniform(0.0, DT, nc),
            contact_duration=rng.uniform(0.0, DT, nc),
            work_normal=rng.normal(size=nc),
            work_friction=rng.normal(size=nc),
            pieces=SimpleNamespace(
                begin=np.zeros(k % 3),
                duration=np.full(k % 3, DT / 2),
                contacts=np.arange(k % 3),
                moves=np.ones((k % 3, 1), np.int8),
                joints=rng.normal(size=(8, k % 3, 1)),
            )
            if links and k % 3
            else None,
            joints=rng.normal(size=(8, 1)) if links else None,
            links=rng.normal(size=(int(links), 6)),
            wrenches=SimpleNamespace(
                body=np.arange(2),
                time=np.full(2, DT / 2),
                duration=np.full(2, DT),
                done=rng.normal(size=(2, 6)),
            )
            if k % 2
            else None,
            lifts=SimpleNamespace(
                body=np.arange(1), time=np.full(1, DT / 2), duration=np.full(1, DT), done=rng.normal(size=(1, 6))
            )
            if k % 3
            else None,
            untold=None,
        )

    return SimpleNamespace(**state(0)), [step(k) for k in range(1, n + 1)]


def record(path, n, links=False):
    first, steps = rows(n, links)
    with Recorder(path, META, scene_dict(links), first) as recorder:
        for step in steps:
            recorder.append(step)
    return recorder.trajectory(), first, steps


def assert_same(a: Trajectory, b: Trajectory):
    assert a.meta == b.meta and a.scene == b.scene
    assert a.columns.keys() == b.columns.keys()
    for name, values in a.columns.items():
        if name == "wall_time":  # of the recorder that measured it
            assert values.shape == b.columns[name].shape and (values > 0.0).all()
            continue
        assert values.dtype == b.columns[name].dtype, name
        np.testing.assert_array_equal(values, b.columns[name], err_msg=name)


@pytest.mark.parametrize("links", [False, True])
@pytest.mark.parametrize("n", [0, 1, 256, pytest.param(600, marks=pytest.mark.slow)])  # 256 rows are one block
def test_what_goes_in_comes_out(n, links, tmp_path):
    trajectory, first, steps = record(None, n, links)
    np.testing.assert_array_equal(trajectory.t, [s.t for s in [first, *steps]])
    np.testing.assert_array_equal(trajectory.q, [s.q for s in [first, *steps]])
    np.testing.assert_array_equal(trajectory.energy.kinetic, np.arange(n + 1.0))
    np.testing.assert_array_equal(trajectory.energy.friction, [s.energy["friction"] for s in steps])
    np.testing.assert_array_equal(trajectory.solver.iterations, np.arange(1, n + 1))
    assert trajectory.wall_time.shape == (n,)
    for k, step in enumerate(steps, start=1):
        table = trajectory.contacts(k)
        assert len(table) == step.gap.size
        np.testing.assert_array_equal(table.impulse_raw, step.r)
        np.testing.assert_array_equal(table.key, step.contacts.key)
        if links:
            np.testing.assert_array_equal(trajectory.columns["links/impulse"][k - 1], step.links)

    in_file, _, _ = record(tmp_path / "run.h5", n, links)
    assert_same(in_file, trajectory)
    trajectory.save(tmp_path / "copy.h5")
    assert_same(Trajectory.load(tmp_path / "copy.h5"), trajectory)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.h5", "run.h5"]


@pytest.mark.parametrize("options", [{}, {"every": 3}, {"contacts": False}, {"external_force": True}])
def test_steps_told_together_are_as_each_alone(options):
    """Quiet steps that nobody asked for anything, of changing numbers of contacts and with others between."""
    scene = sliding_box()
    scene.add_sphere("ball", 0.1, 1.0, position=(1, 0, 0.12), linear_velocity=(0.5, 0, 0))
    meta = META | {"external_force": False} | options
    alone, together = (Recorder(None, meta, scene.describe(), nd.Stepper(scene).start()) for _ in range(2))
    force = (lambda t, q, v: {"box": ((0.1 * np.sin(30 * t), 0, 0), (0, 0, 1e-3))}) if meta["external_force"] else None
    mine, other = (nd.Stepper(scene, dt=2e-3, external_force=force) for _ in range(2))
    names = [name for name in nd.Step.__annotations__ if name != "untold"]
    quiet = set()
    for _ in range(300):
        step = mine.step()
        quiet.add((step.untold is not None, step.gap.size))
        alone.append(
            SimpleNamespace(
                tangent=step.tangent, energy=step.energy, untold=None, **{n: getattr(step, n) for n in names}
            )
        )
        together.append(other.step())
    assert {(True, 4), (True, 5)} <= quiet and any(not untold and count for untold, count in quiet)
    one, many = alone.trajectory(), together.trajectory()
    assert ("wrenches/impulse" in one.columns) == (force is not None)
    one.columns["solver/time"], many.columns["solver/time"] = np.zeros((2, one.steps))
    assert_same(one, many)


def test_interrupt_while_rows_are_packed_loses_and_doubles_none(monkeypatch):
    first, steps = rows(6, links=True)
    recorder = Recorder(None, META, scene_dict(links=True), first)
    for step in steps:
        recorder.append(step)
    join, calls = np.concatenate, iter(range(100))

    def interrupted(*given, **options):
        if next(calls) == 30:
            raise KeyboardInterrupt
        return join(*given, **options)

    with monkeypatch.context() as patch:
        patch.setattr(np, "concatenate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            recorder.flush()
    assert_same(recorder.trajectory(), record(None, 6, links=True)[0])


@pytest.mark.slow
def test_frequent_flushes_change_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_FLUSH_SECONDS", 0.0)
    in_file, _, _ = record(tmp_path / "run.h5", 20, links=True)
    monkeypatch.undo()
    assert_same(in_file, record(None, 20, links=True)[0])


def test_a_complete_file_that_is_damaged_is_told(tmp_path):
    """Wherever a number or the scene is changed: HDF5 itself has checksums of all else."""
    path = tmp_path / "run.h5"
    in_file, _, _ = record(path, 7, links=True)
    data = path.read_bytes()
    for what in (in_file.q[3].tobytes(), in_file.columns["gauss/bound"].tobytes(), b'"two boxes"'):
        at = data.index(what) + 1
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(ValueError, match=r"is damaged: .*(filter returned failure|not what was written)"):
            Trajectory.load(path)


def test_file_is_readable_without_nsdyn(tmp_path):
    record(tmp_path / "run.h5", 7, links=True)
    with h5py.File(tmp_path / "run.h5") as file:
        meta = dict(file["meta"].attrs)
        assert meta["format"] == "nsdyn" and meta["format_version"] == 12 and meta["dt"] == DT
        assert {"nsdyn_version", "pin_version", "coal_version", "numpy_version", "scene_name"} < meta.keys()
        assert b'"two boxes"' in file["meta/scene"][()]
        assert file["t"].shape == (8,) and file["q"].shape == (8, 15) and file["v"].shape == (8, 13)
        assert file["frames/x"].shape == (8, 3, 3) and file["frames/quat"].shape == (8, 3, 4)
        named = {"t", "t_steps", "joint_coordinate", "axis", "side", "contact"}  # axes
        assert set(file["energy"]) - named == {"kinetic", "potential", *WORKS, "created"}
        assert file["energy/kinetic"].shape == (8,) and file["energy/defect"].shape == (7,)
        assert set(file["gauss"]) - named == {"gap", "shift", "bound", "coulomb"}
        assert set(file["solver"]) - named == {"error", "residual", "iterations", "status", "time"}
        offset, pieces = file["contacts/offset"][:], file["pieces/offset"][:]
        assert offset.shape == (8,) and offset[0] == 0
        assert pieces.tolist() == [0, 1, 3, 3, 4, 6, 6, 7] and file["pieces/shift"].shape == (7, 1)
        joints = ("actuation", "limit", "friction", "external", "shift", "strength", "drive", "struck")
        shapes = {name: file["joints"][name].shape for name in {*file["joints"]} - named}
        assert shapes == dict.fromkeys(joints, (7, 1))
        assert file["links/impulse"].shape == (7, 1, 6)
        assert file["wrenches/offset"][:].tolist() == [0, 2, 2, 4, 4, 6, 6, 8]
        assert file["lifts/offset"][:].tolist() == [0, 1, 2, 2, 3, 4, 4, 5] and file["lifts/shift"].shape == (5, 6)
        assert [len(file["wrenches"][name]) for name in ("body", "time", "duration", "impulse")] == [8] * 4
        columns = set(file["contacts"]) - {"offset"} - named
        names = "geom1 geom2 point normal gap u impulse couple mu restitution key status tangent time duration"
        assert columns == {*names.split(), "work_normal", "work_friction"}
        assert {len(file[f"contacts/{name}"]) for name in columns} == {offset[-1]}


# A process that records until it is killed, by itself in the middle of a write or by its parent.
ENDLESS = """
import itertools, os, signal, sys
sys.path[:0] = {paths!r}
import h5py
from nsdyn.recording import file as recording_file
from nsdyn.recording import recorder as module
from test_trajectory import META, rows, scene_dict
module._FLUSH_SECONDS = 0.0
flushes = itertools.count(1)
flush = h5py.File.flush
def dying(file):
    if next(flushes) == {dies_at}:
        os.kill(os.getpid(), signal.SIGKILL)
    flush(file)
h5py.File.flush = dying
first, steps = rows(300)
recorder = module.Recorder(sys.argv[1], META, scene_dict(), first)
for k, step in enumerate(itertools.cycle(steps), start=1):
    recorder.append(step)
    print(k, flush=True)
"""


def killed(path, dies_at):
    paths = [*map(str, Path(__file__).parents[:2]), str(Path(nd.__file__).parents[1])]
    code = ENDLESS.format(paths=paths, dies_at=dies_at)
    command = [sys.executable, "-c", code, str(path)]
    written = 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            written = int(line)
            if written == 40 and not dies_at:
                process.kill()
    assert process.returncode == -signal.SIGKILL
    return written


def check_rows_of_killed_run(trajectory):
    first, steps = rows(300)
    n = trajectory.steps
    expected = Recorder(None, META, scene_dict(), first)
    for step in steps[:n]:
        expected.append(step)
    assert_same(trajectory, expected.trajectory())


def test_killed_run_keeps_its_steps(tmp_path):
    written = killed(tmp_path / "run.h5", dies_at=0)
    trajectory = Trajectory.load(tmp_path / "run.h5")
    assert trajectory.steps >= written  # every step was flushed before it was printed
    check_rows_of_killed_run(trajectory)


@pytest.fixture(scope="module")
def half_written(tmp_path_factory):
    """Bytes of a file whose tenth write has put all columns but /t into it."""
    path = tmp_path_factory.mktemp("killed") / "run.h5"
    assert killed(path, dies_at=10) == 9
    return path.read_bytes()


def test_run_killed_while_it_writes_keeps_its_complete_steps(half_written, tmp_path):
    (tmp_path / "run.h5").write_bytes(half_written)
    with h5py.File(tmp_path / "run.h5", swmr=True) as file:
        assert file["t"].shape == (10,)
    trajectory = Trajectory.load(tmp_path / "run.h5")
    assert trajectory.steps == 9
    check_rows_of_killed_run(trajectory)


def test_interrupted_write_is_completed(tmp_path, monkeypatch):
    first, steps = rows(6)
    recorder = Recorder(tmp_path / "run.h5", META, scene_dict(), first)
    for step in steps[:4]:
        recorder.append(step)

    def interrupt(file):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(h5py.File, "flush", interrupt)
        with pytest.raises(KeyboardInterrupt):
            recorder.flush()
    for step in steps[4:]:
        recorder.append(step)
    assert_same(recorder.trajectory(), record(None, 6)[0])


def test_recording_can_be_read_while_it_grows(tmp_path):
    first, steps = rows(6)
    recorder = Recorder(tmp_path / "run.h5", META, scene_dict(), first)
    # Another process that holds the file open, and by it a lock that must not stop the simulation.
    code = "import h5py, sys; file = h5py.File(sys.argv[1]); print(len(file['t']), flush=True); input()"
    command = [sys.executable, "-c", code, str(recorder.path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdout.readline() == "1\n"
        for step in steps:
            recorder.append(step)
        recorder.flush()
        reader.communicate("\n")
    assert reader.returncode == 0
    assert Trajectory.load(tmp_path / "run.h5").steps == 6


@pytest.mark.parametrize("name", ["missing/run.h5", "folder"])
def test_unwritable_path_is_named_and_nothing_is_left(name, tmp_path):
    (tmp_path / "folder").mkdir()
    first, _ = rows(0)
    with pytest.raises(ValueError, match=f"cannot write .*{name}"):
        Recorder(tmp_path / name, META, scene_dict(), first)
    with pytest.raises(ValueError, match=f"cannot write .*{name}"):
        record(None, 3)[0].save(tmp_path / name)
    assert [p.name for p in tmp_path.rglob("*")] == ["folder"]


def test_failed_save_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.h5"
    record(path, 3)
    old = path.read_bytes()
    bad = Trajectory({"dt": object()}, {}, {})
    with pytest.raises(TypeError):
        bad.save(path)
    assert path.read_bytes() == old and os.listdir(tmp_path) == ["run.h5"]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: f.__delitem__("meta"), "/meta with format='nsdyn' is missing"),
        (lambda f: f["meta"].attrs.__setitem__("format", "other"), "/meta with format='nsdyn' is missing"),
        (lambda f: f["meta"].attrs.__setitem__("format_version", FORMAT_VERSION + 1), "format_version"),
        (lambda f: f.__delitem__("gauss/bound"), "/gauss/bound is missing"),
        (lambda f: f["energy/defect"].resize(2, axis=0), "/energy/defect has 2 rows, 5 expected"),
        (lambda f: f["t"].resize(0, axis=0), "is damaged"),
    ],
)
def test_damaged_file_is_named(damage, message, tmp_path):
    path = tmp_path / "run.h5"
    first, steps = rows(5)
    recorder = Recorder(path, META, scene_dict(), first)
    for step in steps:
        recorder.append(step)
    recorder.flush()  # not finished, so that datasets can be resized
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(ValueError, match=message) as failure:
        Trajectory.load(path)
    assert str(path) in str(failure.value)


@pytest.mark.parametrize("parts", [40, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ended", [True, False])
def test_truncated_file_is_told_at_once(half_written, tmp_path, monkeypatch, ended, parts):
    """Of any length; one that its writer left marked as open would be waited for."""
    whole, cut = tmp_path / "run.h5", tmp_path / "cut.h5"
    record(whole, 40, links=True) if ended else whole.write_bytes(half_written)
    monkeypatch.setattr(unfinished, "PATIENCE", 0.0)
    opened = []

    class File(h5py.File):
        def __init__(self, *given, **options):
            opened.append(options)
            super().__init__(*given, **options)

    monkeypatch.setattr(h5py, "File", File)
    data = whole.read_bytes()
    for length in [*range(0, 64), *range(64, len(data), len(data) // parts)]:
        cut.write_bytes(data[:length])
        opened.clear()
        with pytest.raises(ValueError, match=r"cut\.h5 is (damaged|not a recording)") as failure:
            Trajectory.load(cut)
        assert "\n" not in str(failure.value)
        # As it is and without its mark; a reader beside a writer would try each block a hundred times.
        assert len(opened) <= 2 and not any("swmr" in options for options in opened)
    cut.write_bytes(data)
    assert Trajectory.load(cut).steps == (40 if ended else 9)


def test_a_file_to_which_rows_are_added_while_it_is_read_is_read_again(tmp_path, monkeypatch):
    path, calls = tmp_path / "run.h5", []
    whole, _, _ = record(path, 5, links=True)

    def contents(*given):
        calls.append(len(path.read_bytes()))
        if len(calls) < 3:
            os.utime(path, (0, len(calls)))  # as a writer changes it
            raise OSError("addr overflow")
        return real(*given)

    real = recording_file._contents
    monkeypatch.setattr(recording_file, "_contents", contents)
    assert_same(Trajectory.load(path), whole)
    assert len(calls) == 3


def test_other_files_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.h5"):
        Trajectory.load(tmp_path / "nothing.h5")
    (tmp_path / "text.h5").write_text("text")
    with pytest.raises(ValueError, match=r"text\.h5 .* not an HDF5 file"):
        Trajectory.load(tmp_path / "text.h5")


def test_body_motion_is_in_the_world_frame():
    trajectory, _, _ = record(None, 5, links=True)
    trajectory.scene["articulations"][0]["model"]["joints"][0]["kind"] = "JointModelScrew"
    body = trajectory.body("b")
    np.testing.assert_array_equal(body.position, trajectory.q[:, 7:10])
    np.testing.assert_array_equal(body.quaternion, trajectory.q[:, 10:14])
    R = Rotation.from_quat(body.quaternion)
    # Two ways to rotate vectors of size 1: a few units of round-off.
    np.testing.assert_allclose(body.linear_velocity, R.apply(trajectory.v[:, 6:9]), rtol=0, atol=1e-14)
    np.testing.assert_allclose(body.angular_velocity, R.apply(trajectory.v[:, 9:12]), rtol=0, atol=1e-14)
    link = trajectory.body("arm/elbow")
    np.testing.assert_array_equal(link.position, trajectory.columns["frames/x"][:, 2])
    slope = np.gradient(link.position, trajectory.t, axis=0, edge_order=2)  # whose joint is of no known kind
    np.testing.assert_allclose(link.linear_velocity, slope, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"moving body must be one of a, b, .*; got 'c'"):
        trajectory.body("c")


def test_contact_table():
    trajectory, _, steps = record(None, 10)
    k = next(k for k, s in enumerate(steps, start=1) if s.gap.size == 3)
    step, table = steps[k - 1], trajectory.contacts(k)
    assert table.body1 == ("ground",) * 3
    assert table.body2 == tuple("ground a b".split()[g] for g in step.contacts.geom2)
    assert table.status_names == [["open", "stick", "slip"][s] for s in step.contact_status]
    t2 = np.cross(step.contacts.normal, step.tangent)
    frame = np.stack([step.contacts.normal, step.tangent, t2], axis=1)
    # Sums of three products of size 1.
    expected = np.einsum("ci,cij->cj", step.r, frame)
    np.testing.assert_allclose(table.impulse_world, expected, rtol=0, atol=1e-14)
    lines = repr(table).splitlines()
    assert len(lines) == 4 and "r_N [N·s]" in lines[0] and "ground" in lines[1]
    np.testing.assert_array_equal(trajectory.contacts(k - 11).gap, table.gap)
    for outside in (0, 11, -11):
        with pytest.raises(IndexError, match="steps 1 to 10"):
            trajectory.contacts(outside)
    for none in ("a", 1.5, None, True):
        with pytest.raises(ValueError, match=f"step must be a whole number, got {none!r}"):
            trajectory.contacts(none)


def test_ledger_and_table():
    trajectory, _, steps = record(None, 95)
    ledger = trajectory.ledger()
    assert len(ledger["t"]) == 11 and ledger["t"][-1] == trajectory.t[-1]
    total = sum(s.energy["normal"] for s in steps)
    assert ledger["normal"][0] == 0.0
    assert ledger["normal"][-1] == pytest.approx(total, rel=1e-12)  # the same 95 terms, summed in order
    table = trajectory.energy_table().splitlines()
    assert len(table) == 17 and table[0].split()[:4] == ["t", "[s]", "kinetic", "potential"]
    assert "max residual 9.5e-08 m/s" in table[-1]
    numerics = np.cumsum([s.energy["integration"] + s.energy["defect"] for s in steps])
    total, most, share = map(float, table[-3].removeprefix("numerics").split())
    assert total == pytest.approx(numerics[-1], rel=1e-4) and most == pytest.approx(abs(numerics).max(), rel=1e-4)
    assert share == pytest.approx(most / trajectory.at_play, rel=0.06)  # two digits are printed


def test_works_that_vanish_are_left_out():
    first, steps = rows(5)
    for step in steps:
        step.energy |= dict.fromkeys(WORKS, 0.0) | {"integration": 1e-20, "friction": -1.0}
    with Recorder(None, META, scene_dict(), first) as recorder:
        for step in steps:
            recorder.append(step)
    assert list(recorder.trajectory().ledger()) == ["t", "kinetic", "potential", "friction", "defect"]


def test_matplotlib_is_not_loaded_by_recordings():
    code = textwrap.dedent("""
        import sys, nsdyn.recording.trajectory
        sys.exit("matplotlib" in sys.modules)
    """)
    root = str(Path(nd.__file__).parents[1])
    assert subprocess.run([sys.executable, "-c", code], cwd=root).returncode == 0


def sliding_box():
    scene = nd.Scene(name="slide")
    scene.add_halfspace("ground")
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), linear_velocity=(1, 0, 0))
    return scene


def test_recorded_simulation_equals_the_one_in_memory(tmp_path):
    in_memory = nd.simulate(sliding_box(), duration=0.1, dt=1e-3)
    recorded = nd.simulate(sliding_box(), duration=0.1, dt=1e-3, record=tmp_path / "run.h5")
    np.testing.assert_array_equal(recorded.q, in_memory.q)
    np.testing.assert_array_equal(recorded.columns["contacts/impulse"], in_memory.columns["contacts/impulse"])
    assert Trajectory.load(tmp_path / "run.h5").meta == in_memory.meta


def test_trajectory_of_a_simulation():
    trajectory = nd.simulate(sliding_box(), duration=0.1, dt=1e-3)
    assert trajectory.steps == 100 and trajectory.dt == 1e-3
    assert trajectory.t[-1] == pytest.approx(0.1, rel=1e-14)
    assert set(trajectory.solver.status_names) == {"CONVERGED"}
    body, e = trajectory.body("box"), trajectory.energy
    # v - mu g t, exact for the scheme up to the tolerance of the solver, 1e-8 m/s per step.
    np.testing.assert_allclose(body.linear_velocity[:, 0], 1.0 - 0.5 * 9.81 * trajectory.t, rtol=0, atol=1e-6)
    works = sum(getattr(e, name) for name in e.names[2:])
    np.testing.assert_allclose(np.diff(e.total), works, rtol=0, atol=1e-14)  # round-off of 1 J
    table = trajectory.contacts(-1)
    assert table.body1 == ("ground",) * 4 and table.body2 == ("box",) * 4
    assert table.status_names == ["slip"] * 4
    assert table.impulse_world.sum(axis=0)[2] == pytest.approx(9.81e-3, rel=1e-6)  # weight x dt


def test_motions_of_bodies_and_joints_can_be_sent_to_other_processes():
    slide, arm = (nd.simulate(nd.scenes.load(name)(), 0.05, dt=1e-2) for name in ("slide", "arm_pushes_box"))
    for run, name in (slide, "box"), (arm, "arm/fore"):
        velocity = pickle.loads(pickle.dumps(run.body(name))).linear_velocity
        np.testing.assert_array_equal(velocity, run.body(name).linear_velocity)
    elbow = arm.joint("arm/elbow")
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(elbow)).reaction_force, elbow.reaction_force)


def test_refused_simulation_leaves_an_existing_recording(tmp_path):
    path = tmp_path / "run.h5"
    path.write_text("precious")
    with pytest.raises(ValueError, match="theta"):
        nd.simulate(sliding_box(), duration=0.1, theta=2.0, record=path)
    assert path.read_text() == "precious"


def test_a_recording_has_one_run(tmp_path):
    """Another run is refused while one records, and the first says where its file was taken away."""
    path = tmp_path / "run.h5"
    first, steps = rows(4)
    with Recorder(path, META, scene_dict(), first) as recorder:
        recorder.append(steps[0])
        recorder.flush()
        before = path.read_bytes()
        with pytest.raises(ValueError, match=r"run\.h5 is being recorded by another run"):
            Recorder(path, META, scene_dict(), first)
        assert path.read_bytes() == before
        recorder.append(steps[1])
    assert Trajectory.load(path).steps == 2
    with (
        pytest.raises(ValueError, match=r"run\.h5 was replaced or removed"),
        Recorder(path, META, scene_dict(), first) as it,
    ):
        path.unlink()
        it.append(steps[0])
